"""The machine in a report: where measured rows stand, what is lit, what is not drawn and why."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from helpers import redundant
from helpers.commands import ppmcal
from helpers.paths import ROOT

import ppmcal as face
from ppmcal.io import read_dataset, read_mechanism
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.identification_tables import row_key
from ppmcal.io.results.scene import joint_words
from ppmcal.io.results.scene_rows import FittedRows, placed_rows, spread_rows
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.report.collect import collect
from ppmcal.report.machine_section import machine_section, scene_effects

DAY = """format: ppmcal/scenario/1
units: {length: mm, angle: deg}
poses: {random: {center: {x: 500, y: 288.675, rz: 30}, half_range: {x: 60, y: 60, rz: 8},
                 count: COUNT}}
errors: {random: {scale: 1.0}}
instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}
frame: {x: 150, y: -80, rz: 112}
target: [20, -10]
seed: 7
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a machine that was identified from rows in a turned frame."""
    out = tmp_path_factory.mktemp("machine")
    ppmcal("init", "3-RPR", "--out", "mine.yaml", cwd=out, expect=0)
    (out / "day.yaml").write_text(DAY.replace("COUNT", "30"))
    ppmcal("simulate", "mine.yaml", "day.yaml", "--out", "simulated", cwd=out)
    ppmcal("identify", "mine.yaml", "simulated/measurements.csv", "--out", "fit", cwd=out)
    return out


def only(folder, name="fit"):
    return collect([folder / name]).identified[0]


def rows_of(folder):
    one = only(folder)
    return FittedRows(one.folder, one.record, one.residuals)


def scene_of(html):
    return json.loads(re.search(r'class="scene">(.*?)</script>', html, re.S)[1])


@pytest.mark.slow
def test_points_and_errors_are_the_measured_ones_in_the_base_frame(folder, monkeypatch):
    monkeypatch.chdir(folder)
    one, machine = rows_of(folder), read_mechanism(folder / "fit/identified.yaml")
    rows = placed_rows(one, 4, machine)
    data = read_dataset(folder / "simulated/measurements.csv", machine)
    assert len(rows.points) == 30 and not rows.notes
    registration = machine.registration(data.name)
    turn = np.array([[np.cos(r), -np.sin(r)] for r in [registration.frame_pose[5]]])[0]
    turn = np.array([turn, [-turn[1], turn[0]]])
    f = machine.units.factor("length")
    for n, point in enumerate(rows.points):
        assert point.key == row_key(4, data.name, n + 1)
        # the measured place, taken back from the tracker's frame to the base's
        measured = turn.T @ (data.position[n, :2] - registration.frame_pose[:2]) / f
        np.testing.assert_allclose(np.add(point.point, point.error)[:2], measured, atol=1e-9)
        assert point.value == pytest.approx(np.hypot(*point.error[:2]))
        assert np.hypot(*point.error_before[:2]) == pytest.approx(point.value_before)
    scene = scene_of(machine_section(only(folder), 4))
    assert len(scene["measured"]) == 30 and scene["value"] == "position error"
    own = [m for m in scene["measured"] if m["own"]]
    frames = scene["machines"][0]["frames"]
    assert [frames[m["frame"]]["key"] for m in own] == [m["key"] for m in own]
    assert sorted(scene["order"][-len(own):]) == sorted(m["frame"] for m in own)
    assert [m["name"] for m in scene["machines"]] == ["nominal", "identified"]


@pytest.mark.slow
def test_without_its_file_the_machine_has_no_points_and_says_why(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(folder / "fit", tmp_path / "fit")
    html = machine_section(only(tmp_path), 0)
    assert "measurements.csv is not where it was" in html
    assert len(scene_of(html)["machines"][0]["limbs"]) == 3 and not scene_of(html)["measured"]
    (tmp_path / "simulated").mkdir()
    text = (folder / "simulated/measurements.csv").read_text()
    (tmp_path / "simulated/measurements.csv").write_text(text + "\n")
    shutil.copy(folder / "simulated/measurements.yaml", tmp_path / "simulated/measurements.yaml")
    assert "measurements.csv has changed since" in machine_section(only(tmp_path), 0)
    (tmp_path / "fit/identified.yaml").write_text("format: ppmcal/mechanism/1\n")
    assert "cannot be drawn" in machine_section(only(tmp_path), 0)
    (tmp_path / "fit/identified.yaml").unlink()
    assert machine_section(only(tmp_path), 0) == ""


@pytest.mark.slow
def test_many_rows_are_thinned_and_said(folder, monkeypatch):
    monkeypatch.chdir(folder)
    one, machine = rows_of(folder), read_mechanism(folder / "fit/identified.yaml")
    rows = placed_rows(one, 0, machine, most=12)
    assert len(rows.points) <= 12 and "of 30 rows are drawn" in rows.notes[0]
    whole = placed_rows(one, 0, machine)
    worst = max((p for p in whole.points if p.used), key=lambda p: p.value)
    assert worst.key in [p.key for p in rows.points]


def test_rows_that_are_spread_lie_apart():
    place = np.random.default_rng(1).normal(size=(300, 6))
    chosen, nearest = spread_rows(place, [7, 7, 9], 20)
    assert len(chosen) == 20 and {7, 9} <= set(chosen) and chosen == sorted(chosen)
    for n in range(300):
        away = np.linalg.norm(place[chosen] - place[n], axis=1)
        assert nearest[n] == np.argmin(away)
    assert spread_rows(np.zeros((5, 6)), [], 3)[0] == [0]


def test_effects_are_lit_where_they_sit():
    machine = face.load({
        **__import__("yaml").safe_load((ROOT / "sample_data/hexapod.yaml").read_text()),
        "effects": [{"kind": "backlash", "on": ["leg2", "leg5"], "parameters": {"width": 0.03}},
                    {"kind": "base_thermal", "parameters": {"expansion": 1e-5}},
                    {"kind": "sensor_scale", "parameters": {"scale": 1e-4}},
                    {"kind": "gain", "parameters": {"gain": 1e-4}}]})
    found = {e.name: e for e in scene_effects(machine, None)}
    assert found["backlash on leg2, leg5"].limbs == (1, 4)
    assert found["backlash on leg2, leg5"].text.endswith("width 0.03 mm")
    assert found["base_thermal"].body == "base" and not found["base_thermal"].limbs
    assert not found["sensor_scale"].body and not found["sensor_scale"].limbs
    assert found["gain on all 6 actuators"].limbs == tuple(range(6))
    named = DiagnosisRecord.checked({"effects": [
        {"kind": "backlash", "on": ["leg2", "leg5"], "parameters": {
            "width": {"value": 0.03, "sigma": 0.001, "unit": "mm"}}},
        {"kind": "geometry", "on": [], "parameters": {
            "leg3.lateral": {"value": 0.1, "sigma": 0.01, "unit": "mm"}}}]}, ROOT)
    told = scene_effects(machine, named)
    assert [e.limbs for e in told if "backlash" in e.name] == [(1, 4)]
    assert "± 0.002" in next(e.text for e in told if "backlash" in e.name)
    assert [e.limbs for e in told if "geometry" in e.name] == [(2,)]


def test_a_drive_that_counts_in_its_own_unit_says_how_far_that_goes(tmp_path):
    tree = redundant.belts()
    for limb in tree["limbs"][:2]:
        limb["ratio"] = -37.5
    assert joint_words(redundant.machine(tmp_path, tree)) == (
        *2 * ("units of 37.5\u00a0mm",), "mm", "mm")


@pytest.mark.slow
def test_what_to_measure_next_stands_on_the_machine(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    shutil.copytree(folder / "fit", tmp_path / "fit")
    machine = read_mechanism(folder / "fit/identified.yaml")
    nominal = replace(machine.nominal(), effects=())
    rows = read_dataset(folder / "simulated/measurements.csv", machine).q[[4, 4, 9]]
    names = [f"q_{a}" for a in machine.actuators]
    factors = np.array([f for f, _ in machine.joint_units])
    (tmp_path / "fit/next.csv").write_text("\n".join(
        [",".join([*names, "payload", "approach"])] + [
            ",".join([*map(repr, (q / factors).tolist()), "2.5", "+"]) for q in rows]) + "\n")
    scene = scene_of(machine_section(collect([tmp_path / "fit"]).identified[0], 0))
    found = {f["key"]: f for f in scene["machines"][0]["frames"]
             if f.get("key", "").startswith("next:")}
    assert list(found) == ["next:1", "next:3"]
    assert [f["label"] for f in found.values()] == [
        f"measure next, row {n}, payload 2.5" for n in (1, 3)]
    pose = pose_vector(forward(Model(nominal), rows[[0, 2]]).pose)[:, :2]
    np.testing.assert_allclose([f["origin"][:2] for f in found.values()],
                               pose / machine.units.factor("length"), rtol=1e-6)
    assert any("next.csv" in note for note in scene["notes"])
    assert not any(f.get("key", "").startswith("next:")
                   for f in scene_of(machine_section(only(folder), 0))["machines"][0]["frames"])
