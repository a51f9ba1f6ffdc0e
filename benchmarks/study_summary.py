"""The study's table: each figure with its 95 % interval (Clopper-Pearson)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ppmcal.design.tolerance_allocation import StageYield

Row = dict[str, str]


def interval(hits: int, total: int) -> tuple[float, float]:
    """Return the Clopper-Pearson 95 % interval of a share."""
    low, high = StageYield(hits, total).interval
    return low, high


def share(rows: Sequence[Row], test: Callable[[Row], bool]) -> str:
    """Return ``93 % (90-95)`` for the rows that pass."""
    if not rows:
        return "-"
    hits = sum(test(r) for r in rows)
    low, high = interval(hits, len(rows))
    return f"{100 * hits / len(rows):.1f} % ({100 * low:.1f}-{100 * high:.1f})"


def table(rows: Sequence[Row]) -> str:
    """Return the study in Markdown."""
    parts = [_targets(rows), _nothing(rows), _one(rows), _kinds(rows), _several(rows),
             _unknown(rows)]
    return "\n".join(parts)


def _named(row: Row) -> bool:
    return row["verdict"] in ("named", "named-set", "partial")


def _cells(rows: Sequence[Row], start: str) -> list[str]:
    return list(dict.fromkeys(r["cell"] for r in rows if r["cell"].startswith(start)))


def flagged(row: Row) -> bool:
    """Whether a campaign is said to hold something unknown, without a wrong name beside it."""
    return row["verdict"] in ("partial", "unnamed") and int(row["wrong"]) == 0


def _targets(rows: Sequence[Row]) -> str:
    """Return the figures that a world-class diagnosis would have, and what was found."""
    empty = [r for r in rows if r["cell"].startswith("none")]
    strong = [r for r in rows if r["cell"].startswith("one") and float(r["eta"]) >= 0.3
              and int(r["freedom"]) >= 500]
    sizes = [float(r["set_size"]) for r in strong if float(r["set_size"]) > 0.0]
    closed = [(float(r["closed"] or 0.0), float(r["closed_truth"])) for r in strong
              if r["closed_truth"] and float(r["closed_truth"]) > 0.0]
    ratio = sum(a for a, _ in closed) / max(sum(b for _, b in closed), 1e-9)
    unknown = [r for r in rows if r["cell"].startswith("unknown")]

    def right(r: Row) -> bool:
        return r["right"] == "1"

    def wrong(r: Row) -> bool:
        return int(r["wrong"]) > 0

    lines = [
        ("nothing hidden: something said to be there", "at most 5 %",
         share(empty, lambda r: r["verdict"] != "none")),
        ("nothing hidden: something named", "at most 1 %", share(empty, _named)),
        ("one, eta >= 0.3, 500 degrees of freedom: right, alone or in a set", "at least 95 %",
         share(strong, right)),
        ("the same: size of the set", "at most 1.5", f"{np.mean(sizes or [0.0]):.2f}"),
        ("the same: a wrong name", "at most 1 %", share(strong, wrong)),
        ("the same: held-out gap closed, over that of a fit that is told", "at least 0.9",
         f"{ratio:.2f}"),
        ("two, eta >= 0.5: both right", "at least 90 %",
         share([r for r in rows if r["cell"] == "two"], right)),
        ("three, eta >= 0.5: all right", "at least 80 %",
         share([r for r in rows if r["cell"] == "three"], right)),
        ("not in the library, eta = 1: flagged, and nothing named", "at least 95 %",
         share(unknown, flagged)),
        ("the same: a wrong name, alone, in a set or in a partial answer", "at most 1 %",
         share(unknown, wrong)),
        ("all campaigns: a wrong name, in whatever verdict", "at most 1 %", share(rows, wrong))]
    out = ["### Against what would be world-class", "", "| | wanted | found (95 %) |",
           "|---|---|---|", *(f"| {a} | {b} | {c} |" for a, b, c in lines)]
    return "\n".join(out) + "\n"


def _nothing(rows: Sequence[Row]) -> str:
    out = ["### Nothing hidden", "",
           "| noise | campaigns | any verdict but none | something named |", "|---|---|---|---|"]
    empty = [r for r in rows if r["cell"].startswith("none")]
    for cell, mine in [(c, [r for r in empty if r["cell"] == c]) for c in _cells(rows, "none")] + [
            ("all", empty)]:
        out.append(f"| {cell.removeprefix('none, ')} | {len(mine)} | "
                   f"{share(mine, lambda r: r['verdict'] != 'none')} | {share(mine, _named)} |")
    return "\n".join(out) + "\n"


def _figures(mine: Sequence[Row]) -> str:
    sizes = [float(r["set_size"]) for r in mine if float(r["set_size"]) > 0.0]
    hits = sum(int(r["covered"].split("/")[0]) for r in mine)
    total = sum(int(r["covered"].split("/")[1]) for r in mine)
    told = [(float(r["closed"] or 0.0), float(r["closed_truth"])) for r in mine
            if r["closed_truth"] and float(r["closed_truth"]) > 0.0]
    ratio = f"{sum(a for a, _ in told) / sum(b for _, b in told):.2f}" if told else "-"
    cover = f"{100 * hits / total:.0f} % of {total}" if total else "-"
    size = f"{np.mean(sizes):.2f}" if sizes else "-"
    return (f"{len(mine)} | {share(mine, lambda r: r['right'] == '1')} | "
            f"{share(mine, lambda r: r['alone'] == '1')} | {size} | "
            f"{share(mine, lambda r: int(r['wrong']) > 0)} | {cover} | {ratio}")


HEAD = ("campaigns | right, alone or in a set | alone | set size | wrong name | "
        "95 % intervals hold | gap closed / by the truth |")


def _one(rows: Sequence[Row]) -> str:
    out = ["### One effect hidden, by size", "", f"| eta | {HEAD}", "|---" * 8 + "|"]
    single = [r for r in rows if r["cell"].startswith("one")]
    for low, high in ((0.05, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 1.0), (1.0, 3.01)):
        mine = [r for r in single if low <= float(r["eta"]) < high]
        out.append(f"| {low:g} to {high:.2g} | {_figures(mine)} |")
    strong = [r for r in single if float(r["eta"]) >= 0.3 and int(r["freedom"]) >= 500]
    out.append(f"| at least 0.3, 500 degrees of freedom | {_figures(strong)} |")
    seen = [r for r in strong if float(r["survival"]) >= 0.2]
    out.append(f"| ... and survival at least 0.2 | {_figures(seen)} |")
    return "\n".join(out) + "\n"


def _kinds(rows: Sequence[Row]) -> str:
    out = ["### One effect hidden, eta at least 0.3, by kind", "", f"| kind | {HEAD}",
           "|---" * 8 + "|"]
    for cell in sorted(_cells(rows, "one")):
        mine = [r for r in rows if r["cell"] == cell and float(r["eta"]) >= 0.3]
        out.append(f"| {cell.removeprefix('one, ')} | {_figures(mine)} |")
    return "\n".join(out) + "\n"


def _several(rows: Sequence[Row]) -> str:
    out = ["### Several hidden, eta at least 0.5 each", "", f"| effects | {HEAD}", "|---" * 8 + "|"]
    for cell in ("two", "three"):
        mine = [r for r in rows if r["cell"] == cell]
        out.append(f"| {cell} | {_figures(mine)} |")
    return "\n".join(out) + "\n"


def _unknown(rows: Sequence[Row]) -> str:
    out = ["### Effects that the library does not know, eta = 1", "",
           "| effect | campaigns | flagged, nothing wrong named | wrong name in a partial answer | "
           "named (alone or set) |",
           "|---|---|---|---|---|"]
    for cell in _cells(rows, "unknown"):
        mine = [r for r in rows if r["cell"] == cell]
        out.append(
            f"| {cell.removeprefix('unknown, ')} | {len(mine)} | "
            f"{share(mine, flagged)} | "
            f"{share(mine, lambda r: r['verdict'] == 'partial' and int(r['wrong']) > 0)} | "
            f"{share(mine, lambda r: r['verdict'] in ('named', 'named-set'))} |")
    return "\n".join(out) + "\n"
