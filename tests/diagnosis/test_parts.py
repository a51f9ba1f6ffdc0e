"""The pieces of a diagnosis, each against an answer that is known another way."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import hidden
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import betaln
from scipy.stats import f as fisher

from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.added_variable_test import (
    AddedVariableTest,
    build_test,
    log_p,
    seen_noise,
    squares_of,
)
from ppmcal.diagnosis.adequacy import kernel_test
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.diagnose import _untestable
from ppmcal.diagnosis.grids import usual_range
from ppmcal.diagnosis.hypotheses import Library, united
from ppmcal.diagnosis.linear_system import System, build
from ppmcal.diagnosis.rivals import as_one, find, rivals
from ppmcal.diagnosis.search import DETECT, NAME, Search, null_scan, scan
from ppmcal.diagnosis.selection import bic
from ppmcal.diagnosis.stage import Stage, of_single, run_stage
from ppmcal.diagnosis.whitening import estimate, heavy, pure_error, simulated
from ppmcal.model.effects import EffectParameter, effect_kinds

Array = NDArray[np.float64]


# --- p-values -------------------------------------------------------------------------------------


def ratio_to_f(x: Array, size: int, freedom: int) -> Array:
    """Return the F statistic of a share x of the squares."""
    return np.asarray((x / size) / ((1.0 - x) / (freedom - size)))


@pytest.mark.parametrize("size", [1, 2, 3, 6, 18])
@pytest.mark.parametrize("freedom", [25, 240, 3000])
def test_log_p_is_that_of_the_f_test(size: int, freedom: int) -> None:
    x = np.linspace(0.001, 0.999, 199)
    wanted = fisher.logsf(ratio_to_f(x, size, freedom), size, freedom - size)
    good = wanted > -600.0
    assert good.sum() > 10
    found = log_p(x, 1.0, size, freedom)
    assert np.allclose(found[good], wanted[good], rtol=1e-3, atol=1e-9)


def tail(x: float, size: int, freedom: int) -> float:
    """Return log I_y(b, a), y = 1 - x, by its power series, which has positive terms only."""
    a, b = size / 2.0, (freedom - size) / 2.0
    y = 1.0 - x
    term, total, n = 1.0, 1.0, 0
    while term > 1e-17 * total:
        term *= (a + b + n) / (b + 1.0 + n) * y
        total += term
        n += 1
    return float(b * np.log(y) + a * np.log(x) - np.log(b) - betaln(a, b) + np.log(total))


@pytest.mark.parametrize("size", [1, 3, 12])
@pytest.mark.parametrize("freedom", [240, 1000, 20000])
def test_log_p_far_out(size: int, freedom: int) -> None:
    """Where p underflows the logarithm is still right, and never turns back."""
    x = 1.0 - np.logspace(-9.0, -0.01, 400)
    wanted = np.array([tail(float(v), size, freedom) for v in x])
    found = log_p(x, 1.0, size, freedom)
    assert np.isfinite(found).all()
    assert wanted.min() < -1000.0
    assert np.allclose(found, wanted, rtol=1e-4, atol=0.02)
    order = np.argsort(x)
    assert np.all(np.diff(found[order]) <= 0.0)


def test_log_p_at_the_ends() -> None:
    assert log_p(np.array([0.0]), 1.0, 2, 100)[0] == 0.0
    assert log_p(np.array([0.3]), 1.0, 0, 100)[0] == 0.0
    assert np.isfinite(log_p(np.array([1.0, 1.1]), 1.0, 1, 100)).all()
    # columns that leave no freedom fit anything
    assert np.all(log_p(np.array([0.5, 0.999]), 1.0, np.array([10, 12]), 10) == 0.0)


# --- inner products -------------------------------------------------------------------------------


@cache
def random_case(seed: int = 0) -> tuple[Array, Array, Array, AddedVariableTest]:
    """Return geometry (60, 7), columns (60, 9) of all sizes, a residual, and their Gram."""
    rng = np.random.default_rng(seed)
    jacobian, residual = rng.normal(size=(60, 7)), rng.normal(size=60)
    columns = rng.normal(size=(60, 9)) * 10.0 ** rng.uniform(-4, 4, 9)
    basis = np.linalg.qr(jacobian)[0]
    test = build_test(basis, columns, residual, 60)
    return jacobian, columns, residual, test


def off(basis_of: Array, values: Array) -> Array:
    """Return values with a matrix' range projected out."""
    q = np.linalg.qr(basis_of)[0]
    return np.asarray(values - q @ (q.T @ values))


@pytest.mark.parametrize("chosen", [[], [3], [0, 5], [8, 1, 2, 6]])
def test_given_is_a_projection(chosen: list[int]) -> None:
    """What every pair of columns explains beyond those chosen, against QR of the whole model."""
    jacobian, columns, residual, test = random_case()
    model = np.concatenate([jacobian, columns[:, chosen]], axis=1)
    found, left = test.given(chosen), off(model, residual)
    assert found.square == pytest.approx(left @ left, rel=1e-10)
    assert found.freedom == 60 - 7 - len(chosen)
    others = [c for c in range(9) if c not in chosen]
    pairs = np.array([[a, b] for a in others for b in others if a < b])
    for pair, gain, rank in zip(pairs, *found.explained(pairs), strict=True):
        rest = off(np.concatenate([model, columns[:, pair]], axis=1), residual)
        assert gain == pytest.approx(left @ left - rest @ rest, rel=1e-8)
        assert rank == 2
    for c in chosen:
        gain, rank = found.explained(np.array([[c]]))
        assert rank[0] == 0
        assert gain[0] < 1e-12


def test_given_takes_the_chosen_columns_out_of_the_others() -> None:
    """C^T M C of what is left of unit columns, for several groups at once; G itself stays."""
    jacobian, columns, _, test = random_case()
    found = test.given([0, 5])
    assert found.first is test.first
    assert found.taken == (0, 5)
    left = off(np.concatenate([jacobian, columns[:, [0, 5]]], axis=1),
               columns / np.linalg.norm(columns, axis=0))
    rows, others = np.array([[1, 2], [3, 0]]), np.array([[4, 6, 8], [3, 5, 7]])
    for block, a, b in zip(found.block(rows, others), rows, others, strict=True):
        assert np.allclose(block, left[:, a].T @ left[:, b], atol=1e-12)
    one, two = test.first.some([1, 2]), test.first.some([4, 6, 8])
    assert np.allclose(test.block(rows, others)[0], one @ two.T)


@pytest.mark.parametrize("group", [[4], [0, 5], [7, 1, 3]])
def test_explained_is_the_gain_of_a_fit(group: list[int]) -> None:
    """Against least squares with and without the columns, given another one."""
    jacobian, columns, residual, test = random_case(1)
    old = np.concatenate([jacobian, columns[:, [2]]], axis=1)
    new = np.concatenate([old, columns[:, group]], axis=1)
    gain = np.sum(off(old, residual) ** 2) - np.sum(off(new, residual) ** 2)
    found, rank = test.given([2]).explained(np.array([group]))
    assert found[0] == pytest.approx(gain, rel=1e-9)
    assert rank[0] == len(group)


def test_columns_of_the_geometry_explain_nothing() -> None:
    jacobian, columns, residual, _ = random_case()
    inside = jacobian @ np.random.default_rng(1).normal(size=7)
    test = build_test(np.linalg.qr(jacobian)[0], np.stack([inside, columns[:, 0]], axis=1),
                      residual, 60)
    found, rank = test.explained(np.array([[0]]))
    assert rank[0] == 0
    assert found[0] < 1e-12
    # and a column that was chosen already has nothing left
    again, rank = test.given([1]).explained(np.array([[1]]))
    assert rank[0] == 0
    assert again[0] < 1e-12


def test_a_fit_is_least_squares() -> None:
    jacobian, columns, residual, test = random_case(2)
    value, covariance = test.fit([1, 4])
    model = np.concatenate([columns[:, [1, 4]], jacobian], axis=1)
    wanted = np.linalg.lstsq(model, residual, rcond=None)[0][:2]
    assert np.allclose(value, wanted, rtol=1e-8)
    noise = np.sum(off(model, residual) ** 2) / (60 - 9)
    assert np.allclose(covariance, np.linalg.inv(model.T @ model)[:2, :2] * noise, rtol=1e-7)


def test_extended_has_sums_of_columns() -> None:
    jacobian, columns, residual, test = random_case(3)
    weights = np.zeros((9, 2))
    weights[[0, 3], 0] = 1.0
    weights[[2, 5, 7], 1] = 1.0, -2.0, 3e-3
    found = test.extended(weights)
    whole = np.concatenate([columns, columns @ weights], axis=1)
    unit = off(jacobian, whole / np.linalg.norm(whole, axis=0))
    # the sum's length is taken before the projection, as for any column
    value, _ = found.fit([9])
    model = np.concatenate([whole[:, [9]], jacobian], axis=1)
    assert value[0] == pytest.approx(np.linalg.lstsq(model, residual, rcond=None)[0][0], rel=1e-8)
    gram = found.block(np.arange(11), np.arange(11))
    cosine = gram / np.sqrt(np.outer(np.diagonal(gram), np.diagonal(gram)))
    wanted = unit.T @ unit
    wanted /= np.sqrt(np.outer(np.diagonal(wanted), np.diagonal(wanted)))
    assert np.allclose(cosine, wanted, atol=1e-9)
    for group in ([9], [10], [1, 9]):
        square, _ = found.explained(np.array([group]))
        more = np.concatenate([jacobian, whole[:, group]], axis=1)
        gain = np.sum(off(jacobian, residual) ** 2) - np.sum(off(more, residual) ** 2)
        assert square[0] == pytest.approx(gain, rel=1e-8)


def test_survival_is_what_the_geometry_leaves() -> None:
    jacobian, columns, _, test = random_case(4)
    for c in range(9):
        left = np.linalg.norm(off(jacobian, columns[:, c])) / np.linalg.norm(columns[:, c])
        assert test.survival([c]) == pytest.approx(left, rel=1e-10)
    same = columns / np.linalg.norm(columns, axis=0)
    left = np.linalg.norm(off(jacobian, same[:, :3])) / np.linalg.norm(same[:, :3])
    assert test.survival([0, 1, 2]) == pytest.approx(left, rel=1e-10)


def test_survival_of_a_sum_of_columns() -> None:
    """One value for several joints: |MC|/|C| of the summed column, and never above 1."""
    rng = np.random.default_rng(5)
    jacobian, first = rng.normal(size=(60, 7)), rng.normal(size=60)
    columns = np.stack([first, first + 0.1 * rng.normal(size=60)], axis=1)
    test = build_test(np.linalg.qr(jacobian)[0], columns, first, 60)
    total = columns.sum(axis=1)
    wanted = np.linalg.norm(off(jacobian, total)) / np.linalg.norm(total)
    assert test.extended(np.ones((2, 1))).survival([2]) == pytest.approx(wanted, rel=1e-8)


# --- a real machine -------------------------------------------------------------------------------


@cache
def fitted(machine: str, seed: int, kinds: tuple[str, ...], eta: float, options: hidden.Options
           ) -> tuple[Problem, Any]:
    made = hidden.hide(machine, seed, list(kinds), eta, options)
    problem = Problem(made.mechanism, (made.dataset,), made.mechanism.free)
    return problem, identify(problem)


def system_of(machine: str, seed: int, kinds: tuple[str, ...] = (), eta: float = 1.0,
              options: hidden.Options = hidden.USUAL) -> tuple[System, Library]:
    problem, fit = fitted(machine, seed, kinds, eta, options)
    system = build(problem, fit.state, fit.keep)
    return system, library(system)


@cache
def stage_of(machine: str, seed: int, kinds: tuple[str, ...] = (), eta: float = 1.0,
             options: hidden.Options = hidden.USUAL) -> Stage:
    problem, fit = fitted(machine, seed, kinds, eta, options)
    return run_stage(problem, fit.state, fit.keep, seed)


def noise_of(stage: Stage, count: int, rng: np.random.Generator) -> Array:
    """Return simulated noise as the stage itself simulates it."""
    left = stage.residual - stage.basis @ (stage.basis.T @ stage.residual)
    return simulated(stage.noise, stage.system, stage.basis, left, count, rng)


SMALL = hidden.Options(poses=30)


def test_thresholds_hold_on_fresh_noise() -> None:
    """The smallest p of all hypotheses falls below p_det and p_name as often as they say."""
    stage = stage_of("3-RPR", 3, (), 1.0, SMALL)
    search, forms = stage.search, stage.library.hypotheses
    fresh, draws = np.random.default_rng(77), 1500
    test, noise = search.test, noise_of(stage, draws, fresh)
    smallest = null_scan(test, forms, seen_noise(test.first, stage.basis, noise))
    for level, limit in ((DETECT, search.detect), (NAME, search.name)):
        # both the threshold and the count are drawn
        spread = np.sqrt(level * (1.0 - level) * (1.0 / draws + 1.0 / search.smallest.size))
        assert abs(np.mean(smallest < limit) - level) < 3.5 * spread
    assert search.name < search.detect < np.log(DETECT)
    # the test of data and that of simulated noise are the same test
    for b in range(20):
        data = build_test(stage.basis, stage.columns, noise[:, b], stage.system.count)
        assert scan(data, forms).min() == pytest.approx(smallest[b], rel=1e-9)


def test_p_values_of_noise_are_uniform() -> None:
    """Each hypothesis alone rejects as often as it says, whatever its size."""
    stage = stage_of("3-RPR", 3, (), 1.0, SMALL)
    test, forms = stage.search.test, stage.library.hypotheses
    noise = noise_of(stage, 1000, np.random.default_rng(5))
    clean = noise - stage.basis @ (stage.basis.T @ noise)
    sizes = {f.size: f for f in forms if test.survival(f.columns) > 0.01}
    assert len(sizes) > 2
    for form in sizes.values():
        root, rank = test.roots(np.array([form.columns]))
        square = squares_of(root, (test.first.some(form.columns) @ clean)[None])
        p = np.exp(log_p(square[0], np.sum(clean**2, axis=0), rank[0], test.freedom))
        assert abs(np.mean(p < 0.1) - 0.1) < 3.5 * np.sqrt(0.1 * 0.9 / 1000), form.label
        assert abs(np.mean(p) - 0.5) < 3.5 / np.sqrt(12 * 1000), form.label


def kurtosis(values: Array) -> float:
    return float(np.mean(values**4) / np.mean(values**2) ** 2 - 3.0)


@pytest.mark.slow
def test_simulated_noise_has_the_tails_of_the_residuals() -> None:
    """Heavy tails are drawn again, row by row and with unit variance; normal noise stays normal."""
    rng, found = np.random.default_rng(8), {}
    for tails in ("normal", "t4"):
        stage = stage_of("3-RPR", 3, (), 1.0, hidden.Options(poses=80, tails=tails))
        seen = stage.system.observed.reshape(-1)
        left = stage.residual - stage.basis @ (stage.basis.T @ stage.residual)
        drawn = noise_of(stage, 200, rng)[seen]
        assert np.mean(drawn**2) == pytest.approx(1.0, abs=0.03)
        assert heavy(left[seen]) == (tails == "t4")
        found[tails] = kurtosis(drawn), kurtosis(left[seen])
    assert abs(found["normal"][0]) < 0.1
    assert found["t4"][0] == pytest.approx(found["t4"][1], rel=0.35)


# --- noise ----------------------------------------------------------------------------------------


def correlations(ar: float, kinds: tuple[str, ...], eta: float, seeds: range) -> Array:
    found = []
    for seed in seeds:
        system, every = system_of("3-RPR", seed, kinds, eta, hidden.Options(poses=40, ar=ar))
        found.append(estimate(system, every).rho)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("ar", "kinds"), [(0.0, ()), (0.3, ()), (0.6, ()), (0.0, ("drift",)),
                                           (0.6, ("drift",))])
def test_correlation_is_that_of_the_noise(ar: float, kinds: tuple[str, ...]) -> None:
    """Unbiased, with every candidate projected out; what is slow is not taken for noise."""
    rho = correlations(ar, kinds, 3.0, range(40, 46))
    # 240 values each; what is projected out takes 40 % of them at most
    error = np.sqrt((1.0 - ar**2) / (0.6 * 240) / rho.size)
    assert abs(rho.mean() - ar) < 3.0 * error, rho


@pytest.mark.slow
def test_a_strong_slow_effect_is_not_whitened_away() -> None:
    """Drift in correlated noise: still there after whitening, and named."""
    stage = stage_of("3-RPR", 41, ("drift",), 3.0, hidden.Options(poses=40, ar=0.6))
    best = min(range(len(stage.log_p)), key=lambda i: stage.log_p[i])
    assert stage.hypotheses[best].kind == "drift"
    assert stage.log_p[best] < -50.0
    assert [f.kind for f in stage.named] == ["drift"]


def test_pure_error_does_not_pool_directions() -> None:
    """Repeats with a large backlash: the scatter is still the noise; directions are apart."""
    options = hidden.Options(poses=20, repeats=3, columns=("dir",))
    system, _ = system_of("3-RPR", 6, ("backlash",), 5.0, options)
    pure = pure_error(system)
    rows = len(system.residual)
    assert pure is not None
    assert pure.freedom <= 20 * 2 * 2 * 3
    assert pure.freedom > 0.8 * 20 * 2 * 2 * 3 * rows / 120
    assert abs(pure.ratio**2 - 1.0) < 4.0 * np.sqrt(2.0 / pure.freedom)
    assert float(np.sum(system.residual**2)) / system.count > 4.0


def test_pure_error_of_rows_without_repeats() -> None:
    options = hidden.Options(poses=20, repeats=1, columns=("dir",))
    assert pure_error(system_of("3-RPR", 6, (), 1.0, options)[0]) is None


def test_repeats_at_nearly_the_same_temperature_are_repeats() -> None:
    """A thermometer read to 0.01 K wanders; the machine does not notice."""
    options = hidden.Options(poses=20, repeats=3, columns=("dir",))
    made = hidden.hide("3-RPR", 6, [], 1.0, options)
    wander = 1e-3 * np.random.default_rng(0).normal(size=len(made.dataset))
    data = replace(made.dataset, columns={**made.dataset.columns, "temperature": 293.15 + wander})
    problem = Problem(made.mechanism, (data,), made.mechanism.free)
    fit = identify(problem)
    pure = pure_error(build(problem, fit.state, fit.keep))
    assert pure is not None
    assert pure.freedom > 150


# --- what is left ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_kernel_test_false_alarms_and_power() -> None:
    """1 % at 1 %; a bump of the noise's size over a part of one joint's stroke is seen."""
    rng = np.random.default_rng(8)

    def p_of(stage: Stage, extra: Array) -> float:
        seen, basis = stage.system.observed.reshape(-1), stage.basis
        left = rng.normal(size=seen.size) * seen + extra
        left = left - basis @ (basis.T @ left)
        return kernel_test(stage, basis, left, int(rng.integers(999)))[1]

    small = stage_of("3-RPR", 3, (), 1.0, SMALL)
    alone = np.array([p_of(small, np.zeros(small.residual.size)) for _ in range(100)])
    # binomial: 1 % of 100 is above 5 once in 2000, 10 % above 20 or below 2 once in 1000
    assert np.sum(alone < 0.01) <= 5
    assert 2 <= np.sum(alone < 0.1) <= 20
    assert alone.min() > 0.0
    stage = stage_of("3-RPR", 3)
    system, basis = stage.system, stage.basis
    seen = system.observed.reshape(-1)
    # what follows one input alone is seen among all the others: p is not bounded by their number
    n = len(system.residual)
    slow = np.repeat(np.cos(np.arange(n) / n * 2.0 * np.pi), system.residual.shape[1]) * seen
    assert p_of(stage, 2.0 * slow) < 0.003
    travel = np.concatenate([p.setting.travel for p in system.parts])[:, 0]
    bump = np.exp(-0.5 * ((travel - np.median(travel)) / (0.25 * np.std(travel))) ** 2)
    shape = np.repeat(bump, system.residual.shape[1]) * seen
    shape = shape - basis @ (basis.T @ shape)
    shape *= np.sqrt(seen.sum()) / np.linalg.norm(shape)
    assert np.mean([p_of(stage, shape) < 0.01 for _ in range(10)]) >= 0.9


# --- rivals ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_sensor_scale_and_gain_of_all_encoders_are_rivals() -> None:
    """A larger machine and a longer ruler are the same to every measured pose."""
    stage = stage_of("6-UPS", 9, ("sensor_scale",), 1.0, SMALL)
    forms = stage.search.hypotheses
    scale = next(i for i, f in enumerate(forms) if f.kind == "sensor_scale")
    gain = next(i for i, f in enumerate(forms) if f.kind == "gain" and f.shared and len(f.on) == 6)
    a, b = forms[scale].columns[0], forms[gain].columns[0]
    g = stage.search.test.block(np.array([a, b]), np.array([a, b]))
    assert abs(g[0, 1]) / np.sqrt(g[0, 0] * g[1, 1]) > 0.995
    for one, other in ((scale, gain), (gain, scale)):
        found = {r.hypothesis.label: r for r in rivals(stage.search, (one,), one)}
        rival = found[forms[other].label]
        assert rival.hypothesis == forms[other]
        assert rival.angle < 0.1
        assert 0.05 < rival.odds < 20.0


@pytest.mark.slow
def test_backlash_and_compliance_are_no_rivals() -> None:
    stage = stage_of("6-UPS", 9, ("backlash",), 1.0, SMALL)
    assert [f.kind for f in stage.named] == ["backlash"]
    found = rivals(stage.search, stage.chosen, stage.chosen[0])
    assert not {r.hypothesis.kind for r in found} & {"compliance", "leg_thermal"}


@pytest.mark.slow
def test_a_kind_on_a_few_actuators_is_one_hypothesis() -> None:
    """With values of its own on each it is what the single ones are together."""
    stage = stage_of("6-UPS", 9, ("backlash",), 1.0, SMALL)
    forms = stage.search.hypotheses
    single = {f.on[0]: f for f in forms if f.kind == "curvature" and len(f.on) == 1}
    two = united([single["leg2"], single["leg5"]])
    assert (two.on, two.shared, two.size) == (("leg2", "leg5"), False, 6)
    assert two.label == "curvature on leg2, leg5"
    search, at = find(stage.search, two)
    assert at is not None
    assert search.hypotheses[at] == two
    apart = [stage.columns[:, single[a].columns] for a in two.on]
    assert np.array_equal(of_single(stage.columns, forms, two), np.concatenate(apart, axis=1))
    assert np.array_equal(of_single(stage.columns, forms, replace(two, shared=True)),
                          apart[0] + apart[1])
    each = next(f for f in forms if f.kind == "curvature" and not f.shared)
    everywhere = united([single[a] for a in each.on])
    assert (everywhere.names, everywhere.columns) == (each.names, each.columns)


def test_a_rival_on_several_actuators_names_them_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """What could take the place of a gain of two legs is curvature of both, not of the first.

    It takes four values more, which count; that it is on two legs is one choice, as for the gain.
    At odds beyond 1000 to 1 it is one only since the gain may imitate something.
    """
    stage = stage_of("3-RPR", 0, ("gain",), 1.0, SMALL)
    assert [(f.kind, f.on) for f in stage.named] == [("gain", ("leg1", "leg3"))]
    (rival,) = rivals(stage.search, stage.chosen, stage.chosen[0])
    assert (rival.hypothesis.kind, rival.hypothesis.on) == ("curvature", ("leg1", "leg3"))
    given = stage.search.test.given
    assert given(rival.hypothesis.columns).square < given(rival.hypothesis.columns[:3]).square
    whole, one = as_one(stage.search, rival.members)
    apart = bic(whole, (one,)) - bic(stage.search, stage.chosen)
    assert rival.odds == pytest.approx(np.exp(apart / 2.0)) and rival.odds > 1000.0
    assert apart < bic(stage.search, rival.members) - bic(stage.search, stage.chosen) - 3.0
    monkeypatch.setattr("ppmcal.diagnosis.rivals.doubtful", lambda *_: False)
    assert rivals(stage.search, stage.chosen, stage.chosen[0]) == []


def surrounded(part: Any, **changes: Any) -> Any:
    """Return a part whose rows' effects depend on something else."""
    rows = replace(part.response.rows, **changes)
    return replace(part, response=replace(part.response, surroundings=lambda: rows))


def test_what_is_optional_is_tried_alone_after_the_plain_kind() -> None:
    """And not where its columns are missing; each costs its value and that it was looked for."""
    system, found = system_of("3-RPR", 1)
    optional = {s.name for s in effect_kinds()["compliance"].parameters("planar") if s.optional}
    for kind in ("compliance", "leg_thermal"):
        own = [f for f in found.hypotheses if f.family == kind and len(f.on) == 1]
        have = [set(f.constants) & (optional | {"tau"}) for f in own]
        assert not have[0] and all(len(h) <= 1 for h in have)
        assert {f.searched for f, h in zip(own, have, strict=True) if h} <= {2}
        assert {f.searched for f, h in zip(own, have, strict=True) if not h} == {0}
        assert not any(f.constants[n] == 0.0 for f, h in zip(own, have, strict=True) for n in h)
        assert set().union(*have) == ({"tau"} if kind == "leg_thermal" else optional)
    forgetful = [surrounded(p, history=None) for p in system.parts]
    less = library(replace(system, parts=tuple(forgetful)), ["leg_thermal"])
    assert {f.family for f in less.hypotheses} == {"leg_thermal"}
    assert not any("tau" in f.constants for f in less.hypotheses)


def test_one_of_two_kinds_of_a_name_may_be_untestable() -> None:
    """Heat of the drives is tested without a thermometer; heat of the hall stays listed."""
    system, _ = system_of("3-RPR", 1)
    cold = [surrounded(p, temperature=np.full_like(p.response.rows.temperature, np.nan))
            for p in system.parts]
    less: Any = SimpleNamespace(library=library(replace(system, parts=tuple(cold))))
    less.hypotheses = less.library.hypotheses
    assert "leg_thermal" in {f.kind for f in less.hypotheses}
    found: Any = SimpleNamespace(first=less, last=less)
    assert "leg_thermal" in {u.kind for u in _untestable(found)}
    later: Any = SimpleNamespace(library=library(system))
    later.hypotheses = later.library.hypotheses
    found = SimpleNamespace(first=less, last=later)
    assert "leg_thermal" not in {u.kind for u in _untestable(found)}


@pytest.mark.parametrize(("traits", "expected"), [
    ({}, (-np.inf, np.inf)), ({"usual": (0.0, 0.05), "of_stroke": True}, (0.0, 0.02)),
    ({"reciprocal": True}, (0.0, np.inf)),
    ({"reciprocal": True, "usual": (10.0, 1e4)}, (1e-4, 0.1))])
def test_the_range_of_a_coefficient(traits: dict[str, Any], expected: tuple[float, float]) -> None:
    """A kind that says no range has any; a reciprocal one is judged by its inverse."""
    found = usual_range(EffectParameter("k", "joint", **traits), 0.4)
    assert found == pytest.approx(expected)


# --- p-values that are told -----------------------------------------------------------------------


def test_a_chance_that_is_told_is_that_of_the_best_of_all() -> None:
    """Of 3000 tests the smallest p is below 1e-4 in a quarter of all campaigns of noise."""
    rng = np.random.default_rng(1)
    tests, draws = 3000, 4000
    smallest = np.log1p(-rng.random(draws) ** (1.0 / tests))
    detect, name = np.quantile(smallest, [DETECT, NAME])
    nothing: Any = None
    search = Search(nothing, (), float(detect), float(name), smallest)
    for p in (1e-3, 1e-4, 1e-5, 1e-7, 1e-30):
        true = -np.expm1(tests * np.log1p(-p))
        assert search.over_all(np.log(p)) == pytest.approx(np.log(true), abs=0.35), p
    values = np.linspace(-80.0, 0.0, 500)
    told = np.array([search.over_all(v) for v in values])
    assert (np.diff(told) >= 0.0).all() and told[-1] == 0.0
    assert (search.over_all(search.detect), search.over_all(search.name)) == pytest.approx(
        (np.log(DETECT), np.log(NAME)))
