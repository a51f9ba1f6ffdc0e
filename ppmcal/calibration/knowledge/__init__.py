"""What a fit knows: covariances, intervals, what is identifiable and what is held."""

from __future__ import annotations

from ppmcal.calibration.knowledge.consider_parameters import Considered, considered
from ppmcal.calibration.knowledge.disagreement import Disagreement
from ppmcal.calibration.knowledge.distance_from_nominal import farthest
from ppmcal.calibration.knowledge.extrapolation import (
    OUTSIDE,
    extrapolated,
    measured_ranges,
    refuse_far,
)
from ppmcal.calibration.knowledge.freedom_choice import (
    FreedomChoice,
    choice_sentence,
    with_chosen_freedoms,
)
from ppmcal.calibration.knowledge.identifiability_report import (
    CALIPER,
    CollinearParameters,
    Identifiability,
    Scale,
    identifiability,
    predict_identifiability,
    with_held,
)
from ppmcal.calibration.knowledge.intervals import by_noise, coverage, honest, in_words
from ppmcal.calibration.knowledge.parameter_estimates import (
    FAR,
    IMPLAUSIBLE,
    Estimate,
    estimates,
    far_from_nominal,
    registered,
    with_estimates,
)
from ppmcal.calibration.knowledge.ranges import measured_by
from ppmcal.calibration.knowledge.tension import pulled_apart
from ppmcal.calibration.knowledge.tolerance_moves import as_pose, by_tolerances
from ppmcal.calibration.knowledge.tolerated_noise import noise_beyond_tolerances

__all__ = [
    "CALIPER",
    "FAR",
    "IMPLAUSIBLE",
    "OUTSIDE",
    "CollinearParameters",
    "Considered",
    "Disagreement",
    "Estimate",
    "FreedomChoice",
    "Identifiability",
    "Scale",
    "as_pose",
    "by_noise",
    "by_tolerances",
    "choice_sentence",
    "considered",
    "coverage",
    "estimates",
    "extrapolated",
    "far_from_nominal",
    "farthest",
    "honest",
    "identifiability",
    "in_words",
    "measured_by",
    "measured_ranges",
    "noise_beyond_tolerances",
    "predict_identifiability",
    "pulled_apart",
    "refuse_far",
    "registered",
    "with_chosen_freedoms",
    "with_estimates",
    "with_held",
]
