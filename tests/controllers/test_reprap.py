"""M665 and M666 of RepRapFirmware: what is read, what is written, and what it is worth."""

from __future__ import annotations

import random
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, tree
from helpers.paths import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

from ppmcal.controllers.delta import geometry
from ppmcal.controllers.delta.fit import error_summary, project
from ppmcal.controllers.delta.geometry import drive_of, driven
from ppmcal.controllers.reprap.controller import (
    REPRAP,
    Delta,
    delta_of,
    format_delta,
    geometry_of,
    parse,
    read_delta,
    travel,
)
from ppmcal.io import read_mechanism

CONFIGS = ROOT / "configs"
TOP = 520.0
"""Carriage heights of delta-linear at its endstops, mm."""
OVERRIDE = """; config-override.g file generated in response to M500 at 2024-01-01 10:00
; This is a system-generated file - do not edit
; Delta parameters
M665 L249.700:250.100:250.000 R124.448 H303.459 B85.0 X-0.121 Y-0.228 Z0.100
M666 X-0.069 Y-0.135 Z0.204 A0.20 B-0.10
; Heater model parameters
M307 H0 A139.0 C670.6 D1.0 S1.00 V24.0 B0
"""
OLD = Delta(124.448, (249.7, 250.1, 250.0), 303.459, (-0.121, -0.228, 0.1),
            (-0.069, -0.135, 0.204), (0.2, -0.1), 85.0)
BENT = {
    "a": {"base.point": {"radius": 160.8, "angle": 210.4, "z": 0}, "length": 250.5, "offset": 0.4},
    "b": {"base.point": {"radius": 160.1, "angle": 329.5, "z": 0}, "length": 250.1, "offset": -0.3},
    "c": {"base.point": {"radius": 159.7, "angle": 90.2, "z": 0.5}, "length": 249.6, "offset": 0.7}}


def read(text: str) -> Delta:
    return read_delta(parse(text, "config.g"))


def written(folder: Path) -> dict[str, list[float]]:
    """``M665 L`` -> numbers of reprap.g, by splitting at blanks."""
    out = {}
    for line in (folder / "exported" / "reprap.g").read_text().splitlines():
        if not line.startswith(";"):
            code, *words = line.split()
            out |= {f"{code} {w[0]}": [float(v) for v in w[1:].split(":")] for w in words}
    return out


def carriages(n: dict[str, list[float]], point: np.ndarray) -> np.ndarray:
    """Carriage heights below the endstops (N, 3), mm, after the firmware's own source."""
    r = n["M665 R"][0]
    xa, yb, zc = (np.radians(n[f"M665 {t}"][0]) for t in "XYZ")
    s = np.radians(30)
    towers = [(-r * np.cos(s + xa), -r * np.sin(s + xa)), (r * np.cos(s - yb), -r * np.sin(s - yb)),
              (-r * np.sin(zc), r * np.cos(zc))]
    x, y, z = point.T
    out = []
    for i, (tx, ty) in enumerate(towers):
        rod = (n["M665 L"] * 3)[i]
        home = n["M665 H"][0] + np.sqrt(rod**2 - r**2) + n["M666 " + "XYZ"[i]][0]
        out.append(home - (np.sqrt(rod**2 - (x - tx) ** 2 - (y - ty) ** 2) + z
                           + x * n["M666 A"][0] / 100 + y * n["M666 B"][0] / 100))
    return np.stack(out, axis=-1)


def numbers(delta: Delta) -> dict[str, list[float]]:
    return {"M665 L": list(delta.rods), "M665 R": [delta.radius], "M665 H": [delta.height],
            **{f"M665 {t}": [v] for t, v in zip("XYZ", delta.angles, strict=True)},
            **{f"M666 {t}": [v] for t, v in zip("XYZAB", (*delta.endstops, *delta.tilt),
                                                strict=True)}}


def trilaterate(feet: np.ndarray, rods: np.ndarray) -> np.ndarray:
    """The lower point at distances ``rods`` (3,) of three points (3, 3), mm."""
    ex = (feet[1] - feet[0]) / np.linalg.norm(feet[1] - feet[0])
    i = ex @ (feet[2] - feet[0])
    ey = feet[2] - feet[0] - i * ex
    ey /= np.linalg.norm(ey)
    d, j = np.linalg.norm(feet[1] - feet[0]), ey @ (feet[2] - feet[0])
    x = (rods[0] ** 2 - rods[1] ** 2 + d**2) / (2 * d)
    y = (rods[0] ** 2 - rods[2] ** 2 + i**2 + j**2) / (2 * j) - i / j * x
    up = np.sqrt(rods[0] ** 2 - x**2 - y**2) * np.cross(ex, ey)
    return min((feet[0] + x * ex + y * ey + side * up for side in (1, -1)), key=lambda v: v[2])


def plain(value: object) -> float:
    return float(value["value"] if isinstance(value, dict) else value)


def stands(machine: Path, down: np.ndarray) -> np.ndarray:
    """Where the machine of a file goes (N, 3), mm, with its carriages ``down`` (N, 3) mm."""
    limbs = yaml.safe_load(machine.read_text())["limbs"]
    feet, rods = [], []
    for limb in limbs:
        at = np.zeros(3)
        for part, sign in (("base", 1), ("platform", -1)):
            p = limb[part]["point"]
            turn = np.radians(plain(p["angle"]))
            at += sign * np.array([*plain(p["radius"]) * np.array([np.cos(turn), np.sin(turn)]),
                                   plain(p.get("z", 0))])
        feet.append(at + [0, 0, TOP + plain(limb.get("offset", 0))])
        rods.append(plain(limb["length"]))
    return np.array([trilaterate(np.array(feet) - np.outer(d, [0, 0, 1]), np.array(rods))
                     for d in down])


def laid(at: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """What is left (N,) after the best turn about z and shift in the plane."""
    a, w = at - at.mean(axis=0), wanted - wanted.mean(axis=0)
    u, _, v = np.linalg.svd(a[:, :2].T @ w[:, :2])
    turn = v.T @ np.diag([1, np.linalg.det(v.T @ u.T)]) @ u.T
    return np.linalg.norm(np.column_stack([a[:, :2] @ turn.T - w[:, :2], at[:, 2] - wanted[:, 2]]),
                          axis=1)


POINTS = np.array([[r * np.cos(t), r * np.sin(t), z] for r, n in ((0, 1), (50, 6), (100, 9))
                   for t in np.arange(n) * 2 * np.pi / n + r for z in (0.0, 40.0, 100.0)])


def changed(tmp_path: Path, change: dict[str, dict], drawn: bool = False) -> Path:
    """``delta-linear`` with limbs' entries replaced; ``drawn``: the drawing stays as it is."""
    machine = yaml.safe_load((CONFIGS / "delta-linear.yaml").read_text())
    for limb in machine["limbs"]:
        for path, value in change.get(limb["name"], {}).items():
            *parents, last = path.split(".")
            place = limb
            for key in parents:
                place = place[key]
            if drawn and last == "point":
                value = {k: {"value": v, "nominal": plain(place[last][k])}
                         for k, v in value.items()}
            elif drawn and last in ("length", "offset"):
                value = {"value": value, "nominal": plain(place[last])}
            place[last] = value
    path = tmp_path / "m.yaml"
    path.write_text(yaml.safe_dump(machine))
    return path


# ---------------------------------------------------------------- what a file says


def test_what_m500_saves_is_read() -> None:
    assert read(OVERRIDE) == OLD


@pytest.mark.parametrize(("text", "wanted"), [
    ("M665 R105.6 L215.0 B85 H235 ; set delta radius\nM666 X0 Y0 Z0",
     Delta(105.6, (215.0,) * 3, 235.0, bed=85.0)),
    ("m665h235l215r105.6\n", Delta(105.6, (215.0,) * 3, 235.0)),
    ("M665 R1 L2 H3\nM665 R105.6 L215\n  M665 H 235 ; M665 H1\n;M665 H4",
     Delta(105.6, (215.0,) * 3, 235.0)),
    ("G21 M665 L215:215.5:216 R.1056E3 H2350e-1 M666 y-.5 G90",
     Delta(105.6, (215.0, 215.5, 216.0), 235.0, endstops=(0.0, -0.5, 0.0))),
    ('M550 P"a;b M665 R1"\nM665 L215 R105.6 H235\nM117 use M665 R1\nM6650 R2\nM665.1 R3\n'
     'echo "M665 R4"\nset global.x = {M665}\nhello M665 R5\nM665\nN5 M666 A0.5 B-1 \n',
     Delta(105.6, (215.0,) * 3, 235.0, tilt=(0.5, -1.0))),
    ("if true\n  G90\n  if false\n    G91\nM665 L215 R105.6 H235\nM92 X{var.s}\n",
     Delta(105.6, (215.0,) * 3, 235.0)),
    ("\ufeffM665 L215 R105.6 H235 Z1 X-2\r\nM666 X1 Y1 Z1\r\n",
     Delta(105.6, (215.0,) * 3, 235.0, (-2.0, 0.0, 1.0), (1.0,) * 3)),
])
def test_forms_that_the_firmware_takes(text: str, wanted: Delta) -> None:
    assert read(text.removeprefix("\ufeff")) == wanted


LENGTH = st.floats(100, 999)
SMALL = st.tuples(*[st.floats(-9.9, 9.9)] * 3)


@settings(max_examples=60, deadline=None)
@given(st.floats(1, 99.9), st.tuples(LENGTH, LENGTH, LENGTH), LENGTH,
       st.tuples(*[st.floats(-180, 180)] * 3), SMALL, SMALL, st.none() | st.floats(1, 999))
def test_what_is_written_reads_back_equal(radius: float, rods: tuple, height: float, angles: tuple,
                                          ends: tuple, tilt: tuple, bed: float | None) -> None:
    delta = Delta(radius, rods, height, angles, ends, tilt[:2], bed).rounded()
    text = format_delta(delta, "a\nM665 R1\r\n\"b")
    assert read(text) == delta == delta.rounded()
    assert max(len(line) for line in text.splitlines()) < 100


@settings(max_examples=60, deadline=None)
@given(st.floats(80, 99.9), st.tuples(*[st.floats(200, 400)] * 3), LENGTH,
       st.tuples(*[st.floats(-20, 20)] * 3), SMALL, st.tuples(st.floats(-2, 2), st.floats(-2, 2)))
def test_the_arithmetic_is_the_firmwares(radius: float, rods: tuple, height: float, angles: tuple,
                                         ends: tuple, tilt: tuple) -> None:
    delta = Delta(radius, rods, height, angles, ends, tilt)
    points = POINTS * [0.8, 0.8, 1.0]
    down = travel(delta, points * 1e-3)
    np.testing.assert_allclose(down * 1e3, carriages(numbers(delta), points), atol=1e-9)
    # as Klipper's, but for the tilt; H and the endstops are told apart by a mean of 0
    again = delta_of(geometry_of(delta), delta)
    assert sum(again.endstops) == pytest.approx(0.0, abs=1e-9)
    level = Delta(radius, rods, height, angles, ends)
    np.testing.assert_allclose(travel(again, points * 1e-3), travel(level, points * 1e-3),
                               atol=1e-12)
    np.testing.assert_allclose(geometry.travel(geometry_of(delta), points * 1e-3),
                               travel(level, points * 1e-3), atol=1e-12)


def test_trilateration_of_the_firmwares_carriages_is_the_point() -> None:
    n = numbers(OLD)
    turn = np.radians([210 + OLD.angles[0], 330 + OLD.angles[1], 90 + OLD.angles[2]])
    feet = OLD.radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    rods = np.array(OLD.rods)
    top = OLD.height + np.sqrt(rods**2 - OLD.radius**2) + OLD.endstops
    at = np.array([trilaterate(np.column_stack([feet, top - d]), rods)
                   for d in carriages(n, POINTS)])
    at[:, 2] -= at[:, 0] * 0.002 - at[:, 1] * 0.001       # A0.20 B-0.10
    np.testing.assert_allclose(at, POINTS, atol=1e-9)


# ---------------------------------------------------------------- what the lines are worth


def test_a_bent_machine_is_driven_with_its_lines(tmp_path: Path) -> None:
    path = changed(tmp_path, BENT, drawn=True)
    run = ppmcal("export", "reprap", path, "--json", cwd=tmp_path, expect=0)
    n = written(tmp_path)
    assert len(n["M665 L"]) == 3 and n["M665 Z"] == [0.0] and "M665 B" not in n
    assert n["M666 A"] == n["M666 B"] == [0.0]
    assert abs(sum(n[f"M666 {t}"][0] for t in "XYZ")) < 2e-4
    left = laid(stands(path, carriages(n, POINTS)), POINTS)
    assert left.max() < 1e-3                              # mm, hence 1e-6 m
    gain = run.json["gain"]
    assert run.json["exact"] and gain["before"]["rms"] > 0.2 and gain["after"]["max"] < 1e-3
    notes = " ".join(run.json["notes"])
    assert "a is X, b is Y, c is Z" in notes and "turned by" in notes and "mean 0" in notes
    assert "2.03" in notes


@pytest.mark.slow
def test_single_numbers_move_alone(tmp_path: Path) -> None:
    start = project(read_mechanism(CONFIGS / "delta-linear.yaml"), REPRAP)
    assert start.after.max < 1e-7 and start.new == start.old and not start.not_expressed
    for change, moves in (
            ({t: {"length": 250.4} for t in "abc"}, {"rods": 0.4}),
            ({"b": {"base.point": {"radius": 160, "angle": 331, "z": 0},
                    "platform.point": {"radius": 35, "angle": 331, "z": 0}}}, {"angles": 1.0}),
            ({"a": {"offset": 0.3}, "b": {"offset": 0.3}, "c": {"offset": 0.3}},
             {"height": 0.3}),
            ({"a": {"offset": 0.3}, "b": {"offset": -0.3}}, {"endstops": 0.3})):
        found = project(read_mechanism(changed(tmp_path, change)), REPRAP)
        assert found.after.max < 1e-6
        for name, size in moves.items():
            apart = np.abs(np.subtract(getattr(found.new, name), getattr(start.new, name)))
            assert apart.max() == pytest.approx(size, abs=2e-4), (name, found.new)
    path = changed(tmp_path, {t: {"length": 250.4} for t in "abc"})
    longer = project(read_mechanism(path), REPRAP)
    assert "L250.4000 R" in format_delta(longer.new)      # equal rods are one number


@pytest.mark.slow
def test_the_gain_against_the_present_file(tmp_path: Path) -> None:
    path = changed(tmp_path, BENT)
    (tmp_path / "config-override.g").write_text(OVERRIDE)
    run = ppmcal("export", "reprap", path, "--old", "config-override.g", "--json", cwd=tmp_path,
                 expect=0)
    found = project(read_mechanism(path), REPRAP, OLD)
    points = found.points * 1e3
    before = stands(path, carriages(numbers(OLD), points))
    at = driven(drive_of(read_mechanism(path)), travel(OLD, found.points))
    np.testing.assert_allclose(at * 1e3, before, atol=1e-6)
    after = stands(path, carriages(written(tmp_path), points))
    for side, at in (("before", before), ("after", after)):
        left = laid(at, points)
        assert run.json["gain"][side]["rms"] == pytest.approx(np.sqrt(np.mean(left**2)), abs=1e-6)
        assert run.json["gain"][side]["max"] == pytest.approx(left.max(), abs=1e-6)
    assert run.json["gain"]["after"]["max"] < 1e-3 < run.json["gain"]["before"]["rms"]
    assert run.json["old"]["M666 A"] == 0.2 and run.json["parameters"]["M666 A"] == 0.0
    assert written(tmp_path)["M665 B"] == [85.0]
    assert "tilt of the bed" in " ".join(run.json["notes"])
    again = ppmcal("export", "reprap", path, "--old", "exported/reprap.g", "--out", "again",
                   cwd=tmp_path, expect=0)
    assert "cannot be expressed" not in again.out
    lines = [[x for x in (tmp_path / f / "reprap.g").read_text().splitlines() if x[0] != ";"]
             for f in ("exported", "again")]
    assert lines[0] == lines[1]


@pytest.mark.slow
def test_files_that_the_old_one_runs_are_named(tmp_path: Path) -> None:
    (tmp_path / "config.g").write_text('M98 P"a.g"\n' + OVERRIDE + 'M501\nM98 P"drives.g"\n')
    run = ppmcal("export", "reprap", CONFIGS / "delta-linear.yaml", "--old", "config.g",
                 cwd=tmp_path, expect=0)
    words = " ".join(run.out.split())
    assert "line 9: M501 runs another file" in words and "line 10: M98" in words
    assert "line 1: M98" not in words and "config-override.g win" in words
    assert "The endstops go" not in words
    assert "config-override.g win" in (tmp_path / "exported" / "reprap.g").read_text()
    (tmp_path / "config.g").write_text(OVERRIDE.replace("H303.4", "H272.4"))
    run = ppmcal("export", "reprap", CONFIGS / "delta-linear.yaml", "--old", "config.g",
                 "--out", "other", cwd=tmp_path, expect=0)
    assert "The endstops go +31.0 mm from where config.g" in " ".join(run.out.split())


@pytest.mark.long
def test_a_leaning_tower_is_listed_with_its_cost(tmp_path: Path) -> None:
    costs = []
    for lean in (0.002, 0.004):
        path = changed(tmp_path, {"a": {"base.direction": {"value": [lean, 0, 1],
                                                           "nominal": [0, 0, 1]}}})
        found = ppmcal("export", "reprap", path, "--json", cwd=tmp_path, expect=1).json
        assert not found["exact"] and len(found["not_expressed"]) == 1
        lack = found["not_expressed"][0]
        assert f"tower a leans by {np.degrees(lean):.4g} deg" in lack["what"]
        after = found["gain"]["after"]
        assert lack["cost"]["rms"] == pytest.approx(after["rms"], rel=1e-3)
        assert 0.0 < after["rms"] < found["gain"]["before"]["rms"]
        costs.append(after["rms"])
    assert costs[1] / costs[0] == pytest.approx(2.0, rel=0.05)
    assert "Cannot be expressed: tower a" in (tmp_path / "exported" / "reprap.g").read_text()


@pytest.mark.long
def test_the_tilt_of_the_bed_would_add_next_to_nothing(tmp_path: Path) -> None:
    lean = {"base.direction": {"value": [0.004, 0, 1], "nominal": [0, 0, 1]}}
    machine = read_mechanism(changed(tmp_path, dict.fromkeys("abc", lean)))
    found = project(machine, REPRAP)
    drive, points, new = drive_of(machine), found.points, found.new
    v = np.array([new.radius, *new.rods, *new.angles[:2],
                  *np.add(new.height, new.endstops), 0.0, 0.0])

    def left(p: np.ndarray) -> np.ndarray:
        delta = Delta(p[0], tuple(p[1:4]), 0.0, (p[4], p[5], 0.0), tuple(p[6:9]), tuple(p[9:]))
        at = driven(drive, travel(delta, points))
        laid_by = error_summary(at, points).removed
        flat = np.exp(1j * laid_by.turn) * (at[:, 0] + 1j * at[:, 1]) + complex(*laid_by.shift)
        return (np.stack([flat.real, flat.imag, at[:, 2]], axis=-1) - points).ravel() * 1e3

    slopes = np.stack([(left(v + d) - left(v - d)) / 0.02 for d in np.eye(11) * 0.01], axis=-1)
    rms = np.sqrt(np.mean(left(v) ** 2))
    for columns, least in ((9, 0.999), (11, 0.9)):
        step = np.linalg.lstsq(slopes[:, :columns], -left(v), rcond=None)[0]
        rest = left(v) + slopes[:, :columns] @ step
        assert least < np.sqrt(np.mean(rest**2)) / rms <= 1.0


@pytest.mark.slow
def test_a_changed_drive_ratio_is_told_as_steps_per_mm(tmp_path: Path) -> None:
    path = changed(tmp_path, {"c": {"ratio": {"value": 1.001, "nominal": 1.0, "tolerance": 0.01}}})
    found = project(read_mechanism(path), REPRAP)
    what = found.not_expressed[0].what
    assert "divide its steps per mm (M92)" in what and "1.001" in what


def test_towers_named_x_y_z_are_found_in_any_order(tmp_path: Path) -> None:
    text = (CONFIGS / "delta-linear.yaml").read_text()
    head, *limbs = re.split(r"(?m)^(?=  - name: )", text)
    limbs[2], tail = limbs[2].split("home:")
    for name, new, i in (("a", "X", 0), ("b", "Y", 1), ("c", "Z", 2)):
        limbs[i] = limbs[i].replace(f"name: {name} ", f"name: {new} ").replace(
            f"name: {name}\n", f"name: {new}\n")
        tail = tail.replace(f"{name}: [120", f"{new}: [120")
    (tmp_path / "m.yaml").write_text(head + "".join([limbs[2], limbs[0], limbs[1]])
                                     + "home:" + tail)
    found = project(read_mechanism(tmp_path / "m.yaml"), REPRAP)
    assert found.new.angles == (0.0, 0.0, 0.0) and found.after.max < 1e-7
    assert not any("towers:" in note for note in found.notes)


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(("old", "new", "words"), [
    ("M665", "M668", ["there is no M665", "config-override.g"]),
    ("R124.448 ", "", ["M665 R", "is missing", "default"]),
    ("H303.459", "", ["M665 H", "is missing"]),
    ("L249.700:250.100:250.000 ", "", ["M665 L", "is missing"]),
    ("R124.448", "R{var.r}", ["line 4", "M665", "expression"]),
    ("R124.448", "R", ["line 4", "'R H303.459", "letter with a number"]),
    ("R124.448", "R12O", ["line 4", "letter with a number"]),
    ("R124.448", "R1.2.3", ["line 4", "letter with a number"]),
    ("R124.448", "Rnan", ["line 4", "letter with a number"]),
    ("R124.448", 'R"124"', ["line 4", "letter with a number"]),
    ("R124.448", "R1e999", ["line 4", "too large"]),
    ("H303.459", "H1e7", ["line 4", "too large"]),
    ("R124.448", "R124:125", ["line 4", "2 numbers"]),
    ("R124.448", "R0", ["line 4", "M665 R", "not above 0"]),
    ("R124.448", "R400", ["line 4", "tower X", "does not reach the middle"]),
    ("R124.448", "R124 R125", ["line 4", "stands twice"]),
    ("R124.448", "R124.448 S2", ["line 4", "unknown parameter 'S'", "Allowed: L, R"]),
    ("B85.0", "B-1", ["line 4", "M665 B", "not above 0"]),
    ("249.700:", "249.700 :", ["line 4", "':250.100"]),
    ("249.700:", "", ["line 4", "2 rods"]),
    ("249.700", "240:245", ["line 4", "4 rods"]),
    ("Z0.204", "Z0.204 endstops", ["line 5", "M666", "'endstops"]),
    ("A0.20", "A60", ["line 5", "M666 A", "rises by 60 %"]),
    ("Z0.204", "Z0.204 U0.1", ["line 5", "unknown parameter 'U'"]),
    ("M666", "if {a}\n   M666", ["line 6", "under a condition"]),
    ("M666", "if a\n G90\nelse\n  M666", ["line 8", "under a condition"]),
])
def test_a_broken_config_is_refused(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    assert old in OVERRIDE
    (tmp_path / "config.g").write_text(OVERRIDE.replace(old, new))
    run = ppmcal("export", "reprap", CONFIGS / "delta-linear.yaml", "--old", "config.g", "--out",
                 "o", cwd=tmp_path, expect=2)
    assert all(w in run.err for w in ("config.g", *words)), run.err
    assert "Traceback" not in run.err and not (tmp_path / "o").exists()


@pytest.mark.parametrize("content", [b"", b"\x00\x01\xff", b"\xff\xfeM665", b"M665", b"M665 \xff",
                                     b"M501\n", b"{" * 500, b'"M665 R1', b"M" + b"9" * 5000])
def test_any_file_is_refused_in_words(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "p.g").write_bytes(content)
    run = ppmcal("export", "reprap", CONFIGS / "delta-linear.yaml", "--old", "p.g", cwd=tmp_path,
                 expect=2)
    assert "p.g" in run.err and "fault of ppmcal" not in run.err


@pytest.mark.long
def test_cut_and_scrambled_files_never_end_in_a_traceback(tmp_path: Path,
                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    draw = random.Random(3)
    monkeypatch.setattr("ppmcal.controllers.delta.fit.HEIGHTS", (0.0,))
    for _ in range(60):
        broken = bytearray(OVERRIDE[:draw.randrange(150, len(OVERRIDE))].encode())
        for _ in range(draw.randrange(8)):
            broken[draw.randrange(len(broken))] = draw.randrange(256)
        (tmp_path / "p.g").write_bytes(bytes(broken))
        run = ppmcal("export", "reprap", CONFIGS / "delta-linear.yaml", "--old", "p.g", "--quiet",
                     cwd=tmp_path)
        assert run.code in (0, 1, 2, 3) and "fault of ppmcal" not in run.err, run.err


@pytest.mark.slow
def test_a_machine_that_is_no_delta_is_refused(tmp_path: Path) -> None:
    for name in ("6-UPS", "delta-rotary", "3-RPR"):
        run = ppmcal("export", "reprap", CONFIGS / f"{name}.yaml", cwd=tmp_path, expect=2)
        assert "(P)US" in run.err and f"{name}.yaml" in run.err and "Klipper" not in run.err
    run = ppmcal("export", "reprap", CONFIGS / "delta-linear.yaml", "--poses", CONFIGS /
                 "delta-linear.yaml", cwd=tmp_path, expect=2)
    assert "--poses" in run.err
    (tmp_path / "far.g").write_text(OVERRIDE + "M666 X300 Z-300")
    run = ppmcal("export", "reprap", CONFIGS / "delta-linear.yaml", "--old", "far.g", cwd=tmp_path,
                 expect=3)
    assert "H of M665" in run.err
    assert set(tree(tmp_path)) == {"far.g"}
