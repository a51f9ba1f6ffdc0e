"""The fit of given rows, from near its minimum."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from ppmcal import linalg
from ppmcal.calibration.fit.fit_result import Fit, FitOptions
from ppmcal.calibration.fit.gauss_newton import Minimum, least_squares
from ppmcal.calibration.fit.linearisation import QRFactor, column_scale, qr_factor
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.linalg import Array, Bools

log = logging.getLogger(__package__)


def fit_rows(problem: Problem, state: State, keep: Sequence[Bools],
             reasons: Sequence[dict[int, str]], prior: Array, options: FitOptions,
             scale: float = 1.0) -> Fit:
    """Return the minimum of the rows in use.

    Args:
        problem: machine, data and free parameters.
        state: a start near the minimum.
        keep: which rows (N,) of each data set are in use.
        reasons: why others are not, by row.
        prior: weights (C,) of the parameters, 1/SI.
        options: method and its settings.
        scale: by which the tolerances were scaled in ``prior``.
    """
    found = least_squares(problem, state, keep, prior, options.most, None)
    reduced = found.reduced or qr_factor(problem, found.state, keep)
    _remark(problem, found, reduced, keep)
    return Fit(problem, found.state, reduced, prior, column_scale(problem), tuple(keep),
               found.iterations, found.converged, prior_scale=scale, reasons=tuple(reasons),
               summed=found.summed)


def _remark(problem: Problem, found: Minimum, reduced: QRFactor, keep: Sequence[Bools]) -> None:
    """Log how a fit went."""
    if log.isEnabledFor(logging.INFO):
        used = reduced.triangle * column_scale(problem)
        condition = float(linalg.condition(used)) if used.size else 1.0
        log.info("%d columns to %d rows: %s after %d iterations, %d of them from normal equations, "
                 "the others by QR; chi-squared %.6g, condition of the data alone %.2g",
                 len(problem.columns), sum(int(k.sum()) for k in keep),
                 "converged" if found.converged else "not converged", found.iterations,
                 found.summed, reduced.square, condition)
