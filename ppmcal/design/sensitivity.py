"""Error analysis of a machine: which error does what to the tool, where, and how far it is linear.

Errors are the free parameters of the file, or all components of every joint frame
(:mod:`design.error_sources`). The amplification index is [LIN] eq. 16: the tool's error when all
errors have the same standard deviation. Lengths and angles are made alike by one metric
length rho: an angular error of sigma/rho counts as a length error of sigma.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal.design.error_jacobian import (
    Linearity,
    Poses,
    Survey,
    covariance,
    error_jacobian,
    linearity,
    root_sum_square,
    survey,
    worst_signs,
)
from ppmcal.design.error_sources import Source, geometry_only, natural_units, sources, tolerances
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.tables import KinematicsTable, inverse_table, refuse_singular_home
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.parameters import unmatched
from ppmcal.wording.progress import stage

MULTIPLES = np.logspace(-3.0, 3.0, 25)
"""Multiples of the tolerances at which the linear model is tried."""
SIZES = np.logspace(-6.0, -1.5, 28)
"""Sizes of errors that are moved together, in parts of the reach (of what counts like it)."""


@dataclass(frozen=True, eq=False)
class SensitivityOptions:
    """What to analyse.

    Attributes:
        tool: point in platform axes (3,), m.
        metric: rho, m.
        sigmas: worst case with every error at this many standard deviations.
        together: patterns of parameters moved by one and the same error for the linearity
            curve; empty: every error at once, by its tolerance, in the worst direction.
        size: that error, for one figure besides the curve, or None.
    """

    tool: Array
    metric: float
    sigmas: float = 1.0
    together: tuple[str, ...] = ()
    size: float | None = None


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The error analysis of one machine, SI.

    Attributes:
        mechanism: without effects; sources: its errors (S,); sigma: their deviations (S,).
        jacobian: J_g at home (6, S); home: the figures there (one pose).
        table: the poses asked for (N); figures of those that are ``ok``, nan elsewhere:
        over: root-sum-square, worst case and each error's part; index: amplification of
            position and rotation (N, 2), m per m and rad per m; home_index (2,).
        linear: linear against nonlinear model, at home.
        moved: parameter indices that the linearity curve moves.
        at_size: the same for the one size asked for, or None.
    """

    mechanism: Mechanism
    asked: SensitivityOptions
    sources: tuple[Source, ...]
    sigma: Array
    jacobian: Array
    home: Survey
    home_index: Array
    table: KinematicsTable
    over: Survey
    index: Array
    linear: Linearity
    moved: tuple[int, ...]
    at_size: Linearity | None = None

    def share(self, rotation: bool = False) -> Array:
        """Return each error's share of the tool's variance over the poses (S,), sum 1."""
        by = self.over.by_rotation if rotation else self.over.by_position
        part = (by * self.sigma) ** 2
        whole = float(part.sum())
        return np.asarray(part / whole if whole > 0.0 else part)


@stage("what each error does")
def analyse(
    mechanism: Mechanism, asked: SensitivityOptions, wanted: Array | None = None
) -> Sensitivity:
    """Return the error analysis at home and over wanted poses (N, 6), default home alone.

    Raises:
        BadInput: no error to look at, or a pattern that names none.
        NoResult: home is singular, or none of the poses can be reached.
    """
    machine = geometry_only(mechanism)
    found = sources(machine)
    if not found:
        raise BadInput("no parameter is free, so there is no error to look at",
                       f"{mechanism.source}: free", "Give slots a tolerance, change `free`, or "
                       "ask for all components")
    refuse_singular_home(machine)
    free, sigma = [s.parameter for s in found], tolerances(machine, found)
    model, moved = Model(machine), _moved(machine, found, asked.together)
    home = Poses(home_state(machine).q[None], machine.home[None], asked.tool)
    jacobian = error_jacobian(model, home, free)[0]
    if not np.isfinite(jacobian).all() or np.abs(jacobian).max() > 1e12:
        raise NoResult("home is singular: errors there have no finite effect", mechanism.source,
                       "Choose another home")
    table = inverse_table(model, pose_vector(home.motor) if wanted is None else wanted)
    good = np.array([s == "ok" for s in table.status])
    if wanted is None:
        good[:] = True
    if not good.any():
        why = Counter(s for s in table.status).most_common()
        raise NoResult(f"none of the {len(good)} poses can be used: "
                       + ", ".join(f"{count} {status}" for status, count in why),
                       mechanism.source, "Choose poses nearer to home")
    at = Poses(table.q[good], pose_motor(table.pose[good]), asked.tool)
    limits = asked.sigmas * sigma
    unit = natural_units(machine, found, asked.metric)
    index = np.full((len(good), 2), np.nan)
    index[good] = np.stack(root_sum_square(covariance(model, at, free, unit)), axis=-1)
    first = np.stack(root_sum_square(covariance(model, home, free, unit)), axis=-1)[0]
    step, scale = _way(machine, found, sigma, jacobian, asked, moved)
    return Sensitivity(
        machine, asked, found, sigma, jacobian, survey(model, home, free, sigma, limits), first,
        table, _spread_out(survey(model, at, free, sigma, limits), good), index,
        linearity(model, home, free, step, scale, asked.metric), moved,
        None if asked.size is None or not asked.together else
        linearity(model, home, free, step, np.array([asked.size]), asked.metric))


def _spread_out(over: Survey, good: NDArray[np.bool_]) -> Survey:
    """Return a survey with nan where a pose was not looked at."""
    def full(values: Array) -> Array:
        out = np.full(len(good), np.nan)
        out[good] = values
        return out

    return Survey(full(over.position), full(over.rotation), full(over.worst_position),
                  full(over.worst_rotation), over.by_position, over.by_rotation)


def _moved(machine: Mechanism, found: Sequence[Source], together: Sequence[str]
           ) -> tuple[int, ...]:
    """Return the parameters that the linearity curve moves, all of one quantity if together."""
    free = [s.parameter for s in found]
    if not together:
        return tuple(free)
    parameters = [machine.parameters[p] for p in free]
    missed = unmatched(parameters, together)
    if missed:
        raise BadInput(f"the pattern '{missed[0]}' names none of the errors looked at",
                       "--together", f"They are called {', '.join(p.name for p in parameters[:6])}"
                       ", ...")
    moved = [i for i, p in zip(free, parameters, strict=True)
             if any(p.matches(t) for t in together)]
    if len({(machine.parameters[p].quantity, machine.parameters[p].per_unit)
            for p in moved}) > 1:
        raise BadInput("lengths, angles and ratios cannot be off by the same amount",
                       "--together", "Name parameters of one quantity")
    return tuple(moved)


def _way(
    machine: Mechanism,
    found: Sequence[Source],
    sigma: Array,
    jacobian: Array,
    asked: SensitivityOptions,
    moved: Sequence[int],
) -> tuple[Array, Array]:
    """Return one multiple's errors (S,) of the linearity curve, and the multiples (L,)."""
    if not asked.together:
        ways = [sigma * worst_signs(part * sigma) for part in (jacobian[:3], jacobian[3:])]
        size = [np.linalg.norm(jacobian[:3] @ ways[0]),
                asked.metric * np.linalg.norm(jacobian[3:] @ ways[1])]
        return ways[int(np.argmax(size))], MULTIPLES
    step = np.array([1.0 if s.parameter in moved else 0.0 for s in found])
    unit = natural_units(machine, [s for s in found if s.parameter == moved[0]], asked.metric)
    return step, SIZES * machine.reach * float(unit[0])
