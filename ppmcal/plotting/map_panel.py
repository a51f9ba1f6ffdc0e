"""One panel of a map: colours, contour lines, hatching, singular curve, home."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from ppmcal.linalg import Array
from ppmcal.plotting.style import (
    BODY,
    GROUND,
    HATCH,
    INK,
    SINGULAR,
    TITLE,
    number_words,
    outline,
    robust_range,
    round_numbers,
)

COLOURS = "viridis"
"""Even steps for the eye, and darker to lighter also in grey."""
BANDS = 96
NO_VALUE = "no value: beyond reach, limits or a singularity"
NO_POSE, NONE_HERE = "no pose of this map can be reached", "no pose here"
SINGULAR_CURVE = "singular: det A changes sign"


@dataclass(frozen=True, eq=False)
class ColourScale:
    """One scale of colours for all panels: ends, logarithm, ticks, which ends are cut."""

    low: float
    high: float
    log: bool
    ticks: Array
    extend: Literal["neither", "both", "min", "max"]
    empty: bool

    @classmethod
    def of(cls, values: Array, log: bool) -> ColourScale:
        """Return the scale of values of any shape, nan where there is none."""
        known = values[~np.isnan(values)]
        low, high, log = robust_range(known, log)
        ticks = round_numbers(low, high, log)
        finite = known[np.isfinite(known)]
        if finite.size and high - low > 0.0 and np.ptp(finite) <= 1e-9 * np.abs(finite).max():
            ticks = finite[:1]
        return cls(low, high, log, ticks, _cut(known, low, high), not known.size)

    def norm(self) -> Normalize:
        """Return values as parts of the colour map."""
        return (LogNorm if self.log else Normalize)(self.low, self.high)

    def mappable(self) -> ScalarMappable:
        """Return what a colour bar shows."""
        return ScalarMappable(self.norm(), COLOURS)

    def bands(self) -> Array:
        """Return the edges of the fine bands of colour."""
        return (np.geomspace if self.log else np.linspace)(self.low, self.high, BANDS + 1)


def _cut(known: Array, low: float, high: float) -> Literal["neither", "both", "min", "max"]:
    """Return at which ends values lie beyond the scale."""
    pad = 1e-9 * (high - low)
    below, above = bool(np.any(known < low - pad)), bool(np.any(known > high + pad))
    if below and above:
        return "both"
    return "min" if below else "max" if above else "neither"


def draw_panel(axes: Axes, x: Array, y: Array, values: Array, determinant: Array | None,
               scale: ColourScale, home: Array | None, alone: bool = True) -> dict[str, Any]:
    """Draw values (X, Y) over two coordinates; return what the legend has to explain.

    Args:
        axes: where to draw.
        x: levels (X,) of the first coordinate.
        y: levels (Y,) of the second.
        values: what to draw (X, Y), nan where there is none.
        determinant: likewise, or None.
        scale: colours.
        home: place of home (2,), or None.
        alone: whether it is the only panel, whose contour lines have numbers.
    """
    edges = _edges(x), _edges(y)
    axes.set_xlim(edges[0][0], edges[0][-1])
    axes.set_ylim(edges[1][0], edges[1][-1])
    axes.tick_params(length=3.0)
    legend: dict[str, Any] = {}
    if home is not None and _inside(home, edges):
        legend["home"] = _home(axes, home)
    if determinant is not None and _singular(axes, x, y, determinant):
        legend[SINGULAR_CURVE] = Line2D([], [], color=SINGULAR, linewidth=2.2)
    missing = np.isnan(values)
    if missing.any():
        legend[NO_VALUE] = _hatch(axes)
    if missing.all():
        axes.text(0.5, 0.5, NO_POSE if alone else NONE_HERE, transform=axes.transAxes,
                  ha="center", va="center", size=TITLE if alone else BODY,
                  path_effects=outline(4.0, GROUND))
        return legend
    field = np.ma.masked_invalid(np.clip(values, scale.low, scale.high)).T
    axes.pcolormesh(edges[0], edges[1], field, norm=scale.norm(), cmap=COLOURS, zorder=1.0)
    if min(values.shape) > 1 and np.ma.count(field) and scale.ticks.size:
        _contours(axes, x, y, field, scale, alone)
    return legend


def _contours(
    axes: Axes, x: Array, y: Array, field: Any, scale: ColourScale, numbers: bool
) -> None:
    """Smooth the colours between poses, and draw lines at the colour bar's numbers."""
    low, high = float(field.min()), float(field.max())
    if not high > low:
        return
    axes.contourf(x, y, field, levels=scale.bands(), norm=scale.norm(), cmap=COLOURS, zorder=1.1)
    levels = [t for t in scale.ticks if low < t < high]
    if not levels:
        return
    light = np.asarray(colormaps[COLOURS](scale.norm()(np.array(levels))))[:, :3] @ (
        0.3, 0.59, 0.11)
    colours = ["black" if v > 0.45 else "white" for v in light]
    drawn = axes.contour(x, y, field, levels=levels, colors=colours, linewidths=0.7,
                         alpha=0.75, zorder=1.2)
    if numbers:
        words = dict(zip(levels, number_words(scale.ticks[np.isin(scale.ticks, levels)]),
                         strict=True))
        axes.clabel(drawn, fmt=words, fontsize=8.0, inline=True)


def _singular(axes: Axes, x: Array, y: Array, determinant: Array) -> bool:
    """Draw where the determinant changes sign; return whether it does."""
    field = np.where(np.isfinite(determinant), determinant, np.nan)
    field = field / (np.nanmax(np.abs(field), initial=0.0) or 1.0)
    if min(field.shape) < 2 or not np.nanmin(field, initial=0.0) < 0.0 < np.nanmax(
            field, initial=0.0):
        return False
    drawn = axes.contour(x, y, np.ma.masked_invalid(field).T, levels=[0.0], colors=[SINGULAR],
                         linewidths=2.2, zorder=2.0)
    drawn.set_path_effects(outline(4.2))
    return any(np.size(path.vertices) for path in drawn.get_paths())


def _hatch(axes: Axes) -> Patch:
    """Fill the panel with the hatching of poses without a value; return the legend's patch."""
    axes.add_patch(Rectangle((0.0, 0.0), 1.0, 1.0, transform=axes.transAxes, zorder=0.5,
                             facecolor=GROUND, edgecolor=HATCH, hatch="////", linewidth=0.0))
    return Patch(facecolor=GROUND, edgecolor=HATCH, hatch="////", linewidth=0.5)


def _home(axes: Axes, home: Array) -> Line2D:
    """Mark home with a cross and its name; return the legend's cross."""
    (mark,) = axes.plot(home[:1], home[1:2], linestyle="none", marker="+", markersize=12.0,
                        markeredgewidth=2.0, color=INK, zorder=3.0)
    mark.set_path_effects(outline(4.0))
    span = axes.get_xlim(), axes.get_ylim()
    right = home[0] < 0.7 * span[0][1] + 0.3 * span[0][0]
    up = home[1] < 0.8 * span[1][1] + 0.2 * span[1][0]
    axes.annotate("home", (home[0], home[1]), textcoords="offset points",
                  xytext=(5.0 if right else -5.0, 5.0 if up else -5.0),
                  ha="left" if right else "right", va="bottom" if up else "top", size=BODY,
                  weight="bold", path_effects=outline(2.5), zorder=3.0, clip_on=True)
    return Line2D([], [], linestyle="none", marker="+", markersize=9.0, markeredgewidth=1.8,
                  color=INK)


def _inside(home: Array, edges: tuple[Array, Array]) -> bool:
    return all(bool(e[0] <= h <= e[-1]) for h, e in zip(home, edges, strict=True))


def _edges(levels: Array) -> Array:
    """Return the edges (n + 1,) of the cells about levels (n,)."""
    if len(levels) < 2:
        half = 0.5 * (abs(float(levels[0])) * 1e-3 or 1.0)
        return np.array([levels[0] - half, levels[0] + half])
    middle = 0.5 * (levels[1:] + levels[:-1])
    out: Array = np.concatenate([[2.0 * levels[0] - middle[0]], middle,
                                 [2.0 * levels[-1] - middle[-1]]])
    return out
