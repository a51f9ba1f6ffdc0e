"""Uncertainty of kinematics: the model's own standard deviations of poses, joint values and rates.

At fixed joints the pose changes by J dg, at fixed parameters by P dq with P = -A^-1 Jq; a wanted
pose stays for dq = -P^-1 J dg. This turns covariances of parameters into those of poses and joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.compensation.pose_sigma import (
    ParameterCovariance,
    frame_variance,
    own_variance,
    pose_sigma,
    prediction_jacobian,
)
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.linalg import Array, Bools, Ints, finite_rows, pinv, solve_blocks
from ppmcal.model.dataset import Environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.wording.progress import stage

PIECE = 2000
"""Rows processed at a time."""
STEP = 0.1
"""Step of a parameter, in standard deviations, for differences where there is no derivative."""


def independent(mechanism: Mechanism, sigma: dict[str, float]) -> ParameterCovariance:
    """Return the covariance of independent parameters with these standard deviations, SI."""
    values = np.array(list(sigma.values()))
    return ParameterCovariance(tuple(sigma), np.diag(values**2), {}, {}, {})


@dataclass(frozen=True, eq=False)
class PoseRows:
    """N poses with their joint values and conditions.

    ``pose`` (N, 6) of the platform in the base frame, ``q`` (N, k), SI, nan where unknown.
    """

    pose: Array
    q: Array
    rows: Environment

    @property
    def known(self) -> Bools:
        """Which rows have both pose and joint values (N,)."""
        return finite_rows(self.pose) & finite_rows(self.q)

    def take(self, index: Ints) -> PoseRows:
        """Return some of the rows."""
        return PoseRows(self.pose[index], self.q[index], self.rows.take(index))

    def pieces(self) -> Iterator[Ints]:
        """Yield the indices of rows that have both, in pieces."""
        index = np.flatnonzero(self.known)
        for begin in range(0, index.size, PIECE):
            yield index[begin:begin + PIECE]


@stage("how sure they are")
def forward_sigma(model: Model, registration: Registration, at: PoseRows,
                  knowledge: ParameterCovariance, dataset: str = "") -> tuple[Array, Array]:
    """Return standard deviations (N,) of measured position, m, and rotation, rad, at fixed joints.

    Args:
        model: the machine at its parameters.
        registration: frame and target (a tool point, say) in which the platform is observed.
        at: joint values and the platform's poses there.
        knowledge: covariance of parameters, and of frames if ``dataset`` is named.
        dataset: data set of the registration, empty for one that is not of the calibration.
    """
    position, rotation = np.full(len(at.q), np.nan), np.full(len(at.q), np.nan)
    for n in at.pieces():
        some = at.take(n)
        position[n], rotation[n] = pose_sigma(model, registration, some.pose, some.q, some.known,
                                              knowledge, dataset, some.rows)
    return position, rotation


@stage("how sure they are")
def joint_sigma(model: Model, at: PoseRows, knowledge: ParameterCovariance) -> Array:
    """Return standard deviations of joint values (N, k) at fixed poses, unit of q.

    For a machine with fewer actuators than coordinates they are those of the nearest pose.
    """
    by_parameters, left = _joint_parts(model, at, knowledge, True)
    return np.asarray(np.hypot(by_parameters, left))


def left_joint_sigma(model: Model, at: PoseRows, knowledge: ParameterCovariance) -> Array:
    """Return the part of :func:`joint_sigma` that is not due to parameters (N, k), unit of q."""
    return np.asarray(_joint_parts(model, at, knowledge, False)[1])


def _joint_parts(model: Model, at: PoseRows, knowledge: ParameterCovariance,
                 by_parameters: bool) -> Array:
    """Return standard deviations (2, N, k) due to parameters, if wanted, and to all else."""
    out = np.full((2, *at.q.shape), np.nan)
    for n in at.pieces():
        some = at.take(n)
        turn = _joints_of_poses(model, some.pose, some.q)
        if by_parameters:
            jacobian = turn @ prediction_jacobian(model, Registration(), some.pose, some.q,
                                                  knowledge, "", some.rows)[:, _measured(model)]
            out[0, n] = _spread(jacobian, knowledge.covariance)
        out[1, n] = np.sqrt(_beyond_parameters(model, some, turn, knowledge))
    return out


def _measured(model: Model) -> list[int]:
    """Return the places of the pose's coordinates among those that an instrument measures."""
    motion = model.mechanism.motion
    return [motion.measured_parts.index(c) for c in motion.dof]


def _spread(jacobian: Array, covariance: Array) -> Array:
    """Return the standard deviations (N, k) for derivatives (N, k, C) by parameters."""
    return np.asarray(np.sqrt(np.maximum(
        np.einsum("nkc,cd,nkd->nk", jacobian, covariance, jacobian), 0.0)))


def _joints_of_poses(model: Model, pose: Array, q: Array) -> Array:
    """Return d(joint values)/d(pose) (N, k, m) on the closure, nan where singular.

    With fewer actuators than coordinates, for the nearest pose that the machine takes, with
    rotations counted as arcs at the platform's joints.
    """
    closure, motor = model.closure(q), pose_motor(pose)
    a, jq = closure.pose_matrix(motor), closure.joint_matrix(motor)
    if jq.shape[1] == jq.shape[2]:
        return -solve_blocks(jq, a)
    poses = -solve_blocks(a, jq)
    out = np.full((len(q), jq.shape[2], a.shape[2]), np.nan)
    good = np.isfinite(poses).all(axis=(1, 2))
    size = np.array([1.0 if c < 3 else model.mechanism.length_scale for c in model.mechanism.dof])
    out[good] = pinv(poses[good] * size[:, None]) * size
    return out


def joint_resolution(model: Model, at: PoseRows, position: float, rotation: float) -> Array:
    """Return the largest steps of joint values (k,), unit of q, to which commands may be rounded.

    With this rounding, all joints together move the platform by at most ``position`` m and
    ``rotation`` rad, rms, at the most sensitive pose; infinite for joints that do not move it.
    """
    closure, motor = model.closure(at.q[at.known]), pose_motor(at.pose[at.known])
    poses = pinv(closure.pose_matrix(motor)) @ closure.joint_matrix(motor)
    places = np.array([c < 3 for c in model.mechanism.dof])
    allowed = math.sqrt(12.0 / at.q.shape[1])    # rounding errors are uniform over the step
    with np.errstate(divide="ignore"):
        steps = [allowed * size / np.linalg.norm(poses[:, part], axis=1).max(axis=0, initial=0.0)
                 for size, part in ((position, places), (rotation, ~places))]
    return np.asarray(np.minimum(*steps))


def _beyond_parameters(model: Model, at: PoseRows, turn: Array,
                       knowledge: ParameterCovariance) -> Array:
    """Return the variance (N, k) of a fit's unexplained residuals, and of effects' own spread."""
    dof = model.mechanism.dof
    places = np.array([c < 3 for c in dof])
    left = knowledge.missed(at.q, model.mechanism.actuators) ** 2
    each = np.where(places, left[:, :1] / max(int(places.sum()), 1),
                    left[:, 1:] / max(int((~places).sum()), 1))
    own = own_variance(model, Registration(), at.pose, at.q, "", at.rows)
    own = own + frame_variance(model, Registration(), at.pose, knowledge, "")
    each = each + own[:, _measured(model)]
    return np.asarray(np.einsum("nkm,nm->nk", turn**2, each))


@stage("how sure they are")
def sigma_by_differences(solve: Callable[[Model], Array], mechanism: Mechanism,
                         knowledge: ParameterCovariance) -> Array:
    """Return standard deviations (N, k) of any function of a model, by central differences.

    Args:
        solve: returns the values (N, k) for a model; nan where it has none.
        mechanism: the machine, at whose values the differences are centred.
        knowledge: covariance of its parameters, the only uncertainty that counts.
    """
    names = [n for n in knowledge.names if n in mechanism.names]
    own = [knowledge.names.index(n) for n in names]
    covariance = knowledge.covariance[np.ix_(own, own)]
    columns = []
    for name, sigma in zip(names, np.sqrt(np.diagonal(covariance)), strict=True):
        ends = []
        for sign in (1.0, -1.0):
            g = mechanism.values.copy()
            g[mechanism.names.index(name)] += sign * STEP * sigma
            ends.append(solve(Model(mechanism, g)))
        columns.append((ends[0] - ends[1]) / (2.0 * STEP * sigma) if sigma > 0.0
                       else np.zeros_like(ends[0]))
    return _spread(np.stack(columns, axis=-1), covariance)
