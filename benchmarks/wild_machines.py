"""Does the machine itself get better? Hidden machines, calibrated, commanded, and looked at.

    python benchmarks/wild_machines.py --out machines --count 20

Every machine of `benchmarks/wild` has one hidden cause. It is diagnosed from its campaign, wanted
poses are turned into commands (`compensate` with model.yaml), and the generator, which shares no
code with the package, says where the true machine goes. Printed per machine, rms over 40 new poses:

    nominal    true error of uncorrected commands, mm
    geometry   true error of commands of a fit without effects, mm; nan: refused
    model      true error of commands of model.yaml, mm
    promised   error that `compensate` predicts, mm
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import zlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from study_runner import read, remaining, work  # noqa: E402
from wild.cases import fits  # noqa: E402
from wild.catalogue import truth_pose, write  # noqa: E402
from wild.files import coordinates  # noqa: E402
from wild.machines import MACHINES, build  # noqa: E402

from ppmcal import compensate, diagnose, identify  # noqa: E402
from ppmcal.commands.compensate.run import CompensationResult  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402

CASES = ("none", "backlash-all", "homed-one", "leg-heat", "compliance-all", "periodic-one",
         "target-bumped", "play-all", "wear", "base-moved", "curvature-one", "gain-one",
         "leg-heat-late", "friction-one", "hardening", "base-plate", "backlash-and-heat",
         "speed-squared", "platform-plate", "shortfall")
POSES = 40


@dataclass(frozen=True)
class Job:
    """One hidden machine."""

    case: str
    machine: str
    seed: int
    eta: float


@dataclass(frozen=True)
class Line:
    """What became of one machine, rms over poses in mm; ``refused``: of its targets."""

    case: str
    machine: str
    seed: int
    eta: float
    verdict: str
    named: str
    nominal: float
    geometry: float
    model: float
    promised: float
    refused: int


def jobs(count: int, seed: int, eta: float) -> list[Job]:
    """Return so many machines, cases and kinds of machine in turns."""
    out: list[Job] = []
    for n in range(count):
        case = CASES[n % len(CASES)]
        able = [m for m in MACHINES if fits(case, m)]
        own = zlib.crc32(f"{seed}|{case}|{n}".encode()) % 2**20
        out.append(Job(case, able[(n + n // len(CASES)) % len(able)], own, eta))
    return out


def run(job: Job) -> Line | None:
    """Calibrate one machine and look where it goes; None where it is not diagnosed."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        truth = write(job.case, job.machine, 120, job.seed, folder, job.eta)
        if not all(e["physical"] for e in truth["effects"]):
            return None
        paths = folder / "mechanism.yaml", [folder / "data.csv"]
        try:
            found = diagnose(*paths)
            plain = identify(*paths)
            targets, joints = _targets(folder, job)
            sent = {"model": compensate(found, targets, approach="sequence")}
        except PpmcalError as error:
            print(f"{job}: {error}", file=sys.stderr)
            return None
        with suppress(PpmcalError):     # refused as worse than none, for what it leaves unexplained
            sent["geometry"] = compensate(plain, targets, approach="sequence")
        return _line(job, found.record.entries(), folder, targets, joints, sent)


def _targets(folder: Path, job: Job) -> tuple[dict[str, Any], np.ndarray]:
    """Return wanted poses between those of the campaign, and the true machine's joints there."""
    rows = read(folder / "data.csv")
    legs = [c for c in rows[0] if c.startswith("q_")]
    seen = np.array([[float(r[c]) for c in legs] for r in rows])
    rng = np.random.default_rng(job.seed)
    one, other = rng.integers(len(seen), size=(2, POSES))
    part = rng.uniform(0.2, 0.8, (POSES, 1))
    joints = seen[one] * part + seen[other] * (1.0 - part)
    motion = build(job.machine, job.seed).motion
    pose = truth_pose(folder, joints)
    table = dict(zip(coordinates(motion), pose.T, strict=True)) | _conditions(rows)
    return table, joints


def _conditions(rows: list[dict[str, str]]) -> dict[str, np.ndarray]:
    """Return what the generator takes where nothing else is said."""
    last = rows[-1]
    same = {"temperature": float(last["temperature"])} | {
        c: 0.0 for c in last if c in ("payload", "fx", "fy", "fz", "mx", "my", "mz")
        or c.startswith("vel_")}
    out = {c: np.full(POSES, v) for c, v in same.items()}
    return out | {"time": float(last["time"]) + 10.0 * (1.0 + np.arange(POSES))}


def _line(job: Job, found: Any, folder: Path, targets: dict[str, Any], joints: np.ndarray,
          sent: dict[str, CompensationResult]) -> Line:
    names = coordinates(build(job.machine, job.seed).motion)
    places = [n for n, c in enumerate(names) if c in ("x", "y", "z")]
    wanted = np.stack([targets[c] for c in names], axis=1)[:, places]
    good = np.all([[s == "ok" for s in c.compensation.status] for c in sent.values()], axis=0)
    good[0] = False         # how it is approached is not the sequence's

    def off(q: np.ndarray) -> float:
        scale = np.degrees(1.0) if build(job.machine, job.seed).rotary else 1e3
        q = np.where(good[:, None], q * scale, joints)
        return _rms(np.linalg.norm(truth_pose(folder, q)[:, places] - wanted, axis=1)[good])

    mine = sent["model"].compensation
    promised = 1e3 * np.hypot(mine.sigma_position, np.nan_to_num(mine.position_after))[good]
    return Line(job.case, job.machine, job.seed, job.eta, found["verdict"],
                " ".join(e["kind"] for e in found["effects"]), off(mine.q_nominal),
                off(sent["geometry"].compensation.q) if "geometry" in sent else float("nan"),
                off(mine.q), _rms(promised),
                int(POSES - 1 - good.sum()))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def table(lines: list[dict[str, str]]) -> str:
    """Return the machines, and all of them together, in Markdown."""
    out = ["| cause | machine | named | nominal, mm | geometry, mm | model, mm | promised, mm | "
           "refused |", "|---" * 8 + "|"]
    out += [f"| {r['case']} | {r['machine']} | {r['named'] or r['verdict']} | "
            + " | ".join(f"{float(r[c]):.4f}" for c in ("nominal", "geometry", "model", "promised"))
            + f" | {r['refused']} |" for r in lines]
    ratio = np.array([float(r["model"]) / float(r["promised"]) for r in lines])
    worse = sum(float(r["model"]) > float(r["geometry"]) for r in lines)
    nominal = sum(float(r["model"]) > float(r["nominal"]) for r in lines)
    out += ["", f"{len(lines)} machines: true error over the promised one, rms {_rms(ratio):.2f}, "
            f"median {np.median(ratio):.2f}; worse than without effects {worse}, than uncorrected "
            f"{nominal}."]
    return "\n".join(out)


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("machines"))
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--eta", type=float, default=2.0)
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scheduler", help="run on this dask cluster, tcp://HOST:8786")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "machines.csv"
    todo = remaining(path, jobs(given.count, given.seed, given.eta))
    work(path, Line, run, todo, None, given.cores, given.scheduler)
    print(table(read(path)))


if __name__ == "__main__":
    main()
