"""What the probabilities of causes say of one data set, in the last round."""

from __future__ import annotations

from collections.abc import Sequence

from ppmcal.calibration.fit import Fit, FitOptions, Problem, identify
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.explanation import Round, explained
from ppmcal.diagnosis.linear_system import Whitening, build
from ppmcal.diagnosis.linearisation import Linearisation, linearisation_of
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism


def last_round(mechanism: Mechanism, data: Dataset) -> Round:
    """Return what is found beside the geometry that is free."""
    fit = identify(with_whole_rows(Problem(mechanism, (data,), mechanism.free)), FitOptions())
    return explained(fit, FitOptions())[-1]


def stage_at(fit: Fit, kinds: Sequence[str] | None = None) -> Linearisation:
    """Return the linear problem of a fit, noise white, nothing chosen."""
    system = build(fit.problem, fit.state, fit.keep)
    return linearisation_of(system, library(system, kinds), (), Whitening())
