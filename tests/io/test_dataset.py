"""What measurement files mean: columns, units, repeats, noise, foreign headers, speed."""

import time

import numpy as np
import pytest
from helpers.paths import ROOT

from ppmcal.calibration.interpretation import unit_findings
from ppmcal.errors import BadInput
from ppmcal.io import (
    csv_text,
    read_campaign,
    read_dataset,
    read_joints,
    read_mechanism,
    read_poses,
    twists,
)
from ppmcal.io.sidecar import sidecar_path

GOOD = ROOT / "tests" / "broken"
BENCH = read_mechanism(GOOD / "good_bench.yaml")
RAILS = read_mechanism(GOOD / "good_rails.yaml")
CRANK = read_mechanism(GOOD / "good_crank.yaml")
DEG = np.pi / 180.0
SIDE = (GOOD / "good_run.yaml").read_text()
SHARED = ROOT.parent / "shared" / "data"


def dataset(tmp_path, text, mechanism=BENCH, *edits, side=SIDE):
    for old, new in edits:
        assert old in side
        side = side.replace(old, new)
    (tmp_path / "run.yaml").write_text(side)
    path = tmp_path / "run.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_dataset(path, mechanism)


def test_the_good_one():
    d = read_dataset(GOOD / "good_run.csv", BENCH)
    assert (d.name, d.kind.name, d.approach, d.homing) == ("run 3", "pose", "columns", "shared")
    np.testing.assert_array_equal(d.rows, [1, 2, 3, 4])
    np.testing.assert_array_equal(d.groups, [0, 0, 1, 2])
    np.testing.assert_allclose(d.q[0], [0.4501, 0.4602, 0.4703])
    np.testing.assert_allclose(d.position[0, :2], [0.5001, 0.2602])
    assert np.isnan(d.position[:, 2]).all() and np.isnan(d.rotation[:, :2]).all()
    np.testing.assert_allclose(d.rotation[:, 2], np.array([25.3, 25.2, 24.5, np.nan]) * DEG)
    np.testing.assert_allclose(d.sigma_position, 1e-5)
    np.testing.assert_allclose(d.sigma_rotation, 0.002 * DEG)
    np.testing.assert_allclose(d.sigma_actuator, 3e-6)
    np.testing.assert_allclose(d.columns["temperature"], [293.15, 293.65, np.nan, 294.15])
    np.testing.assert_array_equal(d.columns["dir_leg1"], [1, -1, 1, 1])
    assert d.sessions == ("monday", "monday", "tuesday", "tuesday")
    assert d.frame.fitted and d.target.fitted and not d.target_rotation.fitted
    assert d.findings == ()


@pytest.mark.parametrize("change", [
    lambda t: t.replace("\n", "\r\n"), lambda t: "\ufeff" + t, lambda t: t.replace("\n", "\r"),
    lambda t: t + "\n\n", lambda t: t.rstrip("\n"), lambda t: t.replace(",", " , "),
    lambda t: t.replace("tuesday\n", "tuesday\n\n"), lambda t: t.replace("20.5", '"20.5"')])
def test_harmless_differences(tmp_path, change):
    want = read_dataset(GOOD / "good_run.csv", BENCH)
    got = dataset(tmp_path, change((GOOD / "good_run.csv").read_text()))
    np.testing.assert_array_equal(got.q, want.q)
    np.testing.assert_array_equal(got.rotation, want.rotation)
    assert got.sessions == want.sessions


def test_rows_that_cannot_be_used(tmp_path):
    d = dataset(tmp_path, "q_leg1,q_leg2,q_leg3,x,y,rz\n1,2,3,4,5,6\n1,,3,4,5,6\n9,2,3,,,\n"
                          "7,2,3,,5,6\n")
    np.testing.assert_array_equal(d.rows, [1, 4])
    np.testing.assert_array_equal(d.groups, [0, 3])
    assert d.dropped == ((2, "a joint value is missing"), (3, "nothing was measured"))
    assert "row 2" in d.findings[-3] and "row 3" in d.findings[-2]
    assert "row 4: x is empty" in d.findings[-1]
    assert d.approach == "unknown"
    assert d.sessions is None


def test_one_row_is_fine(tmp_path):
    assert len(dataset(tmp_path, "q_leg1,q_leg2,q_leg3,x,y,rz\n1,2,3,4,5,6")) == 1


def test_pose_labels(tmp_path):
    d = dataset(tmp_path, "pose,q_leg1,q_leg2,q_leg3,x,y,rz\n"
                          "b,1,2,3,4,5,6\na,7,2,3,4,5,6\nb,1,2,3,4,5,6\n,8,2,3,4,5,6\n")
    np.testing.assert_array_equal(d.groups, [0, 1, 0, 2])
    d = dataset(tmp_path, "pose,q_leg1,q_leg2,q_leg3,x,y,rz\n"
                          "b,1,2,3,4,5,6\nnan,7,2,3,4,5,6\nNaN,8,2,3,4,5,6\nnan,9,2,3,4,5,6\n")
    np.testing.assert_array_equal(d.groups, [0, 1, 2, 3])
    d = dataset(tmp_path, "pose,q_leg1,q_leg2,q_leg3,x,y,rz\n"
                          "7,1,2,3,4,5,6\n2,7,2,3,4,5,6\n7,1,2,3,4,5,6\n,8,2,3,4,5,6\n")
    np.testing.assert_array_equal(d.groups, [0, 1, 0, 2])


@pytest.mark.parametrize(("cells", "labels"), [
    (("0.1", "7", "nan", ""), ("0.1", "7", "", "")), (("am", "nan", "", "1"), ("am", "", "", "1"))])
def test_session_labels(tmp_path, cells, labels):
    rows = "".join(f"1,2,3,4,5,6,{c}\n" for c in cells)
    d = dataset(tmp_path, "q_leg1,q_leg2,q_leg3,x,y,rz,session\n" + rows)
    assert d.sessions == labels


def test_row_sigmas_override(tmp_path):
    d = dataset(tmp_path, "q_leg1,q_leg2,q_leg3,x,y,rz,sigma_x,sigma_rz\n"
                          "1,2,3,4,5,6,0.5,\n1,2,3,4,5,6,,0.25\n")
    np.testing.assert_allclose(d.sigma_position[:, :2], [[5e-4, 1e-5], [1e-5, 1e-5]])
    np.testing.assert_allclose(d.sigma_rotation[:, 2], np.array([0.002, 0.25]) * DEG)
    with pytest.raises(BadInput, match="row 1, column sigma_x"):
        dataset(tmp_path, "q_leg1,q_leg2,q_leg3,x,y,rz,sigma_x\n1,2,3,4,5,6,0\n")


def test_commanded_poses(tmp_path):
    d = dataset(tmp_path, "cmd_x,cmd_y,cmd_rz,x,y,rz\n1,2,3,4,5,6\n")
    assert d.commanded is not None
    np.testing.assert_allclose(d.commanded[0, [0, 1, 5]], [1e-3, 2e-3, 3 * DEG])
    assert np.isnan(d.q).all()
    with pytest.raises(BadInput, match="cmd_rz"):
        dataset(tmp_path, "cmd_x,cmd_y,x,y,rz\n1,2,4,5,6\n")


def test_commanded_coordinates_that_the_machine_does_not_have(tmp_path):
    """A cmd_z of a planar machine once lengthened its struts without a word."""
    with pytest.raises(BadInput, match="row 2, column cmd_z: a planar machine has no"):
        dataset(tmp_path, "cmd_x,cmd_y,cmd_z,cmd_rz,x,y,rz\n1,2,0,3,4,5,6\n1,2,7,3,4,5,6\n")
    with pytest.raises(BadInput, match="row 1, column cmd_quat_x: a planar machine has no"):
        dataset(tmp_path, "cmd_x,cmd_y,cmd_quat_x,cmd_quat_y,cmd_quat_z,cmd_quat_w,x,y,rz\n"
                          "1,2,1,0,0,0,4,5,6\n")
    d = dataset(tmp_path, "cmd_x,cmd_y,cmd_z,cmd_rz,x,y,rz\n1,2,0,3,4,5,6\n1,2,,3,4,5,6\n")
    assert d.commanded is not None
    np.testing.assert_array_equal(d.commanded[:, 2:5], 0.0)


def test_rows_whose_commanded_pose_is_incomplete(tmp_path):
    d = dataset(tmp_path, "cmd_x,cmd_y,cmd_rz,x,y,rz\n1,2,3,4,5,6\n1,,3,4,5,6\n9,2,3,,,\n")
    assert d.dropped == ((2, "a commanded coordinate is missing"), (3, "nothing was measured"))
    assert d.rows.tolist() == [1]
    with pytest.raises(BadInput, match="a commanded pose and a measurement"):
        dataset(tmp_path, "cmd_x,cmd_y,cmd_rz,x,y,rz\n1,2,,4,5,6\n1,,3,4,5,6\n,2,3,4,5,6\n")


def test_columns_of_another_instrument_are_named(tmp_path):
    d = dataset(tmp_path, "q_leg1,q_leg2,q_leg3,x,y,rz,height,to_q_leg1\n1,2,3,4,5,6,7,8\n")
    assert any("columns height, to_q_leg1: not used" in f for f in d.findings)


def test_position_instrument_ignores_rotation(tmp_path):
    d = dataset(tmp_path, (GOOD / "good_run.csv").read_text(), BENCH,
                ("kind: pose", "kind: position"))
    assert np.isnan(d.rotation).all()
    assert "rz" in d.findings[0]


def test_quaternions(tmp_path):
    q = "q_leg1,q_leg2,q_leg3,q_leg4,q_leg5,q_leg6"
    d = dataset(tmp_path, f"{q},x,y,z,quat_x,quat_y,quat_z,quat_w\n"
                          "1,2,3,4,5,6,7,8,9,0,0,0.70710678,0.70710678\n"
                          "1,2,3,4,5,6,7,8,9,0,0,0,-1\n1,2,3,4,5,6,7,8,9,,,,\n", RAILS)
    np.testing.assert_allclose(d.rotation[0], [0, 0, np.pi / 2], atol=1e-9)
    np.testing.assert_allclose(d.rotation[1], 0)
    assert np.isnan(d.rotation[2]).all() and len(d) == 3
    np.testing.assert_allclose(d.q[0, :2], [1.0, 2e-3])  # leg1 has a ratio: bare revolutions
    with pytest.raises(BadInput, match=r"rows 1, 2, 3, 4, 5 \(\+1 more\)"):
        dataset(tmp_path, f"{q},x,y,z,quat_x,quat_y,quat_z,quat_w\n"
                + "1,2,3,4,5,6,7,8,9,0,0,0,0.9\n" * 6, RAILS)


def test_translational_pose_without_rotation(tmp_path):
    side = SIDE.replace(", rotation: 0.002, actuator: 0.003", "")
    d = dataset(tmp_path, "q_arm1,q_arm2,q_arm3,x,y,z\n90,2,3,4,5,6\n", CRANK, side=side)
    assert np.isnan(d.rotation).all()
    np.testing.assert_allclose(d.q[0, 0], np.pi / 2)
    np.testing.assert_allclose(d.position[0], [4e-3, 5e-3, 6e-3])


def test_heights_and_distances(tmp_path):
    d = dataset(tmp_path, "q_arm1,q_arm2,q_arm3,height\n1,2,3,0.5\n", CRANK,
                ("kind: pose", "kind: plane"), ("rotation: 0.002, ", ""))
    np.testing.assert_allclose((d.value[0], d.sigma_value[0]), (5e-4, 1e-5))
    text = "q_arm1,q_arm2,q_arm3,to_q_arm1,to_q_arm2,to_q_arm3,distance\n1,2,3,4,5,6,70\n"
    d = dataset(tmp_path, text, CRANK, ("kind: pose", "kind: distance"))
    assert d.to_q is not None
    np.testing.assert_allclose(d.to_q[0], np.array([4, 5, 6]) * DEG)
    assert d.extra["point"] is None
    with pytest.raises(BadInput, match=r"instrument\.point"):
        dataset(tmp_path, "q_arm1,q_arm2,q_arm3,distance\n1,2,3,70\n", CRANK,
                ("kind: pose", "kind: distance"))
    d = dataset(tmp_path, "q_arm1,q_arm2,q_arm3,distance\n1,2,3,70\n", CRANK,
                ("{kind: pose", "{point: [1, 2, 3], kind: distance"))
    np.testing.assert_allclose(d.extra["point"].value, [1e-3, 2e-3, 3e-3])


def test_distances_between_two_platform_positions_need_no_frame(tmp_path):
    side = [("kind: pose", "kind: distance"), ("frame: unknown\n", "")]
    text = "q_arm1,q_arm2,q_arm3,to_q_arm1,to_q_arm2,to_q_arm3,distance\n1,2,3,4,5,6,70\n"
    assert not dataset(tmp_path, text, CRANK, *side).frame.fitted
    one = "q_arm1,q_arm2,q_arm3,distance\n1,2,3,70\n"
    with pytest.raises(BadInput, match=r"the point they are measured from.*to_q_"):
        dataset(tmp_path, one, CRANK, *side)
    with pytest.raises(BadInput, match="'frame' is missing"):
        dataset(tmp_path, one, CRANK, ("{kind: pose", "{point: [1, 2, 3], kind: distance"), side[1])


def test_known_frames_and_targets(tmp_path):
    d = dataset(tmp_path, (GOOD / "good_run.csv").read_text(), BENCH,
                ("frame: unknown", "frame: {x: 1, y: 2, rz: 90}"),
                ("target: unknown", "target: [3, 4]"),
                ("target_rotation: known", "target_rotation: [0, 0, 180]"),
                ("actuator: 0.003", "actuator: {leg2: 0.5}"))
    np.testing.assert_allclose(d.frame.value, [1e-3, 2e-3, 0, 0, 0, np.pi / 2])
    np.testing.assert_allclose(d.target.value, [3e-3, 4e-3, 0])
    np.testing.assert_allclose(d.target_rotation.value, [0, 0, np.pi])
    np.testing.assert_allclose(d.sigma_actuator, [0, 5e-4, 0])
    assert not (d.frame.fitted or d.target.fitted or d.target_rotation.fitted)


def test_campaign_resolves_same_as(tmp_path):
    paths = []
    for name, frame in (("a", "unknown"), ("b", "{same_as: a}"), ("c", "{same_as: b}"),
                        ("d", "{x: 1, y: 2, rz: 3}"), ("e", "{same_as: d}")):
        (tmp_path / f"{name}.csv").write_text((GOOD / "good_run.csv").read_text())
        (tmp_path / f"{name}.yaml").write_text(
            SIDE.replace("run 3", name).replace("frame: unknown", f"frame: {frame}"))
        paths.append(tmp_path / f"{name}.csv")
    frames = [d.frame for d in read_campaign(paths, BENCH)]
    assert [f.same_as for f in frames] == [None, None, "a", None, None] or [
        f.same_as for f in frames] == [None, "a", "a", None, None]
    assert [f.fitted for f in frames] == [True, True, True, False, False]
    np.testing.assert_array_equal(frames[3].value, frames[4].value)


def test_foreign_hexapod_header(tmp_path):
    joints = ",".join(f"leg{i}" for i in range(1, 7))
    d = dataset(tmp_path, f"x1,y1,z1,phix1,phiy1,phiz1,{joints}\n1,2,3,4,5,6,7,8,9,10,11,12\n",
                RAILS)
    np.testing.assert_allclose(d.position[0], [1e-3, 2e-3, 3e-3])
    np.testing.assert_allclose(d.rotation[0], np.array([4, 5, 6]) * DEG)
    np.testing.assert_allclose(d.q[0, :2], [7.0, 8e-3])
    d = dataset(tmp_path, "x1,y1,z1,phix1,phiy1,phiz1,a,b,c,d,e,f\n1,2,3,4,5,6,7,8,9,10,11,12\n",
                RAILS)
    np.testing.assert_allclose(d.q[0, 5], 12e-3)
    assert "in order" in d.findings[0]
    d = dataset(tmp_path, "x1,y1,z1,phix1,phiy1,phiz1,a,b,c,d,e,f,temperature_room\n"
                "1,2,3,4,5,6,7,8,9,10,11,12,20\n", RAILS)
    np.testing.assert_allclose(d.q[0, 5], 12e-3)
    np.testing.assert_allclose(d.columns["temperature_room"], 293.15)


def test_foreign_motion_capture_header(tmp_path):
    legs = ",".join(f"leg_length_{i}" for i in range(1, 7))
    header = (f"{legs},position_x,position_y,position_z,orientation_x,orientation_y,"
              "orientation_z,orientation_w")
    d = dataset(tmp_path, f"{header}\n1,2,3,4,5,6,7,8,9,0,0,0,1\n", RAILS)
    np.testing.assert_allclose(d.q[0, :2], [1.0, 2e-3])
    np.testing.assert_allclose(d.position[0], [7e-3, 8e-3, 9e-3])
    np.testing.assert_allclose(d.rotation[0], 0)


@pytest.mark.skipif(not (SHARED / "stewart-jugglebot").is_dir(), reason="no shared data here")
def test_real_motion_capture(tmp_path):
    text = (SHARED / "stewart-jugglebot" / "poses60_2025-02-12.csv").read_text()
    d = dataset(tmp_path, text, RAILS)
    assert len(d) == 60
    assert np.isfinite(d.rotation).all()


def test_plain_and_odd_numbers_agree(tmp_path):
    plain = "q_leg1,q_leg2,q_leg3,x,y,rz\n1.5,-2e-3,3,nan,5,6\n,2,3,4,5,6\n1,2,3,,5,6\n"
    odd = plain.replace("1.5", "+1.5").replace("6\n", "06.\n").replace("nan", "NaN")
    quoted = plain.replace("1.5", '"1.5"')
    want = dataset(tmp_path, plain)
    for text in (odd, quoted):
        got = dataset(tmp_path, text)
        np.testing.assert_array_equal(got.q, want.q)
        np.testing.assert_array_equal(got.position, want.position)


@pytest.mark.parametrize("cell", ["true", "null", "[1]", "0x10", "1 2", "--1", "1e", "e", "n",
                                  "Infinity", "١", "1.2.3", "{}", "'1'"])
def test_cells_that_only_look_like_numbers(tmp_path, cell):
    with pytest.raises(BadInput, match="row 2, column y"):
        dataset(tmp_path, f"q_leg1,q_leg2,q_leg3,x,y,rz\n1,2,3,4,5,6\n1,2,3,4,{cell},6\n")


@pytest.mark.slow
def test_many_rows_are_fast(tmp_path):
    rng = np.random.default_rng(3)
    columns = [rng.normal(size=100_000) for _ in range(12)]
    header = [f"q_leg{i}" for i in range(1, 7)] + ["x", "y", "z", "rx", "ry", "rz"]
    text = csv_text(header, columns)
    start = time.perf_counter()
    d = dataset(tmp_path, text, RAILS)
    assert time.perf_counter() - start < 5.0
    np.testing.assert_array_equal(d.position[:, 0], columns[6] * 1e-3)


def test_pose_files(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("tag,x,y,rz,vx,wz\na,1,2,90,10,180\nb,,2,3,,1\n")
    table = read_poses(path, BENCH)
    np.testing.assert_allclose(table.poses[0], [1e-3, 2e-3, 0, 0, 0, np.pi / 2])
    assert np.isnan(table.poses[1, 0])
    assert table.given[0] == ("tag", "x", "y", "rz", "vx", "wz")
    assert table.extra["tag"] == ("a", "b")
    speed = twists(table.extra, BENCH)
    assert speed is not None
    np.testing.assert_allclose(speed[0], [0.01, 0, 0, 0, 0, np.pi])
    path.write_text("x,y\n1,2\n")
    with pytest.raises(BadInput, match="there is no column rz"):
        read_poses(path, BENCH)
    path.write_text("x,y,rz\n1,2,\n")
    assert np.isnan(read_poses(path, BENCH).poses[0, 5])
    assert twists(read_poses(path, BENCH).extra, BENCH) is None
    path.write_text("x,y,z,quat_x,quat_y,quat_z,quat_w\n1,2,3,1,0,0,0\n")
    np.testing.assert_allclose(read_poses(path, RAILS).poses[0, 3:], [np.pi, 0, 0])


def test_numbers_that_are_only_repeated_may_be_large(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("x,y,rz,stamp\n1,2,3,1700000000000000000\n")
    assert read_poses(path, BENCH).extra["stamp"] == [1.7e18]
    path.write_text("x,y,rz,stamp\n1e16,2,3,4\n")
    with pytest.raises(BadInput, match="row 1, column x: 1e\\+16 is out of range"):
        read_poses(path, BENCH)


def test_joint_files(tmp_path):
    path = tmp_path / "j.csv"
    path.write_text("q_leg3,note,q_leg1,q_leg2\n3,hello,1,\n")
    table = read_joints(path, BENCH)
    np.testing.assert_array_equal(table.q, [[1e-3, np.nan, 3e-3]])
    assert dict(zip(*table.given, strict=True))["note"] == ("hello",)


@pytest.mark.parametrize(("edit", "says"), [
    (("length: mm", "length: m"), "1000"), (("angle: deg", "angle: rad"), "57.3")])
def test_wrong_units_are_noticed(tmp_path, edit, says):
    text = (GOOD / "good_run.csv").read_text().replace("510.5", "540.5")
    assert unit_findings(BENCH, [dataset(tmp_path, text)]) == []
    found = unit_findings(BENCH, [dataset(tmp_path, text, BENCH, edit)], sidecar_path)
    assert any(says in f and "run.csv" in f and "check" in f and "run.yaml" in f for f in found)


def test_metres_declared_as_millimetres_are_noticed(tmp_path):
    text = "q_leg1,q_leg2,q_leg3,x,y,rz\n.4,.5,.6,.5,.2,1\n.5,.6,.7,.6,.3,2\n.5,.6,.7,.5,.3,2\n"
    found = unit_findings(BENCH, [dataset(tmp_path, text)])
    assert any("spans only" in f and "1000" in f for f in found)
    assert any("outside the limits of leg1" in f and "rows 1, 2, 3" in f for f in found)


def test_swapped_columns_are_noticed(tmp_path):
    mechanism = (GOOD / "good_bench.yaml").read_text().replace(
        "q: {leg1: 400}", "q: {leg1: 400, leg2: 800, leg3: 500}").replace("[200, 900]",
                                                                          "[200, 950]")
    (tmp_path / "m.yaml").write_text(mechanism)
    m = read_mechanism(tmp_path / "m.yaml")
    text = "q_leg2,q_leg1,q_leg3,x,y,rz\n400,800,500,500,200,1\n420,810,520,600,300,2\n"
    found = unit_findings(m, [dataset(tmp_path, text, m)])
    assert any("q_leg1 and q_leg2" in f and "swapped" in f for f in found)
