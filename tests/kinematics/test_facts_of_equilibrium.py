"""Poses that effects and closure agree on: found from near by, or led from home."""

from __future__ import annotations

import numpy as np
import pytest

import ppmcal
from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import _newton
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
