"""Array alias and the two layout helpers that every explicit formula uses."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array: TypeAlias = NDArray[np.float64]
"""Batched float64 data: any leading axes, components (blades) last."""

Scalars: TypeAlias = Any
"""One component of a batch: an array of the batch shape, or a NumPy scalar."""


def as_array(value: ArrayLike, size: int, name: str) -> Array:
    """Return `value` as float64 with `size` components on its last axis.

    Raises:
        ValueError: if the last axis has another length.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ValueError(
            f"{name} needs {size} components on its last axis, got an array of shape {array.shape}"
        )
    return array


def components(value: ArrayLike, size: int, name: str) -> Array:
    """Return a view of `(..., size)` with the components first, `(size, ...)`, to unpack.

    It shares the argument's memory, so it must not be written to.  A contiguous copy gains nothing:
    fresh pages cost more than the strided reads of a product.
    """
    array = as_array(value, size, name)
    last = array.ndim - 1
    return array.transpose(last, *range(last))


def pack(*parts: Scalars) -> Array:
    """Broadcast component arrays and stack them on a new last axis: the inverse of `components`."""
    out = np.empty((*np.broadcast(*parts).shape, len(parts)))
    for index, part in enumerate(parts):
        out[..., index] = part
    return out


def cross3(a: Scalars, b: Scalars) -> tuple[Scalars, Scalars, Scalars]:
    """Return a × b for component-first triples `(3, ...)` or tuples of three."""
    a1, a2, a3 = a
    b1, b2, b3 = b
    return a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1


def dot3(a: Scalars, b: Scalars) -> Scalars:
    """Return a · b for component-first triples."""
    a1, a2, a3 = a
    b1, b2, b3 = b
    return a1 * b1 + a2 * b2 + a3 * b3
