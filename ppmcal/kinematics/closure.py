"""Stacked closure, pose Jacobian A, joint Jacobian Jq, errors Bg.

The closure equations are stacked limb by limb into d rows, as many as the pose has coordinates:

    c(M, q, g) = 0,    A dpose + Jq dq + Bg dg = 0,

with dpose = (platform origin displacement, rotation) in base axes, restricted to the
machine's motion. All three matrices are derived from the same leg lines ([LIN] section 2.5,
[IK] eq. 32 and 49): A is the line about the platform origin, Jq and Bg its pairing with
the twist of each joint and slot.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.kinematics.limb_groups import LimbGroup, groups_of, slot_columns
from ppmcal.linalg import Array, Ints
from ppmcal.model.effects import Shift
from ppmcal.model.limbs import ClosureSurface
from ppmcal.model.limbs.chain import U
from ppmcal.model.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class Model:
    """A mechanism at parameter values ``g`` (P,); default its present ones.

    With a ``shift``, or with ``g`` (N, P), the model belongs to N rows: the first changes their
    slots row by row, the second gives each row a machine of its own (without effects).
    """

    mechanism: Mechanism
    g: Array | None = None
    shift: Shift | None = None

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Model:
        """Return the model for some of its rows."""
        if self.shift is not None:
            return replace(self, shift=self.shift.take(rows))
        return replace(self, g=self.g[rows]) if self.g is not None and self.g.ndim == 2 else self

    @cached_property
    def parameters(self) -> Array:
        """The parameters in use (P,) or (N, P)."""
        return self.mechanism.values if self.g is None else self.g

    @cached_property
    def limb_values(self) -> tuple[dict[str, Any], ...]:
        """Slots and directions of each limb; slots that differ from row to row are (N,)."""
        g = self.parameters
        values = [limb.slots.values(g) if g.ndim == 1 else limb.slots.of_many(g)
                  for limb in self.mechanism.limbs]
        out: list[dict[str, Any]] = [{**v, **limb.constants} for v, limb in
                                     zip(values, self.mechanism.limbs, strict=True)]
        for (limb, slot), change in (self.shift.slots if self.shift else {}).items():
            out[limb][slot] = out[limb].get(slot, 0.0) + change
        return tuple(out)

    @cached_property
    def tables(self) -> dict[object, object]:
        """Cached tables for the compiled loops, by kind (:mod:`compiled_limbs`)."""
        return {}

    def joint_coordinate(self, limb: int, q: Array) -> Array:
        """Return u = ratio q + offset of one limb with a drive, (N,); m or rad."""
        v = self.limb_values[limb]
        own = q[:, self.mechanism.limbs[limb].actuator]
        return np.asarray(v.get("ratio", 1.0) * own + v.get("offset", 0.0), dtype=float)

    def closure(self, q: Array, wanted: Collection[int] = ()) -> Closure:
        """Build all KGBs for joint values ``q`` (N, k) or (k,).

        ``wanted`` are the parameter indices whose columns Bg will be needed.
        """
        q = np.atleast_2d(np.asarray(q, dtype=float))
        every = set(wanted)
        fed = [limb.slots.feeds(every) for limb in self.mechanism.limbs]
        slots = tuple(tuple(names) for names, _ in fed)
        groups = groups_of(self.mechanism, self.limb_values, q, slots)
        return Closure(self, q, groups, slots, tuple(tuple(used) for _, used in fed))


@dataclass(frozen=True, eq=False)
class Closure:
    """The stacked closure equations of N poses with their joints locked at ``q`` (N, k).

    Groups that are ``turning`` have a surface that also depends on the pose, because the axes of
    a universal joint do not meet: here as if they met, after :meth:`at` with their offset.
    """

    model: Model
    q: Array
    groups: tuple[LimbGroup, ...]
    slots: tuple[tuple[str, ...], ...]
    columns: tuple[tuple[int, ...], ...]
    _turned: list[tuple[Array, Closure]] = field(default_factory=list)

    @property
    def turning(self) -> bool:
        """Whether the surface of a limb also depends on the pose."""
        return any(group.turning for group in self.groups)

    def at(self, pose: Array) -> Closure:
        """Return the closure with every joint of offset axes rotated as at motors ``pose`` (N, 8).

        At these poses c and all derivatives are those of the machine: the joint's own rotation
        makes c stationary, and so does no work. Unchanged if all axes meet.
        """
        if not self.turning:
            return self
        pose = np.atleast_2d(pose)
        if self._turned and np.array_equal(self._turned[0][0], pose):
            return self._turned[0][1]
        here = replace(self, groups=tuple(group.at(pose) for group in self.groups), _turned=[])
        self._turned[:] = [(pose.copy(), here)]
        return here

    @cached_property
    def bodies(self) -> tuple[ClosureSurface, ...]:
        """The surface of each limb, (n, k, ...), without twists."""
        own = {i: group.limb(place) for group in self.groups for place, i in enumerate(group.limbs)}
        return tuple(own[i] for i in range(len(own)))

    def _stacked(self, part: str) -> Array:
        """Return an array of all groups' surfaces, equation by equation: (n, d, ...)."""
        parts = [getattr(group.surface, part) for group in self.groups]
        d = self.model.mechanism.equations
        if len(parts) == 1:
            return np.reshape(parts[0], (parts[0].shape[0], d, *parts[0].shape[3:]))
        sizes = {p.shape[0] for p in parts}     # 1 where a surface is the same in all rows
        out = np.empty((0 if 0 in sizes else max(sizes), d, *parts[0].shape[3:]))
        for group, values in zip(self.groups, parts, strict=True):
            out[:, group.rows] = values
        return out

    @cached_property
    def fixed(self) -> Array:
        """Base-side KGB vectors (1 or N, d, 5)."""
        return self._stacked("fixed")

    @cached_property
    def moving(self) -> Array:
        """Platform-side KGB vectors (1 or N, d, 5)."""
        return self._stacked("moving")

    @cached_property
    def scale(self) -> Array:
        """Factor that makes each inner product a length (1 or N, d)."""
        return self._stacked("scale")

    @cached_property
    def radius(self) -> Array:
        """Sphere radii (1 or N, d), 0 for planes."""
        return self._stacked("radius")

    @cached_property
    def point_moves(self) -> Array:
        """Whether the platform carries the point (d,)."""
        return np.array([m for limb in self.model.mechanism.limbs
                         for m in limb.kind.surface.point_moves])

    def carried(self, pose: Array) -> Array:
        """Platform-side vectors carried to the base frame by motors ``pose`` (N, 8)."""
        return cga.move_vector(np.atleast_2d(pose)[:, None, :], self.at(pose).moving)

    def misclosure(self, pose: Array) -> Array:
        """Return c (N, d), m: the inner product scaled to a length (exact where it is 0)."""
        here = self.at(pose)
        return here.scale * cga.inner(here.fixed, here.carried(pose))

    def lengths(self, pose: Array) -> Array:
        """Return c as true lengths (N, d), m: |x - C| - radius for spheres."""
        c, r = self.misclosure(pose), self.at(pose).radius
        return np.where(r > 0.0, np.sqrt(np.maximum(r * r + 2.0 * r * c, 0.0)) - r, c)

    def lines(self, pose: Array) -> Array:
        """Return the legs' lines (N, d, 6) in base axes: unit direction, moment.

        A platform twist B changes c by their pairing.
        """
        here = self.at(pose)
        return here._lines(here.carried(pose))

    def misclosure_and_lines(self, pose: Array) -> tuple[Array, Array]:
        """Return c (N, d), m, and the legs' lines (N, d, 6), as from the two methods."""
        here = self.at(pose)
        moved = here.carried(pose)
        return here.scale * cga.inner(here.fixed, moved), here._lines(moved)

    def _lines(self, moved: Array) -> Array:
        here, carries = self, self.point_moves[:, None]
        point = np.where(carries, moved, here.fixed)
        surface = np.where(carries, here.fixed, moved)
        sign = np.where(here.point_moves, 1.0, -1.0)
        return (sign * here.scale)[..., None] * cga.leg_line(point, surface)

    def contacts(self, pose: Array) -> Array:
        """Return the points at which the legs act on the platform (N, d, 3), base axes."""
        here = self.at(pose)
        return cga.coordinates(np.where(here.point_moves[:, None], here.carried(pose), here.fixed))

    def pose_matrix(self, pose: Array, lines: Array | None = None) -> Array:
        """Return A (N, d, d): columns (origin displacement, rotation) of the motion."""
        lines = self.lines(pose) if lines is None else lines
        n, m = lines[..., :3], lines[..., 3:]
        t = cga.translation(np.atleast_2d(pose))[:, None, :]
        moment = m - np.stack([t[..., 1] * n[..., 2] - t[..., 2] * n[..., 1],
                               t[..., 2] * n[..., 0] - t[..., 0] * n[..., 2],
                               t[..., 0] * n[..., 1] - t[..., 1] * n[..., 0]], axis=-1)
        return np.concatenate([n, moment], axis=-1)[..., self.model.mechanism.dof]

    def joint_matrix(self, pose: Array, lines: Array | None = None, drive: bool = True) -> Array:
        """Return Jq = dc/dq (N, d, k), m per unit of q; dc/du without the ``drive`` ratio."""
        lines = self.lines(pose) if lines is None else lines
        out = np.zeros((*lines.shape[:2], len(self.model.mechanism.actuators)))
        for group, turned in zip(self.groups, self.at(pose).groups, strict=True):
            if not group.kind.driven:
                continue
            own = turned if group.kind.pulley else group
            rows = own.slot_columns(own.of_rows(lines), pose, (U,))[..., 0]
            if drive and "ratio" in group.values:
                rows = rows * group.values["ratio"][..., None]
            out[:, group.rows, group.actuators[:, None]] = rows
        return out

    def error_blocks(self, pose: Array, lines: Array | None = None
                     ) -> list[tuple[slice, tuple[int, ...], Array]]:
        """Return Bg limb by limb: (rows, parameter indices, block (N, k, P_limb))."""
        return [(slice(int(rows[0]), int(rows[-1]) + 1), columns, block[:, place])
                for own, named, block in self.error_groups(pose, lines)
                for place, (rows, columns) in enumerate(zip(own, named, strict=True))]

    def error_groups(self, pose: Array, lines: Array | None = None
                     ) -> list[tuple[Ints, tuple[tuple[int, ...], ...], Array]]:
        """Return Bg for groups of limbs with equal numbers of columns.

        Returns:
            rows (L, k), parameter indices of each limb (L times P) and blocks (N, L, k, P).
        """
        here = self.at(pose)
        lines = here.lines(pose) if lines is None else lines
        out = []
        for group in here.groups:
            names = tuple(dict.fromkeys(s for i in group.limbs for s in self.slots[i]))
            if not names:
                continue
            raw = group.slot_columns(group.of_rows(lines), pose, names)
            if "ratio" in names:
                raw[..., names.index("ratio")] *= self.q[:, group.actuators, None]
            alike: dict[int, list[int]] = {}
            for place, i in enumerate(group.limbs):
                alike.setdefault(len(self.columns[i]), []).append(place)
            for count, places in alike.items():
                limbs = [group.limbs[place] for place in places]
                chain = np.stack([self.model.mechanism.limbs[i].slots.jacobian(
                    self.model.parameters, names, self.columns[i]) for i in limbs])
                if count:
                    part = raw if len(places) == len(group.limbs) else raw[:, places]
                    out.append((group.rows[places], tuple(self.columns[i] for i in limbs),
                                part @ chain))
        return out

    def slot_matrix(self, pose: Array, limb: int, slots: Sequence[str],
                    lines: Array | None = None) -> Array:
        """Return dc/dslot of one limb; zero in the other limbs' rows.

        Args:
            pose: closed platform motors (N, 8).
            limb: index of the limb.
            slots: names of its S slots.
            lines: of the legs, if already known.

        Returns:
            (N, d, S), m per m or rad of a slot.
        """
        lines = self.lines(pose) if lines is None else lines
        group = next(g for g in self.groups if limb in g.limbs)
        rows = group.rows[group.limbs.index(limb)]
        kind = group.kind
        values = dict(self.model.limb_values[limb])
        if kind.driven:
            values[U] = self.model.joint_coordinate(limb, self.q)
        body = kind.evaluate(values, {U, *slots}, np.atleast_2d(pose))
        out = np.zeros((*lines.shape[:2], len(slots)))
        out[:, rows[0]:rows[-1] + 1] = slot_columns(body, lines[:, rows], pose, slots)
        return out

    def error_matrix(self, pose: Array, wanted: Sequence[int], lines: Array | None = None) -> Array:
        """Return Bg (N, d, len(wanted)), dense, columns in the order of ``wanted``."""
        place = {p: i for i, p in enumerate(wanted)}
        blocks = self.error_blocks(pose, lines)
        n = np.atleast_2d(pose).shape[0]
        out = np.zeros((n, self.model.mechanism.equations, len(place)))
        for rows, columns, block in blocks:
            out[:, rows, [place[c] for c in columns]] += block
        return out
