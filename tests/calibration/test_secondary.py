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
from ppmcal.api import diagnose as diagnose_command
from ppmcal.api import identify as identify_command
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.secondary_analyses import NOTE, secondary
from ppmcal.calibration.validation import summary
from ppmcal.diagnosis import diagnose as diagnosis
from ppmcal.errors import BadInput, LinearAlgebraError
from ppmcal.io import read_mechanism, read_scenario

OF_A_FIT = ("find_gross_errors", "flats", "honest", "held_out", "left_out", "identifiability",
            "unidentifiable", "doubtful_stretches")
OF_IDENTIFY = ("with_chosen_freedoms", "weak_campaign", "registration_hints", "left_over")
OF_DIAGNOSE = ("with_chosen_freedoms", "weak_campaign", "left_over")
OF_A_DIAGNOSIS = ("block_gaps", "with_sessions", "other_days", "_places", "_others", "next_step")


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
    assert notes == [f"{NOTE}the colour (no)"]
    assert secondary("the colour", lambda: 5, 7, notes) == 5
    assert len(notes) == 1


def test_faults_of_the_program_are_not_hidden() -> None:
    with pytest.raises(TypeError):
        secondary("the colour", lambda: len(3), 7, [])    # type: ignore[arg-type]


def test_two_machines_of_exact_values_disagree_and_have_a_result() -> None:
    """Residuals are millions of times the noise, whatever the fit: that is told, and is no end."""
    printer = read_mechanism(ROOT / "configs" / "delta-linear.yaml")
    scenario = replace(read_scenario(
        ROOT / "configs" / "scenarios" / "delta-linear.yaml", printer), sigma_position=1e-12)
    days = [replace(run(printer, scenario, seed).data.take(np.arange(8)), name=f"day{seed}")
            for seed in (1, 2)]
    fit = identify(Problem(printer, tuple(days), printer.free))
    found = summary.report(fit, FitOptions(), 0.0, 0)
    assert found.noise.sigma_ratio > 1e6
    assert found.sessions is not None and found.sessions.differ
    assert any(f.startswith("sessions disagree") for f in found.findings)
    assert not any(f.startswith(NOTE) for f in found.findings)


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
    notes = [f for f in bare.findings if f.startswith(NOTE)]
    assert len(notes) == len(OF_A_FIT) + len(OF_IDENTIFY)
    assert all("an extra that had no answer" in f for f in notes)
    bare.save(tmp_path / "out")
    assert (tmp_path / "out" / "identified.yaml").is_file()


@pytest.mark.slow
def test_diagnose_without_any_of_its_extras(monkeypatch: pytest.MonkeyPatch,
                                            tmp_path: Path) -> None:
    made = planar()
    for module, names in ((summary, OF_A_FIT), (diagnose_command, OF_DIAGNOSE),
                          (diagnosis, OF_A_DIAGNOSIS)):
        for name in names:
            monkeypatch.setattr(module, name, fails)
    found = ppmcal.diagnose(made.mechanism, [made.data])
    notes = [f for f in found.findings if f.startswith(NOTE)]
    assert len(notes) >= len(OF_DIAGNOSE) + 3
    found.save(tmp_path / "out")
