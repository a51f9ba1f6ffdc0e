"""Named parameters, and how limb slots follow from them.

A parameter is one number that identification may change. Most feed one slot of one limb; a shared
one feeds several slots, and the radius and angle of a point each feed two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import lru_cache

import numpy as np

from ppmcal.linalg import Array

RATIO = "ratio"
"""Name and class of the slot that holds a drive ratio."""
NO_TOLERANCE = "no tolerance"
"""The topic of notes on tolerances that a file does not give, so that defaults apply."""

RIGID = 1e-6
"""Ratio to the nominal value below which a reciprocal counts as 0."""


@dataclass(frozen=True)
class Parameter:
    """One scalar of the machine, SI.

    Attributes:
        name: the slot's path, ``leg1.base.point.x``, or the name that several slots share.
        quantity: ``length`` or ``angle``; for effects also a quotient, ``length/N``.
        value: present value; nominal: the value as designed.
        tolerance: one standard deviation; inf for no prior, None if not stated.
        fixed: the file says it must not change.
        tolerance_class: of its first slot: ``point``, ``length``, ``angle`` or ``offset``, the key
            of the file's ``tolerances`` that covers it; ``ratio`` has none; empty for effects.
        aliases: slot paths that it feeds, for pattern matching.
        sigma: standard deviation from an earlier identification, or None.
        free: marked as to be fitted, with or without a tolerance (effects).
        size: a significant change, SI, where no tolerance gives one; None for geometry.
        reciprocal: predictions are linear in 1/value; steps are taken in it.
        nonlinear: the effect is not linear in this parameter.
    """

    name: str
    quantity: str
    value: float
    nominal: float
    tolerance: float | None = None
    fixed: bool = False
    tolerance_class: str = ""
    aliases: tuple[str, ...] = ()
    sigma: float | None = None
    free: bool = False
    size: float | None = None
    reciprocal: bool = False
    nonlinear: bool = False

    @property
    def per_unit(self) -> bool:
        """Whether it is a drive ratio (quantity per unit of the joint variable)."""
        return self.tolerance_class == RATIO

    @property
    def prior_sigma(self) -> float | None:
        """The tolerance if finite and above 0, otherwise None: no prior, or fixed by it."""
        tau = self.tolerance
        return tau if tau is not None and np.isfinite(tau) and tau > 0.0 else None

    def stepped(self, value: float, step: float) -> float:
        """Return the value after a Gauss-Newton step; a reciprocal one keeps its sign.

        With c = 1/value the step is dc = -step c^2, limited so that c falls at most to a tenth and
        not below :data:`RIGID` of nominal, which is practically rigid. However often it is
        reduced, the value never reaches 0.
        """
        if not self.reciprocal:
            return value + step
        most = max(abs(self.nominal) / RIGID, abs(value))
        least, moved = float(np.finfo(float).tiny), abs(value) / max(1.0 - step / value, 0.1)
        return float(np.copysign(np.clip(moved, least, most), value))

    def matches(self, pattern: str) -> bool:
        """Whether a shell pattern names this parameter or a slot that it feeds."""
        return any(fnmatchcase(n, pattern) for n in (self.name, *self.aliases))


@dataclass(frozen=True)
class SlotMap:
    """How the slots of one limb follow from the parameter vector g (P,).

    ``direct``: (slot name, parameter index). ``polar``: (slot x, slot y, index of the
    radius, index of the angle): x = r cos a, y = r sin a.
    """

    direct: tuple[tuple[str, int], ...]
    polar: tuple[tuple[str, str, int, int], ...] = ()

    def feeds_point(self, point: str) -> set[int]:
        """Return the parameters behind a point, ``base.point``."""
        own = {p for slot, p in self.direct if slot.rpartition(".")[0] == point}
        return own | {p for x, _, r, a in self.polar if x.rpartition(".")[0] == point
                      for p in (r, a)}

    def values(self, g: Array) -> dict[str, float]:
        """Return slot name -> value for parameters ``g`` (P,)."""
        return {slot: float(value) for slot, value in self.of_many(g).items()}

    def of_many(self, g: Array) -> dict[str, Array]:
        """Return slot name -> values (...) for parameters ``g`` (..., P)."""
        out = {slot: g[..., p] for slot, p in self.direct}
        for x, y, r, a in self.polar:
            out[x], out[y] = g[..., r] * np.cos(g[..., a]), g[..., r] * np.sin(g[..., a])
        return out

    def jacobian(self, g: Array, slots: Sequence[str], columns: Sequence[int]) -> Array:
        """Return d(slots)/d(parameters ``columns``), (..., S, C), at ``g`` (..., P)."""
        if not self.polar and g.ndim == 1:
            return _direct(self.direct, tuple(slots), tuple(columns))
        row = {s: i for i, s in enumerate(slots)}
        column = {p: i for i, p in enumerate(columns)}
        out = np.zeros((*g.shape[:-1], len(slots), len(columns)))

        def put(slot: str, p: int, d: Array | float) -> None:
            if slot in row and p in column:
                out[..., row[slot], column[p]] += d

        for slot, p in self.direct:
            put(slot, p, 1.0)
        for x, y, r, a in self.polar:
            c, s = np.cos(g[..., a]), np.sin(g[..., a])
            put(x, r, c)
            put(x, a, -g[..., r] * s)
            put(y, r, s)
            put(y, a, g[..., r] * c)
        return out

    def feeds(self, wanted: set[int]) -> tuple[list[str], list[int]]:
        """Return the slots fed by the ``wanted`` parameters, and those parameters."""
        slots: list[str] = []
        used: list[int] = []
        for slot, p in self.direct:
            if p in wanted:
                slots.append(slot)
                used.append(p)
        for x, y, r, a in self.polar:
            if r in wanted or a in wanted:
                slots += [x, y]
                used += [p for p in (r, a) if p in wanted]
        return slots, sorted(set(used))


@lru_cache(maxsize=4096)
def _direct(direct: tuple[tuple[str, int], ...], slots: tuple[str, ...], columns: tuple[int, ...]
            ) -> Array:
    """Return d(slots)/d(parameters) (S, C) where each slot is a parameter; the same at all g."""
    out = np.zeros((len(slots), len(columns)))
    for slot, p in direct:
        if slot in slots and p in columns:
            out[slots.index(slot), columns.index(p)] += 1.0
    out.setflags(write=False)
    return out


def free_indices(parameters: Sequence[Parameter], patterns: Sequence[str] | None) -> list[int]:
    """Return the indices that identification may change.

    Without ``patterns``: every parameter that has a tolerance above 0 and is not fixed. Parameters
    marked as free are always included. The caller has to reject patterns that match nothing
    (:func:`unmatched`).
    """
    def chosen(p: Parameter) -> bool:
        if patterns is not None:
            return any(p.matches(pattern) for pattern in patterns)
        return (p.tolerance is not None and p.tolerance > 0.0
                and not is_joint_component(p.name))

    return [i for i, p in enumerate(parameters) if p.free or (not p.fixed and chosen(p))]


def is_joint_component(name: str) -> bool:
    """Whether a name is a joint frame component, ``leg1.joint2.rx``: not free by default."""
    parts = name.split(".")
    return len(parts) >= 3 and parts[-2].startswith("joint") and parts[-2][5:].isdigit()


def unmatched(parameters: Sequence[Parameter], patterns: Sequence[str]) -> list[str]:
    """Return the patterns that match no parameter."""
    return [pattern for pattern in patterns if not any(p.matches(pattern) for p in parameters)]


def with_values(parameters: Sequence[Parameter], g: Array) -> tuple[Parameter, ...]:
    """Return the parameters with new present values ``g`` (P,)."""
    return tuple(replace(p, value=float(v)) for p, v in zip(parameters, g, strict=True))
