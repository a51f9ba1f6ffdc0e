"""kinematics.csv and commands.csv, and their JSON beside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.compensate import Compensation
from ppmcal.files import csv_text, json_text
from ppmcal.kinematics import Table
from ppmcal.mechanism import POSE_COORDINATES, Mechanism

Array = NDArray[np.float64]


def joint_columns(mechanism: Mechanism, q: Array, pattern: str) -> dict[str, Array]:
    """Return joint values as columns named by ``pattern`` (``q_{}``), file units."""
    return {pattern.format(name): q[:, i] / factor for i, (name, (factor, _)) in
            enumerate(zip(mechanism.actuators, mechanism.joint_units, strict=True))}


def pose_columns(mechanism: Mechanism, pose: Array, prefix: str = "") -> dict[str, Array]:
    """Return pose coordinates of the machine's motion as columns, file units."""
    return {prefix + POSE_COORDINATES[c]:
            pose[:, c] / mechanism.units.factor("length" if c < 3 else "angle")
            for c in mechanism.dof}


def unit_map(mechanism: Mechanism, header: Sequence[str]) -> dict[str, str]:
    """Return the unit of every column that has one."""
    length, angle = mechanism.units.length, mechanism.units.angle
    out = {}
    joints = dict(zip(mechanism.actuators, (u for _, u in mechanism.joint_units), strict=True))
    for name in header:
        bare = name.removeprefix("cmd_")
        if bare in POSE_COORDINATES:
            out[name] = angle if bare.startswith("r") else length
        elif name.startswith(("q_", "rate_")):
            unit = joints.get(name.removeprefix("q_").removeprefix("rate_")
                              .removesuffix("_nominal"), "")
            out[name] = f"{unit or 'unit'}/s" if name.startswith("rate_") else unit
        elif "_position" in name:
            out[name] = length
        elif "_rotation" in name:
            out[name] = angle
    return out


def kinematics_files(mechanism: Mechanism, table: Table, header: Sequence[str],
                     columns: Sequence[Any], which: str, provenance: Mapping[str, Any],
                     pose: Array | None = None) -> dict[str, str]:
    """Return kinematics.csv and kinematics.json. ``pose`` replaces the table's (forward)."""
    added: dict[str, Any] = {}
    if which == "inverse":
        added |= joint_columns(mechanism, table.q, "q_{}")
        added |= {k: v for k, v in pose_columns(mechanism, table.pose).items() if k not in header}
    elif which == "forward":
        added |= pose_columns(mechanism, table.pose if pose is None else pose)
    else:
        added |= joint_columns(mechanism, table.q, "q_{}")
        added |= joint_columns(mechanism, table.rate, "rate_{}")
    solved = list(columns)
    if which == "inverse":
        solved = _open_columns(header, columns, pose_columns(mechanism, table.pose))
    own = dict(zip(header, solved, strict=True))
    added |= {"condition": table.condition, "status": list(table.status),
              "reason": list(table.reason)}
    # what was computed stands in place of input columns of the same name
    together = {**own, **added}
    names, data = list(together), list(together.values())
    counts = {s: table.status.count(s) for s in sorted(set(table.status))}
    meta = {"format": "ppmcal/kinematics/1", "which": which, "rows": len(table.status),
            "status": counts, "units": unit_map(mechanism, names), "provenance": dict(provenance)}
    return {"kinematics.csv": csv_text(names, data), "kinematics.json": json_text(meta)}


def _open_columns(header: Sequence[str], columns: Sequence[Any], found: Mapping[str, Array]
                  ) -> list[Any]:
    """Fill in the coordinates that were left open and solved for."""
    out = []
    for name, column in zip(header, columns, strict=True):
        if name in found:
            own = np.asarray(column, dtype=float)
            column = np.where(np.isnan(own), found[name], own)
        out.append(column)
    return out


def command_files(mechanism: Mechanism, result: Compensation, header: Sequence[str],
                  columns: Sequence[Any], provenance: Mapping[str, Any],
                  notes: Sequence[str]) -> dict[str, str]:
    """Return commands.csv and commands.json."""
    units = mechanism.units
    length, angle = units.factor("length"), units.factor("angle")
    added: dict[str, Any] = {}
    added |= joint_columns(mechanism, result.q, "q_{}")
    added |= joint_columns(mechanism, result.q_nominal, "q_{}_nominal")
    added |= pose_columns(mechanism, result.command, "cmd_")
    added |= {"error_position_before": result.position_before / length,
              "error_position_after": result.position_after / length,
              "error_rotation_before": result.rotation_before / angle,
              "error_rotation_after": result.rotation_after / angle,
              "sigma_position": result.sigma_position / length,
              "sigma_rotation": result.sigma_rotation / angle,
              "status": list(result.status), "reason": list(result.reason)}
    clash = [n for n in added if n in header]
    filled = _open_columns(header, columns, pose_columns(mechanism, result.seen))
    kept = [(n, c) for n, c in zip(header, filled, strict=True) if n not in clash]
    names = [*(n for n, _ in kept), *added]
    meta = {"format": "ppmcal/commands/1", "rows": len(result.status),
            "refused": sum(s != "ok" for s in result.status), "notes": list(notes),
            "units": unit_map(mechanism, names), "provenance": dict(provenance)}
    return {"commands.csv": csv_text(names, [*(c for _, c in kept), *added.values()]),
            "commands.json": json_text(meta)}
