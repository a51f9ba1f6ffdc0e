"""What is told beside a result never ends the command: it is left out, and a note says so."""

import json
import logging

import numpy as np
import pytest

import ppmcal
from ppmcal.calibration.fit.secondary_analyses import LEFT_OUT
from ppmcal.calibration.sessions import change_detection, day_noise
from ppmcal.calibration.validation import frozen_models
from ppmcal.commands.compensate import run as compensate_command
from ppmcal.commands.export import run as export_command
from ppmcal.commands.kinematics import run as kinematics_command
from ppmcal.commands.tolerances import run as tolerances_command
from ppmcal.design.plan import plan as planning
from ppmcal.diagnosis.plot_data import PlotData, SelectionStep
from ppmcal.errors import LinearAlgebraError
from ppmcal.io.results import plan as plan_record
from ppmcal.io.results import tolerances as tolerances_record
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_parts import HeldOutGap
from ppmcal.plotting import curves, maps
from ppmcal.report import batch as batch_report
from ppmcal.report import diagnosis_figures, figure_files, identified, page

BENCH = ppmcal.shipped("3-RPR")
TARGETS = {"x": [500.0, 505.0], "y": [260.0, 262.0], "rz": [25.0, 26.0]}
WHY = "an extra that had no answer"


@pytest.fixture(scope="module")
def runs():
    return [ppmcal.simulate(BENCH, ppmcal.shipped("3-RPR", scenario=True), seed=s)
            for s in (3, 4)]


@pytest.fixture(scope="module")
def folders(runs, tmp_path_factory):
    out = [tmp_path_factory.mktemp("fit") / "out" for _ in runs]
    for run, folder in zip(runs, out, strict=True):
        ppmcal.identify(BENCH, run.data, holdout=0.0).save(folder)
    return out


@pytest.fixture
def break_(monkeypatch):
    def broken(*modules_and_names, error=ValueError):
        def fails(*_, **__):
            raise error(WHY)

        for module, name in modules_and_names:
            monkeypatch.setattr(module, name, fails)

    return broken


def left_out(lines):
    return [line for line in lines if line.startswith(f"{LEFT_OUT}: ") and WHY in line]


@pytest.mark.slow
def test_compare_tells_what_changed_without_names_or_platform(folders, break_):
    whole = ppmcal.compare(*folders)
    break_((change_detection, "pose_difference"), (change_detection, "explanations"),
           error=np.linalg.LinAlgError)
    bare = ppmcal.compare(*folders)
    assert bare.comparison.p_value == whole.comparison.p_value
    np.testing.assert_array_equal(bare.comparison.sigma, whole.comparison.sigma)
    assert len(left_out(bare.findings)) == len(left_out(bare.record.findings)) == 2
    assert bare.record.moved is None and "comparison.json" in bare.files()


@pytest.mark.slow
def test_compensate_sends_commands_without_what_is_told_beside_them(folders, break_):
    model = folders[0] / "identified.yaml"
    whole = ppmcal.compensate(model, TARGETS, frame="base")
    break_((compensate_command, "doubts"), (compensate_command, "beyond_measured"))
    bare = ppmcal.compensate(model, TARGETS, frame="base")
    np.testing.assert_array_equal(bare.compensation.q, whole.compensation.q)
    assert len(left_out(bare.notes)) == 2
    assert (whole.exit_code, bare.exit_code) == (0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["averaged", "worse_rows", "unsafe_ways"])
def test_what_decides_whether_commands_are_safe_is_no_extra(folders, break_, name):
    break_((compensate_command, name))
    with pytest.raises((ppmcal.PpmcalError, ValueError), match=WHY):
        ppmcal.compensate(folders[0] / "identified.yaml", TARGETS, frame="base")


@pytest.mark.slow
def test_validate_judges_the_machine_without_the_noise_of_the_day(runs, folders, break_):
    whole = ppmcal.validate(folders[0], runs[1].data)
    break_((day_noise, "day_noise"))
    bare = ppmcal.validate(folders[0], runs[1].data)
    assert (bare.validated[0].errors[0].position["rms"]
            == whole.validated[0].errors[0].position["rms"])
    assert len(left_out(bare.findings)) == 1
    assert bare.noise[0].source == "stated"


@pytest.mark.slow
def test_validate_leaves_out_another_machine_that_cannot_be_judged(
        runs, folders, monkeypatch):
    registered = frozen_models._registered
    nominal = ppmcal.load(BENCH).values

    def fails(mechanism, data):
        if np.array_equal(mechanism.values, nominal):
            raise LinearAlgebraError(WHY)
        return registered(mechanism, data)

    monkeypatch.setattr(frozen_models, "_registered", fails)
    found = ppmcal.validate(folders[0], runs[1].data)
    assert [e.label for e in found.validated[0].errors] == ["model"]
    (note,) = left_out(found.findings)
    assert "nominal, as a prediction of" in note


@pytest.mark.slow
def test_validate_refuses_where_the_machine_itself_cannot_be_judged(runs, folders, break_):
    break_((frozen_models, "_registered"), error=LinearAlgebraError)
    with pytest.raises((ppmcal.PpmcalError, ValueError), match=WHY):
        ppmcal.validate(folders[0], runs[1].data)


@pytest.mark.slow
def test_export_without_how_well_the_model_is_known(folders, break_, tmp_path):
    poses = tmp_path / "poses.csv"
    poses.write_text("x,y,rz\n500,260,25\n505,262,26\n", encoding="utf-8")
    whole = ppmcal.export("grid", folders[0] / "identified.yaml", poses=poses)
    break_((export_command, "pose_uncertainty"))
    bare = ppmcal.export("grid", folders[0] / "identified.yaml", poses=poses)
    assert bare.record.after == whole.record.after
    assert len(left_out(bare.findings)) == 1
    assert WHY in bare.files()["export.json"]


@pytest.mark.slow
def test_kinematics_without_how_well_the_model_is_known(folders, break_):
    whole = ppmcal.inverse(folders[0] / "identified.yaml", TARGETS)
    break_((kinematics_command, "model_sigma"))
    bare = ppmcal.inverse(folders[0] / "identified.yaml", TARGETS)
    np.testing.assert_array_equal(bare.q, whole.q)
    assert len(left_out(bare.findings)) == 1
    assert "not known" in bare.headline() and "kinematics.json" in bare.files()


@pytest.mark.long
def test_plan_without_its_comparisons(break_):
    whole = ppmcal.plan(BENCH, count=4, seed=1)
    break_((planning, "_against"))
    bare = ppmcal.plan(BENCH, count=4, seed=1)
    assert bare.plan.chosen == whole.plan.chosen
    assert len(left_out(bare.findings)) == 1
    assert "plan.json" in bare.files() and not any("nan" in s for s in bare.record.summary)


@pytest.mark.slow
def test_tolerances_without_what_the_linear_model_expects(break_):
    whole = ppmcal.tolerances(BENCH, accuracy=1.0, machines=20, cores=1)
    break_((tolerances_command, "_expected"), (tolerances_command, "root_sum_square"))
    bare = ppmcal.tolerances(BENCH, accuracy=1.0, machines=20, cores=1)
    assert bare.record.costs == whole.record.costs
    assert len(left_out(bare.findings)) == 2
    assert "tolerances.json" in bare.files()


@pytest.mark.slow_cases("tolerances", "plan")
@pytest.mark.parametrize(("make", "places", "kept"), [
    (lambda: ppmcal.plan(BENCH, count=4), [(plan_record, "accuracy_picture")], "plan.json"),
    (lambda: ppmcal.tolerances(BENCH, accuracy=1.0, machines=20, cores=1),
     [(tolerances_record, "yield_picture")], "tolerances.json"),
    (lambda: ppmcal.sensitivity(BENCH), [(curves, "draw_curves"), (maps, "draw_map")],
     "sensitivity.json"),
    (lambda: ppmcal.inverse(BENCH, TARGETS, pictures=True), [(figure_files, "to_png")],
     "kinematics.json"),
], ids=["plan", "tolerances", "sensitivity", "kinematics"])
def test_results_are_written_without_a_picture_that_cannot_be_drawn(
        make, places, kept, break_, caplog, tmp_path):
    result = make()
    break_(*places)
    with caplog.at_level(logging.WARNING):
        written = {p.name for p in result.save(tmp_path / "out")}
    assert kept in written and not any(n.endswith(".png") for n in written)
    assert left_out(r.message for r in caplog.records)


def test_a_diagnosis_keeps_the_pictures_that_can_be_drawn(break_, caplog):
    gap = HeldOutGap(noise=1.0, before=3.0, after=1.0, closed=0.9, interval=None)
    record = DiagnosisRecord(verdict="named", gap=gap, plot_data=PlotData(
        steps=[SelectionStep(what="geometry", rms_ratio=3.0)]))
    whole = set(figure_files.diagnosis_files(record))
    assert "gap.svg" in whole
    break_((diagnosis_figures, "by_actuator"))
    assert "gap.svg" in figure_files.diagnosis_files(record)
    break_((diagnosis_figures, "gap"))
    assert set(figure_files.diagnosis_files(record)) == whole - {"gap.svg"}
    assert left_out(r.message for r in caplog.records)


@pytest.mark.slow
def test_a_page_has_its_other_chapters(folders, break_):
    break_((identified, "identified_section"), (page, "_provenance"))
    found = ppmcal.make_report(folders[0]).files()
    assert WHY in found["report.html"] and LEFT_OUT in found["report.html"]
    assert json.loads(found["report.json"])["identifications"]


def test_the_page_of_a_batch_stands_without_what_is_common(break_):
    break_((batch_report, "common_sentences"), (batch_report, "common_effects"),
           (batch_report, "common_parameters"), (batch_report, "effects_over_time"))
    record = batch_report.CampaignRecord(campaign="a/1/identify", machine="a", date="1",
                                         command="identify")
    found = batch_report.batch_page([record])
    assert found.count(WHY) == 4 and "All campaigns" in found


@pytest.mark.slow
def test_a_fault_of_the_program_is_told(folders, monkeypatch):
    monkeypatch.setattr(compensate_command, "doubts", lambda *_: len(3))
    with pytest.raises(TypeError):
        ppmcal.compensate(folders[0] / "identified.yaml", TARGETS, frame="base")
