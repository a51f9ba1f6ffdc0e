"""A diagnosis in pictures, drawn from diagnosis.json alone.

Every function takes the record and returns a :class:`BarPicture`, or None where the record (of an
older version, or cut down) does not hold what it shows.
"""

from __future__ import annotations

from collections.abc import Sequence

from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_plots import PlottedActuator, PlottedStep
from ppmcal.io.results.diagnosis_wording import (
    actuators,
    gap_closed,
    group_name,
    name_of,
    together,
    worst_block,
)
from ppmcal.report import svg
from ppmcal.report.diagnosis_format import finer, left_out, odds_to
from ppmcal.report.diagnosis_inputs import input_pictures
from ppmcal.report.diagnosis_ranking import ranking
from ppmcal.report.format import number, sig
from ppmcal.report.svg_bars import (
    EDGE,
    BarPicture,
    Bars,
    linear_scale,
    log_scale,
    ratio_ticks,
    width,
)
from ppmcal.wording import shorter


def pictures(record: DiagnosisRecord) -> dict[str, list[BarPicture]]:
    """Return file name without ending -> pictures on that sheet."""
    found: dict[str, Sequence[BarPicture | None]] = {
        "gap": [gap(record)], "actuators": [by_actuator(record)],
        "inputs": input_pictures(record), "ranking": [ranking(record)],
        "alternatives": [confusion(record)]}
    drawn = {name: [p for p in some if p is not None] for name, some in found.items()}
    return {name: some for name, some in drawn.items() if some}


def gap(record: DiagnosisRecord) -> BarPicture | None:
    """Return the residuals of one model after the other, down to the noise."""
    steps = [(s, value) for s in record.plot_data.steps
             if (value := number(s.rms_ratio)) is not None]
    held = record.gap
    ends = [number(held.before), number(held.after)]
    if not steps and None in ends:
        return None
    values = [v for _, v in steps] + [e for e in ends if e is not None]
    high = 1.25 * max([*values, 1.6])
    wide = svg.WIDTH - 56.0
    draw = Bars(log_scale(0.5, high, EDGE, wide), right=wide)
    for n, (step, value) in enumerate(steps):
        later = n > 0 and step.what == "effect"
        _gap_row(draw, _step_name(record, step), value, "r-after" if later else "r-before")
    if None not in ends:
        draw.y += 6.0
        draw.text(f"Check on {held.poses} poses that no fit has seen" if held.poses else
                  "Check on poses that no fit has seen", "strong")
        draw.y += 19.0
        _gap_row(draw, "geometry alone", ends[0] or 0.0, "r-before")
        if record.effects:
            _gap_row(draw, "geometry and what is named", ends[1] or 0.0, "r-after")
    draw.axis([(v, "1 (noise)" if v == 1.0 else words) for v, words in ratio_ticks(high)],
              "rms of the residuals over the noise")
    return BarPicture(
        "gap", "How the gap closes",
        "Upper bars: the rows that effects were searched in; each bar adds one thing to the "
        "model. The upright line is the noise alone: where nothing is missing, bars end there.",
        "; ".join(f"{_step_name(record, s)}: {sig(v)} times the noise" for s, v in steps) + ".",
        tuple(draw.parts), draw.y, note=f"{gap_closed(record)} {worst_block(record)}".strip())


def _gap_row(draw: Bars, label: str, value: float, kind: str) -> None:
    draw.text(label)
    draw.bar(value, kind, draw.y + 5.0, 9.0)
    draw.limit(1.0, draw.y + 4.5, draw.y + 18.0)
    draw.parts.append(svg.text(max(draw.at(value), draw.at(1.0)) + 6.0, draw.y + 13.0,
                               times(value), "start", "strong"))
    draw.y += 32.0


def times(ratio: float) -> str:
    """Return ``0.94 ×``, ``1.05 ×``, ``21.9 ×``."""
    return f"{sig(ratio, 3 if float(f'{ratio:.2f}') >= 1.0 else 2)} ×"


def _step_name(record: DiagnosisRecord, step: PlottedStep) -> str:
    if step.what == "start":
        return "machine as in its file, only frames fitted"
    if step.what == "geometry":
        return "+ geometry identified"
    return "+ " + name_of(record, step.kind, step.on)


def by_actuator(record: DiagnosisRecord) -> BarPicture | None:
    """Return the rms error of each joint before and after, beside what noise gives."""
    rows = [a for a in record.plot_data.actuators if number(a.rms_before) is not None]
    if not rows:
        return None
    units = {a.unit for a in rows}
    one = len(units) == 1
    after = bool(record.effects)
    largest = max(_parts(a)[0] for a in rows)
    factor, unit = finer(units.pop(), largest) if one else (1.0, "")
    table = [_scaled(a, factor, one) for a in rows]
    high = 1.06 * max([max(v) for v in table] + [1e-300])
    names = [a.name or "?" for a in rows]
    amounts = [f"{sig(v[0])} → {sig(v[1])}" if after else sig(v[0]) for v in table]
    amounts = [f"{words} {unit or '×'}" for words in amounts]
    name_room = min(max(map(width, names)) + 6.0, 110.0)
    value_room = max(width(words, True) for words in amounts)
    left, right = EDGE + name_room, svg.WIDTH - EDGE - value_room - 8.0
    draw = Bars(linear_scale(high, left, right), left, right)
    _actuator_legend(draw, after)
    for name, words, (before, now, noise) in zip(names, amounts, table, strict=True):
        draw.text(name, room=name_room)
        draw.bar(before, "r-before" if after else "r-after", draw.y - 11.0, 7.0)
        if after:
            draw.bar(now, "r-after", draw.y - 2.0, 7.0)
        draw.limit(noise, draw.y - 14.0, draw.y + 8.0)
        draw.text(words, "strong", svg.WIDTH - EDGE, "end", value_room)
        draw.y += 28.0
    draw.y -= 8.0
    shown = f"rms of the joint error ({unit})" if one else "rms of the joint error over the noise"
    draw.axis([(t, svg.label(t)) for t in svg.Axis(0.0, high).ticks(5)], shown)
    return BarPicture(
        "actuators", "Where it is: the error of each joint",
        "Joint errors that would explain the residuals, row by row; the upright lines are what "
        f"noise alone gives. {_reading(after)} {left_out(record)}".rstrip(),
        "; ".join(f"{name}: {sig(v[0])} before, {sig(v[1])} after, noise {sig(v[2])} "
                  f"{unit}".rstrip() for name, v in zip(names, table, strict=True)) + ".",
        tuple(draw.parts), draw.y)


def _reading(after: bool) -> str:
    if after:
        return "What is missing shows where the upper bar passes the line; the lower should not."
    return "What is missing shows where a bar passes its line."


def _parts(a: PlottedActuator) -> tuple[float, float, float]:
    before, after, noise = (number(v) or 0.0 for v in (a.rms_before, a.rms_after, a.noise))
    return before, after, noise


def _scaled(a: PlottedActuator, factor: float, one: bool) -> tuple[float, float, float]:
    """Return before, after, noise in the unit shown; over the noise where units differ."""
    before, after, noise = _parts(a)
    scale = factor if one else 1.0 / max(noise, svg.LEAST)
    return before * scale, after * scale, noise * scale


def _actuator_legend(draw: Bars, after: bool) -> None:
    marks = [("r-before", "geometry alone"), ("r-after", "with what is named")] if after else [
        ("r-after", "geometry alone")]
    x = EDGE
    for kind, words in marks:
        draw.parts.append(f'<rect class="{kind}" x="{svg.num(x)}" y="{svg.num(draw.y - 8)}" '
                          'width="22" height="7"/>')
        draw.parts.append(svg.text(x + 27.0, draw.y, words))
        x += 27.0 + width(words) + 14.0
    draw.parts.append(f'<path class="limit" d="M{svg.num(x + 3)} {svg.num(draw.y - 10)}v12"/>')
    draw.parts.append(svg.text(x + 10.0, draw.y, "noise"))
    draw.y += 27.0


LONG_ODDS = 150.0
"""Beyond these an alternative is in the set only for what it can imitate."""


def confusion(record: DiagnosisRecord) -> BarPicture | None:
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
    high = max([LONG_ODDS] + [min(o, 1e6) for _, pairs in groups for _, o in pairs])
    left = 2.0 * EDGE
    draw = Bars(log_scale(0.5, high, left, svg.WIDTH - 80.0), left, svg.WIDTH - 80.0)
    total = actuators(record)
    for name, pairs in groups:
        draw.text(name, "strong")
        draw.y += 17.0
        for other, value in pairs:
            draw.text("or " + shorter(other, total), x=left)
            draw.bar(value, "r-alternative", draw.y + 5.0, 8.0)
            words = f"{odds_to(value)} : 1"
            draw.parts.append(svg.text(draw.at(value) + 6.0, draw.y + 13.0, words, "start",
                                       "strong"))
            draw.y += 30.0
    draw.axis(ratio_ticks(high), "odds for the named effect against the alternative")
    file = record.next_measurements.file
    long = any(o > LONG_ODDS for _, pairs in groups for _, o in pairs)
    return BarPicture(
        "alternatives", "What these data cannot tell apart",
        "Odds from the fit and the number of parameters; a short bar: the data hardly prefer the "
        "named effect." + long * (" A long one: the alternative fits as well and has more "
                                  "parameters, which does not rule it out."),
        "; ".join(f"{n}: " + ", ".join(f"{odds_to(v)} to 1 against {a}" for a, v in pairs)
                  for n, pairs in groups) + ".", tuple(draw.parts), draw.y,
        note=f"Measurements that tell them apart are in {file}." if file else "")
