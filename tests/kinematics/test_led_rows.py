"""Rows whose limbs contradict each other are led once for a machine while a command works."""

import numpy as np
import pytest
from helpers.redundant import belts, machine

from ppmcal.commands.face import carry_out
from ppmcal.kinematics import forward as kinematics
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.led_rows import MODELS, LedRows, keeping_led_rows, kept_rows
from ppmcal.kinematics.partial_pose import pose_motor


@pytest.fixture
def mechanism(tmp_path):
    return machine(tmp_path, belts())


@pytest.fixture
def joints(mechanism):
    """Return joint values at 12 places; in three of them one belt reads metres too little."""
    pose = np.tile(mechanism.home_pose, (12, 1))
    pose[:, :2] += np.random.default_rng(2).uniform(-0.7, 0.7, (12, 2))
    q = inverse(Model(mechanism), pose_motor(pose)).q
    q[[1, 5, 9], [0, 2, 3]] -= [1.0, 3.5, 1.2]
    return q


@pytest.fixture
def led(monkeypatch):
    """Return how many rows were led by some limbs so far, in a list of one."""
    count, lead = [0], kinematics._led_by

    def counted(model, some, q, *args):
        count[0] += len(q)
        return lead(model, some, q, *args)

    monkeypatch.setattr(kinematics, "_led_by", counted)
    return count


def test_what_is_led_once_is_known_and_the_same(mechanism, joints, led):
    alone = forward(Model(mechanism), joints)
    whole = led[0]
    with keeping_led_rows():
        led[0] = 0
        first = forward(Model(mechanism), joints)
        assert 0 < led[0] < whole
        led[0] = 0
        again = forward(Model(mechanism, mechanism.values.copy()), joints)
        assert led[0] == 0
        forward(Model(mechanism, mechanism.values + 1e-6), joints)
        assert led[0] > 0
    np.testing.assert_array_equal(first.pose, again.pose)
    np.testing.assert_array_equal(first.converged, alone.converged)
    np.testing.assert_allclose(first.pose, alone.pose, rtol=0.0, atol=1e-11)


def test_a_command_begins_with_nothing_kept(monkeypatch):
    """Whatever was done before it, and inside of another command."""
    seen = []

    class Work:
        @staticmethod
        def run(asked):
            seen.append(kept_rows())
            return asked

    class Spec:
        name, recorded = "any", False

    monkeypatch.setattr("ppmcal.commands.face.work", lambda name: Work)
    assert kept_rows() is None
    with keeping_led_rows():
        outer = kept_rows()
        for _ in range(2):
            carry_out(Spec, None)
        assert kept_rows() is outer
    assert kept_rows() is None
    assert len({id(k) for k in (outer, *seen)}) == 3 and not any(k.known for k in seen)


def test_the_latest_models_are_kept(mechanism, joints):
    kept, asked = LedRows(), []

    def lead(rows):
        asked.append(len(rows))
        return (np.zeros((len(rows), 8)), np.ones(len(rows), dtype=bool), np.zeros(len(rows)))

    models = [Model(mechanism, mechanism.values + 1e-3 * n) for n in range(MODELS + 1)]
    for model in (models[0], models[1], models[0]):
        kept.of(model, (0, 1), joints[:4], lead)
    assert asked == [4, 4]
    kept.of(models[0], (0, 1), joints, lead)
    kept.of(models[0], (0, 2), joints[:1], lead)
    assert asked[2:] == [8, 1]
    for model in models[2:]:
        kept.of(model, (0, 1), joints[:1], lead)
    assert len(kept.known) == MODELS
    asked.clear()
    kept.of(models[0], (0, 1), joints, lead)
    kept.of(models[1], (0, 1), joints[:4], lead)
    assert asked == [4]
