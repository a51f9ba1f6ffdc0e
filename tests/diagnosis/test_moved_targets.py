"""One of several targets on the platform that moves in mid-run is named, with its row."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.bodies import MARKS, Seen, long, machine, measured, several, wide
from helpers.commands import number, ppmcal, rows

import ppmcal as package
from ppmcal.calibration.fit.problem import Problem
from ppmcal.commands.inputs import prepared
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.linear_system import build
from ppmcal.io.campaign import joined
from ppmcal.model.effects import EffectKind, find_effect
from ppmcal.model.mechanism import Given, with_effect
from ppmcal.notes import FINDING, NOTE

STEP, ROW = (0.05, -0.04), 21
FORMS = {"wide": wide, "long": long, "several": several}


def diagnosed(folder: Path, seen: Seen, form: str = "wide", joint: float = 0.0) -> dict[str, Any]:
    machine(folder)
    paths = FORMS[form](folder, seen, joint=joint)    # type: ignore[operator]
    run = ppmcal("diagnose", "bench.yaml", *([paths] if isinstance(paths, Path) else paths),
                 "--out", "d", cwd=folder)
    assert run.code in (0, 1), run.err
    found: dict[str, Any] = json.loads((folder / "d" / "diagnosis.json").read_text())
    return found


def moved(seen: Seen, names: Mapping[str, tuple[float, float]], row: int = ROW) -> Seen:
    """Return a campaign some of whose marks are seen displaced, in the measuring frame."""
    after = (np.arange(len(seen.q)) >= row - 1)[:, None]
    return replace(seen, marks={n: m + after * np.array(names.get(n, (0.0, 0.0)))
                                for n, m in seen.marks.items()})


@pytest.mark.long
@pytest.mark.parametrize(("name", "form", "joint"), [
    ("T2", "wide", 0.0), ("T1", "long", 0.0), ("T3", "several", 0.0), ("T2", "wide", 0.02)])
def test_the_target_that_moved_is_named_with_its_row(tmp_path: Path, name: str, form: str,
                                                     joint: float) -> None:
    seen = measured(11, joint=joint, moved={name: (ROW, STEP)})
    found = diagnosed(tmp_path, seen, form, joint)
    assert found["verdict"] == "named"
    (only,) = found["effects"]
    dataset, first = f"body {name}", ROW
    if form == "long":    # a row for each target
        first = 3 * (ROW - 1) + 1 + list(MARKS).index(name)
    assert only["kind"] == "target_shift" and only["label"] == f"target_shift of {dataset}"
    assert only["row"]["dataset"] == dataset
    assert only["row"]["low"] <= first <= only["row"]["high"]
    assert only["row"]["high"] - only["row"]["low"] < 6
    for axis, step in zip("xy", STEP, strict=True):
        size = only["parameters"][axis]
        assert abs(size["value"] - step) < 4.0 * size["sigma"] < abs(step)
    assert f"target_shift of {dataset}" in (tmp_path / "d" / "effects.csv").read_text()
    (effect,) = yaml.safe_load((tmp_path / "d" / "model.yaml").read_text())["effects"]
    assert effect["target"] == dataset


@pytest.mark.long
def test_what_moves_all_targets_is_not_called_one_of_them(tmp_path: Path) -> None:
    """The base, the whole body, and a drive whose zero moved."""
    plain = measured(11)
    zero = plain.q + 0.05 * (np.arange(len(plain.q)) >= ROW - 1)[:, None] * np.array([0, 1, 0])
    cases = {
        "base_shift": moved(plain, dict.fromkeys(MARKS, STEP)),
        "target_shift": measured(11, moved=dict.fromkeys(MARKS, (ROW, STEP))),
        "zero_shift": replace(plain, q=zero)}
    for kind, seen in cases.items():
        folder = tmp_path / kind
        folder.mkdir()
        (only,) = diagnosed(folder, seen)["effects"]
        assert only["label"] == kind, kind
        assert only["row"]["low"] <= ROW <= only["row"]["high"], kind


@pytest.mark.long
def test_of_two_targets_either_may_have_moved(tmp_path: Path) -> None:
    """Against a third nothing tells which: what is named says that it may be the other one."""
    seen = measured(11, names=("T1", "T2"), moved={"T2": (ROW, STEP)})
    found = diagnosed(tmp_path, seen)
    (only,) = found["effects"]
    assert "target_shift of body T2" in (only["label"], *only["alternatives"])


def one_target(folder: Path, joint: float) -> tuple[Problem, EffectKind]:
    bench = package.load(machine(folder)).with_free(["*.offset"])
    data = package.read_data(bench, wide(folder, measured(5, rows=12, joint=0.05), joint=joint))
    made = find_effect("target_shift").of_target
    assert made is not None
    return Problem(bench, data, bench.free), made("body T2")


@pytest.mark.parametrize("joint", [0.0, 0.05])
def test_columns_are_what_the_step_does(tmp_path: Path, joint: float) -> None:
    """Also to rows of other targets, which are white given those of this one."""
    problem, kind = one_target(tmp_path, joint)
    state, keep = problem.start(), [np.ones(12, dtype=bool)] * 3
    system = build(problem, state, keep)
    on, values = np.ones(3, dtype=bool), {"x": 0.0, "y": 0.0, "from_row": 5.0}
    column = system.column([kind.evaluate(p.setting, on, values).by["x"] for p in system.parts])
    size = 1e-4
    with_step = with_effect(problem.mechanism, kind, (True,) * 3,
                            {"x": Given(size), "from_row": Given(5.0)})
    other = problem.changed(mechanism=with_step)
    before = list(problem.rows(state, True, keep))
    after = list(other.rows(replace(state, g=with_step.values), True, keep))
    for n, (one, two) in enumerate(zip(before, after, strict=True)):
        change = one.residual - one.whitened(two.raw, [c.raw for c in two.companions])
        np.testing.assert_allclose(column[system.parts[n].at], change / size,
                                   atol=1e-6 * np.abs(column).max())
        moves = np.abs(change).max(axis=1) > 1e-9
        later = np.arange(12) >= 4
        assert (moves == (later & (n == 1 or (n > 1 and joint > 0.0)))).all()


@pytest.mark.slow
def test_commands_for_a_target_are_for_where_it_is_in_the_end(tmp_path: Path) -> None:
    machine(tmp_path)
    content = yaml.safe_load((tmp_path / "bench.yaml").read_text())
    content["effects"] = [{"kind": "target_shift", "target": "run T2",
                           "parameters": {"x": 3.0, "y": -2.0, "from_row": 7}}]
    content["measurement"] = {"datasets": {
        f"run {n}": {"frame": {"x": 0, "y": 0, "rz": 0}, "target": at}
        for n, at in (("T1", [40, -15]), ("T2", [-65, 30]), ("T2 there", [-62, 28]))}}
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    (tmp_path / "t.csv").write_text("x,y,rz\n520,280,5\n480,300,8\n")

    def sent(name: str) -> list[list[float]]:
        run = ppmcal("compensate", "model.yaml", "t.csv", "--frame", name, "--out", "c",
                     "--overwrite", cwd=tmp_path)
        assert run.code in (0, 1), run.err
        return [[number(r, f"q_leg{i}") for i in (1, 2, 3)]
                for r in rows(tmp_path / "c" / "commands.csv")]

    np.testing.assert_allclose(sent("run T2"), sent("run T2 there"), rtol=0.0, atol=1e-9)
    still = sent("run T1")
    content["effects"] = []
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    np.testing.assert_allclose(sent("run T1"), still, rtol=0.0, atol=1e-9)


def test_a_target_without_a_name_is_refused(tmp_path: Path) -> None:
    machine(tmp_path)
    content = yaml.safe_load((tmp_path / "bench.yaml").read_text())
    content["effects"] = [{"kind": "target_shift", "target": [1, 2],
                           "parameters": {"x": 3.0, "from_row": 7}}]
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    run = ppmcal("check", "model.yaml", cwd=tmp_path)
    assert run.code == 2
    assert "effects[1].target" in run.err and "not the name of a target" in run.err


@pytest.mark.parametrize(("name", "free", "level"), [
    ("body T9", True, FINDING), ("body T9", False, NOTE), ("body T2", True, None)])
def test_an_effect_of_a_target_that_nobody_measured_is_told(tmp_path: Path, name: str, free: bool,
                                                            level: str | None) -> None:
    """One to be fitted is a mistake; of another session's target a model may well know."""
    content = yaml.safe_load(machine(tmp_path).read_text())
    content["effects"] = [{"kind": "target_shift", "target": name, "parameters": {
        "x": {"value": 0.0, "free": free}, "from_row": 7}}]
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(content))
    known, _ = prepared(tmp_path / "bench.yaml", wide(tmp_path, measured(3)), ())
    told = [f for f in known.findings if "effects[1].target" in f]
    assert [f.level for f in told] == ([] if level is None else [level])
    assert all("Did you mean 'body T" in f for f in told)


def test_a_single_point_that_moved_has_no_turns_and_its_own_row(tmp_path: Path) -> None:
    """How one reflector turns does not show, and no turn stands in for a step of a later row."""
    far = 6.0 * np.array(STEP)
    seen = measured(11, names=("T2",), moved={"T2": (ROW, far)})
    found = diagnosed(tmp_path, seen)
    (only,) = found["effects"]
    assert only["kind"] == "target_shift" and set(only["parameters"]) == {"x", "y", "from_row"}
    assert only["row"]["low"] == ROW == only["row"]["high"]
    for axis, step in zip("xy", far, strict=True):
        size = only["parameters"][axis]
        assert abs(size["value"] - step) < 4.0 * size["sigma"] < abs(step)
    assert found["residual"]["after"]["position"]["rms"] < 1.2 * np.hypot(0.01, 0.01)


def test_a_point_of_another_day_tells_no_turns_of_this_one(tmp_path: Path) -> None:
    """Each day has its own mark: together they are no body of which turns would show."""
    bench = package.load(machine(tmp_path)).with_free(["*.offset"])
    days = [one for n, mark in enumerate(("T2", "T1")) for one in package.read_data(
        bench, wide(tmp_path, measured(5 + n, rows=12, names=(mark,))))]
    days = [replace(one, name=f"day {n}", campaign="") for n, one in enumerate(days)]
    problem = Problem(bench, days, bench.free)
    system = build(problem, problem.start(), [np.ones(12, dtype=bool)] * 2)
    (found,) = {h.names for h in library(system, ["target_shift"]).hypotheses}
    assert found == ("x", "y")


def test_what_each_day_has_free_anyway_is_no_candidate(tmp_path: Path) -> None:
    """With a day's first row its frame and marks are unknown, and after it there are none."""
    bench = package.load(machine(tmp_path))
    days = []
    for n in (0, 1):
        files = wide(tmp_path, measured(5 + n, rows=12))
        for d in package.read_data(bench, files):
            name = f"day {n} {d.mark}"
            frame = replace(d.frame, same_as=d.frame.same_as and f"day {n} T1")
            days.append(replace(d, name=name, body=f"day {n}", frame=frame))
    problem = Problem(bench, joined(days), bench.free)
    system = build(problem, problem.start(), [np.ones(12, dtype=bool)] * 6)
    found = library(system, ["base_shift", "target_shift", "zero_shift"])
    assert {h.kind for h in found.hypotheses if h.begins} == {"zero_shift"}
    assert {u.kind for u in found.untestable} == {"base_shift between sessions",
                                                  "target_shift between sessions"}
    steps = [h.constants["from_row"] for h in found.hypotheses
             if h.family == "target_shift of day 0 T2"]
    assert steps and max(steps) <= 12
    assert max(h.constants["from_row"] for h in found.hypotheses) > 12
