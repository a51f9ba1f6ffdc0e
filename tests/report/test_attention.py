"""Nothing needs a closer look only where nothing warns, whatever the warning comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from helpers.report_files import identification

from ppmcal.io.results.batch import CampaignRecord, with_findings
from ppmcal.io.results.commands import CommandsRecord
from ppmcal.io.results.comparison import ComparisonRecord
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.export import ExportRecord
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.plan import PlanRecord
from ppmcal.io.results.record import AnyRecord
from ppmcal.io.results.simulation import ComparedMachines, TruthRecord, TruthRow, compared
from ppmcal.io.results.validation import ValidationRecord
from ppmcal.report import to_html, to_json
from ppmcal.report.batch import batch_page
from ppmcal.report.collect import compare
from ppmcal.report.records import (
    CheckedRows,
    Designed,
    Diagnosed,
    Held,
    Identified,
    ReportData,
    Simulated,
)
from ppmcal.store.provenance import Provenance
from ppmcal.units import Units

CALM = "Nothing needs a closer look"


def fit(**changes: Any) -> Identified:
    """Return an identification without any fault, and with what is given; it lists no findings."""
    clean = identification()
    del clean["findings"]
    clean |= {"excluded": [], "parameters": clean["parameters"][:1]}
    return Identified("fit", IdentificationRecord.checked(clean | changes))


@pytest.mark.parametrize("truth", [
    {"effects": [{"kind": "compliance", "parameters": {"stiffness": 4500.0}}]},
    {"parameters": {"compliance.stiffness": 4500.0}, "errors": {"compliance.stiffness": 20.0}}])
def test_an_effect_without_a_nominal_value_is_compared_itself(truth: dict[str, Any]) -> None:
    """A start is no nominal: identification.json has neither that nor an error of a stiffness."""
    one = fit(parameters=[{"name": "compliance.stiffness", "value": 4478.0, "sigma": 11.0,
                           "unit": "N/mm", "status": "identified"}])
    parameters = {"leg1.offset": 0.1, **truth.pop("parameters", {})}
    record = TruthRecord.checked({"parameters": parameters, **truth})
    row, = compared(record, one.record.parameters, ("s", "f")).rows
    assert (row.true, row.found, row.z) == (4500.0, 4478.0, -2.0)


def diagnosis(**keys: Any) -> Diagnosed:
    return Diagnosed("d", DiagnosisRecord.checked({"verdict": "named", **keys}), None)


EFFECT = {"kind": "backlash", "on": ["leg1"], "p_value": 1e-9}
ERRORS = [{"model": "model"}, {"model": "without gain", "verdict": "better", "closer": 0.1,
                               "unit": "mm"}]
FAR = TruthRow("leg1.offset", "mm", 1.0, 2.0, 0.1, "identified")
WARNINGS: dict[str, Callable[[], dict[str, Any]]] = {
    "finding": lambda: {"identified": (fit(findings=["odd"]),)},
    "excluded": lambda: {"identified": (fit(excluded=[{"row": 1, "reason": "x"}]),)},
    "noise": lambda: {"identified": (fit(noise={"sigma_ratio": 2.0, "chi2_p": 1e-20}),)},
    "unconverged": lambda: {"identified": (fit(converged=False),)},
    "rise": lambda: {"identified": (fit(residual={
        "before": {"position": {"rms": 0.1, "unit": "mm"}},
        "after": {"position": {"rms": 0.2, "unit": "mm"}}}),)},
    "no check of the noise": lambda: {"identified": (fit(noise={}, redundant=[]),)},
    "sessions": lambda: {"identified": (fit(parameters=[{"name": "a", "disagree": True}]),)},
    "far": lambda: {"identified": (fit(parameters=[{
        "name": "a", "error": 5.0, "tolerance": 1.0, "unit": "mm", "far": True}]),)},
    "homing": lambda: {"identified": (fit(gross_errors={"homing_shifts": [{
        "session": "s", "actuator": "leg1", "value": 1.0, "sigma": 0.1, "unit": "mm"}]}),)},
    "unchecked": lambda: {"identified": (fit(gross_errors={"unchecked": [{
        "dataset": "s", "rows": [1]}]}),)},
    "scale": lambda: {"identified": (fit(identifiability={"scale": {
        "distance": 100.0, "open": True, "unit": "mm"}}),)},
    "campaign": lambda: {"identified": (fit(campaign={"text": "all poses lie on a circle"}),)},
    "diagnosis finding": lambda: {"diagnosed": (diagnosis(findings=["odd"]),)},
    **{verdict: lambda verdict=verdict: {"diagnosed": (diagnosis(verdict=verdict),)}
       for verdict in ("weak", "named-set", "partial", "unnamed", "misread", "new-verdict")},
    "unconfirmed": lambda: {"diagnosed": (diagnosis(effects=[EFFECT], confirmed=False),)},
    "day": lambda: {"diagnosed": (diagnosis(validation=[{"name": "s", "errors": ERRORS}]),)},
    "commands": lambda: {"compensated": (CheckedRows(
        "c", "commands", CommandsRecord(notes=("uncertainties are unknown",)), None),)},
    "lifted": lambda: {"compensated": (CheckedRows(
        "c", "commands", CommandsRecord(findings=("3 rows commanded though refused",)), None),)},
    "check": lambda: {"others": (CheckedRows("c", "check", AnyRecord(findings=("odd",))),)},
    "validation": lambda: {"validated": (Held("v", ValidationRecord.checked(
        {"datasets": [{"name": "s", "errors": ERRORS}]})),)},
    "changed": lambda: {"compared": (Held("c", ComparisonRecord(
        verdict="changed")),)},
    "compared": lambda: {"compared": (Held("c", ComparisonRecord(
        findings=("odd",))),)},
    "export": lambda: {"exported": (Held("e", ExportRecord.checked(
        {"not_expressed": [{"what": "a leaning tower"}]})),)},
    "worse": lambda: {"exported": (Held("e", ExportRecord.checked(
        {"gain": {"before": {"rms": 0.1}, "after": {"rms": 0.2}}})),)},
    "simulation": lambda: {"simulated": (Simulated("s", TruthRecord(left_out=("row 1",)), None),)},
    "truth": lambda: {"comparisons": (ComparedMachines("s", "f", (FAR,)),)},
    "other machine": lambda: {"comparisons": (ComparedMachines(
        "s", "f", (replace(FAR, found=1.0),), other=("leg1.offset",)),)},
    "design": lambda: {"designed": (Designed("p", "plan", PlanRecord(findings=("odd",)), {}),)},
}


@pytest.mark.parametrize("name", WARNINGS)
def test_a_warning_and_the_calm_sentence_never_stand_together(name: str) -> None:
    data = ReportData.of(("x",), WARNINGS[name]())
    assert to_json(data)["attention"], name
    assert CALM not in to_html(data)


@pytest.mark.parametrize(("name", "sentence"), [
    ("sessions", "sessions disagree on 1 parameter"), ("no check of the noise",
     "The folder does not hold a check of the noise"), ("noise", "something is missing")])
def test_the_page_says_once_what_speaks_against_being_sure(name: str, sentence: str) -> None:
    """What its first lines say is not in the list below them, and the other way round."""
    page = to_html(ReportData(("x",), **WARNINGS[name]())).split("<main>")[1]
    assert page.lower().count(sentence.lower()) == 1


def test_without_a_warning_it_is_calm() -> None:
    data = ReportData(("x",), (fit(),), (diagnosis(effects=[EFFECT], confirmed=True),))
    assert to_json(data)["attention"] == []
    assert CALM in to_html(data)


@pytest.mark.parametrize("name", ["excluded", "noise", "unconverged", "far"])
def test_a_fit_that_lists_its_findings_has_said_them_all(name: str) -> None:
    """Whatever words they are in: nothing is said twice, nor left out for a word in another."""
    (bare,) = WARNINGS[name]()["identified"]
    (own,) = to_json(ReportData(("x",), (bare,)))["attention"]
    for finding in ("another word", own["what"], "rows left out, converged, stated noise"):
        told = replace(bare, record=bare.record.changed(findings=(finding,)))
        (seen,) = to_json(ReportData(("x",), (told,)))["attention"]
        assert seen["what"] == finding


def test_nine_warnings_of_a_kind_are_one_line_and_all_in_the_json() -> None:
    lines = [f"limb 'leg{i}' is at a dead point" for i in range(9)]
    data = ReportData(("x",), (fit(findings=lines),))
    assert len(to_json(data)["attention"]) == 9
    page = to_html(data)
    assert page.count("is at a dead point") == 1
    assert "and 5 more" in page


@pytest.mark.parametrize("record", [
    CampaignRecord(campaign="c", command="identify", exit_code=3, message="lost"),
    CampaignRecord(campaign="c", command="identify", exit_code=1),
    CampaignRecord(campaign="c", command="compare", exit_code=1, verdict="same"),
    CampaignRecord(campaign="c", command="compare", exit_code=1, verdict="changed"),
    CampaignRecord(campaign="c", command="compare", exit_code=2, message="lost")])
def test_a_batch_is_calm_only_where_all_is_fine(record: CampaignRecord) -> None:
    assert with_findings([record])
    assert CALM not in batch_page([record])
    fine = CampaignRecord(campaign="c", machine="m", command="identify")
    assert not with_findings([fine])
    assert CALM in batch_page([fine])


# --- truth --------------------------------------------------------------------------------------

def one_of(**parameter: Any) -> Identified:
    entry = {"name": "leg1.base.point.radius", "unit": "mm", "sigma": 0.1, "status": "identified"}
    return Identified("fit", IdentificationRecord.checked({
        "parameters": [entry | parameter], "provenance": {"inputs": {"m.csv": "x"}}}))


def simulated(**keys: Any) -> Simulated:
    known: dict[str, Any] = {"errors": {"leg1.base.point.radius": 0.4},
             "parameters": {"leg1.base.point.radius": 260.4}, "units": Units("mm", "deg")}
    return Simulated("sim", TruthRecord(**{**known, **keys}), None, "x")


def test_another_machine_of_the_same_names_gives_no_alarm() -> None:
    """What was simulated is 260.4; a model whose nominal value is 261.5 has an error of -1.1."""
    (c,) = compare([one_of(nominal=261.5, value=260.45, error=-1.05)], [simulated()])
    assert c.rows[0].true == pytest.approx(-1.1)
    assert c.other == ("leg1.base.point.radius",)
    said = to_json(ReportData(("x",), comparisons=(c,)))
    assert "is not the machine simulated" in said["attention"][0]["what"]
    assert not any("sigma" in a["what"] for a in said["attention"])
    assert said["truth_against_identified"][0]["other_nominal_values"] == list(c.other)


@pytest.mark.parametrize("turn", [0.0, 360.0, -360.0])
def test_a_whole_turn_makes_no_other_machine(turn: float) -> None:
    name = "leg1.base.point.angle"
    truth = simulated(errors={name: 0.1}, parameters={name: -11.9})
    (c,) = compare([one_of(name=name, unit="deg", nominal=-12.0 + turn, value=-11.9 + turn,
                           error=0.1)], [truth])
    assert (c.other, c.rows[0].true) == ((), pytest.approx(0.1))


def test_an_effect_is_compared_with_the_one_simulated_there() -> None:
    effects = ({"kind": "backlash", "on": ["leg2", "leg5"], "parameters": {"width": 0.03}},)
    found = one_of(name="backlash.leg2+leg5.width", nominal=0.0, value=0.031, error=0.031)
    (c,) = compare([found], [simulated(effects=effects)])
    assert c.rows[0].true == pytest.approx(0.03)
    wrong = one_of(name="backlash.leg1.width", nominal=0.0, value=0.031, error=0.031)
    both = replace(wrong, record=wrong.record.changed(
        parameters=(*wrong.record.parameters, *found.record.parameters),
        provenance=Provenance(inputs={"m.csv": "x"})))
    (c,) = compare([both], [simulated(effects=effects)])
    assert [r.name for r in c.rows] == ["backlash.leg2+leg5.width"]
    assert "Not in the simulated machine" in c.note
    assert "backlash.leg1.width" in c.note


def test_a_finding_of_a_diagnosis_and_of_its_fit_is_listed_once() -> None:
    """The two lie in one folder; of another folder the same sentence is another finding."""
    both = {"identified": (replace(fit(findings=["odd"]), folder="d"),),
            "diagnosed": (replace(diagnosis(findings=["odd", "new"]), folder="d"),)}
    told = [f["what"] for f in to_json(ReportData(("x",), **both))["attention"]]
    assert (told.count("odd"), told.count("new")) == (1, 1)
    apart = both | {"identified": (fit(findings=["odd"]),)}
    told = [f["what"] for f in to_json(ReportData(("x",), **apart))["attention"]]
    assert told.count("odd") == 2


def test_a_page_tells_the_row_of_an_event_in_words() -> None:
    """And not as a parameter of no unit."""
    event = {"kind": "target_shift", "label": "target_shift", "on": [], "parameters": {
        "x": {"value": 0.25, "sigma": 0.01, "unit": "mm"},
        "from_row": {"value": 40.0, "unit": ""}},
        "row": {"value": 40, "low": 39, "high": 41, "dataset": "smr2"}}
    page = to_html(ReportData(("x",), diagnosed=(diagnosis(effects=[event]),)))
    assert "from row 40 of smr2 on (95 %: 39 to 41)" in page
    assert "from_row" not in page and "no unit" not in page
