"""What tests of several packages share: printers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from helpers.instruments import data_of
from ppmcal.calibration.fit.fit_result import Fit, FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.commands.inputs import shipped
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

Array = NDArray[np.float64]

ROBUST = FitOptions(robust=False)

def printer(tmp_path: Path, **limb: object) -> Mechanism:
    """Return a delta whose drives are in steps; ``limb``: slots of every limb."""
    slots: dict[str, object] = {"ratio": {"value": -0.0125, "tolerance": 2.5e-5}, **limb}
    tree = {
        "format": "ppmcal/mechanism/1", "name": "printer", "units": {"length": "mm",
                                                                     "angle": "deg"},
        "motion": "translational", "home": {"pose": {"x": 0, "y": 0, "z": 0}},
        "tolerances": {"point": 0.5, "length": 0.3, "angle": 0.2, "offset": 0.5},
        "limbs": [{"name": n, "kind": "(P)US",
                   "base": {"point": {"radius": {"share": "radius", "value": 135},
                                      "angle": {"value": 120 * i + 90, "fixed": i == 2},
                                      "z": {"value": 0, "fixed": True}},
                            "direction": {"value": [0, 0, 1], "fixed": True}},
                   "platform": {"point": [{"value": 0, "fixed": True}] * 3},
                   "length": 300, "offset": 500.0, "branch": 1, **slots}
                  for i, n in enumerate("abc")]}
    path = tmp_path / "printer.yaml"
    path.write_text(yaml.safe_dump(tree))
    return read_mechanism(path)


def leaning(folder: Path) -> Path:
    """Write the package's printer with a tower that leans and endstops that nobody has measured."""
    text = shipped("delta-linear").read_text(encoding="utf-8")
    text = text.replace("[0, 0, 1], fixed: true}", "[0, 0, 1]}", 1)
    text = text.replace("offset: 0.5}", "offset: .inf}")
    path = folder / "printer.yaml"
    path.write_text(text[:text.index("limits:")], encoding="utf-8")
    return path


def touches(mechanism: Mechanism, g: Array, rng: np.random.Generator, n: int = 60) -> Dataset:
    """Touch a flat bed all over."""
    angle, radius = rng.uniform(0, 2 * np.pi, n), 0.11 * np.sqrt(rng.uniform(size=n))
    pose = np.zeros((n, 6))
    pose[:, 0], pose[:, 1] = radius * np.cos(angle), radius * np.sin(angle)
    q = joints_at(mechanism, g, pose)
    return data_of(mechanism, "plane", q, None, g, rng, 1e-5, False)


def joints_at(mechanism: Mechanism, g: Array, pose: Array) -> Array:
    found = inverse(Model(mechanism, g), pose_motor(pose))
    assert found.reached.all()
    return found.q


def fitted(mechanism: Mechanism, *data: Dataset, options: FitOptions = ROBUST) -> Fit:
    return identify(Problem(mechanism, data, mechanism.free), options)
