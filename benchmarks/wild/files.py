"""Mechanism file, sidecar and table as text, in mm and deg."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from .kinematics import COLUMNS, inverse
from .machines import Machine, pose_of

NAMES = np.array(["x", "y", "z", "rx", "ry", "rz"])
IS_ANGLE = np.array([False] * 3 + [True] * 3)


def coordinates(motion: str) -> list[str]:
    """Names of a pose's coordinates."""
    return list(NAMES[COLUMNS[motion]])


def in_file_units(motion: str, values: np.ndarray) -> np.ndarray:
    """Coordinates (..., d) from mm and rad to mm and deg."""
    return np.where(IS_ANGLE[COLUMNS[motion]], np.degrees(values), values)


def scalar(value) -> str:
    """One number, text or flag of a YAML file."""
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, (float, np.floating)):
        text = f"{value:.12g}"
        return text if "e" not in text else f"{value:.15f}"
    return str(int(value)) if isinstance(value, (int, np.integer)) else json.dumps(str(value))


def flow(value) -> str:
    """Any nested value as YAML in flow style."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(flow(item) for item in value) + "]"
    return scalar(value)


def yaml_text(record: dict) -> str:
    """A mapping as YAML: one line per key, limbs one line each."""
    lines = []
    for key, value in record.items():
        if key == "limbs":
            lines += ["limbs:"] + [f"  - {flow(limb)}" for limb in value]
        else:
            lines.append(f"{key}: {flow(value)}")
    return "\n".join(lines) + "\n"


def wrapped_branch(machine: Machine, leg: int) -> int:
    """+1 where the home root is the larger of both within (−180, 180] deg, else −1."""
    geo, at = machine.geometry, pose_of(machine.motion, machine.home[None])
    roots = [inverse(replace(geo, branch=side * geo.branch), *at)[0, leg] for side in (1, -1)]
    here, other = (np.arctan2(np.sin(u), np.cos(u)) for u in roots)
    return 1 if here > other else -1


def _limb(machine: Machine, leg: int) -> dict:
    geo, planar = machine.geometry, machine.motion == "planar"
    axes = 2 if planar else 3
    base = {"point": geo.base[0, leg, :axes].tolist()}
    limb = {"name": machine.legs[leg], "kind": machine.kind, "base": base}
    limb["platform"] = {"point": geo.platform[0, leg, :axes].tolist()}
    if geo.closure == "slider":
        base["direction"] = geo.axis[0, leg].tolist()
        limb |= {"length": geo.length[0, leg], "branch": int(geo.branch[0, leg])}
    if geo.closure == "crank":
        limb |= {"proximal": geo.proximal[0, leg], "distal": geo.length[0, leg]}
        side = int(geo.branch[0, leg])
        limb |= {"elbow": -side} if planar else {"branch": wrapped_branch(machine, leg)}
        if not planar:
            base |= {"axis": geo.axis[0, leg].tolist(), "zero": geo.zero[0, leg].tolist()}
    return limb


def mechanism_record(machine: Machine) -> dict:
    """Nominal machine as its mechanism file has it."""
    tol = machine.tolerances
    turn = np.degrees if machine.rotary else float
    turn_all = lambda pairs: (np.degrees(pairs) if machine.rotary else pairs).tolist()  # noqa: E731
    home = in_file_units(machine.motion, machine.home)
    limits = dict(zip(machine.legs, turn_all(machine.limits), strict=True))
    return {
        "format": "ppmcal/mechanism/1",
        "name": f"{machine.name} of the wild",
        "units": {"length": "mm", "angle": "deg"},
        "motion": machine.motion,
        "limbs": [_limb(machine, leg) for leg in range(len(machine.legs))],
        "home": {"pose": dict(zip(coordinates(machine.motion), home.tolist(), strict=True))},
        "tolerances": {
            "point": tol["point"], "length": tol["length"],
            "angle": float(np.degrees(tol["angle"])), "offset": float(turn(tol["offset"])),
        },
        "limits": limits,
        "gravity": machine.gravity.tolist(),
    }  # fmt: skip


def table_text(table: dict[str, np.ndarray]) -> str:
    """Columns of numbers or text as CSV with 17 significant digits."""
    columns = []
    for values in table.values():
        if values.dtype.kind in "iuUO":
            columns.append([str(v) for v in values])
        else:
            columns.append(["" if np.isnan(v) else f"{v:.17g}" for v in values])
    rows = [",".join(row) for row in zip(*columns, strict=True)]
    return "\n".join([",".join(table), *rows]) + "\n"


def write_text(path: Path, text: str) -> None:
    """Write text, making the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
