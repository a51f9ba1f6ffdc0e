"""Mean errors against the input that an effect follows, before and after: one panel each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.diagnosis.residual_series import Series
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import actuators, effect_name
from ppmcal.linalg import Array
from ppmcal.plotting.canvas import HEIGHT, Drawing
from ppmcal.plotting.layers import Intervals, Layer, Points, Zero
from ppmcal.plotting.plot import CLASS_ROOM, Plot, span
from ppmcal.report.diagnosis_format import INPUTS, finer, left_out
from ppmcal.report.format import number, with_label
from ppmcal.wording import actuator_list

APART = 2.5
"""Before and after are plotted so many points to each side of their place."""


def input_pictures(record: DiagnosisRecord) -> list[Drawing]:
    """Return one panel for each series of the plot data."""
    out = [_panel(record, s) for s in record.plot_data.series]
    return [p for p in out if p is not None]


def _values(s: Series) -> tuple[Array, Array] | None:
    """Return input (B,) and means and half intervals before and after (4, B), if drawable."""
    columns = [np.array([np.nan if (n := number(v)) is None else n for v in some])
               for some in (s.x, s.before, s.before_95, s.after, s.after_95)]
    size = min(map(len, columns))
    x, table = columns[0][:size], np.stack([c[:size] for c in columns[1:]])
    seen = [np.isfinite(mean + half).any() for mean, half in (table[:2], table[2:])]
    return (x, table) if size > 1 and np.isfinite(x).all() and all(seen) else None


def _panel(record: DiagnosisRecord, series: Series) -> Drawing | None:
    """Return one panel, None where there is too little to draw."""
    found = _values(series)
    if found is None:
        return None
    x, table = found
    size = len(x)
    both = bool(record.effects)
    if not both:
        table[:2] = table[2:]
    ends = np.append(table[::2] - table[1::2], table[::2] + table[1::2])
    factor, unit = finer(series.unit, float(np.nanmax(np.abs(ends))))
    table *= factor
    per, x_unit = finer(series.input_unit, _largest(series, x))
    what = _what(series, actuators(record))
    classes = series.names if len(series.names) == size else ()
    x_name = _input_name(series, x_unit)
    period = number(series.period)
    tail = "" if not period else f"; one period is {period:.4g} {series.input_unit}".rstrip()
    subject = f"measured {series.coordinate}" if series.coordinate else "the joint"
    return _plot(x * per, table, both, classes, (x_name, with_label(f"error of {what}", unit)),
                 (x_unit, unit), np.append(factor * ends, 0.0)).drawing(
        _title(record, series, what),
        f"Means of {size} {'classes' if classes else 'bins'} with 95 % bars; positive: {subject} "
        f"is further than the model says{tail}. {left_out(record)}".rstrip(),
        f"Mean error of {what} in {size} bins of {x_name}; largest "
        f"{np.nanmax(np.abs(table[0])):.3g} {unit} before and "
        f"{np.nanmax(np.abs(table[2])):.3g} {unit} after.",
        (("ring", "geometry alone"), ("after", "with what is named")) if both else
        (("after", "geometry alone"),),
        "○ geometry alone, ● with what is named." if both else "● geometry alone.")


def _plot(x: Array, table: Array, both: bool, classes: Sequence[str], names: tuple[str, str],
          units: tuple[str, str], ends: Array) -> Plot:
    """Return means with their intervals; below the axis the names of classes."""
    said = Points(classes)
    layers: list[Layer] = [Zero()]
    if both:
        layers.append(Intervals(x, table[0], table[1], "before", -APART, said))
    layers.append(Intervals(x, table[2], table[3], "after", APART if both else 0.0, said))
    parts = [name.rpartition(" ") for name in classes]
    return Plot(span(x, margin=0.06), span(ends), names, layers, units,
                height=HEIGHT + (CLASS_ROOM if parts else 0.0),
                classes=[(at, owner, sign) for at, (owner, _, sign) in
                         zip(x.tolist() if parts else (), parts, strict=True)])


def _largest(series: Series, x: Array) -> float:
    """Return the size that decides an input's unit: positions keep that of the file."""
    keeps = series.input not in ("time", "phase", "velocity")
    return float("inf") if keeps else float(np.max(np.abs(x)))


def _what(series: Series, total: int) -> str:
    if series.coordinate:
        return f"measured {series.coordinate}"
    on = series.on
    return actuator_list(on, total) if len(on) < 4 or len(on) == total else f"{len(on)} actuators"


def _title(record: DiagnosisRecord, series: Series, what: str) -> str:
    n = series.effect
    if n is not None and 0 <= n < len(record.effects):
        place = f" ({what})" if series.coordinate else ""
        return effect_name(record, record.effects[n]) + place
    name = INPUTS.get(series.input, series.input).partition(" (")[0]
    against = " ".join(w for w in (what, "against", name, series.which) if w)
    return f"What is left: {against}" if series.role == "left" and record.effects else against


def _input_name(series: Series, unit: str) -> str:
    name = INPUTS.get(series.input, series.input or "input")
    return with_label(f"{name} {series.which}".strip(), unit)
