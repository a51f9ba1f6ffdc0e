"""What an export says first, and the controller's own file that it changes where it stands."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path

import pytest
from helpers.commands import ppmcal

from ppmcal.commands.export.verdict import FitEvidence, verdict_of
from ppmcal.controllers import loaded, own_words
from ppmcal.io import read_mechanism
from ppmcal.io.results.export import CommandErrors, ExportRecord
from ppmcal.io.results.parts import ErrorSize

SAMPLE = Path(__file__).parents[2] / "sample_data" / "printer" / "printer.cfg"


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sample printer, read and calibrated, with distances and without."""
    here = tmp_path_factory.mktemp("printer")
    shutil.copy(SAMPLE, here)
    ppmcal("import", "klipper", "printer.cfg", cwd=here)
    for out, data in (("heights", ["heights"]), ("both", ["heights", "distances"])):
        run = ppmcal("identify", "imported/machine.yaml", *(f"imported/{one}.csv" for one in data),
                     "--out", out, cwd=here, expect=0)
        assert "a.offset is position_endstop + sqrt(" in " ".join(run.out.split())
    return here


@pytest.fixture
def here(fitted: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(fitted, tmp_path / "own"))


@pytest.mark.slow
def test_the_verdict_comes_first_with_errors_before_and_after(here: Path) -> None:
    run = ppmcal("export", "klipper", "both", "--old", "printer.cfg", cwd=here, expect=0)
    words = " ".join(run.out.split())
    assert words.startswith("Paste this: yes; predicted error ")
    assert "size is not checked" not in words.lower()
    record = json.loads((here / "exported" / "export.json").read_text())
    held = json.loads((here / "both" / "identification.json").read_text())["residual"]["holdout"]
    rows = held["position"]["count"]
    assert 0 < rows < 22
    assert f"measurements that the fit had not seen ({rows} rows, held out once): " in words
    assert ("mm after (heights and distances where they were measured; predicted is the whole "
            "position, over the workspace)") in words
    old, new = (record["predicted"][k]["rms"] for k in ("before", "after"))
    assert f"{old:.2g} mm rms with the old numbers, {new:.2g} mm with the new" in words
    text = (here / "exported" / "klipper.cfg").read_text()
    assert [line for line in text.splitlines() if line and line[0] != "#"] == [
        line for line in record["lines"] if line]
    assert all(line in run.out for line in record["lines"])


@pytest.mark.slow
@pytest.mark.parametrize("form", ["klipper", "marlin", "reprap"])
def test_parameters_are_told_by_the_printers_own_names(here: Path, form: str) -> None:
    """The formula that is told makes the endstops of the numbers that are exported."""
    machine = read_mechanism(here / "both" / "identified.yaml")
    words = own_words(machine, form)
    formula = words.partition("a.offset is ")[2].partition(";")[0].replace("^", "**")
    numbers = {n.name: n.new for n in loaded(form).export(machine, None, None).numbers}
    named = {"klipper": {"arm_length": "stepper_a.arm_length", "delta_radius":
                         "printer.delta_radius", "position_endstop": "stepper_a.position_endstop"},
             "marlin": {"H of M665": "M665 H", "X of M666": "M666 X", "L": "M665 L",
                        "R": "M665 R"},
             "reprap": {"H of M665": "M665 H", "X of M666": "M666 X", "L": "M665 L of X",
                        "R": "M665 R"}}[form]
    for own, name in named.items():
        assert own in formula
        formula = re.sub(rf"\b{own}\b", repr(numbers[name]), formula)
    value = machine.values[machine.names.index("a.offset")] * 1e3
    assert eval(formula, {"sqrt": math.sqrt}) == pytest.approx(value, abs=1e-3)
    assert f"is {'arm_length' if form == 'klipper' else 'L'}, a.base.point.angle is " in words


@pytest.mark.slow
def test_heights_alone_do_not_check_the_size(here: Path) -> None:
    ppmcal("export", "klipper", "heights", cwd=here, expect=0)
    verdict = json.loads((here / "exported" / "export.json").read_text())["verdict"]
    assert verdict["answer"] == "yes"
    assert any("size is not checked" in one and "measure one distance" in one
               for one in verdict["unchecked"])


@pytest.mark.slow
def test_a_machine_that_nobody_measured_is_not_judged(here: Path) -> None:
    run = ppmcal("export", "klipper", "imported/machine.yaml", cwd=here, expect=0)
    assert run.out.startswith("Paste this: not judged;")


@pytest.mark.long
def test_lines_to_paste_are_never_broken(tmp_path: Path) -> None:
    """Half a line of M669 is another command; and nobody who owns the printer knows of run_1."""
    shutil.copy(SAMPLE.parents[1] / "hangprinter" / "samples.jsonl", tmp_path)
    ppmcal("import", "hangprinter", "samples.jsonl", "--out", "lines", cwd=tmp_path)
    ppmcal("identify", "lines/machine.yaml", "lines/run_1.csv", "lines/run_2.csv", cwd=tmp_path,
           expect=None)
    run = ppmcal("export", "hangprinter", "identified", cwd=tmp_path, expect=None)
    lines = json.loads((tmp_path / "exported" / "export.json").read_text())["lines"]
    printed = run.out.splitlines()
    copied = [f"    {line}" for line in lines]
    assert max(map(len, copied)) > 80
    assert set(copied) <= set(printed)
    assert max(len(line) for line in printed if line not in copied) <= 80
    assert "(1 sigma, rms over the poses, in the base frame)" in " ".join(printed)
    assert "run_1" not in run.out


@pytest.mark.slow
@pytest.mark.parametrize(("folders", "stands"), [
    (("one",), 1), (("one", "both"), 1), (("one", "two"), 4)])
def test_a_page_says_the_verdict_once(here: Path, folders: tuple[str, ...], stands: int) -> None:
    """Of its only export; of two the beginning and each one's chapter say it."""
    for name, model in (("one", "both"), ("two", "heights")):
        ppmcal("export", "klipper", model, "--out", name, cwd=here, expect=0)
    ppmcal("report", *folders, "--out", "page", cwd=here, expect=None)
    page = (here / "page" / "report.html").read_text(encoding="utf-8")
    assert page.count("Paste this: ") == stands


@pytest.mark.slow
def test_a_fit_that_predicts_unseen_rows_no_better_is_refused(here: Path) -> None:
    path = here / "both" / "identification.json"
    record = json.loads(path.read_text())
    record["residual"]["holdout"]["position"]["rms"] = record["residual"]["before"]["position"][
        "rms"] * 1.01
    path.write_text(json.dumps(record))
    run = ppmcal("export", "klipper", "both", cwd=here, expect=3)
    assert "no better than the machine did before it" in " ".join(run.err.split())
    assert not (here / "exported").exists()
    run = ppmcal("export", "klipper", "both", "--regardless", cwd=here, expect=1)
    assert run.out.startswith("Paste this: no;")


@pytest.mark.slow
def test_a_fit_of_rows_that_were_all_seen_has_to_miss_them_by_less(here: Path) -> None:
    """As it does not where all that is left is taken for noise."""
    path = here / "both" / "identification.json"
    record = json.loads(path.read_text())
    sizes = record["residual"]
    sizes["holdout"] = {}
    sizes["after"]["position"]["rms"] = 1.01 * sizes["before"]["position"]["rms"]
    path.write_text(json.dumps(record))
    run = ppmcal("export", "klipper", "both", cwd=here, expect=3)
    assert "its own measurements no better than the machine did before it" in " ".join(
        run.err.split())


@pytest.mark.parametrize(("new", "unseen", "answer"), [
    (0.5, None, "yes"), (0.99, None, "no"), (0.99, 0.1, "yes")])
def test_numbers_that_promise_no_gain_are_not_to_be_pasted(
        new: float, unseen: float | None, answer: str) -> None:
    """Unless rows that the fit had not seen show one."""
    record = ExportRecord(expected_before=CommandErrors(rms=1.0, unit="mm"),
                          expected_after=CommandErrors(rms=new, unit="mm"))
    known = FitEvidence(before=ErrorSize(rms=1.0, unit="mm"), there=True,
                        unseen=ErrorSize(rms=unseen, unit="mm"))
    verdict = verdict_of(record, known, ())
    assert verdict["answer"] == answer
    assert ("hardly anything to gain" in verdict["why"]) == (answer == "no")


@pytest.mark.slow
def test_write_changes_the_numbers_alone_and_keeps_the_old_file(here: Path) -> None:
    path = here / "printer.cfg"
    before = path.read_bytes()
    path.chmod(0o640)
    ppmcal("export", "klipper", "both", "--old", "printer.cfg", "--write", cwd=here, expect=0)
    kept = here / "printer.cfg.before-1"
    assert kept.read_bytes() == before != path.read_bytes()
    assert path.stat().st_mode & 0o777 == 0o640
    assert path.read_bytes() == (here / "exported" / "printer.cfg").read_bytes()
    old, new = (one.decode().splitlines() for one in (before, path.read_bytes()))
    changed = [(a, b) for a, b in zip(old, new, strict=True) if a != b]
    assert changed and all(a.startswith("#*# ") and a.split("=")[0] == b.split("=")[0]
                           for a, b in changed)
    # it is done again from the copy that was kept
    assert ppmcal("verify", "exported", cwd=here).code == 0
    # the machine was not read from the numbers that stand there now
    run = ppmcal("export", "klipper", "both", "--old", "printer.cfg", "--write", "--overwrite",
                 cwd=here, expect=2)
    assert "is not the file that" in " ".join(run.err.split())


@pytest.mark.slow
@pytest.mark.parametrize("away", [False, True])
def test_write_leaves_a_file_that_the_machine_is_not_of(here: Path, away: bool) -> None:
    path = here / "printer.cfg"
    if away:    # nothing says where the machine is from
        shutil.rmtree(here / "imported")
    else:
        path.write_text(path.read_text().replace("max_accel: 3000", "max_accel: 2000"))
    before = path.read_bytes()
    ppmcal("export", "klipper", "both", "--old", "printer.cfg", "--write", cwd=here, expect=2)
    assert path.read_bytes() == before and not list(here.glob("*.before-*"))


@pytest.mark.parametrize(("form", "text"), [
    ("reprap", "; my printer\nM665 L300 R140 H290 B110 ; rods\nM666 X0 Y0 Z0\nM92 X80\n"),
    ("marlin", "echo:  M92 X80 Y80 Z80\necho:  M665 L300.00 R140.00 H290.00 S80\necho:  M666 X0\n"),
])
@pytest.mark.slow
def test_lines_of_gcode_take_the_place_of_the_old_ones(here: Path, form: str, text: str) -> None:
    path = here / "config.g"
    path.write_text(text)
    ppmcal("import", form, "config.g", "--out", "other", cwd=here)
    # the same printer: what it measured is fitted to the machine of this file
    for name in ("heights", "distances"):
        for end in ("csv", "yaml"):
            shutil.copy(here / "imported" / f"{name}.{end}", here)
    ppmcal("identify", "other/machine.yaml", "heights.csv", "distances.csv", "--out", "fit",
           cwd=here, expect=0)
    run = ppmcal("export", form, "fit", "--old", "config.g", "--write", cwd=here)
    assert run.code in (0, 1), run.err
    lines = path.read_text().splitlines()
    new = [line for line in (here / "exported" / f"{form}.g").read_text().splitlines()
           if line and line[0] != ";"]
    old = text.splitlines()
    kept = [line for line in old if "M665" not in line and "M666" not in line]
    assert [line for line in lines if line in kept] == kept
    assert [line for line in lines if not line.startswith(";") and line not in kept] == new
    assert [f";{line}" in lines for line in old if line not in kept] == [True, True]


@pytest.mark.long
def test_a_wrong_length_of_rods_is_told_and_no_plain_yes(fitted: Path, tmp_path: Path) -> None:
    shutil.copy(fitted / "printer.cfg", tmp_path)
    before = (tmp_path / "printer.cfg").read_bytes()
    rods = json.loads((fitted / "both" / "identification.json").read_text())
    length = next(p["nominal"] for p in rods["parameters"] if p["name"] == "rod")
    run = ppmcal("import", "klipper", "printer.cfg", "--rods", f"{length + 12.0:g}", cwd=tmp_path)
    assert f"--rods {length + 12.0:g} is " in run.out and "mm that it prints with" in run.out
    ppmcal("identify", "imported/machine.yaml", "imported/heights.csv", "imported/distances.csv",
           cwd=tmp_path)
    shown = ppmcal("export", "klipper", "identified", "--old", "printer.cfg", cwd=tmp_path)
    words = " ".join(shown.out.split())
    assert shown.code == 1 and words.startswith("Paste this: only after a check;")
    assert "check them before you use these numbers" in words
    ppmcal("export", "klipper", "identified", "--old", "printer.cfg", "--write", "--out", "w",
           cwd=tmp_path, expect=3)
    assert (tmp_path / "printer.cfg").read_bytes() == before
