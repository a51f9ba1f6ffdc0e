"""What each possible measurement would tell: whitened rows of the machine's error model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.compensation import Knowledge, prediction_jacobian
from ppmcal.calibration.identifiability import RANK_TOLERANCE, analyse, pivoted
from ppmcal.calibration.least_squares import column_scale, prior_weights
from ppmcal.calibration.problem import Problem, State
from ppmcal.errors import NoResult
from ppmcal.instrument import Instrument
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.linalg import Array, Bools, Ints, known
from ppmcal.model.dataset import conditions
from ppmcal.model.mechanism import Mechanism
from ppmcal.plan.candidates import Candidates


@dataclass(frozen=True, eq=False)
class Offer:
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


def offer(mechanism: Mechanism, instrument: Instrument, candidates: Candidates, pose: Ints,
          columns: Mapping[str, Array], like: Offer | None = None) -> Offer:
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
    data = instrument.dataset(q, candidates.pose[pose], columns, mechanism.motion == "planar")
    about = (like.problem.opens[0].about,) if like else None
    problem = Problem(mechanism, (data,), mechanism.free, about)
    state = problem.solve(State(mechanism.values, (instrument.station(),),
                                (pose_motor(candidates.pose[pose]),)))
    if not known(state.poses[0]).all():
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
    return Offer(problem, pose, white[..., kept], (prior * scale)[kept],
                 kept >= len(problem.free), kept, scale[kept], dropped)


def _told(white: Array, prior: Array, count: int) -> Ints:
    """Return the columns that all rows together, and the prior, can tell (C,)."""
    triangle = np.asarray(np.linalg.qr(white.reshape(-1, white.shape[-1]), mode="r"))
    stacked = np.concatenate([triangle, np.diag(prior)])
    frames = pivoted(triangle[:, count:], RANK_TOLERANCE)[0] if white.shape[-1] > count else []
    open_ = [count + c for c in frames]
    found = analyse(stacked[:, [*range(count), *open_]], count, np.ones(count))
    return np.array([*sorted(found.kept), *sorted(open_)], dtype=np.int64)


def task_rows(offered: Offer, instrument: Instrument, tasks: Candidates,
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
    knowledge = Knowledge(problem.columns, np.zeros((0, 0)), {},
                          {instrument.name: problem.opens[0].about}, {})
    rows = conditions(columns, mechanism.actuators, mechanism.gravity, tasks.q)
    jacobian = prediction_jacobian(Model(mechanism), instrument.station(), tasks.pose, tasks.q,
                                   knowledge, instrument.name, rows)
    own = jacobian[..., offered.kept] * offered.scale
    places = sum(1 for c in mechanism.dof if c < 3)
    parts = (own[:, :places], own[:, places:])
    position, rotation = (np.einsum("nmi,nmj->ij", p, p) / len(own) for p in parts)
    return position, rotation
