"""Machines on ropes, with seven legs or two arms: what is named, and how often intervals are right.

    python benchmarks/ropes_study.py --seed 921 --count 2         # names
    python benchmarks/ropes_study.py --seed 921 --coverage 200    # intervals without an instrument
    python benchmarks/ropes_study.py --causes slipped --eta 0.5 0.5 --machines cage cage-square
"""

from __future__ import annotations

import argparse
import csv
import json
import multiprocessing
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from ropes.machines import BELTS, MACHINES, NAMES, SQUARE, Machine
from ropes.world import (
    BY_PULL,
    CAUSES,
    NOISE,
    OF_ROPES,
    TURN_NOISE,
    UNKNOWN,
    Session,
    session,
)
from study_summary import interval

import ppmcal
from ppmcal.errors import PpmcalError
from ppmcal.model.effects import effect_kinds

ETA = (0.5, 2.0)
PLACES, REPEATS = 40, 3


@dataclass(frozen=True)
class Job:
    """One campaign."""

    seed: int
    machine: str
    cause: str
    number: int
    eta: tuple[float, float] = ETA
    places: int = PLACES
    repeats: int = REPEATS


def write(machine: Machine, done: Session, folder: Path, sides: bool) -> tuple[Path, Path]:
    """Write the machine and the campaign; return the paths."""
    file = folder / "machine.yaml"
    file.write_text(yaml.safe_dump(machine.file()), encoding="utf-8")
    kind = {"kind": machine.instrument, "sigma": {"actuator": machine.in_joints(NOISE)}}
    header = ["pose", *(f"q_{n}" for n in machine.ropes)]
    table = [done.place + 1, *machine.in_joints(done.readings).T]
    if sides:
        header += [f"dir_{n}" for n in machine.ropes]
        table += [*done.side.T]
    if done.poses is not None:
        kind["sigma"] |= {"position": NOISE}
        if not machine.pointed:
            kind["sigma"] |= {"rotation": TURN_NOISE}
        header += [NAMES[c] for c in machine.coordinates]
        table += [done.poses[:, c] for c in machine.coordinates]
    if done.session is not None:
        header += ["session"]
        table += [done.session + 1]
    if done.force is not None:
        header += [f"tension_{n}" for n in machine.ropes]
        table += [*done.force.T]
    data = folder / "rows.csv"
    with data.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out).writerows([header, *np.array(table).T.tolist()])
    side = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "rad"},
            "instrument": kind}
    if done.poses is not None:
        side |= {"frame": "unknown", "target": "known"}
    data.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    return file, data


def run(job: Job) -> dict:
    """Return what a diagnosis makes of one campaign."""
    rng = np.random.default_rng([job.seed, job.number, *job.machine.encode(), *job.cause.encode()])
    machine, (made, right) = (MACHINES | SQUARE)[job.machine], CAUSES[job.cause]
    eta = float(np.exp(rng.uniform(*np.log(job.eta))))
    done = session(machine, job.cause, eta, rng, job.places, job.repeats)
    line = {"machine": job.machine, "cause": job.cause, "eta": round(eta, 2)}
    with tempfile.TemporaryDirectory() as place:
        file, data = write(machine, done, Path(place), job.cause != "none")
        try:
            ppmcal.diagnose(file, data).save(Path(place) / "out")
        except PpmcalError as error:
            return line | {"verdict": "refused", "names": str(error)[:90], "right": 0, "wrong": 0}
        told = json.loads((Path(place) / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    sets = [{e["kind"], *map(kind_of, e["alternatives"])} for e in told["effects"]]
    hit, wrong = any(s & right for s in sets), sum(not s & right for s in sets)
    if made is None:
        hit = told["verdict"] == "none"
    elif right == UNKNOWN:
        hit = (hit or told["verdict"] in ("partial", "unnamed")) and not wrong
    names = "; ".join(f"{e['kind']} {'+'.join(e['on'])} {e['probability']:.2f}"
                      for e in told["effects"])
    return line | {"verdict": told["verdict"], "wrong": wrong, "right": int(hit), "names": names}


def covered(job: Job) -> list[float]:
    """Return the errors of a self-calibration of four belts, in standard deviations."""
    rng = np.random.default_rng([job.seed, job.number, 77])
    done = session(BELTS, "none", 1.0, rng, 50, 1)
    with tempfile.TemporaryDirectory() as place:
        file, data = write(BELTS, done, Path(place), False)
        found = ppmcal.identify(file, data).identification
    # the frame of the result: first anchor where it is drawn, second one at its drawn height
    true = done.anchors[:, :2] - done.anchors[0, :2]
    away = BELTS.anchors[1, 1] - BELTS.anchors[0, 1]
    angle = np.arcsin(away / np.hypot(*true[1])) - np.arctan2(true[1, 1], true[1, 0])
    c, s = np.cos(angle), np.sin(angle)
    true = true @ np.array([[c, -s], [s, c]]).T + BELTS.anchors[0, :2]
    at = {f"r{i + 1}.base.point.{a}": true[i, k] for i in range(4) for k, a in enumerate("xy")}
    return [(1e3 * e.value - at[e.name]) / (1e3 * e.sigma) for e in found.estimates if e.sigma]


def kind_of(label: str) -> str:
    """Return the kind of effect that an alternative is called after."""
    return next((name for name, kind in effect_kinds().items() if label.startswith(kind.label)),
                label.split()[0])


def has(machine: Machine, cause: str) -> bool:
    """Whether a machine can have a cause: where offsets are free a constant is geometry."""
    if cause in BY_PULL:
        return bool(machine.pulling)
    if cause == "constant":
        return not machine.offset
    return cause not in OF_ROPES or machine.kind == "rope"


def share(hits: int, total: int) -> str:
    """Return a share with its 95 % interval."""
    low, high = interval(hits, total)
    return f"{100 * hits / max(total, 1):.0f} % ({100 * low:.0f}-{100 * high:.0f})"


def table(lines: list[dict]) -> str:
    """Return the rates by cause in Markdown."""
    out = ["| hidden | campaigns | right | a wrong name | refused |", "|---|---|---|---|---|"]
    for cause in [*CAUSES, "all"]:
        own = [x for x in lines if cause in (x["cause"], "all")]
        if own:
            right, wrong = (sum(x[c] > 0 for x in own) for c in ("right", "wrong"))
            out.append(f"| {cause} | {len(own)} | {share(right, len(own))} | "
                       f"{share(wrong, len(own))} | "
                       f"{sum(x['verdict'] == 'refused' for x in own)} |")
    return "\n".join(out)


def main() -> None:
    """Run a study and print its table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seed", type=int, default=921)
    arguments.add_argument("--count", type=int, default=2, help="of each cause and machine")
    arguments.add_argument("--coverage", type=int, default=0, help="self-calibrations of belts")
    arguments.add_argument("--machines", nargs="*", default=list(MACHINES),
                           choices=[*MACHINES, *SQUARE])
    arguments.add_argument("--eta", type=float, nargs=2, default=ETA, help="least and most")
    arguments.add_argument("--places", type=int, default=PLACES)
    arguments.add_argument("--repeats", type=int, default=REPEATS, help="at each place")
    arguments.add_argument("--causes", nargs="*", default=list(CAUSES))
    arguments.add_argument("--cores", type=int, default=multiprocessing.cpu_count())
    asked = arguments.parse_args()
    with multiprocessing.Pool(asked.cores) as pool:
        if asked.coverage:
            z = np.concatenate(pool.map(covered, [Job(asked.seed, "belts", "none", n)
                                                  for n in range(asked.coverage)]))
            print(f"{asked.coverage} self-calibrations, {z.size} intervals: "
                  f"{share(int(np.sum(np.abs(z) < 1.96)), z.size)} hold the truth, "
                  f"rms {np.sqrt(np.mean(z**2)):.3f} sigma")
            return
        jobs = [Job(asked.seed, m, c, n, tuple(asked.eta), asked.places, asked.repeats)
                for n in range(asked.count) for c in asked.causes for m in asked.machines
                if has((MACHINES | SQUARE)[m], c)]
        lines = []
        for line in pool.imap_unordered(run, jobs):
            lines.append(line)
            print(", ".join(f"{k} {v}" for k, v in line.items()), file=sys.stderr, flush=True)
    print(table(lines))


if __name__ == "__main__":
    main()
