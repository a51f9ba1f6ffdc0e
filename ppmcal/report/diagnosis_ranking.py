"""Hypotheses by strength of evidence, with the thresholds that they have to pass."""

from __future__ import annotations

import math

from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_plots import PlottedHypothesis
from ppmcal.io.results.diagnosis_wording import name_of
from ppmcal.report import svg
from ppmcal.report.diagnosis_format import chance, power, scientific
from ppmcal.report.format import number
from ppmcal.report.svg_bars import EDGE, BarPicture, Bars, width

STATUS = {"named": "named", "alternative": "alternative", "explained": "explained"}
UNSAID = ("named", "not needed", "significant")
"""Statuses that bars, bold names and lines show already."""
THICK = {"named": 8.0, "more": 8.0, "alternative": 8.0, "explained": 5.0, "other": 2.5}
LEGEND = (("named", "named"), ("more", "with the other named ones in the model"),
          ("alternative", "cannot be told from it"),
          ("explained", "explained by what is named"), ("other", "not named"))
TICKS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 150.0, 200.0, 300.0)


def ranking(record: DiagnosisRecord) -> BarPicture | None:
    """Return how unlikely noise alone would show each hypothesis as strongly as the data do."""
    rows = [(r, -value) for r in record.plot_data.ranking if (value := number(
        r.log10_p if r.log10_p_alone is None else r.log10_p_alone)) is not None]
    if not rows:
        return None
    limits = _limits(record)
    later = [_given_others(r, v) for r, v in rows]
    high = 1.04 * max([v for _, v in rows] + [v for v in later if v is not None]
                      + [v for _, v, _ in limits] + [4.0])

    def at(value: float) -> float:
        return EDGE + math.sqrt(min(max(value, 0.0) / high, 1.0)) * (svg.WIDTH - 2.0 * EDGE)

    draw = Bars(at)
    more = {"more"} if any(v is not None for v in later) else set()
    _legend(draw, {_class_of(r) for r, _ in rows} | more, limits)
    for (r, value), then in zip(rows, later, strict=True):
        _row(draw, record, r, value, then)
        for _, place, line in limits:
            draw.limit(place, draw.y + 3.5, draw.y + 13.5, line)
        draw.y += 27.0
    draw.y -= 8.0
    draw.axis([(v, power(-v)) for v in TICKS if v <= high],
              "p-value before anything was named (stronger: right)")
    best = ", ".join(_hypothesis(record, r) for r, _ in rows[:3])
    return BarPicture(
        "ranking", "What could be missing, by strength of evidence", _caption(record, rows, limits),
        f"The {len(rows)} strongest hypotheses; first: {best}.", tuple(draw.parts), draw.y)


def _row(draw: Bars, record: DiagnosisRecord, entry: PlottedHypothesis, value: float,
         then: float | None) -> None:
    """Write one hypothesis with its p-value and draw its bar below."""
    kind, status = _class_of(entry), entry.status
    p = _p(value) if then is None else f"{_p(then)} ({_p(value)} alone)"
    end = p if status in UNSAID else f"{p} {status}".rstrip()
    draw.text(end, "", svg.WIDTH - EDGE, "end", width(end))
    draw.text(_hypothesis(record, entry), "strong" if kind == "named" else "ink",
              room=svg.WIDTH - 2.0 * EDGE - width(end) - 6.0)
    top = draw.y + 4.0 + (8.0 - THICK[kind]) / 2.0
    if then is not None:
        draw.bar(max(then, value), "r-more", top, THICK["more"])
    draw.bar(value, f"r-{kind}", top, THICK[kind])


def _p(value: float) -> str:
    return chance(-value).removeprefix("p = ")


def _given_others(entry: PlottedHypothesis, value: float) -> float | None:
    """Return -log10 p of a named one given the others, None where it reads the same."""
    log10 = number(entry.log10_p)
    if entry.status != "named" or log10 is None:
        return None
    return -log10 if _p(-log10) != _p(value) else None


def _caption(record: DiagnosisRecord, rows: list[tuple[PlottedHypothesis, float]],
             limits: list[tuple[str, float, str]]) -> str:
    """Return what the bars and lines say, and why what passes may not be named."""
    out = "Bars: how rarely noise alone looks so much like this effect."
    if limits:
        out += " The lines allow for the many hypotheses that were tried"
        passing = max(v for _, v in rows) > min(v for _, v, _ in limits)
        if record.effects:
            out += "; what is named explains the others that pass"
        elif not passing:
            out += "; nothing passes them"
        elif record.verdict == "unnamed":
            out += ("; what passes imitates something that has no name here: none explains "
                    "the residuals as far as the noise")
        else:
            out += "; what passes is too weak to be named"
        out += "."
    return out


def _class_of(entry: PlottedHypothesis) -> str:
    return STATUS.get(entry.status, "other")


def _hypothesis(record: DiagnosisRecord, entry: PlottedHypothesis) -> str:
    name = name_of(record, entry.kind, entry.on)
    return f"{name}, {entry.form}" if entry.form else name


def _limits(record: DiagnosisRecord) -> list[tuple[str, float, str]]:
    """Return (words, -log10 p, kind of line) of the thresholds."""
    out = []
    for p, words, kind in ((record.noise.detect_p, "beyond it something is missing", "dotted"),
                           (record.noise.name_p, "beyond it an effect may be named", "")):
        if p is not None and 0.0 < p < 1.0:
            out.append((f"{words}: p < {scientific(p)}", -math.log10(p), kind))
    return out


def _legend(draw: Bars, kinds: set[str], limits: list[tuple[str, float, str]]) -> None:
    x = EDGE
    for kind, words in (e for e in LEGEND if e[0] in kinds):
        if x > EDGE and x + 27.0 + width(words) > svg.WIDTH - EDGE:
            x, draw.y = EDGE, draw.y + 15.0
        top = draw.y - 8.0 + (8.0 - THICK[kind]) / 2.0
        draw.parts.append(f'<rect class="r-{kind}" x="{svg.num(x)}" y="{svg.num(top)}" '
                          f'width="22" height="{svg.num(THICK[kind])}"/>')
        draw.parts.append(svg.text(x + 27.0, draw.y, words))
        x += 27.0 + width(words) + 12.0
    draw.y += 15.0
    for words, _, kind in limits:
        draw.parts.append(f'<path class="limit {kind}" d="M{svg.num(EDGE + 11)} '
                          f'{svg.num(draw.y - 9)}v11"/>')
        draw.parts.append(svg.text(EDGE + 27.0, draw.y, words))
        draw.y += 15.0
    draw.y += 6.0
