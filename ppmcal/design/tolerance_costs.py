"""From a demanded accuracy to tolerances: one for all, equal contributions, least cost.

Every allocation meets sum((a_i tau_i)^2) = 1, with a_i the size of what one unit of error i does
to the tool, over the accuracy that is demanded of it: errors are independent, squares add up
([LIN] section 3.1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppmcal.linalg import Array

NOTHING = 1e-9
"""An error does nothing where its sensitivity is below this part of the largest."""
ROUNDS = 200


def demand(by_position: Array, by_rotation: Array, position: float | None,
           rotation: float | None) -> Array:
    """Return a (S,): sensitivities over the accuracy demanded, position and rotation together.

    Args:
        by_position: tool displacement per unit of each error, rms over the poses (S,).
        by_rotation: tool rotation likewise (S,).
        position: accuracy demanded, m, or None.
        rotation: accuracy demanded, rad, or None.
    """
    square = np.zeros_like(by_position)
    for by, wanted in ((by_position, position), (by_rotation, rotation)):
        if wanted is not None:
            square += (by / wanted) ** 2
    return np.asarray(np.sqrt(square))


def is_sensitive(a: Array) -> NDArray[np.bool_]:
    """Return which errors do anything to the tool (S,)."""
    return np.asarray(a > NOTHING * a.max(initial=0.0), dtype=np.bool_)


def one_for_all(a: Array, unit: Array) -> Array:
    """Return tau (S,) of one and the same size in units ``unit`` (S,): [LIN]'s mean deviation.

    sigma = accuracy / amplification index; with ``unit`` 1 for lengths and 1/rho for angles.
    """
    return np.asarray(unit / np.sqrt(np.sum((a * unit) ** 2)))


def equal_parts(a: Array) -> Array:
    """Return tau (S,) with which all errors contribute alike; inf: the tool is not sensitive."""
    with np.errstate(divide="ignore"):
        return np.where(is_sensitive(a), 1.0 / (np.sqrt(is_sensitive(a).sum()) * a), np.inf)


def least_cost(a: Array, weight: Array, exponent: Array) -> Array:
    """Return tau (S,) of least cost sum(weight tau^-exponent); inf where the tool is not sensitive.

    Lagrange: tau = (weight exponent / (2 lambda a^2))^(1/(exponent + 2)); lambda by bisection
    of its logarithm, since the sum of squares falls with it.
    """
    use = is_sensitive(a)
    w, p, s = weight[use], exponent[use], a[use]
    # in logarithms: weights and sensitivities of files in micrometres span many decades
    top = np.log(w * p) - 2.0 * np.log(s)

    def logs(multiplier: float) -> Array:
        return np.asarray((top - np.log(2.0) - multiplier) / (p + 2.0))

    low, high = -700.0, 700.0
    for _ in range(ROUNDS):
        middle = 0.5 * (low + high)
        square = 2.0 * (np.log(s) + logs(middle))
        over = float(np.logaddexp.reduce(square)) > 0.0
        low, high = (middle, high) if over else (low, middle)
    out = np.full(len(a), np.inf)
    out[use] = np.exp(logs(0.5 * (low + high)))
    return out


def cost(tau: Array, weight: Array, exponent: Array) -> float:
    """Return the cost of tolerances (S,); those of 0 cost infinitely much, of inf nothing."""
    with np.errstate(divide="ignore"):
        return float(np.sum(weight * tau ** -exponent))
