"""One score for every way to read a file, and what it says of files that no other test has."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from held_back_readings import MISREAD, RIGHT, Case, judged, made, other
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import chdtri
from wild import catalogue

from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation.candidates import joint_readings, pose_readings
from ppmcal.calibration.interpretation.exchanged_targets import best_stretch
from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    Interpretation,
    interpretation_sentence,
)
from ppmcal.calibration.interpretation.limits import TELLING
from ppmcal.calibration.interpretation.read_rightly import _chosen, find_misreading
from ppmcal.calibration.interpretation.readings import ColumnInterpretation
from ppmcal.calibration.interpretation.score import Score, all_rows, first_order_scores, score
from ppmcal.calibration.interpretation.search import Way
from ppmcal.commands.inputs import prepared
from ppmcal.io.results.parts import misreading_entries
from ppmcal.model.dataset import Dataset
from ppmcal.units import SI


@given(st.lists(st.sampled_from([-4.0, 0.0, 1.0]), min_size=1, max_size=30))
def test_the_stretch_that_gains_most_is_found_and_ends_where_it_gains(gain: list[float]) -> None:
    begin, end, sure = best_stretch(np.array(gain))
    every = [sum(gain[a:b]) for a in range(len(gain)) for b in range(a, len(gain) + 1)]
    assert sure == max(every) == sum(gain[begin:end])
    assert not gain[begin:end] or gain[begin] == gain[end - 1] == 1.0


def test_what_a_way_leaves_is_asked_of_all_rows() -> None:
    three = np.full(60, 3.0)
    assert all_rows(np.zeros(60), three) == 1.0
    assert all_rows(np.full(60, chdtri(3.0, 0.5)), three) == pytest.approx(1.0)
    noise = np.random.default_rng(1).chisquare(3.0, 20000)
    assert 1.0 < all_rows(noise, np.full(20000, 3.0)) < 1.2
    gross = np.where(np.arange(60) < 6, 1e6 * noise[:60], noise[:60])
    assert all_rows(gross, three) < 2.5 < 20.0 < all_rows(
        np.where(np.arange(60) < 30, 1e6 * noise[:60], noise[:60]), three)
    # what has no pose, or was not measured, is not judged
    assert all_rows(np.array([9.0, np.nan, 1e9]), np.array([3.0, 3.0, 0.0])) == all_rows(
        np.array([9.0]), np.array([3.0]))


def test_a_score_counts_noise_and_a_bent_geometry_alike() -> None:
    assert Score(1.0, noise=0.9, geometry=1.5).total == 1.0
    assert Score(1.0, noise=3.0, geometry=1.5).total == 3.0
    assert Score(1.0, noise=1.0, geometry=8.0).total == Score(1.0, noise=4.0).total
    # without a fit what tolerances do not explain stands for both; nothing known is worst
    assert Score(7.0).total == 7.0 and Score().total == np.inf


def test_a_shift_on_a_dense_path_has_the_least_score_to_first_order() -> None:
    machine, data = made(MISREAD["a row late, dense"], 5)
    plain = ColumnInterpretation.as_declared(machine, data)
    readings = [replace(plain, shift=s) for s in (0, 1, -1, 2, -2)]
    found = first_order_scores(Problem(machine, (data,), machine.free), readings)
    assert np.argmin(found) == 1 and found[1] < 0.5 * np.delete(found, 1).min()


def test_scores_to_first_order_do_not_depend_on_where_the_files_frame_is() -> None:
    machine, data = made(MISREAD["a row late, dense"], 5)
    moved = replace(data, position=data.position + np.array([3.0, -2.0, 5.0]))
    plain = ColumnInterpretation.as_declared(machine, data)
    readings = [replace(plain, shift=s) for s in (0, 1)]
    there, here = (first_order_scores(Problem(machine, (d,), machine.free), readings)
                   for d in (moved, data))
    np.testing.assert_allclose(there, here, rtol=1e-4)


def visited_twice(data: Dataset, play: float, lost: int, rng: np.random.Generator) -> Dataset:
    """Return every pose visited from both sides of drives with play, as encoders show them.

    Of the first visits ``lost`` are not measured: with every row a row late, most of those that
    are left have the measurement of their own pose, always from the same side.
    """
    n = len(data)
    own = data.take(np.repeat(np.arange(n), 2))
    side = np.tile([-0.5, 0.5], n)[:, None] * play
    gone = np.isin(np.arange(2 * n), rng.permutation(np.arange(0, 2 * n, 2))[:lost])[:, None]
    position, rotation = (
        np.where(gone, np.nan, v + rng.normal(size=v.shape) * np.nan_to_num(sigma)) for v, sigma in
        ((own.position, own.sigma_position), (own.rotation, own.sigma_rotation)))
    return other(own, q=own.q + side, position=position, rotation=rotation)


@pytest.mark.slow
def test_a_reading_that_is_right_for_most_rows_only_does_not_explain_a_file() -> None:
    """Poses visited twice, by drives with play: a row late, more than half of the rows fit."""
    machine, data = made(Case("3-RRR-1"), 2)
    data = visited_twice(data.take(np.arange(40)), 1e-3, 16, np.random.default_rng(2))
    assert score(Problem(machine, (data,), machine.free).alone(data)).total > TELLING
    assert find_misreading(Problem(machine, (data,), machine.free), 0) is None


@pytest.mark.long
def test_rotations_tell_the_order_of_joints_where_the_target_is_far_off() -> None:
    """Positions of a target 0.1 m from the platform's middle follow the joints otherwise."""
    machine, data = made(MISREAD["joints 1 to 3 in a ring"], 11)
    order = (2, 0, 1, 3, 4, 5)
    assert order in [r.order for r in joint_readings(machine, data)]
    nobody = replace(data, rotation=np.full_like(data.rotation, np.nan))
    assert order not in [r.order for r in joint_readings(machine, nobody)]
    found = find_misreading(Problem(machine, (data,), machine.free), 0)
    assert found is not None and [m.kind for m in found.mistakes] == ["permuted"]
    assert found.block == {"columns": {"q_leg1": "q_leg3", "q_leg2": "q_leg1",
                                       "q_leg3": "q_leg2"}}


@pytest.mark.slow
def test_joints_of_a_file_of_matrices_are_searched_too() -> None:
    """Its rotations are read in one way only: the sidecar has no line for another one."""
    machine, data = made(MISREAD["joints 1 to 3 in a ring"], 11)
    data = replace(data, convention="matrix")
    plain = ColumnInterpretation.as_declared(machine, data)
    assert {(r.turns, r.rotation) for r in pose_readings(plain, data)} == {(plain.turns, "")}
    found = find_misreading(Problem(machine, (data,), machine.free), 0)
    assert found is not None and [m.kind for m in found.mistakes] == ["permuted"]


def test_what_explains_a_file_as_well_is_said_beside_it() -> None:
    one, other = FileFault("mirrored", ("z",), "z is mirrored"), FileFault("sign", ("z",),
                                                                           "z is down")
    found = Interpretation("run.csv", (one,), quantity="length", before=3.0, after=1.0,
                           alternatives=((other,),))
    assert interpretation_sentence(found, SI).startswith("z is mirrored, or: z is down: ")
    assert [e.text for e in misreading_entries([found], SI)] == ["z is mirrored, or: z is down"]


def test_what_a_turn_of_the_frame_makes_alike_is_one_way_and_others_are_alternatives() -> None:
    """Three ways that leave the same, the last one by round-off less; a fourth leaves otherwise."""
    def way(kind: str, parts: float = 1.0) -> Way:
        return Way((FileFault(kind, (), kind),), parts, problem)

    machine, data = made(RIGHT["right"], 5)
    problem = Problem(machine, (data,), machine.free)
    one = Score(0.3, noise=1.02, geometry=0.5)
    good = [(way("mirrored"), one), (way("sign"), replace(one, noise=1.02 - 1e-12)),
            (way("unit"), replace(one, nominal=0.31, noise=1.1)), (way("shifted", 2.0), one)]
    chosen, best, alternatives = _chosen(good)
    assert chosen.what[0].kind == "mirrored" and best == one
    assert [m.kind for what in alternatives for m in what] == ["unit"]


@pytest.mark.slow
def test_rows_without_a_pose_are_no_misreading_of_a_file_whose_others_fit(tmp_path: Path) -> None:
    """Drives exchanged in the last 66 of 120 rows, most of which then have no pose."""
    catalogue.write("swapped-at-end", "3-RRR", 120, 1, tmp_path)
    machine, data = prepared(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    problem = Problem(machine, data, machine.free)
    assert score(problem.alone(data[0])).total == np.inf and find_misreading(problem, 0) is None


def test_a_file_that_has_no_pose_has_the_worst_score() -> None:
    machine, data = made(RIGHT["right"], 5)
    nowhere = replace(data, q=data.q + 1e3)
    assert score(Problem(machine, (nowhere,), machine.free)) == Score()


QUICK = ("a row late, of three drives", "inches in one drive", "drives in radians")


@pytest.mark.long_cases(
    "Euler of turns of 1.5 deg", "Euler of turns of 4 deg", "a sign in a fifth of the rows",
    "drives exchanged from row 40", "inverse, turns of 3 deg", "joints 1 to 3 in a ring",
    "target closed", "two joints the other way", "two rows early, dense", "Euler of turns of 3 deg")
@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow)
                                  for n in MISREAD])
@pytest.mark.slow
def test_misreadings_that_were_held_back_are_named(name: str) -> None:
    assert judged(name, MISREAD[name], 4).answer == "named"


@pytest.mark.long_cases(
    "backlash in the plane", "backlash of every drive", "millimetres off", "periodic and gain",
    "a burst")
@pytest.mark.slow
@pytest.mark.parametrize("name", RIGHT)
def test_right_files_with_real_faults_are_not_misread(name: str) -> None:
    assert judged(name, RIGHT[name], 4).answer == "unseen"
