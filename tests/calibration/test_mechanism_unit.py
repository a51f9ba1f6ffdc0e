"""A mechanism file in another unit than its numbers are: the unit is named, not the columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import machine, measured, wide

import ppmcal as package
from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation import InterpretationError, refuse_before_fit
from ppmcal.model.scaled_points import scaled_lengths


@pytest.mark.parametrize(("unit", "words"), [
    ("in", "is 25.4 times larger than the one that was measured: its lengths seem to be in mm, "
           "not in inches"),
    ("cm", "is 10 times larger than the one that was measured: its lengths seem to be in mm, not "
           "in cm")])
def test_the_unit_of_the_mechanism_file_is_named(tmp_path: Path, unit: str, words: str) -> None:
    machine(tmp_path)
    wide(tmp_path, measured(3, names=["T1"]))
    bench = tmp_path / "bench.yaml"
    bench.write_text(bench.read_text().replace("length: mm", f"length: {unit}"))
    mechanism = package.load(bench)
    data = tuple(package.read_data(mechanism, tmp_path / "wide.csv"))
    with pytest.raises(InterpretationError) as told:
        refuse_before_fit(Problem(mechanism, data, mechanism.free))
    assert words in told.value.what
    assert told.value.hint.startswith("Correct `units: {length: ...}` in the mechanism file")


def test_a_scaled_machine_is_the_file_read_in_the_other_unit(tmp_path: Path) -> None:
    machine(tmp_path)
    bench = tmp_path / "bench.yaml"
    metric = package.load(bench)
    bench.write_text(bench.read_text().replace("length: mm", "length: in"))
    scaled, read = scaled_lengths(metric, 25.4), package.load(bench)
    for one, other in zip(scaled.parameters, read.parameters, strict=True):
        assert one.nominal == pytest.approx(other.nominal)
        assert one.tolerance == pytest.approx(other.tolerance)
    np.testing.assert_allclose(scaled.home_pose, read.home_pose)
