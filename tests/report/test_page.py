"""The report on small outputs written here: figures, page, escapes and refusals."""

from __future__ import annotations

import ast
import hashlib
import json
import re
import warnings
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from helpers.report_files import cells, identification, own, read, specs, write_csv, write_fit
from helpers.sources import tree_of

from ppmcal import commands, report
from ppmcal.calibration.fit import Noise
from ppmcal.calibration.knowledge.parameter_estimates import FAR
from ppmcal.calibration.validation import Dependence
from ppmcal.codec import unsaid
from ppmcal.errors import BadInput
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import ParameterEstimate
from ppmcal.io.results.identification_tables import RESIDUAL_TABLE
from ppmcal.io.results.identification_wording import combination, noise_verdict
from ppmcal.io.results.record import AnyRecord
from ppmcal.io.results.simulation import TruthRecord
from ppmcal.plotting.plot import Axis, span
from ppmcal.report import collect, to_html, to_json
from ppmcal.report.collect import compare
from ppmcal.report.design import OTHER
from ppmcal.report.html import NBSP, probability, sig, to_sigma, typeset
from ppmcal.report.kinds import KINDS, KNOWN
from ppmcal.report.records import Held, Identified, Simulated
from ppmcal.report.residual_figures import envelope, evenly_spread
from ppmcal.report.section import Kind, Section
from ppmcal.store.provenance import Provenance
from ppmcal.units import Units


def write_simulation(folder: Path, rows: int = 12) -> Path:
    folder.mkdir()
    t = np.linspace(0.0, 6.0, rows)
    write_csv(folder / "measurements.csv", {"x": 500 + 80 * np.cos(t), "y": 290 + 80 * np.sin(t),
                                            "rz": t, "q_leg1": t})
    (folder / "truth.json").write_text(json.dumps(
        {"errors": {"leg1.base.point.x": 0.0004972, "leg1.offset": 0.002},
         "units": {"length": "m", "angle": "deg"}, "provenance": {"seed": 7}}))
    return folder


def write_commands(folder: Path) -> Path:
    folder.mkdir()
    write_csv(folder / "commands.csv", {
        "x": [1.0, 2.0, 3.0], "q_leg1": [300.1, 301.2, "nan"],
        "q_leg1_nominal": [300.0, 301.0, 302.0],
        "error_position_before": [0.3, 0.4, "nan"], "error_position_after": [1e-9, 2e-9, ""],
        "status": ["ok", "ok", "limits"], "reason": ["", "", "leg1 too long"]})
    (folder / "commands.json").write_text(json.dumps({"units": {"length": "mm", "angle": "deg"}}))
    return folder


@pytest.fixture
def everything(tmp_path: Path) -> list[Path]:
    sim = write_simulation(tmp_path / "sim")
    sha = hashlib.sha256((sim / "measurements.csv").read_bytes()).hexdigest()
    fit = write_fit(tmp_path / "fit", identification(inputs={"measurements.csv": sha}))
    check = tmp_path / "check"
    check.mkdir()
    (check / "check.json").write_text(json.dumps({"findings": [{"where": "m.yaml: units",
                                                                "what": "odd unit"}]}))
    kin = tmp_path / "kin"
    kin.mkdir()
    write_csv(kin / "kinematics.csv", {"x": [1, 2], "condition": [3.0, 4.0],
                                       "status": ["ok", "singular"], "reason": ["", "at rz 0"]})
    return [sim, fit, write_commands(tmp_path / "comp"), check, kin]


def test_json_repeats_every_figure(everything: list[Path]) -> None:
    out = to_json(collect(everything))
    record = json.loads((everything[1] / "identification.json").read_text())
    found = out["identifications"][0]
    assert found["identification"] == record
    assert found["parameters"] == record["parameters"]
    assert found["residuals"]["rows"] == 12 and found["residuals"]["used"] == 11
    assert found["residuals"]["excluded"] == record["excluded"]
    commands = out["compensations"][0]
    assert commands["accepted"] == 2 and commands["rows"] == 3
    assert commands["error_position_before"] == pytest.approx(
        {"mean": 0.35, "rms": np.sqrt(0.125), "max": 0.4})
    assert commands["flagged"] == [{"row": 3, "status": "limits", "reason": "leg1 too long"}]
    json.dumps(out, allow_nan=False)


def test_truth_is_compared_in_the_units_of_the_fit(everything: list[Path]) -> None:
    data = collect(everything)
    rows = {r.name: r for r in data.comparisons[0].rows}
    assert set(rows) == {"leg1.base.point.x", "leg1.offset"}
    assert rows["leg1.base.point.x"].z == pytest.approx((0.5012 - 0.4972) / 0.004)
    assert rows["leg1.offset"].true == pytest.approx(2.0)
    assert data.comparisons[0].note == ""
    (c,) = to_json(data)["truth_against_identified"]
    assert c["parameters"][0]["z"] == rows["leg1.base.point.x"].z


def test_truth_of_other_measurements_is_not_compared(tmp_path: Path) -> None:
    sim = write_simulation(tmp_path / "sim")
    fit = write_fit(tmp_path / "fit", identification(inputs={"other.csv": "0" * 64}))
    data = collect([sim, fit])
    assert not data.comparisons and data.identified[0].positions is None
    assert "belongs to none of the identifications shown" in to_html(data)
    out = to_json(data)
    assert str(sim) in out["simulations"][0]["note"]
    assert not any("truth" in a["what"] for a in out["attention"])


def test_truth_is_compared_with_its_own_identification_alone(everything: list[Path],
                                                             tmp_path: Path) -> None:
    later = write_fit(tmp_path / "later", identification(inputs={"later.csv": "1" * 64}))
    data = collect([*everything, later])
    assert [c.identified for c in data.comparisons] == [str(everything[1])]
    assert to_json(data)["simulations"][0]["note"] == ""
    assert "belongs to none" not in to_html(data)


def test_truth_of_measurements_simulated_again_is_compared(tmp_path: Path) -> None:
    """Another machine's arithmetic changes last digits, and with them the check sum."""
    sim, used = write_simulation(tmp_path / "sim"), tmp_path / "run.csv"
    text = (sim / "measurements.csv").read_text().splitlines()
    first = text[1].split(",")
    for change, same in ((1e-14, True), (1e-6, False)):
        own = [repr(float(first[0]) * (1.0 + change)), *first[1:]]
        used.write_text("\n".join([text[0], ",".join(own), *text[2:]]) + "\n")
        sha = hashlib.sha256(used.read_bytes()).hexdigest()
        fit = write_fit(tmp_path / f"fit{same}", identification(inputs={str(used): sha}))
        data = collect([sim, fit])
        assert bool(data.comparisons) == same
        assert ("belongs to none" in to_html(data)) != same
    used.write_text(used.read_text() + "\n")
    assert not collect([sim, tmp_path / "fitTrue"]).comparisons


def test_truth_of_a_ratio_is_compared_in_the_units_of_the_fit() -> None:
    ratio = ParameterEstimate(name="leg1.ratio", error=2e-5, sigma=1e-5, unit="m/unit")
    truth = TruthRecord(errors={"leg1.ratio": 0.02}, units=Units("mm", "deg"))
    own = Provenance(inputs={"1": "x", "2": "y"})
    one = Identified("fit", IdentificationRecord(parameters=(ratio,), provenance=own))
    (c,) = compare([one], [Simulated("sim", truth, None, "x")])
    assert c.rows[0].true == pytest.approx(2e-5)
    odd = TruthRecord.checked({"errors": {"leg1.ratio": 0.02, "a": 1.0},
                               "units": {"length": "ell"}})
    both = (ratio, ParameterEstimate(name="a", error=1.0))
    found = compare([Identified("fit", IdentificationRecord(parameters=both, provenance=own))],
                    [Simulated("sim", odd, None, "x"), Simulated("again", odd, None, "y")])
    assert [c.note for c in found] == ["Units do not match and are left out: leg1.ratio."] * 2


def test_truth_beyond_reason_makes_a_page(tmp_path: Path) -> None:
    sim = write_simulation(tmp_path / "sim")
    (sim / "truth.json").write_text('{"errors": {"leg1.offset": -1.7e308, "leg1.lateral": 1}}')
    sha = hashlib.sha256((sim / "measurements.csv").read_bytes()).hexdigest()
    data = collect([sim, write_fit(tmp_path / "fit", identification(inputs={"m.csv": sha}))])
    assert data.comparisons
    read(to_html(data))


def test_tiny_numbers_make_a_drawing(tmp_path: Path) -> None:
    tiny = {"x": ["5e-324"] * 3, "error_position_before": ["5e-324"] * 3,
            "error_position_after": ["5e-324"] * 3, "status": ["ok"] * 3}
    write_csv(tmp_path / "commands.csv", tiny)
    write_csv(tmp_path / "residuals.csv", {
        "row": range(3), "x": range(3), "y": range(3), "before_x": ["5e-324"] * 3,
        "before_y": [0.0] * 3, "after_x": ["5e-324"] * 3, "after_y": [0.0] * 3})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        html = to_html(collect([tmp_path]))
    assert "Mnan" not in html and "lnan" not in html


def test_columns_of_the_targets_may_have_any_name(tmp_path: Path) -> None:
    """commands.csv repeats the columns of the targets, whatever they hold."""
    folder = write_commands(tmp_path / "comp")
    lines = (folder / "commands.csv").read_text().splitlines()
    extra = ["value,error_note,row", "A1,a,-", "A2,b,-", "A3,c,-"]
    (folder / "commands.csv").write_text(
        "\n".join(f"{a},{b}" for a, b in zip(extra, lines, strict=True)) + "\n")
    page = read(to_html(collect([folder])))
    assert {"A1", "b"} <= set(page.text)
    (folder / "commands.csv").rename(folder / "poses.csv")
    assert OTHER.of(collect([folder]))[0].table is not None


def test_page_says_it_all_with_units(everything: list[Path]) -> None:
    html = to_html(collect(everything))
    page = read(html)
    text = "".join(page.text)
    for piece in (f"0.00655{NBSP}mm on poses kept out of the fit", f"(0.512{NBSP}mm before",
                  "12 rows, 1 of them left out", "consistent with the stated noise (ratio 1.02",
                  "1 of 12 rows left out", f", 1 {FAR}",
                  "outlier: 7.0 times the noise", "leg1 too long", "frame.x − 0.5 × leg2.offset",
                  "m.yaml: units: odd unit", "at rz 0", "10.4934 … 10.5090", "10.5012",
                  "Error vectors in the plane, after", "ppmcal identify m.yaml"):
        assert piece in text, piece
    order = [html.index(f"{h}</h") for h in (
        "Calibration", "Error before and after", "Residuals", "Parameters",
        "Simulated truth against identified", "Compensation", "Where this comes from")]
    assert order == sorted(order)


def test_page_needs_nothing_else_and_is_accessible(everything: list[Path]) -> None:
    whole = to_html(collect(everything))
    page, html = read(whole), own(whole)
    assert not re.search(r"https?:|//[a-z]|url\(|@import", html)
    links = [a[2] for a in page.attributes if a[1] in ("src", "href", "srcset")]
    named = {a[2] for a in page.attributes if a[1] == "id"}
    assert len(links) > 12 and all(link[0] == "#" and link[1:] in named for link in links)
    assert html.count("<svg") == html.count("</title>") - 1
    plots = html.count('class="plot"')
    assert plots >= 9 and plots == html.count("<noscript><p>") == len(specs(html))
    assert all(v.strip(". ") for t, k, v in page.attributes if k == "aria-label")
    assert html.count("<th ") == html.count('scope="')
    assert "nan" not in "".join(page.text) and "NaN" not in html and "inf," not in html


def test_names_are_escaped(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>\"'&"
    record = identification(evil)
    record["parameters"][0]["name"] = evil
    record["excluded"][0]["reason"] = record["findings"][0] = evil
    record["redundant"] = [{"name": evil, "depends_on": {evil: 1}}]
    record["correlations"] = [{"a": evil, "b": evil, "value": 0.99}]
    record["provenance"] = {"command": evil, "version": evil, "inputs": {evil: evil}}
    for kind in record["residual"]["after"].values():
        kind["unit"] = evil
    record["units"] = {"length": evil, "angle": evil}
    record["holdout_note"] = record["method"] = evil
    page = read(to_html(collect([write_fit(tmp_path / "f", record)])))
    assert page.scripts == 3 + page.held
    assert evil in "".join(page.text)
    assert not [a for a in page.attributes if a[1].startswith("on")]


@pytest.mark.slow
@pytest.mark.parametrize("drop", sorted(identification()))
def test_any_key_may_be_missing(tmp_path: Path, drop: str) -> None:
    record = identification()
    del record[drop]
    data = collect([write_fit(tmp_path / "f", record)])
    read(to_html(data))
    to_json(data)
    record[drop] = None
    (tmp_path / "f" / "identification.json").write_text(json.dumps(record))
    read(to_html(collect([tmp_path / "f"])))


def test_parameters_csv_alone_is_enough(tmp_path: Path) -> None:
    write_csv(tmp_path / "parameters.csv", {
        "name": ["leg1.offset"], "nominal": [1.0], "value": [1.25], "error": [0.25],
        "sigma": [0.01], "sigma_data": [""], "tolerance": [0.4], "unit": ["mm"],
        "status": ["redundant"]})
    data = collect([tmp_path])
    assert to_json(data)["identifications"][0]["parameters"][0]["value"] == 1.25
    assert data.identified[0].record.parameters[0].sigma_data is None
    assert "1.250" in to_html(data)


def test_diagnosis(tmp_path: Path) -> None:
    record = {"verdict": "named", "effects": [
        {"kind": "backlash", "on": ["leg1"], "parameters": {"width": {
            "value": 0.0212, "sigma": 0.001, "unit": "mm"}}, "p_value": 1e-9, "survival": 0.9,
         "alternatives": ["windup"]}],
        "remainder": {"follows": "time", "p_value": 0.02},
        "gap": {"before": 3.1, "after": 1.02, "closed": 0.93, "interval": [0.9, 0.95]},
        "localised": [{"by": "actuator", "value": "leg1", "rms_ratio": 3.4, "p_value": 1e-6}],
        "not_testable": [{"kind": "lag", "missing": ["vel_leg1"]}],
        "next_measurements": {"reason": "both directions", "file": "next.csv"}}
    (tmp_path / "diagnosis.json").write_text(json.dumps(record))
    data = collect([tmp_path])
    page = to_html(data)
    text = "".join(read(page).text)
    for piece in ("The missing effect is named: backlash on leg1.", "width 0.0212 ± 0.0020 mm",
                  "p\u00a0<\u00a010⁻⁸", "90 %", "windup",
                  "What is left follows time (p\u00a0=\u00a00.02)",
                  "residuals drop from 3.10 to 1.02 times the noise",
                  "93 % of the excess error is explained (95 % interval: 90 % to 95 %)",
                  "Where the residuals are, group by group",
                  "Both directions. They are in next.csv"):
        assert piece in text, piece
    assert cells(page, "Not testable") == [["effect", "columns missing"], ["lag", "vel_leg1"]]
    assert cells(page, "rms of the residuals of that group")[1] == [
        "actuator", "leg1", "3.40", "–", "p\u00a0<\u00a010⁻⁵"]
    assert to_json(data)["diagnoses"][0]["diagnosis"] == record
    (tmp_path / "diagnosis.json").write_text('{"units": "mm"}')
    with pytest.raises(BadInput, match="units: should be an object"):
        collect([tmp_path])


def test_unknown_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no folder"):
        collect([])
    with pytest.raises(BadInput, match="does not exist"):
        collect([tmp_path / "none"])
    (tmp_path / "demo").mkdir()
    with pytest.raises(BadInput) as refusal:
        collect([tmp_path / "demo"])
    assert str(tmp_path / "demo") in str(refusal.value)
    assert all(name in str(refusal.value) for name in KNOWN)
    write_commands(tmp_path / "demo" / "comp")
    with pytest.raises(BadInput, match="Did you mean its folders comp"):
        collect([tmp_path / "demo"])
    with pytest.raises(BadInput, match="is a file"):
        collect([tmp_path / "demo" / "comp" / "commands.csv"])
    with pytest.raises(BadInput, match="cannot be read"):
        collect([tmp_path / ("a" * 300)])


BROKEN_JSON = {
    '{"name": "a", "parameters": [': "line 1, column",
    "": "line 1, column 1",
    "[1]": "no JSON object",
    "[" * 20000: "identification.json",
    '{"parameters": {"a": 1}}': "parameters: should be a list",
    '{"parameters": [3]}': r"parameters\[0\]: should be an object",
    '{"parameters": [null]}': r"parameters\[0\]",
    '{"parameters": [{"name": "a", "sigma": "small"}]}': r"parameters\[0\].sigma: .* number",
    '{"residual": {"after": {"position": {"rms": [1]}}}}': "residual.after.position.rms",
    '{"noise": 3}': "noise: should be an object",
    '{"units": {"length": 1}}': "units.length: should be text",
    '{"provenance": {"inputs": ["a"]}}': "provenance.inputs",
    '{"rank": ' + "1" * 5000 + "}": "cannot be read as JSON",
}


@pytest.mark.parametrize("text", BROKEN_JSON)
def test_broken_json_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "identification.json").write_text(text)
    with pytest.raises(BadInput, match=BROKEN_JSON[text]) as refusal:
        collect([tmp_path])
    assert "identification.json" in str(refusal.value)


BROKEN_CSV = {
    b"": "is empty",
    b"row,before_x\n1,2": "last line",
    b"row,before_x\n1\n": "row 1: the row has 1 cells",
    b"row,before_x\n1,2\n2,abc\n": "row 2, column before_x",
    b"row,before_x\n1,1e300\n": "row 1, column before_x",
    b"row,row\n1,2\n": "called 'row'",
    b"\n": "is empty",
    b",\n": "column 1 has no name",
    b"row,used\n1,yes\n": "row 1, column used: 'yes' is not a number",
    b"row,before_x\n1,\xff\n": "UTF-8",
    b'row,reason\n1,"open\n': "CSV",
}


@pytest.mark.parametrize("content", BROKEN_CSV)
def test_broken_csv_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "residuals.csv").write_bytes(content)
    with pytest.raises(BadInput, match=BROKEN_CSV[content]) as refusal:
        collect([tmp_path])
    assert "residuals.csv" in str(refusal.value)


def test_tables_are_read_back_by_their_specs(tmp_path: Path) -> None:
    """Which columns hold numbers is said beside what writes them, whatever words look like."""
    write_csv(tmp_path / "residuals.csv", {
        "row": [1, 2], "dataset": ["0701", "0702"], "after_x": ["", "-1e-3"], "sigma_x": [1, "inf"],
        "used": ["true", 0], "reason": ["", "7.0"]})
    found = RESIDUAL_TABLE.read(tmp_path / "residuals.csv")
    assert found.words("dataset") == ("0701", "0702") and found.words("reason") == ("", "7.0")
    assert found.number("used").tolist() == [1.0, 0.0] and found.number("sigma_x")[1] == np.inf
    assert np.isnan(found.number("after_x")[0]) and found.number("after_x")[1] == -1e-3
    assert RESIDUAL_TABLE.entries(found)[0] == {
        "row": 1.0, "dataset": "0701", "after_x": None, "sigma_x": 1.0, "used": True, "reason": ""}
    only = RESIDUAL_TABLE.read(tmp_path / "residuals.csv", ("row",).__contains__)
    assert (set(only.numbers), only.text, only.size) == ({"row"}, {}, 2)


def test_a_folder_without_its_record_has_the_parameters_of_its_table(tmp_path: Path) -> None:
    write_csv(tmp_path / "parameters.csv", {
        "name": ["a", "b"], "value": [1.5, 2], "sigma": [0.1, ""], "unit": ["mm", "mm"],
        "status": ["identified", "fixed"], "sigma_sessions": [0.2, ""], "disagree": [1, ""]})
    (one,) = collect([tmp_path]).identified
    first, second = one.record.parameters
    assert (first.name, first.value, first.sigma, first.disagree) == ("a", 1.5, 0.1, True)
    assert (second.sigma, second.status, second.disagree) == (None, "fixed", None)


@pytest.mark.parametrize("left", [(0.03, 0.04), (1e-9, 2e-9)])
def test_the_models_uncertainty_counts_once_in_corrected_commands(tmp_path: Path, left: tuple
                                                                  ) -> None:
    """It is in what commands.csv says is left; files of earlier versions have it beside."""
    folder = write_commands(tmp_path / "comp")
    write_csv(folder / "commands.csv", {
        "x": [1.0, 2.0], "error_position_before": [0.3, 0.4], "error_position_after": left,
        "sigma_position": [0.03, 0.04], "status": ["ok", "ok"], "reason": ["", ""]})
    row = next(r for r in cells(to_html(collect([folder])), "Error predicted")
               if r[0] == "position, corrected")
    assert row[2:] == ["0.0350", "0.0354", "0.0400"]


def test_what_was_tried_is_told_with_its_probability(tmp_path: Path) -> None:
    write_csv(tmp_path / "effects.csv", {
        "kind": ["gain", "play", "drift"], "on": ["leg1", "leg2", ""], "form": ["each"] * 3,
        "p_value": [""] * 3, "survival": [0.5, 0.4, ""], "status": ["tried", "named", "tried"],
        "probability": [0.03, 0.9999, 1e-5]})
    data = collect([tmp_path])
    rows = cells(to_html(data), "Every hypothesis")[1:]
    assert [(r[0], r[3]) for r in rows] == [
        ("play", "> 0.999"), ("gain", "0.030"), ("drift", "< 0.001")]
    (shown,) = to_json(data)["diagnoses"]
    assert [c["probability"] for c in shown["candidates"]] == [0.03, 0.9999, 1e-5]
    assert shown["candidates"][2]["survival"] is None


def test_headers_without_rows_are_fine(tmp_path: Path) -> None:
    for name, head in (("residuals", "row,dataset,before_x,after_x,sigma_x,used,reason"),
                       ("commands", "x,q_leg1,status,reason"), ("kinematics", "x,status"),
                       ("parameters", "name,value"), ("measurements", "x,y")):
        (tmp_path / f"{name}.csv").write_text(head + "\n")
    data = collect([tmp_path])
    read(to_html(data))
    to_json(data)


@pytest.mark.slow
def test_large_data_are_thinned(tmp_path: Path) -> None:
    rows = 30_000
    write_fit(tmp_path / "big", identification(), rows)
    html = to_html(collect([tmp_path / "big"]))
    assert len(html) < 5_000_000 and len(own(html)) < 1_000_000
    assert "Thinned: each stroke spans the lowest to the highest of about 100 rows" in html


def test_all_missing_values_make_a_page(tmp_path: Path) -> None:
    write_csv(tmp_path / "residuals.csv", {
        "row": [1, 2], "dataset": ["a", "b"], "before_x": ["", "nan"], "after_x": ["", ""],
        "sigma_x": ["", 0.0], "before_y": [1, 2], "after_y": [0.0, 0.0], "sigma_y": [1, 1]})
    read(to_html(collect([tmp_path])))


def test_thinning_keeps_the_extremes() -> None:
    y = np.random.default_rng(2).normal(size=10_000)
    y[1234], y[77] = 99.0, np.nan
    x, low, below, above, high = envelope(y, 50)
    assert np.all(low < below) and np.all(above < high)
    assert x.size == 50 and high.max() == 99.0 and low.min() == np.nanmin(y)
    places = np.random.default_rng(3).uniform(size=(5000, 2))
    size = np.arange(5000.0)
    rows = evenly_spread(places, size)
    assert rows.size <= 22 * 22 and 4999 in rows


def test_axes() -> None:
    assert span([0.002, 0.7], log=True) == Axis(1e-3, 1.0, True)
    assert [round(t, 9) for t in Axis(-0.011, 0.021).ticks()] == [-0.01, 0.0, 0.01, 0.02]
    assert list(Axis(1e-4, 1e-2, True).ticks()) == pytest.approx([1e-4, 1e-3, 1e-2])
    assert list(Axis(0.01, 0.1, True).ticks()) == pytest.approx([0.01, 0.02, 0.05, 0.1])
    for values in ([], [3.0], [0.0, 0.0], [np.nan], [1e300, -1e300], [1e-300, 2e-300]):
        for log in (False, True):
            axis = span(values, log=log)
            assert axis.high > axis.low and np.all(np.isfinite(axis.ticks()))


def test_numbers_have_sensible_digits() -> None:
    assert [sig(v) for v in (0.012345, 1234.5, 0, None, -1.23e-7, float("nan"))] == [
        "0.0123", "1234", "0", "–", "−1.23·10⁻⁷", "–"]
    assert sig(9.999) == "10.0"
    assert to_sigma(10.50123, 0.0041) == "10.5012" and to_sigma(-1e-9, 0.01) == "0.000"
    assert probability(1e-9) == f"p{NBSP}<{NBSP}10⁻⁸" and probability(0.4) == f"p{NBSP}={NBSP}0.4"


def test_noise_verdicts() -> None:
    none = unsaid(Noise)
    assert noise_verdict(replace(none, sigma_ratio=3.0, chi2_p=1e-9))[1] is False
    assert "below" in noise_verdict(replace(none, sigma_ratio=0.2, chi2_p=1.0))[0]
    assert "consistent" in noise_verdict(replace(none, sigma_ratio=1.0, chi2_p=0.4))[0]
    assert noise_verdict(none) == ("", True)
    assert typeset("p = 1.2e-09, -0.5*a - b +- 2 chi-squared of leg-1") == (
        "p = 1.2·10⁻⁹, −0.5 × a − b ± 2 χ² of leg-1")
    assert combination(Dependence("a", {})) == "nothing: no effect on these measurements"


def test_a_row_is_told_with_what_its_own_file_says(tmp_path: Path) -> None:
    rows = 6
    write_csv(tmp_path / "day.csv", {
        "pose": [f"p{i}" for i in range(rows)], "q_leg1": range(rows),
        "x": [10.0 + i / 3.0 for i in range(rows)], "y": [0.5] * rows,
        "temperature": [20.0 + i for i in range(rows)], "approach": ["+", "-"] * 3})
    sha = hashlib.sha256((tmp_path / "day.csv").read_bytes()).hexdigest()
    record = identification(inputs={str(tmp_path / "day.csv"): sha})
    record["datasets"][0]["source"] = str(tmp_path / "day.csv")
    (one,) = collect([write_fit(tmp_path / "fit", record, rows)]).identified
    assert one.measured is not None
    assert one.measured.said(1) == ["pose p1", "x 10.3333", "y 0.5", "temperature 21",
                                    "approach -"]
    assert one.positions is not None and one.positions[1].tolist() == [10.0 + 1 / 3, 0.5]
    html = to_html(collect([tmp_path / "fit"]))
    assert "temperature 21" in html and "q_leg1" not in html
    (tmp_path / "day.csv").write_text("pose,x\n1,2\n")
    assert collect([tmp_path / "fit"]).identified[0].measured is None


@pytest.mark.parametrize("module", ["page", "collect", "section", "html"])
def test_what_makes_the_page_names_no_command(module: str) -> None:
    """A kind of output is declared beside its section; `kinds` alone lists them."""
    tree = tree_of(Path(report.__file__).parent / f"{module}.py")
    said = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)} | {
        n.module.rpartition(".")[2] for n in ast.walk(tree)
        if isinstance(n, ast.ImportFrom) and n.module}
    assert not said & ({name for name in commands.names() if name != "report"}
                       | {kind.place for kind in KINDS} | {"identification", "diagnosis"})


def test_every_kind_of_output_is_told_apart_by_its_files_and_has_a_place() -> None:
    assert len({kind.place for kind in KINDS}) == len({kind.key for kind in KINDS}) == len(KINDS)
    assert {kind.place for kind in KINDS}.isdisjoint({"folders", "held", "use"})
    assert len({kind.order for kind in KINDS}) == len(KINDS)


def test_a_chapter_is_a_declaration_and_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                                               ) -> None:
    """Of a file that no version has written: a chapter, a look, a list in the JSON."""
    walks: Kind[Held[AnyRecord]] = Kind(
        "walked", "walks", "walk", 55, ("walk.json",),
        lambda folder: [Held(folder.name, AnyRecord(findings=("muddy",)))],
        lambda one, _: [("A walk", lambda: Section("A walk", "<p>in the hills</p>"))],
        lambda one, _: {"folder": one.folder}, lambda _: [],
        lambda one, _: [(one.folder, text) for text in one.record.findings or ()])
    (tmp_path / "walk.json").write_text("{}")
    reader, page = (import_module(f"ppmcal.report.{name}") for name in ("collect", "page"))
    for module, name, value in ((reader, "KINDS", (*KINDS, walks)), (reader, "KNOWN", walks.files),
                                (page, "KINDS", (*KINDS, walks)), (page, "IN_ORDER", (walks,))):
        monkeypatch.setattr(module, name, value)
    data = collect([tmp_path])
    assert "in the hills" in to_html(data)
    told = to_json(data)
    assert told["walks"] == [{"folder": str(tmp_path)}]
    assert told["attention"] == [{"where": str(tmp_path), "what": "muddy"}]
