"""Measured rows by themselves: their keys on the page, and those that miss most."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppmcal.io.csv import Table
from ppmcal.linalg import Array
from ppmcal.report.format import exact, whole, with_label
from ppmcal.report.html import number_cell, paragraph, table, text_cell
from ppmcal.report.records import Identified
from ppmcal.report.residuals import coordinates, groups, used
from ppmcal.report.section import Section

SHOWN = 100
"""Rows that the table holds: those furthest from the model for their noise."""


def row_key(index: int | str, dataset: str, row: int) -> str:
    """Return the name by which plots, tables and the drawing know a row.

    Args:
        index: of the identification on the page, from 0; of a diagnosis alone its folder.
        dataset: the row's data set.
        row: its number in the file.
    """
    return f"{index}:{dataset}:{row}"


def row_keys(index: int, residuals: Table) -> list[str]:
    """Return the key of every row of residuals.csv."""
    return [row_key(index, d, int(n)) for d, n in
            zip(residuals.words("dataset"), row_numbers(residuals), strict=True)]


def row_numbers(residuals: Table) -> NDArray[np.int64]:
    """Return the number of every row in its file (N,), -1 where residuals.csv does not say."""
    found = np.nan_to_num(np.clip(residuals.number("row"), -1.0, 1e15), nan=-1.0)
    return found.astype(np.int64)


def times_noise(residuals: Table) -> Array:
    """Return how far each row is from the model: rms of its residuals over their sigma (N,)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratios = np.stack([residuals.number(f"after_{c}") / residuals.number(f"sigma_{c}")
                           for c in coordinates(residuals)] or [np.full(residuals.size, np.nan)])
        seen = np.isfinite(ratios)
        total = np.sum(np.where(seen, ratios, 0.0) ** 2, axis=0)
        out: Array = np.sqrt(total / np.sum(seen, axis=0))
    return out


def rows_section(one: Identified, index: int) -> Section | None:
    """Return the table of the rows that miss most, None without rows."""
    t = one.residuals
    if t is None or not t.size:
        return None
    ratio, keys, keep = times_noise(t), row_keys(index, t), used(t)
    order = np.argsort(-np.nan_to_num(ratio, nan=-1.0), kind="stable")[:SHOWN]
    parts = groups(t)
    heads = ["row", "data set", "times its noise"]
    for g in parts:
        unit = one.record.units.name(g.quantity)
        heads += [with_label(f"{g.name} before", unit), with_label(f"{g.name} after", unit)]
    names, reasons = t.words("dataset"), t.words("reason")
    number = t.number("row")
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
        "", [*heads, "in the fit"], body, sort=True, keys=[keys[i] for i in order]),
        f"{whole(min(SHOWN, t.size))} of {whole(t.size)}", folded=True)
