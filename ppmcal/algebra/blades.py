"""Names for ordered sets of basis blades, which tell the general products what an array holds.

A blade is written "1" or "e" followed by factors out of 1, 2, 3, inf, 0 in any order: "e31" is
e3∧e1 = −e1∧e3, "e1inf0" is e1∧e∞∧e0.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

from ppmcal.errors import BadInput, unknown

BASIS = ("1", "2", "3", "inf", "0")
"""The null basis e1, e2, e3, e∞, e0; bit i of a mask stands for BASIS[i]."""

CANONICAL = tuple(
    "1 e1 e2 e3 einf e0 e23 e31 e12 e1inf e2inf e3inf e10 e20 e30 einf0 "
    "e1inf0 e2inf0 e3inf0 e23inf e31inf e12inf e230 e310 e120 e123 "
    "e123inf e1230 e23inf0 e31inf0 e12inf0 e123inf0".split()
)
"""All 32 blades, in the order and orientation that outputs use."""

_FACTOR = re.compile(r"inf|[1230]")


def parse_blade(name: str) -> tuple[int, int]:
    """Return the bit mask of a blade and its sign against the order of `BASIS`.

    Raises:
        BadInput: if the name is not a blade; the message lists the canonical ones.
    """
    if name == "1":
        return 0, 1
    factors = _FACTOR.findall(name[1:])
    if name[:1] != "e" or not factors or "e" + "".join(factors) != name:
        raise unknown("basis blade", name, CANONICAL)
    order = [BASIS.index(factor) for factor in factors]
    if len(set(order)) < len(order):
        raise unknown("basis blade", name, CANONICAL)
    swaps = sum(a > b for i, a in enumerate(order) for b in order[i + 1 :])
    return sum(1 << index for index in order), -1 if swaps % 2 else 1


@dataclass(frozen=True)
class Blades:
    """An ordered set of basis blades: the meaning of the last axis of an array.

    Attributes:
        names: one name for each component, no blade twice (whatever its orientation).
    """

    names: tuple[str, ...]

    def __post_init__(self) -> None:
        """Reject unknown names and repeated blades."""
        masks = [parse_blade(name)[0] for name in self.names]
        if len(set(masks)) < len(masks):
            raise BadInput(f"a blade is named twice in {self.names}")

    @classmethod
    def grades(cls, *grades: int) -> Blades:
        """Return all blades of the given grades, in canonical order."""
        return cls(tuple(n for n in CANONICAL if parse_blade(n)[0].bit_count() in grades))

    @classmethod
    def of_masks(cls, masks: set[int]) -> Blades:
        """Return the blades with these bit masks, in canonical order and orientation."""
        return cls(tuple(n for n in CANONICAL if parse_blade(n)[0] in masks))

    @cached_property
    def masks(self) -> tuple[int, ...]:
        """Bit mask of each blade."""
        return tuple(parse_blade(name)[0] for name in self.names)

    @cached_property
    def signs(self) -> tuple[int, ...]:
        """Sign of each blade against the order of `BASIS`."""
        return tuple(parse_blade(name)[1] for name in self.names)

    def __len__(self) -> int:
        """Return the number of components."""
        return len(self.names)


SCALAR = Blades(("1",))
VECTOR = Blades(("e1", "e2", "e3", "einf", "e0"))
MOTOR = Blades(("1", "e23", "e31", "e12", "e1inf", "e2inf", "e3inf", "e123inf"))
TWIST = Blades(("e23", "e31", "e12", "e1inf", "e2inf", "e3inf"))
"""Blades of the bivector of a twist; its coefficients are −½(ω, v)."""
LINE = Blades(("e1inf0", "e2inf0", "e3inf0", "e23inf", "e31inf", "e12inf"))
"""Blades of P∧S∧e∞; its coefficients are the Plücker coordinates (direction, moment)."""
PAIR = Blades.grades(2)
FULL = Blades(CANONICAL)
