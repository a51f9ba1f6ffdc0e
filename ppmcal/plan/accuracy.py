"""How exact the calibrated machine will be at task poses, against the number of measurements.

From the posterior covariance of the linear model, C = M^-1: the mean square error at the tasks
is trace(G C), G the mean of J^T J there. It is what a calibration leaves open, in the
instrument's frame; the repeatability of the drives comes on top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.linalg import Array
from ppmcal.plan.model import Offer

DETERMINED = 1e-10
"""A design is too small while a direction (of columns scaled to 1) has less information."""
PAYS = 0.01
"""One more measurement pays where it lowers the error at the tasks by this part."""
WINDOW = 5
UNSEEN = 1e-9


@dataclass(frozen=True, eq=False)
class Curve:
    """Standard deviations at the tasks after 1 ... n rows (n,), m and rad; inf where too few.

    ``rotation`` is 0 throughout for machines that do not turn.
    """

    position: Array
    rotation: Array


def curve(offer: Offer, rows: Sequence[int], tasks: tuple[Array, Array]) -> Curve:
    """Return the accuracy after each row of a design, in its order."""
    blocks = offer.jacobian[list(rows)]
    total = np.cumsum(np.swapaxes(blocks, -1, -2) @ blocks, axis=0) + np.diag(offer.prior**2)
    return Curve(*spreads(total, tasks))


def spreads(information: Array, tasks: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return both standard deviations (n,) of designs with information (n, C, C)."""
    d = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    safe = np.where(d > 0.0, d, 1.0)
    values, vectors = np.linalg.eigh(information / (safe[:, :, None] * safe[:, None, :]))
    enough = (values[:, 0] > DETERMINED) & (d > 0.0).all(axis=1)
    root = vectors / np.sqrt(np.maximum(values, DETERMINED))[:, None, :] / safe[:, :, None]
    out = [np.sqrt(np.einsum("nci,cd,ndi->n", root, g, root, optimize=True)) for g in tasks]
    return np.where(enough, out[0], np.inf), np.where(enough, out[1], np.inf)


def limit(offer: Offer, tasks: tuple[Array, Array]) -> tuple[float, float]:
    """Return what is left after ever more measurements of all candidates, m and rad.

    Directions that no candidate sees keep what the tolerances leave them; the others go to 0.
    """
    triangle = np.linalg.qr(offer.jacobian.reshape(-1, offer.prior.size), mode="r")
    _, s, vt = np.linalg.svd(triangle)
    seen = np.zeros(len(vt), dtype=np.bool_)
    seen[:s.size] = s > UNSEEN * s[0]
    blind = vt[~seen].T
    if not blind.size:
        return 0.0, 0.0
    held = blind.T @ (offer.prior[:, None] ** 2 * blind)
    left = blind @ np.linalg.pinv(held) @ blind.T
    # what is left far below what the tolerances alone would give is round-off
    out = [float(np.sqrt(max(np.sum(g * left), 0.0))) for g in tasks]
    return out[0], out[1]


def still_pays(errors: Array) -> int:
    """Return the number of rows from which on one more improves by less than :data:`PAYS`.

    ``errors`` (n,) after 1 ... n rows, inf where too few; 0 where it pays to the end. Judged over
    a few rows, since single ones differ.
    """
    with np.errstate(invalid="ignore"):
        ahead = 1.0 - (errors[WINDOW:] / errors[:-WINDOW]) ** (1.0 / WINDOW)
    pays = np.flatnonzero(~(ahead < PAYS))
    last = int(pays[-1]) + 1 if pays.size else 0
    return last + 1 if last < len(ahead) else 0


def reaching(errors: Array, wanted: float) -> int | None:
    """Return after how many rows the error first falls to ``wanted``, None if it does not."""
    met = np.flatnonzero(errors <= wanted)
    return int(met[0]) + 1 if met.size else None


def extrapolated(offer: Offer, rows: Sequence[int], tasks: tuple[Array, Array], wanted: float
                 ) -> int | None:
    """Return about how many rows like these bring the position error to ``wanted``.

    None where a million would not do.
    """
    prior = np.diag(offer.prior**2)
    data = offer.information(np.asarray(rows, dtype=np.int64)) - prior
    times = np.geomspace(1.0, 1e6 / len(rows), 400)
    errors = spreads(prior + times[:, None, None] * data, tasks)[0]
    met = np.flatnonzero(errors <= wanted)
    return int(np.ceil(times[met[0]] * len(rows))) if met.size else None
