"""Pictures of residuals, of predicted errors and of the simulated truth."""

from __future__ import annotations

import numpy as np

from ppmcal.io.results.record import UnitNames
from ppmcal.linalg import Array, Bools
from ppmcal.plotting import plot
from ppmcal.plotting.canvas import HEIGHT, WIDTH, Drawing
from ppmcal.plotting.plot import BOTTOM, LEFT, RIGHT, TOP, Axis, Layer, plotted, span
from ppmcal.report.format import count, sig, whole, with_label, with_unit
from ppmcal.report.records import Columns, ComparedMachines, ResidualRows
from ppmcal.report.residuals import (
    BINS,
    POINTS,
    LimbResiduals,
    boundaries,
    coordinates,
    envelope,
    evenly_spread,
    groups,
    predicted,
    quantity_of,
    used,
    white,
)

CROSSES = 100
"""At most so many of the rows left out are drawn."""
ROWS = "row, in the order of the file"
BEFORE_AFTER = (("before", "before"), ("after", "after"))


def residual_figures(table: Columns | None, units: UnitNames, positions: Array | None = None
                     ) -> list[Drawing]:
    """Return all pictures of residuals.csv; ``positions``: measured x, y (N, 2) of its rows."""
    if table is None or not table.size:
        return []
    out = [histogram(white(table))]
    out += [by_row(table, g, units.of_quantity(g.quantity)) for g in groups(table)]
    have = coordinates(table)
    out += [coordinate(table, c, units.of_quantity(quantity_of(c))) for c in have]
    if "x" in have and "y" in have:
        out += plane(table, units.length, positions)
    return [p for p in out if p is not None]


def histogram(values: Array) -> Drawing | None:
    """Return white residuals with the normal curve that they should follow."""
    if values.size < 4:
        return None
    edges = np.linspace(-5.0, 5.0, 41 if values.size > 300 else 21)
    step = float(edges[1] - edges[0])
    density = np.histogram(np.clip(values, -4.999, 4.999), edges)[0] / (values.size * step)
    curve = np.linspace(-5.0, 5.0, 101)
    normal = np.exp(-0.5 * curve**2) / np.sqrt(2.0 * np.pi)
    outside = int(np.sum(np.abs(values) > 5.0))
    rms = float(np.sqrt(np.mean(values**2)))
    far = f" {count(outside, 'value')} beyond 5 sigma in the outer bars." if outside else ""
    return plotted(
        "Residuals over their stated noise, after",
        f"{count(values.size, 'value')}, rms {sig(rms)}; line: what pure noise gives "
        f"(rms 1).{far}", f"Histogram of {values.size} values with the standard normal curve; "
        f"their rms is {rms:.2f}.", Axis(-5.0, 5.0),
        Axis(0.0, 1.08 * max(float(density.max()), 0.42)), ("residual / sigma", "density"),
        [plot.columns(edges, density), plot.line(curve, normal)])


def by_row(table: Columns, group: LimbResiduals, unit: str) -> Drawing | None:
    """Return the norm of the error by row before and after, on a logarithmic scale."""
    keep = used(table)
    before, after = (np.where(v > 0.0, v, np.nan) for v in (group.before, group.after))
    if not np.isfinite(after).any():
        return None
    return plotted(
        f"Error of {group.name} by row, before and after", subsampled(table.size) + few(keep),
        f"{table.size} rows on a logarithmic scale.", Axis(0.0, table.size + 1.0),
        span([before, after], log=True), (ROWS, with_label(group.name, unit)),
        [_starts(table), *series(np.where(keep, before, np.nan), "before"),
         *series(np.where(keep, after, np.nan), "after"), _left_out(after, keep)],
        BEFORE_AFTER if keep.all() else (*BEFORE_AFTER, ("out", "left out")))


def coordinate(table: Columns, name: str, unit: str) -> Drawing | None:
    """Return one coordinate's residual after the fit by row, with two sigma."""
    keep, values = used(table), table.number(f"after_{name}")
    inside = np.where(keep, values, np.nan)
    if not np.isfinite(inside).any():
        return None
    sigma = table.number(f"sigma_{name}")[keep]
    sigma = sigma[np.isfinite(sigma)]
    two = 2.0 * float(np.median(sigma)) if sigma.size else 0.0
    caption = f"Band: ±2 sigma of the stated noise ({with_unit(two, unit)})." if two else ""
    return plotted(
        f"Residual of {name} by row, after", f"{caption}{subsampled(table.size)}{few(keep)}",
        f"{table.size} rows; rms {with_unit(float(np.sqrt(np.nanmean(inside**2))), unit)}.",
        Axis(0.0, table.size + 1.0), span(np.append(inside, two), zero=True),
        (ROWS, with_label(name, unit)),
        [plot.band(-two, two), _starts(table), *series(inside, "after"), _left_out(values, keep)],
        () if keep.all() else (("after", "after"), ("out", "left out (at the edge: beyond it)")))


def series(values: Array, kind: str) -> list[Layer]:
    """Return dots, or strokes from lowest to highest where there are too many."""
    if values.size <= POINTS:
        rows = np.arange(values.size) + 1.0
        return [plot.dots(rows, values, kind, 3.4 if kind == "before" else 4.0)]
    x, low, below, above, high = envelope(values)
    return [plot.strokes(x + 1.0, low, high, kind, alpha=0.35),
            plot.strokes(x + 1.0, below, above, kind)]


def subsampled(size: int) -> str:
    """Return the note on thinning, empty for few rows."""
    if size <= POINTS:
        return ""
    return (f" Thinned: each stroke spans the lowest to the highest of about "
            f"{whole(round(size / BINS))} rows, its dark part the middle two thirds.")


def _starts(table: Columns) -> Layer:
    """Draw a mark where each further data set begins (of up to twelve)."""
    found = boundaries(table)
    return plot.starts([(i + 0.5, name) for i, name in found] if 1 < len(found) <= 12 else [])


def few(keep: Bools) -> str:
    """Return the note that not all rows left out are drawn, empty if they are."""
    return f" {CROSSES} of the rows left out are drawn." if int((~keep).sum()) > CROSSES else ""


def _left_out(values: Array, keep: Bools) -> Layer:
    rows = np.flatnonzero(~keep & np.isfinite(values))
    if rows.size > CROSSES:
        rows = rows[np.linspace(0, rows.size - 1, CROSSES).astype(int)]
    return plot.marks(rows + 1.0, values[rows], "out", "x")


def plane(table: Columns, unit: str, positions: Array | None) -> list[Drawing | None]:
    """Return error vectors where they were measured, or their scatter where that is unknown."""
    keep = used(table)
    out = []
    for stage in ("before", "after"):
        vector = np.column_stack([table.number(f"{stage}_x"), table.number(f"{stage}_y")])
        vector[~keep] = np.nan
        if not np.isfinite(vector).all(axis=1).any():
            continue
        if positions is not None:
            out.append(error_vectors(positions, vector, stage, unit))
        elif stage == "after":
            out.append(scatter(vector, unit))
    return out


def square(x: Array, y: Array) -> tuple[Axis, Axis]:
    """Return axes with equal scales in x and y that hold the points."""
    a, b = span(x, margin=0.1), span(y, margin=0.1)
    wide = (WIDTH - LEFT - RIGHT) / (HEIGHT - TOP - BOTTOM)
    half = 0.5 * max(b.high - b.low, (a.high - a.low) / wide)
    cx, cy = (a.low + a.high) / 2.0, (b.low + b.high) / 2.0
    return Axis(cx - half * wide, cx + half * wide), Axis(cy - half, cy + half)


def error_vectors(places: Array, vector: Array, stage: str, unit: str) -> Drawing | None:
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
    return plotted(
        f"Error vectors in the plane, {stage}",
        f"Each plot has its own scale (arrow at the top right).{note}",
        f"{rows.size} vectors; the longest is {with_unit(largest, unit)}.", x, y,
        ("measured x", "measured y"),
        [plot.arrows(at[:, 0], at[:, 1], dx, dy, stage),
         plot.arrows(x.high - per * (10.0 + length), np.array([y.high - 10.0 * per]), length,
                0.0 * length, "ink"),
         plot.words_at(14.0 + float(length[0]), 14.0, with_unit(step, unit, 1))], ((stage, stage),))


def scatter(vector: Array, unit: str) -> Drawing:
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
    return plotted(
        "Residuals in the plane, after", f"A round cloud about 0 is what noise gives.{note}",
        f"Residual in y against residual in x of {total} rows.", x, y,
        (with_label("x", unit), with_label("y", unit)),
        [plot.zero(upright=True), plot.zero(), plot.dots(v[:, 0], v[:, 1], "after")])


def command_figure(rows: ResidualRows, kind: str, unit: str) -> Drawing | None:
    """Return the predicted error of the commands, before and after compensation."""
    table = rows.table
    if table is None or f"error_{kind}_after" not in table.numbers:
        return None
    values = [np.where(v > 0.0, v, np.nan) for v in predicted(table, kind).values()]
    if not np.isfinite(values).any():
        return None
    return plotted(
        f"Predicted error of {kind} by target",
        f"After: the model's own uncertainty, 1 sigma. {subsampled(table.size)}".strip(),
        f"{table.size} targets on a logarithmic scale.", Axis(0.0, table.size + 1.0),
        span(values, log=True), ("target, in the order of the file", with_label(kind, unit)),
        [*series(values[0], "before"), *series(values[1], "after")], BEFORE_AFTER)


def truth_figures(c: ComparedMachines) -> list[Drawing]:
    """Return found against true errors for each unit, and z by parameter."""
    out = []
    for unit in dict.fromkeys(r.unit for r in c.rows):
        rows = [r for r in c.rows if r.unit == unit]
        true, found = (np.array([getattr(r, k) for r in rows]) for k in ("true", "found"))
        two = np.array([1.96 * (r.sigma or 0.0) for r in rows])
        x, y = span(true), span(np.concatenate([true, found - two, found + two]))
        ends = [max(x.low, y.low), min(x.high, y.high)]
        out.append(plotted(
            "Error found against the true one" + (f", in {unit}" if unit else ""),
            "Line: found = true; bars: 95 % interval.",
            f"{len(rows)} parameters with 95 % intervals.", x, y,
            (with_label("true error", unit), with_label("found", unit)),
            [plot.line(ends, ends), plot.strokes(true, found - two, found + two, "after", 1.0),
             plot.dots(true, found, "after")]))
    z = np.array([np.nan if r.z is None else r.z for r in c.rows])
    if np.isfinite(z).any():
        at = np.arange(z.size) + 1.0
        out.append(plotted(
            "Deviation from the truth in standard deviations",
            "Band: ±2, where 95 % should lie.", f"z of {z.size} parameters.",
            Axis(0.0, z.size + 1.0), span([*z, 3.0], zero=True),
            ("parameter, in the order of the table", "z"),
            [plot.band(-2.0, 2.0), plot.strokes(at, 0.0 * z, z, "after", 1.0),
             plot.dots(at, z, "after")]))
    return out
