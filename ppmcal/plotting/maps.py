"""Maps as pictures: a quantity over one, two or three pose coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ppmcal.kinematics.region import Grid, Map, placed
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.plotting.map_panel import ColourScale, MapView, draw_panel, draw_profile
from ppmcal.plotting.style import (
    BODY,
    EDGE,
    FOOT,
    TITLE,
    capital,
    draw_head,
    draw_legend,
    figure,
    head_height,
    lines_of,
    look,
    number_words,
    png,
    tame,
    with_unit,
)

LEFT, GAP_X, GAP_Y, BAR, BAR_GAP, BAR_ROOM = 0.85, 0.22, 0.34, 0.2, 0.18, 1.25
"""Room before and between panels, and for the colour bar and its words, inches."""
LEAST = 5.2
"""Least width of a picture, inches."""
ONE, MANY = (4.7, 5.0), (2.15, 2.3)
"""Largest width and height of a panel where there is one, and where there are several."""
OWN_SCALES = "axes not to one scale"
THINNEST = 5.0
"""Lengths longer than this times the other are drawn to another scale."""
PANELS = 9


def draw_map(mechanism: Mechanism, grid: Grid, shown: Map,
             determinant: Array | None = None) -> bytes:
    """Return a map as PNG.

    One coordinate gives a curve, two a field of colours under contour lines, three up to
    :data:`PANELS` such fields at levels of the third, on one scale; any further coordinate is
    shown at its level next to home. Home is marked, poses without a value are hatched, and
    the curve is drawn on which ``determinant`` changes sign.

    Args:
        mechanism: the machine, for home, units and the coordinates that the grid leaves alone.
        grid: coordinates and levels, SI.
        shown: the quantity; values of the grid's shape, file units, nan where there is none.
        determinant: det A over the grid, nan where there is none.

    Raises:
        ValueError: values or determinant do not have the grid's shape.
    """
    for name, array in (("values", shown.values), ("determinant", determinant)):
        if array is not None and np.shape(array) != grid.shape:
            raise ValueError(f"{name} of '{shown.name}' have shape {np.shape(array)}, "
                             f"the grid has {grid.shape}")
    view = _view(mechanism, grid, tame(shown.values), determinant)
    head = capital(shown.title)
    below = f"{mechanism.name}, {view.held}" if view.held else mechanism.name
    with look():
        if len(view.levels) == 1:
            return draw_profile(view, shown, head, below)
        return _fields(view, shown, head, below)


def _view(mechanism: Mechanism, grid: Grid, values: Array, determinant: Array | None) -> MapView:
    """Return what is drawn of a map: at most three coordinates, others next to home."""
    units = [mechanism.units.factor("length" if c < 3 else "angle") for c in grid.coordinates]
    levels = [np.asarray(v) / u for v, u in zip(grid.levels, units, strict=True)]
    home = np.array([mechanism.home_pose[c] / u
                     for c, u in zip(grid.coordinates, units, strict=True)])
    corner = np.array([[level[0] for level in grid.levels]])
    drawn = grid.coordinates[:3]
    for axis in reversed(range(3, len(levels))):
        at = int(np.argmin(np.abs(levels[axis] - home[axis])))
        corner[0, axis] = grid.levels[axis][at]
        values = np.take(values, at, axis=axis)
        determinant = None if determinant is None else np.take(determinant, at, axis=axis)
    pose = placed(mechanism, grid.coordinates, corner)[0]
    names = tuple(with_unit(POSE_COORDINATES[c], _unit(mechanism, c)) for c in drawn)
    return MapView(drawn, tuple(levels[:3]), values, determinant, names, home[:3],
                _held(mechanism, drawn, pose))


def _unit(mechanism: Mechanism, coordinate: int) -> str:
    return mechanism.units.name("length" if coordinate < 3 else "angle")


def _held(mechanism: Mechanism, drawn: Sequence[int], pose: Array) -> str:
    """Return where the coordinates that are not drawn are held: ``z = 0 mm, rz free``."""
    fixed, free = [], []
    for c in mechanism.dof:
        if c in drawn:
            continue
        if np.isnan(pose[c]):
            free.append(POSE_COORDINATES[c])
            continue
        value = pose[c] / mechanism.units.factor("length" if c < 3 else "angle")
        text = f"{value:.6g}" if abs(value) > 1e-9 else "0"
        fixed.append(f"{POSE_COORDINATES[c]} = {text} {_unit(mechanism, c)}".replace("-", "−"))
    parts = ["at " + ", ".join(fixed)] if fixed else []
    parts += [", ".join(free) + " free"] if free else []
    return "; ".join(parts)


@dataclass(frozen=True)
class Layout:
    """Where everything is, inches from the lower left corner of the picture.

    Attributes:
        columns, rows: of panels; wide, high: of each panel; equal: whether both axes of a
            panel have one scale; width: of the picture; title, notes: lines of words on top.
    """

    columns: int
    rows: int
    wide: float
    high: float
    equal: bool
    width: float
    title: str
    notes: str

    @classmethod
    def of(cls, view: MapView, panels: int, head: str, below: str) -> Layout:
        """Return the layout of some panels."""
        columns = {1: 1, 2: 2, 4: 2}.get(panels, 3)
        wide, high, equal = _panel_size(view, panels > 1)
        width = max(LEFT + columns * (wide + GAP_X) - GAP_X + BAR_GAP + BAR + BAR_ROOM, LEAST)
        return cls(columns, -(-panels // columns), wide, high, equal, width,
                   lines_of(head, width - 2 * EDGE, TITLE, 3),
                   lines_of(below, width - 2 * EDGE, BODY, 4))

    @property
    def field(self) -> tuple[float, float]:
        """Width and height of all panels together."""
        return (self.columns * (self.wide + GAP_X) - GAP_X,
                self.rows * (self.high + GAP_Y) - GAP_Y)

    @property
    def height(self) -> float:
        """Height of the picture."""
        return head_height(self.title, self.notes) + (
            0.22 if self.rows * self.columns > 1 else 0.0) + self.field[1] + FOOT

    def rectangle(self, left: float, low: float, wide: float, high: float
                  ) -> tuple[float, float, float, float]:
        """Return a rectangle as parts of the picture."""
        return left / self.width, low / self.height, wide / self.width, high / self.height

    def panel(self, i: int) -> tuple[float, float, float, float]:
        """Return the place of one panel."""
        row, column = divmod(i, self.columns)
        return self.rectangle(self.left + column * (self.wide + GAP_X),
                              FOOT + (self.rows - 1 - row) * (self.high + GAP_Y),
                              self.wide, self.high)

    @property
    def left(self) -> float:
        """Left end of the panels; a narrow one stands in the middle."""
        return LEFT + 0.5 * (self.width - LEFT - self.field[0] - BAR_GAP - BAR - BAR_ROOM)


def _fields(view: MapView, shown: Map, head: str, below: str) -> bytes:
    """Draw two or three coordinates: panels, colour bar, words."""
    chosen: Sequence[int | None] = [None]
    if len(view.levels) == 3:
        count = len(view.levels[2])
        chosen = np.unique(np.linspace(0, count - 1, min(count, PANELS)).round()
                           .astype(int)).tolist()
    layout = Layout.of(view, len(chosen), head, below)
    drawn = figure(layout.width, layout.height)
    draw_head(drawn, layout.title, layout.notes)
    scale = ColourScale.of(view.values, shown.log)
    legend: dict[str, Any] = {}
    near = _nearest(view, [c for c in chosen if c is not None])
    for i, level in enumerate(chosen):
        axes = drawn.add_axes(layout.panel(i))
        legend |= draw_panel(axes, view.levels[0], view.levels[1], _layer(view.values, level),
                             None if view.determinant is None else
                             _layer(view.determinant, level), scale,
                             view.home[:2] if level is None or level == near else None,
                             alone=len(chosen) == 1)
        if level is not None:
            axes.set_title(_level_words(view, level), size=BODY, pad=4.0)
        below_it, first = i + layout.columns >= len(chosen), i % layout.columns == 0
        axes.tick_params(labelbottom=below_it, labelleft=first)
        axes.set_xlabel(view.names[0] if below_it else "")
        axes.set_ylabel(view.names[1] if first else "")
    _colour_bar(drawn, scale, shown, layout)
    if not layout.equal and all(c < 3 for c in view.coordinates[:2]):
        legend[OWN_SCALES] = Line2D([], [], linestyle="none")
    return png(drawn, draw_legend(drawn, legend))


def _layer(values: Array, level: int | None) -> Array:
    """Return one level (X, Y) of the third coordinate, or what has only two."""
    return values if level is None else values[:, :, level]


def _panel_size(view: MapView, many: bool) -> tuple[float, float, bool]:
    """Return width and height of a panel, inches, and whether its axes have one scale."""
    widest, highest = MANY if many else ONE
    spans = [float(np.ptp(level)) for level in view.levels[:2]]
    if all(c < 3 for c in view.coordinates[:2]) and min(spans) > 0.0:
        ratio = spans[1] / spans[0]
        if 1.0 / THINNEST <= ratio <= THINNEST:
            wide = min(widest, highest / ratio)
            return wide, wide * ratio, True
    return widest, 0.8 * widest, False


def _nearest(view: MapView, chosen: Sequence[int]) -> int | None:
    """Return the level of the third coordinate on whose panel home is marked."""
    if not chosen:
        return None
    levels, home = view.levels[2], view.home[2]
    pad = 1e-6 * (float(np.ptp(levels)) or 1.0)
    if not levels.min() - pad <= home <= levels.max() + pad:
        return None
    return min(chosen, key=lambda i: abs(float(levels[i] - home)))


def _level_words(view: MapView, level: int) -> str:
    name, _, unit = view.names[2].partition(", ")
    value = float(view.levels[2][level])
    span = float(np.ptp(view.levels[2]))
    text = "0" if abs(value) <= 1e-9 * span else f"{value:.4g}".replace("-", "−")
    return f"{name} = {text} {unit}".strip()


def _colour_bar(drawn: Figure, scale: ColourScale, shown: Map, layout: Layout) -> None:
    """Draw the colour bar with its title, unit and arrows."""
    if scale.empty:
        return
    high = layout.field[1]
    axes = drawn.add_axes(layout.rectangle(layout.left + layout.field[0] + BAR_GAP, FOOT,
                                           BAR, high))
    bar = drawn.colorbar(scale.mappable(), cax=axes, extend=scale.extend, extendfrac=0.04)
    bar.set_ticks(scale.ticks.tolist(), labels=number_words(scale.ticks))
    bar.minorticks_off()
    words = with_unit(shown.title, shown.unit)
    if "\n" in lines_of(words, high, BODY):
        title = lines_of(shown.title, high, BODY, 2)
        words = "\n".join(t for t in (title, lines_of(shown.unit, high, BODY, 1)) if t)
    bar.set_label(words if "\n" in words else lines_of(words, high, BODY, 1))
