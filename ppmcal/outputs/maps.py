"""Quantities over a grid of poses: what a map shows, and its table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.arrays import Array
from ppmcal.files import csv_text
from ppmcal.mechanism import Mechanism
from ppmcal.outputs.tables import pose_columns
from ppmcal.region import Grid


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


def map_table(mechanism: Mechanism, pose: Array, maps: Sequence[Map], status: Sequence[str],
              reason: Sequence[str]) -> str:
    """Return map.csv: poses (N, 6), every map's value, ``status, reason``."""
    table: dict[str, object] = {**pose_columns(mechanism, pose),
                                **{m.name: m.values.ravel() for m in maps},
                                "status": list(status), "reason": list(reason)}
    return csv_text(list(table), list(table.values()))


__all__ = ["Grid", "Map", "map_table"]
