"""M665 and M666 of Marlin: what a report says, what is written, and where carriages go with it."""

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.paths import ROOT

from ppmcal import export, import_config
from ppmcal.controllers import import_options, uses
from ppmcal.controllers.delta.geometry import DeltaGeometry
from ppmcal.controllers.delta.geometry import travel as delta_travel
from ppmcal.controllers.marlin.controller import (
    MarlinDelta,
    delta_of,
    format_delta,
    geometry_of,
    parse,
    read_delta,
    read_lines,
    travel,
)
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism

REPORT = """echo:; Linear Units:
echo:  G21 ; (mm)
echo:; Delta settings: L<diagonal rod> R<radius> H<height> S<segments per sec> ABC<rod trim>
echo:  M665 L250.30 R160.20 H270.40 S80.00 X0.30 Y-0.40 Z0.00 A0.20 B-0.10 C-0.10
echo:; Endstop adjustment:
echo:  M666 X-0.25 Y0.00 Z-0.60
echo:; PID settings:
echo:  M301 P22.20 I1.08 D114.00
"""
DELTA = MarlinDelta(160.2, 250.3, 270.4, (0.3, -0.4, 0.0), (0.2, -0.1, -0.1), (-0.25, 0.0, -0.6),
                    80.0)


def read(text):
    return read_delta(parse(text, "m503.txt"))


def homed_and_sent(n, point):
    """How far below its switch each carriage ends, mm: homed, backed off, sent to a point."""
    out = []
    for i, turn in enumerate((210.0, 330.0, 90.0)):
        a = np.radians(turn + n.angles[i])
        rod = n.rod + n.trims[i]
        tower = n.radius * np.array([np.cos(a), np.sin(a)])

        def height(x, y, z, rod=rod, tower=tower):
            return z + np.sqrt(rod**2 - (x - tower[0]) ** 2 - (y - tower[1]) ** 2)

        backed = -n.backs[i]                                # below the switch, taken for (0, 0, H)
        out.append(backed + height(0.0, 0.0, n.height) - height(*point))
    return out


@pytest.mark.parametrize("lead", ["echo:  ", "", "Recv: echo:  ", "12:01:02 > echo:", ">>> "])
def test_a_report_is_read_whatever_a_host_puts_before_its_lines(lead):
    assert read(REPORT.replace("echo:  ", lead)) == DELTA


def test_carriages_go_where_the_firmware_sends_them():
    rng = np.random.default_rng(2)
    points = rng.uniform([-60, -60, 0], [60, 60, 100], (40, 3))
    wanted = np.array([homed_and_sent(DELTA, p) for p in points])
    assert 1e3 * travel(DELTA, 1e-3 * points) == pytest.approx(wanted, abs=1e-9)
    assert travel(DELTA, 1e-3 * points) == pytest.approx(
        delta_travel(geometry_of(DELTA), 1e-3 * points), abs=1e-12)
    again = delta_of(geometry_of(DELTA), DELTA)
    assert again == DELTA.rounded()


def test_no_back_off_is_above_zero_and_old_reports_have_no_trims():
    up = DeltaGeometry(160.0, (210.0, 330.0, 90.0), (250.0,) * 3, (270.0, 270.5, 271.0))
    found = delta_of(up)
    assert found.height == 270.0 and found.backs == (0.0, -0.5, -1.0)
    assert found.trims == (0.0, 0.0, 0.0) and found.segments is None
    old = read("M665 L250 R160 H270 S100 B80 X0 Y0 Z0\nM666 X0 Y0 Z0\n")
    assert old.trims is None and delta_of(up, old).trims is None
    assert " B" not in format_delta(delta_of(up, old)).partition("M666")[0]
    differ = DeltaGeometry(160.0, (210.0, 330.0, 90.0), (250.3, 250.0, 249.7), (270.0,) * 3)
    assert delta_of(differ, old).trims == (0.3, 0.0, -0.3)
    for delta in (found, DELTA, delta_of(differ, old)):
        assert read(format_delta(delta, "a comment; M665 L1")) == delta.rounded()


@pytest.mark.slow
def test_a_printer_goes_out_as_it_came_in(tmp_path):
    """Of a machine that was changed, the new lines leave nothing of what they were worth."""
    (tmp_path / "m503.txt").write_text(REPORT)
    ran = ppmcal("import", "marlin", "m503.txt", cwd=tmp_path, expect=1)
    assert "a delta printer with 0 heights" in ran.out + ran.err
    assert "the report holds no touches" in " ".join((ran.out + ran.err).split())
    ppmcal("export", "marlin", "imported/machine.yaml", "--old", "m503.txt", cwd=tmp_path, expect=0)
    assert read_delta(read_lines(tmp_path / "exported" / "marlin.g")) == DELTA
    tree = yaml.safe_load((tmp_path / "imported" / "machine.yaml").read_text())
    for limb, by in zip(tree["limbs"], (0.4, -0.2, 0.1), strict=True):
        limb["offset"] = {"value": limb["offset"] + by, "nominal": limb["offset"]}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree))
    made = export("marlin", tmp_path / "m.yaml", old=tmp_path / "m503.txt")
    assert made.exported.after.max < 1e-6 < 1e-4 < made.exported.before.rms
    new = read_delta(parse(made.exported.files["marlin.g"], "marlin.g"))
    assert max(new.backs) == 0.0 and new.segments == 80.0
    assert new.height - np.array(new.backs) == pytest.approx(
        DELTA.height - np.array(DELTA.backs) + [0.4, -0.2, 0.1], abs=2e-4)
    told = " ".join(str(n) for n in made.exported.notes)
    assert "lowest endstop" in told and "A, B and C of M665" in told


@pytest.mark.slow
def test_a_leaning_tower_is_told_with_its_cost(tmp_path):
    tree = yaml.safe_load((ROOT / "configs" / "delta-linear.yaml").read_text())
    tree["limbs"][0]["base"]["direction"] = [0.01, 0.0, 1.0]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree))
    made = export("marlin", tmp_path / "m.yaml")
    (lack,) = made.exported.not_expressed
    assert "leans by" in lack.what and lack.cost.rms > 1e-6


@pytest.mark.parametrize(("text", "words"), [
    ("M666 X0 Y0 Z0\n", "there is no M665"),
    ("M665 R160 H270\n", "M665 L: is missing"),
    ("M665 L150 R160 H270\n", "does not reach the middle"),
    ("M665 L250 R160 H270\nM666 X0.2\n", "0.2 is above 0, and Marlin refuses it"),
    ("M665 L250 R160 H270 Q3\n", "unknown parameter 'Q'"),
    ("M665 L250:251 R160 H270\n", "2 numbers stand here"),
])
def test_a_broken_report_is_refused(text, words):
    with pytest.raises(BadInput, match=words):
        read(text)


def test_what_else_is_refused(tmp_path):
    (tmp_path / "x").write_bytes(b"M665\0")
    with pytest.raises(BadInput, match="not a text file"):
        import_config("marlin", tmp_path / "x")
    with pytest.raises(BadInput, match=r"\(P\)US"):
        export("marlin", ROOT / "configs" / "3-RPR.yaml")
    (tmp_path / "m503.txt").write_text(REPORT)
    far = import_config("marlin", tmp_path / "m503.txt", radius=170.0, rods=251.0)
    assert any("--radius 170" in str(f) for f in far.findings)


def test_help_says_each_word_once_and_what_to_do_with_an_imported_machine():
    assert import_options()["radius"].help.count("R of M665") == 1
    machine = read_mechanism(ROOT / "configs" / "delta-linear.yaml")
    (told,) = uses(machine, "fit", "marlin", "m503.txt")
    assert told.startswith("ppmcal export marlin fit --old m503.txt writes the lines")
