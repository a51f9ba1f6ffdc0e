"""What all pictures share: one look, plain words, round numbers, PNG bytes.

Nothing here or in the pictures touches matplotlib's state for good: figures are drawn by
objects on an Agg canvas, under settings that end with the drawing and that no user's settings
file changes, so the same numbers give the same bytes and no display is needed.
"""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.ticker import MaxNLocator, NullFormatter
from matplotlib.transforms import Bbox

from ppmcal.linalg import Array, Bools

DPI = 150
INK, SOFT, GROUND, HATCH = "#1c2227", "#5a6670", "#e6e8ea", "#aab1b7"
LINE, BEFORE, AFTER, OUT = "#dde2e6", "#b3692a", "#1f62a6", "#c2293a"
CARD, SINGULAR = "#ffffff", "#d01c4b"
PAGE = {INK: "ink", SOFT: "soft", LINE: "line", BEFORE: "before", AFTER: "after", OUT: "out",
        CARD: "card"}
"""Colours that the page has by name, as they are by day."""
TITLE, BODY = 12.0, 9.5
"""Font sizes, points."""
EDGE, LABELS, LEGEND, FOOT = 0.2, 0.52, 0.23, 1.1
"""Left margin of words; room for an axis' words, a line of legend and both, inches."""
LARGEST, SMALLEST = 1e100, 1e-100
"""Numbers beyond these are drawn as infinite and as 0."""
EQUAL = 1e-9
"""Values that differ by less than this part of the largest are drawn as equal."""
_SUPER = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LOOK: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"], "font.size": BODY, "axes.edgecolor": SOFT,
    "axes.labelcolor": INK, "text.color": INK, "xtick.color": SOFT, "ytick.color": SOFT,
    "xtick.labelcolor": INK, "ytick.labelcolor": INK, "axes.axisbelow": True,
    "hatch.linewidth": 0.7, "legend.frameon": False, "path.simplify": False,
    "svg.fonttype": "none", "svg.hashsalt": "ppmcal", "text.parse_math": False}


@contextmanager
def look() -> Iterator[None]:
    """Draw with this package's settings and without a word about letters that no font has."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="(?s).*[Gg]lyph")
        warnings.simplefilter("ignore", matplotlib.MatplotlibDeprecationWarning)
        # the backend is not ours to choose: asking for it would load one
        settings: dict[Any, Any] = {k: v for k, v in matplotlib.rcParamsDefault.items()
                                    if k != "backend"}
        with matplotlib.rc_context(settings | _LOOK):
            yield


def figure(width: float, height: float) -> Figure:
    """Return an empty figure, inches."""
    out = Figure(figsize=(width, height), dpi=DPI, facecolor=CARD)
    FigureCanvasAgg(out)
    return out


def png(drawn: Figure, cut: float = 0.0, dpi: float | None = None) -> bytes:
    """Return a figure as PNG, less ``cut`` inches at its foot, without date or version in it."""
    stream = io.BytesIO()
    width, height = drawn.get_size_inches()
    drawn.savefig(stream, format="png", dpi=dpi or DPI, metadata={"Software": None},
                  bbox_inches=Bbox([[0.0, cut], [width, height]]))
    return stream.getvalue()


def with_palette(png: bytes) -> bytes:
    """Return a PNG in at most 256 colours, as it is where that is not smaller or cannot be read.

    Args:
        png: the file's bytes.
    """
    from PIL import Image

    out = io.BytesIO()
    try:
        with Image.open(io.BytesIO(png)) as picture:
            if picture.mode != "RGB" and picture.getextrema()[-1] != (255, 255):
                return png    # what shines through would be lost
            few = picture.convert("RGB").quantize(256, dither=Image.Dither.NONE)
        few.save(out, "PNG", optimize=True)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return png    # a browser may do better
    return min(png, out.getvalue(), key=len)


def head_height(title: str, notes: str) -> float:
    """Return the room that the words on top take, inches."""
    return 0.28 + 0.2 * len(title.splitlines()) + 0.165 * len(notes.splitlines())


def draw_head(drawn: Figure, title: str, notes: str) -> None:
    """Write title and notes on top; both may have several lines."""
    width, height = drawn.get_size_inches()
    drawn.text(EDGE / width, 1.0 - 0.14 / height, title, size=TITLE, weight="bold", va="top")
    drawn.text(EDGE / width, 1.0 - (0.18 + 0.2 * len(title.splitlines())) / height, notes,
               size=BODY, va="top", linespacing=1.15)


def draw_legend(drawn: Figure, entries: Mapping[str, Any]) -> float:
    """Explain what is drawn below it; return how much of the foot is left over, inches."""
    width, height = drawn.get_size_inches()
    if entries:
        drawn.legend(list(entries.values()), list(entries), loc="upper left", ncols=2,
                     bbox_to_anchor=(0.1 / width, (FOOT - LABELS) / height),
                     borderaxespad=0.25, columnspacing=1.4, handletextpad=0.6)
    return FOOT - LABELS - 0.06 - LEGEND * (-(-len(entries) // 2))


def plain(text: object) -> str:
    """Return text on one line, without letters that cannot be drawn."""
    return " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())


def lines_of(text: str, inches: float, size: float, most: int = 4) -> str:
    """Return text broken into lines that fit a width; what is beyond ``most`` lines is cut."""
    letters = max(int(inches * 72.0 / ((0.66 if size >= TITLE else 0.58) * size)), 8)
    return "\n".join(textwrap.wrap(plain(text), letters, max_lines=most, placeholder=" …"))


def with_unit(name: str, unit: str) -> str:
    """Return ``name, unit``, or the name alone for a bare number."""
    return f"{name}, {unit}" if unit.strip() not in ("", "1") else name


def capital(text: str) -> str:
    """Return text with a capital first letter."""
    return text[:1].upper() + text[1:]


def tame(values: Array) -> Array:
    """Return values with those too large to draw as inf, and those too small as 0."""
    out = np.array(values, dtype=float)
    size = np.abs(out)
    out[size > LARGEST] = np.copysign(np.inf, out[size > LARGEST])
    out[size < SMALLEST] = 0.0
    return out


def alone(there: Bools) -> Bools:
    """Return which points (N,) are there and have no neighbour."""
    beside = np.concatenate([[False], there, [False]])
    return np.asarray(there & ~beside[:-2] & ~beside[2:], dtype=bool)


def robust_range(values: Array, log: bool) -> tuple[float, float, bool]:
    """Return lowest and highest colour, and whether they go with the logarithm.

    The inner nine tenths of the values, and as much again to either side, or the whole range
    where that is less: few poses close to a singularity do not take all colours for
    themselves. Values of one sign only can go with the logarithm.
    """
    finite = values[np.isfinite(values)]
    log = log and bool(finite.size) and bool(np.max(finite, initial=0.0) > 0.0)
    if log:
        finite = np.log10(finite[finite > 0.0])
    if not finite.size:
        return 0.0, 1.0, False
    low, inner, outer, high = np.quantile(finite, [0.0, 0.05, 0.95, 1.0])
    if outer > inner:
        low, high = max(low, 2.0 * inner - outer), min(high, 2.0 * outer - inner)
    if log:
        low, high = 10.0**low, 10.0**high
    if high - low <= EQUAL * max(abs(low), abs(high)):
        pad = 0.05 * max(abs(low), abs(high)) or 1.0
        return float(low - pad), float(high + pad), False
    return float(low), float(high), log


def round_numbers(low: float, high: float, log: bool, most: int = 6,
                  steps: Sequence[float] = (1, 2, 2.5, 5, 10)) -> Array:
    """Return round numbers from ``low`` to ``high``, for ticks and contour lines."""
    if log and high > 8.0 * low:
        powers = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
        steps = (1.0, 2.0, 5.0) if len(powers) <= 4 else (1.0,)
        ticks = np.ravel(10.0 ** powers[:, None] * np.array(steps))
        if len(powers) > 10:
            ticks = ticks[::len(powers) // 8 + 1]
    else:
        ticks = np.asarray(MaxNLocator(most, steps=steps).tick_values(low, high))
        ticks[np.abs(ticks) < 1e-9 * (high - low)] = 0.0
    out: Array = ticks[(ticks >= low) & (ticks <= high)]
    return out


def number_words(ticks: Sequence[float] | Array) -> list[str]:
    """Return ticks as text, with no more digits than tell them apart."""
    values = np.asarray(ticks, dtype=float)
    if not values.size:
        return []
    size = np.abs(values)
    apart = np.min(np.diff(np.sort(values)), initial=size.max())
    rounded = values
    for digits in range(1, 16):
        rounded = np.array([float(f"{v:.{digits}g}") for v in values])
        if np.all(np.abs(rounded - values) <= 1e-3 * max(apart, 1e-12 * size.max())):
            break
    least = np.min(size[size > 0.0], initial=np.inf)
    if not (1e-4 <= least < 1e6 and size.max() < 1e6):
        shown = [_power(f"{v:.6g}") for v in rounded]
    else:
        shown = [np.format_float_positional(v, trim="-") for v in rounded]
        if size.max() < 1e3 * least:
            places = max(len(s.partition(".")[2]) for s in shown)
            shown = [f"{v:.{places}f}" for v in rounded]
    return [s.replace("-", "−") for s in shown]


def log_ticks(axis: Axis) -> None:
    """Give a logarithmic axis, its ends set, round numbers, also within one decade."""
    low, high = sorted(float(v) for v in axis.get_view_interval())
    ticks = round_numbers(low, high, True)
    axis.set_ticks(ticks.tolist(), labels=number_words(ticks))
    axis.set_minor_formatter(NullFormatter())


def _power(text: str) -> str:
    """Return ``5e+07`` as ``5·10⁷``, ``1e+07`` as ``10⁷``."""
    mantissa, sign, power = text.partition("e")
    if not sign:
        return text
    times = {"1": "", "-1": "-"}.get(mantissa, f"{mantissa}·")
    return f"{times}10{str(int(power)).translate(_SUPER)}"


def outline(width: float, colour: str = "white") -> list[AbstractPathEffect]:
    """Return a stroke about words and lines, so that they show on any colour."""
    return [withStroke(linewidth=width, foreground=colour)]
