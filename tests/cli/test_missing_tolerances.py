"""A file without tolerances: every command says the same, and none fails for it."""

from __future__ import annotations

import json

import pytest
from helpers.commands import ppmcal

import ppmcal as face


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """A 3-RPR without tolerances, measured, with its identification."""
    folder = tmp_path_factory.mktemp("bare")
    machine = face.load(face.shipped("3-RPR"))
    text = face.shipped("3-RPR").read_text(encoding="utf-8")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("tolerances"))
    (folder / "m.yaml").write_text(text, encoding="utf-8")
    face.simulate(machine, face.shipped("3-RPR", scenario=True), seed=3).save(folder / "simulated")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("words", [
    "identify m.yaml simulated/measurements.csv", "sensitivity m.yaml --home-only",
    "plan m.yaml --count 6", "tolerances m.yaml --accuracy 1 --machines 20",
    "workspace m.yaml --grid x=450:550:3,y=240:340:3", "simulate m.yaml simulated/scenario.yaml",
    "diagnose m.yaml simulated/measurements.csv --kind backlash",
    "validate m.yaml simulated/measurements.csv"])
def test_every_command_tells_it_and_none_fails_for_it(bare, words, tmp_path):
    if "scenario" in words:
        scenario = face.shipped("3-RPR", scenario=True).read_text(encoding="utf-8")
        (bare / "simulated" / "scenario.yaml").write_text(scenario, encoding="utf-8")
    done = ppmcal(*words.split(), "--out", str(tmp_path / "out"), cwd=bare)
    said = " ".join((done.out + done.err).split())
    assert "no tolerance is given for 'point'" in said
    assert "1/1000 of the reach" in said
    assert done.code == 0, said


@pytest.mark.slow
def test_it_stands_in_the_records_too(bare, tmp_path):
    ppmcal("identify", "m.yaml", "simulated/measurements.csv", "--out", str(tmp_path / "out"),
           cwd=bare)
    record = json.loads((tmp_path / "out" / "identification.json").read_text(encoding="utf-8"))
    assert [f for f in record["findings"] if "no tolerance is given" in f]
