"""Quantities over a grid of poses: what a map shows, and its table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from ppmcal.linalg import Array
from ppmcal.units import Units


@dataclass(frozen=True, eq=False)
class Map:
    """One quantity over a grid.

    Attributes:
        name: column of the table and stem of the picture: ``amplification_position``.
        title: in words; unit: of ``values``, empty for a bare number.
        values: one value per pose, shape of the grid, file units, nan where there is none.
        log: whether colours go with the logarithm.
    """

    name: str
    title: str
    unit: str
    values: Array
    log: bool = False

    @classmethod
    def of(cls, units: Units, name: str, title: str, quantity: str, values: Array) -> Self:
        """Return the map of SI values of a quantity such as ``angle/length``."""
        return cls(name, title, units.name(quantity), values / units.factor(quantity))


@dataclass(frozen=True, eq=False)
class MapView:
    """What is drawn, in file units.

    Attributes:
        coordinates: at most three indices into the full pose; levels: of each.
        values, determinant: shape of the levels; ``determinant`` None where not given.
        names: axes with units; home: home's place (c,); held: the other coordinates in words.
    """

    coordinates: tuple[int, ...]
    levels: tuple[Array, ...]
    values: Array
    determinant: Array | None
    names: tuple[str, ...]
    home: Array
    held: str
