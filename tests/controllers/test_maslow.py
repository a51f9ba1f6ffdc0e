"""Maslow: logs of belts as machines and runs, and anchors in its own frame and keys."""

import csv
import os
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.paths import ROOT
from helpers.redundant import alone, belts, written

from ppmcal import export, identify, import_config, simulate
from ppmcal.controllers.maslow.controller import MASLOW, read
from ppmcal.controllers.maslow.reading import BELTS, read_log
from ppmcal.errors import BadInput

DATA = Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data")) / "maslow"
TRUE = {"bl": (0.0, 0.0), "br": (2968.4, 0.0), "tr": (2955.1, 2087.9), "tl": (11.7, 2094.6)}
real = pytest.mark.skipif(not DATA.is_dir(),
                          reason="real measurements are not at hand (PPMCAL_DATA)")


def places(count, seed=1):
    return np.array([1484.0, 1045.0]) + np.random.default_rng(seed).uniform(
        -1.0, 1.0, (count, 2)) * [900.0, 600.0]


def readings(points, digits=6):
    """Return the belts at each place, as the firmware writes them."""
    return ["{" + ",   ".join(f"{b}:{np.hypot(*(p - TRUE[b])):.{digits}f}" for b in BELTS) + "}"
            for p in points]


def clbm(rows):
    return f"[MSG:INFO: CLBM:[{','.join(rows)},]]"


def log(folder, *lines):
    path = folder / "maslow.log"
    path.write_text("\n".join(lines) + "\n")
    return path


def runs(path):
    return [len(run.joints) for run in read_log(path).runs]


HIGH = {"bl": 34.0, "br": 78.0, "tr": 56.0, "tl": 100.0}


@pytest.mark.long
def test_heights_of_anchors_are_taken_from_the_keys_and_written_back(tmp_path):
    """Belts from four heights: their fit is the frame, and the firmware's own sums make it so."""
    def belts(p):
        return "{" + ", ".join(
            f"{b}:{np.sqrt(np.sum((p - TRUE[b])**2) + HIGH[b]**2):.6f}" for b in BELTS) + "}"

    path = log(tmp_path, clbm([belts(p) for p in places(20)]),
               *(f"$/Maslow_{b}Z={h}" for b, h in HIGH.items()))
    found = import_config("maslow", path)
    assert found.imported.entries["heights"] == HIGH
    found.save(tmp_path / "o")
    fit = identify(tmp_path / "o" / "machine.yaml", tmp_path / "o" / "measurements.csv")
    np.testing.assert_allclose(fit.mechanism.values[list(fit.mechanism.free)],
                               np.array([2968.4, 2955.1, 2087.9, 11.7, 2094.6]) * 1e-3, atol=5e-5)
    fit.save(tmp_path / "fit")
    out = export("maslow", tmp_path / "fit").exported
    written_ = read(out.files[MASLOW.file], "x")
    np.testing.assert_allclose(written_[:, 2], list(HIGH.values()), atol=1e-9)
    np.testing.assert_allclose(written_[:, :2], list(TRUE.values()), atol=0.05)
    assert not out.not_expressed
    assert out.after.rms < 1e-6

    # without the keys the same belts suit no frame
    path.write_text("\n".join(line for line in path.read_text().splitlines() if "Z=" not in line))
    plain = import_config("maslow", path)
    assert "effects" not in plain.files()["machine.yaml"]
    plain.save(tmp_path / "p")
    other = identify(tmp_path / "p" / "machine.yaml", tmp_path / "p" / "measurements.csv")
    away = other.mechanism.values[list(other.mechanism.free)] - fit.mechanism.values[
        list(fit.mechanism.free)]
    assert np.abs(away).max() > 1e-3


def test_a_height_beyond_its_belt_is_refused(tmp_path):
    path = log(tmp_path, clbm(readings(places(9))), "tlZ: 100000")
    with pytest.raises(BadInput, match="tlZ is 100000 mm"):
        import_config("maslow", path)


# --- reading ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_run_is_a_file_and_their_fit_is_the_frame(tmp_path):
    path = log(tmp_path, "[MSG:INFO: start]", clbm(readings(places(20))), "Run two:", "",
               *(f"{r}," for r in readings(places(15, 2))), "(0, 0), (3030.49, 0)")
    found = import_config("maslow", path)
    assert sorted(found.files()) == ["machine.yaml", "run_1.csv", "run_1.yaml", "run_2.csv",
                                     "run_2.yaml"]
    assert "35 readings of its belts in 2 runs" in found.headline()
    assert found.imported.entries["lines"] == ["line 2", "lines 5 to 19"]
    assert not found.findings
    found.save(tmp_path / "o")
    assert "lines 5 to 19 of maslow.log" in (tmp_path / "o" / "run_2.yaml").read_text()
    fit = identify(tmp_path / "o" / "machine.yaml",
                   [tmp_path / "o" / f"run_{n}.csv" for n in (1, 2)])
    machine = fit.mechanism
    assert [machine.names[p] for p in machine.free] == [
        "br.base.point.x", "tr.base.point.x", "tr.base.point.y", "tl.base.point.x",
        "tl.base.point.y"]
    np.testing.assert_allclose(machine.values[list(machine.free)],
                               np.array([2968.4, 2955.1, 2087.9, 11.7, 2094.6]) * 1e-3, atol=5e-5)


def test_a_calibration_under_way_is_one_run(tmp_path):
    """First its lines have all readings so far, then one reading each."""
    rows = readings(places(12))
    path = log(tmp_path, clbm(rows[:4]), "[MSG:INFO: moving]", clbm(rows[:8]),
               *(line for r in rows[8:] for line in (clbm([r]), "[MSG:INFO: moving]")))
    found = read_log(path)
    assert runs(path) == [12]
    assert "repeat the line before" in found.findings[0]


@pytest.mark.parametrize("between", ["", "Run two:", "{\"state\": 1}"])
def test_anything_else_ends_a_list(tmp_path, between):
    rows = [f"{r}," for r in readings(places(10))]
    assert runs(log(tmp_path, *rows[:5], between, *rows[5:])) == [5, 5]


def test_a_list_goes_on_in_the_lines_below_clbm(tmp_path):
    rows = [f"{r}," for r in readings(places(10))]
    assert runs(log(tmp_path, "CLBM:[" + rows[0], *rows[1:], "]", *rows)) == [10, 10]


def test_a_table_is_a_run(tmp_path):
    points = places(10)
    lines = [",".join(f"{np.hypot(*(p - TRUE[b])):.6f}" for b in ("tl", "tr", "bl", "br"))
             for p in points]
    path = log(tmp_path, "tl,tr,bl,br", *lines)
    (run,) = read_log(path).runs
    listed = log(tmp_path, *readings(points))
    np.testing.assert_array_equal(run.joints, read_log(listed).runs[0].joints)


def test_readings_of_one_place_share_its_number(tmp_path):
    rows = [f"{r}," for r in readings(np.repeat(places(6), 4, axis=0)
                                      + np.tile([0.0, 0.2, 0.4, 0.1], 6)[:, None])]
    table = import_config("maslow", log(tmp_path, *rows)).files()["measurements.csv"]
    assert [row["pose"] for row in csv.DictReader(table.splitlines())] == [
        str(1 + n // 4) for n in range(24)]


def test_where_anchors_about_are(tmp_path):
    """By keys of the log, of another file, by width and height, else by the readings alone."""
    rows = [f"{r}," for r in readings(places(10))]

    def nominal(path, **options):
        found = import_config("maslow", path, **options)
        tree = yaml.safe_load(found.files()["machine.yaml"])
        return found.imported.entries["anchors"], tree["tolerances"]["point"], found.headline()

    at, wide, said = nominal(log(tmp_path, *rows))
    np.testing.assert_allclose(at["tr"], TRUE["tr"], atol=20.0)
    assert wide == 100 and "suits the readings" in said
    keys = ["Maslow_tlX: 9.5", "Maslow_tlY: 2090.0", "Maslow_trX: 2950.0", "Maslow_trY: 2089.0",
            "Maslow_brX: 2970.0", "Maslow_brY: 0.0"]
    at, wide, said = nominal(log(tmp_path, *rows, *(f"[MSG:INFO: {k}]" for k in keys)))
    assert at["tl"] == [9.5, 2090.0] and wide == 30 and "tlX ... brY of maslow.log" in said
    (tmp_path / "maslow.yaml").write_text("\n".join(keys).replace("9.5", "10.5"))
    plain = log(tmp_path, *rows)
    at, wide, said = nominal(plain, anchors=tmp_path / "maslow.yaml")
    assert at["tl"] == [10.5, 2090.0] and "of --anchors" in said
    at, wide, said = nominal(plain, width=2965.0, height=2091.0)
    assert at["tr"] == [2965.0, 2091.0] and wide == 30
    at, wide, said = nominal(plain, height=2091.0)
    assert at["tr"][1] == 2091.0 and wide == 100 and "--height, and a rectangle" in said


GOOD = readings(places(9))


@pytest.mark.parametrize(("lines", "says", "place"), [
    (["hello"], "holds no readings of belts", "maslow.log"),
    ([*GOOD, "{bl:1631.15, br:2729.87, tr:2400.60}"], "has no tl", "line 10"),
    ([*GOOD, "{bl:1631.15, br:2729.87, tr:2400.60, tr:2400.60, tl:1.0}"], "tr twice", "line 10"),
    ([*GOOD, "{bl:1631.15, br:2729.87, tr:24"], "cut off", "line 10"),
    ([clbm(GOOD)[:-30]], "cut off", "line 1"),
    ([*GOOD, "{{bl:1631.15, br:2729.87, tr:2400.60, tl:998.65}"], "cut off", "line 10"),
    ([*GOOD, "}{bl:1631.15, br:2729.87"], "cut off", "line 10"),
    ([*GOOD, "{bl:1631.15, br:x, tr:2400.60, tl:998.65}"], "'x', not a length", "line 10"),
    ([*GOOD, "{bl:1.63, br:2.73, tr:2.40, tl:1.00}"], "implausible", "line 10"),
    ([*GOOD, "{bl:-1631.15, br:2729.87, tr:2400.60, tl:998.65}"], "implausible", "line 10"),
    ([*GOOD, "{bl:nan, br:2729.87, tr:2400.60, tl:998.65}"], "implausible", "line 10"),
    (GOOD[:3], "readings at 3 places, and 4 are the least", "lines 1 to 3"),
    (["bl,br,tr,tl", "1631.15,2729.87,2400.6,99865000"], "implausible", "row 1"),
    (["bl,br,tr,tl", "1631.15,2729.87,2400.6"], "cells", "row 1"),
], ids=lambda x: x if isinstance(x, str) else None)
def test_what_cannot_be_read_is_one_message(tmp_path, lines, says, place):
    log(tmp_path, *lines)
    told = ppmcal("import", "maslow", "maslow.log", cwd=tmp_path, expect=2)
    said = " ".join(told.err.split())
    assert says in said and place in said and "Traceback" not in said
    assert not (tmp_path / "imported").exists()


def test_a_run_that_is_too_short_is_left_out_of_several(tmp_path):
    path = log(tmp_path, *GOOD, "run two", *GOOD[:2])
    found = import_config("maslow", path)
    assert "measurements.csv" in found.files()
    # of several logs in one fit each has its own name
    assert f"\nname: {path.stem}\n" in found.files()["measurements.yaml"]
    (said,) = found.findings
    assert "lines 11 to 12" in said and "left out" in said


def test_names_that_are_mixed_up_are_found(tmp_path):
    swapped = [r.replace("tr:", "u:").replace("tl:", "tr:").replace("u:", "tl:") for r in GOOD]
    (said,) = import_config("maslow", log(tmp_path, *swapped)).findings
    assert "better with bl and br, or tr and tl, exchanged" in said


@pytest.mark.parametrize(("options", "says"), [
    (["--width", "-3"], "-3.0 is not a width"), (["--rods", "300"], "maslow has no option --rods"),
    (["--anchors", "none.yaml"], "there is no such file"),
    (["--anchors", "maslow.log"], "tlX, tlY, trX, trY, brX are missing")])
def test_options_that_cannot_be_used(tmp_path, options, says):
    log(tmp_path, *GOOD)
    told = ppmcal("import", "maslow", "maslow.log", *options, cwd=tmp_path, expect=2)
    assert says in " ".join(told.err.split())


@pytest.mark.parametrize("keys", ["tlX: 0 tlY: 0 trX: 2900 trY: 0 brX: 3000",
                                  "tlX: 2900 tlY: 2000 trX: 0 trY: 2000 brX: 3000",
                                  "tlX: 0 tlY: 2e300 trX: 0 trY: 2000 brX: 3000",
                                  "tlX: 0 tlY: 2000 trX: 3000 trY: 2000 brX: 0"])
def test_anchors_that_are_no_frame(tmp_path, keys):
    """Asked for they are refused; in a log the readings alone say where anchors are."""
    (tmp_path / "maslow.yaml").write_text(keys)
    path = log(tmp_path, *GOOD)
    with pytest.raises(BadInput, match="in one line, or the frame is mirrored"):
        import_config("maslow", path, anchors=tmp_path / "maslow.yaml")
    assert "suits the readings" in import_config("maslow", log(tmp_path, *GOOD, keys)).headline()


def test_options_of_another_format_are_refused(tmp_path):
    (tmp_path / "printer.cfg").write_text("")
    told = ppmcal("import", "klipper", "printer.cfg", "--width", "3000", cwd=tmp_path, expect=2)
    assert "klipper has no option --width. Leave it out; it has --rods, --mesh" in " ".join(
        told.err.split())


# --- export -------------------------------------------------------------------------------------


def frame_of(tmp_path, turn, shift, offset=0.0, **more):
    """Return the file of the true frame in another one, nominally a rectangle."""
    c, s = np.cos(turn), np.sin(turn)
    tree = belts()
    at = {b: np.array([[c, -s], [s, c]]) @ np.array(p) + shift for b, p in TRUE.items()}
    for limb in tree["limbs"]:
        nominal = np.array([[c, -s], [s, c]]) @ limb["base"]["point"] + shift
        limb["base"]["point"] = {a: {"value": float(v), "nominal": float(n)} for a, v, n in zip(
            "xy", at[limb["name"]], nominal, strict=True)}
        limb["offset"]["value"] = offset
    mid = np.mean(list(at.values()), axis=0)
    tree["home"] = {"pose": {"x": float(mid[0]), "y": float(mid[1])}}
    tree["limits"] = {b: [700, 3000] for b in BELTS}
    return written(tmp_path, tree | more)


def keys(found):
    text = found.exported.files[MASLOW.file]
    return dict(zip(BELTS, read(text, "x")[:, :2].tolist(), strict=True))


@pytest.mark.parametrize(("turn", "shift"), [(0.0, (0.0, 0.0)), (0.02, (30.0, -12.0)),
                                             (np.pi, (500.0, 9.0))])
@pytest.mark.slow
def test_anchors_are_in_the_frame_of_the_maslow(tmp_path, turn, shift):
    found = export("maslow", frame_of(tmp_path, turn, shift))
    for belt, place in TRUE.items():
        np.testing.assert_allclose(keys(found)[belt], place, atol=6e-4)
    moved = bool(turn)
    assert any("bottom left anchor" in note for note in found.exported.notes) == moved
    assert found.exported.after.rms < 1e-6 < found.exported.before.rms
    assert not found.exported.not_expressed


@pytest.mark.slow
def test_what_keys_cannot_hold_is_told_with_its_cost(tmp_path):
    found = export("maslow", frame_of(tmp_path, 0.0, (0.0, 0.0), offset=4.0))
    (lack,) = found.exported.not_expressed
    assert "4 mm (bl)" in lack.what
    assert lack.cost.rms == pytest.approx(found.exported.after.rms, rel=1e-3)
    # in the middle all belts pull it to their anchors alike, at the sides less so
    assert 1e-4 < lack.cost.rms < 4e-3


@pytest.mark.slow
def test_the_old_file_is_compared_and_copied(tmp_path):
    path = frame_of(tmp_path, 0.0, (0.0, 0.0))
    (tmp_path / "maslow.yaml").write_text(
        "name: shop\nMaslow_tlX: 10.0   # left\nMaslow_tlY: 2090.0\nMaslow_trX: 2950.0\n"
        "Maslow_trY: 2089.0\nMaslow_brX: 2970.0\nMaslow_brY: 0.0\nMaslow_vertical: false\n")
    told = ppmcal("export", "maslow", path, "--old", "maslow.yaml", "--write", cwd=tmp_path,
                  expect=0)
    assert re.search(r"Maslow_tlX +10\.0000 +11\.7000 +\+1\.7000", told.out)
    copy = (tmp_path / "exported" / "maslow.yaml").read_text()
    assert "Maslow_tlX: 11.700   # left" in copy and "Maslow_vertical: false" in copy
    np.testing.assert_array_equal(
        read(copy, "x"), read((tmp_path / "exported" / "anchors.yaml").read_text(), "x"))


@pytest.mark.slow
def test_limbs_of_other_names_are_told_by_where_they_are(tmp_path):
    tree = yaml.safe_load(frame_of(tmp_path, 0.0, (0.0, 0.0)).read_text())
    for limb, name in zip(tree["limbs"], "pqrs", strict=True):
        limb["name"] = name
    tree["limits"] = {name: [700, 3000] for name in "pqrs"}
    tree["limbs"].reverse()
    found = export("maslow", written(tmp_path, tree))
    np.testing.assert_allclose(keys(found)["tl"], TRUE["tl"], atol=6e-4)


def test_machines_that_are_no_maslow_are_refused(tmp_path):
    with pytest.raises(BadInput, match="four ropes to one point in the plane"):
        export("maslow", ROOT / "configs" / "five-bar.yaml")
    tree = yaml.safe_load(frame_of(tmp_path, 0.0, (0.0, 0.0)).read_text())
    tree["limbs"][0]["name"], tree["limbs"][1]["name"] = "br", "bl"
    tree["limbs"][2]["name"], tree["limbs"][3]["name"] = "tl", "tr"
    with pytest.raises(BadInput, match="mirrored"):
        export("maslow", written(tmp_path, tree))


@pytest.mark.long
def test_a_self_calibrated_machine_is_known_in_its_own_frame(tmp_path):
    """Import, identification, export: what defines the frame adds nothing to its uncertainty."""
    path = written(tmp_path, belts())
    made = simulate(path, alone(belts(), {"x": 900, "y": 700}, sigma=0.1))
    rows = made.data[0].q * 1e3
    log(tmp_path, *("{" + ", ".join(f"{b}:{v:.6f}" for b, v in zip(BELTS, row, strict=True)) + "},"
                    for row in rows))
    import_config("maslow", tmp_path / "maslow.log").save(tmp_path / "o")
    fit = identify(tmp_path / "o" / "machine.yaml", tmp_path / "o" / "measurements.csv")
    fit.save(tmp_path / "fit")
    found = export("maslow", tmp_path / "fit")
    assert found.exported.uncertainty.position < 1e-3


@real
@pytest.mark.slow
def test_an_owners_ten_runs(tmp_path):
    """Anchors as his own program finds them, within what these runs leave open."""
    import_config("maslow", DATA / "ten-runs-01.csv").save(tmp_path / "o")
    fit = identify(tmp_path / "o" / "machine.yaml", tmp_path / "o" / "measurements.csv")
    fit.save(tmp_path / "fit")
    at = keys(export("maslow", tmp_path / "fit"))
    np.testing.assert_allclose(at["tl"], (-0.54, 2138.24), atol=12.0)
    np.testing.assert_allclose(at["tr"], (3027.57, 2141.11), atol=12.0)
    np.testing.assert_allclose(at["br"], (3033.46, 0.0), atol=12.0)


@real
@pytest.mark.slow
def test_all_runs_of_the_owner_are_read():
    with (DATA / "index.csv").open() as stream:
        assert len(list(csv.reader(stream))) > 5
    for path in sorted(DATA.glob("*-??.csv")):
        found = import_config("maslow", path)
        assert found.imported.entries["runs"] == [len(path.read_text().splitlines()) - 1]
        assert not found.findings, path
