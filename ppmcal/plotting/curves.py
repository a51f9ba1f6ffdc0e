"""Pictures of curves: something against the size of errors, or against the number of poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from ppmcal.linalg import Array
from ppmcal.plotting.style import (
    BODY,
    EDGE,
    GROUND,
    INK,
    SOFT,
    TITLE,
    alone,
    capital,
    draw_head,
    figure,
    head_height,
    lines_of,
    log_ticks,
    look,
    outline,
    plain,
    png,
    tame,
)

WIDTH, HEIGHT = 6.6, 3.9
"""Size of the picture without title and legend, inches."""
LEFT, RIGHT, BOTTOM = 0.95, 0.25, 0.6
LINES = (("#1f62a6", "-", "o"), ("#b3692a", "--", "s"), ("#23744a", "-.", "^"),
         ("#c2293a", ":", "D"), ("#6b4c9a", (0, (5, 1, 1, 1)), "v"), ("#1c2227", (0, (1, 1)), "P"))
"""Colour, dashes and marker of each curve; told apart in grey too."""
FEW = 40
"""Curves with no more points have a marker at each."""


def draw_curves(title: str, x_label: str, y_label: str,
                series: Sequence[tuple[str, ArrayLike, ArrayLike]], log_x: bool = False,
                log_y: bool = False, marks: Sequence[tuple[float, str]] = ()) -> bytes:
    """Return a PNG of curves over one axis.

    Args:
        title: in words, above the picture; no words, no title.
        x_label: name of the x axis, with its unit.
        y_label: name of the y axis, with its unit.
        series: name and points (N,), (N,) of each curve; what is not finite, and on a
            logarithmic axis what is not positive, leaves a gap.
        log_x: logarithmic x axis; linear where nothing is positive.
        log_y: likewise.
        marks: vertical lines, position and words.
    """
    curves = [(plain(name), *_points(x, y)) for name, x, y in series]
    lines = [(float(x), plain(text)) for x, text in marks if np.isfinite(tame(np.array(x)))]
    across = np.concatenate([*(x for _, x, _ in curves), [x for x, _ in lines], np.zeros(0)])
    log_x = log_x and bool(np.any(across > 0.0))
    log_y = log_y and any(np.any(y > 0.0) for _, _, y in curves)
    curves = [(name, *_drawable(x, y, log_x, log_y)) for name, x, y in curves]
    lines = [(x, text) for x, text in lines if x > 0.0 or not log_x]
    with look():
        head = lines_of(capital(title), WIDTH - 2 * EDGE, TITLE)
        named = [c for c in curves if c[0]]
        top = head_height(head, "")
        rows = -(-len(named) // 2) if len(named) > 1 else 0
        height = HEIGHT + top + 0.21 * rows
        drawn = figure(WIDTH, height)
        draw_head(drawn, head, "")
        low = BOTTOM + 0.21 * rows
        axes = drawn.add_axes((LEFT / WIDTH, low / height, (WIDTH - LEFT - RIGHT) / WIDTH,
                               (height - low - top) / height))
        axes.set_xlabel(lines_of(x_label, WIDTH - 1.5, BODY, 1))
        axes.set_ylabel(lines_of(y_label, height - low - top, BODY, 2))
        handles = _fill(axes, curves, lines, log_x, log_y)
        if rows:
            drawn.legend(handles=[h for h, c in zip(handles, curves, strict=True) if c[0]],
                         loc="lower left", ncols=2, bbox_to_anchor=(LEFT / WIDTH, 0.0),
                         borderaxespad=0.2, handlelength=3.2)
        return png(drawn)


def _fill(axes: Axes, curves: Sequence[tuple[str, Array, Array]],
          lines: Sequence[tuple[float, str]], log_x: bool, log_y: bool) -> list[Line2D]:
    """Draw curves and marks; return the curves' lines for the legend."""
    logs = [axis for axis, log in ((axes.xaxis, log_x), (axes.yaxis, log_y)) if log]
    axes.set_xscale("log" if log_x else "linear")
    axes.set_yscale("log" if log_y else "linear")
    axes.grid(visible=True, color=GROUND)
    handles = [_curve(axes, curve, i) for i, curve in enumerate(curves)]
    if not any(np.isfinite(y).any() for _, _, y in curves):
        axes.text(0.5, 0.5, "no value to show", transform=axes.transAxes, ha="center",
                  size=TITLE, color=SOFT)
    _widen(axes, curves, lines, log_x)
    for axis in logs:
        log_ticks(axis)
    for i, (x, text) in enumerate(lines):
        _mark(axes, x, text, 0.98 - 0.12 * (i % 5))
    return handles


def _points(x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Return points as two arrays (N,) in order of x, nan where infinite."""
    across, up = (tame(np.ravel(np.asarray(v, dtype=float))) for v in (x, y))
    across, up = np.broadcast_arrays(across, up)
    order = np.argsort(across, kind="stable")
    out = [np.where(np.isfinite(v), v, np.nan)[order] for v in (across, up)]
    return out[0], out[1]


def _drawable(x: Array, y: Array, log_x: bool, log_y: bool) -> tuple[Array, Array]:
    """Return points with a gap where an axis cannot show them."""
    bad = np.isnan(x) | np.isnan(y) | (log_x & ~(x > 0.0)) | (log_y & ~(y > 0.0))
    return np.where(bad, np.nan, x), np.where(bad, np.nan, y)


def _curve(axes: Axes, curve: tuple[str, Array, Array], i: int) -> Line2D:
    """Draw one curve; points without a neighbour show as markers."""
    name, x, y = curve
    colour, dashes, marker = LINES[i % len(LINES)]
    there = np.isfinite(y)
    if there.sum() > FEW:
        there = alone(there)
    (line,) = axes.plot(x, y, color=colour, linestyle=dashes, linewidth=1.7, label=name,
                        marker=marker if there.any() else "none", markersize=4.0,
                        markevery=np.flatnonzero(there).tolist())
    return line


def _widen(axes: Axes, curves: Sequence[tuple[str, Array, Array]],
           lines: Sequence[tuple[float, str]], log: bool) -> None:
    """Set ends of the x axis that hold all curves and marks."""
    x = np.concatenate([*(c[1] for c in curves), [m for m, _ in lines], np.zeros(0)])
    x = x[np.isfinite(x)]
    if not x.size:
        return
    low, high = float(x.min()), float(x.max())
    if log:
        pad = (high / low) ** 0.03 if high > low * 1.0001 else 2.0
        axes.set_xlim(low / pad, high * pad)
    else:
        pad = 0.03 * (high - low) if high - low > 1e-9 * max(abs(low), abs(high)) else (
            0.1 * abs(high) or 1.0)
        axes.set_xlim(low - pad, high + pad)


def _mark(axes: Axes, x: float, text: str, up: float) -> None:
    """Draw a vertical line with words beside it at height ``up``, where there is more room."""
    axes.axvline(x, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
    place = axes.transAxes.inverted().transform(axes.transData.transform((x, 1.0)))[0]
    side = 1.0 if place < 0.55 else -1.0
    axes.annotate(lines_of(text, 2.2, BODY, 3), (x, up),
                  xycoords=("data", "axes fraction"), textcoords="offset points",
                  xytext=(4.0 * side, 0.0), ha="left" if side > 0 else "right", va="top",
                  size=BODY, path_effects=outline(2.5))
