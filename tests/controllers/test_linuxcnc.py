"""A hexapod as HAL pins of LinuxCNC's genhexkins, and what they are worth."""

from __future__ import annotations

import math
import random
import re
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, tree
from helpers.paths import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ppmcal.controllers.export import Exported
from ppmcal.controllers.linuxcnc.controller import export
from ppmcal.controllers.linuxcnc.fit import (
    best,
    commands,
    drive_of,
    genhexkins_setting,
    grid,
    predicted_errors,
    reached,
    strut_lengths,
)
from ppmcal.controllers.linuxcnc.hal import (
    BASE_N,
    PLATFORM_N,
    HexapodGeometry,
    Joint,
    format_hal,
    format_joints,
    parse_hal,
    parse_joints,
    read_geometry,
)
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.kinematics.partial_pose import pose_motor

CONFIGS = ROOT / "configs"
UPS = CONFIGS / "6-UPS.yaml"
NAMES = [f"leg{i}" for i in range(1, 7)]
SIM_BASE = np.array([[-22.95, 13.25, 0], [22.95, 13.25, 0], [22.95, 13.25, 0], [0, -26.5, 0],
                     [0, -26.5, 0], [-22.95, 13.25, 0]])
SIM_PLATFORM = np.array([[-1, 11.5, 0], [1, 11.5, 0], [10.459, -4.884, 0], [9.459, -6.616, 0],
                         [-9.459, -6.616, 0], [-10.459, -4.884, 0]])


def triples(values: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in values)


SIM = HexapodGeometry(triples(SIM_BASE), triples(SIM_PLATFORM))
"""genhexkins' own defaults, inch."""


def turned(a: float, b: float, c: float) -> np.ndarray:
    """The platform's matrix at A, B, C in degrees, as a product of three plain turns."""
    a, b, c = (math.radians(v) for v in (a, b, c))
    x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    return z @ y @ x


def by_hand(base: np.ndarray, platform: np.ndarray, at: np.ndarray, turn: np.ndarray
            ) -> np.ndarray:
    """Strut lengths (6,) at one place (3,) and matrix, strut by strut."""
    return np.array([math.dist(at + turn @ a, b) for a, b in zip(platform, base, strict=True)])


def where(base: np.ndarray, platform: np.ndarray, lengths: np.ndarray, start: np.ndarray
          ) -> np.ndarray:
    """Place and rotation vector (6,) of a platform on struts of these lengths, near ``start``."""
    def gaps(p: np.ndarray) -> np.ndarray:
        return by_hand(base, platform, p[:3] * 1e3,
                       Rotation.from_rotvec(p[3:]).as_matrix()) - lengths

    found = least_squares(gaps, start / np.array([1e3] * 3 + [1] * 3), xtol=1e-15, ftol=1e-15,
                          gtol=1e-15)
    assert np.max(np.abs(found.fun)) < 1e-9
    return found.x * np.array([1e3] * 3 + [1] * 3)


# ---------------------------------------------------------------- the controller's arithmetic

POSES = np.array([[1.0, -2, 20, 5, -7, 12], [0, 0, 22, 0, 0, 0], [-3, 1, 18, -20, 15, -40],
                  [2, 2, 25, 0, -30, 170]])


def test_strut_lengths_are_those_by_hand() -> None:
    want = [by_hand(SIM_BASE, SIM_PLATFORM, p[:3], turned(*p[3:])) for p in POSES]
    np.testing.assert_allclose(strut_lengths(SIM, POSES), want, rtol=1e-14)


def test_strut_lengths_are_those_of_linuxcncs_own_simulation() -> None:
    """Its hexapod homes all joints at 29.7466 inch, where the platform is 20 inch up."""
    found = strut_lengths(SIM, np.array([[0, 0, 20, 0, 0, 0]], dtype=float))
    assert found.mean() == pytest.approx(29.7466, abs=5e-5) and np.ptp(found) < 5e-4


def test_a_screw_lead_adds_what_the_nuts_turn() -> None:
    """n3 lies in the plane of strut and base axis, n2 across strut and platform axis."""
    lead = 0.2
    geometry = HexapodGeometry(SIM.base, SIM.platform, screw_lead=lead)
    found = strut_lengths(geometry, POSES)
    for p, row in zip(POSES, found, strict=True):
        turn = turned(*p[3:])
        for n in range(6):
            strut = p[:3] + turn @ SIM_PLATFORM[n] - SIM_BASE[n]
            s = strut / math.hypot(*strut)
            axis = np.array(BASE_N[n])
            n3 = axis - (axis @ s) * s
            n2 = np.cross(turn @ np.array(PLATFORM_N[n]), s)
            sine = n3 @ n2 / math.hypot(*n3) / math.hypot(*n2)
            want = math.hypot(*strut) + lead * math.degrees(math.asin(sine)) / 360.0
            assert row[n] == pytest.approx(want, rel=1e-13)
    assert np.ptp(found - strut_lengths(SIM, POSES)) > 0.02


def test_offsets_move_the_frames_only() -> None:
    """A spindle offset s is the tool s above the platform's origin and the world s higher."""
    up = np.array([0.0, 0.0, 1.5])
    moved = strut_lengths(
        HexapodGeometry(SIM.base, SIM.platform, spindle_offset=1.0, tool_offset=0.5), POSES
    )
    for p, row in zip(POSES, moved, strict=True):
        turn = turned(*p[3:])
        np.testing.assert_allclose(row, by_hand(
            SIM_BASE, SIM_PLATFORM, p[:3] + turn @ up - up, turn), rtol=1e-13)


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[st.floats(-180, 180)] * 3))
def test_commands_turn_the_platform_as_the_pose_does(angles: tuple[float, float, float]) -> None:
    for a, b, c in (angles, (angles[0], 90.0, angles[2]), (angles[0], -90.0, angles[2])):
        turn = turned(a, b, c)
        pose = pose_motor(np.array([[0.1, 0.2, 0.3, *Rotation.from_matrix(turn).as_rotvec()]]))
        x, y, z, *abc = commands(pose, 1e-3)[0]
        assert (x, y, z) == pytest.approx((100, 200, 300), abs=1e-12)
        np.testing.assert_allclose(turned(*abc), turn, atol=1e-7)


# ---------------------------------------------------------------- the files

NUMBER = st.floats(-5e3, 5e3)
POINT = st.tuples(NUMBER, NUMBER, NUMBER)
POINTS = st.tuples(*[POINT] * 6)
ITERATION = st.lists(st.tuples(st.sampled_from(["convergence-criterion", "max-error"]),
                               st.floats(1e-12, 1e4)), max_size=2, unique_by=lambda v: v[0])


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(POINTS, POINTS, st.one_of(st.just((BASE_N, PLATFORM_N)), st.tuples(POINTS, POINTS)),
       st.tuples(*[st.one_of(st.just(0.0), NUMBER)] * 3), ITERATION, st.text(max_size=300))
def test_pins_read_back_equal(base: Any, platform: Any, axes: Any, scalars: Any,
                              iteration: list[tuple[str, float]], comment: str) -> None:
    geometry = HexapodGeometry(base, platform, *axes, *scalars, tuple(sorted(iteration))).rounded()
    text = format_hal(geometry, NAMES, comment + "\\")
    assert read_geometry(parse_hal(text, "x")) == geometry
    assert max(map(len, text.splitlines())) < 120 and geometry == geometry.rounded()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.builds(Joint, NUMBER, st.one_of(st.just(1.0), st.floats(0.5, 2)),
                          st.one_of(st.just(0.0), NUMBER)), min_size=6, max_size=6))
def test_joints_read_back_equal(joints: list[Joint]) -> None:
    want = tuple(j.rounded() for j in joints)
    text = format_joints(want, NAMES, "a\n[JOINT_0]")
    assert parse_joints(text, "x") == want
    assert all(not line or line[0] in "#[" for line in text.splitlines())


@pytest.mark.parametrize(("old", "new", "said"), [
    ("# HOME = 1.0000000", "# HOME = here", "'here' is not a number"),
    ("# HOME = 1.0000000", "# HOME = nan", "'nan' is not a number"),
    ("# HOME = 1.0000000", "# HOME = 1e999", "is not a number"),
    ("# HOME = 1.0000000\n", "", "HOME is missing"),
    ("present * 1.500000000000", "present * .", "'.' is not a number"),
    ("+ 2.0000000", "+ -", "is not a number")])
def test_odd_lines_of_joints_are_refused(old: str, new: str, said: str) -> None:
    text = format_joints([Joint(0.5), Joint(1.0, 1.5, 2.0)], NAMES[:2])
    assert old in text
    with pytest.raises(BadInput, match=re.escape(said)) as error:
        parse_joints(text.replace(old, new), "x")
    assert str(error.value).startswith("x: [JOINT_1]")


def pins_text(geometry: HexapodGeometry = SIM) -> str:
    return format_hal(geometry, NAMES, "mine")


def test_what_people_write_is_read() -> None:
    text = ("loadrt [KINS]KINEMATICS  # genhexkins.base.0.x\r\nsource $(HOME)/a.hal\n"
            + pins_text().replace("setp genhexkins.base.0.x -22.9500000",
                                  "setp genhexkins.base.0.x \\\n   7  # not yet\n"
                                  "  SETP Genhexkins.Base.0.X = -2.295e1")
            + 'genhexkins.platform.5.y = -4.884\nsetp "genhexkins.base.1.x" +22.95 # x\n'
            + "setp genhexkins.max-error 200\n# setp genhexkins.base.0.x 5\n"
            + "net tool motion.tooloffset.z => genhexkins.tool-offset\nshow pin genhexkins.x\n")
    hal = parse_hal(text, "x")
    geometry = read_geometry(hal)
    assert geometry.base == SIM.base and geometry.platform == SIM.platform
    assert geometry.iteration == (("max-error", 200.0),)
    assert hal.pins["base.0.x"][0] == -22.95 and hal.sourced == ("$(HOME)/a.hal",)
    assert read_geometry(parse_hal(text + "genhexkins.base.0.x = 3", "x")).base[0][0] == 3.0


FORMAT = "`setp pin value`"


@pytest.mark.parametrize(("old", "new", "words"), [
    ("base.3.z 0.0000000", "base.3.z", [FORMAT, "line"]),
    ("base.3.z 0.0000000", "base.3.z 0 0", [FORMAT]),
    ("base.3.z 0.0000000", "base.3.z=0", [FORMAT]),
    ("base.3.z 0.0000000", "base.3.z O.0", ["'O.0' is not a number", "base.3.z"]),
    ("base.3.z 0.0000000", "base.3.z nan", ["'nan' is not a number"]),
    ("base.3.z 0.0000000", "base.3.z 1e999", ["'1e999' is not a number"]),
    ("base.3.z 0.0000000", "base.3.z [KINS]B3Z", ["[KINS]B3Z", "not in this file", "line 30"]),
    ("base.3.z 0.0000000", "base.3.z $(B3Z)", ["not in this file"]),
    ("base.3.z 0.0000000", "bose.3.z 0", ["no pin 'bose.3.z'", "genhexkins.base.3.z"]),
    ("base.3.z 0.0000000", "base.6.z 0", ["no pin 'base.6.z'"]),
    ("setp genhexkins.base.3.z 0.0000000", "", ["genhexkins.base.3.z is not set"]),
    ("setp genhexkins.base.", "# setp genhexkins.base.", ["base.0.x and 17 more are not set"]),
    ("setp genhexkins.base.3.z 0.0000000", "net a b => genhexkins.base.3.z", ["a signal drives"]),
    ("setp genhexkins.base.3.z 0.0000000", "source more.hal", ["more.hal", "not followed"]),
])
def test_a_broken_hal_file_is_refused(tmp_path: Path, old: str, new: str, words: list[str]
                                      ) -> None:
    text = pins_text()
    assert old in text
    (tmp_path / "k.hal").write_text(text.replace(old, new))
    run = ppmcal("export", "linuxcnc", UPS, "--old", "k.hal", cwd=tmp_path, expect=2)
    said = " ".join(run.err.split())
    assert "k.hal" in said and all(w in said for w in words), said
    assert not (tmp_path / "exported").exists()


@pytest.mark.parametrize("content", [b"", b"\x00\x01\xff", b"\xff\xfe[printer]", b"setp", b"=",
                                     b"setp genhexkins.", b"genhexkins.", b"\\", b"\\\n\\",
                                     b"setp genhexkins.base.0.x 1", b"= = =\nsetp = =", b"'\"#"])
def test_any_file_is_refused_in_words(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "k.hal").write_bytes(content)
    run = ppmcal("export", "linuxcnc", UPS, "--old", "k.hal", cwd=tmp_path, expect=2)
    assert "k.hal" in run.err and "fault of ppmcal" not in run.err


@pytest.mark.slow
def test_cut_and_scrambled_files_never_end_in_a_traceback(tmp_path: Path) -> None:
    draw = random.Random(5)
    text = pins_text().encode()
    for _ in range(60):
        broken = bytearray(text[:draw.randrange(len(text))])
        for _ in range(draw.randrange(8)):
            if broken:
                broken[draw.randrange(len(broken))] = draw.randrange(256)
        (tmp_path / "k.hal").write_bytes(bytes(broken))
        run = ppmcal("export", "linuxcnc", UPS, "--old", "k.hal", "--quiet", cwd=tmp_path,
                     expect=2)
        assert "k.hal" in run.err and "fault of ppmcal" not in run.err, run.err


# ---------------------------------------------------------------- machines


def changed(tmp_path: Path, change: dict[str, dict[str, Any]] | None = None,
            more: dict[str, Any] | None = None, **errors: float) -> Path:
    """``6-UPS`` with limbs' entries replaced, and with random ``errors`` of centres, mm."""
    rng = np.random.default_rng(7)
    machine = yaml.safe_load(UPS.read_text())
    machine.update(more or {})
    for limb in machine["limbs"]:
        for part, size in errors.items():
            polar = limb[part]["point"]
            angle = math.radians(polar["angle"])
            nominal = [polar["radius"] * math.cos(angle), polar["radius"] * math.sin(angle), 0.0]
            value = (np.array(nominal) + rng.normal(0, size, 3)).tolist()
            limb[part] = {"point": {"value": value, "nominal": nominal}}
        limb.update(change.get(limb["name"], {}) if change else {})
    path = tmp_path / "m.yaml"
    path.write_text(yaml.safe_dump(machine))
    return path


def centres(path: Path, key: str) -> tuple[np.ndarray, np.ndarray]:
    limbs = yaml.safe_load(path.read_text())["limbs"]
    base, platform = (np.array([limb[part]["point"][key] for limb in limbs])
                      for part in ("base", "platform"))
    return base, platform


def written(folder: Path) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Points and per joint (stretch, shift) of the files, by plain expressions."""
    hal = (folder / "genhexkins.hal").read_text()
    of = dict(re.findall(r"^setp genhexkins\.(\S+) (\S+)$", hal, re.MULTILINE))
    base, platform = (np.array([[float(of[f"{part}.{n}.{c}"]) for c in "xyz"] for n in range(6)])
                      for part in ("base", "platform"))
    ini = []
    for part in (folder / "joints.ini").read_text().split("[JOINT_")[1:]:
        line = re.search(r"# HOME_OFFSET = present(?: \* (\S+))? (.) (\S+)", part)
        scale = re.search(r"# SCALE = present / (\S+)", part)
        assert (scale and scale[1]) == (line and line[1])
        ini.append((1.0, 0.0) if line is None else
                   (float(line[1] or 1), float(line[2] + line[3])))
    return base, platform, ini


PLACES = [np.array([*p, *r]) for p, r in product(
    [(0, 0, 2000), (250, -180, 2150), (-120, 200, 1850)],
    [(0, 0, 0), (0.1, -0.12, 0.15), (-0.14, 0.05, -0.1)])]


@pytest.mark.slow
def test_joint_centres_are_driven_exactly(tmp_path: Path) -> None:
    path = changed(tmp_path, base=0.5, platform=0.3)
    run = ppmcal("export", "linuxcnc", path, "--json", cwd=tmp_path, expect=0).json
    base, platform, ini = written(tmp_path / "exported")
    true = centres(path, "value")
    assert ini == [(1.0, 0.0)] * 6
    for p in PLACES:
        turn = Rotation.from_rotvec(p[3:]).as_matrix()
        at = where(*true, by_hand(base, platform, p[:3], turn), p)
        assert np.max(np.abs(at - p)[:3]) < 1e-5 and np.max(np.abs(at - p)[3:]) < 1e-8
        wrong = where(*true, by_hand(*centres(path, "nominal"), p[:3], turn), p)
        assert np.max(np.abs(wrong - p)) > 0.05
    gain = run["gain"]
    assert run["exact"] and gain["after"]["max"] < 1e-5
    assert gain["after"]["rotation"]["max"] < 1e-6 and gain["before"]["rms"] > 0.1
    assert run["parameters"]["genhexkins.base.2.y"] == pytest.approx(true[0][2][1], abs=1e-7)
    assert run["old"]["genhexkins.base.2.y"] == pytest.approx(centres(path, "nominal")[0][2][1],
                                                              abs=1e-7)
    assert len(run["parameters"]) == 48


@pytest.mark.slow
def test_the_predicted_gain_is_that_by_hand(tmp_path: Path) -> None:
    path = changed(tmp_path, {"leg2": {"offset": {"value": 1.2, "nominal": 0.4}}}, base=0.5,
                   platform=0.3)
    lines = [",".join(str(v) for v in (*p[:3], *np.degrees(p[3:]))) for p in PLACES]
    (tmp_path / "poses.csv").write_text("x,y,z,rx,ry,rz\n" + "\n".join(lines) + "\n")
    run = ppmcal("export", "linuxcnc", path, "--poses", "poses.csv", "--json", cwd=tmp_path,
                 expect=0).json
    lengths = np.array([by_hand(*centres(path, "nominal"), p[:3],
                                Rotation.from_rotvec(p[3:]).as_matrix()) for p in PLACES])
    lengths[:, 1] += 0.8
    found = [where(*centres(path, "value"), row, p)
             for row, p in zip(lengths, PLACES, strict=True)]
    away = [math.dist(a[:3], p[:3]) for a, p in zip(found, PLACES, strict=True)]
    turn = [math.degrees((Rotation.from_rotvec(a[3:]) * Rotation.from_rotvec(p[3:]).inv())
                         .magnitude()) for a, p in zip(found, PLACES, strict=True)]
    before = run["gain"]["before"]
    assert before["max"] == pytest.approx(max(away), rel=1e-6)
    assert before["rms"] == pytest.approx(np.sqrt(np.mean(np.square(away))), rel=1e-6)
    assert before["rotation"]["max"] == pytest.approx(max(turn), rel=1e-6)
    assert run["gain"]["after"]["max"] < 1e-6 and run["poses"] == len(PLACES)


def test_offset_and_ratio_become_scale_and_home_offset(tmp_path: Path) -> None:
    """A motor's turns q are what stays; the positions that LinuxCNC has of them change."""
    change = {"leg1": {"offset": {"value": 1.5, "nominal": 0}},
              "leg3": {"ratio": {"value": 10.02, "nominal": 10, "tolerance": 0.01},
                       "offset": {"value": 1501, "nominal": 1500}},
              "leg4": {"ratio": {"value": -4.99, "nominal": -5}, "offset": 4000},
              "leg5": {"joint2": {"z": 0.3}, "joint3": {"z": 0.2}},
              "leg6": {"ratio": -1, "offset": {"value": 4500.7, "nominal": 4500}}}
    limits = {f"leg{i}": [1900, 3400] for i in (1, 2, 5)}
    path = changed(tmp_path, change, {"limits": limits}, base=0.5, platform=0.3)
    run = ppmcal("export", "linuxcnc", path, cwd=tmp_path, expect=0)
    base, platform, ini = written(tmp_path / "exported")
    true = centres(path, "value")
    r0, o0 = np.array([1, 1, 10, -5, 1, -1]), np.array([0, 0, 1500, 4000, 0, 4500])
    r, o = np.array([1, 1, 10.02, -4.99, 1, -1]), np.array([1.5, 0, 1501, 4000, 0.5, 4500.7])
    switch = np.array([40.0, 2000, 60, 300, 2100, 2000])       # q at the home switches
    offset_now = r0 * switch + o0                              # HOME_OFFSET in use
    offset_new = np.array([f * h + d for (f, d), h in zip(ini, offset_now, strict=True)])
    for p in PLACES:
        j = by_hand(base, platform, p[:3], Rotation.from_rotvec(p[3:]).as_matrix())
        # from the switch, SCALE counts for each mm; one count is one 1000th of q
        counts = 1000 / r0 / [f for f, _ in ini] * (j - offset_new)
        q = switch + counts / 1000
        at = where(*true, r * q + o, p)
        assert np.max(np.abs(at - p)[:3]) < 2e-5 and np.max(np.abs(at - p)[3:]) < 2e-8
    assert ini[1] == (1.0, 0.0) and ini[0] == (1.0, 1.5) and ini[4] == (1.0, 0.5)
    assert ini[5] == (1.0, 0.7) and ini[2][0] == 1.002
    said = " ".join(run.out.split())
    assert "joints 0, 2, 3, 4, 5 as joints.ini says" in said and "driven lines went" in said
    home = by_hand(base, platform, np.array([0, 0, 2000.0]), np.eye(3))
    text = (tmp_path / "exported" / "joints.ini").read_text()
    assert [float(v) for v in re.findall(r"# HOME = (\S+)", text)] == pytest.approx(home)
    assert "[TRAJ]HOME = 0.000000 0.000000 2000.000000 0.0" in text


@pytest.mark.slow
def test_the_present_pins_are_read_and_kept(tmp_path: Path) -> None:
    path = changed(tmp_path, base=0.5, platform=0.3)
    old = HexapodGeometry(*(triples(v) for v in centres(path, "nominal")), screw_lead=5.0,
                   spindle_offset=-80.0, iteration=(("max-error", 900.0),)).rounded()
    (tmp_path / "k.hal").write_text(pins_text(old))
    run = ppmcal("export", "linuxcnc", path, "--old", "k.hal", "--json", cwd=tmp_path, expect=0)
    plain = ppmcal("export", "linuxcnc", path, "--json", "--out", "p", cwd=tmp_path, expect=0)
    for which in ("before", "after"):
        assert run.json["gain"][which]["rms"] == pytest.approx(
            plain.json["gain"][which]["rms"], abs=1e-6)
    text = (tmp_path / "exported" / "genhexkins.hal").read_text()
    new = read_geometry(parse_hal(text, "x"))
    assert (new.screw_lead, new.spindle_offset, new.iteration) == (5.0, -80.0, old.iteration)
    assert new.base_n == BASE_N and "genhexkins.base-n.0.x 0.7071070" in text
    notes = " ".join(run.json["notes"])
    assert "screw-lead 5" in notes and "spindle-offset" in notes
    # driven with its own numbers there is nothing to gain, and that is no finding
    again = ppmcal("export", "linuxcnc", path, "--old", "exported/genhexkins.hal", "--json",
                   "--out", "again", cwd=tmp_path, expect=0)
    assert again.json["gain"]["before"] == again.json["gain"]["after"]
    assert (tmp_path / "again" / "genhexkins.hal").read_text().split("Pins of")[1] == (
        text.split("Pins of")[1])


@pytest.mark.slow
def test_inches_are_seen_by_the_size_of_the_old_points(tmp_path: Path) -> None:
    path = changed(tmp_path, {"leg1": {"offset": {"value": 2.54, "nominal": 0}}}, base=0.5,
                   platform=0.3)
    base, platform = (triples(v / 25.4) for v in centres(path, "nominal"))
    (tmp_path / "k.hal").write_text(pins_text(HexapodGeometry(base, platform)))
    run = ppmcal("export", "linuxcnc", path, "--old", "k.hal", "--json", cwd=tmp_path, expect=0)
    assert run.json["length_unit"] == "in" and run.json["gain"]["after"]["max"] < 1e-4
    new, _, ini = written(tmp_path / "exported")
    np.testing.assert_allclose(new * 25.4, centres(path, "value")[0], atol=2e-6)
    assert ini[0][1] == pytest.approx(0.1, abs=1e-7)
    assert "lengths in inch, as" in (tmp_path / "exported" / "genhexkins.hal").read_text()
    (tmp_path / "k.hal").write_text(pins_text(SIM))
    run = ppmcal("export", "linuxcnc", path, "--old", "k.hal", cwd=tmp_path, expect=2)
    assert "k.hal" in run.err and "spread by" in run.err


def test_struts_in_another_order_are_refused(tmp_path: Path) -> None:
    base, platform = (v[[1, 2, 3, 4, 5, 0]] for v in centres(
        changed(tmp_path, base=0.5, platform=0.3), "nominal"))
    (tmp_path / "k.hal").write_text(pins_text(HexapodGeometry(triples(base), triples(platform))))
    run = ppmcal("export", "linuxcnc", "m.yaml", "--old", "k.hal", cwd=tmp_path, expect=2)
    assert "k.hal: strut 0 stands where leg2 is drawn, not leg1" in " ".join(run.err.split())


# ---------------------------------------------------------------- what cannot be expressed


def exported(path: Path) -> Exported:
    return export(read_mechanism(path), None, None)


@pytest.mark.slow
def test_joints_beside_the_line_are_listed_with_their_cost(tmp_path: Path) -> None:
    costs = []
    for beside in (10, 20):
        path = changed(tmp_path, {"leg2": {"joint2": {"x": beside, "rz": 0.1}}})
        run = ppmcal("export", "linuxcnc", path, "--json", cwd=tmp_path, expect=1).json
        lack, after = run["not_expressed"][0], run["gain"]["after"]
        assert f"leg2 stand {beside} mm beside" in lack["what"] and not run["exact"]
        assert len(run["not_expressed"]) == 1 and "leg2.joint2.x" in lack["parameters"]
        # nothing else is wrong with this machine, so its cost is what remains
        assert lack["cost"]["rms"] == pytest.approx(after["rms"], rel=0.01)
        assert lack["cost"]["rotation"]["max"] == pytest.approx(after["rotation"]["max"], rel=0.01)
        assert 0.0 < after["rms"] < 0.05 * run["gain"]["before"]["rms"]
        costs.append(after["rms"])
    # a strut is longer by beside^2 / 2 length
    assert costs[1] / costs[0] == pytest.approx(4.0, rel=0.05)
    said = ppmcal("export", "linuxcnc", path, cwd=tmp_path, expect=1).out
    assert "cannot be expressed: joints 2 and 3 of leg2" in " ".join(said.split())


@pytest.mark.slow
def test_the_fit_is_a_smallest_one(tmp_path: Path) -> None:
    path = changed(tmp_path, {"leg2": {"joint2": {"x": 30}}, "leg5": {"joint3": {"y": 20}}})
    drive = drive_of(read_mechanism(path), 1e-3)
    poses = grid(drive)[0]
    found = best(drive, genhexkins_setting(drive), poses)
    scale = drive.mechanism.length_scale

    def cost(setting: Any) -> float:
        m = predicted_errors(drive, setting, poses)
        return m.rms**2 + (scale * m.rotation_rms) ** 2

    least = cost(found)
    assert least < 0.01 * cost(genhexkins_setting(drive))
    rng = np.random.default_rng(2)
    for size, _ in product((1e-4, 1e-3), range(12)):
        away = HexapodGeometry(*(triples(np.array(v) + rng.normal(0, size, (6, 3)))
                          for v in (found.geometry.base, found.geometry.platform)))
        near = type(found)(away, found.stretch * (1 + rng.normal(0, 1e-3 * size, 6)),
                           found.shift + rng.normal(0, size, 6))
        assert cost(near) > least


def test_frame_errors_that_move_centres_or_nothing_are_expressed(tmp_path: Path) -> None:
    path = changed(tmp_path, {"leg1": {"joint1": {"x": 2, "z": -1, "rx": 0.3}},
                              "leg2": {"joint2": {"z": 3, "rx": 0.2}},
                              "leg3": {"joint3": {"z": -1, "rz": 5}}})
    found = exported(path)
    assert not found.not_expressed and found.after.max < 1e-8 and found.before.rms > 1e-4
    notes = " ".join(found.notes)
    assert "base points of leg1" in notes and "into HOME_OFFSET" in notes
    new = {n.name: (n.old, n.new) for n in found.numbers}
    old, value = new["genhexkins.base.0.x"]
    assert value - old == pytest.approx(2.0, abs=1e-6)
    assert new["[JOINT_1] shift"] == (0.0, pytest.approx(3.0, abs=1e-4))


def test_effects_are_listed_without_a_cost(tmp_path: Path) -> None:
    path = changed(tmp_path, more={"effects": [
        {"kind": "backlash", "parameters": {"width": 0.02}}]}, base=0.5)
    run = ppmcal("export", "linuxcnc", path, "--json", cwd=tmp_path, expect=1).json
    assert [v["cost"] for v in run["not_expressed"]] == [None]
    assert "backlash" in run["not_expressed"][0]["what"] and run["gain"]["after"]["max"] < 1e-5


# ---------------------------------------------------------------- refusals


def test_a_machine_that_is_no_hexapod_is_refused(tmp_path: Path) -> None:
    for name in ("delta-linear", "3-RPR"):
        run = ppmcal("export", "linuxcnc", CONFIGS / f"{name}.yaml", cwd=tmp_path, expect=2)
        assert "U(P)S" in run.err and f"{name}.yaml" in run.err and not tree(tmp_path)
    machine = yaml.safe_load(UPS.read_text())
    machine["limbs"][0] |= {"kind": "(P)US", "length": 2500}
    machine["limbs"][0]["base"]["direction"] = [0, 0, 1]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(machine))
    run = ppmcal("export", "linuxcnc", "m.yaml", cwd=tmp_path, expect=2)
    assert "(P)US" in run.err and "six limbs U(P)S" in " ".join(run.err.split())


@pytest.mark.slow
def test_limits_that_leave_no_pose_are_refused(tmp_path: Path) -> None:
    path = changed(tmp_path, more={"limits": {n: [3000, 3100] for n in NAMES}})
    run = ppmcal("export", "linuxcnc", path, cwd=tmp_path, expect=3)
    assert "limits" in run.err and not (tmp_path / "exported").exists()
    narrow = changed(tmp_path, more={"limits": {n: [2600, 2660] for n in NAMES}})
    assert ppmcal("export", "linuxcnc", narrow, "--json", cwd=tmp_path, expect=0).json["poses"] > 20


@pytest.mark.parametrize(("table", "words"), [
    ("x,y,z,rx,ry,rz\n0,0,2000,0,0,\n", ["row 1", "empty coordinate"]),
    ("x,y,z,rx,ry,rz\n0,0,9000,0,0,0\n", ["none of these poses"]),
    ("x,y,z\n0,0,2000\n", ["rx, ry, rz"]),
    ("", ["poses.csv"]),
])
def test_poses_that_cannot_be_used_are_refused(tmp_path: Path, table: str, words: list[str]
                                               ) -> None:
    (tmp_path / "poses.csv").write_text(table)
    run = ppmcal("export", "linuxcnc", UPS, "--poses", "poses.csv", cwd=tmp_path, expect=2)
    assert "poses.csv" in run.err and all(w in " ".join(run.err.split()) for w in words), run.err


def test_poses_out_of_reach_are_left_aside(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text("x,y,z,rx,ry,rz\n0,0,2000,0,0,0\n0,0,9000,0,0,0\n")
    run = ppmcal("export", "linuxcnc", UPS, "--poses", "poses.csv", "--json", cwd=tmp_path,
                 expect=0).json
    assert run["poses"] == 1 and any("1 of the 2 poses" in note for note in run["notes"])


def test_reached_is_nowhere_where_struts_do_not_close(tmp_path: Path) -> None:
    drive = drive_of(read_mechanism(UPS), 1e-3)
    far = pose_motor(np.array([[0.0, 0.0, 2.0, 0, 0, 0]]))
    apart = HexapodGeometry(triples(np.full((6, 3), 9e5)), SIM.platform)
    setting = genhexkins_setting(drive)
    assert np.isnan(reached(drive, type(setting)(apart, setting.stretch, setting.shift),
                            far)).all()
    with pytest.raises(BadInput, match="six limbs"):
        drive_of(read_mechanism(CONFIGS / "delta-linear.yaml"), 1e-3)
