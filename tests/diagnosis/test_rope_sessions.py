"""Machines over several sessions, and ropes with force sensors: what is hidden is named."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from helpers.commands import ppmcal as run
from ropes.machines import MACHINES, SQUARE
from ropes.world import CAUSES, session
from ropes_study import write

import ppmcal
from ppmcal.calibration.fit import FitOptions, Problem, identify
from ppmcal.commands.diagnose.run import as_filed
from ppmcal.diagnosis.at_sessions import session_starts, with_sessions
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.question import blocks
from ppmcal.errors import BadInput
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.priors import ALL_ALIKE, MOVED
from ppmcal.inference.question import Question
from ppmcal.io.campaign import read_campaign
from ppmcal.io.mechanism_reader import read_mechanism


def files(folder, machine, cause, eta, seed):
    """Return the machine and data of one campaign, and what was hidden."""
    rng = np.random.default_rng([seed, *machine.encode(), *cause.encode()])
    at = (MACHINES | SQUARE)[machine]
    done = session(at, cause, eta, rng, 40, 3)
    return *write(at, done, folder, CAUSES[cause][0] is not None), done


def told(folder, machine, cause, eta, seed):
    """Return diagnosis.json of one campaign."""
    file, data, _ = files(folder, machine, cause, eta, seed)
    ppmcal.diagnose(file, data).save(folder / "out")
    return json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))


def named(found):
    """Return what each place is named for, with what may be there instead."""
    return [{e["kind"], *(a.split()[0] for a in e["alternatives"])} for e in found["effects"]]


@pytest.fixture(scope="module")
def days(tmp_path_factory):
    """Return the system of belts over three sessions in which nothing is hidden."""
    file, data, _ = files(tmp_path_factory.mktemp("days"), "belts", "none-by-day", 1.0, 911)
    machine = read_mechanism(file)
    return identify(Problem(machine, read_campaign([data], machine), machine.free), FitOptions())


@pytest.mark.parametrize(("machine", "cause", "eta", "seed"), [
    ("belts", "homed", 0.5, 901), ("cables", "homed", 0.5, 904), ("belts", "pulled", 1.0, 900),
    ("cables", "pulled", 0.5, 905), ("cables", "elastic", 1.0, 901),
    ("cage-square", "homed", 1.0, 902), ("cables-square", "homed", 2.0, 903),
    ("five-bar", "homed", 1.0, 901), ("seven-legs", "homed", 0.5, 901),
    ("belts", "sides", 1.0, 901), ("cables", "sides", 1.0, 902),
    ("belts", "slipped-in-columns", 1.0, 903)])
@pytest.mark.long
def test_what_is_hidden_is_named(machine, cause, eta, seed, tmp_path):
    found = told(tmp_path, machine, cause, eta, seed)
    sets, right = named(found), CAUSES[cause][1]
    assert sets and all(s & right for s in sets)


@pytest.mark.parametrize("machine", ["belts", "cables"])
@pytest.mark.parametrize("cause", ["none-by-day", "none-in-force"])
@pytest.mark.long
def test_nothing_is_named_where_nothing_is_hidden(machine, cause, tmp_path):
    assert told(tmp_path, machine, cause, 1.0, 906)["verdict"] == "none"


@pytest.mark.long
def test_a_changed_pull_is_told_by_session(tmp_path):
    found = told(tmp_path, "belts", "pulled", 1.0, 901)
    strain = [s["parameters"]["strain"] for s in found["effects"][0]["sessions"]]
    assert len(strain) == 3
    assert strain[2]["low"] > strain[0]["high"] or strain[2]["high"] < strain[0]["low"]
    assert any("differs between sessions" in text for text in found["findings"])


@pytest.mark.long
def test_joints_homed_anew_are_told_with_their_session(tmp_path):
    found = told(tmp_path, "belts", "homed", 1.0, 901)
    assert any("begins with session" in text for text in found["findings"])
    assert {e["row"]["value"] for e in found["effects"]} <= {1, 43, 82}


@pytest.mark.slow
def test_sessions_start_where_their_first_rows_are(days):
    session_of = days.problem.datasets[0].sessions
    first = {s: 1 + session_of.index(s) for s in ("1", "2", "3")}
    assert session_starts(days.problem) == first


@pytest.mark.slow
def test_what_is_homed_anew_with_one_session_is_likelier_so_with_the_next(days):
    """Rather than another thing: whoever homes joints each morning does so each morning."""
    system = build(days.problem, days.state, days.keep)
    every = [(b, h) for b, h in blocks(library(system, ["zero_shift"])) if h.begins]
    asked = Question(MatrixColumns(np.zeros((1, 0))), np.zeros(1), np.zeros((1, 0)),
                     tuple(b for b, _ in every), np.ones((1, 1), dtype=bool),
                     np.zeros(0, dtype=np.int64))
    own = {h.begins: n for n, (_, h) in enumerate(every) if not h.shared and not h.beside}
    one, both = asked.log_prior([own["2"]]), asked.log_prior([own["2"], own["3"]])
    assert np.exp(both - one) == pytest.approx(0.5)    # FURTHER, either of two


@pytest.mark.slow
def test_sessions_that_a_fit_has_apart_are_of_their_file(days):
    """Where the instrument was moved between them each has a frame of its own."""
    data, = days.problem.datasets
    first, other = (np.array([s == label for s in data.sessions]) for label in "12")
    apart = [data.take(first), replace(data.take(other), name=f"{data.name} 2")]
    assert as_filed(apart, [data]) == [data, data]


@pytest.mark.slow
def test_sessions_that_overlap_have_no_start(days):
    data = days.problem.datasets[0]
    mixed = replace(data, sessions=tuple(np.roll(data.sessions, 10).tolist()))
    assert session_starts(days.problem.changed(datasets=(mixed,))) == {}


@pytest.mark.slow
def test_what_begins_with_a_session_is_as_likely_as_what_is_homed_anew(days):
    system = build(days.problem, days.state, days.keep)
    pairs = [(b, h) for b, h in blocks(library(system, ["zero_shift"])) if getattr(
        h, "begins", "")]
    later = [b.log_prior for b, h in pairs if h.begins == "2"]
    assert np.exp(later).sum() == pytest.approx(float(MOVED))
    assert [np.exp(b.log_prior) for b, h in pairs if h.begins == "1"] == pytest.approx(
        [float(ALL_ALIKE)])
    sets = with_sessions([h for _, h in pairs])
    assert [len(s) for s in sets] == [2, 3]
    assert sets[0] < sets[1]


@pytest.mark.long
def test_tensions_that_are_missing_are_named(tmp_path):
    found = told(tmp_path, "belts", "none", 1.0, 907)
    lack = {u["kind"]: u["missing"] for u in found["not_testable"]}
    assert lack["elasticity and weight of ropes"] == [f"tension_r{i}" for i in range(1, 5)]
    assert "elasticity and weight of ropes" not in {
        u["kind"] for u in told(tmp_path, "belts", "none-in-force", 1.0, 907)["not_testable"]}


SCENARIO = {
    "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
    "poses": {"random": {"center": {"x": 1500, "y": 1050}, "half_range": {"x": 900, "y": 500},
                         "count": 30}},
    "effects": [{"kind": "rope_elasticity", "parameters": {"elongation": 5e-6}}],
    "instrument": {"kind": "none", "sigma": {"actuator": 0.2}},
    "errors": {"random": {"scale": 0.3}},
    "conditions": {"tension": [20, 100]}, "seed": 12}


@pytest.mark.long
def test_a_hidden_elongation_is_simulated_and_found(tmp_path):
    machine = ppmcal.load(ppmcal.shipped("maslow"))
    made = ppmcal.simulate(machine, SCENARIO).data[0]
    found = ppmcal.diagnose(machine, made)
    assert [e.kind for e in found.diagnosis.effects][:1] == ["rope_elasticity"]


def test_tensions_are_refused_where_no_ropes_pull_against_each_other():
    with pytest.raises(BadInput, match="no ropes of this machine") as error:
        ppmcal.simulate(ppmcal.load(ppmcal.shipped("3-RPR")), SCENARIO | {
            "poses": {"random": {"center": {"x": 500, "y": 260, "rz": 25},
                                 "half_range": {"x": 70, "y": 70, "rz": 8}, "count": 20}},
            "effects": [], "instrument": {"kind": "pose", "sigma": {
                "position": 0.005, "rotation": 0.001}}})
    assert error.value.where.endswith("conditions.tension")


@pytest.mark.long
def test_elongation_is_planned_for_by_tensions(tmp_path):
    side = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "none", "sigma": {"actuator": 0.3}}}
    path = tmp_path / "none.yaml"
    path.write_text(json.dumps(side), encoding="utf-8")
    ask = partial(ppmcal.plan, ppmcal.shipped("maslow"), instrument=path, count=12,
                  effects=["rope_elasticity"])
    with pytest.raises(BadInput, match="pulled tight by several forces"):
        ask()
    ask(tension="20,80").save(tmp_path / "plan")
    head, *rows = (tmp_path / "plan" / "poses.csv").read_text(encoding="utf-8").splitlines()
    at = [n for n, c in enumerate(head.split(",")) if c.startswith("tension_")]
    mean = np.array([[float(row.split(",")[n]) for n in at] for row in rows]).mean(axis=1)
    assert len(at) == 4
    assert {round(m) for m in mean.tolist()} == {20, 80}


@pytest.mark.long
def test_the_command_line_simulates_finds_and_plans_elongation(tmp_path):
    machine = str(ppmcal.shipped("maslow"))
    scenario, none = tmp_path / "scenario.yaml", tmp_path / "none.yaml"
    scenario.write_text(json.dumps(SCENARIO), encoding="utf-8")
    none.write_text(json.dumps({key: SCENARIO[key] for key in ("units", "instrument")} | {
        "format": "ppmcal/dataset/1"}), encoding="utf-8")
    out = tmp_path / "simulated"
    assert run("simulate", machine, scenario, "--out", out).code == 0
    done = run("diagnose", machine, out / "measurements.csv", "--out", tmp_path / "found")
    assert done.code == 0, done.err
    assert "elasticity and weight of ropes on all 4 actuators: elongation" in done.out
    done = run("plan", machine, "--instrument", none, "--count", "12", "--for", "rope_elasticity",
               "--tension", "20,80", "--out", tmp_path / "plan")
    assert done.code == 0, done.err
    assert "Pull ropes tight by the forces of the tension_ columns" in " ".join(
        done.out.split())
