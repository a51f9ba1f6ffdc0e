"""Machines that calibrate themselves: joint values alone, against a truth they were made from."""

import numpy as np
import pytest
from helpers.redundant import alone, apart, belts, cables, rope_cage, stewart, written

import ppmcal
from ppmcal.commands.inputs import prepared
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, moved
from ppmcal.kinematics.inverse import inverse

HALF = {"belts": {"x": 900, "y": 700},
        "stewart": {"x": 80, "y": 80, "z": 60, "rx": 10, "ry": 10, "rz": 10},
        "cage": {"x": 800, "y": 600, "z": 500, "rx": 15, "ry": 15, "rz": 15}}
HELD = {"belts": 3, "stewart": 12, "cage": 12}


def fresh(model, count=20, size=1.0):
    """Return poses (count, 8) that no campaign has seen, and the joint values there."""
    mechanism = model.mechanism
    rng = np.random.default_rng(99)
    step = np.zeros((count, 6))
    half = np.where(np.arange(6) < 3, 0.1, 0.1)
    step[:, mechanism.dof] = (size * rng.uniform(-1.0, 1.0, step.shape) * half)[:, mechanism.dof]
    pose = moved(np.tile(mechanism.home, (count, 1)), step)
    return pose, inverse(model, pose).q


@pytest.mark.parametrize("tree", [belts, stewart, rope_cage], ids=lambda t: t.__name__)
def test_what_is_found_is_the_truth_in_another_frame(tree, tmp_path):
    """Joints without noise: poses that no row had come out to less than 1e-9 m."""
    file = tree()
    path = written(tmp_path, file)
    made = ppmcal.simulate(path, alone(file, HALF[file["name"]], sigma=1e-9))
    found = ppmcal.identify(path, made.data[0])
    count = HELD[file["name"]]
    problem = found.identification.fit.problem
    gauge, = (f for f in problem.mechanism.findings if f.topic == "gauge" and " are held" in f)
    assert gauge.split(" are held")[0].count(",") == count - 1
    assert found.identification.rank == len(problem.columns) == len(problem.free)
    true = Model(made.campaign.with_effects, made.campaign.g)
    pose, q = fresh(true)
    machine = found.identification.mechanism
    ours = forward(Model(machine), q)
    assert ours.converged.all()
    assert apart(machine, ours.pose, pose) < 1e-9


def test_no_instrument_and_no_surplus_is_refused(tmp_path):
    file = stewart(6)
    path = written(tmp_path, file)
    with pytest.raises(BadInput, match="as many closure equations as freedoms"):
        ppmcal.simulate(path, alone(file, HALF["stewart"]))


def test_the_noise_of_joints_has_to_be_said(tmp_path):
    path = written(tmp_path, belts())
    table = {f"q_{name}": np.full(20, 1800.0) for name in ("bl", "br", "tr", "tl")}
    with pytest.raises(BadInput, match="the noise of the joint values is missing"):
        ppmcal.read_data(path, table, sidecar={"instrument": {"kind": "none", "sigma": {}}})


def test_a_wrong_reading_is_found_by_its_limb(tmp_path):
    file = belts()
    path = written(tmp_path, file)
    made = ppmcal.simulate(path, alone(file, HALF["belts"], sigma=0.2))
    data = made.data[0]
    q = data.q.copy()
    q[11, 2] += 0.02
    object.__setattr__(data, "q", q)
    found = ppmcal.identify(path, data)
    (row,) = found.identification.gross_errors.rows
    assert row.row == 12 and row.number == "gap_tr"


@pytest.mark.parametrize(("tree", "exchanged"), [
    (belts, "bl with br, tr with tl"), (cables, "c0 with c3, c1 with c2"),
    (rope_cage, "r1 with r2, r3 with r4, r5 with r6, r7 with r8"), (stewart, None)],
    ids=["belts", "cables", "cage", "stewart"])
def test_the_mirror_image_is_told_where_it_fits_as_well(tree, exchanged, tmp_path):
    file = tree()
    path = written(tmp_path, file)
    half = {**HALF, "cables": {"x": 700, "y": 500, "rz": 8}}[file["name"]]
    made = ppmcal.simulate(path, alone(file, half, count=30, sigma=1e-3))
    findings = [f for f in prepared(path, made.data[0], ())[0].findings if "mirror image" in f]
    assert len(findings) == (exchanged is not None)
    for said in findings:
        assert said.topic == "gauge" and said.level == "note"
        assert f"with {exchanged} exchanged they fit as well" in said
