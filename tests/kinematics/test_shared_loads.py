"""Drives that give way, more of them than freedoms: where the platform goes, by least energy."""

import numpy as np
import pytest
from helpers.redundant import belts, cables, machine, stewart
from scipy.optimize import minimize

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.loads import loads
from ppmcal.model.dataset import environment

MASS, GRAVITY = 8.0, 9.80665


def giving(tree, values):
    """Return a file whose drives give way, one unlike the other, N/mm."""
    names = [limb["name"] for limb in tree["limbs"]]
    return {**tree, "effects": [{"kind": "compliance", "on": [n], "parameters": {"stiffness": v}}
                                for n, v in zip(names, values, strict=False)]}


def case(folder, tree, values):
    """Return the machine, joint values of poses about home, and the poses reached under weight."""
    mechanism = machine(folder, giving(tree, values))
    rng = np.random.default_rng(6)
    step = np.zeros((4, 6))
    step[:, mechanism.dof] = rng.uniform(-0.08, 0.08, (4, len(mechanism.dof)))
    pose = moved(np.tile(mechanism.home, (4, 1)), step)
    q = inverse(Model(mechanism), pose).q
    rows = environment({"payload": np.full(4, MASS)}, mechanism.actuators, mechanism.gravity, q)
    return mechanism, q, reached_poses(Model(mechanism), q, rows).closed


@pytest.mark.slow
@pytest.mark.parametrize("tree", [cables, belts, stewart], ids=lambda t: t.__name__)
def test_the_pose_is_that_of_the_least_energy(tree, tmp_path):
    """By distances alone: springs of the drives, and the weight's potential."""
    tree = tree()
    stiffness = 300.0 + 250.0 * np.arange(len(tree["limbs"]))
    mechanism, q, reached = case(tmp_path, tree, stiffness.tolist())
    values = Model(mechanism).limb_values
    ends = [np.array([[v.get(f"{end}.point.{a}", 0.0) for a in "xyz"] for v in values])
            for end in ("base", "platform")]
    dof, size = list(mechanism.dof), 1e-6
    for n in range(4):
        def at(x, n=n):
            step = np.zeros((1, 6))
            step[0, dof] = size * x
            there = moved(reached[n:n + 1], step)
            ways = cga.move_point(there, ends[1]) - ends[0]
            apart = np.linalg.norm(ways, axis=-1)
            force = 1e3 * stiffness * (apart - q[n])
            arms = cga.move_point(there, ends[1]) - cga.translation(there)
            lines = ways / apart[:, None]
            slope = force @ np.concatenate([lines, np.cross(arms, lines)], axis=1)
            slope[:3] -= MASS * GRAVITY * mechanism.gravity
            energy = 0.5 * np.sum(force * (apart - q[n])) - MASS * GRAVITY * (
                mechanism.gravity @ step[0, :3])
            return energy / size, slope[dof]

        best = minimize(at, np.zeros(len(dof)), jac=True, method="BFGS", options={"gtol": 1e-6})
        still = unloaded(mechanism, q[n])
        turn = cga.rotation_vector(cga.compose(reached[n:n + 1], cga.reverse(still)))[0]
        moves = np.concatenate([cga.translation(reached[n]) - cga.translation(still)[0], turn])
        assert np.linalg.norm(moves[:3]) > 1e-5
        for own in (slice(0, 3), slice(3, 6)):
            off = size * best.x[[c in range(6)[own] for c in dof]]
            # what carries the load is told to first order in what it gives way
            assert np.linalg.norm(off) <= 5e-3 * np.linalg.norm(moves[own]) + 1e-12


def unloaded(mechanism, q):
    """Return where the platform would be without weight, as a motor (1, 8)."""
    bare = reached_poses(Model(mechanism), q[None], environment(
        {"payload": np.zeros(1)}, mechanism.actuators, mechanism.gravity, q[None]))
    return bare.closed


def test_drives_that_give_alike_or_not_all_share_as_before(tmp_path):
    """What they carry is then that of least squares of the drives."""
    tree, weight = belts(), np.array([[0.0, -MASS * GRAVITY, 0, 0, 0, 0]])
    plain = Model(machine(tmp_path, tree))
    q = inverse(plain, plain.mechanism.home[None]).q
    expected = loads(plain, q, plain.mechanism.home[None], weight)
    for values in ([400.0] * 4, [400.0, 100.0]):
        model = Model(machine(tmp_path, giving(tree, values)))
        np.testing.assert_array_equal(
            loads(model, q, model.mechanism.home[None], weight), expected)
    model = Model(machine(tmp_path, giving(tree, [400.0, 100.0, 300.0, 200.0])))
    other = loads(model, q, model.mechanism.home[None], weight)
    assert np.abs(other - expected).max() > 1.0
