"""Deltas of six rods whose probe stands beside the nozzle: what heights tell, and what more would.

Against a printer that is simulated without the package.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import ppmcal
from ppmcal.calibration.knowledge import tool_height
from ppmcal.controllers.klipper.config import read_config, read_geometry
from ppmcal.errors import BadInput
from tests.helpers.six_rod_printer import SixRodPrinter, places

PROBE = (25.0, 10.0)
PROBED = places(16, 100.0)
FRESH = places(15, 95.0)
SIGMA = 0.01


def imported(folder: Path, printer: SixRodPrinter, by_hand: np.ndarray = FRESH[:0],
             probe: tuple[float, float] = PROBE, **more: object) -> Path:
    config = printer.config(folder / "printer.cfg", probe, PROBED, by_hand, SIGMA, 5)
    ppmcal.import_config("klipper", config, **{"effector": "40,60"} | more).save(folder / "in")
    return folder / "in"


def nozzle_errors(found: object, printer: SixRodPrinter, tmp_path: Path) -> np.ndarray:
    """Return by how much the identified machine misses heights that the nozzle touched."""
    travel = [printer.down(printer.touched(p, (0.0, 0.0), 0.0)) for p in FRESH]
    table = tmp_path / "q.csv"
    table.write_text("q_a,q_b,q_c\n" + "".join(f"{a!r},{b!r},{c!r}\n" for a, b, c in (
        row.tolist() for row in travel)))
    found.save(tmp_path / "found")    # type: ignore[attr-defined]
    at = ppmcal.forward(tmp_path / "found" / "identified.yaml", table)
    return at.to_frame()["z"].to_numpy()


def test_tables_have_the_probe_where_it_stands_and_the_nozzle_apart(tmp_path: Path) -> None:
    folder = imported(tmp_path, SixRodPrinter(1), FRESH[:3])
    sidecar = yaml.safe_load((folder / "heights.yaml").read_text())
    assert sidecar["target"] == [25, 10, 0]
    assert yaml.safe_load((folder / "nozzle_heights.yaml").read_text())["target"] == "known"
    assert len((folder / "heights.csv").read_text().splitlines()) == 17
    assert len((folder / "nozzle_heights.csv").read_text().splitlines()) == 4
    machine = yaml.safe_load((folder / "machine.yaml").read_text())
    assert [limb["actuator"] for limb in machine["limbs"]] == list("aabbcc")


def test_six_rods_go_where_the_firmware_sends_them_while_they_are_alike(tmp_path: Path) -> None:
    """As designed, the machine of six rods is the firmware's, at every place and height."""
    folder = imported(tmp_path, SixRodPrinter(1, apart=0.0))
    printer = SixRodPrinter(1, apart=0.0)
    points = np.column_stack([FRESH, np.linspace(0.0, 80.0, len(FRESH))])
    table = tmp_path / "q.csv"
    table.write_text("q_a,q_b,q_c\n" + "".join(
        ",".join(map(repr, printer.down(p).tolist())) + "\n" for p in points))
    at = ppmcal.forward(folder / "machine.yaml", table).to_frame()
    np.testing.assert_allclose(at[["x", "y", "z"]].to_numpy(), points, atol=1e-5)
    np.testing.assert_allclose(at[["rx", "ry", "rz"]].to_numpy(), 0.0, atol=1e-5)


def test_what_is_open_is_said_on_import_before_the_fit_and_after_it(tmp_path: Path) -> None:
    printer = SixRodPrinter(2)
    config = printer.config(tmp_path / "printer.cfg", PROBE, PROBED, FRESH[:0], SIGMA, 5)
    made = ppmcal.import_config("klipper", config, effector="40,60")
    made.save(tmp_path / "in")
    checked = ppmcal.check(tmp_path / "in" / "machine.yaml", tmp_path / "in" / "heights.csv")
    found = ppmcal.identify(tmp_path / "in" / "machine.yaml", tmp_path / "in" / "heights.csv")
    for findings in (made.findings, checked.findings, found.findings):
        said, = (f for f in findings if "beside the tool" in f)
        assert "25, 10 mm" in said and "touches of the tool itself" in said
        assert float(re.search(r"known to ([\d.]+) mm", said)[1]) > 0.03
        assert float(re.search(r"would bring the tool to ([\d.]+) mm", said)[1]) < 0.02


def test_a_level_import_says_how_to_import_six_rods(tmp_path: Path) -> None:
    printer = SixRodPrinter(2)
    config = printer.config(tmp_path / "printer.cfg", PROBE, PROBED, FRESH[:0], SIGMA, 5)
    assert any("--effector" in f for f in ppmcal.import_config("klipper", config).findings)
    config = printer.config(tmp_path / "other.cfg", (0.0, 0.0), PROBED, FRESH[:0], SIGMA, 5)
    assert not any("--effector" in f for f in ppmcal.import_config("klipper", config).findings)


def test_nothing_is_open_where_the_probe_is_the_nozzle_or_both_have_touched(tmp_path: Path
                                                                           ) -> None:
    for name, options in (("one", {"probe": (0.0, 0.0)}), ("two", {"by_hand": FRESH[::2]})):
        (tmp_path / name).mkdir()
        folder = imported(tmp_path / name, SixRodPrinter(3), **options)
        found = ppmcal.identify(folder / "machine.yaml", sorted(folder.glob("*heights.csv")))
        told = tool_height(found.identification.fit)
        assert (told is None) == (name == "one") and not (told and told.open)
        said = [f for f in found.findings if "beside the tool" in f]
        assert len(said) == (name == "two")
        assert all("touches of the tool itself" not in f for f in said)


def test_a_bed_of_which_nothing_is_known_is_one_for_both_offsets(tmp_path: Path) -> None:
    printer = SixRodPrinter(7)
    for name, probe in (("one", PROBE), ("two", (-20.0, -8.0))):
        (tmp_path / name).mkdir()
        folder = imported(tmp_path / name, printer, probe=probe)
        side = yaml.safe_load((folder / "heights.yaml").read_text())
        side |= {"name": name, "frame": "unknown" if name == "one" else {"same_as": "one"}}
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(side))
        (folder / f"{name}.csv").write_text((folder / "heights.csv").read_text())
    one, two = tmp_path / "one" / "in", tmp_path / "two" / "in"
    alone = ppmcal.identify(one / "machine.yaml", one / "one.csv")
    said, = (f for f in alone.findings if "beside the tool" in f)
    assert "frame: {same_as: one}" in said
    both = ppmcal.identify(one / "machine.yaml", [one / "one.csv", two / "two.csv"])
    told = tool_height(both.identification.fit)
    assert told is not None and not told.open


def test_without_tolerances_nothing_holds_the_nozzle(tmp_path: Path) -> None:
    folder = imported(tmp_path, SixRodPrinter(4))
    text = (folder / "machine.yaml").read_text().replace("point: 0.1,", "point: .inf,")
    (folder / "machine.yaml").write_text(text)
    checked = ppmcal.check(folder / "machine.yaml", folder / "heights.csv")
    assert any("nor does any tolerance" in f for f in checked.findings)


def test_touches_at_one_place_are_no_place_to_round(tmp_path: Path) -> None:
    printer = SixRodPrinter(5)
    config = printer.config(tmp_path / "p.cfg", PROBE, np.zeros((3, 2)), FRESH[:0], SIGMA, 5)
    assert not any("nan" in f for f in ppmcal.import_config(
        "klipper", config, effector="40,60").findings)


@pytest.mark.slow
def test_the_nozzle_is_missed_by_as_much_as_is_said(tmp_path: Path) -> None:
    """Over printers: the errors of the nozzle's height over what was promised of them."""
    ratios: dict[str, list[float]] = {"alone": [], "more": []}
    for seed in range(20, 44):
        printer, folder = SixRodPrinter(seed), tmp_path / str(seed)
        (folder / "more").mkdir(parents=True)
        alone = imported(folder, printer)
        found = ppmcal.identify(alone / "machine.yaml", alone / "heights.csv")
        told = tool_height(found.identification.fit)
        assert told is not None and 2 <= len(told.at) <= 12
        ratios["alone"].append(float(np.sqrt(np.mean(
            nozzle_errors(found, printer, folder)**2))) * 1e-3 / told.tool)
        more = imported(folder / "more", printer, PROBED[list(told.at)])
        both = ppmcal.identify(more / "machine.yaml", sorted(more.glob("*heights.csv")))
        ratios["more"].append(float(np.sqrt(np.mean(
            nozzle_errors(both, printer, folder / "more")**2))) * 1e-3 / told.with_tool)
    # the noise is half of what sidecars begin with, so that promises are rather too large
    for one in ratios.values():
        assert 0.5 < np.sqrt(np.mean(np.square(one))) < 1.3


@pytest.mark.slow
def test_exported_numbers_hold_the_nozzle_level_over_the_bed(tmp_path: Path) -> None:
    """The simulated firmware with the new numbers; three rods leave what the tilt does."""
    heights: dict[str, list[float]] = {"three": [], "six": []}
    for seed in (50, 51, 52, 53):
        printer, folder = SixRodPrinter(seed), tmp_path / str(seed)
        folder.mkdir()
        config = printer.config(folder / "printer.cfg", PROBE, PROBED, PROBED[::3], SIGMA, 5)
        for name, effector in (("three", None), ("six", "40,60")):
            made = folder / name
            ppmcal.import_config("klipper", config, effector=effector).save(made)
            ppmcal.identify(made / "machine.yaml", sorted(made.glob("*heights.csv"))).save(
                made / "found")
            ppmcal.export("klipper", made / "found", old=config).save(made / "out")
            new = read_geometry(read_config(made / "out" / "klipper.cfg"))
            printer.numbers = {"radius": new.radius, "angles": np.radians(new.angles),
                               "arms": np.array(new.arms), "ends": np.array(new.endstops)}
            heights[name] += [printer.tip(np.array([*p, 0.0]), (0.0, 0.0))[2] for p in FRESH]
            printer = SixRodPrinter(seed)
    three, six = (float(np.sqrt(np.mean(np.square(heights[n])))) for n in ("three", "six"))
    assert six < 0.02 and six < 0.5 * three


def test_what_an_effector_cannot_be(tmp_path: Path) -> None:
    config = SixRodPrinter(1).config(tmp_path / "p.cfg", PROBE, PROBED, FRESH[:0], SIGMA, 5)
    for wrong, what in (("40", "radius and a spacing"), ("40,0", "radius and a spacing"),
                        ("a,b", "radius and a spacing"), ("40,60,1", "radius and a spacing"),
                        ("nan,60", "radius and a spacing"), ("140,60", "as large as the delta"),
                        ("40,139", "beyond those of the next pair")):
        with pytest.raises(BadInput, match=what) as told:
            ppmcal.import_config("klipper", config, effector=wrong)
        assert "--effector" in str(told.value)
    inches = ppmcal.import_config("klipper", config, effector="1.575,2.362")
    assert any("both are mm" in f for f in inches.findings)


def test_heights_of_a_manual_calibration_are_the_nozzle_s(tmp_path: Path) -> None:
    """DELTA_CALIBRATE METHOD=manual saves them as height0, height1 ... too, at 0."""
    config = SixRodPrinter(1).config(tmp_path / "p.cfg", PROBE, FRESH[:0], FRESH[:7], SIGMA, 5)
    config.write_text(config.read_text().replace("manual_height", "height"))
    ppmcal.import_config("klipper", config, effector="40,60").save(tmp_path / "in")
    assert {p.name for p in Path(tmp_path / "in").glob("*.csv")} == {"nozzle_heights.csv"}


def test_a_file_without_a_probe_says_whose_heights_they_are(tmp_path: Path) -> None:
    config = SixRodPrinter(1).config(tmp_path / "p.cfg", PROBE, PROBED, FRESH[:0], SIGMA, 5)
    text = config.read_text()
    config.write_text(text.replace("[probe]", "[beacon]"))
    made = ppmcal.import_config("klipper", config, effector="40,60")
    assert any("beside the tool" in f for f in made.findings)
    config.write_text(text.replace("[probe]", "[not_known]"))
    made = ppmcal.import_config("klipper", config, effector="40,60")
    assert any("heights count as the nozzle's own" in f for f in made.findings)


def test_the_export_says_that_the_effector_tilts(tmp_path: Path) -> None:
    folder = imported(tmp_path, SixRodPrinter(6), FRESH[::2])
    ppmcal.identify(folder / "machine.yaml", sorted(folder.glob("*heights.csv"))).save(
        tmp_path / "found")
    ppmcal.export("klipper", tmp_path / "found", old=tmp_path / "printer.cfg").save(
        tmp_path / "out")
    lacks = json.loads((tmp_path / "out" / "export.json").read_text())["not_expressed"]
    assert any("the effector tilts" in str(one) for one in lacks)


def test_a_printer_that_was_touched_on_its_bed_alone_is_commanded_above_it(tmp_path: Path) -> None:
    """A flat that was touched has hardly any range in z, which is no reason to know none there."""
    folder = imported(tmp_path, SixRodPrinter(1))
    ppmcal.identify(folder / "machine.yaml", folder / "heights.csv").save(tmp_path / "found")
    table = tmp_path / "wanted.csv"
    table.write_text("x,y,z,rx,ry,rz\n" + "".join(
        f"{x!r},{y!r},{z!r},,,\n" for z in (0.2, 60.0, 180.0) for x, y in FRESH[:4].tolist()))
    found = ppmcal.compensate(tmp_path / "found" / "identified.yaml", table, frame="base")
    assert found.compensation.status == ("ok",) * 8 + ("refused",) * 4
    assert all("far outside the measured volume: z = 180 mm" in why
               for why in found.compensation.reason[8:])


def test_a_probe_beyond_the_towers_is_refused_with_its_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"probe stands 300 mm.*offsets") as refused:
        imported(tmp_path, SixRodPrinter(1), probe=(300.0, 0.0))
    assert "printer.cfg" in str(refused.value)
