"""Workspace: reach, singular set, dexterity, and the command that writes them."""

import json
from functools import cache

import numpy as np
import pytest
import yaml
from helpers.commands import columns, number, ppmcal, rows
from helpers.machines import (
    CASES,
    PLANAR,
    Model,
    displaced,
    forward,
    full,
    home_state,
    limb_lengths,
    matrices,
    mechanism_text,
    read_text,
)
from helpers.paths import ROOT

from ppmcal.design.workspace import workspace
from ppmcal.errors import NoResult
from ppmcal.io import read_mechanism
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.region import Grid, placed, slice_axes, slice_grid
from ppmcal.kinematics.tables import inverse_table
from ppmcal.model.motions import POSE_COORDINATES

CONFIGS = ROOT / "configs"
SOME = ("3-RPR", "3-RPS", "6-RUS", "delta-rotary", "delta-linear-6rods", "mixed-planar")


@cache
def machine(name):
    return read_mechanism(CONFIGS / f"{name}.yaml")


def grid_of(mechanism, count=7):
    return slice_grid(mechanism, slice_axes(mechanism), (count, count))


@cache
def about_home(name):
    return workspace(machine(name), grid_of(machine(name)))


def edited(tmp_path, name, change, file="edited.yaml"):
    tree = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    change(tree)
    path = tmp_path / file
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return path


def slope_of_lengths(model, q, pose):
    """d(limb lengths)/d(pose) (N, d, d) by central differences of tests/machines.py."""
    dof, h = list(model.mechanism.dof), 1e-6
    out = []
    for c in dof:
        step = h * np.eye(6)[c]
        out.append((limb_lengths(model, q, displaced(pose, step))
                    - limb_lengths(model, q, displaced(pose, -step))) / (2.0 * h))
    return np.stack(out, axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_measures_against_differences(name):
    """det A and its singular values, by differences of the limbs' own lengths."""
    mechanism, found = machine(name), about_home(name)
    model = Model(mechanism)
    take = np.flatnonzero(np.isfinite(found.table.q).all(axis=1))[::5]
    q, pose = found.table.q[take], pose_motor(found.table.pose[take])
    home = home_state(mechanism).q[None]
    a = slope_of_lengths(model, q, pose)
    own = np.linalg.det(slope_of_lengths(model, home, mechanism.home[None]))[0]
    ratio = found.quality.determinant[take] / found.home.determinant[0]
    assert np.allclose(ratio, np.linalg.det(a) / own, rtol=1e-4, atol=1e-6)
    turns = [i for i, c in enumerate(mechanism.dof) if c >= 3]
    a[..., turns] /= mechanism.length_scale
    values = np.linalg.svd(a, compute_uv=False)
    assert np.allclose(found.quality.singular_value[take], values[:, -1], rtol=1e-5, atol=1e-7)
    assert np.allclose(found.quality.legs[take], values[:, -1] / values[:, 0], rtol=1e-5, atol=1e-7)


def joint_moves(model, q, pose):
    """d(pose)/d(joints) (N, d, k), all lengths, by differences of forward kinematics."""
    mechanism, moves = model.mechanism, []
    for k in range(q.shape[1]):
        h = 1e-6 * np.eye(q.shape[1])[k]
        (r1, t1), (r0, t0) = (matrices(forward(model, q + s * h, start=pose, start_q=q).pose)
                              for s in (1.0, -1.0))
        twist = (r1 - r0) @ np.swapaxes(r1, 1, 2)
        turn = np.stack([twist[:, 2, 1], twist[:, 0, 2], twist[:, 1, 0]], axis=-1)
        move = np.concatenate([t1 - t0, mechanism.length_scale * turn], axis=1)[:, mechanism.dof]
        unit = mechanism.length_scale if mechanism.actuator_quantity[k] == "angle" else 1.0
        moves.append(move / unit)
    return np.stack(moves, axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_dexterity_is_what_forward_kinematics_does(name):
    mechanism, found = machine(name), about_home(name)
    take = np.flatnonzero(found.reached)[::5]
    moves = joint_moves(Model(mechanism), found.table.q[take], pose_motor(found.table.pose[take]))
    values = np.linalg.svd(moves, compute_uv=False)
    assert np.allclose(found.quality.dexterity[take], values[:, -1] / values[:, 0], rtol=1e-4)
    assert found.index == pytest.approx(found.quality.dexterity[found.reached].mean())
    assert 0.0 < found.index <= 1.0


@pytest.mark.slow
def test_reach_of_three_struts_in_plain_geometry():
    """Status, share and area of a 3-R(P)R from strut lengths and leg lines alone."""
    mechanism = machine("3-RPR")
    grid = Grid((0, 1), (np.linspace(0.2, 0.9, 57), np.linspace(-0.1, 0.6, 43)))
    found = workspace(mechanism, grid)
    x, y = (a.ravel() for a in np.meshgrid(*grid.levels, indexing="ij"))
    struts, lines = leg_lines(np.stack([x, y, np.full_like(x, np.radians(30.0))], axis=-1))
    within = ((struts >= 0.2) & (struts <= 0.7)).all(axis=1)
    _, home = leg_lines(np.array([[0.5, 0.288675, np.radians(30.0)]]))
    same = np.sign(np.linalg.det(lines)) == np.sign(np.linalg.det(home))
    status = np.array(found.table.status)
    near = status == "singular"
    assert (found.reached == (within & same & ~near)).all()
    assert ((status == "crossed") == (~same & ~near)).all()
    assert near.sum() < 0.1 * near.size
    assert found.share == pytest.approx(found.reached.mean())
    assert found.size == pytest.approx(found.reached.mean() * 0.7 * 0.7)


def leg_lines(pose):
    """Strut lengths (N, 3) and unit leg lines (direction, moment about the origin) (N, 3, 3)."""
    base = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.866025]])
    angle = np.radians([210.0, 330.0, 90.0]) + pose[:, 2:]
    end = pose[:, None, :2] + 0.25 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    strut = end - base
    length = np.linalg.norm(strut, axis=-1)
    n = strut / length[..., None]
    moment = base[:, 0] * n[..., 1] - base[:, 1] * n[..., 0]
    return length, np.concatenate([n, moment[..., None]], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("coordinates,levels", [
    ((0, 1), (np.linspace(0.1, 0.9, 33), np.linspace(-0.1, 0.7, 35))),
    ((0, 5), (np.linspace(0.1, 0.9, 21), np.radians(np.linspace(-100, 200, 37)))),
    ((0, 1, 5), (np.linspace(0.2, 0.8, 9), np.linspace(0.0, 0.6, 9),
                 np.radians(np.linspace(-40, 40, 9)))),
    ((5,), (np.radians(np.linspace(-170, 170, 42)),))], ids=["x,y", "x,rz", "x,y,rz", "rz"])
def test_three_legs_meet_in_a_point_or_are_parallel_on_the_singular_set(coordinates, levels):
    mechanism = machine("3-RPR")
    found = workspace(mechanism, Grid(coordinates, levels))
    points = found.singular[:, [0, 1, 5]]
    assert len(points) > 0
    _, lines = leg_lines(points)
    # x n_y - y n_x = moment holds on a line: where the first two meet, times the sine between them
    n, moment = lines[..., :2], lines[..., 2]
    sine = n[:, 0, 0] * n[:, 1, 1] - n[:, 0, 1] * n[:, 1, 0]
    x, y = (n[:, 1, k] * -moment[:, 0] + n[:, 0, k] * moment[:, 1] for k in (0, 1))
    # 0 where the third goes through it; with a sine of 0, where it is parallel too
    off = x * n[:, 2, 1] - y * n[:, 2, 0] - sine * moment[:, 2]
    assert np.abs(off).max() < 1e-8 and np.abs(sine).max() > 0.1
    # and it is where the determinant changes sign: so do all edges' ends, by plain geometry
    side = np.sign(found.quality.determinant)
    assert (side > 0).any() and (side < 0).any()
    grid = np.stack([a.ravel() for a in np.meshgrid(*levels, indexing="ij")], axis=-1)
    pose = np.tile(mechanism.home_pose[[0, 1, 5]], (len(grid), 1))
    pose[:, [[0, 1, 5].index(c) for c in coordinates]] = grid
    plain = np.linalg.det(leg_lines(pose)[1])
    clear = np.abs(plain) > 1e-9
    assert len(np.unique((side * np.sign(plain))[clear])) == 1


def test_a_hexapod_is_singular_a_quarter_turn_about_its_axis():
    """Fichter, "A Stewart platform-based manipulator", Int. J. Robotics Research 5(2), 1986."""
    mechanism = machine("6-UPS")
    found = workspace(mechanism, Grid((5,), (np.radians(np.linspace(-171.0, 160.0, 83)),)))
    assert np.allclose(np.degrees(found.singular[:, 5]), [-90.0, 90.0], atol=1e-6)
    assert np.degrees(found.nearest.distance) == pytest.approx(90.0)
    assert found.distance_quantity == "angle"


def test_similar_triangles_are_singular_when_parallel():
    """A 3-R(P)R of similar triangles is singular at rz = 0, wherever it stands."""
    mechanism = machine("3-RPR")
    found = workspace(mechanism, Grid((0, 5), (np.linspace(0.35, 0.65, 7),
                                               np.radians(np.linspace(-50, 61, 38)))))
    assert np.abs(np.degrees(found.singular[:, 5])).max() < 1e-3
    rz = np.tile(found.grid.levels[1], 7)
    assert np.allclose(found.distance, np.abs(rz) * mechanism.length_scale, atol=1e-6)
    scale = mechanism.length_scale
    assert found.nearest.distance == pytest.approx(np.radians(30) * scale, rel=1e-5)
    assert found.nearest.edge == pytest.approx(np.radians(31) * scale)


@pytest.mark.slow
def test_distances_settle_as_the_grid_gets_finer():
    mechanism = machine("3-RPR-1")
    coarse, fine = (workspace(mechanism, grid_of(mechanism, count)) for count in (16, 46))
    every = fine.distance.reshape(46, 46)[::3, ::3].ravel()
    cell = np.hypot(*(level[1] - level[0] for level in coarse.grid.levels))
    known = np.isfinite(every) & np.isfinite(coarse.distance)
    assert known.sum() > 200
    more = (coarse.distance - every)[known]
    assert more.max() < cell and more.min() > -0.25 * cell
    assert coarse.nearest.distance == pytest.approx(fine.nearest.distance, rel=2e-3)


@pytest.mark.long
def test_distances_that_the_grid_cannot_settle_are_told(tmp_path):
    """The singular curve of the 3-RPR is a circle about home: on a small map most is beyond."""
    mechanism = machine("3-RPR")
    small, large = (workspace(mechanism, Grid((0, 1), (np.linspace(a, b, 61),
                                                       np.linspace(c, d, 61))))
                    for a, b, c, d in ((0.24, 0.89, -0.1, 0.57), (-0.1, 1.1, -0.3, 0.9)))
    for found in (small, large):
        place = found.grid.poses(mechanism)[:, :2]
        true = np.abs(0.381881 - np.linalg.norm(place - mechanism.home_pose[:2], axis=1))
        settled = found.reached & found.sure
        assert settled.any() and np.abs(found.distance - true)[settled].max() < 0.02
    assert (small.reached & ~small.sure).any() and (large.reached & ~large.sure).sum() == 0
    run = ppmcal("workspace", CONFIGS / "3-RPR.yaml", "--grid", "x=240:890:31,y=-100:570:31",
                 "--out", tmp_path / "w", "--json")
    assert any("a nearer one may lie beyond" in t for t in run.json["said"])
    edge = rows(tmp_path / "w" / "singular.csv")
    near = run.json["singular"]["nearest_to_home"]["pose"]
    assert -100 <= near["y"] <= 570 and len(edge) > 10


@pytest.mark.slow
def test_no_singularity_is_invented():
    """Where an elbow turns over det A jumps; a delta has none of the second type in its reach."""
    for name in ("delta-linear", "3-PRP-1", "3-RRP-1", "3-PRR-1"):
        mechanism = machine(name)
        found = workspace(mechanism, grid_of(mechanism, 25))
        assert found.searched and found.nearest is None and not len(found.singular)
        assert np.isnan(found.distance).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", PLANAR)
def test_a_jump_of_the_determinant_is_no_singularity(kind):
    """Turned so that a slide is parallel to its guide, a limb's joint value goes through infinity.

    det A jumps there. By differences of the limbs' own lengths, what is found is singular.
    """
    mechanism = full(kind)
    x = mechanism.home_pose[0]
    span = 0.6 * mechanism.reach
    found = workspace(mechanism, Grid((0, 5), (np.linspace(x - span, x + span, 13),
                                               np.linspace(-3.0, 3.0, 25))))
    if not len(found.singular):
        return
    poses = placed(mechanism, (0, 5), found.singular[:, [0, 5]])
    table = inverse_table(Model(mechanism), poses)
    a = slope_of_lengths(Model(mechanism), table.q, pose_motor(table.pose))
    a[..., 2] /= mechanism.length_scale
    assert np.linalg.svd(a, compute_uv=False)[:, -1].max() < 1e-6


@pytest.mark.slow
def test_dexterity_with_ratios_and_both_kinds_of_joints():
    """Drive ratios do not matter, joint angles count as arcs at the length scale."""
    limbs = [dict(CASES[k].limbs[i]) for i, k in enumerate(("R(P)R", "(R)RR", "(P)PR"))]
    home = {"x": 4.0, "y": -3.0, "rz": 6.0}
    plain = read_text(mechanism_text(limbs, "planar", home))
    geared = read_text(mechanism_text([{**limb, "ratio": r} for limb, r in
                                       zip(limbs, (4.0, -2.5, 0.1), strict=True)], "planar", home))
    grid = Grid((0, 1), (np.linspace(-0.02, 0.02, 3), np.linspace(-0.02, 0.02, 3)))
    found = workspace(plain, grid)
    # differences fail next to a singularity
    take = np.flatnonzero(found.reached & (found.quality.dexterity > 0.02))
    assert take.size > 2
    assert np.allclose(workspace(geared, grid).quality.dexterity, found.quality.dexterity)
    moves = joint_moves(Model(plain), found.table.q[take], pose_motor(found.table.pose[take]))
    values = np.linalg.svd(moves, compute_uv=False)
    assert np.allclose(found.quality.dexterity[take], values[:, -1] / values[:, 0], rtol=1e-4)


def test_four_coordinates_have_no_singular_set():
    mechanism = machine("6-UPS")
    found = workspace(mechanism, slice_grid(mechanism, (0, 1, 2, 3), (3, 3, 3, 3)))
    assert not found.searched and found.nearest is None


@pytest.mark.slow
def test_effects_are_left_out(tmp_path):
    path = edited(tmp_path, "3-RPR", lambda t: t.update(effects=[
        {"kind": "backlash", "on": ["leg1"], "parameters": {"width": 5.0}},
        {"kind": "gain", "on": ["leg2"], "parameters": {"gain": 0.1}}]))
    plain, heavy = machine("3-RPR"), read_mechanism(path)
    a, b = (workspace(m, grid_of(plain)) for m in (plain, heavy))
    assert np.array_equal(a.table.q, b.table.q) and a.table.status == b.table.status
    assert np.array_equal(a.quality.determinant, b.quality.determinant)


def test_home_that_is_singular_has_no_workspace(tmp_path):
    path = edited(tmp_path, "3-RPR", lambda t: t["home"]["pose"].update(rz=0.0, x=500.0))
    mechanism = read_mechanism(path)
    base = mechanism.with_values(np.where([p.name == "leg3.base.point.y" for p in
                                           mechanism.parameters], np.sqrt(0.75), mechanism.values))
    with pytest.raises(NoResult, match="singular at home"):
        workspace(base, Grid((0,), (np.linspace(0.4, 0.6, 5),)))


# --- the command ------------------------------------------------------------------------------

@pytest.mark.long_cases("3-RPS-rx=-60:60:5,ry=-60:60:5", "delta-linear-x,y=-100:100:4,z=0:300:4")
@pytest.mark.slow
@pytest.mark.parametrize("name,grid", [("3-RPR", "x=250:800:12,y=0:550:12"),
                                       ("3-RPS", "rx=-60:60:5,ry=-60:60:5"),
                                       ("delta-linear", "x,y=-100:100:4,z=0:300:4")])
def test_command_agrees_with_kinematics(tmp_path, name, grid):
    mech = CONFIGS / f"{name}.yaml"
    run = ppmcal("workspace", mech, "--grid", grid, "--out", tmp_path / "w", expect=0)
    assert "Reached within limits" in run.out and max(map(len, run.out.splitlines())) <= 80
    found = rows(tmp_path / "w" / "map.csv")
    pose = [c for c in columns(tmp_path / "w" / "map.csv") if c in POSE_COORDINATES]
    named = ["z", "rx", "ry"] if name == "3-RPS" else pose
    table = [",".join(pose)] + [",".join(r[p] if p in named else "" for p in pose) for r in found]
    (tmp_path / "poses.csv").write_text("\n".join(table) + "\n", encoding="utf-8")
    ppmcal("kinematics", "inverse", mech, tmp_path / "poses.csv", "--out", tmp_path / "k")
    other = rows(tmp_path / "k" / "kinematics.csv")
    assert [r["status"] for r in found] == [r["status"] for r in other]
    for a, b in zip(found, other, strict=True):
        assert number(a, "condition") == pytest.approx(number(b, "condition"), rel=1e-9,
                                                       nan_ok=True)
    content = json.loads((tmp_path / "w" / "workspace.json").read_text(encoding="utf-8"))
    assert content["format"] == "ppmcal/workspace/1"
    assert content["poses"] == len(found) == sum(content["status"].values())
    assert sum(content["left_out"].values()) == sum(r["status"] != "ok" for r in found)
    assert content["reachable"]["share"] == pytest.approx(
        sum(r["status"] == "ok" for r in found) / len(found))
    assert content["units"]["x"] == "mm"
    pictures = list((tmp_path / "w").glob("map_*.png"))
    assert {"map_dexterity.png", "map_determinant.png"} <= {p.name for p in pictures}
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures)
    edge = rows(tmp_path / "w" / "singular.csv")
    assert len(edge) == content["singular"]["points"]
    assert bool(edge) == (content["singular"]["nearest_to_home"] is not None)


@pytest.mark.long
def test_units_of_the_file(tmp_path):
    """The same machine in mm and degrees, and in inches and radians, gives the same numbers."""
    def inches(tree):
        tree["units"] = {"length": "in", "angle": "rad"}
        for limb in tree["limbs"]:
            point = limb["platform"]["point"]
            angle = point["angle"]["value"] if isinstance(point["angle"], dict) else point["angle"]
            limb["platform"]["point"] = {"radius": point["radius"] / 25.4,
                                         "angle": float(np.radians(angle))}
            limb["base"]["point"] = [v / 25.4 for v in limb["base"]["point"]]
        tree["home"]["pose"] = {"x": 500 / 25.4, "y": 288.675 / 25.4, "rz": float(np.radians(30))}
        tree["limits"] = {n: [a / 25.4, b / 25.4] for n, (a, b) in tree["limits"].items()}
        tree.pop("tolerances")

    other = edited(tmp_path, "3-RPR", inches)
    ppmcal("workspace", CONFIGS / "3-RPR.yaml", "--grid", "x=254:762:5,rz=-90:90:5", "--out",
           tmp_path / "a", expect=0)
    half = repr(float(np.pi / 2))
    ppmcal("workspace", other, "--grid", f"x=10:30:5,rz=-{half}:{half}:5", "--out", tmp_path / "b",
           expect=0)
    tables = (rows(tmp_path / n / "map.csv") for n in "ab")
    for a, b in zip(*tables, strict=True):
        assert a["status"] == b["status"]
        assert number(a, "singularity_distance") == pytest.approx(
            25.4 * number(b, "singularity_distance"), rel=1e-6, abs=1e-6)
        assert number(a, "dexterity") == pytest.approx(number(b, "dexterity"), abs=1e-9)
        assert number(a, "determinant") == pytest.approx(number(b, "determinant"), abs=1e-9)
    a, b = (json.loads((tmp_path / n / "workspace.json").read_text(encoding="utf-8"))
            for n in "ab")
    assert a["reachable"]["unit"] == "mm deg" and b["reachable"]["unit"] == "in rad"
    assert a["reachable"]["extent"] == pytest.approx(
        b["reachable"]["extent"] * 25.4 * np.degrees(1.0))


@pytest.mark.slow
def test_modes_of_rows_of_joints(tmp_path):
    far, _ = leg_lines(np.array([[0.9, 0.4, np.radians(30)]]))
    (tmp_path / "q.csv").write_text(
        "q_leg1,q_leg2,q_leg3\n381,382,383\n,300,300\n10,10,10\n0,300,300\n500,600,690\n"
        + ",".join(map(repr, (1e3 * far[0]).tolist())) + "\n", encoding="utf-8")
    run = ppmcal("workspace", CONFIGS / "3-RPR.yaml", "--grid", "x=450:550:3", "--joints",
                 tmp_path / "q.csv", "--out", tmp_path / "w", expect=1)
    assert "row 2: joint values are missing" in run.out
    found = rows(tmp_path / "w" / "modes.csv")
    per_row = {n: [r for r in found if r["row"] == str(n)] for n in range(1, 7)}
    assert [len(per_row[n]) for n in (2, 3, 4)] == [1, 1, 1]
    assert [per_row[n][0]["status"] for n in (2, 3, 4)] == ["refused", "none", "refused"]
    assert "no length" in per_row[4][0]["reason"]
    assert len(per_row[1]) == len(per_row[5]) == 2
    assert [r["home"] for r in per_row[1]] == ["yes", "no"]
    assert "outside [200, 700] mm" in per_row[6][0]["reason"]
    # every mode closes: the struts are as long as the joints say
    for r in (r for r in found if r["status"] == "ok"):
        struts, _ = leg_lines(np.array([[number(r, "x") / 1e3, number(r, "y") / 1e3,
                                         np.radians(number(r, "rz"))]]))
        assert np.allclose(1e3 * struts[0], [number(r, f"q_leg{i}") for i in (1, 2, 3)], atol=1e-7)
    content = json.loads((tmp_path / "w" / "workspace.json").read_text(encoding="utf-8"))
    assert [m["count"] for m in content["modes"]] == [2, None, 0, None, 2, len(per_row[6])]


@pytest.mark.slow
def test_modes_at_home_on_the_console(tmp_path):
    run = ppmcal("workspace", CONFIGS / "mixed-planar.yaml", "--grid", "x=450:550:3", "--out",
                 tmp_path / "w", expect=0)
    assert "Assembly modes at home's joint values: 2, all there are." in run.out
    assert "home" in run.out
    run = ppmcal("workspace", CONFIGS / "6-UPS.yaml", "--grid", "z=1900:2100:3", "--out",
                 tmp_path / "w", "--json", expect=0)
    assert run.json["modes"][0]["method"] == "search" and not run.json["modes"][0]["complete"]
    assert run.json["provenance"]["seed"] == 0
    assert not ppmcal("workspace", CONFIGS / "3-RPR.yaml", "--grid", "x=450:550:3", "--out",
                      tmp_path / "w", "--quiet", expect=0).out


@pytest.mark.slow
def test_findings_about_home(tmp_path):
    outside = edited(tmp_path, "3-RPR", lambda t: t.update(limits={"leg1": [100, 300]}))
    run = ppmcal("workspace", outside, "--grid", "x", "--out", tmp_path / "w", expect=1)
    assert "home is not within limits" in run.out and "leg1" in run.out
    near = edited(tmp_path, "3-RPR", lambda t: t["home"]["pose"].update(rz=0.2))
    run = ppmcal("workspace", near, "--grid", "x=450:550:3", "--out", tmp_path / "w", expect=1)
    assert "close to a singularity at home" in run.out
    # unreachable poses are no finding
    run = ppmcal("workspace", CONFIGS / "3-RRR-1.yaml", "--grid", "x=5000:6000:4,y=0:9:3", "--out",
                 tmp_path / "w", expect=0)
    assert "cannot reach" in run.out and "No pose of this grid has joint values" in run.out


@pytest.mark.slow
@pytest.mark.parametrize("args,words", [
    (("--grid", "foo"), "unknown pose coordinate"), (("--grid", "x=1"), "is not a range"),
    (("--grid", "x,y,rz,x"), "twice"), (("--joints", "none.csv"), "none.csv"),
    (("--joints", "bare.csv"), "no rows"), (("--joints", "other.csv"), "q_leg2")])
def test_bad_input(tmp_path, args, words):
    (tmp_path / "bare.csv").write_text("q_leg1,q_leg2,q_leg3\n", encoding="utf-8")
    (tmp_path / "other.csv").write_text("q_leg1\n5\n", encoding="utf-8")
    run = ppmcal("workspace", CONFIGS / "3-RPR.yaml", *args, "--out", tmp_path / "w", cwd=tmp_path,
                 expect=2)
    assert words in run.err and not (tmp_path / "w").exists()


@pytest.mark.slow
def test_surplus_ropes_have_no_sign_to_keep(tmp_path):
    """The least singular value in reach is told with its place, which is a row of the map."""
    run = ppmcal("workspace", CONFIGS / "maslow.yaml", "--out", tmp_path / "out", expect=0)
    assert "keeps its sign" not in run.out
    said = " ".join(run.out.split())
    found = [r for r in rows(tmp_path / "out" / "map.csv") if r["status"] == "ok"]
    least = min(found, key=lambda r: number(r, "condition"))
    assert (f"Smallest singular value in reach: {number(least, 'condition'):.3f} at "
            f"x {number(least, 'x'):.1f}, y {number(least, 'y'):.1f} (home") in said
