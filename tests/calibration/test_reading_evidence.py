"""One score of all ways to read a file: what it counts, and that hidden effects do not decide."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

import ppmcal
from ppmcal.api.inputs import load, shipped
from ppmcal.calibration.mistakes import Mistake
from ppmcal.calibration.problem import Problem
from ppmcal.calibration.read_rightly import found_wrong
from ppmcal.calibration.reading_evidence import Way, best_way, leaves, of_noise
from ppmcal.calibration.readings import FileReading, JointReading, PoseReading
from ppmcal.inference.priors import MISREAD, NONE_MISREAD
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism


def simulated(kind: str, **other: Any) -> tuple[Mechanism, Dataset]:
    text = copy.deepcopy(yaml.safe_load(shipped(kind, True).read_text(encoding="utf-8")))
    machine = load(shipped(kind))
    return machine, ppmcal.simulate(machine, {**text, **other}).data[0]


def gain(before: float, after: float) -> float:
    """Return how far above being told one reading is that lowers what is left."""
    return (of_noise(after) + float(np.log(float(MISREAD))) - of_noise(before)
            + float(np.log(float(NONE_MISREAD))))


def test_coming_to_the_noise_is_told_and_leaving_less_of_an_effect_is_not() -> None:
    assert gain(2.0, 1.0) > 0.0 and gain(500.0, 8.0) > 0.0
    assert gain(6.0, 4.0) < 0.0 and gain(1.2, 1.0) < 0.0


def test_a_factor_on_values_and_what_is_left_cancels() -> None:
    """In another unit all misses are smaller by its factor, and nothing is explained by that."""
    machine, data = simulated("delta-linear")
    plain = JointReading.plain(len(machine.actuators))
    small = FileReading(plain, PoseReading(units=("um",) * 3))
    assert small.volume(data, (0, 1, 2)) == pytest.approx(np.log(1e-3))
    assert small.volume(data, (0, 1, 2, 3, 4, 5)) == pytest.approx(0.5 * np.log(1e-3))
    way = Way(Problem(machine, (small.of(data, machine),), machine.free), (), small, 1.0,
              small.volume(data, (0, 1, 2)))
    assert of_noise(5e4) - of_noise(50.0) == pytest.approx(way.most - np.log(float(MISREAD)))


def test_the_right_reading_is_told_and_beside_a_right_file_none() -> None:
    text = {"center": {"x": 500, "y": 260, "rz": 25}, "half_range": {"x": 70, "y": 70, "rz": 8}}
    machine, data = simulated("3-RPR", poses={"random": {**text, "count": 20}})
    problem = Problem(machine, (data,), machine.free)
    swapped = FileReading(JointReading((1, 0, 2), (1, 1, 1), ("", "", "")))
    wrong = replace(problem, datasets=(swapped.of(data, machine),))
    what = Mistake("permuted", ("q_leg1", "q_leg2"), "exchanged")
    told, as_read = Way(problem, (what,), swapped, 1.2), leaves(wrong)
    best = best_way([told], as_read.score, as_read.times)
    assert best is not None and best[0] is told and best[1].noise < 2.0
    right = leaves(problem)
    assert right.score > -5.0
    assert best_way([replace(told, problem=wrong)], right.score, right.times) is None


@pytest.mark.slow
def test_rows_that_are_late_on_a_machine_with_play_are_no_other_machine() -> None:
    """The fit takes both for a geometry tens of tolerances away."""
    machine, data = simulated("delta-linear", seed=1090, approach="both", effects=[
        {"kind": "backlash", "on": ["a"], "parameters": {"width": 0.2}}])
    late = np.arange(len(data) - 1)
    data = replace(data.take(late + 1), position=data.position[late],
                   rotation=data.rotation[late], whole=None, place=None)
    _, found = found_wrong(Problem(machine, (data,), machine.free))
    assert [m.kind for f in found for m in f.mistakes] == ["shifted"]


@pytest.mark.slow
def test_what_lets_a_fit_of_another_machine_go_a_little_less_astray_is_no_misreading() -> None:
    """Fifteen tolerances away cost what another machine does, with the body turned or not."""
    machine, data = simulated("6-UPS", seed=2091, errors={"random": {"scale": 25.0}})
    _, found = found_wrong(Problem(machine, (data,), machine.free))
    assert [m.kind for f in found for m in f.mistakes] == ["other-machine"]
