"""Functions that no library has: over the volume, of the payload, of another joint's travel."""

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
