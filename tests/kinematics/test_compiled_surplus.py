"""Closure by least squares, compiled, against NumPy's: where it ends, and what has no such form."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.diagnoses import CONFIGS
from helpers.redundant import belts, cables, gapped, machine, rope_cage, stewart

from ppmcal.io import read_mechanism
from ppmcal.kinematics import compiled_limbs
from ppmcal.kinematics import forward as forward_module
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import settle
from ppmcal.kinematics.forward import (
    Minima,
    forward,
    least_of_minima,
    moved,
    newton,
    smallest_singular_value,
)
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.kinematics.limb_sets import exact_sets
from ppmcal.kinematics.tables import forward_table
from ppmcal.model.dataset import unknown_environment

# on a new machine each of these compiles for seconds
pytestmark = pytest.mark.slow
COUNT = 37
"""Rows: fewer than go the compiled way, unless they are told to."""


def cranks():
    """Return the file of a platform on seven cranks with rods."""
    tree = yaml.safe_load((CONFIGS / "6-RUS.yaml").read_text(encoding="utf-8"))
    last = tree["limbs"][-1] | {"name": "leg7", "base": {
        "point": [60, 40, 10], "axis": [0, 1, 0], "zero": [1, 0, 0]},
        "platform": {"point": [-30, 60, 0]}}
    tree["limbs"].append(last)
    tree.pop("limits", None)
    return tree


def over_pulleys(name):
    """Return the file of a machine on ropes over pulleys."""
    tree = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    tree.pop("limits", None)
    return tree


@pytest.fixture(scope="module", params=[
    cables, stewart, rope_cage, belts, cranks, lambda: gapped(stewart()),
    lambda: gapped(cranks(), (0.3, 0.0)), lambda: over_pulleys("cable-4-pulleys"),
    lambda: over_pulleys("cable-8-pulleys")], ids=[
        "cables", "stewart", "cage", "belts", "cranks", "stewart that gaps", "cranks, some gap",
        "pulleys in the plane", "pulleys"])
def rows(request, tmp_path_factory):
    """A model off its nominal values, joint values that contradict each other, and poses."""
    mechanism = machine(tmp_path_factory.mktemp("m"), request.param())
    rng = np.random.default_rng(4)
    step = np.zeros((COUNT, 6))
    step[:, mechanism.dof] = rng.uniform(-1.0, 1.0, (COUNT, len(mechanism.dof)))
    there = moved(np.tile(mechanism.home, (COUNT, 1)),
                  step * np.repeat([0.06 * mechanism.reach, 0.1], 3))
    q = inverse(Model(mechanism), there).q
    q += 1e-4 * mechanism.reach * rng.normal(size=q.shape) / mechanism.joint_ratios
    assert np.isfinite(q).all()
    return Model(mechanism), q, there


def both(monkeypatch, work):
    """Return what some work gives by NumPy, and compiled."""
    plain = work()
    monkeypatch.setattr(compiled_limbs, "MANY", 1)
    return plain, work()


@pytest.mark.long_cases("cables")
def test_newton_ends_at_the_same_least_squares(rows, monkeypatch):
    model, q, there = rows
    (slow, sure, _), (fast, found, _) = both(monkeypatch, lambda: newton(model.closure(q), there))
    assert sure.all()
    assert found.all()
    np.testing.assert_allclose(fast, slow, atol=1e-10)
    assert compiled_limbs.compiled_limbs(model.closure(q), COUNT) is not None


@pytest.mark.long_cases("cables")
def test_rows_from_home_come_to_the_same_poses(rows, monkeypatch):
    model, q, _ = rows
    plain, fast = both(monkeypatch, lambda: forward(model, q))
    np.testing.assert_array_equal(fast.converged, plain.converged)
    np.testing.assert_allclose(fast.pose, plain.pose, atol=1e-10)


@pytest.mark.long_cases("cables")
def test_rows_in_another_minimum_are_found_alike(rows, monkeypatch):
    model, q, there = rows
    off = there.copy()
    off[::5] = np.nan
    plain, fast = both(monkeypatch, lambda: least_of_minima(model, q, off))
    np.testing.assert_allclose(fast, plain, atol=1e-10)


@pytest.mark.long_cases("cables")
def test_minima_that_are_remembered_are_those_that_home_leads_to(rows):
    """Of a machine a little farther on in its fit: from near, or from home."""
    model, q, there = rows
    off, minima = there.copy(), Minima()
    off[::5] = np.nan
    first = least_of_minima(model, q, off, minima=minima)
    np.testing.assert_array_equal(first, least_of_minima(model, q, off))
    assert minima.known
    later = replace(model, g=model.parameters * (1.0 + 1e-6))
    np.testing.assert_allclose(least_of_minima(later, q, off, minima=minima),
                               least_of_minima(later, q, off), atol=1e-8)


def test_gaps_are_those_of_the_closure(rows, monkeypatch):
    model, q, there = rows
    monkeypatch.setattr(compiled_limbs, "MANY", 1)
    closure = model.closure(q)
    np.testing.assert_allclose(
        compiled_limbs.compiled_limbs(closure, COUNT).gap_squares(there),
        np.sum(closure.lengths(there) ** 2, axis=1), rtol=1e-9, atol=1e-20)


def test_joints_that_are_nowhere_near_are_given_up_by_both(rows, monkeypatch):
    model, q, there = rows
    wild = q + 30.0 * model.mechanism.reach * (np.arange(COUNT) % 2)[:, None]
    plain, fast = both(monkeypatch, lambda: newton(model.closure(wild), there, most=0.25))
    np.testing.assert_array_equal(fast[1], plain[1])
    assert not fast[1][1::2].all()      # a crank goes round
    assert fast[1].any()


def test_columns_of_surplus_limbs_go_another_way(rows, monkeypatch):
    """Their A has no inverse: what columns are made of is there, -A^-1 is not."""
    model, q, there = rows
    monkeypatch.setattr(compiled_limbs, "MANY", 1)
    free = model.mechanism.free
    tables = compiled_limbs.compiled_limbs(model.closure(q, free), COUNT)
    place = {p: c for c, p in enumerate(free)}
    out = np.zeros((COUNT, 6, len(free)))
    assert not tables.error_columns(there, np.eye(6)[None], place, out)
    assert not out.any()


def test_limbs_that_share_a_drive_have_no_compiled_form(tmp_path, monkeypatch):
    """Their errors are one: S is not diagonal."""
    tree = stewart(8)
    tree["limbs"][7]["actuator"] = "leg7"
    mechanism = machine(tmp_path, tree)
    monkeypatch.setattr(compiled_limbs, "MANY", 1)
    q = np.tile(mechanism.home_q, (COUNT, 1))
    assert compiled_limbs.compiled_limbs(Model(mechanism).closure(q), COUNT) is None


def test_a_row_that_no_way_leads_to_is_led_by_each_set_of_limbs_once(tmp_path, monkeypatch):
    mechanism = machine(tmp_path, cables())
    model, by_part, led = Model(mechanism), forward_module._by_part, []

    def counted(model, some, q, *more):
        led.extend((some, *row) for row in q)
        return by_part(model, some, q, *more)

    monkeypatch.setattr(forward_module, "_by_part", counted)
    q = np.tile(home_state(mechanism).q, (3, 1))
    q[1] *= 5.0
    pose = np.tile(mechanism.home, (3, 1))
    found = settle(model, q, unknown_environment(*q.shape), pose)[0]
    assert not np.isfinite(found[1]).any()
    assert np.isfinite(found[[0, 2]]).all()
    assert sorted({some for some, *_ in led}) == sorted(exact_sets(mechanism))
    assert len(set(led)) == len(led)


def test_tables_are_made_once_of_a_model_and_follow_the_joints(rows, monkeypatch):
    model, q, _ = rows
    monkeypatch.setattr(compiled_limbs, "MANY", 1)
    model = Model(model.mechanism)
    one, other = (compiled_limbs.compiled_limbs(model.closure(own), COUNT) for own in (q, 1.01 * q))
    assert one.limbs is other.limbs
    assert not np.array_equal(one.u, other.u)
    place = next(i for i, p in enumerate(model.mechanism.parameters) if ".point." in p.name)
    moved_on = Model(model.mechanism, model.parameters + 1e-3 * np.eye(len(
        model.mechanism.parameters))[place])
    assert compiled_limbs.compiled_limbs(moved_on.closure(q), COUNT).limbs is not one.limbs
    columns = compiled_limbs.compiled_limbs(model.closure(q, model.mechanism.free), COUNT)
    assert columns.chains is not one.chains


def test_a_row_of_surplus_limbs_is_worth_several_others(tmp_path):
    tall, square = machine(tmp_path, stewart(7)), machine(tmp_path, stewart(6))
    few = compiled_limbs.MANY // compiled_limbs.SURPLUS
    assert compiled_limbs.pays(tall, few)
    assert not compiled_limbs.pays(tall, few - 1)
    assert not compiled_limbs.pays(square, few)
    assert compiled_limbs.pays(square, compiled_limbs.MANY)


def test_far_rows_are_not_taken_for_beyond_a_singularity():
    """Eight cables: joints that move in proportion contradict each other between far-off poses.

    On the straight way between these poses no pose matrix comes near losing rank.
    """
    mechanism = read_mechanism(CONFIGS / "cable-8.yaml")
    model = Model(mechanism)
    rng = np.random.default_rng(5)
    half = np.array([0.7, 0.6, 0.4, 0.2, 0.2, 0.2])
    at = rng.uniform(-half, half, (COUNT, 6))
    between = (at[:-1, None] + np.linspace(0.0, 1.0, 21)[:, None]
               * np.diff(at, axis=0)[:, None]).reshape(-1, 6)
    home = np.tile(mechanism.home, (len(between), 1))
    way = moved(home, between)
    value, _ = smallest_singular_value(model.closure(inverse(model, way).q), way)
    assert value.min() > 0.4
    there = moved(home[:COUNT], at)
    table = forward_table(model, inverse(model, there).q)
    assert set(table.status) == {"ok"}
