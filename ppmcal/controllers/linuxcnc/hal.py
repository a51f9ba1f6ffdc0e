"""HAL files of LinuxCNC as far as they set the pins of genhexkins, and notes for its INI file.

A line is ``setp pin value`` or ``pin = value``; ``#`` begins a comment, a backslash at the end
joins the next line, later lines win. ``[SECTION]VAR`` and ``$VAR`` stand for values of the INI
file and of the environment, which are not known here (man halcmd; halcmd.c of LinuxCNC).
Lengths are in the unit of ``[TRAJ]LINEAR_UNITS``, mm or inch, which a HAL file does not say.
The pins and their defaults are those of genhexkins.c and genhexkins.h; struts count from 0.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from textwrap import wrap

from ppmcal.controllers.text import DECIMAL, Rounded, read_text
from ppmcal.errors import BadInput

STRUTS = 6
DIGITS = 7
"""Decimals of lengths and unit vectors: 0.1 nm, or 2.5 nm where the unit is the inch."""
FACTOR_DIGITS = 12
Triple = tuple[float, float, float]
Points = tuple[Triple, ...]

_H = 0.707107
BASE_N: Points = ((_H, 0.0, _H), (0.0, -_H, _H), (-_H, 0.0, _H), (-_H, 0.0, _H), (0.0, _H, _H),
                  (_H, 0.0, _H))
"""Axes of the base joints that genhexkins assumes where no pin says otherwise."""
PLATFORM_N: Points = ((-1.0, 0.0, 0.0), (0.866025, 0.5, 0.0), (0.866025, 0.5, 0.0),
                      (0.866025, -0.5, 0.0), (0.866025, -0.5, 0.0), (-1.0, 0.0, 0.0))
GROUPS = ("base", "platform", "base-n", "platform-n")
SCALARS = ("screw-lead", "spindle-offset", "tool-offset")
ITERATION = ("convergence-criterion", "limit-iterations", "max-error")
_PINS = tuple([f"{group}.{n}.{c}" for group in GROUPS for n in range(STRUTS) for c in "xyz"]
              + [*SCALARS, *ITERATION])
_HEAD = "genhexkins."
_LINKS = ("net", "linkps", "linksp", "linkpp")


@dataclass(frozen=True)
class HexapodGeometry(Rounded, digits=DIGITS):
    """What the pins of genhexkins hold, in the machine's length unit.

    Attributes:
        base, platform: joint centres in base and platform axes, one (x, y, z) for each strut.
        base_n, platform_n: unit vectors along the joints' axes, for the lead correction.
        screw_lead: of the actuators' screws, positive for a right-hand thread; 0 for none.
        spindle_offset, tool_offset: added to z of all points.
        iteration: pins that control the forward kinematics, as far as they were set.
    """

    base: Points
    platform: Points
    base_n: Points = BASE_N
    platform_n: Points = PLATFORM_N
    screw_lead: float = 0.0
    spindle_offset: float = 0.0
    tool_offset: float = 0.0
    iteration: tuple[tuple[str, float], ...] = ()

    def rounded(self) -> HexapodGeometry:
        """Return what is left of it after writing and reading."""
        return replace(super().rounded(), iteration=tuple(
            (name, float(f"{v:.12g}")) for name, v in self.iteration))


@dataclass(frozen=True)
class Joint(Rounded, digits=DIGITS):
    """What changes in one [JOINT_n] section of the INI file.

    With j a joint position under the present section, the new one is stretch j + shift. So
    HOME_OFFSET, HOME, MIN_LIMIT and MAX_LIMIT become stretch times what they are plus shift, and
    SCALE (counts for one unit of travel) is divided by stretch. ``home``: the joint position at
    the model's home pose. ``shift`` and ``home`` are in the machine's length unit.
    """

    home: float
    stretch: float = 1.0
    shift: float = 0.0

    def rounded(self) -> Joint:
        """Return what is left of it after writing and reading."""
        return replace(super().rounded(), stretch=round(self.stretch, FACTOR_DIGITS))


@dataclass(frozen=True)
class Hal:
    """A HAL file: pin -> (value, line); pins that signals drive; files that it sources."""

    source: str
    pins: Mapping[str, tuple[float, int]]
    linked: Mapping[str, int] = field(default_factory=dict)
    sourced: tuple[str, ...] = ()


def read_hal(path: str | os.PathLike[str]) -> Hal:
    """Return the genhexkins pins that a HAL file sets.

    Raises:
        BadInput: not a text file, or a line on these pins that cannot be read.
    """
    return parse_hal(read_text(path, "Give a HAL file, such as kinematics.hal"), str(path))


def parse_hal(text: str, source: str) -> Hal:
    """Return the genhexkins pins that ``text`` sets."""
    pins: dict[str, tuple[float, int]] = {}
    linked: dict[str, int] = {}
    sourced: list[str] = []
    for number, line in _statements(text):
        words = line.replace('"', " ").replace("'", " ").split()
        if words and words[0].lower() == "source":
            sourced += words[1:]
        mine = [w.lower() for w in words if w.lower().startswith(_HEAD)]
        if not mine:
            continue
        if words[0].lower() in _LINKS:
            linked |= {pin.removeprefix(_HEAD): number for pin in mine}
        elif words[0].lower() in mine or (words[0].lower() == "setp" and words[1].lower() in mine):
            pin, value = _setting(words, f"{source}: line {number}")
            pins[pin] = (value, number)
    return Hal(source, pins, linked, tuple(sourced))


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line, continued ones joined, without comments."""
    start, held = 0, ""
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        start = start or number
        held += line
        if held.endswith("\\") and number < len(lines):
            held = held[:-1] + " "
            continue
        yield start, held.partition("#")[0].strip().rstrip("\\")
        start, held = 0, ""


def _setting(words: Sequence[str], where: str) -> tuple[str, float]:
    """Return pin and value of the words of one line."""
    parts = [w for w in words if w != "="]
    parts = parts[1:] if parts[0].lower() == "setp" else parts
    if len(parts) != 2:
        raise BadInput(f"'{' '.join(words)[:60]}' is not of the form `setp pin value`", where,
                       "Correct the line, or remove it")
    pin = parts[0].lower().removeprefix(_HEAD)
    if any(c in "$[" for c in "".join(parts)):
        raise BadInput(f"'{parts[1][:40]}' stands for a value that is not in this file", where,
                       f"Put the number itself behind {_HEAD}{pin[:40]}")
    if pin not in _PINS:
        near = difflib.get_close_matches(pin, _PINS, 1, 0.6)
        raise BadInput(f"genhexkins has no pin '{pin[:40]}' to set", where,
                       f"Its points are {_HEAD}base.N.x to {_HEAD}platform.N.z, N from 0 to 5."
                       + (f" Did you mean '{_HEAD}{near[0]}'?" if near else ""))
    return pin, _decimal(parts[1], f"{where}: {_HEAD}{pin}")


def read_geometry(hal: Hal) -> HexapodGeometry:
    """Return the pins as a geometry; all 36 coordinates must be set.

    Raises:
        BadInput: a coordinate is missing, or a signal drives it.
    """
    driven = [pin for pin in hal.linked if pin.startswith(GROUPS) or pin == "screw-lead"]
    if driven:
        raise BadInput(f"a signal drives {_HEAD}{driven[0]}, so its value is not in this file",
                       f"{hal.source}: line {hal.linked[driven[0]]}",
                       "Give a file that sets the pins with `setp`")
    missing = [p for p in _PINS[:2 * 3 * STRUTS] if p not in hal.pins]
    if missing:
        more = f" and {len(missing) - 1} more are" if len(missing) > 1 else " is"
        follow = (f" What `source {hal.sourced[0][:60]}` brings is not followed: give that file, "
                  "or put its lines here." if hal.sourced else "")
        raise BadInput(f"{_HEAD}{missing[0]}{more} not set", hal.source,
                       f"Set all 36 coordinates, such as `setp {_HEAD}{missing[0]} 12.5`; the "
                       f"defaults are those of another machine.{follow}")

    def points(group: str, default: Points) -> Points:
        return tuple((of(f"{group}.{n}.x", p[0]), of(f"{group}.{n}.y", p[1]),
                      of(f"{group}.{n}.z", p[2])) for n, p in enumerate(default))

    def of(pin: str, default: float = 0.0) -> float:
        return hal.pins.get(pin, (default, 0))[0]

    return HexapodGeometry(
        points("base", BASE_N),
        points("platform", BASE_N),
        points("base-n", BASE_N),
        points("platform-n", PLATFORM_N),
        of("screw-lead"),
        of("spindle-offset"),
        of("tool-offset"),
        tuple((p, of(p)) for p in ITERATION if p in hal.pins),
    )


def pins(geometry: HexapodGeometry) -> dict[str, float]:
    """Return pin name -> value of the 36 coordinates, strut by strut."""
    return {f"{_HEAD}{group}.{n}.{c}": v for n in range(STRUTS)
            for group, points in (("base", geometry.base), ("platform", geometry.platform))
            for c, v in zip("xyz", points[n], strict=True)}


def format_hal(geometry: HexapodGeometry, names: Sequence[str], comment: str = "") -> str:
    """Return the HAL file that sets the pins; ``names``: of the struts."""
    lines = _comments(comment)
    values = {pin: f"{v:.{DIGITS}f}" for pin, v in pins(geometry).items()}
    for n, name in enumerate(names):
        lines += ["", *_comments(f"strut {n}: {name}"),
                  *(f"setp {pin} {v}" for pin, v in values.items() if pin.split(".")[2] == str(n))]
    axes = (("base-n", geometry.base_n), ("platform-n", geometry.platform_n))
    if geometry.screw_lead or axes != (("base-n", BASE_N), ("platform-n", PLATFORM_N)):
        lines += ["", "# axes of the joints, for screws that turn with them",
                  *(f"setp {_HEAD}{group}.{n}.{c} {v:.{DIGITS}f}" for group, points in axes
                    for n, point in enumerate(points) for c, v in zip("xyz", point, strict=True))]
    scalars = (geometry.screw_lead, geometry.spindle_offset, geometry.tool_offset)
    rest = [f"setp {_HEAD}{pin} {v:.{DIGITS}f}" for pin, v in zip(SCALARS, scalars, strict=True)
            if v]
    rest += [f"setp {_HEAD}{pin} {v:.12g}" for pin, v in geometry.iteration]
    return "\n".join([*lines, *([""] if rest else []), *rest]) + "\n"


def format_joints(joints: Sequence[Joint], names: Sequence[str], comment: str = "") -> str:
    """Return notes on the INI file: one section for each joint, every line a comment."""
    lines = _comments(comment)
    for n, (joint, name) in enumerate(zip(joints, names, strict=True)):
        lines += ["", f"[JOINT_{n}]", *_comments(f"strut {n}: {name}")]
        times = "" if joint.stretch == 1.0 else f" * {joint.stretch:.{FACTOR_DIGITS}f}"
        if times:
            lines.append(f"# SCALE = present / {joint.stretch:.{FACTOR_DIGITS}f}")
        if times or joint.shift != 0.0:
            change = f"present{times} {'+-'[joint.shift < 0.0]} {abs(joint.shift):.{DIGITS}f}"
            lines += [f"# {key} = {change}" for key in ("HOME_OFFSET", "MIN_LIMIT", "MAX_LIMIT")]
        lines.append(f"# HOME = {joint.home:.{DIGITS}f}")
    return "\n".join(lines) + "\n"


def parse_joints(text: str, source: str) -> tuple[Joint, ...]:
    """Return the joints of notes that :func:`format_joints` wrote, in the order of their number.

    Raises:
        BadInput: a section without a home, out of turn, or with what is not a number.
    """
    out = []
    parts = re.split(r"^\[JOINT_([^]\n]*)\]$", text, flags=re.MULTILINE)
    for n, (number, part) in enumerate(zip(parts[1::2], parts[2::2], strict=True)):
        where = f"{source}: [JOINT_{number[:20]}]"
        if number != str(n):
            raise BadInput(f"joint {n} is to stand here", where,
                           "Write one section for each joint, from 0 on")
        home = re.search(r"^# HOME = (\S+)$", part, re.MULTILINE)
        change = re.search(r"^# HOME_OFFSET = present(?: \* (\S+))? ([+-]) (\S+)$", part,
                           re.MULTILINE)
        if home is None:
            raise BadInput("HOME is missing", where, "Write `# HOME = ` and a number")
        at = _decimal(home[1], f"{where}: HOME")
        offset = f"{where}: HOME_OFFSET"
        out.append(Joint(at) if change is None else
                   Joint(at, _decimal(change[1] or "1", offset),
                         _decimal(change[2] + change[3], offset)))
    return tuple(out)


def _decimal(text: str, where: str) -> float:
    """Return a finite decimal number."""
    value = float(text) if DECIMAL.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise BadInput(f"'{text[:40]}' is not a number", where, "Write a decimal number")
    return value


def _comments(text: str) -> list[str]:
    """Return text as comment lines.

    halcmd reads 1024 characters at a time, and a backslash at the end joins the next line.
    """
    return [f"# {part}".rstrip("\\ ") for line in text.splitlines() for part in wrap(line, 96)]
