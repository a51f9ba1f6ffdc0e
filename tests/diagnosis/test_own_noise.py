"""Noise that a file wants estimated, and effects that it would hide."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import ppmcal
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis import own_noise
from ppmcal.diagnosis.options import DiagnosisOptions
from ppmcal.diagnosis.own_noise import diagnose_with_own_noise
from ppmcal.wording.progress import Watch, watching

BOTH = DiagnosisOptions(kinds=("curvature", "backlash"))
"""The noise is the fact, not what is named of the whole library."""


@pytest.fixture(scope="module")
def stage():
    return ppmcal.load(ppmcal.shipped("3-RPR"))


@pytest.fixture(scope="module")
def day(stage):
    """A large curvature of one leg, and a backlash of another below what it leaves."""
    return ppmcal.simulate(stage, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": {"x": 500, "y": 260, "rz": 25},
                             "half_range": {"x": 70, "y": 70, "rz": 8}, "count": 40}},
        "effects": [
            {"kind": "curvature", "on": ["leg2"], "parameters": {"p2": 0.3, "p3": 0.0, "p4": 0.0}},
            {"kind": "backlash", "on": ["leg1"], "parameters": {"width": 0.015}}],
        "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
        "frame": {"x": 5, "y": -3, "rz": 10}, "target": [1, 2], "approach": "both",
        "seed": 8}).data[0]


@pytest.mark.long
def test_noise_is_that_of_the_model_with_what_was_named(stage, day):
    said: list[str] = []
    guess = replace(day, estimated=True).noisier(3.0)
    with watching(Watch(said.append)):
        found, told = diagnose_with_own_noise(Problem(stage, (guess,), stage.free), BOTH)
    assert {(e.kind, e.on) for e in found.effects} == {("curvature", ("leg2",)),
                                                       ("backlash", ("leg1",))}
    assert any("again with the noise" in s for s in said)
    assert len(told) == 1 and "estimated" in told[0]
    assert found.identification.fit.noise == pytest.approx(1.0, abs=0.2)
    assert found.start.source == found.remainder.source == "estimated"


@pytest.mark.long
def test_stated_noise_stays(stage, day):
    said: list[str] = []
    with watching(Watch(said.append)):
        _, told = diagnose_with_own_noise(Problem(stage, (day,), stage.free), BOTH)
    assert told == [] and not any("again with the noise" in s for s in said)


def test_probabilities_are_asked_once_more_with_the_noise_that_is_left(
        stage, day, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often less is left: they take such noise as hardly known."""
    asked = list[Problem]()

    def named(problem: Problem, _: object) -> SimpleNamespace:
        asked.append(problem)
        fit = SimpleNamespace(problem=problem, state=SimpleNamespace(g=stage.values))
        return SimpleNamespace(effects=[SimpleNamespace(kind="curvature", on=("leg2",))],
                               identification=SimpleNamespace(fit=fit))

    noise = iter(0.5 ** np.arange(9))
    monkeypatch.setattr(own_noise, "diagnose_with_registration", named)
    monkeypatch.setattr(own_noise, "with_own_noise", lambda problem, _: (
        replace(problem, datasets=(guess.noisier(float(next(noise))),)), ["estimated"]))
    guess = replace(day, estimated=True)
    diagnose_with_own_noise(Problem(stage, (guess,), stage.free), DiagnosisOptions())
    assert len(asked) == 2
