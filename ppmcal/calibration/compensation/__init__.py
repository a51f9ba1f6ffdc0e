"""From a fitted machine to commands, and whether these are safe."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.lazy import on_first_use

if TYPE_CHECKING:
    from ppmcal.calibration.compensation.commands import KINDS as KINDS
    from ppmcal.calibration.compensation.commands import Compensation as Compensation
    from ppmcal.calibration.compensation.commands import compensate as compensate
    from ppmcal.calibration.compensation.kinematics_sigma import PoseRows as PoseRows
    from ppmcal.calibration.compensation.kinematics_sigma import forward_sigma as forward_sigma
    from ppmcal.calibration.compensation.kinematics_sigma import independent as independent
    from ppmcal.calibration.compensation.kinematics_sigma import (
        joint_resolution as joint_resolution,
    )
    from ppmcal.calibration.compensation.kinematics_sigma import joint_sigma as joint_sigma
    from ppmcal.calibration.compensation.kinematics_sigma import (
        left_joint_sigma as left_joint_sigma,
    )
    from ppmcal.calibration.compensation.kinematics_sigma import (
        sigma_by_differences as sigma_by_differences,
    )
    from ppmcal.calibration.compensation.model_averaging import CandidateModel as CandidateModel
    from ppmcal.calibration.compensation.model_averaging import Readings as Readings
    from ppmcal.calibration.compensation.model_averaging import Targets as Targets
    from ppmcal.calibration.compensation.model_averaging import averaged as averaged
    from ppmcal.calibration.compensation.model_averaging import probabilities as probabilities
    from ppmcal.calibration.compensation.pose_sigma import (
        ParameterCovariance as ParameterCovariance,
    )
    from ppmcal.calibration.compensation.pose_sigma import model_sigma as model_sigma
    from ppmcal.calibration.compensation.pose_sigma import (
        prediction_jacobian as prediction_jacobian,
    )
    from ppmcal.calibration.compensation.safe_commands import is_worse as is_worse
    from ppmcal.calibration.compensation.safe_commands import own_steps as own_steps
    from ppmcal.calibration.compensation.safe_commands import refused as refused
    from ppmcal.calibration.compensation.safe_commands import sent as sent
    from ppmcal.calibration.compensation.safe_commands import unsafe_ways as unsafe_ways
    from ppmcal.calibration.compensation.safe_commands import worse_rows as worse_rows

if not TYPE_CHECKING:   # type checkers read the names above
    __getattr__ = on_first_use(__name__)
