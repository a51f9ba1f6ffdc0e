"""Rates and accelerations of rows by differences."""

import numpy as np
import pytest

from ppmcal.kinematics.path_rates import accelerations, follows, rates, without_turns


def test_a_parabola_is_exact_at_any_spacing():
    time = np.cumsum(np.random.default_rng(1).uniform(0.1, 1.0, 12))
    values = 3.0 - 2.0 * time + 0.7 * time**2
    np.testing.assert_allclose(rates(time, values), -2.0 + 1.4 * time, rtol=1e-10)
    found = accelerations(time, values)
    np.testing.assert_allclose(found[1:-1], 1.4, rtol=1e-9)
    assert np.isnan(found[[0, -1]]).all()


def test_a_gap_stays_a_gap():
    time = np.arange(9.0)
    values = np.where(time == 4.0, np.nan, time)
    assert np.isnan(rates(time, values)[[3, 5]]).all()
    np.testing.assert_allclose(rates(time, values)[[1, 2, 6, 7]], 1.0)
    assert np.isnan(accelerations(time, values)[3:6]).all()


def test_whole_turns_are_no_motion():
    values = np.array([170.0, 179.0, -172.0, np.nan, -163.0])
    np.testing.assert_allclose(without_turns(values, 360.0), [170.0, 179.0, 188.0, np.nan, 197.0])
    assert without_turns(values, 0.0) is values


@pytest.mark.parametrize(("time", "goes"), [([0.0, 1.0, 3.0], True), ([0.0, 1.0, 1.0], False),
                                            ([0.0, np.nan, 1.0], False), ([0.0], False)])
def test_times_go_up(time, goes):
    assert follows(np.array(time)) is goes


def test_two_rows_have_no_rate():
    assert np.isnan(rates(np.array([0.0, 1.0]), np.array([0.0, 1.0]))).all()
    assert np.isnan(accelerations(np.array([0.0, 1.0]), np.array([0.0, 1.0]))).all()
