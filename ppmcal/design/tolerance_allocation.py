"""From a demanded accuracy to tolerances, and the share of machines that meet it.

Tolerances follow from the linear model ([LIN] section 3.1), their common scale from the wanted
share of machines in specification; the share itself is then counted on other machines with
the full nonlinear model, before and after a calibration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.special import betaincinv

from ppmcal.design.error_jacobian import Poses, covariance, error_jacobian, root_sum_square
from ppmcal.design.error_sources import Source
from ppmcal.design.monte_carlo import Fleet, MachineErrors, MonteCarloErrors, batches, run, together
from ppmcal.design.processes import over
from ppmcal.design.tolerance_costs import (
    cost,
    demand,
    equal_parts,
    is_sensitive,
    least_cost,
    one_for_all,
)
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array, Bools
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Angle, Length
from ppmcal.wording.progress import stage

DRAWS, BEYOND, MOST_DRAWS = 4000, 400, 40_000
"""Machines of the linear model from which the common scale follows: at least so many, and so many
expected out of specification, up to the last."""
NEAR = 0.1
"""Machines whose worst error is this near to the quantile tell which errors set it."""
ROUNDS = 12
METHODS = ("mean", "equal", "cost", "file")
SURE = 4.0
"""Linear and nonlinear model disagree beyond this many standard errors ..."""
MATTERS = 0.02
"""... and by more than this part."""


@dataclass(frozen=True)
class Demand:
    """What is demanded: largest errors and the share of machines that meet them, a bare number.

    Errors are in m and rad, or in a file's units, or None. A machine meets them if it does so at
    every task pose.
    """

    position: Length[float | None]
    rotation: Angle[float | None]
    share: float


@dataclass(frozen=True, eq=False)
class Allocation:
    """Tolerances by one method: ``tau`` (S,), inf where the tool is not sensitive; ``cost``."""

    method: str
    tau: Array
    cost: float

    @property
    def drawn(self) -> Array:
        """Standard deviations to draw machines with (S,): 0 where tau is inf."""
        return np.asarray(np.where(np.isfinite(self.tau), self.tau, 0.0))


@dataclass(frozen=True)
class StageYield:
    """Machines in specification at one stage, their share and its 95 % interval.

    ``going``: machines that have a result at every task pose; ``position_rms, rotation_rms``:
    of those, units as in ``units``.
    """

    KEYS: ClassVar = ("stage", "words", "in_specification", "machines", "share", "interval",
                      "going", "position_rms", "rotation_rms")

    in_specification: int
    machines: int
    stage: str = ""
    words: str = ""
    going: int = 0
    position_rms: Length[float | None] = None
    rotation_rms: Angle[float | None] = None

    @cached_property
    def share(self) -> float | None:
        """Those in specification over all."""
        return self.in_specification / self.machines

    @cached_property
    def interval(self) -> tuple[float, ...]:
        """Clopper-Pearson 95 % interval of the share."""
        h, n = self.in_specification, self.machines
        low = 0.0 if h == 0 else float(betaincinv(h, n - h + 1, 0.025))
        high = 1.0 if h == n else float(betaincinv(h + 1, n - h, 0.975))
        return low, high


@stage("allocating tolerances")
def allocate(mechanism: Mechanism, sources: tuple[Source, ...], tasks: Poses, wanted: Demand,
             unit: Array, weight: Array, exponent: Array, given: Array, seed: int
             ) -> Mapping[str, Allocation]:
    """Return the tolerances by every method of :data:`METHODS`.

    Args:
        mechanism: without effects.
        sources: the errors (S,).
        tasks: poses at which the accuracy is demanded, with the tool point.
        wanted: the demand.
        unit: 1 for lengths, 1/rho for angles (S,).
        weight: cost of each error at a tolerance of one unit (S,).
        exponent: cost is weight tau^-exponent (S,).
        given: present tolerances (S,); ``file`` keeps them as they are.
        seed: of the draws from which the common scale follows.

    Raises:
        BadInput: the tool is sensitive to no error.
    """
    free = [s.parameter for s in sources]
    jacobian = error_jacobian(Model(mechanism), tasks, free)
    by_position, by_rotation = (np.sqrt((part**2).sum(axis=1).mean(axis=0))
                                for part in (jacobian[:, :3], jacobian[:, 3:]))
    a = demand(by_position, by_rotation, wanted.position, wanted.rotation)
    if not is_sensitive(a).any():
        raise BadInput("none of the errors moves the tool", f"{mechanism.source}: free",
                       "Free other parameters")
    if not np.isfinite(jacobian).all():
        raise BadInput("a task pose is singular: errors there have no finite effect",
                       mechanism.source, "Leave it out")
    rng = np.random.default_rng(seed)
    count = int(min(max(DRAWS, BEYOND / (1.0 - wanted.share)), MOST_DRAWS))
    linear, fresh = (_Linear(jacobian, rng.normal(size=(n, len(free))), wanted)
                     for n in (DRAWS, count))
    out = {}
    for method, tau in (("mean", one_for_all(a, unit)), ("equal", equal_parts(a)),
                        ("cost", least_cost(a, weight, exponent))):
        scaled = tau / linear.quantile(tau)[0]
        out[method] = Allocation(method, scaled, cost(scaled, weight, exponent))
    out["cost"] = _cheapest(linear, out, a, weight, exponent)
    use = is_sensitive(a)
    for method, found in out.items():
        # other draws than those that chose the tolerances set their scale
        tau = found.tau / fresh.quantile(found.tau)[0]
        out[method] = Allocation(method, tau, cost(tau[use], weight[use], exponent[use]))
    out["file"] = Allocation("file", given, cost(given[use], weight[use], exponent[use]))
    return out


@dataclass(frozen=True, eq=False)
class _Linear:
    """Machines of the linear model: J_g (T, 6, S), standard draws (D, S), what is demanded."""

    jacobian: Array
    draws: Array
    wanted: Demand

    def quantile(self, tau: Array) -> tuple[float, Array]:
        """Return the wanted quantile of machines' worst error over the demand, and its parts.

        The parts (S,) add up to the quantile: tau_i times its derivative by tau_i, that is the
        mean, over machines near the quantile, of what error i adds along the worst error.
        """
        steps = self.jacobian * np.where(np.isfinite(tau), tau, 0.0)
        worst = np.zeros(len(self.draws))
        along = np.zeros(self.draws.shape)
        for part, limit in ((steps[:, :3], self.wanted.position),
                            (steps[:, 3:], self.wanted.rotation)):
            if limit is None:
                continue
            for pose in part:
                error = self.draws @ pose.T
                size = np.linalg.norm(error, axis=1) / limit
                more = size > worst
                worst[more] = size[more]
                way = error[more] / (size[more] * limit**2)[:, None]
                along[more] = (way @ pose) * self.draws[more]
        found = float(np.quantile(worst, self.wanted.share))
        near = np.abs(worst - found) <= NEAR * found
        parts = np.maximum(along[near].mean(axis=0), 0.0)
        return found, parts * found / parts.sum()


def _cheapest(linear: _Linear, known: Mapping[str, Allocation], a: Array, weight: Array,
              exponent: Array) -> Allocation:
    """Return the cheapest tolerances found that keep the demand at every pose at once.

    Squares add up at one pose; what is demanded is a quantile over machines of the worst of
    all poses. At the least cost, weight exponent tau^-exponent is to the part of error i in
    that quantile as for every other (Lagrange): the same rule with parts in place of squares,
    solved by iteration.
    """
    best = min(known.values(), key=lambda k: k.cost)
    best = Allocation("cost", best.tau, best.cost)
    square, tau = a**2, known["cost"].tau
    for _ in range(ROUNDS):
        parts = linear.quantile(tau)[1]
        use = np.isfinite(tau)
        square[use] = 0.5 * (square[use] + parts[use] / tau[use] ** 2)
        tau = least_cost(np.sqrt(square), weight, exponent)
        tau = np.where(use, np.where(np.isfinite(tau), tau, best.tau), np.inf)
        tau = tau / linear.quantile(tau)[0]
        now = cost(tau, weight, exponent)
        if now < best.cost:
            best = Allocation("cost", tau, now)
    return best


def count(errors: MachineErrors, wanted: Demand) -> StageYield:
    """Return how many machines meet the demand at every pose; those that cannot go there do not."""
    good = np.ones(len(errors.position), dtype=np.bool_)
    for part, limit in ((errors.position, wanted.position), (errors.rotation, wanted.rotation)):
        if limit is not None:
            good &= (part <= limit).all(axis=1)
    return StageYield(int(good.sum()), len(good))


def simulate(fleet: Fleet, machines: int, seed: int, processes: int, scheduler: str | None
             ) -> MonteCarloErrors:
    """Return the errors of that many machines; the same for a seed whatever runs them."""
    items = batches(machines, seed)
    parts: list[MonteCarloErrors] = []
    with stage("simulating", machines, "machines") as work:
        for part in over(run, fleet, items, processes, scheduler):
            parts.append(part)
            work.done(len(part.built.position))
    return together(parts)


@dataclass(frozen=True, eq=False)
class AccuracyCheck:
    """Linear prediction against Monte Carlo, pose by pose (T,).

    ``linear``, ``drawn``: rms position error, m, the second of machines that can go there;
    ``error``: its standard error; ``agrees``: whether the linear prediction is good enough.
    """

    linear: Array
    drawn: Array
    error: Array

    @property
    def seen(self) -> float:
        """The relative difference that so many machines would show for certain."""
        return float(np.max(SURE * self.error / np.where(self.linear > 0.0, self.linear, 1.0),
                            initial=MATTERS))

    @property
    def agrees(self) -> Bools:
        """Within :data:`SURE` standard errors, or within :data:`MATTERS`."""
        apart = np.abs(self.drawn - self.linear)
        return np.asarray((apart <= SURE * self.error) | (apart <= MATTERS * self.linear))


def check(fleet: Fleet, built: MachineErrors) -> AccuracyCheck:
    """Return how the linear model's rms error compares with that of machines drawn."""
    expected = covariance(Model(fleet.mechanism), fleet.tasks, fleet.wanted, fleet.sigma)
    square = built.position**2
    there = np.isfinite(square)
    n = np.maximum(there.sum(axis=0), 1)
    mean = np.where(there, square, 0.0).sum(axis=0) / n
    spread_of = np.where(there, (square - mean) ** 2, 0.0).sum(axis=0) / n
    drawn = np.sqrt(mean)
    error = np.sqrt(spread_of / n) / np.where(drawn > 0.0, 2.0 * drawn, 1.0)
    return AccuracyCheck(root_sum_square(expected)[0], drawn, error)
