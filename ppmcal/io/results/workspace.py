"""map.csv, singular.csv, modes.csv, workspace.json and the pictures of ``workspace``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.design.workspace import Workspace
from ppmcal.io import csv_text, json_text
from ppmcal.io.results.tables import joint_columns, map_table, pose_columns, unit_map
from ppmcal.io.results.workspace_wording import (
    ModeRow,
    distance_unit,
    left_table,
    modes_table,
    size_unit,
    size_word,
    why,
)
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import limit_reason
from ppmcal.linalg import finite_rows
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism
from ppmcal.plotting.map_data import Map

MEANING = {
    "condition": "smallest singular value of A, rotation columns divided by length_scale",
    "condition_relative": "condition, home = 1",
    "dexterity": "smallest over largest singular value of J = -inv(A) Jq, rotation rows times "
                 "length_scale, joint angles as arcs at length_scale (local conditioning index)",
    "dexterity_legs": "smallest over largest singular value of A",
    "singularity_distance": "to the nearest pose of singular.csv, in the grid's coordinates; "
                            "rotations times length_scale unless all coordinates are rotations",
    "grid_end": "distance to the end of the grid: where singularity_distance is larger, a nearer "
                "singularity may lie beyond",
    "determinant": "det A, home = 1; 0 on the singular curve, negative beyond it",
}
"""What the columns of map.csv are."""


def maps(found: Workspace) -> list[Map]:
    """Return the columns of map.csv, values wherever there are joint values."""
    q, shape = found.quality, found.grid.shape
    factor, unit = distance_unit(found)
    columns = (
        ("condition", "smallest singular value of A", "", found.table.singular_value),
        ("condition_relative", "smallest singular value of A, home = 1", "",
         found.table.singular_value / found.home.condition[0]),
        ("dexterity", "dexterity, from joint rates to platform: 1 is isotropic", "", q.dexterity),
        ("dexterity_legs", "how evenly the legs hold the platform: 1 is isotropic", "", q.legs),
        ("singularity_distance", "distance to the nearest singularity", unit,
         found.distance / factor),
        ("grid_end", "distance to the end of the grid", unit, found.edge / factor),
        ("determinant", "det A, home = 1", "", q.determinant / found.home.determinant[0]))
    return [Map(name, title, in_unit, values.reshape(shape))
            for name, title, in_unit, values in columns]


def shown(found: Workspace) -> list[Map]:
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
            out.append(Map(m.name, m.title, m.unit, values, m.log))
    return out


def pictures(found: Workspace) -> dict[str, bytes]:
    """Return file name -> PNG of every map worth one."""
    from ppmcal.plotting.maps import draw_map

    determinant = found.quality.determinant.reshape(found.grid.shape)
    return {f"map_{m.name}.png": draw_map(found.mechanism, found.grid, m, determinant)
            for m in shown(found)}


def tables(found: Workspace, rows: Sequence[ModeRow]) -> dict[str, str]:
    """Return map.csv, singular.csv and modes.csv, in the machine's units."""
    machine = found.mechanism
    wanted = found.grid.poses(machine)
    pose = np.where(finite_rows(found.table.pose)[:, None], found.table.pose, wanted)
    edge = pose_columns(machine, found.singular)
    return {"map.csv": map_table(machine, pose, maps(found), found.table.status,
                                 found.table.reason),
            "singular.csv": csv_text(list(edge), list(edge.values())),
            "modes.csv": modes_file(machine, rows)}


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
        sign, condition = modes.sign, modes.condition
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


def summary(found: Workspace, rows: Sequence[ModeRow], said: Sequence[str],
            findings: Sequence[str], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of workspace.json."""
    machine, grid = found.mechanism, found.grid
    size, unit = size_unit(found)
    status = Counter(found.table.status)
    header = (*machine.coordinates, *(f"q_{a}" for a in machine.actuators))
    units = unit_map(machine, header) | {"singularity_distance": distance_unit(found)[1]}
    axes = {POSE_COORDINATES[c]: {
        "low": level[0] / f, "high": level[-1] / f, "levels": len(level),
        "unit": machine.units.name("length" if c < 3 else "angle")}
        for c, level in zip(grid.coordinates, grid.levels, strict=True)
        for f in [machine.units.factor("length" if c < 3 else "angle")]}
    return {"format": "ppmcal/workspace/1", "name": machine.name, "grid": axes,
            "poses": len(found.table.status), "status": dict(sorted(status.items())),
            "left_out": why(found),
            "reachable": {"share": found.share, size_word(found): found.size / size, "unit": unit},
            "conditioning_index": {"dexterity": found.index, "dexterity_legs": found.index_legs},
            "home": {"condition": found.home.condition[0], "dexterity": found.home.dexterity[0],
                     "dexterity_legs": found.home.legs[0],
                     "determinant": float(np.sign(found.home.determinant[0])),
                     "outside_limits": found.home_limits or None},
            "singular": {"searched": found.searched, "points": len(found.singular),
                         "nearest_to_home": _nearest(found)},
            "modes": [_modes_entry(r) for r in rows], "said": list(said),
            "findings": list(findings),
            "pictures": {f"map_{m.name}.png": m.title for m in shown(found)},
            "tables": [t for t in (left_table(found), modes_table(found, rows)) if t],
            "columns": MEANING, "units": units,
            "length_scale": {"value": machine.length_scale / machine.units.factor("length"),
                             "unit": machine.units.length},
            "provenance": dict(provenance)}


def _nearest(found: Workspace) -> dict[str, Any] | None:
    """Return the singular pose nearest to home."""
    if found.nearest is None:
        return None
    factor, unit = distance_unit(found)
    pose = pose_columns(found.mechanism, found.nearest.pose[None])
    return {"distance": found.nearest.distance / factor, "unit": unit,
            "pose": {name: float(v[0]) for name, v in pose.items()},
            "grid_ends_at": found.nearest.edge / factor}


def _modes_entry(entry: ModeRow) -> dict[str, Any]:
    """Return how many modes one row has, and how far that is known."""
    modes = entry.modes
    if modes is None:
        return {"row": entry.row, "count": None, "reason": entry.reason}
    return {"row": entry.row, "count": len(modes), "singular": int(modes.singular.sum()),
            "home": None if modes.home is None else modes.home + 1,
            "complete": modes.complete, "method": modes.method}


def text(content: Mapping[str, Any]) -> str:
    """Return workspace.json."""
    return json_text(content)
