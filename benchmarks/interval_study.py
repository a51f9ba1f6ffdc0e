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

from ppmcal.calibration.coverage import Z95
from ppmcal.calibration.estimates import estimates
from ppmcal.calibration.fit import Fit, FitOptions, posterior, prediction_covariance
from ppmcal.calibration.identify import identify
from ppmcal.calibration.intervals import honest
from ppmcal.calibration.noise import noise_check, with_noise
from ppmcal.calibration.problem import Problem
from ppmcal.calibration.summary import rank_of
from ppmcal.calibration.validation import register_only
from ppmcal.io import read_mechanism, read_scenario
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Scenario
from ppmcal.simulation.simulate import simulate

FAMILIES = ("6-UPS", "3-RPR", "delta-linear", "6-RUS")
WANTED = (0.93, 0.97)
FRESH = 30
SESSIONS = 3
WARMER = 3.0
"""Standard deviation of a session's mean temperature, K."""


@dataclass(frozen=True)
class Setting:
    """What a campaign is like: number of sessions, what differs, what the model does not know."""

    sessions: int
    differ: bool
    curved: bool = False


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
    if setting.curved:
        raw["effects"].append({"kind": "curvature", "parameters": {"p2": 0.05, "p3": 0.03}})
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
            if mechanism.motion == "planar":
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
    sessions, blocks = honest(fit, inflation)
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


def main() -> int:
    """Print the tables; exit 1 where three sessions' intervals are not as they must be."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=20, help="of each family")
    parser.add_argument("--seed", type=int, default=1, help="first seed")
    parser.add_argument("--quick", action="store_true", help="three sessions that differ only")
    options = parser.parse_args()
    share = table(f"{SESSIONS} sessions: homing, registration, temperature differ",
                  Setting(SESSIONS, True), options.machines, options.seed)
    if not options.quick:
        table(f"{SESSIONS} sessions alike: nothing differs but the registration",
              Setting(SESSIONS, False), options.machines, options.seed)
        table("one session, the model is right", Setting(1, False), options.machines, options.seed)
        table("one session, drives curved by 0.05 (P2) and 0.03 (P3)", Setting(1, False, True),
              options.machines, options.seed)
    return 0 if WANTED[0] <= share <= WANTED[1] else 1


if __name__ == "__main__":
    sys.exit(main())
