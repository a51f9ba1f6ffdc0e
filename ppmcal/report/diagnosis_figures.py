"""The story of a diagnosis in pictures, drawn from diagnosis.json alone.

Every function takes the record and returns a :class:`Picture`, or None where the record (of an
older version, or cut down) does not hold what it shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ppmcal.report import svg
from ppmcal.report.bars import (
    EDGE,
    LETTER,
    Bars,
    Picture,
    linear_scale,
    log_scale,
    ratio_ticks,
)
from ppmcal.report.diagnosis_inputs import input_pictures
from ppmcal.report.diagnosis_words import (
    actuators,
    chance,
    effect_name,
    finer,
    gap_closed,
    power,
    where,
)
from ppmcal.report.numbers import number, sig, whole

Record = Mapping[str, Any]
STATUS = {"named": "named", "alternative": "alternative", "explained": "explained",
          "significant": "other"}
THICK = {"named": 8.0, "alternative": 8.0, "explained": 5.0, "other": 2.5}
LEGEND = (("named", "named"), ("alternative", "alternative to it"),
          ("explained", "explained by what is named"), ("other", "any other"))


def pictures(record: Record) -> dict[str, list[Picture]]:
    """Return file name without ending -> pictures on that sheet."""
    one = {"gap": gap(record), "ranking": ranking(record), "actuators": by_actuator(record)}
    out = {name: [p] for name, p in one.items() if p is not None}
    found = input_pictures(record)
    return {**out, "inputs": found} if found else out


def story(record: Record, part: str) -> list[Record]:
    """Return one list of the story, [] where there is none."""
    found = record.get("story")
    return [e for e in (found or {}).get(part) or [] if isinstance(e, Mapping)]


def gap(record: Record) -> Picture | None:
    """Return the residuals of one model after the other, down to the noise."""
    steps = [(s, value) for s in story(record, "steps")
             if (value := number(s.get("rms_ratio"))) is not None]
    held = record.get("gap") or {}
    ends = [number(held.get("before")), number(held.get("after"))]
    if not steps and None in ends:
        return None
    values = [v for _, v in steps] + [e for e in ends if e is not None]
    high = 1.25 * max([*values, 1.6])
    wide = svg.WIDTH - 56.0
    draw = Bars(log_scale(0.5, high, EDGE, wide), right=wide)
    for n, (step, value) in enumerate(steps):
        later = n > 0 and step.get("what") == "effect"
        _gap_row(draw, _step_name(record, step), value, "r-after" if later else "r-before")
    if None not in ends:
        draw.y += 6.0
        poses = number(held.get("poses"))
        draw.text(f"Check on {poses:.0f} poses that no fit has seen" if poses else
                  "Check on poses that no fit has seen", "strong")
        draw.y += 19.0
        _gap_row(draw, "geometry alone", ends[0] or 0.0, "r-before")
        if record.get("effects"):
            _gap_row(draw, "geometry and what is named", ends[1] or 0.0, "r-after")
    draw.axis(ratio_ticks(high), "rms of the residuals over the noise; line: the noise alone, 1")
    rows = number((record.get("fit") or {}).get("rows"))
    used = f" ({whole(int(rows))} rows in all)" if rows else ""
    return Picture(
        "gap", "How the gap closes",
        f"Upper bars: the rows that effects were searched in{used}; each bar adds one thing to "
        f"the model. {gap_closed(record)}".strip(),
        "; ".join(f"{_step_name(record, s)}: {sig(v)} times the noise" for s, v in steps) + ".",
        tuple(draw.parts), draw.y)


def _gap_row(draw: Bars, label: str, value: float, kind: str) -> None:
    draw.text(label)
    draw.bar(value, kind, draw.y + 5.0, 9.0)
    draw.limit(1.0, draw.y + 2.0, draw.y + 17.0)
    draw.parts.append(svg.text(max(draw.at(value), draw.at(1.0)) + 6.0, draw.y + 13.0,
                               f"{sig(value)} ×", "start", "strong"))
    draw.y += 32.0


def _step_name(record: Record, step: Record) -> str:
    what = step.get("what")
    if what == "start":
        return "machine as in its file, only frames fitted"
    if what == "geometry":
        return "+ geometry identified"
    return "+ " + effect_name(record, step)


def ranking(record: Record) -> Picture | None:
    """Return how unlikely noise alone would show each hypothesis as strongly as the data do."""
    rows = [(r, -value) for r in story(record, "ranking")
            if (value := number(r.get("log10_p"))) is not None]
    if not rows:
        return None
    limits = _limits(record)
    high = 1.04 * max([v for _, v in rows] + [v for _, v, _ in limits] + [4.0])

    def at(value: float) -> float:
        return EDGE + math.sqrt(min(max(value, 0.0) / high, 1.0)) * (svg.WIDTH - 2.0 * EDGE)

    draw = Bars(at)
    _ranking_legend(draw, {_class_of(r) for r, _ in rows}, limits)
    for r, value in rows:
        kind = _class_of(r)
        end = f"{chance(-value)}  {r.get('status') or ''}".rstrip()
        end_room = LETTER * len(end)
        draw.text(end, "", svg.WIDTH - EDGE, "end", end_room + LETTER)
        draw.text(_hypothesis(record, r), "strong" if kind == "named" else "ink",
                  room=svg.WIDTH - 2.0 * EDGE - end_room - 10.0)
        draw.bar(value, f"r-{kind}", draw.y + 4.0 + (8.0 - THICK[kind]) / 2.0, THICK[kind])
        for _, place, line in limits:
            draw.limit(place, draw.y + 2.5, draw.y + 13.5, line)
        draw.y += 27.0
    draw.y -= 8.0
    draw.axis([(v, power(-v)) for v in (1.0, 5.0, 20.0, 50.0, 100.0, 150.0, 200.0, 300.0)
               if v <= high], "p of noise alone, before anything was named (unlikely: right)")
    best = ", ".join(_hypothesis(record, r) for r, _ in rows[:3])
    return Picture(
        "ranking", "What could be missing, by strength of evidence",
        "Bars: how unlikely it is that noise alone looks as much like this effect. Several "
        "bars pass the lines where they show the same thing; what is named explains the others.",
        f"The {len(rows)} strongest hypotheses; first: {best}.", tuple(draw.parts), draw.y)


def _class_of(entry: Record) -> str:
    return STATUS.get(str(entry.get("status") or ""), "other")


def _hypothesis(record: Record, entry: Record) -> str:
    name = effect_name(record, entry)
    form = str(entry.get("form") or "")
    return f"{name}, {form}" if form else name


def _limits(record: Record) -> list[tuple[str, float, str]]:
    """Return (words, -log10 p, kind of line) of the thresholds."""
    noise = record.get("noise") or {}
    out = []
    for key, words, kind in (("detect_p", "something is missing", "dotted"),
                             ("name_p", "may be named", "")):
        p = number(noise.get(key))
        if p is not None and 0.0 < p < 1.0:
            out.append((f"{words}: p < {sig(p, 2)}", -math.log10(p), kind))
    return out


def _ranking_legend(draw: Bars, kinds: set[str], limits: list[tuple[str, float, str]]) -> None:
    x = EDGE
    for kind, words in (e for e in LEGEND if e[0] in kinds):
        room = 27.0 + LETTER * len(words) + 8.0
        if x + room > svg.WIDTH + 8.0:
            x, draw.y = EDGE, draw.y + 15.0
        top = draw.y - 8.0 + (8.0 - THICK[kind]) / 2.0
        draw.parts.append(f'<rect class="r-{kind}" x="{svg.num(x)}" y="{svg.num(top)}" '
                          f'width="22" height="{svg.num(THICK[kind])}"/>')
        draw.parts.append(svg.text(x + 27.0, draw.y, words))
        x += room
    draw.y += 15.0
    for n, (words, _, kind) in enumerate(limits):
        x = EDGE + n * 190.0
        draw.parts.append(f'<path class="limit {kind}" d="M{svg.num(x + 4)} '
                          f'{svg.num(draw.y - 9)}v11"/>')
        draw.parts.append(svg.text(x + 12.0, draw.y, words))
    draw.y += 21.0 if limits else 6.0


def by_actuator(record: Record) -> Picture | None:
    """Return the rms error of each joint before and after, beside what noise gives."""
    rows = [e for e in story(record, "actuators") if number(e.get("rms_before")) is not None]
    if not rows:
        return None
    units = {str(e.get("unit") or "") for e in rows}
    one = len(units) == 1
    after = bool(record.get("effects"))
    largest = max(_parts(e)[0] for e in rows)
    factor, unit = finer(units.pop(), largest) if one else (1.0, "")
    table = [_scaled(e, factor, one) for e in rows]
    high = 1.06 * max([max(v) for v in table] + [1e-300])
    name_room = min(LETTER * max(len(str(e.get("name") or "")) for e in rows) + 6.0, 110.0)
    left, right = EDGE + name_room, svg.WIDTH - 108.0
    draw = Bars(linear_scale(high, left, right), left, right)
    _actuator_legend(draw, after)
    for entry, (before, now, noise) in zip(rows, table, strict=True):
        draw.text(str(entry.get("name") or "?"), room=name_room)
        draw.bar(before, "r-before" if after else "r-after", draw.y - 11.0, 7.0)
        if after:
            draw.bar(now, "r-after", draw.y - 2.0, 7.0)
        draw.limit(noise, draw.y - 14.0, draw.y + 8.0)
        words = f"{sig(before)} → {sig(now)}" if after else sig(before)
        draw.text(words, "strong", svg.WIDTH - EDGE, "end", 108.0)
        draw.y += 28.0
    draw.y -= 8.0
    shown = f"rms of the joint error ({unit})" if one else "rms of the joint error over the noise"
    draw.axis([(t, svg.label(t)) for t in svg.Axis(0.0, high).ticks(5)], shown)
    return Picture(
        "actuators", "Where it is: the error of each joint",
        "Joint errors that would explain the residuals, row by row; the upright line is what "
        "noise alone gives. A joint far beyond its line before and at it after has been mended.",
        "; ".join(f"{e.get('name')}: {sig(v[0])} before, {sig(v[1])} after, noise {sig(v[2])} "
                  f"{unit}".rstrip() for e, v in zip(rows, table, strict=True)) + ".",
        tuple(draw.parts), draw.y)


def _parts(entry: Record) -> tuple[float, float, float]:
    before, after, noise = (number(entry.get(k)) or 0.0
                            for k in ("rms_before", "rms_after", "noise"))
    return before, after, noise


def _scaled(entry: Record, factor: float, one: bool) -> tuple[float, float, float]:
    """Return before, after, noise in the unit shown; over the noise where units differ."""
    before, after, noise = _parts(entry)
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
        x += 27.0 + LETTER * len(words) + 8.0
    draw.parts.append(f'<path class="limit" d="M{svg.num(x + 3)} {svg.num(draw.y - 10)}v12"/>')
    draw.parts.append(svg.text(x + 10.0, draw.y, "noise"))
    draw.y += 27.0


def confusion(record: Record) -> Picture | None:
    """Return for each named effect what could take its place, and how likely that is."""
    groups = []
    for e in record.get("effects") or []:
        names = e.get("alternatives_on") or e.get("alternatives") or []
        odds = [number(o) for o in e.get("odds") or []]
        pairs = [(str(n), o) for n, o in zip(names, odds, strict=False) if o is not None]
        if pairs:
            groups.append((effect_name(record, e), sorted(pairs, key=lambda p: p[1])))
    if not groups:
        return None
    high = max([150.0] + [min(o, 1e6) for _, pairs in groups for _, o in pairs])
    left = 2.0 * EDGE
    draw = Bars(log_scale(0.5, high, left, svg.WIDTH - 80.0), left, svg.WIDTH - 80.0)
    total = actuators(record)
    for name, pairs in groups:
        draw.text(name, "strong")
        draw.y += 17.0
        for other, value in pairs:
            draw.text("or " + _shorter(other, total), x=left)
            draw.bar(value, "r-alternative", draw.y + 5.0, 8.0)
            words = f"{sig(value, 2)} : 1" if value < 1e6 else "> 10⁶ : 1"
            draw.parts.append(svg.text(draw.at(value) + 6.0, draw.y + 13.0, words, "start",
                                       "strong"))
            draw.y += 30.0
    draw.axis(ratio_ticks(high), "odds for the named effect against the alternative")
    return Picture(
        "alternatives", "What these data cannot tell apart",
        "Odds by what fit and number of parameters say; a short bar means that the data hardly "
        "prefer the named effect.",
        "; ".join(f"{n}: " + ", ".join(f"{sig(v, 2)} to 1 against {a}" for a, v in pairs)
                  for n, pairs in groups) + ".", tuple(draw.parts), draw.y)


def _shorter(label: str, total: int) -> str:
    """Return a label in which a list of all actuators is one word."""
    kind, _, place = label.partition(" on ")
    names = place.split(", ") if place else []
    return f"{kind} on {where(names, total)}" if names else kind
