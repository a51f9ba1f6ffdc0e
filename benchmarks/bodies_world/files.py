"""Mechanism file, sidecar and table of a campaign, in mm, deg and kg."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from .machines import Machine
from .session import Run

COORDINATES = {"planar": ["x", "y", "rz"], "translational": ["x", "y", "z"],
               "spatial": ["x", "y", "z", "rx", "ry", "rz"]}
AXES = {"planar": 2, "translational": 3, "spatial": 3}
POINT, LENGTH, TURN = 0.2, 0.2, 0.05
"""Tolerances: mm, mm, deg."""


def unit(machine: Machine) -> float:
    """Return how many file units an SI unit of the joints is."""
    return 1e3 if machine.drive.joint == "slide" else 180.0 / np.pi


def limb(machine: Machine, i: int) -> dict[str, Any]:
    """Return a limb's nominal record."""
    shape, axes = machine.shape, AXES[machine.motion]
    record: dict[str, Any] = {
        "name": machine.legs[i], "kind": machine.kind,
        "base": {"point": (1e3 * shape.base[i, :axes]).tolist()},
        "platform": {"point": (1e3 * shape.platform[i, :axes]).tolist()}}
    if machine.kind == "(P)US":
        record["base"]["direction"] = {"value": [0, 0, 1], "fixed": True}
    return record | {k: float(1e3 * v[i]) for k, v in shape.lengths.items()} | machine.more


def mechanism(machine: Machine) -> dict[str, Any]:
    """Return the nominal machine as its file has it; weight acts along -z."""
    names = COORDINATES[machine.motion]
    home = dict(zip(("x", "y", "z"), (1e3 * machine.home).tolist(), strict=True))
    record = {
        "format": "ppmcal/mechanism/1", "name": f"{machine.name} of bodies",
        "units": {"length": "mm", "angle": "deg"}, "motion": machine.motion,
        "limbs": [limb(machine, i) for i in range(len(machine.legs))],
        "home": {"pose": {n: home.get(n, 0.0) for n in names}},
        "tolerances": {"point": POINT, "length": LENGTH, "angle": TURN,
                       "offset": LENGTH if machine.drive.joint == "slide" else TURN}}
    if machine.motion != "planar":
        record["gravity"] = [0, 0, -1]
    return record


def sidecar(machine: Machine, sigma: tuple[float, float], approach: str) -> dict[str, Any]:
    """Return the data's description: the instrument stands in the base frame."""
    turning = machine.motion != "translational"
    size = {"position": 1e3 * sigma[0]}
    if turning:
        size["rotation"] = float(np.degrees(sigma[1]))
    return {"format": "ppmcal/dataset/1", "name": machine.name,
            "units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "pose" if turning else "position", "sigma": size},
            "frame": "known", "target": "known", "approach": approach}


def table(machine: Machine, run: Run, sigma: tuple[float, float], directions: bool,
          rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the columns, with noise of ``sigma`` (m, rad)."""
    n = len(run.q)
    position = 1e3 * (run.position + sigma[0] * rng.normal(size=(n, 3)))
    noise = Rotation.from_rotvec(sigma[1] * rng.normal(size=(n, 3)))
    turn = (noise * Rotation.from_matrix(run.rotation)).as_rotvec(degrees=True)
    out = {f"q_{n}": unit(machine) * run.q[:, i] for i, n in enumerate(machine.legs)}
    pose = dict(zip(COORDINATES["spatial"], np.hstack([position, turn]).T, strict=True))
    out |= {name: pose[name] for name in COORDINATES[machine.motion]}
    if np.any(run.payload):
        out["payload"] = run.payload
    if directions:
        out |= {f"dir_{n}": run.direction[:, i] for i, n in enumerate(machine.legs)}
    return out


def write(folder: Path, machine: Machine, columns: dict[str, np.ndarray], side: dict[str, Any]
          ) -> None:
    """Write mechanism.yaml, data.csv and data.yaml."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, record in (("mechanism", mechanism(machine)), ("data", side)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(record, sort_keys=False),
                                             encoding="utf-8")
    with (folder / "data.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{v:.17g}" for v in row]
                         for row in zip(*columns.values(), strict=True))
