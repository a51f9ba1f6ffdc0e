"""Units at the boundary: files use the units that they declare, the program uses SI."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from ppmcal.errors import unknown
from ppmcal.wording import number

T = TypeVar("T")

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
ANGLES = {"rad": 1.0, "deg": math.pi / 180.0}
TURN = 2.0 * math.pi
"""A unit that columns may be in, besides those that a file may declare."""


@dataclass(frozen=True)
class Units:
    """The units of one file: ``length`` m, cm, mm, um or in; ``angle`` rad or deg."""

    length: str
    angle: str

    def __post_init__(self) -> None:
        """Reject unknown units."""
        if self.length not in LENGTHS:
            raise unknown("length unit", self.length, LENGTHS, "units.length")
        if self.angle not in ANGLES:
            raise unknown("angle unit", self.angle, ANGLES, "units.angle")

    def factor(self, quantity: str) -> float:
        """Return the SI value of one file unit of a quantity.

        ``length`` and ``angle`` follow the file; everything else is in SI. Quotients are
        written ``N/length``.
        """
        above, _, below = quantity.partition("/")
        return self._one(above) / self._one(below)

    def factors(self, quantities: Sequence[str]) -> list[float]:
        """Return the SI value of one file unit of each of several quantities."""
        return [self.factor(q) for q in quantities]

    def name(self, quantity: str) -> str:
        """Return the unit's name: ``mm``, ``N/mm``, ``mm/(N m)``; empty for a bare number."""
        own = {"length": self.length, "angle": self.angle, "N.m": "N m", "1": ""}
        above, _, below = quantity.partition("/")
        if not below:
            return own.get(above, above)
        under = own.get(below, below)
        return f"{own.get(above, above) or 1}/{f'({under})' if ' ' in under else under}"

    def words(self, value: float, quantity: str, digits: int = 4) -> str:
        """Return an SI value as text in file units: ``0.0123 mm``."""
        return f"{number(value / self.factor(quantity), digits)} {self.name(quantity)}"

    def _one(self, part: str) -> float:
        if part == "length":
            return LENGTHS[self.length]
        return ANGLES[self.angle] if part == "angle" else 1.0


SI = Units("m", "rad")


def as_now(name: str) -> str:
    """Return a unit's current name: older files have ``mm/N m`` for ``mm/(N m)``."""
    above, _, below = name.partition("/")
    return f"{above}/({below})" if " " in below and not below.startswith("(") else name


def to_file(value: float, factor: float) -> float:
    """Return the double f with f * factor == value, or the nearest if none exists.

    Every value read from a file in the same units has one, so reading, writing and reading again
    is exact to the last bit.
    """
    first = value / factor
    if factor == 1.0 or not math.isfinite(first) or first * factor == value:
        return first
    candidates = [first]
    low = high = first
    for _ in range(3):
        low, high = math.nextafter(low, -math.inf), math.nextafter(high, math.inf)
        candidates += [low, high]
    return min(candidates, key=lambda f: abs(f * factor - value))


@dataclass(frozen=True)
class Quantity:
    """The quantity of a number of a result, SI: ``Annotated[float, Quantity("length")]``.

    Attributes:
        name: as in :meth:`Units.factor`, empty for a bare number.
        of: in place of ``name``, the field that names the quantity; for an array, the attribute
            that lists the quantities along its last axis.
        digits: significant digits written, where the number is only plotted; 0 for all.
        per: an array's numbers are per unit of these quantities; ``square``: products of two.
    """

    name: str = ""
    of: str = ""
    digits: int = 0
    per: bool = False
    square: bool = False

    def of_file(self, value: Any, name: str, units: Units) -> Any:
        """Convert a value of the quantity ``name``, or a list or mapping of such, to file units."""
        if name == COORDINATE and value is not None:
            return {k: self._over(v, units.factor(coordinate_quantity(k)))
                    for k, v in value.items()}
        return self._over(value, units.factor(name))

    def _over(self, value: Any, factor: float) -> Any:
        if value is None:
            return None
        if isinstance(value, Mapping):
            return {k: self._over(v, factor) for k, v in value.items()}
        if hasattr(value, "__len__"):
            return tuple(self._over(v, factor) for v in value)
        own = float(value) / factor
        return float(f"{own:.{self.digits}g}") if self.digits else own


COORDINATE = "coordinate"
"""The quantity of a mapping by pose coordinate: each value has its coordinate's quantity."""
COLUMN = "column "
"""Prefix of a fit's column name: the quantity of that column."""
PARAMETERS, JOINTS = "parameters", "joints"
"""For arrays: the quantities of all fitted parameters, and of all joints."""


ANGLES_SEEN = ("rx", "ry", "rz", "roll", "pitch")


def coordinate_quantity(name: str) -> str:
    """Return ``length`` for x, y, z and ``angle`` for rx, ry, rz; other readings likewise."""
    return "angle" if name in ANGLES_SEEN or name.startswith("turn_") else "length"


Length = Annotated[T, Quantity("length")]
Angle = Annotated[T, Quantity("angle")]
ByCoordinate = Annotated[T, Quantity(COORDINATE)]
OfUnit = Annotated[T, Quantity(of="unit")]
"""A number whose quantity the field ``unit`` names; in a file that field holds its unit."""


@dataclass(frozen=True)
class Key:
    """The key of a field in a file, where it differs from its name.

    ``object.key`` is a key within an object without a class of its own; ``whole``: that object is
    null where the field is None.
    """

    name: str
    whole: bool = False


@dataclass(frozen=True)
class AtMost:
    """The largest magnitude accepted when reading; numbers that are only shown have none."""

    largest: float


@dataclass(frozen=True)
class Unsaid:
    """A value that is missing or null in a file reads as nan or None, whatever the default."""


OrNull = Annotated[T, Unsaid()]

LARGEST = 1e30
Finite = Annotated[float, AtMost(LARGEST)]
"""A number used in calculations: at most :data:`LARGEST` when read."""
