"""What is said with a probability, on data drawn from the model itself; and misuses that show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import gammaln, logsumexp

from ppmcal.inference.block_sets import state
from ppmcal.inference.blocks import Block, scaled_root
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.correlation import RowNoise
from ppmcal.inference.priors import CORRELATED, CORRELATIONS, GROSS_ROW, NOISE_FREEDOM
from ppmcal.inference.question import Question
from ppmcal.inference.ranges import SIZES
from ppmcal.inference.sets import posterior

ROWS, WIDTH = 30, 2
COUNT = ROWS * WIDTH
NU = float(NOISE_FREEDOM)
ODDS = 19.0
"""Posterior odds against nothing: those of 95 %."""


def template(rng: np.random.Generator, kinds: int, share: float, rows: bool = False,
             correlated: bool = False, signed: bool = False) -> Question:
    """Return a question without values: kinds of prior odds that make ``share`` together."""
    matrix = rng.normal(size=(COUNT, kinds)) * rng.uniform(0.1, 10.0, kinds)
    odds = float(np.log(np.expm1(np.log1p(share) / kinds)))
    blocks = [Block(f"k{i}", f"k{i}", (i,), odds, low=0.0 if signed and i % 2 else -np.inf)
              for i in range(kinds)]
    gross = float(np.log(float(GROSS_ROW)))
    blocks += [Block(f"row {i}", "row", (kinds + 2 * i, kinds + 2 * i + 1), gross)
               for i in range(ROWS if rows else 0)]
    return Question(MatrixColumns(np.hstack([matrix, np.eye(COUNT)])), np.zeros(COUNT),
                    3.0 * rng.normal(size=(COUNT, 3)), tuple(blocks),
                    np.ones((ROWS, WIDTH), dtype=bool), np.full(ROWS - 1, int(correlated)),
                    frozenset({"row"}))


def drawn(asked: Question, rng: np.random.Generator,
          empty: bool = False) -> tuple[Question, np.ndarray]:
    """Return the question with values drawn as its priors have them, and which blocks act (B,).

    ``empty``: only rows that do not belong do.
    """
    odds = np.exp([b.log_prior for b in asked.blocks])
    acts = rng.uniform(size=odds.size) < odds / (1.0 + odds)
    if empty:
        acts &= np.array([b.family in asked.alone for b in asked.blocks])
    rho = (float(rng.choice(CORRELATIONS))
           if asked.apart.any() and rng.uniform() < float(CORRELATED) else 0.0)
    noise = RowNoise(rho, asked.apart, asked.observed)
    values = np.zeros((ROWS, WIDTH))
    values[0] = rng.normal(size=WIDTH)
    for i in range(1, ROWS):
        values[i] = rho * values[i - 1] + np.sqrt(1.0 - rho**2) * rng.normal(size=WIDTH)
    flat = values.ravel() + asked.geometry @ rng.normal(size=asked.geometry.shape[1])
    for i in np.flatnonzero(acts).tolist():
        block = asked.blocks[i]
        own = asked.columns.some(block.columns)
        white = noise.apply(own)
        z = rng.normal(size=len(block.columns))
        root = scaled_root(white.T @ white, COUNT)
        flat += own @ root @ (np.abs(z) if block.low == 0.0 else z) * rng.choice(SIZES)
    scale = np.sqrt(NU / rng.chisquare(NU))
    return replace(asked, values=scale * flat), acts


def against_nothing(asked: Question) -> float:
    nothing = posterior(asked).nothing(asked.alone)
    return (1.0 - nothing) / nothing


def exceeded(odds: Callable[[Question], float], draws: int, seed: int = 1, kinds: int = 10,
             **what: bool) -> tuple[float, float]:
    """Return how often odds against nothing exceed 19 where nothing is, and how often they may.

    With prior odds of one in all, by Markov's inequality one in 19 times, and chance beside it.
    """
    rng = np.random.default_rng(seed)
    some = [odds(drawn(template(rng, kinds, 1.0, **what), rng, empty=True)[0])
            for _ in range(draws)]
    return float(np.mean(np.array(some) > ODDS)), float(
        stats.binom(draws, 1.0 / ODDS).ppf(0.999)) / draws


@pytest.mark.slow
def test_odds_against_nothing_keep_their_bound_where_nothing_is() -> None:
    rate, most = exceeded(against_nothing, 150, signed=True)
    assert rate <= most


@pytest.mark.long
def test_odds_keep_their_bound_with_rows_that_do_not_belong_and_correlated_noise() -> None:
    rate, most = exceeded(against_nothing, 200, seed=2, correlated=True, rows=True, signed=True)
    assert rate <= most


def density(asked: Question, chosen: tuple[int, ...]) -> float:
    """Return the log density of a question's values with blocks, constants and all."""
    n = asked.observed.sum()
    return float(state(asked, chosen).log_p + gammaln(0.5 * (NU + n)) - gammaln(0.5 * NU)
                 - 0.5 * n * np.log(np.pi) + 0.5 * NU * np.log(NU))


def without_its_worst_row(asked: Question) -> float:
    """Misuse: each candidate is asked without the row that it misses most."""
    n = len(asked.blocks)
    matrix, every = asked.columns.some(range(n)), []
    for i in range(n):
        known = np.column_stack([asked.geometry, matrix[:, i]])
        missed = asked.values - known @ np.linalg.lstsq(known, asked.values, rcond=None)[0]
        seen = asked.observed.copy()
        seen[int(np.argmax(np.sum(missed.reshape(ROWS, WIDTH)**2, axis=1)))] = False
        keep = seen.reshape(-1, 1)
        every.append(density(replace(
            asked, observed=seen, values=asked.values * keep[:, 0], geometry=asked.geometry * keep,
            columns=MatrixColumns(matrix * keep)), (i,)))
    return float(np.exp(logsumexp(every) - density(asked, ())))


def every_row(asked: Question) -> float:
    """The same without the misuse."""
    every = [density(asked, (i,)) for i in range(len(asked.blocks))]
    return float(np.exp(logsumexp(every) - density(asked, ())))


def as_it_fits_best(asked: Question) -> float:
    """Misuse: no prior of coefficients, each cause of six columns as it fits best."""
    n = len(asked.blocks)
    matrix = asked.columns.some(range(n))
    rest = []
    for i in range(-1, n):
        own = [(i + k) % n for k in range(6 if i >= 0 else 0)]
        known = np.column_stack([asked.geometry, matrix[:, own]])
        missed = asked.values - known @ np.linalg.lstsq(known, asked.values, rcond=None)[0]
        rest.append(NU + missed @ missed)
    log_odds = -0.5 * (NU + COUNT) * np.log(np.array(rest[1:]) / rest[0])
    return float(np.mean(np.exp(log_odds)))


def of_no_prior(asked: Question) -> float:
    """Misuse: causes that are believed for themselves, not as one of many."""
    return against_nothing(replace(asked, blocks=tuple(
        replace(block, log_prior=0.0) for block in asked.blocks)))


@pytest.mark.slow
def test_a_candidate_that_drops_the_row_it_misses_breaks_the_bound() -> None:
    rate, most = exceeded(every_row, 60, seed=3)
    assert rate <= most
    rate, most = exceeded(without_its_worst_row, 60, seed=3)
    assert rate > most


@pytest.mark.parametrize("misuse", [as_it_fits_best, of_no_prior])
@pytest.mark.slow_cases("of_no_prior")
def test_a_prior_that_is_none_breaks_the_bound(misuse: Callable[[Question], float]) -> None:
    rate, most = exceeded(misuse, 60, seed=4, kinds=20)
    assert rate > most


BINS = np.array([0.0, 0.02, 0.1, 0.3, 0.7, 0.9, 0.98, 1.0 + 1e-9])


@pytest.mark.long
@pytest.mark.parametrize(("campaigns", "what"), [
    (500, {}), (300, {"signed": True, "correlated": True, "rows": True})])
def test_what_is_said_with_a_probability_is_so_often_right(
        campaigns: int, what: dict[str, bool]) -> None:
    """Said against true, of each cause and of nothing, in bins of what is said."""
    rng = np.random.default_rng(6)
    said, right = [], []
    for _ in range(campaigns):
        asked, acts = drawn(template(rng, 10, 2.0, **what), rng)
        found = posterior(asked)
        causes = np.array([b.family not in asked.alone for b in asked.blocks])
        said += [*found.probability[causes], found.nothing(asked.alone)]
        right += [*acts[causes], not acts[causes].any()]
    home = np.digitize(said, BINS) - 1
    for n in range(len(BINS) - 1):
        here = np.array(said)[home == n]
        # a count of independent events of these probabilities, and half a case
        spread = np.sqrt(np.sum(here * (1.0 - here)))
        true = np.sum(np.array(right)[home == n])
        assert here.size and abs(true - here.sum()) < 3.5 * spread + 0.5, (BINS[n], true, here)
