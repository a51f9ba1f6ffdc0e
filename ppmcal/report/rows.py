"""Measured rows by themselves: what their files say, their keys, and those that miss most."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_tables import (
    is_measured,
    norms,
    quantity_of,
    row_key,
    row_numbers,
    times_noise,
    used,
)
from ppmcal.io.results.parts import LeftOutRow
from ppmcal.io.tables import read_table
from ppmcal.linalg import Array
from ppmcal.plotting.layers import Points, Undrawn
from ppmcal.report.html import (
    MAX_ROWS,
    count,
    exact,
    name_cell,
    number,
    number_cell,
    paragraph,
    sig,
    table,
    text_cell,
    whole,
    with_label,
    with_unit,
)
from ppmcal.report.records import Identified, MeasuredRows, Simulated
from ppmcal.report.section import Section
from ppmcal.store.inputs import digest_of
from ppmcal.units import Units

NOT_SHOWN = ("q_", "q2_", "vel_", "sigma_", "cmd_")
"""Table that begin so are not conditions that a person looks for."""


def conditions(path: Path) -> Table:
    """Return what a measurement file says of a row: pose, temperature, load, time.

    Raises:
        BadInput: as :func:`ppmcal.io.tables.read_table`.
    """
    return read_table(path, loose=lambda name: name not in ("x", "y"), rowless=True,
                      wanted=lambda name: not name.startswith(NOT_SHOWN))


def with_measured(one: Identified, simulated: Sequence[Simulated]) -> Identified:
    """Find the lines of the residual rows, in files with the check sum of the input."""
    table = one.residuals
    if table is None or not table.size:
        return one
    tables: list[Table] = []
    which, line = (np.full(table.size, -1, dtype=np.int64) for _ in range(2))
    datasets = one.record.datasets
    names = np.array(table.words("dataset"), dtype=object)
    rows = np.clip(table.number("row"), -1.0, 1e9)
    for entry in datasets:
        found = _measured(one, entry.source, simulated)
        mine = (names == entry.name) | (len(datasets) == 1)
        if found is None or not np.isfinite(rows[mine]).all() or not mine.any():
            continue
        index = np.nan_to_num(rows, nan=-1.0).astype(int) - (0 if rows[mine].min() < 1 else 1)
        mine &= (index >= 0) & (index < found.size)
        which[mine], line[mine] = len(tables), index[mine]
        tables.append(found)
    measured = MeasuredRows(tuple(tables), which, line) if tables else None
    places = _places(table, measured)
    known = np.isfinite(places).all(axis=1).any()
    return replace(one, measured=measured, positions=places if known else None)


def _places(table: Table, measured: MeasuredRows | None) -> np.ndarray:
    """Return measured x, y (N, 2), nan where unknown: those of residuals.csv if it has them."""
    if _has_places(table):
        return np.column_stack([table.number("x"), table.number("y")])
    out = np.full((table.size, 2), np.nan)
    for n, own in enumerate(measured.tables if measured is not None else ()):
        if measured is not None and _has_places(own):
            mine = measured.table == n
            out[mine] = np.column_stack([own.number("x"), own.number("y")])[measured.line[mine]]
    return out


def _has_places(table: Table) -> bool:
    return "x" in table.numbers and "y" in table.numbers


def _measured(one: Identified, source: str, simulated: Sequence[Simulated]) -> Table | None:
    """Return the conditions of a measurement file, if it is the very one that was fitted."""
    inputs, names = one.record.provenance.inputs, one.record.provenance.inputs_of(source)
    if len(names) != 1 or not inputs[names[0]]:
        return None
    table = next((s.measurements for s in simulated if s.digest == inputs[names[0]]), None)
    if table is None and digest_of(Path(names[0])) == inputs[names[0]]:
        try:
            return conditions(Path(names[0]))
        except BadInput:
            return None
    return table


OWN = ("row", "dataset", "used")
"""Table of residuals.csv that say which row it is, not what held in it."""
MOST = 18
"""So many columns of the measurement file are shown of a row, three in a line."""
MOST_HELD, MOST_RUNS = 20_000, 500
"""So many rows at most are held by each thinned plot, numbered through in so many pieces."""
STAGES = ("before_", "after_", "sigma_")


@dataclass(frozen=True, eq=False)
class DataRows:
    """The rows of a residuals.csv, with what is known of each.

    Attributes:
        fit: which identification of the page, from 0.
        table: residuals.csv, N rows.
        units: of its columns.
        positions: measured x, y (N, 2), nan where unknown; None: all are.
        measured: the rows in the files that were fitted; None where these are not at hand.
        freedoms: coordinates of a pose, which joint values alone have fitted row by row.
    """

    fit: int | str
    table: Table
    units: Units
    positions: Array | None = None
    measured: MeasuredRows | None = None
    freedoms: int = 0

    @classmethod
    def of(cls, one: Identified, index: int) -> DataRows | None:
        """Return the rows of an identification, ``index`` on the page; None without any."""
        return cls(index, one.residuals, one.record.units, one.positions, one.measured,
                   one.freedoms) if one.residuals is not None else None

    def points(self, index: NDArray[np.integer[Any]]) -> Points:
        """Return what some rows (M,), counted from 0, are."""
        names, rows = self.table.words("dataset"), row_numbers(self.table)
        picked = index.tolist()
        return Points([self._said(i) for i in picked],
                      [row_key(self.fit, names[i], int(rows[i])) for i in picked])

    def undrawn(self, y: Array, x: Array | None = None) -> Undrawn | None:
        """Return all rows at their places, for a layer that draws some; None for too many.

        Args:
            y: (N,), nan where a row has no place.
            x: likewise  [default: the number of the row in the table].
        """
        names, rows = self.table.words("dataset"), row_numbers(self.table)
        starts = [i for i in range(rows.size) if i == 0 or names[i] != names[i - 1]
                  or rows[i] != rows[i - 1] + 1]
        if rows.size > MOST_HELD or len(starts) > MOST_RUNS:
            return None
        runs = [(row_key(self.fit, names[i], int(rows[i])).rpartition(":")[0], int(rows[i]), j - i)
                for i, j in zip(starts, [*starts[1:], rows.size], strict=True)]
        return Undrawn(runs, y, x)

    def _said(self, i: int) -> str:
        """Return data set, row and what held in it, in lines."""
        row = number(float(self.table.number("row")[i]))
        name = ", ".join(t for t in (self.table.words("dataset")[i],
                                     "" if row is None else f"row {row:.0f}") if t)
        return "\n".join(t for t in (name, *self._conditions(i)) if t)

    def _conditions(self, i: int) -> Iterator[str]:
        """Yield where the row was measured, and what other columns say of it."""
        told = [] if self.measured is None else self.measured.said(i)
        yield from (", ".join(told[n:n + 3]) for n in range(0, min(len(told), MOST), 3))
        if not told and self.positions is not None and np.isfinite(self.positions[i]).all():
            x, y = self.positions[i].tolist()
            yield f"measured x {sig(x, 5)}, y {sig(y, 5)}"
        for name in self.table.header:
            if name in OWN or name.startswith(STAGES):
                continue
            if name in self.table.numbers:
                value = number(float(self.table.numbers[name][i]))
                unit = self.units.name(quantity_of(name)) if is_measured(name) else ""
                if value is not None:
                    yield f"{name} {with_unit(value, unit, 5)}"
            elif self.table.words(name)[i]:
                yield f"{name}: {self.table.words(name)[i]}"


SHOWN = 100
"""Rows that the table holds: those furthest from the model for their noise."""


def rows_section(one: Identified, index: int) -> Section | None:
    """Return the table of the rows that miss most, None without rows."""
    t = one.residuals
    if t is None or not t.size:
        return None
    ratio, keep = times_noise(t, one.freedoms), used(t)
    order = np.argsort(-np.nan_to_num(ratio, nan=-1.0), kind="stable")[:SHOWN]
    parts = norms(t)
    heads = ["row", "data set", "times its noise"]
    for g in parts:
        unit = one.record.units.name(g.quantity)
        heads += [with_label(f"{g.name} before", unit), with_label(f"{g.name} after", unit)]
    names, reasons = t.words("dataset"), t.words("reason")
    number, counted = t.number("row"), row_numbers(t)
    body = [[number_cell(number[i], exact(float(number[i]))), text_cell(names[i]),
             number_cell(float(ratio[i])),
             *(number_cell(float(v[i])) for g in parts for v in (g.before, g.after)),
             text_cell("used" if keep[i] else f"left out: {reasons[i]}".rstrip(": "),
                       "wrap" if keep[i] else "wrap warn")] for i in order]
    more = (f"The {SHOWN} of {whole(t.size)} rows that miss most; residuals.csv has them all. "
            if t.size > SHOWN else "")
    note = more + ("Noise: root mean square of a row's residuals over their sigma. Click a "
                   "row, or a point in a plot or on the machine, to find it in the others.")
    return Section("Rows by error", paragraph(note, "note") + table(
        "", [*heads, "in the fit"], body, sort=True,
        keys=[row_key(index, names[i], int(counted[i])) for i in order]),
        f"{whole(min(SHOWN, t.size))} of {whole(t.size)}", folded=True)


def gross_error_section(found: IdentificationRecord, units: Mapping[str, str], index: int
                        ) -> Section | None:
    """Return what the rows left out said, and what they would have done to the parameters."""
    rows = [[text_cell(r.dataset), number_cell(r.row, exact(r.row)), text_cell(r.coordinate),
             *(number_cell(v, exact(v, 6)) for v in (r.value, r.predicted)), text_cell(r.unit),
             number_cell(r.times)] for r in found.gross_errors]
    out = table(_first("What those rows say, and what all others say of them", len(rows)),
                ["data set", "row", "number", "measured", "the others say", "unit",
                 "times the noise"], rows[:MAX_ROWS], sort=True,
                keys=[row_key(index, r.dataset, r.row or 0) for r in found.gross_errors[:MAX_ROWS]])
    body = [[name_cell(name), *(number_cell(v, exact(v, 6)) for v in (now, then)),
             text_cell(units.get(name, ""))]
            for name, e in found.would_be.items()
            if (now := e.get("now")) is not None and (then := e.get("with_them")) is not None]
    out += table(_first("What parameters would be with them", len(body)),
                 ["parameter", "now", "with them", "unit"], body[:MAX_ROWS], sort=True)
    if not out:
        return None
    note = "These rows were left out because the others contradict them."
    if any(r.repeats for r in found.gross_errors):
        note += (" Of a joint's reading (q_...) the others are those at the same place, and the "
                 "noise is how they scatter.")
    return Section("Gross errors", paragraph(note, "note") + out, folded=True)


def _first(caption: str, size: int) -> str:
    return caption + (f"; the first {MAX_ROWS} of {size}" if size > MAX_ROWS else "")


def excluded(one: Identified, index: int) -> Section | None:
    """Return the rows that the fit left out, with reasons."""
    entries = excluded_rows(one)
    if not entries:
        return None
    rows = [[text_cell(e.dataset), number_cell(e.row, exact(e.row)), text_cell(e.reason, "wrap")]
            for e in entries[:MAX_ROWS]]
    more = (f"the first {MAX_ROWS} of {whole(len(entries))}; residuals.csv has them all"
            if len(entries) > MAX_ROWS else "")
    keys = [row_key(index, e.dataset, e.row or 0) for e in entries[:MAX_ROWS]]
    return Section(f"{count(len(entries), 'row')} left out of the fit",
                   table(more, ["data set", "row", "reason"], rows, sort=True, keys=keys),
                   folded=True)


def excluded_rows(one: Identified) -> tuple[LeftOutRow, ...]:
    """Return the rows left out, from the JSON, else from residuals.csv."""
    t = one.residuals
    if "excluded" in one.record.given or t is None:
        return one.record.excluded
    row, names, reasons = t.number("row"), t.words("dataset"), t.words("reason")
    return tuple(LeftOutRow(dataset=names[i], reason=reasons[i],
                             row=int(row[i]) if np.isfinite(row[i]) else None)
                 for i in (~used(t)).nonzero()[0])
