"""Inner products of a library by what columns are made of, against plain ones."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import cast

import hidden
import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.grids import start_values
from ppmcal.diagnosis.held_out_gap import DRAWS, _bootstrap
from ppmcal.diagnosis.hypotheses import Library
from ppmcal.diagnosis.library_columns import only_slots
from ppmcal.diagnosis.linear_system import System, build
from ppmcal.diagnosis.thinning import LEAST, MOST_VALUES, thinned
from ppmcal.model.effects import effect_kinds
from ppmcal.model.instruments import POSE
from ppmcal.model.motions import SPATIAL

Array = NDArray[np.float64]
SMALL = hidden.Options(poses=30)


@cache
def system_of(machine: str) -> tuple[System, Library]:
    made = hidden.hide(machine, 3, ["backlash"], 1.0, SMALL)
    problem = Problem(made.mechanism, (made.dataset,), made.mechanism.free)
    fit = identify(problem)
    system = build(problem, fit.state, fit.keep)
    return system, library(system)


@pytest.mark.parametrize("machine", ["3-RPR", "delta-linear"])
@pytest.mark.slow_cases("delta-linear")
def test_products_are_those_of_the_columns(machine: str) -> None:
    system, found = system_of(machine)
    products = found.products
    assert products.outer and products.sums and len(products.whole)
    values = np.random.default_rng(3).normal(size=(*system.residual.shape, 3))
    flat, wanted = found.columns.reshape(system.residual.size, -1), values.reshape(-1, 3)
    assert np.allclose(products.along(values), flat.T @ wanted, rtol=1e-9,
                       atol=1e-9 * np.abs(flat).max())


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


@pytest.mark.slow_cases("rope_stretch-delta-linear")
@pytest.mark.parametrize("machine", ["3-RPR", "delta-linear"])
@pytest.mark.parametrize("name", list(effect_kinds()))
def test_a_kind_on_all_joints_is_the_sum_of_it_on_each(machine: str, name: str) -> None:
    """So that it need be evaluated once; in the terms of each slot, not only in their effect."""
    system, _ = system_of(machine)
    kind, setting = effect_kinds()[name], system.parts[0].setting
    motion = system.problem.mechanism.motion
    if not kind.per_actuator or not kind.exists_in(motion) or kind.carried is not None or (
            kind.opposed):      # who pulls is one thing
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


# --- what is left ---------------------------------------------------------------------------------


@pytest.mark.parametrize("poses", [7, 900])
def test_a_bootstrap_is_drawn_poses_summed(poses: int) -> None:
    table = np.random.default_rng(9).random((3, poses))
    drawn = np.random.default_rng(11).integers(poses, size=(DRAWS, poses))
    assert np.allclose(_bootstrap(table, 11), table[:, drawn].sum(axis=-1), rtol=1e-12)


# --- rows of a search -----------------------------------------------------------------------------


def rows_of(count: int, load: Array | None = None, sessions: list[str] | None = None) -> Problem:
    """Return what thinning asks of a problem: rows with a load and in sessions, of six values."""
    data = SimpleNamespace(name="a", kind=POSE, sessions=sessions, campaign="", body="",
                           to_q=None, __len__=lambda: count)
    wrench = np.zeros((count, 6))
    wrench[:, 2] = 0.0 if load is None else load

    class Rows(SimpleNamespace):
        def __len__(self) -> int:
            return count

    return cast(Problem, SimpleNamespace(
        mechanism=SimpleNamespace(motion=SPATIAL, surplus=0), datasets=(Rows(**vars(data)),),
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
