"""Two versions of a file, value by value.

Where bytes need not be the same, a number may be off by :data:`OF_SCALE` of the largest number of
its column (of its list in JSON), by :data:`OF_SIGMA` of the sigma that stands beside it, or by
:data:`LEAST`, whichever is most; a number within text by one step of its last digit. Everything
else (names, verdicts, statuses, counts, which rows were used) must be the same.

Another version may say it in other words: a sentence for a sentence, a comment, a page or a drawing
that is made of what stands in other files. That is told apart, and only where versions differ.
So are keys and columns of a later version, which this one does not know.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from typing import Any

from ppmcal.wording import abbreviate_list, number, pluralize

SAME, WITHIN, DIFFERS, OPEN = "same", "within bounds", "differs", "not compared"
REWORDED, LATER = "wording differs", "of a later version"
OF_SCALE, OF_SIGMA, LEAST = 1e-6, 1e-3, 1e-9
BOUNDS = {"of_scale": OF_SCALE, "of_sigma": OF_SIGMA, "least": LEAST}
ESTIMATES = ("value", "error", "data", "mean", "estimate")
"""Names of numbers whose standard deviation is the ``sigma`` beside them."""
NOTHING = "(nothing)"
SENTENCE = 3
"""Words that make a text a sentence, and no status or verdict."""
FACTS = ("name", "dataset", "file", "command", "kind", "status", "verdict", "unit", "units")
"""Keys and columns whose text is none, however many words it has."""
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.\d+(?:[eE][-+]?\d+)?(?!\w|\.\d)")
"""A number within text: with a point, so that neither names nor counts are taken for one."""
_ANY_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?!\w|\.\d)")
"""Counts as well."""


@dataclass(frozen=True)
class ValueDifference:
    """A value that is not as it was: where, both as text, and how far apart, in ``unit``."""

    place: str = ""
    then: str = ""
    now: str = ""
    size: float | None = None
    unit: str = ""

    def words(self) -> str:
        """Return it in words."""
        if not (self.then or self.now):
            return self.place
        apart = f", apart by {number(self.size, 3)} {self.unit}".rstrip() if self.size else ""
        return f"{self.place}: {short_text(self.then)} there, {short_text(self.now)} now{apart}"


@dataclass(frozen=True)
class FileCheck:
    """A file against the one that comes out today.

    ``count``: values that differ, or texts where only the wording does; ``worst``: the one that
    is farthest from what is allowed, or the first of those texts; ``unknown``: keys and columns
    that only the later version knows that wrote it.
    """

    file: str = ""
    status: str = SAME
    edited: bool = False
    count: int = 0
    worst: ValueDifference | None = None
    unknown: tuple[str, ...] = ()

    def words(self) -> str:
        """Return what is to say of it besides its status."""
        edited = "edited since ppmcal wrote it" * self.edited
        later = self.unknown and (f"made by a later version: {pluralize(len(self.unknown), 'key')} "
                                  f"({abbreviate_list(self.unknown)}) not understood")
        worst = self.worst.words() if self.worst else ""
        if worst and self.count > 1:
            worst = f"{'first' if self.status == REWORDED else 'farthest apart'} at {worst}"
        return "; ".join(t for t in (edited, later, worst) if t)


@dataclass
class Tally:
    """Differences of a file so far: how many, the worst, and whether all are within bounds.

    ``exact``: whether bytes must be the same; ``reword``: whether sentences may be other ones, and
    ``texts`` are those that are; ``later``: whether a later version may have ``unknown`` keys.
    """

    exact: bool
    root: str = ""
    reword: bool = False
    later: bool = False
    unknown: list[str] = field(default_factory=list)
    texts: list[ValueDifference] = field(default_factory=list)
    count: int = 0
    over: float = -1.0
    within: bool = True
    worst: ValueDifference | None = None

    def differ(self, place: str, then: object, now: object, over: float = math.inf,
               size: float | None = None, unit: str = "") -> None:
        """Count one that is ``over`` times what is allowed; inf where nothing is."""
        self.count += 1
        self.within = self.within and over <= 1.0
        if over > self.over:
            self.over = over
            self.worst = ValueDifference(place=place, then=str(then), now=str(now), size=size,
                                         unit=unit)

    def say(self, place: str, then: object, now: object) -> None:
        """Count one that only the wording of another version makes."""
        self.texts.append(ValueDifference(place=place, then=str(then), now=str(now)))

    def strange(self, place: str) -> None:
        """Note a key that only the later version knows: once for all entries of a list."""
        key = re.sub(r"\[[^]]*\]", "", place)
        if key not in self.unknown:
            self.unknown.append(key)

    def of(self, name: str) -> FileCheck:
        """Return what was found of a file."""
        status = SAME if not self.count else WITHIN if self.within and not self.exact else DIFFERS
        check = FileCheck(file=name, status=status, count=self.count, worst=self.worst,
                          unknown=tuple(self.unknown))
        if self.texts and self.within:
            check = replace(check, status=REWORDED, count=len(self.texts), worst=self.texts[0])
        return replace(check, status=LATER) if self.unknown and status != DIFFERS else check


def is_later(version: str, than: str) -> bool:
    """Whether a version comes after another one."""
    one, other = ([int(n) for n in re.findall(r"\d+", v)] for v in (version, than))
    return one > other


def short_text(value: object) -> str:
    """Return what is shown of a value, which may be long."""
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def first_apart(then: bytes, now: bytes) -> int:
    """Return the number, from 1, of the first byte that differs."""
    low, high = 0, min(len(then), len(now))
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if then[:middle] == now[:middle] else (low, middle - 1)
    return low + 1


def numeric(value: object) -> float | None:
    """Return a cell or a JSON number as a float, None for anything else."""
    if isinstance(value, float | str):
        try:
            return float(value)
        except ValueError:
            return None
    return None


def judge(found: Tally, place: str, then: Any, now: Any, scale: float, sigma: float | None,
          unit: str = "") -> None:
    """Count two values that are not the same; counts, without a point, may not be off at all."""
    a, b = numeric(then), numeric(now)
    counts = str(then).lstrip("-").isdigit() and str(now).lstrip("-").isdigit()
    if a is not None and b is not None and math.isfinite(a) and math.isfinite(b):
        allowed = max(OF_SCALE * max(scale, abs(a)), OF_SIGMA * (sigma or 0.0), LEAST)
        found.differ(place, then, now, math.inf if counts else abs(a - b) / allowed, abs(a - b),
                     unit)
    elif isinstance(then, str) and isinstance(now, str):
        if found.reword and is_sentence(place, then) and is_sentence(place, now):
            _judge_sentence(found, place, then, now)
        else:
            found.differ(place, then, now, in_text(then, now))
    else:
        found.differ(place, then, now)


def is_sentence(place: str, text: str) -> bool:
    """Whether a text says something in words, and is no name or command that has several."""
    key = re.split(r"[., ]+", re.sub(r"\[[^]]*\]$", "", place))[-1]
    return len(text.split()) >= SENTENCE and key not in FACTS and "provenance" not in place


def _judge_sentence(found: Tally, place: str, then: str, now: str) -> None:
    """Count two sentences: numbers that are as many must be the same, in whatever order."""
    same = _ANY_NUMBER.sub("#", then) == _ANY_NUMBER.sub("#", now)
    a, b = (sorted(_ANY_NUMBER.findall(text), key=float) for text in (then, now))
    over = max(map(_steps, a, b), default=0.0) if len(a) == len(b) else 0.0
    if same or over > 1.0:
        found.differ(place, then, now, in_text(then, now) if same else over)
    else:
        found.say(place, then, now)


def in_text(then: str, now: str) -> float:
    """Return how far two texts are apart in steps of their numbers' last digits; inf in words."""
    if _NUMBER.sub("#", then) != _NUMBER.sub("#", now):
        return math.inf
    return max((_steps(a, b) for a, b in zip(_NUMBER.findall(then), _NUMBER.findall(now),
                                             strict=True) if a != b), default=0.0)


def _steps(then: str, now: str) -> float:
    """Return how many steps of the last digit two numbers are apart; inf for unlike counts."""
    if "." not in then + now:
        return 0.0 if then == now else math.inf
    a, b = float(then), float(now)
    step = max(_last_digit(then), _last_digit(now))
    return abs(a - b) / max(1.001 * step, OF_SCALE * abs(a), LEAST)


def _last_digit(text: str) -> float:
    """Return what one step of the last digit is worth."""
    digits, _, power = text.lower().partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
