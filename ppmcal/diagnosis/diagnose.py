"""The door: what is missing in a machine's model, and how sure that is."""

from __future__ import annotations

from dataclasses import replace

from ppmcal.calibration.fit import Problem, bounded
from ppmcal.diagnosis.from_evidence import diagnosed
from ppmcal.diagnosis.refit import MOST_STEPS as REFIT_STEPS
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.diagnosis.search_rounds import DiagnosisOptions as DiagnosisOptions
from ppmcal.wording import counted

MOST_STEPS = 4000
"""Steps that the fits of one search may try together: some times what any needs that ends by
itself. Three freedoms and forty poses may need 500, a hexapod that wanders 900."""
ENDED = (f"the search was ended after {MOST_STEPS} steps of its fits, which wander: what was named "
         "by then is told as far as its fit had got, and rivals, learned terms and what to measure "
         "next may be missing; state what is known (stiffness, load) in the mechanism file, or "
         "try fewer kinds")

CUT = ("{} with further effects wandered and went no farther than " + str(REFIT_STEPS)
       + " steps: effects that only a longer one would show may be missing")


def diagnose(problem: Problem, options: DiagnosisOptions | None = None
             ) -> Diagnosis:
    """Find what is missing in the machine's model, add it, and say how sure that is.

    Args:
        problem: machine, data and free geometry.
        options: seed and the like.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.calibration.fit.identify`.
    """
    with bounded(MOST_STEPS) as work:
        options = options or DiagnosisOptions()
        found = diagnosed(problem, options)
    said = [ENDED] if work.ended else [CUT.format(counted(work.cut, "fit"))] if work.cut else []
    return replace(found, findings=(*found.findings, *said))
