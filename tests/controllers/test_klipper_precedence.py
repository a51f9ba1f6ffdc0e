"""Which of two numbers Klipper takes: what is imported, and the copy that an export writes.

The reader here is written after the behaviour of Klipper's own and shares no line with the
program's: body and block are parsed apart, and the block gives way.
"""

from __future__ import annotations

import configparser
import glob
import io
import os
from pathlib import Path

import pytest
from controllers.test_klipper import OLD, TRUE, apart, printer_cfg
from helpers.commands import ppmcal
from helpers.paths import ROOT

from ppmcal import import_config
from ppmcal.controllers.delta.geometry import DeltaGeometry

START = """
#*# <---------------------- SAVE_CONFIG ---------------------->
#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.
#*#
"""
BESIDE = {"radius.cfg": "[printer]\ndelta_radius: 141.5   # by hand\n",
          "ends.cfg": "[include deeper/*.cfg]\n",
          "deeper/one.cfg": "[stepper_b]\nposition_endstop: 288.5\n"}


def firmware(path: Path) -> dict[str, dict[str, str]]:
    """What Klipper holds of a configuration: section -> key -> text."""
    body, found, block = path.read_text().partition(START)
    assert "\n#*# " not in body, "Klipper would read no block at all"
    assert not found or all(x.startswith("#*#") for x in block.strip().split("\n"))
    merged = parsed("\n".join(x[4:] for x in block.split("\n")), path)
    for section, keys in parsed(body, path).items():
        merged.setdefault(section, {}).update(keys)
    return merged


def parsed(text: str, path: Path) -> dict[str, dict[str, str]]:
    parser = configparser.RawConfigParser(strict=False, inline_comment_prefixes=(";", "#"))
    buffer: list[str] = []

    def flush() -> None:
        parser.read_file(io.StringIO("\n".join(buffer)))
        buffer.clear()

    def take(text: str, path: Path) -> None:
        for line in text.split("\n"):
            bare = line.partition("#")[0]
            if bare.startswith("[include "):
                flush()
                for name in sorted(glob.glob(os.path.join(path.parent, bare[9:].strip(" ]")))):
                    take(Path(name).read_text(), Path(name))
            else:
                buffer.append(bare)
        flush()

    take(text, path)
    return {s: dict(parser.items(s)) for s in parser.sections()}


def geometry(read: dict[str, dict[str, str]]) -> DeltaGeometry:
    """The firmware's numbers; b and c fall back to a's."""
    a, b, c = (read[f"stepper_{t}"] for t in "abc")
    usual = dict(zip("abc", (210.0, 330.0, 90.0), strict=True))
    own = dict(zip("abc", (a, b, c), strict=True))

    def three(key: str) -> tuple[float, ...]:
        return tuple(float(own[t].get(key, a[key])) for t in "abc")

    return DeltaGeometry(float(read["printer"]["delta_radius"]),
                         tuple(float(own[t].get("angle", usual[t])) for t in "abc"),
                         three("arm_length"), three("position_endstop"))


def sample(where: Path) -> str:
    return (ROOT / "sample_data" / "printer" / "printer.cfg").read_text()


def uncommented(where: Path) -> str:
    """The sample with its body's values in force, as earlier samples had them."""
    text = sample(where)
    for key in ("delta_radius", "position_endstop", "arm_length"):
        text = text.replace(f"\n#{key}: ", f"\n{key}: ")
    return text


def including(where: Path) -> str:
    """A printer whose numbers stand in files beside it, and in its block too."""
    for name, text in BESIDE.items():
        (where / name).parent.mkdir(exist_ok=True)
        (where / name).write_text(text)
    return printer_cfg(OLD, TRUE).replace("[include mainsail.cfg]",
                                          "[include radius.cfg]\n[include ends.cfg]")


def unsaved(where: Path) -> str:
    """A file without a block: what it measured stands in the body."""
    return uncommented(where).replace("#*# ", "").replace("#*#\n", "\n").replace(
        "<---------------------- SAVE_CONFIG ---------------------->\nDO NOT EDIT THIS BLOCK OR "
        "BELOW. The contents are auto-generated.", "")


@pytest.mark.parametrize("make", [sample, uncommented, including, unsaved])
@pytest.mark.slow
def test_import_and_the_written_copy_are_what_klipper_reads(tmp_path: Path, make) -> None:
    path = tmp_path / "printer.cfg"
    path.write_text(make(tmp_path))
    now = firmware(path)
    found = import_config("klipper", path)
    assert found.imported.printer.geometry == geometry(now)
    found.save(tmp_path / "imported")
    out = ["--old", "printer.cfg", "--write", "--json"]
    run = ppmcal("export", "klipper", "imported/machine.yaml", *out, cwd=tmp_path)
    assert run.code in (0, 1), run.err
    copy = path.with_name("copied.cfg")
    copy.write_text((tmp_path / "exported" / "printer.cfg").read_text())
    after = firmware(copy)
    keys = run.json["parameters"]
    for name, value in keys.items():
        section, key = name.split(".")
        assert float(after[section][key]) == pytest.approx(value, abs=1e-6), name
    for section in now:
        for key, text in now[section].items():
            if f"{section}.{key}" not in keys:
                assert after[section][key].split() == text.split(), (section, key)
    # and what was nominal before is nominal still
    assert apart(import_config("klipper", copy).imported.printer.nominal.geometry,
                 found.imported.printer.nominal.geometry) < 1e-6


@pytest.mark.slow
def test_numbers_in_the_body_that_win_over_a_calibration_are_told(tmp_path: Path) -> None:
    """The calibration stays a result to compare with, and is not what it prints with."""
    path = tmp_path / "printer.cfg"
    path.write_text(uncommented(tmp_path).replace("#*# delta_radius = 140.0", "#*# delta_radius = "
                                                  "140.5").replace("= 290.0", "= 290.2"))
    found = import_config("klipper", path)
    assert found.imported.printer.geometry.radius == 140.0
    assert found.imported.printer.calibration.radius == 140.5
    (said,) = [f for f in found.findings if "wins over" in f]
    assert "delta_radius 140.0 (line 8) wins over the 140.500000" in said and "1 more" in said
    assert "saved.yaml" in found.files() and "140.5" in found.files()["saved.yaml"]


@pytest.mark.slow
def test_a_block_that_klipper_does_not_read_is_told_and_not_copied(tmp_path: Path) -> None:
    path = tmp_path / "printer.cfg"
    path.write_text(sample(tmp_path) + "[fan]\n")
    found = import_config("klipper", path)
    assert any("Klipper reads nothing of the #*# lines: line " in f for f in found.findings)
    found.save(tmp_path / "imported")
    run = ppmcal("export", "klipper", "imported/machine.yaml", "--old", path, "--write",
                 cwd=tmp_path, expect=2)
    assert "Restore them" in run.err


@pytest.mark.slow
def test_only_files_beside_are_followed_and_no_circle(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "up.cfg").write_text("[printer]\ndelta_radius: 1\n")
    path = home / "printer.cfg"
    text = printer_cfg(OLD, TRUE)
    path.write_text(text.replace("mainsail.cfg", "../up.cfg").replace(
        "[mcu]", f"[include {tmp_path}/up.cfg]\n[include *.none]\n[mcu]"))
    found = import_config("klipper", path)
    assert found.imported.printer.geometry == OLD and not found.imported.printer.included
    assert sum("not beside the file" in f for f in found.findings) == 2
    (home / "mainsail.cfg").write_text("[include mainsail.cfg]\n")
    path.write_text(text)
    run = ppmcal("import", "klipper", path, cwd=tmp_path, expect=2)
    assert "includes itself" in run.err


@pytest.mark.slow
@pytest.mark.parametrize(("words", "said"), [
    (["klipper", "m.yaml", "--write"], "--old"), (["linuxcnc", "m.yaml", "--write"], "no copy")])
def test_a_copy_wants_a_file_and_a_format(tmp_path: Path, words: list[str], said: str) -> None:
    path = tmp_path / "printer.cfg"
    path.write_text(sample(tmp_path))
    (tmp_path / "m.yaml").write_text(str(import_config("klipper", path).files()["machine.yaml"]))
    assert said in ppmcal("export", *words, cwd=tmp_path, expect=2).err
