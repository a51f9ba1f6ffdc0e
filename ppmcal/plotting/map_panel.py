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

from ppmcal.kinematics.region import Map
from ppmcal.linalg import Array
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
    number_words,
    outline,
    png,
    robust_range,
    round_numbers,
    with_unit,
)

COLOURS = "viridis"
"""Even steps for the eye, and darker to lighter also in grey."""
BANDS = 96
NO_VALUE = "no value: beyond reach, limits or a singularity"
NO_POSE, NONE_HERE = "no pose of this map can be reached", "no pose here"
HATCHED: dict[str, Any] = {"facecolor": GROUND, "edgecolor": HATCH, "hatch": "////"}
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

    def mappable(self) -> ScalarMappable:
        """Return what a colour bar shows."""
        return ScalarMappable(self.norm(), COLOURS)

    def norm(self) -> Normalize:
        """Return values as parts of the colour map."""
        return (LogNorm if self.log else Normalize)(self.low, self.high)

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
                             linewidth=0.0, **HATCHED))
    return Patch(linewidth=0.5, **HATCHED)


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


@dataclass(frozen=True, eq=False)
class MapView:
    """What is drawn, in file units.

    Attributes:
        coordinates: at most three indices into the full pose; levels: of each.
        values, determinant: shape of the levels; ``determinant`` None where not given.
        names: axes with units; home: home's place (c,); held: the other coordinates in words.
    """

    coordinates: tuple[int, ...]
    levels: tuple[Array, ...]
    values: Array
    determinant: Array | None
    names: tuple[str, ...]
    home: Array
    held: str


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
        axes.axvspan(edges[a], edges[b], linewidth=0.0, zorder=0.5, **HATCHED)
    return {NO_VALUE: Patch(linewidth=0.5, **HATCHED)}


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
