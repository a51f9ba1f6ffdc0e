"""Pictures of residuals, predicted errors and the simulated truth, thinned where rows are many."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.io.csv import Table
from ppmcal.io.results.commands import CommandsRecord, predicted_errors
from ppmcal.io.results.identification_tables import (
    ResidualNorm,
    coordinates,
    gap_share,
    norms,
    quantity_of,
    rms,
    typical_sigma,
    used,
    white,
)
from ppmcal.io.results.simulation import ComparedMachines
from ppmcal.linalg import Array, Bools
from ppmcal.plotting.canvas import HEIGHT, WIDTH, Drawing
from ppmcal.plotting.layers import (
    Arrows,
    Band,
    Dots,
    Histogram,
    Layer,
    Marks,
    Points,
    Polyline,
    Starts,
    Strokes,
    WordsAt,
    Zero,
)
from ppmcal.plotting.plot import BOTTOM, LEFT, RIGHT, TOP, Axis, Plot, span
from ppmcal.report.html import count, sig, whole, with_label, with_unit
from ppmcal.report.records import CheckedRows
from ppmcal.report.rows import DataRows

POINTS = 1200
"""More rows than this are plotted thinned."""
BINS = 300
"""Thinned plots show the range of the rows in each of so many bins."""


def envelope(y: Array, bins: int = BINS) -> tuple[Array, Array, Array, Array, Array]:
    """Return bin centres and the 0, 1/6, 5/6 and 1 quantiles of the finite values in each bin."""
    edges = np.linspace(0, y.size, bins + 1).astype(int)
    out = []
    for start, stop in pairwise(edges.tolist()):
        part = y[start:stop]
        part = part[np.isfinite(part)]
        if part.size:
            out.append([(start + stop - 1) / 2.0, *np.quantile(part, [0.0, 1 / 6, 5 / 6, 1.0])])
    centres, low, below, above, high = np.array(out).reshape(-1, 5).T
    return centres, low, below, above, high


def evenly_spread(places: Array, size: Array, cells: int = 22) -> NDArray[np.intp]:
    """Return one row for each cell of a square grid over the plane: the largest one."""
    good = np.flatnonzero(np.isfinite(places).all(axis=1) & np.isfinite(size))
    if good.size <= cells * cells:
        return np.asarray(good, dtype=np.intp)
    xy = places[good]
    low = xy.min(axis=0)
    width = max(float((xy.max(axis=0) - low).max()), 1e-300)
    cell = np.minimum(((xy - low) / width * cells).astype(int), cells - 1)
    key = cell[:, 0] * cells + cell[:, 1]
    order = np.lexsort((-size[good], key))
    _, first = np.unique(key[order], return_index=True)
    return np.asarray(good[order[first]], dtype=np.intp)


def plane(rows: DataRows, unit: str) -> list[Drawing | None]:
    """Return error vectors where they were measured, or their scatter where that is unknown."""
    table = rows.table
    keep = used(table)
    out = []
    for stage in ("before", "after"):
        vector = np.column_stack([table.number(f"{stage}_x"), table.number(f"{stage}_y")])
        vector[~keep] = np.nan
        if not np.isfinite(vector).all(axis=1).any():
            continue
        if rows.positions is not None:
            out.append(error_vectors(rows, rows.positions, vector, stage, unit))
        elif stage == "after":
            out.append(scatter(rows, vector, unit))
    return out


def square(x: Array, y: Array) -> tuple[Axis, Axis]:
    """Return axes with equal scales in x and y that hold the points."""
    a, b = span(x, margin=0.1), span(y, margin=0.1)
    wide = (WIDTH - LEFT - RIGHT) / (HEIGHT - TOP - BOTTOM)
    half = 0.5 * max(b.high - b.low, (a.high - a.low) / wide)
    cx, cy = (a.low + a.high) / 2.0, (b.low + b.high) / 2.0
    return Axis(cx - half * wide, cx + half * wide), Axis(cy - half, cy + half)


def error_vectors(data: DataRows, places: Array, vector: Array, stage: str, unit: str
                  ) -> Drawing | None:
    """Return error vectors at the measured places, enlarged, with their scale."""
    size = np.hypot(vector[:, 0], vector[:, 1])
    rows = evenly_spread(places, size)
    if not rows.size:
        return None
    at, largest = places[rows], float(size[rows].max())
    largest = largest if largest > 1e-140 else 1.0
    step = next(s for s in sorted(m * 10.0 ** (np.floor(np.log10(largest)) - d)
                                  for d in (0, 1) for m in (1, 2, 5))[::-1] if s <= largest)
    scale = 34.0 / largest
    dx, dy = (vector[rows] * scale).T
    x, y = square(at[:, 0], at[:, 1])
    per, length = (x.high - x.low) / (WIDTH - LEFT - RIGHT), np.array([step * scale])
    total = int(np.sum(np.isfinite(size)))
    note = (f" Thinned: the largest of each cell, {rows.size} of {whole(total)} rows."
            if rows.size < total else "")
    return Plot(
        x, y, ("measured x (unit of the file)", "measured y (unit of the file)"),
        [Arrows(at[:, 0], at[:, 1], dx, dy, stage, size[rows], unit, replace(
            data.points(rows), undrawn=data.undrawn(
                np.where(np.isfinite(size), places[:, 1], np.nan), places[:, 0])
            if rows.size < total else None)),
         Arrows(x.high - per * (10.0 + length), np.array([y.high - 10.0 * per]), length,
                0.0 * length, "ink"),
         WordsAt(14.0 + float(length[0]), 14.0, with_unit(step, unit, 1))], equal=True).drawing(
        f"Error vectors in the plane, {stage}",
        f"Each plot has its own scale (arrow at the top right).{note}",
        f"{rows.size} vectors; the longest is {with_unit(largest, unit)}.", ((stage, stage),))


def scatter(data: DataRows, vector: Array, unit: str) -> Drawing:
    """Return residuals in x and y against each other."""
    rows = np.flatnonzero(np.isfinite(vector).all(axis=1))
    total = rows.size
    if total > POINTS:
        order = rows[np.argsort(np.hypot(*vector[rows].T))]
        rows = np.unique(np.concatenate([order[-200:], order[::max(1, total // 1000)]]))
    v = vector[rows]
    x, y = square(v[:, 0], v[:, 1])
    note = (f" Thinned: {whole(rows.size)} of {whole(total)} rows, with the 200 largest."
            if rows.size < total else "")
    return Plot(
        x, y, (with_label("x", unit), with_label("y", unit)),
        [Zero(upright=True), Zero(), Dots(v[:, 0], v[:, 1], "after", points=replace(
            data.points(rows), undrawn=data.undrawn(vector[:, 1], vector[:, 0])
            if rows.size < total else None))],
        (unit, unit), equal=True).drawing(
        "Residuals in the plane, after", f"A round cloud about 0 is what noise gives.{note}",
        f"Residual in y against residual in x of {total} rows.")


CROSSES = 100
"""At most so many of the rows left out are drawn."""
LARGEST = 50
"""So many of the largest are dots of their own where rows are thinned."""
ROWS = "row, in the order of the file"
BEFORE_AFTER = (("before", "before"), ("after", "after"))


def residual_figures(rows: DataRows | None) -> list[Drawing]:
    """Return the pictures of all residuals together: over their noise, and as norms by row."""
    if rows is None or not rows.table.size:
        return []
    out = [histogram(rows), *(by_row(rows, n, rows.units.name(n.quantity))
                              for n in norms(rows.table))]
    return [p for p in out if p is not None]


def coordinate_figures(rows: DataRows | None) -> list[Drawing]:
    """Return the pictures of each measured coordinate, and those in the plane."""
    if rows is None or not rows.table.size:
        return []
    have, units = coordinates(rows.table), rows.units
    out = [coordinate(rows, c, units.name(quantity_of(c))) for c in have]
    if "x" in have and "y" in have:
        out += plane(rows, units.length)
    return [p for p in out if p is not None]


def histogram(rows: DataRows) -> Drawing | None:
    """Return white residuals with the normal curve that they should follow."""
    found, share = white(rows.table, rows.freedoms), gap_share(rows.table, rows.freedoms)
    values, size = found.values, found.values.size
    if found.rms is None or size < 4:
        return None
    edges = np.linspace(-5.0, 5.0, 41 if size > 300 else 21)
    step = float(edges[1] - edges[0])
    density = np.histogram(np.clip(values, -4.999, 4.999), edges)[0] / (size * step)
    curve = np.linspace(-5.0, 5.0, 101)
    normal = np.exp(-0.5 * curve**2) / np.sqrt(2.0 * np.pi)
    far = f" {count(found.far, 'value')} beyond 5 sigma in the outer bars." if found.far else ""
    fitted = (f" Sigma of gaps: {share:.2g} of the limbs' noise, since each row's pose is fitted "
              "to all of them." if share < 1.0 else "")
    return Plot(
        Axis(-5.0, 5.0), Axis(0.0, 1.08 * max(float(density.max()), 0.42)),
        ("residual / sigma", "density"),
        [Histogram(edges, density), Polyline(curve, normal, "what pure noise gives")]).drawing(
        "Residuals over their noise, after",
        f"{count(size, 'value')}, rms {sig(found.rms)}; line: what pure noise gives "
        f"(rms 1).{far}{fitted}", f"Histogram of {size} values with the standard normal curve; "
        f"their rms is {found.rms:.2f}.")


def by_row(rows: DataRows, residual: ResidualNorm, unit: str) -> Drawing | None:
    """Return the norm of the error by row before and after, on a logarithmic scale."""
    table = rows.table
    keep = used(table)
    before, after = (np.where(v > 0.0, v, np.nan) for v in (residual.before, residual.after))
    if not np.isfinite(after).any():
        return None
    return Plot(
        Axis(0.0, table.size + 1.0), span([before, after], log=True),
        (ROWS, with_label(residual.name, unit)),
        [_starts(table), *series(np.where(keep, before, np.nan), "before", rows, unit),
         *series(np.where(keep, after, np.nan), "after", rows, unit), _left_out(after, keep, rows)],
        ("", unit)).drawing(
        f"Error of {residual.name} by row, before and after", subsampled(table.size) + few(keep),
        f"{table.size} rows on a logarithmic scale.",
        BEFORE_AFTER if keep.all() else (*BEFORE_AFTER, ("out", "left out")))


def coordinate(rows: DataRows, name: str, unit: str) -> Drawing | None:
    """Return one coordinate's residual after the fit by row, with two sigma."""
    table = rows.table
    keep, values = used(table), table.number(f"after_{name}")
    inside = np.where(keep, values, np.nan)
    if not np.isfinite(inside).any():
        return None
    two = 2.0 * typical_sigma(table, name, rows.freedoms)
    caption = f"Band: ±2 sigma of the noise ({with_unit(two, unit)})." if two else ""
    return Plot(
        Axis(0.0, table.size + 1.0), span(np.append(inside, two), zero=True),
        (ROWS, with_label(name, unit)),
        [Band(-two, two), _starts(table), *series(inside, "after", rows, unit),
         _left_out(values, keep, rows)], ("", unit)).drawing(
        f"Residual of {name} by row, after", f"{caption}{subsampled(table.size)}{few(keep)}",
        f"{table.size} rows; rms {with_unit(rms(inside), unit)}.",
        () if keep.all() else (("after", "after"), ("out", "left out (at the edge: beyond it)")))


def series(values: Array, kind: str, rows: DataRows | None = None, unit: str = "") -> list[Layer]:
    """Return dots; where there are too many, strokes from lowest to highest, and the largest.

    Without ``rows`` the points are not rows of data, and called by their number.
    """
    def points(index: NDArray[np.integer[Any]]) -> Points:
        if rows is None:
            return Points([f"target {i + 1}" for i in index.tolist()])
        rest = rows.undrawn(values) if index.size < values.size else None
        return replace(rows.points(index), undrawn=rest)

    every = np.arange(values.size)
    if values.size <= POINTS:
        return [Dots(every + 1.0, values, kind, 3.4 if kind == "before" else 4.0, points(every))]
    x, low, below, above, high = envelope(values)
    said = Points([f"rows about {at + 1.0:.0f}\n{kind}: {sig(v)} … {with_unit(w, unit)}"
                   for at, v, w in zip(x.tolist(), low.tolist(), high.tolist(), strict=True)])
    size = np.where(np.isfinite(values), np.abs(values), -1.0)
    largest = np.sort(np.argsort(size)[-LARGEST:])
    return [Strokes(x + 1.0, low, high, kind, alpha=0.35, points=said),
            Strokes(x + 1.0, below, above, kind),
            Dots(largest + 1.0, values[largest], kind, 3.4, points(largest))]


def subsampled(size: int) -> str:
    """Return the note on thinning, empty for few rows."""
    if size <= POINTS:
        return ""
    return (f" Thinned: each stroke spans the lowest to the highest of about "
            f"{whole(round(size / BINS))} rows, its dark part the middle two thirds; the {LARGEST} "
            "largest are dots.")


def _starts(table: Table) -> Layer:
    """Draw a mark where each further data set begins (of up to twelve)."""
    names = table.words("dataset")
    found = [(i, name) for i, name in enumerate(names) if i == 0 or name != names[i - 1]]
    return Starts([(i + 0.5, name) for i, name in found] if 1 < len(found) <= 12 else [])


def few(keep: Bools) -> str:
    """Return the note that not all rows left out are drawn, empty if they are."""
    return f" {CROSSES} of the rows left out are drawn." if int((~keep).sum()) > CROSSES else ""


def _left_out(values: Array, keep: Bools, data: DataRows) -> Layer:
    rows = np.flatnonzero(~keep & np.isfinite(values))
    if rows.size > CROSSES:
        rows = rows[np.linspace(0, rows.size - 1, CROSSES).astype(int)]
    return Marks(rows + 1.0, values[rows], "out", "x", points=data.points(rows))


def command_figure(rows: CheckedRows[CommandsRecord], kind: str, unit: str) -> Drawing | None:
    """Return the predicted error of the commands, before and after compensation."""
    table = rows.table
    if table is None or f"error_{kind}_after" not in table.numbers:
        return None
    values = [np.where(v > 0.0, v, np.nan) for v in predicted_errors(table, kind).values()]
    if not np.isfinite(values).any():
        return None
    return Plot(
        Axis(0.0, table.size + 1.0), span(values, log=True),
        ("target, in the order of the file", with_label(kind, unit)),
        [*series(values[0], "before", unit=unit), *series(values[1], "after", unit=unit)],
        ("", unit)).drawing(
        f"Predicted error of {kind} by target",
        f"After: the model's own uncertainty, 1 sigma. {subsampled(table.size)}",
        f"{table.size} targets on a logarithmic scale.", BEFORE_AFTER)


def truth_figures(c: ComparedMachines) -> list[Drawing]:
    """Return found against true errors for each unit, and z by parameter."""
    out = []
    for unit in dict.fromkeys(r.unit for r in c.rows):
        rows = [r for r in c.rows if r.unit == unit]
        true, found = (np.array([getattr(r, k) for r in rows]) for k in ("true", "found"))
        two = np.array([r.half or 0.0 for r in rows])
        x, y = span(true), span(np.concatenate([true, found - two, found + two]))
        ends = [max(x.low, y.low), min(x.high, y.high)]
        said = Points([f"{r.name}\n± {sig(w, 2)} {unit} (95 %)".rstrip()
                       for r, w in zip(rows, two.tolist(), strict=True)])
        out.append(Plot(
            x, y, (with_label("true error", unit), with_label("found", unit)),
            [Polyline(ends, ends, "found = true"),
             Strokes(true, found - two, found + two, "after", 1.0),
             Dots(true, found, "after", points=said)], (unit, unit)).drawing(
            "Error found against the true one" + (f", in {unit}" if unit else ""),
            "Line: found = true; bars: 95 % interval.",
            f"{len(rows)} parameters with 95 % intervals."))
    z = np.array([np.nan if r.z is None else r.z for r in c.rows])
    if np.isfinite(z).any():
        at = np.arange(z.size) + 1.0
        out.append(Plot(
            Axis(0.0, z.size + 1.0), span([*z, 3.0], zero=True),
            ("parameter, in the order of the table", "z"),
            [Band(-2.0, 2.0), Strokes(at, 0.0 * z, z, "after", 1.0),
             Dots(at, z, "after", points=Points([r.name for r in c.rows]))]).drawing(
            "Deviation from the truth in standard deviations",
            "Band: ±2, where 95 % should lie.", f"z of {z.size} parameters."))
    return out
