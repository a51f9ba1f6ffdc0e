"""A flat's own shape beside errors of a printer: what one bed can tell, and what not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

import ppmcal
from ppmcal.calibration.fit.problem import Problem
from ppmcal.model.effects import effect_kinds
from ppmcal.model.motions import TRANSLATIONAL


@pytest.fixture(scope="module")
def printer():
    return ppmcal.load(ppmcal.shipped("delta-linear"))


def touches(printer, seed=5, **more):
    found = ppmcal.simulate(printer, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"grid": {"center": {"x": 0, "y": 0, "z": 1e3 * printer.home_pose[2]},
                           "half_range": {"x": 90, "y": 90, "z": 0},
                           "counts": {"x": 9, "y": 9, "z": 1}}},
        "instrument": {"kind": "plane", "sigma": {"height": 0.01}}, "frame": "known",
        "seed": seed} | more).data
    return [replace(d, frame=replace(d.frame, fitted=True)) for d in found]


def test_touches_have_no_scale(printer):
    """A scale of heights held the very noise that it was to explain: nothing was unnamed."""
    machine = ppmcal.load({**_tree(), "effects": [
        {"kind": "sensor_scale", "parameters": {"scale": {"value": 1e-4, "free": True}}}]})
    problem = Problem(machine, tuple(touches(printer)), machine.free)
    (rows,) = problem.rows(problem.start())
    (column,) = (i for i, name in enumerate(problem.columns) if "scale" in name)
    assert not rows.jacobian[..., column].any()


def _tree():
    return yaml.safe_load(ppmcal.shipped("delta-linear").read_text(encoding="utf-8"))


def test_the_shape_moves_what_is_seen_and_not_the_machine(printer):
    bent = touches(printer, effects=[{"kind": "bed_shape", "parameters": {"bowl": 0.2}}])[0]
    flat = touches(printer)[0]
    np.testing.assert_array_equal(bent.q, flat.q)
    heights = 0.2 * (np.hypot(*np.mgrid[-90:91:22.5, -90:91:22.5]).ravel() / 100.0) ** 2
    lower = 1e3 * (flat.value - bent.value)    # under a hill the flat's height is reached higher up
    assert np.abs(lower[:, None] - heights).min(axis=1).max() < 1e-6
    assert lower.max() > 0.25


@pytest.mark.long
def test_a_leaning_tower_is_found_in_touches_of_a_flat(printer):
    found = ppmcal.diagnose(printer, touches(printer, errors={"a.base.direction.ry": 0.5}))
    assert found.verdict in ("named", "named-set")
    assert [e.parameters for e in found.diagnosis.effects] == [("a.base.direction.ry",)]


@pytest.mark.long
@pytest.mark.parametrize("shape", ["bowl", "saddle", "trefoil_x"])
def test_the_shape_of_the_flat_is_no_leaning_tower(printer, shape):
    """Swallowed by rods and radius, or told as unnamed: never a tower."""
    found = ppmcal.diagnose(printer, touches(printer, effects=[
        {"kind": "bed_shape", "parameters": {shape: 0.15}}]))
    assert found.verdict in ("none", "weak", "unnamed") and not found.diagnosis.effects
    if found.verdict == "unnamed":
        (told,) = found.diagnosis.unknown
        assert "bed_shape" in told.looks_like
        assert "touch" in found.diagnosis.proposal.reason


def _warped(data, size=0.08):
    """Touches of a flat that is bent as no low order says."""
    places = np.unique(data.groups, return_inverse=True)[1]
    x, y = 0.9 * (places // 9 - 4) / 4.0, 0.9 * (places % 9 - 4) / 4.0
    bent = 1e-3 * size * (np.sin(3.3 * x + 0.4) * np.cos(3.9 * y - 0.7) - x**3 * y)
    return replace(data, value=data.value - bent)


@pytest.mark.long
def test_backlash_is_found_on_a_flat_of_any_shape(printer):
    """A flat bent less, and every joint that stays behind: it follows the way, not the place."""
    hidden = {"effects": [{"kind": "backlash", "parameters": {"width": 0.08}}], "approach": "both"}
    found = ppmcal.diagnose(printer, [_warped(d, 0.01) for d in touches(printer, **hidden)])
    assert "backlash" in {e.kind for e in found.diagnosis.effects}


@pytest.mark.long
def test_touches_of_a_good_printer_miss_nothing(printer):
    assert ppmcal.diagnose(printer, touches(printer)).verdict == "none"


@pytest.mark.parametrize("kind", ["leg_thermal", "base_thermal", "platform_thermal"])
def test_what_is_warmed_grows(kind):
    (expansion, *_) = effect_kinds()[kind].parameters(TRANSLATIONAL)
    assert expansion.name == "expansion" and expansion.usual == (0.0, 120e-6)
