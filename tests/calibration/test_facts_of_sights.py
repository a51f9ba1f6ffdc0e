"""What an instrument sees moves with target and platform as its derivatives say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.calibration.fit.observation import view
from ppmcal.kinematics.forward import moved
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import find_instrument
from ppmcal.model.motions import SPATIAL
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]
N, STEP = 5, 1e-6


def case(kind: str, ends: int) -> tuple[Dataset, Registration, list[Array]]:
    """Return rows of an instrument, where it stands, and where the platform is."""
    rng = np.random.default_rng(1)
    registration = Registration.of_pose(rng.normal(size=6), rng.normal(size=3),
                                        np.array([0.2, -0.1, 0.3]), 1.02)
    poses = [np.asarray(cga.motor_from_rotation_vector(0.4 * rng.normal(size=(N, 3)),
                                                       rng.normal(size=(N, 3))))
             for _ in range(ends)]
    data = Dataset.of_poses("a", np.zeros((N, 6)), np.zeros((N, 6)), (1e-3, 1e-3), False)
    return replace(data, kind=find_instrument(kind), value=rng.normal(size=N)), registration, poses


@pytest.mark.parametrize(("kind", "ends"), [("position", 1), ("plane", 1), ("distance", 1),
                                            ("distance", 2)])
def test_positions_heights_and_distances_by_differences(kind: str, ends: int) -> None:
    """Of a distance between two platform positions the target moves both ends."""
    data, registration, poses = case(kind, ends)
    about = np.array([0.3, -0.2, 0.5])

    def predicted(registration: Registration, poses: list[Array]) -> Array:
        return -view(data, registration, poses, SPATIAL, about).residual

    found = view(data, registration, poses, SPATIAL, about)
    for c in range(3):
        ends_of = [predicted(replace(registration, target=registration.target + s * np.eye(3)[c]),
                             poses) for s in (STEP, -STEP)]
        np.testing.assert_allclose(found.by_target[..., c],
                                   (ends_of[0] - ends_of[1]) / (2.0 * STEP), atol=1e-8)
    for end in range(ends):
        for c in range(6):
            both = []
            for s in (STEP, -STEP):
                there = list(poses)
                there[end] = moved(poses[end], np.tile(s * np.eye(6)[c], (N, 1)))
                both.append(predicted(registration, there))
            np.testing.assert_allclose(found.by_poses[end][..., c],
                                       (both[0] - both[1]) / (2.0 * STEP), atol=1e-8)


def test_a_distance_of_nothing_has_no_direction() -> None:
    data, registration, poses = case("distance", 2)
    found = view(data, registration, [poses[0], poses[0]], SPATIAL, np.zeros(3))
    np.testing.assert_array_equal(found.residual[:, 0], data.value)
    assert not found.by_target.any()
    assert not found.by_poses[0].any()
