"""Intervals of figures of errors hold what they promise."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.stats import binom

from ppmcal.calibration.validation import error_intervals
from ppmcal.calibration.validation.error_intervals import RmsDraws, quantile_interval, rms_interval

POSES = (6, 12, 40)


def errors(rng, poses, shared=1.0, per=2, axes=2):
    """Squared errors (R,) of poses measured twice, which share an error, and the groups (R,)."""
    both = shared * rng.standard_normal((poses, 1, axes)) + rng.standard_normal((poses, per, axes))
    return np.sum(both**2, axis=-1).ravel(), np.repeat(np.arange(poses), per)


@pytest.mark.parametrize("poses", POSES)
@pytest.mark.parametrize("shared", [0.0, 2.0])
def test_the_interval_of_an_rms_holds_what_it_promises(poses, shared):
    """2000 days of a known error: 95 % of the intervals hold it, within what chance allows."""
    rng, truth = np.random.default_rng(poses), np.sqrt(2.0 * (shared**2 + 1.0))
    held = 0
    for _ in range(2000):
        low, high = rms_interval(*errors(rng, poses, shared))
        held += low < truth < high
    assert 0.91 <= held / 2000 <= 0.975    # an interval by rows alone holds 0.82 at shared 2


def test_rows_that_share_an_error_do_not_count_twice():
    rng = np.random.default_rng(0)
    squares, groups = errors(rng, 30, shared=3.0, per=8)
    width = [np.diff(rms_interval(squares, g))[0] for g in (groups, np.arange(squares.size))]
    assert width[0] > 1.5 * width[1]


def test_what_a_registration_took_is_given_back():
    """A mean over the poses is fitted per axis: of 6 poses 5/6 of the degrees are left."""
    rng, held = np.random.default_rng(1), 0
    for _ in range(2000):
        e = rng.standard_normal((6, 2))
        squares = np.sum((e - e.mean(axis=0)) ** 2, axis=1)
        low, high = rms_interval(squares, np.arange(6), kept=5.0 / 6.0)
        held += low < np.sqrt(2.0) < high
    assert 0.91 <= held / 2000 <= 0.975


@pytest.mark.parametrize("poses", [20, 80, 200])
def test_the_interval_of_a_95_percent_point_holds_it(poses):
    rng, truth = np.random.default_rng(poses), np.sqrt(-2.0 * np.log(0.05))    # of a Rayleigh
    held = 0
    for _ in range(1000):
        values = rng.rayleigh(size=poses)
        low, high = quantile_interval(values, np.arange(poses), 0.95)
        held += (np.isnan(low) or low <= truth) and (np.isnan(high) or truth <= high)
    assert 0.94 <= held / 1000 <= 1.0


def test_few_poses_leave_the_95_percent_point_open_above():
    values = np.linspace(1.0, 2.0, 71)
    assert np.isnan(quantile_interval(values, np.arange(71), 0.95)[1])
    assert np.isfinite(quantile_interval(np.linspace(1.0, 2.0, 72), np.arange(72), 0.95)[1])


@pytest.mark.parametrize("poses", POSES)
@pytest.mark.slow_cases("40")
def test_two_machines_that_are_alike_are_surely_apart_one_day_in_twenty(poses):
    rng, apart, days = np.random.default_rng(7 * poses), 0, 300
    for day in range(days):
        one, groups = errors(rng, poses)
        other, _ = errors(rng, poses)
        draws = RmsDraws(groups, day)
        low, high = draws.interval(draws.rms(one) - draws.rms(other))
        apart += low > 0.0 or high < 0.0
    assert apart <= 27    # of 300; more has a chance of 0.1 % where the rate is 5 %


def test_nothing_is_told_of_two_poses():
    assert np.isnan(rms_interval(np.ones(4), np.array([0, 0, 1, 1]))).all()
    draws = RmsDraws(np.array([0, 0, 1, 1]), 0)
    assert draws.interval(draws.rms(np.ones(4))) == (-np.inf, np.inf)


def test_no_error_at_all_is_sure():
    assert rms_interval(np.zeros(5), np.arange(5)) == (0.0, 0.0)


def test_an_interval_over_all_orders_of_magnitude_is_none():
    """A registration left hardly a degree of freedom: Student's t has no end any more."""
    assert np.isnan(rms_interval(np.array([0.3, 0.1, 0.6]), np.arange(3), kept=0.05)).all()


def test_the_ends_of_a_quantile_are_the_ranks_of_the_binomial_distribution():
    """Rank by rank, for any number of poses: 123 as parts of one make 124."""
    for poses in (*range(3, 300), 986, 2999):
        ranks = binom.ppf([0.025, 0.975], poses, 0.95).astype(int) + [0, 1]
        found = quantile_interval(np.arange(1.0, poses + 1.0), np.arange(poses), 0.95)
        want = [r if 1 <= r <= poses else np.nan for r in ranks]
        np.testing.assert_array_equal(found, want, f"{poses} poses")


def test_draws_of_many_poses_take_little_memory_and_are_the_same(
        monkeypatch: pytest.MonkeyPatch) -> None:
    poses = 20_000
    squares = np.random.default_rng(1).chisquare(2.0, poses)
    groups = np.arange(poses)
    monkeypatch.setattr(error_intervals, "DRAWS", 100)
    whole = RmsDraws(groups, 3).rms(squares)
    monkeypatch.setattr(error_intervals, "AT_ONCE", 60_000)
    draws = RmsDraws(groups, 3)
    tracemalloc.start()
    some = draws.rms(squares)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(some, whole)
    # of all draws at once, indices alone would take sixteen megabytes
    assert peak < 4e6


@pytest.mark.slow
def test_intervals_that_are_to_hold_together_are_longer():
    """Of five alike machines noise makes one better or worse in one day of twenty, not in five."""
    rng, days, found = np.random.default_rng(6), 150, np.zeros(2)
    for _ in range(days):
        draws = RmsDraws(np.arange(24), 0)
        one, *others = rng.normal(size=(6, 24)) ** 2
        first = draws.rms(one)
        for n, together in enumerate((1, 5)):
            ends = [draws.interval(first - draws.rms(o), together) for o in others]
            found[n] += any(low > 0.0 or high < 0.0 for low, high in ends)
    assert found[0] > 0.1 * days > 0.05 * days + 2.0 * np.sqrt(0.05 * days) > found[1]
