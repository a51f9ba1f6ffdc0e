"""What is known of noise in closed form: correlation, covariance, excess, and inputs that vary."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2, norm

from ppmcal.diagnosis import adequacy, whitening
from ppmcal.diagnosis.adequacy import _against_noise, _kernel, kernel_test, low_rank, varies
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.whitening import (
    PureError,
    _cleaned,
    _correlate,
    _correlation,
    _gain,
    _of_rest,
    _within_rows,
    heavy,
    pure_error,
    simulated,
)

Array = NDArray[np.float64]


def rows(residual: Array, apart: Array | None = None) -> Any:
    """Return as much of a system as noise asks for: every value measured, one file."""
    n, _ = residual.shape
    return SimpleNamespace(
        residual=residual, observed=np.ones(residual.shape, dtype=bool), count=residual.size,
        apart=np.ones(n - 1, dtype=int) if apart is None else apart,
        dataset=np.zeros(n, dtype=int), problem=SimpleNamespace(datasets=(None,)))


def white(m: int) -> Whitening:
    return Whitening(np.eye(m)[None], 0.0)


def test_what_columns_explain_is_the_length_of_the_projection() -> None:
    """Of one column, of several, and of columns of which one is the sum of two others."""
    rng = np.random.default_rng(1)
    residual, a = rng.normal(size=30), rng.normal(size=(30, 3))
    for columns in (a[:, :1], a, np.column_stack([a, a[:, 0] + a[:, 1]])):
        unit = columns / np.linalg.norm(columns, axis=0)
        basis = np.linalg.svd(columns, full_matrices=False)[0][:, :min(columns.shape[1], 3)]
        assert _gain(unit, unit.T @ residual, residual) == pytest.approx(
            np.sum((basis.T @ residual) ** 2), rel=1e-9)


def test_noise_that_was_projected_is_not_correlated() -> None:
    """Smooth columns taken out of white noise leave it against itself: that is allowed for."""
    rng = np.random.default_rng(2)
    n, rank, draws = 120, 24, 400
    t = (np.arange(n) + 0.5) / n
    slow = np.stack([np.cos(np.pi * k * t) for k in range(rank)], axis=-1)[:, None, :]
    found = []
    for _ in range(draws):
        system = rows(rng.normal(size=(n, 1)))
        found.append(_correlation(system, *_cleaned(system, slow, white(1))))
    value = np.array([v for v, _ in found])
    assert {pairs for _, pairs in found} == {n - 1}
    assert abs(value.mean()) < 4.0 * value.std() / np.sqrt(draws)
    # without the allowance it would be far from 0
    assert rank / n > 20.0 * value.std() / np.sqrt(draws)


def test_rows_of_which_a_fit_takes_every_value_tell_no_correlation() -> None:
    rng = np.random.default_rng(4)
    n = 30
    system = rows(rng.normal(size=(n, 1)))
    every = np.eye(n)[:, None, :]
    assert _correlation(system, *_cleaned(system, every, white(1))) == (0.0, n - 1)


def test_correlation_of_successive_rows_only() -> None:
    """Of rows with one left out between them, or of two files, nothing is said."""
    rng = np.random.default_rng(3)
    z = rng.normal(size=4000)
    for t in range(1, len(z)):
        z[t] = 0.6 * z[t - 1] + 0.8 * z[t]
    none = np.zeros((len(z), 1, 0))
    found, pairs = _correlation(rows(z[:, None]), none, z[:, None])
    assert found == pytest.approx(0.6, abs=0.05)
    assert pairs == 3999
    some = z[::2, None]
    assert _correlation(rows(some, np.full(len(some) - 1, 2)), none[::2], some) == (0.0, 0)


def test_pairs_that_are_not_successive_count_for_nothing() -> None:
    """Every third row is of another file: the rest tells the same, basis and all."""
    rng = np.random.default_rng(17)
    n = 300
    slow = np.linspace(-1.0, 1.0, n)[:, None, None] ** np.arange(4)
    system = rows(rng.normal(size=(n, 1)), np.where(np.arange(n - 1) % 3 == 2, 0, 1))
    basis, left = _cleaned(system, slow, white(1))
    found, pairs = _correlation(system, basis, left)
    both = [k for k in range(n - 1) if k % 3 != 2]
    own = sum(left[k, 0] * left[k + 1, 0] for k in both) / len(both)
    taken = sum(float(basis[k, 0] @ basis[k + 1, 0]) for k in both) / len(both)
    assert pairs == len(both)
    assert found == pytest.approx(own / (np.sum(left**2) / n) + taken / (1.0 - 4 / n), rel=1e-9)


@pytest.mark.parametrize(("pairs", "told"), [(20, True), (19, False)])
def test_few_pairs_tell_no_correlation(pairs: int, told: bool) -> None:
    same = np.ones((pairs + 1, 1))
    found, counted = _correlation(rows(same), np.zeros((pairs + 1, 1, 0)), same)
    assert (counted, found != 0.0) == (pairs, told)


def test_coordinates_that_go_together_are_made_independent() -> None:
    rng = np.random.default_rng(4)
    root = np.array([[3.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, -1.0, 0.5]])
    left = rng.normal(size=(2000, 3)) @ root.T
    found = _within_rows(rows(left), np.zeros((2000, 3, 0)), left, white(3))
    made = left @ found.inner[0].T / found.scale
    np.testing.assert_allclose(made.T @ made / len(made), np.eye(3), atol=1e-9)


def test_what_chance_makes_of_stated_noise_is_left_alone() -> None:
    rng = np.random.default_rng(5)
    changed = 0
    for _ in range(40):
        left = 1.7 * rng.normal(size=(60, 3))
        found = _within_rows(rows(left), np.zeros((60, 3, 0)), left, white(3))
        changed += not np.array_equal(found.inner[0], np.eye(3))
        assert found.scale == pytest.approx(1.7, rel=0.3)
    assert changed == 0


@pytest.mark.parametrize(("chance", "white_again"), [(1.2, False), (0.8, True)])
def test_a_covariance_counts_where_chance_makes_it_once_in_a_thousand(chance: float,
                                                                      white_again: bool) -> None:
    """By the likelihood ratio against equal variances: m (m + 1) / 2 - 1 degrees of freedom."""
    n, m = 400, 3
    made = np.linalg.qr(np.random.default_rng(5).normal(size=(n, m)))[0] * np.sqrt(n)
    wanted = chi2.isf(chance * whitening.SIGNIFICANT, m * (m + 1) / 2 - 1)

    def statistic(e: float) -> float:
        share = np.array([1.0 + e, 1.0, 1.0])
        return float(-n * np.sum(np.log(share / share.mean())))

    e = brentq(lambda e: statistic(e) - wanted, 0.0, 5.0)
    left = made * np.sqrt([1.0 + e, 1.0, 1.0])
    found = _within_rows(rows(left), np.zeros((n, m, 0)), left, white(m))
    assert np.array_equal(found.inner[0], np.eye(m)) != white_again


def test_a_projection_takes_freedom_not_variance() -> None:
    """A third of one coordinate projected away: its variance is not a third smaller for it."""
    rng = np.random.default_rng(6)
    n = 900
    basis = np.zeros((n, 2, n // 3))
    basis[np.arange(n // 3), 0, np.arange(n // 3)] = 1.0
    left = rng.normal(size=(n, 2))
    left[:n // 3, 0] = 0.0
    found = _within_rows(rows(left), basis, left, white(2))
    np.testing.assert_array_equal(found.inner[0], np.eye(2))
    assert found.scale == pytest.approx(1.0, abs=0.08)


def test_too_few_rows_show_no_covariance() -> None:
    left = np.random.default_rng(7).normal(size=(11, 3)) @ np.diag([9.0, 1.0, 1.0])
    found = _within_rows(rows(left), np.zeros((11, 3, 0)), left, white(3))
    assert (found.scale, found.inner.tolist()) == (1.0, np.eye(3)[None].tolist())


def test_a_correlation_that_is_known_leaves_white_noise_white() -> None:
    """Whatever is between the rows: made and taken out again, it is the noise that it was."""
    rng = np.random.default_rng(8)
    z = rng.normal(size=(60, 2, 5))
    apart = rng.integers(0, 4, size=59)
    out = z.copy()
    _correlate(out, Whitening(np.eye(2)[None], 0.7, rho_error=1e-13), rows(z[..., 0], apart), rng)
    np.testing.assert_allclose(out, z, atol=1e-9)


def test_a_row_is_correlated_with_the_one_before_if_they_are_of_one_file() -> None:
    """Where a file begins, or a row does not follow, it is drawn as it is."""
    rng = np.random.default_rng(9)
    out = rng.normal(size=(5, 1, 30))
    fresh = out.copy()
    _correlate(out, Whitening(np.eye(1)[None], 0.0, rho_error=0.4),
               rows(out[..., 0], np.array([0, 1, 0, 2])), rng)
    changed = np.any(out != fresh, axis=(1, 2))
    assert changed.tolist() == [False, False, True, False, True]


@pytest.mark.parametrize("gap", [1, 2])
def test_a_correlation_that_is_off_is_left_in_the_rows(gap: int) -> None:
    """Of noise with rho +- error, taken for white: rows are correlated by rho^gap, variance 1."""
    rng = np.random.default_rng(9)
    out = rng.normal(size=(4000, 1, 40))
    _correlate(out, Whitening(np.eye(1)[None], 0.0, rho_error=0.4),
               rows(out[..., 0], np.full(3999, gap)), rng)
    found = np.mean(out[1:] * out[:-1], axis=(0, 1))
    assert np.mean(out**2) == pytest.approx(1.0, abs=0.05)
    if gap == 2:
        assert found.min() > -0.06      # a square
        assert found.mean() == pytest.approx(0.16, abs=0.1)
    else:
        assert found.min() < -0.2 < 0.2 < found.max()


def test_simulated_noise_is_of_unit_variance_where_values_were_measured() -> None:
    rng = np.random.default_rng(10)
    system = rows(rng.normal(size=(200, 3)))
    system.observed[::3, 1] = False
    drawn = simulated(white(3), system, np.zeros((600, 0)), system.residual.reshape(-1), 300, rng)
    drawn = drawn.reshape(200, 3, 300)
    assert not drawn[~system.observed].any()
    assert np.mean(drawn[system.observed] ** 2) == pytest.approx(1.0, abs=0.02)


def test_rows_with_heavy_tails_are_drawn_whole_and_of_unit_variance() -> None:
    """Also where half of the freedom went into a fit, which made the residuals smaller."""
    rng = np.random.default_rng(11)
    size = 3.0 * rng.standard_t(3.0, size=(400, 1)) * np.ones((1, 2))
    system = rows(size)
    basis = np.linalg.qr(rng.normal(size=(800, 400)))[0]
    drawn = simulated(white(2), system, basis, size.reshape(-1), 200, rng).reshape(400, 2, 200)
    assert heavy(size.reshape(-1))
    assert np.mean(drawn**2) == pytest.approx(1.0, abs=0.1)
    assert abs(np.corrcoef(np.abs(drawn[:, 0].ravel()), np.abs(drawn[:, 1].ravel()))[0, 1]) > 0.5
    assert abs(np.mean(np.sign(drawn))) < 0.02


@pytest.mark.parametrize("values", [np.ones(99) * np.array([50.0] + 98 * [0.1]), np.zeros(200)],
                         ids=["few", "none"])
def test_no_tails_without_values(values: Array) -> None:
    assert not heavy(values)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e3])
@pytest.mark.parametrize("n", [100, 5000])
def test_normal_noise_has_no_tails_of_any_size(size: float, n: int) -> None:
    rng = np.random.default_rng(17)
    assert not any(heavy(size * rng.normal(size=n)) for _ in range(20))
    assert heavy(size * rng.standard_t(3.0, size=5000))


# --- against the noise ----------------------------------------------------------------------------

def against(left: Array, pure: PureError | None = None, rho: float = 0.0, off: float = 0.0,
            freedom: int = 0) -> tuple[float, float, float, str]:
    stage: Any = SimpleNamespace(
        system=SimpleNamespace(residual=left, problem=SimpleNamespace(datasets=())), pure=pure,
        noise=Whitening(np.eye(left.shape[1])[None], rho, rho_error=off))
    return _against_noise(stage, left.reshape(-1), freedom or left.size)


def test_residuals_of_twice_the_noise() -> None:
    left = 2.0 * np.random.default_rng(12).normal(size=(400, 3))
    ratio, excess, reference, source = against(left)
    assert (reference, source) == (1.0, "stated")
    assert ratio == pytest.approx(2.0, rel=0.05)
    assert excess > 20.0
    # what a fit took has to be counted
    assert against(left, freedom=900)[0] == pytest.approx(ratio * np.sqrt(1200 / 900), rel=1e-12)


def test_noise_is_not_in_excess_of_itself() -> None:
    rng = np.random.default_rng(13)
    found = np.array([against(rng.normal(size=(100, 3)))[1] for _ in range(300)])
    assert abs(found.mean()) < 0.3
    assert found.std() == pytest.approx(1.0, abs=0.2)
    assert (found > 3.5).sum() == 0


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
    np.testing.assert_array_equal(varies(values), [True, False, False, False])


def test_kernels_are_centred_symmetric_and_of_low_rank() -> None:
    """A figure of residuals that are all alike is 0: nothing follows from a mean."""
    x = np.random.default_rng(16).normal(size=(50, 1)) * 7.0 + 3.0
    kernel = _kernel(x, (0.6, 1.5))
    np.testing.assert_allclose(kernel, kernel.T, atol=1e-12)
    np.testing.assert_allclose(kernel.sum(axis=0), 0.0, atol=1e-10)
    np.testing.assert_allclose(_kernel(x * 1e6, (0.6, 1.5)), kernel, atol=1e-9)
    root = low_rank(kernel, 40)
    assert root is not None
    np.testing.assert_allclose(root @ root.T, kernel, atol=1e-9)
    assert low_rank(np.eye(10), 5) is None


# --- the whitening of what is left ----------------------------------------------------------------

def rest_of(residual: Array) -> Whitening:
    """Return the whitening with nothing projected out but a mean."""
    n, m = residual.shape
    system = rows(residual)
    system.jacobian = np.ones((n, m, 1))
    library: Any = SimpleNamespace(some=lambda columns: np.zeros((n, m, 0)))
    return _of_rest(system, library, [])


def tied(rho: float, n: int, seed: int) -> Array:
    z = np.random.default_rng(seed).normal(size=n)
    for t in range(1, n):
        z[t] = rho * z[t - 1] + np.sqrt(1.0 - rho**2) * z[t]
    return z[:, None]


@pytest.mark.parametrize("rho", [-0.5, 0.0, 0.6, 0.9])
def test_the_correlation_of_rows_and_how_well_it_is_known(rho: float) -> None:
    """An AR(1) of 4000 rows: its standard error is sqrt((1 - rho^2)/n)."""
    found = rest_of(tied(rho, 4000, 18))
    error = np.sqrt((1.0 - rho**2) / 3999)
    assert abs(found.rho - rho) < (3.0 * error if rho else 1e-12)
    assert found.rho_error == pytest.approx(np.sqrt((1.0 - found.rho**2) / 3999), rel=0.02)
    assert found.scale == pytest.approx(1.0, abs=0.15)


def test_a_correlation_within_two_sigmas_is_none() -> None:
    """Of 400 pairs 0.1 is two: less is left as it is, more is taken out."""
    taken = {}
    for seed in range(60):
        z = np.random.default_rng(seed).normal(size=(401, 1))
        z -= z.mean()
        found, _ = _correlation(rows(z), np.full((401, 1, 1), 401**-0.5), z)
        if 0.06 < abs(found) < 0.095 or 0.105 < abs(found) < 0.145:
            taken[abs(found) > 0.1] = rest_of(z).rho != 0.0 or taken.get(abs(found) > 0.1, False)
    assert taken == {False: False, True: True}


def test_of_few_rows_a_correlation_is_hardly_known() -> None:
    assert rest_of(tied(0.9, 15, 19)).rho == 0.0
    assert rest_of(tied(0.0, 3, 20)).rho_error == 0.5


def test_what_residuals_follow_is_found_and_noise_follows_nothing(
        monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(21)
    n = 120
    known = {name: (rng.uniform(-1.0, 1.0, (n, 1)), (0.25, 1.0)) for name in ("a", "b", "c")}
    monkeypatch.setattr(adequacy, "inputs", lambda system: known)
    noise = rng.normal(size=(n, 2))
    for follows in ("a", "b", "c", ""):
        left = noise + (np.sin(4.0 * known[follows][0]) if follows else 0.0)
        stage: Any = SimpleNamespace(system=rows(left), noise=white(2))
        by_input, p, found = kernel_test(stage, np.zeros((2 * n, 0)), left.reshape(-1), 1)
        if follows:
            assert found == follows == min(by_input, key=lambda name: by_input[name])
            assert p < 0.005
        else:
            assert p > 0.02
            assert min(by_input.values()) > 0.005


def test_a_correlation_that_is_not_known_is_in_simulated_noise() -> None:
    rng = np.random.default_rng(22)
    system = rows(rng.normal(size=(3000, 1)))
    for off in (0.0, 0.4):
        noise = Whitening(np.eye(1)[None], 0.0, rho_error=off)
        drawn = simulated(noise, system, np.zeros((3000, 0)), system.residual[:, 0], 30, rng)
        found = np.mean(drawn[1:] * drawn[:-1], axis=0)
        assert (np.abs(found).max() > 0.2) == (off > 0.0)


def test_residuals_that_a_fit_made_smaller_are_drawn_at_their_own_size() -> None:
    """Half of the rows lost three quarters of their variance to the fit; all had one size."""
    rng = np.random.default_rng(23)
    size = np.ones(200)
    size[[10, 60, 120, 170]] = 15.0
    basis = np.zeros((200, 100))
    basis[np.arange(100), np.arange(100)] = np.sqrt(0.75)
    left = size * rng.choice((-1.0, 1.0), 200) * np.sqrt(1.0 - np.sum(basis**2, axis=1))
    drawn = simulated(white(1), rows(left[:, None]), basis, left, 50, rng)
    small, large = np.unique(np.round(np.abs(drawn), 9))
    assert large == pytest.approx(15.0 * small)
    assert 15.0 * small == pytest.approx(15.0 / np.sqrt(np.mean(size**2)))


def test_a_hundred_values_may_show_tails() -> None:
    values = np.array([50.0] + 99 * [0.1])
    assert heavy(values)
    assert not heavy(values[:99])


def test_pure_error_is_the_scatter_about_the_means_of_repeats(monkeypatch: pytest.MonkeyPatch
                                                             ) -> None:
    """Wherever the repeats lie; values that were not measured have no part in it."""
    rng = np.random.default_rng(24)
    label = np.array([0, 0, 0, 1, 1, 2, 3, 3])
    system = rows(rng.normal(size=(8, 2)) + 7.0 * label[:, None])
    system.observed[0, 1] = system.observed[6, 1] = False
    system.residual[~system.observed] = 0.0
    monkeypatch.setattr(whitening, "_environments", lambda system: label)
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
