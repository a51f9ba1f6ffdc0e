"""Joint values alone, read several times at each place: what is noise, what belongs together."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import redundant

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.explanation import _pulled
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.options import DiagnosisOptions
from ppmcal.diagnosis.own_noise import with_repeats_noise
from ppmcal.diagnosis.question import ROW_FAMILY, first_readings, question
from ppmcal.diagnosis.term_candidates import all_settings
from ppmcal.diagnosis.unknown_causes import PULLS, UnknownCauses
from ppmcal.inference.block_sets import state
from ppmcal.inference.priors import FIRST_READING, GROSS_ROW
from ppmcal.inference.sets import posterior

PLACES, READ, NOISE, CAUGHT = 20, 4, 0.1, 0.6
"""Noise of a reading and what belts pull at each place, mm."""


@pytest.fixture(scope="module")
def problem(tmp_path_factory) -> Problem:
    """A router's belts at 20 places, each read four times, one reading of them 5 mm off."""
    rng = np.random.default_rng(3)
    tree = redundant.belts()
    anchors = np.array([limb["base"]["point"] for limb in tree["limbs"]], dtype=float)
    at = np.array([1500.0, 1050.0]) + np.array([900.0, 550.0]) * rng.uniform(-1, 1, (PLACES, 2))
    length = np.linalg.norm(at[:, None] - anchors, axis=2) + CAUGHT * rng.normal(size=(PLACES, 4))
    q = np.repeat(length, READ, axis=0) + NOISE * rng.normal(size=(PLACES * READ, 4))
    q[READ * 5, 1] += 5.0
    file = redundant.written(tmp_path_factory.mktemp("belts"), tree)
    data, = ppmcal.read_data(file, {
        "pose": np.repeat(np.arange(PLACES) + 1, READ),
        **{f"q_{n}": q[:, i] for i, n in enumerate(("bl", "br", "tr", "tl"))}}, sidecar={
            "units": {"length": "mm", "angle": "deg"}, "instrument": {
                "kind": "none", "sigma": {"actuator": 1.0, "estimated": True}}})
    machine = ppmcal.load(file)
    return Problem(machine, (data,), machine.free)


@pytest.fixture(scope="module")
def quiet(problem) -> tuple[Problem, list[str]]:
    """The same with the noise of its repeats."""
    return with_repeats_noise(problem, [], DiagnosisOptions())


@pytest.fixture(scope="module")
def asked(quiet):
    """What may be in what its fit leaves."""
    fit = identify(quiet[0], FitOptions())
    system = build(fit.problem, fit.state, [np.ones_like(k) for k in fit.keep])
    return question(system, library(system, ["zero_shift"]),
                    UnknownCauses(system, all_settings(fit)))


@pytest.mark.slow
def test_noise_is_how_readings_repeat_at_a_place_whatever_places_add(quiet):
    data, = quiet[0].datasets
    assert 1e3 * data.sigma_actuator == pytest.approx(4 * [NOISE], rel=0.15)
    assert not data.estimated
    assert len(quiet[1]) == 1 and quiet[1][0].endswith("mm, from repeated readings at one place.")


@pytest.mark.slow
def test_stated_noise_and_places_read_once_stay_as_they_are(problem, quiet):
    stated, told = with_repeats_noise(quiet[0], ["said"], DiagnosisOptions())
    assert stated is quiet[0] and told == ["said"]
    once = problem.datasets[0].take(np.arange(0, PLACES * READ, READ))
    alone, told = with_repeats_noise(Problem(problem.mechanism, (once,), problem.free), [],
                                     DiagnosisOptions())
    assert alone.datasets[0].estimated and told == []


@pytest.mark.slow
def test_rows_of_one_place_are_not_correlated_but_pulled_alike(asked):
    assert not asked.system.apart.any() and len(asked.question.views) == 1


@pytest.mark.slow
def test_a_first_reading_is_more_often_off_and_a_place_is_off_as_a_whole(asked):
    first = first_readings(asked.system)
    assert np.flatnonzero(first).tolist() == list(range(0, PLACES * READ, READ))
    rows = [(b, s.rows) for b, s in zip(asked.question.blocks, asked.sources, strict=True)
            if b.family == ROW_FAMILY]
    for block, own in rows:
        prior = FIRST_READING if len(own) == 1 and first[own[0]] else GROSS_ROW
        assert np.exp(block.log_prior) == pytest.approx(float(prior))
    whole = [(b, own) for b, own in rows if len(own) > 1]
    assert len(whole) == PLACES
    block, own = whole[2]
    columns = asked.question.columns.some(block.columns).reshape(*asked.system.observed.shape, -1)
    assert list(own) == list(range(2 * READ, 3 * READ)) and columns.shape[-1] == 4
    outside = np.delete(np.arange(len(columns)), own)
    assert not columns[outside].any()
    # by one number for each joint, the same in all readings but for where they say it stood
    assert columns[list(own)] == pytest.approx(np.broadcast_to(
        columns[own[0]], columns[list(own)].shape), abs=2e-2 * np.abs(columns).max())


def test_what_an_effect_does_at_a_place_holds_no_error_of_a_reading(tmp_path):
    """Such an error is in the residual: a wave as short as it would seem to explain it.

    Whatever measures the pose, where joints are read and limbs are more than freedoms.
    """
    rng = np.random.default_rng(5)
    tree = redundant.belts()
    anchors = np.array([limb["base"]["point"] for limb in tree["limbs"]], dtype=float)
    at = np.array([1500.0, 1050.0]) + np.array([900.0, 550.0]) * rng.uniform(-1, 1, (PLACES, 2))
    at = np.repeat(at, READ, axis=0)
    q = np.linalg.norm(at[:, None] - anchors, axis=2) + NOISE * rng.normal(size=(len(at), 4))
    seen = at + NOISE * rng.normal(size=at.shape)
    file = redundant.written(tmp_path, tree)
    data, = ppmcal.read_data(file, {
        "pose": np.repeat(np.arange(PLACES) + 1, READ), "x": seen[:, 0], "y": seen[:, 1],
        **{f"q_{n}": q[:, i] for i, n in enumerate(("bl", "br", "tr", "tl"))}}, sidecar={
            "units": {"length": "mm", "angle": "deg"}, "instrument": {
                "kind": "pose", "sigma": {"actuator": NOISE, "position": NOISE}}})
    machine = ppmcal.load(file)
    fit = identify(Problem(machine, (data,), machine.free), FitOptions())
    system = build(fit.problem, fit.state, [np.ones_like(k) for k in fit.keep])
    travel = system.parts[0].setting.travel
    assert np.unique(np.round(travel, 9), axis=0).shape == (PLACES, 4)
    assert 1e3 * np.std(travel - data.q, axis=0) == pytest.approx(4 * [NOISE], rel=0.3)


@pytest.mark.slow
def test_the_search_finds_what_belts_pull_at_each_place(asked):
    """From nothing, among steps from place to place that can stand for it."""
    pulls, = (n for n, s in enumerate(asked.sources) if getattr(s, "label", "") == PULLS)
    found = posterior(asked.question, []).best.chosen
    assert pulls in found
    # the reading that is off: the first one at its place
    assert [asked.sources[i].rows for i in found if i != pulls] == [(READ * 5,)]


@pytest.mark.slow
def test_a_search_begins_with_what_belts_pull_at_each_place(asked):
    pulls, = (n for n, s in enumerate(asked.sources) if getattr(s, "label", "") == PULLS)
    begin = _pulled(asked, [])
    assert pulls in begin and 1 <= len(begin) <= 2
    assert state(asked.question, begin).log_p >= state(asked.question, [pulls]).log_p
    # the reading that is off: the first one at its place
    assert [asked.sources[i].rows for i in begin if i != pulls] == [(READ * 5,)]
