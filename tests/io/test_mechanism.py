"""What a mechanism file means: units, defaults, sharing, points, directions, extends."""


import numpy as np
import pytest
from helpers import broken
from helpers.broken import GOOD

from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism, write_mechanism

DEG = np.pi / 180.0


def edited(tmp_path, good, *edits):
    """Read a good file with the first of each (old, new) replaced."""
    return read_mechanism(broken.edited(tmp_path, f"good_{good}.yaml", *edits))


def named(mechanism, name):
    return mechanism.parameters[mechanism.names.index(name)]


def test_units_and_order():
    m = read_mechanism(GOOD / "good_bench.yaml")
    assert m.names[:6] == ("leg1.base.point.x", "leg1.base.point.y", "leg1.lateral",
                           "leg1.platform.point.x", "leg1.platform.point.y", "leg1.offset")
    assert m.names[6] == "leg2.base.point.x"
    assert named(m, "leg2.base.point.x").value == 1.0
    assert named(m, "leg2.base.point.x").tolerance == 0.5e-3
    assert named(m, "leg2.offset").tolerance == pytest.approx(0.4e-3)
    np.testing.assert_allclose(m.home_pose, [0.5, 0.26, 0, 0, 0, 25 * DEG])
    np.testing.assert_array_equal(m.home_q, [0.4, np.nan, np.nan])
    np.testing.assert_allclose(m.limits[0], [0.2, 0.9])
    assert np.isinf(m.limits[1:]).all()
    assert m.limbs[0].kind.name == "R(P)R"
    assert (m.limbs[0].branch, m.limbs[1].branch) == (None, 1)
    assert m.digits == {"length": 0.5e-6, "angle": 0.5 * DEG}


def test_lateral_is_fixed_until_given(tmp_path):
    m = read_mechanism(GOOD / "good_bench.yaml")
    lateral = named(m, "leg1.lateral")
    assert (lateral.value, lateral.fixed, lateral.tolerance) == (0.0, True, None)
    m = edited(tmp_path, "bench", ("    branch: 1", "    lateral: 0"))
    assert not named(m, "leg2.lateral").fixed
    assert named(m, "leg2.lateral").tolerance == pytest.approx(0.3e-3)


def test_ratio_makes_q_bare(tmp_path):
    m = edited(tmp_path, "rails", ("ratio: 71.2", "ratio: 71.2, offset: 5"),
               ("quat_w: 1}", "quat_w: 1}\n  q: {leg1: 12, leg2: 880}"))
    ratio = named(m, "leg1.ratio")
    assert ratio.value == pytest.approx(71.2e-3)
    assert ratio.per_unit and ratio.fixed and ratio.tolerance is None
    assert named(m, "leg1.offset").value == 5e-3
    assert "leg2.ratio" not in m.names
    np.testing.assert_allclose(m.home_q[:2], [12.0, 0.88])
    assert m.actuator_has_ratio == (True, False, False, False, False, False)


def test_a_ratio_with_a_tolerance_is_free(tmp_path):
    m = edited(tmp_path, "rails", ("ratio: 71.2", "ratio: {value: 71.2, tolerance: 0.1}"))
    ratio = named(m, "leg1.ratio")
    assert not ratio.fixed
    assert ratio.tolerance == pytest.approx(1e-4)
    assert m.names.index("leg1.ratio") in m.free


def test_slot_forms(tmp_path):
    m = edited(tmp_path, "bench", (
        "point: [0, 0]", "point: {x: {value: 1, tolerance: .inf}, y: {value: 2, fixed: true}}"),
        ("point: [1000, 0]", "point: [{value: 3, nominal: 2.5, sigma: 0.1}, "
                             "{value: 4, tolerance: 0}]"))
    assert named(m, "leg1.base.point.x").tolerance == np.inf
    assert named(m, "leg1.base.point.y").fixed
    assert named(m, "leg2.base.point.x").nominal == 2.5e-3
    assert named(m, "leg2.base.point.x").sigma == pytest.approx(1e-4)
    assert named(m, "leg2.base.point.y").fixed
    free = {m.names[i] for i in m.free}
    assert "leg1.base.point.x" in free
    assert not {"leg1.base.point.y", "leg2.base.point.y", "leg1.lateral"} & free


def test_a_whole_point_takes_the_keys_of_a_slot(tmp_path):
    m = edited(tmp_path, "bench", ("point: [0, 0]",
                                   "point: {value: [1, 2], tolerance: [0.1, 0.2], share: A}"),
               ("point: [1000, 0]", "point: {share: A}"))
    assert named(m, "A.x").value == 1e-3
    assert named(m, "A.y").tolerance == pytest.approx(2e-4)
    assert named(m, "A.y").aliases == ("leg1.base.point.y", "leg2.base.point.y")


def test_polar_points_and_sharing(tmp_path):
    m = edited(
        tmp_path, "bench",
        ("point: [-120, -69.282]", "point: {radius: {value: 138.564, share: b}, angle: 210}"),
        ("point: [120, -69.282]", "point: {radius: {share: b}, angle: -30}"),
        ("point: [0, 138.564]", "point: {radius: {share: b}, angle: {value: 90, fixed: true}}"),
        ("effects: []", 'free: ["*.base.point.?", "*.offset", "*.platform.point.radius", '
                        '"*.joint1.rz"]'))
    b = named(m, "b")
    assert b.aliases == tuple(f"leg{i}.platform.point.radius" for i in (1, 2, 3))
    assert b.tolerance == 0.5e-3
    assert named(m, "leg1.platform.point.angle").tolerance == pytest.approx(0.1 * DEG)
    assert m.names.count("b") == 1
    values = m.limbs[0].slots.values(m.values)
    assert values["platform.point.x"] == pytest.approx(-0.12, abs=1e-6)
    assert values["platform.point.y"] == pytest.approx(-0.069282, abs=1e-6)
    assert len(m.free) == 6 + 3 + 1 + 3
    assert "leg2.joint1.rz" in m.names
    assert "leg2.joint2.rz" not in m.names


def test_joint_frames_given_or_named(tmp_path):
    m = edited(tmp_path, "rails", ("ratio: 71.2", "joint2: {rz: 0.1, x: 2}"))
    rz = named(m, "leg1.joint2.rz")
    assert (rz.value, rz.nominal) == (pytest.approx(0.1 * DEG), 0.0)
    assert named(m, "leg1.joint2.x").tolerance == pytest.approx(0.3e-3)
    assert m.names.index("leg1.joint2.x") not in m.free
    m = edited(tmp_path, "rails", ("tolerances:", 'free: ["*.joint?.*"]\ntolerances:'))
    assert len(m.free) == 6 * 18


def test_missing_tolerances_warn(tmp_path):
    m = edited(tmp_path, "bench", ("{point: 0.5, length: 0.3, angle: 0.1, offset: 0.4}",
                                   "{offset: 0.4}"))
    assert len(m.findings) == 1
    assert "'point'; 1 mm" in m.findings[0]
    assert named(m, "leg1.base.point.x").tolerance == pytest.approx(m.reach / 1000)
    assert m.reach == pytest.approx(1.0, rel=1e-6)
    m = edited(tmp_path, "crank",
               ("tolerances: {point: 0.3, length: 0.2, angle: 0.05, offset: 0.1}", ""))
    assert len(m.findings) == 4
    assert named(m, "arm1.base.axis.rx").tolerance == 1e-3
    assert named(m, "arm1.offset").tolerance == 1e-3


def test_zero_is_made_square(tmp_path):
    m = edited(tmp_path, "crank", ("zero: [1, 0, 0]", "zero: [2, 0.002, 0]"))
    constants = m.limbs[0].constants
    assert constants["base.zero"] @ constants["base.axis"] == 0.0
    assert np.linalg.norm(constants["base.zero"]) == pytest.approx(1.0, abs=1e-15)


def test_a_shared_direction(tmp_path):
    m = edited(tmp_path, "rails", (
        "base: {point: [25, 886, 0], direction: [0, 0, 1]}",
        "base: {point: [25, 886, 0], direction: {value: [0, 0, 2], share: tower}}"), (
        "base: {point: [-25, 886, 0], direction: [0, 0, 1]}",
        "base: {point: [-25, 886, 0], direction: {share: tower}}"))
    assert named(m, "tower.rx").aliases == ("leg1.base.direction.rx", "leg4.base.direction.rx")
    np.testing.assert_array_equal(m.limbs[3].constants["base.direction"], [0, 0, 1])


def test_free_of_fixed_only_warns(tmp_path):
    m = edited(tmp_path, "bench", ("effects: []", 'free: ["*.lateral", "*.offset"]'))
    assert len(m.free) == 3
    assert "only fixed" in m.findings[0]


def test_free_may_be_empty(tmp_path):
    assert edited(tmp_path, "bench", ("effects: []", "free: []")).free == ()


def test_shared_actuator(tmp_path):
    m = edited(tmp_path, "bench", ("    branch: 1", "    actuator: leg1"))
    assert m.actuators == ("leg1", "leg3")
    assert [limb.actuator for limb in m.limbs] == [0, 0, 1]


def test_yaml_as_people_write_it(tmp_path):
    m = edited(tmp_path, "bench", ("point: [0, 0]", "point: [1e1, 010]"),
               ("name: 3-RPR bench", "name: on"))
    assert named(m, "leg1.base.point.x").value == 0.01
    assert named(m, "leg1.base.point.y").value == 0.01
    assert m.name == "on"


def test_extends_merges(tmp_path):
    (tmp_path / "base.yaml").write_text((GOOD / "good_bench.yaml").read_text())
    child = tmp_path / "child.yaml"
    child.write_text("""extends: base.yaml
name: ours
limbs:
  - {name: leg2, base: {point: [1001, 0]}, offset: {value: 3}}
tolerances: {point: 0.7}
""")
    m = read_mechanism(child)
    assert m.name == "ours"
    assert [limb.name for limb in m.limbs] == ["leg1", "leg2", "leg3"]
    assert named(m, "leg2.base.point.x").value == pytest.approx(1.001)
    assert named(m, "leg2.platform.point.x").value == pytest.approx(0.12)
    assert named(m, "leg1.base.point.x").tolerance == pytest.approx(0.7e-3)
    assert named(m, "leg1.offset").tolerance == pytest.approx(0.4e-3)


def test_extends_adds_a_tolerance_to_a_number(tmp_path):
    (tmp_path / "base.yaml").write_text((GOOD / "good_rails.yaml").read_text())
    child = tmp_path / "child.yaml"
    child.write_text("extends: base.yaml\nlimbs: [{name: leg1, length: {tolerance: 2}}]\n")
    length = named(read_mechanism(child), "leg1.length")
    assert (length.value, length.tolerance) == (1.25, pytest.approx(2e-3))


def test_extends_refuses_other_units(tmp_path):
    (tmp_path / "base.yaml").write_text((GOOD / "good_bench.yaml").read_text())
    child = tmp_path / "child.yaml"
    child.write_text("extends: base.yaml\nunits: {length: m, angle: deg}\n")
    with pytest.raises(BadInput, match=r"child\.yaml: units: .*same units"):
        read_mechanism(child)


@pytest.mark.parametrize("name", ["../base.yaml", "deep/../../base.yaml", "{}/base.yaml", ".."])
def test_extends_stays_in_the_folder(tmp_path, name):
    """A file that came from somebody else reads nothing elsewhere; a link of one's own does."""
    (tmp_path / "mine" / "deep").mkdir(parents=True)
    (tmp_path / "base.yaml").write_text((GOOD / "good_bench.yaml").read_text())
    child = tmp_path / "mine" / "child.yaml"
    child.write_text(f"extends: {name.format(tmp_path)}\n")
    with pytest.raises(BadInput, match="leads out of the folder") as caught:
        read_mechanism(child)
    assert "child.yaml: extends" in caught.value.where and "link" in caught.value.hint
    (tmp_path / "mine" / "base.yaml").symlink_to(tmp_path / "base.yaml")
    child.write_text("extends: deep/../base.yaml\n")
    assert read_mechanism(child).names == read_mechanism(GOOD / "good_bench.yaml").names


def test_extends_in_a_circle(tmp_path):
    (tmp_path / "a.yaml").write_text("extends: b.yaml\n")
    (tmp_path / "b.yaml").write_text("extends: a.yaml\n")
    with pytest.raises(BadInput, match="circle"):
        read_mechanism(tmp_path / "a.yaml")


def test_registrations(tmp_path):
    m = edited(tmp_path, "bench", ("effects: []", """measurement:
  datasets:
    run3: {frame: {x: 1, y: 2, rz: 90}, target: [3, 4], target_rotation: [0, 0, 180]}"""))
    r = m.registrations["run3"]
    np.testing.assert_allclose(r.frame_pose, [1e-3, 2e-3, 0, 0, 0, np.pi / 2])
    np.testing.assert_allclose(r.target, [3e-3, 4e-3, 0])
    np.testing.assert_allclose(r.target_rotation, [0, 0, np.pi])


def test_a_moved_direction_keeps_its_drawing(tmp_path):
    m = read_mechanism(GOOD / "good_crank.yaml")
    g = m.values.copy()
    turn = [m.names.index(f"arm1.base.axis.{c}") for c in ("rx", "ry", "rz")]
    g[turn] = [0.01, -0.02, 0.03]
    path = tmp_path / "out.yaml"
    path.write_text(write_mechanism(m.with_values(g)))
    back = read_mechanism(path)
    from ppmcal.io.directions import rotation

    now, old = back.limbs[0].constants, m.limbs[0].constants
    moved = rotation(g[turn])
    n = rotation(back.nominals[turn])
    for name in ("base.axis", "base.zero"):
        np.testing.assert_allclose(now[name], moved @ old[name], atol=1e-15)
        np.testing.assert_allclose(n @ now[name], old[name], atol=1e-15)
    np.testing.assert_array_equal(back.values[turn], 0.0)


def test_joint_frames_keep_a_direction_apart(tmp_path):
    m = edited(tmp_path, "rails", ("tolerances:", 'free: ["leg1.*"]\ntolerances:'))
    g = m.values.copy()
    g[m.names.index("leg1.base.direction.rx")] = 0.01
    path = tmp_path / "out.yaml"
    path.write_text(write_mechanism(m.with_values(g)))
    back = read_mechanism(path)
    np.testing.assert_array_equal(back.limbs[0].constants["base.direction"], [0, 0, 1])
    np.testing.assert_allclose(back.values, g, rtol=3e-16)
    np.testing.assert_array_equal(back.nominals, m.nominals)


def test_joints_do_not_share_a_column_of_commands(tmp_path):
    with pytest.raises(BadInput, match="column in which commands"):
        edited(tmp_path, "bench", ("name: leg2", "name: leg1_nominal"))


@pytest.mark.slow
def test_importing_needs_no_scipy():
    import subprocess
    import sys

    code = ("import sys, ppmcal.io.mechanism_reader, ppmcal.io.dataset_reader, "
            "ppmcal.io.scenario, ppmcal.store.output, "
            "ppmcal.calibration.interpretation.plausibility; "
            "sys.exit('scipy' in sys.modules)")
    assert subprocess.run([sys.executable, "-c", code], cwd=GOOD.parents[1],
                          check=False).returncode == 0
