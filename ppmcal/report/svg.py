"""Small drawings: axes, points, strokes and lines as SVG text, coloured by the page's CSS.

All drawings share one size, chosen so that 11 px letters stay readable on a 400 px screen.
Marks of one kind are one path: a thousand points cost about 12 kB.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.linalg import Array

WIDTH, HEIGHT = 400.0, 250.0
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LEAST = 1e-280
"""Smaller numbers are drawn as 0: ratios of them would overflow."""
LEFT, RIGHT, TOP, BOTTOM = 54.0, 10.0, 12.0, 40.0


@dataclass(frozen=True)
class Axis:
    """One axis from ``low`` to ``high``, linear or logarithmic."""

    low: float
    high: float
    log: bool = False

    def at(self, values: ArrayLike) -> Array:
        """Return where values lie, 0 at the low end to 1 at the high end, clipped."""
        v = np.asarray(values, dtype=float)
        a, b = self.low, self.high
        if self.log:
            v, a, b = np.log10(np.maximum(v, LEAST)), math.log10(a), math.log10(b)
        return np.asarray(np.clip((v - a) / (b - a), 0.0, 1.0), dtype=float)

    def ticks(self, most: int = 6) -> list[float]:
        """Return round values within the axis."""
        if self.log:
            first, last = math.ceil(math.log10(self.low) - 1e-9), math.log10(self.high)
            step = max(1, math.ceil((last - first) / most))
            tens = [10.0**k for k in range(first, math.floor(last + 1e-9) + 1, step)]
            return tens if len(tens) > 1 else [self.low, math.sqrt(self.low * self.high), self.high]
        ten = 10.0 ** math.floor(math.log10((self.high - self.low) / most))
        wide = next(s for s in (ten, 2 * ten, 5 * ten, 10 * ten)
                    if (self.high - self.low) / s <= most)
        start = math.ceil(self.low / wide - 1e-9)
        return [k * wide for k in range(start, math.floor(self.high / wide + 1e-9) + 1)]


def span(values: ArrayLike, log: bool = False, zero: bool = False, margin: float = 0.05) -> Axis:
    """Return an axis that holds the finite values, with a margin.

    ``log``: whole powers of ten around them, all but the lowest half percent, which is drawn
    at the edge; ``zero``: symmetric about 0.
    """
    v = np.asarray(values, dtype=float).ravel()
    v = v[np.isfinite(v)]
    if log:
        v = v[v > LEAST]
        if not v.size:
            return Axis(0.1, 1.0, True)
        top = math.ceil(math.log10(float(v.max())) + 1e-9)
        least = max(float(np.quantile(v, 0.005)), 1e-12 * 10.0**top)
        foot = min(math.floor(math.log10(least)), top - 1)
        return Axis(10.0**foot, 10.0**top, True)
    low, high = (float(v.min()), float(v.max())) if v.size else (0.0, 1.0)
    if zero:
        high = max(abs(low), abs(high))
        low = -high
    largest = max(abs(low), abs(high))
    if not high - low > 1e-12 * max(largest, LEAST):
        room = largest if largest > LEAST else 1.0
        low, high = low - room, high + room
    pad = margin * (high - low)
    return Axis(low - pad, high + pad)


@dataclass(frozen=True)
class Frame:
    """The plot area with its two axes; turns data into drawing coordinates."""

    x: Axis
    y: Axis
    left: float = LEFT
    width: float = WIDTH
    height: float = HEIGHT

    def px(self, values: ArrayLike) -> Array:
        """Return horizontal drawing coordinates."""
        return self.left + self.x.at(values) * (self.width - self.left - RIGHT)

    def py(self, values: ArrayLike) -> Array:
        """Return vertical drawing coordinates (downwards)."""
        return self.height - BOTTOM - self.y.at(values) * (self.height - BOTTOM - TOP)


def num(value: float) -> str:
    """Return a coordinate with a tenth of a pixel."""
    return f"{value:.1f}".removesuffix(".0")


def label(value: float, log: bool = False) -> str:
    """Return a tick's label; powers of ten on a logarithmic axis are written as such."""
    power = math.log10(value) if value > 0.0 else 0.0
    if log and abs(power) > 2.5 and abs(power - round(power)) < 1e-9:
        return f"10{str(round(power)).translate(SUPERSCRIPT)}"
    if value != 0.0 and not 1e-4 <= abs(value) < 1e5:
        mantissa, exponent = f"{value:.6e}".split("e")
        head = mantissa.rstrip("0").rstrip(".").replace("-", "−")
        return f"{head}e{int(exponent)}".replace("e-", "e−")
    return f"{value:.6g}".replace("-", "−")


def points(frame: Frame, x: ArrayLike, y: ArrayLike, kind: str) -> str:
    """Return dots (class ``kind``), one path."""
    px, py = _finite(frame.px(x), frame.py(y), x, y)
    d = "".join(f"M{num(a)} {num(b)}h0" for a, b in zip(px, py, strict=True))
    return f'<path class="dot {kind}" d="{d}"/>' if d else ""


def crosses(frame: Frame, x: ArrayLike, y: ArrayLike, kind: str) -> str:
    """Return small diagonal crosses."""
    px, py = _finite(frame.px(x), frame.py(y), x, y)
    d = "".join(f"M{num(a - 3)} {num(b - 3)}l6 6m0-6l-6 6" for a, b in zip(px, py, strict=True))
    return f'<path class="line {kind}" d="{d}"/>' if d else ""


def strokes(frame: Frame, x: ArrayLike, low: ArrayLike, high: ArrayLike, kind: str) -> str:
    """Return upright strokes from ``low`` to ``high``."""
    px, a = _finite(frame.px(x), frame.py(low), x, low)
    _, b = _finite(frame.px(x), frame.py(high), x, low)
    d = "".join(f"M{num(p)} {num(q)}V{num(r - 0.5)}" for p, q, r in zip(px, a, b, strict=True))
    return f'<path class="stroke {kind}" d="{d}"/>' if d else ""


def line(frame: Frame, x: ArrayLike, y: ArrayLike, kind: str) -> str:
    """Return a line through the points."""
    px, py = _finite(frame.px(x), frame.py(y), x, y)
    pairs = " ".join(f"{num(a)},{num(b)}" for a, b in zip(px, py, strict=True))
    return f'<polyline class="line {kind}" points="{pairs}"/>' if pairs else ""


def segments(px: Array, py: Array, dx: Array, dy: Array, kind: str) -> str:
    """Return arrows in drawing coordinates from (px, py) by (dx, dy)."""
    parts = []
    for a, b, u, v in zip(px, py, dx, dy, strict=True):
        parts.append(f"M{num(a)} {num(b)}l{num(u)} {num(v)}")
        size = math.hypot(u, v)
        if size > 4.0:
            c, s = -u / size * 3.0, -v / size * 3.0
            parts.append(f"l{num(0.87 * c - 0.5 * s)} {num(0.5 * c + 0.87 * s)}"
                         f"M{num(a + u)} {num(b + v)}l{num(0.87 * c + 0.5 * s)} "
                         f"{num(-0.5 * c + 0.87 * s)}")
    return f'<path class="line {kind}" d="{"".join(parts)}"/>' if parts else ""


def bars(frame: Frame, edges: Array, tops: Array, kind: str) -> str:
    """Return a histogram's bars as one path."""
    base = num(float(frame.py(0.0)))
    x, y = frame.px(edges), frame.py(tops)
    d = "".join(f"M{num(x[i] + 0.5)} {base}V{num(y[i])}H{num(x[i + 1] - 0.5)}V{base}z"
                for i in range(len(tops)) if tops[i] > 0)
    return f'<path class="area {kind}" d="{d}"/>'


def box(frame: Frame, low: float, high: float, kind: str) -> str:
    """Return a band across the plot between two values of y."""
    a, b = float(frame.py(high)), float(frame.py(low))
    return (f'<rect class="area {kind}" x="{num(frame.left)}" y="{num(a)}" '
            f'width="{num(frame.width - frame.left - RIGHT)}" height="{num(b - a)}"/>')


def text(x: float, y: float, words: str, anchor: str = "start", kind: str = "") -> str:
    """Return words at a place."""
    extra = f' class="{kind}"' if kind else ""
    return (f'<text x="{num(x)}" y="{num(y)}" text-anchor="{anchor}"{extra}>'
            f"{escape(words)}</text>")


def axes(frame: Frame, x_label: str, y_label: str, x_ticks: bool = True, y_ticks: bool = True
         ) -> str:
    """Return grid lines, tick labels and axis labels."""
    left, right = frame.left, frame.width - RIGHT
    floor = frame.height - BOTTOM
    grid, out = [], []
    for t in frame.y.ticks() if y_ticks else []:
        y = float(frame.py(t))
        grid.append(f"M{num(left)} {num(y)}H{num(right)}")
        out.append(text(left - 5, y + 3.5, label(t, frame.y.log), "end"))
    for t in frame.x.ticks() if x_ticks else []:
        x = float(frame.px(t))
        grid.append(f"M{num(x)} {num(floor)}v4")
        out.append(text(x, floor + 15, label(t), "middle"))
    out.insert(0, f'<path class="grid" d="{"".join(grid)}"/>'
                  f'<path class="axis" d="M{num(left)} {num(TOP)}V{num(floor)}H{num(right)}"/>')
    if x_label:
        out.append(text((left + right) / 2, frame.height - 6, x_label, "middle", "name"))
    middle = (TOP + floor) / 2
    out.append(f'<text class="name" text-anchor="middle" transform="translate(11 {num(middle)}) '
               f'rotate(-90)">{escape(y_label)}</text>')
    return "".join(out)


def document(title: str, description: str, parts: Sequence[str], width: float = WIDTH,
             height: float = HEIGHT, kind: str = "plot") -> str:
    """Return the whole drawing with its title and description for those who cannot see it."""
    return (f'<svg class="{kind}" role="img" aria-label="{escape(title)}" '
            f'viewBox="0 0 {num(width)} {num(height)}">'
            f"<title>{escape(title)}</title><desc>{escape(description)}</desc>"
            f"{''.join(parts)}</svg>")


def _finite(px: Array, py: Array, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Return the drawing coordinates whose data are finite."""
    good = np.isfinite(np.asarray(x, dtype=float)) & np.isfinite(np.asarray(y, dtype=float))
    return np.atleast_1d(px)[np.atleast_1d(good)], np.atleast_1d(py)[np.atleast_1d(good)]
