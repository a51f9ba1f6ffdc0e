"""The section about a comparison of two calibrations: what changed, and what it means."""

from __future__ import annotations

from collections.abc import Sequence

from ppmcal.io.results.comparison import (
    ComparisonRecord,
    ParameterDifference,
    platform_sentence,
    remainder_sentence,
    verdict_sentence,
)
from ppmcal.report import svg
from ppmcal.report.format import count, listed, number, probability, sig, to_sigma, typeset
from ppmcal.report.html import Cell, amount, dotted, paragraph, table, words
from ppmcal.report.records import ComparedCalibrations
from ppmcal.report.residual_figures import figure
from ppmcal.report.svg_bars import fitting

Z95 = 1.96
SHOWN, PLOTTED = 12, 40
ROW, NAMES, SMALL = 15.0, 150.0, 11.0 / 9.5
"""Height of a line, room for names, and how much more of the small letters goes in."""
STYLES = {"changed": "out", "possible": "before"}
KEYS = {"changed": "changed", "possible": "possible instead"}


def comparison_section(one: ComparedCalibrations) -> str:
    """Return everything about one comparison."""
    r = one.record
    drawing = differences(r.parameters)
    return "".join([
        "<h2>Comparison of two calibrations</h2>", paragraph(f"From {one.folder}.", "note"),
        paragraph(verdict(r), "big"), paragraph(typeset(platform_sentence(r))), _changes(r),
        f'<div class="plots">{drawing}</div>' if drawing else "", _likeliest(r.parameters)])


def verdict(r: ComparisonRecord) -> str:
    """Return whether the machine has changed, nothing where the JSON does not say."""
    return typeset(verdict_sentence(r))


def attention(r: ComparisonRecord) -> list[str]:
    """Return what the user must look at."""
    if r.verdict != "changed":
        return []
    names = [c.name or "?" for c in r.changes]
    return ["the machine has changed between the two calibrations: "
            + (listed(names) if names else "no single parameter explains it")]


def _changes(r: ComparisonRecord) -> str:
    """Return the changes that are named, and whether they explain all of it."""
    rows = []
    for c in r.changes:
        wide = None if c.sigma is None else Z95 * c.sigma
        rows.append([dotted(c.name), amount(c.value, to_sigma(c.value, c.sigma)),
                     amount(wide, f"± {sig(wide, 2)}"), words(c.unit),
                     amount(c.p_value, probability(c.p_value) or "–"),
                     words(listed(c.instead) or "nothing else", "wrap")])
    return table("The fewest parameters that explain the change",
                 ["parameter", "changed by", "95 %", "unit", "chance of noise alone",
                  "it could as well be"], rows) + paragraph(typeset(remainder_sentence(r)))


def _likeliest(rows: Sequence[ParameterDifference]) -> str:
    """Return the parameters likeliest to have changed, the others folded away."""
    heads = ["parameter", "old", "new", "new − old", "95 %", "unit", "chance of noise alone",
             "status"]
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
            words("" if p.status == "unchanged" else p.status,
                  "warn" if p.status == "changed" else "")]


def differences(rows: Sequence[ParameterDifference]) -> str:
    """Return new minus old of each parameter over its sigma, largest first, as a figure."""
    seen = [(z, p) for p in rows if (z := _ratio(p)) is not None]
    if not seen:
        return ""
    seen.sort(key=lambda s: (s[1].status not in STYLES, -abs(s[0])))
    shown = sorted(seen[:PLOTTED], key=lambda s: -abs(s[0]))
    height = svg.TOP + ROW * len(shown) + svg.BOTTOM
    ends = [e for z, _ in shown for e in (z - Z95, z + Z95)]
    frame = svg.Frame(svg.span([*ends, 0.0]), svg.Axis(0.0, float(len(shown))), left=NAMES,
                      height=height)
    parts = [svg.axes(frame, "(new − old) / sigma", "", y_ticks=False), _upright(frame)]
    for i, (z, p) in enumerate(shown):
        parts += _mark(frame, z, float(frame.py(len(shown) - i - 0.5)), p)
    title = "New minus old in units of sigma"
    drawing = svg.document(title, f"{len(shown)} parameters with 95 % bars.", parts,
                           height=height)
    less = f" The {len(shown)} largest of {len(seen)}." if len(shown) < len(seen) else ""
    return figure(drawing, f"{title}, with 95 % bars, sorted by size; diamonds and bold names: "
                  "changed. Sigma is what noise and tolerances make, so that parameters that "
                  f"trade with each other differ little each.{less}",
                  _key(shown))


def _key(shown: Sequence[tuple[float, ParameterDifference]]) -> str:
    """Return what the colours mean that are there."""
    there = {p.status for _, p in shown}
    keys = [(STYLES[s], name) for s, name in KEYS.items() if s in there]
    keys += [("after", "unchanged")] if there - set(STYLES) else []
    return " ".join(f'<i class="key {kind}"></i>{name}' for kind, name in keys)


def _mark(frame: svg.Frame, z: float, y: float, p: ParameterDifference) -> list[str]:
    """Return name, bar and mark of one parameter at the height ``y``."""
    status = p.status
    kind = STYLES.get(status, "after")
    low, middle, high = (float(frame.px(v)) for v in (z - Z95, z, z + Z95))
    bold = "small strong" if status == "changed" else "small"
    name = fitting(frame.left - 6.0, y + 3.5, p.name or "?", (frame.left - 8.0) * SMALL,
                   "end", bold)
    bar = f'<path class="stroke {kind}" d="M{svg.num(low)} {svg.num(y)}H{svg.num(high)}"/>'
    if status == "changed":
        return [name, bar, f'<path class="r-changed" d="M{svg.num(middle - 4.5)} {svg.num(y)}'
                           'l4.5-4.5 4.5 4.5-4.5 4.5z"/>']
    return [name, bar, f'<path class="dot {kind}" d="M{svg.num(middle)} {svg.num(y)}h0"/>']


def _upright(frame: svg.Frame) -> str:
    """Return the line of no difference."""
    return (f'<path class="mark" d="M{svg.num(float(frame.px(0.0)))} {svg.num(svg.TOP)}'
            f'V{svg.num(frame.height - svg.BOTTOM)}"/>')


def _ratio(p: ParameterDifference) -> float | None:
    """Return the difference in sigmas, None where it is not known or beyond reason."""
    if p.difference is None or p.sigma is None or not p.sigma > 0.0:
        return None
    return number(p.difference / p.sigma)
