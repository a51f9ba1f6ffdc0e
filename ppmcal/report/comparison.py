"""The section about a comparison of two calibrations: what changed, and what it means."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.io.json import NUMBER, TEXT
from ppmcal.report import svg
from ppmcal.report.format import count, exact, listed, number, probability, sig, to_sigma, with_unit
from ppmcal.report.html import amount, dotted, paragraph, table, words
from ppmcal.report.records import Columns, Other
from ppmcal.report.residual_figures import figure
from ppmcal.report.svg_bars import fitting

Record = Mapping[str, Any]

_MOVED = {"unit": TEXT, "*": NUMBER}
COMPARISON = {
    "name": TEXT, "verdict": TEXT,
    **dict.fromkeys(("chi2", "degrees", "p_value", "p_left"), NUMBER),
    "changes": [{"name": TEXT, "unit": TEXT, "instead": [TEXT], "*": NUMBER}],
    "platform": {"position": _MOVED, "rotation": _MOVED, "poses": NUMBER},
    "parameters": [{"name": TEXT, "unit": TEXT, "status": TEXT, "*": NUMBER}],
    "findings": [None], "provenance": {"inputs": {"*": TEXT}},
}
"""Shape of comparison.json."""
WORDS = frozenset({"name", "unit", "status"})
"""Columns of compare.csv that are words; the others are numbers."""
Z95 = 1.96
LEFT = 0.01
"""What is left is told where chance would leave as much this rarely."""
SHOWN, DRAWN = 12, 40
ROW, NAMES, SMALL = 15.0, 150.0, 11.0 / 9.5
"""Height of a line, room for names, and how much more of the small letters goes in."""
STYLES = {"changed": "out", "possible": "before"}
KEYS = {"changed": "changed", "possible": "possible instead"}


def comparison_section(one: Other) -> str:
    """Return everything about one comparison."""
    r = one.record
    rows = parameters(one)
    drawing = differences(rows)
    return "".join([
        "<h2>Comparison of two calibrations</h2>", paragraph(f"From {one.folder}.", "note"),
        paragraph(verdict(r), "big"), paragraph(platform(r)), _changes(r),
        f'<div class="plots">{drawing}</div>' if drawing else "", _likeliest(rows)])


def parameters(one: Other) -> list[Record]:
    """Return the parameters of the JSON, else of compare.csv."""
    own = one.record.get("parameters")
    return list(own) if own else _rows(one.table)


def verdict(r: Record) -> str:
    """Return whether the machine has changed, nothing where the JSON does not say."""
    what = {"changed": "the machine has changed", "unchanged": "nothing has changed"}.get(
        str(r.get("verdict")))
    if not what:
        return ""
    size = r.get("parameters") or []
    about = f"{r.get('name') or 'Comparison'}: {count(len(size), 'parameter')}; {what}"
    if number(r.get("chi2")) is None or number(r.get("degrees")) is None:
        return f"{about}."
    return (f"{about} (χ² {sig(r['chi2'], 4)} of {exact(r['degrees'])} degrees of freedom, "
            f"{probability(r.get('p_value'))}".rstrip(", ") + ").")


def attention(r: Record) -> list[str]:
    """Return what the user must look at."""
    if r.get("verdict") != "changed":
        return []
    names = [str(c.get("name") or "?") for c in r.get("changes") or ()]
    return ["the machine has changed between the two calibrations: "
            + (listed(names) if names else "no single parameter explains it")]


def platform(r: Record) -> str:
    """Return what the change means at the platform."""
    moved = r.get("platform") or {}
    position, rotation = moved.get("position") or {}, moved.get("rotation") or {}
    if number(position.get("rms")) is None:
        return ""
    unit, turn = str(position.get("unit") or ""), ""
    if (number(rotation.get("rms")) or 0.0) > 0.0:
        turn = f", {with_unit(rotation['rms'], str(rotation.get('unit') or ''))} rms"
    poses = number(moved.get("poses"))
    over = f", over {poses:.0f} poses of the volume measured before" if poses else ""
    return (f"At the same joints the platform is {with_unit(position['rms'], unit)} rms and "
            f"{with_unit(position.get('max'), unit)} at most from where it was{turn}{over}.")


def _changes(r: Record) -> str:
    """Return the changes that are named, and whether they explain all of it."""
    rows = []
    for c in r.get("changes") or ():
        sigma = number(c.get("sigma"))
        wide = None if sigma is None else Z95 * sigma
        instead = [str(n) for n in c.get("instead") or ()]
        rows.append([dotted(c.get("name")),
                     amount(c.get("value"), to_sigma(c.get("value"), sigma)),
                     amount(wide, f"± {sig(wide, 2)}"), words(c.get("unit")),
                     amount(c.get("p_value"), probability(c.get("p_value")) or "–"),
                     words(listed(instead) or "nothing else", "wrap")])
    text, left = "", number(r.get("p_left"))
    if not rows and r.get("verdict") == "changed":
        text = "No single parameter explains it."
    elif rows and left is not None and left < LEFT:
        text = f"That does not explain all of it ({probability(left)} of the rest)."
    return table("The fewest parameters that explain the change",
                 ["parameter", "changed by", "95 %", "unit", "chance of noise alone",
                  "it could as well be"], rows) + paragraph(text)


def _likeliest(rows: Sequence[Record]) -> str:
    """Return the parameters likeliest to have changed, the others folded away."""
    heads = ["parameter", "old", "new", "new − old", "95 %", "unit", "chance of noise alone",
             "status"]
    first = sorted(rows, key=lambda p: _or(p.get("p_alone"), 2.0))
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


def _row(p: Record) -> list[Any]:
    sigma, status = number(p.get("sigma")), str(p.get("status") or "")
    wide = None if sigma is None else Z95 * sigma
    return [dotted(p.get("name")), amount(p.get("old"), to_sigma(p.get("old"), sigma)),
            amount(p.get("new"), to_sigma(p.get("new"), sigma)),
            amount(p.get("difference"), to_sigma(p.get("difference"), sigma)),
            amount(wide, f"± {sig(wide, 2)}"), words(p.get("unit")),
            amount(p.get("p_alone"), probability(p.get("p_alone")) or "–"),
            words("" if status == "unchanged" else status, "warn" if status == "changed" else "")]


def differences(rows: Sequence[Record]) -> str:
    """Return new minus old of each parameter over its sigma, largest first, as a figure."""
    seen = [(z, p) for p in rows if (z := _ratio(p.get("difference"), p.get("sigma"))) is not None]
    if not seen:
        return ""
    seen.sort(key=lambda s: (s[1].get("status") not in STYLES, -abs(s[0])))
    shown = sorted(seen[:DRAWN], key=lambda s: -abs(s[0]))
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


def _key(shown: Sequence[tuple[float, Record]]) -> str:
    """Return what the colours mean that are there."""
    there = {str(p.get("status") or "") for _, p in shown}
    keys = [(STYLES[s], name) for s, name in KEYS.items() if s in there]
    keys += [("after", "unchanged")] if there - set(STYLES) else []
    return " ".join(f'<i class="key {kind}"></i>{name}' for kind, name in keys)


def _mark(frame: svg.Frame, z: float, y: float, p: Record) -> list[str]:
    """Return name, bar and mark of one parameter at the height ``y``."""
    status = str(p.get("status") or "")
    kind = STYLES.get(status, "after")
    low, middle, high = (float(frame.px(v)) for v in (z - Z95, z, z + Z95))
    bold = "small strong" if status == "changed" else "small"
    name = fitting(frame.left - 6.0, y + 3.5, str(p.get("name") or "?"), (frame.left - 8.0) * SMALL,
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


def _ratio(difference: Any, sigma: Any) -> float | None:
    a, b = number(difference), number(sigma)
    return number(a / b) if a is not None and b is not None and b > 0.0 else None


def _or(value: Any, otherwise: float) -> float:
    found = number(value)
    return otherwise if found is None else found


def _rows(t: Columns | None) -> list[Record]:
    """Return the rows of compare.csv as the JSON would hold them."""
    if t is None:
        return []
    return [{**{k: v[i] for k, v in t.text.items()},
             **{k: float(v[i]) if np.isfinite(v[i]) else None for k, v in t.numbers.items()}}
            for i in range(t.size)]
