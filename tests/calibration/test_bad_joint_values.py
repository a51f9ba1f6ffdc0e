"""Joint values alone that cannot be a machine's: one refusal each, with its cause and place."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from helpers.redundant import alone, belts, cables, rope_cage, written

import ppmcal
from ppmcal.calibration.fit import FitOptions, Problem, find_gross_errors, identify, too_few
from ppmcal.calibration.interpretation import InterpretationError
from ppmcal.commands.inputs import prepared
from ppmcal.errors import BadInput
from ppmcal.io.results.gross_errors import gross_rows, row_sentences, would_be

HALF = {"belts": {"x": 900, "y": 600}, "cables": {"x": 700, "y": 500, "rz": 8},
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
    assert "limbs read longer than the others let them be" in text
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


@pytest.mark.parametrize(("tree", "cause"), [
    (cables, "all limbs hold the platform in one point"),
    (rope_cage, "all limbs hold the platform in one point"),
    (belts, "all anchors lie in one line with the platform at home")])
@pytest.mark.slow_cases(
    "cables-all limbs hold the platform in one point",
    "rope_cage-all limbs hold the platform in one point")
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
    assert "5 poses give 5 numbers for 14 unknowns" in told and "at least 9 poses more" in told


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
    assert "limbs read longer than the others let them be in 31 of 60 rows" in text
    assert f"q_{names[3]} in 31 by up to" in text
    assert "of one contradiction a row the sign alone tells, so it may be any of these" in text
