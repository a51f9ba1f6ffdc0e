"""The simulated campaigns are what they say: kinematics, sizes, files, mends."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from wild.campaign import Plan, seen, setup, take
from wild.cases import CASES
from wild.catalogue import draw, recorded, table_of, truth_of, truth_pose, write
from wild.files import mechanism_record
from wild.kinematics import closure, forward, inverse, pose_by_joint
from wild.machines import MACHINES, build, draw_errors, pose_of, with_errors
from wild.memory import lagged, play_operator
from wild.mistakes import Paper, inverted, mirrored
from wild.rows import shifted, typed_wrong
from wild.world import jacobian, judge, measured, open_setup, shifted_setup, whitened

ONE_EACH = [(n, c.machines[i % len(c.machines)]) for i, (n, c) in enumerate(CASES.items())]


def true_machine(name: str, seed: int):
    machine = build(name, seed)
    errors = draw_errors(machine, np.random.default_rng(seed))
    return machine, errors, with_errors(machine, errors)


@pytest.mark.parametrize("gap", [0.0, 3.0])
@pytest.mark.parametrize("name", MACHINES)
def test_forward_undoes_inverse(name, gap):
    for seed in range(4):
        machine, _, geo = true_machine(name, seed)
        geo = replace(geo, u_gap=geo.u_gap + gap)
        rng = np.random.default_rng(seed)
        values = machine.home + machine.half * rng.uniform(-1, 1, (60, len(machine.home)))
        pos, rot = pose_of(machine.motion, values)
        q = inverse(geo, pos, rot)
        assert np.abs(closure(geo, q + geo.offset, pos, rot)[0]).max() < 1e-10
        start = pose_of(machine.motion, np.tile(machine.home, (60, 1)))
        at, turned = forward(geo, q, *start, machine.motion)
        assert np.abs(at - pos).max() < 1e-10
        assert np.abs(turned - rot).max() < 1e-12


@pytest.mark.parametrize("off", [1e4, np.nan])
def test_joints_that_no_pose_reaches_are_an_error(off):
    machine, _, geo = true_machine("3-RPR", 0)
    pos, rot = pose_of(machine.motion, machine.home[None])
    q = inverse(geo, pos, rot)
    q[0, 0] += off
    with np.errstate(all="ignore"), pytest.raises((ArithmeticError, np.linalg.LinAlgError)):
        forward(geo, q, pos, rot, machine.motion)


@pytest.mark.parametrize("name", MACHINES)
def test_pose_by_joint_is_the_derivative(name):
    machine, _, geo = true_machine(name, 2)
    pos, rot = pose_of(machine.motion, machine.home[None] + 0.3 * machine.half)
    q, step = inverse(geo, pos, rot), 1e-5
    ahead, _ = forward(geo, q + step, pos, rot, machine.motion)
    behind, _ = forward(geo, q - step, pos, rot, machine.motion)
    jac = pose_by_joint(geo, q, pos, rot, machine.motion)[0]
    flat = 2 if machine.motion == "planar" else 3
    slope = ((ahead - behind) / (2 * step))[0, :flat]
    np.testing.assert_allclose(jac.sum(axis=1)[:flat], slope, rtol=1e-5, atol=1e-5)


def fit(run, place, data, rounds=6):
    """Own fit of slots, frame and target from nominal slots: whitened residual."""
    machine = run.machine
    errors = np.zeros(len(machine.slots))
    for _ in range(rounds):
        geo = with_errors(machine, errors)
        pos, rot = forward(geo, run.q, run.pos, run.rot, machine.motion)
        now = replace(run, geo=geo, pos=pos, rot=rot)
        left = whitened(place, machine.motion, seen(place, pos, rot), data)
        step = np.linalg.lstsq(jacobian(now, place, errors), left, rcond=1e-9)[0]
        errors = errors + step[: len(errors)]
        for (kind, i), size in zip(
            open_setup(place, machine.motion), step[len(errors) :], strict=True
        ):
            place = shifted_setup(place, kind, i, size)
    return left


@pytest.mark.long_cases("crank-hexapod")
@pytest.mark.parametrize("name", [
    pytest.param(m, marks=pytest.mark.slow) if "hexapod" in m else m for m in MACHINES])
@pytest.mark.slow_cases("3-RRR", "delta-linear", "delta-rotary")
def test_clean_files_fit_exactly(name):
    machine, _, geo = true_machine(name, 3)
    plan = Plan(instrument="pose")
    place = setup(machine, plan, np.random.default_rng(5))
    run = take(machine, geo, plan, 60, np.random.default_rng(6))
    data = seen(place, run.pos, run.rot)
    assert np.abs(fit(run, place, data)).max() < 1e-5  # in sigmas


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_noise_is_what_the_sidecar_says(name):
    world = draw("none", name, 400, 4, 1.0)
    data = recorded(world, 4)
    clean = measured(world.run, world.place, [])
    flat = whitened(world.place, world.run.machine.motion, clean, data)
    assert abs(np.sqrt(np.mean(flat**2)) - 1) < 0.08


@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine", "eta"), [
    ("backlash-one", "hexapod", 0.3), ("play-all", "3-RRR", 2.0),
    ("leg-heat-late", "crank-hexapod", 2.0), ("hardening", "delta-rotary", 0.3)])
def test_eta_is_what_it_says(case, machine, eta):
    world = draw(case, machine, 90, 2, eta)
    other = judge(world.run, world.place, world.errors)
    now = measured(world.run, world.place, world.effects)
    flat = whitened(world.place, world.run.machine.motion, other.plain, now)
    columns = jacobian(world.run, world.place, world.errors)
    fitted = columns @ np.linalg.lstsq(columns / 1.0, flat, rcond=1e-10)[0]
    assert np.sqrt(np.mean((flat - fitted) ** 2)) == pytest.approx(eta, rel=0.03)


def check_files(folder, truth):
    rows = list(csv.DictReader((folder / "data.csv").read_text().splitlines()))
    assert len(rows) > 40
    assert all(np.isfinite(float(v)) for row in rows for v in row.values())
    assert json.loads((folder / "truth.json").read_text())["kinds"] == truth["kinds"]
    assert (folder / "data.yaml").exists()
    for name in ("mechanism.yaml", "data.yaml"):
        assert "e-" not in (folder / name).read_text()


@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine"), ONE_EACH)
def test_every_case_writes(case, machine, tmp_path):
    truth = write(case, machine, 60, 1, tmp_path, 1.0)
    check_files(tmp_path, truth)
    for effect in truth["effects"]:
        assert effect["eta"] == pytest.approx(1.0, rel=2e-3) or "slip" in case


@pytest.mark.parametrize("case", ["swapped-with-backlash", "gross-5", "motion-heat-all"])
def test_seed_decides(case, tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        write(case, "3-RPR", 60, seed, tmp_path / name, 1.0)
    for file in ("mechanism.yaml", "data.csv", "data.yaml", "truth.json"):
        first, again, other = ((tmp_path / n / file).read_bytes() for n in "abc")
        assert first == again
        assert first != other


def test_pose_after_the_last_row(tmp_path):
    write("homed-one", "3-RPR", 60, 3, tmp_path, 3.0)
    world = draw("homed-one", "3-RPR", 60, 3, 3.0)
    clean = measured(world.run, world.place, world.effects)[0][-1]
    got = truth_pose(tmp_path, world.run.q[-1:])
    np.testing.assert_allclose(got[0, :2], clean[:2], atol=1e-6)
    base = truth_pose(tmp_path, world.run.q[-1:], frame="base")
    assert np.abs(base[0] - got[0]).max() > 1


def test_conditions_reach_the_pose(tmp_path):
    write("leg-heat", "hexapod", 60, 3, tmp_path, 3.0)
    q = draw("leg-heat", "hexapod", 60, 3, 3.0).run.q[-1:]
    cold = truth_pose(tmp_path, q, {"temperature": 20.0}, frame="base")
    warm = truth_pose(tmp_path, q, {"temperature": 30.0}, frame="base")
    assert 1e-3 < np.abs(warm - cold).max() < 5


def paper_of(case: str, machine: str) -> Paper:
    world = draw(case, machine, 60, 1, 1.0)
    return Paper(table_of(world, 1), {}, {}, world.run.machine.rotary)


def test_inverse_twice_is_nothing():
    paper = paper_of("pose-inverse", "hexapod")
    before = {k: v.copy() for k, v in paper.table.items()}
    assert inverted(None, paper).read == {"pose": "inverse"}
    assert np.abs(paper.table["x"] - before["x"]).max() > 1
    inverted(None, paper)
    for name, values in before.items():
        np.testing.assert_allclose(paper.table[name], values, atol=1e-9)


def test_a_mirrored_rotation_is_a_mirror_image():
    paper = paper_of("pose-inverse", "hexapod")
    names = ("rx", "ry", "rz")
    turn = lambda: Rotation.from_rotvec(  # noqa: E731
        np.column_stack([paper.table[n] for n in names]), degrees=True
    ).as_matrix()
    before = turn()
    axis = mirrored(np.random.default_rng(0), paper).read["mirror"]
    flip = np.diag([-1.0 if a == axis else 1.0 for a in "xyz"])
    np.testing.assert_allclose(turn(), flip @ before @ flip, atol=1e-12)


@pytest.mark.slow
def test_shifted_rows_stand_as_far_behind_as_the_mend_says():
    for seed in range(6):
        paper = paper_of("none", "3-RRR")
        old = {k: v.copy() for k, v in paper.table.items()}
        by = shifted(np.random.default_rng(seed), paper).read["shift"]
        rows = paper.rows
        for k in range(max(0, by), min(rows, rows + by)):
            at = int(np.flatnonzero(old["x"] == paper.table["x"][k])[0])
            assert old["q_leg1"][at] == paper.table["q_leg1"][k - by]


UNITS = {"m": 1e3, "in": 25.4, "um": 1e-3, "rad": 180 / np.pi, "turn": 360.0}
UNITS |= {"g": 1e-3, "lb": 0.45359237, "N": 1 / 9.80665}


def read_back(table: dict, read: dict) -> dict:
    """Own reader of the sidecar's ``read``: columns, then units and signs, then the pose."""
    out = dict(table)
    for ours, header in read.get("columns", {}).items():
        out[ours] = table[header]
    for name, unit in read.get("units", {}).items():
        if unit in "FK":
            out[name] = (out[name] - 32) / 1.8 if unit == "F" else out[name] - 273.15
        else:
            out[name] = out[name] * UNITS[unit]
    for name, sign in read.get("signs", {}).items():
        out[name] = sign * out[name]
    if "rotation" in read:
        out |= dict(zip(("rx", "ry", "rz"), rotvec_of(out, read["rotation"]).T, strict=True))
    paper = Paper(out, {}, {}, False)
    if "pose" in read:
        inverted(None, paper)
    if "mirror" in read:
        fixed = type("Always", (), {"choice": lambda self, names: read["mirror"]})()
        mirrored(fixed, paper)
    return paper.table


def rotvec_of(table: dict, way: str) -> np.ndarray:
    if way == "quat-wxyz":
        quat = np.column_stack([table.pop(f"quat_{c}") for c in "xyzw"])
        return Rotation.from_quat(quat[:, [1, 2, 3, 0]]).as_rotvec(degrees=True)
    order = way.removeprefix("euler-")
    names = [f"r{a}" for a in order.lower()]
    if len(set(names)) < 3:
        names = ["rx", "ry", "rz"]
    angles = np.column_stack([table[n] for n in names])
    return Rotation.from_euler(order, angles, degrees=True).as_rotvec(degrees=True)


UNREAD = ("euler-moving-zyx-in-order", "swapped-and-typos")
MENDED = [n for n, c in CASES.items() if c.group == "mistake" and n not in UNREAD]


@pytest.mark.long_cases("euler-fixed-zyz", "euler-moving-xyz", "euler-fixed-zyx")
@pytest.mark.slow
@pytest.mark.parametrize("case", MENDED)
def test_the_mend_restores_the_file(case):
    for seed in (1, 2):
        world = draw(case, CASES[case].machines[seed % len(CASES[case].machines)], 50, seed, 1.0)
        clean = table_of(world, seed)
        paper = Paper({k: v.copy() for k, v in clean.items()}, {},
                      mechanism_record(world.run.machine), world.run.machine.rotary)  # fmt: skip
        rng, blames = np.random.default_rng(seed), []
        for make in world.case.errors:
            blames.append(make(rng, paper))
        truth = truth_of(world, blames, {})
        if truth["mend"] is None or "shift" in truth["mend"]:
            continue
        got = read_back(paper.table, truth["mend"])
        assert set(got) == set(clean)
        for name, values in clean.items():
            if name != "pose":
                np.testing.assert_allclose(got[name], values, atol=1e-7, err_msg=name)


def test_typos_change_the_number():
    rng = np.random.default_rng(0)
    for value in rng.uniform(-500, 500, 200):
        assert abs(typed_wrong(float(value), rng) - value) > 1e-2


def test_play_keeps_still_inside_its_width():
    path = np.array([[0.0], [1.0], [0.9], [0.7], [0.0]])
    np.testing.assert_allclose(
        play_operator(path, 0.2, np.zeros(1))[:, 0], [0.0, 0.8, 0.8, 0.8, 0.2]
    )


def test_lag_ends_at_its_drive():
    time = np.array([0.0, 10.0, 1e6])
    out = lagged(time, np.array([0.0, 1.0, 1.0]), 10.0, np.zeros(()))
    np.testing.assert_allclose(out, [0.0, 1 - np.exp(-1), 1.0])
