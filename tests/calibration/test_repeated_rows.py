"""Readings of joints alone that were taken again at one place: which of them are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import redundant

import ppmcal
from ppmcal.calibration.fit.fit_result import Fit, FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.outliers import contradictions, find_gross_errors
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.repeated_rows import _Known
from ppmcal.inference.priors import NO_WEIGHT
from ppmcal.io.results.identification_wording import gross_rows, row_sentences
from ppmcal.model.repeats import places, with_misread

Array = np.ndarray
BELTS = ("bl", "br", "tr", "tl")
PLACES, READ = 12, 4
MISFIT, NOISE = 1.5, 0.1
"""What places add to belts and how readings repeat, mm."""
KNOWN = _Known(80.0, 48, 2, (NOISE / MISFIT) ** 2)


def exchanged(q: Array, rng: np.random.Generator) -> tuple[int, int]:
    """Exchange the tens and units of one reading (N, 4), mm, by 9 mm; return row and belt."""
    tens, ones = q.astype(int) // 10 % 10, q.astype(int) % 10
    row, belt = rng.permutation(np.argwhere(np.abs(tens - ones) == 1))[0].tolist()
    q[row, belt] += 9.0 * (ones - tens)[row, belt]
    return row, belt


def readings(seed: int, misfit: float = MISFIT, read: int = READ) -> Array:
    """Return belts (N, 4) as a router's display shows them, mm, each place read again."""
    rng = np.random.default_rng(seed)
    anchors = np.array([limb["base"]["point"] for limb in redundant.belts()["limbs"]], dtype=float)
    at = np.array([1500.0, 1050.0]) + np.array([900.0, 550.0]) * rng.uniform(-1, 1, (PLACES, 2))
    length = np.linalg.norm(at[:, None] - anchors, axis=2) + misfit * rng.normal(size=(PLACES, 4))
    return np.round(np.repeat(length, read, axis=0)
                    + NOISE * rng.normal(size=(PLACES * read, 4)), 1)


def fitted(folder: Path, q: Array) -> Fit:
    file = redundant.written(folder, redundant.belts())
    data, = ppmcal.read_data(file, {f"q_{n}": q[:, i] for i, n in enumerate(BELTS)}, sidecar={
        "units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "none", "sigma": {"actuator": MISFIT}}})
    machine = ppmcal.load(file)
    problem = Problem(machine, (data,), machine.free)
    return identify(problem, FitOptions(), problem.start(), near=True)


@pytest.mark.long
def test_no_exchanged_digits_are_missed_and_no_right_reading_is_blamed(tmp_path):
    """Of nine millimetres, six times what places add: half of them stayed unnoticed."""
    for seed in range(300, 310):
        q = readings(seed)
        row, belt = exchanged(q, np.random.default_rng(seed))
        fit = fitted(tmp_path, q)
        assert np.flatnonzero(fit.outliers[0]).tolist() == [row], seed
        error, = find_gross_errors(fit).rows
        assert (error.row, error.joint) == (row + 1, BELTS[belt])
        assert abs(error.value - error.predicted) == pytest.approx(9e-3, abs=5e-4)


@pytest.mark.long
def test_of_right_readings_none_is_left_out(tmp_path):
    for seed in range(310, 330):
        assert not fitted(tmp_path, readings(seed)).outliers[0].any(), seed


@pytest.mark.slow
def test_a_wrong_reading_is_told_with_its_joint_and_what_its_repeats_say(tmp_path):
    q = readings(331)
    row, belt = exchanged(q, np.random.default_rng(331))
    fit = fitted(tmp_path, q)
    machine = fit.problem.mechanism
    told, = gross_rows(find_gross_errors(fit), machine)
    others = [n for n in range(row // READ * READ, (row // READ + 1) * READ) if n != row]
    assert told.value == pytest.approx(q[row, belt])
    assert told.predicted == pytest.approx(np.median(q[others, belt]))
    assert told.unit == "mm" and told.repeats
    sentence = row_sentences([told], {}, machine)[0]
    read = f"q_{BELTS[belt]} {q[row, belt]:.6g} mm"
    assert f"row {row + 1}: {read}, where its repeats say" in sentence
    assert sentence.endswith("times their scatter).")
    assert fit.reasons[0][row].endswith("times the scatter of its repeats")


@pytest.mark.slow
def test_places_read_once_are_judged_as_they_were(tmp_path, monkeypatch: pytest.MonkeyPatch):
    """By all rows alone: repeats change nothing, to the last bit, where there are none."""
    q = np.concatenate([readings(332, read=1), readings(333, read=1)])
    now = fitted(tmp_path, q)
    monkeypatch.setattr("ppmcal.calibration.fit.repeated_rows.repeats",
                        lambda data: np.arange(len(data)))
    before = fitted(tmp_path, q)
    assert now.state.g.tobytes() == before.state.g.tobytes()
    assert now.reasons == before.reasons and now.repeated == before.repeated


def weights(*white: float) -> Array:
    """Return the weights of readings of one place that miss so many millimetres."""
    return KNOWN.weights(np.array([[w, 0.0] for w in white]) / NOISE, np.zeros(len(white)))[0]


def test_most_readings_of_a_place_say_which_is_wrong_however_far_the_place_is_off():
    for place in (0.0, -3.0):
        found = weights(place, place + 0.1, place + 9.0, place - 0.1)
        assert found[2] < 1e-6 and np.delete(found, 2).min() > 0.9


def test_of_two_readings_what_places_add_says_which_is_wrong_or_nobody_does():
    assert weights(0.1, 9.0) == pytest.approx([1.0, 0.0], abs=float(NO_WEIGHT))
    assert weights(-4.5, 4.5) == pytest.approx([0.5, 0.5], abs=0.02)


def test_readings_are_unsure_where_one_is_wrong_and_nothing_tells_which():
    def unsure(*white: float) -> list[bool]:
        return KNOWN.weights(np.array([[w, 0.0] for w in white]) / NOISE,
                             np.zeros(len(white)))[2].tolist()

    assert unsure(-4.5, 4.5) == [True, True]
    assert unsure(0.1, 9.0) == unsure(0.1, 0.2) == [False, False]
    assert not any(unsure(0.0, 0.1, 9.0, -0.1))


@pytest.mark.slow
def test_two_readings_that_contradict_each_other_are_a_finding(tmp_path):
    q = np.concatenate([readings(334, read=2), readings(335, read=2)])
    fit = fitted(tmp_path, q)
    assert not contradictions(fit)
    # one belt reads as much too long as too short of where all four meet
    at, g = fit.state.poses[0][6, :2], fit.state.g
    anchors = np.array([g[[fit.problem.mechanism.names.index(f"{n}.base.point.{a}") for a in "xy"]]
                        for n in BELTS])
    q[6:8] = 1e3 * np.linalg.norm(at - anchors, axis=1)
    q[6:8, 2] += [4.5, -4.5]
    fit = fitted(tmp_path, q)
    assert not fit.outliers[0].any()
    told, = contradictions(fit)
    assert "rows 7, 8 were read at one place" in told and "most in q_tr;" in told
    weight = fit.problem.weights[0]
    assert weight[6:8].max() < 0.95 and weight[6:8].sum() == pytest.approx(1.0, abs=0.05)


def test_readings_within_their_scatter_belong():
    rng = np.random.default_rng(5)
    for _ in range(50):
        assert weights(*(2.0 + NOISE * rng.normal(size=4))).min() > 0.5


def test_each_place_is_judged_by_itself_and_a_reading_alone_by_none():
    white = np.array([[0.0, 1.0], [5.0, 0.0], [0.1, 0.9], [90.0, 0.0], [5.0, 0.1]])
    weight, times, _ = KNOWN.weights(white, np.array([7, 3, 7, 2, 3]))
    for place in ([0, 2], [1, 4]):
        alone = KNOWN.weights(white[place], np.zeros(2, dtype=np.int64))
        assert weight[place] == pytest.approx(alone[0])
        assert times[place] == pytest.approx(alone[1])
    assert weight[3] == 1.0 and np.isnan(times[3])


def test_a_reading_that_differs_in_one_joint_is_of_its_place():
    q = np.repeat([[10.0, 20.0, 30.0, 40.0], [12.0, 21.0, 29.0, 38.0]], 3, axis=0)
    q[1, 2] += 9.0
    noise = np.full(4, 0.05)
    assert places(q, noise, 2).tolist() == [0, 0, 0, 1, 1, 1]
    # the others must contradict each other elsewhere: with one surplus they do nowhere
    assert places(q, noise, 1).tolist() == [0, 1, 2, 3, 3, 3]
    q[1, 0] += 9.0
    assert places(q, noise, 2).tolist() == [0, 1, 2, 3, 3, 3]


def test_of_one_label_what_differs_in_one_joint_was_misread_and_other_poses_are_others():
    q = np.array([[10.0, 20.0, 30.0], [10.0, 29.0, 30.0], [10.0, 20.0, 30.0], [14.0, 25.0, 30.0]])
    found = with_misread(np.array([0, 1, 0, 2]), np.zeros(4, dtype=np.int64), q, np.full(3, 0.05))
    assert found.tolist() == [0, 0, 0, 1]
