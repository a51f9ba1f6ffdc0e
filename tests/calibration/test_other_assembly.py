"""Rows measured in another assembly mode are told as that, not as an error of the model."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from helpers.redundant import alone, belts, written

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.gauge import with_gauge
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.interpretation import InterpretationError
from ppmcal.calibration.interpretation.assembly import other_assembly
from ppmcal.calibration.interpretation.read_rightly import misfit
from ppmcal.calibration.sessions.day_noise import with_day_noise
from ppmcal.calibration.validation.frozen_models import FrozenModel, in_other_assembly, validated
from ppmcal.design.assembly_modes import assembly_modes
from ppmcal.io import read_mechanism
from ppmcal.io.results.validation import ValidationRecord
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.model.dataset import Dataset

SIGMA = (1e-5, 1e-5)


def measured(mechanism, mode, seed=3, count=12):
    """Return poses near home, or the mode farthest from home's at the same joint values."""
    model, rng = Model(mechanism), np.random.default_rng(seed)
    size = np.zeros(6)
    size[list(mechanism.dof)] = [0.02 if c < 3 else 0.03 for c in mechanism.dof]
    poses = pose_motor(mechanism.home_pose + size * rng.uniform(-1.0, 1.0, (count, 6)))
    q = inverse(model, poses).q
    if mode == "other":
        found = [assembly_modes(model, row).motors for row in q]
        poses = np.stack([m[np.argmax(np.linalg.norm(m - own, axis=1))]
                          for m, own in zip(found, poses, strict=True)])
    seen = pose_vector(poses)
    for c in set(range(6)) - set(mechanism.dof):
        seen[:, c] = np.nan if mechanism.motion.planar else seen[:, c]
    return Dataset.of_poses("day", q, seen, SIGMA, False)


def judged(mechanism, data):
    """Return the record's data set."""
    days, noise = with_day_noise([mechanism], [data], [])
    found = validated([FrozenModel("model", mechanism)], days, ())
    return ValidationRecord.of_validation(found, noise, "m", mechanism.units, {}, ()).datasets[0]


@pytest.mark.long_cases("3-RPR")
@pytest.mark.parametrize("name", ["3-RPR", "delta-linear"])
@pytest.mark.slow
def test_rows_of_another_assembly_mode_are_no_residuals(name):
    mechanism = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    day = judged(mechanism, measured(mechanism, "other"))
    assert day.elsewhere == day.rows == 12
    assert "the model misses" not in day.model_sentence()
    assert "12 of 12 rows were measured in another assembly mode" in day.model_sentence()
    told = day.misled()
    assert any("set `home`" in f for f in told) and not any("another machine" in f for f in told)
    day = judged(mechanism, measured(mechanism, "own"))
    assert not day.elsewhere and "the model misses by" in day.model_sentence()
    assert not day.misled()


def test_a_machine_that_is_far_off_is_in_no_other_assembly_mode():
    """Marks a fifth of the machine away from where any mode has them."""
    mechanism = read_mechanism(ROOT / "configs" / "3-RPR.yaml")
    data = measured(mechanism, "own")
    far = replace(data, position=data.position + [0.2 * mechanism.length_scale, 0.0, 0.0])
    day = judged(mechanism, far)
    assert not day.elsewhere and "the model misses by" in day.model_sentence()
    assert any("another machine" in f for f in day.misled())


def test_values_typed_wrong_are_no_other_assembly_mode():
    """Off by as much as modes are apart, but where none is."""
    mechanism = read_mechanism(ROOT / "configs" / "3-RPR.yaml")
    data, rng = measured(mechanism, "own"), np.random.default_rng(6)
    wrong = data.position + np.where(np.arange(12)[:, None] < 4,
                                     rng.uniform(-0.6, 0.6, (12, 3)) * [1.0, 1.0, np.nan], 0.0)
    wrong[:, 2] = np.nan
    fit = identify(Problem(mechanism, (replace(data, position=wrong),), ()),
                   FitOptions(method="flat", robust=False))
    assert not in_other_assembly(fit).any()


def encoded(tree, at="left.joint2"):
    """Return rows of a second encoder of a machine whose errors are drawn."""
    made = ppmcal.simulate(tree, {
        "format": "ppmcal/scenario/1", "units": tree["units"], "errors": {"random": {"scale": 1.0}},
        "poses": {"random": {"center": tree["home"]["pose"], "half_range": {"x": 60, "y": 40},
                             "count": 40}},
        "instrument": {"kind": "joint", "at": at, "sigma": {"value": 0.01}}, "seed": 5})
    return replace(made.data[0], name=at)


def five_bar(side=1):
    """Return the file of a five-bar, or its mirror image: home beyond the motors, elbows turned."""
    tree = yaml.safe_load((ROOT / "configs" / "five-bar.yaml").read_text(encoding="utf-8"))
    limbs = [{**limb, "elbow": side * limb["elbow"]} for limb in tree["limbs"]]
    home = {"pose": {"x": 0, "y": 190 * side}}
    return {n: v for n, v in tree.items() if n != "limits"} | {"limbs": limbs, "home": home}


@pytest.mark.slow
def test_encoders_of_a_machine_that_is_assembled_mirrored_are_told_as_that():
    """Not as another machine: the place that is named, and other elbows, are the true file."""
    true, data = read_mechanism(five_bar()), encoded(five_bar())
    with pytest.raises(InterpretationError, match="in another assembly") as refused:
        ppmcal.identify(five_bar(-1), data)
    (fault,) = refused.value.found[0].mistakes
    assert fault.kind == "assembly" and "elbow" in refused.value.hint
    mirrored = read_mechanism(five_bar(-1))
    (found,) = other_assembly(Problem(mirrored, (data,), mirrored.free))
    x, y, left, right = (float(re.search(rf"{name}(?: =)? (-?[\d.]+) ", found.mistakes[0].text)[1])
                         for name in ("x", "y", "left", "right"))
    there = inverse(Model(true), pose_motor(np.array([[x, y, 0, 0, 0, 0]]) * 1e-3)).q[0]
    np.testing.assert_allclose(np.degrees(there), [left, right], atol=0.1)


def test_encoders_that_are_read_rightly_are_of_no_other_assembly():
    machine, data = read_mechanism(five_bar()), encoded(five_bar())
    assert not misfit(Problem(machine, (data,), machine.free)).readings


@pytest.mark.parametrize("strain", [0.0, 5e-4])
def test_the_way_of_home_is_not_another_one(strain, tmp_path):
    """Belts as home has them come to the noise, or near it where they stretch a little."""
    path = written(tmp_path, belts())
    stretch = {"kind": "rope_stretch", "on": ["bl", "br"], "parameters": {"strain": strain}}
    scenario = alone(belts(), {"x": 900, "y": 700}, sigma=0.3, seed=12)
    data = ppmcal.simulate(path, scenario | {"errors": {}, "effects": [stretch]}).data
    machine = with_gauge(read_mechanism(path), data)
    assert not other_assembly(Problem(machine, data, machine.free))
