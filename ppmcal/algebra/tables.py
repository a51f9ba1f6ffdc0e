"""The general path: products of any blades, from tables derived from the signature alone.

e+² = +1, e−² = −1, e∞ = e− + e+, e0 = ½(e− − e+) ([IK] eq. 1, 2).  In the orthonormal basis a
product of blades is one blade with a sign; expanding the null blades there and back gives the
32×32×32 table of the null basis, and grades select the outer product and the contraction.
All entries are halves and integers, so the tables are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ppmcal import linalg
from ppmcal.algebra._types import Array, as_array, components
from ppmcal.algebra.blades import FULL, SCALAR, Blades
from ppmcal.errors import unknown

Kind = Literal["geometric", "outer", "inner"]
KINDS: tuple[Kind, ...] = ("geometric", "outer", "inner")

_SIGNATURE = (1.0, 1.0, 1.0, 1.0, -1.0)
"""Squares of e1, e2, e3, e+, e−."""

_NULL_VECTORS = np.array(
    [
        [1, 0, 0, 0, 0],
        [0, 1, 0, 0, 0],
        [0, 0, 1, 0, 0],
        [0, 0, 0, 1, 1],
        [0, 0, 0, -0.5, 0.5],
    ]
)
"""Rows: e1, e2, e3, e∞, e0 in terms of e1, e2, e3, e+, e−."""

_SIZE = 32


def _orthonormal_product(a: int, b: int) -> float:
    """Return the sign of the product of two orthonormal blades (the product is a XOR b)."""
    swaps = sum((a >> shift).bit_count() for shift in range(1, 6) if b >> (shift - 1) & 1)
    sign = -1.0 if swaps % 2 else 1.0
    for index, square in enumerate(_SIGNATURE):
        if a & b & 1 << index:
            sign *= square
    return sign


def _expansions(vectors: Array) -> Array:
    """Return the outer products of all subsets of five vectors, `(subset, orthonormal blade)`."""
    out = np.zeros((_SIZE, _SIZE))
    out[0, 0] = 1.0
    for mask in range(1, _SIZE):
        last = mask.bit_length() - 1
        for blade in np.flatnonzero(out[mask ^ 1 << last]):
            for axis in range(5):
                if not blade & 1 << axis:
                    value = out[mask ^ 1 << last, blade] * vectors[last, axis]
                    sign = -1.0 if (int(blade) >> axis + 1).bit_count() % 2 else 1.0
                    out[mask, blade | 1 << axis] += sign * value
    return out


@cache
def _geometric_table() -> Array:
    """Return the structure constants `(left, right, out)` over bit masks of the null basis."""
    orthonormal = np.zeros((_SIZE, _SIZE, _SIZE))
    for a in range(_SIZE):
        for b in range(_SIZE):
            orthonormal[a, b, a ^ b] = _orthonormal_product(a, b)
    there = _expansions(_NULL_VECTORS)
    back = _expansions(linalg.inv(_NULL_VECTORS))
    halfway = np.tensordot(there, np.tensordot(there, orthonormal, (1, 1)), (1, 1))
    return halfway @ back


@dataclass(frozen=True, eq=False)
class Product:
    """A bilinear product of two sets of blades, as a sparse table.

    Attributes:
        kind: geometric, outer or inner (left contraction).
        left: blades of the first factor.
        right: blades of the second factor.
        out: blades of the result.
        terms: for every non-zero entry (out index, left index, right index, coefficient).
    """

    kind: Kind
    left: Blades
    right: Blades
    out: Blades
    terms: tuple[tuple[int, int, int, float], ...]

    def __call__(self, a: ArrayLike, b: ArrayLike) -> Array:
        """Return the product of `a (..., len(left))` and `b (..., len(right))`, batched.

        Returns:
            `(..., len(out))`, the leading axes broadcast.
        """
        left = components(a, len(self.left), f"left factor of the {self.kind} product")
        right = components(b, len(self.right), f"right factor of the {self.kind} product")
        shape = np.broadcast_shapes(left.shape[1:], right.shape[1:])
        # every component is read several times: contiguous copies, one by one
        x, y = [part.copy() for part in left], [part.copy() for part in right]
        rows: list[Array | None] = [None] * len(self.out)
        for k, i, j, coefficient in self.terms:
            term = x[i] * y[j]
            if coefficient != 1.0:
                term = term * coefficient
            row = rows[k]
            rows[k] = term if row is None else row + term
        out = np.zeros((*shape, len(self.out)))
        for k, row in enumerate(rows):
            if row is not None:
                out[..., k] = row
        return out


def _kept(kind: Kind, a: int, b: int, k: int) -> bool:
    """Return whether the grade of `k` belongs to this kind of product of blades `a` and `b`."""
    left, right, out = a.bit_count(), b.bit_count(), k.bit_count()
    if kind == "outer":
        return out == left + right
    return kind == "geometric" or out == right - left


@cache
def product(
    kind: Kind, a_blades: Blades, b_blades: Blades, out_blades: Blades | None = None
) -> Product:
    """Return the cached table of a product.

    Args:
        kind: "geometric", "outer", or "inner": the left contraction a⌋b.
        a_blades: blades of the first factor.
        b_blades: blades of the second factor.
        out_blades: blades to keep, in this order; by default those that can be non-zero, in
            canonical order.

    Raises:
        BadInput: unknown kind.
    """
    if kind not in KINDS:
        raise unknown("kind of product", kind, KINDS)
    table = _geometric_table()
    entries = [
        (int(k), i, j, float(table[a, b, k] * a_blades.signs[i] * b_blades.signs[j]))
        for i, a in enumerate(a_blades.masks)
        for j, b in enumerate(b_blades.masks)
        for k in np.flatnonzero(table[a, b])
        if _kept(kind, a, b, int(k))
    ]
    out = Blades.of_masks({entry[0] for entry in entries}) if out_blades is None else out_blades
    place = {mask: (index, out.signs[index]) for index, mask in enumerate(out.masks)}
    terms = tuple(
        (place[k][0], i, j, place[k][1] * value) for k, i, j, value in entries if k in place
    )
    return Product(kind, a_blades, b_blades, out, terms)


@dataclass(frozen=True, eq=False)
class Linear:
    """A linear map between two sets of blades.

    Attributes:
        blades: blades of the argument.
        out: blades of the result.
        matrix: `(len(out), len(blades))`, read-only.
    """

    blades: Blades
    out: Blades
    matrix: Array

    def __call__(self, a: ArrayLike) -> Array:
        """Return the image `(..., len(out))` of `a (..., len(blades))`."""
        return as_array(a, len(self.blades), "multivector") @ self.matrix.T


def _linear(blades: Blades, out: Blades, matrix: Array) -> Linear:
    matrix.flags.writeable = False
    return Linear(blades, out, matrix)


@cache
def dual(blades: Blades) -> Linear:
    """Return the map X ↦ X I⁻¹ with I = e1∧e2∧e3∧e∞∧e0 = e1 e2 e3 e+ e− ([PPM] 2.2)."""
    pseudoscalar = Blades((FULL.names[-1],))
    square = product("geometric", pseudoscalar, pseudoscalar, SCALAR)([1.0], [1.0])[0]
    table = product("geometric", blades, pseudoscalar)
    return _linear(blades, table.out, table(np.eye(len(blades)), [1 / square]).T.copy())


@cache
def reverse_blades(blades: Blades) -> Linear:
    """Return the map X ↦ X~, which reverses the order of the factors of every blade."""
    grades = np.array([mask.bit_count() for mask in blades.masks])
    signs = np.where(grades * (grades - 1) // 2 % 2, -1.0, 1.0)
    return _linear(blades, blades, np.diag(signs))


@dataclass(frozen=True, eq=False)
class Sandwich:
    """The map (V, X) ↦ V X V~ of a versor V, from two tables.

    Attributes:
        versor: blades of V.
        blades: blades of X.
        out: blades of the result: the grades of X.
    """

    versor: Blades
    blades: Blades
    out: Blades
    _first: Product
    _second: Product

    def __call__(self, v: ArrayLike, x: ArrayLike) -> Array:
        """Return V X V~ `(..., len(out))` of `v (..., len(versor))`, `x (..., len(blades))`."""
        return self._second(self._first(v, x), reverse_blades(self.versor)(v))


@cache
def sandwich(versor: Blades, x: Blades) -> Sandwich:
    """Return the cached sandwich V X V~ ([IK] eq. 10).

    V has to be a versor (a product of vectors): only then are the grades of X kept, and only these
    are computed.  There is no division by V V~, so V also has to be of unit length for a rigid
    motion.

    Args:
        versor: blades of V.
        x: blades of X; if they include all blades that the result can have, their order is kept.
    """
    first = product("geometric", versor, x)
    grades = {mask.bit_count() for mask in x.masks}
    reachable = product("geometric", first.out, versor).out
    masks = {mask for mask in reachable.masks if mask.bit_count() in grades}
    out = x if masks <= set(x.masks) else Blades.of_masks(masks)
    return Sandwich(versor, x, out, first, product("geometric", first.out, versor, out))
