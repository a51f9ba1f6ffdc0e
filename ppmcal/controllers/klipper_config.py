"""Klipper's ``printer.cfg`` of a linear delta: what it says, and lines to paste into it.

Sections of ``key: value`` or ``key = value`` lines; ``#`` and ``;`` begin comments; lines that
begin with ``#*#`` at the end hold what the printer saved itself, and win. Everything here is in
the file's own units: mm, degrees, microsteps counted down from the endstop.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ppmcal.errors import BadInput
from ppmcal.io.input_files import read_bytes
from ppmcal.io.limits import CONFIG_BYTES

TOWERS = ("a", "b", "c")
LARGEST = 1e9
"""mm, degrees, microsteps: no number of a printer is as large."""
SMALLEST = 1e-6
"""None that has to be above 0 is as small."""
ANGLES = (210.0, 330.0, 90.0)
DIGITS = 6
"""Decimals of what is written, as many as the firmware saves itself."""
SAVED = "#*#"
_NUMBER = re.compile(r"[-+]?(\d+(?:\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_MINE = re.compile(r"printer|stepper_.*|delta_calibrate")
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class ConfigEntry:
    """One value as text, the line that it stands in (from 1), and whether it was autosaved."""

    text: str
    line: int
    saved: bool = False


@dataclass(frozen=True)
class Config:
    """A configuration file: section -> key -> entry; ``includes`` are not followed.

    ``text``: the whole file.
    """

    source: str
    sections: Mapping[str, Mapping[str, ConfigEntry]]
    includes: tuple[str, ...] = ()
    text: str = ""

    def section(self, name: str) -> Mapping[str, ConfigEntry]:
        """Return a section.

        Raises:
            BadInput: it is not there.
        """
        if name not in self.sections:
            more = (f" It may be in {', '.join(self.includes)}, which is not followed: put its "
                    "lines into this file" if self.includes else "")
            raise BadInput(f"there is no section [{name}]", self.source,
                           "Give the printer.cfg of a delta printer, with [printer], [stepper_a], "
                           f"[stepper_b] and [stepper_c].{more}")
        return self.sections[name]

    def at(self, section: str, key: str) -> str:
        """Return the place of a key for messages."""
        entry = self.sections.get(section, {}).get(key)
        line = "" if entry is None else f"line {entry.line}: "
        return f"{self.source}: {line}[{section}] {key}"

    def numbers(self, section: str, key: str, count: int) -> tuple[float, ...]:
        """Return the ``count`` numbers of a key, separated by commas."""
        entry = self.section(section).get(key)
        if entry is None:
            raise BadInput("is missing", self.at(section, key),
                           f"Add a line such as `{key}: 100` to the section")
        parts = [p.strip() for p in entry.text.split(",")]
        good = len(parts) == count and all(_NUMBER.fullmatch(p) for p in parts)
        values = tuple(float(p) for p in parts) if good else ()
        if not good or not all(abs(v) <= LARGEST for v in values):
            raise BadInput(f"'{entry.text[:40]}' is not {_count(count)}", self.at(section, key),
                           "Write decimal numbers" + (", separated by commas" if count > 1 else ""))
        return values

    def number(self, section: str, key: str, default: float | None = None,
               positive: bool = False) -> float:
        """Return one number, ``default`` where the key is absent."""
        if default is not None and key not in self.section(section):
            return default
        value = self.numbers(section, key, 1)[0]
        if positive and value <= 0.0:
            raise BadInput(f"{value:g} is not above 0", self.at(section, key),
                           "Write the value that the printer has")
        if positive and value < SMALLEST:
            raise BadInput(f"{value:g} is too small to be true", self.at(section, key),
                           "Write the value that the printer has")
        return value


def _count(count: int) -> str:
    return "a number" if count == 1 else f"{count} numbers"


@dataclass(frozen=True)
class DeltaGeometry:
    """The numbers of Klipper's delta kinematics: mm and degrees; triples are towers a, b, c."""

    radius: float
    angles: Triple
    arms: Triple
    endstops: Triple

    def rounded(self) -> DeltaGeometry:
        """Return what is left of it after writing and reading."""
        def cut(v: Triple) -> Triple:
            return round(v[0], DIGITS), round(v[1], DIGITS), round(v[2], DIGITS)

        return DeltaGeometry(round(self.radius, DIGITS), cut(self.angles), cut(self.arms),
                        cut(self.endstops))


def read_config(path: str | os.PathLike[str]) -> Config:
    """Return a configuration file as sections of text.

    Raises:
        BadInput: not a text file, or not of this syntax where it matters.
    """
    data = read_bytes(Path(path), CONFIG_BYTES)
    if b"\0" in data:
        raise BadInput("is not a text file", str(path), "Give the printer.cfg of a printer")
    return parse_config(data.decode("utf-8-sig", errors="replace"), str(path))


def parse_config(text: str, source: str) -> Config:
    """Return the sections of ``text``; later values win, and the autosaved ones last."""
    sections: dict[str, dict[str, ConfigEntry]] = {}
    includes: list[str] = []
    lines = list(enumerate(text.splitlines(), 1))
    plain = [(n, line, False) for n, line in lines if not line.startswith(SAVED)]
    saved = [(n, line[4:], True) for n, line in lines if line.startswith(SAVED)]
    here, key, at_saved = "", "", False
    for n, raw, late in plain + saved:
        if late and not at_saved:
            here, key, at_saved = "", "", True
        line = _bare(raw)
        if not line.strip():
            continue
        header = re.match(r"\[([^]]*)\]", line)
        if header:
            here, key = header[1].strip(), ""
            if here.startswith("include "):
                includes.append(here.removeprefix("include ").strip())
            else:
                sections.setdefault(here, {})
        elif line[0] in " \t" and here and key:
            old = sections[here][key]
            sections[here][key] = ConfigEntry(f"{old.text} {line.strip()}".strip(), old.line, late)
        elif here in sections:
            key, value = _pair(line, here, f"{source}: line {n}")
            if key:
                sections[here][key] = ConfigEntry(value, n, late)
    return Config(source, sections, tuple(includes), text)


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
                           f"{where}: [{section}]", "Mend the line, or take it out")
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
    arms: list[float] = []
    ends: list[float] = []
    angles: list[float] = []
    for i, tower in enumerate(TOWERS):
        name = f"stepper_{tower}"
        angles.append(config.number(name, "angle", ANGLES[i]))
        arms.append(config.number(name, "arm_length", arms[0] if arms else None, positive=True))
        ends.append(config.number(name, "position_endstop", ends[0] if ends else None))
        if arms[i] <= radius:
            raise BadInput(f"the arm of tower {tower}, {arms[i]:g} mm, does not reach the middle: "
                           f"delta_radius is {radius:g} mm", config.at(name, "arm_length"),
                           "Check both lengths; arm_length is the longer one")
    return DeltaGeometry(radius, (angles[0], angles[1], angles[2]), (arms[0], arms[1], arms[2]),
                    (ends[0], ends[1], ends[2]))


def read_step(config: Config, name: str) -> float:
    """Return the travel per microstep, mm."""
    if "rotation_distance" not in config.section(name) and "step_distance" in config.section(name):
        return config.number(name, "step_distance", positive=True)
    turn = config.number(name, "rotation_distance", positive=True)
    steps = config.number(name, "full_steps_per_rotation", 200.0, positive=True)
    steps *= config.number(name, "microsteps", positive=True)
    ratio = config.section(name).get("gear_ratio")
    for part in ratio.text.split(",") if ratio is not None and ratio.text else ():
        pair = [p.strip() for p in part.split(":")]
        if len(pair) != 2 or not all(_NUMBER.fullmatch(p) and float(p) > 0.0 for p in pair):
            raise BadInput(f"'{part.strip()[:40]}' is not a gear ratio",
                           config.at(name, "gear_ratio"), "Write teeth such as `57:11, 2:1`")
        steps *= float(pair[0]) / float(pair[1])
    if not (0.0 < steps < math.inf and turn / steps > 0.0):
        raise BadInput("these numbers give no travel per step", config.at(name, "gear_ratio"),
                       "Check rotation_distance, microsteps and gear_ratio")
    return turn / steps


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


def format_geometry(geometry: DeltaGeometry, comment: str = "") -> str:
    """Return the lines to paste into a ``printer.cfg``."""
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    lines += ["[printer]", f"delta_radius: {geometry.radius:.{DIGITS}f}"]
    for i, tower in enumerate(TOWERS):
        lines += ["", f"[stepper_{tower}]", f"angle: {geometry.angles[i]:.{DIGITS}f}",
                  f"arm_length: {geometry.arms[i]:.{DIGITS}f}",
                  f"position_endstop: {geometry.endstops[i]:.{DIGITS}f}"]
    return "\n".join(lines) + "\n"
