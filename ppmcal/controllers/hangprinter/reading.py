"""Samples of a Hangprinter's auto-calibration, as JSON lines or arrays of scripts, and its M669.

``M669 A0:-1600:-120 B... C... D...``: x, y, z of each anchor, mm; of older firmware D is a height
alone. ``M666 Q R U O L H``: line build-up, mm^2 per mm of line; spool radii at the origin, mm;
mechanical advantages; lines per spool; teeth of motor and spool gears. With the spool turned by
theta as it pays out, its radius is R - Q O theta / 2, and the head's line is longer by the integral
of that, by U: (R theta - Q O theta^2 / 4) / U.

Sources: RepRapFirmware, ``HangprinterKinematics.cpp`` (Configure, Recalc, MotorPosToLinePos).
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.controllers.text import NUMBER, read_text
from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.wording import pluralize

NAMES = "ABCDI"
"""Anchors in the firmware's order; the fifth is that of the fifth version."""
DECIMALS = 2
"""Of what is written: M669 keeps as many, and lines stay short."""
FARTHEST = 1e5
"""No anchor is farther away, mm."""
LEAST, LARGEST_BUILDUP = 0.01, 10.0
"""No radius, mm, advantage or tooth count is less, and no line builds up by more."""
_LETTER = re.compile(rf"([A-Z])\s*({NUMBER}(?:\s*:\s*{NUMBER})*)", re.ASCII | re.IGNORECASE)
_LINE = re.compile(r"^[ \t]*M(669|666)\b([^;\n]*)", re.ASCII | re.MULTILINE | re.IGNORECASE)
_SPOOLS = {"Q": "buildup", "R": "radius", "U": "advantage", "O": "lines", "L": "motor_teeth",
           "H": "spool_teeth"}
_CONFIG = {"spool_buildup_factor": "buildup", "spool_r": "radius", "spool_r_in_origin": "radius",
           "mechanical_advantage": "advantage", "lines_per_spool": "lines",
           "motor_gear_teeth": "motor_teeth", "spool_gear_teeth": "spool_teeth"}
"""What JSON lines call the same."""


@dataclass(frozen=True)
class Spools:
    """What turns motor positions into line positions; one number for all lines, or one for each.

    The values are those of the fourth version.
    """

    buildup: tuple[float, ...] = (0.007,)
    radius: tuple[float, ...] = (75.0,)
    advantage: tuple[float, ...] = (2.0, 2.0, 2.0, 2.0, 4.0)
    lines: tuple[float, ...] = (1.0,)
    motor_teeth: tuple[float, ...] = (20.0,)
    spool_teeth: tuple[float, ...] = (255.0,)

    def line_positions(self, motors: Array) -> Array:
        """Return line positions (N, k), mm, of motor positions (N, k), degrees."""
        k = motors.shape[1]
        q, r, u, o, small, large = (
            np.array([values[min(i, len(values) - 1)] for i in range(k)]) for values in (
                self.buildup, self.radius, self.advantage, self.lines, self.motor_teeth,
                self.spool_teeth))
        turned = np.radians(motors) * small / large
        return np.asarray(turned * (r - q * o * turned / 4.0) / u)


@dataclass(frozen=True)
class HangprinterConfig:
    """What a ``config.g`` says: anchors by letter, mm, and spools, None where M666 is missing."""

    anchors: Mapping[str, tuple[float, ...]]
    spools: Spools | None

    def matrix(self, source: str) -> Array:
        """Return the anchors (k, 3), mm.

        Raises:
            BadInput: one of the first four is missing, or has other than three numbers.
        """
        letters = [name for name in NAMES if name in self.anchors]
        if missing := [name for name in NAMES[:4] if name not in letters]:
            raise BadInput(f"M669 has no {' and no '.join(missing)}", source,
                           "Give the machine's config.g, with a line such as M669 "
                           "A0:-1600:-120 B1300:1250:-160 C-1400:750:-150 D20:10:2350")
        for name in letters:
            place = self.anchors[name]
            if len(place) != 3 or max(map(abs, place)) > FARTHEST:
                raise BadInput(f"M669 {name} is not x:y:z in mm", source,
                               f"Write three numbers up to {FARTHEST:g}, such as "
                               f"{name}0:-1600:-120")
        return np.array([self.anchors[name] for name in letters])


def parse_config(text: str, source: str) -> HangprinterConfig:
    """Return what M669 and M666 of a text say; a letter keeps its value until another line.

    Raises:
        BadInput: a number of M666 that no spool has.
    """
    said: dict[str, dict[str, tuple[float, ...]]] = {"669": {}, "666": {}}
    for number, rest in _LINE.findall(text):
        for letter, words in _LETTER.findall(rest):
            said[number][letter.upper()] = tuple(float(w) for w in words.split(":"))
    anchors = {name: (0.0, 0.0, *place) if name == "D" and len(place) == 1 else place
               for name, place in said["669"].items() if name in NAMES}
    found = {_SPOOLS[name]: _spool(f"M666 {name}", _SPOOLS[name], values, source)
             for name, values in said["666"].items() if name in _SPOOLS}
    return HangprinterConfig(anchors, replace(Spools(), **found) if found else None)


def spools_of(config: Mapping[str, Any], where: str) -> Spools | None:
    """Return the spools that a JSON object says, None where it says nothing.

    Raises:
        BadInput: a number is missing or not above 0.
    """
    found: dict[str, tuple[float, ...]] = {}
    for name, value in config.items():
        if name not in _CONFIG or value is None:
            continue
        values = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        found[_CONFIG[name]] = _spool(name, _CONFIG[name], values, where)
    return replace(Spools(), **found) if found else None


def _spool(name: str, kind: str, given: Sequence[Any], where: str) -> tuple[float, ...]:
    """Return the numbers of spools, one or one for each line.

    Raises:
        BadInput: they are none that a spool has.
    """
    try:
        values = tuple(float(v) for v in given)
    except (TypeError, ValueError, OverflowError):
        values = ()
    least, most = (0.0, LARGEST_BUILDUP) if kind == "buildup" else (LEAST, FARTHEST)
    if not values or not all(least <= v <= most for v in values):
        raise BadInput(f"{name} is not a number from {least:g} to {most:g}", where,
                       "Write what the machine's M666 has")
    return values


MOTORS = ("motor_samples", "motor_pos_samp")
"""Motor positions in degrees, what JSON and what scripts call them."""
LINES = ("line_samples", "samp")
"""Line positions in mm."""
PLACES = ("real_xyz", "xyz_of_samp")
"""Measured places of the first samples, mm."""
ORIGIN = ("line_lengths_when_at_origin", "line_lengths_origin")
"""Line lengths with the nozzle at the origin, mm."""
MOST_TURNS = 1e7
"""No motor position is larger, degrees."""
_ARRAY = re.compile(r"^[ \t]*(\w+)\s*=\s*(?:np\.array\s*\(\s*)?(?=[\[(])", re.MULTILINE)
_HINT = ('Give JSON lines with "motor_samples": [[...], ...] in degrees, or arrays such as '
         "motor_pos_samp = [[...], ...] or samp = [[...], ...]")


@dataclass(frozen=True, eq=False)
class Samples:
    """One set of samples.

    Attributes:
        where: it stands in the file.
        motors: motor positions, degrees, or line positions, mm (N, k).
        turned: whether they are motor positions.
        places: measured places of the first n samples (n, 3), mm.
        anchors: about where anchors are (k, 3), mm; None where it does not say.
        lengths: line lengths at the origin (k,), mm, None likewise.
        spools: None likewise.
    """

    where: str
    motors: Array
    turned: bool
    places: Array
    anchors: Array | None = None
    lengths: Array | None = None
    spools: Spools | None = None


def read_samples(path: Path) -> list[Samples]:
    """Return the sets of samples of a file, all of as many lines.

    Raises:
        BadInput: it holds none, or what is wrong in one of them.
    """
    text = read_text(path)
    found = (_json_lines(text, path) if text.lstrip().startswith("{")
             else _script(text, str(path)))
    sizes = {one.motors.shape[1] for one in found}
    if len(sizes) > 1:
        raise BadInput(f"sets of samples are of {' and '.join(map(str, sorted(sizes)))} lines",
                       str(path), "Put each machine's samples into a file of their own")
    return found


def _json_lines(text: str, path: Path) -> list[Samples]:
    out = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        where = f"{path}: line {number}"
        try:
            tree = json.loads(line)
        except (ValueError, RecursionError):
            raise BadInput("is not one JSON object", where, _HINT) from None
        if not isinstance(tree, dict):
            raise BadInput("is not one JSON object", where, _HINT)
        config = {**_mapping(tree.get("config")), **_mapping(tree.get("config_used"))}
        out.append(_samples(tree, where, f"line {number}", spools_of(config, where)))
    return out


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _script(text: str, source: str) -> list[Samples]:
    """Return the set of samples of a script's arrays, the last of each name."""
    known: dict[str, Any] = {}
    for match in _ARRAY.finditer(text):
        if match[1] in (*MOTORS, *LINES, *PLACES, *ORIGIN, "anchors"):
            try:
                known[match[1]] = ast.literal_eval(_balanced(text[match.end():]))
            except (ValueError, SyntaxError, RecursionError, MemoryError):
                raise BadInput("is no array of numbers", f"{source}: {match[1]}",
                               "Write numbers in brackets: [[1.0, 2.0, 3.0, 4.0], ...]") from None
    return [_samples(known, source, "its arrays", None)]


def _balanced(text: str) -> str:
    """Return the bracketed part that a text begins with, without comments."""
    depth, out = 0, []
    for line in text.splitlines():
        for sign in line.partition("#")[0]:
            out.append(sign)
            depth += (sign in "[(") - (sign in "])")
            if not depth:
                return "".join(out)
        out.append("\n")
    raise ValueError("never closed")


def _samples(tree: Mapping[str, Any], where: str, name: str, spools: Spools | None) -> Samples:
    turned = next((key for key in MOTORS if tree.get(key) not in (None, [])), "")
    key = turned or next((key for key in LINES if tree.get(key) not in (None, [])), "")
    if not key:
        raise BadInput("holds no samples of motors or lines", where, _HINT)
    motors = _matrix(tree[key], where, key, MOST_TURNS if turned else FARTHEST)
    k = motors.shape[1]
    if not 4 <= k <= len(NAMES):
        raise BadInput(f"samples of {pluralize(k, 'line')} are not those of a Hangprinter in space",
                       f"{where}: {key}", "Four lines (A, B, C, D) or five (and I) hold the head")
    places = _part(tree, PLACES, where, 3)
    if places is not None and len(places) > len(motors):
        raise BadInput(f"{len(places)} places were measured of {len(motors)} samples", where,
                       "The first place belongs to the first sample, and so on")
    anchors, lengths = (_part(tree, names, where, size) for names, size in (
        (("anchors",), 3), (ORIGIN, k)))
    if anchors is not None and len(anchors) != k:
        raise BadInput(f"{len(anchors)} anchors do not hold {k} lines", f"{where}: anchors",
                       "Give one x, y, z for each line")
    return Samples(name, motors, bool(turned), np.zeros((0, 3)) if places is None else places,
                   anchors, None if lengths is None else lengths[0], spools)


def _part(tree: Mapping[str, Any], names: tuple[str, ...], where: str, width: int) -> Array | None:
    key = next((key for key in names if tree.get(key) not in (None, [])), "")
    if not key:
        return None
    out = _matrix(tree[key], where, key, FARTHEST)
    if out.shape[1] != width:
        raise BadInput(f"rows have {out.shape[1]} numbers, not {width}", f"{where}: {key}",
                       "Write them as the machine's own script has them")
    return out


def _matrix(value: Any, where: str, name: str, most: float) -> Array:
    """Return rows of numbers, as an array (N, k)."""
    try:
        out = np.atleast_2d(np.array(value, dtype=float))
    except (TypeError, ValueError, OverflowError):
        out = np.zeros((0, 0))
    if out.ndim != 2 or not out.size:
        raise BadInput("is not a table of numbers, rows of equal length", f"{where}: {name}",
                       "Write each sample as a row with a number for each line")
    wrong = np.flatnonzero(~(np.abs(out) <= most).all(axis=1))
    if wrong.size:
        raise BadInput("holds what is implausible, or no number", f"{where}: {name}: row "
                       f"{wrong[0] + 1}", f"Numbers go up to {most:g}: take the sample out")
    return out
