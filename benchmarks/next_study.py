"""Do the measurements that ``ppmcal diagnose`` proposes settle what it cannot tell apart?

    python benchmarks/next_study.py --count 60 --seed 1

Campaigns with one hidden effect that end in a named set are measured on: at the proposed rows,
and at random ones, as many, twice and four times as many: random poses, under settings as in
the campaign. The hidden machine is measured by :mod:`hidden`, which shares no code with the
package's effects. A set
is settled where sets with the true cause are likelier than those with its rival by 20 to 1.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from diagnosis_study import MACHINES, POSES  # noqa: E402
from hidden import KINDS, Hidden, Impossible, Options, applicable, hide  # noqa: E402
from hidden_scene import Array, measure, solved  # noqa: E402
from hidden_session import REFERENCE, recorded, with_noise  # noqa: E402
from study_summary import interval  # noqa: E402

from ppmcal.calibration.fit import FitOptions, Problem, identify  # noqa: E402
from ppmcal.diagnosis.diagnose import DiagnosisOptions as RunOptions  # noqa: E402
from ppmcal.diagnosis.diagnose import diagnose  # noqa: E402
from ppmcal.diagnosis.explanation import explained  # noqa: E402
from ppmcal.diagnosis.hypotheses import Hypothesis  # noqa: E402
from ppmcal.diagnosis.next_experiment import possible_rows  # noqa: E402
from ppmcal.diagnosis.result import Diagnosis  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402
from ppmcal.model.dataset import Dataset  # noqa: E402

OFTEN = ("tilt", "gain", "curvature", "leg_thermal", "base_thermal", "platform_thermal",
         "compliance", "eccentricity", "drift", "clearance", "windup")
"""Kinds that end in named sets often enough to be worth a try."""
SETTLED = 20.0


@dataclass(frozen=True)
class Case:
    """One named set: rows proposed, and whether they, or random ones, settled it rightly."""

    machine: str
    kind: str
    rival: str
    rows: int
    proposed: bool
    random: bool
    twice: bool
    four: bool


def one(job: tuple[str, str, int, float]) -> Case | None:
    """Return what became of one campaign; None if it did not end in a set with a proposal."""
    machine, kind, seed, eta = job
    options = Options(poses=POSES)
    try:
        found = hide(machine, seed, [kind], eta, options)
        problem = Problem(found.mechanism, (found.dataset,), found.mechanism.free)
        result = diagnose(problem, RunOptions(seed=seed % 1000))
        pair = _pair(result, kind)
        if pair is None:
            return None
        rows = result.proposal.rows
        stage = result.found.last
        pool = possible_rows(stage, np.random.default_rng(seed % 1000))
        rng = np.random.default_rng(seed + 1)
        assert pool is not None
        good = [_settles(found, problem, data, pair, options, seed) for data in (
            _proposed(pool, result), *(_random(pool, found.dataset, n * rows, rng)
                                       for n in (1, 2, 4)))]
    except (Impossible, PpmcalError, ValueError):
        return None
    return Case(machine, kind, pair[1].label, rows, *good)


def _pair(result: Diagnosis, kind: str) -> tuple[Hypothesis, Hypothesis] | None:
    """Return the true form and its rival, where the true kind is one of the first set."""
    if result.verdict != "named-set" or not result.proposal.rows:
        return None
    first, every = result.effects[0], result.found.last.hypotheses
    alike = [h for h in every if first.alternatives and h.label == first.alternatives[0]]
    if not alike:
        return None
    pair = [first.hypothesis, alike[0]]
    pair.sort(key=lambda f: f.kind != kind)
    return (pair[0], pair[1]) if pair[0].kind == kind else None


def _proposed(pool: Dataset, result: Diagnosis) -> Dataset:
    """Return the proposed rows as a data set."""
    p = result.proposal
    blank = pool.take(np.zeros(p.rows, dtype=np.int64))
    return replace(blank, q=p.q, columns=dict(p.columns))


def _random(pool: Dataset, campaign: Dataset, rows: int, rng: np.random.Generator) -> Dataset:
    """Return random poses of the pool under the settings of random rows of the campaign."""
    data = pool.take(rng.integers(len(pool), size=rows))
    like = rng.integers(len(campaign), size=rows)
    return replace(data, columns={n: c[like] for n, c in campaign.columns.items()})


def _settles(found: Hidden, problem: Problem, rows: Dataset, pair: tuple[Hypothesis, Hypothesis],
             options: Options, seed: int) -> bool:
    """Whether old and new rows together favour the true form clearly."""
    whole = joined(found.dataset, measured(found, rows, options, seed + 77))
    fit = identify(replace(problem, datasets=(whole,), pivots=None, given=None))
    last = explained(fit, FitOptions(), tuple({f.kind for f in pair}))[-1]
    labels = [h.label if isinstance(h, Hypothesis) else "" for h in last.asked.sources]

    def chance(wanted: Hypothesis, other: Hypothesis) -> float:
        """Return the probability of the sets that have one of them alone."""
        return sum(float(np.exp(p)) for some, p in last.answer.log_p.items()
                   if wanted.label in (own := {labels[i] for i in some}) and other.label not in own)

    return chance(*pair) > SETTLED * chance(*pair[::-1])


def measured(found: Hidden, rows: Dataset, options: Options, seed: int) -> Dataset:
    """Return what the instrument would show of the hidden machine at further rows."""
    old, n = found.scene, len(rows)
    blank = np.zeros(n)

    def stacked(name: str) -> Array:
        columns = [rows.columns.get(f"{name}_{a}", blank) for a in old.mechanism.actuators]
        return np.stack(columns, axis=-1)

    start = np.argmin(np.sum((rows.q[:, None] - old.q[None]) ** 2, axis=2), axis=1)
    scene = replace(
        old, q=rows.q, pose=solved(old.model, rows.q, old.pose[start], old.q[start]),
        approach=stacked("dir"), velocity=stacked("vel"),
        temperature=rows.columns.get("temperature", blank + REFERENCE) - REFERENCE,
        payload=rows.columns.get("payload", blank), time=rows.columns.get("time", blank),
        groups=np.arange(n, dtype=np.int64))
    seen = measure(scene, [KINDS[c.kind].change(scene, c) for c in found.causes])
    return with_noise(recorded(scene, seen, options, seed), scene.mechanism.motion, options,
                      seed)[0]


def joined(a: Dataset, b: Dataset) -> Dataset:
    """Return the rows of two data sets of one session as one."""
    def both(name: str) -> Array:
        return np.concatenate([getattr(a, name), getattr(b, name)])

    columns = {n: np.concatenate([v, b.columns[n]]) for n, v in a.columns.items()}
    return replace(
        a, rows=np.arange(1, len(a) + len(b) + 1), q=both("q"), position=both("position"),
        rotation=both("rotation"), value=both("value"), sigma_position=both("sigma_position"),
        sigma_rotation=both("sigma_rotation"), sigma_value=both("sigma_value"), commanded=None,
        groups=np.concatenate([a.groups, a.groups.max() + 1 + b.groups]), columns=columns)


def table(cases: Sequence[Case]) -> str:
    """Return the result in Markdown."""
    out = ["| measured on at | sets | settled rightly (95 %) |", "|---|---|---|"]
    for name, key in (("the proposed rows", "proposed"), ("as many random rows", "random"),
                      ("twice as many random rows", "twice"),
                      ("four times as many random rows", "four")):
        hits = sum(getattr(c, key) for c in cases)
        low, high = interval(hits, len(cases))
        out.append(f"| {name} | {len(cases)} | {hits / max(len(cases), 1):.0%} "
                   f"({low:.0%}-{high:.0%}) |")
    rows = sorted(c.rows for c in cases)
    out.append(f"\nRows proposed: median {rows[len(rows) // 2] if rows else 0}.")
    return "\n".join(out)


def main() -> None:
    """Run campaigns until enough named sets were found, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60, help="named sets wanted")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=0.0, help="stop after this time")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    jobs = []
    for n in range(20 * given.count):
        kind = OFTEN[n % len(OFTEN)]
        able = [m for m in MACHINES if kind in applicable(m)]
        jobs.append((able[int(rng.integers(len(able)))], kind, 10_000 * given.seed + n,
                     float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))))
    cases: list[Case] = []
    end = time.monotonic() + 60.0 * given.minutes if given.minutes else float("inf")
    with multiprocessing.Pool(given.cores) as pool:
        for case in pool.imap_unordered(one, jobs):
            if case is not None:
                cases.append(case)
                print(case, file=sys.stderr, flush=True)
            if len(cases) == given.count or time.monotonic() > end:
                pool.terminate()
                break
    print(table(cases))


if __name__ == "__main__":
    main()
