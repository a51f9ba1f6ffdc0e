"""Statistics against closed forms and plain loops, and what they must not depend on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, norm
from scipy.stats import f as fisher

from ppmcal.diagnosis import rivals, whitening
from ppmcal.diagnosis.added_variable_test import (
    AddedVariableTest,
    build_test,
    log_p,
    probability,
    pseudo_inverse,
)
from ppmcal.diagnosis.adequacy import _kernel, _tail
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import System, SystemPart, _groups
from ppmcal.diagnosis.refit import _given_optional
from ppmcal.diagnosis.rivals import _choices, _elsewhere, _subsets, _together, _within
from ppmcal.diagnosis.search import Search
from ppmcal.model.effects import EffectParameter, effect_kinds

Array = NDArray[np.float64]

# --- p-values ------------------------------------------------------------------------------------


@pytest.mark.parametrize("freedom", [5, 40, 3000])
@pytest.mark.parametrize("part", [1e-9, 0.2, 0.9, 0.999, 1.0 - 1e-6])
def test_two_and_four_columns_have_a_p_value_in_closed_form(freedom: int, part: float) -> None:
    """(1 - R^2)^b and (1 - R^2)^b (1 + b R^2), b = (nu - k)/2, however small they are."""
    two, four = (float(log_p(np.array([part]), 1.0, k, freedom)[0]) for k in (2, 4))
    assert two == pytest.approx((freedom / 2.0 - 1.0) * np.log1p(-part), rel=1e-6, abs=1e-14)
    b = freedom / 2.0 - 2.0
    wanted = b * np.log1p(-part) + np.log1p(b * part)
    assert four == pytest.approx(wanted, rel=1e-4 if wanted < -400.0 else 1e-7, abs=1e-14)


def test_more_explained_is_less_probable_without_a_jump() -> None:
    """Where p can be had and where it underflows."""
    part = np.linspace(0.0, 0.999, 4000)
    for size in (1, 3, 6):
        found = log_p(part, 1.0, size, 900)
        assert found[0] == pytest.approx(0.0, abs=1e-12)
        steps = np.diff(found)
        assert (steps < 0.0).all()
        # the slope is that of 1 - R^2 to some power: no kink where one form takes over
        second = np.abs(np.diff(steps[100:-100]))
        assert second.max() < 0.02 * np.abs(steps[100:-100]).max()
    assert log_p(np.array([1.0, 2.0]), 1.0, 1, 50).tolist() == [
        float(log_p(np.array([1.0]), 1.0, 1, 50)[0])] * 2


def test_of_many_values_one_column_is_a_normal_score() -> None:
    for z in (0.5, 2.0, 5.0):
        found = float(log_p(np.array([z**2]), 10**7 + z**2, 1, 10**7)[0])
        assert found == pytest.approx(np.log(2.0) + norm.logsf(z), rel=1e-4)


def test_a_probability_is_never_0() -> None:
    assert probability(-3.0) == pytest.approx(np.exp(-3.0))
    assert probability(0.0) == 1.0
    assert probability(-700.0) == pytest.approx(np.exp(-700.0))
    assert 0.0 < probability(-1e9) < 1e-300


# --- tests of columns ----------------------------------------------------------------------------

N = 50


def parts(seed: int = 0) -> tuple[Array, Array, Array]:
    """Return geometry, columns of many sizes of which the last is made of two, and a residual."""
    rng = np.random.default_rng(seed)
    geometry = rng.normal(size=(N, 3))
    columns = rng.normal(size=(N, 6)) * 10.0 ** np.array([3.0, -6.0, 0.0, 1.0, -2.0, 0.0])
    columns[:, 5] = 2.0 * columns[:, 2] - 0.3 * columns[:, 3]
    return geometry, columns, rng.normal(size=N) + 0.4 * columns[:, 2]


def test_of(geometry: Array, columns: Array, residual: Array) -> AddedVariableTest:
    return build_test(np.linalg.qr(geometry)[0], columns, residual, N)


test_of.__test__ = False  # type: ignore[attr-defined]


def rss(geometry: Array, columns: Array, residual: Array, *chosen: int) -> float:
    whole = np.column_stack([geometry, columns[:, list(chosen)]])
    basis = np.linalg.svd(whole / np.linalg.norm(whole, axis=0), full_matrices=False)
    basis_of = basis[0][:, basis[1] > 1e-9]
    return float(np.sum((residual - basis_of @ (basis_of.T @ residual)) ** 2))


@pytest.mark.parametrize("chosen", [(), (1,), (5, 0), (2, 3)])
@pytest.mark.parametrize("group", [(4,), (2, 4), (2, 3, 5), (5, 2)])
def test_what_groups_explain_beside_others_is_that_of_fits(chosen: tuple[int, ...],
                                                           group: tuple[int, ...]) -> None:
    """Also where columns are made of each other: their rank is counted, in the model and beside."""
    geometry, columns, residual = parts()
    test = test_of(geometry, columns, residual).given(chosen)
    square, rank = test.explained(np.array([group]))
    known = geometry, columns, residual
    assert square[0] == pytest.approx(rss(*known, *chosen) - rss(*known, *chosen, *group),
                                      rel=1e-7, abs=1e-9)
    whole = np.linalg.matrix_rank(unit(columns[:, [*chosen, *group]]), tol=1e-9)
    base = np.linalg.matrix_rank(unit(columns[:, list(chosen)]), tol=1e-9) if chosen else 0
    assert rank[0] == whole - base
    assert test.freedom == N - 3 - base
    assert test.square == pytest.approx(rss(*known, *chosen))
    assert test.left(()) == pytest.approx(test.square)


def unit(columns: Array) -> Array:
    return np.asarray(columns / np.linalg.norm(columns, axis=0))


@pytest.mark.parametrize("factor", [1e-9, -3.0, 1e7])
def test_the_unit_of_a_column_changes_its_coefficient_only(factor: float) -> None:
    geometry, columns, residual = parts()
    other = columns.copy()
    other[:, 2] *= factor
    one, two = (test_of(geometry, c, residual) for c in (columns, other))
    groups = np.array([[2, 4], [0, 2]])
    np.testing.assert_allclose(one.explained(groups)[0], two.explained(groups)[0], rtol=1e-9)
    (a, ca), (b, cb) = one.fit((4, 2)), two.fit((4, 2))
    np.testing.assert_allclose(b, a / [1.0, factor], rtol=1e-8)
    np.testing.assert_allclose(cb, ca / np.outer([1.0, factor], [1.0, factor]), rtol=1e-8)
    assert one.survival((2, 4)) == pytest.approx(two.survival((2, 4)))


def test_the_unit_of_the_residual_changes_squares_only() -> None:
    geometry, columns, residual = parts()
    one, two = (test_of(geometry, columns, f * residual) for f in (1.0, 1e-6))
    assert two.square == pytest.approx(1e-12 * one.square)
    np.testing.assert_allclose(two.fit((0, 4))[0], 1e-6 * one.fit((0, 4))[0])
    np.testing.assert_allclose(two.fit((0, 4))[1], 1e-12 * one.fit((0, 4))[1])


@pytest.mark.parametrize("chosen", [(), (1,), (6,), (7, 0)])
def test_a_column_that_is_added_is_the_combination_it_is_made_of(chosen: tuple[int, ...]) -> None:
    """Where it was there from the start nothing else comes out: with others in the model too."""
    geometry, columns, residual = parts()
    weights = np.zeros((6, 2))
    weights[[2, 4], 0] = 1.0, -30.0
    weights[[0, 1, 3], 1] = 1e-3, 1e6, 2.0
    made = test_of(geometry, columns, residual).extended(weights).given(chosen)
    there = test_of(geometry, np.column_stack([columns, columns @ weights]), residual).given(chosen)
    groups = np.array([[6, 1], [7, 2], [4, 3]])
    np.testing.assert_allclose(made.explained(groups)[0], there.explained(groups)[0], rtol=1e-7,
                               atol=1e-9)
    np.testing.assert_allclose(made.length, there.length)
    np.testing.assert_allclose(made.right, there.right, atol=1e-9)
    np.testing.assert_allclose(made.hidden, there.hidden, atol=1e-12)
    assert made.survival((6, 7)) == pytest.approx(there.survival((6, 7)))
    np.testing.assert_allclose(made.block(np.array([6, 0]), np.array([1, 7, 3])),
                               there.block(np.array([6, 0]), np.array([1, 7, 3])), atol=1e-9)
    again = test_of(geometry, columns, residual).extended(weights[:, :1])
    twice = again.extended(np.vstack([weights[:, 1:], [[0.0]]]))
    np.testing.assert_allclose(twice.explained(groups)[0],
                               test_of(geometry, np.column_stack([columns, columns @ weights]),
                                       residual).explained(groups)[0], rtol=1e-7)
    few = twice.only([7, 2, 6])
    np.testing.assert_allclose(few.explained(np.array([[0, 1], [1, 2]]))[0], twice.explained(
        np.array([[7, 2], [2, 6]]))[0], rtol=1e-9)
    assert len(few.first) == 3


def test_a_block_that_is_singular_has_the_inverse_of_what_is_there() -> None:
    a = np.random.default_rng(2).normal(size=(4, 2))
    np.testing.assert_allclose(pseudo_inverse(a @ a.T), np.linalg.pinv(a @ a.T), rtol=1e-8)
    np.testing.assert_array_equal(pseudo_inverse(np.diag([1e-9, 4.0])), np.diag([0.0, 0.25]))


def test_a_column_within_the_geometry_explains_nothing() -> None:
    geometry, columns, residual = parts()
    columns[:, 1] = 1e-4 * (geometry[:, 0] - 2.0 * geometry[:, 2])
    found = test_of(geometry, columns, residual)
    square, rank = found.explained(np.array([[1], [0]]))
    assert rank.tolist() == [0, 1]
    assert square[0] == 0.0
    assert found.survival((1,)) == pytest.approx(0.0, abs=1e-7)


# --- kernels -------------------------------------------------------------------------------------

def test_a_kernel_is_what_its_formula_says_number_by_number() -> None:
    """Of inputs in standard deviations, mean squares over inputs, centred both ways."""
    rng = np.random.default_rng(4)
    values, widths = rng.normal(size=(7, 2)) * [2.0, 50.0] + [7.0, -1.0], (0.3, 1.2)
    plain = np.zeros((7, 7))
    for i in range(7):
        for j in range(7):
            apart = np.mean(((values[i] - values[j]) / values.std(axis=0)) ** 2)
            plain[i, j] = sum(np.exp(-apart / (2.0 * w * w)) for w in widths)
    centre = np.eye(7) - 1.0 / 7.0
    np.testing.assert_allclose(_kernel(values, widths), centre @ plain @ centre, atol=1e-12)


def test_a_kernel_has_no_unit_and_knows_no_zero() -> None:
    """Nor the order of inputs, nor which way they count; the order of rows is its own."""
    values, widths = np.random.default_rng(5).normal(size=(9, 2)), (0.5, 1.5)
    here = _kernel(values, widths)
    np.testing.assert_allclose(_kernel(values * [-1e-6, 40.0] + [3e-6, 900.0], widths), here,
                               atol=1e-9)
    np.testing.assert_allclose(_kernel(values[:, ::-1], widths), here, atol=1e-12)
    order = np.random.default_rng(6).permutation(9)
    np.testing.assert_allclose(_kernel(values[order], widths), here[np.ix_(order, order)],
                               atol=1e-12)


def test_an_input_that_stands_still_tells_no_rows_apart() -> None:
    """Beside another it is one more that is alike, and never a number that is none."""
    values = np.random.default_rng(7).normal(size=(8, 1))
    still = np.full((8, 1), 3.0)
    both = _kernel(np.concatenate([values, still], axis=1), (1.0,))
    np.testing.assert_allclose(both, _kernel(values, (np.sqrt(2.0),)), atol=1e-12)
    np.testing.assert_allclose(_kernel(still, (1.0,)), 0.0, atol=1e-15)


@pytest.mark.parametrize(("freedom", "tolerance"), [(4, 0.15), (40, 0.1)])
def test_tails_are_those_of_sums_of_squares(freedom: int, tolerance: float) -> None:
    """For which the gamma distribution is exact; whatever their unit and zero."""
    noise = chi2.ppf((np.arange(2000) + 0.5) / 2000, freedom)
    for p in (0.9, 0.3, 0.01, 1e-4, 1e-8):
        figure = np.append(chi2.isf(p, freedom), noise)
        found = _tail(figure)
        assert np.log(found[0]) == pytest.approx(np.log(p), rel=tolerance)
        np.testing.assert_allclose(_tail(7.0 - 1e3 + 1e-3 * figure), found, rtol=1e-5)
    np.testing.assert_allclose(np.mean(_tail(np.append(0.0, noise))[1:]), 0.5, atol=0.01)


def test_tails_without_skewness_are_normal_and_of_equal_figures_none() -> None:
    noise = norm.ppf((np.arange(5000) + 0.5) / 5000)
    for z in (-2.0, 0.0, 3.0):
        assert _tail(np.append(z, noise))[0] == pytest.approx(norm.sf(z), rel=0.3)
        assert _tail(np.append(z, -chi2.ppf((np.arange(999) + 0.5) / 999, 3)))[0] >= 0.0
    assert 0.3 < _tail(np.full(20, 4.0))[0] < 0.7
    assert _tail(np.array([-1e6, 1.0, 2.0, 3.0, 9.0]))[0] == 1.0


# --- rows ----------------------------------------------------------------------------------------

def test_poses_of_files_are_labelled_apart() -> None:
    problem: Any = SimpleNamespace(datasets=(
        SimpleNamespace(groups=np.array([3, 1, 3, 0]), campaign="", name="a"),
        SimpleNamespace(groups=np.array([3, 0]), campaign="", name="b")))
    found = _groups(problem, np.array([0, 0, 1, 0, 1]), np.array([0, 2, 0, 1, 1]))
    assert found.shape == (5,)
    same = found[:, None] == found
    assert same.sum() == 7
    assert same[0, 1]
    assert set(found) == {0, 1, 2, 3}


def test_the_stroke_is_the_longest_way_of_a_joint() -> None:
    """Over all parts; values that were measured are counted; pairs are one row."""
    def part(travel: Array, end: int) -> Any:
        return SimpleNamespace(setting=SimpleNamespace(travel=travel), response=SimpleNamespace(
            end=end))

    none: Any = None
    pieces = (part(np.array([[1.0, 5.0], [4.0, 6.0]]), 0), part(np.array([[-1.0, 7.0]]), 1))
    observed = np.array([[True, False], [True, True]])
    system = System(none, none, pieces, np.zeros((2, 2)), none, observed, none, none, none)
    assert system.stroke == 5.0
    assert system.count == 3
    assert system.firsts == pieces[:1]


def test_a_column_is_the_sum_of_both_ends_whitened() -> None:
    """Where nothing was observed it is 0; columns that a part has not are 0 too."""
    rng = np.random.default_rng(8)
    raw = rng.normal(size=(2, 3, 2))
    seen: Any = SimpleNamespace(observed=np.array([[True, True], [True, False], [True, True]]))
    whitener = rng.normal(size=(3, 2, 2))
    parts = tuple(SystemPart(slice(1, 4), 0, SimpleNamespace(  # type: ignore[arg-type]
        seen=seen, column=lambda shift, n=n: raw[n]), whitener) for n in (0, 1))
    none: Any = None
    system = System(none, none, parts, np.zeros((5, 3)), none, none, none, none, none)
    found = system.column([none, none])
    want = np.zeros((5, 3))
    for n in range(3):
        want[1 + n, :2] = whitener[n] @ np.where(seen.observed[n], raw[0, n] + raw[1, n], 0.0)
    np.testing.assert_allclose(found, want, atol=1e-14)


# --- rivals --------------------------------------------------------------------------------------

def joints(values: dict[str, float], names: str = "abcd", kind: str = "gain") -> Search:
    """Return a search of one kind alone on each joint, with values in the data."""
    rng = np.random.default_rng(9)
    columns = rng.normal(size=(120, len(names)))
    residual = rng.normal(size=120) + sum((columns[:, names.index(j)] * v
                                           for j, v in values.items()), np.zeros(120))
    test = build_test(np.linalg.qr(rng.normal(size=(120, 3)))[0], columns, residual, 120)
    single = tuple(Hypothesis(kind, (j,), True, ("gain",), (-np.inf,), (np.inf,), (c,),
                              effect=effect_kinds()[kind]) for c, j in enumerate(names))
    return Search(test, single, -5.0, -7.0, np.zeros(1))


def test_the_strongest_one_two_and_so_on_are_tried() -> None:
    """Of those that were named, then of all; each set once, in the order of the joints."""
    search = joints({"a": 0.5, "b": 2.0, "d": 1.0})
    single = {"a": 0, "b": 1, "c": 2, "d": 3}
    found = _subsets(search, [], single, ["a", "d"])
    assert found[:2] == [["a", "d"], ["d"]]
    assert found[2:] == [["b"], ["b", "d"], ["a", "b", "d"], ["a", "b", "c", "d"]]
    assert _subsets(search, [], single, []) == [["b"], ["b", "d"], ["a", "b", "d"],
                                                ["a", "b", "c", "d"]]


@pytest.mark.parametrize(("some", "sets"), [(1, 6), (2, 15), (3, 20), (6, 1)])
def test_a_choice_of_joints_is_one_of_so_many_sets(some: int, sets: int) -> None:
    search: Any = SimpleNamespace(hypotheses=[SimpleNamespace(on=tuple("ab")),
                                              SimpleNamespace(on=tuple("abcdef"))])
    assert _choices(search, some) == pytest.approx(np.log(sets), abs=1e-12)


def test_joints_that_share_a_value_have_the_sum_of_their_columns() -> None:
    search = joints({"a": 1.0})
    made, at = _together(search, [search.hypotheses[n] for n in (0, 2)])
    assert at == 4
    assert made.hypotheses[4].on == ("a", "c")
    assert made.hypotheses[4].columns == (4,)
    both = made.test.given([0]).explained(np.array([[4], [2]]))[0]
    assert both[0] == pytest.approx(both[1])        # beside one of two the sum is the other
    assert _together(made, [search.hypotheses[n] for n in (2, 0)]) == (made, 4)
    assert _within(made, [4], [0, 2])
    assert not _within(made, [4], [0, 1])
    assert _within(made, [0], [4, 2])


@pytest.mark.parametrize("turn", [0.02, 0.7, np.pi / 2.0])
def test_an_angle_is_the_smallest_between_planes(turn: float) -> None:
    """Past geometry and what is chosen; whatever the columns' lengths."""
    q = np.linalg.qr(np.random.default_rng(10).normal(size=(40, 9)))[0]
    columns = np.stack([q[:, 3] + 5.0 * q[:, 0], 7.0 * (q[:, 4] + q[:, 3]) + q[:, 8],
                        np.cos(turn) * q[:, 3] + np.sin(turn) * q[:, 5] - 3.0 * q[:, 1],
                        1e-3 * q[:, 6], q[:, 8]], axis=1)
    test = build_test(q[:, :3], columns, q[:, 7], 40)
    h = [Hypothesis(f"k{n}", (), True, ("a",) * len(c), (-np.inf,) * len(c), (np.inf,) * len(c), c)
         for n, c in enumerate(((0, 1), (2, 3), (4,)))]
    search = Search(test, tuple(h), -5.0, -7.0, np.zeros(1))
    assert rivals._angle(search, [2], 0, [1]) == pytest.approx(turn, abs=1e-6)


def test_other_kinds_on_just_these_joints_are_rivals() -> None:
    """One value for each; nothing that a grid chose, no slot, no kind that lacks a joint."""
    def one(kind: str, on: str, **traits: Any) -> Hypothesis:
        return Hypothesis(kind, tuple(on), True, ("v",), (0.0,), (1.0,), (0,), **traits)

    search: Any = SimpleNamespace(hypotheses=[
        one("x", "a"), one("x", "b"), one("x", "c"), one("x", "b"), one("y", "a"),
        one("own", "a"), one("own", "b"), one("z", "a", searched=1), one("z", "b"),
        one("w", "ab"), one("s", "a", slot="a.length"), one("s", "b", slot="b.length")])
    assert _elsewhere(search, one("own", "ab")) == [(0, 1)]
    assert _elsewhere(search, one("own", "a")) == []
    assert _elsewhere(search, one("own", "abd")) == []


def test_a_general_kind_that_lacks_a_joint_is_no_rival_of_a_plain_one() -> None:
    """The plain one has to be there on every joint of the general one, else it stays."""
    search = joints({"a": 2.0, "b": 2.0}, "ab", "backlash")
    rng = np.random.default_rng(12)
    general = Hypothesis("friction", ("a", "b", "c"), False, ("s",) * 3, (-np.inf,) * 3,
                         (np.inf,) * 3, (0, 1, 2), effect=effect_kinds()["friction"])
    columns = np.column_stack([search.test.first.some([0, 1]).T, rng.normal(size=120)])
    test = build_test(np.eye(120)[:, :1] * 0.0, columns, 30.0 * columns[:, :2].sum(axis=1)
                      + rng.normal(size=120), 120)
    made = Search(test, (*search.hypotheses, general), -5.0, -7.0, np.zeros(1))
    assert rivals.simplified(made, (2,))[1] == (2,)


# --- sizes ---------------------------------------------------------------------------------------

def test_of_what_is_held_a_covariance_is_the_conditional_one() -> None:
    """Schur's complement: inverse of a block of the inverse; nothing held, nothing changes."""
    a = np.random.default_rng(11).normal(size=(6, 4))
    covariance: Array = np.asarray(np.linalg.inv(a.T @ a), dtype=float)
    kind: Any = SimpleNamespace(parameters=lambda motion: (
        EffectParameter("size", "1"), EffectParameter("hard", "1", optional=True)))
    effect = SimpleNamespace(kind=kind, parameters={"size": 10, "hard": 12})
    fit: Any = SimpleNamespace(problem=SimpleNamespace(
        free=(9, 10, 11, 12), mechanism=SimpleNamespace(effects=(effect,), motion="spatial")))
    found = _given_optional(fit, covariance, [1, 2, 3], [1, 2])
    keep = np.linalg.inv(np.linalg.inv(covariance[1:, 1:])[:2, :2])
    np.testing.assert_allclose(found, keep, rtol=1e-9)
    np.testing.assert_array_equal(_given_optional(fit, covariance, [1, 2], [1, 2]),
                                  covariance[1:3, 1:3])
    unknown = covariance.copy()
    unknown[3, 3] = np.inf
    np.testing.assert_array_equal(_given_optional(fit, unknown, [1, 3], [1]), covariance[1:2, 1:2])


@pytest.mark.parametrize(("kind", "constants", "slow"), [
    ("zero_shift", {}, True), ("creep", {}, True), ("gain", {}, False), ("leg_thermal", {}, False),
    ("leg_thermal", {"tau": 0.0}, False), ("leg_thermal", {"tau": 60.0}, True)])
def test_slow_is_what_has_a_past_or_a_first_row(kind: str, constants: dict[str, float],
                                                slow: bool) -> None:
    made = Hypothesis(kind, (), True, ("v",), (0.0,), (1.0,), (0,), constants=constants,
                      effect=effect_kinds()[kind])
    assert whitening._slow(made) == slow
    assert not whitening._slow(Hypothesis("geometry", (), True, (), (), (), (), slot="x"))


@pytest.mark.parametrize("size", [2, 3])
def test_an_f_test_of_groups_is_fishers(size: int) -> None:
    """Of a fit with and without the columns, nu - k degrees of freedom left."""
    geometry, columns, residual = parts(3)
    found = test_of(geometry, columns, residual)
    group = [0, 1, 4][:size]
    square, rank = found.explained(np.array([group]))
    before, after = (rss(geometry, columns, residual, *c) for c in ((), group))
    ratio = (before - after) / size / (after / (N - 3 - size))
    assert float(log_p(square, found.square, rank, found.freedom)[0]) == pytest.approx(
        float(fisher.logsf(ratio, size, N - 3 - size)), rel=1e-7)
