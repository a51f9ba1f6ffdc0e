"""What is learned of an unknown cause: the posterior of its block, given all else.

The block is the one that the question had: the same values at nodes, kernels and sizes; a function
of two inputs, or by direction, is learned with what each input does by itself. The rows are taken
back to the nominal machine, geometry and named effects have their priors, the noise's scale is
integrated, and so are lengths and sizes (Kennedy & O'Hagan 2001). What of a term geometry does as
well is held at nothing (Plumlee 2017): a sum over the rows that is zero, and so on, so that
it moves no parameter's meaning; and so is what moves the platform where the instrument is blind.
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
"""Directions that rows see by less than this part of the strongest keep what the kernel says."""
ROUND_OFF = 1e-10
"""Shapes to which the kernels give less than this part of the most are none."""


@dataclass(frozen=True, eq=False)
class Shape:
    """What a term may be: values = ``root`` z (K, r), z standard normal times its size.

    ``lost`` (K, d): values that geometry does as well; ``held`` (d, K): what a term has of them, by
    its values: nothing.
    """

    root: Array
    lost: Array
    held: Array

    def gauged(self, values: Array) -> Array:
        """Return values at the nodes (K,) less what geometry does as well."""
        amount = linalg.lstsq(self.held @ self.lost, self.held @ values, rcond=None)[0]
        return np.asarray(values - self.lost @ amount)


@dataclass(frozen=True, eq=False)
class Term:
    """A function to be learned: a curve without values, the joints, its columns (n, K).

    ``free``: the columns without what geometry and named effects could do instead; ``shapes``: one
    for each root of its block; ``likeliest``: which.
    """

    curve: LearnedCurve
    on: tuple[bool, ...]
    columns: Array
    free: Array
    shapes: tuple[Shape, ...]
    likeliest: int = 0

    def block(self, first: int) -> Block:
        """Return what it may be as a block; ``first``: number of its column.

        Raises:
            NoResult: where nothing shows of it.
        """
        width = max(s.root.shape[1] for s in self.shapes)
        if not width:
            raise NoResult("nothing of a learned term shows in these rows")
        return Block("learned", UNKNOWN_FAMILY, tuple(range(first, first + self.columns.shape[1])),
                     0.0, tuple(np.pad(s.root, ((0, 0), (0, width - s.root.shape[1])))
                                for s in self.shapes))


@dataclass(frozen=True, eq=False)
class Learned:
    """Terms with their curves; ``sigma``: of the noise, over the whitened one."""

    terms: tuple[Term, ...]
    curves: tuple[LearnedCurve, ...]
    sigma: float


def learned(seen: Visible, functions: Sequence[Placed]) -> Learned:
    """Return what rows say of functions, each given the others.

    Raises:
        NoResult: where the instrument does not see one of them, or nothing of it shows.
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
    """Return a function as these rows see it; ``motion``: what they see of the platform's.

    Raises:
        NoResult: where it moves what the instrument does not see.
    """
    if not (motion.joint_seen(on) if curve.acts == JOINT else
            motion.place_seen(PLACE[curve.acts])):
        raise NoResult("something of a learned term is not seen by the instrument")
    columns = columns_of(seen, curve, on)
    free = without_range(columns, seen.basis)
    moved = motion.grams([curve.weights(p.setting) for p in seen.system.parts], on) if (
        curve.acts == JOINT) else None
    whole = columns.T @ columns
    every = roots(whole_kernels(curve), whole, seen.system.count)
    return Term(curve, on, columns, free, tuple(
        _shape(root, (whole, free.T @ free), moved) for root in every))


def _shape(root: Array, by_rows: tuple[Array, Array], moved: tuple[Array, Array] | None) -> Shape:
    """Return what a term may be by one root (K, K) of its block.

    ``by_rows``: inner products (K, K) of its columns, whole and past the geometry; ``moved``: of
    how it moves the platform, whole and as far as that is seen, None where all of it is.
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
    """Return the z (r, d) that leave next to nothing, and how much (d, r) each z has of them.

    ``whole``, ``left`` (K, K): inner products of columns, and of what is left of them.
    """
    there = root.T @ whole @ root
    metric = there + UNSEEN * float(linalg.eigvalsh(there)[-1]) * np.eye(len(there))
    gone = there - root.T @ left @ root
    part, z = linalg.eigh(0.5 * (gone + gone.T), metric=metric)
    lost = z[:, part > 1.0 - WEAK_VISIBILITY**2]
    return lost, lost.T @ metric


def _without(held: Array) -> Array:
    """Return the z (r, r - d) that have nothing of what is ``held`` (d, r)."""
    return linalg.svd(held, full=True)[2][len(held):].T if len(held) else np.eye(held.shape[1])


def _past_geometry(seen: Visible, terms: Sequence[Term]) -> Conditioned:
    """Return rows and the columns of terms with the geometry taken, as tolerances have it."""
    system, shape = seen.system, seen.system.residual.shape
    values, geometry = (seen.noise.apply(x.reshape(*shape, -1), system)
                        for x in at_nominal(system))
    return Conditioned.nothing(MatrixColumns(np.hstack([t.columns for t in terms])), values[:, 0],
                               system.count, noise_freedom(system)).taking(geometry)
