"""A map over one pose coordinate: a curve, with home, singular poses and gaps."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ppmcal.linalg import Array
from ppmcal.plotting.map_data import Map, MapView
from ppmcal.plotting.map_panel import NO_POSE, NO_VALUE, SINGULAR_CURVE, ColourScale
from ppmcal.plotting.style import (
    BODY,
    EDGE,
    FOOT,
    GROUND,
    HATCH,
    INK,
    SINGULAR,
    TITLE,
    alone,
    draw_head,
    draw_legend,
    figure,
    head_height,
    lines_of,
    log_ticks,
    outline,
    png,
    with_unit,
)

WIDTH, HEIGHT, LEFT = 6.4, 3.4, 0.95
BEYOND = "value beyond the axis"


def draw_profile(view: MapView, shown: Map, head: str, below: str) -> bytes:
    """Draw a quantity along one coordinate, as PNG."""
    title = lines_of(head, WIDTH - 2 * EDGE, TITLE, 3)
    notes = lines_of(below, WIDTH - 2 * EDGE, BODY, 4)
    height, x = head_height(title, notes) + HEIGHT + FOOT, view.levels[0]
    drawn = figure(WIDTH, height)
    draw_head(drawn, title, notes)
    axes = drawn.add_axes((LEFT / WIDTH, FOOT / height, (WIDTH - LEFT - 0.25) / WIDTH,
                           HEIGHT / height))
    axes.set_xlabel(view.names[0])
    axes.set_ylabel(lines_of(with_unit(shown.title, shown.unit), HEIGHT, BODY, 2))
    axes.grid(visible=True, color=GROUND)
    pad = 0.02 * float(np.ptp(x)) or 1.0
    axes.set_xlim(float(x.min()) - pad, float(x.max()) + pad)
    scale = ColourScale.of(view.values, shown.log)
    legend = _gaps(axes, x, view.values)
    legend |= _curve(axes, x, view.values, scale)
    legend |= _crossings(axes, x, view.determinant)
    home = float(view.home[0])
    if x.min() - pad <= home <= x.max() + pad:
        axes.axvline(home, color=INK, linewidth=1.1, linestyle=(0, (4, 3)), zorder=2.5)
        axes.annotate("home", (home, 0.98), xycoords=("data", "axes fraction"),
                      textcoords="offset points", xytext=(4.0, 0.0), va="top", size=BODY,
                      weight="bold", path_effects=outline(2.5), zorder=4.0)
    return png(drawn, draw_legend(drawn, legend))


def _curve(axes: Axes, x: Array, values: Array, scale: ColourScale) -> dict[str, Any]:
    """Draw the values; those beyond the scale as arrows at its edge."""
    if scale.empty:
        axes.text(0.5, 0.5, NO_POSE, transform=axes.transAxes, ha="center", va="center",
                  size=TITLE, path_effects=outline(4.0, GROUND))
        axes.set_yticks([])
        return {}
    there = ~np.isnan(values)
    high, low = there & (values > scale.high), there & (values < scale.low)
    finite = np.where(np.isfinite(values), values, np.nan)
    if scale.log:
        axes.set_yscale("log")
        finite = np.where(finite > 0.0, finite, np.nan)
        pad = (scale.high / scale.low) ** 0.05
        axes.set_ylim(scale.low / pad, scale.high * pad)
        log_ticks(axes.yaxis)
    else:
        pad = 0.05 * (scale.high - scale.low)
        axes.set_ylim(scale.low - pad, scale.high + pad)
    lonely = alone(np.isfinite(finite))
    axes.plot(x, finite, color="#1f62a6", linewidth=1.8, zorder=2.0)
    axes.plot(x[lonely], finite[lonely], color="#1f62a6", linestyle="none", marker="o",
              markersize=4.5, zorder=2.0)
    for rows, place, marker in ((high, 0.985, "^"), (low, 0.015, "v")):
        axes.plot(x[rows], np.full(int(rows.sum()), place), color="#b3692a", linestyle="none",
                  marker=marker, markersize=5.0, transform=axes.get_xaxis_transform(), zorder=3.0)
    if not (high.any() or low.any()):
        return {}
    return {BEYOND: Line2D([], [], color="#b3692a", linestyle="none", markersize=5.0,
                           marker="^" if high.any() else "v")}


def _gaps(axes: Axes, x: Array, values: Array) -> dict[str, Any]:
    """Hatch where there is no value; halfway to the poses beside."""
    missing = np.isnan(values)
    if not missing.any():
        return {}
    left, right = axes.get_xlim()
    middle = 0.5 * (x[1:] + x[:-1])
    edges = np.concatenate([[left], middle, [right]])
    step = np.diff(np.concatenate([[0], missing.astype(int), [0]]))
    for a, b in zip(np.flatnonzero(step == 1), np.flatnonzero(step == -1), strict=True):
        axes.axvspan(edges[a], edges[b], facecolor=GROUND, edgecolor=HATCH, hatch="////",
                     linewidth=0.0, zorder=0.5)
    return {NO_VALUE: Patch(facecolor=GROUND, edgecolor=HATCH, hatch="////", linewidth=0.5)}


def _crossings(axes: Axes, x: Array, determinant: Array | None) -> dict[str, Any]:
    """Draw a line where the determinant changes sign between neighbours."""
    if determinant is None:
        return {}
    a, b = determinant[:-1], determinant[1:]
    rows = np.flatnonzero(np.isfinite(a) & np.isfinite(b) & ((a < 0.0) != (b < 0.0)))
    for i in rows:
        part = a[i] / (a[i] - b[i])
        axes.axvline(float(x[i] + part * (x[i + 1] - x[i])), color=SINGULAR, linewidth=2.0,
                     zorder=2.2)
    return {SINGULAR_CURVE: Line2D([], [], color=SINGULAR, linewidth=2.0)} if rows.size else {}
