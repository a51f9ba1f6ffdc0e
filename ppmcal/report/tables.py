"""Tables as HTML: escaped cells, row and column headers with their scope."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from ppmcal.report.numbers import exact, number, sig

MAX_ROWS = 200
"""Tables with one line for each data row stop here; the CSV holds them all."""


@dataclass(frozen=True)
class Cell:
    """One cell: ready HTML, its value for sorting, and its class (``n``: a number)."""

    html: str
    value: float | None = None
    kind: str = ""


def words(text: object, kind: str = "") -> Cell:
    """Return a cell of plain text."""
    return Cell(escape("" if text is None else str(text)), None, kind)


def dotted(name: object) -> Cell:
    """Return a cell with a name that may break after its dots."""
    return Cell(escape("" if name is None else str(name)).replace(".", ".<wbr>"))


def amount(value: Any, text: str | None = None, bad: bool = False) -> Cell:
    """Return a cell with a number, shown as ``text`` or with three digits."""
    return Cell(escape(sig(value) if text is None else text), number(value),
                "n bad" if bad else "n")


def given(text: str) -> Cell:
    """Return a cell of a CSV as it stands there, shortened if it is a number."""
    try:
        value = number(float(text))
    except ValueError:
        return words(text)
    return amount(value, exact(value) if len(text) < 8 else sig(value, 6))


def table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[Cell]],
          sort: bool = False) -> str:
    """Return a table; the first cell of each row is its header. ``heads`` are plain text."""
    if not rows:
        return ""
    numeric = [all("n" in r[i].kind.split() for r in rows) for i in range(len(heads))]
    top = "".join(f'<th scope="col"{_class("n" if n else "")}>{escape(h)}</th>'
                  for h, n in zip(heads, numeric, strict=True))
    body = "".join("<tr>" + "".join(_cell(c, i == 0) for i, c in enumerate(r)) + "</tr>"
                   for r in rows)
    name = escape(caption or "table")
    return (f'<div class="scroll" role="region" tabindex="0" aria-label="{name}">'
            f'<table{_class("sort" if sort and len(rows) > 2 else "")}>'
            + (f"<caption>{name}</caption>" if caption else "")
            + f"<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>")


def _cell(cell: Cell, first: bool) -> str:
    value = "" if cell.value is None else f' data-v="{cell.value:.7g}"'
    if first:
        return f'<th scope="row"{_class(cell.kind)}{value}>{cell.html}</th>'
    return f"<td{_class(cell.kind)}{value}>{cell.html}</td>"


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def definitions(pairs: Sequence[tuple[str, str]], code: str = "") -> str:
    """Return a list of names and plain text; the one called ``code`` is shown as code."""
    items = "".join(f"<dt>{escape(k)}</dt><dd>"
                    + (f"<code>{escape(v)}</code>" if k == code else escape(v)) + "</dd>"
                    for k, v in pairs if v)
    return f"<dl>{items}</dl>" if items else ""


def bullets(lines: Sequence[str]) -> str:
    """Return a list of plain lines."""
    items = "".join(f"<li>{escape(t)}</li>" for t in lines)
    return f'<ul class="plain">{items}</ul>' if items else ""


def paragraph(text: str, kind: str = "") -> str:
    """Return one paragraph of plain text, nothing for none."""
    return f"<p{_class(kind)}>{escape(text)}</p>" if text else ""


def error_bar(p: Mapping[str, Any]) -> str:
    """Return a small bar: the error against its tolerance, with the 95 % interval.

    The shaded zone is one tolerance to each side of nominal, the ends are three.
    """
    error, tolerance = number(p.get("error")), number(p.get("tolerance"))
    if error is None or tolerance is None or not tolerance > 0.0:
        return ""
    half = 1.96 * (number(p.get("sigma")) or 0.0)

    def at(value: float) -> float:
        return 65.0 + 20.0 * max(-2.9, min(2.9, value / tolerance))

    x, far = at(error), abs(error) > 3.0 * tolerance
    mark = (f'<circle class="err" cx="{x:.1f}" cy="9" r="3.5"/>' if not far else
            f'<path class="err far" d="M{x:.1f} 4v10l{5 if error > 0 else -5} -5z"/>')
    label = f"error {sig(error)}, tolerance {sig(tolerance)}"
    return (f'<svg class="bar" role="img" aria-label="{label}" viewBox="0 0 130 18">'
            f'<title>{label}</title><rect class="zone" x="45" y="3" width="40" height="12"/>'
            f'<path class="zero" d="M65 1v16"/>'
            f'<path class="ci" d="M{at(error - half):.1f} 9H{at(error + half):.1f}"/>{mark}</svg>')
