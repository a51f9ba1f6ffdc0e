"""The machine before its calibration: one definition for every command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import Problem, labels
from ppmcal.calibration.knowledge import registered
from ppmcal.calibration.validation.residual_vectors import (
    LEFT_OUT,
    Residuals,
    fresh_state,
    register_only,
    residuals,
)
from ppmcal.errors import PpmcalError
from ppmcal.linalg import Bools
from ppmcal.model.registration import Registration

DEFINITION = ("the uncalibrated machine (only unknown frame and target fitted); errors are RMS "
              "distances")
"""Meaning of ``before`` in every command."""
CLOSURE_ALONE = "the uncalibrated machine; errors are how far limbs are from closing"
"""Its meaning for joint values alone."""


def definition(blind: bool) -> str:
    """Return the meaning of ``before``; ``blind``: for joint values alone."""
    return CLOSURE_ALONE if blind else DEFINITION


@dataclass(frozen=True, eq=False)
class Before:
    """Errors of the nominal machine, SI, and the resulting registrations by name."""

    residuals: Residuals
    registrations: Mapping[str, Registration]


def before(problem: Problem, keep: Sequence[Bools]) -> Before:
    """Return the errors of the machine before its calibration, as :data:`DEFINITION` says.

    They depend on the nominal values and the rows alone, not on the fit, its noise or its effects,
    so that commands that use the same rows report the same figures.

    Args:
        problem: machine and data; which of its parameters are free does not matter.
        keep: rows in use (N,), by data set.

    Returns:
        Errors of all rows, including those not in use; nan, and no registration, if the
        nominal machine reaches no row.
    """
    sets = problem.datasets
    used = tuple(d if k.all() else d.without(~k, LEFT_OUT) for d, k in zip(sets, keep, strict=True))
    bare = problem.changed(mechanism=problem.mechanism.nominal(), datasets=used, free=(),
                           given=None, earlier=None)
    try:
        state = register_only(bare, robust=False).state
    except PpmcalError:
        return nothing_before(problem)
    whole = replace(bare, datasets=sets)
    return Before(residuals(whole, fresh_state(whole, state)), registered(whole, state))


def nothing_before(problem: Problem) -> Before:
    """Return errors that are all nan, of the right shapes, and no registrations."""
    rows = [len(d) for d in problem.datasets]
    vectors = tuple(np.full((n, len(labels(d, problem.mechanism))), np.nan)
                    for n, d in zip(rows, problem.datasets, strict=True))
    norms = tuple(np.full(n, np.nan) for n in rows)
    gaps = tuple(np.full((n, problem.mechanism.equations), np.nan) for n in rows)
    return Before(Residuals(vectors, vectors, norms, norms, gaps), {})
