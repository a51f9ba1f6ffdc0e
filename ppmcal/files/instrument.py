"""Reading an instrument that has not measured yet: a sidecar without its CSV."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.registration import refuse_flat
from ppmcal.design.virtual_instrument import Instrument
from ppmcal.errors import BadInput
from ppmcal.files.columns import joint_factors
from ppmcal.files.schema import check
from ppmcal.files.sidecar import (
    SidecarFile,
    actuator_noise,
    frame_of,
    point_of,
    rotation_of,
    sigma_needs,
)
from ppmcal.files.yaml_text import read_yaml
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.model.dataset import Unknown
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units


def read_instrument(path: str | os.PathLike[str], mechanism: Mechanism) -> Instrument:
    """Return the instrument that a sidecar describes (contract section 2), SI.

    Raises:
        BadInput: anything wrong in the file, or an instrument that cannot be planned for.
    """
    source = str(path)
    file = check(SidecarFile, read_yaml(Path(path)), source)
    units, kind, sigma = file.units.units(), file.instrument.kind, file.instrument.sigma
    refuse_flat(kind, mechanism.motion, source)
    sigma_needs(file, source, mechanism.motion != "translational")
    frame = frame_of(file.frame, mechanism.motion, units, source)
    if frame.same_as is not None:
        raise BadInput("a plan is for one instrument: there is no other data set", f"{source}: "
                       "frame.same_as", "Write unknown, known, or the pose")
    if kind == "distance":
        frame = _from_point(file, frame, mechanism, units, source)
    length, angle = units.factor("length"), units.factor("angle")
    own = {"plane": sigma.height, "distance": sigma.distance}.get(kind) or sigma.position
    scalar = kind in ("plane", "distance")
    return Instrument(
        kind, np.nan if scalar else (sigma.position or np.nan) * length,
        (sigma.rotation or np.nan) * angle if kind == "pose" else np.nan,
        (own or np.nan) * length if scalar else np.nan,
        actuator_noise(sigma.actuator, mechanism, joint_factors(mechanism, length, angle), source),
        frame, point_of(file.target, mechanism.motion, units, source),
        rotation_of(file.target_rotation, units, source))


def _from_point(file: SidecarFile, frame: Unknown, mechanism: Mechanism, units: Units,
                source: str) -> Unknown:
    """Return the frame whose origin is the point that distances are measured from."""
    raw, place = file.instrument.point, f"{source}: instrument.point"
    if raw in (None, "unknown"):
        raise BadInput("which distances tell most depends on where the fixed point is", place,
                       "Write it as well as you know it, such as `point: [0, 0, 500]`, in the "
                       "base frame, and `frame: unknown` to have it fitted")
    point = point_of(raw, mechanism.motion, units, source, "instrument.point")
    away = cga.motor_from_rotation_vector(np.zeros(3), -point.value)
    return Unknown(frame.fitted, pose_vector(cga.compose(away, pose_motor(frame.value))))
