"""M665 and M666 of firmwares of linear deltas: how such lines are read, and written.

Each letter keeps its value until a later line gives another. Letters are read in any case and
order, ``;`` begins a comment, quotes hold text (RepRapFirmware, ``StringParser.cpp``:
DecodeCommand).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ppmcal.controllers.delta.geometry import Triple, above_zero
from ppmcal.controllers.text import NUMBER, commented, read_text
from ppmcal.errors import BadInput, unknown

DIGITS = 4
"""Decimals of what is written: what single precision holds of 500 mm, in one line of below 100
characters, which is all that older firmware takes. M500 itself saves 3."""
ELSEWHERE = (98, 501)
"""Commands that run other files, where these numbers may stand, too."""
MOST = 1e6
"""Larger numbers, mm, degrees or percent, are none of a printer's."""
TEXT = 117
"""The command whose text is not quoted."""
_PARAMETER = re.compile(rf"\s*([A-Za-z])\s*({NUMBER}(?::{NUMBER})*)(?![\d.:])", re.ASCII)
_COMMAND = re.compile(r"[GM](\d{1,9})(\.\d)?", re.ASCII | re.IGNORECASE)
_GCODE = re.compile(r"\s*(N\d+\s*)?[GMT]", re.ASCII | re.IGNORECASE)
_WORD = re.compile(r"\s*([a-z]{2,8})(?=[\s{\"(]|$)", re.ASCII)
_HIDDEN = re.compile(r'"[^"]*"?|\{[^}]*\}?|;.*')


@dataclass(frozen=True)
class Value:
    """Numbers of one letter, and the line that they stand in (from 1)."""

    numbers: tuple[float, ...]
    line: int


@dataclass(frozen=True)
class Lines:
    """What a file says: ``M665 R`` -> value; ``elsewhere``: (line, command) that run others."""

    source: str
    values: Mapping[str, Value]
    elsewhere: tuple[tuple[int, str], ...] = ()

    def at(self, name: str) -> str:
        """Return the place of a number for messages."""
        value = self.values.get(name)
        return f"{self.source}: {'' if value is None else f'line {value.line}: '}{name}"

    def number(self, name: str, default: float | None = None, positive: bool = False) -> float:
        """Return one number, ``default`` where the file does not give it.

        Raises:
            BadInput: it is missing without default, more than one, or not above 0.
        """
        value = self.values.get(name)
        if value is None:
            if default is None:
                raise BadInput("is missing", self.at(name), "Write the value that the printer has: "
                               "without it the firmware takes its own default")
            return default
        if len(value.numbers) != 1:
            raise BadInput(f"{len(value.numbers)} numbers stand here", self.at(name),
                           "Write one; only L takes one for each tower")
        return above_zero(value.numbers[0], self.at(name)) if positive else value.numbers[0]

    def overruled(self) -> list[str]:
        """Return ``line 9: M501`` of what runs after the numbers, and so may win over them."""
        last = max((value.line for value in self.values.values()), default=0)
        return [f"line {n}: {command}" for n, command in self.elsewhere if n >= last]

    def triple(self, command: str, letters: str = "XYZ") -> Triple:
        """Return the numbers of three letters of a command, 0 where nobody says."""
        a, b, c = (self.number(f"{command} {letter}", 0.0) for letter in letters)
        return a, b, c

    def optional(self, name: str) -> float | None:
        """Return a number that has to be above 0, None where the file does not give it."""
        return self.number(name, positive=True) if name in self.values else None

    def refuse_short(self, tower: str, rod: float, radius: float) -> None:
        """Refuse a rod that does not reach the middle, mm (BadInput)."""
        if rod <= radius:
            raise BadInput(f"the rod of tower {tower}, {rod:g} mm, does not reach the middle: "
                           f"R is {radius:g} mm", self.at("M665 L"),
                           "Check both lengths; L is the longer one")


def parse_lines(text: str, source: str, known: Mapping[int, str]) -> Lines:
    """Return what ``text`` says of the delta; later lines win, letter by letter.

    Args:
        text: of a file.
        source: what messages call it.
        known: the commands that are read, and their letters.
    """
    values: dict[str, Value] = {}
    elsewhere: list[tuple[int, str]] = []
    block: int | None = None
    for n, raw in enumerate(text.splitlines(), 1):
        line = _HIDDEN.sub(_mark, raw).expandtabs(4).rstrip()
        indent = len(line) - len(line.lstrip())
        if line and block is not None and indent <= block:
            block = None
        word = _WORD.match(line)
        if word is not None:
            if word[1] in ("if", "elif", "else", "while") and block is None:
                block = indent
            continue
        for code, body in _commands(line):
            where = f"{source}: line {n}: M{code}"
            if code in ELSEWHERE:
                elsewhere.append((n, f"M{code}"))
            elif code in known and block is not None:
                raise BadInput("stands under a condition, so that it may hold or not", where,
                               "Put the line that the printer uses outside")
            elif code in known:
                values |= {f"M{code} {letter}": Value(numbers, n)
                           for letter, numbers in _parameters(body, known[code], where).items()}
    return Lines(source, values, tuple(elsewhere))


def line_readers(known: Mapping[int, str], wanted: str, bare: Callable[[str], str] = str
                 ) -> tuple[Callable[[Path], Lines], Callable[[str, str], Lines]]:
    """Return what reads a firmware's file, and what its text says, of a name for messages.

    ``known``: as of :func:`parse_lines`; ``wanted``: what to give instead of what is no text;
    ``bare``: a text without what a host shows before its lines.
    """
    def parse(text: str, source: str) -> Lines:
        return parse_lines(bare(text), source, known)

    return lambda path: parse(read_text(path, wanted), str(path)), parse


def _mark(hidden: re.Match[str]) -> str:
    """Return what is left of text, an expression and a comment."""
    return {'"': '""', "{": "{}", ";": ""}[hidden[0][0]]


def _commands(line: str) -> Iterator[tuple[int, str]]:
    """Yield number and parameters of the commands M of a line: one line may hold several."""
    found = list(_COMMAND.finditer(line)) if _GCODE.match(line) else []
    ends = [*(match.start() for match in found[1:]), len(line)]
    for match, end in zip(found, ends, strict=False):
        if match[0][0] in "mM" and match[2] is None:
            if int(match[1]) == TEXT:
                return
            yield int(match[1]), line[match.end():end]


def _parameters(body: str, letters: str, where: str) -> dict[str, tuple[float, ...]]:
    """Return letter -> numbers."""
    if "{" in body:
        raise BadInput("an expression in { } stands here, and is not worked out", where,
                       "Write the number that it gives")
    out: dict[str, tuple[float, ...]] = {}
    at = 0
    while body[at:].strip():
        found = _PARAMETER.match(body, at)
        if found is None:
            raise BadInput(f"'{body[at:].strip()[:40]}' is not a letter with a number", where,
                           "Write such as R105.6, and put a `;` before comments")
        letter = found[1].upper()
        if letter not in letters:
            raise unknown("parameter", letter, tuple(letters), where)
        if letter in out:
            raise BadInput(f"{letter} stands twice", where, "Leave one")
        out[letter] = tuple(float(part) for part in found[2].split(":"))
        if not all(abs(v) <= MOST for v in out[letter]):
            raise BadInput(f"'{found[0].strip()[:40]}' is too large", where,
                           "Write decimal numbers")
        at = found.end()
    return out


def words(letters: str, values: Iterable[float]) -> str:
    """Return letters with their numbers, as they follow a command."""
    return "".join(f" {letter}{value:.{DIGITS}f}"
                   for letter, value in zip(letters, values, strict=True))


def two_lines(first: str, second: str, comment: str) -> str:
    """Return M665 and M666 below a comment."""
    return "\n".join([*commented(comment, ";"), first, second]) + "\n"


def with_lines(text: str, source: str, codes: Mapping[int, str], new: str,
               bare: Callable[[str], str] = str) -> str:
    """Return a text with the lines of some commands commented out, and new ones behind the last.

    Args:
        text: of a file.
        source: what messages call it.
        codes: the commands, and their letters.
        new: text whose lines, but comments, take their place.
        bare: a line without what a host shows before it.

    Raises:
        BadInput: none stands there, or one stands in a line with others.
    """
    lines = text.splitlines(keepends=True)
    last = -1
    for at, raw in enumerate(lines):
        here = [code for code, _ in _commands(
            _HIDDEN.sub(_mark, bare(raw)).expandtabs(4).rstrip())]
        if not set(here) & set(codes):
            continue
        if set(here) - set(codes):
            raise BadInput("other commands stand in this line too",
                           f"{source}: line {at + 1}", "Write each into a line of its own")
        last, lines[at] = at, f";{raw}"
    if last < 0:
        raise BadInput("holds none of the lines that change", source,
                       "Leave out --write and paste the lines")
    end = "\r\n" if lines[last].endswith("\r\n") else "\n"
    lines[last] = lines[last].rstrip("\r\n") + end
    own = [line for line in new.splitlines() if not line.startswith(";")]
    lines[last + 1:last + 1] = [f"{line}{end}" for line in own]
    return "".join(lines)
