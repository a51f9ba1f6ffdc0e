"""How effects are chosen from a library, on columns small enough to try every set of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, norm
from scipy.stats import t as student

from ppmcal.diagnosis import verdict as verdicts
from ppmcal.diagnosis.added_variable_test import DRAWS, build_test, seen_noise
from ppmcal.diagnosis.extended_model import Added
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.refit import APART, _against_zero, _none_of_machines, key_of
from ppmcal.diagnosis.rivals import Rival, find, held, merged, odds_between, rivals
from ppmcal.diagnosis.search import Search
from ppmcal.diagnosis.selection import (
    _apart,
    _once,
    _twice,
    bic,
    borne,
    choose,
    doubtful,
    own_log_p,
    possible,
    pruned,
    stand,
)
from ppmcal.diagnosis.verdict import findings
from ppmcal.model.effects import EffectParameter, effect_kinds

Array = NDArray[np.float64]


def hypothesis(columns: Sequence[int], kind: str = "", **traits: Any) -> Hypothesis:
    """Return a hypothesis of its own family, with any coefficients."""
    n = len(columns)
    found = Hypothesis(kind or f"kind{columns[0]}", (), True, tuple(f"c{i}" for i in range(n)),
                       (-np.inf,) * n, (np.inf,) * n, tuple(columns))
    return replace(found, **traits)


def case(true: dict[int, float], seed: int = 0, n: int = 80, count: int = 6,
         **first: Any) -> tuple[Search, Array, Array, Array]:
    """Return a search of columns of which some are in the data, and J, columns and residual."""
    rng = np.random.default_rng(seed)
    jacobian, columns = rng.normal(size=(n, 4)), rng.normal(size=(n, count))
    residual = rng.normal(size=n) + sum((columns[:, c] * v for c, v in true.items()), np.zeros(n))
    test = build_test(np.linalg.qr(jacobian)[0], columns, residual, n)
    hypotheses = tuple(hypothesis([c], **(first if c == 0 else {})) for c in range(count))
    return Search(test, hypotheses, np.log(1e-3), np.log(1e-4), np.zeros(1)), (
        jacobian), columns, residual


def left_of(jacobian: Array, columns: Array, residual: Array, chosen: Sequence[int]) -> float:
    """Return the sum of squares that a fit of geometry and some columns leaves."""
    whole = np.concatenate([jacobian, columns[:, list(chosen)]], axis=1)
    return float(np.sum((residual - whole @ np.linalg.lstsq(whole, residual, rcond=None)[0]) ** 2))


# --- BIC ------------------------------------------------------------------------------------------

@pytest.mark.parametrize("chosen", [(0,), (1, 4), (0, 2, 5)])
def test_bic_is_that_of_the_fit_and_pays_for_the_search(chosen: tuple[int, ...]) -> None:
    """n log(RSS/n) + k log n + 2 log of how many sets of so many families there are."""
    search, *parts = case({0: 1.0, 4: -0.7}, 3)
    n, sets = 76, len(list(combinations(range(6), len(chosen))))
    wanted = n * np.log(left_of(*parts, chosen) / n) + len(chosen) * np.log(n) + 2.0 * np.log(sets)
    assert bic(search, chosen) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize(("traits", "more"), [
    ({"searched": 2}, 2.0 * np.log(76)), ({"anonymous": True}, 6.0), ({"choices": 1.5}, 3.0),
    ({"effect": replace(effect_kinds()["gain"], seldom=4.0)}, 4.0)])
def test_what_bic_is_raised_by(traits: dict[str, Any], more: float) -> None:
    """Constants of a grid count as parameters, a choice of actuators as one more search."""
    plain, made = case({}, 4)[0], case({}, 4, **traits)[0]
    assert bic(made, (0, 3)) - bic(plain, (0, 3)) == pytest.approx(more, abs=1e-9)
    assert bic(made, (1, 3)) == pytest.approx(bic(plain, (1, 3)), abs=1e-9)


# --- choosing -------------------------------------------------------------------------------------

@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("true", [{}, {2: 1.2}, {1: 1.0, 5: -1.3}, {0: 0.9, 3: 1.1, 4: 1.4}])
def test_what_is_chosen_is_the_best_set_that_stands(true: dict[int, float], seed: int) -> None:
    """Against every set of columns: nothing but what reaches the threshold, and the least BIC."""
    search, *_ = case(true, 10 + seed)
    sets = [s for k in range(1, 5) for s in combinations(range(6), k) if stand(search, s)]
    found = choose(search)
    if not sets:
        assert not found
        return
    assert [c.bic for c in found] == sorted(c.bic for c in found)
    assert tuple(sorted(found[0].chosen)) == min(sets, key=lambda s: bic(search, s))
    assert found[0].bic == pytest.approx(bic(search, found[0].chosen), rel=1e-12)


def test_a_p_value_of_one_given_the_others_is_that_of_the_f_test() -> None:
    search, *parts = case({1: 0.6, 3: 0.8}, 21)
    less, all_ = left_of(*parts, (1, 3)), left_of(*parts, (1, 3, 4))
    value = own_log_p(search, (1, 3, 4), 4)
    t = np.sqrt((less - all_) / (all_ / (80 - 4 - 3)))
    assert value == pytest.approx(np.log(2.0 * student.sf(t, 73)), rel=1e-9)


def test_caution_divides_the_evidence() -> None:
    plain, made = case({0: 1.0}, 5)[0], case({0: 1.0}, 5, caution=2.5)[0]
    assert own_log_p(made, (0,), 0) == pytest.approx(own_log_p(plain, (0,), 0) / 2.5)
    assert made.values()[0] == pytest.approx(plain.values()[0] / 2.5)
    np.testing.assert_allclose(made.values()[1:], plain.values()[1:])


def test_what_others_explain_is_dropped_and_one_is_always_left() -> None:
    search, *_ = case({1: 1.5, 3: -1.5}, 6)
    assert pruned(search, [0, 1, 2, 3], search.name) == [1, 3]
    assert pruned(search, [0], search.name) == [0]


@pytest.mark.parametrize(("caution", "found"), [(1.0, True), (2.0, True), (50.0, False)])
def test_an_event_is_found_with_the_one_that_undoes_it(caution: float, found: bool) -> None:
    """A step and its end, of which each alone is hidden by the other: both or none."""
    n = 200
    rng = np.random.default_rng(7)
    at = [20, 90, 110, 170]
    columns = np.stack([(np.arange(n) >= a).astype(float) for a in at], axis=1)
    residual = 4.0 * (columns[:, 1] - columns[:, 2]) + rng.normal(size=n)
    test = build_test(np.linalg.qr(np.ones((n, 1)))[0], columns, residual, n)
    kind = effect_kinds()["zero_shift"]
    events = tuple(hypothesis([c], kind.name, effect=kind, on=("leg1",), caution=caution)
                   for c in range(4))
    search = Search(test, events, -7.0, -9.0, np.zeros(1))
    assert search.values().min() > -9.0        # none stands alone
    assert [set(c.chosen) for c in choose(search)][:1] == [{1, 2}] * found


# --- what is physical -----------------------------------------------------------------------------

@pytest.mark.parametrize(("traits", "fine"), [
    ({"low": (0.0,)}, True), ({"high": (0.0,)}, False), ({"high": (0.5,)}, False),
    ({"low": (2.0,)}, False), ({"usual": ((0.5, 2.0),)}, True), ({"usual": ((2.0, 3.0),)}, False),
    ({"named": ((-1.0, 0.0),)}, False), ({"named": ((0.0, 3.0),)}, True)])
def test_coefficients_out_of_range_are_not_possible(traits: dict[str, Any], fine: bool) -> None:
    search, *_ = case({0: 1.2}, 8, n=4000, **traits)
    assert possible(search, [0]) == fine
    assert possible(search, [0], usual=False) == (fine or "usual" in traits)
    assert possible(search, [0], named=False) == (fine or "named" in traits)
    assert possible(search, [1, 2])


def wave(on: str, turns: float) -> Hypothesis:
    return hypothesis([0], on=(on,), turns=turns)


@pytest.mark.parametrize(("waves", "fine"), [
    ([("a", 3.0), ("a", 5.0)], True), ([("a", 3.0), ("a", 3.9)], False),
    ([("a", 3.0), ("a", 4.0)], True), ([("a", 3.0), ("b", 3.1)], True),
    ([("a", 3.0), ("a", 5.0), ("a", 9.0)], False),
    ([("a", 3.0), ("a", 5.0), ("b", 9.0)], True), ([], True)])
def test_a_joint_has_two_periods_at_most_and_no_two_that_are_one(
        waves: list[tuple[str, float]], fine: bool) -> None:
    assert _apart([wave(*w) for w in waves]) == fine
    assert _apart([wave(*w) for w in reversed(waves)]) == fine


def of_kind(kind: str, on: Sequence[str] = (), **constants: float) -> Hypothesis:
    return hypothesis([0], kind, on=tuple(on), effect=effect_kinds()[kind], constants=constants)


@pytest.mark.parametrize(("two", "once", "twice"), [
    ((of_kind("play", "a", width=1e-4), of_kind("play", "a", width=3e-4)), False, False),
    ((of_kind("play", "a", width=1e-4), of_kind("play", "b", width=3e-4)), True, False),
    ((of_kind("play", width=1e-4), of_kind("play", width=3e-4)), False, False),
    ((of_kind("gain", "a"), of_kind("gain", "a")), True, False),
    ((of_kind("periodic", "a", period=0.1), of_kind("periodic", "a", period=0.3)), True, False),
    ((of_kind("compliance", "a"), of_kind("compliance", "a", hardening=0.1)), True, True),
    ((of_kind("compliance", "a"), of_kind("compliance", "b", hardening=0.1)), True, False),
    ((of_kind("compliance", "a"), of_kind("compliance", "a")), True, False)])
def test_one_cause_is_there_once(two: tuple[Hypothesis, Hypothesis], once: bool, twice: bool
                                 ) -> None:
    """Of a grid no two steps on a joint; of a kind that may be plain no two forms."""
    assert _once(two) == once
    assert _once(two[::-1]) == once
    assert _twice(two) == twice
    assert _twice(two[::-1]) == twice


def test_waves_and_events_beside_two_of_a_grid_hide_nothing() -> None:
    one, other = of_kind("play", "a", width=1e-4), of_kind("play", "a", width=3e-4)
    for beside in (hypothesis([0]), of_kind("zero_shift", "a", from_row=3.0), of_kind("gain", "a"),
                   of_kind("periodic", "a", period=0.1)):
        assert not _once([beside, one, other])
        assert not _once([one, beside, other])
        assert _once([beside, one, beside])


def test_what_leans_on_another_is_not_there_without_it() -> None:
    search, *_ = case({}, 9)
    soft = replace(search.hypotheses[1], kind="compliance", on=("leg1",))
    arm = replace(search.hypotheses[2], leans=("compliance", ("leg1",)))
    made = replace(search, hypotheses=(search.hypotheses[0], soft, arm))
    assert borne(made, [0, 2]) == [0]
    assert borne(made, [0, 1, 2]) == [0, 1, 2]
    assert not possible(made, [0, 2])
    assert possible(made, [1, 2])


def test_what_geometry_nearly_swallows_is_doubtful() -> None:
    rng = np.random.default_rng(10)
    jacobian = rng.normal(size=(100, 4))
    columns = np.stack([jacobian[:, 0] + 0.1 * rng.normal(size=100), rng.normal(size=100)], axis=1)
    test = build_test(np.linalg.qr(jacobian)[0], columns, rng.normal(size=100), 100)
    search = Search(test, (hypothesis([0]), hypothesis([1])), -7.0, -9.0, np.zeros(1))
    assert [doubtful(search, [0, 1], i) for i in (0, 1)] == [True, False]


@pytest.mark.parametrize(("true", "wanted"), [
    ({0: 2.0, 1: 2.0, 2: 2.0, 3: 2.0}, False), ({0: 2.0, 1: 2.0, 2: 2.0}, False),
    ({0: 2.0, 1: 2.0}, True)])
def test_values_for_each_joint_have_to_stand_out_one_by_one(true: dict[int, float], wanted: bool
                                                            ) -> None:
    """Three of four: fewer only make up a shape."""
    search, *_ = case(true, 12, n=200)
    each = hypothesis(range(4), shared=False, on=tuple("abcd"))
    assert doubtful(replace(search, hypotheses=(each,)), [0], 0) == wanted


def test_noise_is_seen_as_the_residual_is_in_blocks_of_any_size() -> None:
    rng = np.random.default_rng(13)
    basis, columns = np.linalg.qr(rng.normal(size=(30, 3)))[0], rng.normal(size=(30, 5))
    noise = rng.normal(size=(30, DRAWS + 7))
    test = build_test(basis, columns, noise[:, 0], 30)
    seen = [(r.copy(), s) for r, s in seen_noise(test.first, basis, noise)]
    right, square = (np.concatenate(parts, axis=-1) for parts in zip(*seen, strict=True))
    for b in (0, DRAWS - 1, DRAWS, DRAWS + 6):
        one = build_test(basis, columns, noise[:, b], 30)
        np.testing.assert_allclose(right[:, b], one.right, atol=1e-12)
        assert square[b] == pytest.approx(one.square, rel=1e-12)
    assert right.shape[1] == noise.shape[1]


# --- sizes and ranges after the fit ---------------------------------------------------------------

def fit_of(values: Sequence[float], count: int = 40, square: float = 20.0,
           reciprocal: bool = False) -> Any:
    """Return as much of a fit as its sizes ask for."""
    parameters = tuple(SimpleNamespace(nonlinear=False, size=1.0, reciprocal=reciprocal)
                       for _ in values)
    names = tuple(f"kind.leg{i + 1}.period" for i in range(len(values)))
    mechanism = SimpleNamespace(parameters=parameters, names=names, effects=(), motion="planar")
    return SimpleNamespace(
        problem=SimpleNamespace(mechanism=mechanism, free=tuple(range(len(values)))),
        state=SimpleNamespace(g=np.array(values)), scale=np.ones(len(values)),
        prior=np.zeros(len(values)), reduced=SimpleNamespace(
            square=square, count=count, triangle=np.eye(len(values))))


def test_the_size_of_an_effect_against_zero_is_a_chi_squared() -> None:
    fit = fit_of([3.0, -1.0])
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    value = np.array([3.0, -1.0])
    square = value @ np.linalg.inv(covariance) @ value
    assert _against_zero(fit, covariance, [0, 1]) == pytest.approx(chi2.logsf(square, 2), rel=1e-9)
    one = 2.0 * norm.sf(3.0 / np.sqrt(2.0))
    assert _against_zero(fit, covariance, [0]) == pytest.approx(np.log(one), rel=1e-9)
    # noise that is four times the stated one: half as many sigmas
    noisy = fit_of([3.0, -1.0], count=42, square=160.0)
    assert _against_zero(noisy, covariance, [0, 1]) == pytest.approx(chi2.logsf(square / 4.0, 2),
                                                                     rel=1e-9)
    for count in (1, 2, 3):     # as many values as parameters, or one more
        few = fit_of([3.0, -1.0], count=count, square=4.0)
        assert _against_zero(few, covariance, [0, 1]) == pytest.approx(
            chi2.logsf(square / 4.0, 2), rel=1e-9)
    assert _against_zero(fit, np.full((2, 2), np.inf), [0, 1]) == 0.0


def test_a_stiffness_is_known_as_its_compliance_is() -> None:
    """1/k = 0.5 +- 0.1, whatever that makes of k."""
    fit = fit_of([2.0], reciprocal=True)
    found = _against_zero(fit, np.array([[(0.1 * 2.0**2) ** 2]]), [0])
    assert found == pytest.approx(np.log(2.0 * norm.sf(5.0)), rel=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1000.0])
@pytest.mark.parametrize(("values", "fine"), [
    ([0.30, 0.305], True), ([0.30, 0.35], False), ([0.30], True), ([0.30, 0.30, 0.36], False),
    ([0.30, 0.345], True), ([0.30, 0.348], False),
    ([0.30, 0.27, 0.32], True), ([0.05, 0.05], False), ([0.95, 0.95], False)])
def test_joints_made_alike_have_one_period_which_machines_have(values: list[float], fine: bool,
                                                               unit: float) -> None:
    """0.1 to 0.9 of a unit, each known to 0.01: together they scatter as chi-squared says."""
    fit = fit_of([unit * v for v in values])
    sigma = 0.01 if len(values) < 3 or not fine else 0.03
    own = hypothesis([0], "kind", names=("period",))
    found: Any = SimpleNamespace(
        added=tuple(Added(own, (f"leg{i + 1}",), (f"kind.leg{i + 1}.period",))
                    for i in range(len(values))),
        last=SimpleNamespace(system=SimpleNamespace(stroke=2.0)))
    spec = EffectParameter("period", "joint", None, usual=(0.1 * unit, 0.9 * unit),
                           scan=lambda data: [0.3])
    told = _none_of_machines(fit, (unit * sigma) ** 2 * np.eye(len(values)), found, key_of(own),
                             spec)
    assert told == (-np.inf if fine else 0.0)
    if len(values) > 1 and min(values) >= 0.1 and max(values) <= 0.9:
        apart = np.var(values) * len(values) / sigma**2
        assert (chi2.sf(apart, len(values) - 1) < APART) == (not fine)


# --- what the user must look at -------------------------------------------------------------------

def fit_with(reasons: dict[int, str], converged: bool = True) -> Any:
    class Data(list[int]):
        name, findings = "run1", ()

    return SimpleNamespace(problem=SimpleNamespace(datasets=(Data(range(50)),)),
                           reasons=(reasons,), converged=converged, iterations=60)


def said(before: Any, after: Any, **left: Any) -> list[str]:
    own: Any = SimpleNamespace(**({"excess": 0.0, "ratio": 1.0, "source": "stated"} | left))
    return findings(before, after, own, (), None, SimpleNamespace(sentence=""), ())  # type: ignore[arg-type]


def test_nothing_is_said_of_a_fit_that_is_as_it_should_be() -> None:
    assert said(fit_with({}), fit_with({})) == []


def test_rows_out_rows_back_and_a_fit_that_stopped_are_said() -> None:
    out, back = {3: "outlier", 4: "outlier"}, {3: "outlier"}
    assert [s for s in said(fit_with(out), fit_with(out)) if "back in use" in s] == []
    assert "2 of 50 rows left out" in said(fit_with(out), fit_with(out))[0]
    words = said(fit_with(out), fit_with(back))
    assert "1 of 50 rows left out" in words[0]
    assert "1 row at first taken for outliers" in words[1]
    assert "not converged after 60" in said(fit_with({}), fit_with({}, converged=False))[-1]


@pytest.mark.parametrize(("left", "words"), [
    ({"excess": 3.5, "ratio": 1.4}, "1.40 times the stated noise"),
    ({"ratio": 0.01}, "only 0.01 times the stated noise")])
def test_residuals_above_or_far_below_the_noise_are_said(left: dict[str, float], words: str
                                                         ) -> None:
    assert words in " ".join(said(fit_with({}), fit_with({}), **left))


# --- rivals ---------------------------------------------------------------------------------------

def alike(cosine: float, seed: int = 30, n: int = 120) -> Search:
    """Return a search of two columns at an angle, the first of which made the residual."""
    rng = np.random.default_rng(seed)
    q = np.linalg.qr(rng.normal(size=(n, 7)))[0]
    first = q[:, 4]
    columns = np.stack([first, cosine * first + np.sqrt(1.0 - cosine**2) * q[:, 5], q[:, 6]],
                       axis=1)
    residual = 25.0 * first + rng.normal(size=n)
    test = build_test(q[:, :4], columns, residual, n)
    return Search(test, tuple(hypothesis([c]) for c in range(3)), -7.0, -9.0, np.zeros(1))


@pytest.mark.parametrize(("cosine", "told"), [(0.9999, False), (-0.9999, False), (0.7, True),
                                              (0.0, True)])
def test_what_explains_as_much_is_a_rival(cosine: float, told: bool) -> None:
    found = rivals(alike(cosine), (0,), 0)
    assert not found if told else [r.hypothesis.kind for r in found] == ["kind1"]
    for rival in found:
        assert rival.angle == pytest.approx(np.arccos(abs(cosine)), rel=1e-6)
        search = alike(cosine)
        assert rival.odds == pytest.approx(
            np.exp((bic(search, (1,)) - bic(search, (0,))) / 2.0), rel=1e-9)


def test_odds_are_those_of_bic() -> None:
    assert odds_between(10.0, 14.0) == pytest.approx(np.exp(2.0))
    assert odds_between(14.0, 10.0) == pytest.approx(np.exp(-2.0))


def test_what_was_chosen_before_stays_unless_another_is_better() -> None:
    """Else two that look alike would take turns for ever."""
    search = alike(0.9999)
    first, second, third = search.hypotheses
    assert held(search, (1,), [first])[1] == (0,)
    assert held(search, (0,), [second])[1] in ((0,), (1,))
    close = bic(search, (1,)) <= bic(search, (0,)) + 2.0
    assert (held(search, (0,), [second])[1] == (1,)) == close
    assert held(search, (0,), [third])[1] == (0,)           # does not stand
    assert held(search, (0,), [])[1] == (0,)
    assert held(search, (), [first])[1] == (0,)
    assert held(search, (0,), [hypothesis([0], "unheard of")])[1] == (0,)


def of_joints(values: dict[str, float], n: int = 150, seed: int = 31) -> Search:
    """Return a search of one kind, alone on each of four joints, with values in the data."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(n, 4))
    residual = rng.normal(size=n) + sum(
        (columns[:, "abcd".index(j)] * v for j, v in values.items()), np.zeros(n))
    test = build_test(np.linalg.qr(rng.normal(size=(n, 3)))[0], columns, residual, n)
    single = tuple(hypothesis([c], "gain", on=(joint,)) for c, joint in enumerate("abcd"))
    return Search(test, single, -5.0, -7.0, np.zeros(1))


@pytest.mark.parametrize(("values", "on", "size"), [
    ({"a": 1.0, "b": 1.0, "c": 1.0, "d": 1.0}, "abcd", 1), ({"b": 1.2}, "b", 1),
    ({"a": 1.0, "d": 1.0}, "ad", 1)])
def test_one_value_where_joints_are_alike(values: dict[str, float], on: str, size: int) -> None:
    search = of_joints(values)
    chosen = tuple("abcd".index(j) for j in values)
    made, found = merged(search, chosen)
    assert [made.hypotheses[i].on for i in found] == [tuple(on)]
    assert made.hypotheses[found[0]].size == size
    assert made.hypotheses[found[0]].shared
    assert bic(made, found) <= bic(made, chosen)


def test_values_of_their_own_where_joints_are_not_alike() -> None:
    search = of_joints({"a": 3.0, "b": -2.0})
    made, found = merged(search, (0, 1))
    assert {made.hypotheses[i].on for i in found} == {("a",), ("b",)}


def test_a_hypothesis_is_found_again_in_another_search() -> None:
    """As it was, or made of those of single joints; of another kind it is not."""
    search = of_joints({"a": 1.0})
    assert find(search, search.hypotheses[2]) == (search, 2)
    for shared in (True, False):
        wanted = hypothesis([0, 1] if not shared else [0], "gain", on=("a", "c"), shared=shared)
        made, at = find(search, wanted)
        assert at is not None
        assert (made.hypotheses[at].on, made.hypotheses[at].shared) == (("a", "c"), shared)
        assert made.hypotheses[at].size == (1 if shared else 2)
    assert find(search, hypothesis([0], "gain", on=("a", "x"), shared=False))[1] is None
    assert find(search, hypothesis([0], "other", on=("a",)))[1] is None


@pytest.mark.parametrize(("verdict", "asked"), [("named-set", True), ("unnamed", False)])
def test_rivals_are_told_apart_by_the_next_experiment(monkeypatch: pytest.MonkeyPatch, verdict: str,
                                                      asked: bool) -> None:
    """The likeliest of them; not where nothing is named."""
    search = alike(0.9)
    monkeypatch.setattr(verdicts, "propose", lambda *known: known)
    monkeypatch.setattr(verdicts, "measured_against", lambda stage: iter(()))
    joints = SimpleNamespace(mechanism=SimpleNamespace(actuators=("a", "b")))
    stage: Any = SimpleNamespace(hypotheses=search.hypotheses,
                                 system=SimpleNamespace(problem=joints))
    others = [Rival(search.hypotheses[2], 0.1, 50.0), Rival(search.hypotheses[1], 0.1, 3.0)]
    found: Any = verdicts.next_step(stage, {0: (others, [])}, verdict, 7)
    if asked:
        assert found == (stage, search.hypotheses[0], search.hypotheses[1], 3.0, 7)
    else:
        assert "record more" in found.reason


@pytest.mark.parametrize(("verdict", "words"), [
    ("none", "nothing more to measure: no missing"), ("weak", "repeat the campaign"),
    ("named", "nothing more to measure: the named"), ("partial", "record more of what")])
def test_the_next_step_of_each_verdict(verdict: str, words: str) -> None:
    joints = SimpleNamespace(mechanism=SimpleNamespace(actuators=("a", "b")))
    stage: Any = SimpleNamespace(hypotheses=(), system=SimpleNamespace(problem=joints))
    assert verdicts.next_step(stage, {}, verdict, 7).reason.startswith(words)
