"""Do 95 % intervals hold the machine's truth, when it was measured on other days?

    python benchmarks/interval_study.py --machines 20

Machines with drawn geometry are measured in three sessions. Between them the drives are homed anew
(nothing says so in the files; the spread is drawn for each machine, 0.03 to 0.5 tolerances), the
instrument stands elsewhere, and the struts are warmer or colder by 3 K (one standard deviation;
11.7 ppm/K, not in the model). The truth is the machine at 20 degC, homed right. Printed per family:

    honest    share of true parameters inside the intervals that identify states, and its 95 %
              interval, machine by machine (parameters of one machine are not independent)
    noise     the same by noise alone, with residuals beyond the stated noise counted as noise
    ratio     length of the honest interval over that by noise alone, median and 90th percentile
    promise   rms error of a command on fresh poses over what `compensate` promises, and by noise
    differ    machines whose sessions were said to differ; disagree: parameters named

Then the same where all sessions are alike (nothing may be said to differ), and one session of each
machine, alone, with and without a curvature of the drives that the model does not know. Exit code
1 where the intervals of three sessions, over all families, hold less than 93 or more than 97 %.

``--noise`` prints another table instead: campaigns of 20 to 60 rows whose stated noise is 0.67, 1
and 1.5 times the true one, taken as stated and estimated. How many 95 % intervals of geometry in
parameters.csv hold the truth, and of sizes of a curvature in diagnosis.json where it is named.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from campaigns import CONFIGS, Array, dataset, fresh, fresh_errors

import ppmcal
from ppmcal.calibration.fit import (
    Z95,
    Fit,
    FitOptions,
    Problem,
    identify,
    noise_check,
    posterior,
    prediction_covariance,
    with_noise,
)
from ppmcal.calibration.knowledge import cluster_robust, estimates
from ppmcal.calibration.validation.residual_vectors import register_only
from ppmcal.calibration.validation.summary import rank_of
from ppmcal.io import read_mechanism, read_scenario
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Scenario
from ppmcal.simulation.simulate import simulate

FAMILIES = ("6-UPS", "3-RPR", "delta-linear", "6-RUS")
WANTED = (0.93, 0.97)
FRESH = 30
SESSIONS = 3
CURVED = {"p2": 0.05, "p3": 0.03, "p4": 0.0}
"""A curvature of the drives, mm, that is not named; so many times as large it is."""
NAMED = 8.0
QUIET, KNOWN = 0.05, 0.5
"""Noise over the scenario's, and what is known to this part of its tolerance: what rows decide
about geometry, tolerances do not."""
WARMER = 3.0
"""Standard deviation of a session's mean temperature, K."""


@dataclass(frozen=True)
class Setting:
    """What a campaign is like: number of sessions, what differs, what the model does not know.

    ``curved``: drives, times :data:`CURVED`; ``rows``: of a session, 0: those of the scenario;
    ``noise``: over the scenario's.
    """

    sessions: int
    differ: bool
    curved: float = 0.0
    rows: int = 0
    noise: float = 1.0


@dataclass(frozen=True, eq=False)
class Outcome:
    """One machine: parameters inside the intervals, lengths, squared errors over promises."""

    inside: Array
    by_noise: Array
    ratio: Array
    promise: float
    promise_noise: float
    differ: bool
    disagree: int
    seconds: float


def load(machine: str, setting: Setting) -> tuple[Mechanism, Scenario]:
    """Return a machine of configs/, and its scenario with what acts on it."""
    mechanism = read_mechanism(CONFIGS / f"{machine}.yaml")
    raw: dict[str, Any] = yaml.safe_load((CONFIGS / "scenarios" / f"{machine}.yaml").read_text())
    raw["effects"] = []
    if setting.differ:
        raw["effects"].append({"kind": "leg_thermal", "parameters": {"expansion": 1.17e-5}})
        raw["conditions"] = {"temperature": {"mean": 20, "swing": 0}}
    if setting.rows:
        next(iter(raw["poses"].values()))["count"] = setting.rows
    sigma = raw["instrument"]["sigma"]
    raw["instrument"]["sigma"] = {k: setting.noise * v for k, v in sigma.items()}
    if setting.curved:
        raw["effects"].append({"kind": "curvature", "parameters": {
            name: setting.curved * size for name, size in CURVED.items()}})
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "scenario.yaml"
        path.write_text(yaml.safe_dump(raw), encoding="utf-8")
        return mechanism, read_scenario(path, mechanism)


def campaign(machine: str, setting: Setting, seed: int
             ) -> tuple[Mechanism, tuple[Dataset, ...], Array, Scenario]:
    """Return a machine, its sessions, its true parameters (P,) and the last session's scenario."""
    mechanism, scenario = load(machine, setting)
    rng = np.random.default_rng([seed, FAMILIES.index(machine)])
    free = [mechanism.parameters[p] for p in mechanism.free]
    errors = {p.name: float(rng.normal() * (p.tolerance or 0.0)) for p in free}
    homing = float(np.exp(rng.uniform(np.log(0.03), np.log(0.5)))) if setting.differ else 0.0
    days = []
    for day in range(setting.sessions):
        own = {p.name: errors[p.name] + (p.tolerance_class == "offset") * homing * rng.normal()
               * (p.tolerance or 0.0) for p in free}
        today = replace(scenario, errors=own, error_scale=None)
        if not scenario.frame_known:
            moved = np.concatenate([0.1 * rng.normal(size=3), 0.05 * rng.normal(size=3)])
            if mechanism.motion.planar:
                moved[2:5] = 0.0
            today = replace(today, frame=scenario.frame + moved)
        if setting.differ:
            today = replace(today, temperature=(293.15 + WARMER * rng.normal(), 0.3))
        days.append(dataset(mechanism, today, simulate(mechanism, today, 100 * seed + day),
                            f"day{day + 1}"))
    true = mechanism.nominals.copy()
    true[list(mechanism.free)] += np.array([errors[p.name] for p in free])
    return mechanism, tuple(days), true, today


def run(machine: str, setting: Setting, seed: int) -> Outcome:
    """Measure one machine, identify it, and look at its intervals."""
    mechanism, days, true, today = campaign(machine, setting, seed)
    fit = identify(Problem(mechanism, days, mechanism.free))
    inflation = noise_check(fit).inflation
    fit = with_noise(fit, inflation, FitOptions())
    began = time.perf_counter()
    sessions, blocks = cluster_robust(fit, inflation)
    found = sessions or blocks
    seconds = time.perf_counter() - began
    free = list(mechanism.free)
    off = np.abs(fit.state.g - true)[free]
    alone = Z95 * np.sqrt(np.diagonal(posterior(fit)))[:len(free)]
    stated = [estimates(fit, rank_of(fit)[0], found)[p] for p in free]
    half = np.array([0.5 * (e.interval[1] - e.interval[0]) for e in stated])
    by_noise = prediction_covariance(fit)
    promise = [promised(fit, mechanism, today, true, seed, c) for c in (
        found.covariance if found and found.differ else by_noise, by_noise)]
    return Outcome(off <= half, off <= alone, half / alone, *promise,
                   found is not None and found.differ, sum(e.disagree for e in stated), seconds)


def promised(fit: Fit, mechanism: Mechanism, today: Scenario, true: Array, seed: int,
             covariance: Array) -> float:
    """Return squared error over promise on fresh poses, in the frame of the last day.

    That is where the true machine is seen from on that day: homing and warmth that look like
    another frame are in it, and no error of a command in it.
    """
    day = simulate(mechanism, replace(today, sigma_position=0.0, sigma_rotation=0.0),
                   100 * seed + len(fit.problem.datasets) - 1)
    rows = dataset(mechanism, today, day, fit.problem.datasets[-1].name)
    seen = register_only(Problem(mechanism.with_values(true), (rows,), ())).state.registrations[0]
    plan = replace(fresh(mechanism, today, true, FRESH), with_effects=mechanism, temperature=None,
                   frame=seen.frame_pose, target=seen.target)
    return squared(fit, dataset(mechanism, plan, simulate(mechanism, plan, seed + 10**6),
                                rows.name), covariance)


def squared(fit: Fit, unseen: Dataset, covariance: Array) -> float:
    """Return the mean squared position error on unseen rows over the covariance's promise."""
    problem = fit.problem
    last = len(problem.datasets) - 1
    columns = list(range(len(problem.free)))
    own = problem.opens[last]
    for part in (own.frame, own.target, own.target_rotation, own.homing):
        columns += list(range(part.start, part.stop))
    alone = replace(fit, problem=replace(problem, datasets=(problem.datasets[last],),
                                         pivots=(own.about,)),
                    noise_factor=fit.noise_factor[last:],
                    state=replace(fit.state, registrations=fit.state.registrations[last:],
                                  poses=fit.state.poses[last:]))
    error, promise, _ = fresh_errors(alone, unseen, covariance[np.ix_(columns, columns)])[0]
    return error / promise


def summary(machine: str, found: list[Outcome]) -> str:
    """Return one family's line."""
    each = np.array([o.inside.mean() for o in found])
    spread = Z95 * float(each.std(ddof=1)) / np.sqrt(len(each)) if len(each) > 1 else float("nan")
    inside, noise = (np.concatenate([getattr(o, n) for o in found]) for n in ("inside", "by_noise"))
    ratio = np.concatenate([o.ratio for o in found])
    promise, alone = (np.sqrt(np.mean([getattr(o, n) for o in found]))
                      for n in ("promise", "promise_noise"))
    return (f"{machine:14} {len(found):3} {inside.mean():7.3f} +- {spread:5.3f} "
            f"{noise.mean():7.3f} {np.median(ratio):6.2f} {np.quantile(ratio, 0.9):6.2f} "
            f"{promise:8.2f} {alone:6.2f} "
            f"{sum(o.differ for o in found):6} {sum(o.disagree for o in found):5} of {inside.size}"
            f"  {np.mean([o.seconds for o in found]):.1f} s")


def table(title: str, setting: Setting, machines: int, first: int,
          each: Callable[[str, Setting, int], Outcome] = run) -> float:
    """Print a table; return the coverage over all families."""
    print(f"\n{title}\n{'family':14} {'n':>3} {'honest':>7} {'':8} {'noise':>7} {'ratio':>6} "
          f"{'p90':>6} {'promise':>8} {'noise':>6} {'differ':>6} disagree", flush=True)
    everything: list[Outcome] = []
    for machine in FAMILIES:
        found = [each(machine, setting, first + n) for n in range(machines)]
        everything += found
        print(summary(machine, found), flush=True)
    print(summary("all", everything), flush=True)
    return float(np.concatenate([o.inside for o in everything]).mean())


ROWS = (20, 60)
STATED = (0.67, 1.0, 1.5)


@dataclass(frozen=True, eq=False)
class Held:
    """Whether intervals of one campaign hold the truth: of geometry (F,), of an effect's sizes."""

    geometry: Array
    effect: Array


def few_rows(machine: str, stated: float, sigma: str, seed: int, effect: bool) -> Held:
    """Identify a machine from few rows, as the command does, and look at what its files say.

    Args:
        machine: of ``configs/``.
        stated: noise that the file states, over the true one.
        sigma: ``stated`` or ``estimated``.
        seed: of machine, rows and noise.
        effect: diagnose a machine with curved drives as well.
    """
    rng = np.random.default_rng([seed, 5])
    count = int(rng.integers(ROWS[0], ROWS[1] + 1))

    def rows(curved: float) -> tuple[Mechanism, Dataset, Array]:
        mechanism, (day,), true, _ = campaign(machine, Setting(
            1, False, curved, count, 1.0 if curved else QUIET), seed)
        return mechanism, day.noisier(stated), true

    mechanism, day, true = rows(0.0)
    found = ppmcal.identify(mechanism, [day], sigma=sigma, holdout=0.0)
    value = {n: t / mechanism.units.factor(p.quantity) for n, p, t in
             zip(mechanism.names, mechanism.parameters, true.tolist(), strict=True)}
    inside = [p.low <= value[p.name] <= p.high for p in found.record.parameters
              if p.of_tolerance is not None and p.of_tolerance < KNOWN
              and p.low is not None and p.high is not None]
    sizes = list[bool]()
    if effect:
        mechanism, day, _ = rows(NAMED)
        sizes = [v.low <= NAMED * CURVED[name] <= v.high
                 for e in ppmcal.diagnose(mechanism, [day]).record.effects
                 if e.kind == "curvature" and len(e.on) == len(mechanism.actuators)
                 for name, v in e.parameters.items()
                 if v.low is not None and v.high is not None]
    return Held(np.array(inside, dtype=bool), np.array(sizes, dtype=bool))


def noise_table(machines: int, first: int) -> None:
    """Print how many intervals hold where the noise is stated wrong, and estimated."""
    print(f"{'family':14} {'stated':>7} {'sigma':>10} {'n':>3} {'geometry':>9} {'':8} effect")
    for machine in ("3-RPR", "6-UPS"):
        for sigma in ("stated", "estimated"):
            for stated in STATED:
                found = [few_rows(machine, stated, sigma, first + n,
                                  machine == "3-RPR" and sigma == "stated")
                         for n in range(machines)]
                each = np.array([h.geometry.mean() for h in found])
                spread = Z95 * float(each.std(ddof=1)) / np.sqrt(len(each))
                sizes = np.concatenate([h.effect for h in found])
                print(f"{machine:14} {stated:7.2f} {sigma:>10} {machines:3} {each.mean():9.3f} "
                      f"+- {spread:5.3f} " + (f"{sizes.sum()} of {sizes.size}" * bool(sizes.size)),
                      flush=True)


def main() -> int:
    """Print the tables; exit 1 where three sessions' intervals are not as they must be."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=20, help="of each family")
    parser.add_argument("--seed", type=int, default=1, help="first seed")
    parser.add_argument("--quick", action="store_true", help="three sessions that differ only")
    parser.add_argument("--noise", action="store_true", help="few rows, noise stated wrong")
    options = parser.parse_args()
    if options.noise:
        noise_table(options.machines, options.seed)
        return 0
    share = table(f"{SESSIONS} sessions: homing, registration, temperature differ",
                  Setting(SESSIONS, True), options.machines, options.seed)
    if not options.quick:
        table(f"{SESSIONS} sessions alike: nothing differs but the registration",
              Setting(SESSIONS, False), options.machines, options.seed)
        table("one session, the model is right", Setting(1, False), options.machines, options.seed)
        table("one session, drives curved by 0.05 (P2) and 0.03 (P3)", Setting(1, False, 1.0),
              options.machines, options.seed)
    return 0 if WANTED[0] <= share <= WANTED[1] else 1


if __name__ == "__main__":
    sys.exit(main())
