"""``ppmcal diagnose`` on files: machines simulated with effects, diagnosed without."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.commands import (
    columns,
    number,
    pick,
    ppmcal,
    ppmcal_process,
    rows,
    tree,
    write_csv,
)
from helpers.diagnoses import (
    BACKLASH,
    DATA,
    SQUEEZED,
    WARM,
    diagnose,
    drop,
    effect,
    found_in,
    named,
    simulate,
    value,
)

from ppmcal.inference.priors import SURE_ODDS

WRITTEN = {"model.yaml", "effects.csv", "residuals.csv", "diagnosis.json"}
VERDICTS = {"none", "weak", "named", "named-set", "partial", "unnamed"}


SOME = [word for kind in ("backlash", "compliance", "leg_thermal") for word in ("--kind", kind)]
"""Of the library, what is asked where the fact is another one than what is named of all of it."""
CAMPAIGNS = ["none", *(
    pytest.param(n, marks=pytest.mark.slow) for n in ("backlash", "three", "scale", "thermal"))]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Campaigns that several tests look at, made and diagnosed on first use."""
    recipes: dict[str, tuple[str, list[dict[str, Any]], dict[str, Any]]] = {
        "backlash": ("6-UPS", [BACKLASH], {"count": 18}), "none": ("3-RPR", [], {}),
        "three": ("3-RPR", [BACKLASH, SQUEEZED, WARM], {"count": 30, "seed": 5}),
        "scale": ("3-RPR", [effect("gain", gain=5e-4)], {}),
        "thermal": ("3-RPR", [effect("leg_thermal", expansion=2e-6)], {})}
    done: dict[str, Path] = {}

    def campaign(name: str) -> Path:
        if name not in done:
            machine, effects, changes = recipes[name]
            folder = simulate(tmp_path_factory.mktemp(name), machine, effects, **changes)
            run, _ = diagnose(folder)
            (folder / "out.txt").write_text(run.out + run.err)
            done[name] = folder
        return done[name]

    return campaign


# --- what is found ------------------------------------------------------------------------------


@pytest.mark.long
def test_backlash_on_one_leg(made: Callable[[str], Path]) -> None:
    found = found_in(made("backlash"))
    assert found["verdict"] in ("named", "named-set")
    assert named(found) == {"backlash": {"leg3"}}
    width = value(found, "backlash", "width")
    assert abs(width["value"] - 0.03) < 4.0 * width["sigma"]
    assert 0.0 < width["sigma"] < 0.003
    assert width["unit"] == "mm"
    strongest = max((p for p in found["localised"] if p["by"] == "actuator"),
                    key=lambda p: p["rms_ratio"])
    assert strongest["value"] == "leg3"
    assert strongest["p_value"] < 0.01


@pytest.mark.long
def test_three_effects_together(made: Callable[[str], Path]) -> None:
    """Each with its own parameter alone: no hardening of what is plain, and no time constant."""
    found = found_in(made("three"))
    assert found["verdict"] in ("named", "named-set")
    legs = {"leg1", "leg2", "leg3"}
    assert named(found) == {"backlash": {"leg3"}, "compliance": legs, "leg_thermal": legs}
    for kind, name, truth, unit in (("backlash", "width", 0.03, "mm"),
                                    ("compliance", "stiffness", 8000.0, "N/mm"),
                                    ("leg_thermal", "expansion", 11e-6, "1/K")):
        v = value(found, kind, name)
        assert abs(v["value"] - truth) < 4.0 * v["sigma"], kind
        assert 0.0 < v["sigma"] < 0.1 * truth
        assert v["unit"] == unit
    assert {frozenset(e["parameters"]) for e in found["effects"]} == {
        frozenset({name}) for name in ("width", "stiffness", "expansion")}
    gap = found["gap"]
    assert found["confirmed"] and gap["closed"] > 0.8 and gap["interval"][1] > 0.9
    assert gap["after"] < 1.25 < gap["before"]
    # what the geometry had moved to imitate them is listed, and has come back
    assert found["swallowed"]
    for s in found["swallowed"]:
        assert abs(s["before"] - s["after"]) > s["tolerance"] > 0.0


@pytest.mark.long
def test_nothing_hidden(made: Callable[[str], Path]) -> None:
    """The verdict, exit 0, and that nothing was likely."""
    folder = made("none")
    found = found_in(folder)
    assert found["verdict"] == "none"
    assert found["effects"] == []
    # each pose was approached on its own: there is no way from row to row
    assert {u["kind"]: u["missing"] for u in found["not_testable"]} == {
        "play": ["approach: sequence"], "hysteresis": ["approach: sequence"]}
    assert found["remainder"]["follows"] is None
    assert found["nothing"] > 0.5 and found["unknown"] == []
    assert "absent" not in (folder / "out.txt").read_text()
    table = {(r["kind"], r["on"], r["form"]): r
             for r in rows(folder / "d" / "effects.csv")}
    assert all(number(r, "probability") < 0.5 for r in table.values()
               if r["status"] != "not testable")
    assert number(table["backlash", "leg1", "shared"], "probability") < 0.05
    # the fit is that of identify
    ppmcal("identify", "m.yaml", DATA, "--out", "i", cwd=folder)
    plain = yaml.safe_load((folder / "i" / "identified.yaml").read_text())
    model = yaml.safe_load((folder / "d" / "model.yaml").read_text())
    assert model["limbs"] == plain["limbs"]


@pytest.mark.long
def test_a_frozen_slot_is_named(tmp_path: Path) -> None:
    simulate(tmp_path, "3-RPR", [], free=["*.offset", "*.platform.point.radius"],
             errors={"leg2.platform.point.angle": 0.15, "leg1.offset": 0.3}, frame="known",
             target="known")
    _, found = diagnose(tmp_path)
    assert found["verdict"] in ("named", "named-set")
    slot = next(e for e in found["effects"] if e["kind"] == "geometry")
    ((name, v),) = slot["parameters"].items()
    assert name == "leg2.platform.point.angle"
    assert v["unit"] == "deg"
    assert abs(v["value"] - 0.15) < 4.0 * v["sigma"]
    assert slot["on"] == ["leg2"]


@pytest.mark.long
def test_a_large_slot_error_is_not_another_effect(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], 12, free=["*.offset", "*.platform.point.*"], frame="known",
             target="known", errors={"leg2.base.point.angle": 0.03, "leg1.offset": 0.3})
    _, found = diagnose(tmp_path)
    assert set(named(found)) <= {"geometry"}


@pytest.mark.long
def test_a_machine_with_fewer_actuators_than_coordinates(tmp_path: Path) -> None:
    simulate(tmp_path, "3-RPS", [effect("backlash", ["leg2"], width=0.03)])
    _, found = diagnose(tmp_path)
    assert found["verdict"] == "named"
    assert named(found) == {"backlash": {"leg2"}}
    assert abs(value(found, "backlash", "width")["value"] - 0.03) < 0.003


@pytest.mark.slow
def test_positions_only(tmp_path: Path) -> None:
    """A retroreflector off the platform's origin, and no rotation."""
    simulate(tmp_path, "3-RPR", [effect("backlash", ["leg2"], width=0.03)], count=40,
             conditions={}, instrument={"kind": "position", "sigma": {"position": 0.005}},
             target=[60, 40])
    _, found = diagnose(tmp_path, DATA, *SOME)
    assert named(found) == {"backlash": {"leg2"}}
    width = value(found, "backlash", "width")
    assert abs(width["value"] - 0.03) < 4.0 * width["sigma"]
    assert not {"after_rz", "before_rz"} & set(columns(tmp_path / "d" / "residuals.csv"))


@pytest.mark.long
def test_two_data_files(tmp_path: Path) -> None:
    """One machine, the instrument set up twice."""
    errors = {"leg1.offset": 0.3, "leg2.base.point.x": -0.2, "leg3.platform.point.radius": 0.2}
    own = effect("backlash", ["leg1"], width=0.03)
    simulate(tmp_path, "3-RPR", [own], 15, errors=errors)
    simulate(tmp_path, "3-RPR", [own], 15, "t", errors=errors, seed=8,
             frame={"x": -4, "y": 3, "rz": -2})
    _, found = diagnose(tmp_path, DATA, "t/measurements.csv", *SOME)
    assert found["verdict"] in ("named", "named-set")
    assert named(found) == {"backlash": {"leg1"}}
    table = rows(tmp_path / "d" / "residuals.csv")
    assert [len([r for r in table if r["dataset"] == d]) for d in ("s", "t")] == [
        len(rows(tmp_path / DATA)), len(rows(tmp_path / "t/measurements.csv"))]
    assert set(yaml.safe_load((tmp_path / "d" / "model.yaml").read_text())["measurement"][
        "datasets"]) == {"s", "t"}


@pytest.mark.long
def test_outliers_that_an_effect_explains_are_readmitted(tmp_path: Path) -> None:
    """A heavy load once a pose: without compliance these rows are far off."""
    simulate(tmp_path, "3-RPR", [effect("compliance", ["leg1"], stiffness=500.0)], 8,
             conditions={"payload": [0, 2, 0, 2, 0, 2, 60]}, approach="one")
    ppmcal("identify", "m.yaml", DATA, "--out", "i", cwd=tmp_path, expect=1)
    out = [r["row"] for r in rows(tmp_path / "i" / "residuals.csv") if r["used"] == "0"]
    assert len(out) == 8
    _, found = diagnose(tmp_path, DATA, *SOME)
    assert found["verdict"] == "named"
    assert named(found) == {"compliance": {"leg1"}}
    assert abs(value(found, "compliance", "stiffness")["value"] - 500.0) < 25.0
    assert found["excluded"] == []
    assert {r["used"] for r in rows(tmp_path / "d" / "residuals.csv")} == {"1"}
    assert any("8 rows" in f for f in found["findings"])


@pytest.mark.long
def test_true_outliers_stay_out(tmp_path: Path) -> None:
    simulate(tmp_path, "3-RPR", [effect("backlash", ["leg1"], width=0.03)])
    table = rows(tmp_path / DATA)
    for row in (5, 20):
        table[row]["y"] = str(float(table[row]["y"]) + 0.5)
    write_csv(tmp_path / DATA, table)
    _, found = diagnose(tmp_path, DATA, *SOME)
    assert named(found) == {"backlash": {"leg1"}}
    assert {e["row"] for e in found["excluded"]} >= {6, 21}
    assert len(found["excluded"]) <= 4
    out = {r["row"]: r["reason"] for r in rows(tmp_path / "d" / "residuals.csv")
           if r["used"] == "0"}
    assert {"6", "21"} <= set(out)
    assert all(out.values())


# --- what cannot be found -----------------------------------------------------------------------


@pytest.mark.slow
def test_a_column_that_was_not_recorded(tmp_path: Path) -> None:
    """Nothing is said of kinds that need it but that, and what they need."""
    simulate(tmp_path, "3-RPR", [])
    drop(tmp_path, "temperature", "vel_leg2", "payload")
    run, found = diagnose(tmp_path)
    missing = {e["kind"]: e["missing"] for e in found["not_testable"]}
    assert missing["leg_thermal"] == missing["base_thermal"] == ["temperature"]
    assert missing["lag"] == missing["friction"] == ["vel_leg2"]
    for kind in ("compliance", "clearance", "base_compliance", "windup"):
        assert missing[kind] == ["payload"], kind
    assert not {"backlash", "drift", "gain", "geometry"} & set(missing)
    assert named(found) == {}
    table = [r for r in rows(tmp_path / "d" / "effects.csv") if r["kind"] in missing]
    assert {r["kind"] for r in table} == set(missing)
    for r in table:
        # they can be tested on the two legs whose speed is known
        assert r["status"] == "not testable" or r["kind"] in ("lag", "friction"), r
    for text in (run.out, *(b.decode() for b in tree(tmp_path / "d").values())):
        assert "absent" not in text
    said = " ".join(run.out.split())
    assert ("base_thermal, leg_thermal, platform_thermal, backlash x temperature "
            "(need temperature)") in said


@pytest.mark.long
def test_an_effect_whose_column_was_not_recorded_is_not_called_another(tmp_path: Path) -> None:
    """Legs that grow with a temperature that nobody wrote down: unnamed or partial at most."""
    simulate(tmp_path, "3-RPR", [WARM], 12)
    drop(tmp_path, "temperature")
    _, found = diagnose(tmp_path)
    assert "leg_thermal" in {e["kind"] for e in found["not_testable"]}
    assert found["verdict"] != "none"
    assert found["verdict"] not in ("named", "named-set") or found["confirmed"]
    assert found["gap"]["after"] < 2.0 * found["gap"]["before"]
    assert len(found["effects"]) <= 6
    for e in found["effects"]:
        # a drift along one coordinate has others, too
        assert any(v["sigma"] is None or v["sigma"] < abs(v["value"])
                   for v in e["parameters"].values()), e["kind"]


@pytest.mark.slow
def test_columns_that_do_not_change(tmp_path: Path) -> None:
    """Every row approached from one side, one load, one temperature: nothing follows them."""
    simulate(tmp_path, "3-RPR", [], approach="one",
             conditions={"payload": [10], "temperature": 20.0})
    _, found = diagnose(tmp_path)
    missing = {e["kind"]: e["missing"] for e in found["not_testable"]}
    assert {"dir_leg1", "dir_leg2", "dir_leg3"} <= set(missing["backlash"])
    assert missing["leg_thermal"] == ["temperature"]
    for r in rows(tmp_path / "d" / "effects.csv"):
        if r["kind"] == "backlash":
            assert r["status"] == "not testable"
            assert not number(r, "probability") > 0.0
    assert found["unknown"] == [] and found["remainder"]["follows"] is None
    assert found["verdict"] in ("none", "weak")


@pytest.mark.parametrize("count", [1, 2, 6, 10])
@pytest.mark.slow
def test_hardly_any_data(tmp_path: Path, count: int) -> None:
    """A clear refusal or a verdict that claims nothing."""
    simulate(tmp_path, "3-RPR", [], count, approach="one", conditions={})
    run = ppmcal("diagnose", "m.yaml", DATA, "--out", "d", cwd=tmp_path)
    assert "fault of ppmcal" not in run.err
    if run.code in (2, 3):
        assert "measurements.csv" in run.err
        assert not (tmp_path / "d").exists()
        return
    found = found_in(tmp_path)
    assert found["verdict"] in ("none", "weak")


@pytest.mark.slow
def test_four_poses(tmp_path: Path) -> None:
    test_hardly_any_data(tmp_path, 4)


@pytest.mark.slow
def test_directions_the_other_way_round_are_the_other_side(tmp_path: Path) -> None:
    """Whether an encoder sits before the play or `dir_` is turned, the width takes the sign."""
    simulate(tmp_path, "3-RPR", [effect("backlash", ["leg1"], width=0.03)])
    table = rows(tmp_path / DATA)
    for r in table:
        r["dir_leg1"] = str(-int(r["dir_leg1"]))
    write_csv(tmp_path / DATA, table)
    ppmcal("diagnose", "m.yaml", DATA, "--kind", "backlash", "--out", "d",
           cwd=tmp_path, expect=0)
    found = found_in(tmp_path)
    assert found["verdict"] == "named"
    (one,) = found["effects"]
    assert one["kind"] == "backlash" and one["on"] == ["leg1"] and one["side"] == "lags"
    width = one["parameters"]["width"]
    assert abs(width["value"] + 0.03) < 4.0 * width["sigma"]


# --- named sets and next measurements -----------------------------------------------------------


@pytest.mark.long
def test_what_cannot_be_told_apart_is_a_set(made: Callable[[str], Path]) -> None:
    """Gain of all encoders and the instrument's scale: no pose can tell, only a known length."""
    found = found_in(made("scale"))
    assert found["verdict"] == "named-set"
    (only,) = found["effects"]
    assert {only["kind"], *only["alternatives"]} >= {"gain", "sensor_scale"}
    assert found["next_measurements"]["file"] is None
    assert "distance" in found["next_measurements"]["reason"]
    assert not (made("scale") / "d" / "next.csv").exists()


@pytest.mark.long
def test_no_measurements_are_not_zero_measurements(made: Callable[[str], Path]) -> None:
    reason = found_in(made("scale"))["next_measurements"]["reason"]
    assert not re.search(r"\b0 further", reason)


@pytest.mark.long
def test_next_measurements_can_be_taken(made: Callable[[str], Path]) -> None:
    """A table of joints, poses and settings: within limits, within what was seen, consistent."""
    folder = made("thermal")
    found = found_in(folder)
    assert found["verdict"] == "named-set"
    (only,) = found["effects"]
    assert "leg_thermal" in {only["kind"], *only["alternatives"]}
    assert found["next_measurements"]["file"] == "next.csv"
    table = rows(folder / "d" / "next.csv")
    assert len(table) == found["next_measurements"]["rows"] > 0
    assert str(len(table)) in found["next_measurements"]["reason"]
    seen = [number(r, "temperature") for r in rows(folder / DATA)]
    for r in table:
        assert all(200.0 <= number(r, f"q_leg{i}") <= 700.0 for i in (1, 2, 3))
        assert {r[f"dir_leg{i}"] for i in (1, 2, 3)} <= {"1", "-1"}
        assert min(seen) - 1e-6 <= number(r, "temperature") <= max(seen) + 1e-6
        assert abs(number(r, "vel_leg1")) <= 30.0 + 1e-6
    # its joints and poses belong together, within what identification changed
    pick(folder / "d" / "next.csv", ["q_leg1", "q_leg2", "q_leg3"], folder / "q.csv")
    ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--out", "f", cwd=folder, expect=0)
    for r, back in zip(table, rows(folder / "f" / "kinematics.csv"), strict=True):
        assert math.dist([number(r, c) for c in "xy"], [number(back, c) for c in "xy"]) < 5.0
        assert abs(number(r, "rz") - number(back, "rz")) < 1.0
    assert found["next_measurements"]["odds_after"] > 0.999 * SURE_ODDS


@pytest.mark.long
def test_next_measurements_move_the_way_they_come(made: Callable[[str], Path]) -> None:
    """A joint that comes from below moves up."""
    for r in rows(made("thermal") / "d" / "next.csv"):
        for i in (1, 2, 3):
            assert number(r, f"vel_leg{i}") * number(r, f"dir_leg{i}") >= 0.0


# --- what is written ----------------------------------------------------------------------------


@pytest.mark.long_cases("backlash", "none", "three")
@pytest.mark.slow
@pytest.mark.parametrize("name", CAMPAIGNS)
def test_diagnosis_json(made: Callable[[str], Path], name: str) -> None:
    """Every key of the contract, of the right type, in the machine's units."""
    folder = made(name)
    found = found_in(folder)
    assert set(tree(folder / "d")) >= WRITTEN
    assert found["format"] == "ppmcal/diagnosis/2"
    assert found["verdict"] in VERDICTS
    assert bool(found["effects"]) == (found["verdict"] in ("named", "named-set", "partial"))
    assert (found["verdict"] == "named-set") == any(e["alternatives"] for e in found["effects"])
    for e in found["effects"]:
        assert {"kind", "on", "parameters", "p_value", "survival", "alternatives"} <= set(e)
        assert isinstance(e["kind"], str)
        assert isinstance(e["on"], list)
        assert e["p_value"] is None and 0.0 < e["probability"] <= 1.0
        assert 0.0 < e["survival"] <= 1.0 + 1e-9
        assert all(isinstance(a, str) and " " not in a for a in e["alternatives"]
                   if not a.startswith("geometry"))
        assert e["kind"] not in e["alternatives"]
        assert e["parameters"]
        for v in e["parameters"].values():
            assert set(v) == {"value", "sigma", "unit", "low", "high"}
            assert math.isfinite(v["value"])
            assert v["sigma"] > 0.0
            assert v["low"] < v["value"] < v["high"]
    assert set(found["remainder"]) >= {"follows", "p_value"}
    assert found["remainder"]["follows"] is None or isinstance(found["remainder"]["follows"], str)
    assert found["remainder"]["p_value"] is None
    assert 0.0 <= found["remainder"]["known"] <= 1.0
    gap = found["gap"]
    assert set(gap) >= {"noise", "before", "after", "closed", "interval"}
    assert gap["noise"] == 1.0
    assert gap["before"] > 0.0
    assert gap["after"] > 0.0
    if gap["closed"] is not None:
        assert gap["closed"] <= 1.0
        low, high = gap["interval"]
        assert low <= gap["closed"] <= high <= 1.0
    for p in found["localised"]:
        assert {"by", "value", "rms_ratio", "p_value"} <= set(p)
        assert isinstance(p["value"], str)
        assert p["rms_ratio"] > 0.0
        assert 0.0 < p["p_value"] <= 1.0
    assert {p["value"] for p in found["localised"] if p["by"] == "actuator"} == {
        c[2:] for c in columns(folder / DATA) if c.startswith("q_")}
    assert {"actuator", "direction", "temperature", "time"} <= {
        p["by"] for p in found["localised"]}
    for e in found["not_testable"]:
        assert {"kind", "missing"} <= set(e)
    assert set(found["next_measurements"]) >= {"reason", "file"}
    assert found["next_measurements"]["reason"]
    assert {"version", "inputs", "command", "seed"} <= set(found["provenance"])
    assert len(found["provenance"]["inputs"]) == 3


@pytest.mark.slow_cases("none")
@pytest.mark.parametrize("name", ["none", *(
    pytest.param(n, marks=pytest.mark.slow) for n in ("backlash", "scale"))])
def test_effects_csv(made: Callable[[str], Path], name: str) -> None:
    """One row per candidate, with the contract's columns; named ones first."""
    folder = made(name)
    found = found_in(folder)
    table = rows(folder / "d" / "effects.csv")
    assert {"kind", "on", "p_value", "survival", "status", "alternatives"} <= set(table[0])
    keys = [tuple(r[c] for c in ("kind", "on", "form")) for r in table]
    assert len(keys) == len(set(keys))
    for r in table:
        assert r["status"]
        if r["kind"] in ("play", "hysteresis"):     # poses are approached from both sides
            assert r["status"] == "not testable"
            continue
        if r["kind"].endswith(".lateral"):  # of 0: it counts by its square
            assert r["status"] == "not testable" and "changes no reading" in r["alternatives"]
            continue
        assert r["status"] != "not testable"
        assert r["p_value"] == "nan" and 0.0 <= number(r, "probability") <= 1.0
        assert 0.0 <= number(r, "survival") <= 1.0 + 1e-9
    assert {r["kind"] for r in table if r["status"] == "named"} == set(named(found))
    for e in found["effects"]:
        row = next(r for r in table if r["status"] == "named")
        assert row["kind"] == e["kind"]
        assert set(row["on"].split()) == set(e["on"])
        assert {a.split(" on ")[0] for a in row["alternatives"].split("; ") if a} == set(
            e["alternatives"])
    kinds = {r["kind"] for r in table}
    assert {"backlash", "lag", "compliance", "clearance", "leg_thermal", "base_thermal", "drift",
            "gain", "sensor_scale", "curvature", "periodic", "windup"} <= kinds
    legs = {r["on"] for r in table if r["kind"] == "backlash" and r["form"] == "shared"}
    actuators = [c[2:] for c in columns(folder / DATA) if c.startswith("q_")]
    assert legs == {*actuators, " ".join(actuators)}


@pytest.mark.slow
def test_residuals_before_and_after(made: Callable[[str], Path]) -> None:
    folder = made("backlash")
    table = rows(folder / "d" / "residuals.csv")
    pose = ("x", "y", "z", "rx", "ry", "rz")
    assert list(table[0]) == ["row", "dataset", *(f"{part}_{c}" for c in pose for part in (
        "before", "after", "sigma", "geometry")), "used", "reason"]
    assert [int(r["row"]) for r in table] == list(range(1, len(rows(folder / DATA)) + 1))

    def white(part: str) -> float:
        own = [number(r, f"{part}_{c}") / number(r, f"sigma_{c}") for r in table for c in pose]
        return math.sqrt(sum(v * v for v in own) / len(own))

    assert white("before") > 1.15
    assert 0.85 < white("after") < 1.05
    assert number(table[0], "sigma_x") == pytest.approx(0.005, rel=1e-9)


@pytest.mark.long
def test_the_model_is_a_mechanism_file(made: Callable[[str], Path], tmp_path: Path) -> None:
    """It reads, it is complete for these data, and it can be fitted again."""
    folder = shutil.copytree(made("three"), tmp_path / "c")
    model = yaml.safe_load((folder / "d" / "model.yaml").read_text())
    first = found_in(folder)
    assert {e["kind"] for e in model["effects"]} == set(named(first))
    ppmcal("check", "d/model.yaml", cwd=folder, expect=0)
    ppmcal("diagnose", "d/model.yaml", DATA, "--out", "e", cwd=folder,
           expect=0)
    again = found_in(folder, "e")
    assert again["verdict"] == "none"
    assert again["effects"] == []
    ppmcal("identify", "d/model.yaml", DATA, "--out", "i", cwd=folder, expect=0)
    table = {r["name"]: r for r in rows(folder / "i" / "parameters.csv")}
    for e in first["effects"]:
        for short, v in e["parameters"].items():
            own = [r for n, r in table.items() if n.startswith(e["kind"]) and n.endswith(short)]
            assert any(abs(number(r, "value") - v["value"]) < 0.1 * v["sigma"] for r in own)


@pytest.mark.slow
def test_the_model_compensates(made: Callable[[str], Path], tmp_path: Path) -> None:
    """From dir_ and payload columns: other commands for other directions and loads."""
    folder = shutil.copytree(made("three"), tmp_path / "c")
    wanted = [{"x": 500, "y": 288, "rz": 30, **{f"dir_leg{i}": 1 for i in (1, 2, 3)},
               "payload": load, "temperature": warm} for load in (0, 30) for warm in (20, 30)]
    write_csv(folder / "wanted.csv", wanted)
    ppmcal("compensate", "d/model.yaml", "wanted.csv", "--frame", "base", "--out", "k",
           cwd=folder, expect=0)
    table = rows(folder / "k" / "commands.csv")
    assert {r["status"] for r in table} == {"ok"}
    q = [number(r, "q_leg1") for r in table]
    # 300 mm of 11e-6 per K over 10 K
    assert 0.02 < abs(q[1] - q[0]) < 0.05
    assert abs(q[2] - q[0]) > 1e-3
    legs = shutil.copytree(made("backlash"), tmp_path / "b")
    wanted = [{"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0,
               **{f"dir_leg{i}": side for i in range(1, 7)}} for side in (1, -1)]
    write_csv(legs / "wanted.csv", wanted)
    ppmcal("compensate", "d/model.yaml", "wanted.csv", "--frame", "base", "--out", "k", cwd=legs,
           expect=0)
    up, down = rows(legs / "k" / "commands.csv")
    assert abs(abs(number(up, "q_leg3") - number(down, "q_leg3")) - 0.03) < 0.005
    assert abs(number(up, "q_leg1") - number(down, "q_leg1")) < 1e-6


# --- the command --------------------------------------------------------------------------------


@pytest.mark.long
def test_quiet_json_and_the_same_bytes(made: Callable[[str], Path], tmp_path: Path) -> None:
    """Nothing but errors; one JSON object, that of the file; the seed decides everything."""
    folder = shutil.copytree(made("none"), tmp_path / "c")
    args = ["diagnose", "m.yaml", DATA, "--seed", "3", *SOME]
    quiet = ppmcal(*args, "--quiet", "--out", "a", cwd=folder, expect=0)
    assert quiet.out == quiet.err == ""
    run = ppmcal(*args, "--json", "--out", "b", cwd=folder, expect=0)
    assert run.json == found_in(folder, "b")
    assert run.err == ""
    for name in ("model.yaml", "effects.csv", "residuals.csv"):
        assert (folder / "a" / name).read_bytes() == (folder / "b" / name).read_bytes(), name
    one, two = found_in(folder, "a"), found_in(folder, "b")
    assert one["provenance"].pop("command") != two["provenance"].pop("command")
    assert one == two
    assert one["provenance"]["seed"] == 3


@pytest.mark.long
def test_the_same_command_writes_the_same_bytes(made: Callable[[str], Path],
                                                tmp_path: Path) -> None:
    folder = shutil.copytree(made("thermal"), tmp_path / "c")
    before = tree(folder / "d")
    diagnose(folder)
    assert tree(folder / "d") == before
    assert "next.csv" in before


@pytest.mark.parametrize("name", CAMPAIGNS)
@pytest.mark.slow
def test_output_is_no_wider_than_a_terminal(made: Callable[[str], Path], name: str) -> None:
    """And tells the verdict, every named effect and what to do next."""
    text = (made(name) / "out.txt").read_text()
    assert max(map(len, text.splitlines())) <= 80
    assert "nan" not in text.split()
    assert "Next:" in text
    for kind in named(found_in(made(name))):
        assert kind in text


@pytest.mark.slow
def test_only_the_kinds_that_were_asked_for(made: Callable[[str], Path], tmp_path: Path) -> None:
    folder = shutil.copytree(made("none"), tmp_path / "c")
    _, found = diagnose(folder, DATA, "--kind", "backlash", "--kind", "drift")
    assert found["verdict"] == "none"
    assert {r["kind"] for r in rows(folder / "d" / "effects.csv")} == {"backlash", "drift"}


BAD: dict[str, tuple[list[str], list[str]]] = {
    "unknown kind": (["m.yaml", DATA, "--kind", "backlsh"], ["--kind", "backlsh", "backlash"]),
    "no such file": (["m.yaml", "s/nope.csv"], ["nope.csv"]),
    "no machine": (["nope.yaml", DATA], ["nope.yaml"]),
    "no data": (["m.yaml"], ["DATA"]),
    "held-out share": (["m.yaml", DATA, "--holdout", "2"], ["--holdout"]),
    "an option that went": (["m.yaml", DATA, "--draws", "3"], ["--draws"]),
    "pattern of nothing": (["m.yaml", DATA, "--free", "leg9.*"], ["leg9.*"]),
    "not a table": (["m.yaml", "s/truth.json"], ["truth.json"]),
    "a direction of 5": (["m.yaml", "s/bad.csv"], ["bad.csv", "row 4", "dir_leg1", "1"])}


@pytest.mark.slow_cases("unknown kind", "no such file")
@pytest.mark.parametrize("case", BAD)
def test_bad_input(made: Callable[[str], Path], tmp_path: Path, case: str) -> None:
    """One message that names file, place and hint; nothing is written."""
    folder = shutil.copytree(made("none"), tmp_path / "c")
    table = rows(folder / DATA)
    table[3]["dir_leg1"] = "5"
    write_csv(folder / "s" / "bad.csv", table)
    shutil.copy(folder / "s" / "measurements.yaml", folder / "s" / "bad.yaml")
    args, words = BAD[case]
    before = tree(folder)
    for flags in ([], ["--quiet"]):
        run = ppmcal("diagnose", *args, *flags, "--out", "o", cwd=folder, expect=2)
        assert run.out == ""
        assert "Traceback" not in run.err
        for word in words:
            assert word in run.err
    assert tree(folder) == before


@pytest.mark.long
def test_in_a_process_of_its_own(made: Callable[[str], Path], tmp_path: Path) -> None:
    folder = shutil.copytree(made("none"), tmp_path / "c")
    run = ppmcal_process("diagnose", "m.yaml", DATA, "--kind", "backlash",
                         "--out", "p", cwd=folder)
    assert run.code == 0, run.err
    assert run.err == ""
    assert "No missing effect is detectable" in run.out
