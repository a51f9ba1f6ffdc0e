"""Machines of bodies in MuJoCo, identified and diagnosed beside what is truly wrong with them.

    python benchmarks/bodies_study.py
    python benchmarks/bodies_study.py --worlds hexapod-lean --seeds 1 2 3

Needs ``mujoco`` (extra ``test``). Prints two tables. The first: how far the pose of a rigid world
with nominal geometry, heavily loaded, is from that of ``ppmcal`` for the same encoders; and what
`identify` leaves of the true error where joint centres, lengths and zeros are wrong, without noise
at new joint values. The second, for each world and seed (`benchmarks/bodies_world/cases.py` says
what is right, and why): the verdict, what was named, the gap before and after on poses put
aside, in units of the noise, and the true sizes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
from bodies_world.cases import CASES, LOADS, SIGMA, Case, campaign, true_shape  # noqa: E402
from bodies_world.files import sidecar, table, write  # noqa: E402
from bodies_world.machines import MACHINES, Machine, Shape  # noqa: E402
from bodies_world.mjcf import Faults  # noqa: E402
from bodies_world.session import measure  # noqa: E402
from diagnosis_study import surely_worse  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

import ppmcal  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402
from ppmcal.io.results.diagnosis import DiagnosisRecord  # noqa: E402


@dataclass(frozen=True)
class Answer:
    """What `diagnose` said of a world: each effect named, with its alternatives, and its sizes.

    ``gap``: before and after, over the noise; ``refused``: why there is no diagnosis; ``worse``:
    whether geometry alone surely predicts poses left out better; ``chances``: of each name that
    leads its kind, its probability, and those that may be in its place.
    """

    verdict: str
    named: tuple[frozenset[str], ...] = ()
    text: str = ""
    sizes: tuple[tuple[str, float, float, str], ...] = ()
    gap: tuple[float, float] = (np.nan, np.nan)
    refused: str = ""
    worse: int = 0
    chances: tuple[tuple[str, float, tuple[tuple[str, float], ...]], ...] = ()


def wrong(case: Case, answer: Answer) -> list[str]:
    """Return what is wrong with an answer: names that are not right, and those that are missing."""
    out = [f"{'/'.join(sorted(names))} is named" for names in answer.named
           if not names & case.right]
    said = frozenset[str]().union(*answer.named)
    out += [f"{'/'.join(sorted(names))} is not named" for names in case.must if not names & said]
    if not case.right and answer.verdict not in ("none", "weak"):
        out.append(f"{answer.verdict}, although nothing is there")
    return [answer.refused, *out] if answer.refused else out


def ask(folder: Path) -> Answer:
    """Return what is said of a campaign."""
    try:
        record = ppmcal.diagnose(folder / "mechanism.yaml", [folder / "data.csv"]).record
    except PpmcalError as error:
        why = str(error).replace(f"{folder}/data.csv: ", "").split(":")[0]
        return Answer("refused", refused=why)
    return answer_of(record)


def answer_of(record: DiagnosisRecord) -> Answer:
    """Return what a diagnosis says, as it is compared with the truth."""
    named = tuple(frozenset((e.kind, *e.alternatives)) for e in record.effects)
    text = ", ".join("/".join((e.kind, *e.alternatives)) for e in record.effects)
    sizes = tuple((f"{e.kind}.{n}", p.value, p.sigma, p.unit)
                  for e in record.effects for n, p in e.parameters.items() if p.sigma is not None)
    return Answer(record.verdict, named, text, sizes,
                  (record.gap.before or np.nan, record.gap.after or np.nan),
                  chances=tuple((e.kind, e.probability, tuple(zip(
                      e.alternatives, e.probabilities, strict=True))) for e in record.effects),
                  worse=surely_worse(record.predictive))


def random_run(machine: Machine, shape: Shape, rng: np.random.Generator, rows: int) -> Any:
    """Return a run of a rigid world at random joint values, under random payloads."""
    at = machine.reach * rng.uniform(-1, 1, (rows, len(machine.legs)))
    return measure(machine, shape, Faults(), at, rng.choice(LOADS, rows))


def apart(machine: Machine, run: Any, model: Path | Any) -> tuple[float, float]:
    """Return the largest distance (m) and angle (rad) of a model's poses from those of a run."""
    clean = table(machine, run, (0.0, 0.0), False, np.random.default_rng(0))
    joints = pd.DataFrame({k: v for k, v in clean.items() if k.startswith("q_")})
    said = ppmcal.forward(model, joints).to_frame()
    miss = np.linalg.norm([said[c].to_numpy() - clean[c] for c in "xyz" if c in clean], axis=0)
    names = [c for c in ("rx", "ry", "rz") if c in clean]
    turns = [[t[c] if c in names else np.zeros(len(joints)) for c in ("rx", "ry", "rz")]
             for t in (said, clean)]
    one, other = (Rotation.from_rotvec(np.transpose(t), degrees=True) for t in turns)
    return float(miss.max() / 1e3), float((one * other.inv()).magnitude().max())


def nominal_apart(machine: Machine, folder: Path, rows: int = 40) -> tuple[float, float]:
    """Return how far a rigid nominal world is from ppmcal, m and rad."""
    rng = np.random.default_rng(5)
    run = random_run(machine, machine.shape, rng, rows)
    write(folder, machine, table(machine, run, SIGMA, False, rng),
          sidecar(machine, SIGMA, "unknown"))
    return apart(machine, run, folder / "mechanism.yaml")


def identified_apart(machine: Machine, folder: Path, rows: int = 80
                     ) -> tuple[float, float, float, float]:
    """Return true errors after `identify` from noisy rows: before, after (m), noise, score.

    Errors are the largest at 40 new joint values; noise is what is left of the fitted rows over the
    stated sigma; the score is the largest distance of a parameter from the truth over its sigma.
    """
    rng = np.random.default_rng(7)
    shape = true_shape(machine, rng)
    run = random_run(machine, shape, rng, rows)
    columns = table(machine, run, SIGMA, False, rng)
    columns.pop("payload", None)
    write(folder, machine, columns, sidecar(machine, SIGMA, "unknown"))
    fit = ppmcal.identify(folder / "mechanism.yaml", [folder / "data.csv"])
    fit.save(folder / "fit")
    fresh = random_run(machine, shape, rng, 40)
    before = apart(machine, fresh, folder / "mechanism.yaml")[0]
    after = apart(machine, fresh, folder / "fit" / "identified.yaml")[0]
    return before, after, float(fit.record.noise.sigma_ratio or np.nan), score(machine, shape, fit)


def score(machine: Machine, shape: Shape, fit: Any) -> float:
    """Return the largest distance of an identified slot from its truth over its sigma."""
    turn = 180.0 / np.pi if machine.drive.joint == "hinge" else 1e3
    truth: dict[str, float] = {}
    for i, name in enumerate(machine.legs):
        for body, now, old in (("base", shape.base, machine.shape.base),
                               ("platform", shape.platform, machine.shape.platform)):
            truth |= {f"{name}.{body}.point.{c}": 1e3 * (now - old)[i, k]
                      for k, c in enumerate("xyz")}
        truth |= {f"{name}.{k}": 1e3 * (v[i] - machine.shape.lengths[k][i])
                  for k, v in shape.lengths.items()}
        truth[f"{name}.offset"] = turn * shape.offset[i]
    return max(abs(p.error - truth[p.name]) / p.sigma for p in fit.record.parameters
               if p.status == "identified" and p.sigma)


def sized(case: Case, answer: Answer) -> str:
    """Return found sizes beside true ones."""
    found = [f"{name} {value:.4g} ± {sigma:.2g} ({case.sizes[name]:.4g}) {unit}"
             for name, value, sigma, unit in answer.sizes if name in case.sizes]
    return "; ".join(found) or "-"


def geometry_table(folder: Path) -> None:
    """Print the first table."""
    print("| machine | ppmcal apart, nm, urad | error before, mm | after, um | left, sigmas "
          "| worst slot, sigmas |\n|---|---|---|---|---|---|")
    for name, machine in MACHINES.items():
        place, turn = nominal_apart(machine, folder / name)
        before, after, noise, worst = identified_apart(machine, folder / f"{name}-wrong")
        print(f"| {name} | {1e9 * place:.0f}, {1e6 * turn:.3f} | {1e3 * before:.2f} "
              f"| {1e6 * after:.1f} | {noise:.2f} | {worst:.1f} |", flush=True)


def worlds_table(folder: Path, worlds: Sequence[str], seeds: Sequence[int]) -> None:
    """Print the second table; the time of each on standard error."""
    print("\n| world | seed | verdict | named | gap before, after | found (true) | wrong |\n"
          "|---|---|---|---|---|---|---|")
    for name in worlds:
        for seed in seeds:
            start = time.process_time()
            campaign(name, seed, folder / f"{name}-{seed}")
            middle = time.process_time()
            answer, case = ask(folder / f"{name}-{seed}"), CASES[name]
            gap = ", ".join(f"{g:.2f}" if np.isfinite(g) else "-" for g in answer.gap)
            amiss = "; ".join(wrong(case, answer)) or "-"
            print(f"| {name} | {seed} | {answer.verdict} | {answer.text or '-'} | {gap} "
                  f"| {sized(case, answer)} | {amiss} |", flush=True)
            print(f"{name} {seed}: {middle - start:.1f} s world, "
                  f"{time.process_time() - middle:.1f} s diagnosis", file=sys.stderr)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        geometry_table(Path(folder))
        worlds_table(Path(folder), args.worlds, args.seeds)


if __name__ == "__main__":
    main()
