"""What an identification says besides its numbers: what is not told, and rows that do not belong.

identification.json may lack any of it, and may have been edited: an entry with a hole says nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ppmcal.io.json import NUMBER, TEXT
from ppmcal.io.results import identifiability_wording as told
from ppmcal.report.format import exact, number
from ppmcal.report.html import MAX_ROWS, amount, bullets, dotted, paragraph, table, words

Record = Mapping[str, Any]

UNTOLD = {"scale": {"unit": TEXT, "open": None, "held": None, "*": NUMBER},
          "twins": [{"a": TEXT, "b": TEXT, "correlation": NUMBER, "limb_by_limb": None}]}
BLUNDERS = {
    "rows": [{"dataset": TEXT, "coordinate": TEXT, "unit": TEXT, "*": NUMBER}],
    "would_be": {"*": {"*": NUMBER}}, "unchecked": [{"dataset": TEXT, "rows": [NUMBER]}],
    "zeros_moved": [{"session": TEXT, "actuator": TEXT, "unit": TEXT, "*": NUMBER}]}
FLATS = [{"dataset": TEXT, "unit": TEXT, "*": NUMBER}]
TOLD = {"untold": UNTOLD, "blunders": BLUNDERS, "flats": FLATS}
"""Shapes of these parts of identification.json."""


def told_section(record: Record) -> str:
    """Return what these data do not tell."""
    lines = [plus_minus(t) for t in (*_untold(record), *_flats(record), *_unchecked(record))]
    return "<h3>What these data do not tell</h3>" + bullets(lines) if lines else ""


def blunder_section(record: Record, units: Mapping[str, str]) -> str:
    """Return what the rows left out said, and what they would have done to the parameters."""
    found = record.get("blunders") or {}
    rows = [[words(b.get("dataset")), amount(b.get("row"), exact(b.get("row"))),
             words(b.get("coordinate")), amount(b.get("value"), _digits(b.get("value"))),
             amount(b.get("predicted"), _digits(b.get("predicted"))), words(b.get("unit")),
             amount(b.get("times"))] for b in found.get("rows") or ()]
    out = table(_first("What those rows say, and what all others say of them", len(rows)),
                ["data set", "row", "number", "measured", "the others say", "unit",
                 "times the noise"], rows[:MAX_ROWS], sort=True)
    would = [(name, e) for name, e in (found.get("would_be") or {}).items()
             if e and number(e.get("now")) is not None and number(e.get("with_them")) is not None]
    body = [[dotted(name), amount(e["now"], _digits(e["now"])),
             amount(e["with_them"], _digits(e["with_them"])), words(units.get(name, ""))]
            for name, e in would]
    out += table(_first("What parameters would be with them", len(body)),
                 ["parameter", "now", "with them", "unit"], body[:MAX_ROWS], sort=True)
    if not out:
        return ""
    return "<h3>Rows that do not belong</h3>" + paragraph(
        "They were left out because the others contradict them.", "note") + out


def moved_zeros(record: Record) -> list[str]:
    """Return one sentence for each joint's zero that moved between sessions."""
    found = (record.get("blunders") or {}).get("zeros_moved") or ()
    return [plus_minus(t) for t in _say(told.zero_moved, found, ("value", "sigma"),
                                        ("actuator", "session"))]


def plus_minus(text: str) -> str:
    """Return a sentence of the console as the page writes it."""
    return text.replace("+- ", "± ")


def _untold(record: Record) -> Iterator[str]:
    found = record.get("untold") or {}
    scale = found.get("scale") or {}
    if scale.get("open") is True:
        entry: dict[str, Any] = {k: number(scale.get(k)) for k in ("sigma", "sigma_data")}
        entry |= {"held": scale.get("held") is True, "unit": scale.get("unit") or ""}
        needs = ["distance"] + (["measure_at_least", "measure_to"]
                                if entry["sigma"] is not None else [])
        if all((number(scale.get(k)) or 0.0) > 0.0 for k in needs):
            yield told.scale(entry | {k: number(scale[k]) for k in needs})
    for pair in found.get("twins") or ():
        yield from _say(told.twins, [{**pair, "limb_by_limb": pair.get("limb_by_limb") is True}],
                        ("correlation",), ("a", "b"))


def _flats(record: Record) -> Iterator[str]:
    seen = (f for f in record.get("flats") or () if (number(f.get("p_value")) or 0.0) < told.SMOOTH)
    return _say(told.flat, seen, ("smooth", "scatter", "p_value"), ("dataset",))


def _unchecked(record: Record) -> Iterator[str]:
    for entry in (record.get("blunders") or {}).get("unchecked") or ():
        rows = [exact(r) for r in entry.get("rows") or ()]
        if rows:
            yield from _say(told.unchecked, [{**entry, "rows": rows}], (), ("dataset",))


def _say(sentence: Callable[[told.Entry], str], entries: Any, numbers: tuple[str, ...],
         texts: tuple[str, ...]) -> Iterator[str]:
    """Yield the sentences of those entries that have all it takes."""
    for entry in entries:
        values = {k: number(entry.get(k)) for k in numbers}
        if None not in values.values() and all(entry.get(k) for k in texts):
            yield sentence({**entry, **values, "unit": entry.get("unit") or ""})


def _digits(value: Any) -> str:
    """Return a number to six digits, as the console shows it."""
    x = number(value)
    return "–" if x is None else f"{x:.6g}".replace("-", "−")


def _first(caption: str, size: int) -> str:
    return caption + (f"; the first {MAX_ROWS} of {size}" if size > MAX_ROWS else "")
