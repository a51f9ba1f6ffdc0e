"""What limbs may gap: how it weighs their equations, in the pose and in simulated rows."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.redundant import alone, belts, cables, gapped, machine, stewart, written
from scipy.optimize import least_squares

import ppmcal
from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import Reached, gaping
from ppmcal.kinematics.forward import forward, moved
from ppmcal.kinematics.inverse import inverse
from ppmcal.model.mechanism import USUAL_NOISE

ROWS = 5


def contradicting(mechanism, size=1e-4):
    """Return joint values (ROWS, k) about home whose limbs do not meet."""
    rng = np.random.default_rng(5)
    step = np.zeros((ROWS, 6))
    step[:, mechanism.dof] = rng.uniform(-0.1, 0.1, (ROWS, len(mechanism.dof)))
    there = moved(np.tile(mechanism.home, (ROWS, 1)), step)
    q = inverse(Model(mechanism), there).q
    return q + rng.normal(0.0, size, q.shape)


@pytest.mark.parametrize("tree", [cables, stewart, belts], ids=lambda t: t.__name__)
@pytest.mark.slow_cases("stewart")
def test_the_pose_is_that_of_weighted_least_squares(tree, tmp_path):
    """SciPy's minimum of squared gaps, which are distances, over what each may be."""
    mechanism = machine(tmp_path, gapped(tree()))
    model, q = Model(mechanism), contradicting(mechanism)
    found = forward(model, q)
    plain = forward(Model(replace(mechanism, gaps={})), q)
    assert found.converged.all()
    assert np.abs(cga.translation(found.pose) - cga.translation(plain.pose)).max() > 1e-5
    sigma = np.hypot([mechanism.gaps[limb.name] for limb in mechanism.limbs],
                     USUAL_NOISE * mechanism.reach)
    values = model.limb_values
    ends = [np.array([[v.get(f"{end}.point.{a}", 0.0) for a in "xyz"] for v in values])
            for end in ("base", "platform")]
    for n in range(ROWS):
        def at(x, n=n):
            step = np.zeros((1, 6))
            step[:, mechanism.dof] = x
            pose = moved(found.pose[n:n + 1], step)
            apart = np.linalg.norm(cga.move_point(pose, ends[1]) - ends[0], axis=-1)
            return (apart - q[n]) / sigma

        best = least_squares(at, np.zeros(len(mechanism.dof)), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        # the closure's inner product is a gap up to its square over the limb's length
        np.testing.assert_allclose(best.x, 0.0, atol=1e-6)


@pytest.mark.parametrize("tree", [cables, stewart], ids=lambda t: t.__name__)
@pytest.mark.slow_cases("stewart")
def test_gaps_of_next_to_nothing_leave_the_pose_of_the_drives_noise(tree, tmp_path):
    mechanism = machine(tmp_path, gapped(tree(), (1e-8, 3e-8)))
    q = contradicting(mechanism)
    np.testing.assert_allclose(forward(Model(mechanism), q).pose,
                               forward(Model(replace(mechanism, gaps={})), q).pose, atol=1e-12)


def test_poses_do_not_depend_on_the_file_s_units(tmp_path):
    """The same machine in mm and in m."""
    tree = gapped(belts())
    metres = {**tree, "units": {"length": "m", "angle": "deg"},
              "limbs": [{**limb, "base": {"point": [v / 1e3 for v in limb["base"]["point"]]}}
                        for limb in tree["limbs"]],
              "home": {"pose": {"x": 1.5, "y": 1.05}}, "tolerances": {"point": 0.02},
              "closure": {"sigma": {k: v / 1e3 for k, v in tree["closure"]["sigma"].items()}}}
    one, other = machine(tmp_path, tree), machine(tmp_path, metres)
    assert one.gaps == pytest.approx(other.gaps)
    q = contradicting(one)
    np.testing.assert_allclose(forward(Model(one), q).pose, forward(Model(other), q).pose,
                               atol=1e-12)


def test_simulated_limbs_gap_by_what_the_file_says(tmp_path):
    """At the true poses, by distances alone; limbs that are not named close."""
    tree = gapped(belts(), (0.5, 0.0, 0.2, 0.1))
    path = written(tmp_path, tree)
    made = ppmcal.simulate(path, alone(tree, {"x": 700, "y": 500}, sigma=0, count=400, seed=3, **{
        "instrument": {"kind": "position", "sigma": {"position": 0.0}}}))
    campaign = made.campaign
    model = Model(campaign.with_effects, campaign.g)
    base = np.array([[v[f"base.point.{a}"] for a in "xy"] for v in model.limb_values])
    apart = np.linalg.norm(campaign.position[:, None, :2] - base, axis=-1)
    size = 1e3 * np.std(apart - campaign.q, axis=0)
    np.testing.assert_allclose(size, [0.5, 0.0, 0.2, 0.1], rtol=0.12, atol=1e-9)


def test_limbs_of_one_drive_gap_each_by_itself(tmp_path):
    """Where they share a drive the platform moves too, by as little as may be."""
    tree = stewart(8)
    tree["limbs"][7]["actuator"] = "leg7"
    mechanism = machine(tmp_path, tree)
    model, q = Model(mechanism), contradicting(machine(tmp_path, stewart(8)))[:, :7]
    pose = forward(model, q).pose
    gap = np.random.default_rng(1).normal(0.0, 3e-4, (ROWS, 8))
    joints, real = gaping(q, Reached(pose, pose, model), gap)
    np.testing.assert_allclose(model.closure(joints).lengths(real.closed), gap, atol=1e-12)
