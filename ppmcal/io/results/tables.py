"""Tables of results: columns that several have, with their units, and how one is read back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from ppmcal.calibration.fit import pictures_beside
from ppmcal.codec import AGAIN
from ppmcal.design.error_sources import Source
from ppmcal.errors import BadInput
from ppmcal.io import csv_text
from ppmcal.io.csv import Table, csv_table, joined, refuse_absurd, whole_rows
from ppmcal.io.csv_body import Cells
from ppmcal.io.pose_fields import EULER
from ppmcal.io.results.record import Column, Part
from ppmcal.kinematics.region import Grid, Map
from ppmcal.limits import refuse_shape
from ppmcal.linalg import Array
from ppmcal.model.instruments import is_own_reading, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.store.inputs import read_bytes, read_pieces
from ppmcal.units import coordinate_quantity


def finite_number(value: Any) -> float | None:
    """Return a number of at most ``LARGEST``, None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) <= LARGEST else None


def status_counts(status: Sequence[str]) -> dict[str, int]:
    """Return how many rows have each status."""
    return dict(sorted(Counter(status).items()))


def joint_columns(mechanism: Mechanism, q: Array, pattern: str) -> dict[str, Array]:
    """Return joint values as columns named by ``pattern`` (``q_{}``), file units."""
    return {pattern.format(name): q[:, i] / factor for i, (name, (factor, _)) in
            enumerate(zip(mechanism.actuators, mechanism.joint_units, strict=True))}


def pose_columns(mechanism: Mechanism, pose: Array, prefix: str = "") -> dict[str, Array]:
    """Return pose coordinates of the machine's motion as columns, file units."""
    return {prefix + POSE_COORDINATES[c]:
            pose[:, c] / mechanism.units.factor("length" if c < 3 else "angle")
            for c in mechanism.dof}


def unit_map(mechanism: Mechanism, header: Sequence[str]) -> dict[str, str]:
    """Return the unit of every column that has one."""
    length, angle = mechanism.units.length, mechanism.units.angle
    out = {}
    joints = dict(zip(mechanism.actuators, (u for _, u in mechanism.joint_units), strict=True))
    for name in header:
        bare = name.removeprefix("cmd_")
        if bare in POSE_COORDINATES:
            out[name] = angle if bare.startswith("r") else length
        elif name in EULER:
            out[name] = angle
        elif bare.removeprefix("sigma_").startswith(("q_", "rate_")):
            bare = bare.removeprefix("sigma_")
            unit = joints.get(bare.removeprefix("q_").removeprefix("rate_")
                              .removesuffix("_nominal"), "")
            out[name] = f"{unit or 'unit'}/s" if bare.startswith("rate_") else unit
        elif "_position" in name:
            out[name] = length
        elif "_rotation" in name:
            out[name] = angle
    return out


ENVIRONMENT = {"time": "s", "payload": "kg", "fx": "N", "fy": "N", "fz": "N", "mx": "N.m",
               "my": "N.m", "mz": "N.m", "pressure": "Pa"}
"""Columns that effects depend on, in units that no file chooses."""
STAGES = ("before_", "after_", "sigma_", "geometry_")
"""What residuals.csv says of each measured coordinate."""


def column_units(mechanism: Mechanism, header: Sequence[str]) -> dict[str, str]:
    """Return the unit of every column of a table, empty for bare numbers and words."""
    units, out = mechanism.units, dict.fromkeys(header, "") | unit_map(mechanism, header)
    joints = dict(zip(mechanism.actuators, (u for _, u in mechanism.joint_units), strict=True))
    for name in header:
        if name in ENVIRONMENT:
            out[name] = ENVIRONMENT[name]
        elif name.startswith("temperature"):
            out[name] = "deg C"
        elif name in ("vx", "vy", "vz", "wx", "wy", "wz"):
            out[name] = f"{units.length if name[0] == 'v' else units.angle}/s"
        elif name.removeprefix("vel_") in joints:
            out[name] = f"{joints[name.removeprefix('vel_')] or 'unit'}/s"
        elif name.startswith("to_q_"):
            out[name] = joints.get(name.removeprefix("to_q_"), "")
        for stage in STAGES:
            bare = name.removeprefix(stage)
            if bare != name and (bare in (*POSE_COORDINATES, *number_names())
                                 or is_own_reading(bare)):
                out[name] = units.name(coordinate_quantity(bare))
    return out


def error_unit(mechanism: Mechanism, parameter: int) -> str:
    """Return the unit of the error of a parameter."""
    p = mechanism.parameters[parameter]
    return mechanism.units.name(p.quantity) + " per unit" * p.per_unit


def error_columns(mechanism: Mechanism, errors: Sequence[Source], of: Literal["kind", "class"]
                  ) -> tuple[list[Column], Array]:
    """Return the columns that name errors (S,), ``of`` which kind or class each is, and its unit.

    Last, the SI value of one of each's unit (S,).
    """
    named = {"name": [mechanism.names[e.parameter] for e in errors],
             "limb": [e.limb for e in errors], "slot": [e.group for e in errors],
             of: [e.kind if of == "kind" else e.tolerance_class for e in errors],
             "unit": [error_unit(mechanism, e.parameter) for e in errors]}
    return [Column(n, words) for n, words in named.items()], np.array([
        mechanism.units.factor(mechanism.parameters[e.parameter].quantity) for e in errors])


def filled_columns(header: Sequence[str], columns: Sequence[Any], found: Mapping[str, Array]
                  ) -> list[Any]:
    """Fill in the coordinates that were left open and solved for."""
    out = []
    for name, column in zip(header, columns, strict=True):
        if name in found:
            own = np.asarray(column, dtype=float)
            column = np.where(np.isnan(own), found[name], own)
        out.append(column)
    return out


def map_table(mechanism: Mechanism, pose: Array, maps: Sequence[Map], status: Sequence[str],
              reason: Sequence[str]) -> str:
    """Return map.csv: poses (N, 6), every map's value, ``status, reason``."""
    table: dict[str, object] = {**pose_columns(mechanism, pose),
                                **{m.name: m.values.ravel() for m in maps},
                                "status": list(status), "reason": list(reason)}
    return csv_text(list(table), list(table.values()))


def map_pictures(mechanism: Mechanism, grid: Grid, shown: Sequence[Map], determinant: Array
                 ) -> dict[str, bytes]:
    """Return file name -> PNG of maps over a grid; ``determinant``: of A at its poses (N,)."""
    from ppmcal.plotting.maps import draw_map

    return pictures_beside({f"map_{m.name}.png": partial(
        draw_map, mechanism, grid, m, determinant.reshape(grid.shape)) for m in shown})


P = TypeVar("P", bound=Part)
LARGEST = 1e140
"""Larger numbers are refused: their squares would overflow."""
PIECE = 1 << 25
"""Bytes of a table that are held at once beside its columns."""
FLAGS = {"": np.nan, "true": 1.0, "false": 0.0}


@dataclass(frozen=True)
class WrittenTable:
    """A table that a command writes: by which columns it is read back.

    Attributes:
        file: its name.
        numbers: whether a column of some name holds numbers; the others hold words.
        flags: of those with numbers the ones that hold 1 or 0, or true or false.
    """

    file: str
    numbers: Callable[[str], bool]
    flags: frozenset[str] = frozenset()

    def read(self, path: Path, wanted: Callable[[str], bool] = lambda _: True) -> Table:
        """Return the columns of a file that are ``wanted``, in the units of its record.

        Raises:
            BadInput: as :func:`ppmcal.io.csv.csv_table`, a last line that was cut off, or a
                number that is too large.
        """
        head, parts = b"", list[Table]()
        try:
            for rows in whole_rows(read_pieces(path, PIECE)):
                parts.append(self._table(head + rows, str(path), wanted))
                head = head or rows[:rows.find(b"\n") + 1]
            refuse_shape(sum(p.size for p in parts), len(parts[0].header), str(path))
        except (BadInput, IndexError):    # told with its place in the whole file
            parts = [self._table(read_bytes(path), str(path), wanted)]
        return joined(parts)

    def _table(self, data: bytes, source: str, wanted: Callable[[str], bool]) -> Table:
        """Return the columns of a file's bytes, or of some of its rows under the header."""
        try:
            if data and data[-1:] not in (b"\r", b"\n"):
                raise BadInput("is cut off: its last line has no end", f"{source}: last line")
            found = csv_table(data, source, Cells(
                self.flags.__contains__, lambda name: not self.numbers(name), wanted), True)
            found = found.put({h: self._flags(found, h) for h in found.header
                               if h in self.flags and h in found.text})
            refuse_absurd(found.numbers, source, LARGEST, True)
        except BadInput as error:
            raise BadInput(error.what, error.where, AGAIN) from None
        return found

    @staticmethod
    def _flags(table: Table, name: str) -> Array:
        """Return a column of flags (N,) of which some are words."""
        values = dict[str, float]()
        for i, word in enumerate(table.text[name]):
            if word not in values:
                try:
                    values[word] = FLAGS[w] if (w := word.lower()) in FLAGS else float(word)
                except ValueError:
                    raise BadInput(f"'{word[:40]}' is not a number", table.at(name, i)) from None
        return np.array([values[word] for word in table.text[name]])

    def entries(self, table: Table) -> list[dict[str, Any]]:
        """Return a small table row by row, None for a number that is not there."""
        columns = {h: table.text[h] if h in table.text else [
            None if not np.isfinite(v) else bool(v) if h in self.flags else v
            for v in table.number(h).tolist()] for h in table.header}
        return [dict(zip(columns, row, strict=True))
                for row in zip(*columns.values(), strict=True)]

    def parameters(self, record: P, table: Table | None) -> P:
        """Return a record that lists no parameters with those of the table."""
        known: Any = record
        if table is None or known.parameters:
            return record
        listed: Any = type(record).checked({"parameters": self.entries(table)}, Path(table.source))
        return record.changed(parameters=listed.parameters)


ANY_TABLE = WrittenTable("", lambda _: False)
"""Of which nothing but the number of rows is asked."""
