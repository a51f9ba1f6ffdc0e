"""Hypotheses by strength of evidence, with the thresholds that they have to pass."""

from __future__ import annotations

import math

from ppmcal.diagnosis.plot_data import Ranked
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import name_of
from ppmcal.plotting.bars import Chart, Row
from ppmcal.plotting.canvas import Drawing
from ppmcal.report.diagnosis_format import chance, power, scientific
from ppmcal.report.format import number

STATUS = {"named": "named", "alternative": "alternative", "explained": "explained"}
UNSAID = ("named", "not needed", "significant")
"""Statuses that bars, bold names and lines show already."""
LEGEND = (("named", "named"), ("more", "with the other named ones in the model"),
          ("alternative", "cannot be told from it"),
          ("explained", "explained by what is named"), ("other", "not named"))
TICKS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 150.0, 200.0, 300.0)


def ranking(record: DiagnosisRecord) -> Drawing | None:
    """Return how unlikely noise alone would show any hypothesis as strongly as each is shown."""
    rows = [(r, -value) for r in record.plot_data.ranking if (value := number(
        r.log10_p if r.log10_p_alone is None else r.log10_p_alone)) is not None]
    if not rows:
        return None
    limits = _limits(record)
    bars = [_row(record, r, value, limits) for r, value in rows]
    there = {kind for row in bars for _, kind in row.bars}
    high = 1.04 * max([v for row in bars for v, _ in row.bars] + [v for _, v, _ in limits] + [4.0])
    best = ", ".join(_hypothesis(record, r) for r, _ in rows[:3])
    return Chart(bars, "root", 0.0, high, "p-value before anything was named (stronger: right)",
                 [(v, power(-v)) for v in TICKS if v <= high],
                 [*(e for e in LEGEND if e[0] in there), *((k, words) for words, _, k in limits)]
                 ).drawing(
        "What could be missing, by strength of evidence", _caption(record, rows, limits),
        f"The {len(rows)} strongest hypotheses; first: {best}.")


def _row(record: DiagnosisRecord, entry: Ranked, value: float,
         limits: list[tuple[str, float, str]]) -> Row:
    """Return one hypothesis with its p-value and its bars."""
    kind, then = STATUS.get(entry.status, "other"), _given_others(entry, value)
    p = _p(value) if then is None else f"{_p(then)} ({_p(value)} alone)"
    more = () if then is None else ((max(then, value), "more"),)
    return Row(_hypothesis(record, entry), (*more, (value, kind)),
               p if entry.status in UNSAID else f"{p} {entry.status}".rstrip(),
               tuple((place, style) for _, place, style in limits), kind == "named")


def _p(value: float) -> str:
    return chance(-value).removeprefix("p = ")


def _given_others(entry: Ranked, value: float) -> float | None:
    """Return -log10 p of a named one given the others, None where it reads the same."""
    log10 = number(entry.log10_p)
    if entry.status != "named" or log10 is None:
        return None
    return -log10 if _p(-log10) != _p(value) else None


def _caption(record: DiagnosisRecord, rows: list[tuple[Ranked, float]],
             limits: list[tuple[str, float, str]]) -> str:
    """Return what the bars and lines say, and why what passes may not be named."""
    out = "Bars: how rarely noise alone looks so much like anything that was tried."
    if limits:
        out += " Beyond the lines that is rare enough"
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


def _hypothesis(record: DiagnosisRecord, entry: Ranked) -> str:
    name = name_of(record, entry.kind, entry.on)
    return f"{name}, {entry.form}" if entry.form else name


def _limits(record: DiagnosisRecord) -> list[tuple[str, float, str]]:
    """Return (words, -log10 p, kind of line) of the thresholds."""
    out = []
    for p, words, kind in ((record.noise.detect_p, "beyond it something is missing", "dotted"),
                           (record.noise.name_p, "beyond it an effect may be named", "limit")):
        if p is not None and 0.0 < p < 1.0:
            out.append((f"{words}: p < {scientific(p)}", -math.log10(p), kind))
    return out
