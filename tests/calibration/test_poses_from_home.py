"""Poses led from home are made once for a machine and its joint values, and never for others."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.redundant import cables, machine

from ppmcal.calibration.fit import poses_from_home
from ppmcal.calibration.fit.poses_from_home import PosesFromHome
from ppmcal.kinematics.closure import Model

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
