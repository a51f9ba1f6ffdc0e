"""Shares and differences of which the size is integrated, against sums over draws."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.inference.differences import differing
from ppmcal.inference.priors import GROSS_ROW, UNKNOWN
from ppmcal.inference.ranges import SIZES
from ppmcal.inference.shares import everywhere, in_a_part


def chance(hits: int, rows: int, share: np.ndarray) -> float:
    """Return the chance of one sequence with so many hits, over drawn shares."""
    return float(np.mean(share**hits * (1.0 - share) ** (rows - hits)))


@pytest.mark.parametrize(("hits", "inside", "count", "total"), [
    (4, 10, 5, 60), (8, 15, 9, 120), (2, 5, 2, 30)])
@pytest.mark.slow
def test_shares_are_integrated(hits: int, inside: int, count: int, total: int) -> None:
    rng, often = np.random.default_rng(1), 4_000_000
    any_, usual = rng.uniform(size=often), rng.beta(1.0, 1.0 / GROSS_ROW.value - 1.0, size=often)
    u = UNKNOWN.value
    alike = (1.0 - u) * chance(count, total, usual) + u * chance(count, total, any_)
    part = u * chance(hits, inside, any_) * chance(count - hits, total - inside, usual)
    assert in_a_part(hits, inside, count, total) == pytest.approx(part / alike, rel=0.05)
    wanted = u * chance(count, total, any_) / ((1.0 - u) * chance(count, total, usual))
    assert everywhere(count, total) == pytest.approx(wanted, rel=0.05)


def test_what_is_hit_less_often_is_nothing() -> None:
    assert in_a_part(0, 10, 3, 60) == in_a_part(1, 20, 3, 60) == 0.0
    assert everywhere(0, 100) == everywhere(1, 100) == 0.0


def test_odds_of_differences_are_those_of_their_normal_distributions() -> None:
    """Against densities of draws, and on average no more than 1 where nothing differs."""
    chi2, k = 14.0, 3
    wanted = np.mean([(1.0 + s**2) ** (-k / 2) * np.exp(0.5 * chi2 * s**2 / (1.0 + s**2))
                      for s in SIZES])
    assert differing(chi2, k) == pytest.approx(wanted)
    drawn = np.random.default_rng(2).chisquare(k, size=4000)
    odds = np.array([differing(c, k) for c in drawn])
    assert np.mean(odds > 20.0) <= 1.0 / 20.0        # Markov
    assert np.mean(np.minimum(odds, 1e3)) < 1.2
