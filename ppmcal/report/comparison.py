"""The section about a comparison of two calibrations: what changed, and what it means."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ppmcal.io.results.comparison import (
    ComparisonRecord,
    ParameterDifference,
    apart_sentence,
    noise_sentence,
    platform_sentence,
    remainder_sentence,
    verdict_sentence,
)
from ppmcal.plotting.canvas import SMALL, Canvas, Drawing
from ppmcal.plotting.plot import BOTTOM, TOP, Axis, dots, marks, plot, span, strokes, zero
from ppmcal.report.format import count, listed, number, probability, sig, to_sigma, typeset
from ppmcal.report.html import Cell, amount, dotted, figures, paragraph, table, words
from ppmcal.report.records import ComparedCalibrations
from ppmcal.report.section import Section

Z95 = 1.96
SHOWN, PLOTTED = 12, 40
ROW, NAMES = 15.0, 150.0
"""Height of a line and room for names, points."""
STYLES = {"changed": "out", "possible": "before"}
KEYS = {"changed": "changed", "possible": "possible instead"}


def comparison_section(one: ComparedCalibrations) -> Section:
    """Return everything about one comparison."""
    r = one.record
    return Section("Comparison of two calibrations", "".join([
        paragraph(verdict(r), "big"), paragraph(typeset(platform_sentence(r))), _changes(r),
        figures([differences(r.parameters)]), _likeliest(r.parameters)]), one.folder)


def verdict(r: ComparisonRecord) -> str:
    """Return whether the machine has changed, nothing where the JSON does not say."""
    return typeset(verdict_sentence(r))


def attention(r: ComparisonRecord) -> list[str]:
    """Return what the user must look at."""
    if r.verdict != "changed":
        return []
    names = [c.name or "?" for c in r.changes]
    return ["the machine has changed between the two calibrations: "
            + (listed(names) if names else "nothing by itself explains it")]


def _changes(r: ComparisonRecord) -> str:
    """Return the changes that are named, and whether they explain all of it."""
    rows = []
    for c in r.changes:
        for i, n in enumerate(c.numbers):
            wide = None if n.sigma is None else Z95 * n.sigma
            name = f"{c.name}: {n.name}" if n.name else c.name
            rows.append([dotted(name), amount(n.value, to_sigma(n.value, n.sigma)),
                         amount(wide, f"± {sig(wide, 2)}"), words(n.unit),
                         amount(c.p_value, probability(c.p_value) or "–"),
                         words("" if i else listed(c.instead) or "nothing else", "wrap")])
    said = [remainder_sentence(r), apart_sentence(r), noise_sentence(r)]
    return table("The likeliest changes that explain it",
                 ["what", "changed by", "95 %", "unit", "chance of noise alone",
                  "as likely"], rows) + "".join(paragraph(typeset(s)) for s in said if s)


def _likeliest(rows: Sequence[ParameterDifference]) -> str:
    """Return the parameters likeliest to have changed, the others folded away."""
    heads = ["parameter", "old", "new", "new − old", "95 %", "unit", "chance of noise alone",
             "explained", "status"]
    first = sorted(rows, key=lambda p: 2.0 if p.p_alone is None else p.p_alone)
    body = [_row(p) for p in first]
    note = ("Chance: how often noise would ask as much for a change of this parameter, if it were "
            "the only one; changes of one show in others that act alike.")
    many = len(body) > SHOWN
    out = table(f"The {SHOWN} likeliest to have changed" if many else
                "All parameters, the likeliest to have changed first", heads, body[:SHOWN],
                sort=True)
    if many:
        out += (f"<details><summary>{count(len(body) - SHOWN, 'further parameter')}</summary>"
                + table("", heads, body[SHOWN:], sort=True) + "</details>")
    return out + paragraph(note, "note") if out else ""


def _row(p: ParameterDifference) -> list[Cell]:
    wide = None if p.sigma is None else Z95 * p.sigma
    return [dotted(p.name), amount(p.old, to_sigma(p.old, p.sigma)),
            amount(p.new, to_sigma(p.new, p.sigma)),
            amount(p.difference, to_sigma(p.difference, p.sigma)),
            amount(wide, f"± {sig(wide, 2)}"), words(p.unit),
            amount(p.p_alone, probability(p.p_alone) or "–"),
            amount(p.explained, to_sigma(p.explained, p.sigma) if p.explained else ""),
            words("" if p.status == "unchanged" else p.status,
                  "warn" if p.status == "changed" else "")]


def differences(rows: Sequence[ParameterDifference]) -> Drawing | None:
    """Return new minus old of each parameter over its sigma, largest first."""
    seen = [(z, p) for p in rows if (z := _ratio(p)) is not None]
    if not seen:
        return None
    seen.sort(key=lambda s: (s[1].status not in STYLES, -abs(s[0])))
    shown = sorted(seen[:PLOTTED], key=lambda s: -abs(s[0]))
    less = f" The {len(shown)} largest of {len(seen)}." if len(shown) < len(seen) else ""
    return Drawing(
        "New minus old in units of sigma",
        "With 95 % bars, sorted by size; diamonds and bold names: changed. Sigma is what noise "
        "and tolerances make, so that parameters that trade with each other differ little "
        f"each.{less}", f"{len(shown)} parameters with 95 % bars.", partial(_draw, shown=shown),
        TOP + ROW * len(shown) + BOTTOM, _key(shown))


def _key(shown: Sequence[tuple[float, ParameterDifference]]) -> tuple[tuple[str, str], ...]:
    """Return what the colours mean that are there."""
    there = {p.status for _, p in shown}
    keys = [(STYLES[s], name) for s, name in KEYS.items() if s in there]
    return (*keys, *([("after", "unchanged")] if there - set(STYLES) else []))


def _draw(canvas: Canvas, shown: Sequence[tuple[float, ParameterDifference]]) -> None:
    """Draw a name, a bar and a mark for each parameter, from the top down."""
    count, layers = len(shown), [zero(upright=True)]
    for kind in ("after", "before", "out"):
        mine = [(z, count - i - 0.5) for i, (z, p) in enumerate(shown)
                if STYLES.get(p.status, "after") == kind]
        if mine:
            z, y = np.array(mine).T
            layers += [strokes(y, z - Z95, z + Z95, kind, flat=True),
                       marks(z, y, "out", "D", 5.6) if kind == "out" else dots(z, y, kind)]
    for i, (_, p) in enumerate(shown):
        canvas.text(NAMES - 6.0, TOP + ROW * (i + 0.5) + 3.5, p.name or "?", room=NAMES - 8.0,
                    bold=p.status == "changed", ha="right", size=SMALL)
    x = span([e for z, _ in shown for e in (z - Z95, z + Z95, 0.0)])
    plot(canvas, x, Axis(0.0, float(count)), ("(new − old) / sigma", ""), layers, NAMES,
         TOP + ROW * count + BOTTOM, y_ticks=False)


def _ratio(p: ParameterDifference) -> float | None:
    """Return the difference in sigmas, None where it is not known or beyond reason."""
    if p.difference is None or p.sigma is None or not p.sigma > 0.0:
        return None
    return number(p.difference / p.sigma)
