"""RepRapFirmware's ``config.g`` of a linear delta: what M665 and M666 say, and lines like them.

``M665 L R H B X Y Z``: rods, delta radius, height of the nozzle at the endstops, printable radius,
mm, and how far towers X, Y, Z stand from 210, 330 and 90 deg, counted against the clock from
above. ``M666 X Y Z A B``: how much higher than H each endstop is, mm, and how far the bed rises
along x and y, percent. Each letter keeps its value until a later line gives another. Letters are
read in any case and order, ``;`` begins a comment, quotes hold text.

Sources: RepRapFirmware, ``LinearDeltaKinematics.cpp`` (Configure, WriteCalibrationParameters) and
``StringParser.cpp`` (DecodeCommand); the firmware's G-code dictionary, M665 and M666.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ppmcal.controllers.delta.geometry import Triple, above_zero, rounded
from ppmcal.errors import BadInput, unknown
from ppmcal.limits import CONFIG_BYTES
from ppmcal.store.inputs import read_bytes

DIGITS = 4
"""Decimals of what is written: what single precision holds of 500 mm, in one line of below 100
characters, which is all that older firmware takes. M500 itself saves 3."""
LETTERS = {665: "LRHBXYZ", 666: "XYZAB"}
STEEP = 50.0
"""No bed is tilted by more, percent."""
ELSEWHERE = (98, 501)
"""Commands that run other files, where these numbers may stand, too."""
MOST = 1e6
"""Larger numbers, mm, degrees or percent, are none of a printer's."""
TEXT = 117
"""The command whose text is not quoted."""
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_PARAMETER = re.compile(rf"\s*([A-Za-z])\s*({_NUMBER}(?::{_NUMBER})*)(?![\d.:])", re.ASCII)
_COMMAND = re.compile(r"[GM](\d{1,9})(\.\d)?", re.ASCII | re.IGNORECASE)
_GCODE = re.compile(r"\s*(N\d+\s*)?[GMT]", re.ASCII | re.IGNORECASE)
_WORD = re.compile(r"\s*([a-z]{2,8})(?=[\s{\"(]|$)", re.ASCII)
_HIDDEN = re.compile(r'"[^"]*"?|\{[^}]*\}?|;.*')


@dataclass(frozen=True)
class Delta:
    """The numbers of RepRapFirmware's linear delta; triples are towers X, Y, Z.

    Attributes:
        radius: M665 R, mm; rods: M665 L, mm; height: M665 H, mm.
        angles: M665 X, Y, Z, degrees from 210, 330 and 90.
        endstops: M666 X, Y, Z, mm above H.
        tilt: M666 A and B, percent.
        bed: M665 B, mm, None where nothing says.
    """

    radius: float
    rods: Triple
    height: float
    angles: Triple = (0.0, 0.0, 0.0)
    endstops: Triple = (0.0, 0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    bed: float | None = None

    def rounded(self) -> Delta:
        """Return what is left of it after writing and reading."""
        return rounded(self, DIGITS)


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


def read_lines(path: str | os.PathLike[str]) -> Lines:
    """Return what a ``config.g`` or ``config-override.g`` says of the delta.

    Raises:
        BadInput: not a text file, or an M665 or M666 that cannot be read.
    """
    data = read_bytes(Path(path), CONFIG_BYTES)
    if b"\0" in data:
        raise BadInput("is not a text file", str(path), "Give the config.g of a printer")
    return parse_lines(data.decode("utf-8-sig", errors="replace"), str(path))


def parse_lines(text: str, source: str, known: Mapping[int, str] = LETTERS) -> Lines:
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


def read_delta(lines: Lines) -> Delta:
    """Return the delta's numbers; what is 0 in the firmware when nobody says is 0 here.

    Raises:
        BadInput: L, R or H is missing, or they make no delta of three towers.
    """
    if not any(name.startswith("M665") for name in lines.values):
        more = ", ".join(f"line {n} runs {command}" for n, command in lines.elsewhere)
        raise BadInput("there is no M665 with numbers", lines.source, "Give the config.g or "
                       "config-override.g of a linear delta"
                       + (f"; {more}, which is not followed" if more else ""))
    radius = lines.number("M665 R", positive=True)
    rods = _rods(lines)
    for i, rod in enumerate(rods):
        if rod <= radius:
            raise BadInput(f"the rod of tower {'XYZ'[i]}, {rod:g} mm, does not reach the middle: "
                           f"R is {radius:g} mm", lines.at("M665 L"),
                           "Check both lengths; L is the longer one")
    tilt = lines.number("M666 A", 0.0), lines.number("M666 B", 0.0)
    for letter, percent in zip("AB", tilt, strict=True):
        if abs(percent) > STEEP:
            raise BadInput(f"the bed rises by {percent:g} %", lines.at(f"M666 {letter}"),
                           f"Write at most {STEEP:g}: 1 is 1 mm on 100 mm")
    bed = lines.number("M665 B", positive=True) if "M665 B" in lines.values else None
    return Delta(radius, rods, lines.number("M665 H"), _triple(lines, "M665"),
                 _triple(lines, "M666"), tilt, bed)


def _rods(lines: Lines) -> Triple:
    value = lines.values.get("M665 L")
    if value is None or len(value.numbers) == 1:
        rod = lines.number("M665 L", positive=True)
        return rod, rod, rod
    if len(value.numbers) != 3:
        raise BadInput(f"{len(value.numbers)} rods stand here", lines.at("M665 L"),
                       "Write one for all, or three: deltas of three towers are read")
    return value.numbers[0], value.numbers[1], value.numbers[2]


def _triple(lines: Lines, command: str) -> Triple:
    x, y, z = (lines.number(f"{command} {letter}", 0.0) for letter in "XYZ")
    return x, y, z


def format_delta(delta: Delta, comment: str = "") -> str:
    """Return M665 and M666 as M500 writes them, with every letter that another line could set.

    Rods that are equal are one number, as firmware before 2.03 wants it.
    """
    def words(letters: str, values: tuple[float, ...]) -> str:
        return "".join(f" {letter}{value:.{DIGITS}f}"
                       for letter, value in zip(letters, values, strict=True))

    delta = delta.rounded()
    rods = delta.rods[:1] if len(set(delta.rods)) == 1 else delta.rods
    first = (f"M665 L{':'.join(f'{rod:.{DIGITS}f}' for rod in rods)}"
             + words("RH", (delta.radius, delta.height))
             + ("" if delta.bed is None else words("B", (delta.bed,)))
             + words("XYZ", delta.angles))
    second = "M666" + words("XYZAB", (*delta.endstops, *delta.tilt))
    lines = [f"; {line}".rstrip() for line in comment.splitlines()]
    return "\n".join([*lines, first, second]) + "\n"
