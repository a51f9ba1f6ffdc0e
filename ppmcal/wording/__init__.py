"""Words for messages: lists, numbers and units; what is under way is in ``progress``."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

_QUOTED_OR_WORD = re.compile(r"'[^']*'|[^\s,;:()']+")
_FILE = re.compile(r"\.\w{1,8}$")
_NAME = "\0"
"""What stands for a name in the form of a sentence."""


def pluralize(count: int, what: str) -> str:
    """Return ``1 row``, ``2 rows``."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def row_list(indices: Sequence[Any] | Any, most: int = 5) -> str:
    """Return ``rows 3, 7, 9 (+12 more)`` for row indices counted from 0."""
    shown = ", ".join(str(int(i) + 1) for i in indices[:most])
    more = f" (+{len(indices) - most} more)" if len(indices) > most else ""
    return f"row{'s' if len(indices) > 1 else ''} {shown}{more}"


def sentence(text: str) -> str:
    """Return text as a sentence, empty if there is none."""
    plain = text.strip()
    return f"{plain[:1].upper()}{plain[1:].rstrip('.')}." if plain else ""


MOST = 3
"""So many of a kind are named; the others are counted, and said to be where they are."""


def abbreviate_list(names: Sequence[str], where: str = "", most: int = MOST,
                    joint: str = ", ") -> str:
    """Return ``a, b, c`` of few; of many ``a, b, c and 4 more (all in FILE)``."""
    if len(names) <= most + 1:    # "and 1 more" is as long as the one
        return joint.join(names)
    rest = f" (all in {where})" if where else ""
    return f"{joint.join(names[:most])} and {len(names) - most} more{rest}"


def collapse_similar(lines: Sequence[str], where: str) -> list[str]:
    """Return sentences, those that state one fact of several files, rows or names as one.

    A fact of several files or rows names them before it: ``a.csv, b.csv: ...``. Of more than
    three that differ elsewhere too the first stands for all, with what the others are about.
    ``actuator_list``: where all of them can be read.
    """
    kinds: dict[str, list[tuple[str, list[str]]]] = {}
    for line in dict.fromkeys(lines):
        form, names = _form(line.replace(_NAME, ""))
        kinds.setdefault(form, []).append((line, names))
    out = []
    for form, alike in kinds.items():
        out += _as_one(form, alike, where) or [line for line, _ in alike]
    return out


def _form(line: str) -> tuple[str, list[str]]:
    """Return a sentence without what it names, and that: files, quoted names, numbers."""
    place, colon, _ = line.partition(": ")
    first = len(place) if colon and (" " not in place or _FILE.search(place[-9:])) else 0
    names = [line[:first]] * bool(first)

    def _taken(found: re.Match[str]) -> str:
        word = found[0]
        if word[0] != "'" and not any(c.isdigit() for c in word):
            return word
        names.append(word)
        return _NAME

    return _NAME * bool(first) + _QUOTED_OR_WORD.sub(_taken, line[first:]), names


def _as_one(form: str, alike: Sequence[tuple[str, list[str]]], where: str) -> list[str]:
    """Return the sentence that stands for all of one form; none if they stay apart."""
    names = [list(own) for own in zip(*(n for _, n in alike), strict=True)]
    apart = [i for i, own in enumerate(names) if len(set(own)) > 1]
    if not apart:
        return []
    text, at = form.split(_NAME), apart[0]
    if len(apart) == 1 and text[at + 1].startswith((":", " refused:")):
        before = text[at].replace("row ", "rows ") if text[at].endswith("row ") else text[at]
        said = [_few(own, where) if i == at else own[0] for i, own in enumerate(names)]
        return ["".join(a + b for a, b in zip([*text[:at], before, *text[at + 1:]], [*said, ""],
                                              strict=True))]
    if len(alike) <= MOST:
        return []
    line = alike[0][0].rstrip(".")
    rows = "rows " * text[at].endswith("row ")
    return [f"{line}; likewise {rows}{_few(names[at][1:], where)}"]


def _few(names: Sequence[str], where: str) -> str:
    few = list(dict.fromkeys(names))
    more = len(few) - MOST
    return ", ".join(few) if more <= 1 else f"{', '.join(few[:MOST])} and {more} more ({where})"


def actuator_list(on: Sequence[Any], total: int) -> str:
    """Return ``leg1, leg2`` or ``all 6 actuators``; empty for the whole machine."""
    if total > 1 and len(on) == total:
        return f"all {total} actuators"
    return ", ".join(str(a) for a in on)


def shorten_label(label: str, total: int) -> str:
    """Return a label, ``gain on leg1, leg2``, in which a list of all actuators is one word."""
    kind, _, place = label.partition(" on ")
    names = place.split(", ") if place else []
    return f"{kind} on {actuator_list(names, total)}" if names else kind


def causes(label: str) -> str:
    """Return ``backlash and gain`` of ``backlash on leg1, leg2 and gain on leg3``."""
    return " and ".join(dict.fromkeys(
        part.partition(" on ")[0] for part in label.split(" and ")))


SLOW = 1e-2
"""A rate below this is easier to read by the hour."""


def rate(unit: str, largest: float) -> tuple[float, str]:
    """Return factor and unit for people: ``mm/s`` becomes ``mm/h`` where numbers are small."""
    if unit.endswith("/s") and abs(largest) < SLOW:
        return 3600.0, unit.removesuffix("s") + "h"
    return 1.0, unit


def number(value: float | None, digits: int = 4) -> str:
    """Return a number for people, ``-`` for none."""
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}g}"


def known(value: float | None) -> float | None:
    """Return a number that can be said, else None: files may hold nan."""
    return value if value is not None and math.isfinite(value) else None


def percent(part: float) -> str:
    """Return ``34 %`` of a part of 1."""
    return f"{100.0 * part:.0f} %"


def rounded(value: float, digits: int) -> float | None:
    """Return a number with so many digits, None for none."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def too_long(ratio: float) -> str:
    """Return ``0.4 % too short``, where ``ratio`` is of what is shown over what is true."""
    return f"{100.0 * abs(ratio - 1.0):.2g} % too {'long' if ratio > 1.0 else 'short'}"


def chance(p: float) -> str:
    """Return ``p = 0.03``, and ``p < 1e-99`` of what arithmetic may have made 0."""
    return "p < 1e-99" if p < 1e-99 else f"p = {p:.2g}"
