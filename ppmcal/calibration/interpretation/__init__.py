"""What files may have meant: units, columns read differently, copies, rows of another machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.lazy import on_first_use

if TYPE_CHECKING:
    from ppmcal.calibration.interpretation.clock_offset import ClockOffset as ClockOffset
    from ppmcal.calibration.interpretation.clock_offset import SeenTargets as SeenTargets
    from ppmcal.calibration.interpretation.clock_offset import (
        find_clock_offset as find_clock_offset,
    )
    from ppmcal.calibration.interpretation.clock_offset import one_target as one_target
    from ppmcal.calibration.interpretation.copies import chance as chance
    from ppmcal.calibration.interpretation.copies import count_among as count_among
    from ppmcal.calibration.interpretation.copies import known_rows as known_rows
    from ppmcal.calibration.interpretation.copies import steps_of as steps_of
    from ppmcal.calibration.interpretation.copies import without_copies as without_copies
    from ppmcal.calibration.interpretation.copies import without_known as without_known
    from ppmcal.calibration.interpretation.copies import without_shared as without_shared
    from ppmcal.calibration.interpretation.data_check import Check as Check
    from ppmcal.calibration.interpretation.data_check import check as check
    from ppmcal.calibration.interpretation.interpretation_error import NOISE as NOISE
    from ppmcal.calibration.interpretation.interpretation_error import FileFault as FileFault
    from ppmcal.calibration.interpretation.interpretation_error import (
        Interpretation as Interpretation,
    )
    from ppmcal.calibration.interpretation.interpretation_error import (
        InterpretationError as InterpretationError,
    )
    from ppmcal.calibration.interpretation.interpretation_error import headers_of as headers_of
    from ppmcal.calibration.interpretation.interpretation_error import in_headers as in_headers
    from ppmcal.calibration.interpretation.interpretation_error import (
        interpretation_sentence as interpretation_sentence,
    )
    from ppmcal.calibration.interpretation.interpretation_error import with_line as with_line
    from ppmcal.calibration.interpretation.obvious_mistakes import plain_mistakes as plain_mistakes
    from ppmcal.calibration.interpretation.obvious_mistakes import recorded_units as recorded_units
    from ppmcal.calibration.interpretation.obvious_mistakes import (
        rows_with_negative_struts as rows_with_negative_struts,
    )
    from ppmcal.calibration.interpretation.obvious_mistakes import without_stale as without_stale
    from ppmcal.calibration.interpretation.plausibility import unit_findings as unit_findings
    from ppmcal.calibration.interpretation.read_rightly import refuse_after_fit as refuse_after_fit
    from ppmcal.calibration.interpretation.read_rightly import (
        refuse_before_fit as refuse_before_fit,
    )
    from ppmcal.calibration.interpretation.read_rightly import refuse_columns as refuse_columns
    from ppmcal.calibration.interpretation.read_rightly import (
        refuse_other_machine as refuse_other_machine,
    )
    from ppmcal.calibration.interpretation.rope_tightness import slack_ropes as slack_ropes
    from ppmcal.calibration.interpretation.stated_places import place_hints as place_hints

if not TYPE_CHECKING:   # type checkers read the names above
    __getattr__ = on_first_use(__name__)
