"""Every command that computes, with numbers that are hard: a right answer or a refusal by name.

Singular and nearly singular homes and poses, single and repeated ones, rotations of half a turn,
machines of a micrometre and of a hundred metres, noise and tolerances from nothing to beyond
everything, wrong rows. Refusals name place and hint; nothing warns, and no file holds infinities.
"""

import copy
import importlib.util
import json
import math
import re

import numpy as np
import pytest
import yaml
from helpers.fleets import write_fleet
from helpers.other_words import IN_LENGTHS
from helpers.paths import ROOT

import ppmcal as face
from ppmcal import batch
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import measured_pose

BARE = re.compile(r"(?i)(?<![\w.])-?(nan|inf|infinity)(?![\w.])")


# --- the machine and its campaign ---------------------------------------------------------------


def tree(**changes):
    """Return the 3-RPR, 1 m wide, whose struts meet in one point where rz is 0 or 180 degrees."""
    return yaml.safe_load(face.shipped("3-RPR").read_text()) | changes


def plan(**changes):
    """Return its scenario."""
    return yaml.safe_load(face.shipped("3-RPR", scenario=True).read_text()) | changes


TREE = tree()
HOME = TREE["home"]["pose"]


def times(value, factor):
    """Return lengths in a tree times a factor."""
    if isinstance(value, list):
        return [times(v, factor) for v in value]
    if isinstance(value, dict):
        return {k: v if k in ("angle", "rz", "fixed", "rotation", "count") else times(v, factor)
                for k, v in value.items()}
    return value * factor if isinstance(value, int | float) else value


def at_scale(factor):
    """Return machine and scenario of which every length is so many times as long."""
    machine, scenario = tree(), plan()
    for limb in machine["limbs"]:
        limb |= {k: times(limb[k], factor) for k in ("base", "platform", *IN_LENGTHS) if k in limb}
    for key in ("home", "limits", "tolerances"):
        machine[key] = times(machine[key], factor)
    for key in ("poses", "frame", "target", "instrument"):
        scenario[key] = times(scenario[key], factor)
    return machine, scenario


def homed(rz, **changes):
    """Return the machine without limits, with home at so many degrees from its singularity."""
    machine = tree(home={"pose": {**HOME, "rz": rz}}, **changes)
    machine.pop("limits")
    return machine


def with_tolerance(value):
    """Return the machine with one tolerance for all."""
    return tree(tolerances=dict.fromkeys(TREE["tolerances"], value))


def measured(machine, scenario, seed=1):
    """Return sidecar and columns of a simulated campaign."""
    made = face.simulate(machine, scenario, seed=seed)
    side = yaml.safe_load(str(made.files()["measurements.yaml"]))
    side["approach"] = "unknown"
    frame = made.to_frame()
    return side, {c: np.array(frame[c], float) for c in frame
                  if c.startswith("q_") or c in ("x", "y", "rz")}


@pytest.fixture(scope="module")
def bench():
    """Return sidecar and columns of the machine's campaign."""
    return measured(TREE, plan())


def data(bench, machine=TREE, columns=None, **sigma):
    """Return the campaign as data sets, with other columns or standard deviations."""
    side, table = copy.deepcopy(bench[0]), bench[1] if columns is None else columns
    side["instrument"]["sigma"] |= sigma
    return face.read_data(face.load(machine), table, sidecar=side, name="run")


@pytest.fixture(scope="module")
def identified(bench):
    """Return the identified machine."""
    return face.identify(TREE, data(bench), holdout=0)


@pytest.fixture(scope="module")
def saved(identified, tmp_path_factory):
    """Return the folder of the identified machine."""
    folder = tmp_path_factory.mktemp("saved") / "identified"
    identified.save(folder)
    return folder


def poses(*rows):
    """Return a table of poses x, y, rz."""
    return dict(zip(("x", "y", "rz"), np.array(rows, float).T, strict=True))


# --- what every answer and every refusal has to be ----------------------------------------------


def had(result):
    """Return a result of whose files no number is lost: no infinity, none missing where it is ok.

    Tables have `nan` for a cell that is empty; of tolerances and quantiles inf is said on purpose.
    """
    for name, content in result.files().items():
        if name.endswith(".json"):
            json.loads(str(content), parse_constant=pytest.fail)
            assert not BARE.search(str(content)), name
        elif name.endswith(".csv"):
            header, *rows = str(content).splitlines()
            names = header.split(",")
            for row in rows:
                cells = dict(zip(names, row.split(","), strict=False))
                assert name in ("tolerances.csv", "errors.csv") or not re.search(
                    r"(?i)\binf", row), f"{name}: {row}"
                if cells.get("status") == "ok":
                    assert "nan" not in {cells[c] for c in names if c.startswith("q_")}, row
    return result


def refused(words, call):
    """Assert that a call is refused with these words, a hint, and exit code 2 or 3."""
    with pytest.raises(PpmcalError, match=words) as found:
        call()
    assert found.value.hint and found.value.exit_code in (2, 3)
    return found.value


SINGULAR = [0.0, 1e-9, 1e-3]
SINGULAR_HOMES = {
    "simulate": lambda m: face.simulate(m, plan()),
    "tolerances": lambda m: face.tolerances(m, accuracy=0.5, machines=20, measure=6, cores=1),
    "compensate": lambda m: face.compensate(m, poses((500, 288, 30)), frame="base"),
    "sensitivity": lambda m: face.sensitivity(m, home_only=True),
    "workspace": lambda m: face.workspace(m, grid="x=440:560:3,y=230:350:3"),
    "plan": lambda m: face.plan(m, count=4),
    "stiffness": lambda m: face.stiffness({**m, "stiffness": {"drive": 1e7}}),
}


@pytest.mark.parametrize("home", SINGULAR)
@pytest.mark.parametrize("command", SINGULAR_HOMES)
def test_a_home_at_or_near_a_singularity(command, home):
    refused("singular", lambda: SINGULAR_HOMES[command](homed(home)))


@pytest.mark.long_cases("1e-09")
@pytest.mark.slow
@pytest.mark.parametrize("home", SINGULAR)
def test_kinematics_and_check_of_a_singular_home(home):
    machine = homed(home)
    assert any("singularity at home" in f for f in face.check(machine).findings)
    for found in (face.inverse(machine, poses((500, 288, 30), (500, 288.675, home))),
                  face.forward(machine, {f"q_leg{i}": np.array([432.0]) for i in (1, 2, 3)}),
                  face.velocity(machine, poses((500, 288, 30)) | {
                      c: np.array([1.0]) for c in ("vx", "vy", "wz")})):
        assert len(had(found).failed) == found.asked
        assert all("singular" in reason for _, _, reason in found.failed)


@pytest.mark.parametrize("home", [0.0, 1e-9])
@pytest.mark.parametrize("command", ["identify", "diagnose", "validate"])
def test_fits_of_a_machine_with_a_singular_home(bench, command, home):
    machine = homed(home)
    refused("singular at home", lambda: getattr(face, command)(machine, data(bench, machine)))


# --- singular, single and repeated poses, half a turn -------------------------------------------


@pytest.fixture(scope="module")
def unlimited(bench):
    """Return the machine without limits, identified, and what turns its poses into targets."""
    machine = homed(30.0)
    model = face.identify(machine, data(bench, machine), holdout=0)
    registration = model.identification.fit.state.registrations[0]

    def seen(rows):
        vector = np.zeros((len(rows), 6))
        vector[:, [0, 1, 5]] = np.array(rows, float) * [1e-3, 1e-3, math.pi / 180.0]
        there = measured_pose(registration, pose_motor(vector))
        return poses(*(there[:, [0, 1, 5]] * [1e3, 1e3, 180.0 / math.pi]))

    return model, seen


@pytest.mark.slow_cases("0.0-near a singularity")
@pytest.mark.parametrize(("rz", "why"), [
    (0.0, "near a singularity"), (1e-9, "near a singularity"), (0.1, "near a singularity"),
    (179.999, "near a singularity"), (180.0, "near a singularity"), (-180.0, "near a singularity"),
    (2.0, "far outside the measured volume"), (-30.0, "other side of a singularity")])
def test_targets_at_and_beyond_a_singularity_are_refused(unlimited, rz, why):
    model, seen = unlimited
    found = had(face.compensate(model, seen([(500, 288.675, 30), (500, 288.675, rz)])))
    assert found.compensation.status == ("ok", "refused")
    assert why in found.compensation.reason[1]
    assert np.isnan(found.compensation.q[1]).all() and found.has_findings


@pytest.mark.parametrize("rz", [0.0, 1e-6, 180.0])
@pytest.mark.slow
def test_singular_poses_in_tables(rz):
    machine = homed(30.0)
    asked = poses((500, 288.675, 30), (500, 288.675, rz))
    moving = {c: np.array([1.0, 1.0]) for c in ("vx", "vy", "wz")}
    for found in (face.inverse(machine, asked), face.velocity(machine, asked | moving)):
        assert [(n, s) for n, s, _ in had(found).failed] == [(2, "singular")]
    springs = face.stiffness({**machine, "stiffness": {"drive": 1e7}}, poses=asked,
                             load_at_tool="fx=10")
    assert len(had(springs).row_failures) == 1
    only = poses((500, 288.675, rz))
    refused("singular", lambda: face.sensitivity(machine, poses=only))
    refused("singular", lambda: face.tolerances(machine, accuracy=0.5, poses=only, cores=1))
    refused("singular", lambda: face.plan(machine, candidates=only, count=4))


@pytest.mark.long
def test_one_pose_and_the_same_pose_again():
    once, again = poses((500, 288.675, 30)), poses(*[(500, 288.675, 30)] * 4)
    same = [had(face.inverse(TREE, p)).q for p in (once, again)]
    assert np.ptp(np.concatenate(same), axis=0) == pytest.approx(0.0, abs=1e-15)
    one, other = (had(face.sensitivity(TREE, poses=p)).record for p in (once, again))
    for name in ("amplification_position", "rss_position", "rss_rotation", "worst_position",
                 "worst_rotation"):
        assert getattr(one, name) == getattr(other, name)
    found = [face.tolerances(TREE, accuracy=0.5, poses=p, machines=20, measure=6, cores=1)
             for p in (once, again)]
    chosen = [had(f).found.allocations["cost"].tau for f in found]
    assert chosen[1] == pytest.approx(chosen[0], rel=1e-6)
    made = had(face.plan(TREE, candidates=once, count=4)).to_frame()
    assert len(set(zip(made["x"], made["y"], made["rz"], strict=True))) == 1


@pytest.mark.slow
def test_targets_that_are_one_pose_and_turns_of_it(bench, identified):
    x, y, rz = (bench[1][c][0] for c in ("x", "y", "rz"))
    plain = had(face.compensate(identified, poses((x, y, rz))))
    assert plain.compensation.status == ("ok",)
    for rows in ([(x, y, rz)] * 5, [(x, y, rz + 360.0), (x, y, rz - 360.0)]):
        found = had(face.compensate(identified, poses(*rows))).compensation
        assert set(found.status) == {"ok"}
        assert found.q == pytest.approx(np.tile(plain.compensation.q, (len(rows), 1)), rel=1e-9)
    far = face.compensate(identified, poses((1e12, 0, 0), (x, y, 1e6)))
    assert had(far).compensation.status == ("refused", "refused")
    refused("out of range", lambda: face.compensate(identified, poses((1e300, 0, 0))))


@pytest.mark.parametrize("turn", [137.999999, 138.0, -222.0])
@pytest.mark.slow
def test_a_measuring_frame_half_a_turn_away(bench, identified, turn):
    """Measured rotations of about 180 degrees flip their sign; the machine does not."""
    side, table = bench
    rz = table["rz"] + turn
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    turned = table | {"x": c * table["x"] - s * table["y"], "y": s * table["x"] + c * table["y"],
                      "rz": (rz + 180.0) % 360.0 - 180.0}
    assert np.ptp(turned["rz"]) > 350.0
    model = had(face.identify(TREE, data((side, turned)), holdout=0))
    assert model.mechanism.values == pytest.approx(identified.mechanism.values, abs=1e-9)
    sent = [had(face.compensate(m, {k: t[k][:4] for k in ("x", "y", "rz")})).compensation.q
            for m, t in ((identified, table), (model, turned))]
    assert sent[1] == pytest.approx(sent[0], rel=1e-9)


@pytest.mark.slow_cases("identify-one", "identify-two")
@pytest.mark.parametrize("name", ["one", "two", "copies"])
@pytest.mark.parametrize("command", ["identify", "validate",
                                     pytest.param("diagnose", marks=pytest.mark.slow)])
def test_rows_that_are_too_few(bench, identified, command, name):
    rows = {"one": [0], "two": [0, 1], "copies": [0] * 9}[name]
    few = {c: v[rows] for c, v in bench[1].items()}
    machine = identified if command == "validate" else TREE
    refused("copied" if name == "copies" else "at least 3",
            lambda: getattr(face, command)(machine, data(bench, columns=few)))


@pytest.mark.long_cases("1e-09")
@pytest.mark.parametrize("apart", [1e-12, 1e-9, 1e-6])
@pytest.mark.slow
def test_poses_hardly_apart_tell_no_more_than_sound_ones(bench, identified, apart):
    """Round-off that open frames leave of the columns is no rank."""
    rng = np.random.default_rng(1)
    near = {c: v[0] * (1.0 + apart * rng.normal(size=9)) for c, v in bench[1].items()}
    found = had(face.identify(TREE, data(bench, columns=near), holdout=0)).identification
    assert found.rank <= identified.identification.rank
    assert found.unidentifiable
    for e in found.estimates:
        if e.status != "fixed":
            assert e.sigma == pytest.approx(e.tolerance, rel=1e-3)


# --- sizes --------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("factor", [1e-6, pytest.param(1e2, marks=pytest.mark.slow)])
def test_designs_of_any_size_give_scaled_answers(factor):
    machine, _ = at_scale(factor)
    grid = ",".join(f"{c}={a * factor!r}:{b * factor!r}:3" for c, a, b in (
        ("x", 470.0, 530.0), ("y", 260.0, 320.0)))
    one, other = (had(face.sensitivity(m, home_only=True)).record
                  for m in (TREE, machine))
    assert other.rss_position == pytest.approx(one.rss_position * factor, rel=1e-9)
    assert other.rss_rotation == pytest.approx(one.rss_rotation, rel=1e-9)
    one, other = (had(face.workspace(m, grid=g)).workspace for m, g in (
        (TREE, "x=470:530:3,y=260:320:3"), (machine, grid)))
    assert other.table.singular_value == pytest.approx(one.table.singular_value, rel=1e-9)
    load = {"load_at_tool": "fx=10"}
    spring = {"stiffness": {"drive": 1e7}}
    one, other = (had(face.stiffness({**m, **spring}, poses=poses(
        (500 * f, 288.675 * f, 30)), **load)).study.found for m, f in ((TREE, 1.0),
                                                                       (machine, factor)))
    assert other.deflection[..., :3] == pytest.approx(one.deflection[..., :3], rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("factor", [1e-6, 1e2])
def test_plans_and_tolerances_of_any_size(factor):
    machine, _ = at_scale(factor)
    one, other = (had(face.plan(m, count=5)).to_frame() for m in (TREE, machine))
    assert np.array(other["rz"]) == pytest.approx(np.array(one["rz"]), abs=1e-6)
    for c in ("x", "y"):
        assert np.array(other[c]) == pytest.approx(np.array(one[c]) * factor, rel=1e-6)
    one, other = (had(face.tolerances(m, accuracy=0.5 * f, machines=20, measure=6, cores=1)
                      ).found.allocations["equal"].tau
                  for m, f in ((TREE, 1.0), (machine, factor)))
    assert other == pytest.approx(one * factor, rel=1e-4)


@pytest.mark.long_cases("100.0")
@pytest.mark.slow
@pytest.mark.parametrize("factor", [pytest.param(1e-6, marks=pytest.mark.slow), 1e2])
def test_campaigns_of_any_size(identified, bench, tmp_path, factor):
    machine, scenario = at_scale(factor)
    side, table = measured(machine, scenario)
    for c, v in bench[1].items():
        assert table[c] == pytest.approx(v * (1.0 if c == "rz" else factor), rel=1e-9), c
    model = had(face.identify(machine, data((side, table), machine), holdout=0))
    assert model.identification.rank == identified.identification.rank
    judged = [had(face.validate(m, d)).record.datasets[0].errors[0] for m, d in (
        (identified, data(bench)), (model, data((side, table), machine)))]
    assert judged[1].noise == pytest.approx(judged[0].noise, rel=1e-5)
    model.save(tmp_path / "a")
    assert not had(face.compare(tmp_path / "a", tmp_path / "a")).has_findings
    (tmp_path / "p.csv").write_text(f"x,y,rz\n{500 * factor!r},{288.675 * factor!r},30\n")
    assert not had(face.export("grid", tmp_path / "a", poses=tmp_path / "p.csv")).has_findings


# --- noise, tolerances, options -----------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0, 1e-300, 1e-15])
def test_simulated_noise_of_nothing_is_none(bench, sigma):
    scenario = plan(instrument={"kind": "pose", "sigma": {"position": sigma, "rotation": sigma}},
                    errors={})
    made = had(face.simulate(TREE, scenario, seed=1))
    back = face.forward(TREE, {c: made.to_frame()[c][:4] for c in bench[1]
                               if c.startswith("q_")}).pose
    frame, target = plan()["frame"], np.array([*plan()["target"], 1.0])
    for n, (x, y, *_, rz) in enumerate(back):
        turns = [np.array([[math.cos(a), -math.sin(a), u], [math.sin(a), math.cos(a), v],
                           [0, 0, 1]]) for a, u, v in (
            (math.radians(frame["rz"]), frame["x"], frame["y"]), (rz, 1e3 * x, 1e3 * y))]
        seen = turns[0] @ turns[1] @ target
        assert made.to_frame()["x"][n] == pytest.approx(seen[0], abs=1e-7)
        assert made.to_frame()["y"][n] == pytest.approx(seen[1], abs=1e-7)


@pytest.mark.parametrize(("changes", "words"), [
    ({"instrument": {"kind": "pose", "sigma": {"position": 1e300, "rotation": 1}}}, "implausible"),
    ({"instrument": {"kind": "pose", "sigma": {"position": 1, "rotation": 1e6}}}, "implausible"),
    ({"errors": {"random": {"scale": 1e300}}}, "cannot be used"),
    ({"errors": {"random": {"scale": 1e6}}}, "cannot reach any"),
    ({"errors": {"leg1.offset": 1e6}}, "cannot reach any"),
    ({"errors": {"leg1.offset": 1e300}}, "not a number"),
    ({"frame": {"x": 1e300, "y": 0, "rz": 0}}, "out of range"),
    ({"poses": {"random": {"center": {"x": 1e9, "y": 0, "rz": 0}, "half_range": {
        "x": 0, "y": 0, "rz": 0}, "count": 3}}}, "can be measured")])
def test_scenarios_that_cannot_be(changes, words):
    refused(words, lambda: face.simulate(TREE, plan(**changes)))


@pytest.mark.parametrize(("sigma", "words"), [
    (0, "greater than 0"), (1e-300, "implausible"), (1e-15, "implausible"), (1e9, "implausible"),
    (1e300, "out of range")])
def test_validate_refuses_noise_that_cannot_be(bench, sigma, words):
    refused(words, lambda: data(bench, position=sigma))


def test_tolerances_of_nothing_leave_nothing_to_design_for():
    machine = with_tolerance(0)
    for call in (lambda: face.sensitivity(machine, home_only=True),
                 lambda: face.plan(machine, count=4),
                 lambda: face.tolerances(machine, accuracy=0.5, cores=1)):
        refused("no parameter is free", call)
    for value in (1e-300, 1e300):
        refused("is implausible", lambda v=value: face.load(with_tolerance(v)))


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e6, pytest.param(math.inf, marks=pytest.mark.slow)])
def test_tolerances_of_everything_are_no_prior(bench, identified, tmp_path, tolerance):
    """What the data tell is told without them too: the commands are those of the data."""
    machine = with_tolerance(tolerance)
    model = had(face.identify(machine, data(bench, machine), holdout=0))
    assert model.identification.rank == identified.identification.rank
    targets = {c: bench[1][c][:4] for c in ("x", "y", "rz")}
    a, b = (had(face.compensate(m, targets)).compensation for m in (identified, model))
    assert set(b.status) == {"ok"}
    assert np.abs(a.q - b.q).max() < 1e-4
    had(face.validate(model, data(bench)))
    model.save(tmp_path / "a")
    assert not had(face.compare(tmp_path / "a", tmp_path / "a")).has_findings


@pytest.mark.parametrize(("call", "words"), [
    (lambda: face.tolerances(TREE, accuracy=0), "not the size"),
    (lambda: face.tolerances(TREE, accuracy=1e-300), "is implausible"),
    (lambda: face.tolerances(TREE, accuracy=1e-12), "is implausible"),
    (lambda: face.tolerances(TREE, accuracy=1e6), "is implausible"),
    (lambda: face.tolerances(TREE, accuracy=1e300), "not the size"),
    (lambda: face.tolerances(TREE, rotation=1e-300), "is implausible"),
    (lambda: face.tolerances(TREE, accuracy=0.5, share=1.0), "not a share"),
    (lambda: face.tolerances(TREE, accuracy=0.5, metric=1e300), "not a length"),
    (lambda: face.sensitivity(TREE, sigmas=1e300), "number of standard deviations"),
    (lambda: face.sensitivity(TREE, metric=1e300), "not a length"),
    (lambda: face.sensitivity(TREE, tool="1e300,0"), "not a point"),
    (lambda: face.sensitivity(TREE, together=["*.offset"], size=1e300), "size of an error"),
    (lambda: face.plan(TREE, count=0), "number of measurements"),
    (lambda: face.plan(TREE, accuracy=1e300), "not the size"),
    (lambda: face.plan(TREE, payload="0,1e300"), "1e\\+300 .* is not between 0 and 1e6"),
    (lambda: face.stiffness(tree(stiffness={"drive": 0})), "not a stiffness"),
    (lambda: face.stiffness(tree(stiffness={"drive": 1e-300})), "out of range"),
    (lambda: face.stiffness(tree(stiffness={"drive": 1e300})), "out of range"),
    (lambda: face.stiffness(tree(stiffness={"drive": 1e7}), load_at_tool="fx=1e300"),
     "out of range"),
    (lambda: face.stiffness(tree(stiffness={"drive": 1e7}), payload=1e300), "not a mass"),
    (lambda: face.workspace(TREE, grid="x=1e300:2e300:3,y"), "x"),
    (lambda: face.inverse(TREE, poses((1e300, 0, 0))), "out of range"),
    (lambda: face.inverse(TREE, poses((500, 288, 30)), tool=(1e300, 0)), "not a point"),
    (lambda: face.forward(TREE, {f"q_leg{i}": np.array([1e300]) for i in (1, 2, 3)}),
     "out of range")])
def test_options_and_cells_that_cannot_be_meant(call, words):
    refused(words, call)


@pytest.mark.slow
def test_joints_and_tools_far_away_have_no_pose():
    joints = {f"q_leg{i}": np.array([432.0, 1e-300, 0.0, -432.0, 1e9]) for i in (1, 2, 3)}
    for method in ("newton", "intersection"):
        found = had(face.forward(TREE, joints, method=method))
        assert 1 not in [n for n, _, _ in found.failed]
        assert {5} <= {n for n, _, r in found.failed if r}
    far = had(face.inverse(TREE, poses((500, 288.675, 30)), tool=(1e12, 0.0)))
    assert [s for _, s, _ in far.failed] == ["unreachable"]


@pytest.mark.slow
@pytest.mark.parametrize("options", [
    {"sigmas": 1e-300}, {"metric": 1e-300}, {"tool": "1e9,0"},
    {"together": ["*.offset"], "size": 1e-300}, {"together": ["*.offset"], "size": 1e6}])
def test_sensitivities_of_extreme_options(options):
    had(face.sensitivity(TREE, home_only=True, **options))


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"machines": 1}, {"measure": 1}, {"metric": 1e-300}])
def test_tolerances_of_extreme_options(options):
    had(face.tolerances(TREE, accuracy=0.5, cores=1, **{"machines": 20, "measure": 6} | options))


@pytest.mark.slow
@pytest.mark.parametrize("load", [{"load_at_tool": "fx=1e-300"}, {"load_at_tool": "fx=1e12"},
                                  {"payload": 1e-300}, {"payload": 1e11}])
def test_loads_of_any_size(load):
    had(face.stiffness(tree(stiffness={"drive": 1e7}), grid="x=470:530:3,y=260:320:3", **load))


# --- wrong rows, other machines -----------------------------------------------------------------


@pytest.mark.slow
def test_one_row_in_five_wrong_is_left_out_of_a_validation(bench, identified):
    wrong = {c: v.copy() for c, v in bench[1].items()}
    rng = np.random.default_rng(4)
    at = rng.choice(len(wrong["x"]), len(wrong["x"]) // 5, replace=False)
    wrong["x"][at] += rng.uniform(5.0, 300.0, at.size)
    judged = had(face.validate(identified, data(bench, columns=wrong))).record.datasets[0]
    assert (judged.rows, judged.of_rows) == (24, 30)
    assert judged.errors[0].noise < 1.5


@pytest.mark.long
def test_validate_says_that_rows_are_of_another_machine(bench, identified):
    other = tree()
    for i, limb in enumerate(other["limbs"]):
        x, y = limb["base"]["point"]
        limb["base"]["point"] = [x + 30 * i, y - 20 * i]
    found = face.validate(identified, data(measured(other, plan(), seed=5)))
    assert had(found).has_findings
    assert any("another machine" in f for f in found.findings), found.findings
    own = face.validate(identified, data(bench))
    assert len(own.findings) == 1 and "was fitted to these measurements" in own.findings[0]
    found = face.validate(identified, data(measured(tree(), plan(), seed=6)))
    assert not any("another machine" in f for f in found.findings), found.findings


@pytest.mark.slow
def test_compare_of_the_same_data_finds_no_difference(bench, identified, saved, tmp_path):
    for i, model in enumerate((face.identify(TREE, data(bench), holdout=0.2), identified)):
        model.save(tmp_path / str(i))
        found = had(face.compare(saved, tmp_path / str(i)))
        assert not found.comparison.changed and not found.has_findings
        assert "nothing has changed" in found.headline()
    other = tree()
    other["limbs"][1]["base"]["point"][0] += 3.0
    face.identify(TREE, data(measured(other, plan(), seed=5)), holdout=0).save(tmp_path / "o")
    assert had(face.compare(saved, tmp_path / "o")).comparison.changed


# --- controllers, batches -----------------------------------------------------------------------


@pytest.mark.parametrize(("rows", "words"), [
    ("500,288.675,0\n500,288.675,1e-9\n", "near a singularity"),
    ("1e12,0,0\n", "1000 times the machine's reach"), ("1e300,0,0\n", "out of range"),
    ("500,288.675,180\n", "none of the 1")])
def test_grids_of_poses_that_cannot_be(saved, tmp_path, rows, words):
    (tmp_path / "p.csv").write_text("x,y,rz\n" + rows)
    refused(words, lambda: face.export("grid", saved, poses=tmp_path / "p.csv"))


@pytest.mark.slow
def test_grids_and_tables_that_can(saved, tmp_path):
    (tmp_path / "p.csv").write_text("x,y,rz\n" + "500,288.675,30\n" * 4 + "500,288.675,0\n")
    assert had(face.export("grid", saved, poses=tmp_path / "p.csv")).has_findings
    had(face.export("joints", saved))


PRINTER = (ROOT / "sample_data" / "printer" / "printer.cfg").read_text()


@pytest.mark.parametrize(("key", "value"), [
    (k, v) for k in ("delta_radius", "arm_length", "rotation_distance")
    for v in ("0", "-1", "1e-300", "1e300", "nan", "inf")])
def test_printers_that_cannot_be(tmp_path, key, value):
    file = tmp_path / "printer.cfg"
    file.write_text(re.sub(rf"(?m)^(#?\*?#? ?{key}\s*[:=]\s*).*$", rf"\g<1>{value}", PRINTER))
    refused(key, lambda: face.import_config("klipper", file))


@pytest.mark.parametrize("options", [
    {"rods": [v, "fixed"]} for v in (1e-300, 1.0, 1e300)] + [
    {"radius": v} for v in (0, 1e-300, 1e300, -5)])
def test_rods_and_radii_that_cannot_be(tmp_path, options):
    file = tmp_path / "printer.cfg"
    file.write_text(PRINTER)
    refused("radius|rods", lambda: face.import_config("klipper", file, **options))


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="writes Parquet")
def test_a_batch_goes_on_after_numbers_that_cannot_be(tmp_path):
    """One sound campaign; one of noise of nothing, one of too few rows, one singular at home."""
    manifest = write_fleet(tmp_path, machines=4, dates=("2026-01-10",))
    runs = tmp_path / "runs"
    side = runs / "m01" / "2026-01-10" / "measurements.yaml"
    content = yaml.safe_load(side.read_text())
    content["instrument"]["sigma"] = {"position": 1e-300, "rotation": 1e-300}
    side.write_text(yaml.safe_dump(content))
    table = runs / "m02" / "2026-01-10" / "measurements.csv"
    table.write_text("\n".join(table.read_text().splitlines()[:3]) + "\n")
    (tmp_path / "singular.yaml").write_text(yaml.safe_dump(homed(0.0)))
    whole = yaml.safe_load(manifest.read_text())
    whole["campaigns"] = [{"machine": f"m{i:02d}", "date": "2026-01-10",
                           "data": f"runs/m{i:02d}/2026-01-10/measurements.csv",
                           **({"model": "singular.yaml"} if i == 3 else {})} for i in range(4)]
    manifest.write_text(yaml.safe_dump(whole))
    found = batch(manifest, tmp_path / "out", cores=1)
    assert [r.exit_code for r in found.campaigns] == [
        found.campaigns[0].exit_code, 2, 2, 3] and found.campaigns[0].exit_code < 2
    for record, words in zip(found.failed, ("is implausible", "at least 3", "singular at home"),
                             strict=True):
        assert words in record.message
