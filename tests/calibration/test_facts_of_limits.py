"""Selections at their limits: what is just enough, and what one value more changes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ppmcal.calibration.fit.rank import analyse
from ppmcal.calibration.knowledge.extrapolation import CONDITIONS, _shown, _still
from ppmcal.calibration.knowledge.identifiability_report import (
    LOOSE,
    LOST,
    MATTERS,
    SHARE,
    Scale,
    _farthest,
)
from ppmcal.model.dataset import WRENCH


@pytest.mark.parametrize("length", [0.25, 2.0, 64.0])
def test_a_size_is_open_beyond_a_part_of_itself(length: float) -> None:
    """Of what the data hold a thousandth, of what the tolerances do a hundred thousandth."""
    by_data, by_prior = 1.0, 1e9
    for data, part in ((by_data, LOOSE), (by_prior, MATTERS)):
        assert not Scale(length, part * length, data * part * length).open
        assert Scale(length, 1.001 * part * length, data * part * length).open
        assert not Scale(length, 0.999 * part * length, data * part * length).open
    assert not Scale(length, LOST * length, LOST * length).unobservable
    assert Scale(length, 1.001 * LOST * length, LOST * length).unobservable
    assert not Scale(length, 1.001 * LOST * length, np.inf).unobservable
    assert not Scale(length, SHARE, 1.0).prior_dominated
    assert Scale(length, 0.999 * SHARE, 1.0).prior_dominated


@pytest.mark.parametrize(("length", "sigma"), [(2.0, 1e-3), (0.5, 4e-5)])
def test_a_distance_that_halves_the_uncertainty(length: float, sigma: float) -> None:
    """Known to w by itself, 1/w^2 = 3/s^2: four times the information, a half of the sigma."""
    needed = Scale(length, sigma, sigma).needed
    per_metre, caliper = sigma / length, 5e-5 / needed
    assert 1.0 / per_metre**2 + 1.0 / caliper**2 == pytest.approx(4.0 / per_metre**2)
    assert Scale(length, 0.0, 0.0).needed == 0.0


@pytest.mark.parametrize("kept", [0, 1])
def test_one_position_is_no_distance(kept: int) -> None:
    keep = np.arange(5) < kept
    fit: Any = SimpleNamespace(keep=[keep], state=None, problem=SimpleNamespace(
        datasets=[SimpleNamespace(to_q=None)]))
    assert _farthest(fit, 0) is None


@pytest.mark.parametrize("silent", [False, True])
def test_what_frames_take_up_is_gone_beside_columns_of_nothing_too(silent: bool) -> None:
    """What round-off leaves of it is small against the longest column, whatever the shortest is."""
    rng = np.random.default_rng(1)
    frames = rng.normal(size=(30, 3))
    geometry = frames @ rng.normal(size=(3, 2))
    if silent:
        geometry = np.column_stack([geometry, np.zeros(30)])
    found = analyse(np.column_stack([geometry, frames]), geometry.shape[1],
                    np.ones(geometry.shape[1]))
    assert found.kept == ()


@pytest.mark.parametrize("reach", [1e-3, 1.0, 50.0])
def test_what_was_measured_at_one_value_holds_a_little_around_it(reach: float) -> None:
    """Of places a part of the machine; of turns, temperature, time the same; of loads a tenth."""
    machine: Any = SimpleNamespace(reach=reach)
    for name in ("temperature", "time"):
        assert _still(machine, name, 290.0, 290.0) == 1.0
    assert _still(machine, "x", 0.2, 0.2) == pytest.approx(1e-3 * reach)
    assert _still(machine, "rz", 0.2, 0.2) == pytest.approx(1e-3)
    for load in ("payload", *WRENCH):
        assert _still(machine, load, 40.0, 40.0) == pytest.approx(4.0)
        assert _still(machine, load, -70.0, -60.0) == pytest.approx(6.0)
        assert _still(machine, load, 0.0, 0.0) == 0.0


def test_conditions_are_shown_in_their_own_units() -> None:
    units = SimpleNamespace(factor=lambda q: {"length": 1e-3, "angle": 0.1}[q],
                            name=lambda q: {"length": "mm", "angle": "gon"}[q])
    machine: Any = SimpleNamespace(units=units)
    assert _shown(machine, "y") == (1e-3, "mm")
    assert _shown(machine, "rx") == (0.1, "gon")
    assert {n: _shown(machine, n) for n in CONDITIONS} == {
        "temperature": (1.0, "C"), "payload": (1.0, "kg"), "time": (1.0, "s"),
        **dict.fromkeys(("fx", "fy", "fz"), (1.0, "N")),
        **dict.fromkeys(("mx", "my", "mz"), (1.0, "N.m"))}
