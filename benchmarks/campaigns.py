"""Does the fit know how well it knows? Many simulated campaigns, each with a machine of its own.

    python benchmarks/campaigns.py --campaigns 200 --machine 3-RPR --machine 6-UPS

A campaign draws the machine's true errors from the tolerances and the instrument's noise from
the scenario, fits, and looks at poses that the fit had not seen. Printed per machine:

    position    rms error of predicted positions on fresh poses over what the covariance promised
    rotation    the same for rotations
    coverage    share of the true parameters inside their 95 % intervals
    p < ...     noise check: share of campaigns with so small a p-value (nothing is wrong here)
    dropped     share of campaigns in which a good row was taken for an outlier

Exit code 1 where a ratio is outside 0.9 to 1.1 or the coverage outside 93 to 97 %.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import multiprocessing
import os
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
from ppmcal.calibration.knowledge import by_noise, estimates
from ppmcal.calibration.validation import fresh_state
from ppmcal.calibration.validation.summary import rank_of
from ppmcal.io import read_mechanism, read_scenario
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Circle, Random, Scenario
from ppmcal.simulation.simulate import Campaign, simulate

Array = NDArray[np.float64]

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
FRESH = 40
RATIO = (0.9, 1.1)
COVERAGE = (0.93, 0.97)


@dataclass(frozen=True)
class Outcome:
    """One campaign.

    Mean squared errors of fresh poses (m2, rad2) beside what the covariance promises, parameters
    inside their intervals; ``..._spread``: variance of that figure if the covariance is right.
    """

    machine: str
    seed: int
    converged: bool
    position_error: float
    position_promised: float
    position_spread: float
    rotation_error: float
    rotation_promised: float
    rotation_spread: float
    parameters: int
    inside: int
    inside_spread: float
    noise_p: float
    rows: int
    dropped: int
    seconds: float


@dataclass(frozen=True)
class Summary:
    """All campaigns of one machine; ``position`` and ``rotation`` are error over promise."""

    machine: str
    campaigns: int
    converged: int
    position: float
    rotation: float
    coverage: float
    below_5_percent: float
    below_1_permille: float
    dropped: float
    seconds: float

    @property
    def sound(self) -> bool:
        """Whether the figures are as they must be."""
        ratios = [r for r in (self.position, self.rotation) if np.isfinite(r)]
        return (all(RATIO[0] <= r <= RATIO[1] for r in ratios)
                and COVERAGE[0] <= self.coverage <= COVERAGE[1]
                and self.converged == self.campaigns)


@cache
def load(machine: str) -> tuple[Mechanism, Scenario]:
    """Read a machine of ``configs/`` and its scenario."""
    mechanism = read_mechanism(CONFIGS / f"{machine}.yaml")
    return mechanism, read_scenario(CONFIGS / "scenarios" / f"{machine}.yaml", mechanism)


def dataset(mechanism: Mechanism, scenario: Scenario, campaign: Campaign, name: str) -> Dataset:
    """Return a campaign as the data set that its files would read as."""
    n = campaign.q.shape[0]
    planar = mechanism.motion.planar
    pose = scenario.kind.sees_rotation and mechanism.motion.turns
    seen = np.array([True, True, not planar, pose and not planar, pose and not planar, pose])
    both = np.where(seen, np.concatenate([campaign.position, campaign.rotation], axis=1), np.nan)
    return Dataset(
        name=name, source=name, kind=scenario.kind, rows=np.arange(1, n + 1), q=campaign.q,
        commanded=None, position=both[:, :3], rotation=both[:, 3:], value=np.full(n, np.nan),
        to_q=None, sigma_position=np.full((n, 3), scenario.sigma_position or 1e-9),
        sigma_rotation=np.full((n, 3), scenario.sigma_rotation or 1e-9), sigma_value=np.ones(n),
        sigma_actuator=scenario.sigma_actuator, groups=campaign.pose, columns={}, sessions=None,
        frame=Unknown(not scenario.frame_known, np.zeros(6)),
        target=Unknown(not scenario.target_known, np.zeros(3)),
        target_rotation=Unknown(not scenario.target_rotation_known, np.zeros(3)))


def fresh(mechanism: Mechanism, scenario: Scenario, g: Array, count: int) -> Scenario:
    """Return a noise-free scenario of the machine with parameters ``g``: poses within the box."""
    shape = scenario.poses
    if isinstance(shape, Circle):
        half = shape.swing.copy()
        half[:2] += shape.radius / np.sqrt(2.0)
        shape = Random(shape.center, half, count)
    assert isinstance(shape, Random)
    errors = dict(zip(mechanism.names, (g - mechanism.nominals).tolist(), strict=True))
    return replace(scenario, poses=replace(shape, count=count), errors=errors, error_scale=None,
                   sigma_position=0.0, sigma_rotation=0.0, outliers=0.0, repeats=1,
                   approach="one", sigma_actuator=np.zeros_like(scenario.sigma_actuator))


def fresh_errors(fit: Fit, unseen: Dataset, covariance: Array) -> list[tuple[float, float, float]]:
    """Return mean square, promise and spread of position and of rotation on unseen rows."""
    pivots = tuple(o.about for o in fit.problem.opens)
    one = replace(unseen, sigma_position=np.ones_like(unseen.sigma_position),
                  sigma_rotation=np.ones_like(unseen.sigma_rotation))
    problem = replace(fit.problem, datasets=(one,), pivots=pivots)
    rows = list(problem.rows(fresh_state(problem, fit.state)))
    jacobian = np.concatenate([r.jacobian for r in rows])
    raw = np.concatenate([r.raw for r in rows])
    places = sum(1 for c in fit.problem.mechanism.dof if c < 3)
    out = []
    for part in (slice(places), slice(places, None)):
        flat = jacobian[:, part].reshape(-1, jacobian.shape[2]) / np.sqrt(len(raw))
        spread = flat.T @ flat @ covariance
        out.append((float(np.sum(raw[:, part] ** 2) / len(raw)), float(np.trace(spread)),
                    2.0 * float(np.trace(spread @ spread))))
    return out


def inside_spread(covariance: Array, rng: np.random.Generator) -> float:
    """Return the variance of the number of parameters inside their intervals, by drawing."""
    sigma = np.sqrt(np.diagonal(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    drawn = rng.normal(size=(2000, sigma.size)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    return float(np.var(np.sum(np.abs(drawn) < Z95, axis=1)))


def run(task: tuple[str, int]) -> Outcome:
    """Simulate, fit and judge one campaign."""
    machine, seed = task
    mechanism, scenario = load(machine)
    campaign = simulate(mechanism, scenario, seed)
    began = time.perf_counter()
    fit = identify(Problem(mechanism, (dataset(mechanism, scenario, campaign, "a"),),
                           mechanism.free))
    seconds = time.perf_counter() - began
    noise = noise_check(fit)
    fit = with_noise(fit, noise.inflation, FitOptions())
    found = estimates(fit, rank_of(fit)[0], by_noise=by_noise(fit, FitOptions()))
    within = [found[p].interval for p in mechanism.free]
    inside = [low <= campaign.g[p] <= high for p, (low, high) in
              zip(mechanism.free, within, strict=True)]
    plan = fresh(mechanism, scenario, campaign.g, FRESH)
    unseen = dataset(mechanism, plan, simulate(mechanism, plan, seed + 1_000_000), "a")
    covariance = prediction_covariance(fit)
    position, rotation = fresh_errors(fit, unseen, covariance)
    count = len(mechanism.free)
    return Outcome(
        machine, seed, fit.converged, *position, *rotation, count, sum(inside),
        inside_spread(posterior(fit)[:count, :count], np.random.default_rng(seed)),
        noise.chi2_p, len(campaign.q), sum(len(r) for r in fit.reasons), seconds)


def outcomes(machines: Sequence[str], campaigns: int, seed: int, processes: int
             ) -> Iterable[Outcome]:
    """Yield the outcomes of all campaigns, machine by machine."""
    tasks = [(m, seed + n) for m in machines for n in range(campaigns)]
    if processes == 1:
        yield from map(run, tasks)
        return
    # threads slow small matrices down; spawned processes read this before they load NumPy
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap(run, tasks, chunksize=4)


def summarise(mine: Sequence[Outcome]) -> Summary:
    """Return the figures of one machine's campaigns."""

    def total(name: str) -> float:
        return float(sum(getattr(o, name) for o in mine))

    def ratio(kind: str) -> float:
        promised = total(f"{kind}_promised")
        return float(np.sqrt(total(f"{kind}_error") / promised)) if promised else float("nan")

    count = len(mine)
    return Summary(
        mine[0].machine, count, sum(o.converged for o in mine), ratio("position"),
        ratio("rotation"),
        total("inside") / total("parameters"), sum(o.noise_p < 0.05 for o in mine) / count,
        sum(o.noise_p < 0.001 for o in mine) / count, sum(o.dropped > 0 for o in mine) / count,
        total("seconds") / count)


def main() -> int:
    """Run the study; exit 1 where a figure is not as it must be."""
    machines = sorted(p.stem for p in CONFIGS.glob("*.yaml"))
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaigns", type=int, default=200, help="campaigns per machine")
    parser.add_argument("--machine", action="append", choices=machines, metavar="NAME",
                        help="a machine of configs/, may be repeated; default: all")
    parser.add_argument("--seed", type=int, default=1, help="first seed")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, help="CSV with one row per campaign")
    options = parser.parse_args()
    chosen = options.machine or machines
    print(f"{'machine':20} {'n':>4} {'position':>8} {'rotation':>8} {'coverage':>8} {'p<.05':>6} "
          f"{'p<.001':>6} {'dropped':>7} {'s/fit':>6}")
    everything: list[Outcome] = []
    sound = True
    results = outcomes(chosen, options.campaigns, options.seed, options.processes)
    for machine, group in itertools.groupby(results, lambda o: o.machine):
        mine = list(group)
        everything += mine
        s = summarise(mine)
        sound &= s.sound
        lost = s.campaigns - s.converged
        print(f"{machine:20} {s.campaigns:4} {s.position:8.3f} {s.rotation:8.3f} {s.coverage:8.4f} "
              f"{s.below_5_percent:6.3f} {s.below_1_permille:6.3f} {s.dropped:7.3f} "
              f"{s.seconds:6.3f}" + (f"  {lost} not converged" if lost else "")
              + ("" if s.sound else "  OUTSIDE"), flush=True)
    if options.out:
        with options.out.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow([f.name for f in fields(Outcome)])
            writer.writerows(asdict(o).values() for o in everything)
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
