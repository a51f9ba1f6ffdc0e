"""What a scenario file means."""


import numpy as np
import pytest
from helpers.paths import ROOT

from ppmcal.io import read_mechanism, read_scenario
from ppmcal.simulation.scenario import Circle, GridPattern, Helix, Listed, Random

GOOD = ROOT / "tests" / "broken"
BENCH = read_mechanism(GOOD / "good_bench.yaml")
CRANK = read_mechanism(GOOD / "good_crank.yaml")
DEG = np.pi / 180.0
CIRCLE = ("{circle: {center: {x: 500, y: 290, rz: 10}, radius: 80, count: 30, "
          "swing: {rz: 5}}}")


def scenario(tmp_path, mechanism, *edits):
    text = (GOOD / "good_scenario.yaml").read_text()
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "s.yaml").write_text(text)
    return read_scenario(tmp_path / "s.yaml", mechanism)


def test_the_good_one():
    s = read_scenario(GOOD / "good_scenario.yaml", BENCH)
    assert isinstance(s.poses, Circle)
    np.testing.assert_allclose(s.poses.center, [0.5, 0.29, 0, 0, 0, 10 * DEG])
    np.testing.assert_allclose(s.poses.swing, [0, 0, 0, 0, 0, 5 * DEG])
    assert (s.poses.radius, s.poses.count) == (0.08, 30)
    assert s.errors == {"leg1.base.point.x": 0.5e-3, "leg2.offset": pytest.approx(-0.3e-3)}
    assert s.error_scale is None
    assert s.sigma_position == pytest.approx(5e-6)
    np.testing.assert_allclose(s.frame, [5e-3, -3e-3, 0, 0, 0, DEG])
    np.testing.assert_allclose(s.target, [1e-3, 2e-3, 0])
    assert not s.frame_known and not s.target_known and s.target_rotation_known
    assert (s.ar, s.outliers, s.tails, s.repeats, s.approach) == (0, 0, "normal", 1, "both")
    assert s.payload == (0.0, 20.0)
    assert s.temperature == (293.15, 4.0)
    assert s.seed == 7


def test_other_poses(tmp_path):
    s = scenario(tmp_path, BENCH, (CIRCLE, "{grid: {center: {x: 5, y: 2, rz: 1}, "
                                   "half_range: {x: 50}, counts: {x: 3, rz: 2}}}"))
    assert isinstance(s.poses, GridPattern)
    np.testing.assert_array_equal(s.poses.counts, [3, 1, 1, 1, 1, 2])
    np.testing.assert_allclose(s.poses.half_range, [0.05, 0, 0, 0, 0, 0])
    s = scenario(tmp_path, BENCH, (CIRCLE, "{random: {center: {x: 5, y: 2, rz: 1}, "
                                   "half_range: {x: 50}, count: 9}}"))
    assert isinstance(s.poses, Random)
    (tmp_path / "poses.csv").write_text("x,y,rz\n1,2,3\n")
    s = scenario(tmp_path, BENCH, (CIRCLE, "{file: poses.csv}"))
    assert isinstance(s.poses, Listed)
    np.testing.assert_allclose(s.poses.poses, [[1e-3, 2e-3, 0, 0, 0, 3 * DEG]])


def test_helix_and_random_errors(tmp_path):
    s = scenario(
        tmp_path, CRANK,
        (CIRCLE, "{helix: {center: {x: 0, y: 0, z: -300}, diameter: 50, pitch: 10, turns: 2, "
                 "count: 20}}"),
        ("errors: {leg1.base.point.x: 0.5, leg2.offset: -0.3}", "errors: {random: {scale: 2}}"),
        ("frame: {x: 5, y: -3, rz: 1}\n", ""), ("target: [1, 2]\n", ""),
        ("temperature: {mean: 20, swing: 4}", "temperature: 25"))
    assert isinstance(s.poses, Helix)
    assert (s.poses.diameter, s.poses.pitch, s.poses.turns) == (0.05, 0.01, 2.0)
    assert s.error_scale == 2.0
    assert s.frame_known and s.target_known
    assert s.temperature == (298.15, 0.0)


def test_fewer_actuators_leave_coordinates_open(tmp_path):
    limbs = []
    for i, (x, y) in enumerate(((1, 0), (-0.5, 0.8660254), (-0.5, -0.8660254))):
        limbs.append(f"  - {{name: l{i}, kind: R(P)S, base: {{point: [{300 * x}, {300 * y}, 0], "
                     f"axis: [{-y}, {x}, 0]}}, platform: {{point: [{200 * x}, {200 * y}, 0]}}}}")
    (tmp_path / "m.yaml").write_text(
        "format: ppmcal/mechanism/1\nunits: {length: mm, angle: deg}\nmotion: spatial\nlimbs:\n"
        + "\n".join(limbs) + "\nhome: {pose: {x: 0, y: 0, z: 400, rx: 0, ry: 0, rz: 0}}\n")
    m = read_mechanism(tmp_path / "m.yaml")
    assert len(m.actuators) == 3
    s = scenario(
        tmp_path, m, (CIRCLE, "{random: {center: {z: 400, rx: 0, ry: 1}, half_range: {rx: 5}, "
                              "count: 5}}"),
        ("{leg1.base.point.x: 0.5, leg2.offset: -0.3}", "{}"),
        ("frame: {x: 5, y: -3, rz: 1}", "frame: known"), ("target: [1, 2]", "target: known"))
    np.testing.assert_allclose(s.poses.center, [np.nan, np.nan, 0.4, 0, DEG, np.nan])
