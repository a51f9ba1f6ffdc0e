"""Commands as a measurement file has them: its names, units, signs and marks, and its digits.

``commands.csv`` is in the mechanism file's units; who sends commands wants them as the joints were
recorded. What is written here reads back through the same block ``read`` of the sidecar.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from ppmcal.io.csv import Table
from ppmcal.io.csv_dialect import Dialect
from ppmcal.io.header import Columns, HeaderColumn, ReadFile
from ppmcal.io.pose_fields import COORDINATES
from ppmcal.io.reading import declared_unit, in_units
from ppmcal.io.yaml import decimals
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.recorded import LABEL, RecordedColumn, RecordedForm
from ppmcal.units import Units, coordinate_quantity

LOOKED_AT = 2000
"""Cells of a column by which its decimals are told."""
SIGNIFICANT = 17
"""Digits of a number, beyond which a double has none."""


def form_of(table: Table, columns: Columns, read: ReadFile, mechanism: Mechanism, units: Units
            ) -> RecordedForm | None:
    """Return how a file has joints or commanded poses, None where it has neither in full.

    Commanded quaternions are not written again. ``table`` has our own names, and the file's own
    numbers, in the sidecar's ``units``.
    """
    joints = [f"q_{a}" for a in mechanism.actuators]
    commanded = [f"cmd_{c}" for c in COORDINATES]
    own = [c for c in columns if c.name in (LABEL, *joints, *commanded)]
    known = {c.name for c in own}
    if not (set(joints) <= known or known & set(commanded)) or any(
            c.name.startswith("cmd_quat_") for c in columns):
        return None
    dialect = table.dialect or Dialect()
    by_name = {c.name: c for c in own}
    return RecordedForm(
        tuple(_column(by_name[name], table, read, mechanism, units) for name in table.header
              if name in by_name), dialect.separator, dialect.decimal)


def _column(column: HeaderColumn, table: Table, read: ReadFile, mechanism: Mechanism, units: Units
            ) -> RecordedColumn:
    """Return what is known of one column."""
    name = column.name
    if name == LABEL:
        return RecordedColumn(name, column.header)
    one = Table(table.source, (name,), {name: np.ones(1)}, {}, 1)
    read_as = float(in_units(one, [column], read, mechanism, units).numbers[name][0])
    there = _si(name, mechanism, units) / _si(name, mechanism, mechanism.units)
    return RecordedColumn(name, column.header, column.unit or declared_unit(
        name, mechanism, units), read_as * there, decimals_of(table.numbers[name]))


def _si(name: str, mechanism: Mechanism, units: Units) -> float:
    """Return the SI value of a column's unit where it is that of a file in some units."""
    if name.startswith("cmd_"):
        return units.factor(coordinate_quantity(name.removeprefix("cmd_")))
    return float(mechanism.joint_factors(units)[mechanism.actuators.index(
        name.removeprefix("q_"))])


def decimals_of(values: Array) -> int:
    """Return how many digits numbers (N,) have behind the mark, by the first of them.

    >>> decimals_of(np.array([1.5, np.nan, 0.125, 3.0]))
    3
    """
    found = islice((v for v in values.tolist() if math.isfinite(v)), LOOKED_AT)
    return max(map(decimals, found), default=0)


def with_decimals(form: RecordedForm, steps: Mapping[str, float]) -> RecordedForm:
    """Return a form whose columns have digits enough for some steps, never fewer than they had.

    ``steps``: by column of ours the largest that numbers may go by, the mechanism file's unit.
    """
    return replace(form, columns=tuple(replace(c, decimals=max(c.decimals, _needed(
        steps.get(c.name, math.inf) / abs(c.factor)))) for c in form.columns))


def _needed(step: float) -> int:
    """Return how many decimals numbers need that may go by steps as large as one."""
    if not 0.0 < step < math.inf:
        return 0 if step else SIGNIFICANT
    return min(max(0, math.ceil(-math.log10(step))), SIGNIFICANT)


def recorded_text(form: RecordedForm, labels: Sequence[str], values: Mapping[str, Array]) -> str:
    """Return a CSV of commands in a recorded form.

    Args:
        form: names, units, digits and marks; a column of labels comes first where it has none.
        labels: of the rows (N,).
        values: by our names (N,), in the mechanism file's units; rows without all of them are
            left out: an empty cell is 0 to some controllers.
    """
    columns = form.columns if any(c.name == LABEL for c in form.columns) else (
        RecordedColumn(LABEL, LABEL), *form.columns)
    stream = io.StringIO()
    writer = csv.writer(stream, delimiter=form.separator, lineterminator="\n")
    writer.writerow([c.header for c in columns])
    cells = [labels if c.name == LABEL else list(_cells(c, values[c.name], form.decimal))
             for c in columns]
    writer.writerows(row for row in zip(*cells, strict=True) if "" not in row)
    return stream.getvalue()


def _cells(column: RecordedColumn, values: Array, mark: str) -> Iterator[str]:
    """Yield numbers as the file has them, nothing for what is not there."""
    for value in (values / column.factor).tolist():
        text = f"{value:.{column.decimals}f}" if math.isfinite(value) else ""
        yield (text.removeprefix("-") if not text.strip("-0.") else text).replace(".", mark)
