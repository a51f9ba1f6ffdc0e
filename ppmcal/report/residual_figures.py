"""The drawings of the report, as HTML figures with captions."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from ppmcal.io.results.record import UnitNames
from ppmcal.linalg import Array, Bools
from ppmcal.report import svg
from ppmcal.report.format import count, sig, whole, with_unit
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
    quantity_of,
    used,
    white,
)

CROSSES = 100
"""At most so many of the rows left out are drawn."""
BEFORE_AFTER = '<i class="key before"></i>before <i class="key after"></i>after'
LEFT_OUT = ' <i class="key out"></i>left out'


def figure(drawing: str, caption: str, key: str = "") -> str:
    """Return a figure; ``caption`` is plain text, ``key`` HTML."""
    legend = f'<span class="legend">{key}</span> ' if key else ""
    return f"<figure>{drawing}<figcaption>{legend}{escape(caption)}</figcaption></figure>"


def with_label(name: str, unit: str) -> str:
    """Return ``x (mm)``."""
    return f"{name} ({unit})" if unit else name


def residual_figures(table: Columns | None, units: UnitNames, positions: Array | None = None
                     ) -> list[str]:
    """Return all drawings of residuals.csv; ``positions``: measured x, y (N, 2) of its rows."""
    if table is None or not table.size:
        return []
    out = [histogram(white(table))]
    out += [by_row(table, g, units.of_quantity(g.quantity)) for g in groups(table)]
    have = coordinates(table)
    out += [coordinate(table, c, units.of_quantity(quantity_of(c))) for c in have]
    if "x" in have and "y" in have:
        out += plane(table, units.length, positions)
    return [f for f in out if f]


def histogram(values: Array) -> str:
    """Return white residuals with the normal curve that they should follow."""
    if values.size < 4:
        return ""
    edges = np.linspace(-5.0, 5.0, 41 if values.size > 300 else 21)
    step = float(edges[1] - edges[0])
    counts = np.histogram(np.clip(values, -4.999, 4.999), edges)[0]
    density = counts / (values.size * step)
    curve = np.linspace(-5.0, 5.0, 101)
    normal = np.exp(-0.5 * curve**2) / np.sqrt(2.0 * np.pi)
    frame = svg.Frame(svg.Axis(-5.0, 5.0),
                      svg.Axis(0.0, 1.08 * max(float(density.max()), 0.42)))
    outside = int(np.sum(np.abs(values) > 5.0))
    rms = float(np.sqrt(np.mean(values**2)))
    title = "Residuals over their stated noise"
    drawing = svg.document(title, f"Histogram of {values.size} values with the standard normal "
                           f"curve; their rms is {rms:.2f}.",
                           [svg.axes(frame, "residual / sigma", "density"),
                            svg.bars(frame, edges, density, "after"),
                            svg.line(frame, curve, normal, "ink")])
    far = f" {count(outside, 'value')} beyond 5 sigma in the outer bars." if outside else ""
    return figure(drawing, f"{title}, after: {count(values.size, 'value')}, rms {sig(rms)}; "
                  f"line: what pure noise gives (rms 1).{far}")


def by_row(table: Columns, group: LimbResiduals, unit: str) -> str:
    """Return the norm of the error by row before and after, on a logarithmic scale."""
    keep = used(table)
    positive = [np.where(v > 0.0, v, np.nan) for v in (group.before, group.after)]
    if not np.isfinite(positive[1]).any():
        return ""
    frame = svg.Frame(svg.Axis(0.0, table.size + 1.0), svg.span(positive, log=True))
    parts = [svg.axes(frame, "row, in the order of the file", with_label(group.name, unit)),
             _starts(frame, table)]
    for values, kind in zip(positive, ("before", "after"), strict=True):
        parts.append(series(frame, np.where(keep, values, np.nan), kind))
    parts.append(_left_out(frame, positive[1], keep))
    title = f"Error of {group.name} by row, before and after"
    note = subsampled(table.size) + few(keep)
    drawing = svg.document(title, f"{table.size} rows on a logarithmic scale.", parts)
    return figure(drawing, f"{title}.{note}", BEFORE_AFTER + ("" if keep.all() else LEFT_OUT))


def coordinate(table: Columns, name: str, unit: str) -> str:
    """Return one coordinate's residual after the fit by row, with two sigma."""
    keep, values = used(table), table.number(f"after_{name}")
    inside = np.where(keep, values, np.nan)
    if not np.isfinite(inside).any():
        return ""
    sigma = table.number(f"sigma_{name}")[keep]
    sigma = sigma[np.isfinite(sigma)]
    two = 2.0 * float(np.median(sigma)) if sigma.size else 0.0
    frame = svg.Frame(svg.Axis(0.0, table.size + 1.0),
                      svg.span(np.append(inside, two), zero=True))
    parts = [svg.box(frame, -two, two, "band") if two else "",
             svg.axes(frame, "row, in the order of the file", with_label(name, unit)),
             _starts(frame, table), series(frame, inside, "after"),
             _left_out(frame, values, keep)]
    title = f"Residual of {name} by row, after"
    drawing = svg.document(title, f"{table.size} rows; rms "
                           f"{with_unit(float(np.sqrt(np.nanmean(inside**2))), unit)}.", parts)
    band = f" Band: ±2 sigma of the stated noise ({with_unit(two, unit)})." if two else ""
    clipped = "" if keep.all() else LEFT_OUT + " (at the edge: beyond it)"
    return figure(drawing, f"{title}.{band}{subsampled(table.size)}{few(keep)}",
                  f'<i class="key after"></i>after{clipped}' if clipped else "")


def series(frame: svg.Frame, values: Array, kind: str) -> str:
    """Return dots, or strokes from lowest to highest where there are too many."""
    if values.size <= POINTS:
        return svg.points(frame, np.arange(values.size) + 1.0, values, kind)
    x, low, below, above, high = envelope(values)
    return (svg.strokes(frame, x + 1.0, low, high, f"light {kind}")
            + svg.strokes(frame, x + 1.0, below, above, kind))


def subsampled(size: int) -> str:
    """Return the note on thinning, empty for few rows."""
    if size <= POINTS:
        return ""
    return (f" Thinned: each stroke spans the lowest to the highest of about "
            f"{whole(round(size / BINS))} rows, its dark part the middle two thirds.")


def _starts(frame: svg.Frame, table: Columns) -> str:
    """Return a mark where each further data set begins (of up to twelve)."""
    starts = boundaries(table)
    if not 1 < len(starts) <= 12:
        return ""
    parts = []
    for i, name in starts:
        x = float(frame.px(i + 0.5))
        parts.append(f'<path class="mark" d="M{svg.num(x)} {svg.num(svg.TOP)}'
                     f'V{svg.num(svg.HEIGHT - svg.BOTTOM)}"/>')
        parts.append(svg.text(x + 3, svg.TOP + 8, name[:14], kind="small"))
    return "".join(parts)


def few(keep: Bools) -> str:
    """Return the note that not all rows left out are drawn, empty if they are."""
    return f" {CROSSES} of the rows left out are drawn." if int((~keep).sum()) > CROSSES else ""


def _left_out(frame: svg.Frame, values: Array, keep: Bools) -> str:
    rows = np.flatnonzero(~keep & np.isfinite(values))
    if rows.size > CROSSES:
        rows = rows[np.linspace(0, rows.size - 1, CROSSES).astype(int)]
    return svg.crosses(frame, rows + 1.0, values[rows], "out")


def plane(table: Columns, unit: str, positions: Array | None) -> list[str]:
    """Return error vectors where they were measured, or their scatter where that is unknown."""
    keep = used(table)
    out = []
    for stage in ("before", "after"):
        vector = np.column_stack([table.number(f"{stage}_x"), table.number(f"{stage}_y")])
        vector[~keep] = np.nan
        if not np.isfinite(vector).all(axis=1).any():
            continue
        if positions is not None:
            out.append(arrows(positions, vector, stage, unit))
        elif stage == "after":
            out.append(scatter(vector, unit))
    return out


def square(x: Array, y: Array) -> svg.Frame:
    """Return a frame with equal scales in x and y that holds the points."""
    a, b = svg.span(x, margin=0.1), svg.span(y, margin=0.1)
    wide = (svg.WIDTH - svg.LEFT - svg.RIGHT) / (svg.HEIGHT - svg.TOP - svg.BOTTOM)
    height = max(b.high - b.low, (a.high - a.low) / wide)
    cx, cy = (a.low + a.high) / 2.0, (b.low + b.high) / 2.0
    return svg.Frame(svg.Axis(cx - height * wide / 2.0, cx + height * wide / 2.0),
                     svg.Axis(cy - height / 2.0, cy + height / 2.0))


def arrows(places: Array, vector: Array, stage: str, unit: str) -> str:
    """Return error vectors at the measured places, enlarged, with their scale."""
    size = np.hypot(vector[:, 0], vector[:, 1])
    rows = evenly_spread(places, size)
    if not rows.size:
        return ""
    frame = square(places[rows, 0], places[rows, 1])
    largest = float(size[rows].max())
    largest = largest if largest > 1e-140 else 1.0
    step = next(s for s in sorted(m * 10.0 ** (np.floor(np.log10(largest)) - d)
                                  for d in (0, 1) for m in (1, 2, 5))[::-1] if s <= largest)
    scale = 34.0 / largest
    v = vector[rows] * scale
    length = step * scale
    parts = [svg.axes(frame, "measured x", "measured y"),
             svg.segments(frame.px(places[rows, 0]), frame.py(places[rows, 1]), v[:, 0], -v[:, 1],
                          stage),
             svg.segments(np.array([svg.WIDTH - 20 - length]), np.array([22.0]),
                          np.array([length]), np.array([0.0]), "ink"),
             svg.text(svg.WIDTH - 24 - length, 26, with_unit(step, unit, 1), "end")]
    title = f"Error vectors in the plane, {stage}"
    drawing = svg.document(title, f"{rows.size} vectors; the longest is "
                           f"{with_unit(largest, unit)}.", parts)
    total = int(np.sum(np.isfinite(size)))
    note = (f" Thinned: the largest of each cell, {rows.size} of {whole(total)} rows."
            if rows.size < total else "")
    return figure(drawing, f"{title}; each plot has its own scale (arrow at the top right).{note}",
                  f'<i class="key {stage}"></i>{stage}')


def scatter(vector: Array, unit: str) -> str:
    """Return residuals in x and y against each other."""
    rows = np.flatnonzero(np.isfinite(vector).all(axis=1))
    total = rows.size
    if total > POINTS:
        order = rows[np.argsort(np.hypot(*vector[rows].T))]
        rows = np.unique(np.concatenate([order[-200:], order[::max(1, total // 1000)]]))
    v = vector[rows]
    frame = square(v[:, 0], v[:, 1])
    title = "Residuals in the plane, after"
    drawing = svg.document(title, f"Residual in y against residual in x of {total} rows.",
                           [svg.axes(frame, with_label("x", unit), with_label("y", unit)),
                            svg.line(frame, [0.0, 0.0], [frame.y.low, frame.y.high], "faint"),
                            svg.line(frame, [frame.x.low, frame.x.high], [0.0, 0.0], "faint"),
                            svg.points(frame, v[:, 0], v[:, 1], "after")])
    note = (f" Thinned: {whole(rows.size)} of {whole(total)} rows, with the 200 largest."
            if rows.size < total else "")
    return figure(drawing, f"{title}; a round cloud about 0 is what noise gives.{note}")


def command_figure(rows: ResidualRows, kind: str, unit: str) -> str:
    """Return the predicted error of the commands, before and after compensation."""
    table = rows.table
    if table is None or f"error_{kind}_after" not in table.numbers:
        return ""
    values = [np.where(v > 0.0, v, np.nan) for v in
              (table.number(f"error_{kind}_before"), table.number(f"error_{kind}_after"))]
    if not np.isfinite(values).any():
        return ""
    frame = svg.Frame(svg.Axis(0.0, table.size + 1.0), svg.span(values, log=True))
    parts = [svg.axes(frame, "target, in the order of the file", with_label(kind, unit))]
    parts += [series(frame, v, k) for v, k in zip(values, ("before", "after"), strict=True)]
    title = f"Predicted error of {kind} by target"
    return figure(svg.document(title, f"{table.size} targets on a logarithmic scale.", parts),
                  f"{title}.{subsampled(table.size)}", BEFORE_AFTER)


def truth_figures(c: ComparedMachines) -> list[str]:
    """Return found against true errors for each unit, and z by parameter."""
    out = []
    for unit in dict.fromkeys(r.unit for r in c.rows):
        rows = [r for r in c.rows if r.unit == unit]
        true, found = (np.array([getattr(r, k) for r in rows]) for k in ("true", "found"))
        two = np.array([1.96 * (r.sigma or 0.0) for r in rows])
        both = svg.span(np.concatenate([true, found - two, found + two]))
        frame = svg.Frame(svg.span(true), both)
        ends = [max(frame.x.low, both.low), min(frame.x.high, both.high)]
        parts = [svg.axes(frame, with_label("true error", unit), with_label("found", unit)),
                 svg.line(frame, ends, ends, "ink"),
                 svg.strokes(frame, true, found - two, found + two, "thin after"),
                 svg.points(frame, true, found, "after")]
        title = "Error found against the true one" + (f", in {unit}" if unit else "")
        out.append(figure(svg.document(title, f"{len(rows)} parameters with 95 % intervals.",
                                       parts),
                          f"{title}. Line: found = true; bars: 95 % interval."))
    return [*out, *_z_figure([r.z for r in c.rows])]


def _z_figure(z: Sequence[float | None]) -> list[str]:
    values = np.array([np.nan if v is None else v for v in z])
    if not np.isfinite(values).any():
        return []
    frame = svg.Frame(svg.Axis(0.0, values.size + 1.0), svg.span([*values, 3.0], zero=True))
    x = np.arange(values.size) + 1.0
    title = "Deviation from the truth in standard deviations"
    drawing = svg.document(title, f"z of {values.size} parameters.", [
        svg.box(frame, -2.0, 2.0, "band"),
        svg.axes(frame, "parameter, in the order of the table", "z"),
        svg.strokes(frame, x, np.minimum(values, 0.0), np.maximum(values, 0.0), "thin after"),
        svg.points(frame, x, values, "after")])
    return [figure(drawing, f"{title}. Band: ±2, where 95 % should lie.")]
