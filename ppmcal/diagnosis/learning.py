"""Learning terms from what is left: additive, smooth, sized by marginal likelihood.

With M what is free of geometry and named effects, r the white residual and C_j the columns of
term j, M r = sum_j M C_j v_j + noise, v_j ~ N(0, sigma^2 size_j^2 K_j). K_j is a Matern kernel
(5/2) over the nodes; its length and size maximise the marginal likelihood with sigma taken out
(Rasmussen & Williams 2006, 5.4.1), the size with a prior: what tolerances make of the same
coordinate. What of a term geometry does as well is held at nothing
(Plumlee 2017): a sum over the rows that is zero, and so on, so that it moves no parameter's
meaning; and so is what moves the platform where the instrument is blind. Which functions there are
is asked before, with all other causes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.kernels import LENGTHS, SECOND, matern
from ppmcal.diagnosis.stage import WEAK_SURVIVAL
from ppmcal.diagnosis.term_candidates import TermCandidate, Visible
from ppmcal.errors import NoResult
from ppmcal.linalg import Array
from ppmcal.model.effects.learned import LearnedCurve

SIZES = np.geomspace(1e-2, 1e4, 25)
"""Sizes that are tried: the standard deviation of a column's whole effect, in sigmas."""
NEGLIGIBLE = 12.0
"""Lengths and sizes that are so much less likely (log) count for nothing."""
SWEEPS = 3
UNSEEN = 1e-4
"""Directions that rows see by less than this part of the strongest keep what the kernel says."""


@dataclass(frozen=True, eq=False)
class Shape:
    """What the prior lets a term be: values = ``root`` z, z standard normal times its size.

    ``length``: of the kernel, in parts of the range. ``lost`` (n, d): values that geometry does as
    well; ``held`` (d, n): what a term has of them, by its values: nothing.
    """

    length: float
    root: Array
    lost: Array
    held: Array

    @property
    def spread(self) -> float:
        """Mean variance of the values at the nodes, for a size and a sigma of 1, SI."""
        return float(np.mean(np.sum(self.root**2, axis=1)))

    def gauged(self, values: Array) -> Array:
        """Return values at the nodes (n,) less what geometry does as well."""
        amount = linalg.lstsq(self.held @ self.lost, self.held @ values, rcond=None)[0]
        return np.asarray(values - self.lost @ amount)


@dataclass(frozen=True, eq=False)
class Term:
    """A candidate with its shape and size."""

    candidate: TermCandidate
    shape: Shape
    size: float

    @property
    def columns(self) -> Array:
        """Free columns of z (n, r), of which each is standard normal times sigma."""
        return np.asarray(self.candidate.free @ (self.size * self.shape.root))


@dataclass(frozen=True, eq=False)
class Learned:
    """Terms with their curves and the gain in log marginal likelihood of each.

    ``sigma``: of the noise, over the whitened one.
    """

    terms: tuple[Term, ...]
    curves: tuple[LearnedCurve, ...]
    sigma: float
    gains: tuple[float, ...] = ()


def learned(seen: Visible, chosen: Sequence[TermCandidate]) -> Learned:
    """Return terms learned from rows.

    Raises:
        NoResult: where nothing of one shows.
    """
    terms: list[Term] = []
    gains: list[float] = []
    shapes = {id(c): shapes_of(c) for c in chosen}
    for candidate in chosen:
        if not shapes[id(candidate)]:
            raise NoResult("nothing of a learned term shows in these rows")
        term, gain = _Rest(seen, terms).fitted(candidate, shapes[id(candidate)])
        terms.append(term)
        gains.append(gain)
    return solved(seen, _swept(seen, terms, shapes), shapes, gains)


def _swept(seen: Visible, terms: list[Term], shapes: dict[int, list[Shape]]) -> list[Term]:
    """Return the terms with lengths and sizes fitted again, each given the others."""
    if len(terms) > 1:
        for _ in range(SWEEPS):
            for i, term in enumerate(terms):
                rest = _Rest(seen, terms[:i] + terms[i + 1:])
                terms[i] = rest.fitted(term.candidate, shapes[id(term.candidate)])[0]
    return terms


def shapes_of(candidate: TermCandidate) -> list[Shape]:
    """Return the shapes that a candidate may have, one for each length of the kernel."""
    curve = candidate.curve
    second = matern(curve.by_nodes, SECOND) if curve.by else np.ones((1, 1))
    seen = candidate.columns.T @ candidate.columns
    # one unit of z moves all rows together by one sigma
    scale = 1.0 / np.sqrt(max(float(np.trace(seen)) / len(seen), 1e-300))
    out = []
    for length in LENGTHS:
        kernel = np.kron(matern(curve.nodes, length), second)
        w, v = linalg.eigh(np.asarray(kernel, dtype=float))
        keep = w > 1e-10 * w[-1]
        root = v[:, keep] * (scale * np.sqrt(w[keep]))
        shown = _without(_blind(candidate, root))
        root = root @ shown
        if not root.shape[1]:
            continue
        lost, held = absorbed(candidate, root)
        back = shown.T @ (v[:, keep] / (scale * np.sqrt(w[keep]))).T
        out.append(Shape(length, root @ _without(held), root @ lost, held @ back))
    return [s for s in out if s.root.shape[1]]


def _without(held: Array) -> Array:
    """Return the shapes z (r, r - d) that have nothing of what is ``held`` (d, r)."""
    return linalg.svd(held, full=True)[2][len(held):].T if len(held) else np.eye(held.shape[1])


def _blind(candidate: TermCandidate, root: Array) -> Array:
    """Return how much each z has (d, r) of shapes that move the platform where rows are blind."""
    moved = root.T @ candidate.moved @ root
    metric = moved + UNSEEN * float(linalg.eigvalsh(moved)[-1]) * np.eye(len(moved))
    blind = moved - root.T @ candidate.observed @ root
    part, v = linalg.eigh(0.5 * (blind + blind.T), metric=metric)
    return np.asarray(v[:, part > 1.0 - WEAK_SURVIVAL**2].T @ metric)


def absorbed(candidate: TermCandidate, root: Array) -> tuple[Array, Array]:
    """Return which shapes geometry does as well, and how much of each z has.

    Shapes (r, d) in units of z; the second (d, r) is 0 where a term has nothing of them.
    """
    seen = root.T @ candidate.columns.T @ candidate.columns @ root
    gone = seen - root.T @ candidate.gram @ root
    metric = seen + UNSEEN * float(linalg.eigvalsh(seen)[-1]) * np.eye(len(seen))
    part, v = linalg.eigh(0.5 * (gone + gone.T), metric=metric)
    lost = v[:, part > 1.0 - WEAK_SURVIVAL**2]
    return lost, lost.T @ metric


class _Rest:
    """The rows with some terms in the model: inner products weighted by their covariance."""

    def __init__(self, seen: Visible, terms: Sequence[Term]) -> None:
        self.seen = seen
        n = seen.left.size
        self.z = np.concatenate([np.zeros((n, 0)), *(t.columns for t in terms)], axis=1)
        self.inner = linalg.inv(np.eye(self.z.shape[1]) + self.z.T @ self.z)
        self.right = self.z.T @ seen.left
        self.square = float(seen.left @ seen.left - self.right @ self.inner @ self.right)

    def fitted(self, candidate: TermCandidate, shapes: Sequence[Shape]) -> tuple[Term, float]:
        """Return a candidate at its likeliest length and size, and the gain in log likelihood."""
        tried = self._tried(candidate, shapes)
        value = np.stack([t.value for t in tried])
        n, i = (int(j) for j in np.unravel_index(int(np.argmax(value)), value.shape))
        return Term(candidate, shapes[n], float(tried[n].size[i])), float(value[n, i])

    def posterior(self, candidate: TermCandidate, shapes: Sequence[Shape]) -> tuple[Array, Array]:
        """Return mean (n,) and covariance (n, n) of a candidate's values at its nodes.

        Over all lengths and sizes, each as likely as it is: the likeliest alone would be too sure.
        """
        tried = self._tried(candidate, shapes)
        top = max(float(t.value.max()) for t in tried)
        means, spreads, weights = [], [], []
        for t in tried:
            for i in np.flatnonzero(t.value > top - NEGLIGIBLE):
                shrink = t.size[i] ** 2 / (1.0 + t.size[i] ** 2 * t.strength)
                means.append(t.modes @ (shrink * t.right))
                spreads.append(t.sigma2[i] * (t.modes * shrink) @ t.modes.T)
                weights.append(np.exp(t.value[i] - top))
        share = np.array(weights) / np.sum(weights)
        mean = share @ np.array(means)
        away = np.array(means) - mean
        return mean, np.asarray(np.einsum("i,ijk->jk", share, np.array(spreads))
                                + (away * share[:, None]).T @ away)

    def _tried(self, candidate: TermCandidate, shapes: Sequence[Shape]) -> list[_Tried]:
        """Return what each shape (length) would give at every size."""
        cross = candidate.free.T @ self.z
        gram = candidate.gram - cross @ self.inner @ cross.T
        toward = candidate.free.T @ self.seen.left - cross @ self.inner @ self.right
        freedom, size = self.seen.freedom, SIZES / np.sqrt(candidate.curve.values.size)
        out = []
        for shape in shapes:
            w, v = linalg.eigh(shape.root.T @ gram @ shape.root)
            w, right = np.maximum(w, 0.0), v.T @ (shape.root.T @ toward)
            spread = 1.0 + size[:, None] ** 2 * w
            gone = np.sum(size[:, None] ** 2 * right**2 / spread, axis=1)
            left = np.maximum(self.square - gone, 1e-9 * self.square)
            sigma2 = left / freedom
            value = -0.5 * np.sum(np.log(spread), axis=1) - 0.5 * freedom * np.log(
                left / self.square)
            # its size is one that tolerances explain: normal, of their standard deviation
            value -= 0.5 * size**2 * sigma2 * shape.spread / candidate.sigma**2
            out.append(_Tried(shape.root @ v, w, right, size, value, sigma2))
        return out


@dataclass(frozen=True, eq=False)
class _Tried:
    """A shape at all sizes (s,): its independent modes (n, r), how strongly rows see each.

    ``right`` (r,): what they say of it; ``value``, ``sigma2`` (s,): log likelihood and noise.
    """

    modes: Array
    strength: Array
    right: Array
    size: Array
    value: Array
    sigma2: Array


def solved(seen: Visible, terms: Sequence[Term], shapes: Mapping[int, list[Shape]],
           gains: Sequence[float] = ()) -> Learned:
    """Return the curves of terms that are chosen, each given the others."""
    curves = []
    for i, t in enumerate(terms):
        rest = _Rest(seen, [*terms[:i], *terms[i + 1:]])
        mean, covariance = rest.posterior(t.candidate, shapes[id(t.candidate)])
        curves.append(replace(t.candidate.curve, values=mean, covariance=covariance))
    sigma = float(np.sqrt(_Rest(seen, terms).square / seen.freedom))
    return Learned(tuple(terms), tuple(curves), sigma, tuple(gains))
