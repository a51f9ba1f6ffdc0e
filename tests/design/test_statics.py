"""What surplus limbs hold, against the least total energy of springs that SciPy finds."""

import json

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows, write_csv
from helpers.paths import ROOT
from helpers.redundant import belts, cables, machine, rope_cage, stewart
from scipy.optimize import minimize

from ppmcal import algebra as cga
from ppmcal.design.spring_model import springs_of
from ppmcal.design.statics import balance, even_tension, limb_forces, only_pull
from ppmcal.design.stiffness import _preloaded, compliance
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.inverse import inverse

CONFIGS = ROOT / "configs"
LOADS = {"cables": [30.0, -80.0, 0, 0, 0, 4.0], "belts": [-20.0, -60.0, 0, 0, 0, 0],
         "cage": [20.0, 10.0, -90.0, 1.0, -2.0, 1.5],
         "stewart": [40.0, -30.0, -200.0, 3.0, -5.0, 4.0]}


def stiff(tree):
    """Return a file whose limbs are springs, one unlike the other, N/mm.

    So stiff that tensions over lengths are nothing beside them: preload is left out.
    """
    limbs = [{**limb, "stiffness": {"bar": 3e5 + 6e4 * i, "drive": 9e5}}
             for i, limb in enumerate(tree["limbs"])]
    return {**tree, "limbs": limbs}


def near_home(mechanism, count=6):
    rng = np.random.default_rng(4)
    step = np.zeros((count, 6))
    step[:, mechanism.dof] = rng.uniform(-0.08, 0.08, (count, len(mechanism.dof)))
    return moved(np.tile(mechanism.home, (count, 1)), step)


def least_energy(mechanism, model, q, pose, wrench):
    """Return the twist (6,) to the least energy of one row, and the tensions there (m,).

    By distances alone; ropes that are shorter than their joints say hold nothing.
    """
    values, ropes = model.limb_values, only_pull(mechanism)
    ends = [np.array([[v.get(f"{end}.point.{a}", 0.0) for a in "xyz"] for v in values])
            for end in ("base", "platform")]
    stiffness = np.array([1.0 / (1.0 / s["bar"] + 1.0 / s["drive"]) for s in mechanism.stiffness])
    dof, size = list(mechanism.dof), 1e-7

    def at(x):
        step = np.zeros((1, 6))
        step[0, dof] = size * x
        there = moved(pose[None], step)
        ways = cga.move_point(there, ends[1]) - ends[0]
        apart = np.linalg.norm(ways, axis=-1)
        gap = np.where(ropes & (apart < q), 0.0, apart - q)
        ways /= apart[:, None]
        arms = cga.move_point(there, ends[1]) - cga.translation(there)
        force = stiffness * gap
        slope = force @ np.concatenate([ways, np.cross(arms, ways)], axis=1) - wrench
        energy = 0.5 * np.sum(force * gap) - wrench @ step[0]
        return energy / size, slope[dof], force, step[0]

    best = minimize(lambda x: at(x)[0], np.zeros(len(dof)), jac=lambda x: at(x)[1], method="BFGS",
                    options={"gtol": 1e-6, "maxiter": 5000})
    return at(best.x)[3], at(best.x)[2]


@pytest.mark.parametrize("tree", [cables, belts, rope_cage, stewart], ids=lambda t: t.__name__)
@pytest.mark.slow_cases("rope_cage")
def test_forces_and_pose_are_those_of_the_least_energy(tree, tmp_path):
    """Tight ropes under a load: commands are off by what pulls them, and so is each other limb."""
    mechanism = machine(tmp_path, stiff(tree()))
    model, pose = Model(mechanism), near_home(mechanism, 3)
    wrench = np.array(LOADS[mechanism.name])
    closure = model.closure(inverse(model, pose).q)
    a = closure.pose_matrix(pose)
    ropes = only_pull(mechanism)
    one = np.array([1.0 / s["bar"] + 1.0 / s["drive"] for s in mechanism.stiffness])
    give = np.broadcast_to(np.diag(np.sqrt(one)), (3, len(one), len(one)))
    pulled = even_tension(mechanism, a, np.ones(len(one), dtype=bool), 120.0) if ropes.any() else 0
    gaps = pulled * one + np.random.default_rng(2).normal(0.0, 2e-8, (3, len(one)))
    size = np.array([1.0 if c < 3 else mechanism.length_scale for c in mechanism.dof])
    found = balance(a, give, np.tile(wrench[list(mechanism.dof)], (3, 1)), gaps, ropes, size)
    assert np.isfinite(found.force).all()
    for n in range(3):
        twist, force = least_energy(mechanism, model, closure.q[n] - gaps[n], pose[n], wrench)
        largest = np.abs(force).max()
        # the energy of distances is that of this pose up to the motion over a limb's length
        np.testing.assert_allclose(found.force[n], force, atol=5e-3 * largest)
        np.testing.assert_allclose(found.twist[n], twist[list(mechanism.dof)],
                                   atol=5e-3 * np.abs(twist).max())
        np.testing.assert_array_equal(found.slack[n], ropes & (force == 0.0))


def test_slack_ropes_have_no_row(tmp_path):
    """Two of four belts carry a load; the energy of ropes that cannot push is least there."""
    mechanism = machine(tmp_path, stiff(belts()))
    model, pose = Model(mechanism), near_home(mechanism)
    q, wrench = inverse(model, pose).q, np.array(LOADS["belts"])
    found = limb_forces(mechanism, springs_of(mechanism), q, pose, np.zeros(3), wrench)
    assert found.idle is None
    np.testing.assert_array_equal(found.slack.sum(axis=1), 2)
    assert np.all(found.loaded >= 0.0)
    for n in range(len(pose)):
        twist, force = least_energy(mechanism, model, q[n], pose[n], wrench)
        np.testing.assert_allclose(found.loaded[n], force, atol=2e-3 * force.max())
        np.testing.assert_allclose(found.deflection[n], twist, atol=2e-3 * np.abs(twist).max())
    # what pushes them would hold as well, and that is what a machine of struts does
    pushed = compliance(mechanism, q, pose).deflection(wrench)
    assert np.all(np.linalg.norm(found.deflection, axis=1) > np.linalg.norm(pushed, axis=1))


def test_struts_move_as_their_compliance_says(tmp_path):
    mechanism = machine(tmp_path, stiff(stewart()))
    model, pose = Model(mechanism), near_home(mechanism)
    q, wrench, tool = inverse(model, pose).q, np.array(LOADS["stewart"]), np.array([0, 0.02, 0.05])
    found = limb_forces(mechanism, springs_of(mechanism), q, pose, tool, wrench)
    np.testing.assert_allclose(found.deflection, compliance(mechanism, q, pose, tool).deflection(
        wrench), rtol=1e-6, atol=1e-12)
    assert not found.slack.any()


def test_ropes_that_nothing_holds_have_no_forces(tmp_path):
    """A load upwards, beyond what any set of slack ropes bears: nan, and no number."""
    tree = stiff(belts())
    tree["home"]["pose"]["y"] = 2600    # above all anchors
    mechanism = machine(tmp_path, tree)
    model, pose = Model(mechanism), mechanism.home[None]
    up, down = (limb_forces(mechanism, springs_of(mechanism), inverse(model, pose).q, pose,
                            np.zeros(3), np.array([0, f, 0, 0, 0, 0.0])) for f in (50.0, -50.0))
    assert np.isfinite(up.loaded).all()
    assert np.isnan(down.loaded).all()
    assert np.isnan(down.deflection).all()


def test_all_sets_of_slack_ropes_are_tried(tmp_path):
    """Eight ropes, loads of all directions: tensions balance, and slack ones are not stretched."""
    mechanism = machine(tmp_path, stiff(rope_cage()))
    model = Model(mechanism)
    rng = np.random.default_rng(8)
    pose = np.repeat(near_home(mechanism, 20), 10, axis=0)
    closure = model.closure(inverse(model, pose).q)
    a = closure.pose_matrix(pose)
    load = rng.normal(size=(len(pose), 6)) * [60, 60, 60, 12, 12, 12]
    one = np.array([1.0 / s["bar"] + 1.0 / s["drive"] for s in mechanism.stiffness])
    give = np.broadcast_to(np.diag(np.sqrt(one)), (len(pose), 8, 8))
    gaps = even_tension(mechanism, a, np.ones(8, dtype=bool), 25.0) * one
    found = balance(a, give, load, gaps, np.ones(8, dtype=bool), np.array([1, 1, 1, .3, .3, .3]))
    held = np.isfinite(found.force).all(axis=1)
    assert held.mean() > 0.2
    force, twist = found.force[held], found.twist[held]
    np.testing.assert_allclose((np.swapaxes(a[held], -1, -2) @ force[..., None])[..., 0],
                               load[held], atol=1e-5 * 60)
    assert force.min() > -1e-9
    assert {0, 1} < set(found.slack[held].sum(axis=1).tolist())
    apart = gaps[held] + (a[held] @ twist[..., None])[..., 0] - force * one
    assert np.abs(apart[force > 1e-6]).max() < 1e-6 * (force * one).max()
    assert apart.max() < 1e-6 * (force * one).max()


def test_commands_of_another_geometry_strain_limbs_without_a_load(tmp_path):
    """A calibrated machine under the nominal machine's commands, against the least energy."""
    tree = stiff(stewart())
    tree["limbs"][2]["offset"] = {"value": 4e-5, "nominal": 0.0}
    tree["limbs"][5]["offset"] = {"value": -2e-5, "nominal": 0.0}
    mechanism = machine(tmp_path, tree)
    model, pose = Model(mechanism), near_home(mechanism, 3)
    q = inverse(model, pose).q
    found = limb_forces(mechanism, springs_of(mechanism), q, pose, np.zeros(3), None)
    commanded = inverse(Model(mechanism.nominal()), pose).q
    lengths = np.stack([model.joint_coordinate(i, commanded) for i in range(7)], axis=-1)
    for n in range(3):
        _, force = least_energy(mechanism, model, lengths[n], pose[n], np.zeros(6))
        assert np.abs(force).max() > 0.5
        np.testing.assert_allclose(found.idle[n], force, atol=5e-3 * np.abs(force).max())
    assert found.loaded is None


def written_with(folder, tree, **more):
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump({**tree, **more}))
    return path


def run(folder, path, *options, expect=0):
    """Return what the command says, its record and its table."""
    write_csv(folder / "p.csv", [{"x": 1400, "y": 1000}, {"x": 1700, "y": 1200}])
    said = ppmcal("stiffness", path, "--poses", folder / "p.csv", *options, "--out", "out",
                  "--force", cwd=folder, expect=expect)
    return said.out, json.loads((folder / "out" / "stiffness.json").read_text()), rows(
        folder / "out" / "map.csv")


@pytest.mark.slow
def test_the_command_tells_forces_and_slack_ropes(tmp_path):
    """Pulled tight all belts hold; without tension the lower ones are slack, which is a finding."""
    path = written_with(tmp_path, stiff(belts()))
    out, slack, table = run(tmp_path, path, "--load", "fy=-60", expect=1)
    assert "at home bl, br are slack under fy = -60 N, and hold nothing" in out.replace("\n", " ")
    assert "a rope is slack at 2 of 2 poses" in out.replace("\n", " ")
    forces = slack["home"]["forces"]
    assert forces["bl"] == forces["br"] == 0.0 and forces["tl"] > 40.0
    assert "forces_without_load" not in slack["home"]
    assert slack["units"]["force_tl"] == "N"
    assert float(table[0]["force_bl"]) == 0.0 and float(table[0]["force_tl"]) > 30.0
    out, tight, _ = run(tmp_path, path, "--load", "fy=-60", "--tension", "200")
    assert not tight["findings"]
    assert "What limbs hold at home, N" in out
    idle = tight["home"]["forces_without_load"]
    assert sum(idle.values()) / 4 == pytest.approx(200.0, rel=1e-6)
    assert "counts the ropes' mean tension of 200 N: at home" in out.replace("\n", " ")
    assert "preload" not in out
    move = [one["home"]["deflection"]["y"] for one in (slack, tight)]
    assert move[0] < 1.5 * move[1] < 0.0
    _, still, _ = run(tmp_path, path)
    assert not still["findings"] and "forces" not in still["home"]


def test_the_command_tells_what_nothing_holds(tmp_path):
    tree = stiff(belts())
    tree["home"]["pose"]["y"] = 2600
    out, record, _ = run(tmp_path, written_with(tmp_path, tree), "--load", "fy=-60", expect=1)
    said = out.replace("\n", " ")
    assert "at home ropes do not hold the platform under fy = -60 N" in said
    assert "Under fy = -60 N ropes do not hold the platform there." in said
    assert record["home"]["deflection"] == {"x": None, "y": None}
    assert record["home"]["forces"]["bl"] is None
    _, other, _ = run(tmp_path, written_with(tmp_path, tree), "--tension", "50", expect=1)
    assert "without a load" in other["findings"][0]


@pytest.mark.slow
def test_the_command_tells_what_a_calibrated_machine_holds_without_a_load(tmp_path):
    tree = stiff(cables())
    tree["limbs"][1]["offset"] = {"value": 0.02, "nominal": 0.0}
    path = written_with(tmp_path, tree)
    said = ppmcal("stiffness", path, "--grid", "x=1400:1500:2,y=1000:1100:2", cwd=tmp_path,
                  expect=None)
    words = said.out.replace("\n", " ")
    assert "Without any load limbs hold up to" in words
    assert "the controller commands the nominal geometry, and this machine has another" in words


@pytest.mark.parametrize(("tree", "value", "says"), [
    (belts, "-5", "-5 is not a tension"), (belts, "nan", "is not a"),
    (lambda: stewart(7), "50", "no ropes that could pull against others")],
    ids=["negative", "nan", "struts"])
def test_a_tension_that_cannot_be_is_refused(tree, value, says, tmp_path):
    run_ = ppmcal("stiffness", written_with(tmp_path, stiff(tree())), "--tension", value,
                  cwd=tmp_path, expect=2)
    assert "--tension" in run_.err and says in run_.err


def soft(tree):
    """Return a file whose ropes are so soft, some N/mm, that their tension counts beside them."""
    factor = 1e3 if tree["units"]["length"] == "m" else 1.0
    return {**tree, "limbs": [{**limb, "stiffness": {"bar": factor * (4.0 + 0.7 * i)}}
                              for i, limb in enumerate(tree["limbs"])]}


def pull_of_ropes(mechanism, closure, pose):
    """Return forces and moments (N, d) of ropes that are springs as long as their joints say.

    Nothing is linear here: lengths are distances, over pulleys tangents and arcs, lines those of
    the pose.
    """
    stiffness = np.array([s["bar"] for s in mechanism.stiffness])
    longer, radius = closure.lengths(pose), closure.at(pose).radius
    # c of a distance goes with its square, so that its lines are as long as the rope over its joint
    lines = closure.pose_matrix(pose) * (radius / (radius + longer) + (radius == 0.0))[..., None]
    return np.einsum("nm,nmd->nd", stiffness * longer, lines)


def differences_of_pull(mechanism, cut, pose, size):
    """Return central differences (d, d) of :func:`pull_of_ropes` by the pose."""
    dof = list(mechanism.dof)
    steps = np.zeros((2, len(dof), 6))
    steps[:, range(len(dof)), dof] = [[size], [-size]]
    there = moved(np.tile(pose, (2 * len(dof), 1)), steps.reshape(-1, 6))
    ahead, behind = pull_of_ropes(mechanism, cut, there).reshape(2, len(dof), -1)
    return (ahead - behind) / (2.0 * size)


@pytest.mark.parametrize(("tree", "limit"), [
    (cables, 1e-6), (belts, 1e-6), (rope_cage, 1e-6), ("cable-4-planar", 1e-6),
    ("cable-4-pulleys", 1e-6), ("cable-8", 1e-6),
    # a swivel turns about its own axis, and is taken to turn as the rope does
    ("cable-8-pulleys", 5e-3)], ids=lambda value: getattr(value, "__name__", str(value)))
@pytest.mark.slow_cases("cable-8-pulleys-0.005")
def test_stiffness_of_tight_ropes_is_how_their_pull_changes_with_the_pose(tree, limit, tmp_path):
    """Differences of the equilibrium: ropes cut as short as told, and the platform moved."""
    tree = tree() if callable(tree) else yaml.safe_load((CONFIGS / f"{tree}.yaml").read_text())
    mechanism = machine(tmp_path, soft(tree))
    model, pose, d = Model(mechanism), near_home(mechanism, 1), len(mechanism.dof)
    q = inverse(model, pose).q
    held = limb_forces(mechanism, springs_of(mechanism), q, pose, np.zeros(3), None, 60.0)
    stretch = held.idle / [s["bar"] for s in mechanism.stiffness]
    cut = model.closure(np.tile(q - stretch / mechanism.joint_ratios, (2 * d, 1)))
    found = compliance(mechanism, q, pose, geometric=held.geometric).stiffness[0]
    bare = compliance(mechanism, q, pose).stiffness[0]
    unit = np.sqrt(np.diagonal(bare))
    share = np.abs((found - bare) / (unit[:, None] * unit)).max()
    coarse, fine = (np.abs((found - differences_of_pull(mechanism, cut, pose, size))
                           / (unit[:, None] * unit)).max() / share for size in (1e-3, 1e-4))
    assert share > 0.01
    assert fine < limit
    if limit < 1e-3:  # what is left is what a central difference leaves
        assert 80.0 < coarse / fine < 120.0


def test_tension_that_pushes_a_pose_over_has_no_stiffness(tmp_path):
    """Compliance with what a tension adds, helps and takes away, by hand."""
    springs = np.array([[[1.0, 0.0], [0.0, 0.1]]])
    factor, strain = _preloaded(np.repeat(springs, 3, axis=0), np.array(
        [np.zeros((2, 2)), [[1.0, 0.0], [0.0, 50.0]], [[0.0, 0.0], [0.0, -101.0]]]))
    np.testing.assert_allclose(factor[0], springs[0])
    np.testing.assert_allclose(factor[1] @ factor[1].T, np.diag([0.5, 1.0 / 150.0]))
    np.testing.assert_allclose(strain[1], np.diag([0.5, 0.1 / 1.5]))
    assert np.isnan(factor[2]).all()


@pytest.mark.long
def test_the_command_tells_a_home_that_the_tension_pushes_over(tmp_path):
    """Hooks on the far sides: each rope runs across the platform and pulls it round."""
    tree = soft(yaml.safe_load((CONFIGS / "cable-4-planar.yaml").read_text()))
    for limb in tree["limbs"]:
        limb["platform"]["point"] = [-3.0 * v for v in limb["platform"]["point"]]
    path = written_with(tmp_path, tree)
    said = ppmcal("stiffness", path, "--tension", "9e5", "--load", "fy=-10", "--out", "out",
                  cwd=tmp_path, expect=1)
    out = " ".join((said.out + said.err).split())
    assert "no stiffness: the pose is not stable" in out and "home is not stable under" in out
    record = json.loads((tmp_path / "out" / "stiffness.json").read_text())
    assert record["home"]["deflection"] == {"x": None, "y": None, "rz": None}
    assert record["home"]["stiffness"]["matrix"] is None
    ppmcal("stiffness", path, "--tension", "1", "--out", "out", "--force", cwd=tmp_path)
