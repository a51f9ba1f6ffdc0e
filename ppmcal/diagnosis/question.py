"""A linearised fit as a question: which blocks of columns are in its residuals beside geometry."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.least_squares import prior_weights, to_prior
from ppmcal.diagnosis.hypotheses import Hypothesis, Library
from ppmcal.diagnosis.library_columns import Products
from ppmcal.diagnosis.linear_system import System
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import JoinedColumns, UnitColumns
from ppmcal.inference.priors import ALL_ALIKE, FAMILY, GROSS_ROW, UNKNOWN, WIDE
from ppmcal.inference.sets import Question
from ppmcal.linalg import Array, Bools, reciprocals

UNKNOWN_FAMILY = "unknown"
"""The family of what no kind of the library does."""
Form = tuple[tuple[str, ...], bool]
"""Actuators on which a family acts, and whether with one value for all of them."""


@dataclass(frozen=True, eq=False)
class LibrarySource:
    """A library's columns (T) over flat values (N m,), zero where nothing was observed."""

    products: Products
    observed: Bools

    @property
    def count(self) -> int:
        """How many columns there are."""
        return self.products.shape[0]

    def along(self, values: Array) -> Array:
        """Return the inner products (T, b) of all columns with values (n, b)."""
        return self.products.along(values.reshape(*self.observed.shape, -1)
                                   * self.observed[..., None])

    def some(self, which: Sequence[int]) -> Array:
        """Return the columns (n, k) of these numbers."""
        values = self.products.some(which) * self.observed[..., None]
        return np.asarray(values.reshape(self.observed.size, -1))


def question(system: System, library: Library) -> Question:
    """Return what may be in the residuals of a fit beside its geometry.

    The residuals are taken back to the nominal machine, so that tolerances are the prior of
    geometry whatever the fit has made of it.
    """
    problem = system.problem
    scale = system.jacobian_scale
    away = -to_prior(problem, system.state) / scale
    weight = prior_weights(problem, "prior") * scale
    prior = reciprocals(weight, float(WIDE))
    observed = system.observed
    flat = system.jacobian.reshape(observed.size, -1) * observed.reshape(-1, 1)
    values = system.residual.reshape(-1) * observed.reshape(-1) + flat @ away
    columns = JoinedColumns((LibrarySource(library.products, observed),
                             UnitColumns(observed.size)))
    every = (*blocks(library, system), *rows(observed, library.count))
    return Question(columns, values, flat * prior, every, observed, system.apart)


ROW_FAMILY = "row"
"""The family of rows that do not belong, a wrong point, a typo, a broken beam."""


def rows(observed: Bools, first: int) -> Iterator[Block]:
    """Yield a block for each row that does not belong; ``first``: number of its first column."""
    width = observed.shape[1]
    for n, seen in enumerate(observed):
        own = np.flatnonzero(seen)
        if own.size:
            yield Block(f"row {n}", ROW_FAMILY,
                        tuple((first + n * width + own).tolist()), float(np.log(float(GROSS_ROW))))


def blocks(library: Library, system: System) -> Iterator[Block]:
    """Yield the library's hypotheses, each with its prior."""
    families: dict[str, dict[Form, list[Hypothesis]]] = defaultdict(lambda: defaultdict(list))
    for h in library.hypotheses:
        families[_family(h)][h.on, h.shared].append(h)
    for family, forms in families.items():
        top = float(np.log(float(UNKNOWN) / 2.0 if family == UNKNOWN_FAMILY else float(FAMILY)))
        share = _shares(list(forms))
        for form, own in forms.items():
            for h in own:
                event = h.effect is not None and h.effect.onset
                low, high = _range(h)
                yield Block(h.label, family, h.columns,
                            top + np.log(share[form]) - np.log(len(own)), low=low, high=high,
                            group=f"{family} on {' '.join(h.on)} {h.shared}" if event else "")
    longest: dict[str, Hypothesis] = {}
    for h in library.courses:
        if h.part not in longest or h.size > longest[h.part].size:
            longest[h.part] = h
    for part, h in longest.items():
        yield Block(f"a course of {part}", UNKNOWN_FAMILY, h.columns,
                    float(np.log(float(UNKNOWN) / 2.0 / len(longest))),
                    roots=tuple(_courses(system, library, h)))


def _family(h: Hypothesis) -> str:
    if h.anonymous:
        return UNKNOWN_FAMILY
    return h.family


def _shares(forms: Sequence[Form]) -> dict[Form, float]:
    """Return the prior of each set of actuators of a family that acts."""
    several = [f for f in forms if len(f[0]) > 1]
    single = [f for f in forms if len(f[0]) <= 1]
    every = float(ALL_ALIKE) if several and single else 1.0
    return {f: (every / len(several) if f in several else
                (1.0 - every if several else 1.0) / len(single)) for f in forms}


def _range(h: Hypothesis) -> tuple[float, float]:
    if h.size != 1:
        return -np.inf, np.inf
    usual = h.usual[0] if h.usual else (-np.inf, np.inf)
    return max(h.low[0], usual[0]), min(h.high[0], usual[1])


LENGTHS = (0.05, 0.1, 0.2, 0.4, 0.8)


def _courses(system: System, library: Library, h: Hypothesis) -> Iterator[Array]:
    """Yield roots (k, k) of Matern courses over time, of every length."""
    columns = library.some(h.columns) * system.observed[..., None]
    rms = np.sqrt(np.maximum(np.sum(columns**2, axis=(0, 1)) / system.count, 1e-300))
    wave = np.pi * np.arange(1, h.size + 1)
    for length in LENGTHS:
        density = (1.0 + (length * wave) ** 2 / 5.0) ** -3.0
        yield np.diag(np.sqrt(density / density.sum()) / rms)
