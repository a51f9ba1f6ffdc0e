"""Instruments that tell of different machines, where their noise is estimated."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.calibration.fit.coverage import LEAST
from ppmcal.calibration.knowledge.tension import InstrumentRows, split

COLUMNS = 6
SIZES = {"heights": 9, "distances": 12}
HELD = np.full(COLUMNS, 1e-3)
"""Tolerances that rows outdo by far: what rows alone hold is compared."""


def campaign(rng: np.random.Generator, noise: float, apart: float = 0.0) -> list[InstrumentRows]:
    """Return two instruments; ``noise`` over the stated one, and how far their machines differ."""
    machine = rng.normal(size=COLUMNS)
    out = []
    for n, (name, size) in enumerate(SIZES.items()):
        slope = rng.normal(size=(size, COLUMNS))
        other = machine + n * apart * rng.normal(size=COLUMNS)
        seen = slope @ other + noise * rng.normal(size=size)
        source = np.stack([np.full(size, n), np.arange(size)], axis=1)
        out.append(InstrumentRows((name,), np.column_stack([slope, seen]), source))
    return out


@pytest.mark.slow
def test_one_machine_is_hardly_ever_told_as_two() -> None:
    """Noise over the stated one as its prior has it, five redundant values' worth."""
    rng = np.random.default_rng(7)
    chances = np.array([split(campaign(rng, np.sqrt(LEAST / rng.chisquare(LEAST))), HELD,
                              40).p_value for _ in range(300)])
    assert np.mean(chances < 0.01) < 0.03
    assert np.mean(chances < 0.1) < 0.15


def test_two_machines_are_told() -> None:
    rng = np.random.default_rng(8)
    chances = np.array([split(campaign(rng, 1.0, 4.0), HELD, 60).p_value for _ in range(50)])
    assert np.mean(chances < 0.01) > 0.9


def test_instruments_that_pull_apart_know_how_many_values_their_noise_is_of() -> None:
    found = split(campaign(np.random.default_rng(8), 1.0, 4.0), HELD, 20)
    assert found.degrees == tuple(LEAST + size - COLUMNS for size in SIZES.values())
