"""The first three lines of the page, and the gap step by step."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.commands import ppmcal
from helpers.paths import ROOT
from helpers.report_files import cells, identification

from ppmcal.commands.report.options import ReportArguments
from ppmcal.commands.report.run import run
from ppmcal.io.results.commands import CommandsRecord
from ppmcal.io.results.diagnosis import DiagnosisRecord, gap_steps
from ppmcal.io.results.diagnosis_wording import headline
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.validation import ValidationRecord
from ppmcal.report import to_html
from ppmcal.report.diagnosis_tables import ladder
from ppmcal.report.page import summary
from ppmcal.report.records import CheckedRows, Diagnosed, Held, Identified, ReportData
from ppmcal.report.section import Section, placed
from ppmcal.report.verdict import MOST, verdicts
from ppmcal.store.provenance import Provenance

FAR_OUT = identification()["parameters"]
NEAR = [{**p, "far": False} for p in FAR_OUT]


def one(folder="fit", name="bench", **change):
    record = IdentificationRecord.checked({**identification(name), "parameters": NEAR, **change})
    return Identified(folder, record)


def lines(found, diagnosis=None):
    diagnosed = () if diagnosis is None else (
        Diagnosed(found.folder, DiagnosisRecord.checked(diagnosis), None),)
    (verdict,) = verdicts(ReportData((), (found,), diagnosed))
    assert verdict.of == ""
    assert [line.question for line in verdict.lines] == ["Calibrated?", "How sure?", "Next?"]
    return verdict.lines


def test_a_good_calibration_is_to_be_used():
    good, sure, then = lines(one(redundant=[]))
    assert (good.word, good.state) == ("Yes", "ok")
    assert ("0.00655\u00a0mm on poses kept out of the fit "
            "(0.512\u00a0mm before, 0.00612\u00a0mm in the fit)") in good.text
    assert (sure.word, sure.state) == ("Sure", "ok")
    assert (then.word, then.state) == ("Use it", "ok")
    assert "ppmcal compensate fit" in then.text


NOISY = {"sigma_ratio": 3.0, "chi2": 900.0, "degrees": 100.0, "chi2_p": 1e-40}
FIGURE = {"rms": 0.7, "max": 1.0, "unit": "mm"}
ROSE = {"before": {"position": {**FIGURE, "rms": 0.1}}, "after": {"position": FIGURE},
        "holdout": {}}

@pytest.mark.parametrize(("change", "diagnosis", "word", "state", "then"), [
    ({"noise": NOISY}, None, "Not fully", "warn", "Diagnose"),
    ({"noise": NOISY}, {"verdict": "unnamed"}, "Not fully", "warn", "Look closer"),
    ({}, {"verdict": "weak"}, "Not fully", "warn", "Look closer"),
    ({}, {"verdict": "none"}, "Yes", "ok", "Use it"),
    ({}, {"verdict": "named-set", "next_measurements": {"reason": "Both ways",
                                                        "file": "next.csv", "rows": 8}},
     "Yes, cause open", "warn", "Measure"),
    ({"converged": False}, None, "No", "bad", "Diagnose"),
    ({"residual": ROSE}, None, "No", "bad", "Diagnose"),
    ({"residual": {}}, None, "Not known", "warn", "Diagnose"),
    ({"parameters": FAR_OUT}, None, "After a check", "warn", "Check"),
    ({"campaign": {"poses": 9, "file": "next.csv", "text": "Few"}}, None, "In part", "warn",
     "Measure"),
])
def test_no_yes_beside_a_doubt(change, diagnosis, word, state, then):
    good, _, last = lines(one(**change), diagnosis)
    assert (good.word, good.state) == (word, state)
    assert last.word == then
    assert (last.state == "ok") == (state == "ok")


def test_what_is_farther_off_than_tolerances_allow_is_named_and_to_be_checked_first():
    good, _, then = lines(one(parameters=FAR_OUT))
    assert "farther from nominal than tolerances allow: leg1.offset" in good.text
    assert "after that check" in then.text


@pytest.mark.parametrize(("verdict", "words"), [
    ("named", ("Yes", "Sure")), ("named-set", ("Yes, cause open", "With doubts"))])
def test_nothing_is_sure_beside_an_open_cause(verdict, words):
    """Both lines follow the record: its verdict, and how probable it says that the cause is."""
    effects = [{"kind": "backlash", "on": [a], "probability": p, "alternatives_on": [other]}
               for a, p, other in (("leg1", 0.97, "gain on leg1"), ("leg2", 0.84, "drift"))]
    found = {"verdict": verdict, "confirmed": True, "effects": effects}
    good, sure, _ = lines(one(redundant=[]), found)
    assert (good.word, sure.word) == words
    assert "the named causes have probability 0.84" in sure.text
    sets = [{"effects": ["backlash on leg1"], "probability": 0.8}, {"probability": 0.2}]
    told = lines(one(redundant=[]), found | {"effects": effects[:1], "sets": sets})[1].text
    assert "the named cause has probability 0.8" in told
    bare = lines(one(), found | {"effects": [{"kind": "backlash", "on": ["leg1"]}]})[1].text
    assert "probability" not in bare


def test_doubts_of_certainty_are_told():
    assert lines(one(noise=NOISY))[1].state == "warn"
    assert lines(one(noise={}, redundant=[]))[1].word == "Not known"
    unsure = lines(one(), {"verdict": "named", "confirmed": False, "effects": [
        {"kind": "backlash", "on": ["leg1"]}]})[1]
    assert unsure.word == "With doubts"


def test_each_machine_has_its_lines_by_its_last_calibration():
    found = [one("a", "first", converged=False), one("b", "second"), one("c", "first")]
    told = verdicts(ReportData((), tuple(found)))
    assert [v.of for v in told] == ["first", "second"]
    assert told[0].lines[0].word == "Yes" and "ppmcal compensate c" in told[0].lines[2].text
    many = tuple(one(str(n), f"m{n}") for n in range(MOST + 3))
    assert len(verdicts(ReportData((), many))) == MOST


def test_a_diagnosis_of_the_same_measurements_counts():
    own = {"inputs": {"run.csv": "a" * 64}}
    fit = one(provenance=own)
    other = Diagnosed("elsewhere", DiagnosisRecord.checked(
        {"verdict": "unnamed", "provenance": own}), None)
    assert verdicts(ReportData((), (fit,), (other,)))[0].lines[0].word == "Not fully"
    stray = Diagnosed("elsewhere", DiagnosisRecord.checked(
        {"verdict": "unnamed", "provenance": {"inputs": {"x.csv": "b" * 64}}}), None)
    assert verdicts(ReportData((), (fit,), (stray,)))[0].lines[0].word == "Yes"


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_what_a_diagnosis_explains_is_not_open_whatever_the_order_of_folders(order):
    """Geometry alone misses; with the effect named in the same rows nothing is left."""
    own = {"inputs": {"run.csv": "a" * 64}}
    both = (one("plain", noise=NOISY, provenance=own), one("diagnosed", provenance=own))
    diagnosis = Diagnosed("diagnosed", DiagnosisRecord.checked(
        {"verdict": "named", "confirmed": True, "provenance": own}), None)
    (told,) = verdicts(ReportData((), tuple(both[i] for i in order), (diagnosis,)))
    assert told.lines[0].word == "Yes" and "compensate diagnosed" in told.lines[2].text
    later = one("later", noise=NOISY, provenance={"inputs": {"may.csv": "b" * 64}})
    (told,) = verdicts(ReportData((), (*both, later), (diagnosis,)))
    assert told.lines[0].word == "Not fully"


def test_shares_of_the_gap_are_of_squares_beyond_the_noise():
    steps = [{"what": "start", "rms_ratio": 11.0}, {"what": "geometry", "rms_ratio": 2.0},
             {"what": "effect", "kind": "backlash", "on": ["leg1"], "rms_ratio": 1.5},
             {"what": "effect", "kind": "windup", "on": ["leg2"], "rms_ratio": 0.9}]
    record = DiagnosisRecord.checked({"plot_data": {"steps": steps}})
    found = gap_steps(record.plot_data.steps)
    assert [s.of_whole for s in found] == [None, *(pytest.approx(g / 120) for g in (
        117, 1.75, 1.25))]
    assert [s.of_geometry for s in found] == [None, None, *(pytest.approx(g / 3) for g in (
        1.75, 1.25))]
    html = ladder(record)
    _, first, geometry, one_, two = cells(html, "The gap")
    assert first[1:] == ["11.0 ×", "–", "–"]
    assert geometry[1:] == ["2.00 ×", f"{117 / 120:.0%}".replace("%", " %"),
                            "–"]
    assert one_[2:] == [f"{100 * 1.75 / 120:.1f} %", "58 %"]
    assert two[2:] == [f"{100 * 1.25 / 120:.1f} %", "42 %"]
    assert ladder(DiagnosisRecord()) == ""


def test_names_in_links_are_one_of_a_kind():
    chapters = [Section("Calibration", parts=(Section("Rows"), Section("Rows!"))),
                Section("Rows"), Section("???")]
    found = placed(chapters)
    assert [c.name for c in found] == ["calibration", "rows-3", "part"]
    assert [p.name for p in found[0].parts] == ["rows", "rows-2"]


@pytest.mark.parametrize(("noise", "sure"), [
    ({"sigma_ratio": 0.1, "chi2": 1.0, "degrees": 100.0, "chi2_p": 1.0}, "With doubts"),
    ({"sigma_ratio": 0.3, "chi2": 0.6, "degrees": 3.0, "chi2_p": 0.89}, "Sure"),
    ({"sigma_ratio": 1.0, "chi2_p": 0.4, "prior_p": 1e-10}, "With doubts")])
def test_sigma_that_is_too_large_leaves_nothing_to_diagnose(noise, sure):
    """Nor do few degrees of freedom, at which any ratio may be."""
    found = lines(one(redundant=[], noise=noise))
    assert [line.word for line in found] == ["Yes", sure, "Use it"]
    assert "not noise" not in found[0].text


def test_the_headline_is_of_what_no_fit_has_seen_where_that_is_known():
    """Poses kept out first, then another day, then what commands promise, then the fit."""
    fit = one(residual={stage: {"position": {"rms": rms, "unit": "mm"}} for stage, rms in (
        ("before", 0.5), ("after", 0.01))})
    model = {"provenance": {"inputs": {"fit/identified.yaml": "x"}}}
    errors = [{"model": "model", "position": {"rms": 0.03, "unit": "mm"}}]
    day = Held("v", ValidationRecord.checked(model | {"datasets": [
        {"name": "run2", "errors": errors}]}))
    sent = CheckedRows("c", "commands", CommandsRecord.checked(model | {
        "rows": 4, "predicted": {"position": {"after": 0.02, "unit": "mm"}}}), None)
    other = replace(sent, record=sent.record.changed(provenance=Provenance(inputs={"m.yaml": "x"})))
    for more, words in (
            ({"validated": (day,), "compensated": (sent,)}, "0.0300\u00a0mm on run2, which no fit"),
            ({"compensated": (sent,)}, "0.0200\u00a0mm promised for 4 targets"),
            ({"compensated": (other,)}, "0.0100\u00a0mm in the fit (0.500\u00a0mm before)")):
        data = ReportData(("fit",), (fit,), **more)
        assert words in verdicts(data)[0].lines[0].text, words
        assert words in summary(data)[0]
        assert words.split(" ")[0] in to_html(data).split('class="flow"')[1].split("</div>")[0]


def test_a_set_of_long_names_is_told_by_its_causes():
    every = ", ".join(f"leg{i}" for i in range(1, 6))
    record = {"verdict": "named-set", "plot_data": {"actuators": [{}] * 6}, "effects": [
        {"kind": "backlash", "on": ["leg2"], "alternatives_on": [
            f"backlash on {every} and compliance on {every}", "gain on leg2"]},
        {"kind": "drift", "on": []}]}
    assert headline(DiagnosisRecord.checked(record)).endswith(
        "apart: backlash or backlash and compliance or gain.")
    record["effects"][0]["alternatives_on"] = ["gain on leg2"]
    assert headline(DiagnosisRecord.checked(record)).endswith(
        "apart: backlash on leg2 or gain on leg2.")


@pytest.mark.parametrize(("shipped", "told"), [
    ("6-UPS", ["compensate", "export linuxcnc", "export joints", "validate"]),
    ("3-RPR", ["compensate", "export joints", "validate"])])
def test_what_to_do_next_suits_the_machine(tmp_path, monkeypatch, shipped, told):
    """Which controllers drive it is asked of them: no list of theirs is in the report."""
    monkeypatch.chdir(tmp_path)
    Path("fit").mkdir()
    shutil.copy(ROOT / "configs" / f"{shipped}.yaml", "fit/identified.yaml")
    Path("fit/identification.json").write_text(json.dumps(
        identification("bench") | {"parameters": NEAR}))
    (verdict,) = verdicts(run(ReportArguments(folders=("fit",))).data)
    assert re.findall(r"ppmcal ((?:export )?\w+)", verdict.lines[2].text) == told


@pytest.mark.slow
def test_a_printer_gets_the_numbers_of_its_firmware(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "sample_data" / "printer" / "printer.cfg", "printer.cfg")
    ppmcal("import", "klipper", "printer.cfg", "--rods", "300", cwd=tmp_path, expect=0)
    ppmcal("identify", "imported/machine.yaml", "imported/heights.csv", "--out", "fit", "--quiet",
           cwd=tmp_path)
    (verdict,) = verdicts(run(ReportArguments(folders=("fit",))).data)
    assert re.findall(r"ppmcal ((?:export )?\w+)", verdict.lines[2].text) == [
        "export klipper", "validate"]
    assert "--old printer.cfg --write" in verdict.lines[2].text
