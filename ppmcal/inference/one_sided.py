"""Readings that can only be too long: in which rows, beyond the errors that parameters explain.

Whitened rows y (N, m) with prior-scaled columns J are off by a reading of one of K kinds, x_k e
with e >= 0, or by noise alone. Rows that are off carry no information along their x_k, where e is
uniform up to the longest; for the others

    log Z = -1/2 log|I + J'J| - (nu0 + n)/2 log(nu0 + y'My)

as everywhere here. These rows are found from a convex problem that uses the sign: quadratic loss on
one side, linear beyond HUBER deviations on the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from ppmcal import linalg
from ppmcal.inference.priors import FAMILY
from ppmcal.inference.ranges import SIZES
from ppmcal.linalg import Array, Ints

HUBER = 0.5
"""In the convex problem, readings that are too long count with at most this many deviations."""
SWEEPS, ROUNDS = 300, 40
"""Maximum steps of the convex problem, and of the selection of rows."""
STILL = 1e-3
"""Iteration ends when a step moves parameters by less than this, in standard deviations."""


@dataclass(frozen=True, eq=False)
class LongReadings:
    """Rows whose readings are too long.

    Attributes:
        kind: which of the K readings (N,), -1 for none.
        length: by how much (N,), in units of x; 0 for none.
        parameters: in units of their priors (C,).
        noise: of the other rows, over the stated noise.
        log_odds: relative to noise of any size.
        beyond: log odds relative to errors of both signs, or of one constant per reading.
    """

    kind: Ints
    length: Array
    parameters: Array
    noise: float
    log_odds: float
    beyond: float


@dataclass(frozen=True, eq=False)
class _WhiteRows:
    """Whitened rows ``y`` (N, m), ``jacobian`` (N, m, C), and ``along`` (N, m, K) unit readings.

    ``norm`` (N, K): one unit of a reading in deviations; ``known``: degrees of freedom of the noise
    scale.
    """

    y: Array
    jacobian: Array
    along: Array
    norm: Array
    known: float

    def left(self, parameters: Array) -> Array:
        """Return the residuals (N, m)."""
        return np.asarray(self.y - self.jacobian @ parameters)

    def long(self, left: Array, signs: bool) -> tuple[Ints, Array]:
        """Return for each row the reading that explains most (N,), and its size in deviations."""
        size = -np.einsum("nmk,nm->nk", self.along, left)
        best = np.argmax(size if signs else np.abs(size), axis=1)
        return best, size[np.arange(len(best)), best]

    def without(self, kind: Ints) -> tuple[Array, Array]:
        """Return J (N, m, C) and y (N, m) without each row's reading direction."""
        x = np.where((kind >= 0)[:, None], self.along[np.arange(len(kind)), :, kind], 0.0)
        return (self.jacobian - x[..., None] * (x[:, None] @ self.jacobian),
                self.y - x * np.sum(x * self.y, axis=1, keepdims=True))

    def minimum(self, jacobian: Array, y: Array) -> tuple[Array, float, float]:
        """Return the parameters (C,), their sum of squares and log|I + J'J|."""
        flat = jacobian.reshape(-1, jacobian.shape[-1])
        square = np.eye(flat.shape[1]) + flat.T @ flat
        found = linalg.solve(square, flat.T @ y.ravel())
        rest = y.ravel() - flat @ found
        return found, float(rest @ rest + found @ found), float(np.linalg.slogdet(square)[1])

    def count(self, kind: Ints) -> int:
        """Return the number of values minus one for each reading that is too long."""
        return int(np.count_nonzero(np.any(self.jacobian != 0.0, axis=2))) - int(
            np.count_nonzero(kind >= 0))

    def noise(self, square: float, count: int) -> float:
        """Return the noise over the stated noise."""
        return float(np.sqrt((self.known + square) / (self.known + max(count, 0))))

    def evidence(self, kind: Ints, longest: float, sides: int) -> float:
        """Return log Z: readings ``kind`` (N,) too long by up to ``longest``, of 1 or 2 signs."""
        out = self._log_z(*self.without(kind), self.count(kind))
        off = np.flatnonzero(kind >= 0)
        if not off.size:
            return out
        spread = np.log(sides * longest * self.norm[off, kind[off]] * self.norm.shape[1])
        return out - float(spread.sum()) + self._prior(kind)

    def evidence_of_step(self, kind: Ints, length: Array) -> float:
        """Return log Z for one constant per reading in all rows that are off (N,)."""
        own = np.unique(kind[kind >= 0])
        size = np.array([np.median(length[kind == k]) for k in own])
        at = (kind[:, None] == own) & (length[:, None] > 0.5 * size)
        columns = self.along[..., own] * (self.norm[:, own] * at * size)[:, None]
        return self._log_z(np.concatenate([self.jacobian, columns], axis=-1), self.y, self.count(
            np.full(len(kind), -1))) + self._prior(np.where(at.any(axis=1), 0, -1))

    def _log_z(self, jacobian: Array, y: Array, count: int) -> float:
        _, square, log_det = self.minimum(jacobian, y)
        whole = 0.5 * (self.known + count)
        return float(-0.5 * count * np.log(2.0 * np.pi) + gammaln(whole)
                     - gammaln(0.5 * self.known) + 0.5 * self.known * np.log(0.5 * self.known)
                     - whole * np.log(0.5 * (self.known + square)) - 0.5 * log_det)

    def _prior(self, kind: Ints) -> float:
        """Return the log prior of a choice of rows that are off, uniform over their number."""
        rows, off = len(kind), int(np.count_nonzero(kind >= 0))
        which = gammaln(rows + 1) - gammaln(off + 1) - gammaln(rows - off + 1)
        return float(np.log(float(FAMILY)) - which - np.log(rows + 1.0) - np.log(SIZES.size))


def long_readings(y: Array, jacobian: Array, readings: Array, known: float
                  ) -> LongReadings | None:
    """Return the rows in which one of K readings is too long, None if that explains nothing.

    Args:
        y: whitened rows (N, m), 0 where not measured, linearised back to the prior means.
        jacobian: of parameters in units of their priors (N, m, C).
        readings: derivative of whitened predictions by each reading (N, m, K).
        known: degrees of freedom of the noise scale.
    """
    norm = np.linalg.norm(readings, axis=1)
    rows = _WhiteRows(y, jacobian, readings * linalg.reciprocals(norm)[:, None], norm, known)
    nothing = rows.evidence(np.full(len(y), -1), 1.0, 1)
    found, log_z = _chosen(rows, True)
    if found is None:
        return None
    _, either = _chosen(rows, False)
    return LongReadings(found.kind, found.length, found.parameters, found.noise, log_z - nothing,
                        log_z - max(either, rows.evidence_of_step(found.kind, found.length)))


def _chosen(rows: _WhiteRows, signs: bool) -> tuple[LongReadings | None, float]:
    """Return the rows that are off, in one direction or in both, with their evidence."""
    parameters = _convex(rows, signs)
    kind = np.full(len(rows.y), -1)
    noise, longest = 1.0, np.inf
    for _ in range(ROUNDS):
        best, size = rows.long(rows.left(parameters), signs)
        norm = rows.norm[np.arange(len(best)), best]
        size = size if signs else np.abs(size)
        length = np.where(norm > 0.0, size * linalg.reciprocals(norm), 0.0)
        longest = float(length.max(initial=0.0))
        with np.errstate(divide="ignore"):
            dear = np.log(np.maximum(longest * norm / (noise * np.sqrt(2.0 * np.pi)), 1.0))
        off = (norm > 0.0) & (size > 0.0) & (0.5 * (size / noise)**2 > dear)
        now = np.where(off, best, -1)
        parameters, square, _ = rows.minimum(*rows.without(now))
        noise = max(1.0, rows.noise(square, rows.count(now)))
        if np.array_equal(now, kind):
            break
        kind = now
    if not np.any(kind >= 0):
        return None, -np.inf
    return (LongReadings(kind, np.where(kind >= 0, length, 0.0), parameters, noise, 0.0, 0.0),
            rows.evidence(kind, longest, 1 if signs else 2))


def _convex(rows: _WhiteRows, signs: bool) -> Array:
    """Return the parameters (C,) of the convex problem: squares, linear for long readings."""
    flat = rows.jacobian.reshape(-1, rows.jacobian.shape[-1])
    solver = linalg.inv(np.eye(flat.shape[1]) + flat.T @ flat) @ flat.T
    parameters = solver @ rows.y.ravel()
    for _ in range(SWEEPS):
        left = rows.left(parameters)
        best, size = rows.long(left, signs)
        beyond = np.sign(size) * np.maximum(np.abs(size) - HUBER, 0.0)
        beyond = np.maximum(beyond, 0.0) if signs else beyond
        x = rows.along[np.arange(len(best)), :, best]
        step = solver @ (rows.y + beyond[:, None] * x).ravel() - parameters
        parameters = parameters + step
        if np.abs(step).max(initial=0.0) < STILL:
            break
    return np.asarray(parameters)
