"""Straight ways from pose to pose: whether limits hold in between and no singularity is met.

On the way the platform's origin moves straight and the platform rotates evenly; for a machine with
fewer actuators than coordinates this holds for those that a command names. A way is examined at its
middle, then at the middle of each unsettled stretch, and so on. A stretch is settled if A cannot
become singular in it: its smallest singular value changes by no more than A itself (Weyl), so that
it stays above the mean of both ends less LEEWAY |A1 - A0|; and if the joints bend little and stay
off their limits by half a step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import inverse_partial, pose_vector
from ppmcal.kinematics.region import named
from ppmcal.kinematics.tables import SINGULAR, home_singular_value, limit_reason
from ppmcal.linalg import Array, Bools, Ints, determinant, finite_rows, singular_values
from ppmcal.model.mechanism import Mechanism

SHORT = 0.01
"""Relative to the reach, and a radian: on shorter stretches joints are assumed not to bend."""
BENT = 0.25
"""Joints bend little if the middle is off the line of both ends by this part of their step."""
LEEWAY = 0.75
DEEPEST = 9
"""Halvings of a way; one that is sound at all of 512 places passes."""
CHUNK = 2048


@dataclass(frozen=True)
class _Places:
    """The machine at N places: joints (N, k), A with rotations as arcs, and its singular values."""

    pose: Array
    q: Array
    matrix: Array
    value: Array
    sign: Array

    def take(self, rows: Ints | Bools) -> _Places:
        return _Places(self.pose[rows], self.q[rows], self.matrix[rows], self.value[rows],
                       self.sign[rows])

    def joined(self, other: _Places) -> _Places:
        return _Places(*(np.concatenate(pair) for pair in (
            (self.pose, other.pose), (self.q, other.q), (self.matrix, other.matrix),
            (self.value, other.value), (self.sign, other.sign))))


class Ways:
    """Straight ways between the rows of a table.

    ``q`` (N, k): joint values of the geometry at the rows' poses; ``added``: those of effects.
    """

    def __init__(self, mechanism: Mechanism, pose: Array, q: Array) -> None:
        """Prepare the rows.

        Args:
            mechanism: the machine; effects shift its joints by their values at both ends of a way.
            pose: of the platform in the base frame, motors (N, 8).
            q: joint values sent there (N, k).
        """
        self.mechanism = replace(mechanism, effects=())
        self.model = Model(self.mechanism)
        self.pose = pose
        good = finite_rows(pose)
        own = np.full_like(q, np.nan)
        if mechanism.effects:
            own[good] = self._joints(pose[good])[1]
        else:
            own[good] = q[good]
        self.q, self.added = own, q - own
        self.home_value, self.home_sign = home_singular_value(self.mechanism)

    def judged(self, before: Ints, after: Ints) -> dict[int, str]:
        """Return what is wrong with ways from rows ``before`` to rows ``after`` (M,).

        Index in the list of ways -> reason, without sound ways.
        """
        out: dict[int, str] = {}
        for start in range(0, len(before), CHUNK):
            part = slice(start, start + CHUNK)
            for n, reason in self._chunk(before[part], after[part]):
                out[start + n] = reason
        return out

    def _chunk(self, before: Ints, after: Ints) -> Iterator[tuple[int, str]]:
        rows, place = np.unique(np.concatenate([before, after]), return_inverse=True)
        ends = self._places(self.pose[rows], self.q[rows])
        left, right = ends.take(place[:len(before)]), ends.take(place[len(before):])
        way = np.arange(len(before))
        part = np.stack([np.zeros(len(way)), np.ones(len(way))])
        bend = np.full_like(left.q, np.inf)
        failed = np.zeros(len(way), dtype=np.bool_)
        for _ in range(DEEPEST):
            added = [self._added(before[way], after[way], t) for t in part]
            rest = ~(self._settled(left, right, added, bend) | failed[way])
            if not rest.any():
                return
            left, right, way, part = left.take(rest), right.take(rest), way[rest], part[:, rest]
            half = part.mean(axis=0)
            pose, q = self._joints(between(self.pose[before[way]], self.pose[after[way]], half))
            middle = self._places(pose, q)
            sent = q + self._added(before[way], after[way], half)
            for n, reason in self._wrong(middle, sent, before[way]):
                if not failed[way[n]]:
                    failed[way[n]] = True
                    yield int(way[n]), reason
            bend = np.tile(self._bend(left.q, middle.q, right.q), (2, 1))
            left, right = left.joined(middle), middle.joined(right)
            way = np.tile(way, 2)
            part = np.stack([np.concatenate([part[0], half]), np.concatenate([half, part[1]])])

    def _added(self, before: Ints, after: Ints, part: Array) -> Array:
        """Return the effects' contribution to the joints on the way (M, k)."""
        t = part[:, None]
        return np.asarray((1.0 - t) * self.added[before] + t * self.added[after])

    def _joints(self, pose: Array) -> tuple[Array, Array]:
        """Return motors (M, 8) on the machine's surface, and joint values (M, k), nan: none."""
        if not self.mechanism.dependent:
            return pose, inverse(self.model, pose).q
        asked = pose_vector(pose)
        asked[:, [c for c in self.mechanism.dof if c not in named(self.mechanism)]] = np.nan
        found = inverse_partial(self.model, asked)
        return found.pose, found.q

    def _places(self, pose: Array, q: Array) -> _Places:
        """Return the machine at poses (M, 8) with joints (M, k)."""
        matrix = np.full((len(q), self.mechanism.equations, len(self.mechanism.dof)), np.nan)
        value, sign = np.full(len(q), np.nan), np.full(len(q), np.nan)
        good = finite_rows(q) & finite_rows(pose)
        if good.any():
            own = self.model.closure(q[good]).pose_matrix(pose[good]).copy()
            own[..., [i for i, c in enumerate(self.mechanism.dof) if c >= 3]] /= (
                self.mechanism.length_scale)
            matrix[good] = own
            good[good] = np.isfinite(own).all(axis=(1, 2))
            value[good] = singular_values(matrix[good])[:, -1]
            sign[good] = np.sign(determinant(matrix[good]))
        return _Places(pose, q, matrix, value, sign)

    def _settled(self, left: _Places, right: _Places, added: list[Array], bend: Array) -> Bools:
        """Return on which stretches nothing can be met (M,); ``bend`` (M, k) as below."""
        apart = np.linalg.norm(right.matrix - left.matrix, axis=(1, 2))
        clear = 0.5 * (left.value + right.value) - LEEWAY * apart > SINGULAR * self.home_value
        low, high = self.mechanism.limits.T
        looked = finite_rows(bend)
        step = 0.5 * np.abs(right.q - left.q) + np.where(looked[:, None], 0.5 * bend, 0.0)
        room = np.ones(len(clear), dtype=np.bool_)
        for place, more in zip((left, right), added, strict=True):
            sent = place.q + more
            room &= ((sent - step >= low) & (sent + step <= high)).all(axis=1)
        way = np.linalg.norm(cga.translation(right.pose) - cga.translation(left.pose), axis=1)
        turn = np.linalg.norm(cga.rotation_vector(cga.compose(cga.reverse(left.pose), right.pose)),
                              axis=1)
        short = (way <= SHORT * self.mechanism.reach) & (turn <= SHORT)
        return np.asarray(clear & room & (short | looked), dtype=np.bool_)

    def _bend(self, left: Array, middle: Array, right: Array) -> Array:
        """Return the second difference of the joints (M, k), inf where it is not small."""
        bend, step = np.abs(left - 2.0 * middle + right), np.abs(right - left)
        out = np.ones(len(left), dtype=np.bool_)
        for quantity in set(self.mechanism.actuator_quantity):
            own = [q == quantity for q in self.mechanism.actuator_quantity]
            out &= bend[:, own].max(axis=1) <= BENT * step[:, own].max(axis=1)
        return np.where(out[:, None], bend, np.inf)

    def _wrong(self, at: _Places, sent: Array, before: Ints) -> Iterator[tuple[int, str]]:
        """Yield which places (M,) are unsound, and why."""
        low, high = self.mechanism.limits.T
        with np.errstate(invalid="ignore"):
            over = ((sent < low) | (sent > high)).any(axis=1)
            near = np.asarray(~(at.value >= SINGULAR * self.home_value), dtype=np.bool_)
        crossed = np.asarray(at.sign != self.home_sign, dtype=np.bool_)
        for n in np.flatnonzero(over | near | crossed):
            way = f"the straight way from row {before[n] + 1}"
            if not np.isfinite(at.value[n]):
                yield int(n), f"{way} leaves the machine's reach"
            elif crossed[n]:
                yield int(n), f"{way} goes through a singularity"
            elif near[n]:
                yield int(n), (f"{way} comes near a singularity: condition {at.value[n]:.2g}, "
                               f"{self.home_value:.2g} at home")
            else:
                yield int(n), f"{way} leaves the limits: {limit_reason(self.mechanism, sent[n])}"


def between(start: Array, end: Array, part: Array) -> Array:
    """Return motors (M, 8) at a part of the way: straight, with even rotation."""
    t = part[:, None]
    turn = cga.rotation_vector(cga.compose(cga.reverse(start), end))
    rotor = start.copy()
    rotor[:, 4:] = 0.0
    rotor = cga.compose(rotor, cga.motor_from_rotation_vector(t * turn, np.zeros(3)))
    place = (1.0 - t) * cga.translation(start) + t * cga.translation(end)
    return cga.compose(cga.translator(place), rotor)
