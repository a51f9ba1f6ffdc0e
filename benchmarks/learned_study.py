"""How much of what a fit could close that was told the truth is closed by what `diagnose` learns.

    python benchmarks/learned_study.py --out learned --seeds 1 2

Campaigns of `benchmarks/wild` in which something happens that is of no kind in the list: a worn
place of a screw, an error with the square of speed, joints that stop short by a share of their
move. Every campaign is one line of ``learned.csv``; a study that was stopped goes on.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
import yaml  # noqa: E402
from study_runner import read, remaining, work  # noqa: E402
from wild.catalogue import World, draw, write  # noqa: E402
from wild.machines import MACHINES  # noqa: E402
from wild_diagnosis import Job, jobs  # noqa: E402

from ppmcal import diagnose  # noqa: E402
from ppmcal.diagnosis.diagnose import DiagnosisOptions  # noqa: E402
from ppmcal.diagnosis.held_out_gap import (  # noqa: E402
    Gap,
    measure_gap,
    training_part,
)
from ppmcal.diagnosis.refit import with_mechanism  # noqa: E402
from ppmcal.diagnosis.result import Diagnosis  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402
from ppmcal.io import read_mechanism  # noqa: E402

CASES = ("wear", "speed-squared", "shortfall")
NODES = 161


@dataclass(frozen=True)
class Line:
    """One campaign: rms over the noise in unseen poses, without, told the truth, learned.

    ``of_told``: part of the excess (of squares) that is closed, over that of the fit told the
    truth; 0 where nothing is learned; ``worse``: whether what was learned makes them larger.
    """

    case: str
    machine: str
    seed: int
    rows: int
    eta: float
    verdict: str
    learned: str
    before: float
    told: float
    after: float
    of_told: float
    worse: int
    equation: str


def run(job: Job) -> Line | None:
    """Write one campaign, diagnose it, fit it with the truth too."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        truth = write(job.case, job.machine, job.rows, job.seed, folder, job.eta)
        try:
            found = diagnose(folder / "mechanism.yaml", [folder / "data.csv"])
            best = _told(found.diagnosis, folder, truth)
        except PpmcalError:
            return None
        return None if best is None else _line(job, found.diagnosis, found.record.entries(), best)


def _line(job: Job, found: Diagnosis, record: Mapping[str, Any], best: Gap) -> Line:
    terms = record["learned"]
    gap = found.learned.gap if found.learned else None
    before, after = (gap.before, gap.after) if gap else (best.before, best.before)
    told = _closed(best.before, best.after)
    return Line(job.case, job.machine, job.seed, job.rows, job.eta, found.verdict,
                " ".join(t["input"] for t in terms), round(before, 3), round(best.after, 3),
                round(after, 3), round(_closed(before, after) / told, 3) if told > 0.0 else np.nan,
                int(after > before * 1.001),
                "; ".join(t["equation"]["text"] for t in terms if t["equation"]))


def _closed(before: float, after: float) -> float:
    return 1.0 - max(after**2 - 1.0, 0.0) / max(before**2 - 1.0, 1e-9)


def _told(found: Diagnosis, folder: Path, truth: Mapping[str, Any]) -> Gap | None:
    """Return the gap of a fit of the same training rows that knows what happened."""
    recipe = truth["recipe"]
    world = draw(*(recipe[k] for k in ("case", "machine", "rows", "seed", "eta")))
    tree = yaml.safe_load((folder / "mechanism.yaml").read_text(encoding="utf-8"))
    path = folder / "told.yaml"
    path.write_text(yaml.safe_dump(tree | {"effects": _entries(truth, world)}), encoding="utf-8")
    options = DiagnosisOptions()
    base, held = training_part(found.before, options)
    fit = with_mechanism(base, read_mechanism(path), options.fit)
    return measure_gap(base, fit, held, found.found.noise, options.seed)


def _entries(truth: Mapping[str, Any], world: World) -> list[dict[str, Any]]:
    """Return what happened as functions of a model's file, leg by leg."""
    (effect,), run = truth["effects"], world.run
    size, turn = effect["parameters"], np.degrees if run.machine.rotary else np.asarray
    out = []
    for leg in effect["on"]:
        low, high = run.machine.limits[run.machine.legs.index(leg)]
        if "depth" in size:
            s = np.linspace(-1.6, 1.6, NODES)
            source, x = "travel", 0.5 * (low + high) + 0.5 * (high - low) * s
            y = -size["depth"] * np.exp(-(((s - size["at"]) / size["wide"]) ** 2))
        elif "size" in size:
            source, x = "velocity", np.linspace(-1.05, 1.05, NODES) * np.abs(run.speed).max()
            y = size["size"] * (x / run.speed.std()) ** 2
        else:
            source, x = "last move", np.linspace(-1.5, 1.5, NODES) * np.abs(run.q - run.via).max()
            y = -size["share"] * x
        out.append({"kind": "learned", "on": [leg], "input": source, "nodes": turn(x).tolist(),
                    "values": turn(y).tolist(), "covariance": np.zeros((NODES, NODES)).tolist()})
    return out


def table(lines: Sequence[Mapping[str, str]]) -> str:
    """Return the study in Markdown."""
    out = ["| case | campaigns | learned | of what the truth closes, median | at least 80 % | "
           "worse | equations |", "|---" * 7 + "|"]
    for case in (*CASES, "all"):
        own = [r for r in lines if case in (r["case"], "all")]
        part = [float(r["of_told"]) for r in own if r["of_told"] != "nan"]
        if own:
            out.append(f"| {case} | {len(own)} | {sum(bool(r['learned']) for r in own)} | "
                       f"{100 * np.median(part):.0f} % | {sum(p >= 0.8 for p in part)} | "
                       f"{sum(r['worse'] == '1' for r in own)} | "
                       f"{sum(bool(r['equation']) for r in own)} |")
    return "\n".join([*out, ""])


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("learned"))
    parser.add_argument("--machines", nargs="*", default=list(MACHINES))
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--rows", type=int, default=120)
    parser.add_argument("--eta", type=float, default=1.0)
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scheduler", help="run on this dask cluster, tcp://HOST:8786")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "learned.csv"
    todo = remaining(path, jobs((), CASES, given.machines, given.seeds, given.rows, given.eta))
    work(path, Line, run, todo, None, given.cores, given.scheduler)
    text = table(read(path))
    (given.out / "summary.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
