"""Mean errors against the input that an effect follows, before and after: one panel each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_plots import PlottedSeries
from ppmcal.io.results.diagnosis_wording import actuators, effect_name
from ppmcal.linalg import Array
from ppmcal.report import svg
from ppmcal.report.diagnosis_format import INPUTS, finer, left_out
from ppmcal.report.format import number
from ppmcal.report.svg_bars import BarPicture, fitting, width
from ppmcal.wording import where

APART = 2.5
"""Before and after are plotted so many pixels to each side of their place."""
CLASS_ROOM = 12.0
"""Further height below the axis for the names of classes."""


def input_pictures(record: DiagnosisRecord) -> list[BarPicture]:
    """Return one panel for each series of the plot data."""
    out = [_panel(record, s) for s in record.plot_data.series]
    return [p for p in out if p is not None]


def _column(values: Sequence[float | None]) -> Array:
    known = [number(v) for v in values]
    return np.array([np.nan if v is None else v for v in known])


def _values(s: PlottedSeries) -> tuple[Array, Array] | None:
    """Return input (B,) and means and half intervals before and after (4, B), if drawable."""
    columns = [_column(v) for v in (s.x, s.before, s.before_95, s.after, s.after_95)]
    size = min(map(len, columns))
    x, table = columns[0][:size], np.stack([c[:size] for c in columns[1:]])
    seen = [np.isfinite(mean + half).any() for mean, half in (table[:2], table[2:])]
    return (x, table) if size > 1 and np.isfinite(x).all() and all(seen) else None


def _panel(record: DiagnosisRecord, series: PlottedSeries) -> BarPicture | None:
    """Return one panel, None where there is too little to draw."""
    found = _values(series)
    if found is None:
        return None
    x, table = found
    size = len(x)
    both = bool(record.effects)
    if not both:
        table[:2] = table[2:]
    ends = np.concatenate([table[0] - table[1], table[0] + table[1], table[2] - table[3],
                           table[2] + table[3]])
    factor, unit = finer(series.unit, float(np.nanmax(np.abs(ends))))
    table *= factor
    per, x_unit = finer(series.input_unit, _largest(series, x))
    what = _what(series, actuators(record))
    names = series.names
    frame = svg.Frame(svg.span(x * per, margin=0.06), svg.span(np.append(ends * factor, 0.0)))
    x_name, classes = _input_name(series, x_unit), len(names) == size
    parts = [svg.axes(frame, "" if classes else x_name, _with(f"error of {what}", unit),
                      x_ticks=not classes), _zero(frame)]
    if classes:
        parts.append(_classes(frame, x * per, names, x_name))
    if both:
        parts.append(_marks(frame, x * per, table[0], table[1], "before", -APART))
    parts.append(_marks(frame, x * per, table[2], table[3], "after", APART if both else 0.0))
    tail = f"; one period is {_period(series)}" if number(series.period) else ""
    subject = f"measured {series.coordinate}" if series.coordinate else "the joint"
    return BarPicture(
        "inputs", _title(record, series, what),
        f"Means of {size} {'classes' if classes else 'bins'} with 95 % bars; positive: {subject} "
        f"is further than the model says{tail}. {left_out(record)}".rstrip(),
        f"Mean error of {what} in {size} bins of {x_name}; largest "
        f"{np.nanmax(np.abs(table[0])):.3g} {unit} before and "
        f"{np.nanmax(np.abs(table[2])):.3g} {unit} after.", tuple(parts),
        svg.HEIGHT + (CLASS_ROOM if classes else 0.0),
        key='<i class="key ring"></i>geometry alone <i class="key after"></i>with what is named'
        if both else '<i class="key after"></i>geometry alone',
        note="○ geometry alone, ● with what is named." if both else "● geometry alone.")


def _largest(series: PlottedSeries, x: Array) -> float:
    """Return the size that decides an input's unit: positions keep that of the file."""
    keeps = series.input not in ("time", "phase", "velocity")
    return float("inf") if keeps else float(np.max(np.abs(x)))


def _what(series: PlottedSeries, total: int) -> str:
    if series.coordinate:
        return f"measured {series.coordinate}"
    on = series.on
    return where(on, total) if len(on) < 4 or len(on) == total else f"{len(on)} actuators"


def _title(record: DiagnosisRecord, series: PlottedSeries, what: str) -> str:
    n = series.effect
    if n is not None and 0 <= n < len(record.effects):
        place = f" ({what})" if series.coordinate else ""
        return effect_name(record, record.effects[n]) + place
    name = INPUTS.get(series.input, series.input).partition(" (")[0]
    against = " ".join(w for w in (what, "against", name, series.which) if w)
    return f"What is left: {against}" if series.role == "left" and record.effects else against


def _input_name(series: PlottedSeries, unit: str) -> str:
    name = INPUTS.get(series.input, series.input or "input")
    return _with(f"{name} {series.which}".strip(), unit)


def _with(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


def _period(series: PlottedSeries) -> str:
    return f"{series.period:.4g} {series.input_unit}".rstrip()


def _zero(frame: svg.Frame) -> str:
    return svg.line(frame, [frame.x.low, frame.x.high], [0.0, 0.0], "faint")


def _marks(frame: svg.Frame, x: Array, mean: Array, half: Array, kind: str, aside: float) -> str:
    """Return means with their bars; rings before, discs after."""
    good = np.isfinite(mean) & np.isfinite(half)
    px = frame.px(x[good]) + aside
    low, high = frame.py((mean - half)[good]), frame.py((mean + half)[good])
    bars = "".join(f"M{svg.num(a)} {svg.num(b)}V{svg.num(c)}"
                   for a, b, c in zip(px, low, high, strict=True))
    shape = "ring" if kind == "before" else "disc"
    dots = "".join(f'<circle class="{shape}" cx="{svg.num(a)}" cy="{svg.num(b)}" r="3.2"/>'
                   for a, b in zip(px, frame.py(mean[good]), strict=True))
    return f'<path class="stroke {kind}" d="{bars}"/>{dots}' if bars else ""


def _classes(frame: svg.Frame, x: Array, names: Sequence[str], name: str) -> str:
    """Return signs below the axis, each actuator's name below its signs, and the axis' name."""
    out = []
    floor = frame.height - svg.BOTTOM
    pairs = [n.rpartition(" ") for n in names]
    px = frame.px(x)
    for place, (_, _, sign) in zip(px, pairs, strict=True):
        out.append(svg.text(float(place), floor + 12.0, sign, "middle", "ink"))
    groups = list(dict.fromkeys(owner for owner, _, _ in pairs))
    room = (svg.WIDTH - svg.LEFT - svg.RIGHT) / max(len(groups), 1)
    for owner in groups:
        mine = [float(p) for p, (o, _, _) in zip(px, pairs, strict=True) if o == owner]
        if room > width("leg…"):
            out.append(fitting(sum(mine) / len(mine), floor + 25.0, owner, room, "middle", ""))
    middle = (svg.LEFT + frame.width - svg.RIGHT) / 2.0
    out.append(svg.text(middle, frame.height - 6.0 + CLASS_ROOM, name, "middle", "name"))
    return "".join(out)
