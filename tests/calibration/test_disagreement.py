"""Do sessions that differ widen the intervals, and by what they should?"""

from __future__ import annotations

from functools import cache

import interval_study as study
import numpy as np
import pytest
from scipy.special import chdtrc

from ppmcal.calibration.fit.coverage import Z95
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.noise_estimate import noise_check, with_noise
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.knowledge import session_variance as module
from ppmcal.calibration.knowledge.intervals import by_blocks
from ppmcal.calibration.knowledge.session_clusters import Clusters, Components
from ppmcal.calibration.validation.summary import Identification, report
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.linalg import Array

METHOD = FitOptions()


def rows(rng: np.random.Generator, sessions: int = 3, size: int = 4, spread: float = 0.0
         ) -> tuple[list[Array], list[Array], Clusters]:
    """Rows of sessions about 0, by hand and as normal equations."""
    slopes = [rng.normal(size=(12, size)) for _ in range(sessions)]
    right = [a @ (spread * rng.normal(size=size)) + rng.normal(size=12) for a in slopes]
    return slopes, right, Clusters(
        tuple("abcdefgh"[:sessions]), np.array([a.T @ a for a in slopes]),
        np.array([a.T @ y for a, y in zip(slopes, right, strict=True)]),
        np.array([y @ y for y in right]), np.full(sessions, 12.0), np.ones(size),
        0.3 * np.ones(size))


def test_the_restricted_likelihood_is_that_of_the_rows_themselves() -> None:
    slopes, right, data = rows(np.random.default_rng(1), spread=0.5)
    parts = Components(np.eye(4)[:, :3], np.array([0, 0, 1]), ("one", "two"))
    chances = module._Posterior(data, parts, 1.0)
    everything, y = np.concatenate(slopes), np.concatenate(right)
    prior = np.linalg.inv(chances.prior)

    def dense(sizes: Array) -> float:
        each = np.exp(sizes[:-1])[parts.member]
        total = np.exp(2.0 * sizes[-1]) * np.eye(y.size) + everything @ prior @ everything.T
        for s, a in enumerate(slopes):
            own = a @ parts.directions * each
            total[12 * s:12 * s + 12, 12 * s:12 * s + 12] += own @ own.T
        away = y - everything @ (prior @ chances.offset)
        return float(-0.5 * (np.linalg.slogdet(total)[1] + away @ np.linalg.solve(total, away)))

    at = [np.array(v) for v in ([-9.0, -9.0, 0.0], [-1.0, 0.5, 0.3], [1.0, -2.0, 0.9])]
    got, wanted = ([f(v) for v in at] for f in (chances.likelihood, dense))
    assert np.diff(got) == pytest.approx(np.diff(wanted), abs=1e-6)


def test_p_values_of_sessions_alike_are_even() -> None:
    rng = np.random.default_rng(2)
    p = []
    for _ in range(300):
        truth = rng.normal(size=4)           # as the prior has it
        slopes, right, data = rows(rng)
        moved = np.array([a.T @ (y + a @ truth) for a, y in zip(slopes, right, strict=True)])
        data = Clusters(data.labels, data.matrix, moved, data.square, data.count, data.prior,
                        np.zeros(4))
        p.append(chdtrc(len(data.labels) - 1.0, module._each(data, np.eye(4), 4, 1.0)[2][0]))
    counts = np.histogram(p, bins=5, range=(0.0, 1.0))[0]
    assert float(np.sum((counts - 60.0) ** 2 / 60.0)) < 18.5      # 0.1 % of chi-squared on 4


def test_an_effect_that_sessions_agree_about_keeps_the_noise_s_interval() -> None:
    """Of few sessions the drawn variances have long tails, which count as far as they differ."""
    drawn = 1.0 + np.random.default_rng(3).standard_cauchy((400, 1)) ** 2
    differ = np.hstack([drawn, drawn, drawn])
    alike, even, sure = module._mixed(differ, np.ones(3), np.array([0.01, 0.5, 1.0]))
    assert Z95 < alike < 1.1 * Z95
    assert sure == pytest.approx(module.half_of_mixture(drawn)[0])
    assert alike < even < sure


@cache
def three(differ: bool) -> tuple[Identification, Array]:
    """Three sessions of a delta, and its true parameters."""
    mechanism, days, true, _ = study.campaign("delta-linear", study.Setting(3, differ), 4)
    problem = Problem(mechanism, days, mechanism.free)
    return report(identify(problem), METHOD, 0.0, 0), true


@pytest.mark.slow
def test_sessions_that_differ_have_longer_intervals_and_say_so() -> None:
    found, true = three(True)
    assert found.sessions is not None
    assert found.sessions.differ
    assert any(("session" in f and "differ" in f) or "disagree" in f for f in found.findings)
    free = [e for e in found.estimates if e.status != "fixed"]
    assert all(e.half is not None and e.sigma is not None for e in free)
    assert np.median([e.half / (Z95 * e.sigma) for e in free]) > 1.05
    for place in found.fit.problem.free:
        low, high = found.estimates[place].interval
        assert low < true[place] < high, found.estimates[place].name


@pytest.mark.slow
def test_sessions_alike_keep_the_noise_s_intervals() -> None:
    found, _ = three(False)
    assert found.sessions is not None
    assert not found.sessions.differ
    assert not found.sessions.disagree.any()
    assert not any("session" in f for f in found.findings)
    free = [e for e in found.estimates if e.status != "fixed"]
    assert 0.99 < np.median([e.half / (Z95 * e.sigma) for e in free]) < 1.3
    record = IdentificationRecord.of(found, {}, "prior")
    entry = next(p for p in record.parameters if p.status != "fixed")
    assert [s.session for s in entry.sessions] == ["day1", "day2", "day3"]
    assert entry.high - entry.low == pytest.approx(2 * Z95 * entry.sigma_sessions)
    header = record.files(found)["parameters.csv"].splitlines()[0]
    assert header.endswith("status,low,high,sigma_sessions,disagree")


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.slow_cases("True")
def test_blocks_of_one_session_see_what_is_smooth(curved: bool) -> None:
    mechanism, days, _, _ = study.campaign("3-RPR", study.Setting(1, False, curved), 4)
    fit = identify(Problem(mechanism, days, mechanism.free))
    inflation = noise_check(fit).inflation
    fit = with_noise(fit, inflation, METHOD)
    found = by_blocks(fit, inflation)
    if not curved:
        assert found is None
        return
    assert found is not None
    assert found.differ
    assert not found.sessions
    result = report(identify(Problem(mechanism, days, mechanism.free)), METHOD, 0.0, 0)
    assert any("smooth over" in f for f in result.findings)


@pytest.mark.long
def test_promise_and_coverage_where_sessions_differ() -> None:
    found = [study.run("delta-linear", study.Setting(3, True), seed) for seed in range(1, 13)]
    inside, alone = (np.concatenate([getattr(o, n) for o in found]) for n in ("inside", "by_noise"))
    assert inside.mean() >= 0.93
    assert inside.mean() > alone.mean()
    promise, noise = (np.sqrt(np.mean([getattr(o, n) for o in found]))
                      for n in ("promise", "promise_noise"))
    assert promise < 1.3 < noise
