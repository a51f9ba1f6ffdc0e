"""Campaigns that cannot tell what is asked of them: each ends with a reason, or says so."""

from functools import cache

import numpy as np
import pytest
from helpers import machines

import ppmcal
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.tables import pose_vector


@cache
def machine(name):
    return ppmcal.load(ppmcal.shipped(name))


def campaign(name, kind, rows, noise=0.01, seed=0, **sidecar):
    """Return data sets of a machine as built, joints about home, ``noise`` in mm and degrees."""
    own, rng = machine(name), np.random.default_rng(seed)
    model = Model(own)
    q = home_state(own).q + 3.0 * machines.joint_steps(model) * rng.uniform(
        -1, 1, (rows, len(own.actuators)))
    pose = pose_vector(forward(model, q).pose) * ([1e3] * 3 + [180 / np.pi] * 3)
    pose += noise * rng.standard_normal(pose.shape)
    table = {f"q_{a}": 1e3 * q[:, i] for i, a in enumerate(own.actuators)}
    if kind == "distance":
        table["distance"] = np.linalg.norm(pose[:, :3], axis=1)
    elif kind == "plane":
        table["height"] = pose[:, 2]
    else:
        table |= {c: pose[:, "xyz".index(c)] for c in "xyz" if c in own.coordinates}
    sigma = {{"plane": "height"}.get(kind, kind): 0.01, **sidecar.pop("sigma", {})}
    instrument = {"kind": kind, "sigma": sigma}
    if kind == "distance":
        instrument["point"] = [0.0, 0.0, 0.0]
    return ppmcal.read_data(own, table, sidecar={
        "units": {"length": "mm", "angle": "deg"}, "instrument": instrument, "frame": "known",
        "target": "known", **sidecar})


@pytest.mark.slow
@pytest.mark.parametrize("rows", [3, 4])
@pytest.mark.parametrize(("name", "kind"), [
    ("3-RPR", "distance"), ("delta-linear", "distance"), ("delta-linear", "plane")])
def test_values_that_geometry_always_explains_show_no_missing_effect(name, kind, rows):
    with pytest.raises(ppmcal.NoResult, match=f"fits any {rows} values of this kind exactly"):
        ppmcal.diagnose(machine(name), campaign(name, kind, rows))


def test_six_positions_are_a_validation():
    found = ppmcal.validate(machine("6-UPS"), campaign("6-UPS", "position", 6))
    assert found.record.datasets


@pytest.mark.slow_cases("False-0.01-0", "False-1.0-1")
@pytest.mark.parametrize(("noise", "told"), [(0.01, 0), (1.0, 1)])
@pytest.mark.parametrize("marked", [True, False])
def test_what_does_not_fit_is_not_silently_noise(noise, told, marked):
    """An estimate takes all that is left for noise: beyond what tolerances do, that is said."""
    data = campaign("3-RPR", "position", 12, noise, sigma={"estimated": marked})
    found = ppmcal.identify(machine("3-RPR"), data, sigma="stated" if marked else "estimated")
    assert sum("carry no information about the machine" in f for f in found.findings) == told


@pytest.mark.slow
def test_diagnose_says_it_too():
    data = campaign("3-RPR", "position", 12, 1.0, sigma={"estimated": True})
    found = ppmcal.diagnose(machine("3-RPR"), data)
    assert any("carry no information about the machine" in f for f in found.findings)
