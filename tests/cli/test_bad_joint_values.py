"""Joint values alone that are no machine's, by the command line: one message with the cause."""

import csv

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.paths import ROOT

ROPE = {"cable-4-planar": "c2", "cable-8": "c2", "maslow": "br"}


def campaign(folder, name, count=30, sigma=0.3, change=None, **more):
    """Return a shipped machine's file and what it read without an instrument, each by the program.

    ``change``: what the file that `identify` reads has otherwise.
    """
    tree = yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8"))
    scenario = yaml.safe_load((ROOT / "configs" / "scenarios" / f"{name}.yaml").read_text(
        encoding="utf-8"))
    del scenario["frame"]
    scenario.pop("target", None)
    scenario["poses"]["random"]["count"] = count
    scenario |= {"instrument": {"kind": "none", "sigma": {"actuator": sigma}}, "seed": 5, **more}
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    ppmcal("simulate", path, folder / "scenario.yaml", "--out", folder / "try", expect=0)
    if change:
        change(tree)
        path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path, folder / "try" / "measurements.csv"


def edited(path, change):
    """Change a table, a function of its rows, in place."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    rows = change(rows)
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def slackened(column, rows, by):
    def change(table):
        for n, more in zip(rows, by, strict=True):
            table[n][column] = repr(float(table[n][column]) + float(more))
        return table
    return change


def findings(folder, path, data):
    """Return what `identify` says beside its numbers, each sentence in one line."""
    out = ppmcal("identify", path, data, "--out", folder / "found", "--json")
    return out.code, out.json["findings"]


@pytest.mark.parametrize("name", [
    "cable-4-planar", "maslow", pytest.param("cable-8", marks=pytest.mark.slow)])
@pytest.mark.long
def test_a_rope_that_is_slack_in_most_rows_is_a_finding(name, tmp_path):
    path, data = campaign(tmp_path, name)
    rng = np.random.default_rng(2)
    rows, by = rng.permutation(30)[:20], rng.uniform(5.0, 15.0, 20)
    edited(data, slackened(f"q_{ROPE[name]}", rows, by))
    code, said = findings(tmp_path, path, data)
    (told,) = [f for f in said if "slack?" in f]
    first = ", ".join(str(n + 1) for n in sorted(rows)[:5])
    assert code == 1 and f"reads long in 20 of 30 rows (rows {first} (+15 more)" in told
    if name == "cable-4-planar":    # one contradiction a row does not tell of which rope it is
        assert "one of c" in told and ROPE[name] in told.split("reads long")[0]
    else:
        assert f"{ROPE[name]} reads long" in told


@pytest.mark.slow
def test_slack_is_asked_of_rows_that_were_left_out_too(tmp_path):
    """Where gross errors explain it the others agree with the noise, and the rope is told still."""
    path, data = campaign(tmp_path, "maslow", 40)
    rng = np.random.default_rng(3)
    edited(data, slackened("q_br", rng.permutation(40)[:8], rng.uniform(6.0, 30.0, 8)))
    code, said = findings(tmp_path, path, data)
    assert any("rows left out" in f for f in said)
    (told,) = [f for f in said if "slack?" in f]
    assert code == 1 and "br reads long in 8 of 40 rows" in told


@pytest.mark.slow
def test_a_rope_that_reads_long_in_every_row_of_one_file_has_another_zero_there(tmp_path):
    """To leave its rows out would be no advice."""
    path, data = campaign(tmp_path, "maslow", 40)
    other = data.with_name("other.csv")
    other.write_bytes(data.read_bytes())
    side = yaml.safe_load(data.with_suffix(".yaml").read_text(encoding="utf-8"))
    side["instrument"]["sigma"]["estimated"] = True
    for file, name in ((data, "one"), (other, "other")):
        file.with_suffix(".yaml").write_text(yaml.safe_dump({**side, "name": name}))
    edited(other, slackened("q_br", range(40), np.full(40, 40.0)))
    out = ppmcal("identify", path, data, other, "--out", tmp_path / "found", "--json")
    told = [f for f in out.json["findings"] if "br reads long" in f]
    assert told and all("in every row" in f and "`homing: per-file`" in f for f in told)


@pytest.mark.long_cases("backlash", "noise", "shift")
@pytest.mark.parametrize("change", [None, "backlash", "shift", "noise"])
@pytest.mark.slow
def test_what_is_not_slack_is_not_called_so(change, tmp_path):
    effects = {"backlash": [{"kind": "backlash", "on": ["br"], "parameters": {"width": 8}}],
               "shift": [{"kind": "zero_shift", "on": ["br"],
                          "parameters": {"shift": 8, "from_row": 15}}]}.get(change or "", [])
    path, data = campaign(tmp_path, "maslow", 40, effects=effects,
                          approach="both" if change == "backlash" else "one")
    if change == "noise":       # off to both sides, as much as a slack rope would be
        rng = np.random.default_rng(3)
        edited(data, slackened("q_br", range(40), rng.uniform(-15.0, 15.0, 40)))
    code, said = findings(tmp_path, path, data)
    assert not [f for f in said if "slack?" in f]
    assert (code == 0) == (change is None)


def test_poses_that_a_check_looks_from_are_where_limbs_in_surplus_are(tmp_path):
    """Not where an instrument would say: what differs from side to side shows about home."""
    tree = yaml.safe_load((ROOT / "configs" / "maslow.yaml").read_text(encoding="utf-8"))
    tree["effects"] = [{"kind": "side_shift", "along": "x", "on": ["br"],
                        "parameters": {"shift": {"value": 0, "free": True}}}]
    (tmp_path / "belts.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
    out = ppmcal("check", tmp_path / "belts.yaml", "--json")
    assert out.code == 0 and not out.json["findings"]
