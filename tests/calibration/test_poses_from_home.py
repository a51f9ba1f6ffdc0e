"""Poses led from home, and closed rows, are made once for a machine, and never for others."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.diagnoses import CONFIGS
from helpers.redundant import cables, machine

from ppmcal.calibration.fit import poses_from_home
from ppmcal.calibration.fit.poses_from_home import PosesFromHome
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.response import MOST, RowsAtRest
from ppmcal.calibration.validation.residual_vectors import register_only
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.model.dataset import Dataset

JOINTS = np.array([[1.0, 2.0, 3.0, np.nan], [1.5, 2.5, 3.5, 4.5]])


class Leading:
    """Counts how often poses are led, each time to others."""

    def __init__(self):
        self.times = 0

    def __call__(self):
        self.times += 1
        return np.full((len(JOINTS), 8), float(self.times))


@pytest.fixture
def mechanism(tmp_path):
    return machine(tmp_path, cables())


def test_the_same_poses_are_led_once_and_belong_to_whoever_asks(mechanism):
    kept, leading = PosesFromHome(), Leading()
    first = kept.of(Model(mechanism), JOINTS, leading)
    first[:] = np.nan
    # what is known of parameters, and which are free, moves no limb
    again = replace(mechanism.nominal(), free=())
    second = kept.of(Model(again, mechanism.values.copy()), JOINTS.copy(), leading)
    np.testing.assert_array_equal(second, 1.0)
    second[:] = np.nan
    np.testing.assert_array_equal(kept.of(Model(mechanism), JOINTS, leading), 1.0)
    assert leading.times == 1


def moved_home(m):
    return replace(m, home_pose=m.home_pose + 1e-6)


def other_values(m):
    return m.with_values(m.values + 1e-6)


def gaping(m):
    return replace(m, gaps={m.limbs[0].name: 1e-4})


@pytest.mark.parametrize("change", [moved_home, other_values, gaping])
def test_another_machine_has_poses_of_its_own(mechanism, change):
    kept, leading = PosesFromHome(), Leading()
    kept.of(Model(mechanism), JOINTS, leading)
    kept.of(Model(change(mechanism)), JOINTS, leading)
    assert leading.times == 2


def test_other_parameters_and_other_joints_have_poses_of_their_own(mechanism):
    kept, leading = PosesFromHome(), Leading()
    kept.of(Model(mechanism), JOINTS, leading)
    kept.of(Model(mechanism, mechanism.values + 1e-9), JOINTS, leading)
    kept.of(Model(mechanism), JOINTS + 1e-9, leading)
    assert leading.times == 3


def test_no_more_rows_are_kept_than_are_worth_it(mechanism, monkeypatch):
    monkeypatch.setattr(poses_from_home, "MOST", 3)
    kept, leading = PosesFromHome(), Leading()
    for joints in (JOINTS, JOINTS + 1.0, JOINTS):
        kept.of(Model(mechanism), joints, leading)
    assert leading.times == 3
    kept.of(Model(mechanism), np.ones((4, 4)), leading)
    kept.of(Model(mechanism), JOINTS, leading)
    assert leading.times == 4


@pytest.fixture
def seen(tmp_path):
    """Return a problem of which only frames and targets are open: a planar machine, 12 poses."""
    tree = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text(encoding="utf-8"))
    planar = machine(tmp_path, tree)
    rng = np.random.default_rng(5)
    pose = planar.home_pose + rng.uniform(-1.0, 1.0, (12, 6)) * [0.05, 0.05, 0, 0, 0, 0.1]
    q = inverse(Model(planar), pose_motor(pose)).q
    data = Dataset.of_poses("seen", q, pose + [0.3, -0.2, 0, 0, 0, 0.4], (1e-4, 1e-4), True)
    return Problem(planar, (replace(data, sigma_actuator=np.full(3, 2e-4)),), ())


def test_while_frames_alone_move_the_closure_of_rows_is_made_once(seen, monkeypatch):
    """And what is found is the same to the last bit as where it is made anew each time."""
    made, closure, of = [0], Model.closure, RowsAtRest.of

    def counted(self, *args):
        made[0] += 1
        return closure(self, *args)

    monkeypatch.setattr(Model, "closure", counted)
    found, once = register_only(seen), made[0]
    asked = [0]

    def anew(self, model, q, pose):
        asked[0] += 1
        return of(RowsAtRest(), model, q, pose)

    monkeypatch.setattr(RowsAtRest, "of", anew)
    made[0] = 0
    other = register_only(replace(seen, home=PosesFromHome(), at_rest=RowsAtRest()))
    assert asked[0] > 10 and once <= made[0] - asked[0] + 2
    (a,), (b,) = (f.state.registrations for f in (found, other))
    np.testing.assert_array_equal(a.frame, b.frame)
    np.testing.assert_array_equal(found.information.root, other.information.root)


def test_other_rows_at_rest_are_others(seen):
    kept, mechanism = RowsAtRest(), seen.mechanism
    q, pose = seen.datasets[0].q, seen.start().poses[0]
    first = kept.of(Model(mechanism), q, pose)
    assert kept.of(Model(mechanism, mechanism.values.copy()), q.copy(), pose.copy()) is first
    assert kept.of(Model(mechanism), q[:5], pose[:5]) is not first
    assert kept.of(Model(mechanism, mechanism.values + 1e-6), q, pose) is not first
    assert kept.of(Model(mechanism), q + 1e-6, pose) is not first
    assert kept.of(Model(mechanism), q, moved(pose, np.full((len(pose), 6), 1e-6))) is not first
    assert kept.of(Model(mechanism), q, pose) is first
    for n in range(2 * MOST):
        kept.of(Model(mechanism), q + n, pose)
    assert len(kept.known) == MOST and kept.of(Model(mechanism), q, pose) is not first
