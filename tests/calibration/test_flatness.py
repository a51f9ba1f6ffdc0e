"""A flat that is not quite flat: its shape apart from the scatter of touches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.instruments import truth
from helpers.printers import fitted, printer, touches

from ppmcal import algebra as cga
from ppmcal.calibration.fit.flatness import Flat, flats
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.model.dataset import Unknown

SCATTER = 1e-5
"""What :func:`touches` adds to every height."""


def shape_of(tmp_path: Path, seed: int, size: float, n: int = 120, unknown: bool = False) -> Flat:
    """Fit touches of a bed with a cubic shape of rms about ``size``."""
    mechanism = printer(tmp_path, ratio=-0.0125, length={"value": 300, "fixed": True})
    rng = np.random.default_rng([21, seed])
    g = truth(mechanism, rng)
    data = touches(mechanism, g, rng, n)
    x, y = cga.translation(forward(Model(mechanism, g), data.q).pose)[:, :2].T / 0.11
    # three-fold shapes are what a delta's own geometry explains least
    bump = x**3 - 3.0 * x * y**2 + x**2 * y**2
    data = replace(data, value=data.value + size * (bump - bump.mean()) / bump.std())
    if unknown:
        data = replace(data, frame=Unknown(True, np.zeros(6)))
    (found,) = flats(fitted(mechanism, data))
    return found


@pytest.mark.parametrize("unknown", [False, True])
def test_shape_and_scatter_are_told_apart(tmp_path: Path, unknown: bool) -> None:
    """Whether the flat's height and tilt are known or not."""
    found = shape_of(tmp_path, 1, 5e-5, unknown=unknown)
    assert found.p_value < 1e-6 and found.degree >= 3
    assert found.scatter == pytest.approx(SCATTER, rel=0.2)
    # the geometry takes a part of any shape
    assert 1.5e-5 < found.smooth < 5.5e-5


@pytest.mark.long
def test_a_flat_flat_has_no_shape(tmp_path: Path) -> None:
    found = [shape_of(tmp_path, seed, 0.0, 60) for seed in range(20)]
    assert sum(f.p_value < 0.05 for f in found) <= 4
    assert np.sqrt(np.mean([f.scatter**2 for f in found])) == pytest.approx(SCATTER, rel=0.05)


def test_few_touches_say_nothing(tmp_path: Path) -> None:
    mechanism = printer(tmp_path)
    rng = np.random.default_rng(2)
    data = touches(mechanism, truth(mechanism, rng), rng, 15)
    assert not list(flats(fitted(mechanism, data)))
