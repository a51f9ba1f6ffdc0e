"""Uncertainty of an identified machine's poses: parameters, frame and unexplained residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ppmcal.calibration.fit import Problem, State
from ppmcal.calibration.knowledge import by_tolerances
from ppmcal.calibration.validation import DoubtfulStretch, Identification
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.frame_definition import seen_variance
from ppmcal.kinematics.partial_pose import pose_motor, wanted_poses
from ppmcal.kinematics.registration import predict
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset, Environment, environment, unknown_environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import DefinedFrame, Registration
from ppmcal.wording.progress import stage


@dataclass(frozen=True)
class ParameterCovariance:
    """Information from an identification beyond the model file.

    ``names`` (C,) columns and ``covariance`` (C, C) as in
    :class:`ppmcal.calibration.validation.Identification`, followed by the parameters that
    it held though they may be off, with correlated errors; ``volume``: coordinate -> (low,
    high) of the measured poses, base frame, SI. ``pivots``: the points about which the
    fitted frames are turned, by data set (3,). ``before``: the instrument's registration with the
    nominal geometry, by data set: the frame of the uncorrected commands.
    ``frames``: definitions of the base axes, by data set whose frame is given that way.
    ``unexplained``: rms of residuals beyond model and noise, m and rad; ``doubtful``:
    stretches of a joint's travel where the model is off.
    """

    names: tuple[str, ...]
    covariance: Array
    volume: Mapping[str, tuple[float, float]]
    pivots: Mapping[str, Array]
    before: Mapping[str, Registration]
    unexplained: tuple[float, float] = (0.0, 0.0)
    doubtful: tuple[DoubtfulStretch, ...] = ()
    frames: Mapping[str, DefinedFrame] = field(default_factory=dict)

    @classmethod
    def of(cls, found: Identification) -> ParameterCovariance:
        """Return the information from an identification, as in its identification.json."""
        problem = found.fit.problem
        left = found.unexplained
        kept = found.considered
        names, covariance = tuple(found.columns), found.covariance
        if kept is not None:
            names, covariance = (*names, *kept.names), kept.beside(covariance)
        return cls(names, covariance, found.measured_volume,
                   {d.name: o.about for d, o in zip(problem.datasets, problem.opens, strict=True)},
                   found.before_registrations,
                   (float(left.get("position", 0.0)), float(left.get("rotation", 0.0))),
                   found.doubtful, defined_frames(problem.datasets))

    @property
    def base_axes(self) -> tuple[str, DefinedFrame] | None:
        """Definition of the base axes, and its data set; of several the least certain."""
        return max(self.frames.items(), key=lambda one: one[1].size, default=None)

    def missed(self, q: Array, actuators: Sequence[str]) -> Array:
        """Return the unexplained rms near joint values (N, k), m and rad (N, 2)."""
        out = np.tile(np.square(self.unexplained), (len(q), 1))
        for d in self.doubtful:
            inside = d.holds(q[:, actuators.index(d.actuator)])
            out += np.where(inside[:, None], np.square([d.position, d.rotation]), 0.0)
        return np.asarray(np.sqrt(out))


def defined_frames(datasets: Sequence[Dataset]) -> dict[str, DefinedFrame]:
    """Return, by name, the definitions of frames of those data sets that have one."""
    return {d.name: d.frame.defined for d in datasets if d.frame.defined is not None}


def tolerance_sigma(nominal: Model, registration: Registration, full: Array, q: Array
                    ) -> tuple[Array, Array]:
    """Return how far tolerances move the nominal machine from its commands (N,), m and rad.

    One standard deviation, infinite where a tolerance is. Arguments as for
    :func:`prediction_jacobian`; nan where the machine does not take a pose.
    """
    mechanism, rows = nominal.mechanism, unknown_environment(*q.shape)
    problem, state = as_measured(nominal, registration, full, q, "", rows, (), np.zeros(3))
    places = mechanism.motion.axes
    out = np.full((2, len(q)), np.nan)
    for r in problem.rows(state):
        assert r.response is not None
        variance = np.sum(by_tolerances(r.response, mechanism) ** 2, axis=2)
        out[:, r.index] = variance[:, :places].sum(axis=1), variance[:, places:].sum(axis=1)
    return np.sqrt(out[0]), np.sqrt(out[1])


@stage("how sure they are")
def pose_sigma(model: Model, registration: Registration, full: Array, q: Array, good: Bools,
               knowledge: ParameterCovariance | None, dataset: str, rows: Environment
               ) -> tuple[Array, Array]:
    """Return standard deviations (N,) of position, m, and rotation, rad, at given joint values.

    Residuals that the identification left unexplained occur at these poses too. nan unless
    ``good``; arguments as for :func:`prediction_jacobian`.
    """
    position, rotation = np.full(q.shape[0], np.nan), np.full(q.shape[0], np.nan)
    if knowledge is None or not good.any():
        return position, rotation
    jacobian = prediction_jacobian(model, registration, full[good], q[good], knowledge, dataset,
                                   rows.take(good))
    variance = np.einsum("nmc,nmc->nm", jacobian @ knowledge.covariance, jacobian)
    variance += own_variance(model, registration, full[good], q[good], dataset, rows.take(good))
    variance += frame_variance(model, registration, full[good], knowledge, dataset)
    places = model.mechanism.motion.axes
    left = knowledge.missed(q[good], model.mechanism.actuators) ** 2
    position[good] = np.sqrt(np.maximum(variance[:, :places].sum(axis=1), 0.0) + left[:, 0])
    rotation[good] = np.sqrt(np.maximum(variance[:, places:].sum(axis=1), 0.0) + left[:, 1])
    return position, rotation


def frame_variance(model: Model, registration: Registration, full: Array,
                   knowledge: ParameterCovariance | None, dataset: str) -> Array:
    """Return the variance (N, m) of poses in base axes due to the definition of these axes.

    A fit with such a frame takes its error for one of the geometry, as a motion of the whole
    base; in the measuring frame, that of a ``dataset``, the two cancel. Arguments as for
    :func:`prediction_jacobian`.
    """
    measured = list(model.mechanism.motion.measured_parts)
    axes = None if dataset or knowledge is None else knowledge.base_axes
    if axes is None:
        return np.zeros((len(full), len(measured)))
    point, _ = predict(registration, pose_motor(full))
    return seen_variance(axes[1].covariance, point)[:, measured]


def by_kind(mechanism: Mechanism, variance: Array) -> tuple[Array, Array]:
    """Return standard deviations (N,) of position and rotation from variances (N, m)."""
    places = mechanism.motion.axes
    return (np.sqrt(variance[:, :places].sum(axis=1)), np.sqrt(variance[:, places:].sum(axis=1)))


def model_sigma(mechanism: Mechanism, poses: Array, registration: Registration,
                knowledge: ParameterCovariance, dataset: str, columns: Mapping[str, Array]
                ) -> tuple[Array, Array]:
    """Return standard deviations (N,) of position, m, and rotation, rad, of an identified machine.

    Args:
        mechanism: the identified machine.
        poses: of the platform in the base frame (N, 6), nan where open.
        registration: frame and target in which the pose is measured.
        knowledge: information from the identification.
        dataset: name of the data set that ``registration`` belongs to.
        columns: variables that effects depend on, as in :func:`ppmcal.model.dataset.environment`.

    Poses that the machine does not take are nan.
    """
    k = len(mechanism.actuators)
    model = Model(mechanism)
    full, _ = wanted_poses(model, Registration(), poses)
    rows = environment(columns, mechanism.actuators, mechanism.gravity,
                       np.full((len(full), k), np.nan))
    table = inverse_table(model, full, rows)
    good = np.array([s == "ok" for s in table.status])
    return pose_sigma(model, registration, full, table.q, good, knowledge, dataset, rows)


def prediction_jacobian(model: Model, registration: Registration, full: Array, q: Array,
                        knowledge: ParameterCovariance, dataset: str, rows: Environment) -> Array:
    """Return d(measured pose)/d(columns), columns as the identification names them.

    Args:
        model: the machine at its parameters.
        registration: frame and target in which poses are measured.
        full: platform poses (N, 6) in the base frame, x, y, z, rotation vector.
        q: joint values there (N, k).
        knowledge: names the C columns, and gives the points about which frames are turned.
        dataset: name of the data set that ``registration`` belongs to.
        rows: the environment that effects depend on.

    Returns:
        (N, m, C), m and rad in the measuring frame per unit of a column, SI; 0 in columns of
        other data sets' frames and of unknown names, nan in rows that the machine does not take.
    """
    names = knowledge.names
    place = {n: i for i, n in enumerate(model.mechanism.names)}
    free = tuple(place[n] for n in names if n in place)
    about = knowledge.pivots.get(dataset, np.zeros(3))
    problem, state = as_measured(model, registration, full, q, dataset, rows, free, about)
    own = {name: c for c, name in enumerate(problem.columns)}
    there = [c for c, name in enumerate(names) if name in own]
    measured = model.mechanism.motion.measured_parts
    out = np.full((len(full), len(measured), len(names)), np.nan)
    for r in problem.rows(state):
        block = np.zeros((r.index.size, *out.shape[1:]))
        block[..., there] = r.raw_jacobian()[..., [own[names[c]] for c in there]]
        out[r.index] = block
    return out


def as_measured(model: Model, registration: Registration, full: Array, q: Array, dataset: str,
                 rows: Environment, free: tuple[int, ...], about: Array) -> tuple[Problem, State]:
    """Return poses as rows of a problem, with sigmas of 1 m and 1 rad; see above for arguments."""
    mechanism = model.mechanism
    # planar machines measure x, y, rz only
    flat = np.array([False, False, True, True, True, False]) & mechanism.motion.planar
    data = Dataset.of_poses(dataset, q, np.where(flat, np.nan, full), (1.0, 1.0), fitted=True)
    closed = reached_poses(model, q, rows, pose_motor(full), q).closed
    return (Problem(mechanism, (data,), free, (about,), (rows,)),
            State(mechanism.values, (registration,), (closed,)))


def own_variance(model: Model, registration: Registration, full: Array, q: Array, dataset: str,
                 rows: Environment) -> Array:
    """Return the variance (N, m) of poses due to the effects' own uncertainty."""
    mechanism = model.mechanism
    uncertain = [e for e in mechanism.effects if e.kind.spread is not None]
    out = np.zeros((len(full), len(mechanism.motion.measured_parts)))
    if not uncertain:
        return out
    problem, state = as_measured(model, registration, full, q, dataset, rows, (), np.zeros(3))
    for r in problem.rows(state):
        assert r.response is not None
        at = r.response.setting()
        for effect in uncertain:
            assert effect.kind.spread is not None
            values = {n: float(mechanism.values[p]) for n, p in effect.parameters.items()}
            for shift in effect.kind.spread(at, np.array(effect.on), values):
                out[r.index] += r.response.column(shift) ** 2
    return out
