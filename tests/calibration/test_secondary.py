"""What is told beside a fit never ends it: it is left out, and a note says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.campaigns_in_files import run
from helpers.paths import ROOT

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.secondary_analyses import LEFT_OUT, secondary
from ppmcal.calibration.sessions import change_detection, day_noise
from ppmcal.calibration.validation import frozen_models, summary
from ppmcal.commands.compare import run as compare_command
from ppmcal.commands.diagnose import run as diagnose_command
from ppmcal.commands.identify import run as identify_command
from ppmcal.commands.validate import run as validate_command
from ppmcal.diagnosis import diagnose as diagnosis
from ppmcal.diagnosis import naming
from ppmcal.errors import BadInput, LinearAlgebraError
from ppmcal.io import read_mechanism, read_scenario
from ppmcal.notes import topic_of

OF_A_FIT = ("find_gross_errors", "flats", "cluster_robust", "held_out", "left_out",
            "identifiability", "unidentifiable", "doubtful_stretches", "against_tolerances",
            "considered", "before", "observability", "branch_findings",
            "in_words", "far_from_nominal")
OF_IDENTIFY = ("with_chosen_freedoms", "weak_campaign", "registration_hints", "left_over",
               "too_few", "noise_beyond_tolerances", "pulled_apart", "scale_sentences")
OF_DIAGNOSE = ("with_chosen_freedoms", "weak_campaign", "left_over", "noise_beyond_tolerances",
               "pulled_apart")
OF_A_DIAGNOSIS = ("left_out", "other_days", "learned_beyond", "readings", "localise", "next_step")
OF_VALIDATION = ("_compared", "in_other_assembly", "_intervals", "_typed_right", "_demanded")


def planar() -> Any:
    mechanism = read_mechanism(ROOT / "configs" / "3-RPR.yaml")
    scenario = read_scenario(ROOT / "configs" / "scenarios" / "3-RPR.yaml", mechanism)
    return run(mechanism, scenario, 3)


def fails(*args: Any, **options: Any) -> Any:
    raise LinearAlgebraError("an extra that had no answer")


@pytest.mark.parametrize("error", [BadInput("no"), ZeroDivisionError("no"), ValueError("no"),
                                   np.linalg.LinAlgError("no")])
def test_what_fails_is_left_out_and_noted(error: Exception) -> None:
    def make() -> int:
        raise error

    notes = list[str]()
    assert secondary("the colour", make, 7, notes) == 7
    assert notes == [f"{LEFT_OUT}: the colour (no)"]
    assert secondary("the colour", lambda: 5, 7, notes) == 5
    assert len(notes) == 1


def test_faults_of_the_program_are_not_hidden() -> None:
    with pytest.raises(TypeError):
        secondary("the colour", lambda: len(3), 7, [])    # type: ignore[arg-type]


@pytest.mark.slow
def test_two_machines_of_exact_values_disagree_and_have_a_result() -> None:
    """Residuals are millions of times the noise, whatever the fit: that is told, and is no end."""
    printer = read_mechanism(ROOT / "configs" / "delta-linear.yaml")
    scenario = replace(read_scenario(
        ROOT / "configs" / "scenarios" / "delta-linear.yaml", printer), sigma_position=1e-12)
    days = [replace(run(printer, scenario, seed).data.take(np.arange(8)), name=f"day{seed}")
            for seed in (1, 2)]
    # all rows count: which day's look wrong is a matter of the last digit
    options = FitOptions(robust=False)
    fit = identify(Problem(printer, tuple(days), printer.free), options)
    found = summary.report(fit, options, 0.0, 0)
    assert found.noise.sigma_ratio > 1e6
    assert found.sessions is not None and found.sessions.differ
    assert any(f.startswith("sessions disagree") for f in found.findings)
    assert not any(topic_of(f) == LEFT_OUT for f in found.findings)


@pytest.mark.long_cases("too small-1 pm")
@pytest.mark.parametrize("stated", [1e-9, 1e-12], ids=["1 nm", "1 pm"])
@pytest.mark.parametrize("true", [2e-5, 0.0], ids=["too small", "as it is"])
@pytest.mark.slow
def test_a_delta_measured_once_has_a_result_at_any_sigma(stated: float, true: float) -> None:
    """How far sessions differ cannot be told from one of them, which had ended the command."""
    printer = read_mechanism(ROOT / "configs" / "delta-linear.yaml")
    scenario = read_scenario(ROOT / "configs" / "scenarios" / "delta-linear.yaml", printer)
    data = run(printer, replace(scenario, sigma_position=true or stated), 36).data
    found = ppmcal.identify(printer, [replace(
        data, sigma_position=np.full_like(data.sigma_position, stated))])
    assert found.converged and np.isfinite(found.mechanism.values).all()
    for note in (f for f in found.findings if topic_of(f) == LEFT_OUT):
        assert "how far sessions, or stretches of rows, differ" in note


@pytest.mark.slow
def test_identify_without_any_of_its_extras(monkeypatch: pytest.MonkeyPatch,
                                            tmp_path: Path) -> None:
    made = planar()
    whole = ppmcal.identify(made.mechanism, [made.data])
    for name in OF_A_FIT:
        monkeypatch.setattr(summary, name, fails)
    for name in OF_IDENTIFY:
        monkeypatch.setattr(identify_command, name, fails)
    bare = ppmcal.identify(made.mechanism, [made.data])
    assert bare.converged
    np.testing.assert_array_equal(bare.mechanism.values, whole.mechanism.values)
    notes = [f for f in bare.findings if topic_of(f) == LEFT_OUT]
    assert len(notes) == len(OF_A_FIT) + len(OF_IDENTIFY)
    assert all("an extra that had no answer" in f for f in notes)
    bare.save(tmp_path / "out")
    assert (tmp_path / "out" / "identified.yaml").is_file()


@pytest.mark.slow
def test_diagnose_without_any_of_its_extras(monkeypatch: pytest.MonkeyPatch,
                                            tmp_path: Path) -> None:
    made = planar()
    for module, names in ((summary, OF_A_FIT), (diagnose_command, OF_DIAGNOSE),
                          (diagnosis, OF_A_DIAGNOSIS), (naming, ("measure_gap",))):
        for name in names:
            monkeypatch.setattr(module, name, fails)
    found = ppmcal.diagnose(made.mechanism, [made.data])
    notes = [f for f in found.findings if topic_of(f) == LEFT_OUT]
    assert len(notes) >= len(OF_DIAGNOSE) + 3
    for what in ("the gap on held-out poses", "what left-out rows have in common",
                 "the prediction of each session", "where residuals are",
                 "which measurements come next"):
        assert any(what in n for n in notes), what
    found.save(tmp_path / "out")


@pytest.mark.slow
def test_validate_without_any_of_its_extras(monkeypatch: pytest.MonkeyPatch, tmp_path: Path
                                            ) -> None:
    made, other = planar(), planar()
    model = ppmcal.identify(made.mechanism, [made.data])
    whole = ppmcal.validate(model, [other.data])
    for module, names in ((frozen_models, OF_VALIDATION), (day_noise, ("day_noise",)),
                          (validate_command, ("_fitted_to",))):
        for name in names:
            monkeypatch.setattr(module, name, fails)
    bare = ppmcal.validate(model, [other.data])
    assert bare.record.datasets[0].errors[0].position.rms == pytest.approx(
        whole.record.datasets[0].errors[0].position.rms)
    notes = [f for f in bare.findings if topic_of(f) == LEFT_OUT]
    for what in ("how much closer", "another assembly mode", "errors of position", "the noise that",
                 "fitted to these measurements", "mistyped", "the registration has to fit"):
        assert any(what in n for n in notes), what
    assert bare.headline() and all(e.closer is None for e in bare.record.datasets[0].errors[1:])
    bare.save(tmp_path / "out")


@pytest.mark.slow
def test_compare_without_any_of_its_extras(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = planar()
    for name, seed in (("old", 3), ("new", 4)):     # two machines
        data = run(made.mechanism, read_scenario(
            ROOT / "configs" / "scenarios" / "3-RPR.yaml", made.mechanism), seed).data
        ppmcal.identify(made.mechanism, [data]).save(tmp_path / name)
    whole = ppmcal.compare(tmp_path / "old", tmp_path / "new")
    assert whole.comparison.changed
    monkeypatch.setattr(change_detection, "explanations", fails)
    monkeypatch.setattr(change_detection, "pose_difference", fails)
    monkeypatch.setattr(compare_command, "with_equal_freedoms", fails)
    bare = ppmcal.compare(tmp_path / "old", tmp_path / "new")
    assert bare.comparison.changed and bare.comparison.p_value == whole.comparison.p_value
    notes = [f for f in bare.findings if topic_of(f) == LEFT_OUT]
    for what in ("what has changed", "how far the platform has moved", "one fit to the rows"):
        assert any(what in n for n in notes), what
    bare.save(tmp_path / "out")
