"""Events in mid-run: a zero, the target or the base that moves is named with its row."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import number, ppmcal, rows, write_csv
from helpers.diagnoses import effect, simulate

from ppmcal.commands.inputs import load, shipped
from ppmcal.diagnosis.result import Onset
from ppmcal.io.results.diagnosis_parts import DiagnosedEffect
from ppmcal.io.results.diagnosis_wording import onset
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import effect_terms, final_shift, setting
from ppmcal.kinematics.registration import after_events
from ppmcal.model.dataset import unknown_environment

STEP = {"x": 0.03, "y": -0.04, "rz": 0.004}
HIDDEN: dict[str, list[dict[str, Any]]] = {
    "zero_shift": [effect("zero_shift", ["leg2"], shift=0.04, from_row=31)],
    "target_shift": [effect("target_shift", **STEP, from_row=31)],
    "twice": [effect("zero_shift", ["leg2"], shift=0.04, from_row=17),
              effect("zero_shift", ["leg2"], shift=-0.05, from_row=34)],
}


def diagnosed(folder: Path, name: str) -> dict[str, Any]:
    simulate(folder, "3-RPR", HIDDEN[name])
    run = ppmcal("diagnose", "m.yaml", "s/measurements.csv", "--out", "d",
                 cwd=folder)
    assert run.code in (0, 1), run.err
    found: dict[str, Any] = json.loads((folder / "d" / "diagnosis.json").read_text())
    return found


@pytest.mark.long
def test_an_event_is_named_with_its_row(tmp_path: Path) -> None:
    """Of the target; zeros follow, and how often the base's are named is in docs/rates."""
    found = diagnosed(tmp_path, "target_shift")
    assert found["verdict"] in ("named", "named-set")
    (only,) = found["effects"]
    assert "target_shift" in (only["kind"], *only["alternatives"])
    row = only["row"]
    assert row["low"] <= 31 <= row["high"] and abs(row["value"] - 31) <= 2
    assert row["dataset"] == "s"


@pytest.mark.long
def test_two_events_of_one_joint(tmp_path: Path) -> None:
    """The second takes the first one's place: its size counts from the first zero."""
    found = diagnosed(tmp_path, "twice")
    events = sorted(found["effects"], key=lambda e: e["row"]["value"])
    assert [e["kind"] for e in events] == ["zero_shift", "zero_shift"]
    for event, row, size in zip(events, (17, 34), (0.04, -0.05), strict=True):
        assert abs(event["row"]["value"] - row) <= 2
        assert event["row"]["low"] <= row <= event["row"]["high"]
        assert event["parameters"]["shift"]["value"] == pytest.approx(size, abs=0.005)


@pytest.mark.long
def test_rows_count_in_their_own_file(tmp_path: Path) -> None:
    """The second half of a campaign as a file of its own: the event is in its row 7."""
    simulate(tmp_path, "3-RPR", HIDDEN["zero_shift"])
    table = rows(tmp_path / "s" / "measurements.csv")
    sidecar = yaml.safe_load((tmp_path / "s" / "measurements.yaml").read_text())
    for name, part in (("first", table[:24]), ("second", table[24:])):
        write_csv(tmp_path / f"{name}.csv", part)
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(sidecar | {"name": name}))
    run = ppmcal("diagnose", "m.yaml", "first.csv", "second.csv", "--out", "d",
                 cwd=tmp_path)
    assert run.code in (0, 1), run.err
    found = json.loads((tmp_path / "d" / "diagnosis.json").read_text())
    (only,) = [e for e in found["effects"] if e["kind"] == "zero_shift"]
    shift = only["parameters"]["shift"]
    assert only["on"] == ["leg2"] and abs(shift["value"] - 0.04) < 4.0 * shift["sigma"]
    assert only["row"]["dataset"] == "second" and abs(only["row"]["value"] - 7) <= 2
    assert only["parameters"]["from_row"]["value"] == 24 + only["row"]["value"]


def test_the_row_of_an_event_is_told() -> None:
    wide = DiagnosedEffect(kind="zero_shift", row=Onset(76, 60, 77, "b"))
    assert onset(wide) == "from row 76 of b on (95 %: 60 to 77)"
    sure = wide.changed(row=Onset(7, 7, 7, "b"))
    assert onset(sure) == "from row 7 of b on"
    assert onset(DiagnosedEffect(kind="gain")) == ""


def model(tmp_path: Path, effects: list[dict[str, Any]]) -> Any:
    """Return the planar machine with effects, and a frame of its own."""
    data = yaml.safe_load(shipped("3-RPR").read_text(encoding="utf-8"))
    frame = {"frame": {"x": 10.0, "y": -5.0, "rz": 3.0}, "target": [2.0, 1.0]}
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump(data | {
        "effects": effects, "measurement": {"datasets": {"run": frame}}}))
    return load(path)


def test_an_event_holds_until_the_next_of_its_joint(tmp_path: Path) -> None:
    machine = model(tmp_path, [effect("zero_shift", shift=1.0, from_row=3),
                               effect("zero_shift", ["leg2"], shift=5.0, from_row=6)])
    row = np.array([1.0, 3.0, 5.0, 6.0, np.inf])
    q = np.full((5, 3), np.nan)
    bare = replace(machine, effects=())
    at = setting(Model(bare), replace(unknown_environment(5, 3), row=row), q,
                 np.tile(machine.home, (5, 1)))
    sums = np.sum([[np.broadcast_to(t.shift.slots.get((i, "offset"), 0.0), 5) for i in range(3)]
                   for _, t in effect_terms(machine, machine.values, at)], axis=0) * 1e3
    np.testing.assert_allclose(sums, [[0, 1, 1, 1, 1], [0, 1, 1, 5, 5], [0, 1, 1, 1, 1]])


@pytest.mark.slow
def test_commands_are_for_the_state_after_the_last_event(tmp_path: Path) -> None:
    """A target in the moved frame is the same platform pose as in a frame that says so itself."""
    machine = model(tmp_path, [effect("base_shift", x=4.0, y=-3.0, rz=2.0, from_row=20)])
    now = after_events(machine.registrations["run"], final_shift(machine))
    (tmp_path / "t.csv").write_text("x,y,rz\n520,280,30\n480,300,25\n")
    ppmcal("compensate", "model.yaml", "t.csv", "--out", "a", cwd=tmp_path)
    moved = yaml.safe_load((tmp_path / "model.yaml").read_text())
    pose = now.frame_pose * [1e3, 1e3, 1e3, 1.0, 1.0, 180.0 / np.pi]
    moved["effects"] = []
    moved["measurement"]["datasets"]["run"]["frame"] = {
        "x": float(pose[0]), "y": float(pose[1]), "rz": float(pose[5])}
    (tmp_path / "moved.yaml").write_text(yaml.safe_dump(moved))
    ppmcal("compensate", "moved.yaml", "t.csv", "--out", "b", cwd=tmp_path)
    one, other = ([[number(r, f"q_leg{i}") for i in (1, 2, 3)]
                   for r in rows(tmp_path / f / "commands.csv")] for f in "ab")
    np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-9)
