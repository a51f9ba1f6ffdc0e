"""Several sessions of one machine: what is common, and what changed between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.lazy import on_first_use

if TYPE_CHECKING:
    from ppmcal.calibration.sessions.change_detection import Change as Change
    from ppmcal.calibration.sessions.change_detection import ChangePart as ChangePart
    from ppmcal.calibration.sessions.change_detection import Comparison as Comparison
    from ppmcal.calibration.sessions.change_detection import between as between
    from ppmcal.calibration.sessions.change_detection import carried_on as carried_on
    from ppmcal.calibration.sessions.common_misfit import DifferenceNoise as DifferenceNoise
    from ppmcal.calibration.sessions.common_parameters import CERTAIN as CERTAIN
    from ppmcal.calibration.sessions.common_parameters import FEWEST as FEWEST
    from ppmcal.calibration.sessions.common_parameters import CommonError as CommonError
    from ppmcal.calibration.sessions.common_parameters import common_errors as common_errors
    from ppmcal.calibration.sessions.common_parameters import share_interval as share_interval
    from ppmcal.calibration.sessions.day_noise import REPEATS as REPEATS
    from ppmcal.calibration.sessions.day_noise import STATED as STATED
    from ppmcal.calibration.sessions.day_noise import DayNoise as DayNoise
    from ppmcal.calibration.sessions.day_noise import UnlikeRow as UnlikeRow
    from ppmcal.calibration.sessions.day_noise import with_day_noise as with_day_noise
    from ppmcal.calibration.sessions.joint_fit import fitted_together as fitted_together
    from ppmcal.calibration.sessions.pose_difference import PoseDifference as PoseDifference
    from ppmcal.calibration.sessions.session_posteriors import SESSION as SESSION
    from ppmcal.calibration.sessions.session_posteriors import (
        defining_parameters as defining_parameters,
    )
    from ppmcal.calibration.sessions.session_posteriors import (
        session_knowledge as session_knowledge,
    )

if not TYPE_CHECKING:   # type checkers read the names above
    __getattr__ = on_first_use(__name__)
