"""Inner products that a search takes by what columns are made of, against plain ones."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import hidden
import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.added_variable_test import AddedVariableTest, build_test
from ppmcal.diagnosis.adequacy import _along, _kernel, low_rank
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.grids import start_values
from ppmcal.diagnosis.held_out_gap import DRAWS, _bootstrap
from ppmcal.diagnosis.hypotheses import Library
from ppmcal.diagnosis.library_columns import only_slots
from ppmcal.diagnosis.linear_system import System, Whitening, build, range_basis
from ppmcal.diagnosis.thinning import LEAST, MOST_VALUES, thinned
from ppmcal.diagnosis.wandering import _evidence
from ppmcal.diagnosis.white_columns import WhiteColumns
from ppmcal.diagnosis.whitening import _gains
from ppmcal.linalg import unit_columns
from ppmcal.model.effects import effect_kinds

Array = NDArray[np.float64]
SMALL = hidden.Options(poses=30)


@cache
def system_of(machine: str) -> tuple[System, Library]:
    made = hidden.hide(machine, 3, ["backlash"], 1.0, SMALL)
    problem = Problem(made.mechanism, (made.dataset,), made.mechanism.free)
    fit = identify(problem)
    system = build(problem, fit.state, fit.keep)
    return system, library(system)


@cache
def white(machine: str) -> tuple[System, Library, Whitening, WhiteColumns]:
    """Return columns under noise that is correlated within rows and from row to row."""
    system, found = system_of(machine)
    m = system.residual.shape[1]
    inner = np.linalg.inv(np.linalg.cholesky(np.eye(m) + 0.3 * np.ones((m, m))))
    noise = Whitening(inner[None], 0.4)
    basis = range_basis(noise.apply(system.jacobian, system))
    return system, found, noise, WhiteColumns.of(found.products, noise, system, basis)


def test_whitening_is_what_it_says_row_by_row() -> None:
    system, _, noise, _ = white("3-RPR")
    values = np.random.default_rng(1).normal(size=(*system.residual.shape, 3))
    rows = noise.inner[0] @ values
    wanted = rows.copy()
    for n, gap in enumerate(system.apart, start=1):
        tie = noise.rho**gap if gap else 0.0
        wanted[n] = (rows[n] - tie * rows[n - 1]) / np.sqrt(1.0 - tie**2)
    assert np.allclose(noise.apply(values, system), wanted.reshape(-1, 3), rtol=1e-12)


def test_a_transposed_whitening_has_the_same_inner_products() -> None:
    system, found, noise, _ = white("3-RPR")
    columns = found.some(range(0, found.count, 7))
    values = np.random.default_rng(2).normal(size=(system.residual.size, 4))
    wanted = noise.apply(columns, system).T @ values
    back = noise.transposed(values, system).reshape(system.residual.size, -1)
    assert np.allclose(columns.reshape(system.residual.size, -1).T @ back, wanted, rtol=1e-9,
                       atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("machine", ["3-RPR", "delta-linear"])
def test_products_are_those_of_the_columns(machine: str) -> None:
    system, found, noise, columns = white(machine)
    assert found.products.outer and found.products.sums and len(found.products.whole)
    values = np.random.default_rng(3).normal(size=(system.residual.size, 3))
    flat = noise.apply(found.columns, system)
    unit = flat / np.where(flat.any(axis=0), np.linalg.norm(flat, axis=0), 1.0)
    unit = unit - columns.basis @ (columns.basis.T @ unit)
    assert np.allclose(columns.some(range(len(columns))), unit.T, atol=1e-12)
    assert np.allclose(columns.along(values), unit.T @ values, atol=1e-10)
    some = [5, len(columns) - 1, 2]
    # once made, once kept
    assert np.allclose(columns.some(some), unit.T[some], atol=1e-12)
    assert np.array_equal(columns.some(some), columns.some(some))


def test_sums_and_events_are_what_they_are_made_of() -> None:
    system, found = system_of("3-RPR")
    events = [f for f in found.hypotheses if f.effect is not None and f.effect.onset]
    late = max(events, key=lambda f: next(iter(f.constants.values())))
    row = next(iter(late.constants.values()))
    column = found.some(late.columns)[..., 0]
    number = np.concatenate([p.response.rows.row for p in system.firsts])
    assert not column[number < row].any()
    assert column[number >= row].any()
    for at, members in found.products.sums.items():
        assert np.allclose(found.some([at])[..., 0], found.some(members).sum(axis=-1))


def test_columns_that_are_asked_twice_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two blocks share columns: an effect, and a form of it that has more beside."""
    _, found = system_of("3-RPR")
    total, members = next(iter(found.products.sums.items()))
    wanted = {t: found.some([t])[..., 0] for t in (total, members[0])}
    monkeypatch.setattr(np, "empty", lambda shape: np.full(shape, np.nan))
    asked = [total, members[0], total, members[0]]
    for t, column in zip(asked, np.moveaxis(found.some(asked), -1, 0), strict=True):
        assert np.array_equal(column, wanted[t])


@pytest.mark.parametrize("machine", ["3-RPR", "delta-linear"])
@pytest.mark.parametrize("name", list(effect_kinds()))
def test_a_kind_on_all_joints_is_the_sum_of_it_on_each(machine: str, name: str) -> None:
    """So that it need be evaluated once; in the terms of each slot, not only in their effect."""
    system, _ = system_of(machine)
    kind, setting = effect_kinds()[name], system.parts[0].setting
    motion = system.problem.mechanism.motion
    if not kind.per_actuator or motion not in kind.motions or kind.carried is not None:
        return
    values = start_values(kind, motion)
    for n, spec in enumerate(kind.parameters(motion)):
        if spec.scan is not None or values[spec.name] is None or not np.isfinite(values[spec.name]):
            values[spec.name] = 0.3 + 0.1 * n
    if kind.onset:
        values[kind.onset] = 4.0
    whole = kind.evaluate(setting, np.ones(setting.turning.size, dtype=bool), values)
    for a in range(setting.turning.size):
        one = kind.evaluate(setting, np.arange(setting.turning.size) == a, values)
        for n, shift in {"": one.shift, **one.by}.items():
            both = whole.by[n] if n else whole.shift
            if not only_slots(both):
                continue
            own = {s: v for s, v in both.slots.items() if setting.limbs[s[0]].actuator == a}
            assert own.keys() == shift.slots.keys()
            for slot, change in own.items():
                assert np.allclose(change, shift.slots[slot], rtol=1e-12, atol=0.0, equal_nan=True)


# --- tests that are asked more than once ----------------------------------------------------------


def test_what_was_asked_before_is_not_what_was_added_later() -> None:
    """Two columns that were added, each in its own test, have the same place."""
    rng = np.random.default_rng(4)
    basis = np.linalg.qr(rng.normal(size=(50, 4)))[0]
    test = build_test(basis, rng.normal(size=(50, 6)), rng.normal(size=50), 50)

    def gain(found: AddedVariableTest) -> Array:
        return np.concatenate([found.explained(np.array([[6], [1]]))[0],
                               found.given([6]).explained(np.array([[2, 3], [6, 4]]))[0]])

    one, two = (test.extended(rng.normal(size=(6, 1))) for _ in range(2))
    first = gain(one), gain(two)
    fresh = [replace(t, blocks={}, rows={}) for t in (one, two)]
    assert np.allclose(first[0], gain(fresh[0]), rtol=1e-12)
    assert np.allclose(first[1], gain(fresh[1]), rtol=1e-12)
    assert not np.allclose(first[0], first[1])


@pytest.mark.parametrize("same", [0.0, 1e-2, 1e-5, 1e-15])
def test_gains_are_those_of_least_squares(same: float) -> None:
    """Also of columns that are nearly, or quite, the same."""
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(20, 3, 6))
    columns[..., 4] = columns[..., 3] + same * columns[..., 4]
    residual = rng.normal(size=(20, 3))
    fake = SimpleNamespace(some=lambda which: columns[..., list(which)])
    groups = [(0,), (3,), (1, 2), (3, 4), (0, 3, 4, 5)]
    found = _gains(cast(Any, SimpleNamespace(residual=residual)), cast(Any, fake), groups)
    for group, gain in zip(groups, found, strict=True):
        unit = unit_columns(columns.reshape(60, -1)[:, list(group)])
        fitted = unit @ np.linalg.lstsq(unit, residual.ravel(), rcond=None)[0]
        assert gain == pytest.approx(fitted @ fitted, rel=1e-9)


def test_evidence_of_many_priors_is_that_of_each() -> None:
    """Against the determinant and the quadratic form of the whole covariance."""
    rng = np.random.default_rng(6)
    waves, residual = rng.normal(size=(40, 3)), rng.normal(size=40)
    size = rng.uniform(0.1, 5.0, (4, 3))
    square = float(residual @ residual)
    rest = cast(Any, SimpleNamespace(square=square, freedom=40))
    found = _evidence(waves.T @ waves, waves.T @ residual, size, rest)
    for value, own in zip(found, size, strict=True):
        covariance = np.eye(40) + (waves * own**2) @ waves.T
        left = residual @ np.linalg.solve(covariance, residual) / square
        assert value == pytest.approx(np.linalg.slogdet(covariance)[1] + 40 * np.log(left))


# --- what is left ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "inputs"), [(0.5, 1), (3.0, 2), (0.05, 6)])
def test_kernels_along_values_are_quadratic_forms(width: float, inputs: int) -> None:
    """Of a low rank or not, without the diagonal."""
    rng = np.random.default_rng(7)
    kernel = _kernel(rng.normal(size=(80, inputs)), (width, 2.0 * width))
    assert (low_rank(kernel, 40) is None) == (inputs == 6)
    values = rng.normal(size=(80, 3, 700))
    bare = kernel - np.diag(np.diagonal(kernel))
    wanted = np.einsum("nmb,nk,kmb->b", values, bare, values, optimize=True)
    assert np.allclose(_along([kernel], values)[0], wanted, atol=1e-8 * np.abs(wanted).max())


def test_a_low_rank_root_is_one() -> None:
    part = np.random.default_rng(8).normal(size=(30, 5))
    root = low_rank(part @ part.T, 10)
    assert root is not None and root.shape == (30, 5)
    assert np.allclose(root @ root.T, part @ part.T, atol=1e-10)
    assert low_rank(part @ part.T, 4) is None


@pytest.mark.parametrize("poses", [7, 900])
def test_a_bootstrap_is_drawn_poses_summed(poses: int) -> None:
    table = np.random.default_rng(9).random((3, poses))
    drawn = np.random.default_rng(11).integers(poses, size=(DRAWS, poses))
    assert np.allclose(_bootstrap(table, 11), table[:, drawn].sum(axis=-1), rtol=1e-12)


# --- rows of a search -----------------------------------------------------------------------------


def rows_of(count: int, load: Array | None = None, sessions: list[str] | None = None) -> Problem:
    """Return what thinning asks of a problem: rows with a load and in sessions, of six values."""
    data = SimpleNamespace(name="a", kind="pose", sessions=sessions, campaign="",
                           __len__=lambda: count)
    wrench = np.zeros((count, 6))
    wrench[:, 2] = 0.0 if load is None else load

    class Rows(SimpleNamespace):
        def __len__(self) -> int:
            return count

    return cast(Problem, SimpleNamespace(
        mechanism=SimpleNamespace(motion="spatial"), datasets=(Rows(**vars(data)),),
        environments=(SimpleNamespace(wrench=wrench),)))


def test_few_rows_are_all_used() -> None:
    keep = [np.arange(900) % 3 > 0]
    assert np.array_equal(thinned(rows_of(900), keep)[0], keep[0])


def test_many_rows_are_thinned_evenly_and_out_of_step() -> None:
    count, most = 3000, MOST_VALUES // 6
    keep = [np.arange(count) % 10 > 0]
    found = thinned(rows_of(count), keep)[0]
    assert found.sum() == most and not (found & ~keep[0]).any()
    assert np.array_equal(found, thinned(rows_of(count), keep)[0])
    # time: each tenth of the rows has its share
    share = np.array([part.sum() for part in np.split(found, 10)])
    assert np.all(np.abs(share - most / 10) <= 2)
    # directions that alternate, whatever the step
    for period in (2, 3, 4, 6):
        taken = np.bincount(np.flatnonzero(found) % period, minlength=period)
        assert taken.min() > 0.6 * most / period


def test_a_short_session_and_a_rare_load_stay() -> None:
    count, most = 10_000, MOST_VALUES // 6
    load = np.where(np.arange(count) % 200 == 7, -300.0, 0.0)
    sessions = ["first"] * 9900 + ["second"] * 100
    found = thinned(rows_of(count, load, sessions), [np.ones(count, dtype=bool)])[0]
    assert most - 4 <= found.sum() <= most
    assert found[load < 0.0].sum() >= 45
    assert found[9900:].sum() >= LEAST - 5
