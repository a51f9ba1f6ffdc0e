"""Assembly modes: all platform poses in which a machine closes at given joint values.

Planar machines by a resultant, :mod:`assembly_modes_planar`; three spheres of a translational
machine meet in a point pair, and spatial machines are searched, which may miss modes,
:mod:`ppmcal.design.assembly_modes_spatial`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal.design.assembly_modes_planar import SAME, by_resultant, weights
from ppmcal.design.assembly_modes_spatial import PLACE, FoundModes, apart, point_pair, search
from ppmcal.errors import NoResult
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.forward import forward, smallest_singular_value
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import SINGULAR, home_singular_value
from ppmcal.linalg import Array, Bools, Ints, finite_rows


@dataclass(frozen=True, eq=False)
class Modes:
    """All assembly modes found at one row of joint values; home's first, then by coordinates.

    Attributes:
        motors: platform-to-base motors (n, 8).
        sign: of det A (n,); singular_value: the smallest singular value of A (n,), as
            :func:`ppmcal.kinematics.forward.smallest_singular_value`.
        singular: whether that is below :data:`tables.SINGULAR` of home's, or two
            modes coincide there as far as numbers can tell (n,).
        home: which one home's assembly mode is, as :func:`forward.forward` reaches it;
            None where the way there meets a singularity or there is no such pose.
        complete: whether there can be no others.
        method: ``resultant``, ``point pair`` or ``search``.
    """

    motors: Array
    sign: Array
    singular_value: Array
    singular: Bools
    home: int | None
    complete: bool
    method: str

    def __len__(self) -> int:
        """Return how many modes there are."""
        return len(self.motors)


@dataclass(frozen=True, eq=False)
class ModeRow:
    """Assembly modes at one row of joint values.

    ``row``: its number in the user's file from 1, 0 for home's joints; ``q`` (k,);
    ``modes`` None where they could not be had, with the ``reason``.
    """

    row: int
    q: Array
    modes: Modes | None
    reason: str = ""


def assembly_modes(model: Model, q: Array, seed: int = 0) -> Modes:
    """Return all real platform poses that close at joint values ``q`` (k,), SI.

    A pose counts where the closure of every limb holds, whichever way its passive joints then
    stand: beyond the stroke of a passive slide, or with the other elbow, it is a mode too.
    ``seed`` draws the starts of a search.

    Raises:
        NoResult: a joint value is missing, a limb has no length at ``q``, or the poses that close
            are infinitely many.
    """
    q = np.asarray(q, dtype=float).reshape(1, -1)
    mechanism = model.mechanism
    if not finite_rows(q).all():
        raise NoResult("joint values are missing", PLACE, "Give every joint a value")
    closure = model.closure(q)
    spheres = weights(closure) != 0.0
    short = np.flatnonzero(spheres & (closure.radius[0] < 1e-9 * mechanism.reach))
    if short.size:
        raise NoResult(f"limb '{_limb_of(closure, int(short[0]))}' has no length at these joint "
                       "values: the platform turns about its base joint", PLACE)
    motion = mechanism.motion
    if motion.planar and motion.turns and not closure.turning:
        found, method = by_resultant(closure, spheres), "resultant"
    elif not motion.turns and spheres.any():
        # with pulleys or offset joints spheres move with the pose: two starts, maybe more modes
        found, method = point_pair(closure), "search" if closure.turning else "point pair"
    else:
        found, method = search(closure, seed), "search"
    return judged(model, closure, found, method)


def _limb_of(closure: Closure, row: int) -> str:
    """Return the name of the limb to which a closure equation belongs."""
    limbs = [limb.name for limb, body in zip(closure.model.mechanism.limbs, closure.bodies,
                                             strict=True) for _ in body.point_moves]
    return limbs[row]


def judged(model: Model, closure: Closure, found: FoundModes, method: str) -> Modes:
    """Order the modes, and say which one is home's and which are singular."""
    mechanism = model.mechanism
    motors, sharp, complete = found.motors, found.sharp, method != "search"
    own = forward(model, closure.q)
    home: int | None = None
    if own.converged[0]:
        away = apart(mechanism, motors, own.pose)
        if not away.size or away.min() > 100.0 * SAME:
            # never seen; a mode that forward kinematics knows must not be lost
            motors, sharp = np.concatenate([motors, own.pose]), np.append(sharp, True)
            away, complete = np.append(away, 0.0), False
        home = int(np.argmin(away))
    order = _order(motors, home)
    motors, sharp = motors[order], sharp[order]
    if not len(motors):
        none = np.zeros(0)
        return Modes(motors, none, none, none.astype(bool), None, complete, method)
    smallest, sign = smallest_singular_value(closure, motors)
    sharp = sharp & (smallest > SAME)
    if sharp.all() and len(motors) % 2 and not mechanism.surplus:
        complete = False  # simple roots come in pairs; surplus limbs may leave one of a pair
    singular = ~sharp | (smallest < SINGULAR * home_singular_value(mechanism)[0])
    return Modes(motors, sign, smallest, singular, None if home is None else 0, complete, method)


def _order(motors: Array, home: int | None) -> Ints:
    """Return the order of motors (n, 8): home's first, then by x, y, z and rotation."""
    keys = np.round(pose_vector(motors), 9).T[::-1]
    if home is None:
        return np.lexsort(keys)
    return np.lexsort((*keys, np.arange(len(motors)) != home))
