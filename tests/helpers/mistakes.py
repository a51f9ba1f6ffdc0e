"""The sample's measurements as a person's mistake would leave them."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.paths import ROOT

SAMPLE = ROOT / "sample_data"
MACHINE = SAMPLE / "hexapod.yaml"
Row = dict[str, Any]


def session(folder: Path, change: Callable[[list[Row]], None] | None = None,
            sidecar: Callable[[str], str] | None = None) -> Path:
    """Write one row of each pose of the sample, changed as a person's mistake would."""
    with (SAMPLE / "measurements.csv").open(newline="", encoding="utf-8") as file:
        rows: list[Row] = list(csv.DictReader(file))[::2]
    if change:
        change(rows)
    folder.mkdir(exist_ok=True)
    path = folder / "run.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    text = (SAMPLE / "measurements.yaml").read_text(encoding="utf-8")
    path.with_suffix(".yaml").write_text(sidecar(text) if sidecar else text, encoding="utf-8")
    return path


def turned(rows: list[Row], how: Callable[[Rotation], Any]) -> None:
    for row in rows:
        row["rx"], row["ry"], row["rz"] = how(Rotation.from_rotvec(
            [float(row[k]) for k in ("rx", "ry", "rz")], degrees=True))


def swapped(rows: list[Row]) -> None:
    for row in rows:
        row["q_leg2"], row["q_leg3"] = row["q_leg3"], row["q_leg2"]


def scaled(names: tuple[str, ...], factor: float) -> Callable[[list[Row]], None]:
    def change(rows: list[Row]) -> None:
        for row in rows:
            row.update({k: float(row[k]) * factor for k in names})
    return change


def inverse(rows: list[Row]) -> None:
    for row in rows:
        turn = Rotation.from_rotvec([float(row[k]) for k in ("rx", "ry", "rz")], degrees=True)
        back = -turn.inv().apply([float(row[k]) for k in "xyz"])
        row.update(zip("xyz", back, strict=True))
        row.update(zip(("rx", "ry", "rz"), turn.inv().as_rotvec(degrees=True), strict=True))


def w_first(rows: list[Row]) -> None:
    for row in rows:
        quaternion = Rotation.from_rotvec(
            [float(row.pop(k)) for k in ("rx", "ry", "rz")], degrees=True).as_quat()
        row.update(zip(("quat_x", "quat_y", "quat_z", "quat_w"), np.roll(quaternion, 1),
                       strict=True))


MISTAKES: dict[str, Callable[[list[Row]], None]] = {
    "legs swapped": swapped,
    "metres for mm": scaled(("x", "y", "z"), 1e-3),
    "a sign": scaled(("rx",), -1.0),
    "Euler angles": lambda rows: turned(rows, lambda r: r.as_euler("xyz", degrees=True)),
    "radians": scaled(("rx", "ry", "rz"), np.pi / 180.0),
    "inverse": inverse,
    "mirrored": scaled(("z",), -1.0),
    "w first": w_first,
}
