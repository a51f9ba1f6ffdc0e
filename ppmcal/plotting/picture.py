"""Drawings as pictures: matplotlib draws plots, their layers and charts, alone or on a sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Any, Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Affine2D
from numpy.typing import ArrayLike

from ppmcal.plotting import layers, style
from ppmcal.plotting.bars import LEAST, LIMITS, LINE, LOOKS, SWATCH, THICK, VALUES, Chart, Row
from ppmcal.plotting.canvas import (
    EDGE,
    HEAD,
    LETTERS,
    NAME,
    SMALL,
    WIDTH,
    Drawing,
    broken,
    fitted,
    width,
)
from ppmcal.plotting.layers import Layer, Strokes, apart
from ppmcal.plotting.plot import BOTTOM, CLASS_ROOM, RIGHT, TOP, Plot
from ppmcal.plotting.style import AFTER, INK, SOFT, figure, look, number_words, plain, round_numbers
from ppmcal.plotting.svg import TOLD

PAD, LEADING = 14.0, 14.0
"""Room about the drawings of a sheet, and from one line of words to the next."""
COLOURS = {"before": style.BEFORE, "after": AFTER, "out": style.OUT, "ink": INK}


def sheet(head: str, drawings: Sequence[Drawing]) -> Figure:
    """Return drawings with titles and captions below a head, two in a row where there are more."""
    columns = min(len(drawings), 2)
    wide = columns * (WIDTH + PAD) + PAD
    lines = broken(head, wide - 2.0 * PAD, bold=True)
    titles = [broken(d.title, WIDTH, True, HEAD) for d in drawings]
    words = [broken(f"{d.note} {d.caption}", WIDTH - 2.0 * EDGE) for d in drawings]
    heights = [16.0 * len(t) + 18.0 + d.height + LEADING * len(w)
               for d, t, w in zip(drawings, titles, words, strict=True)]
    tops = [2.0 * PAD + LEADING * len(lines)]
    for row in range(0, len(drawings), columns):
        tops.append(tops[-1] + max(heights[row:row + columns]) + PAD)
    with look():
        drawn = figure(wide / 72.0, (tops[-1] - 0.5 * PAD) / 72.0)
        for n, line in enumerate(lines):
            Canvas(drawn).text(PAD, PAD + 8.0 + LEADING * n, line, bold=True, room=wide)
        for n, drawing in enumerate(drawings):
            at = Canvas(drawn, PAD + n % columns * (WIDTH + PAD), tops[n // columns])
            for i, line in enumerate(titles[n]):
                at.text(WIDTH / 2.0, 12.0 + 16.0 * i, line, INK, True, "center", WIDTH, HEAD)
            at = Canvas(drawn, at.left, at.top + 16.0 * len(titles[n]) + 4.0)
            draw(drawing.content, at)
            for i, line in enumerate(words[n]):
                at.text(EDGE, drawing.height + 14.0 + LEADING * i, line, SOFT, room=WIDTH)
    return drawn


@dataclass(frozen=True)
class Canvas:
    """A part of a figure, in points to the right and down from its upper left corner.

    ``wide``: points to its right edge; ``least``: size of the smallest letters.
    """

    figure: Figure
    left: float = 0.0
    top: float = 0.0
    wide: float = WIDTH
    least: float = 0.0

    def axes(self, left: float, top: float, right: float, bottom: float) -> Axes:
        """Return axes between two corners, without ground and with a line below."""
        wide, high = (72.0 * float(v) for v in self.figure.get_size_inches())
        out = self.figure.add_axes((
            (self.left + left) / wide, 1.0 - (self.top + bottom) / high,
            (right - left) / wide, (bottom - top) / high))
        out.patch.set_visible(False)
        out.set_autoscale_on(False)
        out.spines[["left", "right", "top"]].set_visible(False)
        out.spines["bottom"].set(linewidth=1.0, color=SOFT)
        out.tick_params(labelsize=LETTERS, labelcolor=SOFT, color=SOFT, width=1.0, length=4.0,
                        pad=1.5)
        return out

    def add(self, artist: Artist) -> None:
        """Draw something whose coordinates are points."""
        height = float(self.figure.get_size_inches()[1])
        artist.set_transform(
            Affine2D().translate(self.left, self.top).scale(1.0 / 72.0, -1.0 / 72.0)
            .translate(0.0, height) + self.figure.dpi_scale_trans)
        self.figure.add_artist(artist)

    def text(self, x: float, y: float, words: str, colour: str = INK, bold: bool = False,
             ha: Literal["left", "center", "right"] = "left", room: float | None = None,
             size: float = LETTERS, upright: bool = False) -> None:
        """Write words at a place; those that are cut to their room are told on hovering."""
        size = max(size, self.least)
        shown = fitted(words, self.wide - x - EDGE if room is None else room, bold, size)
        gid = None if shown == plain(words) else TOLD + plain(words)
        self.add(Text(x, y, shown, ha=ha, color=colour, size=size, gid=gid,
                      weight="bold" if bold else "normal", rotation=90.0 if upright else 0.0,
                      rotation_mode="anchor"))

    def name(self, x: float, y: float, words: str, room: float, upright: bool = False) -> None:
        """Write the name of an axis about a place."""
        self.text(x, y, words, ha="center", room=room, size=NAME, upright=upright)


@singledispatch
def draw(content: object, canvas: Canvas) -> None:
    """Draw the content of a drawing.

    Raises:
        TypeError: it is neither a plot nor a chart.
    """
    raise TypeError(f"no picture can be made of {type(content).__name__}")


# --- plots ----------------------------------------------------------------------------------------


@draw.register
def _(plot: Plot, canvas: Canvas) -> None:
    floor, right = plot.height - BOTTOM - CLASS_ROOM * bool(plot.classes), plot.wide - RIGHT
    for i, (name, bold) in enumerate(plot.rows):
        step = (floor - TOP) / len(plot.rows)
        canvas.text(plot.left - 6.0, TOP + step * (i + 0.5) + 3.5, name, bold=bold,
                    room=plot.left - 8.0, ha="right", size=SMALL)
    axes = canvas.axes(plot.left, TOP, right, floor)
    _scales(plot, axes)
    for layer in plot.layers:
        draw_layer(layer, plot, axes)
    middle, foot = (plot.left + right) / 2.0, plot.height - 6.0
    canvas.name(middle, foot - CLASS_ROOM * bool(plot.classes),
                "" if plot.classes else plot.names[0], right - plot.left)
    canvas.name(11.0, (TOP + floor) / 2.0, plot.names[1], TOP + floor, upright=True)
    if plot.classes:
        _classes(plot, canvas, floor)


def _scales(plot: Plot, axes: Axes) -> None:
    """Set ends, ticks and lines of the axes."""
    x, y, right = plot.x, plot.y, plot.wide - RIGHT
    axes.set_xscale("log" if x.log else "linear")
    axes.set_yscale("log" if y.log else "linear")
    axes.set(xlim=(x.low, x.high), ylim=(y.low, y.high))
    axes.spines["left"].set(visible=True, linewidth=1.0, color=SOFT)
    for axis, ends, shown in ((axes.xaxis, x, not plot.classes),
                              (axes.yaxis, y, not plot.rows)):
        ticks = ends.ticks() if shown else np.zeros(0)
        axis.set_ticks(ticks.tolist(), labels=number_words(ticks))
        axis.set_ticks([], minor=True)
    for label in axes.get_xticklabels():
        part = x.part(label.get_position()[0])
        label.set_visible(plot.left + part * (right - plot.left)
                          + 0.5 * width(label.get_text()) <= plot.wide)
    widest = max([width(words) for words in number_words(ticks)], default=1.0)
    axes.tick_params("y", length=0.0, pad=5.0,
                     labelsize=LETTERS * min(1.0, (plot.left - 20.0) / widest))
    across = np.tile([x.low, x.high, np.nan], len(ticks))
    _line(axes, across, np.repeat(ticks, 3), color=style.LINE, linewidth=1.0, zorder=0.5)


def _classes(plot: Plot, canvas: Canvas, floor: float) -> None:
    """Write signs below their places, and once below them what they belong to."""
    wide = plot.wide - plot.left - RIGHT
    room = wide / max(len({owner for _, owner, _ in plot.classes}), 1)
    owners: dict[str, list[float]] = {}
    for x, owner, sign in plot.classes:
        place = plot.left + plot.x.part(x) * wide
        owners.setdefault(owner, []).append(place)
        canvas.text(place, floor + 12.0, sign, ha="center", room=40.0)
    for owner, mine in owners.items():
        if room > width("leg…"):
            canvas.text(sum(mine) / len(mine), floor + 25.0, owner, SOFT, ha="center", room=room)
    canvas.name((plot.left + plot.wide - RIGHT) / 2.0, plot.height - 6.0, plot.names[0],
                plot.wide - plot.left)


# --- layers ---------------------------------------------------------------------------------------


@singledispatch
def draw_layer(layer: Layer, plot: Plot, axes: Axes) -> None:
    """Draw one layer of a plot.

    Raises:
        TypeError: nobody has said how.
    """
    raise TypeError(f"no picture can be made of {type(layer).__name__}")


def _line(axes: Axes, x: ArrayLike, y: ArrayLike, **looks: Any) -> None:
    """Draw one line or markers of one look, with gaps where values are nan."""
    axes.plot(x, y, clip_on=False, scalex=False, scaley=False, **looks)


def _polygon(axes: Axes, path: Path, alpha: float) -> None:
    axes.add_patch(PathPatch(path, facecolor=AFTER, alpha=alpha, linewidth=0.0, clip_on=False))


@draw_layer.register
def _(layer: Strokes, plot: Plot, axes: Axes) -> None:
    ends = (apart(layer.x, layer.x), apart(layer.low, layer.high))[::-1 if layer.flat else 1]
    _line(axes, *plot.inside(*ends), color=COLOURS[layer.kind], linewidth=layer.size,
          alpha=layer.alpha, solid_capstyle=layer.cap, label=layer.name or "_",
          snap=False if layer.cap == "round" else None)    # in whole pixels a dot has no length


@draw_layer.register
def _(layer: layers.Dots, plot: Plot, axes: Axes) -> None:
    # as one path of round strokes of next to no length thousands stay small
    at, half = np.asarray(layer.x, dtype=float), 1e-5 * (plot.x.high - plot.x.low)
    draw_layer(Strokes(layer.y, at - half, at + half, layer.kind, layer.size, flat=True,
                       cap="round"), plot, axes)


@draw_layer.register
def _(layer: layers.Polyline, plot: Plot, axes: Axes) -> None:
    _line(axes, *plot.inside(layer.x, layer.y), color=COLOURS[layer.tint], linewidth=layer.size,
          linestyle=(0, (4, 2)) if layer.dashed else "-")


@draw_layer.register
def _(layer: layers.Zero, plot: Plot, axes: Axes) -> None:
    ends = ([0.0, 0.0], [plot.y.low, plot.y.high]) if layer.upright else (
        [plot.x.low, plot.x.high], [0.0, 0.0])
    _line(axes, *plot.inside(*ends), color=SOFT, linewidth=1.2, alpha=0.5)


@draw_layer.register
def _(layer: layers.Marks, plot: Plot, axes: Axes) -> None:
    fill = style.CARD if layer.kind == "before" else COLOURS[layer.kind]
    _line(axes, *plot.inside(layer.x, layer.y), linestyle="none", marker=layer.marker,
          markersize=layer.size, color=COLOURS[layer.kind], markeredgewidth=1.5,
          markerfacecolor=fill)


@draw_layer.register
def _(layer: layers.Intervals, plot: Plot, axes: Axes) -> None:
    at, middle, half = layer.x + layer.aside * plot.per()[0], layer.middle, layer.half
    draw_layer(Strokes(at, middle - half, middle + half, layer.kind), plot, axes)
    draw_layer(layers.Marks(at, middle, layer.kind, "o"), plot, axes)


@draw_layer.register
def _(layer: layers.Band, plot: Plot, axes: Axes) -> None:
    if layer.low < layer.high:
        axes.axhspan(layer.low, layer.high, facecolor=AFTER, alpha=0.12, linewidth=0.0,
                     clip_on=False)


@draw_layer.register
def _(layer: layers.Between, plot: Plot, axes: Axes) -> None:
    corners = np.stack(layer.outline(plot.y.low, plot.y.high), axis=-1)
    _polygon(axes, Path(corners, closed=False), 0.2)


@draw_layer.register
def _(layer: layers.Histogram, plot: Plot, axes: Axes) -> None:
    gap, foot = 0.06 * np.diff(layer.edges), 0.0 * layer.tops
    left, right = layer.edges[:-1] + gap, layer.edges[1:] - gap
    corners = np.stack([np.stack([left, left, right, right], axis=-1),
                        np.stack([foot, layer.tops, layer.tops, foot], axis=-1)], axis=-1)
    _polygon(axes, Path.make_compound_path_from_polys(corners[layer.tops > 0.0]), 0.75)


@draw_layer.register
def _(layer: layers.Starts, plot: Plot, axes: Axes) -> None:
    for x, _, shown in plot.starts(layer):
        axes.axvline(x, color=SOFT, alpha=0.7, linewidth=1.0, dashes=(3.0, 3.0), clip_on=False)
        axes.annotate(shown, (x, 1.0), (3.0, -8.0), xycoords=axes.get_xaxis_transform(),
                      textcoords="offset points", size=SMALL, color=SOFT)


@draw_layer.register
def _(layer: layers.Arrows, plot: Plot, axes: Axes) -> None:
    _line(axes, *layer.pieces(*plot.per()), color=COLOURS[layer.kind], linewidth=1.2)


@draw_layer.register
def _(layer: layers.WordsAt, plot: Plot, axes: Axes) -> None:
    axes.annotate(plain(layer.text), (1.0, 1.0), (-layer.x, -layer.y), xycoords="axes fraction",
                  textcoords="offset points", ha="right", size=LETTERS, color=SOFT)


# --- charts ---------------------------------------------------------------------------------------


@draw.register
def _(chart: Chart, canvas: Canvas) -> None:
    tops, (left, right) = chart.tops(), chart.ends()
    axes = canvas.axes(left, 0.0, right, tops[-1])
    axes.set(xlim=(0.0, 1.0), ylim=(tops[-1], 0.0), yticks=[])
    for (kind, words), (x, y) in zip(chart.legend, chart.places(), strict=True):
        thick = THICK.get(kind, 8.0)
        canvas.add(_upright(x + 0.5 * SWATCH, y - 10.0, y + 2.0, kind) if kind in LIMITS else
                   _bar(x, y - 4.0, SWATCH, thick, kind))
        canvas.text(x + SWATCH + 5.0, y, words, SOFT)
    for row, top in zip(chart.rows, tops, strict=False):
        _row(chart, canvas, axes, row, top + 14.0)
    ticks = chart.ticks
    if not ticks:
        places = round_numbers(chart.low, chart.high, False, 5, (1, 2, 5, 10))
        ticks = list(zip(places.tolist(), number_words(places), strict=True))
    shown = chart.shown(ticks)
    axes.set_xticks([chart.part(v) for v, _ in shown], labels=[words for _, words in shown])
    middle = 0.5 * (left + right)
    room = 2.0 * min(middle, chart.wide - middle) - EDGE
    canvas.name(middle, tops[-1] + 31.0, chart.axis, room)


def _row(chart: Chart, canvas: Canvas, axes: Axes, row: Row, y: float) -> None:
    """Draw one row, the foot of its label's first line at ``y``."""
    canvas.text(chart.wide - EDGE, y, row.words, bold=chart.beside or row.strong, ha="right",
                room=VALUES)
    for n, line in enumerate(chart.label(row)):
        y += LINE * bool(n)
        canvas.text(EDGE, y, line, bold=row.strong, room=chart.label_room(row))
    left, right = chart.ends()
    for value, kind, below, thick in chart.bars(row):
        axes.add_patch(_bar(0.0, y + below, max(chart.part(value), LEAST / (right - left)), thick,
                            kind))
    for value, kind in row.limits:
        top, low = chart.upright
        axes.add_line(_upright(chart.part(value), y + top, y + low, kind))


def _bar(left: float, middle: float, wide: float, thick: float, kind: str) -> Rectangle:
    shape, bar = ((left, middle - 0.5 * thick), wide, thick), LOOKS[kind]
    if bar.frame:
        return Rectangle(*shape, clip_on=False, fill=False, edgecolor=bar.colour, linewidth=1.4,
                         linestyle=(0, (4, 2)) if bar.dashed else "-")
    return Rectangle(*shape, clip_on=False, linewidth=0.0, facecolor=bar.colour, alpha=bar.alpha)


def _upright(x: float, top: float, low: float, kind: str) -> Line2D:
    return Line2D([x, x], [top, low], color=INK, linewidth=1.2, clip_on=False,
                  linestyle=(0, (2, 2)) if LIMITS[kind] else "-", solid_capstyle="butt")
