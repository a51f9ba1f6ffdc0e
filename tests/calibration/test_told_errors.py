"""What compensate says of errors without and with correction is what they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ppmcal
from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import predict
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]
MACHINES = 6
SCENARIO: dict[str, Any] = {
    "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
    "poses": {"random": {"center": {"x": 500, "y": 290, "rz": 30},
                         "half_range": {"x": 60, "y": 60, "rz": 8}, "count": 12}},
    "errors": {"random": {"scale": 1.0}}, "frame": {"x": 5, "y": -3, "rz": 1}}
TARGETS = np.array([[500 + x, 290 + y, 30 + t] for x in (-40, 0, 40) for y in (-40, 0, 40)
                    for t in (-5, 5)], dtype=float)
KINDS = ("position", "rotation")


def missed(made: Any, q: Array, seen: Array, registration: Registration) -> tuple[Array, Array]:
    """Return by how much the true machine misses wanted poses (N, 6), m and rad (N,)."""
    pose = reached_poses(Model(made.with_effects, made.g), q, unknown_environment(*q.shape)).pose
    point, turn = predict(registration, pose)
    goal = np.swapaxes(cga.rotation_matrix(pose_motor(seen)), -1, -2)
    away = cga.rotation_vector(cga.motor_from_matrix(turn @ goal, np.zeros(3)))
    return np.linalg.norm(point - seen[:, :3], axis=1), np.linalg.norm(away, axis=1)


def campaigns(noise: float, frame: str) -> list[dict[str, tuple[float, float]]]:
    """Return rms errors without and with correction of machines that the tolerances allow.

    Told and true, of each kind, of every machine.
    """
    machine, out = ppmcal.load(ppmcal.shipped("3-RPR")), []
    scenario = SCENARIO | {"instrument": {"kind": "pose", "sigma": {
        "position": noise, "rotation": noise / 5.0}}}
    for seed in range(MACHINES):
        campaign = ppmcal.simulate(machine, scenario, seed=seed)
        fit = ppmcal.identify(machine, campaign.data, holdout=0.0, seed=seed)
        found = ppmcal.compensate(fit, TARGETS, frame=frame or None, path=False)
        made, sent = found.compensation, np.isfinite(found.compensation.q).all(axis=1)
        assert sent.all(), found.refused
        registration = Registration() if frame else Registration.of_pose(
            campaign.scenario.frame, campaign.scenario.target, campaign.scenario.target_rotation)
        true = [missed(campaign.campaign, q, made.seen, registration)
                for q in (made.q_nominal, made.q)]
        sizes: dict[str, tuple[float, float]] = {}
        for k, kind in enumerate(KINDS):
            told = found.errors(kind)
            assert told[0] is not None and told[1] is not None
            sizes[f"{kind} told"] = told
            sizes[f"{kind} true"] = tuple(np.sqrt(np.mean(t[k] ** 2)) for t in true)
        out.append(sizes)
    return out


def together(found: list[dict[str, tuple[float, float]]], what: str) -> Array:
    """Return rms over the machines of errors before and after (2,)."""
    return np.asarray(np.sqrt(np.mean(np.square([f[what] for f in found]), axis=0)))


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "frame"), [(0.5, "base"), (0.3, "")])
def test_machines_as_the_tolerances_have_them_err_as_is_told(noise: float, frame: str) -> None:
    """Poor data: what is not known is as large as what is corrected, and in both errors.

    Were the uncorrected commands told without it, all of these would be refused as worse than none,
    though the true machines are better with them.
    """
    found = campaigns(noise, frame)
    for kind in KINDS:
        told, true = together(found, f"{kind} told"), together(found, f"{kind} true")
        # six machines scatter by a quarter
        np.testing.assert_allclose(told, true, rtol=0.35)
        assert true[1] < true[0]


@pytest.mark.slow
def test_one_name_means_one_thing_in_both_files() -> None:
    """The rms of a column of commands.csv is what commands.json says under its name."""
    machine = ppmcal.load(ppmcal.shipped("3-RPR"))
    scenario = SCENARIO | {"instrument": {"kind": "pose", "sigma": {
        "position": 0.05, "rotation": 0.01}}}
    fit = ppmcal.identify(machine, ppmcal.simulate(machine, scenario, seed=1).data)
    found = ppmcal.compensate(fit, TARGETS, frame="base")
    frame = found.to_frame()
    for kind in KINDS:
        size = found.record.predicted[kind]
        for name, value in (("error_{}_before", size.before), ("error_{}_after", size.after),
                            ("sigma_{}", size.sigma)):
            column = np.asarray(frame[name.format(kind)])
            assert value == pytest.approx(np.sqrt(np.mean(column**2)))
        assert (np.asarray(frame[f"error_{kind}_after"])
                >= 0.999 * np.asarray(frame[f"sigma_{kind}"])).all()
    unknown = ppmcal.compensate(fit.mechanism, TARGETS, frame="base")
    assert np.isnan(np.asarray(unknown.to_frame()["error_position_after"])).all()
    assert unknown.record.predicted["position"].after is None
    assert "if the model is exact, unknown with these" in unknown.record.predicted[
        "position"].words()
