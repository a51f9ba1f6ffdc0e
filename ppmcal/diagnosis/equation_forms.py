"""Short equations in recorded inputs: their terms, and their values.

A term is a size times one form of an input, or times a product of forms of two. The sizes are
linear. The previous row is an input too: ``last move`` is the joint's distance from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.linalg import Array
from ppmcal.model.effects.learned import INPUTS, LearnedCurve

POWERS = 4
"""Highest power of one input, and highest total power of a product."""
KNOTS = np.linspace(0.15, 0.85, 8)
"""Possible places of a kink, as fractions of the input's range."""
INNER = 0.1
"""Zero splits the range of an input if at least this fraction is on each side."""
FORMS: dict[str, Callable[[Array, int], Array]] = {
    "power": lambda x, degree: x**degree,
    "above": lambda x, degree: np.maximum(x, 0.0),
    "below": lambda x, degree: np.maximum(-x, 0.0),
    "abs": lambda x, degree: np.abs(x),
    "sign": lambda x, degree: np.sign(x)}
"""Functions of an input minus its origin."""
KINKED = ("above", "below")
"""Forms whose origin is chosen from the data."""


@dataclass(frozen=True)
class InputForm:
    """A form of one input minus ``origin``, SI; ``degree``: of a power, and in the total power."""

    input: str
    form: str = "power"
    degree: int = 1
    origin: float = 0.0

    def value(self, x: Array) -> Array:
        """Return the factor (...) at inputs (...)."""
        return FORMS[self.form](x - self.origin, self.degree)


Product = tuple[InputForm, ...]


def same_form(a: Product, b: Product) -> bool:
    """Return whether two products differ only in the places of their kinks."""
    def form(product: Product) -> list[tuple[str, str, int, float]]:
        return [(f.input, f.form, f.degree, 0.0 if f.form in KINKED else f.origin)
                for f in product]

    return form(a) == form(b)


def kinked(product: Product) -> bool:
    """Return whether a product has a kink placed by the data."""
    return any(f.form in KINKED for f in product)


def values_of(products: Sequence[Product], inputs: dict[str, Array]) -> Array:
    """Return products (..., F) at inputs (...), by their names."""
    out = []
    for product in products:
        value = np.ones(())
        for f in product:
            value = value * f.value(inputs[f.input])
        out.append(value)
    return np.stack(np.broadcast_arrays(*out), axis=-1)


@dataclass(frozen=True, eq=False)
class Equation(LearnedCurve):
    """A learned function as an equation: ``values`` (F,) are the sizes of its ``products``.

    Attributes:
        probability: of these forms, among all sets of products tried.
        after: rms over the noise in held-out poses, with it in place of the term; nan until known.
    """

    products: tuple[Product, ...] = ()
    probability: float = np.nan
    after: float = np.nan

    def basis(self, x: Array, by: Array | None = None) -> Array:
        """Return the products (..., F) at inputs (...); nan outside of the nodes."""
        inputs, known = {self.input: x}, (x >= self.nodes[0]) & (x <= self.nodes[-1])
        if self.by:
            assert by is not None
            inputs[self.by] = by
            known = known & (by >= self.by_nodes[0]) & (by <= self.by_nodes[-1])
        found = values_of(self.products, inputs)
        return np.asarray(np.where(known[..., None], found, np.nan))


def products_of(curve: LearnedCurve) -> tuple[Product, ...]:
    """Return the products that an equation of a curve's inputs may contain, simpler ones first."""
    first = list(_forms(curve.input, curve.nodes))
    if not curve.by:
        return tuple((f,) for f in first)
    second = list(_forms(curve.by, curve.by_nodes))
    both = [(a, b) for a in first for b in second if a.degree + b.degree <= POWERS
            and b.form not in KINKED]
    return (*((f,) for f in [*first, *second]), *both)


def _forms(name: str, nodes: Array) -> Iterator[InputForm]:
    low, high = float(nodes[0]), float(nodes[-1])
    width, middle = high - low, 0.5 * (low + high)
    parted = low + INNER * width < 0.0 < high - INNER * width
    for degree in range(1, POWERS + 1):
        yield InputForm(name, degree=degree)
    if parted:
        yield InputForm(name, "abs")
        yield InputForm(name, "sign")
    elif not INPUTS[name].zero:
        # for a stroke that does not reach zero, the middle is an equally natural origin
        for degree in range(2, POWERS + 1):
            yield InputForm(name, degree=degree, origin=middle)
    for knot in (low + width * KNOTS).tolist():
        yield InputForm(name, "above", origin=knot)
        yield InputForm(name, "below", origin=knot)
