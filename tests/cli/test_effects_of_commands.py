"""Effects through the real commands: simulated, identified again, compensated, added by others."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import columns, install, number, pick, ppmcal, ppmcal_process, rows, write_csv
from helpers.paths import ROOT

from ppmcal.io import read_mechanism
from ppmcal.model.effects import effect_kinds

CONFIGS = ROOT / "configs"
CONSTANTS = ("low", "high", "from_row", "radius", "at")
POSES: dict[str, Any] = {
    "3-RPR": {"center": {"x": 500, "y": 288.675, "rz": 30},
              "half_range": {"x": 60, "y": 60, "rz": 8}, "count": 24},
    "delta-rotary": {"center": {"x": 0, "y": 0, "z": -380},
                     "half_range": {"x": 80, "y": 80, "z": 50}, "count": 24},
    "6-UPS": {"center": {"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0},
              "half_range": {"x": 200, "y": 200, "z": 150, "rx": 6, "ry": 6, "rz": 6},
              "count": 24},
    "cable-4-planar": {"center": {"x": 1450, "y": 1200, "rz": 0},
                       "half_range": {"x": 700, "y": 500, "rz": 8}, "count": 24}}
CONDITIONS = {"payload": [0, 15, 30], "temperature": {"mean": 24, "swing": 6}, "velocity": 30}


def machine(folder: Path, name: str, effects: Any, file: str = "m.yaml", **changes: Any) -> str:
    """Write a machine of configs/ with effects; return the file's name."""
    data = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    (folder / file).write_text(yaml.safe_dump(data | {"effects": effects} | changes,
                                              sort_keys=False))
    return file


def scenario(folder: Path, name: str, effects: Any, **changes: Any) -> str:
    """Write a scenario with effects and conditions; return the file's name."""
    data = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
            "poses": {"random": POSES[name]}, "effects": effects, "approach": "both",
            "instrument": {"kind": "pose", "sigma": {"position": 2e-4, "rotation": 1e-5}},
            "conditions": CONDITIONS, "seed": 4}
    (folder / "s.yaml").write_text(yaml.safe_dump(data | changes))
    return "s.yaml"


def effect(kind: str, on: list[str] | None = None, **parameters: float) -> dict[str, Any]:
    return {"kind": kind, "parameters": parameters} | ({"on": on} if on else {})


def marked(effects: list[dict[str, Any]], start: dict[str, float]) -> list[dict[str, Any]]:
    """Return the effects as an engineer would write them: free, from nothing or a guess."""
    return [e | {"parameters": {
        n: v if n in CONSTANTS else {
            "value": start.get(f"{e['kind']}.{n}", 0.0), "free": True}
        for n, v in e["parameters"].items()}} for e in effects]


GUESSES = {"play.width": 0.02, "friction.speed": 6.0, "creep.tau": 90.0, "leg_thermal.tau": 250.0,
           "compliance.stiffness": 5000.0, "periodic.period": 7.1, "tilt.direction": 20.0,
           "tilt.shrink": 1e-4, "compliance.hardening": 0.01, "plate_compliance.reach": 400.0,
           "rope_height.height": 120.0}
# In each campaign effects that its poses can tell from one another and from the offsets.
CAMPAIGNS: dict[str, tuple[str, list[dict[str, Any]]]] = {
    "planar 1": ("3-RPR", [effect("backlash", ["leg1", "leg3"], width=0.03),
                           effect("compliance", stiffness=8000.0),
                           effect("leg_thermal", expansion=11e-6),
                           effect("drift", x=2e-6, y=-3e-6, rz=4e-7)]),
    "planar 2": ("3-RPR", [effect("gain", ["leg2"], gain=3e-4), effect("lag", tau=1e-3),
                           effect("periodic", ["leg1"], cos=0.01, sin=-0.02, period=7.0),
                           effect("clearance", ["leg2", "leg3"], width=0.02)]),
    "planar 3": ("3-RPR", [effect("windup", ["leg1"], width=2e-4),
                           effect("base_compliance", x_fy=2e-5, y_fy=-3e-5, rz_fy=1e-5),
                           effect("tilt", shrink=3e-4, direction=35.0),
                           effect("curvature", ["leg3"], p2=0.03, p3=-0.02, p4=0.02, low=300.0,
                                  high=460.0)]),
    "translational": ("delta-rotary", [
        effect("eccentricity", ["b"], cos=0.02, sin=-0.03, cos2=0.01, sin2=0.01),
        effect("backlash", ["a"], width=0.01), effect("base_thermal", expansion=15e-6),
        effect("sensor_scale", scale=2e-4)]),
    "spatial": ("6-UPS", [
        effect("compliance", stiffness=2000.0), effect("platform_thermal", expansion=20e-6),
        effect("backlash", ["leg2", "leg5"], width=0.05), effect("drift", z=3e-6, rx=2e-7)]),
    "touched flat": ("delta-rotary", [
        effect("bed_shape", saddle=0.08, twist=-0.05, trefoil_x=0.04, coma_x=0.03, radius=80.0)]),
    "base plate": ("6-UPS", [effect("plate_compliance", base=2e-3, reach=700.0)]),
    "platform plate": ("6-UPS", [effect("plate_compliance", platform=2e-3, reach=250.0)]),
    "stiffening": ("3-RPR", [
        effect("compliance", stiffness=1500.0, hardening=0.02, by_stroke=0.002, low=200.0,
               high=700.0)]),
    "inclined": ("6-UPS", [
        effect("compliance", stiffness=3000.0), effect("gravity_tilt", first=5.0, second=-8.0),
        effect("payload_offset", x=60.0, y=-90.0, z=80.0)]),
    "memory 1": ("3-RPR", [
        effect("play", ["leg1"], width=0.03), effect("creep", ["leg3"], give=2e-4, tau=150.0),
        effect("friction", ["leg2"], static=0.04, dynamic=0.01, speed=10.0),
        effect("leg_thermal", expansion=11e-6, tau=500.0)]),
    "memory 2": ("6-UPS", [
        effect("hysteresis", ["leg2"], w1=0.03, w2=0.01, w3=0.004, low=1900.0, high=3400.0),
        effect("product", ["leg4"], width=0.01) | {"of": ["backlash", "temperature"]},
        effect("leg_thermal", ["leg5"], growth=1e-4, tau=300.0) | {"from": "motion"}]),
    "events": ("6-UPS", [
        effect("zero_shift", ["leg3"], shift=0.05, from_row=12),
        effect("zero_shift", ["leg5"], shift=-0.03, from_row=30),
        effect("target_shift", x=0.02, y=0.01, z=-0.03, rx=0.002, ry=-0.003, rz=0.004, from_row=20),
        effect("base_shift", x=0.04, y=-0.05, z=0.03, rx=0.001, ry=0.002, rz=-0.003,
               from_row=36)]),
    "ropes": ("cable-4-planar", [effect("rope_stretch", ["c1"], strain=0.004)]),
    "frame of ropes": ("cable-4-planar", [effect("anchor_give", ["c2"], give=6.0)]),
    "heights of ropes": ("cable-4-planar", [effect("rope_height", ["c1"], height=150.0)]),
    "sides of ropes": ("cable-4-planar", [
        effect("side_shift", ["c1"], shift=3.0, at=0.0) | {"along": "x"},
        effect("side_shift", ["c3"], shift=-2.0, at=40.0) | {"along": "y"}]),
    "lengths of ropes": ("cable-4-planar", [effect("missing_length", length=40.0)]),
    "from the file": ("6-UPS", [effect("learned", ["leg2"], scale=1.0) | {
        "input": "travel", "nodes": [1000, 1900, 2000, 2100, 2200, 4000],
        "values": [0.0, 0.0, 0.05, -0.05, 0.0, 0.0],
        "covariance": [[0.0] * 6] * 6}]),
}


TOUCHES = {"instrument": {"kind": "plane", "sigma": {"height": 2e-4}}}


def test_every_kind_is_recovered_somewhere() -> None:
    """A kind of the package that no campaign below has fails here."""
    seen = {e["kind"] for _, effects in CAMPAIGNS.values() for e in effects}
    seen |= {"rope_elasticity"}     # in tests/kinematics/test_rope_elasticity.py
    assert {n for n, k in effect_kinds().items()
            if k.evaluate.__module__.startswith("ppmcal.")} <= seen


@pytest.mark.long_cases(
    "frame of ropes", "inclined", "lengths of ropes", "ropes", "base plate", "platform plate",
    "spatial")
@pytest.mark.slow
@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_simulated_effects_are_identified(tmp_path: Path, campaign: str) -> None:
    """Marked free, every parameter comes out within 4 sigma, and clear of its start."""
    name, effects = CAMPAIGNS[campaign]
    # once per turn and a zero error are one over a part of a turn; a constant of all zeros is one
    free = [] if {"eccentricity", "missing_length"} & {e["kind"] for e in effects} else ["*.offset"]
    plain = machine(tmp_path, name, [], "plain.yaml", free=free)
    approach = "sequence" if campaign.startswith("memory") else "both"
    plan = scenario(tmp_path, name, effects, errors={"random": {"scale": 1.0}}, approach=approach,
                    **(TOUCHES if campaign == "touched flat" else {}))
    ppmcal("simulate", plain, plan, "--out", "s", cwd=tmp_path, expect=0)
    truth = json.loads((tmp_path / "s" / "truth.json").read_text())
    assert [e["kind"] for e in truth["effects"]] == [e["kind"] for e in effects]
    open_ = machine(tmp_path, name, marked(effects, GUESSES), free=free)
    # normal noise has no outliers: every row counts
    ppmcal("identify", open_, "s/measurements.csv", "--holdout", "0", "--keep-outliers",
           "--out", "i", cwd=tmp_path, expect=0)
    found = {r["name"]: r for r in rows(tmp_path / "i" / "parameters.csv")}
    wanted = {f"{'.'.join([e['kind'], *(['+'.join(e['on'])] if 'on' in e else [])])}.{n}": v
              for e in effects for n, v in e["parameters"].items()
              if n not in CONSTANTS}
    assert set(wanted) <= set(found)
    for full, value in wanted.items():
        sigma, fitted = number(found[full], "sigma"), number(found[full], "value")
        assert abs(fitted - value) < 4.0 * sigma, (full, fitted, value, sigma)
        assert sigma < 0.1 * abs(value), (full, value, sigma)
        assert found[full]["status"] == "identified"
    # the model is again a mechanism file, with the effects in it
    model = yaml.safe_load((tmp_path / "i" / "identified.yaml").read_text())
    assert [e["kind"] for e in model["effects"]] == [e["kind"] for e in effects]
    for e, written in zip(effects, model["effects"], strict=True):
        assert written.get("on") == e.get("on")
        for n, v in e["parameters"].items():
            own = written["parameters"][n]
            if n in CONSTANTS:
                assert own == v
                continue
            assert own["value"] == pytest.approx(v, rel=0.5)
            assert own["sigma"] > 0.0
    assert read_mechanism(tmp_path / "i" / "identified.yaml").effects


def test_check_of_a_model_with_effects(tmp_path: Path) -> None:
    """Without measurements: what could be seen if every condition were recorded."""
    effects = CAMPAIGNS["planar 1"][1]
    machine(tmp_path, "3-RPR", marked(effects, GUESSES), free=["*.offset"])
    run = ppmcal("check", "m.yaml", "--json", cwd=tmp_path, expect=0)
    assert run.json["rank"] == run.json["columns"] == 3 + 6


NEEDS = {"backlash": "dir_leg1", "lag": "vel_leg1", "compliance": "payload",
         "leg_thermal": "temperature", "drift": "time", "base_compliance": "payload"}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One planar campaign without effects but with every condition recorded."""
    folder = tmp_path_factory.mktemp("bench")
    machine(folder, "3-RPR", [], "plain.yaml")
    ppmcal("simulate", "plain.yaml", scenario(folder, "3-RPR", []), "--out", "s", cwd=folder,
           expect=0)
    return folder


@pytest.mark.parametrize("kind", NEEDS)
def test_a_needed_column_that_is_not_there(bench: Path, tmp_path: Path, kind: str) -> None:
    """identify, kinematics and compensate name the file and the column, and write nothing."""
    missing = NEEDS[kind]
    values = {"backlash": {"width": 0.1}, "compliance": {"stiffness": 1e4}}.get(kind, {})
    model = machine(tmp_path, "3-RPR", [effect(kind, **values)])
    source = bench / "s" / "measurements.csv"
    sidecar = source.with_suffix(".yaml").read_text()
    (tmp_path / "run.yaml").write_text(sidecar)
    pick(source, [c for c in columns(source) if c != missing], tmp_path / "run.csv")
    pick(source, ["x", "y", "rz"], tmp_path / "wanted.csv")
    pick(source, ["q_leg1", "q_leg2", "q_leg3"], tmp_path / "joints.csv")
    for args in (("identify", model, "run.csv"),
                 ("kinematics", "inverse", model, "wanted.csv"),
                 ("kinematics", "forward", model, "joints.csv"),
                 ("compensate", model, "wanted.csv", "--frame", "base")):
        run = ppmcal(*args, "--out", "o", cwd=tmp_path, expect=2)
        assert missing in run.err
        assert next(a for a in args if a.endswith(".csv")) in run.err
        assert "Add the column" in " ".join(run.err.split())
        assert (f"--assume {missing}=VALUE" in " ".join(run.err.split())) == (
            args[0] == "compensate")
        assert "Traceback" not in run.err
        assert not (tmp_path / "o").exists()
    # an empty column is as good as none
    pick(source, columns(source), tmp_path / "run.csv")
    write_csv(tmp_path / "run.csv", [{**r, missing: ""} for r in rows(tmp_path / "run.csv")])
    assert missing in ppmcal("identify", model, "run.csv", "--out", "o", cwd=tmp_path,
                             expect=2).err


def test_a_scenario_that_does_not_set_what_an_effect_needs(tmp_path: Path) -> None:
    machine(tmp_path, "3-RPR", [])
    for kind, missing, values in (("compliance", "payload", {"stiffness": 1e4}),
                                  ("leg_thermal", "temperature", {"expansion": 1e-5})):
        plan = scenario(tmp_path, "3-RPR", [effect(kind, **values)], conditions={})
        run = ppmcal("simulate", "m.yaml", plan, "--out", "o", cwd=tmp_path, expect=2)
        assert "s.yaml" in run.err
        assert missing in run.err
        assert not (tmp_path / "o").exists()


@pytest.mark.slow
def test_kinds_that_nothing_shows_do_no_harm(bench: Path, tmp_path: Path) -> None:
    """Free effects that are not there: identified as next to nothing, in a file that reads."""
    effects = [effect("backlash", width=0.1), effect("compliance", stiffness=1e5)]
    model = machine(tmp_path, "3-RPR", marked(effects, {"compliance.stiffness": 1e5}),
                    free=["*.offset"])
    run = ppmcal("identify", model, bench / "s" / "measurements.csv", "--out", "i", cwd=tmp_path)
    assert run.code in (0, 1), run.err
    found = {r["name"]: r for r in rows(tmp_path / "i" / "parameters.csv")}
    assert abs(number(found["backlash.width"], "value")) < 4.0 * number(found["backlash.width"],
                                                                        "sigma")
    assert number(found["compliance.stiffness"], "value") > 1e6
    # the model reads back, whatever the noise made of it
    assert len(read_mechanism(tmp_path / "i" / "identified.yaml").effects) == 2


# --- kinematics and compensation ----------------------------------------------------------------

ACTING = [effect("backlash", ["leg1", "leg2"], width=0.2), effect("compliance", stiffness=3000.0),
          effect("drift", x=1e-4, rz=2e-5), effect("leg_thermal", expansion=20e-6),
          effect("gain", ["leg3"], gain=1e-3)]
WANTED = ["x", "y", "rz"]


def wanted_poses(folder: Path, count: int = 8, sequence: bool = False) -> list[dict[str, Any]]:
    """Write wanted poses with all conditions as wanted.csv."""
    rng = np.random.default_rng(5)
    table = []
    for n in range(count):
        x, y, rz = rng.uniform(-1, 1, 3).tolist()
        row: dict[str, Any] = {"x": 500 + 40 * x, "y": 288.675 + 40 * y, "rz": 30 + 4 * rz}
        if not sequence:
            row |= {f"dir_leg{i}": int(rng.choice([-1, 1])) for i in (1, 2, 3)}
        table.append(row | {"payload": 5 * (n % 3), "temperature": 17 + n, "time": 60 * n})
    write_csv(folder / "wanted.csv", table)
    return table


def pose_apart(a: Path, b: list[dict[str, Any]]) -> float:
    """Return the largest relative difference of poses."""
    return max(abs(number(r, c) - w[c]) / abs(w[c]) for r, w in zip(rows(a), b, strict=True)
               for c in WANTED)


@pytest.mark.slow
def test_kinematics_there_and_back(tmp_path: Path) -> None:
    """Inverse, then forward with the same conditions: the wanted poses; without effects, not."""
    model, plain = machine(tmp_path, "3-RPR", ACTING), machine(tmp_path, "3-RPR", [], "p.yaml")
    wanted = wanted_poses(tmp_path)
    ppmcal("kinematics", "inverse", model, "wanted.csv", "--out", "i", cwd=tmp_path, expect=0)
    joints = [c for c in columns(tmp_path / "i" / "kinematics.csv") if c not in WANTED
              and c not in ("condition", "status", "reason")]
    assert {"q_leg1", "dir_leg1", "payload", "temperature", "time"} <= set(joints)
    pick(tmp_path / "i" / "kinematics.csv", joints, tmp_path / "joints.csv")
    ppmcal("kinematics", "forward", model, "joints.csv", "--out", "f", cwd=tmp_path, expect=0)
    assert pose_apart(tmp_path / "f" / "kinematics.csv", wanted) < 1e-9
    ppmcal("kinematics", "forward", plain, "joints.csv", "--out", "g", cwd=tmp_path, expect=0)
    assert pose_apart(tmp_path / "g" / "kinematics.csv", wanted) > 1e-4


def compensated(folder: Path, *args: str) -> list[dict[str, str]]:
    """Compensate wanted.csv, send the commands through the forward kinematics into f/."""
    ppmcal("compensate", "m.yaml", "wanted.csv", "--frame", "base", *args, "--out", "c",
           cwd=folder)
    return rows(folder / "c" / "commands.csv")


@pytest.mark.slow
def test_commands_cancel_backlash_and_compliance(tmp_path: Path) -> None:
    """From dir_ and payload columns; sent to the machine, the commands reach what was wanted."""
    effects = ACTING[:2]
    machine(tmp_path, "3-RPR", effects)
    wanted = wanted_poses(tmp_path)
    commands = compensated(tmp_path)
    assert {r["status"] for r in commands} == {"ok"}
    own = [*(f"q_leg{i}" for i in (1, 2, 3)), *(f"dir_leg{i}" for i in (1, 2, 3)), "payload"]
    pick(tmp_path / "c" / "commands.csv", own, tmp_path / "send.csv")
    ppmcal("kinematics", "forward", "m.yaml", "send.csv", "--out", "f", cwd=tmp_path, expect=0)
    assert pose_apart(tmp_path / "f" / "kinematics.csv", wanted) < 1e-9
    # uncorrected, the error is what was predicted
    nominal = {f"q_leg{i}_nominal": f"q_leg{i}" for i in (1, 2, 3)} | {n: n for n in own[3:]}
    pick(tmp_path / "c" / "commands.csv", nominal, tmp_path / "send.csv")
    ppmcal("kinematics", "forward", "m.yaml", "send.csv", "--out", "g", cwd=tmp_path, expect=0)
    for r, w, c in zip(rows(tmp_path / "g" / "kinematics.csv"), wanted, commands, strict=True):
        error = np.hypot(number(r, "x") - w["x"], number(r, "y") - w["y"])
        assert number(c, "error_position_before") == pytest.approx(error, rel=1e-6)
        assert error > 1e-3
        assert np.isnan(number(c, "error_position_after")), "nobody says how sure the model is"


@pytest.mark.slow
def test_commands_with_every_effect(tmp_path: Path) -> None:
    """Drift, temperature and gain as well."""
    machine(tmp_path, "3-RPR", ACTING)
    wanted = wanted_poses(tmp_path)
    commands = compensated(tmp_path)
    assert {r["status"] for r in commands} == {"ok"}
    keep = [c for c in columns(tmp_path / "c" / "commands.csv")
            if c in wanted[0] and c not in WANTED]
    pick(tmp_path / "c" / "commands.csv", [*keep, "q_leg1", "q_leg2", "q_leg3"],
         tmp_path / "send.csv")
    ppmcal("kinematics", "forward", "m.yaml", "send.csv", "--out", "f", cwd=tmp_path, expect=0)
    assert pose_apart(tmp_path / "f" / "kinematics.csv", wanted) < 1e-9


def test_commands_of_a_sequence(tmp_path: Path) -> None:
    """The order of the targets gives the directions; before the first move there is none."""
    machine(tmp_path, "3-RPR", ACTING[:1])
    wanted = wanted_poses(tmp_path, sequence=True)
    commands = compensated(tmp_path, "--approach", "sequence")
    assert commands[0]["status"] == "refused"
    assert "not given" in commands[0]["reason"]
    assert {r["status"] for r in commands[1:]} == {"ok"}
    q = np.array([[number(r, f"q_leg{i}_nominal") for i in (1, 2, 3)] for r in commands])
    way = np.sign(np.diff(q, axis=0)).astype(int)
    send = [{f"q_leg{i + 1}": r[f"q_leg{i + 1}"] for i in range(3)}
            | {f"dir_leg{i + 1}": w[i] for i in range(3)}
            for r, w in zip(commands[1:], way, strict=True)]
    write_csv(tmp_path / "send.csv", send)
    ppmcal("kinematics", "forward", "m.yaml", "send.csv", "--out", "f", cwd=tmp_path, expect=0)
    assert pose_apart(tmp_path / "f" / "kinematics.csv", wanted[1:]) < 1e-9


def test_commands_of_rows_that_lack_a_condition(tmp_path: Path) -> None:
    """Row by row: refused with a reason, the others have commands."""
    machine(tmp_path, "3-RPR", ACTING[1:2])
    table = wanted_poses(tmp_path)
    table[2]["payload"] = ""
    write_csv(tmp_path / "wanted.csv", table)
    commands = compensated(tmp_path)
    assert [n for n, r in enumerate(commands) if r["status"] != "ok"] == [2]
    assert np.isnan(number(commands[2], "q_leg1"))
    assert commands[2]["reason"]


# --- kinds of other packages --------------------------------------------------------------------

FOREIGN = '''"""An effect that a user's own package adds: a joint that sags with the time of day."""

import numpy as np

from ppmcal.model.effects.kind import EffectKind, EffectParameter, Worked, fixed_list, linear


def terms(setting, on, values):
    shape = np.cos(2.0 * np.pi * setting.time / 86400.0)[:, None] + 0.0 * setting.travel
    return linear(values, {"size": setting.at_joints(shape, on)})


KIND = EffectKind("daily", "du = size cos(2 pi time/day)", "the workshop's diary",
                  fixed_list(EffectParameter("size", "joint")), ("time",), terms,
                  worked=Worked({"size": 1e-5}, {"time": 43200.0, "travel": 0.0}, -1e-5))
'''


@pytest.mark.long
def test_a_kind_of_another_package(tmp_path: Path) -> None:
    """Installed with the entry-point group ppmcal.effects, it is read, simulated and fitted."""
    site = install(tmp_path / "site", "workshop", FOREIGN, {"ppmcal.effects": {"daily": "KIND"}})
    own = effect("daily", ["leg2"], size=0.05)
    machine(tmp_path, "3-RPR", [], "plain.yaml")
    scenario(tmp_path, "3-RPR", [own])
    machine(tmp_path, "3-RPR", marked([own], {}), free=["*.offset"])
    for args in (["simulate", "plain.yaml", "s.yaml", "--out", "s"],
                 ["identify", "m.yaml", "s/measurements.csv", "--holdout", "0", "--out", "i"]):
        ppmcal_process(*args, cwd=tmp_path, site=site, expect=0)
    found = {r["name"]: r for r in rows(tmp_path / "i" / "parameters.csv")}
    size = found["daily.leg2.size"]
    assert abs(number(size, "value") - 0.05) < 4.0 * number(size, "sigma")
    # without the package the file is refused, and says what there is
    assert "daily" not in effect_kinds()
    run = ppmcal("check", "m.yaml", cwd=tmp_path, expect=2)
    assert "unknown effect 'daily'" in " ".join(run.err.split())


@pytest.mark.slow
def test_a_name_that_is_taken(tmp_path: Path) -> None:
    """Two kinds of one name are refused when they are registered."""
    code = ("from ppmcal.model.effects import effect_kinds, register\n"
            "register(effect_kinds()['lag'])\n")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          timeout=60, check=False)
    assert done.returncode == 1
    assert "'lag' is registered twice" in done.stderr


@pytest.mark.parametrize(("effects", "told"), [
    ([effect("zero_shift", ["leg2"], shift=0.3, from_row=21)],
     "from row 21 of the measurements on, with zero_shift.leg2.shift = 0.3 mm. If"),
    ([effect("backlash", ["leg2"], width=0.03)], "")])
def test_commands_say_which_event_they_are_after(tmp_path: Path, effects: Any, told: str) -> None:
    """Nobody can see in data whether a leg was homed back since: whoever sends commands must."""
    model = machine(tmp_path, "3-RPR", effects)
    write_csv(tmp_path / "t.csv", [{"x": 480.0, "y": 300.0, "rz": 35.0}])
    done = ppmcal("compensate", model, "t.csv", "--frame", "base", cwd=tmp_path)
    said = " ".join((done.out + done.err).split())
    assert told in said
    assert ("take the effect out of the mechanism file" in said) == bool(told)
