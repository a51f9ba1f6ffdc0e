"""Which rows are repeats: the same joints and the same environment, whatever the labels say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.noise_estimate import noise_check
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.lack_of_fit import pure_error
from ppmcal.diagnosis.linear_system import build
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.repeats import commanded_poses, repeats

SIDECAR = """format: ppmcal/dataset/1
units: {length: mm, angle: deg}
instrument: {kind: pose, sigma: {position: 0.005, rotation: 0.001}}
frame: unknown
target: unknown
"""


@pytest.fixture(scope="module")
def stage() -> Mechanism:
    return ppmcal.load(ppmcal.shipped("3-RPR"))


def scenario(seed: int, **more: object) -> dict[str, object]:
    return {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
            "poses": {"random": {"center": {"x": 500, "y": 260, "rz": 25},
                                 "half_range": {"x": 70, "y": 70, "rz": 8}, "count": 30}},
            "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
            "frame": {"x": 5, "y": -3, "rz": 10}, "target": [1, 2], "seed": seed} | more


def written(stage: Mechanism, data: Dataset, folder: Path, labels: Array) -> Dataset:
    """Return the data set written with other pose labels, and read."""
    angle = np.rad2deg(data.rotation[:, 2])
    table = np.column_stack([labels, 1e3 * data.q, 1e3 * data.position[:, :2], angle])
    (folder / "run.yaml").write_text(SIDECAR, encoding="utf-8")
    np.savetxt(folder / "run.csv", table, delimiter=",", fmt="%.12g", comments="",
               header="pose,q_leg1,q_leg2,q_leg3,x,y,rz")
    return ppmcal.read_data(stage, folder / "run.csv")[0]


def check(stage: Mechanism, data: Dataset):
    return noise_check(identify(Problem(stage, (data,), stage.free), FitOptions()))


def test_approaches_from_both_sides_are_no_repeats_of_each_other(stage: Mechanism) -> None:
    """Backlash of three sigma is left by a model without it; it is no noise."""
    backlash = [{"kind": "backlash", "on": ["leg1", "leg2", "leg3"], "parameters": {"width": 0.06}}]
    data = ppmcal.simulate(stage, scenario(3, approach="both", repeats=2, effects=backlash)).data[0]
    found = check(stage, data)
    assert found.failed and found.repeat_degrees == 30 * 2 * 3
    assert found.repeat_ratio == pytest.approx(1.0, abs=0.15)
    assert found.unexplained > 0.8


@pytest.mark.parametrize("name", ["payload", "temperature", "vel_leg1", "dir_x"])
def test_rows_under_other_conditions_are_no_repeats(stage: Mechanism, name: str) -> None:
    data = ppmcal.simulate(stage, scenario(4, repeats=4)).data[0]
    values = np.tile([1.0, 1.0, -1.0, -1.0], 30)
    other = replace(data, columns={name: values}, approach="columns")
    assert np.unique(repeats(other)).size == 60
    # the time of day is no condition
    assert np.unique(repeats(replace(data, columns={"time": np.arange(120.0)}))).size == 30
    assert np.unique(repeats(replace(data, sessions=("a", "b") * 60))).size == 60


def test_diagnosis_and_noise_check_take_the_same_rows_for_repeats(stage: Mechanism) -> None:
    data = ppmcal.simulate(stage, scenario(5, approach="both", repeats=2, conditions={
        "payload": [0, 20]})).data[0]
    fit = identify(Problem(stage, (data,), stage.free), FitOptions(robust=False))
    pure = pure_error(build(fit.problem, fit.state, fit.keep))
    own = noise_check(fit)
    assert pure is not None
    assert (pure.freedom, pure.ratio) == pytest.approx((own.repeat_degrees, own.repeat_ratio))


def test_labels_used_again_for_other_joints_are_a_finding_and_no_repeats(
        stage: Mechanism, tmp_path: Path) -> None:
    """Poses numbered 1 to 10 in each of three series: what the model misses is not noise."""
    curved = [{"kind": "curvature", "on": ["leg1", "leg2", "leg3"],
               "parameters": {"p2": 0.3, "p3": 0.2, "p4": 0.1}}]
    data = ppmcal.simulate(stage, scenario(6, effects=curved)).data[0]
    read = written(stage, data, tmp_path, np.arange(30) % 10 + 1)
    assert np.unique(read.groups).size == 30
    (finding,) = (f for f in read.findings if "column pose" in f)
    assert "10 of 10 labels" in finding and "rows 1 and 11)" in finding
    found = check(stage, read)
    assert found.repeat_ratio is None and found.unexplained > 0.8


def test_equal_joints_are_one_pose_whatever_the_labels(stage: Mechanism, tmp_path: Path) -> None:
    data = ppmcal.simulate(stage, scenario(7, repeats=2)).data[0]
    read = written(stage, data, tmp_path, np.arange(60))
    assert np.array_equal(read.groups, data.groups)
    assert not read.findings


def test_joints_read_back_with_the_drives_noise_are_one_pose(
        stage: Mechanism, tmp_path: Path) -> None:
    data = ppmcal.simulate(stage, scenario(8, repeats=3)).data[0]
    noise = np.random.default_rng(1).normal(scale=2e-6, size=data.q.shape)
    read = written(stage, replace(data, q=data.q + noise), tmp_path, data.groups)
    assert np.array_equal(read.groups, data.groups)
    assert not read.findings


def test_equal_joints_of_touches_are_what_was_measured() -> None:
    """Of touches that come out alike, only those that do would count: no noise would be left."""
    q = np.array([[1.0, 2.0], [3.0, 5.0], [1.0, 2.0], [3.001, 5.0]])
    labels, noise = np.arange(4), np.zeros(2)
    assert commanded_poses(labels, q, (None,), noise, True).tolist() == [0, 1, 2, 3]
    assert commanded_poses(labels, q, (None,), noise, False).tolist() == [0, 1, 0, 2]
    assert commanded_poses(np.array([0, 1, 2, 1]), q, (None,), noise, True).tolist() == [0, 1, 2, 1]


def test_stated_noise_of_the_drives_counts() -> None:
    q = np.array([[0.0], [1.0], [1.01], [2.0]])
    labels = np.array([0, 1, 1, 2])
    assert commanded_poses(labels, q, (), np.zeros(1), False).tolist() == [0, 1, 2, 3]
    assert commanded_poses(labels, q, (), np.array([0.005]), False).tolist() == [0, 1, 1, 2]


def test_poses_are_numbered_in_order_of_appearance() -> None:
    q = np.array([[5.0], [4.0], [9.0], [4.0]])
    assert commanded_poses(np.array([0, 1, 0, 2]), q, (), np.zeros(1), False).tolist() == [
        0, 1, 2, 1]
