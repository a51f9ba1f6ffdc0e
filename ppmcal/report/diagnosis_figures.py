"""A diagnosis in pictures, drawn from diagnosis.json alone.

Every function takes the record and returns a :class:`Drawing`, or None where the record (of an
older version, or cut down) does not hold what it shows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ppmcal.calibration.fit import pictures_beside
from ppmcal.diagnosis.plot_data import SelectionStep
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import (
    actuators,
    gap_closed,
    group_name,
    left_out_poses,
    name_of,
    together,
)
from ppmcal.plotting.bars import Chart, Row, ratio_ticks
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.style import SMALLEST
from ppmcal.report.diagnosis_format import finer, left_out, odds_to
from ppmcal.report.diagnosis_inputs import input_pictures
from ppmcal.report.format import number, sig
from ppmcal.report.learned_figures import term_pictures
from ppmcal.wording import shorten_label

LONG_ODDS = 150.0
"""Beyond these an alternative is in the set only for what it can imitate."""


def pictures(record: DiagnosisRecord) -> dict[str, list[Drawing]]:
    """Return file name without ending -> pictures on that sheet."""
    found = pictures_beside(_makers(record))
    drawn = {name: [p for p in some if p is not None] for name, some in found.items()}
    return {name: some for name, some in drawn.items() if some}


def _makers(record: DiagnosisRecord) -> dict[str, Callable[[], Sequence[Drawing | None]]]:
    return {
        "gap": lambda: [gap(record)], "actuators": lambda: [by_actuator(record)],
        "inputs": lambda: input_pictures(record),
        "alternatives": lambda: [confusion(record)], "terms": lambda: term_pictures(record)}


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
        rows.append(Row(f"Check on {left_out_poses(held)}", strong=True))
        rows.append(_gap_row("geometry alone", ends[0] or 0.0, "before"))
        if record.effects:
            rows.append(_gap_row("geometry and what is named", ends[1] or 0.0, "after"))
    ticks = [(v, "1 (noise)" if v == 1.0 else words) for v, words in ratio_ticks(high)]
    return Chart(rows, "log", 0.5, high, "rms of the residuals over the noise", ticks).drawing(
        "How the gap closes",
        "Upper bars: the rows that effects were searched in; each bar adds one thing to the "
        "model. The upright line is the noise alone: where nothing is missing, bars end there.",
        "; ".join(f"{step_name(record, s)}: {sig(v)} times the noise" for s, v in steps) + ".",
        gap_closed(record))


def _gap_row(label: str, value: float, kind: str) -> Row:
    return Row(label, ((value, kind),), times(value), ((1.0, "limit"),))


def times(ratio: float) -> str:
    """Return ``0.94 ×``, ``1.05 ×``, ``21.9 ×``."""
    return f"{sig(ratio, 3 if float(f'{ratio:.2f}') >= 1.0 else 2)} ×"


def step_name(record: DiagnosisRecord, step: SelectionStep) -> str:
    """Return what one step adds to the model."""
    if step.what == "start":
        return "machine as in its file, only frames fitted"
    if step.what == "geometry":
        return "+ geometry identified"
    return "+ " + name_of(record, step.kind, step.on)


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
    for group in together(record):
        names = group[0].alternatives_on or group[0].alternatives
        odds = [number(o) for o in group[0].odds]
        pairs = [(n, o) for n, o in zip(names, odds, strict=False) if o is not None]
        if pairs:
            groups.append((group_name(record, group), sorted(pairs, key=lambda p: p[1])))
    if not groups:
        return None
    total, rows = actuators(record), []
    for name, pairs in groups:
        rows.append(Row(name, strong=True))
        rows += [Row("or " + shorten_label(other, total), ((value, "alternative"),),
                     f"{odds_to(value)} : 1") for other, value in pairs]
    all_odds = [o for _, pairs in groups for _, o in pairs]
    high = max([LONG_ODDS] + [min(o, 1e6) for o in all_odds])
    file, long = record.next_measurements.file, max(all_odds) > LONG_ODDS
    return Chart(rows, "log", 0.5, high, "odds for the named effect against the alternative",
                 ratio_ticks(high)).drawing(
        "What these data cannot tell apart",
        "Odds from the fit and the number of parameters; a short bar: the data hardly prefer the "
        "named effect." + long * (" A long one: the alternative fits as well and has more "
                                  "parameters, which does not rule it out."),
        "; ".join(f"{n}: " + ", ".join(f"{odds_to(v)} to 1 against {a}" for a, v in pairs)
                  for n, pairs in groups) + ".",
        f"Measurements that tell them apart are in {file}." if file else "")
