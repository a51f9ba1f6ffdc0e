"""Named effects on another day: each session predicted by a fit of the others.

The session took part in choosing the effects, but not in fitting the sizes that predict it.

The machine with all effects is fitted to the other sessions, and again without each effect and
without any; these frozen models predict the session left out, including rows that the fit of all
sessions rejected as outliers. Only the registration is fitted there.
"""

from __future__ import annotations

from collections.abc import Sequence

from ppmcal.calibration.fit import Fit, FitOptions, Problem, identify, rows_with_outliers
from ppmcal.calibration.validation import (
    FEWEST,
    FrozenModel,
    Validated,
    other_sessions,
    validated,
    with_and_without,
)
from ppmcal.errors import PpmcalError
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.sessions import session_masks
from ppmcal.notes import Note
from ppmcal.wording.progress import start_stage


def other_days(final: Fit, options: FitOptions, seed: int) -> tuple[Validated, ...]:
    """Return how well each session is predicted from the others, with and without each effect.

    Empty for a single session. Sessions with too few rows, and those without which the machine
    cannot be fitted, are skipped.

    Args:
        final: the fit of all rows with the effects found.
        options: of the fits.
        seed: of the bootstrap.
    """
    problem = final.problem
    if len(session_masks(problem.datasets)) < 2:
        return ()
    start_stage("predicting each session from the others")
    machine = problem.mechanism.with_values(final.state.g)
    out: list[Validated] = []
    for rest, own in other_sessions(problem.datasets, final.keep,
                                    rows_with_outliers(final)):
        # heights and distances of one campaign are not days: neither predicts the other
        days = [d.alone() for d in own if len(d) >= FEWEST and any(
            d.kind == r.kind for r in rest)]
        if not days:
            continue
        try:
            models = [FrozenModel(m.label, _fitted(m.mechanism, rest, options))
                      for m in with_and_without(machine)]
            out += validated([*models, FrozenModel("nominal", machine.nominal())], days, None, seed)
        except PpmcalError:
            continue    # too few rows, or no fit: nothing to report for that day
    return tuple(out)


def _fitted(machine: Mechanism, rest: Sequence[Dataset], options: FitOptions) -> Mechanism:
    """Return a machine identified from the other sessions."""
    found = identify(Problem(machine, tuple(rest), machine.free), options)
    return machine.with_values(found.state.g)


def confirmed(days: Sequence[Validated]) -> bool | None:
    """Return whether the effects clearly improve one day's prediction and clearly worsen none.

    None if there are no effects or no days.
    """
    sure = [e.sure for day in days for e in day.errors if e.label == without_any(day)]
    return None if not sure else min(sure) < 0 and max(sure) <= 0


def without_any(day: Validated) -> str:
    """Return the label of the machine without effects, an empty string if there is none."""
    return next((e.label for e in reversed(day.errors) if e.label.startswith("without")), "")


def worse_days(days: Sequence[Validated]) -> list[Note]:
    """Return findings on effects without which a day is clearly predicted better."""
    out = []
    for day in days:
        whole = day.errors[0].size["rms"]
        out += [Note(f"{day.name} is predicted better {e.label}, by {100.0 * e.closer / whole:.0f} "
                     "%: its size in the other sessions is not the machine's", topic="sessions")
                for e in day.errors if e.sure > 0 and e.label.startswith("without")]
    return out
