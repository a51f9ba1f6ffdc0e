"""Limbs as tables for the compiled path, derived from their declarations.

A limb kind needs nothing extra: chains whose steps say which of them is driven
(:mod:`ppmcal.model.limbs.driven`) and a surface that declares its equations
(:class:`ppmcal.model.limbs.kind.EquationForm`) are enough. If one limb of a machine has
no such form (a plug-in's own step or surface, a universal joint whose axes do not meet, an effect
that changes a length from row to row), the NumPy path of :mod:`closure` is taken for all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Closure
from ppmcal.kinematics.entry_tables import entry_tables
from ppmcal.kinematics.least_squares_closure import EXACT, SMALL
from ppmcal.kinematics.limb_groups import LimbGroup
from ppmcal.kinematics.limb_tables import EntryTables, LimbTables
from ppmcal.linalg import Array, Bools
from ppmcal.model.limbs.chain import U, cross_matrix
from ppmcal.model.limbs.driven import DrivenChain, cut_at_drive
from ppmcal.model.mechanism import Mechanism

MANY = 1000
"""From this many rows on the compiled path is worth its import, half a second if cached."""
SURPLUS = 10
"""A row of surplus limbs counts as this many: its pose is sought twice, in longer searches."""
FORMS = {"sphere": 0, "base plane": 1, "platform plane": 2, "angle": 3,
         "between axes": 4, "over sheave": 5, "over swivel": 6}
OVER = ("over sheave", "over swivel")
ROUND = ("sphere", *OVER)
"""Forms of equations whose second derivative by the pose is that of a sphere."""
STILL, SLIDES, TURNS = 0, 1, 2
CHAINS = 3


@dataclass(frozen=True, eq=False)
class CompiledLimbs:
    """A closure whose limbs all have a compiled form.

    Attributes:
        closure: of N rows.
        limbs: its tables.
        u: joint coordinates (N, L).
        chains: of each group of limbs, split at the drive.
    """

    closure: Closure
    limbs: LimbTables
    u: Array
    chains: tuple[tuple[DrivenChain, ...], ...]

    def newton(self, pose: Array, iterations: int, smallest: float, closed: float,
               most: float = np.inf) -> tuple[Array, Bools, Array, Array]:
        """Solve the closure for the motors, row by row; see :func:`forward.newton`.

        Args:
            pose: motors (N, 8) to start from.
            iterations: maximum number of iterations.
            smallest: a step below this part of the length scale, or rad, ends the search,
            closed: together with a misclosure below this part of the reach.
            most: for surplus limbs, rows whose second step is above this part of the first
                are abandoned.

        Returns:
            motors (N, 8), converged (N,), lengths of the first two steps (N, 2), signs of det A
            (N, 2) at the start and at the end; a tall A has none.
        """
        mechanism = self.closure.model.mechanism
        pose = np.array(pose, dtype=float)
        given = (self.limbs, self._each(self.u, len(pose)), pose, mechanism.length_scale,
                 mechanism.reach, iterations, smallest)
        if mechanism.surplus:
            from ppmcal.kinematics.compiled_surplus import newton_rows as least

            gaps = mechanism.gap_sigma
            noise = (mechanism.usual_joint_noise[[limb.actuator for limb in mechanism.limbs]]
                     if gaps.any() else np.ones(len(mechanism.limbs)))
            return pose, *least(*given, most, EXACT, SMALL * gaps.any(), noise,
                                gaps), np.ones((len(pose), 2))
        from ppmcal.kinematics.compiled_closure import newton_rows

        return pose, *newton_rows(*given, closed)

    def gap_squares(self, pose: Array) -> Array:
        """Return the sum of the squared gaps of surplus limbs, as true lengths (N,), m^2."""
        from ppmcal.kinematics.compiled_surplus import gap_squares

        return gap_squares(self.limbs, self._each(self.u, len(pose)),
                           np.ascontiguousarray(pose))

    def error_columns(self, pose: Array, by_pose: Array, place: Mapping[int, int], out: Array,
                      homing: int | None = None) -> bool:
        """Set columns of the Jacobian of what is observed, -by_pose A^-1 (Bg, Jq).

        Args:
            pose: closed platform motors (N, 8).
            by_pose: d observed/d(platform origin displacement, rotation) (N or 1, m, 6).
            place: parameter -> its column; those for which the closure was built.
            out: (N, m, C), in place, contiguous.
            homing: column of the first joint's offset, if those are wanted.

        Returns:
            Whether there is such a form; if not, nothing is set.
        """
        entries = self.entries(place, homing)
        if entries is None or self.closure.model.mechanism.surplus:
            return False
        from ppmcal.kinematics.compiled_closure import fill_columns

        count = len(pose)
        fill_columns(self.limbs, entries, self._each(self.u, count),
                     self._each(self.closure.q, count), np.ascontiguousarray(pose),
                     np.ascontiguousarray(by_pose), out)
        return True

    def entries(self, place: Mapping[int, int], homing: int | None) -> EntryTables | None:
        """Return the entries of columns, None if a drive ratio changes from row to row."""
        return entry_tables(self.closure, self.chains, place, homing)

    @staticmethod
    def _each(values: Array, count: int) -> Array:
        return np.ascontiguousarray(np.broadcast_to(values, (count, values.shape[1])))


def worth(mechanism: Mechanism, rows: int) -> int:
    """Return the cost of so many rows in rows of a machine without surplus limbs."""
    return rows * SURPLUS if mechanism.surplus else rows


def pays(mechanism: Mechanism, rows: int) -> bool:
    """Whether there are enough rows for the compiled path, if the machine has one."""
    return worth(mechanism, rows) >= MANY


def compiled_limbs(closure: Closure, rows: int) -> CompiledLimbs | None:
    """Return a closure's compiled form for so many rows; None to use NumPy."""
    mechanism = closure.model.mechanism
    if not pays(mechanism, rows) or closure.model.parameters.ndim > 1:
        return None
    if mechanism.surplus and not _each_driven(mechanism):
        return None
    made = _tables(closure)
    if made is None:
        return None
    limbs, chains = made
    u = np.zeros((max(g.values[U].shape[0] for g in closure.groups if g.kind.driven),
                  len(mechanism.limbs)))
    for group in closure.groups:
        if group.kind.driven:
            u[:, list(group.limbs)] = group.values[U]
    return CompiledLimbs(closure, limbs, u, chains)


Tables = tuple[LimbTables, tuple[tuple[DrivenChain, ...], ...]]


def _tables(closure: Closure) -> Tables | None:
    """Return a closure's tables with its chains, cached if the model is the same for all rows."""
    model = closure.model
    if model.shift is not None:
        return _made(closure)
    key = tuple((group.wanted, group.turning, group.pose is None) for group in closure.groups)
    if key not in model.tables:
        model.tables[key] = _made(closure)
    return cast(Tables | None, model.tables[key])


def _made(closure: Closure) -> Tables | None:
    mechanism = closure.model.mechanism
    first = np.cumsum([0, *(limb.kind.surface.equations for limb in mechanism.limbs)])
    count = len(mechanism.limbs)
    ends, drive = np.zeros((count, CHAINS, 3, 12)), np.zeros((count, CHAINS), dtype=np.int64)
    form, axis, other = np.zeros((3, int(first[-1])), dtype=np.int64)
    wheel = np.zeros(count)
    every = []
    for group in closure.groups:
        kind, own = group.kind, list(group.limbs)
        forms = kind.surface.forms
        if not _has_form(group):
            return None
        parts = [cut_at_drive(chain, group.values, group.wanted, len(own))
                 for chain in (kind.base, kind.middle, kind.platform)]
        if kind.pulley:
            wheel[own] = group.values[kind.pulley.radius][0]
            parts[1] = parts[1] and _with_wheel(parts[1], kind.pulley.radius, forms[0].axis)
        chains = tuple(p for p in parts if p is not None)
        moved = [m for m in map(_ends, chains) if m is not None]
        if len(moved) < CHAINS:
            return None
        for k, (how, where) in enumerate(moved):
            drive[own, k], ends[own, k] = how, where
        form[group.rows], axis[group.rows] = [FORMS[f.name] for f in forms], [f.axis for f in forms]
        other[group.rows] = [f.other for f in forms]
        every.append(chains)
    return LimbTables(ends, drive, first, np.repeat(np.arange(count), np.diff(first)), form, axis,
                      other, np.array(mechanism.dof), wheel), tuple(every)


def _each_driven(mechanism: Mechanism) -> bool:
    """Whether each limb is one sphere, or equivalent to one, with a drive of its own."""
    drives = [limb.actuator for limb in mechanism.limbs]
    return len(set(drives)) == len(drives) and all(
        len(limb.kind.surface.forms) == 1 and limb.kind.surface.forms[0].name in ROUND
        for limb in mechanism.limbs)


def _has_form(group: LimbGroup) -> bool:
    """Whether surfaces depend on the pose only by pulleys that the compiled loops know."""
    kind, forms = group.kind, group.kind.surface.forms
    if group.pose is not None or not forms or any(f.name not in FORMS for f in forms):
        return False
    over = any(f.name in OVER for f in forms)
    if kind.pulley is None or not over:
        return not over and not (group.turning and kind.is_turned(group.values, group.wanted))
    return len(np.asarray(group.values[kind.pulley.radius])) == 1


def _with_wheel(rope: DrivenChain, radius: str, axis: int) -> DrivenChain:
    """Return a rope's chain with its pulley's radius as a rotation about the rope.

    It stands for what the pose decides: the rope's line has a moment about itself that is
    the decrease of c by the radius (:func:`compiled_closure.middles_at`).
    """
    turn = np.broadcast_to(np.eye(6)[axis], rope.drive.shape)
    return replace(rope, still={**rope.still, radius: turn})


def _ends(chain: DrivenChain) -> tuple[int, Array] | None:
    """Return how a chain of L limbs moves and its ends (L, 3, 12), None for a screw."""
    w, v = chain.drive[:, :3], chain.drive[:, 3:]
    turns, slides = bool(w.any()), bool(v.any())
    if turns and (slides or np.any(np.abs(np.sum(w * w, axis=-1) - 1.0) > 1e-15)):
        return None
    before, after = (_matrix(m) for m in (chain.before, chain.after))
    parts = np.zeros((len(w), 3, 4, 4))
    if turns:
        along = w[:, :, None] * w[:, None, :]
        parts[:, 0, :3, :3], parts[:, 0, 3, 3] = along, 1.0
        parts[:, 1, :3, :3], parts[:, 2, :3, :3] = np.eye(3) - along, cross_matrix(w)
    else:
        parts[:, 0], parts[:, 1, :3, 3] = np.eye(4), v
    whole = before[:, None] @ parts @ after[:, None]
    out = np.concatenate([whole[..., :3, :3].reshape(len(w), 3, 9), whole[..., :3, 3]], axis=-1)
    return TURNS if turns else SLIDES if slides else STILL, out


def _matrix(motor: Array) -> Array:
    """Return motors (L, 8) as homogeneous matrices (L, 4, 4)."""
    out = np.zeros((len(motor), 4, 4))
    out[:, :3, :3], out[:, :3, 3] = cga.rotation_matrix(motor), cga.translation(motor)
    out[:, 3, 3] = 1.0
    return out
