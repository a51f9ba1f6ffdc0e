"""What the probabilities of causes say of one data set, in the last round."""

from __future__ import annotations

from ppmcal.calibration.fit import FitOptions, Problem, identify
from ppmcal.diagnosis.explanation import Round, explained
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism


def last_round(mechanism: Mechanism, data: Dataset) -> Round:
    """Return what is found beside the geometry that is free."""
    fit = identify(with_whole_rows(Problem(mechanism, (data,), mechanism.free)), FitOptions())
    return explained(fit, FitOptions())[-1]
