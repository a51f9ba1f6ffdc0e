"""Forward kinematics with all assembly modes of each row."""

import csv
import json

import numpy as np
import pytest
from helpers import machines
from helpers.commands import ppmcal

import ppmcal as face
from ppmcal.design.assembly_modes import assembly_modes
from ppmcal.design.every_mode import OTHER, every_mode
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.tables import forward_table

CLOSED = {"R(P)R": lambda: machines.plain("R(P)R"), "(R)RR": lambda: machines.plain("(R)RR"),
          "delta": lambda: machines.delta("(P)US", 3), "tripod": lambda: machines.plain("R(P)S")}


def modes_of(mechanism, q, method="newton"):
    model = Model(mechanism)
    return every_mode(model, forward_table(model, q), method)


@pytest.mark.parametrize("name", CLOSED)
@pytest.mark.slow_cases("tripod")
def test_every_pose_closes_and_one_is_the_machines_own(name):
    mechanism = CLOSED[name]()
    model = Model(mechanism)
    q, pose = machines.spread(model, 3)
    found = modes_of(mechanism, q, "intersection")
    motors = pose_motor(found.table.pose)
    assert np.abs(model.closure(found.table.q).lengths(motors)).max() < 1e-9 * mechanism.reach
    assert found.row[found.own].tolist() == [0, 1, 2] and found.mode[found.own].tolist() == [1] * 3
    assert np.abs(machines.difference(motors[found.own], pose)).max() < 1e-9
    assert {s for s, own in zip(found.table.status, found.own, strict=True) if not own} == {OTHER}
    assert found.complete and found.method == "intersection"
    both = modes_of(mechanism, q)
    assert np.bincount(both.row).tolist() == np.bincount(found.row).tolist()
    assert len(found.row) > 3


def test_the_modes_are_those_of_workspace():
    mechanism = machines.plain("R(P)R")
    q = home_state(mechanism).q
    found = modes_of(mechanism, q[None])
    known = assembly_modes(Model(mechanism), q)
    np.testing.assert_allclose(pose_motor(found.table.pose), known.motors, atol=1e-12)
    assert found.method == "resultant" and found.complete


def test_a_row_without_a_pose_has_one_line():
    mechanism = machines.plain("R(P)R")
    q = np.array([home_state(mechanism).q, [0.05, 0.9, 0.05], [np.nan, 0.3, 0.3]])
    found = modes_of(mechanism, q)
    assert found.mode[found.row > 0].tolist() == [0, 0]
    assert np.isnan(found.table.pose[found.row > 0]).all()
    assert "missing" in found.table.reason[-1]


def test_a_machine_with_effects_is_refused():
    mechanism = machines.read_text(machines.plain_text(
        "R(P)R", effects=[{"kind": "gain", "parameters": {"gain": 0.001}}]))
    with pytest.raises(BadInput, match="geometry alone"):
        face.forward(mechanism, np.array([home_state(mechanism).q]) * 1e3, all_modes=True)


# --- the command ------------------------------------------------------------------------------

def test_the_command_writes_a_line_for_each_mode(tmp_path):
    (tmp_path / "m.yaml").write_text(machines.plain_text("R(P)R"))
    mechanism = machines.plain("R(P)R")
    q, _ = machines.spread(Model(mechanism), 2)
    (tmp_path / "q.csv").write_text("note,q_leg1,q_leg2,q_leg3\n" + "".join(
        f"{word},{','.join(repr(1e3 * float(v)) for v in row)}\n"
        for word, row in zip(("first", "second"), q, strict=True)))
    run = ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--all", "--tool", "10,0",
                 cwd=tmp_path, expect=0)
    assert "Assembly modes in each row" in " ".join(run.out.split())
    with (tmp_path / "kinematics" / "kinematics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    said = json.loads((tmp_path / "kinematics" / "kinematics.json").read_text())
    assert said["modes"]["complete"] and sum(said["modes"]["counts"]) == len(rows) > 2
    own = [r for r in rows if r["own"] == "1"]
    assert [(r["note"], r["row"], r["mode"]) for r in own] == [("first", "1", "1"),
                                                               ("second", "2", "1")]
    ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--tool", "10,0", "--out", "one",
           cwd=tmp_path, expect=0)
    with (tmp_path / "one" / "kinematics.csv").open(newline="") as file:
        for one, line in zip(csv.DictReader(file), own, strict=True):
            assert all(float(one[c]) == pytest.approx(float(line[c]), abs=1e-9) for c in
                       ("x", "y", "rz"))


@pytest.mark.parametrize(("arguments", "says"), [
    (["inverse", "m.yaml", "q.csv", "--all"], "--all goes with forward"),
    (["forward", "m.yaml", "q.csv", "--all", "--dataset", "a"], "do not go together")])
def test_options_that_do_not_go_are_refused(tmp_path, arguments, says):
    (tmp_path / "m.yaml").write_text(machines.plain_text("R(P)R"))
    (tmp_path / "q.csv").write_text("q_leg1,q_leg2,q_leg3\n300,300,300\n")
    run = ppmcal("kinematics", *arguments, cwd=tmp_path, expect=2)
    assert says in " ".join(run.err.split())
