"""Pictures of kinematics: path, pose, joints with their limits, rates, distance to singularity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.io.csv import Table
from ppmcal.io.results.kinematics import KinematicsRecord
from ppmcal.io.rotations import EULER
from ppmcal.kinematics.path_rates import accelerations, rates, without_turns
from ppmcal.linalg import Array, Ints
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Dots, Layer, Marks, Polyline, Strokes, Zero
from ppmcal.plotting.plot import Axis, Plot, span
from ppmcal.report.html import count, sig, whole, with_label, with_unit
from ppmcal.report.kinematics_motion import GONE, TimedRows, motion_of
from ppmcal.report.residual_figures import square
from ppmcal.report.thinning import POINTS

POSITION, VECTOR = ("x", "y", "z"), ("rx", "ry", "rz")
QUATERNION = ("quat_x", "quat_y", "quat_z", "quat_w")
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
    limits = [v for v in motion.record.limits.get(actuator, ()) if v is not None]
    finite = values[np.isfinite(values)]
    room = NEAR_LIMIT * max(float(np.ptp(finite)), 1e-9)
    near = [v for v in limits if finite.min() - room <= v <= finite.max() + room]
    far = [with_unit(v, unit, 6) for v in limits if v not in near]
    axis = span(np.append(finite, near))
    ends = motion.record.limits.get(actuator, (None, None))
    low, high = (-np.inf if ends[0] is None else ends[0], np.inf if ends[1] is None else ends[1])
    across = motion.across
    layers: list[Layer] = [Strokes(np.array([v]), np.array([across.low]),
                                        np.array([across.high]), "out", 1.4, flat=True,
                                   name="limit") for v in near]
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
    shown = [v for v in (bounds.home, bounds.singular) if v is not None]
    finite = values[np.isfinite(values)]
    log = bool(finite.min() > 0.0 and finite.max() > 30.0 * finite.min())
    axis = span(np.append(finite, shown), log=True) if log else Axis(
        0.0, 1.08 * max([float(finite.max()), *shown]))
    across = motion.across
    layers: list[Layer] = [
        Strokes(np.array([v]), np.array([across.low]), np.array([across.high]), kind, 1.4,
                     flat=True, name=name)
        for v, kind, name in ((bounds.home, "after", "at home"),
                              (bounds.singular, "out", "singular below")) if v is not None]
    bad = np.flatnonzero(motion.flagged(SINGULAR) & np.isfinite(values))
    if bad.size:
        some = bad[::max(1, bad.size // FEW)]
        layers.append(Marks(motion.at[some], values[some], "out", "x", 5.0))
    least = int(np.nanargmin(values))
    place = (f"{with_unit(motion.at[least], 's', 4)}" if motion.timed
             else f"row {whole(int(motion.at[least]))}")
    note = f"Least {sig(float(values[least]))}, at {place}."
    note += " Blue line: at home; red: singular below it." if bounds.singular is not None else ""
    return [_over(motion, values, "Distance to singularity along the path",
                  "smallest singular value", note, layers, axis,
                  key=(("out", KEY["out"]),) if bad.size else ())]
