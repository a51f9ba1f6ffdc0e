"""Functions of recorded inputs beyond learned terms: of place, payload, wrench, other joints.

As blocks of columns with the covariance of their coefficients, for :mod:`unknown_causes`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from itertools import compress
from typing import Any

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.kernels import FINER, LENGTHS, bends, matern, roots
from ppmcal.diagnosis.term_candidates import (
    COARSE,
    FINE,
    Visible,
    columns_from,
    joint_groups,
    nodes_over,
)
from ppmcal.linalg import Array
from ppmcal.model.dataset import WRENCH
from ppmcal.model.effects import Setting
from ppmcal.model.effects.learned import INPUTS, JOINT, LearnedCurve
from ppmcal.model.effects.learned_curve import spline_basis
from ppmcal.model.effects.setting import PLACE

GAUGE = ("measure a gauge of known length at several places in the workspace: it separates errors "
         "of the instrument from those of the machine")
EACH = "each joint"
"""Subject of causes that act on all joints, with a separate amount or function for each."""
FINEST = 128
"""Nodes over a joint's travel for a function finer than a learned one."""
LOADED = "at one pose, measure it with an indicator while the load is applied and removed"
ALONE = "move {} alone in fine steps, and measure {} with an indicator"


@dataclass(frozen=True, eq=False)
class CauseLook:
    """The description of an unknown cause.

    ``curve``, ``on``: the corresponding learned term, None if it is not a function of an input.
    ``subject``: what it acts on; a further form of one cause there has a higher prior.
    ``remedy``: what to measure to distinguish it from others. ``low``, ``high``: bounds of its
    coefficients.
    """

    label: str
    curve: LearnedCurve | None = field(default=None, kw_only=True)
    on: tuple[bool, ...] = field(default=(), kw_only=True)
    subject: str = field(default="", kw_only=True)
    remedy: str = field(default="", kw_only=True)
    low: float = field(default=-np.inf, kw_only=True)
    high: float = field(default=np.inf, kw_only=True)


@dataclass(frozen=True, eq=False)
class Made(CauseLook):
    """Columns (n, K) of a possible cause.

    ``kernels`` (K, K): prior covariances of its coefficients, by length; none: independent, of one
    size. ``together``: whether it acts on several joints at once. ``usual``: its prior relative to
    that of a cause without a direction or a second input.
    """

    columns: Array
    kernels: Sequence[Array] = ()
    together: bool = False
    usual: float = field(default=1.0, kw_only=True)

    @property
    def look(self) -> dict[str, Any]:
        """Its description, without the columns."""
        return {f.name: getattr(self, f.name) for f in fields(CauseLook)}

    def roots(self, gram: Array, count: int) -> tuple[Array, ...]:
        """Return the roots of its kernels: see :func:`ppmcal.diagnosis.kernels.roots`."""
        return roots(self.kernels or [np.eye(self.columns.shape[1])], gram, count)


@dataclass(frozen=True)
class Acted:
    """What an unknown cause acts on: joints ``on``, or a coordinate of the pose.

    ``words``: its name; ``acts``: a coordinate or :data:`JOINT`, as for a curve.
    """

    words: str
    acts: str
    on: tuple[bool, ...] = ()

    @property
    def together(self) -> bool:
        """Whether it is several joints at once."""
        return sum(self.on) > 1

    def made(self, seen: Visible, what: str, weights: Sequence[Array], kernels: Sequence[Array],
             **look: Any) -> Made:
        """Return the cause ``what`` acting on it, with functions' ``weights`` by system part."""
        return Made(f"{what} acting on {self.words}",
                    columns_from(seen, self.acts, self.on, weights), kernels, self.together,
                    subject=self.words, **look)


def joints(seen: Visible) -> list[Acted]:
    """Return each joint, and all of them if of one quantity."""
    mechanism = seen.system.problem.mechanism
    return [Acted(" ".join(compress(mechanism.actuators, on)), JOINT, on)
            for on in joint_groups(mechanism)]


def coordinates(seen: Visible) -> list[Acted]:
    """Return the coordinates of the pose that rows observe directly."""
    return [Acted(c, c) for c in seen.coordinates]


def told(seen: Visible) -> list[str]:
    """Return the coordinates that vary by more than residuals, so that they can be inputs."""
    return [c for c in seen.system.problem.mechanism.coordinates
            if c not in seen.residual_coordinates]


def fine_functions(seen: Visible) -> Iterator[Made]:
    """Yield functions of a joint's travel that are finer than learned ones.

    Such as a wave whose pitch changes along the stroke. A learned term with so many nodes would be
    undetermined in most places.
    """
    travel = [p.setting.travel for p in seen.system.parts]
    for acted in joints(seen):
        own = np.concatenate(travel)[:, np.array(acted.on)]
        count = min(FINEST, len(own))
        if not np.ptp(own) > 0.0 or count <= FINE:
            continue
        nodes = np.linspace(own.min(), own.max(), count)
        weights = [spline_basis(nodes, x) for x in travel]
        kernels = [matern(nodes, length) for length in FINER]
        yield acted.made(seen, "a fine function of travel", weights, kernels,
                         remedy="" if acted.together else ALONE.format(acted.words, "it"))


def functions_of_each(seen: Visible) -> Iterator[Made]:
    """Yield functions of recorded inputs for all joints, with a separate function for each.

    The counterpart of effects with a separate size for each joint: in half of the machines all
    joints have what one joint has.
    """
    rows = [p.setting for p in seen.system.parts]
    yield from _of_each(seen, "its own travel", [s.travel for s in rows], FINE)
    for name, x in (("temperature", [s.temperature for s in rows]),
                    ("the payload", [carried(s) for s in rows])):
        yield from _of_each(seen, name, [np.repeat(own[:, None], s.travel.shape[1], axis=1)
                                         for own, s in zip(x, rows, strict=True)], COARSE)


def _of_each(seen: Visible, name: str, x: Sequence[Array], most: int) -> Iterator[Made]:
    """Yield the functions of an input given by row and joint (N, k), by part."""
    mechanism = seen.system.problem.mechanism
    every, columns, kernels = np.concatenate(x), [], []
    for on in joint_groups(mechanism)[:every.shape[1]]:
        own = every[:, on.index(True)]
        nodes = nodes_over(own, own, most, fewest=2)
        if nodes is None:
            return
        columns.append(columns_from(seen, JOINT, on, [spline_basis(nodes, part) for part in x]))
        kernels.append([matern(nodes, length) for length in LENGTHS])
    if len(columns) > 1:
        yield Made(f"a function of {name} acting on each joint individually",
                   np.concatenate(columns, axis=1),
                   [linalg.block_diagonal(some) for some in zip(*kernels, strict=True)], True,
                   subject=EACH)


def over_volume(seen: Visible) -> Iterator[Made]:
    """Yield errors of each coordinate that vary smoothly over the volume, like those of a lens.

    Second powers of all coordinates, third powers of the position; linear terms are scale, rotation
    and skew.
    """
    values = where_it_is(seen)
    places = np.compress([PLACE[c] < 3 for c in told(seen)], values, axis=1)
    powers = np.concatenate([bends(values, 2), bends(places, 3)], axis=1)
    for c in seen.coordinates if powers.size else ():
        yield Made(f"a distortion of {c} over the workspace",
                   columns_from(seen, c, (), by_part(seen, powers)), subject=c, remedy=GAUGE)


def where_it_is(seen: Visible) -> Array:
    """Return the coordinates that vary by more than residuals (N, c), of all parts."""
    return np.concatenate([np.reshape([INPUTS[c].value(p.setting) for c in told(seen)],
                                      (-1, p.setting.time.size)).T for p in seen.system.parts])


def by_part(seen: Visible, values: Array) -> list[Array]:
    """Return values of all rows split by part of the system."""
    return np.split(values, np.cumsum([p.setting.time.size for p in seen.system.parts])[:-1])


def over_travels(seen: Visible) -> Iterator[Made]:
    """Yield errors of each joint that vary smoothly with the travels of all joints at once.

    Second and third powers; linear terms are covered by the functions of each travel.
    """
    travel = np.concatenate([p.setting.travel for p in seen.system.parts])
    powers = np.concatenate([bends(travel, degree) for degree in (2, 3)], axis=1)
    for acted in joints(seen):
        if not acted.together:
            yield acted.made(seen, "a function of all joints' travels", by_part(seen, powers), (),
                             remedy=ALONE.format("each joint", acted.words))


def of_others(seen: Visible) -> Iterator[Made]:
    """Yield functions of payload and wrench, which the library uses as joint loads, and of joints.

    A payload may move anything, and a drive may move its neighbour.
    """
    every = [*joints(seen), *coordinates(seen)]
    rows = [p.setting for p in seen.system.parts]
    yield from functions_of(seen, "the payload", [carried(s) for s in rows], every, LOADED)
    for n, name in enumerate(WRENCH):
        yield from functions_of(seen, name, [applied(n, s) for s in rows], every, LOADED)
    for n, name in enumerate(seen.system.problem.mechanism.actuators):
        yield from functions_of(seen, f"the travel of {name}", [s.travel[:, n] for s in rows],
                                [a for a in joints(seen) if not (a.together or a.on[n])],
                                ALONE.format(name, "the other"))


def functions_of(seen: Visible, name: str, x: Sequence[Array],
                 acted: Sequence[Acted], remedy: str = "") -> Iterator[Made]:
    """Yield functions of an input given by row (N,), by part, acting on each of ``acted``.

    ``remedy``: see :class:`CauseLook`.
    """
    values = np.concatenate(x)
    nodes = nodes_over(values, values, COARSE, fewest=2, margin=0.0)
    if nodes is None:
        return
    kernels = [matern(nodes, length) for length in LENGTHS]
    weights = [spline_basis(nodes, own) for own in x]
    for one in acted:
        yield one.made(seen, f"a function of {name}", weights, kernels, remedy=remedy)


def carried(rows: Setting) -> Array:
    """Return the weight on the platform (N,), N."""
    return np.asarray(np.linalg.norm(rows.weight, axis=1))


def applied(component: int, rows: Setting) -> Array:
    """Return a component of the wrench on the platform (N,) without the weight of its payload."""
    own = rows.wrench[:, component]
    return own - rows.weight[:, component] if component < 3 else own
