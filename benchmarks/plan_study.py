"""Do planned poses do what twice as many random ones do? Many simulated campaigns.

    python benchmarks/plan_study.py --campaigns 100

For each machine ``ppmcal plan`` chooses 15 poses for its default instrument. A campaign draws the
machine's true errors from the tolerances, measures it at the planned poses and at 15, 30 and 45
random ones (drawn evenly from the region that the candidates come from), identifies it from each
with the library's own fit, and asks each model where the machine is at 40 fresh poses, drawn evenly
too. Nothing is linear here but what the fit itself does.

    O1        geometric mean of tolerance over standard deviation, from the covariance of the
              parameters that the fit gives (its determinant, to the power -1/2p)
    position  rms error of the identified machine at the fresh poses, in the instrument's frame
    rotation  the same of its rotation

Printed as a Markdown table: medians of O1, rms over all campaigns of the errors with their 95 %
interval (bootstrap over campaigns).
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from campaigns import dataset  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from ppmcal.calibration.fit import (  # noqa: E402
    Fit,
    Problem,
    identify,
    posterior,
)
from ppmcal.calibration.validation import fresh_state  # noqa: E402
from ppmcal.design.plan.candidate_poses import evenly, region_of  # noqa: E402
from ppmcal.design.plan.plan import PlanOptions, plan  # noqa: E402
from ppmcal.design.virtual_instrument import Instrument, default_instrument  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402
from ppmcal.io import read_mechanism  # noqa: E402
from ppmcal.model.instruments import POSE  # noqa: E402
from ppmcal.model.mechanism import Mechanism  # noqa: E402
from ppmcal.simulation.scenario import Listed, Scenario  # noqa: E402
from ppmcal.simulation.simulate import simulate  # noqa: E402

Array = NDArray[np.float64]
CONFIGS = Path(__file__).resolve().parent.parent / "configs"
MACHINES = ("3-RPR", "6-UPS", "delta-linear", "linapod", "3-RPS")
POSES = 15
RANDOM = (15, 30, 45)
FRESH = 40
POOL = 2000
FRAME = {"planar": (0.05, -0.03, 0.0, 0.0, 0.0, 0.2),
         "translational": (0.1, -0.05, 0.03, 0.05, -0.03, 0.4),
         "spatial": (0.1, -0.05, 0.03, 0.05, -0.03, 0.4)}


@dataclass(frozen=True)
class Outcome:
    """One design in one campaign: mean square errors, m2 and rad2; nan where the fit failed."""

    machine: str
    design: str
    campaign: int
    o1: float
    position: float
    rotation: float


@dataclass(frozen=True, eq=False)
class Case:
    """A machine, its instrument, its planned poses, and a pool of even ones, (N, 6) each."""

    mechanism: Mechanism
    instrument: Instrument
    planned: Array
    pool: Array


@cache
def case(machine: str, seed: int) -> Case:
    """Plan for a machine, and draw its pool."""
    mechanism = read_mechanism(CONFIGS / f"{machine}.yaml")
    instrument = default_instrument(mechanism)
    found = plan(mechanism, instrument, PlanOptions(POSES, seed))
    drawn = mechanism.nominal()
    pool = evenly(drawn, region_of(drawn), POOL, seed + 17)
    return Case(mechanism, instrument, found.pool.pose[found.offer.pose[found.rows]], pool.pose)


def scenario(at: Case, poses: Array, errors: dict[str, float], exact: bool) -> Scenario:
    """Return a scenario that measures at poses (N, 6)."""
    m, i = at.mechanism, at.instrument
    noise = 0.0 if exact else 1.0
    return Scenario(
        source="study", units=m.units, poses=Listed(poses, "study"), errors=errors,
        error_scale=None, kind=i.kind, sigma_position=noise * i.sigma_position,
        sigma_rotation=noise * i.sigma_rotation, sigma_value=0.0, sigma_actuator=i.sigma_actuator,
        point=np.zeros(3), point_known=True, frame=np.array(FRAME[m.motion.name]),
        frame_known=False, target=np.zeros(3), target_known=True, target_rotation=np.zeros(3),
        target_rotation_known=True, ar=0.0, outliers=0.0, tails="normal", repeats=1,
        approach="one", payload=(), temperature=None, velocity=np.zeros(len(m.actuators)),
        with_effects=m, seed=0)


def fresh_errors(fit: Fit, at: Case, truth: Scenario, seed: int) -> tuple[float, float]:
    """Return mean square errors of position and rotation at noise-free fresh poses."""
    m = at.mechanism
    seen = dataset(m, replace(truth, kind=POSE), simulate(m, replace(truth, kind=POSE), seed),
                   "a")
    problem = replace(fit.problem, datasets=(seen,),
                      pivots=tuple(o.about for o in fit.problem.opens))
    raw = np.concatenate([r.raw for r in problem.rows(fresh_state(problem, fit.state), False)])
    places = sum(1 for c in m.dof if c < 3)
    return (float(np.mean(np.sum(raw[:, :places] ** 2, axis=1))),
            float(np.mean(np.sum(raw[:, places:] ** 2, axis=1))))


def information(fit: Fit) -> float:
    """Return O1 of the parameters' covariance."""
    count = len(fit.problem.free)
    cov = posterior(fit)[:count, :count] / np.outer(fit.scale[:count], fit.scale[:count])
    return float(np.exp(-0.5 * np.linalg.slogdet(cov)[1] / count))


def run(job: tuple[str, int, int]) -> list[Outcome]:
    """Return what the four designs of one campaign gave."""
    machine, number, seed = job
    at = case(machine, seed)
    m = at.mechanism
    rng = np.random.default_rng([seed, number])
    errors = {m.names[p]: float(rng.normal() * (m.parameters[p].tolerance or 0.0))
              for p in m.free if np.isfinite(m.parameters[p].tolerance or 0.0)}
    drawn = rng.permutation(len(at.pool))
    fresh = scenario(at, at.pool[drawn[:FRESH]], errors, True)
    rest = at.pool[drawn[FRESH:]]
    out = []
    for name, poses in (("planned", at.planned), *((f"random {n}", rest[:n]) for n in RANDOM)):
        asked = scenario(at, poses, errors, False)
        noise = int(rng.integers(2**31))
        figures = (np.nan, np.nan, np.nan)
        try:
            data = dataset(m, asked, simulate(m, asked, noise), "a")
            fit = identify(Problem(m, (data,), m.free))
            if fit.converged:
                figures = (information(fit), *fresh_errors(fit, at, fresh, noise))
        except PpmcalError:
            pass
        out.append(Outcome(machine, name, number, *figures))
    return out


def table(outcomes: Sequence[Outcome], seed: int) -> str:
    """Return the results in Markdown."""
    lines = ["| machine | poses | campaigns | O1 | position, um | (95 %) | rotation, urad |",
             "|---|---|---|---|---|---|---|"]
    for machine in dict.fromkeys(o.machine for o in outcomes):
        for design in dict.fromkeys(o.design for o in outcomes):
            mine = [o for o in outcomes if o.machine == machine and o.design == design]
            good = [o for o in mine if np.isfinite(o.position)]
            rng = np.random.default_rng(seed)
            square = np.array([o.position for o in good])
            again = np.sqrt(np.mean(rng.choice(square, (2000, len(square))), axis=1))
            low, high = np.quantile(again, [0.025, 0.975]) * 1e6
            turn = np.sqrt(np.mean([o.rotation for o in good])) * 1e6
            name = f"**{POSES} planned**" if design == "planned" else f"{design[7:]} random"
            lines.append(
                f"| {machine} | {name} | {len(good)} of {len(mine)} | "
                f"{np.median([o.o1 for o in good]):.2f} | {np.sqrt(square.mean()) * 1e6:.1f} | "
                f"{low:.1f} to {high:.1f} | {f'{turn:.1f}' if turn else '-'} |")
    return "\n".join(lines)


def main() -> None:
    """Run all campaigns and print the table."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaigns", type=int, default=100, help="campaigns per machine")
    parser.add_argument("--machine", action="append", metavar="NAME",
                        help="a machine of configs/, may be repeated")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    began = time.perf_counter()
    jobs = [(m, n, given.seed) for m in given.machine or MACHINES
            for n in range(given.campaigns)]
    with multiprocessing.get_context("spawn").Pool(given.processes) as pool:
        found = [o for many in pool.imap(run, jobs, chunksize=5) for o in many]
    print(table(found, given.seed))
    print(f"\n{time.perf_counter() - began:.0f} s on {given.processes} processes, "
          f"seed {given.seed}.")


if __name__ == "__main__":
    main()
