"""A diagnosis in pictures, drawn from diagnosis.json alone.

Every function takes the record and returns a :class:`Drawing`, or None where the record (of an
older version, or cut down) does not hold what it shows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.calibration.fit import Z95, pictures_beside
from ppmcal.diagnosis.residual_series import Series
from ppmcal.io.results import diagnosis_wording as wording
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.learned import LearnedEntry
from ppmcal.linalg import Array
from ppmcal.plotting.bars import Chart, Row, ratio_ticks
from ppmcal.plotting.canvas import HEIGHT, Drawing
from ppmcal.plotting.layers import Between, Intervals, Layer, Marks, Points, Polyline, Zero
from ppmcal.plotting.plot import CLASS_ROOM, Plot, span
from ppmcal.plotting.style import SMALLEST
from ppmcal.report.diagnosis_tables import INPUTS, finer, left_out, odds_to, step_name
from ppmcal.report.html import number, sig, with_label
from ppmcal.wording import actuator_list, shorten_label

SHOWN = 0.99
"""This part of the rows is within the axis; the others are drawn at its edge."""


def _columns(*columns: tuple[float | None, ...]) -> Array | None:
    """Return columns of numbers (c, n), None where there are none or they are not alike."""
    table = [[np.nan if (n := number(v)) is None else n for v in c] for c in columns]
    if len({len(c) for c in table}) != 1 or len(table[0]) < 2:
        return None
    found = np.array(table)
    return found if np.isfinite(found).all() else None


def _picture(record: DiagnosisRecord, entry: LearnedEntry) -> Drawing | None:
    curve, rows = _columns(entry.x, entry.value, entry.sigma), _columns(entry.at, entry.partial)
    if curve is None or rows is None:
        return None
    half = (record.coverage or Z95) * curve[2]
    factor, unit = finer(entry.unit, float(np.max(np.abs(curve[1]) + half)))
    ends = factor * np.quantile(rows[1], [1.0 - SHOWN, SHOWN])
    up = span(np.concatenate([ends, factor * (curve[1] - half), factor * (curve[1] + half)]))
    other = _columns(entry.x, entry.other) if entry.by_ends else None
    both = [] if other is None else [Polyline(
        other[0], factor * other[1],
        f"learned, {entry.by} = {sig(entry.by_ends[0], 4)} {entry.by_unit}")]
    at = "" if other is None else f" Two lines: {entry.by} = " + " and ".join(
        f"{sig(e, 4)} {entry.by_unit}" for e in entry.by_ends) + "; the band is the second one's."
    what = "joint" if entry.on else entry.acts
    name = entry.name(wording.actuators(record))
    return Plot(
        span(curve[0], margin=0.02), up,
        (with_label(INPUTS.get(entry.input, entry.input), entry.input_unit),
         with_label(f"error of {what}", unit)),
        [Zero(), Marks(rows[0], factor * rows[1], "before", "o", 3.0),
         Between(curve[0], factor * (curve[1] - half), factor * (curve[1] + half)),
         Polyline(curve[0], factor * curve[1], "what was learned"), *both],
        (entry.input_unit, unit)).drawing(
        f"Learned: {name}",
        "Line: what was learned, with its 95 % band; rings: what single rows say of it, all else "
        f"taken out. It is a shape, not a cause; nothing is known beyond the ends.{at}",
        f"{name}: {number(entry.rms)} {entry.unit} rms.")


APART = 2.5
"""Before and after are plotted so many points to each side of their place."""


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
    what = _what(series, wording.actuators(record))
    classes = series.names if len(series.names) == size else ()
    x_name = INPUTS.get(series.input, series.input or "input")
    x_name = with_label(f"{x_name} {series.which}".strip(), x_unit)
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
        return wording.effect_name(record, record.effects[n]) + place
    name = INPUTS.get(series.input, series.input).partition(" (")[0]
    against = " ".join(w for w in (what, "against", name, series.which) if w)
    return f"What is left: {against}" if series.role == "left" and record.effects else against


LONG_ODDS = 150.0
"""Beyond these an alternative is in the set only for what it can imitate."""


def pictures(record: DiagnosisRecord) -> dict[str, list[Drawing]]:
    """Return file name without ending -> pictures on that sheet."""
    found = pictures_beside({
        "gap": lambda: [gap(record)], "actuators": lambda: [by_actuator(record)],
        "inputs": lambda: [_panel(record, s) for s in record.plot_data.series],
        "alternatives": lambda: [confusion(record)],
        "terms": lambda: [_picture(record, e) for e in record.learned]})
    drawn = {name: [p for p in some if p is not None] for name, some in found.items()}
    return {name: some for name, some in drawn.items() if some}


def gap(record: DiagnosisRecord) -> Drawing | None:
    """Return the residuals of one model after the other, down to the noise."""
    steps = [(s, value) for s in record.plot_data.steps
             if (value := number(s.rms_ratio)) is not None]
    held = record.gap
    ends = [number(held.before), number(held.after)]
    if not steps and None in ends:
        return None
    high = 1.25 * max([*(v for _, v in steps), *(e for e in ends if e is not None), 1.6])
    rows = [_gap_row(step_name(record, step), value,
                     "after" if n > 0 and step.what == "effect" else "before")
            for n, (step, value) in enumerate(steps)]
    if None not in ends:
        rows.append(Row(f"Check on {wording.left_out_poses(held)}", strong=True))
        rows.append(_gap_row("geometry alone", ends[0] or 0.0, "before"))
        if record.effects:
            rows.append(_gap_row("geometry and what is named", ends[1] or 0.0, "after"))
    ticks = [(v, "1 (noise)" if v == 1.0 else words) for v, words in ratio_ticks(high)]
    return Chart(rows, "log", 0.5, high, "rms of the residuals over the noise", ticks).drawing(
        "How the gap closes",
        "Upper bars: the rows that effects were searched in; each bar adds one thing to the "
        "model. The upright line is the noise alone: where nothing is missing, bars end there.",
        "; ".join(f"{step_name(record, s)}: {sig(v)} times the noise" for s, v in steps) + ".",
        wording.gap_closed(record))


def _gap_row(label: str, value: float, kind: str) -> Row:
    return Row(label, ((value, kind),), times(value), ((1.0, "limit"),))


def times(ratio: float) -> str:
    """Return ``0.94 ×``, ``1.05 ×``, ``21.9 ×``."""
    return f"{sig(ratio, 3 if float(f'{ratio:.2f}') >= 1.0 else 2)} ×"


def by_actuator(record: DiagnosisRecord) -> Drawing | None:
    """Return the rms error of each joint before and after, beside what noise gives."""
    rows = [a for a in record.plot_data.actuators if number(a.rms_before) is not None]
    if not rows:
        return None
    units = {a.unit for a in rows}
    one, after = len(units) == 1, bool(record.effects)
    parts = [[number(v) or 0.0 for v in (a.rms_before, a.rms_after, a.noise)] for a in rows]
    factor, unit = finer(units.pop(), max(p[0] for p in parts)) if one else (1.0, "")
    table = [(a.name or "?", [v * (factor if one else 1.0 / max(p[2], SMALLEST)) for v in p])
             for a, p in zip(rows, parts, strict=True)]
    bars = []
    for name, (before, now, noise) in table:
        amount = f"{sig(before)} → {sig(now)}" if after else sig(before)
        bars.append(Row(name, ((before, "before"), (now, "after")) if after else
                        ((before, "after"),), f"{amount} {unit or '×'}", ((noise, "limit"),)))
    legend = [("before", "geometry alone"), ("after", "with what is named")] if after else [
        ("after", "geometry alone")]
    shown = f"rms of the joint error ({unit})" if one else "rms of the joint error over the noise"
    reading = ("What is missing shows where the upper bar passes the line; the lower should not."
               if after else "What is missing shows where a bar passes its line.")
    high = 1.06 * max([*(max(v) for _, v in table), SMALLEST])
    return Chart(bars, "linear", 0.0, high, shown, legend=[*legend, ("limit", "noise")],
                 beside=True).drawing(
        "Where it is: the error of each joint",
        "Joint errors that would explain the residuals, row by row; the upright lines are what "
        f"noise alone gives. {reading} {left_out(record)}".rstrip(),
        "; ".join(f"{name}: {sig(v[0])} before, {sig(v[1])} after, noise {sig(v[2])} "
                  f"{unit}".rstrip() for name, v in table) + ".")


def confusion(record: DiagnosisRecord) -> Drawing | None:
    """Return for each named effect what could take its place, and how likely that is."""
    groups = []
    for group in wording.together(record):
        names = group[0].alternatives_on or group[0].alternatives
        odds = [number(o) for o in group[0].odds]
        pairs = [(n, o) for n, o in zip(names, odds, strict=False) if o is not None]
        if pairs:
            groups.append((wording.group_name(record, group), sorted(pairs, key=lambda p: p[1])))
    if not groups:
        return None
    total, rows = wording.actuators(record), []
    for name, pairs in groups:
        rows.append(Row(name, strong=True))
        rows += [Row("or " + shorten_label(other, total), ((value, "alternative"),),
                     f"{odds_to(value)} : 1") for other, value in pairs]
    all_odds = [o for _, pairs in groups for _, o in pairs]
    high = max([LONG_ODDS] + [min(o, 1e6) for o in all_odds])
    file, long = record.next_file, max(all_odds) > LONG_ODDS
    return Chart(rows, "log", 0.5, high, "odds for the named effect against the alternative",
                 ratio_ticks(high)).drawing(
        "What these data cannot tell apart",
        "Odds from the fit and the number of parameters; a short bar: the data hardly prefer the "
        "named effect." + long * (" A long one: the alternative fits as well and has more "
                                  "parameters, which does not rule it out."),
        "; ".join(f"{n}: " + ", ".join(f"{odds_to(v)} to 1 against {a}" for a, v in pairs)
                  for n, pairs in groups) + ".",
        f"Measurements that tell them apart are in {file}." if file else "")
