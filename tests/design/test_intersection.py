"""Forward kinematics by intersection against Newton, against all modes, and what is refused."""

import csv

import numpy as np
import pytest
import yaml
from helpers import machines
from helpers.commands import ppmcal
from helpers.machines import PLANAR
from helpers.paths import ROOT

from ppmcal import algebra as cga
from ppmcal.design.assembly_modes import assembly_modes
from ppmcal.design.intersection import (
    flat_point,
    forward_by_intersection,
    intersections,
    require_meet,
)
from ppmcal.design.intersection_spatial import tripod_circles
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import read_mechanism
from ppmcal.kinematics import forward as newton
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.tables import inverse_table

SHIPPED = ("3-RPR", "3-RRR-1", "3-PPR-1", "mixed-planar")
"""Every kind of planar limb has its own case."""
ROUND_OFF = 1e-9


def agree(mechanism, q):
    """Check both ways on joint values; return how many rows have a pose."""
    model = Model(mechanism)
    one, other = forward(model, q), forward_by_intersection(model, q)
    assert other.converged.tolist() == one.converged.tolist()
    good = one.converged
    apart = machines.difference(other.pose[good], one.pose[good])
    assert np.abs(apart[:, :3]).max() < ROUND_OFF * mechanism.reach
    assert np.abs(apart[:, 3:]).max() < ROUND_OFF
    return int(good.sum())


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_the_intersection_is_newtons_pose_on_shipped_machines(name):
    """Also far from home: poses over the middle of the joint range, reached or not."""
    mechanism = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    rng = np.random.default_rng(4)
    poses = np.tile(mechanism.home_pose, (12, 1))
    poses[:, :2] += rng.uniform(-0.15, 0.15, (12, 2)) * mechanism.reach
    poses[:, 5] += rng.uniform(-0.3, 0.3, 12)
    q = inverse_table(Model(mechanism), poses).q
    assert agree(mechanism, q[np.isfinite(q).all(axis=1)]) > 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*PLANAR, "mixed"])
def test_the_intersection_is_newtons_pose_of_every_planar_limb(kind):
    cases = [machines.mixed("planar")] if kind == "mixed" else [machines.plain(kind),
                                                               machines.full(kind)]
    for mechanism in cases:
        q, _ = machines.spread(Model(mechanism), 6)
        assert agree(mechanism, q) == 6


SPATIAL = {"delta on rails": lambda: machines.delta("(P)US", 3),
           "delta with cranks": lambda: machines.delta("(R)US", 3),
           "tripod": lambda: machines.plain("R(P)S"), "full tripod": lambda: machines.full("R(P)S")}


@pytest.mark.slow_cases("tripod", "full tripod", "delta with cranks")
@pytest.mark.parametrize("name", SPATIAL)
def test_the_intersection_is_newtons_pose_of_deltas_and_tripods(name):
    mechanism = SPATIAL[name]()
    q, _ = machines.spread(Model(mechanism), 4, size=2.0)
    assert agree(mechanism, q) == 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["3-RPS", "delta-linear", "delta-rotary"])
def test_the_intersection_is_newtons_pose_on_shipped_spatial_machines(name):
    mechanism = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    model = Model(mechanism)
    home = home_state(mechanism).q
    part = np.random.default_rng(1).uniform(-3.0, 3.0, (10, home.size))
    q = np.concatenate([home[None], home + part * machines.joint_steps(model)])
    assert agree(mechanism, q) == 11


@pytest.mark.slow
def test_all_modes_of_a_tripod_are_those_of_a_search():
    """The resultant has degree 8 to round-off; Newton from drawn starts finds no other pose."""
    model = Model(machines.full("R(P)S"))
    q, _ = machines.spread(model, 3)
    for row in q:
        closure = model.closure(row)
        circles = tripod_circles(closure, cga.coordinates(closure.moving[0])[::2])
        even = 2.0 * np.pi * np.arange(64) / 64
        spectrum = np.abs(np.fft.rfft(circles.resultant(even)))
        assert spectrum[9:].max() < 1e-12 * spectrum.max() < spectrum[8]
        found = intersections(closure)
        searched = assembly_modes(model, row)
        assert len(found) == len(searched) and len(found) % 2 == 0
        for pose in searched.motors:
            near = np.abs(machines.difference(found, np.tile(pose, (len(found), 1))))
            assert near.max(axis=1).min() < ROUND_OFF


@pytest.mark.parametrize("kind", PLANAR)
def test_bodies_meet_in_every_assembly_mode(kind):
    """All modes at once, against the resultant with Newton from each root."""
    model = Model(machines.plain(kind))
    q = home_state(model.mechanism).q
    found = intersections(model.closure(q))
    modes = assembly_modes(model, q)
    sharp = modes.motors[~modes.singular]
    for pose in sharp:
        near = np.abs(machines.difference(found, np.tile(pose, (len(found), 1)))).max(axis=1)
        assert near.min() < 1e-9
    assert len(found) >= len(sharp) > 0


def test_the_intersection_does_not_use_newton(monkeypatch):
    mechanism = machines.plain("R(P)R")
    q, pose = machines.spread(Model(mechanism), 3)

    def refuse(*_):
        raise AssertionError("Newton was called")

    monkeypatch.setattr(newton, "newton", refuse)
    monkeypatch.setattr("ppmcal.design.assembly_modes_spatial.newton", refuse)
    found = forward_by_intersection(Model(mechanism), q)
    assert np.abs(machines.difference(found.pose, pose)).max() < ROUND_OFF


def test_three_planes_meet_in_a_flat_point():
    rng = np.random.default_rng(2)
    normals, point = rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3))
    planes = cga.plane(normals, np.einsum("nki,ni->nk", normals, point))
    np.testing.assert_allclose(flat_point(cga.meet(*np.moveaxis(planes, 1, 0))), point, atol=1e-12)
    axes = cga.plane(np.eye(3), np.array([1.0, 2.0, 3.0]))
    assert np.isnan(flat_point(cga.meet(axes[0], axes[0], axes[1]))).all()


@pytest.mark.slow
def test_joints_beyond_reach_have_no_intersection():
    mechanism = machines.plain("R(P)R")
    q = np.array([home_state(mechanism).q, [0.05, 0.9, 0.05], [np.nan, 0.3, 0.3]])
    found = forward_by_intersection(Model(mechanism), q)
    assert found.converged.tolist() == [True, False, False]
    assert np.isnan(found.pose[1:]).all()
    assert 0.0 < found.progress[1] < 1.0
    assert found.progress[1] == pytest.approx(forward(Model(mechanism), q).progress[1], abs=0.02)


def on_a_line():
    """Return the text of a 3-RPR machine whose platform joints are on one line."""
    def change(i, limb):
        return limb | {"platform": {"point": [(-120.0, 10.0, 95.0)[i], 0.0]}}

    return machines.plain_text("R(P)R", change)


def test_end_points_on_a_line_are_refused():
    mechanism = machines.read_text(on_a_line())
    q = home_state(mechanism).q
    with pytest.raises(NoResult, match="on one line"):
        intersections(Model(mechanism).closure(q))
    found = forward_by_intersection(Model(mechanism), q)
    assert not found.converged[0] and "on one line" in found.reason[0]


# --- the command ------------------------------------------------------------------------------

def joints(folder, mechanism, q):
    """Write a table of joint values in mm."""
    text = ",".join(f"q_{a}" for a in mechanism.actuators) + "\n"
    (folder / "q.csv").write_text(text + "".join(
        ",".join(repr(float(v) / f) for v, (f, _) in zip(row, mechanism.joint_units, strict=True))
        + "\n" for row in q))


def read(path):
    """Return the rows of a CSV as dictionaries."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_command_has_both_methods(tmp_path):
    (tmp_path / "m.yaml").write_text(machines.plain_text("(R)RR"))
    mechanism = machines.plain("(R)RR")
    joints(tmp_path, mechanism, machines.spread(Model(mechanism), 4)[0])
    tables = []
    for method in ("newton", "intersection"):
        ppmcal("kinematics", "forward", "m.yaml", "q.csv", "--method", method, "--out", method,
               cwd=tmp_path, expect=0)
        assert f'"method": "{method}"' in (tmp_path / method / "kinematics.json").read_text()
        tables.append(read(tmp_path / method / "kinematics.csv"))
    for one, other in zip(*tables, strict=True):
        for name in ("x", "y", "rz"):
            assert float(one[name]) == pytest.approx(float(other[name]), abs=1e-7)
        assert one["status"] == other["status"] == "ok"


def test_machines_without_intersection_are_refused(tmp_path):
    (tmp_path / "m.yaml").write_text(machines.plain_text("U(P)S"))
    (tmp_path / "e.yaml").write_text(machines.plain_text(
        "R(P)R", effects=[{"kind": "gain", "parameters": {"gain": 0.001}}]))
    (tmp_path / "l.yaml").write_text(on_a_line())
    for file, says in (("m.yaml", "its platform turns"), ("e.yaml", "effects")):
        mechanism = read_mechanism(tmp_path / file)
        joints(tmp_path, mechanism, [home_state(mechanism).q])
        run = ppmcal("kinematics", "forward", file, "q.csv", "--method", "intersection",
                     cwd=tmp_path, expect=2)
        assert says in run.err and "--method newton" in run.err
        assert not (tmp_path / "kinematics").exists()
    mechanism = read_mechanism(tmp_path / "l.yaml")
    joints(tmp_path, mechanism, [home_state(mechanism).q])
    run = ppmcal("kinematics", "forward", "l.yaml", "q.csv", "--method", "intersection",
                 cwd=tmp_path, expect=3)
    assert "on one line" in " ".join(run.out.split())
    run = ppmcal("kinematics", "inverse", "l.yaml", "q.csv", "--method", "intersection",
                 cwd=tmp_path, expect=2)
    assert "--method goes with forward: every limb's" in " ".join(run.err.split())


def test_offset_universal_joints_are_refused(tmp_path):
    text = (ROOT / "configs" / "delta-linear.yaml").read_text(encoding="utf-8")
    tree = yaml.safe_load(text)
    tree["limbs"][1]["base"] |= {"axis": [0.3, 0.1, 1.0], "axis_offset": 4.0}
    (tmp_path / "offset.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
    (tmp_path / "plain.yaml").write_text(text, encoding="utf-8")
    require_meet(read_mechanism(tmp_path / "plain.yaml"))
    with pytest.raises(BadInput, match=f"a universal joint of {tree['limbs'][1]['name']} do"):
        require_meet(read_mechanism(tmp_path / "offset.yaml"))
    with pytest.raises(BadInput, match="its platform turns"):
        require_meet(machines.offset_joints("(P)US", "base"))
