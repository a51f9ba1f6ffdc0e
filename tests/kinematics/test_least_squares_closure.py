"""More equations than freedoms: where the limbs contradict each other least, and what they hold."""

import numpy as np
import pytest
import yaml
from helpers.diagnoses import CONFIGS
from helpers.redundant import cables, machine, stewart
from scipy.optimize import least_squares

from ppmcal import algebra as cga
from ppmcal.design.intersection import require_meet
from ppmcal.errors import BadInput
from ppmcal.kinematics import forward as forward_kinematics
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, moved, newton
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.kinematics.least_squares_closure import closed_by, held_by, surplus
from ppmcal.kinematics.loads import loads


@pytest.fixture(scope="module", params=[cables, stewart])
def model(request, tmp_path_factory):
    return Model(machine(tmp_path_factory.mktemp("m"), request.param()))


def poses(mechanism, count=4, size=1.0):
    """Return some poses about home (count, 8)."""
    rng = np.random.default_rng(3)
    step = np.zeros((count, 6))
    step[:, mechanism.dof] = rng.uniform(-1.0, 1.0, (count, len(mechanism.dof)))
    step[:, :3] *= 0.1 * size
    step[:, 3:] *= 0.15 * size
    return moved(np.tile(mechanism.home, (count, 1)), step)


def gaps(model, q, pose):
    """Return how far each limb ends from closing (N, m), m, by distances alone."""
    v, out = model.limb_values, []
    for i in range(len(model.mechanism.limbs)):
        fixed, carried = (np.array([v[i].get(f"{end}.point.{a}", 0.0) for a in "xyz"])
                          for end in ("base", "platform"))
        apart = np.linalg.norm(cga.move_point(pose, carried) - fixed, axis=-1)
        out.append(apart - model.joint_coordinate(i, q))
    return np.stack(out, axis=-1)


def test_joints_that_agree_close_exactly(model):
    there = poses(model.mechanism)
    found = forward(model, inverse(model, there).q)
    assert found.converged.all()
    np.testing.assert_allclose(cga.translation(found.pose), cga.translation(there), atol=1e-12)
    np.testing.assert_allclose(found.pose, there * np.sign(np.sum(
        found.pose[:, :4] * there[:, :4], axis=1))[:, None], atol=1e-11)


@pytest.mark.slow_cases("stewart")
def test_joints_that_contradict_each_other_give_least_squares(model):
    """SciPy's minimum of the squared gaps, which are distances there and not inner products."""
    mechanism = model.mechanism
    rng = np.random.default_rng(5)
    q = inverse(model, poses(mechanism)).q + rng.normal(0.0, 1e-4, (4, len(mechanism.actuators)))
    found = forward(model, q)
    assert found.converged.all()
    for n in range(4):
        def at(x, n=n):
            step = np.zeros((1, 6))
            step[:, mechanism.dof] = x
            return gaps(model, q[n:n + 1], moved(found.pose[n:n + 1], step))[0]

        best = least_squares(at, np.zeros(len(mechanism.dof)), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        # the closure's inner product is a gap up to its square over the limb's length
        np.testing.assert_allclose(best.x, 0.0, atol=1e-6)
        assert np.sum(at(np.zeros(len(mechanism.dof))) ** 2) < np.sum(best.fun ** 2) * (1 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cable-8", "cable-8-pulleys"])
def test_ropes_that_contradict_each_other_on_the_way_are_led_by_six(name, tmp_path, monkeypatch):
    """Far from home, by a drawing that is off by its tolerances: all eight at once lose their way.

    Where rows stand is known: the minimum beside the pose that their joint values were made at.
    """
    drawn = Model(machine(tmp_path, yaml.safe_load(
        (CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))))
    mechanism, rng = drawn.mechanism, np.random.default_rng(7)
    off = [p.tolerance if p.free and p.tolerance else 0.0 for p in mechanism.parameters]
    built = Model(mechanism, mechanism.values + off * rng.normal(size=len(off)))
    step = rng.uniform(-1.0, 1.0, (60, 6)) * np.array([0.6, 0.5, 0.4, 0.17, 0.17, 0.17])
    there = moved(np.tile(mechanism.home, (60, 1)), step)
    q = inverse(built, there).q
    beside, converged, _ = newton(drawn.closure(q), there)
    assert converged.all()
    led = []
    lead = forward_kinematics._lead

    def watched(model, origin, wanted, *rest):
        if len(wanted):
            led.append((len(model.mechanism.limbs), len(wanted)))
        return lead(model, origin, wanted, *rest)

    monkeypatch.setattr(forward_kinematics, "_lead", watched)
    found = forward(drawn, q)
    assert found.converged.all()
    np.testing.assert_allclose(found.pose, beside * np.sign(np.sum(
        found.pose[:, :4] * beside[:, :4], axis=1))[:, None], atol=1e-11)
    assert {limbs for limbs, _ in led} == {6}


def test_what_closes_gaps_is_the_derivative_of_the_pose(model):
    mechanism = model.mechanism
    there = poses(mechanism)
    q = inverse(model, there).q
    free = list(mechanism.free)
    closure = model.closure(q, free)
    a = closure.pose_matrix(there)
    by = -closed_by(closure, there, a, closure.error_matrix(there, free))
    step = 1e-6
    for column, p in enumerate(free[::3]):
        ends = []
        for sign in (1.0, -1.0):
            g = mechanism.values.copy()
            g[p] += sign * step
            ends.append(forward(Model(mechanism, g), q, there, q).pose)
        turn = cga.rotation_vector(cga.compose(ends[0], cga.reverse(ends[1])))
        twist = np.concatenate([cga.translation(ends[0]) - cga.translation(ends[1]), turn], axis=1)
        np.testing.assert_allclose(by[..., 3 * column], twist[:, mechanism.dof] / (2 * step),
                                   rtol=1e-5, atol=1e-6)


def test_forces_hold_the_load_with_the_least_work(model):
    """A' f = w; and any internal force more costs more."""
    mechanism = model.mechanism
    there = poses(mechanism)
    q = inverse(model, there).q
    closure = model.closure(q)
    a = closure.pose_matrix(there)
    wrench = np.random.default_rng(1).normal(size=(4, 6)) * 10.0
    own = wrench[:, mechanism.dof, None]
    force = held_by(closure, there, a, own)
    np.testing.assert_allclose(np.swapaxes(a, -1, -2) @ force, own, atol=1e-8)
    inner = surplus(mechanism, a)
    np.testing.assert_allclose(np.swapaxes(a, -1, -2) @ inner, 0.0, atol=1e-12)
    give = closure.joint_matrix(there)
    work = np.swapaxes(inner, -1, -2) @ give @ np.swapaxes(give, -1, -2) @ force
    np.testing.assert_allclose(work, 0.0, atol=1e-8)
    # loads of the drives are those forces, per unit of the joint
    np.testing.assert_allclose(loads(model, q, there, wrench), -(
        np.swapaxes(give, -1, -2) @ force)[..., 0], atol=1e-8)


def test_the_surplus_is_one_combination_from_pose_to_pose(model):
    """It turns with the pose and does not jump; of one more equation it has one sign."""
    mechanism = model.mechanism
    way = np.linspace(0.0, 1.0, 50)[:, None] * np.array([[0.1, 0.1, 0.0, 0.0, 0.0, 0.1]])
    there = moved(np.tile(mechanism.home, (50, 1)), way)
    a = model.closure(inverse(model, there).q).pose_matrix(there)
    basis = surplus(mechanism, a)
    assert basis.shape == (50, mechanism.equations, mechanism.surplus) and mechanism.surplus == 1
    np.testing.assert_allclose(np.swapaxes(basis, -1, -2) @ basis,
                               np.tile(np.eye(1), (50, 1, 1)), atol=1e-12)
    assert np.abs(np.diff(basis, axis=0)).max() < 0.05


def test_home_of_a_machine_whose_limbs_contradict_each_other_is_reached(tmp_path):
    """Counts that are off by a tenth of the machine: the way from home begins where they meet."""
    mechanism = machine(tmp_path, cables())
    g = mechanism.values.copy()
    offsets = [i for i, n in enumerate(mechanism.names) if n.endswith(".offset")]
    g[offsets] += [-0.15, 0.1, 0.05, -0.1]
    model = Model(mechanism, g)
    q = np.array(home_state(mechanism).q)
    found = forward(model, np.stack([q, q + [0.2, -0.1, 0.0, 0.1]]))
    assert found.converged.all()


def test_surplus_limbs_have_no_intersection(model):
    with pytest.raises(BadInput, match="more limbs than its platform has freedoms"):
        require_meet(model.mechanism)
