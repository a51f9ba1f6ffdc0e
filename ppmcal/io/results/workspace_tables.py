"""Tables, maps and pictures of ``workspace``: map.csv, singular.csv, modes.csv."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log10
from typing import Any

import numpy as np

from ppmcal.design.assembly_modes import Modes
from ppmcal.design.workspace import Workspace
from ppmcal.io import csv_text
from ppmcal.io.results.parts import ShownTable
from ppmcal.io.results.tables import joint_columns, pose_columns
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.region import Map
from ppmcal.kinematics.tables import limit_reason
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class ModeRow:
    """Assembly modes at one row of joint values.

    ``row``: its number in the user's file from 1, 0 for home's joints; ``q`` (k,);
    ``modes`` None where they could not be had, with the ``reason``.
    """

    row: int
    q: Array
    modes: Modes | None
    reason: str = ""


def maps(found: Workspace) -> list[Map]:
    """Return the columns of map.csv, values wherever there are joint values."""
    q, units, far = found.quality, found.mechanism.units, found.distance_quantity
    columns = (
        ("condition", "smallest singular value of A", "1", found.table.singular_value),
        ("condition_relative", "smallest singular value of A, home = 1", "1",
         found.table.singular_value / found.home.singular_value[0]),
        ("dexterity", "dexterity, from joint rates to platform: 1 is isotropic", "1", q.dexterity),
        ("dexterity_legs", "how evenly the legs hold the platform: 1 is isotropic", "1", q.legs),
        ("singularity_distance", "distance to the nearest singularity", far, found.distance),
        ("grid_end", "distance to the end of the grid", far, found.edge),
        ("determinant", "det A, home = 1", "1", q.determinant / found.home.determinant[0]))
    return [Map.of(units, name, title, quantity, values.reshape(found.grid.shape))
            for name, title, quantity, values in columns]


def plotted(found: Workspace) -> list[Map]:
    """Return the maps worth a picture.

    What the machine reaches within limits; the determinant everywhere, as it changes sign
    beyond. Legs that drive the platform each by itself hold it as they move it: one picture.
    """
    reached = found.reached.reshape(found.grid.shape)
    same = np.allclose(found.quality.dexterity, found.quality.legs, equal_nan=True)
    out = []
    for m in maps(found):
        if m.name in ("condition", "grid_end") or (m.name == "dexterity_legs" and same):
            continue
        there = reached & found.sure.reshape(reached.shape) if (
            m.name == "singularity_distance") else reached
        values = np.asarray(m.values if m.name == "determinant" else
                            np.where(there, m.values, np.nan), dtype=float)
        if np.isfinite(values).any():
            out.append(replace(m, values=values))
    return out


def modes_file(mechanism: Mechanism, rows: Sequence[ModeRow]) -> str:
    """Return modes.csv: one line for each mode, or one with the reason where there is none.

    ``reason`` also says which joint value is outside limits; modes are found there all the same.
    """
    parts: dict[str, list[Any]] = {}
    for entry in rows:
        for name, values in _mode_lines(mechanism, entry).items():
            parts.setdefault(name, []).extend(values)
    return csv_text(list(parts), [np.array(v) if isinstance(v[0], float) else v
                                  for v in parts.values()])


def _mode_lines(mechanism: Mechanism, entry: ModeRow) -> dict[str, list[Any]]:
    """Return the columns of one row's modes."""
    modes = entry.modes
    if modes is None or not len(modes):
        reason = entry.reason or "no pose closes" + (
            "" if modes is None or modes.complete else " that the search would find")
        count, nan = 1, np.full(1, np.nan)
        pose, sign, condition = np.full((1, 6), np.nan), nan, nan
        number, home = [0], ["no"]
        status, reasons = ["refused" if modes is None else "none"], [reason]
    else:
        count, pose = len(modes), pose_vector(modes.motors)
        sign, condition = modes.sign, modes.singular_value
        number = list(range(1, count + 1))
        home = ["yes" if i == modes.home else "no" for i in range(count)]
        status = ["singular" if s else "ok" for s in modes.singular]
        beyond = limit_reason(mechanism, entry.q)
        reasons = ["; ".join(filter(None, ("two modes meet here, or nearly" if s else "", beyond)))
                   for s in modes.singular]
    joints = joint_columns(mechanism, np.tile(entry.q, (count, 1)), "q_{}")
    return {"row": [entry.row] * count, "mode": number,
            **{n: v.tolist() for n, v in joints.items()},
            **{n: v.tolist() for n, v in pose_columns(mechanism, pose).items()},
            "determinant": sign.tolist(), "condition": condition.tolist(), "home": home,
            "status": status, "reason": reasons}


def left_table(found: Workspace) -> ShownTable:
    """Return why poses are left out."""
    return ShownTable(title="Poses left out", columns=("left out because", "poses"), note="",
                      rows=tuple((reason, str(n)) for reason, n in left_out(found).items()))


def modes_table(found: Workspace, rows: Sequence[ModeRow]) -> ShownTable | None:
    """Return home's modes, or how many each row of the user's file has."""
    known = [(r.row, r.modes) for r in rows if r.modes is not None]
    if not known:
        return None
    if known[0][0]:
        return ShownTable(
            title="Assembly modes by row", columns=("row", "modes", "singular", "all of them"),
            rows=tuple((str(n), str(len(m)), str(int(m.singular.sum())),
                        "yes" if m.complete else "there may be more") for n, m in known), note="")
    own, units = known[0][1], found.mechanism.units
    columns = places(found.mechanism, pose_vector(own.motors))
    cells = ((str(i + 1), *(v[i] for v in columns.values()), f"{own.sign[i]:+.0f}",
              f"{own.singular_value[i]:.3g}",
              "home" if i == own.home else "singular" if own.singular[i] else "")
             for i in range(len(own)))
    heads = [f"{n} {units.angle if n.startswith('r') else units.length}" for n in columns]
    return ShownTable(title="Assembly modes at home's joint values", rows=tuple(cells), note="",
                      columns=("", *heads, "det", "cond.", ""))


def places(mechanism: Mechanism, pose: Array) -> dict[str, list[str]]:
    """Return poses (N, 6) as words by coordinate, with decimals that suit the machine's size."""
    out = {}
    for name, values in pose_columns(mechanism, pose).items():
        size = mechanism.reach / mechanism.units.factor("length")
        if name.startswith("r"):
            size = 3.0 / mechanism.units.factor("angle")
        decimals = max(0, 4 - int(log10(max(size, 1e-9))) - (len(mechanism.dof) > 3))
        out[name] = [f"{v:.{decimals}f}" if round(v, decimals) else "0" for v in values.tolist()]
    return out


def size_unit(found: Workspace) -> tuple[float, str]:
    """Return SI value and name of the unit of the reachable part: ``mm^2``, ``mm^2 deg``."""
    units = found.mechanism.units
    factor, parts = 1.0, []
    turns = sum(c >= 3 for c in found.grid.coordinates)
    for quantity, count in (("length", len(found.grid.coordinates) - turns), ("angle", turns)):
        factor *= units.factor(quantity) ** count
        if count:
            parts.append(units.name(quantity) + (f"^{count}" if count > 1 else ""))
    return factor, " ".join(parts)


def size_word(found: Workspace) -> str:
    """Return what the size of the reachable part is called; ``extent`` where angles are in it."""
    if any(c >= 3 for c in found.grid.coordinates):
        return "extent"
    return {1: "length", 2: "area", 3: "volume"}.get(len(found.grid.coordinates), "extent")


def left_out(found: Workspace) -> dict[str, int]:
    """Return why poses of the grid are left out, and how many for each reason."""
    words: Counter[str] = Counter()
    for status, reason in zip(found.table.status, found.table.reason, strict=True):
        if status == "singular":
            reason = "next to a singularity"
        elif status == "limits":
            reason = re.sub(r" = \S+( \w+)? is outside", " is outside", reason)
        elif status == "unreachable":
            reason = re.sub(r" by \S+ \w+$", "", reason.partition(":")[0])
        if status != "ok":
            words[reason] += 1
    return dict(words.most_common())
