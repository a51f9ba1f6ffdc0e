"""Estimates of a machine's parameters, their uncertainties, and estimates far from nominal.

Weakly seen parameters are pulled to nominal, so an estimate is judged by the errors that such data
would find in machines within their tolerances: with the tolerances as prior their variance is the
tolerance's less the posterior's, without a prior it is the sum of both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from ppmcal.calibration.fit import (
    CONVERGED,
    FAILED_NOISE,
    Z95,
    Fit,
    Problem,
    Rank,
    State,
    half_or,
    posterior,
    prediction_covariance,
    seen_directions,
)
from ppmcal.calibration.knowledge.session_variance import SessionVariance
from ppmcal.linalg import Array, svd
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.notes import Note
from ppmcal.units import Units


def farthest(count: int) -> float:
    """Return how many sigmas from nominal the farthest of so many estimates may be.

    Two-sided, at the level of a failed check divided by their number (Bonferroni).

    >>> round(farthest(1), 2), round(farthest(20), 2)
    (3.29, 4.06)
    """
    return float(-ndtri(0.5 * FAILED_NOISE / max(count, 1)))


def expected_errors(fit: Fit) -> Array:
    """Return the size of errors that such data find in each free parameter (F,), SI, one sigma.

    For machines within their tolerances; for a parameter without one, by noise alone. With
    the information J'J of the rows and the fit's covariance P the estimates are P J'J times the
    errors, and noise adds P J'J P.
    """
    problem = fit.problem
    tolerances = np.zeros(len(problem.columns))
    for c, p in enumerate(problem.free):
        tolerances[c] = problem.mechanism.parameters[p].prior_sigma or 0.0
    known = prediction_covariance(fit) / np.outer(fit.scale, fit.scale)
    rows = fit.information.root * fit.scale
    found = known @ (rows.T @ rows)
    # a fit ends within this of the minimum of its chi-squared
    variance = (found**2 @ (tolerances / fit.scale) ** 2 + np.sum((known @ rows.T) ** 2, axis=1)
                + CONVERGED * np.diagonal(known))
    return np.asarray((np.sqrt(variance) * fit.scale)[:len(problem.free)])


IMPLAUSIBLE = 8.0
"""No real machine is this many tolerances from its nominal values."""
FAR = "farther from nominal than tolerances allow"
"""Description of such parameters."""
FAR_BECAUSE = "the nominal values, the tolerances, the units or the data are wrong there"
"""Its explanation."""
SHOWN = 3
"""Number reported, the farthest first."""


@dataclass(frozen=True)
class Estimate:
    """One parameter after the fit, SI. ``status``: identified, fixed or redundant.

    ``nominal`` is nan if there is none: the initial value of a fitted effect's stiffness, period
    or time constant is only a start.

    ``sigma``: by the noise of rows, prior and held parameters included; ``by_noise``: half width
    of the 95 % interval by noise of uncertain size, None: 1.96 sigma; ``half``: the same including
    differences between sessions, None if only noise is known; ``by_session``: label, value, sigma
    and half width of the 95 % interval of each session's own fit; ``p_value`` of these being one
    value, and whether they ``disagree``. ``expected``: the error (one sigma) that such data find
    in machines within their tolerances, None without a tolerance; ``far``: whether it is farther
    from nominal than that allows.
    """

    name: str
    quantity: str
    per_unit: bool
    nominal: float
    value: float
    sigma: float | None
    sigma_data: float | None
    tolerance: float | None
    status: str
    by_noise: float | None = None
    half: float | None = None
    by_session: tuple[tuple[str, float, float, float], ...] = ()
    p_value: float | None = None
    disagree: bool = False
    expected: float | None = None
    far: bool = False

    @property
    def error(self) -> float:
        """The identified error: value - nominal."""
        return self.value - self.nominal

    @property
    def half_by_noise(self) -> float | None:
        """Half width of the 95 % interval by noise alone, None without one."""
        return half_or(self.by_noise, self.sigma)

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval of the value, including prior and disagreement of sessions."""
        half = self.half_by_noise if self.half is None else self.half
        return None if half is None else (self.value - half, self.value + half)

    @property
    def carried(self) -> float | None:
        """Standard uncertainty in the model file: half width of the interval over 1.96."""
        return self.sigma if self.half is None else self.half / Z95


def estimates(fit: Fit, rank: Rank, wider: SessionVariance | None = None,
              by_noise: Array | None = None, held: Array | None = None,
              pull: Array | None = None) -> tuple[Estimate, ...]:
    """Return all parameters of the machine with their uncertainties.

    Args:
        fit: a finished one.
        rank: of its columns.
        wider: disagreement of sessions or blocks of rows.
        by_noise: half width of the 95 % interval of each column by noise and ``held`` (C,), if
            not 1.96 sigma.
        held: contribution to the columns' variances (C,) of parameters that were held though
            they may be off.
        pull: deviation of columns from nominal due to tolerances of the frame-defining parameters
            (C, G), one standard deviation.
    """
    variance = np.diagonal(posterior(fit)) + (0.0 if held is None else held)
    data_sigma = from_data_alone(fit, rank)
    column = {p: c for c, p in enumerate(fit.problem.free)}
    out = []
    for p, parameter in enumerate(fit.problem.mechanism.parameters):
        c = column.get(p)
        sigma, from_data, status = parameter.sigma, None, "fixed"
        if c is not None:
            sigma = float(np.sqrt(variance[c])) if np.isfinite(variance[c]) else None
            status = "identified" if c in data_sigma else "redundant"
            from_data = data_sigma.get(c)
        out.append(Estimate(parameter.name, parameter.quantity, parameter.per_unit,
                            np.nan if c is not None and (parameter.reciprocal
                                                         or parameter.nonlinear)
                            else parameter.nominal, float(fit.state.g[p]), sigma, from_data,
                            parameter.tolerance, status))
        if c is not None and by_noise is not None and sigma is not None:
            out[-1] = replace(out[-1], by_noise=float(by_noise[c]))
        if c is not None and wider is not None and sigma is not None:
            out[-1] = replace(out[-1], **_by_session(out[-1], wider, c))
    expected = expected_errors(fit)
    if pull is not None:
        expected = np.hypot(expected, np.linalg.norm(pull[:expected.size], axis=1))
    return _judged(out, dict(zip(fit.problem.free, expected.tolist(), strict=True)))


def _judged(found: Sequence[Estimate], expected: Mapping[int, float]) -> tuple[Estimate, ...]:
    """Return the estimates with ``far`` set; ``expected``: by parameter.

    Differences between sessions add to the noise.
    """
    out = list(found)
    for p, sigma in expected.items():
        e = out[p]
        if e.sigma is not None and e.tolerance and np.isfinite([e.tolerance, e.error]).all():
            more = max((e.carried or 0.0) ** 2 - e.sigma**2, 0.0)
            out[p] = replace(e, expected=float(np.sqrt(sigma**2 + more)))
    limit = farthest(sum(e.expected is not None for e in out))
    return tuple(e if e.expected is None else replace(e, far=abs(e.error) > limit * e.expected)
                 for e in out)


def _by_session(estimate: Estimate, wider: SessionVariance, column: int) -> dict[str, Any]:
    """Return the entries of an estimate that come from sessions."""
    parts: dict[str, Any] = {"half": max(float(wider.half[column]), estimate.by_noise or 0.0)}
    if wider.sessions:
        values = (estimate.value + wider.own[:, column]).tolist()
        sigma = wider.own_sigma[:, column]
        parts |= {"by_session": tuple(zip(wider.labels, values, sigma.tolist(),
                                          (wider.coverage * sigma).tolist(), strict=True)),
                  "p_value": float(wider.p_value[column]),
                  "disagree": bool(wider.disagree[column])}
    return parts


def from_data_alone(fit: Fit, rank: Rank) -> dict[int, float]:
    """Return the standard uncertainty of each identified column without its tolerance, SI.

    Redundant parameters must be held somehow: by their tolerance, or, without one, at their
    value.
    """
    held = [c for c in rank.dropped if fit.prior[c] == 0.0]
    used = [c for c in range(fit.scale.size) if c not in held]
    prior = fit.stated
    prior[list(rank.dropped)] = fit.prior[list(rank.dropped)]
    matrix = np.concatenate([fit.information.root * fit.scale, np.diag(prior * fit.scale)])
    _, s, vt = svd(matrix[:, used])
    use = seen_directions(s)
    sigma = np.linalg.norm(vt[use].T / s[use], axis=1) * fit.scale[used]
    found = dict(zip(used, sigma.tolist(), strict=True))
    return {c: found[c] for c in rank.kept}


def with_estimates(fit: Fit, found: Sequence[Estimate]) -> Mechanism:
    """Return the machine with the fitted values, sigmas and registrations."""
    mechanism = fit.problem.mechanism
    parameters = tuple(replace(p, value=e.value, sigma=e.carried)
                       for p, e in zip(mechanism.parameters, found, strict=True))
    return replace(mechanism, parameters=parameters,
                   home_q=np.full_like(mechanism.home_q, np.nan),
                   registrations={**mechanism.registrations,
                                  **measuring_frames(fit.problem, fit.state)})


def measuring_frames(problem: Problem, state: State) -> dict[str, Registration]:
    """Return the registrations of data sets that measure poses, or parts of them."""
    shown = {d.name for d in problem.datasets if d.kind.of_poses}
    return {name: r for name, r in registered(problem, state).items() if name in shown}


def registered(problem: Problem, state: State) -> dict[str, Registration]:
    """Return frame and target of every data set measured by an instrument, SI."""
    out = {}
    for data, s in zip(problem.datasets, state.registrations, strict=True):
        if data.kind.blind:
            continue
        out[data.name] = Registration(s.frame, s.target, s.target_rotation, scale=s.scale,
                                      offset=s.offset)
    return out


def far_from_nominal(found: Sequence[Estimate], units: Units, listed: str = "parameters.csv"
                     ) -> list[Note]:
    """Return a note on parameters that end farther from nominal than tolerances allow.

    ``listed``: where the others are, that it does not name.
    """
    far = sorted((e for e in found if e.far), key=lambda e: -abs(e.error) / (e.tolerance or 1.0))
    if not far:
        return []
    words = ", ".join(_times(e, units) for e in far[:SHOWN])
    more = f" and {len(far) - SHOWN} more ({listed})" * (len(far) > SHOWN)
    return [Note(f"{FAR}: {words}{more}; {FAR_BECAUSE}", topic="tolerances")]


def _times(e: Estimate, units: Units) -> str:
    """Return ``leg1.offset by 4.8 times its tolerance of 0.2 mm``, and what data would show."""
    factor, tolerance = units.factor(e.quantity), e.tolerance or np.nan
    unit = units.name(e.quantity) + "/unit" * e.per_unit
    times = abs(e.error) / tolerance
    weak = "" if e.expected is None or times > farthest(1) else (
        f", and these data would show only {e.expected / factor:.2g}")
    return f"{e.name} by {times:.2g} times its tolerance of {tolerance / factor:.4g} {unit}{weak}"
