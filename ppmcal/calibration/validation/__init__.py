"""Predictive accuracy of a fit: residuals, rows and sessions held out, summary."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.lazy import on_first_use

if TYPE_CHECKING:
    from ppmcal.calibration.validation.accuracy import Budget as Budget
    from ppmcal.calibration.validation.accuracy import Contribution as Contribution
    from ppmcal.calibration.validation.accuracy import Figure as Figure
    from ppmcal.calibration.validation.accuracy import PlacedError as PlacedError
    from ppmcal.calibration.validation.frozen_models import FEWEST as FEWEST
    from ppmcal.calibration.validation.frozen_models import FrozenModel as FrozenModel
    from ppmcal.calibration.validation.frozen_models import ModelError as ModelError
    from ppmcal.calibration.validation.frozen_models import Validated as Validated
    from ppmcal.calibration.validation.frozen_models import validated as validated
    from ppmcal.calibration.validation.frozen_models import with_and_without as with_and_without
    from ppmcal.calibration.validation.left_out_rows import UNUSED as UNUSED
    from ppmcal.calibration.validation.left_out_rows import DoubtfulStretch as DoubtfulStretch
    from ppmcal.calibration.validation.left_out_rows import LeftOut as LeftOut
    from ppmcal.calibration.validation.left_out_rows import left_out as left_out
    from ppmcal.calibration.validation.left_out_rows import thirds as thirds
    from ppmcal.calibration.validation.left_out_rows import unused as unused
    from ppmcal.calibration.validation.left_out_rows import unused_sentences as unused_sentences
    from ppmcal.calibration.validation.nominal_machine import DEFINITION as DEFINITION
    from ppmcal.calibration.validation.nominal_machine import before as before
    from ppmcal.calibration.validation.nominal_machine import definition as definition
    from ppmcal.calibration.validation.residual_vectors import Residuals as Residuals
    from ppmcal.calibration.validation.residual_vectors import fresh_state as fresh_state
    from ppmcal.calibration.validation.residual_vectors import other_sessions as other_sessions
    from ppmcal.calibration.validation.residual_vectors import residuals as residuals
    from ppmcal.calibration.validation.residual_vectors import split as split
    from ppmcal.calibration.validation.summary import Dependence as Dependence
    from ppmcal.calibration.validation.summary import Identification as Identification
    from ppmcal.calibration.validation.summary import beyond_tolerances as beyond_tolerances
    from ppmcal.calibration.validation.summary import report as report
    from ppmcal.calibration.validation.summary import rows_left_out as rows_left_out

if not TYPE_CHECKING:   # type checkers read the names above
    __getattr__ = on_first_use(__name__)
