"""What is known of noise in closed form: excess over it, repeats, and inputs that vary."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2, norm

from ppmcal.diagnosis import lack_of_fit as module
from ppmcal.diagnosis.lack_of_fit import PureError, lack_of_fit, pure_error
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.term_candidates import _varies
from ppmcal.inference.priors import NOISE_FREEDOM, SURE, SURE_SIGMAS

Array = NDArray[np.float64]


def rows(residual: Array, apart: Array | None = None) -> Any:
    """Return as much of a system as noise asks for: every value measured, one file."""
    n, _ = residual.shape
    return SimpleNamespace(
        residual=residual, observed=np.ones(residual.shape, dtype=bool), count=residual.size,
        apart=np.ones(n - 1, dtype=int) if apart is None else apart,
        dataset=np.zeros(n, dtype=int), problem=SimpleNamespace(datasets=(None,)))


def against(left: Array, pure: PureError | None = None, rho: float = 0.0, off: float = 0.0,
            freedom: int = 0) -> tuple[float, float, float, str]:
    count = max(freedom or left.size, left.size)
    stage: Any = SimpleNamespace(
        system=SimpleNamespace(residual=left, count=count, problem=SimpleNamespace(datasets=())),
        noise=Whitening(rho, off), chosen=(), left=lambda chosen: left.reshape(-1),
        explained=lambda chosen: np.zeros((left.size, count - (freedom or left.size))))
    found = lack_of_fit(stage, pure, "", 1.0)
    return found.ratio, found.excess, found.reference, found.source


def test_residuals_of_twice_the_noise() -> None:
    left = 2.0 * np.random.default_rng(12).normal(size=(400, 3))
    ratio, excess, reference, source = against(left)
    assert (reference, source) == (1.0, "stated")
    assert ratio == pytest.approx(2.0, rel=0.05)
    # the mean square is 4, that of a stated sigma within 26 % of 1
    assert excess == pytest.approx(3.0 / np.sqrt(2.0 / NOISE_FREEDOM.value), rel=0.1)
    # what a fit took has to be counted
    assert against(left, freedom=900)[0] == pytest.approx(ratio * np.sqrt(1200 / 900), rel=1e-12)


def test_noise_is_not_in_excess_of_itself() -> None:
    rng = np.random.default_rng(13)
    found = np.array([against(rng.normal(size=(100, 3)))[1] for _ in range(300)])
    assert abs(found.mean()) < 0.3
    assert found.std() < 1.2
    assert (found > SURE_SIGMAS).sum() <= binom.ppf(0.999, 300, 1.0 - SURE.value)


def test_enough_repeats_are_the_reference() -> None:
    left = 2.0 * np.random.default_rng(14).normal(size=(400, 3))
    ratio, excess, reference, source = against(left, PureError(2.0, 30))
    assert (reference, source) == (2.0, "repeats")
    assert ratio == pytest.approx(1.0, rel=0.05)
    assert abs(excess) < 2.0
    assert against(left, PureError(2.0, 29))[2:] == (1.0, "stated")


@pytest.mark.parametrize("n", [3, 400])
@pytest.mark.parametrize("size", [1.0, 1.3, 4.0])
def test_an_excess_has_no_unit(n: int, size: float) -> None:
    """Of few rows too, of which chi-squared says what chance gives."""
    left = size * np.random.default_rng(16).normal(size=(n, 2))
    one, twice = (against(scale * left, PureError(scale, 30)) for scale in (1.0, 2.0))
    assert twice[:2] == pytest.approx(one[:2], rel=1e-9)
    square = float(np.sum(left**2))
    chance = chi2.logsf(square, 2 * n)
    assert norm.logsf(one[1]) >= chance - 1e-9


def test_what_is_uncertain_of_the_noise_makes_nothing_more_certain() -> None:
    """Few repeats, or a correlation that is hardly known: the same residuals exceed it by less."""
    left = 1.3 * np.random.default_rng(15).normal(size=(400, 3))
    known = against(left, PureError(1.0, 10**9))[1]
    few = against(left, PureError(1.0, 40))[1]
    off = against(left, PureError(1.0, 10**9), 0.5, 0.2)[1]
    worse = against(left, PureError(1.0, 10**9), 0.5, 0.4)[1]
    mean = float(np.mean(left**2))
    assert 0.0 < few < known
    assert 0.0 < worse < off < known
    # var(rms^2) of k repeats is 2/k, of a correlation that is off by d: (2 rho d/(1 - rho^2))^2
    assert few == pytest.approx((mean - 1.0) / np.sqrt(2.0 / 40 + error(left) ** 2), rel=0.02)
    assert off == pytest.approx((mean - 1.0) / np.hypot(0.2 / 0.75, error(left)), rel=0.02)


def error(left: Array) -> float:
    """Return the standard error of the mean square, at the noise's own level."""
    square = np.sum(left**2, axis=1)
    return float(square.std() / np.sqrt(len(square)) / left.shape[1] / np.mean(left**2))


def test_a_column_varies_where_it_changes_by_more_than_round_off() -> None:
    values = np.array([[1.0, 0.0, 5.0, 5.0], [2.0, 0.0, 5.0, 5.0 * (1.0 + 1e-15)]])
    np.testing.assert_array_equal(_varies(values), [True, False, False, False])


def test_pure_error_is_the_scatter_about_the_means_of_repeats(monkeypatch: pytest.MonkeyPatch
                                                             ) -> None:
    """Wherever the repeats lie; values that were not measured have no part in it."""
    rng = np.random.default_rng(24)
    label = np.array([0, 0, 0, 1, 1, 2, 3, 3])
    system = rows(rng.normal(size=(8, 2)) + 7.0 * label[:, None])
    system.observed[0, 1] = system.observed[6, 1] = False
    system.residual[~system.observed] = 0.0
    monkeypatch.setattr(module, "_environments", lambda system: label)
    found = pure_error(system)
    square, freedom = 0.0, 0
    for a in range(4):
        for c in range(2):
            own = system.residual[(label == a) & system.observed[:, c], c]
            square += float(np.sum((own - own.mean()) ** 2))
            freedom += own.size - 1
    assert found is not None
    assert found.freedom == freedom == 6
    assert found.ratio == pytest.approx(np.sqrt(square / freedom), rel=1e-12)


def test_repeats_are_of_one_pose_and_one_environment() -> None:
    """Within a fiftieth of the largest speed or load, and a twentieth of a kelvin."""
    columns = {"vel_leg1": np.array([1.0, 1.0, 0.9, 1.0, 1.0, 1.0]),
               "temperature": 20.0 + np.array([0.0, 0.0, 0.0, 0.3, 0.0, 0.0]),
               "payload": np.array([5.0] * 4 + [5.5, 5.0])}
    data = SimpleNamespace(groups=np.zeros(6, dtype=int), columns=columns, sessions=None,
                           directions=lambda: None)
    system: Any = SimpleNamespace(dataset=np.zeros(6, dtype=int), row=np.arange(6),
                                  problem=SimpleNamespace(datasets=(data,)))
    label = module._environments(system)
    assert label is not None
    same = label[:, None] == label
    assert same[0].tolist() == [True, True, False, False, False, True]
    assert (same.sum(axis=1) == [3, 3, 1, 1, 1, 3]).all()
    data.groups = np.arange(6)
    assert module._environments(system) is None
