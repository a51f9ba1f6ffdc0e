"""Printers of both firmwares: what is nominal, what a result, calipers, noise, and beds."""

from __future__ import annotations

import csv
import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows
from helpers.paths import ROOT

from ppmcal import import_config
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.noise_estimate import with_estimated_noise
from ppmcal.calibration.fit.problem import Problem
from ppmcal.controllers.delta.geometry import DeltaGeometry
from ppmcal.controllers.delta.importer import SHRUNK
from ppmcal.controllers.klipper.lines import BLOCK
from ppmcal.io import read_campaign, read_mechanism

DATA = Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data"))
MEANT = DeltaGeometry(140.0, (210.0, 330.0, 90.0), (300.0,) * 3, (290.0,) * 3)
REAL = DeltaGeometry(140.62, (210.2, 329.7, 90.0), (300.0,) * 3, (290.4, 289.7, 290.2))
STEP = 0.0125
BED = np.array([[r * np.cos(t), r * np.sin(t), 0.0] for r, n in ((0, 1), (60, 5), (110, 8))
                for t in np.arange(n) * 2 * np.pi / n + r])


def down(g: DeltaGeometry, point: np.ndarray) -> np.ndarray:
    """Travel of the carriages below the endstops (N, 3), mm, tower by tower."""
    out = []
    for angle, arm, end in zip(np.radians(g.angles), g.arms, g.endstops, strict=True):
        foot = g.radius * np.array([np.cos(angle), np.sin(angle)])
        up = np.sqrt(arm**2 - np.sum((foot - point[:, :2]) ** 2, axis=1)) + point[:, 2]
        out.append(end + np.sqrt(arm**2 - g.radius**2) - up)
    return np.stack(out, axis=-1)


def config(saved: DeltaGeometry, real: DeltaGeometry = REAL, *, arms: str = "#arm_length: 300.0",
           pairs: float = 0.0, noise: float = 0.0, extra: str = "", body: str = "") -> str:
    """A printer.cfg after SAVE_CONFIG: earlier values commented out, results at the end.

    ``pairs``: distances are shown so many times too long, 0 for none.
    """
    rng = np.random.default_rng(4)
    out = "[printer]\nkinematics: delta\n" + (body or "#delta_radius = 140.0\n")
    for tower in "abc":
        first = f"#position_endstop: 290.0\n{arms}\n" if tower == "a" else ""
        out += f"[stepper_{tower}]\nstep_distance: {STEP}\n{first}"
    out += "\n".join([extra, *BLOCK, "#*# [printer]\n"])
    out += f"#*# delta_radius = {saved.radius:.6f}\n"
    for i, tower in enumerate("abc"):
        out += (f"#*#\n#*# [stepper_{tower}]\n#*# angle = {saved.angles[i]:.6f}\n"
                f"#*# arm_length = {saved.arms[i]:.6f}\n"
                f"#*# position_endstop = {saved.endstops[i]:.6f}\n")
    out += "#*#\n#*# [delta_calibrate]\n"
    touch = BED + rng.normal(0.0, 1.0, BED.shape) * [0.0, 0.0, noise]
    for i, at in enumerate(down(real, touch) / STEP):
        out += f"#*# height{i} = 0.0\n#*# height{i}_pos = {', '.join(f'{v:.3f}' for v in at)}\n"
    for i in range(12 if pairs else 0):
        a, b = BED[1 + i % 6], BED[7 + (3 * i) % 7]
        out += f"#*# distance{i} = {pairs * float(np.linalg.norm(a - b)):.5f}\n"
        for k, at in enumerate(down(real, np.array([a, b])) / STEP, 1):
            out += f"#*# distance{i}_pos{k} = {', '.join(f'{v:.3f}' for v in at)}\n"
    return out


def written(folder: Path, text: str) -> Path:
    path = folder / "printer.cfg"
    path.write_text(text)
    return path


# ---------------------------------------------------------------- nominal and result


def test_what_is_commented_out_is_nominal_and_what_is_saved_a_result(tmp_path: Path) -> None:
    found = import_config("klipper", written(tmp_path, config(REAL)))
    assert found.imported.printer.nominal.geometry == MEANT
    assert found.imported.printer.geometry == REAL
    assert not found.imported.printer.off and not found.findings
    found.save(tmp_path / "o")
    machine, saved = (read_mechanism(tmp_path / "o" / f"{n}.yaml") for n in ("machine", "saved"))
    place = machine.names.index("delta_radius")
    assert machine.values[place] == pytest.approx(0.140, abs=1e-12)
    assert saved.values[place] == pytest.approx(0.14062, abs=1e-12)
    # the printer's own answer is no surprise to the prior
    assert machine.parameters[place].prior_sigma >= 0.5 * (0.14062 - 0.140)


@pytest.mark.slow
def test_before_is_what_identify_says_of_the_same_files(tmp_path: Path) -> None:
    """One definition: the nominal machine on the touches, before any fit."""
    written(tmp_path, config(REAL))
    told = ppmcal("import", "klipper", "printer.cfg", "--out", "o", "--json", cwd=tmp_path,
                  expect=0).json["before"]
    ppmcal("identify", "o/machine.yaml", "o/heights.csv", "--out", "i", cwd=tmp_path)
    found = json.loads((tmp_path / "i" / "identification.json").read_text())["residual"]
    assert told["heights"]["rms"] == pytest.approx(found["before"]["position"]["rms"], rel=1e-9)
    assert told["heights"]["unit"] == "mm" and told["heights"]["rms"] > 0.05
    assert told["definition"] == found["before_is"]
    said = import_config("klipper", tmp_path / "printer.cfg").headline()
    assert f"Before: {told['heights']['rms']:.4g} mm rms on heights. \"Before\" is the" in said


def test_a_printer_without_touches_has_no_before(tmp_path: Path) -> None:
    text = config(REAL).split("#*# [delta_calibrate]")[0]
    found = import_config("klipper", written(tmp_path, text))
    assert found.imported.entries["before"] == {} and "Before" not in found.headline()


def test_numbers_that_were_edited_by_hand_are_named_with_how_much(tmp_path: Path) -> None:
    edited = DeltaGeometry(REAL.radius, REAL.angles, REAL.arms, tuple(
        e + 0.1 for e in REAL.endstops))
    found = import_config("klipper", written(tmp_path, config(edited)))
    assert found.imported.printer.off == pytest.approx(
        {f"stepper_{t}.position_endstop": 0.1 for t in "abc"}, abs=1e-3)
    (said,) = found.findings
    assert "edited by hand" in said and "+0.100 mm" in said
    run = ppmcal("import", "klipper", "printer.cfg", "--json", cwd=tmp_path, expect=1)
    assert set(run.json["saved_off"]) == set(found.imported.printer.off)
    assert run.json["nominal"]["printer.delta_radius"] == 140.0
    assert run.json["saved"]["printer.delta_radius"] == REAL.radius


@pytest.mark.slow
def test_rods_of_which_only_a_result_is_known_are_wide_and_asked_for(tmp_path: Path) -> None:
    saved = DeltaGeometry(REAL.radius, REAL.angles, (300.9, 299.7, 300.0), REAL.endstops)
    path = written(tmp_path, config(saved, arms="", pairs=1.0))
    found = import_config("klipper", path)
    assert found.imported.printer.nominal.geometry.arms == pytest.approx((300.2,) * 3)
    assert found.imported.printer.nominal.rods == 2.0
    said = found.imported.entries
    assert said["rods"] == "shared" and said["scale"] == "printed"
    assert any("--rods LENGTH" in f for f in found.findings)
    assert not any("shrunk" in f for f in found.findings)
    assert any("shrunk" in f for f in import_config("klipper", path, scale="known").findings)
    given = import_config("klipper", path, rods=(300, "single"))
    assert given.imported.printer.nominal.geometry.arms == (300.0,) * 3
    said = given.imported.entries
    assert (said["rods"], said["scale"]) == ("single", "printed")
    assert given.imported.printer.nominal.rods == 0.3
    assert not any("nominal length" in f for f in given.findings)


def test_a_placeholder_is_no_nominal_and_several_comments_are_said(tmp_path: Path) -> None:
    found = import_config("klipper", written(tmp_path, config(
        REAL, body="#delta_radius: 174.75\n#delta_radius: 99\n")))
    assert found.imported.printer.nominal.geometry.radius == REAL.radius
    assert found.imported.printer.nominal.radius == np.inf
    words = " ".join(found.findings)
    assert "99 mm in a comment of the body is 41.6 mm from the" in words
    assert "174.75, 99 are commented out" in words


def test_a_placeholder_in_force_is_not_said_to_be_another_printers(tmp_path: Path) -> None:
    """What stands uncommented in the body is what the printer prints with."""
    words = " ".join(import_config("klipper", written(tmp_path, config(
        REAL, body="delta_radius: 99\n"))).findings)
    assert "delta_radius 99 (line" in words and "wins over" in words
    assert "99 mm in the body of the file is 41.6 mm from the" in words
    assert "taken for a placeholder" in words and "never" not in words


@pytest.mark.parametrize(("rods", "words"), [("34S", "34S"), ("-3", "not a rod length"),
                                             ("nan", "not a rod length"), ("sigle", "single")])
def test_rods_that_are_none_are_refused(tmp_path: Path, rods: str, words: str) -> None:
    written(tmp_path, config(REAL))
    run = ppmcal("import", "klipper", "printer.cfg", "--rods", rods, cwd=tmp_path, expect=2)
    assert "--rods" in run.err and words in run.err
    run = ppmcal("import", "klipper", "printer.cfg", "--rods", "120", cwd=tmp_path, expect=2)
    assert "do not reach the middle" in run.err


# ---------------------------------------------------------------- noise, calipers


@pytest.mark.long
def test_a_rod_on_a_drawing_does_not_outweigh_a_caliper(tmp_path: Path) -> None:
    """The file says 300 mm, they are 304: told both ways, found, and never sure."""
    real = DeltaGeometry(140.5, REAL.angles, (304.0,) * 3, REAL.endstops)
    found = import_config("klipper", written(tmp_path, config(real, real, pairs=0.995,
                                                              noise=0.01)))
    assert found.imported.entries["scale"] == "printed"
    assert found.imported.printer.nominal.geometry.arms == (300.0,) * 3
    rods, away = re.search(r"the rods are ([\d.]+) mm; if the rods are 300 mm, the distances read "
                           r"([\d.]+) % too long", found.headline()).groups()
    assert float(rods) == pytest.approx(302.5, abs=1.5) and float(away) > 0.0
    found.save(tmp_path / "imported")
    names = [f"imported/{n}" for n in ("machine.yaml", "heights.csv", "distances.csv")]
    ppmcal("identify", *names, cwd=tmp_path)
    machine = read_mechanism(tmp_path / "identified" / "identified.yaml")
    rod = 1e3 * machine.values[machine.names.index("rod")]
    assert rod == pytest.approx(304.0, abs=1.5)
    ppmcal("report", "identified", "--out", "r", cwd=tmp_path)
    text = (tmp_path / "r" / "report.html").read_text()
    assert "With doubts" in text and "rods and the scale of distances" in text
    # rods that somebody measured are better known than the part
    stated = import_config("klipper", tmp_path / "printer.cfg", rods=304)
    assert stated.imported.entries["scale"] == "printed"
    assert stated.imported.printer.nominal.rods == 0.3


@pytest.mark.long
def test_rods_and_a_printed_part_are_known_as_far_as_the_part_is(tmp_path: Path) -> None:
    """Neither is certain, neither left open: rods that are 2 mm longer than the file has them."""
    real = DeltaGeometry(140.5, REAL.angles, (302.0,) * 3, REAL.endstops)
    path = written(tmp_path, config(real, real, pairs=0.9965, noise=0.01))
    names = [f"o/{n}" for n in ("machine.yaml", "heights.csv", "distances.csv")]
    rods: dict[str, tuple[float, float]] = {}
    for scale in ("printed", "known", "unknown"):
        import_config("klipper", path, rods="shared", scale=scale).save(tmp_path / "o", force=True)
        run = ppmcal("identify", *names, "--out", scale, "--holdout", "0", cwd=tmp_path)
        found = json.loads((tmp_path / scale / "identification.json").read_text())
        (rod,) = [p for p in found["parameters"] if p["name"] == "rod"]
        rods[scale] = rod["value"], 1.96 * rod["sigma"]
        if scale == "printed":
            words = " ".join(run.out.split())
            assert "its file says 0.995 with a standard deviation of 0.0015" in words
            machine = read_mechanism(tmp_path / scale / "identified.yaml")
            assert machine.registrations["distances"].scale == pytest.approx(0.9965, abs=0.003)
    assert abs(rods["printed"][0] - 302.0) < rods["printed"][1]
    # a part that is taken for exact misses the rods by what it shrank, and is sure of it
    assert abs(rods["known"][0] - 302.0) > rods["known"][1]
    assert rods["known"][1] < rods["printed"][1] < rods["unknown"][1]


@pytest.mark.slow
def test_what_is_known_of_printed_parts_is_written_once(tmp_path: Path) -> None:
    """0.2 to 0.8 % as the ends of a 95 % interval, said in the file that states it."""
    written(tmp_path, config(REAL, pairs=0.995))
    ppmcal("import", "klipper", "printer.cfg", "--out", "o", cwd=tmp_path)
    text = (tmp_path / "o" / "distances.yaml").read_text()
    assert "0.2 to 0.8 %" in text and "scale: {value: 0.995, sigma: 0.0015}" in text
    low, high = SHRUNK
    side = yaml.safe_load(text)["scale"]
    assert side["value"] - 1.96 * side["sigma"] == pytest.approx(low, abs=1e-4)
    assert side["value"] + 1.96 * side["sigma"] == pytest.approx(high, abs=1e-4)
    run = ppmcal("import", "klipper", "printer.cfg", "--scale", "shrunk", cwd=tmp_path, expect=2)
    assert "printed" in run.err


@pytest.mark.slow
def test_touches_alone_promise_no_more_than_the_rods_tolerance_lets_them(tmp_path: Path) -> None:
    """The rods are 303 mm, the file says 300, and nothing measured a length."""
    real = DeltaGeometry(REAL.radius, REAL.angles, (303.0,) * 3, REAL.endstops)
    path = written(tmp_path, config(MEANT, real, noise=0.01))
    import_config("klipper", path).save(tmp_path / "imported")
    run = ppmcal("identify", "imported/machine.yaml", "imported/heights.csv", cwd=tmp_path)
    words = " ".join(run.out.split())
    assert "Scale: a distance of" in words and "constrained by the prior" in words
    held = import_config("klipper", path, rods="fixed")
    held.save(tmp_path / "held")
    ppmcal("identify", "held/machine.yaml", "held/heights.csv", "--out", "exact", cwd=tmp_path)
    told, exact = (ppmcal("export", "klipper", folder, "--out", f"of-{folder}", "--json",
                          cwd=tmp_path).json["predicted"]["after"]["rms"]
                   for folder in ("identified", "exact"))
    assert told > 1.5 * exact


@pytest.mark.slow
def test_the_noise_is_estimated_unless_it_is_stated(tmp_path: Path) -> None:
    """Touches that scatter by 0.06 mm, with a sidecar that begins at 0.02."""
    written(tmp_path, config(REAL, noise=0.06))
    ppmcal("import", "klipper", "printer.cfg", cwd=tmp_path)
    run = ppmcal("identify", "imported/machine.yaml", "imported/heights.csv", cwd=tmp_path,
                 expect=0)
    words = " ".join((run.out + run.err).split())
    assert "estimated from its residuals" in words and "0.02 mm in its sidecar counts as 5" in words
    side = tmp_path / "imported" / "heights.yaml"
    found = json.loads((tmp_path / "identified" / "identification.json").read_text())
    estimated = {p["name"]: p["sigma"] for p in found["parameters"]}
    content = yaml.safe_load(side.read_text())
    content["instrument"]["sigma"]["estimated"] = False
    side.write_text(yaml.safe_dump(content))
    ppmcal("identify", "imported/machine.yaml", "imported/heights.csv", "--out", "stated",
           "--holdout", "0", cwd=tmp_path)
    found = json.loads((tmp_path / "stated" / "identification.json").read_text())
    assert found["noise"]["sigma_ratio"] > 1.5
    assert estimated["delta_radius"] > 0.0


@pytest.mark.slow
def test_calipers_that_are_all_off_take_no_touch_with_them(tmp_path: Path) -> None:
    """A part that shrank by 0.25 %: its scale is found, and no touch is blamed for it."""
    written(tmp_path, config(REAL, pairs=0.9975, noise=0.01))
    ppmcal("import", "klipper", "printer.cfg", "--rods", "300", "--rods", "fixed", cwd=tmp_path)
    args = ["imported/machine.yaml", "imported/heights.csv", "imported/distances.csv"]
    run = ppmcal("identify", *args, "--holdout", "0", cwd=tmp_path)
    said = " ".join((run.out + run.err).split())
    away = re.search(r"distances: readings come out ([\d.]+) % too short", said)
    assert away and 0.2 < float(away[1]) < 0.3, said
    used = {r["dataset"]: r["used"] for r in rows(tmp_path / "identified" / "residuals.csv")}
    assert set(used) == {"heights", "distances"}
    tree = yaml.safe_load((tmp_path / "identified" / "identified.yaml").read_text())
    assert tree["measurement"]["datasets"]["distances"]["scale"] == pytest.approx(0.9975, abs=4e-4)


@pytest.mark.long_cases("0.99-False")
@pytest.mark.slow_cases("0.99-True", "1.0025-False")
@pytest.mark.parametrize(("pairs", "bad"), [(0.99, False), (1.0025, False), (0.99, True)])
def test_no_touch_pays_for_calipers(tmp_path: Path, pairs: float, bad: bool) -> None:
    """Distances all off by one factor, scale and noise stated: touches agree with their own file.

    One that does not is left out as ever.
    """
    text = config(REAL, pairs=pairs, noise=0.003)
    if bad:
        line = next(x for x in text.splitlines() if x.startswith("#*# height6 ="))
        text = text.replace(line, "#*# height6 = 0.5")
    import_config("klipper", written(tmp_path, text), rods=(300, "shared"), scale="known").save(
        tmp_path / "o")
    for name in ("heights", "distances"):
        side = tmp_path / "o" / f"{name}.yaml"
        side.write_text(side.read_text().replace(", estimated: true", "").replace(
            "height: 0.02", "height: 0.005"))
    mechanism = read_mechanism(tmp_path / "o" / "machine.yaml")
    data = read_campaign([tmp_path / "o" / f"{n}.csv" for n in ("heights", "distances")],
                         mechanism)
    fit = identify(Problem(mechanism, data, mechanism.free), FitOptions())
    assert set(fit.reasons[0]) == ({6} if bad else set())


@pytest.mark.slow
@pytest.mark.parametrize("row", [2, 7])    # 7 used to pass for noise
def test_a_wrong_distance_does_not_pass_for_noise_of_its_file(tmp_path: Path, row: int) -> None:
    """Nine touches and twelve distances, noise estimated: one that is misread by 1 mm is named."""
    text = config(REAL, pairs=1.0, noise=0.03)
    text = "\n".join(x for x in text.splitlines() if not re.match(r"#\*# height(9|1\d)", x))
    import_config("klipper", written(tmp_path, text), rods=(300, "fixed"), scale="known").save(
        tmp_path / "o")
    machine = read_mechanism(tmp_path / "o" / "machine.yaml")
    heights, distances = read_campaign(
        [tmp_path / "o" / f"{n}.csv" for n in ("heights", "distances")], machine)
    rng = np.random.default_rng(3)
    value = distances.value + rng.normal(0.0, 0.05e-3, 12)
    value[row] -= 1e-3
    fit, _ = with_estimated_noise(
        Problem(machine, (heights, replace(distances, value=value)), machine.free), FitOptions())
    assert [np.flatnonzero(~k).tolist() for k in fit.keep] == [[], [row]]


@pytest.mark.slow
def test_console_and_table_say_the_same_of_a_row_that_was_left_out(tmp_path: Path) -> None:
    text = config(REAL, noise=0.01)
    line = next(x for x in text.splitlines() if x.startswith("#*# height4 ="))
    written(tmp_path, text.replace(line, "#*# height4 = 0.8"))
    ppmcal("import", "klipper", "printer.cfg", cwd=tmp_path)
    run = ppmcal("identify", "imported/machine.yaml", "imported/heights.csv", cwd=tmp_path)
    (row,) = [r for r in rows(tmp_path / "identified" / "residuals.csv") if r["reason"]]
    times = float(row["reason"].split(":")[1].split()[0])
    words = " ".join((run.out + run.err).split())
    said = words.partition(" times the noise)")[0].split(" off by ")[-1]
    assert float(said) == pytest.approx(times, rel=0.01)


# ---------------------------------------------------------------- beds


def mesh_lines(heights: np.ndarray, ends: tuple[float, float, float, float]) -> str:
    out = "#*#\n#*# [bed_mesh default]\n#*# version = 1\n#*# points =\n"
    for row in heights:
        out += "#*# \t  " + ", ".join(f"{v:.6f}" for v in row) + "\n"
    out += "".join(f"#*# {key} = {v}\n" for key, v in zip(
        ("min_x", "max_x", "min_y", "max_y"), ends, strict=True))
    return out + f"#*# x_count = {len(heights[0])}\n#*# y_count = {len(heights)}\n"


@pytest.mark.slow
def test_a_saved_mesh_becomes_touches_to_and_fro(tmp_path: Path) -> None:
    """A round bed of 5 x 5 points probed beside the nozzle: 13 were touched."""
    heights = np.arange(25.0).reshape(5, 5) / 100.0
    extra = "[bltouch]\nx_offset: 6\ny_offset: -4\nz_offset: 1.5\n[bed_mesh]\nmesh_radius: 100\n"
    path = written(tmp_path, config(REAL, extra=extra) + mesh_lines(
        heights, (-100.0, 100.0, -100.0, 100.0)))
    found = import_config("klipper", path, mesh="default")
    touches = np.array(found.imported.printer.meshes[0].rows)
    side = np.linspace(-100.0, 100.0, 5)
    order = [(0, 2), *((1, c) for c in (3, 2, 1)), *((2, c) for c in range(5)),
             *((3, c) for c in (3, 2, 1)), (4, 2)]
    nozzle = np.array([[side[c] - 6.0, side[r] + 4.0, heights[r, c] + 1.5] for r, c in order])
    np.testing.assert_allclose(touches[:, 1:4], down(REAL, nozzle), atol=1e-9)
    assert (touches[:, 0] == 1.5).all()
    assert touches[:, 4].tolist() == [1.0, *[-1.0] * 3, *[1.0] * 5, *[-1.0] * 3, 1.0]
    ppmcal("import", "klipper", "printer.cfg", "--mesh", "default", cwd=tmp_path, expect=0)
    side_car = yaml.safe_load((tmp_path / "imported" / "mesh_default.yaml").read_text())
    assert side_car["frame"] == "unknown" and side_car["instrument"]["sigma"]["estimated"]
    run = ppmcal("import", "klipper", "printer.cfg", "--mesh", "defualt", cwd=tmp_path, expect=2)
    assert "Did you mean 'default'" in run.err


def test_a_log_of_touches_is_a_mesh(tmp_path: Path) -> None:
    lines = [f"// probe at {x:.3f},{y:.3f} is z={0.01 * n:.6f}"
             for n, (x, y) in enumerate([(0, 0), (0, 0), (40, 0), (40, 30), (0, 30), (-40, 30)])]
    (tmp_path / "klippy.log").write_text("\n".join(lines))
    path = written(tmp_path, config(REAL))
    found = import_config("klipper", path, mesh=tmp_path / "klippy.log").imported.printer.meshes[0]
    touches = np.array(found.rows)
    assert found.name == "klippy" and touches[2:, 4].tolist() == [1.0, 1.0, -1.0, -1.0]
    np.testing.assert_allclose(touches[2, 1:4], down(REAL, np.array([[40.0, 0.0, 0.02]]))[0],
                               atol=1e-9)


MAP = """RepRapFirmware height map file v2 generated at 2026-01-01 10:00, mean error 0.0
xmin,xmax,ymin,ymax,radius,xspacing,yspacing,xnum,ynum
-80.00,80.00,-80.00,80.00,85.00,80.00,80.00,3,3
      0,  0.010,      0
  0.020,  0.000, -0.030
      0,  0.040,      0
"""
CONFIG_G = """M665 R140 L300 B110 H290 X0.2 Y-0.3 Z0
M666 X0.4 Y-0.3 Z0.2 A0.5 B-0.2
G31 P500 X-16.0 Y3 Z2.5 ; the probe
M501
"""


def test_a_height_map_becomes_touches(tmp_path: Path) -> None:
    (tmp_path / "config.g").write_text(CONFIG_G)
    (tmp_path / "heightmap.csv").write_text(MAP)
    run = ppmcal("import", "reprap", "config.g", "--mesh", "heightmap.csv", "--json",
                 cwd=tmp_path, expect=1)
    assert run.json["meshes"] == {"heightmap": 5}
    assert any("M501" in f for f in run.json["findings"])
    table = np.array([[float(v) for v in r.values()] for r in rows(
        tmp_path / "imported" / "mesh_heightmap.csv")])
    points = np.array([[0, -80, 0.01], [80, 0, -0.03], [0, 0, 0.0], [-80, 0, 0.02], [0, 80, 0.04]])
    nozzle = points - [-16.0, 3.0, -2.5]
    level = nozzle + np.array([0, 0, 1.0]) * (nozzle @ [0.005, -0.002, 0.0])[:, None]
    now = DeltaGeometry(140.0, (210.2, 329.7, 90.0), (300.0,) * 3, (290.4, 289.7, 290.2))
    np.testing.assert_allclose(table[:, 1:4], down(now, level), atol=1e-9)
    assert table[:, 4].tolist() == [1.0, -1.0, -1.0, -1.0, 1.0] and (table[:, 0] == 2.5).all()
    machine = read_mechanism(tmp_path / "imported" / "machine.yaml")
    assert machine.values[machine.names.index("delta_radius")] == pytest.approx(0.14)
    # without heights of its own a result shows the touches
    shown = import_config("reprap", tmp_path / "config.g", mesh=tmp_path / "heightmap.csv")
    assert "dir_x" in shown._repr_html_() and len(shown.to_frame()["dir_x"]) == 5
    bare = import_config("reprap", tmp_path / "config.g")
    assert "import" in bare._repr_html_() and any("--mesh" in f for f in bare.findings)


def test_what_reprapfirmware_saved_is_a_result(tmp_path: Path) -> None:
    (tmp_path / "config.g").write_text("M665 R140 L300 B110 H290\nM501\n")
    (tmp_path / "config-override.g").write_text("M665 R140.62 H290.1 X0.2 Y-0.3\nM666 X0.3 Y-0.4\n")
    (tmp_path / "heightmap.csv").write_text(MAP)
    found = import_config("reprap", tmp_path / "config.g", mesh=tmp_path / "heightmap.csv")
    assert found.imported.printer.nominal.geometry.radius == 140.0
    assert found.imported.printer.geometry.radius == 140.62 and "saved.yaml" in found.files()
    assert not found.findings


@pytest.mark.parametrize(("old", "new", "words"), [
    ("RepRapFirmware height map", "my bed", "line 1"), ("xnum", "xn", "xnum"),
    (",3,3", ",3,4", "rows of heights"), ("0.010,", "0.010;", "line 4"),
    ("0.020", "0.O20", "line 5"), ("80.00,80.00,3", "80.00,0.00,3", "form a grid"),
    (",3,3", ",1e9,3", "xnum is missing, or not a number up to"),
    (",3,3", ",1001,3", "form a grid"), (",3,3", ",nan,3", "xnum")])
def test_a_broken_height_map_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in MAP
    (tmp_path / "config.g").write_text(CONFIG_G)
    (tmp_path / "map.csv").write_text(MAP.replace(old, new, 1))
    run = ppmcal("import", "reprap", "config.g", "--mesh", "map.csv", "--out", "o", cwd=tmp_path,
                 expect=2)
    assert "map.csv" in run.err and words in run.err and not (tmp_path / "o").exists()


# ---------------------------------------------------------------- real printers

needs_data = pytest.mark.skipif(not (DATA / "delta-meshes").is_dir(),
                                reason="real measurements are not at hand (PPMCAL_DATA)")


def numbers_of(geometry: dict, body: bool, rods: bool = True) -> str:
    """A printer.cfg's sections with a geometry, as body or as what was saved."""
    lead = "" if body else "#*# "
    out = f"{lead}[printer]\n" + ("kinematics: delta\n" if body else "")
    out += f"{lead}delta_radius: {geometry['radius']}\n"
    for i, t in enumerate("abc"):
        out += f"{lead}[stepper_{t}]\n"
        if body:
            out += f"step_distance: {geometry['stepdists'][i]}\n"
        out += (f"{lead}angle: {geometry['angles'][i]}\n"
                f"{lead}position_endstop: {geometry['endstops'][i]}\n")
        out += f"{lead}arm_length: {geometry['arms'][i]}\n" if rods else ""
    return out


@pytest.mark.slow
@needs_data
def test_saved_numbers_of_real_printers_are_what_their_touches_give(tmp_path: Path) -> None:
    """All but the three that their owners edited by hand."""
    off = []
    for path in sorted((DATA / "delta-events").glob("*.json")):
        event = json.loads(path.read_text())
        text = numbers_of(event["geometry_start"], True) + numbers_of(
            event["geometry_saved"], False) + "#*# [delta_calibrate]\n"
        for i, row in enumerate(event["heights"]):
            text += f"#*# height{i}: {row[0]}\n#*# height{i}_pos: {str(row[1:])[1:-1]}\n"
        for i, row in enumerate(event["distances"]):
            text += (f"#*# distance{i}: {row[0]}\n#*# distance{i}_pos1: {str(row[1:4])[1:-1]}\n"
                     f"#*# distance{i}_pos2: {str(row[4:])[1:-1]}\n")
        found = import_config("klipper", written(tmp_path, text))
        assert found.imported.printer.nominal.geometry.arms == tuple(
            map(float, event["geometry_start"]["arms"]))
        if found.imported.printer.off:
            off.append(event["id"][:3])
    assert off == ["011", "019", "022"]


@needs_data
def test_real_beds_come_out_as_the_steps_that_were_worked_out_of_them(tmp_path: Path) -> None:
    for path in sorted((DATA / "delta-meshes").glob("*.json")):
        mesh = json.loads(path.read_text())
        with path.with_suffix(".csv").open() as stream:
            table = list(csv.DictReader(stream))
        row, col = (np.array([int(r[k]) for r in table]) for k in ("row", "col"))
        heights = np.zeros((row.max() + 1, col.max() + 1))
        heights[row, col] = [float(r["mesh_z_mm"]) for r in table]
        x, y = (np.array([float(r[f"{c}_cmd_mm"]) for r in table]) for c in "xy")
        text = numbers_of(mesh["active_geometry"], True)
        text += f"[probe]\nz_offset: {mesh['probe']['z_offset']}\n"
        text += f"[bed_mesh]\nmesh_radius: {mesh['mesh_radius']}\n"
        text += mesh_lines(heights, (x.min(), x.max(), y.min(), y.max()))
        found = import_config("klipper", written(tmp_path, text), mesh="default")
        touches = np.array(found.imported.printer.meshes[0].rows)
        steps = np.array([[float(r[f"stepper_{t}_usteps"]) for t in "abc"] for r in table])
        assert np.max(np.abs(touches[:, 1:4] / mesh["active_geometry"]["stepdists"] - steps)) < 1e-3
        assert touches[:, 4].tolist() == [float(r["approach_dir_x"]) for r in table]


# ---------------------------------------------------------------- radius


@pytest.mark.slow
def test_a_radius_that_was_measured_by_hand_is_nominal(tmp_path: Path) -> None:
    path = written(tmp_path, config(REAL, body="#delta_radius: 100.0\n"))
    said = import_config("klipper", path)
    assert any("taken for a placeholder" in f for f in said.findings)
    found = import_config("klipper", path, radius=140.4)
    nominal = found.imported.printer.nominal
    assert nominal.geometry.radius == 140.4 and nominal.origin["delta_radius"] == "--radius"
    assert nominal.radius == 1.0 and not found.findings
    found.save(tmp_path / "o")
    machine = read_mechanism(tmp_path / "o" / "machine.yaml")
    place = machine.names.index("delta_radius")
    assert machine.nominals[place] == pytest.approx(0.1404, abs=1e-12)
    assert machine.parameters[place].prior_sigma == pytest.approx(0.001)
    run = ppmcal("import", "klipper", "printer.cfg", "--radius", "140.4", "--json", cwd=tmp_path,
                 expect=0)
    assert run.json["nominal_from"]["delta_radius"] == "--radius"


def test_a_radius_far_from_what_is_printed_with_is_said_and_none_refused(tmp_path: Path) -> None:
    path = written(tmp_path, config(REAL))
    found = import_config("klipper", path, radius=160.0)
    assert any("19.4 mm from the 140.62 mm" in f for f in found.findings)
    assert found.imported.printer.nominal.radius >= 19.4
    for wrong in ("0", "-3", "nan", "350"):
        run = ppmcal("import", "klipper", "printer.cfg", "--radius", wrong, cwd=tmp_path, expect=2)
        assert "radius" in run.err
    assert not (tmp_path / "imported").exists()


def test_reprap_takes_a_radius_too(tmp_path: Path) -> None:
    (tmp_path / "config.g").write_text("M665 R140 L300 B110 H290\n")
    found = import_config("reprap", tmp_path / "config.g", radius=140.7)
    assert found.imported.printer.nominal.geometry.radius == 140.7
    assert found.imported.printer.geometry.radius == 140.0    # what touches were made with
    assert found.imported.printer.nominal.origin["delta_radius"] == "--radius"
    assert not any("--radius" in f for f in found.findings)


# ---------------------------------------------------------------- freedoms


@pytest.mark.long
def test_freedoms_are_left_to_what_predicts_best_unless_chosen(tmp_path: Path) -> None:
    path = written(tmp_path, config(REAL, pairs=1.0, noise=0.01))
    for rods, optional in (((), True), ((300,), True), (("shared",), False)):
        found = import_config("klipper", path, rods=rods)
        found.save(tmp_path / "o")
        machine = read_mechanism(tmp_path / "o" / "machine.yaml")
        assert bool(machine.optional) == optional
        assert not any("direction" in machine.names[i] for i in machine.free)
    # this part has not shrunk: the distances tell of rods that are 300 mm long all the same
    import_config("klipper", path, scale="known").save(tmp_path / "o")
    run = ppmcal("identify", "o/machine.yaml", "o/heights.csv", "o/distances.csv", cwd=tmp_path)
    assert "Cross-validation error (x noise" in " ".join(run.out.split())
    told = json.loads((tmp_path / "identified" / "identification.json").read_text())["freedoms"]
    # towers stand upright: what is kept is what the file frees
    assert [s["kept"] for s in told["sets"]] == [True, True, False]
    ppmcal("identify", "o/machine.yaml", "o/heights.csv", "o/distances.csv", "--free", "*.offset",
           "--out", "own", cwd=tmp_path)
    assert json.loads((tmp_path / "own" / "identification.json").read_text())["freedoms"] is None


def test_one_flat_alone_frees_no_leaning_towers(tmp_path: Path) -> None:
    """It cannot tell them from the bed's own shape."""
    found = import_config("klipper", written(tmp_path, config(REAL)))
    found.save(tmp_path / "o")
    assert read_mechanism(tmp_path / "o" / "machine.yaml").optional == ()
