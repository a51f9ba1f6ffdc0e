"""From a fitted machine to commands, and whether these are safe."""

from __future__ import annotations

from ppmcal.calibration.compensation.commands import (
    KINDS,
    Compensation,
    Knowledge,
    compensate,
    model_sigma,
    prediction_jacobian,
)
from ppmcal.calibration.compensation.kinematics_sigma import (
    PoseRows,
    forward_sigma,
    independent,
    joint_sigma,
    left_joint_sigma,
    sigma_by_differences,
)
from ppmcal.calibration.compensation.model_averaging import (
    Reading,
    Readings,
    Targets,
    averaged,
    probabilities,
)
from ppmcal.calibration.compensation.safe_commands import (
    is_worse,
    own_steps,
    refused,
    sent,
    unsafe_ways,
    worse_rows,
)

__all__ = [
    "KINDS",
    "Compensation",
    "Knowledge",
    "PoseRows",
    "Reading",
    "Readings",
    "Targets",
    "averaged",
    "compensate",
    "forward_sigma",
    "independent",
    "is_worse",
    "joint_sigma",
    "left_joint_sigma",
    "model_sigma",
    "own_steps",
    "prediction_jacobian",
    "probabilities",
    "refused",
    "sent",
    "sigma_by_differences",
    "unsafe_ways",
    "worse_rows",
]
