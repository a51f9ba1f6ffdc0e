"""The block ``measurement`` of a mechanism file: what identify keeps of its measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.errors import refuse_unknown
from ppmcal.io.mechanism_schema import MeasurementFile, MechanismFile
from ppmcal.io.pose_fields import COORDINATES, pose_from_map, pose_to_map
from ppmcal.io.yaml import to_file
from ppmcal.linalg import Array
from ppmcal.model.dataset import WRENCH, ZERO_CELSIUS
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.units import Units, coordinate_quantity

CONDITIONS = {"temperature": ZERO_CELSIUS, "payload": 0.0, "time": 0.0,
              **dict.fromkeys(WRENCH, 0.0)}
"""Recorded conditions whose ranges are kept, and what is added to make them SI."""


def read_registrations(file: MechanismFile, units: Units, source: str) -> dict[str, Registration]:
    """Return frame and target of each data set.

    Raises:
        BadInput: a frame that is not a pose of this motion.
    """
    out: dict[str, Registration] = {}
    if file.measurement is None:
        return out
    for name, entry in file.measurement.datasets.items():
        where = f"measurement.datasets.{name}.frame"
        frame = np.zeros(6) if entry.frame is None else pose_from_map(
            entry.frame, file.motion.frame_coordinates, units, source, where)
        target = np.array([*(entry.target or [0.0, 0.0, 0.0]), 0.0][:3]) * units.factor("length")
        turn = np.array(entry.target_rotation or [0.0, 0.0, 0.0]) * units.factor("angle")
        out[name] = Registration.of_pose(frame, target, turn, entry.scale)
    return out


def read_measured(file: MeasurementFile | None, units: Units, actuators: Sequence[str],
                  joints: Array, source: str) -> MeasurementBasis | None:
    """Return what the calibration saw, None where the file does not say.

    Args:
        file: the block.
        units: of the mechanism file.
        actuators: names of the joints.
        joints: SI value of one unit of each (k,).
        source: the mechanism file.

    Raises:
        BadInput: a range of a column that there is not.
    """
    if file is None or (file.noise is None and not file.ranges and file.converged is None):
        return None
    known = _columns(units, actuators, joints)
    refuse_unknown("column", file.ranges, known, f"{source}: measurement.ranges")
    ranges = {name: (low * known[name][0] + known[name][1], high * known[name][0] + known[name][1])
              for name, (low, high) in file.ranges.items()}
    noise = file.noise
    if noise is None:
        return MeasurementBasis(ranges=ranges, converged=file.converged)
    p = float("nan") if noise.chi2_p is None else noise.chi2_p
    return MeasurementBasis(noise.sigma_ratio, p, ranges, file.converged)


def measurement_tree(mechanism: Mechanism) -> dict[str, Any]:
    """Return the block as plain data, empty where there is nothing to keep."""
    out: dict[str, Any] = {}
    if mechanism.registrations:
        out["datasets"] = _registrations(mechanism)
    seen = mechanism.measured
    if seen is not None and np.isfinite(seen.sigma_ratio):
        out["noise"] = {"sigma_ratio": seen.sigma_ratio,
                        **({"chi2_p": seen.chi2_p} if np.isfinite(seen.chi2_p) else {})}
    if seen is not None and seen.converged is not None:
        out["converged"] = seen.converged
    if seen is not None and seen.ranges:
        known = _columns(mechanism.units, mechanism.actuators, mechanism.joint_factors())
        out["ranges"] = {name: [_shown(value, *known[name]) for value in ends]
                         for name, ends in seen.ranges.items()}
    return out


def _shown(value: float, factor: float, zero: float) -> float:
    """Return a number in file units; to a millionth where zero is elsewhere, as rounding is."""
    return round(value - zero, 6) if zero else to_file(value, factor)


def _columns(units: Units, actuators: Sequence[str], joints: Array
             ) -> dict[str, tuple[float, float]]:
    """Return the columns that have ranges: name -> SI value of one unit, and of zero."""
    return {**{c: (units.factor(coordinate_quantity(c)), 0.0) for c in COORDINATES},
            **{f"q_{a}": (float(f), 0.0) for a, f in zip(actuators, joints, strict=True)},
            **{c: (1.0, zero) for c, zero in CONDITIONS.items()}}


def _registrations(mechanism: Mechanism) -> Mapping[str, Any]:
    units = mechanism.units
    return {name: {
        "frame": pose_to_map(r.frame_pose, mechanism.motion.frame_coordinates, units),
        "target": [to_file(float(v), units.factor("length")) for v in r.target],
        "target_rotation": [to_file(float(v), units.factor("angle")) for v in r.target_rotation],
        **({} if r.scale == 1.0 else {"scale": r.scale}),
    } for name, r in mechanism.registrations.items()}
