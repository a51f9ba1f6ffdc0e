"""A fit that cannot check its noise says so, and what is redundant is asked of one function."""

from __future__ import annotations

import json

import pytest
import yaml
from helpers.commands import ppmcal as command
from helpers.commands import rows
from helpers.paths import ROOT

import ppmcal

SENTENCE = "too few to check the noise by"


def campaign(folder, count, **changes):
    """A planar machine and so many measured poses."""
    (folder / "m.yaml").write_bytes((ROOT / "configs" / "3-RPR.yaml").read_bytes())
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": {"x": 500, "y": 288, "rz": 30}, "half_range": {
                    "x": 90, "y": 90, "rz": 10}, "count": count}},
                "errors": {"random": {"scale": 1.0}}, "seed": 3,
                "instrument": {"kind": "pose", "sigma": {"position": 0.02, "rotation": 0.004}},
                "frame": {"x": 4, "y": -3, "rz": 1}, "target": [3, -2]}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario | changes))
    command("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=folder, expect=0)
    return folder


@pytest.mark.parametrize(("count", "code"), [(6, 1), (7, 0), (20, 0)])
@pytest.mark.slow
def test_the_exit_code_says_whether_noise_could_be_checked(tmp_path, count, code):
    """Three values a pose; 14 of 17 columns are determined: 18 leave 4, 21 leave 7."""
    campaign(tmp_path, count)
    run = command("identify", "m.yaml", "s/measurements.csv", "--out", "i", "--json",
                  cwd=tmp_path, expect=code)
    found = json.loads((tmp_path / "i" / "identification.json").read_text())
    assert any(SENTENCE in f for f in found["findings"]) == bool(code)
    assert any(SENTENCE in f for f in run.json["findings"]) == bool(code)
    if code:
        assert any(f.startswith("18 measured values for 14 ") for f in found["findings"])


@pytest.mark.parametrize("count", [6, 20])
@pytest.mark.slow
def test_check_and_identify_name_the_same_redundant_columns(tmp_path, count):
    campaign(tmp_path, count)
    seen = command("check", "m.yaml", "s/measurements.csv", "--json", cwd=tmp_path).json
    command("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=tmp_path)
    found = json.loads((tmp_path / "i" / "identification.json").read_text())
    assert sorted([*seen["redundant"], *seen["unseen"]]) == sorted(
        d["name"] for d in found["redundant"])


@pytest.mark.slow
def test_the_start_of_a_fitted_stiffness_is_no_nominal(tmp_path):
    """A stiffness begins somewhere; a width has the file's value for nominal."""
    tree = yaml.safe_load((ROOT / "configs" / "3-RPR.yaml").read_text())
    effects = [{"kind": "compliance", "on": ["leg1"], "parameters": {"stiffness": 500}},
               {"kind": "backlash", "on": ["leg2"], "parameters": {"width": 0.3}}]
    campaign(tmp_path, 20, errors={}, approach="both", effects=effects,
             conditions={"payload": [0, 20, 40]})
    begun = [{**e, "parameters": {n: {"value": 1.2 * v, "free": True}
                                  for n, v in e["parameters"].items()}} for e in effects]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree | {"effects": begun}))
    command("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=tmp_path)
    lines = {r["name"]: r for r in rows(tmp_path / "i" / "parameters.csv")}
    stiffness, width = lines["compliance.leg1.stiffness"], lines["backlash.leg2.width"]
    assert stiffness["nominal"] == stiffness["error"] == ""
    assert float(stiffness["value"]) == pytest.approx(500, rel=0.2)
    assert float(width["nominal"]) == 0.36
    entries = json.loads((tmp_path / "i" / "identification.json").read_text())["parameters"]
    entry = next(e for e in entries if e["name"] == "compliance.leg1.stiffness")
    assert entry.get("nominal") is None and entry.get("error") is None
    assert ppmcal.load(tmp_path / "i" / "identified.yaml").effects
