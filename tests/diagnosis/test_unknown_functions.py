"""Functions that no library has: over the volume, of payload, ways, travel, fine and kinked."""

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


def found(change: Callable[[Dataset, Array], Dataset], **columns: Array) -> Round:
    """Return what is found of a planar machine after a change of its data, in sigmas (N,)."""
    hidden = hide("3-RPR", 7, [], 1.0, Options(poses=50), "all")
    data = hidden.dataset
    data = replace(data, columns={**data.columns, **columns})
    return last_round(hidden.mechanism, change(data, np.ones(len(data))
                                               * data.sigma_position.min()))


def test_a_lens_is_no_scale_and_no_gain() -> None:
    def bent(data: Dataset, sigma: Array) -> Dataset:
        away = data.position[:, :2] - data.position[:, :2].mean(axis=0)
        away /= np.abs(away).max()
        seen = data.position.copy()
        seen[:, :2] += 60.0 * (sigma * np.sum(away**2, axis=1))[:, None] * away
        return replace(data, position=seen)

    places = found(bent).places
    assert places and not any(p.named for p in places)
    assert all(p.label.startswith("a distortion of") for p in places)


@pytest.mark.parametrize("power", [2.0, 3.0])
def test_what_follows_the_payload_in_one_joint_is_no_compliance(power: float) -> None:
    payload = np.random.default_rng(3).choice([0.0, 5.0, 10.0], 100)

    def loaded(data: Dataset, sigma: Array) -> Dataset:
        q = data.q.copy()
        q[:, 1] += 20.0 * sigma * (payload / 10.0)**power
        return replace(data, q=q)

    place, = found(loaded, payload=payload).places
    assert place.label == "a function of the payload acting on leg2" and not place.named


def test_what_a_joint_does_to_another_is_no_gain() -> None:
    def moved(data: Dataset, sigma: Array) -> Dataset:
        q = data.q.copy()
        own = (q[:, 1] - q[:, 1].mean()) / q[:, 1].std()
        q[:, 0] += 8.0 * sigma * np.exp(0.7 * own)
        return replace(data, q=q)

    place, = found(moved).places
    assert place.label == "a function of the travel of leg2 acting on leg1" and not place.named


def test_a_wave_that_turns_faster_along_the_stroke_is_no_row_of_waves() -> None:
    def wavy(data: Dataset, sigma: Array) -> Dataset:
        q = data.q.copy()
        along = (q[:, 0] - q[:, 0].min()) / np.ptp(q[:, 0])
        q[:, 0] += 6.0 * sigma * np.sin(40.0 * along**2)
        return replace(data, q=q)

    place, = found(wavy).places
    assert place.label == "a fine function of travel acting on leg1" and not place.named


@pytest.mark.parametrize(("ahead", "row"), [
    (True, "to the next row"), (False, "from the previous row")])
def test_what_is_read_while_the_machine_moves_is_no_scale(ahead: bool, row: str) -> None:
    def early(data: Dataset, sigma: Array) -> Dataset:
        seen = data.position.copy()
        ways = np.diff(seen, axis=0)
        seen[slice(None, -1) if ahead else slice(1, None)] += 0.002 * (ways if ahead else -ways)
        return replace(data, position=seen, columns={**data.columns, **{
            f"dir_leg{n}": np.full(len(data), np.nan) for n in (1, 2, 3)}})

    place, = found(early).places
    assert place.label == f"readings that include part of the move {row}" and not place.named


def test_a_kink_within_a_stroke_is_no_gain() -> None:
    def kinked(data: Dataset, sigma: Array) -> Dataset:
        q = data.q.copy()
        q[:, 1] += 12.0 * sigma * np.abs(q[:, 1] - np.quantile(q[:, 1], 0.4)) / q[:, 1].std()
        return replace(data, q=q)

    place, = found(kinked).places
    assert not place.named and "leg2" in place.label


def test_steps_in_two_legs_are_no_waves_of_all() -> None:
    def stepped(data: Dataset, sigma: Array) -> Dataset:
        q = data.q.copy()
        for leg in (0, 2):
            along = (q[:, leg] - q[:, leg].mean()) / q[:, leg].std()
            q[:, leg] += 10.0 * sigma * np.tanh(4.0 * (along - 0.3))
        return replace(data, q=q)

    places = found(stepped).places
    assert places and not any(p.named for p in places)


def test_heat_that_moves_each_leg_by_another_course_is_one_cause() -> None:
    warmth = 4.0 * np.sin(np.linspace(0.0, 5.0, 100))

    def warmed(data: Dataset, sigma: Array) -> Dataset:
        return replace(data, q=data.q - 0.8 * sigma[:, None] * warmth[:, None]**2 * [1.0, 2.0, 3.0])

    place, = found(warmed, temperature=warmth).places
    assert place.label == "a function of temperature acting on each joint individually"
    assert not place.named
