"""Joint values alone that cannot be a machine's: one refusal each, with its cause and place."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from helpers.redundant import alone, belts, cables, rope_cage, written

import ppmcal
from ppmcal.calibration.fit import (
    FitOptions,
    Problem,
    distances,
    find_gross_errors,
    identify,
    too_few,
)
from ppmcal.calibration.interpretation import InterpretationError
from ppmcal.calibration.interpretation.joint_zeros import joint_zeros, zeros_elsewhere
from ppmcal.commands.inputs import prepared
from ppmcal.errors import BadInput
from ppmcal.io.mechanism_reader import read_mechanism
from ppmcal.io.results.identification_wording import gross_rows, row_sentences, would_be
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_vector

HALF = {"cable-4-planar": {"x": 700, "y": 500, "rz": 8},
        "belts": {"x": 900, "y": 600}, "cables": {"x": 700, "y": 500, "rz": 8},
        "cage": {"x": 600, "y": 500, "z": 400, "rx": 10, "ry": 10, "rz": 10}}


def measured(folder, tree, count=40):
    """Return the machine's file and rows of joint values alone."""
    path = written(folder, tree)
    return path, ppmcal.simulate(path, alone(tree, HALF[tree["name"]], count, sigma=0.3)).data[0]


def refused(path, data, error=BadInput):
    with pytest.raises(error) as found:
        ppmcal.identify(path, data)
    assert found.value.where and found.value.hint
    return str(found.value)


def fitted(path, data):
    """Return the fit alone: what `identify` tells beside it takes much longer."""
    mechanism, datasets = prepared(path, data)
    return identify(Problem(mechanism, datasets, mechanism.free), FitOptions())


def left_out(path, data):
    """Return the machine as fitted and which rows the fit leaves out."""
    fit = fitted(path, data)
    return fit.problem.mechanism.with_values(fit.state.g), find_gross_errors(fit)


def exchanged(data, *pairs):
    order = list(range(data.q.shape[1]))
    for i, j in pairs:
        order[i], order[j] = order[j], order[i]
    return replace(data, q=data.q[:, order])


@pytest.mark.slow
@pytest.mark.long_cases("cables-0.0", "cables-0.0002")
@pytest.mark.parametrize("scatter", [0.0, 2e-4])
@pytest.mark.parametrize("tree", [belts, cables], ids=["belts", "cables"])
def test_a_rope_that_stands_still(tree, scatter, tmp_path):
    path, data = measured(tmp_path, tree())
    q = data.q.copy()
    q[:, 1] = 2.0 + scatter * np.random.default_rng(1).normal(size=len(q))
    text = refused(path, replace(data, q=q))
    assert f"q_{('br', 'c1')[tree is cables]} hardly changes while the other joints move" in text


@pytest.mark.long_cases("cage")
@pytest.mark.parametrize(("tree", "joint", "part"), [
    (belts, "br", 0.6), (belts, "br", 1.0), (rope_cage, "r2", 0.6)],
    ids=["belts", "belts in all rows", "cage"])
@pytest.mark.slow
def test_a_slack_rope_in_many_rows_is_named(tree, joint, part, tmp_path):
    path, data = measured(tmp_path, tree())
    rng = np.random.default_rng(2)
    q = data.q.copy()
    slack = rng.permutation(len(q))[:round(part * len(q))]
    q[slack, 1] += rng.uniform(0.2, 0.6, len(slack))
    text = refused(path, replace(data, q=q))
    assert "limbs read longer than the others allow" in text
    assert f"q_{joint} in " in text


@pytest.mark.slow
def test_few_slack_ropes_are_left_out_row_by_row(tmp_path):
    path, data = measured(tmp_path, belts())
    q = data.q.copy()
    q[[3, 17], 1] += 0.4
    _, found = left_out(path, replace(data, q=q))
    assert {r.row for r in found.rows} == {4, 18}


def test_readings_at_one_place(tmp_path):
    path, data = measured(tmp_path, belts())
    q = np.tile(data.q[:1], (30, 1)) + 3e-4 * np.random.default_rng(3).normal(size=(30, 4))
    text = refused(path, replace(data.take(np.arange(len(data)) < 30), q=q))
    assert "all 30 rows are at one place, where joint values alone give 2 numbers for 5" in text
    assert "at least 3 places" in text


@pytest.mark.long_cases("cables-pairs2", "rope_cage-pairs3")
@pytest.mark.parametrize(("tree", "pairs"), [
    (belts, [(0, 2)]), (belts, [(2, 3)]), pytest.param(cables, [(0, 2)], marks=pytest.mark.slow),
    pytest.param(rope_cage, [(0, 1)], marks=pytest.mark.slow)])
@pytest.mark.slow
def test_two_exchanged_columns_are_named(tree, pairs, tmp_path):
    path, data = measured(tmp_path, tree())
    found = exchanged(data, *pairs)
    text = refused(path, found, InterpretationError)
    names = [f"q_{limb['name']}" for limb in tree()["limbs"]]
    assert f"{names[pairs[0][0]]} and {names[pairs[0][1]]} are exchanged" in text
    # of one surplus a row only the fit shows it
    shown = "residuals are" if tree is cables else "limbs contradict each other by"
    assert shown in text and "Write into the sidecar" in text
    if tree is not cables:
        assert any("are exchanged" in f for f in ppmcal.check(path, found).findings)


@pytest.mark.long_cases("rope_cage-all limbs hold the platform at one point")
@pytest.mark.parametrize(("tree", "cause"), [
    (cables, "all limbs hold the platform at one point"),
    (rope_cage, "all limbs hold the platform at one point"),
    (belts, "all anchors lie in one line with the platform at home")])
@pytest.mark.slow_cases("cables-all limbs hold the platform at one point")
def test_points_that_leave_the_platform_free(tree, cause, tmp_path):
    _, data = measured(tmp_path, tree())
    file = tree()
    for i, limb in enumerate(file["limbs"]):
        if tree is belts:
            limb["base"]["point"] = [1000 * i, 2100]
            file["home"]["pose"] = {"x": 1400, "y": 2100}
        else:
            limb["platform"]["point"] = [0, 0, 0][:len(limb["platform"]["point"])]
    path = written(tmp_path, file, "bad.yaml")
    assert cause in refused(path, data)
    assert any(cause in f for f in ppmcal.check(path).findings)


@pytest.mark.long_cases("cables", "rope_cage")
@pytest.mark.parametrize("tree", [belts, *(pytest.param(
    tree, marks=pytest.mark.slow) for tree in (cables, rope_cage))])
@pytest.mark.slow
def test_what_is_right_is_not_refused(tree, tmp_path):
    path, data = measured(tmp_path, tree())
    assert ppmcal.identify(path, data).identification.fit.converged


@pytest.mark.long
def test_rows_too_few_are_counted_against_parameters(tmp_path):
    path, data = measured(tmp_path, cables())
    text = refused(path, data.take(np.arange(len(data)) < 2))
    assert "2 usable rows cannot calibrate a machine: 2 numbers of joint values alone for 14 " in (
        text)
    assert "at least 12 more" in text
    (told,) = too_few(fitted(path, data.take(np.arange(len(data)) < 5)))
    assert "5 poses give 5 numbers for 14 unknowns" in told and "at least 9 more poses" in told


# --- one contradiction a row ----------------------------------------------------------------------

def hangprinter(folder, count=60):
    """Return a Hangprinter's file and rows of its four lines: far out some of them push apart."""
    file = yaml.safe_load((ROOT / "configs" / "hangprinter.yaml").read_text(encoding="utf-8"))
    path = written(folder, file)
    half = {"x": 500, "y": 400, "z": 300}
    file["home"]["pose"] = {**file["home"]["pose"], "z": file["home"]["pose"]["z"] + 300}
    return path, ppmcal.simulate(path, alone(file, half, count, sigma=0.2)).data[0], [
        limb["name"] for limb in file["limbs"]]


@pytest.mark.long_cases("0-True")
@pytest.mark.parametrize(("which", "longer"), [(0, True), (3, True), (3, False)])
@pytest.mark.slow
def test_of_one_contradiction_the_sign_tells_what_may_be_slack(which, longer, tmp_path):
    path, data, names = hangprinter(tmp_path, 45)
    q = data.q.copy()
    q[[3, 17, 40], which] += 0.15 if longer else -0.15
    machine, found = left_out(path, replace(data, q=q))
    assert {r.row for r in found.rows} == {4, 18, 41}
    assert all((names[which] in r.slack) == longer for r in found.rows)
    text = " ".join(row_sentences(gross_rows(found, machine), would_be(found, machine), machine))
    assert ("that was slack." in text) == longer
    assert ("Of one contradiction a row the sign alone tells" in text) == longer


def test_a_rope_slack_in_many_rows_is_among_those_that_may_be(tmp_path):
    path, data, names = hangprinter(tmp_path)
    q = data.q.copy()
    slack = np.random.default_rng(2).permutation(len(q))[:36]
    q[slack, 3] += np.random.default_rng(3).uniform(0.1, 0.3, len(slack))
    text = refused(path, replace(data, q=q))
    assert "limbs read longer than the others allow in 31 of 60 rows" in text
    assert f"q_{names[3]} in 31 by up to" in text
    assert "with one contradiction per row only its sign is known, so it may be any of" in text


# --- joints that count from another zero ----------------------------------------------------------

def crossed():
    """Return the file of a platform on four cables in the plane that cross."""
    tree = yaml.safe_load((ROOT / "configs" / "cable-4-planar.yaml").read_text(encoding="utf-8"))
    return {n: v for n, v in tree.items() if n != "limits"}


def from_home(tree, **more):
    """Return the file of a machine whose joints are zero at home, with its home moved."""
    file = {**tree, "home": {"pose": {k: v + more.get(k, 0) for k, v in
                                      tree["home"]["pose"].items()}}}
    bare = read_mechanism({**file, "limbs": [{n: v for n, v in limb.items() if n != "offset"}
                                             for limb in tree["limbs"]]})
    return {**file, "tolerances": {"point": 5, "offset": 3}, "limbs": [
        {**limb, "offset": round(1e3 * length, 2)} for limb, length in
        zip(tree["limbs"], home_state(bare).q.tolist(), strict=True)]}


@pytest.mark.slow
@pytest.mark.parametrize(("tree", "home"), [
    (belts, {"x": 400}), (crossed, {"x": -200, "y": 150})])
def test_a_home_that_is_far_off_is_named(tree, home, tmp_path):
    """Where the platform stood at zero is told to within what the points' tolerances leave."""
    _, data = measured(tmp_path, from_home(tree()))
    mechanism, datasets = prepared(written(tmp_path, from_home(tree(), **home), "off.yaml"), data)
    problem = Problem(mechanism, datasets, mechanism.free)
    (found,) = zeros_elsewhere(problem)
    (fault,) = found.mistakes
    assert fault.kind == "home" and fault.text.startswith("home is far off")
    true = read_mechanism(tree()).home_pose
    found = pose_vector(joint_zeros(problem).home[None])[0]
    assert np.abs(found - true)[:2].max() < 0.02 < np.abs(mechanism.home_pose - true)[:2].max()


@pytest.mark.slow
@pytest.mark.parametrize("tree", [belts, crossed])
def test_a_zero_of_one_joint_is_named(tree, tmp_path):
    _, data = measured(tmp_path, from_home(tree()))
    file = from_home(tree())
    file["limbs"][1]["offset"] += 250
    mechanism, datasets = prepared(written(tmp_path, file, "off.yaml"), data)
    (found,) = zeros_elsewhere(Problem(mechanism, datasets, mechanism.free))
    (fault,) = found.mistakes
    assert fault.kind == "zero" and fault.columns == (f"q_{file['limbs'][1]['name']}",)
    assert float(re.search(r"(-\d+(?:\.\d+)?) mm", fault.text)[1]) == pytest.approx(-250, abs=25)


@pytest.mark.slow
def test_a_home_far_off_is_the_one_refusal_and_offsets_that_may_be_are_found(tmp_path):
    _, data = measured(tmp_path, from_home(belts()))
    file = from_home(belts(), x=300)
    text = refused(written(tmp_path, file, "off.yaml"), data, InterpretationError)
    assert "home is far off" in text and "right mechanism file" not in text
    assert any("home is far off" in f for f in ppmcal.check(tmp_path / "off.yaml", data).findings)
    wide = written(tmp_path, {**file, "tolerances": {"point": 5, "offset": 300}}, "wide.yaml")
    assert fitted(wide, data).converged


def test_rows_that_are_right_and_slack_ones_have_no_other_zero(tmp_path):
    path, data = measured(tmp_path, from_home(belts()))
    mechanism, datasets = prepared(path, data)
    assert zeros_elsewhere(Problem(mechanism, datasets, mechanism.free)) == ()
    q = datasets[0].q.copy()
    q[:, 1] += np.random.default_rng(2).uniform(0.1, 0.6, len(q))
    slack = (replace(datasets[0], q=q),)
    assert zeros_elsewhere(Problem(mechanism, slack, mechanism.free)) == ()


@pytest.mark.parametrize("tree", [belts, pytest.param(cables, marks=pytest.mark.slow)])
def test_rows_of_joints_alone_are_as_far_from_a_right_machine_as_their_noise(tree, tmp_path):
    path, data = measured(tmp_path, tree())
    fit = fitted(path, data)
    assert 0.6 < distances(fit.problem, fit.state).times(fit.keep) < 1.4
