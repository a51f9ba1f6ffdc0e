"""Motions are declarations: what follows from the coordinates, and a machine of each new one."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import environment, install, number, pick, ppmcal, ppmcal_process, rows
from helpers.sources import nodes_of

import ppmcal as package
from ppmcal.calibration.fit.nuisance_columns import frame_parts, lay_out, target_parts
from ppmcal.errors import BadInput
from ppmcal.io import read_dataset, read_mechanism
from ppmcal.model.effects import effect_kinds
from ppmcal.model.instruments import POSE, POSITION
from ppmcal.model.motions import (
    PLANAR,
    PLANAR_POINT,
    SCHOENFLIES,
    SPATIAL,
    TRANSLATIONAL,
    Motion,
    find_motion,
    motions,
)

FIVE_BAR = """format: ppmcal/mechanism/1
name: five-bar
units: {length: mm, angle: deg}
motion: planar-point
limbs:
  - {name: left, kind: (R)RR, base: {point: [-40, 0]}, platform: {point: [0, 0]}, proximal: 100,
     distal: 140, elbow: -1}
  - {name: right, kind: (R)RR, base: {point: [40, 0]}, platform: {point: [0, 0]}, proximal: 100,
     distal: 140, elbow: 1}
home: {pose: {x: 0, y: 170}}
tolerances: {point: 0.5, length: 0.3, angle: 0.1, offset: 0.4}
free: ["*.proximal", "*.distal", "*.offset"]
"""
SCENARIO = """format: ppmcal/scenario/1
units: {length: mm, angle: deg}
poses: {grid: {center: {x: 0, y: 170}, half_range: {x: 60, y: 40}, counts: {x: 6, y: 6}}}
errors: {left.proximal: 0.2, right.distal: -0.3, left.offset: 0.3}
instrument: {kind: position, sigma: {position: 1e-5}}
frame: {x: 5, y: -3}
seed: 7
"""


@pytest.mark.parametrize(("motion", "dof", "turns", "freely", "frame", "seen", "turn", "down"), [
    (PLANAR_POINT, (0, 1), False, False, (0, 1, 5), (), 0.0, (0, -1, 0)),
    (PLANAR, (0, 1, 5), True, False, (0, 1, 5), (5,), 45.0, (0, -1, 0)),
    (TRANSLATIONAL, (0, 1, 2), False, False, tuple(range(6)), (), 0.0, (0, 0, -1)),
    (SCHOENFLIES, (0, 1, 2, 5), True, False, tuple(range(6)), (3, 4, 5), 45.0, (0, 0, -1)),
    (SPATIAL, tuple(range(6)), True, True, tuple(range(6)), (3, 4, 5), 15.0, (0, 0, -1)),
])
def test_what_follows_from_the_coordinates(
        motion: Motion, dof: tuple[int, ...], turns: bool, freely: bool, frame: tuple[int, ...],
        seen: tuple[int, ...], turn: float, down: tuple[int, ...]) -> None:
    assert find_motion(str(motion)) is motion
    assert (motion.dof, motion.turns, motion.turns_freely) == (dof, turns, freely)
    assert (motion.frame_parts, motion.measured_turns) == (frame, seen)
    assert motion.largest_turn == pytest.approx(np.radians(turn))
    np.testing.assert_array_equal(motion.gravity, down)


def test_they_are_told_in_the_order_of_the_contract() -> None:
    assert list(motions()) == ["planar-point", "planar", "translational", "schoenflies", "spatial"]
    with pytest.raises(BadInput, match="unknown motion 'flat'"):
        find_motion("flat")


@pytest.mark.parametrize(("coordinates", "planar"), [
    (("y", "x"), False), (("x", "rx"), False), (("x", "y", "ry", "rz"), False),
    (("x", "z"), True), (("x", "pitch"), False)])
def test_coordinates_that_nothing_could_compute_with(coordinates: tuple[str, ...],
                                                     planar: bool) -> None:
    with pytest.raises(ValueError, match="motion 'odd' has unsupported coordinates"):
        Motion("odd", coordinates, planar)


def test_what_instruments_measure_of_a_platform_that_turns_about_one_axis() -> None:
    """Frame and target may be tilted, so that all of a rotation is measured."""
    assert POSE.coordinates(SCHOENFLIES) == (0, 1, 2, 3, 4, 5)
    assert POSITION.coordinates(SCHOENFLIES) == (0, 1, 2)
    assert POSE.coordinates(PLANAR_POINT) == (0, 1)
    assert POSITION.coordinates(PLANAR_POINT) == (0, 1)


def test_effects_of_the_new_motions() -> None:
    kinds = effect_kinds()
    point, four = ([n for n, k in kinds.items() if k.exists_in(m)]
                   for m in (PLANAR_POINT, SCHOENFLIES))
    assert {"tilt", "drift", "base_shift"} <= set(point)
    assert not {"bed_shape", "payload_offset"} & set(point)
    assert "payload_offset" in four
    assert not {"tilt", "bed_shape"} & set(four)
    names = [s.name for s in kinds["drift"].parameters(SCHOENFLIES)]
    assert names == ["x", "y", "z", "rz"]
    assert [s.name for s in kinds["base_compliance"].parameters(PLANAR_POINT)] == [
        "x_fx", "x_fy", "y_fx", "y_fy"]
    assert [s.name for s in kinds["base_shift"].parameters(PLANAR_POINT)] == [
        "x", "y", "rz", "from_row"]


@pytest.fixture(scope="module")
def five_bar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the machine, a scenario, and what it measured."""
    folder = tmp_path_factory.mktemp("five-bar")
    (folder / "m.yaml").write_text(FIVE_BAR)
    (folder / "s.yaml").write_text(SCENARIO)
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=folder, expect=0)
    return folder


def test_a_five_bar_is_checked(five_bar: Path) -> None:
    found = ppmcal("check", "m.yaml", "--json", cwd=five_bar, expect=0).json
    assert (found["rank"], found["columns"]) == (6, 6)


@pytest.mark.slow
def test_a_five_bars_kinematics_go_both_ways(five_bar: Path) -> None:
    for method in ("newton", "intersection"):
        pick(five_bar / "s" / "measurements.csv", ["x", "y"], five_bar / "at.csv")
        ppmcal("kinematics", "inverse", "m.yaml", "at.csv", "--out", "q", "--force", cwd=five_bar,
               expect=0)
        ppmcal("kinematics", "forward", "m.yaml", "q/kinematics.csv", "--method", method, "--out",
               "x", "--force", cwd=five_bar, expect=0)
        for wanted, row in zip(rows(five_bar / "at.csv"), rows(five_bar / "x" / "kinematics.csv"),
                               strict=True):
            assert row["status"] == "ok"
            for c in "xy":
                assert number(row, c) == pytest.approx(number(wanted, c), abs=1e-9)


@pytest.mark.slow
def test_a_five_bar_is_identified_and_compensated(five_bar: Path) -> None:
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=five_bar, expect=0)
    truth = {"left.proximal": 0.2, "right.distal": -0.3, "left.offset": 0.3}
    for row in rows(five_bar / "i" / "parameters.csv"):
        assert number(row, "error") == pytest.approx(truth.get(row["name"], 0.0), abs=1e-3)
    (five_bar / "wanted.csv").write_text("x,y\n10,150\n-25,180\n")
    ppmcal("compensate", "i/identified.yaml", "wanted.csv", "--frame", "base", "--out", "c",
           cwd=five_bar, expect=0)
    # the real machine, at these commands, is where it was wanted
    tree = FIVE_BAR.replace("free:", "effects: []\nfree:").replace(
        "base: {point: [-40, 0]}, platform: {point: [0, 0]}, proximal: 100",
        "base: {point: [-40, 0]}, platform: {point: [0, 0]}, offset: 0.3, proximal: 100.2").replace(
        "elbow: 1}", "elbow: 1}").replace("distal: 140, elbow: 1}", "distal: 139.7, elbow: 1}")
    (five_bar / "real.yaml").write_text(tree.replace("\n     distal", " distal"))
    ppmcal("kinematics", "forward", "real.yaml", "c/commands.csv", "--out", "r", cwd=five_bar,
           expect=None)
    for row, (x, y) in zip(rows(five_bar / "r" / "kinematics.csv"), ((10, 150), (-25, 180)),
                           strict=True):
        assert (number(row, "x"), number(row, "y")) == pytest.approx((x, y), abs=1e-3)


@pytest.mark.slow
def test_a_five_bars_assembly_modes_are_the_two_points_of_two_circles(five_bar: Path) -> None:
    ppmcal("workspace", "m.yaml", "--out", "w", cwd=five_bar, expect=None)
    modes = rows(five_bar / "w" / "modes.csv")
    assert len(modes) == 2
    assert number(modes[0], "y") == pytest.approx(170.0)
    assert number(modes[0], "x") == pytest.approx(number(modes[1], "x"), abs=1e-9)


def test_a_five_bars_frame_is_in_the_plane(five_bar: Path) -> None:
    machine = read_mechanism(five_bar / "m.yaml")
    data = read_dataset(five_bar / "s" / "measurements.csv", machine)
    assert frame_parts(data, machine.motion) == (0, 1, 5)
    assert target_parts(data, machine.motion) == (0, 1)
    _, names = lay_out(machine, (data,), (), None)
    assert [n.split(" of ")[0] for n in names if n.startswith("frame")] == [
        "frame.x", "frame.y", "frame.rz"]


def test_a_file_of_another_motion_says_which_there_are(tmp_path: Path) -> None:
    for old, new, told in (
            ("motion: planar-point", "motion: spatial",
             "(R)RR is a kind for planar-point or planar motion, but the motion is spatial"),
            ("motion: planar-point", "motion: planar",
             "the limbs put 2 conditions on the platform, but a pose in planar motion has 3"),
            ("motion: planar-point", "motion: planar-dot", "Did you mean 'planar-point'?")):
        (tmp_path / "m.yaml").write_text(FIVE_BAR.replace(old, new))
        assert told in " ".join(ppmcal("check", "m.yaml", cwd=tmp_path, expect=2).err.split())


SLIDER_CRANK = FIVE_BAR.replace("planar-point", "along-a-rail").replace(
    FIVE_BAR[FIVE_BAR.index("  - {name: right"):FIVE_BAR.index("home:")], "").replace(
    "{x: 0, y: 170}", "{x: 150}")


@pytest.mark.long
def test_a_motion_of_another_package(tmp_path: Path) -> None:
    """A crank that drives a carriage along x: one coordinate, one limb."""
    site = install(tmp_path / "site", "workshop_rail", (
        "from ppmcal.model.motions import Motion\n"
        "RAIL = Motion('along-a-rail', ('x',), planar=True)\n"),
        {"ppmcal.motions": {"rail": "RAIL"}})
    (tmp_path / "m.yaml").write_text(SLIDER_CRANK)
    (tmp_path / "at.csv").write_text("x\n140\n155\n170\n")
    assert "unknown motion 'along-a-rail'" in " ".join(
        ppmcal("check", "m.yaml", cwd=tmp_path, expect=2).err.split())
    assert environment(site)
    for line in (("check", "m.yaml"), ("kinematics", "inverse", "m.yaml", "at.csv", "--out", "q"),
                 ("kinematics", "forward", "m.yaml", "q/kinematics.csv", "--out", "x")):
        ppmcal_process(*line, cwd=tmp_path, site=site, expect=0, timeout=120)
    found = [number(r, "x") for r in rows(tmp_path / "x" / "kinematics.csv")]
    assert found == pytest.approx([140.0, 155.0, 170.0], abs=1e-9)


@pytest.mark.long
def test_no_other_module_names_a_motion() -> None:
    """No text of the package outside of the declarations is the name of one."""
    root = Path(package.__file__).parent
    senses = {("io/results/stiffness.py", "translational"),     # of the compliance, its block
              ("controllers/mjcf/writer.py", "spatial")}          # a tendon through space
    found = {(path.relative_to(root).as_posix(), node.value) for path in root.rglob("*.py")
             for node in nodes_of(path)
             if isinstance(node, ast.Constant) and node.value in motions()}
    assert {f for f in found if f[0] != "model/motions.py"} <= senses
