"""Samples of a Hangprinter's auto-calibration, as JSON lines or as arrays of its scripts."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.controllers.hangprinter.config import FARTHEST, NAMES, Spools, spools_of
from ppmcal.controllers.text import read_text
from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.wording import pluralize

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
