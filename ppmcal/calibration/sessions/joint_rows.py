"""The data of two calibrations as rows of one linear problem: the new information of the second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import BENT, SEEN, Posterior, PriorInformation
from ppmcal.calibration.sessions.common_misfit import DifferenceNoise
from ppmcal.calibration.sessions.session_posteriors import SESSION
from ppmcal.linalg import Array, column_lengths, range_basis, reciprocals, svd, without_range
from ppmcal.model.mechanism import Mechanism

FAR = 3.0
"""Tolerances are widened as if the machine were off by this many of them, if it is off by more."""
FORESEEN = 1e-3
"""A direction of the new data counts if the old ones know it at least this well, relatively."""


@dataclass(frozen=True, eq=False)
class JointRows:
    """The new rows less the prediction of old ones and tolerances, white (d,), F parameters.

    ``columns`` (d, F + K + G): derivative of the misfit by one natural unit ``scale`` (F + K + G,)
    of each parameter of the new calibration, of each of the ``candidates`` (K,) and of each
    of the parameters ``defining`` its frames (G,).
    ``information``: of the old data alone, of the new data alone, and of the tolerances (F, F) in
    natural units.
    """

    misfit: Array
    columns: Array
    scale: Array
    candidates: tuple[str, ...]
    information: tuple[Array, Array, Array]
    defining: tuple[str, ...] = ()

    def covariance(self) -> Array:
        """Return the covariance of new minus old values if nothing changed (F, F), SI.

        For two posteriors C1, C2 with the same prior P: C1 + C2 - C1 P C2 - C2 P C1.
        """
        one, two, prior = self.information
        first, second = (linalg.pinv(i + prior, rcond=1e-14, hermitian=True)
                         for i in (one, two))
        cross = first @ prior @ second
        scale = self.scale[:len(prior)]
        return np.asarray((first + second - cross - cross.T) * np.outer(scale, scale))


def joint_rows(mechanism: Mechanism, old: Posterior, new: Posterior, noise: DifferenceNoise
               ) -> JointRows:
    """Return the information in the new data beyond the old ones and the tolerances."""
    (first, one), (second, two), names, natural = _with_candidates(old, new)
    free = len(new.places)
    scale = np.concatenate([new.scale, natural])
    g = mechanism.values.copy()
    g[list(new.places)] = new.value
    # a parameter that only the older one had free is now known exactly
    before = PriorInformation(old.places, first[0], first[1], old.value)
    right_old, slope = before.rows(mechanism, new.places, g)
    weight = new.scale / new.tolerance
    # at the new minimum the pull of the tolerances equals that of the data
    held = new.pull() * new.scale * reciprocals(weight)
    # tolerances do not hold a machine that is farther off than they allow
    loose = max(1.0, float(np.max(np.abs(held), initial=0.0)) / FAR)
    weight, held = weight / loose, held / loose
    if new.step is not None:
        held = held + weight * new.step / new.scale
    here = np.concatenate([second[0], two], axis=1) * scale / noise.new
    prior = np.diag(np.concatenate([weight, np.ones(natural.size)]))
    blocks = [np.concatenate([slope, one], axis=1) * scale / noise.old, here, prior]
    matrix = _with_common(blocks, noise)
    basis = range_basis(matrix, least=BENT)
    right = np.zeros(len(matrix))
    given = np.concatenate([right_old / noise.old, second[1] / noise.new, held])
    right[:given.size] = given
    size = [len(b) for b in blocks]
    ours = slice(size[0], size[0] + size[1])
    # the part of the new rows' own columns beyond all common ones
    own = range_basis(here, least=SEEN)
    rest = np.zeros((right.size, own.shape[1]))
    rest[ours] = own
    rest = without_range(rest, basis)
    seen = range_basis(rest, least=FORESEEN)
    columns, defining = seen[ours].T @ here, new.defining
    if defining is not None:
        # a frame-defining parameter moves the rows like the parameters as seen from its frame
        columns = np.concatenate([columns, columns[:, :free] @ (defining.seen / new.scale).T],
                                 axis=1)
        scale = np.concatenate([scale, defining.scale])
    return JointRows(seen.T @ (right - basis @ (basis.T @ right)), columns, scale,
                     names, (_square(blocks[0][:, :free]), _square(here[:, :free]),
                             np.diag(weight**2)), defining.names if defining else ())


def _with_common(blocks: list[Array], noise: DifferenceNoise) -> Array:
    """Return all rows, with columns for the common misfit of rows of the same poses.

    Reduced rows have no pose: there it is the misfit of the same combination of columns.
    """
    matrix = np.concatenate(blocks)
    if not noise.alike:
        return matrix
    old, new = blocks[:2]
    # a common misfit scales with the whitening of rows by different stated noise
    if noise.pairs is not None:
        first, second = noise.pairs
        sides = [np.zeros((len(b), first.size)) for b in (old, new)]
        sides[0][first, np.arange(first.size)] = 1.0
        sides[1][second, np.arange(first.size)] = (
            column_lengths(new[second].T) / column_lengths(old[first].T))
    else:
        sides = [u @ vt for u, _, vt in map(svd, (old, new))]
        sides[1] *= np.linalg.norm(new) / np.linalg.norm(old)
    count = sides[0].shape[1]
    alike = np.concatenate([sides[0] / noise.old, sides[1] / noise.old,
                            np.zeros((len(blocks[2]), count))])
    held = np.zeros((count, matrix.shape[1]))
    return np.block([[matrix, alike], [held, np.eye(count) / noise.alike]])


def _square(matrix: Array) -> Array:
    return np.asarray(matrix.T @ matrix)


Side = tuple[tuple[Array, Array], Array]
"""Rows of parameters (k, F) with their right side (k,), and columns of candidates (k, K)."""


def _with_candidates(old: Posterior, new: Posterior
                     ) -> tuple[Side, Side, tuple[str, ...], Array]:
    """Return the rows of both, with the candidates that both have, their names and units (K,)."""
    if old.session is None or new.session is None:
        sides = [((p.matrix, p.right), np.zeros((p.right.size, 0))) for p in (old, new)]
        return sides[0], sides[1], (), np.zeros(0)
    named = [dict(zip(_numbered(p), range(len(p.session.names)), strict=True))
             if p.session else {} for p in (old, new)]
    both = [n for n in named[1] if n in named[0]]
    out = []
    for p, own in zip((old, new), named, strict=True):
        assert p.session is not None
        free = len(p.places)
        at = [free + own[n] for n in both]
        out.append(((p.session.matrix[:, :free], p.session.right), p.session.matrix[:, at]))
    at = [named[1][n] for n in both]
    return (out[0], out[1], tuple(new.session.names[c] for c in at), new.session.scale[at])


def _numbered(posterior: Posterior) -> list[str]:
    """Return the candidates' names with numbered data sets, because names differ by session."""
    assert posterior.session is not None
    sets = [SESSION, *(s.name for s in posterior.session.sights)]
    out = []
    for name in posterior.session.names:
        what, _, of = name.partition(" of ")
        kind = next((s.kind for s in posterior.session.sights if s.name == of), "")
        out.append(f"{what} of {kind} {sets.index(of) if of in sets else of}")
    return out
