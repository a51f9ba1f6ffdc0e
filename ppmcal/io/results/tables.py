"""kinematics.csv and commands.csv, and their JSON beside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.calibration.compensation import Compensation
from ppmcal.io import csv_text, json_text
from ppmcal.io.rotations import EULER, columns_of
from ppmcal.kinematics.rotations import to_euler, to_quaternion
from ppmcal.kinematics.tables import KinematicsTable
from ppmcal.linalg import Array
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism
from ppmcal.plotting.map_data import Map

LOCKED = "gimbal lock: only euler_1 and euler_3 together are known, euler_3 is set to 0"


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
        elif name in EULER:
            out[name] = angle
        elif name.startswith(("q_", "rate_")):
            unit = joints.get(name.removeprefix("q_").removeprefix("rate_")
                              .removesuffix("_nominal"), "")
            out[name] = f"{unit or 'unit'}/s" if name.startswith("rate_") else unit
        elif "_position" in name:
            out[name] = length
        elif "_rotation" in name:
            out[name] = angle
    return out


@dataclass(frozen=True)
class Shown:
    """How the poses of kinematics.csv are written.

    Attributes:
        tool: the point whose poses they are, platform axes (3,), m; None for the origin.
        pose: poses (N, 6), SI, in place of the table's; None for those.
        rotation: a convention of :mod:`ppmcal.kinematics.rotations`.
        method: by which forward kinematics was solved, else empty.
    """

    tool: Array | None = None
    pose: Array | None = None
    rotation: str = "rotvec"
    method: str = ""

    def columns(self, mechanism: Mechanism, pose: Array) -> tuple[dict[str, Array],
                                                                  NDArray[np.bool_]]:
        """Return pose columns in file units, and rows whose Euler angles are not unique (N,)."""
        own, locked = pose_columns(mechanism, pose), np.zeros(len(pose), dtype=bool)
        if self.rotation == "rotvec":
            return own, locked
        own = {k: v for k, v in own.items() if not k.startswith("r")}
        if self.rotation == "quat":
            turned = to_quaternion(pose[:, 3:])
        else:
            turned, locked = to_euler(pose[:, 3:], self.rotation)
            turned = turned / mechanism.units.factor("angle")
        return own | dict(zip(columns_of(self.rotation), turned.T, strict=True)), locked

    def record(self, mechanism: Mechanism) -> dict[str, Any]:
        """Return what kinematics.json says of it."""
        out: dict[str, Any] = {"rotation": self.rotation}
        if self.tool is not None:
            out["tool"] = {"point": self.tool / mechanism.units.factor("length"),
                           "unit": mechanism.units.length}
        return out | ({"method": self.method} if self.method else {})


def kinematics_files(mechanism: Mechanism, table: KinematicsTable, header: Sequence[str],
                     columns: Sequence[Any], which: str, provenance: Mapping[str, Any],
                     shown: Shown | None = None) -> tuple[dict[str, str], int]:
    """Return kinematics.csv and kinematics.json, and how many rows are in gimbal lock."""
    shown = shown or Shown()
    pose, locked = shown.columns(mechanism, table.pose if shown.pose is None else shown.pose)
    added: dict[str, Any] = {}
    solved = list(columns)
    if which == "forward":
        added |= pose
    else:
        added |= joint_columns(mechanism, table.q, "q_{}")
        solved = _open_columns(header, columns, pose) if which == "inverse" else solved
        locked[:] = False
    if which == "inverse":
        added |= {k: v for k, v in pose.items() if k not in header}
    if which == "velocity":
        added |= joint_columns(mechanism, table.rate, "rate_{}")
    own = dict(zip(header, solved, strict=True))
    added |= {"condition": table.singular_value, "status": list(table.status), "reason": [
        LOCKED if lock and not r else r for r, lock in zip(table.reason, locked, strict=True)]}
    # what was computed stands in place of input columns of the same name
    together = {**own, **added}
    names, data = list(together), list(together.values())
    counts = {s: table.status.count(s) for s in sorted(set(table.status))}
    meta = {"format": "ppmcal/kinematics/1", "which": which, "rows": len(table.status),
            "status": counts, "units": unit_map(mechanism, names), **shown.record(mechanism),
            "provenance": dict(provenance)}
    return ({"kinematics.csv": csv_text(names, data), "kinematics.json": json_text(meta)},
            int(locked.sum()))


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


def map_table(mechanism: Mechanism, pose: Array, maps: Sequence[Map], status: Sequence[str],
              reason: Sequence[str]) -> str:
    """Return map.csv: poses (N, 6), every map's value, ``status, reason``."""
    table: dict[str, object] = {**pose_columns(mechanism, pose),
                                **{m.name: m.values.ravel() for m in maps},
                                "status": list(status), "reason": list(reason)}
    return csv_text(list(table), list(table.values()))
