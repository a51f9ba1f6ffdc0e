"""Kinds of instruments are declarations: what they say, and one of another package."""

from __future__ import annotations

import ast
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.architecture import block
from helpers.commands import install, number, ppmcal, ppmcal_process, rows
from helpers.paths import ROOT
from helpers.sources import nodes_of

import ppmcal as package
from ppmcal.errors import BadInput
from ppmcal.model.instruments import (
    DISTANCE,
    PLANE,
    POSE,
    POSITION,
    InstrumentKind,
    find_instrument,
    instruments,
    is_own_reading,
    number_names,
)
from ppmcal.model.motions import (
    PLANAR,
    PLANAR_POINT,
    SCHOENFLIES,
    SPATIAL,
    TRANSLATIONAL,
    Motion,
    motions,
)

SIX = (0, 1, 2, 3, 4, 5)


def test_the_seven_in_the_order_in_which_they_are_told() -> None:
    assert list(instruments()) == ["pose", "position", "plane", "distance", "inclinometer",
                                   "joint", "none"]
    assert number_names() == ("height", "distance")
    assert [is_own_reading(n) for n in ("roll", "pitch", "turn_leg1.joint1", "rx", "height")] == [
        True, True, True, False, False]
    assert [k.name for k in instruments().values() if k.touches] == ["plane"]
    assert [k.name for k in instruments().values() if k.along_line] == ["distance"]
    assert [k.name for k in instruments().values() if k.sees_rotation] == ["pose"]
    assert [k.name for k in instruments().values() if not k.of_poses] == ["inclinometer", "joint"]
    assert [k.name for k in instruments().values() if k.inside] == ["joint", "none"]
    assert [k.name for k in instruments().values() if not k.scales] == [
        "plane", "inclinometer", "joint"]
    with pytest.raises(BadInput, match="unknown instrument kind 'laser'"):
        find_instrument("laser")


@pytest.mark.parametrize(("motion", "pose", "position"), [
    (PLANAR_POINT, (0, 1), (0, 1)), (PLANAR, (0, 1, 5), (0, 1)),
    (TRANSLATIONAL, (0, 1, 2), (0, 1, 2)), (SCHOENFLIES, SIX, (0, 1, 2)),
    (SPATIAL, SIX, (0, 1, 2))])
def test_what_they_show(motion: Motion, pose: tuple[int, ...], position: tuple[int, ...]) -> None:
    assert POSE.coordinates(motion) == pose
    assert POSITION.coordinates(motion) == position
    assert (PLANE.coordinates(motion), DISTANCE.coordinates(motion)) == ((2,), (0,))
    assert (PLANE.place, DISTANCE.place) == (2, 0)


def test_what_of_where_they_stand_their_rows_tell() -> None:
    for motion in motions().values():
        for kind in (POSE, POSITION):
            assert kind.frame_parts(motion, False) == motion.frame_parts
            assert kind.target_parts(motion, True) == tuple(range(motion.axes))
    assert PLANE.frame_parts(SPATIAL, False) == (2, 3, 4)
    assert DISTANCE.frame_parts(SPATIAL, False) == (0, 1, 2)
    assert DISTANCE.frame_parts(PLANAR, False) == (0, 1)
    assert DISTANCE.frame_parts(SPATIAL, True) == ()
    # a platform that never turns carries the target as a constant
    assert PLANE.target_parts(TRANSLATIONAL, False) == (2,)
    assert DISTANCE.target_parts(TRANSLATIONAL, False) == (0, 1, 2)
    for kind in (PLANE, DISTANCE):
        assert kind.target_parts(TRANSLATIONAL, True) == ()
        assert kind.target_parts(SPATIAL, True) == (0, 1, 2)
    assert (POSE.opened, POSITION.opened, PLANE.opened, DISTANCE.opened) == (
        ("frame", "target", "rotation", "homing"), ("frame", "target", "homing"), ("frame",), ())


def test_numbers_and_where_a_fit_of_them_starts() -> None:
    rng = np.random.default_rng(2)
    points, far = rng.normal(size=(12, 3)), np.array([0.3, -0.7, 0.4])
    assert PLANE.value is not None
    assert PLANE.start is not None
    assert DISTANCE.value is not None
    assert DISTANCE.start is not None
    np.testing.assert_array_equal(PLANE.value(points, far), points[:, 2])
    apart = DISTANCE.value(points, far)
    np.testing.assert_allclose(apart, np.linalg.norm(points - far, axis=1), rtol=1e-15)
    np.testing.assert_allclose(DISTANCE.start(points, apart, SPATIAL), [*-far, 0, 0, 0], atol=1e-9)
    tilted = points[:, 2] + 0.02 + points[:, 1] * 1e-3 - points[:, 0] * 2e-3
    np.testing.assert_allclose(PLANE.start(points, tilted, SPATIAL), [0, 0, 0.02, 1e-3, 2e-3, 0],
                               atol=1e-12)


def test_a_kind_is_itself_in_another_process() -> None:
    for kind in instruments().values():
        assert pickle.loads(pickle.dumps(kind)) is kind


def test_a_number_needs_a_name_and_a_value() -> None:
    with pytest.raises(ValueError, match="needs the number's name and its value"):
        InstrumentKind("odd", lambda motion: (0,), "odd")


def test_touches_need_a_height() -> None:
    for motion in (PLANAR, PLANAR_POINT):
        with pytest.raises(BadInput, match="it has no z"):
            PLANE.refuse(motion, 0, "a.yaml")
        POSITION.refuse(motion, 0, "a.yaml")
    PLANE.refuse(SCHOENFLIES, 0, "a.yaml")


@pytest.mark.long
def test_an_instrument_of_another_package(tmp_path: Path) -> None:
    """That of the page: simulated, checked, fitted, drawn, planned for; no line here knows it."""
    site = install(tmp_path / "site", "workshop_instrument", block("Add an instrument"), {
        "ppmcal.instruments": {"gauge": "GAUGE"}})
    tree = yaml.safe_load((ROOT / "configs" / "3-RPR.yaml").read_text(encoding="utf-8"))
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree | {"free": ["*.offset"]}))
    scenario = yaml.safe_load((ROOT / "configs" / "scenarios" / "3-RPR.yaml").read_text())
    scenario |= {"instrument": {"kind": "dial", "sigma": {"position": 1e-4}}, "target": "known",
                 "frame": {"x": 7, "y": 0, "rz": 2}, "errors": {"leg1.offset": 0.3,
                                                                "leg3.offset": -0.2}}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
    assert "unknown instrument kind 'dial'" in " ".join(
        ppmcal("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=tmp_path, expect=2).err.split())

    def run(*line: str) -> str:
        return ppmcal_process(*line, cwd=tmp_path, site=site, expect=0, timeout=120).out

    run("simulate", "m.yaml", "s.yaml", "--out", "s")
    assert "reading" in rows(tmp_path / "s" / "measurements.csv")[0]
    run("check", "m.yaml", "s/measurements.csv")
    run("identify", "m.yaml", "s/measurements.csv", "--out", "i")
    truth = {"leg1.offset": 0.3, "leg2.offset": 0.0, "leg3.offset": -0.2}
    for row in rows(tmp_path / "i" / "parameters.csv"):
        if row["name"] in truth:
            assert number(row, "error") == pytest.approx(truth[row["name"]], abs=0.01)
    assert "after_reading" in rows(tmp_path / "i" / "residuals.csv")[0]
    run("report", "i", "--out", "r")
    page = (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    assert '"reading error"' in page, "what points of the drawing are coloured by"
    (worst, *_) = sorted((abs(number(r, "after_reading")) for r in rows(
        tmp_path / "i" / "residuals.csv")), reverse=True)
    assert re.search(rf'"value": ?{worst:.4g}', page), "each point has its row's error"
    told = run("plan", "m.yaml", "--instrument", "s/measurements.yaml", "--count", "8", "--out",
               "p")
    assert "dial, standard deviation reading 0.0001 mm" in " ".join(told.split())


def names_compared(node: ast.AST) -> set[str]:
    """Return texts that a comparison, a dictionary or a set of keys weighs a name against."""
    if not isinstance(node, ast.Compare):
        return set()
    sides = [node.left, *node.comparators]
    words = [w for s in sides for w in (s.elts if isinstance(s, ast.Tuple | ast.Set | ast.List)
                                        else [s])]
    asked = any(isinstance(s, ast.Attribute | ast.Name) and (
        s.attr if isinstance(s, ast.Attribute) else s.id) in ("kind", "kinds", "motion",
                                                              "instrument") for s in sides)
    return {str(w.value) for w in words if isinstance(w, ast.Constant)} if asked else set()


@pytest.mark.long
def test_no_other_module_compares_names_of_instruments() -> None:
    """Figures are of positions, rotations, heights: `kind` of an error is another word."""
    root = Path(package.__file__).parent
    found = {(path.relative_to(root).as_posix(), name) for path in root.rglob("*.py")
             for node in nodes_of(path) for name in names_compared(node) & set(instruments())}
    assert {f for f in found if not f[0].startswith("model/instruments/")} == {
        # of the parts of an error: position or rotation
        ("calibration/validation/summary.py", "position"),
        ("calibration/compensation/safe_commands.py", "position"),
        ("report/exported.py", "position")}
