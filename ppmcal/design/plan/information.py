"""What each possible measurement would tell: whitened rows of the machine's error model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.compensation import ParameterCovariance, prediction_jacobian
from ppmcal.calibration.fit import (
    RANK_TOLERANCE,
    Problem,
    State,
    analyse,
    column_scale,
    pivoted,
    prior_weights,
)
from ppmcal.design.plan.candidate_poses import Candidates
from ppmcal.design.virtual_instrument import Instrument
from ppmcal.errors import NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.dataset import environment
from ppmcal.model.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class CandidateInformation:
    """R possible measurements of m numbers each, C columns that they can tell apart.

    Attributes:
        problem: machine and possible measurements; columns are all of its columns.
        pose: candidate that each row measures (R,).
        jacobian: white rows in natural units (R, m, C).
        prior: 1/tolerance in natural units, 0 where there is none (C,).
        nuisance: columns that are not wanted: open frames and targets (C,).
        kept: which of the problem's columns these are (C,); scale: their natural units (C,).
        dropped: names of columns that neither measurements nor tolerances can tell.
    """

    problem: Problem
    pose: Ints
    jacobian: Array
    prior: Array
    nuisance: Bools
    kept: Ints
    scale: Array
    dropped: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of possible measurements R."""
        return len(self.jacobian)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns (C,)."""
        return tuple(self.problem.columns[c] for c in self.kept)

    def information(self, rows: Ints) -> Array:
        """Return prior and data of some rows as one matrix (C, C)."""
        stacked = self.jacobian[rows].reshape(-1, self.prior.size)
        return np.asarray(stacked.T @ stacked + np.diag(self.prior**2))


def offer(
    mechanism: Mechanism,
    instrument: Instrument,
    candidates: Candidates,
    pose: Ints,
    columns: Mapping[str, Array],
    like: CandidateInformation | None = None,
) -> CandidateInformation:
    """Return what measurements at candidates would tell.

    Args:
        mechanism: with the effects that are to be fitted.
        instrument: what measures.
        candidates: K poses.
        pose: which of them each row measures (R,).
        columns: settings of the rows, SI (R,) each.
        like: an offer whose columns to take; default: those that these rows can tell.

    Raises:
        NoResult: nothing can be told.
    """
    q = candidates.q[pose]
    data = instrument.dataset(q, candidates.pose[pose], columns, mechanism)
    about = (like.problem.opens[0].about,) if like else None
    problem = Problem(mechanism, (data,), mechanism.free, about)
    state = problem.solve(State(mechanism.values, (instrument.registration,),
                                (pose_motor(candidates.pose[pose]),)))
    if not finite_rows(state.poses[0]).all():
        raise NoResult("the machine with its effects does not reach the poses", mechanism.source,
                       "Check the values of the file's `effects`")
    jacobian = np.concatenate([r.jacobian for r in problem.rows(state)])
    scale, prior = column_scale(problem), prior_weights(problem, "prior")
    white = jacobian * scale
    kept = like.kept if like else _told(white, prior * scale, len(problem.free))
    if not np.any(kept < len(problem.free)):
        raise NoResult("no measurement would tell anything about the free parameters",
                       mechanism.source, "Free some parameters, or choose another instrument")
    dropped = tuple(n for c, n in enumerate(problem.columns) if c not in set(kept.tolist())
                    and c < len(problem.free))
    return CandidateInformation(problem, pose, white[..., kept], (prior * scale)[kept],
                 kept >= len(problem.free), kept, scale[kept], dropped)


def _told(white: Array, prior: Array, count: int) -> Ints:
    """Return the columns that all rows together, and the prior, can tell (C,)."""
    triangle = linalg.triangle(white.reshape(-1, white.shape[-1]))
    stacked = np.concatenate([triangle, np.diag(prior)])
    frames = pivoted(triangle[:, count:], RANK_TOLERANCE)[0] if white.shape[-1] > count else []
    open_ = [count + c for c in frames]
    found = analyse(stacked[:, [*range(count), *open_]], count, np.ones(count))
    return np.array([*sorted(found.kept), *sorted(open_)], dtype=np.int64)


def task_rows(offered: CandidateInformation, instrument: Instrument, tasks: Candidates,
              columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return how the machine's pose at tasks moves with the columns.

    The pose is that of the target in the instrument's frame, whatever the instrument measures
    of it.

    Returns:
        mean over the tasks of J^T J for position and for rotation, (C, C) each, m2 and rad2
        per natural unit squared.
    """
    problem = offered.problem
    mechanism = problem.mechanism
    knowledge = ParameterCovariance(problem.columns, np.zeros((0, 0)), {},
                                    {instrument.name: problem.opens[0].about}, {})
    rows = environment(columns, mechanism.actuators, mechanism.gravity, tasks.q)
    jacobian = prediction_jacobian(Model(mechanism), instrument.registration, tasks.pose, tasks.q,
                                   knowledge, instrument.name, rows)
    own = jacobian[..., offered.kept] * offered.scale
    places = mechanism.motion.axes
    parts = (own[:, :places], own[:, places:])
    position, rotation = (np.einsum("nmi,nmj->ij", p, p) / len(own) for p in parts)
    return position, rotation


DETERMINED = 1e-10
"""A design is too small while a direction (of columns scaled to 1) has less information."""
PAYS = 0.01
"""One more measurement pays where it lowers the error at the tasks by this part."""
WINDOW = 5
UNSEEN = 1e-9


@dataclass(frozen=True, eq=False)
class Curve:
    """Standard deviations at the tasks after 1 ... n rows (n,), m and rad; inf where too few.

    ``rotation`` is 0 throughout for machines that do not turn.
    """

    position: Array
    rotation: Array


def curve(offer: CandidateInformation, rows: Sequence[int], tasks: tuple[Array, Array]) -> Curve:
    """Return the accuracy after each row of a design, in its order."""
    blocks = offer.jacobian[list(rows)]
    total = np.cumsum(np.swapaxes(blocks, -1, -2) @ blocks, axis=0) + np.diag(offer.prior**2)
    return Curve(*spreads(total, tasks))


def spreads(information: Array, tasks: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return both standard deviations (n,) of designs with information (n, C, C)."""
    d = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    safe = np.where(d > 0.0, d, 1.0)
    values, vectors = linalg.eigh(information / (safe[:, :, None] * safe[:, None, :]))
    enough = (values[:, 0] > DETERMINED) & (d > 0.0).all(axis=1)
    root = vectors / np.sqrt(np.maximum(values, DETERMINED))[:, None, :] / safe[:, :, None]
    out = [np.sqrt(np.einsum("nci,cd,ndi->n", root, g, root, optimize=True)) for g in tasks]
    return np.where(enough, out[0], np.inf), np.where(enough, out[1], np.inf)


def limit(offer: CandidateInformation, tasks: tuple[Array, Array]) -> tuple[float, float]:
    """Return what is left after ever more measurements of all candidates, m and rad.

    Directions that no candidate sees keep what the tolerances leave them; the others go to 0.
    """
    triangle = linalg.triangle(offer.jacobian.reshape(-1, offer.prior.size))
    _, s, vt = linalg.svd(triangle, full=True)
    seen = np.zeros(len(vt), dtype=np.bool_)
    seen[:s.size] = s > UNSEEN * s[0]
    blind = vt[~seen].T
    if not blind.size:
        return 0.0, 0.0
    held = blind.T @ (offer.prior[:, None] ** 2 * blind)
    left = blind @ linalg.pinv(held) @ blind.T
    # what is left far below what the tolerances alone would give is round-off
    out = [float(np.sqrt(max(np.sum(g * left), 0.0))) for g in tasks]
    return out[0], out[1]


def still_pays(errors: Array) -> int:
    """Return the number of rows from which on one more improves by less than :data:`PAYS`.

    ``errors`` (n,) after 1 ... n rows, inf where too few; 0 where it pays to the end. Judged over
    a few rows, since single ones differ.
    """
    with np.errstate(invalid="ignore"):
        ahead = 1.0 - (errors[WINDOW:] / errors[:-WINDOW]) ** (1.0 / WINDOW)
    pays = np.flatnonzero(~(ahead < PAYS))
    last = int(pays[-1]) + 1 if pays.size else 0
    return last + 1 if last < len(ahead) else 0


def reaching(errors: Array, wanted: float) -> int | None:
    """Return after how many rows the error first falls to ``wanted``, None if it does not."""
    met = np.flatnonzero(errors <= wanted)
    return int(met[0]) + 1 if met.size else None


def extrapolated(
    offer: CandidateInformation, rows: Sequence[int], tasks: tuple[Array, Array], wanted: float
) -> int | None:
    """Return about how many rows like these bring the position error to ``wanted``.

    None where a million would not do.
    """
    prior = np.diag(offer.prior**2)
    data = offer.information(np.asarray(rows, dtype=np.int64)) - prior
    times = np.geomspace(1.0, 1e6 / len(rows), 400)
    errors = spreads(prior + times[:, None, None] * data, tasks)[0]
    met = np.flatnonzero(errors <= wanted)
    return int(np.ceil(times[met[0]] * len(rows))) if met.size else None
