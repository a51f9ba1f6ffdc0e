"""Functions of two recorded inputs beyond learned terms: of time, payload, place.

The error of a joint or an instrument under load, or far out, may change over time. The main effect
of each input is a separate cause (functional analysis of variance).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ppmcal.diagnosis.kernels import LENGTHS, bends, beyond_mean, matern, product_kernels
from ppmcal.diagnosis.term_candidates import PAIRED, Visible, nodes_over
from ppmcal.diagnosis.unknown_courses import COURSE, time_in
from ppmcal.diagnosis.unknown_functions import (
    LOADED,
    Acted,
    Made,
    by_part,
    carried,
    coordinates,
    joints,
    told,
    where_it_is,
)
from ppmcal.inference.priors import GOES_WITH
from ppmcal.linalg import Array
from ppmcal.model.effects.learned_curve import spline_basis


@dataclass(frozen=True, eq=False)
class PairInput:
    """A recorded input: its values (N,), or by joint (N, k), by part of the system.

    ``remedy``: what to measure if something depends on it.
    """

    name: str
    values: Sequence[Array]
    remedy: str = COURSE

    def basis(self, count: int, own: Array) -> tuple[Array, list[Array]] | None:
        """Return nodes over values (N,) and weights (..., K) by part; None: too few values."""
        nodes = nodes_over(own, own, count, fewest=2, margin=0.0)
        return None if nodes is None else (nodes, [spline_basis(nodes, x) for x in self.values])

    def of(self, on: Sequence[bool]) -> Array:
        """Return all values for the joints ``on``, (N,) or (N k,)."""
        return np.concatenate([x if x.ndim == 1 else x[:, np.array(on)].ravel()
                               for x in self.values])


def of_pairs(seen: Visible) -> Iterator[Made]:
    """Yield functions of two inputs acting on joints and coordinates, and of place by condition."""
    rows = [p.setting for p in seen.system.parts]
    when = time_in(seen.system)
    conditions = [c for c in (
        PairInput("time", [when[p.at] for p in seen.system.parts]),
        PairInput("temperature", [s.temperature for s in rows]),
        PairInput("payload", [carried(s) for s in rows], LOADED)) if _varies(c)]
    travel = PairInput("travel", [s.travel for s in rows])
    measured = [a for a in coordinates(seen) if a.words in told(seen)]
    for first, second in combinations(conditions, 2):
        yield from _of_two(seen, first, second, [*joints(seen), *measured])
    for second in conditions:
        if second.name != "temperature":        # which a learned term covers
            yield from _of_two(seen, travel, second, joints(seen))
        yield from _over_places(seen, second, measured)


def _varies(recorded: PairInput) -> bool:
    values = np.concatenate(recorded.values)
    return bool(np.isfinite(values).all() and np.ptp(values) > 0.0)


def _of_two(seen: Visible, first: PairInput, second: PairInput, acted: Sequence[Acted]
            ) -> Iterator[Made]:
    """Yield functions of two inputs, acting on each of ``acted``."""
    for where in acted:
        x, y = first.of(where.on), second.of(where.on)
        one, two = first.basis(PAIRED[0], x), second.basis(PAIRED[1], y)
        if one is None or two is None:
            continue
        yield where.made(seen, f"a function of {first.name} and {second.name}",
                         [_products(a, b) for a, b in zip(one[1], two[1], strict=True)],
                         product_kernels(one[0], two[0], x, y), remedy=second.remedy,
                         usual=float(GOES_WITH))


def _products(first: Array, second: Array) -> Array:
    """Return all products (..., A B) of weights (..., A) and (N, B)."""
    second = second if first.ndim == second.ndim else second[:, None]
    out = first[..., :, None] * second[..., None, :]
    return np.asarray(out.reshape(*out.shape[:-2], -1))


def _over_places(seen: Visible, condition: PairInput, acted: Sequence[Acted]) -> Iterator[Made]:
    """Yield errors of a coordinate that are linear in place, with condition-dependent slopes."""
    values = np.concatenate(condition.values)
    found, where = condition.basis(PAIRED[0], values), bends(where_it_is(seen), 1)
    if found is None or not where.size:
        return
    nodes, weights = found
    columns = [_products(x, w) for x, w in zip(by_part(seen, where), weights, strict=True)]
    kernels = [np.asarray(np.kron(np.eye(where.shape[1]), k)) for k in beyond_mean(
        [matern(nodes, length) for length in LENGTHS], nodes, values)]
    for one in acted:
        yield one.made(seen, f"a function of place and {condition.name}", columns, kernels,
                       remedy=condition.remedy, usual=float(GOES_WITH))
