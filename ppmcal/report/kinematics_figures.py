"""Pictures of kinematics over time: path, pose, joints, rates, distance to singularity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ppmcal.io.csv import Table
from ppmcal.io.pose_fields import EULER, QUATERNION, VECTOR
from ppmcal.io.results.kinematics import KINEMATICS_TABLE, KinematicsRecord
from ppmcal.kinematics.path_rates import accelerations, follows, rates, without_turns
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Dots, Layer, Marks, Polyline, Strokes, Zero
from ppmcal.plotting.plot import Axis, Plot, span
from ppmcal.report.html import count, sig, whole, with_label, with_unit
from ppmcal.report.residual_figures import POINTS, square

NOT_FOUND = "not converged"
GONE = ("unreachable", NOT_FOUND, "refused")
"""Statuses of rows without a pose or without joint values."""


@dataclass(frozen=True)
class TimedRows:
    """Kinematics of N rows as they are drawn.

    Attributes:
        record: kinematics.json; columns: of kinematics.csv.
        at: time or row (N,); name: of that axis; timed: whether it is time.
        status: of each row; rows: their numbers from 1, before thinning.
    """

    record: KinematicsRecord
    columns: Table
    at: Array
    name: str
    timed: bool
    status: tuple[str, ...]
    note: str = ""

    def number(self, name: str) -> Array:
        """Return a column (N,)."""
        return self.columns.number(name)

    def label(self, name: str) -> str:
        """Return a column's name with its unit."""
        return with_label(name, self.record.units.get(name, ""))

    def flagged(self, words: Sequence[str]) -> Bools:
        """Return which rows have one of some statuses (N,)."""
        return np.array([s in words for s in self.status], dtype=bool)

    @property
    def across(self) -> Axis:
        """The axis of time or rows."""
        return span(self.at, margin=0.02)


def is_shown(name: str) -> bool:
    """Whether a column of kinematics.csv is drawn, or says how its row went."""
    return KINEMATICS_TABLE.numbers(name) or name in ("t", "row", "own", "status", "reason")


def drawn_columns(columns: Mapping[str, Any]) -> Table:
    """Return columns (N,) of numbers or words as those of a file."""
    numbers, text = {}, {}
    for name, values in columns.items():
        if KINEMATICS_TABLE.numbers(name):
            numbers[name] = np.asarray(values, dtype=float)
        elif is_shown(name):
            text[name] = tuple(str(v) for v in values)
    size = max((len(v) for v in columns.values()), default=0)
    return Table("kinematics.csv", tuple(columns), numbers, text, size)


def _own_modes(record: KinematicsRecord, columns: Table) -> Table:
    """Return the machine's own assembly mode of each row, all rows where there is one mode a row.

    A row whose own mode is not known stays as a gap.
    """
    row, own = _numbers(columns, "row"), _numbers(columns, "own") == 1.0
    if record.modes is None or not np.isfinite(row).all():
        return columns
    _, first = np.unique(row, return_index=True)
    lines = np.array([next(iter(np.flatnonzero(own & (row == row[i]))), i) for i in first])
    lost = ~own[lines]
    given = ("time", *(h for h in columns.numbers if h.startswith("q_")))
    numbers = {k: np.where(lost & (k not in given), np.nan, v[lines])
               for k, v in columns.numbers.items()}
    text = {k: tuple(NOT_FOUND if gone and k == "status" else v[i]
                     for i, gone in zip(lines, lost, strict=True))
            for k, v in columns.text.items()}
    return replace(columns, size=len(lines), numbers=numbers, text=text)


def motion_of(record: KinematicsRecord, columns: Table) -> TimedRows:
    """Return the rows over time, or over their numbers where there is no time."""
    columns = _own_modes(record, columns)
    name = next((h for h in ("time", "t") if h in columns.header), "")
    at = _numbers(columns, name)
    timed = follows(at)
    if not timed:
        at = np.arange(1.0, columns.size + 1.0)
    axis = "time (s)" if timed else "row, in the order of the file"
    note = f"The column {name} does not go up: rows in its place." if name and not timed else ""
    return TimedRows(record, columns, at, axis, timed, columns.words("status"), note)


def _numbers(columns: Table, name: str) -> Array:
    """Return a column (N,), all nan where it holds other words than numbers."""
    if name in columns.numbers or not name:
        return columns.number(name)
    try:
        return np.array([float(word or "nan") for word in columns.words(name)])
    except ValueError:
        return np.full(columns.size, np.nan)


POSITION = ("x", "y", "z")
STILL = 1e-7
"""A coordinate does not move if it changes by less than this part of the largest of its kind."""
FLAT = 0.02
"""A path is seen from a second side where it is deeper than this part of its extent."""
NEAR_LIMIT = 3.0
"""Limits farther than this many times the motion's range are left out of its picture."""
FEW = 60
"""Paths of no more rows have a dot at each."""
SINGULAR = ("singular", "crossed", "jump")
STRETCHES = (("out", SINGULAR, "singular"), ("before", ("limits",), "limits"),
             ("ink", GONE, "no solution"))
KEY = {kind: name for kind, _, name in STRETCHES}
TOLD = {"out": "red where singular or beyond a singularity", "ink": "black without a solution",
        "before": "brown where outside the limits"}
BY_DIFFERENCES = "By differences of neighbouring rows."


def kinematics_figures(record: KinematicsRecord, columns: Table) -> dict[str, list[Drawing]]:
    """Return the pictures of kinematics.csv by name; a name without one is left out.

    Args:
        record: kinematics.json, with the units and, for some pictures, limits and conditioning.
        columns: of kinematics.csv; of several assembly modes a row, the machine's own is drawn.
    """
    motion = motion_of(record, columns)
    if motion.at.size < 2:
        return {}
    joints = [h for h in columns.header if h.startswith("q_") and np.isfinite(
        motion.number(h)).any()]
    found = {"path": path(motion), "pose": pose(motion),
             "joints": [joint(motion, name) for name in joints],
             "rates": _rates(motion, joints), "singularity": singularity(motion)}
    return {name: drawings for name, drawings in found.items() if drawings}


def _thin(motion: TimedRows) -> Ints:
    """Return the rows that are drawn: all, or evenly spread ones."""
    n = motion.at.size
    return np.arange(n) if n <= POINTS else np.unique(np.linspace(0, n - 1, POINTS).astype(int))


def _thinned(motion: TimedRows) -> str:
    n = motion.at.size
    return f" Thinned: {whole(POINTS)} of {whole(n)} rows." if n > POINTS else ""


# --- where the platform goes ------------------------------------------------------------------

def path(motion: TimedRows) -> list[Drawing]:
    """Return the path of the platform or the tool, from the side where it is widest first."""
    have = [c for c in POSITION if np.isfinite(motion.number(c)).any()]
    if len(have) < 2:
        return []
    extent = {c: float(np.ptp(motion.number(c)[np.isfinite(motion.number(c))])) for c in have}
    wide = sorted(have, key=lambda c: (-extent[c], c))
    if not _moving(motion, have):
        return []
    views = [tuple(sorted(wide[:2]))]
    if len(wide) > 2 and extent[wide[2]] > FLAT * extent[wide[0]]:
        views += [tuple(sorted((wide[0], wide[2]))), tuple(sorted((wide[1], wide[2])))]
    return [_view(motion, a, b) for a, b in views]


def _view(motion: TimedRows, a: str, b: str) -> Drawing:
    """Return the path in one plane, both axes to one scale."""
    rows = _thin(motion)
    x, y = motion.number(a)[rows], motion.number(b)[rows]
    whose = "tool point" if motion.record.tool is not None else "platform"
    first = np.flatnonzero(np.isfinite(x) & np.isfinite(y))[:1]
    bad = motion.flagged(SINGULAR)[rows], motion.flagged(("limits",))[rows]
    layers: list[Layer] = [Polyline(x, y)]
    if rows.size <= FEW:
        layers.append(Dots(x, y, "after"))
    layers += [Marks(x[mine], y[mine], kind, "x" if kind == "out" else "o", 5.0)
               for mine, kind in zip(bad, ("out", "before"), strict=True) if mine.any()]
    layers.append(Marks(x[first], y[first], "after", "s", 7.0))
    key = [("after", "first row")]
    key += [(kind, KEY[kind]) for kind, mine in zip(("out", "before"), bad, strict=True)
            if mine.any()]
    across, up = square(x, y)
    names = motion.label(a), motion.label(b)
    units = motion.record.units.get(a, ""), motion.record.units.get(b, "")
    out = Plot(across, up, names, layers, units, equal=True).drawing(
        f"Path of the {whose}, {a} and {b}", f"Square: first row.{_lost(motion)}{_thinned(motion)}",
        f"{count(motion.at.size, 'row')}; {a} from {_ends(motion, a)}, {b} from "
        f"{_ends(motion, b)}.", tuple(key))
    return replace(out, note=_colours("Marks", key))


def _colours(where: str, key: Sequence[tuple[str, str]]) -> str:
    """Return what the colours mean, for a drawing without a key; nothing where all is well."""
    words = [TOLD[kind] for kind, _ in key if kind in TOLD]
    return f"{where} {', '.join(words)}." if words else ""


def _lost(motion: TimedRows) -> str:
    lost = int(motion.flagged(GONE).sum())
    return f" {count(lost, 'row')} without a solution." if lost else ""


def _ends(motion: TimedRows, name: str) -> str:
    values = motion.number(name)
    ends = (np.nanmin(values), np.nanmax(values))
    return " to ".join(with_unit(float(v), motion.record.units.get(name, ""), 5) for v in ends)


def pose(motion: TimedRows) -> list[Drawing]:
    """Return the pose coordinates that move."""
    names = [c for c in (*POSITION, *VECTOR, *EULER, *QUATERNION)
             if np.isfinite(motion.number(c)).any()]
    moves = [c for kind in (POSITION, (*VECTOR, *EULER), QUATERNION)
             for c in _moving(motion, [n for n in names if n in kind])]
    still = [c for c in names if c not in moves]
    note = f" Not moving: {', '.join(still)}." if still else ""
    return [_over(motion, motion.number(name), f"{_what(motion, name)} {_over_word(motion)}",
                  motion.label(name), "" if i else note, turns=_period(motion, name))
            for i, name in enumerate(moves)]


def _moving(motion: TimedRows, names: Sequence[str]) -> list[str]:
    """Return which of several coordinates of one unit move."""
    finite = [v[np.isfinite(v)] for v in (motion.number(n) for n in names)]
    extent = [float(np.ptp(v)) for v in finite]
    least = STILL * max([*extent, *(1e-3 * float(np.abs(v).max()) for v in finite)], default=0.0)
    return [name for name, e in zip(names, extent, strict=True) if e > least]


def _what(motion: TimedRows, name: str) -> str:
    if name in EULER and motion.record.rotation.startswith("euler-"):
        letter = motion.record.rotation.removeprefix("euler-")[EULER.index(name)]
        return f"{name} (about {letter})"
    return name


def _over_word(motion: TimedRows) -> str:
    return "over time" if motion.timed else "by row"


def _period(motion: TimedRows, name: str) -> float:
    """Return a whole turn in a column's unit, 0 where it is not an angle."""
    return {"deg": 360.0, "rad": 2.0 * np.pi}.get(motion.record.units.get(name, ""), 0.0)


def _over(motion: TimedRows, values: Array, title: str, label: str, note: str = "",
          layers: Sequence[Layer] = (), axis: Axis | None = None, turns: float = 0.0,
          key: tuple[tuple[str, str], ...] = ()) -> Drawing:
    """Return values over time or rows, with stripes along stretches that are not ok."""
    rows = _thin(motion)
    x, y = motion.at[rows], values[rows]
    if turns:
        # a whole turn from one row to the next is not a motion: no line there
        jump = np.flatnonzero(np.abs(np.diff(y)) > 0.5 * turns) + 1
        x, y = np.insert(x, jump, np.nan), np.insert(y, jump, np.nan)
    finite, up = values[np.isfinite(values)], axis or span(values)
    stripes, told = _foot(motion, up)
    drawn: list[Layer] = [*stripes, *layers, Polyline(x, y)]
    if rows.size <= FEW:
        drawn.append(Dots(x, y, "after"))
    said = (f"From {sig(float(finite.min()), 4)} to {sig(float(finite.max()), 4)} in "
            f"{count(int(finite.size), 'row')}." if finite.size else "No value.")
    key = tuple(dict.fromkeys((*told, *key)))
    units = "s" if motion.timed else "", label.rpartition(" (")[2].removesuffix(")")
    out = Plot(motion.across, up, (motion.name, label), drawn,
               units if label.endswith(")") else (units[0], "")).drawing(
        title, f"{note}{_thinned(motion)} {motion.note}".strip(), said, key)
    return replace(out, note=_colours("At the foot", key))


def _foot(motion: TimedRows, up: Axis) -> tuple[list[Layer], tuple[tuple[str, str], ...]]:
    """Return stripes at the foot along stretches that are not ok, and what they are."""
    edges = np.concatenate([motion.at[:1], 0.5 * (motion.at[1:] + motion.at[:-1]), motion.at[-1:]])
    layers: list[Layer] = []
    key: list[tuple[str, str]] = []
    for kind, words, name in STRETCHES:
        change = np.diff(motion.flagged(words).astype(int), prepend=0, append=0)
        low, high = edges[change == 1], edges[change == -1]
        if low.size:
            layers.append(Strokes(np.full(low.size, up.low), low, high, kind, 6.0, flat=True))
            key.append((kind, name))
    return layers, tuple(key)


# --- joints -----------------------------------------------------------------------------------

def joint(motion: TimedRows, name: str) -> Drawing:
    """Return one joint's values with its limits."""
    values = motion.number(name)
    actuator, unit = name.removeprefix("q_"), motion.record.units.get(name, "")
    ends = motion.record.limits.get(actuator, (None, None))
    limits = [v for v in ends if v is not None]
    finite = values[np.isfinite(values)]
    room = NEAR_LIMIT * max(float(np.ptp(finite)), 1e-9)
    near = [v for v in limits if finite.min() - room <= v <= finite.max() + room]
    far = [with_unit(v, unit, 6) for v in limits if v not in near]
    axis = span(np.append(finite, near))
    low, high = (-np.inf if ends[0] is None else ends[0], np.inf if ends[1] is None else ends[1])
    layers: list[Layer] = [_level(motion, v, "out", "limit") for v in near]
    over = (values < low) | (values > high)
    if over.any():
        rows = np.flatnonzero(over)[:: max(1, int(over.sum()) // FEW)]
        layers.append(Marks(motion.at[rows], values[rows], "before", "o", 5.0))
    note = " Red line: limit." if near else ""
    note += f" {' and '.join(far)} {'are limits' if len(far) > 1 else 'is a limit'}." if far else ""
    note += f" Ring: outside, {count(int(over.sum()), 'row')}." if over.any() else ""
    return _over(motion, values, f"Joint {actuator} {_over_word(motion)}", motion.label(name),
                 note, layers, axis, _period(motion, name),
                 (("before", KEY["before"]),) if over.any() else ())


def _level(motion: TimedRows, value: float, kind: str, name: str) -> Layer:
    """Return a line at one value, from edge to edge."""
    across = motion.across
    return Strokes([value], [across.low], [across.high], kind, 1.4, flat=True, name=name)


def _rates(motion: TimedRows, joints: Sequence[str]) -> list[Drawing]:
    """Return joint rates, and accelerations where rows have times."""
    out = []
    for name in joints:
        actuator, unit = name.removeprefix("q_"), motion.record.units.get(name, "")
        values, rate = motion.number(name), motion.number(f"rate_{actuator}")
        exact = bool(np.isfinite(rate).any())
        if not exact and motion.timed:
            values = without_turns(values, _period(motion, name))
            rate = rates(motion.at, values)
        if not np.isfinite(rate).any():
            continue
        label = with_label(f"rate of {actuator}", f"{unit or 'unit'}/s")
        out.append(_over(motion, rate, f"Rate of joint {actuator} {_over_word(motion)}", label,
                         "" if exact else BY_DIFFERENCES, [Zero()]))
        if motion.timed:
            second = rates(motion.at, rate) if exact else accelerations(motion.at, values)
            label = with_label(f"acceleration of {actuator}", f"{unit or 'unit'}/s²")
            if np.isfinite(second).any():
                out.append(_over(motion, second, f"Acceleration of joint {actuator} over time",
                                 label, BY_DIFFERENCES, [Zero()]))
    return out


def singularity(motion: TimedRows) -> list[Drawing]:
    """Return the smallest singular value along the path, with home's and the singular bound."""
    values = motion.number("condition")
    if not np.isfinite(values).any():
        return []
    bounds = motion.record.conditioning
    home, singular = bounds.get("home"), bounds.get("singular")
    shown = [v for v in (home, singular) if v is not None]
    finite = values[np.isfinite(values)]
    log = bool(finite.min() > 0.0 and finite.max() > 30.0 * finite.min())
    axis = span(np.append(finite, shown), log=True) if log else Axis(
        0.0, 1.08 * max([float(finite.max()), *shown]))
    layers: list[Layer] = [
        _level(motion, v, kind, name) for v, kind, name in ((home, "after", "at home"),
                              (singular, "out", "singular below")) if v is not None]
    bad = np.flatnonzero(motion.flagged(SINGULAR) & np.isfinite(values))
    if bad.size:
        some = bad[::max(1, bad.size // FEW)]
        layers.append(Marks(motion.at[some], values[some], "out", "x", 5.0))
    least = int(np.nanargmin(values))
    place = (f"{with_unit(motion.at[least], 's', 4)}" if motion.timed
             else f"row {whole(int(motion.at[least]))}")
    note = f"Least {sig(float(values[least]))}, at {place}."
    note += " Blue line: at home; red: singular below it." if singular is not None else ""
    return [_over(motion, values, "Distance to singularity along the path",
                  "smallest singular value", note, layers, axis,
                  key=(("out", KEY["out"]),) if bad.size else ())]
