"""Joint values alone that cannot be a machine's: refused before any fit, each with its cause.

Limbs in surplus contradict each other by no more than noise and tolerances explain, in most rows.
Where they do so by far more, two columns are exchanged, or one limb reads more than the others
let it be: a rope that was not pulled. Both show against the nominal machine, row by row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, distances, gap_noise, identify
from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    Interpretation,
    InterpretationError,
)
from ppmcal.calibration.interpretation.joint_zeros import zeros_elsewhere
from ppmcal.calibration.interpretation.limits import LANDS, TELLING
from ppmcal.calibration.interpretation.readings import ColumnInterpretation
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.least_squares_closure import with_gaps
from ppmcal.kinematics.limb_sets import with_limbs
from ppmcal.kinematics.singular_structure import singular_structure
from ppmcal.kinematics.tables import SINGULAR_HOME, home_singular_value
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import number, pluralize

ROWS = 60
"""Rows that are looked at, evenly spread."""
STILL = 0.01
"""A joint whose values go less than this part of how far the others go does not move."""
ONE_PLACE = 1e-3
"""Values within this part of the reach are readings at one place."""
MOSTLY = 0.8
"""A rope that may be slack in fewer than this part of the rows of another one is not named."""
MANY = 1.0 / 3.0
"""Of rows with a contradiction: fewer are gross errors, which the fit leaves out by itself."""
FITS = 6
"""Exchanges that are fitted, at most."""


def refuse_joints_alone(problem: Problem) -> None:
    """Refuse rows of joint values alone whose cause shows without a fit.

    Raises:
        BadInput: a machine whose limbs cannot hold it, rows at one place, a joint that stands
            still, ropes that were not pulled. InterpretationError: exchanged columns.
    """
    alone = [d for d in problem.datasets if d.kind.blind]
    if not alone or not problem.free:
        return
    mechanism = problem.mechanism
    if home_singular_value(mechanism)[0] < SINGULAR_HOME:
        _refuse_structure(mechanism)
    if len(alone) == len(problem.datasets) and problem.earlier is None:
        _refuse_one_place(mechanism, alone)
    for data in alone:
        _refuse_still(mechanism, data)
        _refuse_contradiction(problem, data)


def _refuse_structure(mechanism: Mechanism) -> None:
    cause = singular_structure(mechanism)
    if cause:
        raise BadInput(cause, f"{mechanism.source}: limbs",
                       "Correct the points, or choose another home pose where that is the cause")


def _travel(mechanism: Mechanism, q: Array) -> Array:
    """Return how far each joint goes (k,), m at home's transmission."""
    own = q[finite_rows(q)]
    if not len(own):
        return np.zeros(q.shape[1])
    closure = Model(mechanism).closure(home_state(mechanism).q[None])
    by_joint = np.linalg.norm(closure.joint_matrix(mechanism.home[None])[0], axis=0)
    return np.asarray(np.ptp(own, axis=0) * by_joint)


def _refuse_one_place(mechanism: Mechanism, alone: list[Dataset]) -> None:
    q = np.concatenate([d.q for d in alone])
    if len(q) > 1 and _travel(mechanism, q).max() <= ONE_PLACE * mechanism.reach:
        raise BadInput(
            f"all {len(q)} rows are at one place, where joint values alone give "
            f"{pluralize(mechanism.surplus, 'number')} for {len(mechanism.free)} parameters",
            ", ".join(d.source for d in alone),
            f"Go to at least {-(-len(mechanism.free) // mechanism.surplus)} places, as different "
            "as the machine allows")


def _refuse_still(mechanism: Mechanism, data: Dataset) -> None:
    travel = _travel(mechanism, data.q)
    still = np.flatnonzero(travel <= STILL * travel.max())
    if len(data) < 3 or travel.max() <= ONE_PLACE * mechanism.reach or not still.size:
        return
    names = [f"q_{mechanism.actuators[i]}" for i in still]
    raise BadInput(
        f"{' and '.join(names)} hardly {'changes' if len(names) == 1 else 'change'} while the "
        "other joints move: a rope that was not pulled, or a drive that was not read",
        f"{data.source}: {', '.join(names)}",
        "Pull every limb tight at each place and read all of them; or take the limb out of the "
        "mechanism file")


# --- limbs that contradict each other -------------------------------------------------------------

@dataclass(frozen=True, eq=False)
class _AgainstNominal:
    """Rows of one data set against the nominal machine: q (n, k), and by how much it may be off.

    ``allowed``: (n,) what noise and tolerances leave of the limbs' contradiction, m.
    """

    model: Model
    q: Array
    allowed: Array

    def times(self, q: Array) -> tuple[Array, Array]:
        """Return contradictions (n,), m, and in parts of what is allowed; inf without a pose."""
        pose = self.pose(self.model, q)
        with np.errstate(invalid="ignore"):
            gap = np.linalg.norm(self.model.closure(q).lengths(pose), axis=1)
        gap = np.where(np.isfinite(gap), gap, np.inf)
        return gap, gap / self.allowed

    def pose(self, model: Model, q: Array) -> Array:
        """Return the poses (n, 8) where the limbs contradict each other least, nan without."""
        home = np.tile(model.mechanism.home, (len(q), 1))
        pose, good, _ = newton(model.closure(q), home)
        return np.where(good[:, None], pose, np.nan)


def _rows(problem: Problem, data: Dataset) -> _AgainstNominal | None:
    mechanism = replace(problem.mechanism.nominal(), effects=())
    q = data.q[finite_rows(data.q)]
    q = q[np.linspace(0, len(q) - 1, min(len(q), ROWS)).astype(int)] if len(q) else q
    if len(q) < 3 or any(mechanism.parameters[p].prior_sigma is None for p in mechanism.free):
        return None
    model = Model(mechanism)
    rows = _AgainstNominal(model, q, np.ones(len(q)))
    pose = rows.pose(model, q)
    good = finite_rows(pose)
    if not good.any():
        return None
    # what the tolerances leave where there is a pose; elsewhere the most of them
    sigma = np.array([mechanism.parameters[p].prior_sigma or 0.0 for p in mechanism.free])
    closure, at = model.closure(q[good], mechanism.free), pose[good]
    moved = np.concatenate([closure.error_matrix(at, mechanism.free) * sigma,
                            with_gaps(closure.joint_matrix(at) * data.sigma_actuator,
                                      gap_noise(mechanism, data))], axis=-1)
    allowed = np.full(len(q), np.linalg.norm(moved, axis=(-2, -1)).max())
    allowed[good] = np.linalg.norm(moved, axis=(-2, -1))
    return replace(rows, allowed=allowed)


def _refuse_contradiction(problem: Problem, data: Dataset) -> None:
    rows = _rows(problem, data)
    if rows is None:
        return
    gap, times = rows.times(rows.q)
    if np.mean(times > LANDS) <= MANY:
        return
    _refuse_exchanged(rows, data, float(np.median(gap)), float(np.median(times)))
    _refuse(problem.mechanism, zeros_elsewhere(problem))
    _refuse_slack(rows, data, times > LANDS)


def refuse_exchanged(fit: Fit) -> None:
    """Refuse exchanged columns with which a fit leaves more than noise, where another one does not.

    The nominal machine need not tell them: of one surplus a row its tolerances may explain either.

    Raises:
        InterpretationError: with the columns.
    """
    problem, left = fit.problem, distances(fit.problem, fit.state).times(fit.keep)
    if not _kept(fit):
        return
    for i, data in enumerate(problem.datasets):
        rows = _rows(problem, data) if data.kind.blind else None
        found = []
        for *_, way in [] if rows is None else _pairs(rows, data)[:FITS]:
            datasets = (*problem.datasets[:i], way.of(data), *problem.datasets[i + 1:])
            try:
                other = identify(replace(problem, datasets=datasets))
            except PpmcalError:
                continue
            times = distances(other.problem, other.state).times(other.keep)
            if other.converged and _kept(other) >= _kept(fit) and times * TELLING <= left:
                found.append((times, way))
        _refuse(problem.mechanism, [_exchange(
            data, way, f"residuals are {number(times, 3)} times the noise then, not "
            f"{number(left, 3)} times" * (n == 0))
            for n, (times, way) in enumerate(sorted(found, key=lambda f: f[0]))
            if times <= TELLING * min(f[0] for f in found)])


def _kept(fit: Fit) -> int:
    """Return how many rows a fit uses."""
    return sum(int(np.count_nonzero(k)) for k in fit.keep)


def _refuse(mechanism: Mechanism, found: Sequence[Interpretation]) -> None:
    if found:
        best, *others = found
        raise InterpretationError.of([replace(best, alternatives=tuple(
            other.mistakes for other in others))], mechanism.units)


def _exchange(data: Dataset, way: ColumnInterpretation, better: str) -> Interpretation:
    """Return an exchange of columns; ``better``: what it mends, in words."""
    (fault,) = way.joints.mistakes("permuted")
    text = f"{fault.text}: {better}" if better else fault.text
    return Interpretation(data.source, (FileFault(fault.kind, fault.columns, text),),
                          way.block(data))


def _pairs(rows: _AgainstNominal, data: Dataset
           ) -> list[tuple[float, float, ColumnInterpretation]]:
    """Return exchanges of two columns that the tolerances allow, best first.

    With each, by what part of what is allowed limbs contradict each other then, and by how much.
    """
    mechanism = rows.model.mechanism
    plain, k = ColumnInterpretation.as_declared(mechanism, data), len(mechanism.actuators)
    tried = []
    for pair in combinations(range(k), 2):
        order = list(range(k))
        order[pair[0]], order[pair[1]] = pair[1], pair[0]
        joints = replace(plain.joints, order=tuple(order))
        left, part = (float(np.median(v)) for v in rows.times(joints.of(rows.q)))
        if part <= LANDS:
            tried.append((part, left, replace(plain, joints=joints)))
    return sorted(tried, key=lambda t: t[0])


def _refuse_exchanged(rows: _AgainstNominal, data: Dataset, gap: float, times: float) -> None:
    """Refuse columns with which limbs contradict each other far more than if two are exchanged."""
    found = [t for t in _pairs(rows, data) if t[0] * TELLING <= times]
    units = rows.model.mechanism.units
    _refuse(rows.model.mechanism, [_exchange(
        data, way, f"limbs contradict each other by {units.words(left, 'length')} then, not by "
        f"{units.words(gap, 'length')}" * (n == 0))
        for n, (part, left, way) in enumerate(found) if part <= TELLING * found[0][0]])


def _refuse_slack(rows: _AgainstNominal, data: Dataset, wrong: Bools) -> None:
    """Refuse limbs that read more than the others let them be, where that explains most rows."""
    mechanism = rows.model.mechanism
    limbs = mechanism.limbs
    one = mechanism.surplus == 1
    if not mechanism.surplus or len({limb.actuator for limb in limbs}) < len(limbs) or (
            one and not all(limb.kind.pulls_only for limb in limbs)):
        return    # of one contradiction a row only the sign tells which limb it may be of
    left = np.full((len(limbs), len(rows.q)), np.inf)
    longer = np.zeros_like(left)
    for i in range(len(limbs)):
        part, driven = with_limbs(rows.model, [n for n in range(len(limbs)) if n != i])
        pose = rows.pose(part, rows.q[:, driven])
        with np.errstate(invalid="ignore"):
            gap = np.linalg.norm(part.closure(rows.q[:, driven]).lengths(pose), axis=1)
            # a reading that is too long has the limb's end within its length
            longer[i] = -rows.model.closure(rows.q).lengths(pose)[:, i]
        left[i] = np.where(np.isfinite(gap), gap, np.inf) / rows.allowed
    may = wrong & (left <= LANDS) & (longer > 0.0)
    if not one:     # the limb without which the others agree best
        may &= np.arange(len(limbs))[:, None] == np.argmin(left, axis=0)
    slack = may.any(axis=0)
    if slack.sum() <= 0.5 * wrong.sum():
        return
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    count = may.sum(axis=1)
    which = np.flatnonzero(count >= (MOSTLY * count.max() if one else 0.1 * count.sum())).tolist()
    words = [f"q_{mechanism.actuators[limbs[i].actuator]} in {count[i]} by up to "
             f"{number(longer[i][may[i]].max() / factor, 3)} {unit}" for i in which]
    names = [f"q_{mechanism.actuators[limbs[i].actuator]}" for i in which]
    told = ("; or ".join(words) + "; of one contradiction a row the sign alone tells, so it may be "
            "any of these") if one and len(which) > 1 else ", ".join(words)
    raise BadInput(
        f"limbs read longer than the others let them be in {slack.sum()} of {len(rows.q)} rows "
        f"({told}): slack, or with another zero", f"{data.source}: {', '.join(names)}",
        "Pull every rope tight at each place and measure again, or leave these rows out; where "
        "nothing can be slack, correct the column's zero or unit")
