"""Registrations as rivals of named effects: they take precedence.

A moved instrument, a redefined body or a rehomed pose set looks like an effect, or like geometry,
if a sidecar keeps the registration fixed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import (
    Fit,
    Problem,
    RegistrationHint,
    hint_sentences,
    hint_words,
    registration_hints,
    values_taken,
    white_squares,
)
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.inference.priors import SURE_ODDS
from ppmcal.linalg import finite_rows
from ppmcal.wording.progress import start_stage

AS_GOOD = 2.0 * np.log(SURE_ODDS)
"""Explanations whose BIC differs by at most this count as equally good."""


def diagnose_with_registration(problem: Problem, options: DiagnosisOptions) -> Diagnosis:
    """Return the diagnosis, considering registrations that files keep fixed as explanations.

    If freeing one lowers the error and no named effect explains it as well, the search is repeated
    with it free. If named effects explain it equally well, it is listed as their alternative.

    Args:
        problem: machine, data and free geometry.
        options: of the diagnosis.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.diagnosis.diagnose.diagnose`.
    """
    found = diagnose(problem, options)
    hints = registration_hints(found.before)
    if not hints:
        return found
    told = tuple(hint_sentences(found.before, hints))
    worse = _worse(found, hints[-1]) if found.effects else np.inf
    if worse > AS_GOOD:
        start_stage("again with " + " and ".join(hint_words(found.before, h) for h in hints))
        found = diagnose(replace(hints[-1].opened, pivots=None, given=None), options)
    elif worse > -AS_GOOD:
        label = hint_words(found.before, hints[0])
        odds = float(np.exp(np.clip(-worse / 2.0, -50.0, 50.0)))
        found = replace(
            found, verdict="named-set" if found.verdict == "named" else found.verdict,
            effects=tuple(replace(e, alternatives=(*e.alternatives, label),
                                  probabilities=(*e.probabilities, e.probability / odds))
                          for e in found.effects))
    return replace(found, findings=(*told, *found.findings))


def _worse(found: Diagnosis, hint: RegistrationHint) -> float:
    """Return the BIC of the named effects minus that of the registration."""
    square, count = _squares(found.identification.fit, hint)
    other = hint.square * found.before.noise**2
    n = min(count, hint.count)
    fit = found.identification.fit
    fitted = values_taken(fit)
    # use the noise of the better of the two, at least the stated noise
    noise = max(1.0, min(square / max(count - fitted, 1.0),
                         other / max(hint.count - hint.fitted, 1.0)))
    return float((square / count - other / hint.count) * n / noise
                 + (fitted - hint.fitted) * np.log(n))


def _squares(fit: Fit, hint: RegistrationHint) -> tuple[float, float]:
    """Return the sum and count of squared whitened residuals, by stated noise, of a hint's rows."""
    keep = [k & finite_rows(p) for k, p in zip(hint.keep, fit.state.poses, strict=True)]
    square, count = white_squares(fit.problem, fit.state, keep)
    return fit.noise**2 * square, count
