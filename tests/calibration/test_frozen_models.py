"""Frozen machines judged on a day that no fit has seen."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.commands import number, rows
from helpers.commands import ppmcal as command

import ppmcal
from ppmcal.calibration.fit.problem import Problem, squares_by_noise_of, white_squares
from ppmcal.calibration.fit.registration_freedoms import opened
from ppmcal.calibration.sessions.day_noise import day_noise
from ppmcal.calibration.validation.frozen_models import (
    FrozenModel,
    _registered,
    validated,
    with_and_without,
)
from ppmcal.errors import BadInput
from ppmcal.io.mechanism_writer import write_mechanism
from ppmcal.io.results.validation import (
    ValidatedDataset,
    ValidationRecord,
)
from ppmcal.linalg import finite_rows

ERRORS = {"leg1.base.point.x": 0.4, "leg2.offset": -0.3, "leg3.offset": 0.2}
EFFECTS = [{"kind": "backlash", "on": ["leg1"], "parameters": {"width": 0.08}},
           {"kind": "curvature", "on": ["leg2"], "parameters": {"p2": 0.05, "p3": 0.0, "p4": 0.0}}]


def scenario(seed, effects=(), **more):
    return {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
            "poses": {"random": {"center": {"x": 500, "y": 260, "rz": 25},
                                 "half_range": {"x": 70, "y": 70, "rz": 8}, "count": 40}},
            "errors": ERRORS, "effects": list(effects),
            "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
            "frame": {"x": 5 + seed, "y": -3, "rz": 10 + seed}, "target": [1, 2],
            "approach": "both", "seed": seed} | more


@pytest.fixture(scope="module")
def stage():
    return ppmcal.load(ppmcal.shipped("3-RPR"))


@pytest.fixture(scope="module")
def truth(stage):
    """The machine as it is, with both effects."""
    tree = yaml.safe_load(ppmcal.shipped("3-RPR").read_text(encoding="utf-8"))
    tree["effects"] = EFFECTS
    machine = ppmcal.load(tree)
    g = machine.values.copy()
    for name, error in ERRORS.items():
        g[machine.names.index(name)] += 1e-3 * error
    return machine.with_values(g)


@pytest.fixture(scope="module")
def day(stage):
    return ppmcal.simulate(stage, scenario(5, EFFECTS)).data


@pytest.mark.slow
def test_the_true_machine_misses_by_the_noise(truth, day):
    """40 poses from two sides, 0.005 mm in x and y: sqrt(2) x 0.005 mm together."""
    (found,) = validated(with_and_without(truth), day)
    first = found.errors[0]
    assert found.rows == (80, 80) and found.fitted == ("frame", "target")
    assert first.position["rms"] == pytest.approx(np.sqrt(2) * 5e-6, rel=0.1)
    assert first.noise == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_registration_takes_what_rows_see_of_it():
    """A platform that stays level tells no target from the frame: with both open nothing is lost.

    Not of the error's interval either, which columns that take no value would widen.
    """
    printer = ppmcal.load(ppmcal.shipped("delta-linear"))
    (bed,) = ppmcal.simulate(printer, ppmcal.shipped("delta-linear", scenario=True)).data
    few = bed.take(np.arange(8))
    alone, both = (validated([FrozenModel("model", printer)], [few], words)[0].errors[0].position
                   for words in (("frame",), ("frame", "target")))
    assert both["rms"] == pytest.approx(alone["rms"], rel=1e-6)
    assert both["rms_high"] == pytest.approx(alone["rms_high"], rel=1e-6)


@pytest.mark.slow
def test_each_effect_left_out_is_surely_worse(truth, day):
    (found,) = validated(with_and_without(truth), day)
    labels = [e.label for e in found.errors]
    assert labels == ["model", "without backlash on leg1", "without curvature on leg2",
                      "without all effects"]
    assert [e.sure for e in found.errors] == [0, -1, -1, -1]
    assert all(e.interval[0] < e.closer < e.interval[1] < 0.0 for e in found.errors[1:])


@pytest.mark.slow
def test_an_effect_that_is_not_there_makes_it_worse(stage, truth):
    clean = ppmcal.simulate(stage, scenario(6)).data
    (found,) = validated(with_and_without(truth), clean)
    assert [e.sure for e in found.errors][1:] == [1, 1, 1]


@pytest.mark.long
def test_the_command_says_so_and_exits_with_1(stage, truth, tmp_path):
    """Effects that make the day worse than the geometry alone are a finding; those that help none.
    """
    (tmp_path / "truth.yaml").write_text(write_mechanism(truth), encoding="utf-8")
    for name, effects, code in (("with", EFFECTS, 0), ("clean", (), 1)):
        made = ppmcal.simulate(stage, scenario(6, effects))
        made.save(tmp_path / name)
        run = command("validate", "truth.yaml", f"{name}/measurements.csv", "--out", f"v-{name}",
                      "--json", cwd=tmp_path, expect=code)
        worse = [f for f in run.json["findings"] if "makes the prediction worse by" in f
                 or "make the prediction worse by" in f]
        assert len(worse) == 3 * code and all("(95 %: " in f for f in worse)
        for line in rows(tmp_path / f"v-{name}" / "validation.csv"):
            assert number(line, "position_rms_low") < number(line, "position_rms")
            assert number(line, "position_rms") < number(line, "position_rms_high")
            assert number(line, "position_p95_low") < number(line, "position_p95")


def test_errors_agree_with_a_fit_of_the_frame_by_other_means(truth, day):
    """The registration by scipy, rows of nothing but pose differences: the same rms."""
    from scipy.optimize import least_squares

    from ppmcal.kinematics.closure import Model
    from ppmcal.kinematics.equilibrium import platform_pose, reached_poses
    from ppmcal.kinematics.registration import measured_pose
    from ppmcal.model.registration import Registration

    bare = with_and_without(truth)[-1].mechanism
    (data,) = day
    problem = Problem(bare, (data,), ())
    pose = platform_pose(reached_poses(Model(bare), data.q, problem.environments[0]).closed, None)

    def away(p):
        registration = Registration.of_pose(np.array([p[0], p[1], 0, 0, 0, p[2]]),
                                            np.array([p[3], p[4], 0.0]))
        seen = measured_pose(registration, pose)
        return np.concatenate([((seen - np.hstack([data.position, data.rotation]))
                                / [5e-6, 5e-6, 1, 1, 1, np.radians(0.001)])[:, [0, 1, 5]].ravel()])

    best = least_squares(away, [0.01, -0.003, np.radians(15), 0.001, 0.002], x_scale="jac",
                         xtol=1e-15, ftol=1e-15, gtol=1e-15)
    own = np.sqrt(np.mean(np.sum((best.fun.reshape(-1, 3)[:, :2] * 5e-6) ** 2, axis=1)))
    (found,) = validated([FrozenModel("bare", bare)], day)
    assert found.errors[0].position["rms"] == pytest.approx(own, rel=1e-6)


@pytest.mark.long
def test_zeros_that_moved_between_days_are_demanded(truth, day):
    (data,) = day
    shifted = replace(data, q=data.q + np.array([3e-4, -2e-4, 4e-4]))
    (found,) = validated(with_and_without(truth), [shifted])
    assert found.demanded == ("homing",)
    assert found.errors[0].noise == pytest.approx(1.0, abs=0.1)
    (kept,) = validated(with_and_without(truth), [shifted], ["frame", "target"])
    assert kept.demanded == () and kept.errors[0].noise > 5.0


@pytest.mark.slow
def test_a_frame_is_demanded_where_the_file_holds_it_known(truth, day):
    (data,) = day
    known = replace(data, frame=replace(data.frame, fitted=False, value=np.zeros(6)),
                    target=replace(data.target, fitted=False, value=np.array([1e-3, 2e-3, 0.0])))
    (found,) = validated(with_and_without(truth), [known])
    assert found.demanded == ("frame",)


def test_registering_nothing_is_possible(truth, day):
    (found,) = validated(with_and_without(truth), day, [])
    assert found.fitted == () and found.errors[0].position["rms"] > 1e-3


def test_two_rows_are_refused(truth, day):
    (data,) = day
    with pytest.raises(BadInput, match="rows"):
        validated(with_and_without(truth), [data.take(np.arange(2))])


@pytest.mark.long
def test_false_certainty_is_rare(stage, truth):
    """A machine off by far less than the noise is surely better or worse one day in twenty."""
    rng, sure = np.random.default_rng(3), []
    for i in range(20):
        g = truth.values.copy()
        g[list(stage.free)] += 1e-9 * rng.standard_normal(len(stage.free))
        day = ppmcal.simulate(stage, scenario(50 + i, EFFECTS)).data
        (found,) = validated([FrozenModel("true", truth), FrozenModel("off", truth.with_values(g))],
                             day)
        sure.append(abs(found.errors[1].sure))
    assert sum(sure) <= 4   # of 20; more has a chance of 0.3 % where the rate is 5 %


# ---------------------------------------------------------------- face, files, words


@pytest.mark.long
def test_the_face_judges_against_nominal_and_others(truth, stage, day, tmp_path):
    calibrated = ppmcal.identify(stage, ppmcal.simulate(stage, scenario(7, EFFECTS)).data,
                                 holdout=0.0)
    calibrated.save(tmp_path / "cal")
    result = ppmcal.validate(truth, day, against=[tmp_path / "cal"])
    models = {e.model: e for e in result.record.datasets[0].errors}
    assert models["nominal"].verdict == "worse"
    assert models[str(tmp_path / "cal")].verdict == "worse"
    assert models["model"].position.rms == pytest.approx(0.00707, rel=0.1)
    written = {p.name for p in result.save(tmp_path / "out")}
    assert {"validation.csv", "validation.json", "validation.svg"} <= written
    assert ValidationRecord.read(tmp_path / "out" / "validation.json") == result.record
    assert "made smaller by backlash on leg1 (" in result.record.datasets[0].effects_sentence()


@pytest.mark.slow
def test_a_folder_is_as_good_as_its_model(stage, day, tmp_path):
    calibrated = ppmcal.identify(stage, ppmcal.simulate(stage, scenario(7)).data, holdout=0.0)
    calibrated.save(tmp_path / "cal")
    by_folder = ppmcal.validate(tmp_path / "cal", day)
    by_result = ppmcal.validate(calibrated, day)
    assert by_folder.record.datasets[0].errors[0].position.rms == pytest.approx(
        by_result.record.datasets[0].errors[0].position.rms, rel=1e-9)


@pytest.mark.parametrize(("change", "words"), [
    ({"register": ["zeros"]}, "zeros"), ({"against": ["nowhere.yaml"]}, "nowhere.yaml")])
@pytest.mark.slow_cases("change1-nowhere.yaml")
def test_wrong_options_are_refused(truth, day, change, words):
    with pytest.raises(BadInput, match=words):
        ppmcal.validate(truth, day, **change)


def test_a_folder_without_a_model_is_refused(day, tmp_path):
    with pytest.raises(BadInput, match="no calibrated machine"):
        ppmcal.validate(tmp_path, day)


@pytest.mark.long
def test_diagnose_validates_each_session_from_the_others(stage):
    days = [ppmcal.simulate(stage, scenario(11 + i, EFFECTS)).data[0] for i in range(2)]
    days = [replace(d, name=f"day{i}") for i, d in enumerate(days)]
    result = ppmcal.diagnose(stage, days, kinds=["backlash", "curvature"])
    assert [d.name for d in result.record.validation] == ["day0", "day1"]
    for found in result.diagnosis.days:
        by = {e.label: e for e in found.errors}
        assert by["without all effects"].sure < 0 and by["nominal"].sure < 0
        assert found.errors[0].noise == pytest.approx(1.0, abs=0.2)
    assert result.record.confirmed is True


@pytest.mark.long
def test_a_value_typed_wrong_counts_for_no_machine(truth, day):
    (data,) = day
    position = data.position.copy()
    position[7, 0] *= 10.0
    (found,) = validated(with_and_without(truth), [replace(data, position=position)])
    assert found.rows == (79, 80)
    assert found.errors[0].noise == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_bed_that_lies_elsewhere_is_demanded(tmp_path):
    """Touches of a flat whose height and tilt the file holds known."""
    printer = ppmcal.load(ppmcal.shipped("delta-linear"))
    rows = ppmcal.simulate(printer, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": {"x": 0, "y": 0, "z": 1e3 * printer.home_pose[2]},
                             "half_range": {"x": 60, "y": 60, "z": 0}, "count": 20}},
        "instrument": {"kind": "plane", "sigma": {"height": 0.01}}, "frame": "known",
        "seed": 4}).data[0]
    assert rows.kind.touches
    lower = replace(rows, value=rows.value - 5e-4)
    (found,) = validated([FrozenModel("model", printer)], [lower])
    assert found.demanded == ("frame",)
    assert found.errors[0].noise == pytest.approx(1.0, abs=0.4)
    (same,) = validated([FrozenModel("model", printer)], [rows])
    assert same.demanded == ()


@pytest.mark.long
def test_a_row_that_is_wrong_within_tolerances_is_named_and_counts(truth, day):
    """A tolerance of 0.5 mm explains 0.06 mm; the other 79 rows do not."""
    wrong = day[0].position.copy()
    wrong[17, 1] += 6e-5
    found = ppmcal.validate(truth, [replace(day[0], position=wrong)])
    (one,) = found.record.datasets
    (row,) = one.unlike
    assert (one.rows, row.row) == (80, day[0].rows[17])
    assert 3.0 < row.times < 12.0      # over the median norm of three coordinates
    (said,) = (s for s in found.findings if "others" in s)
    assert f"row {row.row} (" in said
    assert "does not fit with the others, whatever the geometry" in said and "they count" in said


@pytest.mark.long
def test_a_row_beyond_tolerances_is_left_out_and_named(truth, day):
    wrong = day[0].position.copy()
    wrong[17, 1] += 0.05
    (found,) = validated(with_and_without(truth), [replace(day[0], position=wrong)])
    assert (found.rows, found.left_out) == ((79, 80), (int(day[0].rows[17]),))
    (said,) = ValidatedDataset.of(found, truth.units).misled()
    assert f"row {day[0].rows[17]} left out" in said


@pytest.mark.long
def test_rows_of_noise_alone_are_hardly_ever_named(truth, stage):
    """No more than the fit of a clean day leaves out: hardly a row of one day in fifty."""
    days = [ppmcal.simulate(stage, scenario(1000 + n, EFFECTS)).data[0] for n in range(48)]
    named = sum(bool(day_noise([truth], d).unlike) for d in days)
    assert named <= 1


@pytest.mark.parametrize("actuator", [0.0, 0.02])
@pytest.mark.slow
def test_a_registration_with_more_freedom_never_fits_worse(actuator):
    """Chi-squared by the noise at the wider one, by which that is the least; mm may grow."""
    hexapod = ppmcal.load(ppmcal.shipped("6-UPS"))
    data = ppmcal.simulate(hexapod, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": dict.fromkeys(("x", "y", "rx", "ry", "rz"), 0)
                             | {"z": 2000},
                             "half_range": {"x": 150, "y": 150, "z": 100, "rx": 1, "ry": 1,
                                            "rz": 1}, "count": 40}},
        "errors": {"random": {"scale": 3.0}},
        "frame": dict.fromkeys(("z", "rx", "ry"), 0) | {"x": 5, "y": -3, "rz": 10},
        "target": [30, -20, 50], "seed": 4,
        "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.001,
                                                 "actuator": actuator}}}).data[0]
    sets = [("frame",), ("frame", "target"), ("frame", "rotation"),
            ("frame", "target", "rotation"), ("frame", "target", "rotation", "homing")]
    fits = {words: _registered(hexapod, opened(data, words, True)) for words in sets}
    for less, more in itertools.permutations(sets, 2):
        if set(less) < set(more):
            rows = [finite_rows(a) & finite_rows(b) for a, b in zip(
                fits[less].state.poses, fits[more].state.poses, strict=True)]
            wide = fits[more].problem, fits[more].state
            narrow = squares_by_noise_of((fits[less].problem, fits[less].state), wide, rows)
            assert white_squares(*wide, rows)[0] <= narrow, (less, more)
