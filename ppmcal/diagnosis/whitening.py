"""What the noise is like: repeats, covariance within a row, correlation from row to row.

Everything is estimated with the candidate effects projected out, so that an effect is
not whitened away as if it were noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from ppmcal import linalg
from ppmcal.diagnosis.event_pairs import best_pair
from ppmcal.diagnosis.hypotheses import Hypothesis, Library
from ppmcal.diagnosis.linear_system import TOGETHER, System, Whitening, plain, range_basis
from ppmcal.errors import LinearAlgebraError
from ppmcal.linalg import Array, unit_columns
from ppmcal.model.effects import GEOMETRY
from ppmcal.model.repeats import repeats

SIGNIFICANT = 1e-3
"""A covariance or correlation is whitened away where chance would show it this rarely."""
MOST = 0.4
"""Candidate columns take at most this part of the freedom when noise is estimated."""


@dataclass(frozen=True)
class PureError:
    """Scatter of repeats in the same environment: sigma over the stated one, freedom."""

    ratio: float
    freedom: int


def pure_error(system: System) -> PureError | None:
    """Return the scatter within rows of one pose and environment, or None."""
    label = _environments(system)
    if label is None:
        return None
    count = int(label.max()) + 1
    size = np.zeros((count, system.residual.shape[1]))
    total = np.zeros_like(size)
    np.add.at(size, label, system.observed.astype(float))
    np.add.at(total, label, system.residual)
    away = np.where(system.observed, system.residual - (total / np.maximum(size, 1.0))[label], 0.0)
    freedom = int(np.sum(np.maximum(size - 1.0, 0.0)))
    return PureError(float(np.sqrt(np.sum(away**2) / freedom)), freedom) if freedom else None


def _environments(system: System) -> NDArray[np.int64] | None:
    """Return one label per pose and environment (N,); different ones hide no effect."""
    own = np.zeros(system.dataset.size, dtype=np.int64)
    for i, data in enumerate(system.problem.datasets):
        mine = system.dataset == i
        own[mine] = repeats(data)[system.row[mine]]
    label = system.dataset * (int(own.max(initial=0)) + 1) + own
    label = np.unique(label, return_inverse=True)[1].reshape(-1)
    return np.asarray(label, dtype=np.int64) if label.max() + 1 < label.size else None


def estimate(system: System, library: Library, extra: Sequence[int] = ()) -> Whitening:
    """Return the whitening that the residuals ask for.

    ``extra``: columns of the library that must be projected out whatever they cost (chosen
    effects).
    """
    columns = _projected(system, library, extra)
    noise = _of_rest(system, library, columns)
    if noise.rho > 0.0:
        pair = best_pair(system, library, columns, noise)
        if pair:
            noise = _of_rest(system, library, list(dict.fromkeys([*columns, *pair])))
    return noise


def _of_rest(system: System, library: Library, columns: Sequence[int]) -> Whitening:
    """Return the whitening with columns of the library projected out."""
    noise = plain(system)
    everything = np.concatenate([system.jacobian, library.some(columns)], axis=-1)
    shape = system.residual.shape
    plane = range_basis(unit_columns(noise.apply(everything, system))).reshape(*shape, -1)
    basis, left = _cleaned(system, plane, noise)
    noise = _within_rows(system, basis, left, noise)
    basis, left = _cleaned(system, plane, noise)
    rho = 0.0
    for _ in range(3):
        more, pairs = _correlation(system, basis, left)
        share = 1.0 - basis.shape[-1] / system.count
        noise = replace(noise, rho_error=float(np.sqrt(
            (1.0 - rho**2) / max(pairs * share, 4.0))))
        if abs(more) < (2.0 if rho == 0.0 else 0.5) / np.sqrt(max(pairs, 1)):
            break
        rho = float(np.clip((rho + more) / (1.0 + rho * more), -0.98, 0.98))
        noise = replace(noise, rho=rho)
        basis, left = _cleaned(system, plane, noise)
    return noise


def _projected(system: System, library: Library, extra: Sequence[int]) -> list[int]:
    """Return the columns to project out: each kind's freest hypothesis, the best few of a grid.

    Where there is not room for all, those that explain most come first, grids last.
    """
    room = MOST * system.count - system.jacobian.shape[-1]
    chosen = list(dict.fromkeys(extra))
    hypotheses: dict[str, list[int]] = {}
    grid: dict[tuple[str, tuple[str, ...]], tuple[float, list[int]]] = {}
    # what is made of a kind that is there itself has most of what it does
    own = [f for f in library.hypotheses if f.effect is None or not f.effect.title]
    scanned = [f for f in own if f.constants and f.searched]
    shared = [f for f in scanned if f.shared]
    for hypothesis, gain in zip(shared, _gains(system, library, [f.columns for f in shared]),
                                strict=True):
        # steps at will, or lags, follow any slow noise: of all only the best one counts
        key = ("slow", ()) if _slow(hypothesis) else (hypothesis.family, hypothesis.on)
        if gain > grid.get(key, (0.0, []))[0]:
            grid[key] = gain, list(hypothesis.columns)
    for hypothesis in own:
        if hypothesis.constants and hypothesis.searched:
            continue
        if hypothesis.kind == GEOMETRY:
            hypotheses[GEOMETRY] = [*hypotheses.get(GEOMETRY, []), *hypothesis.columns]
        elif len(hypothesis.columns) > len(hypotheses.get(hypothesis.family, [])):
            hypotheses[hypothesis.family] = list(hypothesis.columns)
    plain_forms = list(hypotheses.values())
    gains = _gains(system, library, plain_forms)
    ranked = sorted(zip(gains, plain_forms, strict=True), key=lambda g: -g[0] / len(g[1]))
    for _, found in [*ranked, *sorted(grid.values(), reverse=True)]:
        if len(chosen) + len(found) <= room:
            chosen += [c for c in found if c not in chosen]
    return chosen


APART = 1e-3
"""Columns of which each is so far from the others, at unit length, need no singular values."""


def _gains(system: System, library: Library, groups: Sequence[Sequence[int]]) -> list[float]:
    """Return what groups of columns of the library explain of the residual, each alone."""
    residual = system.residual.reshape(-1)
    out: list[float] = []
    for begin, end in _runs([len(g) for g in groups], TOGETHER // residual.size):
        place = {c: n for n, c in enumerate(dict.fromkeys(c for g in groups[begin:end] for c in g))}
        units = unit_columns(library.some(list(place)).reshape(residual.size, -1))
        along = units.T @ residual
        for group in groups[begin:end]:
            at = [place[c] for c in group]
            out.append(_gain(units[:, at], along[at], residual))
    return out


def _gain(unit: Array, along: Array, residual: Array) -> float:
    """Return what unit columns (n, k) explain of a residual, ``along`` being their products."""
    if along.size == 1:
        return float(along[0] ** 2)
    gram = unit.T @ unit
    try:
        root = linalg.cholesky(gram)
    except LinearAlgebraError:
        root = np.zeros((1, 1))
    if np.diagonal(root).min() > APART:
        return float(np.sum(linalg.solve(root, along) ** 2))
    return float(np.sum((unit @ linalg.lstsq(unit, residual, rcond=None)[0]) ** 2))


def _runs(sizes: Sequence[int], most: int) -> Iterator[tuple[int, int]]:
    """Yield runs of items, from and to, that are together at most so large, or of one item."""
    begin, size = 0, 0
    for n, own in enumerate(sizes):
        if n > begin and size + own > most:
            yield begin, n
            begin, size = n, 0
        size += own
    if sizes:
        yield begin, len(sizes)


def _slow(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis is an event, or depends on what came before a row."""
    kind = hypothesis.effect
    return kind is not None and (bool(kind.onset) or "past" in kind.needs or any(
        "past" in s.needs and hypothesis.constants.get(s.name, s.default) != s.default
        for motion in kind.motions for s in kind.parameters(motion)))


def _cleaned(system: System, plane: Array, noise: Whitening) -> tuple[Array, Array]:
    """Return a basis of what spans a plane (N, m, r) and the residual freed of it, whitened."""
    basis = linalg.column_basis(noise.apply(plane, system))
    residual = noise.apply(system.residual[..., None], system)[:, 0]
    left = residual - basis @ (basis.T @ residual)
    shape = system.residual.shape
    return basis.reshape(*shape, -1), left.reshape(shape)


def _within_rows(system: System, basis: Array, left: Array, noise: Whitening) -> Whitening:
    """Whiten with the covariance of the coordinates, where it is not that of stated noise."""
    inner = noise.inner.copy()
    scales = []
    for i in range(len(inner)):
        rows = (system.dataset == i) & system.observed.all(axis=1)
        m = left.shape[1]
        if rows.sum() < 4 * m or not system.observed[system.dataset == i].any():
            continue
        # each coordinate's own freedom: n minus what the projection took from it
        free = np.sum(1.0 - np.sum(basis[rows] ** 2, axis=-1), axis=0)
        free = np.maximum(free, 1.0)
        covariance = left[rows].T @ left[rows] / np.sqrt(np.outer(free, free))
        mean = float(np.trace(covariance)) / m
        sign, logdet = np.linalg.slogdet(covariance / mean)
        statistic = -float(free.mean()) * logdet
        if sign > 0 and chdtrc(m * (m + 1) / 2 - 1, statistic) < SIGNIFICANT:
            root = linalg.cholesky(covariance / mean)
            inner[i] = linalg.inv(root)
        scales.append(mean)
    return replace(noise, inner=inner, scale=float(np.sqrt(np.mean(scales))) if scales else 1.0)


def _correlation(system: System, basis: Array, left: Array) -> tuple[float, int]:
    """Return the correlation of successive rows beyond what the projection makes, and pairs."""
    both = system.observed[1:] & system.observed[:-1] & (system.apart == 1)[:, None]
    pairs, rank = int(both.sum()), basis.shape[-1]
    if pairs < 20 or rank >= system.count:    # or nothing is left
        return 0.0, pairs
    found = float(np.sum(left[1:] * left[:-1] * both)) / pairs
    variance = float(np.sum(left**2)) / system.count
    expected = -float(np.sum(np.sum(basis[1:] * basis[:-1], axis=-1) * both)) / pairs
    return found / variance - expected / (1.0 - rank / system.count), pairs


HEAVY = 3.0
"""Tails are heavy where the kurtosis is so many standard deviations above that of normal noise."""
ENOUGH = 100
"""Fewer values than this show no tails."""
LEAST_FREE = 0.05


def simulated(noise: Whitening, system: System, basis: Array, left: Array, count: int,
          rng: np.random.Generator) -> Array:
    """Return simulated noise (N m, count) after a whitening that knows ``rho`` only so well.

    Each draw has a correlation of its own, as far from ``rho`` as that may be off.

    Args:
        noise: the whitening.
        system: the rows.
        basis: of what was fitted, whitened (N m, r).
        left: whitened residual freed of it (N m,).
        count: how many draws.
        rng: where they come from.
    """
    n, m = system.residual.shape
    out = rng.normal(size=(n, m, count))
    if count:
        free = np.maximum(1.0 - np.sum(basis**2, axis=1), LEAST_FREE)
        scaled = (left / np.sqrt(free)).reshape(n, m)
        for i in range(len(system.problem.datasets)):
            mine = np.flatnonzero(system.dataset == i)
            if heavy(scaled[mine][system.observed[mine]]):
                _resample(out, mine, scaled, system, rng)
    if noise.rho_error > 0.0:
        _correlate(out, noise, system, rng)
    if not system.observed.all():
        out *= system.observed[..., None]
    return out.reshape(n * m, count)


def heavy(values: Array) -> bool:
    """Whether values (n,) have heavier tails than normal noise would show by chance."""
    square = values**2
    mean = float(np.mean(square)) if values.size else 0.0
    if values.size < ENOUGH or mean == 0.0:
        return False
    excess = float(np.mean(square**2)) / mean**2 - 3.0
    return bool(excess > HEAVY * np.sqrt(24.0 / values.size))


def _resample(out: Array, mine: NDArray[np.int64], scaled: Array, system: System,
              rng: np.random.Generator) -> None:
    """Fill rows ``mine`` of ``out`` (N, m, count) with residuals of other rows, at random signs.

    A row is taken as a whole: what disturbs one coordinate may have disturbed all.
    """
    seen = system.observed[mine]
    source = scaled[mine] / np.sqrt(np.mean(scaled[mine][seen] ** 2))
    for row in mine:
        pick = rng.integers(mine.size, size=out.shape[2])
        sign = rng.choice((-1.0, 1.0), size=out.shape[2])
        out[row] = np.where(seen[pick].T, source[pick].T * sign, out[row])


def _correlate(out: Array, noise: Whitening, system: System, rng: np.random.Generator) -> None:
    """Give each draw of white noise (N, m, count) the correlation that the whitening may leave."""
    true = np.clip(noise.rho + noise.rho_error * rng.normal(size=out.shape[2]), -0.95, 0.95)
    before = out[0].copy()
    for row in range(1, len(out)):
        gap = int(system.apart[row - 1])
        if gap == 0:
            before = out[row].copy()
            continue
        tie, known = true**gap, noise.rho**gap
        now = tie * before + np.sqrt(1.0 - tie**2) * out[row]
        out[row] = (now - known * before) / np.sqrt(1.0 - known**2)
        before = now
