"""The section about a comparison of two calibrations: what changed, and what it means."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from ppmcal.io.results.comparison import (
    COMPARE_TABLE,
    NOT_COMPARED,
    ComparisonRecord,
    ParameterDifference,
    about_changes,
    platform_sentence,
    verdict_sentence,
)
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Dots, Layer, Marks, Points, Strokes, Zero
from ppmcal.plotting.plot import row_y, rows_plot, span
from ppmcal.report.html import (
    Cell,
    count,
    figures,
    name_cell,
    number_cell,
    paragraph,
    probability,
    sig,
    table,
    text_cell,
    to_sigma,
    typeset,
)
from ppmcal.report.records import Held, ReportData
from ppmcal.report.section import Folder, Kind, Section
from ppmcal.wording import abbreviate_list

SHOWN, PLOTTED = 12, 40
STYLES = {"changed": "out", "possible": "before"}
KEYS = {"changed": "changed", "possible": "possible instead"}


def comparison_section(one: Held[ComparisonRecord]) -> Section:
    """Return everything about one comparison."""
    r = one.record
    return Section("Comparison of two calibrations", "".join([
        paragraph(typeset(verdict_sentence(r)), "big"), paragraph(typeset(platform_sentence(r))),
        _changes(r), figures([differences(r.parameters)]), _likeliest(r.parameters)]), one.folder)


def findings(r: ComparisonRecord) -> list[str]:
    """Return what the user must look at."""
    if r.verdict == NOT_COMPARED:
        return [f"whether the machine has changed between the two calibrations cannot be told: "
                f"{r.why_not}"]
    if r.verdict != "changed":
        return []
    names = [c.name or "?" for c in r.changes]
    return ["the machine has changed between the two calibrations: "
            + (abbreviate_list(names, most=6) if names else "nothing by itself explains it")]


def _changes(r: ComparisonRecord) -> str:
    """Return the changes that are named, and whether they explain all of it."""
    rows = []
    for c in r.changes:
        for i, n in enumerate(c.numbers):
            wide = n.wide
            name = f"{c.name}: {n.name}" if n.name else c.name
            rows.append([name_cell(name), number_cell(n.value, to_sigma(n.value, n.sigma)),
                         number_cell(wide, f"± {sig(wide, 2)}"), text_cell(n.unit),
                         number_cell(c.probability, sig(c.probability, 3) or "–"),
                         text_cell("" if i else abbreviate_list(c.instead, most=6)
                                   or "nothing else", "wrap")])
    return table("The likeliest changes that explain it",
                 ["what", "changed by", "95 %", "unit", "probability", "or"], rows) + "".join(
                     paragraph(typeset(s)) for s in about_changes(r))


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
    wide = p.wide
    return [name_cell(p.name), number_cell(p.old, to_sigma(p.old, p.sigma)),
            number_cell(p.new, to_sigma(p.new, p.sigma)),
            number_cell(p.difference, to_sigma(p.difference, p.sigma)),
            number_cell(wide, f"± {sig(wide, 2)}"), text_cell(p.unit),
            number_cell(p.p_alone, probability(p.p_alone) or "–"),
            number_cell(p.explained, to_sigma(p.explained, p.sigma) if p.explained else ""),
            text_cell("" if p.status == "unchanged" else p.status,
                      "warn" if p.status == "changed" else "")]


def differences(rows: Sequence[ParameterDifference]) -> Drawing | None:
    """Return new minus old of each parameter over its sigma, largest first."""
    seen = [(z, p) for p in rows if (z := p.in_sigmas) is not None]
    if not seen:
        return None
    seen.sort(key=lambda s: (s[1].status not in STYLES, -abs(s[0])))
    shown = sorted(seen[:PLOTTED], key=lambda s: -abs(s[0]))
    less = f" The {len(shown)} largest of {len(seen)}." if len(shown) < len(seen) else ""
    x = span([e for z, p in shown for e in (z - p.wide_in_sigmas, z + p.wide_in_sigmas, 0.0)])
    return rows_plot(x, "(new − old) / sigma", _layers(shown),
                     [(p.name or "?", p.status == "changed") for _, p in shown]).drawing(
        "New minus old in units of sigma",
        "With 95 % bars, sorted by size; diamonds and bold names: changed. Sigma is what noise "
        "and tolerances make, so that parameters that trade with each other differ little "
        f"each.{less}", f"{len(shown)} parameters with 95 % bars.", _key(shown))


def _key(shown: Sequence[tuple[float, ParameterDifference]]) -> tuple[tuple[str, str], ...]:
    """Return what the colours mean that are there."""
    there = {p.status for _, p in shown}
    keys = [(STYLES[s], name) for s, name in KEYS.items() if s in there]
    return (*keys, *([("after", "unchanged")] if there - set(STYLES) else []))


def _layers(shown: Sequence[tuple[float, ParameterDifference]]) -> list[Layer]:
    """Return a bar and a mark for each parameter."""
    out: list[Layer] = [Zero(upright=True)]
    places = row_y(len(shown))
    for kind in ("after", "before", "out"):
        mine = [(z, at, p) for (z, p), at in zip(shown, places, strict=True)
                if STYLES.get(p.status, "after") == kind]
        if mine:
            z, y = np.array([m[:2] for m in mine]).T
            said = Points([_said(p) for *_, p in mine])
            bar = np.array([p.wide_in_sigmas for *_, p in mine])
            out += [Strokes(y, z - bar, z + bar, kind, flat=True),
                    Marks(z, y, "out", "D", 5.6, said) if kind == "out" else
                    Dots(z, y, kind, points=said)]
    return out


def _said(p: ParameterDifference) -> str:
    """Return a parameter's name and difference with its 95 % interval."""
    half = p.wide
    return (f"{p.name or '?'}\nnew − old: {to_sigma(p.difference, p.sigma)} ± {sig(half, 2)} "
            f"{p.unit}").rstrip()


def _read(folder: Folder) -> Iterator[Held[ComparisonRecord]]:
    if folder.has("comparison.json", "compare.csv"):
        yield Held(folder.name, COMPARE_TABLE.parameters(folder.record(ComparisonRecord),
                                                         folder.table(COMPARE_TABLE)))


def _shown(one: Held[ComparisonRecord], _: ReportData) -> dict[str, Any]:
    record = one.record.entries()
    return {"folder": one.folder, "comparison": record, "parameters": record.get("parameters", ())}


COMPARE: Kind[Held[ComparisonRecord]] = Kind(
    "compared", "comparisons", "comparison", 70, ("comparison.json", "compare.csv"), _read,
    lambda one, _: [(f"Comparison in {one.folder}", partial(comparison_section, one))],
    _shown, lambda one: [("compare", one.record)], lambda one, _: [
        (one.folder, text) for text in (*findings(one.record), *one.record.findings)],
    lambda one, _: {"comparison": [differences(one.record.parameters)]},
    lambda one, _: [typeset(verdict_sentence(one.record))])
