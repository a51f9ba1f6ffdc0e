"""How smooth a function is that nobody knows: its values are normal, near ones alike."""

from __future__ import annotations

import numpy as np

from ppmcal.linalg import Array

LENGTHS = (0.06, 0.12, 0.25, 0.5, 1.0)
"""Lengths of a kernel, in parts of the input's range."""
SECOND = 2.0
"""Of the second of two inputs."""


def matern(nodes: Array, length: float) -> Array:
    """Return the Matern kernel (5/2) between nodes (n, n); ``length`` in parts of their range."""
    far = np.abs(nodes[:, None] - nodes[None, :]) / (nodes[-1] - nodes[0])
    x = np.sqrt(5.0) * far / length
    return np.asarray((1.0 + x + x**2 / 3.0) * np.exp(-x))
