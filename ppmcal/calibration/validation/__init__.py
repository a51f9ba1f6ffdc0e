"""How well a fit predicts: residuals, rows and sessions left out, summary."""

from __future__ import annotations

from ppmcal.calibration.validation.frozen_models import (
    FEWEST,
    OPEN,
    FrozenModel,
    ModelError,
    Validated,
    validated,
    with_and_without,
)
from ppmcal.calibration.validation.left_out_rows import DoubtfulStretch, LeftOut, left_out, thirds
from ppmcal.calibration.validation.nominal_machine import DEFINITION, before
from ppmcal.calibration.validation.residual_vectors import Residuals, fresh_state, residuals, split
from ppmcal.calibration.validation.session_validation import other_sessions
from ppmcal.calibration.validation.summary import Dependence, Identification, report

__all__ = [
    "DEFINITION",
    "FEWEST",
    "OPEN",
    "Dependence",
    "DoubtfulStretch",
    "FrozenModel",
    "Identification",
    "LeftOut",
    "ModelError",
    "Residuals",
    "Validated",
    "before",
    "fresh_state",
    "left_out",
    "other_sessions",
    "report",
    "residuals",
    "split",
    "thirds",
    "validated",
    "with_and_without",
]
