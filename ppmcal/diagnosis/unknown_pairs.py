"""Functions of two things that are recorded, which no learned term has: of time, payload, places.

A joint or an instrument may do under load, or far out, another thing late than early. What each
input does by itself is a cause of its own (functional analysis of variance).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, compress

import numpy as np

from ppmcal.diagnosis.kernels import LENGTHS, beyond_mean, matern, product_kernels
from ppmcal.diagnosis.term_candidates import (
    PAIRED,
    Visible,
    columns_from,
    joint_groups,
    nodes_over,
)
from ppmcal.diagnosis.unknown_courses import COURSE, places_in
from ppmcal.diagnosis.unknown_functions import LOADED, Made, carried
from ppmcal.inference.priors import GOES_WITH
from ppmcal.linalg import Array
from ppmcal.model.effects.learned import INPUTS, JOINT
from ppmcal.model.effects.learned_curve import spline_basis


@dataclass(frozen=True, eq=False)
class PairInput:
    """Something recorded: its values (N,), or by joint (N, k), by part of the system.

    ``remedy``: what to measure where something goes with it.
    """

    name: str
    values: Sequence[Array]
    remedy: str = COURSE

    def basis(self, count: int, own: Array) -> tuple[Array, list[Array]] | None:
        """Return nodes over values (N,) and weights (..., K) by part; None: too few values."""
        nodes = nodes_over(own, own, count, fewest=2, margin=0.0)
        return None if nodes is None else (nodes, [spline_basis(nodes, x) for x in self.values])

    def of(self, on: Sequence[bool]) -> Array:
        """Return all values of the joints that act, (N,) or (N k,)."""
        return np.concatenate([x if x.ndim == 1 else x[:, np.array(on)].ravel()
                               for x in self.values])


def of_pairs(seen: Visible) -> Iterator[Made]:
    """Yield functions of two inputs acting on joints and coordinates, and places' by conditions."""
    mechanism = seen.system.problem.mechanism
    rows = [p.setting for p in seen.system.parts]
    when = list(places_in(seen.system).values())[-1]
    conditions = [c for c in (
        PairInput("time", [when[p.at] for p in seen.system.parts]),
        PairInput("temperature", [s.temperature for s in rows]),
        PairInput("payload", [carried(s) for s in rows], LOADED)) if _varies(c)]
    travel = PairInput("travel", [s.travel for s in rows])
    groups = {" ".join(compress(mechanism.actuators, on)): (JOINT, on)
              for on in joint_groups(mechanism)}
    coordinates = {c: (c, (True,) * len(mechanism.actuators)) for c in mechanism.coordinates
                   if c not in seen.residual_coordinates}
    for first, second in combinations(conditions, 2):
        yield from _of_two(seen, first, second, groups | coordinates)
    for second in conditions:
        if second.name != "temperature":        # which a learned term has
            yield from _of_two(seen, travel, second, groups)
        if coordinates:
            yield from _over_places(seen, second, list(coordinates))


def _varies(recorded: PairInput) -> bool:
    values = np.concatenate(recorded.values)
    return bool(np.isfinite(values).all() and np.ptp(values) > 0.0)


def _of_two(seen: Visible, first: PairInput, second: PairInput,
            acted: Mapping[str, tuple[str, tuple[bool, ...]]]) -> Iterator[Made]:
    """Yield functions of two inputs; ``acted``: as of :func:`unknown_functions.functions_of`."""
    for where, (acts, on) in acted.items():
        x, y = first.of(on), second.of(on)
        one, two = first.basis(PAIRED[0], x), second.basis(PAIRED[1], y)
        if one is None or two is None:
            continue
        weights = [_products(a, b) for a, b in zip(one[1], two[1], strict=True)]
        yield Made(f"a function of {first.name} and {second.name} acting on {where}",
                   columns_from(seen, acts, on, weights),
                   product_kernels(one[0], two[0], x, y), acts == JOINT and sum(on) > 1,
                   subject=where, remedy=second.remedy, usual=float(GOES_WITH))


def _products(first: Array, second: Array) -> Array:
    """Return all products (..., A B) of weights (..., A) and (N, B)."""
    second = second if first.ndim == second.ndim else second[:, None]
    out = first[..., :, None] * second[..., None, :]
    return np.asarray(out.reshape(*out.shape[:-2], -1))


def _over_places(seen: Visible, condition: PairInput, coordinates: Sequence[str]
                 ) -> Iterator[Made]:
    """Yield errors of a coordinate that are linear in places, by another amount as it was.

    ``condition``: how it was.
    """
    values = np.concatenate(condition.values)
    found = condition.basis(PAIRED[0], values)
    where = [np.stack([INPUTS[c].value(p.setting) for c in coordinates], axis=1)
             for p in seen.system.parts]
    every = np.concatenate(where)
    if found is None:
        return
    nodes, weights = found
    middle, spread = every.mean(axis=0), np.maximum(every.std(axis=0), np.finfo(float).tiny)
    columns = [_products((x - middle) / spread, w) for x, w in zip(where, weights, strict=True)]
    kernels = [np.asarray(np.kron(np.eye(len(coordinates)), k)) for k in beyond_mean(
        [matern(nodes, length) for length in LENGTHS], nodes, values)]
    for c in coordinates:
        yield Made(f"a function of place and {condition.name} acting on {c}",
                   columns_from(seen, c, (), columns), kernels, subject=c,
                   remedy=condition.remedy, usual=float(GOES_WITH))
