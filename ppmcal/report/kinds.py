"""What a page may hold: one declaration for each command, beside its section."""

from __future__ import annotations

from typing import Any

from ppmcal.report.checked_rows import COMPENSATE, KINEMATICS
from ppmcal.report.comparison import COMPARE
from ppmcal.report.design import DESIGN, OTHER
from ppmcal.report.diagnosis import DIAGNOSE
from ppmcal.report.exported import EXPORT
from ppmcal.report.identified import IDENTIFY
from ppmcal.report.section import Kind
from ppmcal.report.simulated import SIMULATE, TRUTH
from ppmcal.report.validation import CERTIFY, VALIDATE

KINDS: tuple[Kind[Any], ...] = (
    IDENTIFY, DIAGNOSE, COMPENSATE, KINEMATICS, SIMULATE, OTHER, DESIGN, VALIDATE, COMPARE, EXPORT,
    CERTIFY, TRUTH)
"""In the order of report.json."""
IN_ORDER = sorted(KINDS, key=lambda kind: kind.order)
"""In the order of the page."""
KNOWN = tuple(dict.fromkeys(file for kind in KINDS for file in kind.files))
"""Files by which a folder is recognised as a command's output."""
