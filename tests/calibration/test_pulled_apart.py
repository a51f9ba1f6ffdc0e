"""Instruments that tell of different machines, where their noise is estimated."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.calibration.fit.coverage import LEAST
from ppmcal.calibration.knowledge.session_clusters import Clusters
from ppmcal.calibration.knowledge.tension import split

COLUMNS = 6
SIZES = {"heights": 9, "distances": 12}
HELD = np.full(COLUMNS, 1e-3)
"""Tolerances that rows outdo by far: what rows alone hold is compared."""


def campaign(rng: np.random.Generator, noise: float, apart: float = 0.0) -> Clusters:
    """Return two instruments; ``noise`` over the stated one, and how far their machines differ."""
    machine = rng.normal(size=COLUMNS)
    out = Clusters(tuple(SIZES), np.zeros((2, COLUMNS, COLUMNS)), np.zeros((2, COLUMNS)),
                   np.zeros(2), np.zeros(2), HELD, np.zeros(COLUMNS))
    for n, size in enumerate(SIZES.values()):
        slope = rng.normal(size=(size, COLUMNS))
        other = machine + n * apart * rng.normal(size=COLUMNS)
        seen = slope @ other + noise * rng.normal(size=size)
        out.add(n, np.column_stack([slope, seen])[:, None], size)
    return out


@pytest.mark.slow
def test_one_machine_is_hardly_ever_told_as_two() -> None:
    """Noise over the stated one as its prior has it, five redundant values' worth."""
    rng = np.random.default_rng(7)
    found = [split(campaign(rng, np.sqrt(LEAST / rng.chisquare(LEAST)))) for _ in range(300)]
    assert np.mean([f.likely for f in found]) < 0.03
    assert np.mean([f.probability > 0.1 for f in found]) < 0.15


def test_two_machines_are_told() -> None:
    rng = np.random.default_rng(8)
    assert np.mean([split(campaign(rng, 1.0, 4.0)).likely for _ in range(50)]) > 0.9


def test_rows_taken_away_are_as_if_they_had_never_been() -> None:
    one = campaign(np.random.default_rng(9), 1.0, 4.0)
    before = split(one)
    gross = np.append(np.ones(COLUMNS), 300.0)[None, None]
    one.add(0, gross, 1)
    other = split(one)
    one.add(0, gross, 1, -1.0)
    np.testing.assert_allclose(split(one).noise, before.noise, rtol=1e-6)
    assert other.noise[0] > 10.0 * before.noise[0]


def test_instruments_that_pull_apart_know_how_many_values_their_noise_is_of() -> None:
    found = split(campaign(np.random.default_rng(8), 1.0, 4.0))
    np.testing.assert_allclose(found.degrees, [LEAST + n - COLUMNS for n in SIZES.values()])
