"""A base frame that points of it, or the first pose, define: where it is and how well."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows
from helpers.paths import ROOT

from ppmcal import algebra as cga
from ppmcal.calibration.compensation import ParameterCovariance
from ppmcal.commands.compensate.notes import defined_axes
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.kinematics.frame_definition import frame_by_points, frame_covariance
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.model.registration import FIRST_POSE, DefinedFrame

SEED = 11
FRAME = {"x": 120.0, "y": -40.0, "rz": 30.0}
AHEAD = [120.0 + 1000.0 * math.cos(math.radians(30.0)), -40.0 + 500.0]
"""A metre along the x axis of that frame."""
POINTS = {"origin": [120.0, -40.0], "x_axis": AHEAD}
SIGMA = 0.02
TARGET = [3, 2]


def test_three_points_are_origin_axis_and_plane():
    """Wherever the base is, its own points give its frame back."""
    generator = np.random.default_rng(SEED)
    own = np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0], [-0.2, 0.5, 0.0]])
    for pose in generator.uniform(-1.5, 1.5, (20, 6)):
        frame = pose_motor(pose)
        found = frame_by_points(np.array([cga.move_point(frame, p) for p in own]))
        assert pose_vector(cga.compose(cga.reverse(frame), found)) == pytest.approx(
            np.zeros(6), abs=1e-12)


@pytest.mark.slow
def test_the_covariance_is_that_of_frames_drawn():
    """By first order: as many draws as tell a standard deviation to two per cent."""
    generator = np.random.default_rng(SEED)
    points = np.array([[0.3, 0.1, 0.0], [1.2, 0.4, 0.1], [0.2, 0.9, -0.1]])
    sigma, count = 1e-4, 4000

    def frame(values):
        return frame_by_points(values.reshape(3, 3))

    stated = frame_covariance(frame, points.ravel(), sigma**2 * np.eye(9))
    back = cga.reverse(frame(points.ravel()))
    drawn = np.array([pose_vector(cga.compose(back, frame(points.ravel() + noise)))
                      for noise in generator.normal(0.0, sigma, (count, 9))])
    spread = np.sqrt(np.diagonal(np.cov(drawn.T)) / np.diagonal(stated))
    assert spread == pytest.approx(np.ones(6), abs=4.0 / math.sqrt(2.0 * count))


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A planar machine measured from a frame that is elsewhere, and turned by 30 deg."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "m.yaml").write_bytes((ROOT / "configs" / "3-RPR.yaml").read_bytes())
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": {"x": 500, "y": 290, "rz": 5},
                                     "half_range": {"x": 60, "y": 60, "rz": 8}, "count": 24}},
                "errors": {"random": {"scale": 0.3}}, "seed": 3, "frame": FRAME, "target": TARGET,
                "instrument": {"kind": "pose", "sigma": {"position": 0.004, "rotation": 0.001}}}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    (folder / "targets.csv").write_text("x,y,rz\n500,290,5\n470,310,2\n", encoding="utf-8")
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "sim", cwd=folder)
    return folder


def measured(folder, name, frame, target=TARGET, **more):
    """Write the measurements with a sidecar that says of the frame what is given."""
    side = yaml.safe_load((folder / "sim" / "measurements.yaml").read_text(encoding="utf-8"))
    side |= {"name": name, "frame": frame, "target": target, **more}
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    (folder / f"{name}.csv").write_bytes((folder / "sim" / "measurements.csv").read_bytes())
    return f"{name}.csv"


def promise(folder, name, frame, target=TARGET):
    """Identify, and ask for targets in the base frame; commands, commands.json and what is said."""
    ppmcal("identify", "m.yaml", measured(folder, name, frame, target), "--out", f"id_{name}",
           cwd=folder, expect=None)
    done = ppmcal("compensate", f"id_{name}", "targets.csv", "--frame", "base", "--out",
                  f"c_{name}", cwd=folder)
    record = json.loads((folder / f"c_{name}" / "commands.json").read_text(encoding="utf-8"))
    return rows(folder / f"c_{name}" / "commands.csv"), record, " ".join(done.out.split())


@pytest.mark.slow
def test_a_promise_in_base_axes_says_what_is_the_frames(bench):
    """Of points 1 m apart it is known by hand what they leave of a target."""
    _, record, said = promise(bench, "points", {"points": POINTS, "sigma": SIGMA})
    assert record["base_axes"] == "two points of points"
    size = record["predicted"]["position"]
    assert size["machine"] ** 2 + size["frame"] ** 2 == pytest.approx(size["sigma"] ** 2)
    # the origin's noise, and that of the axis' direction a target's way off: rms of two targets
    far = np.array([0.5, 0.47]) ** 2 + np.array([0.29, 0.31]) ** 2
    by_hand = SIGMA * math.sqrt(np.mean(1.0 + 2.0 * far - 2.0 * np.array([0.5, 0.47]) + 1.0))
    assert size["frame"] == pytest.approx(by_hand, rel=1e-3)
    turn = record["predicted"]["rotation"]["frame"]
    assert turn == pytest.approx(math.degrees(math.sqrt(2.0) * SIGMA / 1000.0), rel=1e-3)
    assert f"{size['frame']:.4g} mm" in said and "as defined by two points of points" in said


@pytest.mark.slow
def test_in_the_measuring_frame_the_definition_does_not_count(bench):
    """The fit takes the points' error for a motion of the base, which comes back there."""
    (bench / "seen.csv").write_text("x,y,rz\n410,440,35\n420,450,36\n", encoding="utf-8")
    shift, found = 0.1, []
    moved = {"origin": [120.0 + shift, -40.0], "x_axis": [AHEAD[0] + shift, AHEAD[1]]}
    for name, points in (("there", POINTS), ("moved", moved)):
        commands, _, _ = promise(bench, name, {"points": points, "sigma": SIGMA})
        done = ppmcal("compensate", f"id_{name}", "seen.csv", "--out", f"s_{name}", cwd=bench)
        assert "It is the machine's alone" in " ".join(done.out.split())
        found.append((commands, rows(bench / f"s_{name}" / "commands.csv")))
    (base, seen), (base_moved, seen_moved) = found
    q = [f"q_leg{i}" for i in (1, 2, 3)]

    def apart(one, other):
        return max(abs(float(a[c]) - float(b[c])) for a, b in zip(one, other, strict=True)
                   for c in q)

    # what tolerances hold against it is a small part
    assert apart(seen, seen_moved) < 0.03 * apart(base, base_moved)
    assert apart(base, base_moved) > 0.5 * shift


@pytest.mark.slow
def test_the_first_pose_is_right_in_its_own_frame(bench):
    """The nominal machine has no error there, whatever it is in truth, and only noise is left."""
    mechanism = read_mechanism(bench / "m.yaml")
    (data,) = read_campaign([bench / measured(bench, "first", {"first_pose": True})], mechanism)
    assert not data.frame.fitted and data.frame.defined is not None
    _, record, _ = promise(bench, "first", {"first_pose": True})
    assert record["base_axes"] == "the first pose of first"
    first = next(row for row in rows(bench / "id_first" / "residuals.csv") if row["row"] == "1")
    assert [float(first[f"before_{c}"]) for c in ("x", "y", "rz")] == pytest.approx(
        [0.0, 0.0, 0.0], abs=1e-9)
    turn = record["predicted"]["rotation"]["frame"]
    assert turn == pytest.approx(0.001, rel=1e-3)    # that of one measured angle


@pytest.mark.parametrize(("machine", "frame", "more", "said"), [
    ("3-RPR.yaml", {"points": {"origin": [0, 0], "x_axis": [0.05, 0]}}, {}, "tell no direction"),
    ("3-RPR.yaml", {"points": {"origin": [0, 0]}}, {}, "the point 'x_axis' is missing"),
    ("3-RPR.yaml", {"points": {**POINTS, "plane": [0, 1]}}, {}, "has no plane to be defined"),
    ("3-RPR.yaml", {"points": POINTS, "sigma": -1}, {}, "is not a standard deviation"),
    ("3-RPR.yaml", {"points": POINTS}, {"scale": 0.99}, "scale, which is not 1"),
    ("3-RPR.yaml", {"first_pose": False}, {}, "cannot be used here"),
    ("3-RPR.yaml", {"first_pose": True}, {"target": "unknown"}, "the target is not"),
    ("6-UPS.yaml", {"points": {"origin": [0, 0, 0], "x_axis": [900, 0, 0],
                               "plane": [500, 0, 0.01]}}, {}, "lie on one line")])
def test_what_defines_no_frame_is_refused(bench, machine, frame, more, said):
    side = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
            "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.002}},
            "target": [0, 0, 0], "frame": frame, **more}
    spatial = machine == "6-UPS.yaml"
    joints = [f"q_leg{i + 1}" for i in range(6 if spatial else 3)]
    seen = ["x", "y", "z", "rx", "ry", "rz"] if spatial else ["x", "y", "rz"]
    (bench / "bad.yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    (bench / "bad.csv").write_text(",".join([*joints, *seen]) + "\n" + ",".join(
        ["440"] * len(joints) + ["1"] * len(seen)) + "\n", encoding="utf-8")
    done = ppmcal("check", ROOT / "configs" / machine, "bad.csv", cwd=bench, expect=2)
    assert said in " ".join(done.err.split()) and "bad.yaml: frame" in " ".join(done.err.split())


def test_a_promise_says_which_axes_it_is_in() -> None:
    """Of several the least certain; of a first pose that the nominal machine's error is not in it.
    """
    def known(**frames: tuple[str, float]) -> ParameterCovariance:
        return ParameterCovariance((), np.zeros((0, 0)), {}, {}, {}, frames={
            name: DefinedFrame(by, size * np.eye(6)) for name, (by, size) in frames.items()})

    points, pose = ("three points", 1.0), (FIRST_POSE, 2.0)
    assert list(defined_axes(known(a=points), "")) == []
    assert list(defined_axes(known(a=pose), "a")) == []    # in the measuring frame it is no matter
    (one,) = defined_axes(known(a=pose), "")
    assert "not what the nominal machine errs there" in one
    several, own = defined_axes(known(a=points, b=pose), "")
    assert "2 data sets define the base axes: the least certain counts" in several
    assert f"{FIRST_POSE} of b" in several
    assert "pose of b" in own
