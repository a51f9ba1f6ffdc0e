"""The tables of rates, from the lines of a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from study_summary import interval, share

Line = Mapping[str, str]
ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "rates"
NAMED = ("named", "named-set", "partial")
GROUPS = {"nothing": "nothing hidden", "poor noise": "nothing hidden, noise not as stated",
          "one": "one cause", "memory": "one cause with memory", "event": "events, with their rows",
          "several": "two or three causes", "unknown": "a cause in no library"}
KNOWN = ("one", "memory", "event")
BINS = (0.0, 0.5, 0.7, 0.9, 0.99, 1.01)
GENERATORS = ("hidden", "wild", "bodies")


def rates(lines: Sequence[Line], about: Mapping[str, Any]) -> str:
    """Return the headline table in Markdown, with what it is of."""
    rows = [(what, [share(of, test) for of in (own(lines), *(
                own([r for r in lines if r["generator"] == g]) for g in GENERATORS))])
            for what, own, test in _questions()]
    return "\n".join([
        _said(lines, about), "", "| | all | hidden | wild | bodies |", "|---|---|---|---|---|",
        *(f"| {what} | {' | '.join(cells)} |" for what, cells in rows),
        f"| one cause, eta from 0.5: names in a set, mean | {' | '.join(_sizes(lines))} |"])


def _sizes(lines: Sequence[Line]) -> list[str]:
    """Return the mean number of names in a set, of all and of each generator."""
    named = [r for r in _known(*KNOWN, low=0.5)(lines) if float(r["size"]) > 0.0]
    each = [named, *([r for r in named if r["generator"] == g] for g in GENERATORS)]
    return [f"{np.mean([float(r['size']) for r in own]):.2f}" if own else "-" for own in each]


def reliability(lines: Sequence[Line], about: Mapping[str, Any]) -> str:
    """Return how often kinds are right, by the probability that was said, on whatever joints."""
    said = [(float(p), hit == "1") for r in lines for p, _, hit in (
        word.partition(":") for word in r["said"].split())]
    out = [_said(lines, about), "", "| said | kinds | mean of what was said | right |",
           "|---|---|---|---|"]
    for low, high in pairwise(BINS):
        own = [(p, hit) for p, hit in said if low <= p < high]
        if own:
            hits = sum(h for _, h in own)
            least, most = interval(hits, len(own))
            out.append(f"| {low:g} to {min(high, 1.0):g} | {len(own)} | "
                       f"{np.mean([p for p, _ in own]):.3f} | {hits / len(own):.3f} "
                       f"({least:.3f} to {most:.3f}) |")
    return "\n".join(out)


def _said(lines: Sequence[Line], about: Mapping[str, Any]) -> str:
    return (f"{about['made']}: {len(lines)} campaigns. "
            f"In brackets: 95 % interval (Clopper and Pearson).")


def _questions() -> list[tuple[str, Callable[[Sequence[Line]], list[Line]],
                               Callable[[Line], bool]]]:
    quiet, of, known = ("nothing", "poor noise"), _known, KNOWN
    return [
        ("nothing hidden: something said to be there", of("nothing"), said),
        ("the same, noise not as stated", of("poor noise"), said),
        ("nothing hidden: something named", of(*quiet), lambda r: r["verdict"] in NAMED),
        ("one cause, eta from 0.5: right, alone or in a set", of(*known, low=0.5), right),
        ("the same: right and alone", of(*known, low=0.5), lambda r: r["alone"] == "1"),
        ("the same: a wrong name", of(*known, low=0.5), wrong),
        ("two or three causes: all right", of("several"), right),
        ("the same: a wrong name", of("several"), wrong),
        ("a cause in no library: said to be there", of("unknown"), said),
        ("the same: a wrong name", of("unknown"), wrong),
        ("all: a wrong name, in whatever verdict", lambda lines: list(lines), wrong),
        ("all: geometry alone surely predicts poses better", lambda lines: list(lines),
         lambda r: r.get("worse") == "1"),
        ("all: a right file refused, or called misread", lambda lines: list(lines),
         lambda r: r["verdict"] in ("refused", "misread", "fault"))]


def _known(*groups: str, low: float = 0.0) -> Callable[[Sequence[Line]], list[Line]]:
    return lambda lines: [r for r in lines if r["group"] in groups and (
        r["generator"] == "bodies" or float(r["eta"]) >= low)]


def said(row: Line) -> bool:
    """Whether anything is said to be there."""
    return row["verdict"] != "none"


def right(row: Line) -> bool:
    """Whether all that is there is named, alone or in a set, events with their rows."""
    return row["right"] == "1"


def wrong(row: Line) -> bool:
    """Whether anything is named that is not there."""
    return int(row["wrong"]) > 0


def by_case(lines: Sequence[Line], about: Mapping[str, Any]) -> str:
    """Return the table of every kind of campaign: counts, since each cell is small."""
    out = [_said(lines, about), "",
           "| campaigns | generator | case | n | right | alone | wrong | none | weak | unnamed | "
           "partial | refused |", "|---" * 12 + "|"]
    cells: dict[tuple[str, str, str], list[Line]] = {}
    for row in lines:
        cells.setdefault((row["group"], row["generator"], row["case"]), []).append(row)
    order = list(GROUPS)
    for (group, generator, case), own in sorted(
            cells.items(), key=lambda c: (order.index(c[0][0]), c[0][1:])):
        count = [sum(r["verdict"] in v for r in own) for v in (
            ("none",), ("weak",), ("unnamed",), ("partial",), ("refused", "misread", "fault"))]
        figures = [len(own), sum(map(right, own)), sum(r["alone"] == "1" for r in own),
                   sum(map(wrong, own)), *count]
        out.append(f"| {GROUPS[group]} | {generator} | {case} | "
                   f"{' | '.join(map(str, figures))} |")
    return "\n".join(out)


TABLES = {"rates": rates, "rates-by-case": by_case, "reliability": reliability}
