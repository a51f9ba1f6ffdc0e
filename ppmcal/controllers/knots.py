"""Few points whose straight lines carry a curve."""

from __future__ import annotations

import numpy as np

from ppmcal.linalg import Array, Ints

HALVINGS = 12


def knots(x: Array, y: Array, target: float, most: int) -> Ints:
    """Return which of the points carry the others by straight lines, ends included (P,).

    As few as keep all of ``y`` (n, c) over increasing ``x`` (n,) within ``target`` of the lines;
    if those are more than ``most``, about the smallest error that ``most`` of them allow.
    """
    found = _spanned(x, y, target, most)
    if found is not None:
        return found
    low, high = np.log(target), np.log(2.0 * float(np.max(np.ptp(y, axis=0))) + target)
    best = np.array([0, len(x) - 1])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        found = _spanned(x, y, float(np.exp(middle)), most)
        if found is None:
            low = middle
        else:
            best, high = found, middle
    return best


def _spanned(x: Array, y: Array, tolerance: float, most: int) -> Ints | None:
    """Return knots of lines as long as the tolerance allows, None if that takes too many."""
    def fits(i: int, j: int) -> bool:
        part = ((x[i:j + 1] - x[i]) / (x[j] - x[i]))[:, None]
        line = y[i] + part * (y[j] - y[i])
        return bool(np.max(np.abs(y[i:j + 1] - line)) <= tolerance)

    last, out = len(x) - 1, [0]
    while out[-1] < last:
        if len(out) >= most:
            return None
        i, good, step = out[-1], out[-1] + 1, 2
        while i + step <= last and fits(i, i + step):
            good, step = i + step, 2 * step
        bad = min(i + step, last + 1)
        while bad - good > 1:
            middle = (good + bad) // 2
            good, bad = (middle, bad) if fits(i, middle) else (good, middle)
        out.append(good)
    return np.array(out)
