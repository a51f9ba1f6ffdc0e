"""Every number column of every CSV that a command writes has its unit in a JSON beside it."""

from __future__ import annotations

import json
from fnmatch import fnmatchcase

import pytest
import yaml
from helpers.commands import columns, ppmcal, rows
from helpers.paths import ROOT

BARE = ("row", "pose", "used", "mode", "own", "condition", "dir_*", "quat_*", "rows", "noise",
        "disagree", "condition_relative", "determinant", "dexterity*", "grid_end", "relative",
        "home", "n", "gain", "share*")
"""Columns that are bare numbers: counts, flags, ratios and chances."""


def stated(folder):
    """Every (file or '', column) -> unit that a JSON file of a folder states."""
    out = {}
    for path in folder.glob("*.json"):
        content = json.loads(path.read_text())
        for key in ("units", "column_units", "number_units"):
            for name, unit in (content.get(key) or {}).items():
                if isinstance(unit, dict):
                    out |= {(name, column): u for column, u in unit.items()}
                else:
                    out["", name] = unit
    return out


def is_number(values):
    try:
        found = [float(v) for v in values if v != ""]
    except ValueError:
        return False
    return bool(found)


def without_unit(folder):
    """Number columns of a folder's CSV files whose unit nobody states."""
    units, out = stated(folder), []
    for path in sorted(folder.glob("*.csv")):
        table = rows(path)
        for name in columns(path):
            if "unit" in (table[0] if table else {}) or not is_number([r[name] for r in table]):
                continue
            unit = units.get((path.name, name), units.get(("", name)))
            bare = any(fnmatchcase(name, pattern) for pattern in BARE)
            if not (unit or bare):
                out.append(f"{folder.name}/{path.name}: {name}")
    return out


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    (folder / "m.yaml").write_bytes((ROOT / "configs" / "3-RPR.yaml").read_bytes())
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": {"x": 500, "y": 288, "rz": 30}, "half_range": {
                    "x": 60, "y": 60, "rz": 8}, "count": 12}}, "approach": "both",
                "errors": {"random": {"scale": 1.0}}, "seed": 3,
                "conditions": {"payload": [0, 20], "temperature": {"mean": 20, "swing": 4}},
                "instrument": {"kind": "pose", "sigma": {"position": 0.02, "rotation": 0.004}}}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=folder, expect=0)
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=folder)
    return folder


COMMANDS = {
    "identify": ("i", None),
    "inverse": ("k", ["kinematics", "inverse", "i/identified.yaml", "t.csv"]),
    "forward": ("f", ["kinematics", "forward", "i/identified.yaml", "s/measurements.csv"]),
    "all modes": ("a", ["kinematics", "forward", "m.yaml", "q.csv", "--all"]),
    "velocity": ("v", ["kinematics", "velocity", "i/identified.yaml", "t.csv"]),
    "compensate": ("c", ["compensate", "i/identified.yaml", "t.csv"]),
    "validate": ("w", ["validate", "i/identified.yaml", "s/measurements.csv"]),
    "compare": ("p", ["compare", "i", "i"]),
    "sensitivity": ("e", ["sensitivity", "m.yaml", "--grid", "x=400:600:3,y=200:300:3"]),
    "tolerances": ("o", ["tolerances", "m.yaml", "--accuracy", "0.5", "--machines", "20"]),
    "workspace": ("r", ["workspace", "m.yaml", "--grid", "x=300:700:5,y=100:400:5"]),
    "plan": ("n", ["plan", "m.yaml", "--count", "6"]),
}


@pytest.mark.slow_cases("tolerances", "workspace", "plan", "sensitivity", "compare", "identify")
@pytest.mark.parametrize("name", COMMANDS)
def test_every_number_has_a_unit(campaign, name):
    out, words = COMMANDS[name]
    (campaign / "t.csv").write_text(
        "x,y,rz,vx,vy,wz,time,payload,temperature\n510,290,30,1,2,3,0,1,20\n")
    (campaign / "q.csv").write_text("q_leg1,q_leg2,q_leg3\n450,330,340\n")
    if words:
        run = ppmcal(*words, "--out", out, cwd=campaign)
        assert run.code in (0, 1), run.err
    assert list((campaign / out).glob("*.csv"))
    assert without_unit(campaign / out) == []


def test_a_column_without_a_unit_would_be_found(tmp_path):
    (tmp_path / "a.csv").write_text("row,depth,name\n1,2.5,x\n")
    (tmp_path / "a.json").write_text('{"units": {}}')
    assert without_unit(tmp_path) == [f"{tmp_path.name}/a.csv: depth"]
