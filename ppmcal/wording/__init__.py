"""Words for messages: lists, numbers and units; what is under way is in ``progress``."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

_QUOTED_OR_WORD = re.compile(r"'[^']*'|[^\s,;:()']+")


def counted(count: int, what: str) -> str:
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


def some(names: Sequence[str], where: str = "", most: int = MOST, joint: str = ", ") -> str:
    """Return ``a, b, c`` of few; of many ``a, b, c and 4 more (all in FILE)``."""
    if len(names) <= most + 1:    # "and 1 more" is as long as the one
        return joint.join(names)
    rest = f" (all in {where})" if where else ""
    return f"{joint.join(names[:most])} and {len(names) - most} more{rest}"


def _kind(found: re.Match[str]) -> str:
    word = found[0]
    return "#" if word[0] == "'" or any(c.isdigit() for c in word) else word


def gathered(lines: Sequence[str], where: str) -> list[str]:
    """Return sentences, of more than three of one kind one: a count, the first three, and where.

    Sentences are of one kind that differ in names in quotes, words with a digit, and numbers.
    """
    kinds: dict[str, list[str]] = {}
    for line in lines:
        kinds.setdefault(_QUOTED_OR_WORD.sub(_kind, line), []).append(line)
    out = []
    for alike in kinds.values():
        few = [line.rstrip(".") for line in alike[:MOST]]
        out += alike if len(alike) <= MOST else [
            f"{len(alike)} alike: {'; '.join(few)}; and {len(alike) - MOST} more ({where})"]
    return out


def where(on: Sequence[Any], total: int) -> str:
    """Return ``leg1, leg2`` or ``all 6 actuators``; empty for the whole machine."""
    if total > 1 and len(on) == total:
        return f"all {total} actuators"
    return ", ".join(str(a) for a in on)


def shorter(label: str, total: int) -> str:
    """Return a label, ``gain on leg1, leg2``, in which a list of all actuators is one word."""
    kind, _, place = label.partition(" on ")
    names = place.split(", ") if place else []
    return f"{kind} on {where(names, total)}" if names else kind


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


def too_long(ratio: float) -> str:
    """Return ``0.4 % too short``, where ``ratio`` is of what is shown over what is true."""
    return f"{100.0 * abs(ratio - 1.0):.2g} % too {'long' if ratio > 1.0 else 'short'}"


def chance(p: float) -> str:
    """Return ``p = 0.03``, and ``p < 1e-99`` of what arithmetic may have made 0."""
    return "p < 1e-99" if p < 1e-99 else f"p = {p:.2g}"
