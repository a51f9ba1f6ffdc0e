"""Exports are commands too: not from a model that misses its data, not beyond what was measured."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.paths import ROOT

import ppmcal
from ppmcal.controllers.delta.geometry import ANGLES, DeltaGeometry
from ppmcal.controllers.joints.tables import joint_tables, known_commands
from ppmcal.controllers.klipper.controller import refuse_endstops
from ppmcal.controllers.pose_grid import default_grid
from ppmcal.errors import NoResult
from ppmcal.io.effects import with_effects
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import SI


@cache
def machine(name: str) -> Mechanism:
    mechanism = ppmcal.load(ROOT / "configs" / f"{name}.yaml")
    g = mechanism.values.copy()
    rng = np.random.default_rng(1)
    for i in mechanism.free:
        g[i] += (mechanism.parameters[i].tolerance or 0.0) * rng.standard_normal()
    return mechanism.with_values(g)


@pytest.mark.slow
def test_a_grid_ends_where_the_measurements_end() -> None:
    mechanism = machine("3-RPR")
    whole = default_grid(mechanism)
    middle = np.array([level.mean() for level in whole.levels])
    ends = {name: (float(m - 0.02), float(m + 0.02)) for name, m in zip(
        ("x", "y"), middle, strict=False)}
    seen = replace(mechanism, measured=MeasurementBasis(1.0, 0.5, ends))
    grid = default_grid(seen)
    for name, level, old in zip(grid.names, grid.levels, whole.levels, strict=True):
        if name in ends:
            assert (level[0], level[-1]) == pytest.approx(ends[name])
        else:
            np.testing.assert_allclose(level, old)
    found = ppmcal.export("grid", seen)
    assert any("ends where the measurements of x, y do" in n for n in found.record.notes)
    assert found.record.left_out == {}


def test_a_listed_pose_far_outside_what_was_measured_has_no_command(tmp_path) -> None:
    mechanism = replace(machine("3-RPR"), measured=MeasurementBasis(1.0, 0.5, {
        "x": (0.49, 0.51), "y": (0.28, 0.3)}))
    (tmp_path / "p.csv").write_text("x,y,rz\n500,290,30\n505,285,31\n560,290,30\n")
    found = ppmcal.export("grid", mechanism, poses=tmp_path / "p.csv")
    assert found.record.rows == 2
    assert found.record.left_out == {"far outside the measured volume": 1}
    assert found.has_findings


@pytest.mark.slow
def test_joint_tables_end_a_little_beyond_the_measured_joints() -> None:
    """A polynomial runs off outside; LinuxCNC keeps the last value there."""
    mechanism = with_effects(machine("3-RPR"), [{"kind": "curvature", "on": ["leg2"], "parameters":
                                                 {"p2": 1e-4, "p3": -2e-4, "p4": 3e-4}}],
                             SI, "test")
    low, high = mechanism.limits[1]
    seen = replace(mechanism, measured=MeasurementBasis(1.0, 0.5, {
        f"q_{a}": (float(low + 0.1), float(high - 0.1)) for a in mechanism.actuators}))
    width = high - low - 0.2
    np.testing.assert_allclose(known_commands(seen)[1], [
        low + 0.1 - 0.1 * width, high - 0.1 + 0.1 * width])
    assert np.isinf(known_commands(seen)[0]).all(), "a joint without effects has a straight table"
    tables = {t.actuator: np.array(t.table.nominal) * t.factor for t in joint_tables(seen)}
    assert tables["leg2"][0] > low + 0.03 and tables["leg2"][-1] < high - 0.03
    assert tables["leg1"][[0, -1]] == pytest.approx(mechanism.limits[0])
    notes = ppmcal.export("joints", seen).record.notes
    assert any("the table of leg2 ends at" in n for n in notes)


@pytest.mark.slow
def test_numbers_that_are_worse_than_the_old_ones_are_refused(tmp_path, monkeypatch) -> None:
    """What the format cannot hold costs more than what it mends."""
    from ppmcal.commands.export import run as work
    from ppmcal.controllers import loaded

    class Worse:
        def export(self, mechanism, old, poses):
            made = loaded("grid").export(mechanism, old, poses)
            return replace(made, before=made.after, after=made.before)

    monkeypatch.setattr(work, "loaded", lambda name: Worse())
    with pytest.raises(NoResult, match=r"worse than the old ones.*--regardless"):
        ppmcal.export("grid", machine("3-RPR"))
    forced = ppmcal.export("grid", machine("3-RPR"), regardless=True)
    assert any("worse than the old ones" in f for f in forced.findings)


def test_endstops_at_the_bed_are_refused() -> None:
    for ends in ((290.0, 289.0, 291.0), (290.0, 0.0, 291.0)):
        with pytest.raises(NoResult, match="stepper_b") if 0.0 in ends else nullcontext():
            refuse_endstops(DeltaGeometry(140.0, ANGLES, (300.0,) * 3, ends), "printer")
