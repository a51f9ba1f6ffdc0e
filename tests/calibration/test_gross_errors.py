"""Values typed wrong, files read wrongly, noise stated wrongly: refused or left out, in seconds."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.campaigns_in_files import run
from helpers.commands import ppmcal
from helpers.mistakes import MACHINE, MISTAKES, SAMPLE, Row, session

from ppmcal.calibration.fit import fit_result as fitting
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.interpretation.read_rightly import misfit
from ppmcal.calibration.validation.summary import report
from ppmcal.diagnosis.refit import of_rows
from ppmcal.io import read_campaign, read_mechanism, read_scenario


def problem(path: Path) -> Problem:
    mechanism = read_mechanism(MACHINE)
    return Problem(mechanism, tuple(read_campaign([path], mechanism)), mechanism.free)


def left_out(path: Path) -> set[int]:
    """Rows (from 0) that a fit leaves out."""
    return set(identify(problem(path)).reasons[0])


def a_whole_tenth(rows: list[Row]) -> None:
    """Metres off: rows that pull a fit away wherever it starts."""
    for i in range(3, len(rows), 10):
        rows[i]["x"] = float(rows[i]["x"]) + 5000.0 * (-1.0) ** i


@pytest.mark.slow
def test_a_fit_to_some_of_the_rows_leaves_them_out_too(tmp_path: Path) -> None:
    whole = identify(problem(session(tmp_path, a_whole_tenth)))
    gross = np.arange(whole.keep[0].size) % 10 == 3
    assert not (whole.keep[0] & gross).any()
    rows = np.arange(gross.size) % 4 != 0
    some = of_rows(whole, [rows], FitOptions())
    assert not (some.keep[0] & gross[rows]).any()
    assert some.keep[0].sum() >= (whole.keep[0] & rows).sum() - 1
    np.testing.assert_allclose(some.state.g, whole.state.g, atol=5e-4)


@pytest.mark.slow
def test_typos_are_not_the_span_of_the_motion(tmp_path: Path) -> None:
    def two(rows: list[Row]) -> None:
        rows[4]["x"] = float(rows[4]["x"]) + 9000.0
        rows[9]["z"] = float(rows[9]["z"]) - 9000.0

    told = ppmcal("check", MACHINE, session(tmp_path, two)).out
    assert "rows 5, 10: measured more than 3 times" in " ".join(told.split())
    assert "motion spans" not in told


# --- rows typed wrong -----------------------------------------------------------------------------

def y_times_ten(rows: list[Row]) -> None:
    rows[7]["y"] = float(rows[7]["y"]) * 10


def joint_plus_hundred(rows: list[Row]) -> None:
    rows[22]["q_leg2"] = float(rows[22]["q_leg2"]) + 100


def both(rows: list[Row]) -> None:
    y_times_ten(rows)
    joint_plus_hundred(rows)


def a_tenth(rows: list[Row]) -> None:
    rng = np.random.default_rng(1)
    for i in rng.permutation(len(rows))[:len(rows) // 10]:
        column = rng.choice(["x", "y", "z", "rx", "ry", "rz", "q_leg1", "q_leg4"])
        value = float(rows[i][column])
        rows[i][column] = value * 10 if rng.random() < 0.5 else value + 100


@pytest.mark.slow
@pytest.mark.parametrize("mistake", [both, a_tenth])
def test_values_typed_wrong_cost_no_honest_row(tmp_path: Path,
                                               mistake: Callable[[list[Row]], None]) -> None:
    honest = session(tmp_path / "honest")
    typed = session(tmp_path / "typed", mistake)
    wrong = {n for n, (a, b) in enumerate(zip(
        honest.read_text().splitlines()[1:], typed.read_text().splitlines()[1:], strict=True))
        if a != b}
    assert wrong
    assert left_out(typed) == left_out(honest) | wrong


@pytest.mark.slow
def test_two_typed_wrong_end_where_the_fit_without_them_ends(tmp_path: Path) -> None:
    fit = identify(problem(session(tmp_path / "a", both)))

    def without(rows: list[Row]) -> None:
        del rows[22], rows[7]

    other = identify(problem(session(tmp_path / "b", without)))
    assert fit.iterations <= other.iterations + 2
    np.testing.assert_allclose(fit.state.g, other.state.g, atol=1e-9)


# --- files read wrongly ---------------------------------------------------------------------------

@pytest.mark.slow
def test_check_finds_it_too(tmp_path: Path) -> None:
    path = session(tmp_path, MISTAKES["a sign"])
    done = ppmcal("check", MACHINE, path, expect=1)
    assert "`read: {signs: {rx: -1}}`" in " ".join(done.out.split())
    assert "read:" not in ppmcal("check", MACHINE, session(tmp_path)).out


def test_what_tolerances_explain_is_no_misreading(tmp_path: Path) -> None:
    found = misfit(problem(session(tmp_path)))
    assert not found.misread
    assert found.nominal < 1.0 and np.isinf(found.noise)


@pytest.mark.long
def test_a_machine_far_from_nominal_is_no_misreading() -> None:
    """Sixty tolerances off: a short fit comes near the noise, so the files are read rightly."""
    from dataclasses import replace

    mechanism = read_mechanism(MACHINE)
    scenario = read_scenario(SAMPLE / "scenario.yaml", mechanism)
    made = run(mechanism, replace(scenario, error_scale=60.0), 1)
    found = misfit(made.problem)
    assert found.nominal > 5.0
    assert not found.misread


@pytest.mark.slow
@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_commands_refuse_it_and_write_no_machine(tmp_path: Path, command: str) -> None:
    path = session(tmp_path, MISTAKES["metres for mm"])
    done = ppmcal(command, MACHINE, path, "--out", tmp_path / "out", expect=3)
    assert "x, y and z are in m, not mm" in done.err
    assert "`read: {units: {x: m, y: m, z: m}}`" in done.err
    written = [p.name for p in (tmp_path / "out").glob("[!.]*")]
    assert written == (["diagnosis.json"] if command == "diagnose" else [])


@pytest.mark.slow
def test_a_fit_that_does_not_converge_above_the_noise_is_no_result(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "ITERATIONS", 0)
    path = session(tmp_path)
    done = ppmcal("identify", MACHINE, path, "--out", tmp_path / "out", "--keep-outliers",
                  "--holdout", "0", expect=3)
    assert "did not converge" in done.err and "times the noise" in done.err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_no_diagnosis_is_built_on_such_a_fit(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "ITERATIONS", 0)
    done = ppmcal("diagnose", MACHINE, session(tmp_path), "--out", tmp_path / "out", expect=3)
    assert "did not converge" in done.err and "effects cannot" in done.err
    assert not (tmp_path / "out").exists()


# --- noise stated wrongly -------------------------------------------------------------------------

@pytest.mark.long
def test_a_sigma_a_thousand_times_too_large_is_a_finding(tmp_path: Path) -> None:
    path = session(tmp_path, sidecar=lambda text: text.replace(
        "position: 0.01", "position: 10").replace("rotation: 0.002", "rotation: 2"))
    done = ppmcal("identify", MACHINE, path, "--out", tmp_path / "out", expect=1)
    assert "sigma is too large" in " ".join(done.out.split())
    findings = json.loads((tmp_path / "out" / "identification.json").read_text())["findings"]
    assert any("times the stated noise" in f for f in findings)
    ppmcal("report", tmp_path / "out", "--out", tmp_path / "page", expect=0)
    assert "Nothing needs a closer look" not in (tmp_path / "page" / "report.html").read_text()


@pytest.mark.slow
def test_the_right_sigma_is_no_finding(tmp_path: Path) -> None:
    fit = identify(problem(session(tmp_path)))
    assert not report(fit, FitOptions(), 0.0, 0).noise.overstated


# --- cross-validation and the damped scheme -------------------------------------------------------

@pytest.mark.slow
def test_cross_validation_is_made_without_outliers() -> None:
    """With them in, the prior shrinks and its intervals hold 42 % in place of 95."""
    mechanism = read_mechanism(MACHINE)
    scenario = read_scenario(SAMPLE / "scenario.yaml", mechanism)
    made = run(mechanism, scenario, 1)
    fit = identify(made.problem, FitOptions("gcv"))
    found = report(fit, FitOptions("gcv"), 0.0, 0)
    assert not found.noise.failed
    away = [abs(e.value - t) / e.sigma for e, t in
            zip(found.estimates, made.truth.g, strict=True) if e.sigma]
    # the scale is estimated too: a little below 95 %
    assert np.mean(np.array(away) < 1.96) > 0.85


METRES = """
format: ppmcal/mechanism/1
name: the papers' bench
units: {length: m, angle: rad}
motion: planar
limbs:
  - name: leg1
    kind: R(P)R
    base: {point: [0, 0]}
    platform: {point: {radius: 0.25, angle: {value: 3.66519, fixed: true}}}
  - name: leg2
    kind: R(P)R
    base: {point: [1, 0]}
    platform: {point: {radius: 0.25, angle: {value: 5.75959, fixed: true}}}
  - name: leg3
    kind: R(P)R
    base: {point: [0.5, 0.866025]}
    platform: {point: {radius: 0.25, angle: {value: 1.570796, fixed: true}}}
home: {pose: {x: 0.5, y: 0.288675, rz: 0.523599}}
tolerances: {point: 0.001, length: 0.001, angle: 0.002, offset: 0.001}
free: ["*.base.point.?", "*.offset", "*.platform.point.radius", "*.joint1.rz"]
"""
CIRCLE = """
format: ppmcal/scenario/1
units: {length: m, angle: rad}
poses:
  circle: {center: {x: 0.5, y: 0.29, rz: 0.45}, radius: 0.08, count: 30, swing: {rz: 0.0873}}
errors: {random: {scale: 1.0}}
instrument: {kind: pose, sigma: {position: 0.0001, rotation: 0.0001}}
seed: 3
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("metres")
    (folder / "m.yaml").write_text(METRES, encoding="utf-8")
    (folder / "s.yaml").write_text(CIRCLE, encoding="utf-8")
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "sim", cwd=folder, expect=0)
    return folder


@pytest.mark.slow
def test_the_papers_damping_stops_at_the_noise(bench: Path) -> None:
    """[PPM] section 4.5 in metres: 0.9 converges in thousands of iterations, and ends after 5."""
    done = ppmcal("identify", "m.yaml", "sim/measurements.csv", "--method", "damped", "--damping",
                  "0.9", "--out", "damped", cwd=bench, expect=1)
    found = json.loads((bench / "damped" / "identification.json").read_text())
    assert found["iterations"] < 20
    assert not found["converged"]
    assert "stopped at the noise" in " ".join(done.out.split())
    after = found["residual"]["after"]["position"]["rms"]
    assert after < 2e-4 < found["residual"]["before"]["position"]["rms"]
    assert found["rank"] == 12 and len(found["redundant"]) == 3


@pytest.mark.slow
def test_iterations_end_where_they_are_told_to(bench: Path) -> None:
    done = ppmcal("identify", "m.yaml", "sim/measurements.csv", "--method", "damped", "--damping",
                  "0.9", "--iterations", "5", "--out", "five", cwd=bench, expect=1)
    found = json.loads((bench / "five" / "identification.json").read_text())
    assert found["iterations"] <= 5
    assert "stopped" in done.out
