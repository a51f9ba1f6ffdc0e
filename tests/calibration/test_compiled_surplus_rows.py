"""Rows of surplus limbs, compiled, against NumPy's: sums, squares and blocks are the same."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.diagnoses import CONFIGS
from helpers.redundant import belts, cables, gapped, machine, rope_cage, stewart

from ppmcal.calibration.fit import column_scale
from ppmcal.calibration.fit.normal_equations import normal_sums, row_squares, white_blocks
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.row_distances import distances
from ppmcal.kinematics import compiled_limbs
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import find_instrument
from ppmcal.model.registration import Registration

COUNT, JOINT, PLACE, TURN = 43, 2e-4, 1e-4, 5e-4

# on a new machine each of these compiles for seconds
pytestmark = pytest.mark.slow


def over_pulleys(name):
    """Return the file of a machine on ropes over pulleys.

    Swivels slant: about an upright one a turn about z moves nothing, and its column is round-off.
    """
    tree = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    tree.pop("limits", None)
    for limb in tree["limbs"]:
        if "swivel_pulley" in limb["base"]:
            limb["base"]["swivel_pulley"]["axis"] = [0.1, -0.2, 1.0]
    return tree


CASES = {
    "cables, pose": (cables, "pose", ("frame", "target", "homing")),
    "cables alone": (cables, "none", ()),
    "cage, pose": (rope_cage, "pose", ("frame", "target", "turn", "scale", "homing")),
    "cage, plane": (rope_cage, "plane", ("frame", "target")),
    "belts, position": (belts, "position", ("frame",)),
    "belts alone": (belts, "none", ()),
    "legs, position": (stewart, "position", ("frame", "target", "scale")),
    "legs alone": (stewart, "none", ()),
    "cage that gaps": (lambda: gapped(rope_cage()), "pose", ("frame", "target", "homing")),
    "pulleys in the plane, pose": (lambda: over_pulleys("cable-4-pulleys"), "pose",
                                   ("frame", "target", "homing")),
    "pulleys, pose": (lambda: over_pulleys("cable-8-pulleys"), "pose", ("frame", "target")),
    "pulleys alone": (lambda: over_pulleys("cable-8-pulleys"), "none", ()),
    "belts of which one gaps": (lambda: gapped(belts(), (0.4, 0.0, 0.0, 0.0)), "none", ()),
}


@pytest.fixture(scope="module", params=CASES)
def bench(request, tmp_path_factory):
    """A problem off its minimum, its state, rows to use and weights."""
    tree, instrument, opened = CASES[request.param]
    tree = tree()
    for number, limb in enumerate(tree["limbs"]):
        limb["ratio"] = {"value": 2.0 + number, "tolerance": 0.001}
    mechanism = machine(tmp_path_factory.mktemp("m"), tree)
    motion, rng = mechanism.motion, np.random.default_rng(2)
    step = np.zeros((COUNT, 6))
    step[:, mechanism.dof] = rng.uniform(-0.1, 0.1, (COUNT, len(mechanism.dof)))
    there = moved(np.tile(mechanism.home, (COUNT, 1)), step)
    q = inverse(Model(mechanism), there).q
    level, turns = (np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])) if motion.planar else (
        np.ones(3), np.ones(3))
    registration = Registration.of_pose(
        np.concatenate([rng.normal(size=3) * level, 0.5 * rng.normal(size=3) * turns]),
        0.05 * rng.normal(size=3) * level * ("target" in opened),
        0.3 * turns * ("turn" in opened), 1.002 if "scale" in opened else 1.0)
    seen = measured_pose(registration, there) + rng.normal(size=(COUNT, 6)) * np.repeat(
        [PLACE, TURN], 3)
    height = seen[:, 2].copy()
    if motion.planar:
        seen[:, 2:5] = np.nan
    if instrument != "pose" or not motion.turns:
        seen[:, 3:] = np.nan
    if instrument in ("plane", "none"):
        seen[:] = np.nan
    seen[5, 0] = seen[6, 5] = np.nan
    data = Dataset.of_poses("d", q + JOINT * rng.normal(size=q.shape) / mechanism.joint_ratios,
                            seen, (PLACE, TURN), False)
    data = replace(
        data, kind=find_instrument(instrument), sigma_value=np.full(COUNT, PLACE),
        value=height if instrument == "plane" else np.full(COUNT, np.nan),
        sigma_actuator=JOINT / mechanism.joint_ratios * np.linspace(0.5, 1.0, q.shape[1]),
        weight=rng.uniform(0.3, 1.0, COUNT),
        frame=Unknown("frame" in opened, np.zeros(6)), target=Unknown("target" in opened,
                                                                      registration.target),
        target_rotation=Unknown("turn" in opened, registration.target_rotation),
        scale=Unknown("scale" in opened, np.array([registration.scale])),
        homing="alone" if "homing" in opened else "shared")
    problem = Problem(mechanism, (data,), mechanism.free)
    state = replace(problem.start(), registrations=(registration,))
    keep = np.ones(COUNT, dtype=bool)
    keep[[3, 11]] = False
    return problem, state, [keep], [np.linspace(0.5, 1.0, COUNT)]


def both(monkeypatch, work):
    """Return what some work gives by NumPy, and compiled."""
    plain = work()
    monkeypatch.setattr(compiled_limbs, "MANY", 1)
    return plain, work()


@pytest.mark.long_cases("cables, pose")
def test_sums_are_those_of_numpy(bench, monkeypatch):
    problem, state, keep, weights = bench
    plain, fast = both(monkeypatch, lambda: normal_sums(replace(problem), state, keep, weights))
    scale = np.sqrt(np.maximum(np.diagonal(plain.matrix), 1e-300))
    np.testing.assert_allclose(fast.matrix / scale / scale[:, None],
                               plain.matrix / scale / scale[:, None], atol=1e-9)
    np.testing.assert_allclose(fast.gradient / scale, plain.gradient / scale,
                               atol=1e-9 * np.sqrt(plain.square))
    np.testing.assert_allclose(fast.square, plain.square, rtol=1e-10)
    assert fast.count == pytest.approx(plain.count, rel=1e-12)


def test_squares_are_those_of_numpy(bench, monkeypatch):
    problem, state, keep, _ = bench
    plain, fast = both(monkeypatch, lambda: row_squares(replace(problem), state, 0, keep[0]))
    np.testing.assert_allclose(fast, plain, rtol=1e-9, atol=1e-12)


@pytest.mark.long_cases("cables, pose")
def test_blocks_tell_the_same_row_by_row(bench, monkeypatch):
    """Their rows are those of another basis: products of a row's columns are the same."""
    problem, state, keep, weights = bench

    def products():
        parts = list(white_blocks(replace(problem), state, 0, keep[0], weights[0]))
        whole = np.concatenate([p.rows for p in parts])
        return (np.concatenate([p.index for p in parts]), np.swapaxes(whole, -1, -2) @ whole,
                np.concatenate([p.values for p in parts]))

    plain, fast = both(monkeypatch, products)
    np.testing.assert_array_equal(fast[0], plain[0])
    np.testing.assert_array_equal(fast[2], plain[2])
    scale = np.sqrt(np.diagonal(plain[1].max(axis=0)))
    scale = np.where(scale > 0.0, scale, 1.0)
    np.testing.assert_allclose(fast[1] / scale / scale[:, None], plain[1] / scale / scale[:, None],
                               atol=1e-8)


def test_distances_of_rows_are_the_same(bench, monkeypatch):
    problem, state, keep, _ = bench
    covariance = np.diag((1e-3 * column_scale(problem)) ** 2)
    plain, fast = both(monkeypatch, lambda: distances(replace(problem), state, covariance, keep))
    np.testing.assert_allclose(fast.square[0], plain.square[0], rtol=1e-8, atol=1e-10)
    np.testing.assert_array_equal(fast.size[0], plain.size[0])


def test_residuals_are_the_same_to_the_instrument(bench, monkeypatch):
    """What is written of rows comes of NumPy, at poses that were found compiled."""
    problem, state, _, _ = bench
    plain, fast = both(monkeypatch, lambda: np.concatenate(
        [r.raw for r in replace(problem).rows(state, False)]))
    np.testing.assert_allclose(fast, plain, atol=1e-12)


def test_joints_without_noise_go_through_numpy(bench):
    """Where one joint is exact the closure has no weight, unless all limbs gap."""
    problem, state, _, _ = bench
    gaps = problem.mechanism.gap_sigma
    data = problem.datasets[0]
    sigma = data.sigma_actuator.copy()
    sigma[0] = 0.0
    exact = replace(problem, datasets=(replace(data, sigma_actuator=sigma),))
    assert problem.sighting(0, state).plain
    assert exact.sighting(0, state).plain == bool(np.all(gaps > 0.0))
