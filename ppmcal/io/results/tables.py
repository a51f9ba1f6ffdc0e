"""Columns that several results have: joints, poses, maps, with their units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.io import csv_text
from ppmcal.io.rotations import EULER
from ppmcal.linalg import Array
from ppmcal.model.instruments import number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.plotting.map_data import Map


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
        elif bare.removeprefix("sigma_").startswith(("q_", "rate_")):
            bare = bare.removeprefix("sigma_")
            unit = joints.get(bare.removeprefix("q_").removeprefix("rate_")
                              .removesuffix("_nominal"), "")
            out[name] = f"{unit or 'unit'}/s" if bare.startswith("rate_") else unit
        elif "_position" in name:
            out[name] = length
        elif "_rotation" in name:
            out[name] = angle
    return out


ENVIRONMENT = {"time": "s", "payload": "kg", "fx": "N", "fy": "N", "fz": "N", "mx": "N.m",
               "my": "N.m", "mz": "N.m", "pressure": "Pa"}
"""Columns that effects depend on, in units that no file chooses."""
STAGES = ("before_", "after_", "sigma_", "geometry_")
"""What residuals.csv says of each measured coordinate."""


def column_units(mechanism: Mechanism, header: Sequence[str]) -> dict[str, str]:
    """Return the unit of every column of a table, empty for bare numbers and words."""
    units, out = mechanism.units, dict.fromkeys(header, "") | unit_map(mechanism, header)
    joints = dict(zip(mechanism.actuators, (u for _, u in mechanism.joint_units), strict=True))
    for name in header:
        if name in ENVIRONMENT:
            out[name] = ENVIRONMENT[name]
        elif name.startswith("temperature"):
            out[name] = "deg C"
        elif name in ("vx", "vy", "vz", "wx", "wy", "wz"):
            out[name] = f"{units.length if name[0] == 'v' else units.angle}/s"
        elif name.removeprefix("vel_") in joints:
            out[name] = f"{joints[name.removeprefix('vel_')] or 'unit'}/s"
        elif name.startswith("to_q_"):
            out[name] = joints.get(name.removeprefix("to_q_"), "")
        for stage in STAGES:
            bare = name.removeprefix(stage)
            if bare != name and bare in (*POSE_COORDINATES, *number_names()):
                out[name] = units.angle if bare.startswith("r") else units.length
    return out


def filled_columns(header: Sequence[str], columns: Sequence[Any], found: Mapping[str, Array]
                  ) -> list[Any]:
    """Fill in the coordinates that were left open and solved for."""
    out = []
    for name, column in zip(header, columns, strict=True):
        if name in found:
            own = np.asarray(column, dtype=float)
            column = np.where(np.isnan(own), found[name], own)
        out.append(column)
    return out


def map_table(mechanism: Mechanism, pose: Array, maps: Sequence[Map], status: Sequence[str],
              reason: Sequence[str]) -> str:
    """Return map.csv: poses (N, 6), every map's value, ``status, reason``."""
    table: dict[str, object] = {**pose_columns(mechanism, pose),
                                **{m.name: m.values.ravel() for m in maps},
                                "status": list(status), "reason": list(reason)}
    return csv_text(list(table), list(table.values()))
