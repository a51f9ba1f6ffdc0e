"""Limbs of one kind evaluated together, along a limb axis, and not one by one.

Six legs of a kind then cost the calls of one. Limbs are grouped if they are of the same kind, have
the same given directions, and turn (:mod:`ppmcal.model.limbs.axis_offset`, :mod:`~.pulley`) or not.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array, Ints
from ppmcal.model.limbs import ClosureSurface
from ppmcal.model.limbs.chain import U
from ppmcal.model.limbs.kind import LimbKind, Still
from ppmcal.model.mechanism import Limb, Mechanism

DEFAULTS = {"ratio": 1.0}
"""Value of a slot that only some limbs of a group have; of all other slots 0."""


@dataclass(frozen=True, eq=False)
class LimbGroup:
    """L limbs of one kind, evaluated together.

    Attributes:
        kind: of all of them.
        limbs: their indices in the mechanism (L,).
        rows: the closure equations of each (L, k).
        actuators: of each (L,); empty for passive ones (0,).
        values: slots (1 or N, L) and directions (1, L, 3), SI, with ``u`` if they are driven.
        wanted: slots whose twists are available, ``u`` among them.
        turning: whether the surface also depends on the pose.
        pose: motors (N, 8) at which offset joints are solved, None if their axes meet.
        still: the pose-independent part of pulleys, if known.
    """

    kind: LimbKind
    limbs: tuple[int, ...]
    rows: Ints
    actuators: Ints
    values: Mapping[str, Array]
    wanted: frozenset[str]
    turning: bool
    pose: Array | None = None
    still: Still | None = None

    @cached_property
    def surface(self) -> ClosureSurface:
        """The KGBs of all of them, (n, L, k, ...)."""
        pose = None if self.pose is None else self.pose[:, None, :]
        return _evaluated(self.kind, self.values, self.wanted, pose, self.still, len(self.limbs))

    @cached_property
    def _still(self) -> Still | None:
        return self.kind.still(self.values, self.wanted) if self.kind.pulley else None

    def at(self, pose: Array) -> LimbGroup:
        """Return the group with its offset joints rotated as at motors (N, 8)."""
        if not self.turning:
            return self
        return replace(self, turning=False, pose=pose, still=self._still)

    def of_rows(self, whole: Array) -> Array:
        """Return the group's part (n, L, k, ...) of an array (n, d, ...)."""
        if self.contiguous is not None:
            part = whole[:, self.contiguous]
            return part.reshape(part.shape[0], *self.rows.shape, *part.shape[2:])
        return whole[:, self.rows]

    @cached_property
    def contiguous(self) -> slice | None:
        """The rows as a slice, None if other limbs are in between."""
        flat = self.rows.ravel()
        whole = flat.size and np.array_equal(flat, np.arange(flat[0], flat[0] + flat.size))
        return slice(int(flat[0]), int(flat[-1]) + 1) if whole else None

    def limb(self, place: int) -> ClosureSurface:
        """Return the surface of one limb (n, k, ...), without its twists."""
        s = self.surface
        return ClosureSurface(s.fixed[:, place], s.moving[:, place], s.scale[:, place],
                              s.radius[:, place], s.point_moves, s.middle_lines[:, place],
                              (), (), ())

    def slot_columns(self, lines: Array, pose: Array, slots: Sequence[str]) -> Array:
        """Return dc/dslot (N, L, k, S): line (N, L, k, 6) against frame twist, chain by chain."""
        return slot_columns(self.surface, lines, pose, slots)


def groups_of(mechanism: Mechanism, limb_values: Sequence[Mapping[str, Any]], q: Array,
              wanted: Sequence[Collection[str]]) -> tuple[LimbGroup, ...]:
    """Return all limbs, grouped by kind.

    Args:
        mechanism: the machine.
        limb_values: slots and directions of each limb; slots may be (N,).
        q: joint values (N, k).
        wanted: slots of each limb whose twists will be needed, without ``u``.
    """
    first = np.cumsum([0, *(limb.kind.surface.equations for limb in mechanism.limbs)])
    together: dict[tuple[Any, ...], list[int]] = {}
    for i, limb in enumerate(mechanism.limbs):
        turns = limb.kind.turns(limb_values[i], wanted[i])
        key = (limb.kind.name, tuple(sorted(limb.constants)), turns)
        together.setdefault(key, []).append(i)
    out = []
    for (_, _, turning), limbs in together.items():
        kind = mechanism.limbs[limbs[0]].kind
        actuators = np.array([mechanism.limbs[i].actuator for i in limbs if kind.driven],
                             dtype=np.int64)
        values = _stacked([mechanism.limbs[i] for i in limbs], [limb_values[i] for i in limbs])
        if kind.driven:
            values[U] = values.get("ratio", 1.0) * q[:, actuators] + values.get("offset", 0.0)
        names = frozenset({U, *(n for i in limbs for n in wanted[i])})
        rows = np.array([first[i] + np.arange(kind.surface.equations) for i in limbs])
        out.append(LimbGroup(kind, tuple(limbs), rows, actuators, values, names, turning))
    return tuple(out)


def _evaluated(kind: LimbKind, values: Mapping[str, Any], wanted: Collection[str],
               pose: Array | None, still: Still | None, count: int) -> ClosureSurface:
    """Return the surfaces of ``count`` limbs, each array with an entry for every limb."""
    found = kind.evaluate(values, wanted, pose, still)

    def each(part: Array) -> Array:
        return part if part.shape[1] == count else np.broadcast_to(
            part, (part.shape[0], count, *part.shape[2:]))

    return replace(found, fixed=each(found.fixed), moving=each(found.moving),
                   scale=each(found.scale), radius=each(found.radius),
                   middle_lines=each(found.middle_lines))


def _stacked(limbs: Sequence[Limb], limb_values: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return slots (1 or N, L) and directions (1, L, 3) of several limbs."""
    out: dict[str, Any] = {name: np.array([[limb.constants[name] for limb in limbs]])
                           for name in limbs[0].constants}
    for name in dict.fromkeys(n for values in limb_values for n in values):
        if name not in out:
            parts = [values.get(name, DEFAULTS.get(name, 0.0)) for values in limb_values]
            out[name] = np.array([parts]) if all(isinstance(p, float) for p in parts) else (
                np.stack(np.broadcast_arrays(*(np.atleast_1d(p) for p in parts)), axis=-1))
    return out


def slot_columns(body: ClosureSurface, lines: Array, pose: Array, slots: Sequence[str]) -> Array:
    """Return dc/dslot (N, ..., k, S): line (N, ..., k, 6) against frame twist, chain by chain.

    ``offset`` and ``ratio`` move the joint coordinate u itself.
    """
    names = [U if s in ("offset", "ratio") else s for s in slots]
    out = np.zeros((*lines.shape[:-1], len(slots)))
    filled = set[int]()

    def fill(sign: float, twists: Sequence[Any], wrench: Array) -> None:
        for group in twists:
            mine = [i for i, n in enumerate(names) if n in group.names]
            if mine:
                picked = [group.names.index(names[i]) for i in mine]
                part = sign * group.pairing(wrench, picked)
                # a pulley's radius moves the rope's exit, and the part of the rope on the pulley
                out[..., mine] = part if filled.isdisjoint(mine) else out[..., mine] + part
                filled.update(mine)

    if body.base:
        fill(-1.0, body.base, lines)
    if body.middle:
        fill(-1.0, body.middle, body.middle_lines)
    if body.platform:
        back = cga.reverse(np.atleast_2d(pose))
        back = back.reshape(back.shape[0], *(1,) * (lines.ndim - 2), 8)
        fill(1.0, body.platform, cga.move_line(back, lines))
    return out
