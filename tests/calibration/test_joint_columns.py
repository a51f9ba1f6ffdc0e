"""Joint values alone in other units or in each other's columns: told with the lines to write."""

import time
from dataclasses import replace

import numpy as np
import pytest
from helpers.redundant import alone, belts, written

import ppmcal
from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation import InterpretationError
from ppmcal.calibration.interpretation.joint_columns import contradicted, refuse_joint_columns
from ppmcal.calibration.interpretation.score import score
from ppmcal.calibration.interpretation.search import ways
from ppmcal.commands.inputs import prepared
from ppmcal.errors import BadInput

HALF = {"x": 900, "y": 600}
ALL = ("bl", "br", "tr", "tl")


def measured(folder, tree):
    """Return the machine's file and rows of joint values alone."""
    path = written(folder, tree)
    return path, ppmcal.simulate(path, alone(tree, HALF, 40, sigma=0.3)).data[0]


def told(path, data):
    with pytest.raises(InterpretationError) as found:
        ppmcal.identify(path, data)
    return found.value


def exchanged(data, i, j):
    order = list(range(data.q.shape[1]))
    order[i], order[j] = order[j], order[i]
    return replace(data, q=data.q[:, order])


@pytest.mark.parametrize(("unit", "factor", "joints"), [
    ("cm", 0.1, ALL), ("in", 1.0 / 25.4, ALL), ("m", 1e-3, ALL), ("cm", 0.1, ("tr",)),
    ("m", 1e-3, ("bl",))])
def test_another_unit_is_told_with_the_line_to_write(unit, factor, joints, tmp_path):
    path, data = measured(tmp_path, belts())
    q = data.q.copy()
    q[:, [ALL.index(name) for name in joints]] *= factor
    error = told(path, replace(data, q=q))
    word = "inches" if unit == "in" else unit
    verb = "is" if len(joints) == 1 else "are"
    assert f"q_{joints[-1]} {verb} in {word}, not mm: limbs contradict each other by" in error.what
    lines = ", ".join(f"q_{name}: {unit}" for name in joints)
    assert error.hint == f"Write into the sidecar: `read: {{units: {{{lines}}}}}`"
    assert np.allclose(error.found[0].right.q, data.q)


def test_check_tells_another_unit_without_fits_of_what_is_read_wrongly(tmp_path):
    path, data = measured(tmp_path, belts())
    begin = time.process_time()
    found = ppmcal.check(path, replace(data, q=data.q / 25.4))
    assert time.process_time() - begin < 5.0
    assert any("are in inches, not mm" in f and "q_bl: in" in f for f in found.findings)


def test_a_unit_in_which_joints_hardly_move_explains_nothing(tmp_path):
    """A machine whose joints are zero at home closes there with numbers that are near zero."""
    tree = belts()
    _, data = measured(tmp_path, tree)
    at_home = np.hypot([1500, 1500, 1500, 1500], [1050, 1050, 1050, 1050])
    tree["limbs"] = [{**limb, "offset": float(at)} for limb, at in
                     zip(tree["limbs"], at_home, strict=True)]
    # readings from a zero that is 200 mm elsewhere: another unit is none of their causes
    off = np.array([0.2, -0.2, -0.2, 0.2])
    path = written(tmp_path, {**tree, "tolerances": {"point": 5, "offset": 3}}, "zero.yaml")
    machine, datasets = prepared(path, replace(data, q=data.q - 1e-3 * at_home + off))
    rows = contradicted(Problem(machine, datasets, machine.free), datasets[0])
    assert rows is not None
    refuse_joint_columns(machine, datasets[0], rows)


def test_exchanged_columns_that_fit_equally_are_both_told(tmp_path):
    path, data = measured(tmp_path, belts())
    error = told(path, exchanged(data, 2, 3))
    assert "both fit equally, and are mirror images of one another" in error.what
    assert "or the points of these limbs in the mechanism file" in error.what
    assert "`read: {columns: {q_tr: q_tl, q_tl: q_tr}}`" in error.hint
    assert "`read: {columns: {q_bl: q_br, q_br: q_bl}}`" in error.hint
    assert error.hint.count("or instead `read:") == 1


@pytest.mark.slow
def test_exchanged_columns_that_bend_the_geometry_are_told_after_the_fit(tmp_path):
    """Ropes on a rectangle's diagonal nearly agree if exchanged: the noise alone tells nothing."""
    tree = {**belts(), "tolerances": {"point": 40}}
    path, data = measured(tmp_path, tree)
    error = told(path, exchanged(data, 0, 2))
    assert "tolerances from nominal then (RMS), not" in error.what
    assert "the same machine turned by half a turn" in error.what
    assert "`read: {columns: {q_bl: q_tr, q_tr: q_bl}}`" in error.hint


def in_one_line(folder):
    """Return the file of belts whose anchors are in one line below the platform, and their rows."""
    tree = {**belts(), "tolerances": {"point": 30, "offset": 30}}
    for limb in tree["limbs"]:
        limb["offset"] = {"share": "end", "value": 0}
    _, data = measured(folder, tree)
    for x, limb in zip((0, 3000, 2200, 800), tree["limbs"], strict=True):
        limb["base"]["point"] = [x, 0]
    return written(folder, tree, "line.yaml"), data


def test_ropes_that_cannot_hold_the_platform_are_told_before_columns(tmp_path):
    path, data = in_one_line(tmp_path)
    with pytest.raises(BadInput, match="the ropes cannot hold the platform at home") as found:
        ppmcal.identify(path, data)
    assert "Their anchors lie in one line" in found.value.what
    told, = (f for f in ppmcal.check(path).findings if "cannot hold" in f)
    assert told == f"{found.value.what}. {found.value.hint}."


@pytest.mark.filterwarnings("error")
def test_joint_values_that_fit_nothing_are_told_by_numbers_that_there_are(tmp_path):
    """No step of a pose runs off to where squares overflow."""
    path, data = in_one_line(tmp_path)
    machine, datasets = prepared(path, data)
    problem = Problem(machine, datasets, machine.free)
    for way in ways(problem, score(problem)):
        score(way.problem)
    said = score(problem).sentence(machine.units)
    assert "half of the rows are off by more than " in said and "more than ," not in said


def test_check_leaves_with_0_where_nothing_but_the_gauge_is_said(tmp_path):
    """A frame that joint values cannot see, and the mirror image, hold of every such machine."""
    path, data = measured(tmp_path, belts())
    found = ppmcal.check(path, data)
    assert found.exit_code == 0 and {f.topic for f in found.findings} == {"gauge"}
    assert ppmcal.check(path, exchanged(data, 2, 3)).exit_code == 1
