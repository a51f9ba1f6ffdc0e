"""Response of predicted rows to shifts of any kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit.observation import ResidualJacobian
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.compiled_limbs import compiled_limbs
from ppmcal.kinematics.effect_response import effect_terms, setting
from ppmcal.kinematics.equilibrium import platform_pose
from ppmcal.kinematics.least_squares_closure import closed_by, held_by, surplus
from ppmcal.kinematics.registration import displacement_twists
from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import Environment
from ppmcal.model.effects import Setting, Shift

KEPT, MOST = 16384, 32
"""Maximum numbers of rows, and of sets of rows, kept in :class:`RowsAtRest`."""


@dataclass(frozen=True, eq=False)
class ClosedRows:
    """The closure of n rows at poses (n, 8), and quantities that depend on these alone, cached."""

    closure: Closure
    pose: Array

    @cached_property
    def lines(self) -> Array:
        """The legs' lines (n, d, 6) in base axes."""
        return self.closure.lines(self.pose)

    @cached_property
    def pose_matrix(self) -> Array:
        """Derivative of the closure equations by the pose (n, e, d)."""
        return self.closure.pose_matrix(self.pose, self.lines)

    @cached_property
    def joint_matrix(self) -> Array:
        """Derivative of the closure equations by joint values (n, e, k)."""
        return self.closure.joint_matrix(self.pose, self.lines)

    def same(self, model: Model, q: Array, pose: Array) -> bool:
        """Whether this is the closure of a model at joint values (n, k) and poses (n, 8)."""
        own = self.closure
        return (own.model.mechanism is model.mechanism and np.array_equal(self.pose, pose)
                and np.array_equal(own.q, q)
                and np.array_equal(own.model.parameters, model.parameters))


@dataclass(eq=False)
class RowsAtRest:
    """Closed rows, the latest last, for fits in which only frames and targets move.

    Registrations compute the same rows hundreds of times, and their geometry is most of the work.
    """

    known: list[ClosedRows] = field(default_factory=list)

    def of(self, model: Model, q: Array, pose: Array) -> ClosedRows:
        """Return the closed rows of a model without effects at joints (n, k) and poses (n, 8)."""
        for one in self.known:
            if one.same(model, q, pose):
                return one
        self.known.append(ClosedRows(model.closure(q), pose))
        while len(self.known) > MOST or sum(len(one.pose) for one in self.known[:-1]) > KEPT:
            del self.known[0]
        return self.known[-1]


@dataclass(frozen=True, eq=False)
class Response:
    """Response of the predictions of n rows to shifts of any kind.

    The poses of ``closed`` are number ``end`` of those seen. ``surplus``: for machines with
    more equations than freedoms, the basis N (n, e, s), and the place of N' c among the m values.
    ``target``: name of the data set, which picks its own shift of a single target.
    """

    closed: ClosedRows
    seen: ResidualJacobian
    surroundings: Callable[[], Environment]
    end: int = 0
    surplus: tuple[Array, slice] | None = None
    target: str = ""

    @cached_property
    def rows(self) -> Environment:
        """The environment of the rows."""
        return self.surroundings()

    @property
    def closure(self) -> Closure:
        """The closure of the rows."""
        return self.closed.closure

    @property
    def pose(self) -> Array:
        """The closed poses (n, 8)."""
        return self.closed.pose

    @property
    def lines(self) -> Array:
        """The legs' lines (n, d, 6) in base axes."""
        return self.closed.lines

    @cached_property
    def by_pose(self) -> Array:
        """Derivative of predictions by displacement and rotation of the closed pose (n, m, 6)."""
        by_pose, shift = self.seen.by_poses[self.end], self.closure.model.shift
        if shift is None or shift.pose is None or self.seen.inside is not None:
            return by_pose
        # a rotation of the closed pose appears rotated by the effects' own rotation
        turn = cga.motor_from_rotation_vector(shift.pose[:, 3:], np.zeros(3))
        return np.concatenate([by_pose[..., :3], by_pose[..., 3:] @ cga.rotation_matrix(turn)],
                              axis=-1)

    @cached_property
    def by_equation(self) -> Array:
        """Derivative of predictions by the closure equations (n, m, e): -by_pose A^-1."""
        matrix = self.closed.pose_matrix
        by_pose = self.by_pose[..., self.closure.model.mechanism.dof]
        out = -np.swapaxes(held_by(self.closure, self.pose, matrix, np.swapaxes(by_pose, -1, -2),
                                   self.lines), -1, -2)
        if self.surplus is not None:
            basis, place = self.surplus
            out[:, place] = np.swapaxes(basis, -1, -2)
        return out

    @cached_property
    def by_joint(self) -> Array:
        """Derivative of predictions by joint values (n, m, k)."""
        out = np.asarray(self.by_equation @ self.closed.joint_matrix)
        if self.seen.inside is not None:
            out[:, 0] += self.seen.inside.by_joint
        return out

    def geometry_columns(self, out: Array, free: Sequence[int], homing: slice) -> None:
        """Set the columns of geometry and of homing offsets in ``out`` (n, m, C), zero before."""
        place = {p: c for c, p in enumerate(free)}
        shifted = homing.stop > homing.start
        self._limb_columns(out, place)
        tables = None if self.seen.inside else compiled_limbs(self.closure, len(self.pose))
        if tables is not None and tables.error_columns(
                self.pose, self.by_pose, place, out, homing.start if shifted else None):
            return
        for rows, parameters, block in self.closure.error_groups(self.pose, self.lines):
            # (n, L, m, k) times (n, L, k, P), a limb at a time where limbs share a parameter
            parts = np.moveaxis(self.by_equation[..., rows], 1, 2) @ block
            columns = [[place[p] for p in own] for own in parameters]
            flat = [c for own in columns for c in own]
            if len(set(flat)) == len(flat):
                out[..., flat] += np.moveaxis(parts, 1, 2).reshape(*out.shape[:2], -1)
                continue
            for limb, own in enumerate(columns):
                out[..., own] += parts[:, limb]
        if shifted:
            out[..., homing] += self.by_joint

    def _limb_columns(self, out: Array, place: dict[int, int]) -> None:
        """Add the derivative of an encoder's reading by its limb, with the platform at rest."""
        inside = self.seen.inside
        if inside is None:
            return
        columns = self.closure.columns[inside.limb]
        if columns:
            out[:, 0, [place[p] for p in columns]] += inside.by_parameters(
                columns, self.closure.slots[inside.limb])

    @cached_property
    def _by_slot(self) -> dict[tuple[int, str], Array]:
        return {}

    def by_slot(self, limb: int, slot: str) -> Array:
        """Return d prediction/d slot (n, m)."""
        if (limb, slot) not in self._by_slot:
            block = self.closure.slot_matrix(self.pose, limb, (slot,), self.lines)
            self._by_slot[limb, slot] = (self.by_equation @ block)[..., 0]
            if self.seen.inside is not None and self.seen.inside.limb == limb:
                self._by_slot[limb, slot][:, 0] += self.seen.inside.by_slots((slot,))[:, 0]
        return self._by_slot[limb, slot]

    def column(self, shift: Shift) -> Array:
        """Return the derivative of predictions (n, m) along a shift."""
        out = np.zeros(self.seen.residual.shape)
        for (limb, slot), change in shift.slots.items():
            out += self.by_slot(limb, slot) * np.broadcast_to(change, (len(out),))[:, None]
        if self.seen.inside is not None:
            return out    # a shift of the platform after its limbs does not move their joints
        if shift.pose is not None:
            out += (self.seen.by_poses[self.end] @ shift.pose[..., None])[..., 0]
        now = self.closure.model.shift
        for twist in displacement_twists(self.platform, shift.of(self.target),
                                         None if now is None else now.of(self.target)):
            out += (self.seen.by_poses[self.end] @ twist[..., None])[..., 0]
        if shift.stretch is not None:
            moved = shift.stretch @ self.seen.points[self.end][..., None]
            out += (self.seen.by_points[self.end] @ moved)[..., 0]
        return out

    @cached_property
    def platform(self) -> Array:
        """Platform pose (n, 8), including effects that move it."""
        return platform_pose(self.pose, self.closure.model.shift)

    def setting(self, stood: Ints | None = None) -> Setting:
        """Return the setting of these rows for effects; ``stood``: see :class:`Environment`."""
        rows = self.rows if stood is None else replace(self.rows, stood=stood)
        model = self.closure.model
        return setting(replace(model, shift=None), rows, self.closure.q, self.pose, model)

    def effect_columns(self, out: Array, free: Sequence[int]) -> None:
        """Fill the columns of free effect parameters (n, m, C), in place.

        The change of an actuator's load with the pose is neglected: its size is deflection
        over reach, and it affects only the step, not the minimum.
        """
        model = self.closure.model
        if not model.mechanism.effects:
            return
        place = {p: c for c, p in enumerate(free)}
        for effect, terms in effect_terms(model.mechanism, model.parameters, self.setting()):
            for name, p in effect.parameters.items():
                if p in place:
                    out[..., place[p]] += self.column(terms.by[name])


def with_surplus(seen: ResidualJacobian, closures: Sequence[Closure], poses: Sequence[Array]
                 ) -> tuple[ResidualJacobian, list[tuple[Array, slice] | None]]:
    """Return residuals with the closure that no pose explains appended, which is 0 in theory.

    Args:
        seen: of n rows.
        closures: the closure at each of the poses seen.
        poses: platform motors (n, 8) of each, close to those by joints alone.

    Returns:
        Residuals (n, m + s) in all, m; and for each pose the basis N (n, e, s) with its place.
    """
    bases: list[tuple[Array, slice] | None] = []
    gaps, residual = [], seen.residual
    first = seen.residual.shape[1]
    for closure, pose, by_pose in zip(closures, poses, seen.by_poses, strict=True):
        c, lines = closure.misclosure_and_lines(pose)
        a = closure.pose_matrix(pose, lines)
        own = surplus(closure.model.mechanism, a)
        gaps.append((np.swapaxes(own, -1, -2) @ c[..., None])[..., 0])
        # the poses need not be those by joints alone: refer the residuals to those
        by_joints = closed_by(closure, pose, a, c[..., None], lines)
        residual = residual + (by_pose[..., closure.model.mechanism.dof] @ by_joints)[..., 0]
        bases.append((own, slice(first, first + own.shape[-1])))
        first += own.shape[-1]
    residual = np.where(seen.observed, residual, 0.0)
    return replace(seen, residual=residual).beside(-np.concatenate(gaps, axis=1)), bases
