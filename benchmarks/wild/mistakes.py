"""Mistakes in the file: columns, units, conventions, rows. Each says how it is mended.

A mistake takes a Paper (table, sidecar, mechanism record) and changes it in place; it returns
a Blame, in the words of the sidecar's ``read:``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass
class Paper:
    """What is about to be written: columns (N,), sidecar and mechanism records."""

    table: dict[str, np.ndarray]
    sidecar: dict
    mechanism: dict
    rotary: bool

    @property
    def joints(self) -> list[str]:
        """Names of the joint columns."""
        return [name for name in self.table if name.startswith("q_")]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.table.values())))

    @property
    def seen(self) -> list[str]:
        """Names of the measured columns."""
        return [n for n in ("x", "y", "z", "rx", "ry", "rz") if n in self.table]


@dataclass
class Blame:
    """A mistake: the contract's kind, columns, rows (from 0), mend, and equal readings."""

    kind: str
    columns: list[str] = field(default_factory=list)
    read: dict | None = None
    rows: list[int] = field(default_factory=list)
    accept: list[str] = field(default_factory=list)
    mends: bool = True
    note: str = ""


def reorder(paper: Paper, order: dict[str, str]) -> None:
    """Fill columns with other columns' values: {column: source}."""
    old = {name: paper.table[name] for name in order.values()}
    for name, source in order.items():
        paper.table[name] = old[source]


def legs_swapped(rng, paper: Paper) -> Blame:
    """Two joint columns under each other's name."""
    a, b = sorted(rng.choice(paper.joints, 2, replace=False).tolist())
    reorder(paper, {a: b, b: a})
    return Blame("permuted", [a, b], {"columns": {a: b, b: a}})


def legs_cyclic(rng, paper: Paper) -> Blame:
    """All joint columns one place on."""
    names, step = paper.joints, int(rng.choice([1, -1]))
    order = {n: names[(i + step) % len(names)] for i, n in enumerate(names)}
    reorder(paper, order)
    back = {source: name for name, source in order.items()}
    return Blame("permuted", names, {"columns": back})


def sign(how: str):
    """One joint column, or all, counts the other way."""

    def make(rng, paper):
        names = paper.joints if how == "all" else [str(rng.choice(paper.joints))]
        for name in names:
            paper.table[name] = -paper.table[name]
        return Blame("sign", names, {"signs": dict.fromkeys(names, -1)})

    return make


PER_MM = {"m": 1e-3, "in": 1 / 25.4, "um": 1e3}
PER_DEG = {"rad": np.pi / 180, "turn": 1 / 360}


def joint_unit(how: str):
    """One joint column, or all, in another unit."""

    def make(rng, paper):
        names = paper.joints if how == "all" else [str(rng.choice(paper.joints))]
        units = PER_DEG if paper.rotary else PER_MM
        name = str(rng.choice(list(units)))
        for column in names:
            paper.table[column] = paper.table[column] * units[name]
        return Blame("unit", names, {"units": dict.fromkeys(names, name)})

    return make


def position_unit(rng, paper: Paper) -> Blame:
    """Positions in m or inch."""
    name, columns = str(rng.choice(["m", "in"])), [n for n in ("x", "y", "z") if n in paper.table]
    for column in columns:
        paper.table[column] = paper.table[column] * PER_MM[name]
    return Blame("unit", columns, {"units": dict.fromkeys(columns, name)})


def one_position_unit(rng, paper: Paper) -> Blame:
    """One coordinate in cm's place: written in inch."""
    column = str(rng.choice([n for n in ("x", "y", "z") if n in paper.table]))
    paper.table[column] = paper.table[column] / 25.4
    return Blame("unit", [column], {"units": {column: "in"}})


def angle_unit(rng, paper: Paper) -> Blame:
    """Measured angles in rad."""
    columns = [n for n in ("rx", "ry", "rz") if n in paper.table]
    for column in columns:
        paper.table[column] = np.radians(paper.table[column])
    return Blame("unit", columns, {"units": dict.fromkeys(columns, "rad")}, accept=["rotation"])


def condition_unit(column: str, unit: str):
    """Temperature in F or K, payload in g, lb or N."""
    change = {
        "F": lambda t: t * 9 / 5 + 32, "K": lambda t: t + 273.15, "g": lambda m: m * 1e3,
        "lb": lambda m: m / 0.45359237, "N": lambda m: m * 9.80665,
    }[unit]  # fmt: skip

    def make(rng, paper):
        paper.table[column] = change(paper.table[column])
        return Blame(
            "unit", [column], {"units": {column: unit}}, note="a condition, not a measurement"
        )

    return make


def _rotvec(paper: Paper) -> Rotation:
    full = np.column_stack([paper.table[n] for n in ("rx", "ry", "rz")])
    return Rotation.from_rotvec(full, degrees=True)


def _write_rotation(paper: Paper, values: np.ndarray, names=("rx", "ry", "rz")) -> None:
    at = list(paper.table)
    for old in ("rx", "ry", "rz"):
        paper.table.pop(old)
    new = dict(zip(names, values.T, strict=True))
    spot = at.index("rx")
    items = [*list(paper.table.items())[:spot], *new.items(), *list(paper.table.items())[spot:]]
    paper.table.clear()
    paper.table.update(items)


def euler(order: str, in_order: bool = False):
    """Rotation columns hold Euler angles (capitals: moving axes) instead of a vector.

    The angle about an axis stands in that axis's column, or, in order, the first in rx.
    """

    def make(rng, paper):
        angles = _rotvec(paper).as_euler(order, degrees=True)
        placed = not in_order and len(set(order)) == 3
        if placed:
            angles = angles[:, [order.lower().index(axis) for axis in "xyz"]]
        _write_rotation(paper, angles)
        note = (
            "the angle about each axis in its column" if placed else "angles in order in rx, ry, rz"
        )
        names, read = ["rx", "ry", "rz"], {"rotation": f"euler-{order}"}
        return Blame("rotation", names, read, accept=["exchanged"] if not placed else [], note=note)

    return make


def quaternion_first(rng, paper: Paper) -> Blame:
    """Quaternion with w first under headers that say x, y, z, w."""
    quat = _rotvec(paper).as_quat()
    names = ["quat_x", "quat_y", "quat_z", "quat_w"]
    _write_rotation(paper, quat[:, [3, 0, 1, 2]], names)
    return Blame("rotation", names, {"rotation": "quat-wxyz"})


def transposed(rng, paper: Paper) -> Blame:
    """Rotation of the base seen from the platform; positions are right."""
    _write_rotation(paper, -_rotvec(paper).as_rotvec(degrees=True))
    names = ["rx", "ry", "rz"]
    return Blame("rotation", names, {"signs": dict.fromkeys(names, -1)}, accept=["sign", "inverse"])


def inverted(rng, paper: Paper) -> Blame:
    """Measuring frame seen from the target."""
    spatial = "rx" in paper.table
    zero = np.zeros(paper.rows)
    pos = np.column_stack([paper.table.get(n, zero) for n in "xyz"])
    turn = (
        _rotvec(paper)
        if spatial
        else Rotation.from_rotvec(np.column_stack([zero, zero, paper.table["rz"]]), degrees=True)
    )
    back = -turn.inv().apply(pos)
    for i, n in enumerate("xyz"):
        if n in paper.table:
            paper.table[n] = back[:, i]
    if spatial:
        _write_rotation(paper, turn.inv().as_rotvec(degrees=True))
    else:
        paper.table["rz"] = -paper.table["rz"]
    return Blame("inverse", paper.seen, {"pose": "inverse"})


def mirrored(rng, paper: Paper) -> Blame:
    """One axis of the instrument points the other way, rotations with it."""
    axis = str(rng.choice([n for n in ("x", "y", "z") if n in paper.table]))
    paper.table[axis] = -paper.table[axis]
    for name in ("rx", "ry", "rz"):
        if name in paper.table and name != "r" + axis:
            paper.table[name] = -paper.table[name]
    note = "with an unknown frame any axis mends it"
    return Blame("mirrored", [axis], {"mirror": axis}, note=note)


def exchanged(rng, paper: Paper) -> Blame:
    """Two position columns under each other's name."""
    names = [n for n in ("x", "y", "z") if n in paper.table]
    a, b = sorted(rng.choice(names, 2, replace=False).tolist())
    reorder(paper, {a: b, b: a})
    accept = [] if "rx" in paper.table or "rz" in paper.table else ["mirrored"]
    return Blame("exchanged", [a, b], {"columns": {a: b, b: a}}, accept=accept)
