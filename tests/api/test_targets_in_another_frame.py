"""Targets that are in an instrument's frame and were asked for in base axes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import machine

import ppmcal as package
from ppmcal.model.registration import Registration


@pytest.mark.parametrize(("frame", "told"), [("base", 1), ("camera", 0)])
def test_the_frame_in_which_targets_can_be_reached_is_named(
        tmp_path: Path, frame: str, told: int) -> None:
    machine(tmp_path)
    far = np.array([9.0, -4.0, 0.0, 0.0, 0.0, 0.0])
    bench = replace(package.load(tmp_path / "bench.yaml"), registrations={
        "camera": Registration.of_pose(far, np.zeros(3))})
    goals = tmp_path / "goals.csv"
    goals.write_text("x,y,rz\n9500,-3710,5\n9510,-3700,4\n")
    found = package.compensate(bench, goals, frame=frame)
    notes = [n for n in found.notes if "2 targets can in that of camera: --frame 'camera'?" in n]
    assert len(notes) == told
