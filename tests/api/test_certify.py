"""Certificates: every figure worked out again, what is refused, and the files that come of it."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bench_by_hand import LEGS, Bench
from helpers.browser import Browser, needs_browser
from helpers.certificates import KINDS, certificate, measure_twice, write_about
from helpers.commands import ppmcal
from helpers.dcc import against_the_schema, faults
from scipy import stats

import ppmcal as face
from ppmcal.calibration.fit import Noise
from ppmcal.calibration.validation import Budget, Contribution, Figure
from ppmcal.commands.certify import evidence
from ppmcal.commands.certify.about import read_about
from ppmcal.commands.certify.evidence import refuse_uncertifiable, refuse_unknown_cause
from ppmcal.commands.certify.judge import bidirectional, decided, one_sided, pose_figures
from ppmcal.commands.certify.printed import wrapped
from ppmcal.commands.inputs import prepared
from ppmcal.errors import BadInput
from ppmcal.io.results.certificate import alike
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import ErrorStages
from ppmcal.io.results.parts import ErrorSize
from ppmcal.wording import number

RULE = {"rule": "guarded acceptance", "limit": 0.1}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a calibrated 3-RPR, another session, and its certificate."""
    folder = tmp_path_factory.mktemp("bench")
    measure_twice(folder, "3-RPR")
    ppmcal("identify", "m.yaml", "cal.csv", "--quiet", cwd=folder, expect=0)
    write_about(folder, decision=RULE, repeats={"iso_9283": 6})
    certificate(folder, "val.csv", "--about", "about.yaml")
    return folder


@pytest.fixture(scope="module")
def record(bench: Path) -> dict[str, Any]:
    return dict(json.loads((bench / "certificate/certificate.json").read_text("utf-8")))


@pytest.fixture(scope="module")
def by_hand(bench: Path) -> Bench:
    return Bench(bench)


def value(record: dict[str, Any], symbol: str = "", name: str = "") -> float:
    found, = (f for f in record["figures"] if f["symbol"] == symbol and name in f["name"])
    return float(found["value"])


# ---- figures


@pytest.mark.slow
def test_errors_are_those_of_the_other_session(record: dict[str, Any], by_hand: Bench) -> None:
    position = np.hypot(*by_hand.errors[:, :2].T)
    for kind, errors in (("position", position), ("rotation", np.abs(by_hand.errors[:, 2]))):
        for name, wanted in (("rms error", np.sqrt(np.mean(errors**2))),
                             ("95 % point", np.quantile(errors, 0.95)),
                             ("largest error", errors.max())):
            assert value(record, name=f"{name} of {kind}") == pytest.approx(wanted, rel=1e-5)


@pytest.mark.slow
def test_pose_accuracy_and_repeatability_are_those_of_iso_9283(record: dict[str, Any],
                                                               by_hand: Bench) -> None:
    found: dict[str, list[float]] = {"AP_p": [], "RP_l": [], "AP_rz": [], "RP_rz": []}
    for rows in by_hand.sets():
        x, y, rz = by_hand.errors[rows].T
        n = len(rows)
        assert n == 6
        length = np.sqrt((x - x.sum() / n) ** 2 + (y - y.sum() / n) ** 2)
        spread = np.sqrt(((length - length.sum() / n) ** 2).sum() / (n - 1))
        found["AP_p"].append(np.hypot(x.sum() / n, y.sum() / n))
        found["RP_l"].append(length.sum() / n + 3.0 * spread)
        found["AP_rz"].append(abs(rz.sum() / n))
        found["RP_rz"].append(3.0 * np.sqrt(((rz - rz.sum() / n) ** 2).sum() / (n - 1)))
    for symbol, values in found.items():
        assert value(record, symbol) == pytest.approx(max(values), rel=1e-4), symbol


@pytest.mark.slow
def test_figures_of_the_axes_are_those_of_iso_230_2(record: dict[str, Any], by_hand: Bench
                                                    ) -> None:
    for deviation, side, leg in zip(by_hand.deviations().T, by_hand.side.T, LEGS, strict=True):
        ends, both, reversals, repeats = [], [], [], []
        for pose in np.unique(by_hand.rows["pose"]):
            here = by_hand.rows["pose"] == pose
            up, down = (deviation[here & (side == s)] for s in (1, -1))
            assert min(len(up), len(down)) >= 5
            m, s = [up.mean(), down.mean()], [up.std(ddof=1), down.std(ddof=1)]
            both += m
            ends += [m[0] + 2 * s[0], m[0] - 2 * s[0], m[1] + 2 * s[1], m[1] - 2 * s[1]]
            reversals.append(abs(m[0] - m[1]))
            repeats.append(max(2 * s[0] + 2 * s[1] + reversals[-1], 4 * s[0], 4 * s[1]))
        for symbol, wanted in (("B", max(reversals)), ("R", max(repeats)),
                               ("E", max(both) - min(both)), ("A", max(ends) - min(ends))):
            assert value(record, symbol, leg) == pytest.approx(wanted, rel=1e-4), (symbol, leg)


@pytest.mark.long
def test_a_figure_that_the_rows_do_not_allow_says_why(bench: Path) -> None:
    write_about(bench, "strict.yaml")
    found = certificate(bench, "val.csv", "--about", "strict.yaml", out="strict")
    pose, = (f for f in found["figures"] if f["symbol"] == "AP_p")
    assert pose["value"] is None
    assert pose["why"] == ("at most 6 attained poses of a commanded pose from one direction, "
                           "30 are asked")
    assert value(found, "B", "leg1") > 0.0    # six approaches from each side are enough for it


@pytest.mark.long
def test_a_row_that_is_typed_wrong_counts_nowhere_and_is_told(bench: Path, tmp_path: Path,
                                                              record: dict[str, Any]) -> None:
    folder = Path(shutil.copytree(bench, tmp_path / "own"))
    lines = (folder / "val.csv").read_text("utf-8").split("\n")
    cells = lines[12].split(",")
    cells[lines[0].split(",").index("x")] = "1" + cells[lines[0].split(",").index("x")]
    lines[12] = ",".join(cells)
    (folder / "val.csv").write_text("\n".join(lines), "utf-8")
    run = ppmcal("certify", "identified", "val.csv", "--about", "about.yaml", "--out", "new",
                 cwd=folder, expect=1)
    assert "val: row 12 of 72 left out of every figure" in " ".join(run.out.split())
    found = json.loads((folder / "new/certificate.json").read_text("utf-8"))
    assert value(found, name="rms error of position") == pytest.approx(
        value(record, name="rms error of position"), rel=0.1)


def test_directions_are_kept_apart() -> None:
    sets = one_sided(np.array([0, 0, 0, 1, 1]), np.array([[1.0], [-1], [1], [np.nan], [np.nan]]))
    assert [s.tolist() for s in sets] == [[0, 2], [3, 4]]
    few = pose_figures(np.zeros((5, 3)), ("x", "y", "rz"), 2, sets, 3)
    assert {f.value for f in few} == {None} and few[0].repeats == 2


def test_reversal_alone_is_reversal_repeatability_and_accuracy() -> None:
    up, down = [np.full(5, 0.02)] * 5, [np.full(5, -0.01)] * 5
    assert bidirectional(up, down) == pytest.approx({"B": 0.03, "R": 0.03, "E": 0.03, "A": 0.03})


# ---- uncertainty and decision


@pytest.mark.slow
def test_budget_is_that_of_the_rows(record: dict[str, Any], by_hand: Bench) -> None:
    b = record["budget"]
    lines = {line["source"]: line for line in b["lines"]}
    scatter, degrees = by_hand.repeatability()
    assert lines["repeatability"]["standard"] == pytest.approx(scatter, rel=1e-5)
    assert lines["repeatability"]["degrees"] == degrees
    assert lines["registration"]["standard"] == pytest.approx(by_hand.registration(), rel=1e-4)
    assert lines["model parameters"]["standard"] == pytest.approx(by_hand.model(), rel=1e-3)
    assert lines["instrument"]["standard"] == pytest.approx(0.01 / 2)
    known = sum(lines[n]["standard"] ** 2 for n in ("repeatability", "registration",
                                                    "model parameters"))
    square = (by_hand.errors[:, :2] ** 2).mean()
    left = np.sqrt(max(square - known, 0.0))
    assert lines["unexplained remainder"]["standard"] == pytest.approx(left, abs=1e-6)
    parts = np.array([line["part"] for line in b["lines"]])
    freedoms = np.array([line["degrees"] or np.inf for line in b["lines"]])
    combined = np.sqrt((parts**2).sum())
    effective = combined**4 / (parts**4 / freedoms).sum()
    assert b["combined"] == pytest.approx(combined)
    assert b["degrees"] == pytest.approx(effective)
    assert b["factor"] == pytest.approx(stats.t.ppf(0.975, int(effective)))
    assert b["expanded"] == pytest.approx(b["factor"] * combined)


@pytest.mark.slow
def test_decision_keeps_a_guard_band_of_the_expanded_uncertainty(record: dict[str, Any]) -> None:
    d = record["decision"]
    assert d["accepted"] == pytest.approx(0.1 - record["budget"]["expanded"])
    assert d["result"] == "pass" and d["value"] == value(record, name="largest error of position")


@pytest.mark.parametrize(("rule", "figure", "result", "accepted"), [
    ("simple acceptance", 0.1, "pass", 0.1), ("simple acceptance", 0.11, "fail", 0.1),
    ("guarded acceptance", 0.07, "pass", 0.07), ("guarded acceptance", 0.08, "fail", 0.07),
    ("none", 9.0, "", None)])
def test_rules_of_decision(rule: str, figure: float, result: str, accepted: float | None) -> None:
    found = decided(rule, figure, 0.1, 0.03)
    assert found == (result, pytest.approx(accepted) if accepted else None)


def test_degrees_are_those_of_the_gum_s_end_gauge() -> None:
    """JCGM 100:2008, H.1.6: 16.7 degrees of freedom, taken down to 16."""
    parts = ((25.0, 18.0), (9.7, 25.6), (2.9, 50.0), (16.6, 2.0))
    one = Budget("", tuple(Contribution("", "A", "normal", u, n) for u, n in parts))
    assert one.degrees == pytest.approx(16.7, abs=0.1)
    assert one.factor == pytest.approx(stats.t.ppf(0.975, 16))
    assert Budget("", one.lines, True).expanded == pytest.approx(2.0 * one.combined)
    known = Budget("", (Contribution("", "B", "normal", 1.0, np.inf),))
    assert known.degrees == np.inf and known.factor == pytest.approx(1.96, abs=1e-3)


# ---- what is refused


@pytest.mark.slow
@pytest.mark.parametrize("name", ["identified/residuals.csv", pytest.param(
    "identified/parameters.csv", marks=pytest.mark.slow), pytest.param(
    "identified/identified.yaml", marks=pytest.mark.slow), pytest.param(
    "identified/identification.json", marks=pytest.mark.slow), "cal.csv", "m.yaml"])
def test_what_was_tampered_with_is_refused_and_named(bench: Path, tmp_path: Path, name: str
                                                     ) -> None:
    folder = Path(shutil.copytree(bench, tmp_path / "own"))
    path = folder / name
    lines = path.read_text("utf-8").split("\n")
    place = max(n for n, line in enumerate(lines) if re.search(r"\d\.\d*[1-8]\b", line))
    lines[place] = re.sub(r"(\d\.\d*)[1-8]\b", r"\g<1>9", lines[place], count=1)
    path.write_text("\n".join(lines), "utf-8")
    run = ppmcal("certify", "identified", "val.csv", "--about", "about.yaml", "--out", "new",
                 cwd=folder, expect=2)
    assert name.rpartition("/")[2] in run.err and "nothing is certified" in run.err
    assert not (folder / "new").exists()


@pytest.mark.slow
def test_what_changes_after_it_came_out_again_is_refused(bench: Path, tmp_path: Path,
                                                         monkeypatch: pytest.MonkeyPatch) -> None:
    folder = Path(shutil.copytree(bench, tmp_path / "own"))
    again = evidence.made_again

    def and_changed(asked: Any) -> Any:
        found = again(asked)
        with (folder / "identified/residuals.csv").open("a", encoding="utf-8") as file:
            file.write("\n")
        return found

    monkeypatch.setattr(evidence, "made_again", and_changed)
    run = ppmcal("certify", "identified", "val.csv", "--about", "about.yaml", "--out", "new",
                 cwd=folder, expect=2)
    assert "identified/residuals.csv: changed after it had come out again" in run.err


@pytest.mark.slow
def test_rows_that_the_model_was_fitted_to_are_refused(bench: Path) -> None:
    run = ppmcal("certify", "identified", "cal.csv", "--about", "about.yaml", "--out", "new",
                 cwd=bench, expect=2)
    assert "cal.csv: the model was fitted to these measurements" in run.err
    assert not (bench / "new").exists()


def a_record(**more: Any) -> IdentificationRecord:
    holdout = {"position": ErrorSize(rms=0.01, p95=0.02, max=0.03, unit="mm")}
    noise = Noise(sigma_ratio=1.0, chi2=50.0, degrees=50.0, chi2_p=0.5, repeat_ratio=None,
                  repeat_degrees=0)
    return IdentificationRecord(**{
        "converged": True, "method": "prior", "noise": noise,
        "residual": ErrorStages(holdout=holdout)} | more)


@pytest.mark.parametrize(("more", "said"), [
    ({"converged": False}, "had not converged"),
    ({"noise": Noise(sigma_ratio=3.0, chi2=450.0, degrees=50.0, chi2_p=1e-9, repeat_ratio=None,
                     repeat_degrees=0)}, "residuals are 3 times the noise"),
    ({"residual": ErrorStages()}, "no poses were held out")])
def test_what_cannot_be_certified_is_refused(more: dict[str, Any], said: str) -> None:
    refuse_uncertifiable(a_record(), Path("i"), False)
    with pytest.raises(BadInput, match=said) as error:
        refuse_uncertifiable(a_record(**more), Path("i"), False)
    assert error.value.hint and "identification.json" in error.value.where


def test_what_a_diagnosis_could_not_name_is_refused() -> None:
    refuse_unknown_cause("named", "d")
    with pytest.raises(BadInput, match="verdict unnamed"):
        refuse_unknown_cause("unnamed", "d")


@pytest.mark.parametrize(("more", "said"), [
    ({"number": None}, "the key 'number' is missing"),
    ({"machine": {"maker": "ACME"}}, "machine: the key 'serial' is missing"),
    ({"date": "14.3.2026"}, "date: '14.3.2026' is not a date. Write it as 2026-03-14"),
    ({"customer": {"name": "A", "country": "Germany"}}, "customer.country: 'Germany'"),
    ({"temperature": [21, 20]}, "temperature: [21, 20] is not a temperature"),
    ({"coverage": "3"}, "coverage: '3'"),
    ({"decision": {"rule": "guarded acceptance"}}, "needs a limit"),
    ({"decision": {"rule": "guarded", "limit": 1}}, "unknown decision rule 'guarded'"),
    ({"repeats": {"iso_9283": 1}}, "repeats.iso_9283: 1 is not a number of repeats"),
    ({"issued": "2026-03-01"}, "before the measurement")])
def test_faults_of_the_file_about_it_are_told_with_their_place(tmp_path: Path, more: dict[str, Any],
                                                               said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)) as error:
        read_about(write_about(tmp_path, **more))
    assert "about.yaml" in error.value.where and error.value.hint


@pytest.mark.parametrize(("more", "said"), [
    ({"instrument": None}, "the key 'instrument' is missing"),
    ({"date": "2026-01-09"}, "calibrated after the measurement")])
@pytest.mark.slow
def test_an_instrument_has_to_be_named_and_calibrated(bench: Path, more: dict[str, Any], said: str
                                                      ) -> None:
    write_about(bench, "odd.yaml", **more)
    run = ppmcal("certify", "identified", "val.csv", "--about", "odd.yaml", "--out", "new",
                 cwd=bench, expect=2)
    assert said in run.err and "odd.yaml" in run.err


# ---- files


@pytest.mark.slow
@pytest.mark.long_cases("3-RPS", "6-UPS", "delta-rotary", "maslow")
@pytest.mark.parametrize("kind", ["3-RPR", *(pytest.param(k, marks=pytest.mark.slow)
                                            for k in KINDS if k != "3-RPR")])
def test_the_digital_certificate_is_valid(bench: Path, tmp_path: Path, kind: str) -> None:
    folder = bench if kind == "3-RPR" else tmp_path
    if kind != "3-RPR":
        measure_twice(folder, kind)
        ppmcal("identify", "m.yaml", "cal.csv", "--quiet", cwd=folder)
        alone = {"instrument": None} if kind == "maslow" else {}
        write_about(folder, decision=RULE | {"limit": 5}, **alone)
        found = certificate(folder, "val.csv", "--about", "about.yaml")
        assert bool(found["gauge"]) == (kind == "maslow")
        assert found["budget"]["expanded"] > 0.0
    text = (folder / "certificate/certificate.xml").read_text("utf-8")
    assert faults(text) == []
    against_the_schema(text)


@pytest.mark.slow
def test_numbers_of_the_xml_are_those_of_the_json(bench: Path, record: dict[str, Any]) -> None:
    text = (bench / "certificate/certificate.xml").read_text("utf-8")
    largest = value(record, name="largest error of position")
    assert f"<si:value>{largest!r}</si:value>" in text
    assert r"<si:unit>\milli\metre</si:unit>" in text
    assert f"<si:valueExpandedMU>{record['budget']['expanded']!r}</si:valueExpandedMU>" in text
    assert "<dcc:conformity>pass</dcc:conformity>" in text
    assert "Customer &amp; Sons" in text and "Köln" in text


@pytest.mark.slow
def test_faults_of_a_digital_certificate_are_found(bench: Path) -> None:
    text = (bench / "certificate/certificate.xml").read_text("utf-8")
    for old, new in (("<dcc:countryCode>DE", "<dcc:countryCode>Germany"),
                     (r"\milli\metre", "mm"), ("si:expandedMU>", "si:expandedUnc>"),
                     ("3.3.0", "3.2.1")):
        assert faults(text.replace(old, new)), old


@pytest.mark.slow
def test_the_pdf_has_two_or_three_pages_and_no_date(bench: Path) -> None:
    pdf = (bench / "certificate/certificate.pdf").read_bytes()
    assert pdf.startswith(b"%PDF-") and b"CreationDate" not in pdf
    count = re.search(rb"/Count (\d+)", pdf)
    assert count and 2 <= int(count[1]) <= 3


def test_lines_of_the_pdf_are_broken_at_words_and_long_words_anywhere() -> None:
    lines = wrapped("accuracy of a machine " + "x" * 90, 1.0, 8.5)
    assert lines[0] == "accuracy of a" and "".join(lines).count("x") == 90 and len(lines) > 6


@pytest.mark.slow
def test_results_in_python(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(bench)
    found = face.certify("identified", "about.yaml", ["val.csv"])
    assert found.exit_code == 0 and "C-2026-014" in repr(found)
    frame = found.to_frame()
    assert len(frame["value"]) == len(found.record.figures)


@pytest.mark.long
def test_a_folder_of_validate_certifies_the_same_and_is_made_again(bench: Path) -> None:
    ppmcal("validate", "identified", "val.csv", "--quiet", cwd=bench)
    found = certificate(bench, "validated", "--about", "about.yaml", out="by-folder")
    plain = certificate(bench, "val.csv", "--about", "about.yaml")
    assert found["figures"] == plain["figures"]
    own = json.loads((bench / "validated/validation.json").read_text("utf-8"))
    rms = own["datasets"][0]["errors"][0]["position"]["rms"]
    assert value(found, name="rms error of position") == pytest.approx(rms)
    said = ppmcal("verify", "by-folder", cwd=bench, expect=0).out
    assert "the same" in said or "same" in said


@pytest.mark.slow
def test_a_bare_word_of_what_was_registered_is_that_word(bench: Path) -> None:
    """Python records ``register="frame"`` as it is, the command line a list."""
    machine, (data,) = prepared(face.load(bench / "identified"), [str(bench / "val.csv")], "none")
    bare, listed = (evidence.judged(machine, data, word).errors for word in ("frame", ["frame"]))
    np.testing.assert_array_equal(bare, listed)


@pytest.mark.long
def test_a_failed_decision_is_a_finding_and_held_out_poses_do(bench: Path) -> None:
    write_about(bench, "tight.yaml", decision={"rule": "guarded acceptance", "limit": 0.001})
    run = ppmcal("certify", "identified", "--about", "tight.yaml", "--out", "tight", cwd=bench,
                 expect=1)
    assert "held out of the fit" in " ".join(run.out.split()) and "fail" in run.out
    assert max(map(len, run.out.splitlines())) <= 80


@needs_browser
@pytest.mark.slow
@pytest.mark.xdist_group("browser")
def test_the_page_fits_on_a4(bench: Path, tmp_path: Path) -> None:
    with Browser() as browser:
        page = browser.open(bench / "certificate/certificate.html", width=794, height=1123)
        page.media(kind="print")
        beside = page.evaluate(
            "[...document.querySelectorAll('body *')].filter(e => e.scrollWidth > e.clientWidth + 1"
            " && getComputedStyle(e).display !== 'inline').map(e => e.outerHTML.slice(0, 90))")
        assert beside == []
        assert page.evaluate("document.documentElement.scrollWidth") <= 794
        page.pdf(tmp_path / "printed.pdf")
        assert not page.errors and not page.requests
    printed = (tmp_path / "printed.pdf").read_bytes()
    assert 2 <= int(re.findall(rb"/Count (\d+)", printed)[0]) <= 4


# ---- reports


@pytest.mark.slow
def test_a_report_has_what_the_certificate_states(bench: Path, record: dict[str, Any]) -> None:
    ppmcal("report", "certificate", "--out", "page", cwd=bench, expect=0)
    page = (bench / "page/report.html").read_text("utf-8")
    chapter = page[page.index("Calibration certificate"):]
    for words in ("Uncertainty (GUM)", "Decision", "Range of validity", "certificate.html"):
        assert words in chapter
    for figure in record["figures"]:
        assert figure["value"] is None or number(figure["value"], 4).replace("-", "−") in chapter
    told = json.loads((bench / "page/report.json").read_text("utf-8"))
    assert [c["record"]["figures"] for c in told["certificates"]] == [record["figures"]]


@pytest.mark.slow
def test_a_limit_that_is_not_kept_is_what_to_look_at(bench: Path, tmp_path: Path) -> None:
    failed = json.loads((bench / "certificate/certificate.json").read_text("utf-8"))
    failed["decision"]["result"] = "fail"
    (tmp_path / "certificate.json").write_text(json.dumps(failed), "utf-8")
    ppmcal("report", tmp_path, "--out", tmp_path / "page", expect=0)
    told = json.loads((tmp_path / "page/report.json").read_text("utf-8"))
    assert any("the agreed limit is not kept" in a["what"] for a in told["attention"])


def test_figures_that_rows_do_not_allow_are_told_once_for_joints_and_files() -> None:
    """Three reflectors on a hexapod are not seventy-two names in a cell."""
    figures = [Figure(s, s, None, norm="ISO 230-2", where=f"leg{leg}", why="no direction",
                      file=f"run T{target}")
               for target in (1, 2, 3) for leg in (1, 2) for s in "BREA"]
    one = [Figure("A", "A", None, norm="ISO 230-2", where="leg3", why="no direction",
                  file="run T1"), Figure("AP_p", "AP_p", None, norm="ISO 230-2")]
    assert list(alike(figures)) == ["B, R, E, A of leg1, leg2 (run T1, run T2, run T3)"]
    assert list(alike([*figures, *one])) == [
        "B, R, E, A of leg1, leg2 (run T1, run T2, run T3)", "A of leg3 (run T1)", "AP_p"]
