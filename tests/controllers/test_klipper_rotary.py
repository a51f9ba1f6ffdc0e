"""Klipper's rotary deltas: printer.cfg to machine and back, by arithmetic of their own.

The firmware's arithmetic here is written after its C source, elbow by elbow; where arms stand is
solved for by spheres.
"""

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal

from ppmcal import export, import_config
from ppmcal.controllers.klipper.config import config_lines, parse_config, read_config
from ppmcal.controllers.klipper.rotary import (
    RotaryDelta,
    arm_angles,
    read_motor_step,
    read_rotary,
)
from ppmcal.errors import BadInput

MEANT = RotaryDelta(33.9, 412.9, (30.0, 150.0, 270.0), (170.0,) * 3, (320.0,) * 3, (252.0,) * 3)
TRUE = RotaryDelta(34.6, 412.1, (30.4, 149.7, 270.0), (170.3, 169.8, 170.1), (320.4, 319.7, 320.2),
                   (251.4, 252.8, 252.1))
GEAR = "107.000:16, 60:16"
STEP = 360.0 / (200 * 16 * 107 / 16 * 60 / 16)


def angle(n, i, x, y, z):
    """The motor's angle as the firmware's source has it: a line through both elbows."""
    turn = np.radians(n.angles[i])
    across = y * np.cos(turn) - x * np.sin(turn)
    dx = x * np.cos(turn) + y * np.sin(turn) - n.radius
    dy = z - n.height
    upper2, lower2 = n.upper[i] ** 2, n.lower[i] ** 2 - across**2
    c1, c2 = 0.5 / dy * (dx * dx + dy * dy + upper2 - lower2), dx / dy
    scale = c2 * c2 + 1.0
    ex = c1 * c2 + np.sqrt(scale * upper2 - c1 * c1)
    return np.arctan2(c1 * scale - c2 * ex, ex)


def travels(n, point):
    """Turns below the endstops, degrees."""
    return np.degrees([angle(n, i, 0.0, 0.0, n.endstops[i]) - angle(n, i, *point)
                       for i in range(3)])


def printer_cfg(n, heights=(), distances=()):
    lines = ["[printer]", "kinematics: rotary_delta", f"shoulder_radius: {n.radius}",
             f"shoulder_height: {n.height}"]
    for i, arm in enumerate("abc"):
        lines += [f"[stepper_{arm}]", f"gear_ratio: {GEAR}", "microsteps: 16",
                  f"angle: {n.angles[i]}", f"upper_arm_length: {n.upper[i]}",
                  f"lower_arm_length: {n.lower[i]}", f"position_endstop: {n.endstops[i]}"]
    lines += ["[delta_calibrate]", "radius: 60"]
    for k, steps in enumerate(heights):
        lines += [f"height{k}: 0.0", f"height{k}_pos: {', '.join(f'{s:.3f}' for s in steps)}"]
    for k, (size, one, two) in enumerate(distances):
        lines += [f"distance{k}: {size:.6f}",
                  f"distance{k}_pos1: {', '.join(f'{s:.3f}' for s in one)}",
                  f"distance{k}_pos2: {', '.join(f'{s:.3f}' for s in two)}"]
    return "\n".join(lines) + "\n"


def touched(n):
    """Steps at touches of the bed, and distances, of a machine that is ``n``."""
    places = [(x, y, 0.0) for x in (-60, -30, 0, 30, 60) for y in (-60, -30, 0, 30, 60)]
    ends = [(np.array([40.0 * np.cos(t), 40.0 * np.sin(t), 2.0]),
             np.array([-45.0 * np.cos(t), -38.0 * np.sin(t), 2.0])) for t in np.arange(0, 6, 0.7)]
    return ([travels(n, p) / STEP for p in places],
            [(np.linalg.norm(a - b), travels(n, a) / STEP, travels(n, b) / STEP)
             for a, b in ends])


@pytest.fixture(scope="module")
def printer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rotary")
    (folder / "printer.cfg").write_text(printer_cfg(MEANT, *touched(TRUE)))
    return folder


def test_angles_are_those_of_the_firmwares_source():
    rng = np.random.default_rng(1)
    points = rng.uniform([-80, -80, 0], [80, 80, 60], (50, 3))
    ours = arm_angles(TRUE, 1e-3 * points)
    assert ours == pytest.approx(np.array([[angle(TRUE, i, *p) for i in range(3)]
                                           for p in points]), abs=1e-12)
    assert np.isnan(arm_angles(TRUE, np.array([[2.0, 0.0, 0.0]]))).any()


def test_a_printer_goes_out_as_it_came_in(tmp_path):
    """Through machine.yaml: its joints stand where the firmware sends them."""
    (tmp_path / "printer.cfg").write_text(printer_cfg(TRUE))
    found = import_config("klipper", tmp_path / "printer.cfg")
    assert "a rotary delta with 0 heights" in found.headline()
    assert "no measured heights" in found.findings[0]
    found.save(tmp_path / "in")
    made = export("klipper", tmp_path / "in" / "machine.yaml")
    assert made.exported.after.max < 1e-9
    new = {n.name: n.new for n in made.exported.numbers}
    assert new == pytest.approx(dict(TRUE.named()), abs=2e-6)
    assert read_rotary(parse_config("[printer]\nkinematics: rotary_delta\n" + made.exported.files[
        "klipper.cfg"], "klipper.cfg")) == RotaryDelta.of(np.array(list(
            read_rotary(read_config(tmp_path / "printer.cfg")).array()))).rounded()


@pytest.mark.long
def test_touches_and_distances_find_the_printer(printer):
    """Identified from its own file, its new numbers bring it where it is told to within 0.02 mm."""
    for words in (("import", "klipper", "printer.cfg"),
                  ("identify", "imported/machine.yaml", "imported/heights.csv",
                   "imported/distances.csv", "--quiet"),
                  ("export", "klipper", "identified", "--old", "printer.cfg")):
        ran = ppmcal(*words, cwd=printer)
        assert ran.code in (0, 1), ran.err + ran.out
    new = read_rotary(parse_config("[printer]\nkinematics: rotary_delta\n" + (
        printer / "exported" / "klipper.cfg").read_text(), "klipper.cfg"))
    for point in ((0.0, 0.0, 0.0), (50.0, 10.0, 0.0), (-40.0, -40.0, 0.0)):
        told = [angle(new, i, 0.0, 0.0, new.endstops[i]) - angle(new, i, *point) for i in range(3)]
        true = np.radians(travels(TRUE, point))
        assert np.abs(np.array(told) - true).max() * 170.0 < 0.3
    ran = ppmcal("export", "klipper", "identified", "--old", "printer.cfg", "--write", cwd=printer)
    assert ran.code == 2 and "copies are written of linear deltas alone" in ran.err


@pytest.mark.slow
def test_what_one_radius_cannot_hold_is_fitted_and_told(tmp_path):
    (tmp_path / "printer.cfg").write_text(printer_cfg(TRUE))
    import_config("klipper", tmp_path / "printer.cfg").save(tmp_path / "in")
    tree = yaml.safe_load((tmp_path / "in" / "machine.yaml").read_text())
    tree["limbs"][0]["base"]["point"]["radius"] = {"value": 35.6, "nominal": 34.6}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree))
    made = export("klipper", tmp_path / "m.yaml")
    (lack,) = made.exported.not_expressed
    assert "shoulders at radii" in lack.what
    assert 1e-7 < made.exported.after.rms < 0.5 * made.exported.before.rms


def test_a_change_of_z_with_temperature_is_told_and_not_written(tmp_path):
    """The section needs a stepper_z, with which no delta starts; its arithmetic gives the sign."""
    (tmp_path / "printer.cfg").write_text(printer_cfg(TRUE))
    import_config("klipper", tmp_path / "printer.cfg").save(tmp_path / "in")
    tree = yaml.safe_load((tmp_path / "in" / "machine.yaml").read_text())
    tree["effects"] = [{"kind": "base_thermal", "parameters": {"expansion": 2e-5}}]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree))
    made = export("klipper", tmp_path / "m.yaml")
    (told,) = [str(n) for n in made.exported.notes if "z_thermal_adjust" in str(n)]
    assert "asks for a stepper_z" in told and "it is not written" in told
    assert "[z_thermal_adjust]" not in made.exported.files["klipper.cfg"]
    rise = float(told.split("temp_coeff: ")[1].split()[0])
    assert rise == pytest.approx(2e-5 * TRUE.height, rel=0.2)    # shoulders rise with the frame


@pytest.mark.parametrize(("old", "new", "words"), [
    ("shoulder_radius: 33.9", "", "shoulder_radius: is missing"),
    (f"gear_ratio: {GEAR}", "", "gear_ratio: is missing"),
    (f"gear_ratio: {GEAR}", "gear_ratio: 5", "'5' is not a gear ratio"),
    ("lower_arm_length: 320.0", "lower_arm_length: 2", "does not get to the middle"),
])
def test_a_broken_file_is_refused(tmp_path, old, new, words):
    text = printer_cfg(MEANT, *touched(TRUE))
    assert old in text
    (tmp_path / "printer.cfg").write_text(text.replace(old, new, 1))
    with pytest.raises(BadInput, match="(?s)" + words.replace("'", ".")):
        import_config("klipper", tmp_path / "printer.cfg")


def test_what_else_is_refused(tmp_path):
    (tmp_path / "printer.cfg").write_text(printer_cfg(TRUE))
    with pytest.raises(BadInput, match="imported as its file has it"):
        import_config("klipper", tmp_path / "printer.cfg", radius=30.0)
    import_config("klipper", tmp_path / "printer.cfg").save(tmp_path / "in")
    machine = tmp_path / "in" / "machine.yaml"
    with pytest.raises(BadInput, match="takes numbers, not poses"):
        export("klipper", machine, poses=machine)
    tree = yaml.safe_load(machine.read_text())
    for limb in tree["limbs"]:
        limb["base"]["point"]["z"] = 2.0
    tree["home"]["pose"]["z"] = -410.0
    (tmp_path / "low.yaml").write_text(yaml.safe_dump(tree))
    with pytest.raises(BadInput, match="bed is z = 0"):
        export("klipper", tmp_path / "low.yaml")
    for limb in tree["limbs"]:
        del limb["ratio"]
    (tmp_path / "open.yaml").write_text(yaml.safe_dump(tree))
    with pytest.raises(BadInput, match="endstop is not known"):
        export("klipper", tmp_path / "open.yaml")
    config = parse_config("[printer]\nkinematics: delta\n", "x.cfg")
    with pytest.raises(BadInput, match="kinematics is not rotary_delta"):
        read_rotary(config)
    assert read_motor_step(read_config(tmp_path / "printer.cfg"), "a") == pytest.approx(STEP)
    assert config_lines(MEANT.named()).startswith("[printer]\nshoulder_radius: 33.900000\n")
