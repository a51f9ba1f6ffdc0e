"""Several sessions of one machine: what is common, what has changed between them."""

from __future__ import annotations

from ppmcal.calibration.sessions.change_detection import (
    Change,
    ChangePart,
    Comparison,
    between,
    carried_on,
)
from ppmcal.calibration.sessions.common_misfit import DifferenceNoise
from ppmcal.calibration.sessions.common_parameters import (
    CERTAIN,
    FEWEST,
    CommonError,
    common_errors,
    share_interval,
)
from ppmcal.calibration.sessions.day_noise import REPEATS, STATED, DayNoise, with_day_noise
from ppmcal.calibration.sessions.joint_fit import fitted_together
from ppmcal.calibration.sessions.pose_difference import PoseDifference
from ppmcal.calibration.sessions.session_posteriors import SESSION, session_knowledge

__all__ = [
    "CERTAIN",
    "FEWEST",
    "REPEATS",
    "SESSION",
    "STATED",
    "Change",
    "ChangePart",
    "CommonError",
    "Comparison",
    "DayNoise",
    "DifferenceNoise",
    "PoseDifference",
    "between",
    "carried_on",
    "common_errors",
    "fitted_together",
    "session_knowledge",
    "share_interval",
    "with_day_noise",
]
