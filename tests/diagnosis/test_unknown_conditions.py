"""Causes that no library has: of late and early, of what was before, of two things at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.rounds import last_round
from hidden import Options, hide

from ppmcal.diagnosis.explanation import Round
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset

ROWS = 100
LATE = np.linspace(0.0, 1.0, ROWS)
PAYLOAD = np.random.default_rng(5).choice([0.0, 5.0, 10.0], ROWS)


def found(change: Callable[[Dataset, float], Dataset], sides: bool = False) -> Round:
    """Return what is found of a planar machine after a change of its data, by one sigma.

    ``sides``: whether it is recorded from where each joint came.
    """
    hidden = hide("3-RPR", 7, [], 1.0, Options(poses=50), "all")
    data = hidden.dataset
    assert len(data) == ROWS
    unknown = {} if sides else {f"dir_leg{n}": np.full(ROWS, np.nan) for n in (1, 2, 3)}
    data = replace(data, columns={**data.columns, **unknown, "payload": PAYLOAD})
    return last_round(hidden.mechanism, change(data, float(data.sigma_position.min())))


def joint(data: Dataset, index: int, by: Array) -> Dataset:
    q = data.q.copy()
    q[:, index] += by
    return replace(data, q=q)


def read(data: Dataset, axis: int, by: Array) -> Dataset:
    seen = data.position.copy()
    seen[:, axis] += by
    return replace(data, position=seen)


def test_joints_that_all_warm_up_are_no_shifts_of_their_zeros() -> None:
    def warming(data: Dataset, sigma: float) -> Dataset:
        return replace(data, q=data.q + 8.0 * sigma * np.exp(-LATE[:, None] / 0.1)
                       * np.array([1.0, -1.0, 1.0]))

    place, = found(warming).places
    assert place.label == "a start-up transient of the zero of each joint individually"
    assert not place.named


def test_what_gives_to_the_payload_the_less_the_later_is_no_compliance() -> None:
    places = found(lambda data, sigma: read(
        data, 1, 1.2 * sigma * (PAYLOAD - PAYLOAD.mean()) * (0.5 - LATE))).places
    assert not any(p.named for p in places)
    assert any(p.label == "a function of time and payload acting on y" for p in places)


def test_the_move_before_the_last_is_no_gain() -> None:
    def behind(data: Dataset, sigma: float) -> Dataset:
        way = np.sign(np.diff(data.q[:, 0]))
        return joint(data, 0, 6.0 * sigma * np.concatenate([[0.0, 0.0], way[:-1]]))

    places = found(behind).places
    assert places[0].label == "a function of the move before last acting on leg1"
    assert not any(p.named for p in places)


def test_readings_that_come_the_later_the_longer_are_told_as_that() -> None:
    def late(data: Dataset, sigma: float) -> Dataset:
        way = np.diff(data.position, axis=0, prepend=data.position[:1])
        return replace(data, position=data.position - 0.006 * LATE[:, None] * way)

    place, = found(late).places
    assert place.label == (
        "readings that include part of the move from the previous row, changing over the campaign")
    assert not place.named


def test_the_side_in_y_that_moves_x_is_no_hysteresis() -> None:
    def dragged(data: Dataset, sigma: float) -> Dataset:
        side = np.sign(np.diff(data.position[:, 1], prepend=data.position[0, 1]))
        return read(data, 0, 6.0 * sigma * side)

    places = found(dragged).places
    assert places[0].label == "a function of the platform's last move in y acting on x"
    assert not any(p.named for p in places)


def test_what_two_joints_do_to_a_third_is_no_curvature() -> None:
    def twisted(data: Dataset, sigma: float) -> Dataset:
        along = (data.q - data.q.mean(axis=0)) / data.q.std(axis=0)
        return joint(data, 2, 5.0 * sigma * (along[:, 0] - along[:, 1])**2)

    place, = found(twisted).places
    assert place.label == "a function of all joints' travels acting on leg3" and not place.named


@pytest.mark.parametrize("sides", [False, True])
def test_what_its_own_moves_heat_is_no_shift_of_a_zero(sides: bool) -> None:
    def used(data: Dataset, sigma: float) -> Dataset:
        way = np.abs(np.diff(data.q[:, 1], prepend=data.q[0, 1]))
        heat = np.zeros(ROWS)
        for row in range(1, ROWS):
            heat[row] = 0.85 * heat[row - 1] + way[row] / way.mean()
        return joint(data, 1, 1.5 * sigma * (heat - heat.mean()))

    places = found(used, sides).places
    assert places and not any(p.named for p in places)
    assert any(p.label == "a fading trace of its own moves acting on leg2" for p in places)
