"""Campaigns that cannot tell what they are fitted for, and what is left of hardly any freedom."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import ppmcal
from ppmcal.calibration.fit.campaign import HALF, grouped
from ppmcal.calibration.fit.fit_result import posterior
from ppmcal.commands.identify.result import IdentificationResult
from ppmcal.commands.inputs import load, read_data, shipped
from ppmcal.model.dataset import Dataset


def scenario(kind: str, **other: Any) -> dict[str, Any]:
    base: dict[str, Any] = yaml.safe_load(shipped(kind, True).read_text(encoding="utf-8"))
    return {**copy.deepcopy(base), **other}


def delta(half_z: float, count: int = 40) -> dict[str, Any]:
    return scenario("delta-linear", poses={"random": {
        "center": {"x": 0, "y": 0, "z": 100}, "half_range": {"x": 50, "y": 50, "z": half_z},
        "count": count}})


def campaign(text: dict[str, Any], kind: str = "delta-linear") -> tuple[Dataset, ...]:
    return ppmcal.simulate(load(shipped(kind)), text).data


@pytest.fixture(scope="module")
def flat() -> IdentificationResult:
    """A delta measured in a plane."""
    return ppmcal.identify(shipped("delta-linear"), campaign(delta(0.0)))


@pytest.mark.slow
def test_a_plane_asks_for_poses_outside_it(flat: IdentificationResult) -> None:
    found = flat.record.campaign
    assert found is not None
    assert "these poses lie in a plane" in found.shapes
    assert found.unknown == ("rod",)
    assert 0 < found.poses <= 10
    assert "next.csv" in flat.files()
    assert not any(found.text in f for f in flat.findings)    # a campaign is no fault: exit code 0


@pytest.mark.slow
def test_poses_all_over_ask_for_nothing() -> None:
    result = ppmcal.identify(shipped("delta-linear"), campaign(delta(80.0)))
    assert result.record.campaign is None
    assert "next.csv" not in result.files()


@pytest.mark.slow
def test_the_missing_poses_tell(flat: IdentificationResult, tmp_path: Path) -> None:
    """What was unknown is known to half its tolerance once they are measured."""
    def open_part(result: IdentificationResult) -> float:
        fit = result.identification.fit
        column = fit.problem.columns.index("rod")
        return float(np.sqrt(posterior(fit)[column, column]) / fit.scale[column])

    path = tmp_path / "next.csv"
    path.write_bytes(bytes(str(flat.files()["next.csv"]), "utf-8"))
    more = scenario("delta-linear", poses={"file": str(path)}, seed=5)
    both = (*campaign(delta(0.0)), replace(campaign(more)[0], name="more"))
    assert open_part(flat) > HALF
    assert open_part(ppmcal.identify(shipped("delta-linear"), both)) <= 1.1 * HALF


def test_names_in_groups() -> None:
    machine = load(shipped("6-UPS"))
    free = [machine.names[p] for p in machine.free]
    z = [n for n in free if n.endswith("point.z")]
    assert grouped(machine, z, free) == ("z of every base.point and platform.point",)
    assert grouped(machine, z[:1], free) == ("z of base.point (leg1)",)


@pytest.mark.slow
def test_frames_only_leaves_effects_alone() -> None:
    machine = yaml.safe_load(shipped("delta-linear").read_text(encoding="utf-8"))
    machine["effects"] = [{"kind": "gain", "on": ["a"], "parameters": {
        "gain": {"value": 0.001, "free": True}}}]
    model = load(machine)
    assert any(model.parameters[p].free for p in model.free)
    result = ppmcal.identify(model, campaign(delta(80.0)), free="none")
    fit = result.identification.fit
    assert fit.problem.free == ()
    np.testing.assert_array_equal(fit.state.g, model.values)


def touches(tmp_path: Path, wave: int) -> Dataset:
    """Seven touches of a flat, six of them about the middle, with a wave in the heights."""
    machine = load(shipped("delta-linear"))
    angle = np.radians(60.0) * np.arange(6)
    place = np.c_[np.r_[0.0, 60.0 * np.cos(angle)], np.r_[0.0, 60.0 * np.sin(angle)],
                  np.full(7, 60.0)]
    path = tmp_path / "poses.csv"
    np.savetxt(path, place, delimiter=",", header="x,y,z", comments="")
    text = scenario("delta-linear", poses={"file": str(path)}, errors={})
    del text["frame"]
    shown = ppmcal.simulate(machine, text).to_frame()
    height = 60.0 + np.r_[0.0, 0.4 * np.cos(wave * angle)]
    table = {n: shown[n] for n in ("q_a", "q_b", "q_c")} | {"height": height}
    return read_data(machine, table, sidecar={
        "units": {"length": "mm", "angle": "deg"}, "frame": "known", "target": "known",
        "instrument": {"kind": "plane", "sigma": {"height": 0.02}}})[0]


@pytest.mark.slow
def test_the_pattern_of_the_one_degree_that_is_left(tmp_path: Path) -> None:
    text = yaml.safe_load(shipped("delta-linear").read_text(encoding="utf-8"))
    text["free"] = ["*.offset", "tower_radius", "a.base.point.angle", "b.base.point.angle"]
    result = ppmcal.identify(load(text), touches(tmp_path, 3), holdout=0.0)
    (said,) = [f for f in result.findings if "freedom" in f]
    assert "1 degree of freedom is left" in said
    assert "3-theta pattern" in said
    assert "base.direction.rx" in said
    assert "more touches would decide" in said


@pytest.mark.slow
def test_flat_short_and_few_name_nothing() -> None:
    flat = ppmcal.diagnose(shipped("delta-linear"), campaign(delta(0.0)))
    assert not flat.diagnosis.effects
    assert flat.record.campaign is not None
    assert flat.record.next_file == "next.csv"


@pytest.mark.long
def test_few_poses_are_no_ground_for_a_part_of_a_name() -> None:
    """Six poses and a strong backlash: names that leave something are made of what they leave."""
    text = scenario("delta-linear", approach="both", seed=1, effects=[
        {"kind": "backlash", "on": ["a"], "parameters": {"width": 30.0 * float(
            scenario("delta-linear")["instrument"]["sigma"]["position"])}}],
        poses={"random": delta(80.0)["poses"]["random"] | {"count": 6}})
    found = ppmcal.diagnose(shipped("delta-linear"), campaign(text))
    assert {e.kind for e in found.diagnosis.effects} <= {"backlash"}
    assert found.verdict in ("unnamed", "named", "named-set")
