"""Knowledge from a fit: covariances, intervals, what is identifiable and what is held."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.lazy import on_first_use

if TYPE_CHECKING:
    from ppmcal.calibration.knowledge.consider_parameters import Considered as Considered
    from ppmcal.calibration.knowledge.consider_parameters import as_pose as as_pose
    from ppmcal.calibration.knowledge.consider_parameters import by_tolerances as by_tolerances
    from ppmcal.calibration.knowledge.consider_parameters import considered as considered
    from ppmcal.calibration.knowledge.consider_parameters import none_considered as none_considered
    from ppmcal.calibration.knowledge.extrapolation import OUTSIDE as OUTSIDE
    from ppmcal.calibration.knowledge.extrapolation import extrapolated as extrapolated
    from ppmcal.calibration.knowledge.extrapolation import far_outside as far_outside
    from ppmcal.calibration.knowledge.extrapolation import measured_by as measured_by
    from ppmcal.calibration.knowledge.extrapolation import measured_ranges as measured_ranges
    from ppmcal.calibration.knowledge.freedom_choice import FreedomChoice as FreedomChoice
    from ppmcal.calibration.knowledge.freedom_choice import FreedomSet as FreedomSet
    from ppmcal.calibration.knowledge.freedom_choice import choice_sentence as choice_sentence
    from ppmcal.calibration.knowledge.freedom_choice import (
        with_chosen_freedoms as with_chosen_freedoms,
    )
    from ppmcal.calibration.knowledge.identifiability_report import CALIPER as CALIPER
    from ppmcal.calibration.knowledge.identifiability_report import (
        CollinearParameters as CollinearParameters,
    )
    from ppmcal.calibration.knowledge.identifiability_report import (
        Identifiability as Identifiability,
    )
    from ppmcal.calibration.knowledge.identifiability_report import Scale as Scale
    from ppmcal.calibration.knowledge.identifiability_report import (
        identifiability as identifiability,
    )
    from ppmcal.calibration.knowledge.identifiability_report import (
        predict_identifiability as predict_identifiability,
    )
    from ppmcal.calibration.knowledge.identifiability_report import with_held as with_held
    from ppmcal.calibration.knowledge.intervals import by_noise as by_noise
    from ppmcal.calibration.knowledge.intervals import cluster_robust as cluster_robust
    from ppmcal.calibration.knowledge.intervals import coverage as coverage
    from ppmcal.calibration.knowledge.intervals import in_words as in_words
    from ppmcal.calibration.knowledge.parameter_estimates import FAR as FAR
    from ppmcal.calibration.knowledge.parameter_estimates import FAR_BECAUSE as FAR_BECAUSE
    from ppmcal.calibration.knowledge.parameter_estimates import IMPLAUSIBLE as IMPLAUSIBLE
    from ppmcal.calibration.knowledge.parameter_estimates import Estimate as Estimate
    from ppmcal.calibration.knowledge.parameter_estimates import estimates as estimates
    from ppmcal.calibration.knowledge.parameter_estimates import (
        far_from_nominal as far_from_nominal,
    )
    from ppmcal.calibration.knowledge.parameter_estimates import farthest as farthest
    from ppmcal.calibration.knowledge.parameter_estimates import (
        measuring_frames as measuring_frames,
    )
    from ppmcal.calibration.knowledge.parameter_estimates import registered as registered
    from ppmcal.calibration.knowledge.parameter_estimates import with_estimates as with_estimates
    from ppmcal.calibration.knowledge.platform_tilt import ToolHeight as ToolHeight
    from ppmcal.calibration.knowledge.platform_tilt import tilt_sentences as tilt_sentences
    from ppmcal.calibration.knowledge.platform_tilt import tool_height as tool_height
    from ppmcal.calibration.knowledge.session_variance import SessionVariance as SessionVariance
    from ppmcal.calibration.knowledge.tension import (
        noise_beyond_tolerances as noise_beyond_tolerances,
    )
    from ppmcal.calibration.knowledge.tension import pulled_apart as pulled_apart

if not TYPE_CHECKING:   # type checkers read the names above
    __getattr__ = on_first_use(__name__)
