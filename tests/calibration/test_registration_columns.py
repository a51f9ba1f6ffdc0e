"""How a fit moves registrations: only what is open, and many at once as each alone."""

from dataclasses import replace

import numpy as np

import ppmcal
from ppmcal.calibration.fit.nuisance_columns import lay_out
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.registration import Registration

FRAME = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])


def columns(fitted):
    """Return the columns of a data set with an open target and homing, and their number."""
    data = Dataset.of_poses("a", np.zeros((4, 6)), np.zeros((4, 6)), (1.0, 1.0), fitted)
    data = replace(data, target=Unknown(True, np.zeros(3)), homing="alone")
    mechanism = ppmcal.load(ppmcal.shipped("6-UPS"))
    (found,), names = lay_out(mechanism, (data,), (), (np.array([0.1, 0.0, 0.2]),))
    return found, len(names)


def test_the_default_registration_sees_platform_poses_in_the_base_frame():
    pose = np.random.default_rng(1).normal(size=(5, 6))
    np.testing.assert_allclose(measured_pose(Registration(), pose_motor(pose)),
                               pose_vector(pose_motor(pose)), rtol=0.0, atol=1e-14)


def test_a_step_moves_an_open_frame_and_leaves_a_known_one_to_the_last_bit():
    start = Registration.of_pose(FRAME)
    for fitted in (True, False):
        found, count = columns(fitted)
        moved = found.moved(start, np.full(count, 1e-3))
        assert np.array_equal(moved.frame, start.frame) is not fitted
        np.testing.assert_array_equal(moved.target, np.full(3, 1e-3))
        np.testing.assert_array_equal(moved.homing, np.full(6, 1e-3))


def test_many_machines_registrations_move_as_each_alone():
    found, count = columns(True)
    steps = np.random.default_rng(2).normal(size=(4, count)) * 1e-2
    start = Registration(np.tile(pose_motor(FRAME), (4, 1)), np.zeros((4, 3)), np.zeros((4, 3)))
    together = found.moved(start, steps)
    for i, step in enumerate(steps):
        alone = found.moved(Registration.of_pose(FRAME), step)
        for name in ("frame", "target", "target_rotation", "homing"):
            np.testing.assert_allclose(getattr(together, name)[i], getattr(alone, name),
                                       rtol=0.0, atol=1e-15)
