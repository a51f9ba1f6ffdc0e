"""Numbers across the border without loss: the file number that reads back as an SI value."""

from __future__ import annotations

import math


def to_file(value: float, factor: float) -> float:
    """Return the double f with f * factor == value, or the nearest where none exists.

    Every value that was read from a file in the same units has one; so what is read, written
    and read again is equal to the last bit.
    """
    first = value / factor
    if factor == 1.0 or not math.isfinite(first) or first * factor == value:
        return first
    candidates = [first]
    low = high = first
    for _ in range(3):
        low, high = math.nextafter(low, -math.inf), math.nextafter(high, math.inf)
        candidates += [low, high]
    return min(candidates, key=lambda f: abs(f * factor - value))


def decimals(value: float) -> int:
    """Return how many decimals the shortest text of a number has (``-69.282``: 3)."""
    if not math.isfinite(value):
        return 0
    digits, _, exponent = repr(float(value)).partition("e")
    after = digits.partition(".")[2].rstrip("0")
    return max(0, len(after) - int(exponent or 0))
