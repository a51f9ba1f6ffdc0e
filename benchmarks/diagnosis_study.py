"""How well does ``ppmcal diagnose`` do? A study on campaigns with hidden effects.

    python benchmarks/diagnosis_study.py --out study --count 200       # the full study
    python benchmarks/diagnosis_study.py --out study --minutes 10      # as much as fits
    python benchmarks/diagnosis_study.py --out study --summary         # the table again

Every campaign is one line of ``study.csv``; a study that was stopped goes on where it was.
The campaigns come from :mod:`hidden`, which shares no code with the package's effects.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from hidden import Hidden, Impossible, Options, applicable, hide  # noqa: E402
from hidden_unknown import UNKNOWN  # noqa: E402
from study_runner import read, work  # noqa: E402

from ppmcal.calibration.fit import (  # noqa: E402
    Problem,
    identify,
)
from ppmcal.calibration.validation import split  # noqa: E402
from ppmcal.diagnosis.diagnose import DiagnosisOptions as RunOptions  # noqa: E402
from ppmcal.diagnosis.diagnose import diagnose  # noqa: E402
from ppmcal.diagnosis.held_out_gap import measure_gap  # noqa: E402
from ppmcal.diagnosis.result import Diagnosis, LeftOutBlocks  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402
from ppmcal.model.effects import effect_kinds  # noqa: E402
from ppmcal.model.mechanism import Given, with_effect  # noqa: E402

MACHINES = ("3-RPR", "3-RRR-1", "3-PRR-1", "delta-rotary", "delta-linear", "6-UPS", "linapod",
            "6-RUS")
NOISES = {"plain": {}, "ar 0.6": {"ar": 0.6}, "t4": {"tails": "t4"},
          "5 % outliers": {"outliers": 0.05}, "10 % outliers": {"outliers": 0.1},
          "actuator": {"actuator": (3e-6, 1e-5)}, "row sigmas": {"row_sigmas": True}}
POSES = 90
SMALLEST, LARGEST = 0.05, 3.0
MOST_DRAWS = 3
"""A cell is given up after so many draws for each campaign that is wanted."""


@dataclass(frozen=True)
class Job:
    """One campaign to run."""

    cell: str
    machine: str
    seed: int
    noise: str
    kinds: str
    where: str
    eta: float

    @property
    def key(self) -> str:
        """Return what identifies the campaign in a stopped study."""
        return f"{self.cell}|{self.machine}|{self.seed}"


@dataclass(frozen=True)
class Outcome:
    """What became of one campaign; one line of study.csv.

    ``nothing``: probability that geometry is all there is; ``known``: that what is left has no
    unknown cause; ``worse``: whether geometry alone surely predicts poses left out better;
    ``said``: as :func:`reliability`.
    """

    cell: str
    machine: str
    seed: int
    noise: str
    kinds: str
    where: str
    eta: float
    survival: float
    freedom: int
    verdict: str
    named: str
    alternatives: str
    right: int
    alone: int
    wrong: int
    set_size: float
    covered: str
    closed: str
    closed_truth: str
    nothing: float
    known: float
    worse: int
    said: str
    seconds: float


def jobs(draws: Mapping[str, int], seed: int) -> Iterator[Job]:
    """Yield campaigns, so many draws of each cell, in turns: a short study sees every cell."""
    for n in range(max(draws.values(), default=0)):
        yield from (j for j in draw(n, seed) if n < draws.get(j.cell, 0))


def draw(n: int, seed: int) -> Iterator[Job]:
    """Yield the n-th campaign of every cell."""
    def job(cell: str, noise: str, kinds: str, machine: str, where: str, eta: float) -> Job:
        own = zlib.crc32(f"{seed}|{cell}|{n}".encode()) % 2**31
        return Job(cell, machine, own, noise, kinds, where, eta)

    rng = np.random.default_rng([seed, n])
    for c, noise in enumerate(NOISES):
        yield job(f"none, {noise}", noise, "", MACHINES[(n + c) % len(MACHINES)], "", 0.0)
    names = sorted({k for m in MACHINES for k in applicable(m)} - set(UNKNOWN))
    for kind in names:
        able = [m for m in MACHINES if kind in applicable(m)]
        eta = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
        where = ("all", "one", "some")[n % 3]
        yield job(f"one, {kind}", "plain", kind, able[int(rng.integers(len(able)))], where, eta)
    for size, cell in ((2, "two"), (3, "three")):
        machine = MACHINES[int(rng.integers(len(MACHINES)))]
        pool = [k for k in applicable(machine) if k not in UNKNOWN and k != "geometry"]
        chosen = rng.permutation(pool)[:size]
        yield job(cell, "plain", "+".join(chosen), machine, "", float(rng.uniform(0.5, 2.0)))
    for kind in UNKNOWN:
        able = [m for m in MACHINES if kind in applicable(m)]
        yield job(f"unknown, {kind}", "plain", kind, able[int(rng.integers(len(able)))], "", 1.0)


def run(job: Job) -> Outcome | None:
    """Return what a diagnosis makes of one campaign; None where there can be no such campaign."""
    options = Options(poses=POSES, **NOISES[job.noise])  # type: ignore[arg-type]
    kinds = [k for k in job.kinds.split("+") if k]
    start = time.perf_counter()
    try:
        found = hide(job.machine, job.seed, kinds, job.eta or 1.0, options, job.where or None)
    except Impossible:
        return None
    try:
        problem = Problem(found.mechanism, (found.dataset,), found.mechanism.free)
        result = diagnose(problem, RunOptions(seed=job.seed % 1000))
    except PpmcalError as error:
        print(f"{job.key}: {error}", file=sys.stderr)
        return Outcome(**asdict(job), survival=min((t.survival for t in found.truth), default=1.0),
                       freedom=0, verdict="refused", named="", alternatives="", right=0, alone=0,
                       wrong=0, set_size=0.0, covered="0/0", closed="", closed_truth="",
                       nothing=float("nan"), known=float("nan"), worse=0, said="",
                       seconds=round(time.perf_counter() - start, 2))
    return judge(job, found, result, time.perf_counter() - start)


def judge(job: Job, found: Hidden, result: Diagnosis, seconds: float) -> Outcome:
    """Compare a diagnosis with the truth."""
    truth = {family(t.kind, t.parameters) for t in found.truth}
    families = [{family(e.kind, e.parameters)} | {label(a) for a in e.alternatives}
                for e in result.effects]
    named = {family(e.kind, e.parameters) for e in result.effects}
    hit = {t for t in truth if any(t in f for f in families)}
    wrong = sum(1 for f in {frozenset(f) for f in families} if not f & truth)
    closed = result.gap.closed if result.gap else None
    return Outcome(
        **asdict(job), survival=min((t.survival for t in found.truth), default=1.0),
        freedom=result.found.first.freedom, verdict=result.verdict,
        named="+".join(sorted(named)),
        alternatives="+".join(sorted({a for e in result.effects for a in e.alternatives})),
        right=int(bool(truth) and hit == truth), alone=int(truth == named), wrong=wrong,
        set_size=float(np.mean([len(f) for f in families])) if families else 0.0,
        covered=coverage(found, result), closed="" if closed is None else f"{closed:.4f}",
        closed_truth=told(found, result, job.seed % 1000),
        nothing=result.nothing, known=result.remainder.known,
        worse=surely_worse(result.predictive),
        said=reliability(((family(e.kind, e.parameters), e.probability, zip(
            map(label, e.alternatives), e.probabilities, strict=True))
            for e in result.effects), truth),
        seconds=round(seconds, 2))


def surely_worse(predictive: Sequence[LeftOutBlocks]) -> int:
    """Return whether geometry alone surely predicts poses left out better than all that may be."""
    return int(any(b.surely_worse for b in predictive if b.by == "pose"))


def reliability(effects: Iterable[tuple[str, float | None, Iterable[tuple[str, float]]]],
                truth: Collection[str]) -> str:
    """Return the probability of each kind that leads, and whether it is right: ``0.9731:1``.

    Of each name its kind, its probability and those of the kinds that may be in its place: the
    same kind on other joints is the same kind. Names that have none are left out; one effect on
    several joints is one.
    """
    told = dict.fromkeys((kind, f"{p + sum(q for other, q in others if other == kind):.4f}")
                         for kind, p, others in effects if p is not None)
    return " ".join(f"{p}:{int(kind in truth)}" for kind, p in told)


def family(kind: str, parameters: Iterable[str]) -> str:
    """Return the kind; of frozen geometry the slot."""
    return f"{kind} {next(iter(parameters))}" if kind == "geometry" else kind


def label(alternative: str) -> str:
    """Return the family of an alternative's label."""
    return alternative if alternative.startswith("geometry ") else alternative.split(" ")[0]


def coverage(found: Hidden, result: Diagnosis) -> str:
    """Return ``hits/intervals`` of the named effects' 95 % intervals that hold the truth."""
    values = {e.name: e for e in result.identification.estimates}
    hits = total = 0
    for effect, truth in itertools.product(result.effects, found.truth):
        same = effect.kind == truth.kind and set(effect.on) == set(truth.on)
        if not same or effect.kind == "geometry":
            continue
        for name in effect.parameters:
            short = name.rsplit(".", 1)[1]
            e = values[name]
            if short in truth.parameters and e.sigma and e.interval and np.isfinite(e.sigma):
                total += 1
                hits += e.interval[0] <= truth.parameters[short] <= e.interval[1]
    return f"{hits}/{total}"


def told(found: Hidden, result: Diagnosis, seed: int) -> str:
    """Return the gap that a fit closes which is told what is hidden; empty where unknown."""
    if not found.truth or any(t.kind not in effect_kinds() for t in found.truth):
        return ""
    mechanism = found.mechanism
    for t in found.truth:
        kind = effect_kinds()[t.kind]
        on = tuple(not t.on or a in t.on for a in mechanism.actuators)
        linear = {s.name for s in kind.parameters(mechanism.motion) if not s.constant}
        given = {n: Given(float(v), free=n in linear) for n, v in t.parameters.items()
                 if n in {s.name for s in kind.parameters(mechanism.motion)}}
        mechanism = with_effect(mechanism, kind, on, given)
    before = result.found.before
    out = split((found.dataset,), RunOptions().holdout, seed)
    training = found.dataset.take(~out[0])
    try:
        fit = identify(replace(before.problem, mechanism=mechanism, free=mechanism.free,
                               datasets=(training,)))
    except PpmcalError:
        return ""
    gap = measure_gap(before, fit, (found.dataset.take(out[0]),), 1.0, 0)
    return "" if gap is None or gap.closed is None else f"{gap.closed:.4f}"


def more(path: Path, draws: dict[str, int], count: int) -> dict[str, int]:
    """Return how many draws each cell needs for ``count`` campaigns, from how many it has.

    Not every draw makes a campaign: an effect may not act on the machine, or geometry may
    swallow it whole.
    """
    have = Counter(r["cell"] for r in read(path))
    return {cell: min(n + max(0, -(-(count - have[cell]) * n // max(have[cell], 1))),
                      MOST_DRAWS * count) for cell, n in draws.items()}


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("study"))
    parser.add_argument("--count", type=int, default=200, help="campaigns per cell")
    parser.add_argument("--minutes", type=float, default=0.0, help="stop after this time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cell", default="", help="only cells whose name begins so")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scheduler", help="run on this dask cluster, tcp://HOST:8786")
    parser.add_argument("--summary", action="store_true", help="only print the table")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "study.csv"
    if not given.summary:
        end = time.monotonic() + 60.0 * given.minutes if given.minutes else None
        done = {f"{r['cell']}|{r['machine']}|{r['seed']}" for r in read(path)}
        draws = {j.cell: given.count for j in draw(0, given.seed) if j.cell.startswith(given.cell)}
        while todo := [j for j in jobs(draws, given.seed) if j.key not in done]:
            if not work(path, Outcome, run, todo, end, given.cores, given.scheduler):
                break
            done |= {j.key for j in todo}
            draws = more(path, draws, given.count)
    from study_summary import table

    text = table(read(path))
    (given.out / "summary.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
