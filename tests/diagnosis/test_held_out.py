"""What the held-out rows say of two models, whichever of them misses a row."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.diagnoses import DATA, effect, simulate
from helpers.rounds import stage_at

from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.validation.residual_vectors import fresh_state
from ppmcal.diagnosis.held_out_gap import Gap, HeldOutErrors, gap_of, measure_gap
from ppmcal.diagnosis.next_experiment import (
    WIDER,
    possible_rows,
    propose,
)
from ppmcal.diagnosis.refit import outside
from ppmcal.inference.priors import SURE_ODDS
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.tables import forward_table
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.effects import effect_kinds
from ppmcal.model.mechanism import Given, with_effect


def made(errors: Array, variance: float = 0.0) -> HeldOutErrors:
    """Return white errors (poses, rows, values) as held-out errors."""
    poses, rows, values = errors.shape
    return HeldOutErrors(np.sum(errors**2, axis=2).reshape(-1), np.full(poses * rows, variance),
                         np.full(poses * rows, float(values)), np.repeat(np.arange(poses), rows))


def gap(before: Array, after: Array, noise: float = 1.0, variance: float = 0.0) -> Gap:
    return gap_of(made(before, variance), made(after, variance), noise, 3)


def errors(seed: int, excess: float, poses: int = 60, noise: float = 1.0) -> Array:
    rng = np.random.default_rng(seed)
    return np.asarray(noise * rng.normal(size=(poses, 4, 3))
                      + excess * rng.choice([-1.0, 1.0], size=(poses, 4, 3)))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("noise", [1.0, 1.7])
def test_gap_closed(noise: float) -> None:
    found = gap(errors(1, 3.0 * noise, noise=noise), errors(2, 1.5 * noise, noise=noise), noise)
    assert found.before == pytest.approx(np.sqrt(10.0), rel=0.05)
    assert found.after == pytest.approx(np.sqrt(1.0 + 1.5**2), rel=0.05)
    assert found.closed == pytest.approx(0.5, abs=0.06)
    assert found.interval is not None
    assert found.interval[0] < 0.5 < found.interval[1]
    assert found.interval[0] <= found.closed <= found.interval[1]
    assert found.confirmed
    assert found.poses == 60


def test_gap_all_closed_and_none() -> None:
    found = gap(errors(1, 3.0), errors(2, 0.0))
    assert found.closed is not None
    assert found.closed > 0.9
    assert found.confirmed
    same = gap(errors(1, 3.0), errors(1, 3.0))
    assert same.closed == pytest.approx(0.0, abs=1e-12)
    assert not same.confirmed


def test_gap_where_nothing_exceeds_the_noise() -> None:
    quiet = 0.9 * errors(1, 0.0)
    found = gap(quiet, quiet)
    assert found.closed is None
    assert found.interval is None
    assert not found.confirmed


def test_gap_allows_for_the_parameters_own_variance() -> None:
    """Three values a row: a variance of 3 in a row is one noise square in each value."""
    found = gap(errors(1, 3.0), errors(2, 1.0), variance=3.0)
    assert found.closed is not None
    assert found.closed > 0.85


def test_gap_that_grows_is_not_closed() -> None:
    found = gap(errors(1, 1.0), errors(2, 3.0))
    assert found.closed is not None
    assert found.closed < 0.0
    assert not found.confirmed
    assert found.worse


@pytest.mark.parametrize(("poses", "size"), [(4, 8.0), (8, 10.0), (1, 40.0), (20, 6.0)])
def test_rows_that_the_model_under_test_misses_count(poses: int, size: float) -> None:
    """Failures at a few poses are failures, however far off and however good it is elsewhere."""
    before = 1.16 * errors(1, 0.0)
    after = errors(1, 0.0)
    after[:poses] += size
    found = gap(before, after)
    assert found.before == pytest.approx(rms(before), rel=0.02)
    assert found.after == pytest.approx(rms(after), rel=0.02)
    assert found.worse
    assert not found.confirmed


def test_rows_that_only_the_old_model_misses_count() -> None:
    """What the effect explains at a few poses is what it is there for."""
    before, after = errors(1, 0.0), errors(1, 0.0)
    before[:8] += 10.0
    found = gap(before, after)
    assert found.before == pytest.approx(rms(before), rel=0.02)
    assert found.after == pytest.approx(rms(after), rel=0.02)
    assert found.confirmed


@pytest.mark.parametrize("size", [10.0, 50.0, 5e3])
@pytest.mark.parametrize("share", [3, 24])
def test_gross_errors_decide_nothing(size: float, share: int) -> None:
    """What both models miss by far is no reason to prefer one of them, nor hides the others."""
    rng = np.random.default_rng(7)
    before, after = errors(1, 1.0), errors(2, 0.0)
    clean = gap(before, after)
    gross = rng.choice([-size, size], size=(share, 1, 3))
    for e in (before, after):
        e[5:5 + share, :1] += gross
    found = gap(before, after)
    assert found.confirmed
    assert not found.worse
    assert found.before == pytest.approx(clean.before, rel=0.1)
    assert found.after == pytest.approx(clean.after, rel=0.1)
    # and of two models that are as good as each other neither is better
    same = gap(after, after[:, ::-1][:, [3, 1, 2, 0]])
    assert not same.confirmed
    assert not same.worse


def test_failures_count_where_both_models_miss() -> None:
    """A row that the old model misses too is no reason to forgive the new one."""
    before, after = errors(1, 0.0), errors(1, 0.0)
    before[:8] += 4.0
    after[:8] += 10.0
    found = gap(before, after)
    assert found.worse
    assert not found.confirmed
    assert found.after**2 - found.before**2 > 3.0


def test_both_models_are_treated_alike() -> None:
    """With the two exchanged, what was before is after, to the last digit."""
    rng = np.random.default_rng(3)
    a, b = errors(1, 1.0) * rng.standard_t(2.0, (60, 4, 1)), errors(2, 2.0)
    one, other = gap(a, b), gap(b, a)
    assert (one.before, one.after) == (other.after, other.before)


def test_a_row_that_the_new_model_is_unsure_of_counts() -> None:
    """A candidate cannot rid itself of rows by knowing little of them, nor excuse others so."""
    before, after = made(errors(1, 0.0)), made(errors(1, 0.0))
    after.square[:16] += 900.0
    after.variance[:16] = 1e6
    found = gap_of(before, after, 1.0, 3)
    assert found.after > 2.0
    assert found.worse


# --- the rows of fits -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Fit, tuple[Dataset, ...]]:
    """Return a fit of most of a small campaign, and the rest of its rows."""
    folder = tmp_path_factory.mktemp("held")
    simulate(folder, "3-RPR", [], count=40, approach="one")
    mechanism = read_mechanism(folder / "m.yaml")
    (data,) = read_campaign([folder / DATA], mechanism)
    part = np.arange(len(data)) % 4 > 0
    fit = identify(Problem(mechanism, (data.take(part),), mechanism.free))
    return fit, (data.take(~part),)


def test_a_machine_without_a_pose_at_held_out_rows_is_worse(
        fitted: tuple[Fit, tuple[Dataset, ...]]) -> None:
    """A row that the candidate cannot even reach is no row less to be judged by."""
    fit, held = fitted
    same = measure_gap(fit, fit, held, 1.0, 0)
    assert same is not None and not same.worse and same.before == same.after
    # legs so much shorter that the lowest poses have none
    g = fit.state.g.copy()
    names = fit.problem.mechanism.names
    lengths = [i for i, n in enumerate(names) if n.endswith(".offset")]
    g[lengths] -= 0.05
    short = replace(fit, state=replace(fit.state, g=g))
    reached = fresh_state(replace(fit.problem, datasets=held), short.state).poses[0]
    assert 0 < np.isfinite(reached).all(axis=1).sum() < len(reached)
    gap = measure_gap(fit, short, held, 1.0, 0)
    assert gap is not None and gap.worse and not gap.confirmed


# --- what is written for others to use ------------------------------------------------------------


@pytest.mark.parametrize(("expansion", "told"), [(12e-6, True), (155e-6, False)])
def test_a_rival_that_no_machine_is_is_beyond_physics(
        fitted: tuple[Fit, tuple[Dataset, ...]], expansion: float, told: bool) -> None:
    """An expansion beyond that of any material: `compensate` could not even read the file."""
    fit, _ = fitted
    machine = with_effect(fit.problem.mechanism, effect_kinds()["leg_thermal"], (True,) * 3,
                          {"expansion": Given(expansion, free=True)})
    ended = replace(fit, problem=replace(fit.problem, mechanism=machine, free=machine.free),
                    state=replace(fit.state, g=np.append(fit.state.g, [expansion, 0.0])))
    assert len(ended.state.g) == len(machine.parameters)
    assert bool(outside(ended.problem, ended.state)) != told


def test_what_to_measure_next_is_away_from_dead_points(
        fitted: tuple[Fit, tuple[Dataset, ...]]) -> None:
    fit, _ = fitted
    stage = stage_at(fit, ("gain",))
    rows = possible_rows(stage, np.random.default_rng(1))
    assert rows is not None and len(rows) > 50
    bare = Model(fit.problem.mechanism, fit.state.g)
    measured, proposed = (forward_table(bare, q).singular_value
                          for q in (fit.problem.datasets[0].q, rows.q))
    assert proposed.min() >= 0.99 * (1.0 - WIDER) * np.nanmin(measured)


@pytest.mark.slow
def test_what_to_measure_next_follows_the_last_row(tmp_path: Path) -> None:
    """At the campaign's own pace, not hours later."""
    simulate(tmp_path, "3-RPR", [effect("leg_thermal", expansion=2e-5)], count=40, approach="one")
    mechanism = read_mechanism(tmp_path / "m.yaml")
    (data,) = read_campaign([tmp_path / DATA], mechanism)
    fit = identify(Problem(mechanism, (data,), mechanism.free))
    kinds = ("leg_thermal", "base_thermal", "drift")
    stage = stage_at(fit, kinds)
    legs, base, drift = (next(h for h in stage.hypotheses if h.kind == kind and len(h.on) != 1)
                         for kind in kinds)
    found = propose(stage, legs, base, 1.5, 1)
    assert found.rows >= 4
    time = data.columns["time"]
    pace = float(np.median(np.diff(time)))
    assert found.columns["time"] == pytest.approx(
        time.max() + pace * np.arange(1, found.rows + 1))
    # what only time tells goes on after the last row, if it does: no more than 19 to 1
    assert propose(stage, drift, base, 1.5, 1).odds_after <= SURE_ODDS * (1.0 + 1e-9)
