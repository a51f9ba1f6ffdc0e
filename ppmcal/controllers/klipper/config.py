"""Klipper's ``printer.cfg`` of a linear delta: what it says, and lines to paste into it.

Sections of ``key: value`` or ``key = value`` lines; ``#`` and ``;`` begin comments; lines that
begin with ``#*#`` at the end hold what the printer saved itself. A key that stands in the body as
well, uncommented, is the body's: Klipper strips the saved one. Everything here is in the file's
own units: mm, degrees, microsteps counted down from the endstop.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ppmcal.controllers.delta.geometry import (
    ANGLES,
    DIGITS,
    TOWERS,
    DeltaGeometry,
    Triple,
    above_zero,
    triple,
)
from ppmcal.controllers.klipper.lines import HEADER, TEXT_WANTED, ConfigLine, lines_of, unread
from ppmcal.controllers.text import DECIMAL, commented, read_text
from ppmcal.errors import BadInput
from ppmcal.io.column_names import MISSPELT

BY_HAND = "manual_height"
"""What heights of DELTA_ANALYZE are called, which the nozzle itself touched."""
LARGEST = 1e9
"""mm, degrees, microsteps: no number of a printer is as large."""
OPTIONS = frozenset((
    "delta_radius", "arm_length", "position_endstop", "rotation_distance", "step_distance",
    "full_steps_per_rotation", "microsteps", "upper_arm_length", "lower_arm_length",
    "shoulder_radius", "shoulder_height"))
"""Of geometry and drives: where one is missing, a key that is nearly it is one misspelt."""
_MINE = re.compile(r"printer|stepper_.*|delta_calibrate")


@dataclass(frozen=True)
class ConfigEntry:
    """One value as text, the line that it stands in (from 1), and whether it was autosaved.

    ``source``: the file of that line.
    """

    text: str
    line: int
    saved: bool = False
    source: str = ""


@dataclass(frozen=True)
class Config:
    """A configuration file: section -> key -> entry, as Klipper takes them.

    Attributes:
        includes: files that it includes and that are not followed; files: those that are.
        body: its lines above the ``#*#`` block, included ones in place.
        hidden: section -> key -> saved entry over which one in the body wins.
        unread: why Klipper reads nothing of the ``#*#`` lines, empty where it does.
    """

    source: str
    sections: Mapping[str, Mapping[str, ConfigEntry]]
    includes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    body: tuple[ConfigLine, ...] = ()
    hidden: Mapping[str, Mapping[str, ConfigEntry]] = field(default_factory=dict)
    unread: str = ""

    def as_saved(self) -> Config:
        """Return the file with what the printer saved in front of its body: a result."""
        both = {name: {**keys, **self.hidden.get(name, {})}
                for name, keys in self.sections.items()}
        return replace(self, sections=both)

    def section(self, name: str) -> Mapping[str, ConfigEntry]:
        """Return a section.

        Raises:
            BadInput: it is not there.
        """
        if name not in self.sections:
            more = (f" It may be in {', '.join(self.includes)}, which is not beside it: put the "
                    "file there, or its lines into this one" if self.includes else "")
            raise BadInput(f"there is no section [{name}]", self.source,
                           "Give the printer.cfg of a delta printer, with [printer], [stepper_a], "
                           f"[stepper_b] and [stepper_c].{more}")
        return self.sections[name]

    def at(self, section: str, key: str) -> str:
        """Return the place of a key for messages."""
        entry = self.sections.get(section, {}).get(key)
        line = "" if entry is None else f"line {entry.line}: "
        source = self.source if entry is None else entry.source or self.source
        return f"{source}: {line}[{section}] {key}"

    def numbers(self, section: str, key: str, count: int) -> tuple[float, ...]:
        """Return the ``count`` numbers of a key, separated by commas."""
        entry = self.section(section).get(key)
        if entry is None:
            self._refuse_misspelt(section, key)
            raise BadInput("is missing", self.at(section, key),
                           f"Add a line such as `{key}: 100` to the section")
        parts = [p.strip() for p in entry.text.split(",")]
        good = len(parts) == count and all(DECIMAL.fullmatch(p) for p in parts)
        values = tuple(float(p) for p in parts) if good else ()
        if not good or not all(abs(v) <= LARGEST for v in values):
            raise BadInput(f"'{entry.text[:40]}' is not "
                           + ("a number" if count == 1 else f"{count} numbers"),
                           self.at(section, key),
                           "Write decimal numbers" + (", separated by commas" if count > 1 else ""))
        return values

    def _refuse_misspelt(self, section: str, key: str) -> None:
        """Refuse a section without a key that has nearly that one: its number would not count."""
        others = [k for k in self.section(section) if k not in OPTIONS]
        near = difflib.get_close_matches(key, others, 1, MISSPELT) if key in OPTIONS else []
        if near:
            raise BadInput(f"there is no such option. Did you mean {key}?",
                           self.at(section, near[0]), "Correct its name")

    def number(self, section: str, key: str, default: float | None = None,
               positive: bool = False) -> float:
        """Return one number, ``default`` where the key is absent."""
        if default is not None and key not in self.section(section):
            self._refuse_misspelt(section, key)
            return default
        value = self.numbers(section, key, 1)[0]
        return above_zero(value, self.at(section, key)) if positive else value

    def each(self, key: str, usual: Sequence[float | None] = (None, None, None),
             positive: bool = False) -> Triple:
        """Return a number of each tower; b and c default to a's, as in the firmware."""
        out: list[float] = []
        for tower, default in zip(TOWERS, usual, strict=True):
            known = out[0] if out and default is None else default
            out.append(self.number(f"stepper_{tower}", key, known, positive))
        return triple(out)


def read_config(path: str | os.PathLike[str]) -> Config:
    """Return a configuration file as sections of text.

    Raises:
        BadInput: not a text file, or not of this syntax where it matters.
    """
    return parse_config(read_text(path, TEXT_WANTED), str(path), Path(path))


def parse_config(text: str, source: str, path: Path | None = None) -> Config:
    """Return the sections of ``text``: later values win, and the body over what was saved.

    ``path``: where the file stands, to follow what it includes beside it; None follows nothing.
    """
    lines = lines_of(text, source, path)
    sections = _sections(lines.body)
    hidden: dict[str, dict[str, ConfigEntry]] = {}
    for name, saved in _sections(lines.block, late=True).items():
        own = sections.setdefault(name, {})
        hidden[name] = {key: entry for key, entry in saved.items() if key in own}
        own |= {key: entry for key, entry in saved.items() if key not in own}
    return Config(source, sections, tuple(lines.unknown), tuple(lines.files), tuple(lines.body),
                  hidden, unread(text))


def _sections(lines: Sequence[ConfigLine], late: bool = False) -> dict[str, dict[str, ConfigEntry]]:
    """Return section -> key -> entry of lines; ``late``: they were autosaved."""
    sections: dict[str, dict[str, ConfigEntry]] = {}
    here, key = "", ""
    for raw in lines:
        line = _bare(raw.text)
        if not line.strip():
            continue
        header = HEADER.match(line)
        if header:
            here, key = header[1].strip(), ""
            if here:
                sections.setdefault(here, {})
        elif line[0] in " \t" and here and key:
            old = sections[here][key]
            sections[here][key] = replace(old, text=f"{old.text} {line.strip()}".strip())
        elif here in sections:
            key, value = _pair(line, here, f"{raw.source}: line {raw.number}")
            if key:
                sections[here][key] = ConfigEntry(value, raw.number, late, raw.source)
    return sections


def _bare(line: str) -> str:
    """Return a line without its comment."""
    line = line.partition("#")[0]
    return re.split(r"(?:^|\s);", line, maxsplit=1)[0].rstrip()


def _pair(line: str, section: str, where: str) -> tuple[str, str]:
    """Return key and value; an empty key where other sections hold something else."""
    parts = re.split("[:=]", line, maxsplit=1)
    if len(parts) < 2 or not parts[0].strip():
        if _MINE.fullmatch(section):
            raise BadInput(f"'{line.strip()[:40]}' is not a line of the form `key: value`",
                           f"{where}: [{section}]", "Correct the line, or remove it")
        return "", ""
    return parts[0].strip().lower(), parts[1].strip()


def read_geometry(config: Config) -> DeltaGeometry:
    """Return the delta's numbers; b and c default to a's arm and endstop, as in the firmware."""
    printer = config.section("printer")
    kind = printer.get("kinematics")
    if kind is not None and kind.text != "delta":
        raise BadInput(f"kinematics '{kind.text[:40]}' is not delta",
                       config.at("printer", "kinematics"),
                       "Only linear delta printers are read: `kinematics: delta`")
    radius = config.number("printer", "delta_radius", positive=True)
    angles, arms = config.each("angle", ANGLES), config.each("arm_length", positive=True)
    ends = config.each("position_endstop")
    for tower, arm in zip(TOWERS, arms, strict=True):
        if arm <= radius:
            raise BadInput(f"the arm of tower {tower}, {arm:g} mm, does not reach the middle: "
                           f"delta_radius is {radius:g} mm",
                           config.at(f"stepper_{tower}", "arm_length"),
                           "Check both lengths; arm_length is the longer one")
    return DeltaGeometry(radius, angles, arms, ends)


def read_step(config: Config, name: str) -> float:
    """Return the travel per microstep, mm."""
    if "rotation_distance" not in config.section(name) and "step_distance" in config.section(name):
        return config.number(name, "step_distance", positive=True)
    turn = config.number(name, "rotation_distance", positive=True)
    steps = config.number(name, "full_steps_per_rotation", 200.0, positive=True)
    steps *= config.number(name, "microsteps", positive=True)
    steps = geared(config, name, steps, "57:11, 2:1")
    if not (0.0 < steps < math.inf and turn / steps > 0.0):
        raise BadInput("these numbers give no travel per step", config.at(name, "gear_ratio"),
                       "Check rotation_distance, microsteps and gear_ratio")
    return turn / steps


def geared(config: Config, name: str, steps: float, example: str) -> float:
    """Return steps of a motor's turn as those of what its gears drive, if it has any.

    Raises:
        BadInput: a pair of teeth is none; the hint has ``example``.
    """
    ratio = config.section(name).get("gear_ratio")
    for part in ratio.text.split(",") if ratio is not None and ratio.text else ():
        pair = [p.strip() for p in part.split(":")]
        if len(pair) != 2 or not all(
                DECIMAL.fullmatch(p) and 0.0 < float(p) < math.inf for p in pair):
            raise BadInput(f"'{part.strip()[:40]}' is not a gear ratio",
                           config.at(name, "gear_ratio"), f"Write teeth such as `{example}`")
        steps *= float(pair[0]) / float(pair[1])
    return steps


def read_touches(config: Config, trigger: float = 0.0
                 ) -> tuple[list[tuple[float, ...]], list[tuple[float, ...]], int]:
    """Return what DELTA_CALIBRATE saved: heights and distances, and where carriages were.

    Those heights come last that the nozzle itself touched, and how many these are: those of
    ``DELTA_ANALYZE``, and those of ``METHOD=manual``, which are 0 where a probe's are its
    ``trigger`` height, mm (Klipper: ``delta_calibrate.py``, ``probe.py``).
    """
    probed = read_rows(config, "height", ("pos",))
    own = [row for row in probed if trigger and not row[0]]
    own += read_rows(config, BY_HAND, ("pos",))
    return ([*(row for row in probed if not trigger or row[0]), *own],
            read_rows(config, "distance", ("pos1", "pos2")), len(own))


def moved(rows: Sequence[tuple[float, ...]], step: Sequence[float]) -> list[tuple[float, ...]]:
    """Return rows of a value and microsteps of a, b, c, once or twice, with these as travel."""
    return [(row[0], *(s * step[i % 3] for i, s in enumerate(row[1:]))) for row in rows]


def read_rows(config: Config, what: str, ends: tuple[str, ...]) -> list[tuple[float, ...]]:
    """Return measured value and carriage positions of ``height0``, ``height0_pos``, ..."""
    section = "delta_calibrate"
    keys = config.sections.get(section, {})
    found = (re.fullmatch(rf"{what}(\d{{1,6}})(_.*)?", key) for key in keys)
    out = []
    for i in sorted({int(m[1]) for m in found if m}):
        name = f"{what}{i}"
        for part in (name, *(f"{name}_{e}" for e in ends)):
            if part not in keys:
                other = next(k for k in keys if re.fullmatch(rf"{name}(_.*)?", k))
                raise BadInput(f"'{part}' is missing", config.at(section, other),
                               f"Each {what} needs {name} and "
                               f"{' and '.join(f'{name}_{e}' for e in ends)}; take out the rest")
        row = config.numbers(section, name, 1)
        for end in ends:
            row += config.numbers(section, f"{name}_{end}", 3)
        out.append(row)
    return out


def config_lines(numbers: Mapping[str, float], comment: str = "") -> str:
    """Return the lines to paste into a ``printer.cfg``, of ``section.key`` and value each."""
    lines, section = commented(comment), ""
    for name, value in numbers.items():
        own, _, key = name.partition(".")
        if own != section:
            lines += [""] * bool(section) + [f"[{own}]"]
            section = own
        lines.append(f"{key}: {value:.{DIGITS}f}")
    return "\n".join(lines) + "\n"
