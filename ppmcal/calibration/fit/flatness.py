"""Touches of a flat: splits the residuals into a smooth shape over the flat and scatter.

The smooth part is the flat's own shape, or an error of the model that no free geometry explains.
It is a polynomial in the touched position, of the degree chosen by generalised cross-validation,
with its columns projected off those of the fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.linalg import Array, range_basis, subsample
from ppmcal.units import Finite, OfUnit

ENOUGH = 16
"""Fewer touches cannot show a shape."""
HIGHEST = 6
MOST_FREEDOM = 0.6
SURVIVES = 0.03
"""Shapes that the fit absorbed but for this part carry no information."""
MOST = 3000
"""Shapes are fitted to at most this many touches, evenly spread."""


@dataclass(frozen=True)
class Flat:
    """One set of touches: rms of the residuals, m, as ``smooth`` shape and as ``scatter``.

    ``degree`` of the shape (0: none), ``p_value``: chance of a shape as strong from scatter alone.
    """

    dataset: str
    smooth: OfUnit[Finite]
    scatter: OfUnit[Finite]
    degree: int
    p_value: Finite
    unit: str = "length"


def flats(fit: Fit) -> Iterator[Flat]:
    """Yield the shape of each flat with enough touches."""
    count = len(fit.problem.columns)
    for i, data in enumerate(fit.problem.datasets):
        if not data.kind.touches:
            continue
        mine = [k & (j == i) for j, k in enumerate(fit.keep)]
        keep = subsample(mine, MOST)
        used = np.flatnonzero(keep[i])
        chunks = list(fit.problem.rows(fit.state, True, keep))
        if used.size < max(ENOUGH, count + 8):
            continue
        jacobian = np.concatenate([c.jacobian[:, 0] for c in chunks])
        residual = np.concatenate([c.residual[:, 0] for c in chunks])
        raw = np.concatenate([c.raw[:, 0] for c in chunks])
        at = cga.translation(fit.state.poses[i][used])[:, :2]
        yield _shape(data.name, at, jacobian * fit.scale, residual, raw)


def _shape(name: str, at: Array, jacobian: Array, residual: Array, raw: Array) -> Flat:
    unit = float(np.median(np.abs(raw[residual != 0.0] / residual[residual != 0.0])))
    basis = range_basis(jacobian, 1e-9)
    left = residual - basis @ (basis.T @ residual)
    n, taken = left.size, basis.shape[1]
    best = (n * float(left @ left) / (n - taken) ** 2, 0, np.zeros_like(left), taken)
    for degree in range(2, HIGHEST + 1):
        columns = linalg.column_basis(_monomials(at, degree))
        columns = columns - basis @ (basis.T @ columns)
        # positions come from the fit: what it absorbed would be explained by its own residuals
        w = range_basis(columns, least=SURVIVES)
        freedom = taken + w.shape[1]
        if freedom > MOST_FREEDOM * n:
            break
        smooth = w @ (w.T @ left)
        rest = float(np.sum((left - smooth) ** 2))
        score = n * rest / (n - freedom) ** 2
        if score < best[0]:
            best = score, degree, smooth, freedom
    _, degree, smooth, freedom = best
    rest = float(np.sum((left - smooth) ** 2))
    extra = freedom - taken
    p = 1.0
    if extra and rest > 0.0:
        ratio = (float(smooth @ smooth) / extra) / (rest / (n - freedom))
        p = min(1.0, (HIGHEST - 1) * float(fdtrc(extra, n - freedom, ratio)))
    scatter = rest / (n - freedom)
    # scatter alone would also appear as a shape
    shape = max(0.0, (float(smooth @ smooth) - extra * scatter) / n)
    return Flat(name, unit * float(np.sqrt(shape)), unit * float(np.sqrt(scatter)), degree, p)


def _monomials(at: Array, degree: int) -> Array:
    """Return x^i y^j with i + j <= degree at scaled places (n, 2), one column each."""
    scaled = (at - at.mean(axis=0)) / np.maximum(np.abs(at - at.mean(axis=0)).max(axis=0), 1e-12)
    x, y = scaled.T
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)],
                    axis=-1)
