"""What a file may have meant: columns read otherwise, rows that are not this machine's."""

from __future__ import annotations

from ppmcal.calibration.interpretation.data_check import Check, check, home_gaps
from ppmcal.calibration.interpretation.misread import Misread, misreading_sentence
from ppmcal.calibration.interpretation.mistakes import Mistake, with_line
from ppmcal.calibration.interpretation.negative_struts import rows_with_negative_struts
from ppmcal.calibration.interpretation.obvious_mistakes import plain_mistakes, recorded_units
from ppmcal.calibration.interpretation.other_machine import refuse_other_machine
from ppmcal.calibration.interpretation.read_rightly import refuse_after_fit, refuse_before_fit
from ppmcal.calibration.interpretation.reading_trial import NOISE, Misreading
from ppmcal.calibration.interpretation.stale_rows import without_stale

__all__ = [
    "NOISE",
    "Check",
    "Misread",
    "Misreading",
    "Mistake",
    "check",
    "home_gaps",
    "misreading_sentence",
    "plain_mistakes",
    "recorded_units",
    "refuse_after_fit",
    "refuse_before_fit",
    "refuse_other_machine",
    "rows_with_negative_struts",
    "with_line",
    "without_stale",
]
