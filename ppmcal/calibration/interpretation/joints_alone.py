"""Joint values alone that cannot be of the machine: refused before any fit, each with its cause.

In most rows, surplus limbs contradict each other by no more than noise and tolerances explain.
If they do so by far more, columns are read wrongly, or one limb reads longer than the others allow:
a rope that was not pulled. Both show against the nominal machine, row by row.
"""

from __future__ import annotations

import numpy as np

from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation.interpretation_error import InterpretationError
from ppmcal.calibration.interpretation.joint_columns import (
    AgainstNominal,
    contradicted,
    refuse_joint_columns,
)
from ppmcal.calibration.interpretation.joint_zeros import zeros_elsewhere
from ppmcal.calibration.interpretation.limits import LANDS
from ppmcal.calibration.interpretation.ropes_at_home import HINT, not_held_at_home
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.limb_sets import with_limbs
from ppmcal.kinematics.singular_structure import singular_structure
from ppmcal.kinematics.tables import SINGULAR_HOME, home_singular_value
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import number, pluralize

STILL = 0.01
"""A joint whose travel is below this part of the others' travel does not move."""
ONE_PLACE = 1e-3
"""Values within this part of the reach are readings at one place."""
MOSTLY = 0.8
"""A rope is not named if it may be slack in fewer than this part of the rows of another one."""


def refuse_joints_alone(problem: Problem) -> None:
    """Refuse rows of joint values alone whose fault shows without a fit.

    Raises:
        BadInput: a machine whose limbs cannot hold it, rows at one place, a joint that stands
            still, ropes that were not pulled. InterpretationError: columns read wrongly, before
            faults of places and joints that follow from this, or zeros elsewhere.
    """
    alone = [d for d in problem.datasets if d.kind.blind]
    if not alone or not problem.free:
        return
    mechanism = problem.mechanism
    if home_singular_value(mechanism)[0] < SINGULAR_HOME:
        _refuse_structure(mechanism)
    against = [contradicted(problem, data) for data in alone]
    if any(rows is not None for rows in against):
        _refuse_slack_at_home(mechanism)
    for data, rows in zip(alone, against, strict=True):
        if rows is not None:
            refuse_joint_columns(mechanism, data, rows)
    if len(alone) == len(problem.datasets) and problem.earlier is None:
        _refuse_one_place(mechanism, alone)
    for data, rows in zip(alone, against, strict=True):
        _refuse_still(mechanism, data)
        if rows is not None:
            zeros = zeros_elsewhere(problem)
            if zeros:
                raise InterpretationError.of(zeros, mechanism.units)
            _refuse_slack(rows, data)


def _refuse_structure(mechanism: Mechanism) -> None:
    cause = singular_structure(mechanism)
    if cause:
        raise BadInput(cause, f"{mechanism.source}: limbs",
                       "Correct the points, or choose another home pose where that is the cause")


def _refuse_slack_at_home(mechanism: Mechanism) -> None:
    told = not_held_at_home(mechanism)
    if told:
        raise BadInput(told, f"{mechanism.source}: limbs", HINT)


def _travel(mechanism: Mechanism, q: Array) -> Array:
    """Return the travel of each joint (k,), m at home's transmission."""
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


def _refuse_slack(rows: AgainstNominal, data: Dataset) -> None:
    """Refuse limbs that read longer than the others allow, if that explains most rows."""
    mechanism, wrong = rows.model.mechanism, rows.as_read[1] > LANDS
    limbs = mechanism.limbs
    one = mechanism.surplus == 1
    if not mechanism.surplus or len({limb.actuator for limb in limbs}) < len(limbs) or (
            one and not all(limb.kind.pulls_only for limb in limbs)):
        return    # with one contradiction per row only its sign shows which limbs it may be
    left = np.full((len(limbs), len(rows.q)), np.inf)
    longer = np.zeros_like(left)
    for i in range(len(limbs)):
        part, driven = with_limbs(rows.model, [n for n in range(len(limbs)) if n != i])
        pose = rows.pose(part, rows.q[:, driven])
        with np.errstate(invalid="ignore"):
            gap = np.linalg.norm(part.closure(rows.q[:, driven]).lengths(pose), axis=1)
            # if a reading is too long, the limb's end is within its length
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
    told = ("; or ".join(words) + "; with one contradiction per row only its sign is known, so it "
            "may be any of these") if one and len(which) > 1 else ", ".join(words)
    raise BadInput(
        f"limbs read longer than the others allow in {slack.sum()} of {len(rows.q)} rows "
        f"({told}): slack, or with another zero", f"{data.source}: {', '.join(names)}",
        "Pull every rope tight at each place and measure again, or leave these rows out; if "
        "nothing can be slack, correct the column's zero or unit")
