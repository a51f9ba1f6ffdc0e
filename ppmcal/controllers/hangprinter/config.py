"""M669 and M666 of RepRapFirmware's Hangprinter, and what its spools make of motor positions.

``M669 A0:-1600:-120 B... C... D...``: x, y, z of each anchor, mm; of older firmware D is a height
alone. ``M666 Q R U O L H``: line build-up, mm^2 per mm of line; spool radii at the origin, mm;
mechanical advantages; lines per spool; teeth of motor and spool gears. With the spool turned by
theta as it pays out, its radius is R - Q O theta / 2, and the head's line is longer by the integral
of that, by U: (R theta - Q O theta^2 / 4) / U.

Sources: RepRapFirmware, ``HangprinterKinematics.cpp`` (Configure, Recalc, MotorPosToLinePos).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ppmcal.controllers.text import NUMBER
from ppmcal.errors import BadInput
from ppmcal.linalg import Array

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
