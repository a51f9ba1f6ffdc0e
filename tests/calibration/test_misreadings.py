"""Files that are read wrongly are named, with the line that mends them; the mend is tried."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.mistakes import (
    MACHINE,
    MISTAKES,
    Row,
    inverse,
    scaled,
    session,
    swapped,
    turned,
)
from scipy.spatial.transform import Rotation
from wild import catalogue

from ppmcal import identify as api_identify
from ppmcal import simulate
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.interpretation import read_rightly
from ppmcal.calibration.interpretation.data_check import check
from ppmcal.calibration.interpretation.interpretation_error import InterpretationError
from ppmcal.calibration.interpretation.limits import LANDS
from ppmcal.calibration.interpretation.obvious_mistakes import plain_mistakes, stale
from ppmcal.calibration.interpretation.read_rightly import (
    misfit,
    other_machine,
    refuse_after_fit,
    refuse_misread,
    refuse_other_machine,
)
from ppmcal.calibration.interpretation.readings import ColumnInterpretation
from ppmcal.calibration.interpretation.score import score
from ppmcal.calibration.interpretation.wrong_rows import wrong_parts, wrong_rows
from ppmcal.calibration.validation.residual_vectors import held_out, residuals
from ppmcal.commands.inputs import load, prepared, read_data, shipped
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.errors import BadInput
from ppmcal.io.results.parts import misreading_entries
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.pose_readings import understood, written
from ppmcal.kinematics.rotations import ORDERS
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

LEGS = tuple(f"q_leg{i}" for i in range(1, 7))
Change = Callable[[list[Row]], None]


def both(*changes: Change) -> Change:
    def change(rows: list[Row]) -> None:
        for one in changes:
            one(rows)
    return change


def permuted(rows: list[Row]) -> None:
    """Each leg in the column of the next one."""
    for row in rows:
        old = [row[n] for n in LEGS]
        row.update(zip(LEGS, [*old[1:], old[0]], strict=True))


def late(rows: list[Row]) -> None:
    """The instrument's columns come two rows late."""
    names = ("x", "y", "z", "rx", "ry", "rz")
    old = [[row[n] for n in names] for row in rows]
    for row, values in zip(rows[2:], old, strict=False):
        row.update(zip(names, values, strict=True))


def exchanged(rows: list[Row]) -> None:
    for row in rows:
        row["x"], row["y"] = row["y"], row["x"]


def euler(order: str) -> Change:
    return lambda rows: turned(rows, lambda r: r.as_euler(order, degrees=True))


WRONG: dict[str, tuple[Change, set[str]]] = {
    **{name: (change, {kind}) for (name, change), kind in zip(MISTAKES.items(), (
        "permuted", "unit", "sign", "rotation", "unit", "inverse", "mirrored", "rotation"),
        strict=True)},
    "every leg in the next one's column": (permuted, {"permuted"}),
    "moving Euler angles": (euler("ZYX"), {"rotation"}),
    "inches in one column": (scaled(("q_leg4",), 1.0 / 25.4), {"unit"}),
    "metres in all joint columns": (scaled(LEGS, 1e-3), {"unit"}),
    "rows late": (late, {"shifted"}),
    "x and y exchanged": (exchanged, {"exchanged"}),
    "inverse rotations only": (lambda rows: turned(
        rows, lambda r: r.inv().as_rotvec(degrees=True)), {"rotation"}),
    "swapped, and Euler angles": (both(swapped, euler("xyz")), {"permuted", "rotation"}),
    "swapped, and one in inches": (both(swapped, scaled(("q_leg5",), 1.0 / 25.4)),
                                   {"permuted", "unit"}),
    "inverse, then metres": (both(inverse, scaled(("x", "y", "z"), 1e-3)), {"inverse", "unit"}),
    "a sign, metres and swapped": (both(scaled(("ry",), -1.0), scaled(("x", "y", "z"), 1e-3),
                                        swapped), {"sign", "unit", "permuted"}),
}
QUICK = {"legs swapped", "Euler angles", "swapped, and one in inches"}


def problem_of(path: Path) -> Problem:
    machine = load(MACHINE)
    return Problem(machine, read_data(machine, path), machine.free)


def mended(path: Path, block: object) -> None:
    """Write the block that was proposed into the sidecar."""
    sidecar = path.with_suffix(".yaml")
    text = yaml.safe_load(sidecar.read_text(encoding="utf-8"))
    sidecar.write_text(yaml.safe_dump({**text, "read": block}), encoding="utf-8")


@pytest.mark.long_cases(
    "a sign, metres and swapped", "legs swapped", "swapped, and Euler angles",
    "swapped, and one in inches", "x and y exchanged", "every leg in the next one's column",
    "metres in all joint columns", "inverse, then metres", "moving Euler angles")
@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow)
                                  for n in WRONG])
def test_a_mistake_is_named_and_its_mend_mends(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    change, kinds = WRONG[name]
    path = session(tmp_path, change)
    seen = []
    monkeypatch.setattr(read_rightly, "misfit", lambda p: seen.append(misfit(p)) or seen[-1])
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(problem_of(path))
    (as_read,), (found,) = seen, refused.value.found
    assert as_read.misread and (name not in MISTAKES or as_read.nominal > 5.0)
    assert {m.kind for m in found.mistakes} == kinds
    mended(path, found.block)
    after = misfit(problem_of(path))
    assert not after.misread and after.nominal < 1.0


@pytest.mark.long
def test_the_mend_of_the_message_can_be_copied(tmp_path: Path) -> None:
    path = session(tmp_path, both(swapped, euler("xyz")))
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(problem_of(path))
    line = re.search(r"`read: (.*)`", refused.value.hint)
    assert line is not None
    mended(path, yaml.safe_load(line[1]))
    assert misfit(problem_of(path)).nominal < 1.0


@pytest.mark.long_cases("in")
@pytest.mark.slow_cases("m")
@pytest.mark.parametrize("unit", ["in", "m"])
def test_sigma_goes_with_the_unit_of_the_whole_file(tmp_path: Path, unit: str) -> None:
    """Values and their sigma in mm under a sidecar that says otherwise: both lines mend it."""
    right = problem_of(session(tmp_path / "right")).datasets[0]
    path = session(tmp_path / "wrong", None, lambda text: text.replace(
        "length: mm", f"length: {unit}"))
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(problem_of(path))
    lines = [yaml.safe_load(line) for line in re.findall(r"`(.*?)`", refused.value.hint)]
    assert [list(line) for line in lines] == [["read"], ["instrument"]]
    mended(path, lines[0]["read"])
    sidecar = path.with_suffix(".yaml")
    text = yaml.safe_load(sidecar.read_text(encoding="utf-8"))
    text["instrument"]["sigma"] |= lines[1]["instrument"]["sigma"]
    sidecar.write_text(yaml.safe_dump(text), encoding="utf-8")
    found = problem_of(path).datasets[0]
    np.testing.assert_allclose(found.position, right.position, rtol=1e-12)
    np.testing.assert_allclose(found.sigma_position, right.sigma_position, rtol=1e-4)
    (entry, *_) = misreading_entries(refused.value.found, refused.value.units)
    assert entry.sigma == lines[1]["instrument"]["sigma"]


@pytest.mark.slow
def test_a_sigma_that_is_right_stays(tmp_path: Path) -> None:
    """Positions in inches, and the tracker's sigma as its maker states it, mm."""
    path = session(tmp_path, scaled(("x", "y", "z"), 1.0 / 25.4))
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(problem_of(path))
    assert [m.sigma for m in refused.value.found] == [{}]
    assert "sigma" not in refused.value.hint


@pytest.mark.long
def test_a_second_mistake_is_added_to_what_the_sidecar_says_already(tmp_path: Path) -> None:
    path = session(tmp_path, both(swapped, scaled(("x", "y", "z"), 1e-3)))
    mended(path, {"units": {"x": "m", "y": "m", "z": "m"}})
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(problem_of(path))
    block = refused.value.found[0].block
    assert block == {"columns": {"q_leg2": "q_leg3", "q_leg3": "q_leg2"},
                     "units": {"x": "m", "y": "m", "z": "m"}}


@pytest.mark.long
@pytest.mark.parametrize(("scale", "end", "word"), [(0.5, "platform", "diameter"),
                                                    (2.0, "base", "radius")])
def test_a_radius_for_a_diameter(tmp_path: Path, scale: float, end: str, word: str) -> None:
    """The machine's file is wrong by a factor 2, not the measurements."""
    content = yaml.safe_load(MACHINE.read_text(encoding="utf-8"))
    for limb in content["limbs"]:
        limb[end]["point"]["radius"] /= scale
    content["home"].pop("q", None)
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(yaml.safe_dump(content), encoding="utf-8")
    machine = load(wrong)
    path = session(tmp_path / "data")
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(Problem(machine, read_data(machine, path), machine.free))
    (found,) = refused.value.found
    assert found.mistakes[0].kind == "radius" and found.block is None
    assert word in str(refused.value)


@pytest.mark.long
def test_another_machines_file_has_no_winner_and_nothing_is_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)

    def another(rows: list[Row]) -> None:
        for row in rows:
            row.update({n: float(v) for n, v in zip(
                ("x", "y", "z"), rng.uniform(-60.0, 60.0, 3), strict=True)})

    done = ppmcal("identify", MACHINE, session(tmp_path, another), "--out", tmp_path / "o",
                  "--json", expect=3)
    said = json.loads(done.out)
    assert "do not fit this machine" in said.pop("reason")
    assert said == {"format": "ppmcal/misread/1", "exit_code": 3, "misreadings": []}
    assert "do not fit this machine" in done.err
    assert not (tmp_path / "o").exists()


# --- what the commands say ------------------------------------------------------------------------

@pytest.mark.long
def test_commands_tell_the_mistakes(tmp_path: Path) -> None:
    path = session(tmp_path, both(swapped, scaled(("x", "y", "z"), 1e-3)))
    checked = json.loads(ppmcal("check", MACHINE, path, "--json", expect=1).out)
    identified = ppmcal("identify", MACHINE, path, "--out", tmp_path / "i", "--json", expect=3)
    diagnosed = ppmcal("diagnose", MACHINE, path, "--out", tmp_path / "d", expect=3)
    assert not (tmp_path / "i").exists()
    assert [p.name for p in (tmp_path / "d").glob("*.*") if not p.name.startswith(".")] == [
        "diagnosis.json"]
    record = json.loads((tmp_path / "d" / "diagnosis.json").read_text(encoding="utf-8"))
    assert record["verdict"] == "misread" and record["effects"] == []
    entries = record["misreadings"]
    assert entries == checked["misreadings"] == json.loads(identified.out)["misreadings"]
    assert [e["kind"] for e in entries] == ["permuted", "unit"]
    for entry in entries:
        assert entry["read"] == {"columns": {"q_leg2": "q_leg3", "q_leg3": "q_leg2"},
                                 "units": {"x": "m", "y": "m", "z": "m"}}
        assert entry["residual"]["after"] < 0.02 * entry["residual"]["before"]
        assert entry["residual"]["unit"] == "mm" and entry["rows"] is None
    assert "`read: {columns: {q_leg2: q_leg3" in identified.err
    assert "q_leg2 and q_leg3 are exchanged" in diagnosed.err


@pytest.mark.long
def test_stale_rows_are_left_out_and_told(tmp_path: Path) -> None:
    def repeated(rows: list[Row]) -> None:
        for i in (10, 31):
            rows[i].update({k: rows[i - 1][k] for k in ("x", "y", "z", "rx", "ry", "rz")})
        rows[44].update({k: rows[43][k] for k in LEGS})

    path = session(tmp_path, repeated)
    entries = json.loads(ppmcal("check", MACHINE, path, "--json").out)["misreadings"]
    assert [(e["kind"], e["rows"], e["read"]) for e in entries] == [
        ("stale", [11, 32], None), ("stale", [45], None)]
    done = ppmcal("identify", MACHINE, path, "--out", tmp_path / "o", expect=1)
    assert "rows 11, 32; left out" in " ".join(done.out.split())


# --- small mistakes, and none ---------------------------------------------------------------------

@pytest.mark.long
@pytest.mark.parametrize("half", [0.5, 2.0])
def test_a_small_mistake_is_found_in_what_the_fit_leaves(tmp_path: Path, half: float) -> None:
    """Turns of half a degree: what Euler angles change is within the tolerances."""
    path = simulated(tmp_path, half)
    rows = read_rows(path)
    turned(rows, lambda r: r.as_euler("xyz", degrees=True))
    write_rows(path, rows)
    done = ppmcal("identify", MACHINE, path, "--out", tmp_path / "o", expect=3)
    assert "`read: {rotation: euler-xyz}`" in done.err


@pytest.mark.long
def test_effects_are_no_mistakes(tmp_path: Path) -> None:
    """Backlash of eight times the noise: no other reading explains it."""
    path = simulated(tmp_path, 2.0, [{"kind": "backlash", "on": ["leg1", "leg2"],
                                      "parameters": {"width": 0.2}}])
    done = ppmcal("identify", MACHINE, path, "--out", tmp_path / "o")
    assert done.code in (0, 1), done.err
    assert json.loads(ppmcal("check", MACHINE, path, "--json").out)["misreadings"] == []


def simulated(folder: Path, half: float, effects: list[dict[str, Any]] | None = None) -> Path:
    """Simulate 80 poses of the sample's machine, turned by up to ``half`` degrees."""
    scenario = yaml.safe_load((MACHINE.parent / "scenario.yaml").read_text(encoding="utf-8"))
    center = scenario["poses"]["random"]["center"]
    scenario["poses"] = {"random": {"center": center, "count": 80, "half_range": {
        "x": 20, "y": 20, "z": 15, "rx": half, "ry": half, "rz": half}}}
    scenario |= {"noise": {}, "repeats": 1, "effects": effects or [],
                 "approach": "both" if effects else "one"}
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(scenario), encoding="utf-8")
    ppmcal("simulate", MACHINE, path, "--out", folder / "sim", expect=0)
    return folder / "sim" / "measurements.csv"


def read_rows(path: Path) -> list[Row]:
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    return [dict(zip(header.split(","), line.split(","), strict=True)) for line in lines]


def write_rows(path: Path, rows: list[Row]) -> None:
    lines = [",".join(rows[0]), *(",".join(str(v) for v in row.values()) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


# --- columns of the environment -----------------------------------------------------------------

PAYLOADS = {"conditions": {"payload": [0, 20]}}
WARM = {"conditions": {"temperature": {"mean": 22, "swing": 6}}}
COMPLIANCE = {"kind": "compliance", "parameters": {"stiffness": 800}}
HEAT = {"kind": "leg_thermal", "parameters": {"expansion": 12e-6}}


@pytest.mark.long
@pytest.mark.parametrize(("effect", "more", "column", "factor", "plus", "line"), [
    (COMPLIANCE, PAYLOADS, "payload", 1000.0, 0.0, "{units: {payload: g}}"),
    (HEAT, WARM, "temperature", 1.8, 32.0, "{units: {temperature: F}}"),
    (HEAT, WARM, "temperature", 1.0, 273.15, "{units: {temperature: K}}")])
def test_columns_of_another_unit(tmp_path: Path, effect: dict[str, Any], more: dict[str, Any],
                                 column: str, factor: float, plus: float, line: str) -> None:
    scenario = yaml.safe_load((MACHINE.parent / "scenario.yaml").read_text(encoding="utf-8"))
    scenario |= {"noise": {}, "repeats": 1, "effects": [effect], **more}
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(scenario), encoding="utf-8")
    ppmcal("simulate", MACHINE, path, "--out", tmp_path / "sim", expect=0)
    data = tmp_path / "sim" / "measurements.csv"
    right = ppmcal("diagnose", MACHINE, data, "--out", tmp_path / "right")
    assert right.code in (0, 1), right.err
    rows = read_rows(data)
    for row in rows:
        row.update({k: factor * float(v) + plus for k, v in row.items() if k.startswith(column)})
    write_rows(data, rows)
    done = ppmcal("diagnose", MACHINE, data, "--out", tmp_path / "wrong", expect=3)
    assert f"`read: {line}" in done.err


# --- the arithmetic -------------------------------------------------------------------------------

@pytest.mark.parametrize("convention", ["rotvec", "quat-xyzw", "quat-wxyz",
                                        *(f"euler-{o}" for o in ORDERS)])
def test_conventions_come_back(convention: str) -> None:
    vectors = Rotation.random(20, random_state=3).as_rotvec()
    again = understood(written(vectors, convention), convention)
    np.testing.assert_allclose(Rotation.from_rotvec(again).as_matrix(),
                               Rotation.from_rotvec(vectors).as_matrix(), atol=1e-12)


def test_matrices_are_understood() -> None:
    turns = Rotation.random(20, random_state=4)
    raw = turns.as_matrix().reshape(20, 9)
    np.testing.assert_allclose(Rotation.from_rotvec(understood(raw, "matrix")).as_matrix(),
                               turns.as_matrix(), atol=1e-12)


@pytest.mark.slow
def test_a_planar_machine_is_searched_too() -> None:
    """Two columns exchanged and the other sign of rz, in the plane."""
    machine = load(shipped("3-RPR"))
    pose = np.random.default_rng(2).uniform(-1.0, 1.0, (40, 3)) * [60.0, 60.0, 0.3]
    data = _planar_data(machine, pose)
    plain = ColumnInterpretation.as_declared(machine, data)
    read_so = replace(plain, joints=replace(plain.joints, order=(1, 0, 2)),
                      turns=replace(plain.turns, signs=(1, 1, -1))).of(data)
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(Problem(machine, (read_so,), machine.free))
    assert {m.kind for m in refused.value.found[0].mistakes} == {"permuted", "sign"}


def test_a_planar_machine_is_told_of_columns_that_it_has() -> None:
    machine = load(shipped("3-RPR"))
    data = _planar_data(machine, np.zeros((3, 3)))
    plain = ColumnInterpretation.as_declared(machine, data)
    inches = replace(plain, places=replace(plain.places, units=("in",) * 3),
                     turns=replace(plain.turns, units=("rad",) * 3))
    assert [m.columns for m in inches.mistakes(data)] == [("x", "y"), ("rz",)]


def _planar_data(machine: Mechanism, pose: Array) -> Dataset:
    full = np.tile(machine.home_pose, (len(pose), 1))
    full[:, [0, 1, 5]] += pose * [1e-3, 1e-3, 1.0]
    table = inverse_table(Model(machine), full)
    good = np.array([s == "ok" for s in table.status])
    data = Dataset.of_poses("made", table.q[good], full[good], (1e-5, 1e-5), fitted=True)
    return replace(data, units=machine.units)


# --- campaigns of other machines, from the simulator of mistakes ---------------------------------

def campaign(folder: Path, case: str, machine: str, rows: int = 60, eta: float = 1.0,
             seed: int = 1) -> Problem:
    """Write a campaign of `benchmarks/wild` and read it."""
    catalogue.write(case, machine, rows, seed, folder, eta)
    mechanism, datasets = prepared(folder / "mechanism.yaml", [folder / "data.csv"])
    return Problem(mechanism, datasets, mechanism.free)


@pytest.mark.parametrize("case", ["joint-unit-all", "position-unit"])
@pytest.mark.slow
def test_a_unit_that_makes_everything_small_explains_nothing(tmp_path: Path, case: str) -> None:
    """A linear delta looks the same at any height: a campaign of micrometres fits it anywhere."""
    found = misfit(campaign(tmp_path, case, "delta-linear")).readings
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    assert [f.block for f in found] == [truth["mend"]]


@pytest.mark.slow
@pytest.mark.parametrize("machine", ["3-RRR", "hexapod"])
def test_another_zero_is_named_where_no_row_has_a_pose(tmp_path: Path, machine: str) -> None:
    problem = campaign(tmp_path, "outside-limits", machine)
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(problem)
    (mistake,) = refused.value.found[0].mistakes
    assert (mistake.kind, list(mistake.columns)) == (
        "outside-limits", truth["mistakes"][0]["columns"])
    assert "Correct the zero of" in refused.value.hint


@pytest.mark.slow
def test_limits_are_not_told_beside_what_explains_them(tmp_path: Path) -> None:
    problem = campaign(tmp_path, "sign-all", "3-RRR")
    found = check(problem.mechanism, problem.datasets).misreadings
    assert [m.kind for f in found for m in f.mistakes] == ["sign"]
    alone = [m.kind for f in plain_mistakes(problem.datasets[0], problem.mechanism)
             for m in f.mistakes]
    assert "outside-limits" in alone


def test_a_diameter_is_named_where_home_cannot_be_reached(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot be reached") as refused:
        misfit(campaign(tmp_path, "radius-base", "3-RRR"))
    assert "base points are twice as far out" in refused.value.hint
    assert "a diameter for a radius?" in refused.value.hint


@pytest.mark.long
def test_a_diameter_that_tolerances_hide_is_named_by_what_the_fit_leaves(tmp_path: Path) -> None:
    problem = campaign(tmp_path, "radius-platform", "crank-hexapod", 120)
    assert not misfit(problem).misread
    with pytest.raises(InterpretationError,
                       match="the platform points are twice as far out") as refused:
        refuse_after_fit(identify(problem))
    assert refused.value.found[0].block is None


@pytest.mark.long
def test_values_typed_wrong_do_not_hide_swapped_columns(tmp_path: Path) -> None:
    found = misfit(campaign(tmp_path, "swapped-and-typos", "hexapod", 120)).readings
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    assert [f.block for f in found] == [truth["mend"]]


@pytest.mark.long
def test_what_happens_in_mid_run_is_no_misreading(tmp_path: Path) -> None:
    """A drive that slipped a turn: half of the rows are off by millimetres, the first are right."""
    found = misfit(campaign(tmp_path, "slip-turn", "3-RRR", 120, 3.0))
    assert found.nominal > 5.0 and not found.misread


@pytest.mark.slow
def test_a_geometry_that_absorbs_another_machine_is_refused(tmp_path: Path) -> None:
    problem = campaign(tmp_path, "other-machine", "delta-linear")
    with pytest.raises(InterpretationError, match="Is this the right mechanism file"):
        refuse_other_machine(identify(problem))


@pytest.mark.long
def test_commands_refuse_the_file_of_another_machine(tmp_path: Path) -> None:
    problem = campaign(tmp_path, "other-machine", "hexapod")
    paths = tmp_path / "mechanism.yaml", tmp_path / "data.csv"
    checked = json.loads(ppmcal("check", *paths, "--json", expect=1).out)["misreadings"]
    done = ppmcal("identify", *paths, "--out", tmp_path / "o", "--json", expect=3)
    assert not (tmp_path / "o").exists()
    for entries in (checked, json.loads(done.out)["misreadings"]):
        assert [e["kind"] for e in entries if e["kind"] != "outside-limits"] == ["other-machine"]
    assert "Is this the right mechanism file?" in " ".join(done.err.split())
    with pytest.raises(InterpretationError, match="Is this the right mechanism file"):
        diagnose(problem, DiagnosisOptions())
    # who says that tolerances are none is believed
    flat = ppmcal("identify", *paths, "--out", tmp_path / "o", "--prior", "flat")
    assert flat.code in (0, 1) and (tmp_path / "o" / "identified.yaml").exists()


@pytest.mark.parametrize("machine", ["delta-linear", "hexapod"])
@pytest.mark.slow
def test_rows_that_hold_each_others_measurements_are_told(tmp_path: Path, machine: str) -> None:
    problem = campaign(tmp_path, "shuffled", machine)
    with pytest.raises(InterpretationError, match="rows are in another order") as refused:
        refuse_after_fit(identify(problem))
    (mistake,) = refused.value.found[0].mistakes
    assert mistake.kind == "shuffled" and refused.value.found[0].block is None
    right = campaign(tmp_path / "right", "none", machine)
    places = [p.datasets[0].position for p in (problem, right)]
    moved = np.flatnonzero((places[0] != places[1]).any(axis=1)) + 1
    # the measurement of another row of the same pose is as good
    assert set(mistake.rows) <= set(moved) and len(mistake.rows) > 0.75 * len(moved)


@pytest.mark.long_cases(
    "stretch-mirrored-3-RPR", "stretch-mirrored-delta-rotary", "swapped-at-end-3-RPR",
    "swapped-at-end-crank-hexapod")
@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine"), [
    ("stretch-swapped", "delta-linear"),
    pytest.param("stretch-mirrored", "delta-rotary", marks=pytest.mark.slow),
    pytest.param("stretch-unit", "hexapod", marks=pytest.mark.slow),
    pytest.param("swapped-at-end", "3-RPR", marks=pytest.mark.slow),
    pytest.param("stretch-mirrored", "3-RPR", marks=pytest.mark.slow),
    pytest.param("swapped-at-end", "crank-hexapod", marks=pytest.mark.slow)])
def test_a_mistake_in_a_stretch_is_told_with_its_rows(tmp_path: Path, case: str, machine: str
                                                      ) -> None:
    campaign(tmp_path, case, machine)
    (true,) = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))["mistakes"]
    with pytest.raises(InterpretationError) as refused:
        api_identify(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    (found,) = refused.value.found
    assert [m.kind for m in found.mistakes] == [true["kind"]] and found.block is None
    assert list(found.mistakes[0].rows) == true["rows"]
    assert f"rows {true['rows'][0]} to {true['rows'][-1]}" in refused.value.what


@pytest.mark.long_cases(
    "gross-10-delta-linear", "homed-there-and-back-delta-linear", "slip-turn-3-RRR",
    "slip-turn-hexapod")
@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine"), [
    ("slip-turn", "3-RRR"), ("slip-turn", "hexapod"), ("homed-there-and-back", "delta-linear"),
    ("base-moved-twice", "hexapod"), ("gross-10", "delta-linear")])
def test_what_happens_in_a_stretch_is_no_mistake(tmp_path: Path, case: str, machine: str) -> None:
    problem = campaign(tmp_path, case, machine, 90, 3.0)
    assert wrong_parts(problem) == ()
    assert wrong_rows(identify(problem)) == ()


def test_a_strut_that_is_homed_elsewhere_for_some_rows_has_no_other_sign(tmp_path: Path) -> None:
    """With the other sign its zero is the other way round; such a length is negative."""
    problem = campaign(tmp_path, "none", "3-RPR")
    data, = problem.datasets
    zero = next(i for i, n in enumerate(problem.mechanism.names) if n.endswith("offset"))
    def with_joints(q: Array) -> Problem:
        return replace(problem, datasets=(replace(data, q=q, whole=None, place=None),), given=None)

    q = data.q - [2e-4, 0.0, 0.0]
    q[20:30, 0] += 2.0 * identify(with_joints(q)).state.g[zero]
    fit = identify(with_joints(q))
    assert not fit.keep[0][20:30].any()
    assert wrong_rows(fit) == ()


def test_one_number_typed_wrong_is_no_other_machine(tmp_path: Path) -> None:
    """Both points of a leg's base 30 tolerances off: told as a finding, and fitted."""
    problem = campaign(tmp_path, "none", "delta-linear")
    wrong = np.flatnonzero([n.startswith("leg1.base.point") for n in problem.mechanism.names])[:2]
    fit = identify(problem)
    g = problem.mechanism.values.copy()
    g[wrong] += 30.0 * np.array([problem.mechanism.parameters[i].tolerance for i in wrong])
    assert other_machine(problem, replace(fit.state, g=g)) is None
    zeros = [i for i, p in enumerate(problem.mechanism.parameters)
             if p.tolerance_class == "offset"]
    g = problem.mechanism.values.copy()
    g[zeros] += 1.0
    assert len(zeros) >= 3 and other_machine(problem, replace(fit.state, g=g)) is None


@pytest.mark.parametrize("machine", ["3-RPR", "delta-linear"])
def test_measurements_that_stay_while_the_machine_rests_are_stale(tmp_path: Path, machine: str
                                                                  ) -> None:
    data = campaign(tmp_path, "stale-pose", machine).datasets[0]
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    machine_ = load(tmp_path / "mechanism.yaml")
    (found,) = stale(replace(data, unusable=None), machine_)[1]
    assert list(found.rows) == truth["mistakes"][0]["rows"]
    rest = np.append(False, (np.diff(data.q, axis=0) == 0.0).all(axis=1))
    assert rest[np.array(found.rows) - 1].any() and not rest[np.array(found.rows) - 1].all()


def test_an_instrument_of_few_digits_repeats_by_chance(tmp_path: Path) -> None:
    """Measured to a hundredth where the noise is a tenth of that: repeats are the same."""
    problem = campaign(tmp_path, "none", "delta-linear")
    data = problem.datasets[0]
    for coarse in (5e-5, 2e-5):
        few = replace(data, position=np.round(data.position / coarse) * coarse, unusable=None)
        assert stale(few, problem.mechanism)[1] == ()


@pytest.mark.parametrize("machine", ["3-RPR", "delta-rotary"])
@pytest.mark.slow_cases("delta-rotary")
def test_rows_out_of_order_do_not_keep_the_held_out_fit_from_ending(tmp_path: Path, machine: str
                                                                    ) -> None:
    """A third of the rows is wrong: what the fit left out, that of the others leaves out too."""
    problem = campaign(tmp_path, "shuffled", machine, 120)
    fit = identify(problem)
    figures, _ = held_out(fit, FitOptions(), 0.2, 0)
    inside = residuals(problem, fit.state).figures(fit.keep)
    assert figures["position"]["rms"] < 2.0 * inside["position"]["rms"]


@pytest.mark.long_cases("backlash-and-heat-hexapod", "gross-10-crank-hexapod")
@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine"), [
    ("none", "3-RRR"), ("none", "delta-linear"), ("none", "hexapod"), ("none", "crank-hexapod"),
    ("gross-10", "crank-hexapod"), ("homed-one", "hexapod"), ("play-all", "3-RRR"),
    ("gain-one", "delta-linear"), ("backlash-and-heat", "hexapod")])
def test_right_files_are_read_as_they_are(tmp_path: Path, case: str, machine: str) -> None:
    problem = campaign(tmp_path, case, machine, 120, 3.0)
    assert not misfit(problem).misread
    refuse_after_fit(identify(problem))


def test_what_a_fit_explains_as_well_is_not_read_otherwise(tmp_path: Path) -> None:
    """Values typed wrong turn the registration with the nominal machine, as a turned body does."""
    problem = campaign(tmp_path, "gross-10", "3-RPR", 120, 0.8085, 933298)
    assert score(problem).nominal > LANDS
    found = misfit(problem)
    assert not found.readings and not found.misread


def test_repeats_are_not_stale_however_they_are_labelled(tmp_path: Path) -> None:
    """Half of the rows repeat a pose: the scatter of repeats is not how far the machine goes."""
    table = shipped("3-RPR")
    machine = load(table)
    made = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
            "poses": {"random": {"center": {"x": 500, "y": 260, "rz": 25},
                                 "half_range": {"x": 70, "y": 70, "rz": 8}, "count": 30}},
            "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.002}},
            "repeats": 3, "seed": 3}
    simulate(table, made).save(tmp_path / "o")
    data = read_data(machine, tmp_path / "o" / "measurements.csv")[0]
    for labels in (np.arange(len(data)), np.arange(len(data)) % 10):
        other = replace(data, labels=None, groups=labels, unusable=None)
        assert not stale(other, machine)[1]
        q = other.q.copy()
        q[9] = q[8]    # the tenth row is of another pose: 30 poses of three rows
        (found,) = stale(replace(other, q=q), machine)[1]
        assert found.rows == (10,)


@pytest.mark.slow
def test_check_tells_rows_that_repeat_the_one_before_once(tmp_path: Path) -> None:
    def repeated(rows: list[Row]) -> None:
        rows[44].update({k: rows[43][k] for k in LEGS})

    said = " ".join(ppmcal("check", MACHINE, session(tmp_path, repeated), expect=1).out.split())
    assert said.count("repeat those of the previous row") == 1


@pytest.mark.long
def test_a_mistake_is_named_on_a_machine_with_a_hidden_effect_too(tmp_path: Path) -> None:
    """A play of ten times the noise is left by the right reading; by the wrong one everything."""
    path = simulated(tmp_path, 7.0, [{"kind": "backlash", "on": ["leg2"],
                                      "parameters": {"width": 0.1}}])
    rows = read_rows(path)
    swapped(rows)
    write_rows(path, rows)
    machine, datasets = prepared(MACHINE, [path])
    (found,) = misfit(Problem(machine, datasets, machine.free)).readings
    assert {m.kind for m in found.mistakes} == {"permuted"} and found.noise_after > 2.0
