"""Poses that effects and closure agree on: found from near by, or led from home."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ppmcal
from ppmcal import algebra as cga
from ppmcal.kinematics import forward as kinematics_forward
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import _newton
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.inverse import inverse


@pytest.mark.parametrize("name", ["3-RPR", "6-UPS"])
def test_a_row_that_newton_loses_is_led_from_home(name: str) -> None:
    """From half a turn away no step leads back; beside it a good row stays as it is found."""
    mechanism = ppmcal.load(ppmcal.shipped(name))
    model = Model(mechanism)
    home = np.repeat(mechanism.home[None], 3, axis=0)
    q = inverse(model, home).q
    start = home.copy()
    away = 40.0 * mechanism.reach
    start[0] = cga.compose(cga.motor_from_rotation_vector(
        np.array([0.0, 0.0, 3.0]), np.array([away, 0.0, 0.0])), home[0])
    start[2] = np.nan
    found = _newton(model, q, start)
    for row in (0, 1):
        np.testing.assert_allclose(cga.translation(found[row]), cga.translation(home[row]),
                                   atol=1e-9 * mechanism.reach)
        apart = cga.rotation_vector(cga.compose(cga.reverse(found[row]), home[row]))
        np.testing.assert_allclose(apart, 0.0, atol=1e-8)
    assert np.isnan(found[2]).all()


@pytest.mark.parametrize("coordinate", range(6))
@pytest.mark.parametrize(("misclosure", "slope", "converged"), [
    (1e-13, 1.0, True), (1e-13, 1e-4, False), (1e-3, 1e12, False), (0.0, 1e-6, True),
    (np.nan, 1.0, False)])
def test_converged_is_closed_and_standing_still(
        monkeypatch: pytest.MonkeyPatch, misclosure: float, slope: float, converged: bool,
        coordinate: int) -> None:
    """A closed pose that still moves is not known; one that stands still need not be closed."""
    monkeypatch.setattr(kinematics_forward, "compiled_limbs", lambda closure, rows: None)
    closure: Any = SimpleNamespace(
        model=SimpleNamespace(mechanism=SimpleNamespace(length_scale=1.0, reach=1.0,
                                                        dof=tuple(range(6)), surplus=0)),
        misclosure_and_lines=lambda pose: (np.tile(misclosure * np.eye(6)[coordinate],
                                                   (len(pose), 1)), None),
        pose_matrix=lambda pose, lines: np.tile(slope * np.eye(6), (len(pose), 1, 1)))
    start = np.tile([1.0, *[0.0] * 7], (2, 1))
    _, found, _ = newton(closure, start, iterations=1)
    assert found.tolist() == [converged] * 2
