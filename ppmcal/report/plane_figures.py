"""Pictures of residuals in the plane: where they were measured, or against each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.linalg import Array
from ppmcal.plotting.canvas import HEIGHT, WIDTH, Drawing
from ppmcal.plotting.layers import (
    Arrows,
    Dots,
    WordsAt,
    Zero,
)
from ppmcal.plotting.plot import BOTTOM, LEFT, RIGHT, TOP, Axis, Plot, span
from ppmcal.report.data_rows import DataRows
from ppmcal.report.format import whole, with_label, with_unit
from ppmcal.report.residuals import (
    POINTS,
    evenly_spread,
    used,
)


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
