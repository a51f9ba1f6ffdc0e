"""Learning an unknown cause: the posterior of its block, given everything else.

The block is that of the inference: the same values at nodes, kernels and sizes; a function of two
inputs, or by direction, is learned including the main effect of each input. The rows are linearised
about the nominal machine, geometry and named effects have their priors, and the noise scale,
lengths and sizes are integrated out (Kennedy & O'Hagan 2001). Parts of a term that geometry absorbs
are constrained to zero (Plumlee 2017), such as its sum over the rows, so that no parameter changes
its meaning; so are parts that move the platform in directions to which the instrument is blind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.kernels import roots, whole_kernels
from ppmcal.diagnosis.linearisation import WEAK_VISIBILITY
from ppmcal.diagnosis.observed_directions import ObservedMotion, observed_motion
from ppmcal.diagnosis.question import at_nominal, noise_freedom
from ppmcal.diagnosis.term_candidates import Visible, columns_of
from ppmcal.diagnosis.unknown_causes import UNKNOWN_FAMILY
from ppmcal.errors import NoResult
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.given import Conditioned
from ppmcal.inference.joint import coefficients, joint, taken_blocks
from ppmcal.linalg import Array, without_range
from ppmcal.model.effects.learned import JOINT, LearnedCurve
from ppmcal.model.effects.setting import PLACE

Placed = tuple[LearnedCurve, tuple[bool, ...]]
"""A function without its values, and the joints on which it acts."""
UNSEEN = 1e-4
"""Directions less visible in the rows than this part of the strongest keep their prior."""
ROUND_OFF = 1e-10
"""Shapes with less prior variance than this part of the largest are dropped."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Prior of a term: values = ``root`` z (K, r), z standard normal times its size.

    ``lost`` (K, d): values that geometry absorbs; ``held`` (d, K): their amounts in given values,
    constrained to zero.
    """

    root: Array
    lost: Array
    held: Array

    def gauged(self, values: Array) -> Array:
        """Return values at the nodes (K,) without the part that geometry absorbs."""
        amount = linalg.lstsq(self.held @ self.lost, self.held @ values, rcond=None)[0]
        return np.asarray(values - self.lost @ amount)


@dataclass(frozen=True, eq=False)
class Term:
    """A function to be learned: a curve without values, the joints, its columns (n, K).

    ``free``: the columns without the part that geometry and named effects absorb; ``shapes``: one
    for each root of its block; ``likeliest``: the most probable one.
    """

    curve: LearnedCurve
    on: tuple[bool, ...]
    columns: Array
    free: Array
    shapes: tuple[Shape, ...]
    likeliest: int = 0

    def block(self, first: int) -> Block:
        """Return its prior as a block; ``first``: number of its first column.

        Raises:
            NoResult: the rows show nothing of it.
        """
        width = max(s.root.shape[1] for s in self.shapes)
        if not width:
            raise NoResult("these rows show nothing of a learned term")
        return Block("learned", UNKNOWN_FAMILY, tuple(range(first, first + self.columns.shape[1])),
                     0.0, tuple(np.pad(s.root, ((0, 0), (0, width - s.root.shape[1])))
                                for s in self.shapes))


@dataclass(frozen=True, eq=False)
class Learned:
    """Terms with their curves; ``sigma``: noise over the whitened noise."""

    terms: tuple[Term, ...]
    curves: tuple[LearnedCurve, ...]
    sigma: float


def learned(seen: Visible, functions: Sequence[Placed]) -> Learned:
    """Return functions learned from rows, each given the others.

    Raises:
        NoResult: the instrument is blind to one of them, or the rows show nothing of it.
    """
    motion = observed_motion(seen.system)
    terms = [term(seen, motion, *own) for own in functions]
    first = np.cumsum([0, *(t.columns.shape[1] for t in terms)]).tolist()
    blocks = [own.block(n) for own, n in zip(terms, first, strict=False)]
    given, curves = _past_geometry(seen, terms), []
    found = joint(given, blocks)
    for k, own in enumerate(terms):
        rest = np.arange(len(blocks)) != k
        others = taken_blocks(given, [b for b in blocks if b is not blocks[k]], found.sizes[rest],
                              found.grid[rest])
        mean, covariance = coefficients(given.taking(others), blocks[k])
        curves.append(replace(own.curve, values=mean, covariance=covariance))
        terms[k] = replace(own, likeliest=int(found.grid[k]))
    whole = given.taking(taken_blocks(given, blocks, found.sizes, found.grid))
    return Learned(tuple(terms), tuple(curves), float(np.sqrt(whole.spread / whole.freedom)))


def term(seen: Visible, motion: ObservedMotion, curve: LearnedCurve, on: tuple[bool, ...]) -> Term:
    """Return a function's term in these rows; ``motion``: the observed motion of the platform.

    Raises:
        NoResult: it moves the platform in directions to which the instrument is blind.
    """
    if not (motion.joint_seen(on) if curve.acts == JOINT else
            motion.place_seen(PLACE[curve.acts])):
        raise NoResult("the instrument does not observe all of a learned term")
    columns = columns_of(seen, curve, on)
    free = without_range(columns, seen.basis)
    moved = motion.grams([curve.weights(p.setting) for p in seen.system.parts], on) if (
        curve.acts == JOINT) else None
    whole = columns.T @ columns
    every = roots(whole_kernels(curve), whole, seen.system.count)
    return Term(curve, on, columns, free, tuple(
        _shape(root, (whole, free.T @ free), moved) for root in every))


def _shape(root: Array, by_rows: tuple[Array, Array], moved: tuple[Array, Array] | None) -> Shape:
    """Return the prior of a term for one root (K, K) of its block.

    ``by_rows``: inner products (K, K) of its columns, whole and past the geometry; ``moved``: of
    its motion of the platform, whole and as far as observed, None if all is observed.
    """
    size = np.sum(root**2, axis=0)
    keep = size > ROUND_OFF * float(size.max())
    root, back = root[:, keep], (root[:, keep] / size[keep]).T
    if moved is not None:
        shown = _without(_gone(root, *moved)[1])
        root, back = root @ shown, shown.T @ back
    if not root.shape[1]:
        return Shape(root, root, root.T)
    lost, held = _gone(root, *by_rows)
    return Shape(root @ _without(held), root @ lost, held @ back)


def _gone(root: Array, whole: Array, left: Array) -> tuple[Array, Array]:
    """Return the z (r, d) that are almost fully absorbed, and their amounts (d, r) in each z.

    ``whole``, ``left`` (K, K): inner products of columns, and of the part not absorbed.
    """
    there = root.T @ whole @ root
    metric = there + UNSEEN * float(linalg.eigvalsh(there)[-1]) * np.eye(len(there))
    gone = there - root.T @ left @ root
    part, z = linalg.eigh(0.5 * (gone + gone.T), metric=metric)
    lost = z[:, part > 1.0 - WEAK_VISIBILITY**2]
    return lost, lost.T @ metric


def _without(held: Array) -> Array:
    """Return a basis (r, r - d) of the z for which the ``held`` (d, r) amounts are zero."""
    return linalg.svd(held, full=True)[2][len(held):].T if len(held) else np.eye(held.shape[1])


def _past_geometry(seen: Visible, terms: Sequence[Term]) -> Conditioned:
    """Return rows and the columns of terms conditioned on the geometry, with its tolerances."""
    system, shape = seen.system, seen.system.residual.shape
    values, geometry = (seen.noise.apply(x.reshape(*shape, -1), system)
                        for x in at_nominal(system))
    return Conditioned.nothing(MatrixColumns(np.hstack([t.columns for t in terms])), values[:, 0],
                               system.count, noise_freedom(system)).taking(geometry)
