"""Calibrating a whole fleet of simulated machines at once.

Machines that differ from one nominal by their tolerances share its linear problem, so the estimate
is one fixed matrix: theta += G r + H (nominal - theta), r the whitened residuals of the full
nonlinear model at theta. That is Gauss-Newton with the nominal Jacobian (a chord method); where it
converges it is where :mod:`identify` ends, but for terms of second order in the errors, and where
it does not, that fits the machine. M machines, N measured poses, m numbers each, C columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.compensation import ParameterCovariance, prediction_jacobian
from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    NuisanceColumns,
    Problem,
    State,
    column_scale,
    identify,
    prior_weights,
    turn_between,
)
from ppmcal.design.virtual_instrument import Instrument
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.least_squares_closure import surplus, unexplained
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.registration import predict
from ppmcal.linalg import Array, finite_rows, svd
from ppmcal.model.dataset import Dataset, unknown_environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import Motion
from ppmcal.model.registration import Registration

ROUNDS = 12
SETTLED = 1e-3
"""A fit has settled when a step changes no column by more than this part of its deviation."""
UNSEEN = 1e-12
NOISY = 3
"""Newton steps from exact readings to noisy ones; two are enough for noise of 1e-4 of the reach."""


@dataclass(frozen=True, eq=False)
class MeasurementSetup:
    """How every machine of a fleet is measured.

    ``mechanism``: the nominal one with its tolerances; ``q`` (N, k) and ``pose`` (N, 6): where.
    """

    mechanism: Mechanism
    instrument: Instrument
    q: Array
    pose: Array

    @cached_property
    def problem(self) -> Problem:
        """The problem of the nominal machine measured without error."""
        data = self.instrument.dataset(self.q, self.pose, {}, self.mechanism)
        return Problem(self.mechanism, (data,), self.mechanism.free)

    @cached_property
    def linear(self) -> LinearCalibration:
        """The linear estimate about the nominal machine, with priors."""
        return _linear(self, np.ones(len(self.problem.columns), dtype=np.bool_))

    @cached_property
    def registration(self) -> LinearCalibration:
        """The same with frame and target alone free: the geometry is taken as nominal."""
        open_ = np.arange(len(self.problem.columns)) >= len(self.problem.free)
        return _linear(self, open_)


@dataclass(frozen=True, eq=False)
class LinearCalibration:
    """One linear estimate: ``gain`` (C, N m), ``pull`` (C, F), ``white`` (N, m, m).

    ``covariance`` (C, C) of what is estimated; ``open``: whether anything is; ``geometry``:
    whether parameters are, or frame and target alone.
    """

    gain: Array
    pull: Array
    white: Array
    covariance: Array
    open: bool
    geometry: bool

    @property
    def sigma(self) -> Array:
        """Standard deviation of every column (C,), 0 where it is not estimated."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What M machines were found to be: ``g`` (M, P) and registrations with rows of their own.

    ``settled`` (M,): whether the fit came to rest.
    """

    g: Array
    registration: Registration
    settled: NDArray[np.bool_]

    def seen_by(self, rows: NDArray[np.int64]) -> Registration:
        """Return the registration with the entries of some machines (R,)."""
        s = self.registration
        return replace(s, frame=s.frame[rows], target=s.target[rows],
                       target_rotation=s.target_rotation[rows])


def _linear(setup: MeasurementSetup, use: NDArray[np.bool_]) -> LinearCalibration:
    """Return the estimate of the columns ``use`` (C,)."""
    problem = setup.problem
    state = State(setup.mechanism.values, (setup.instrument.registration,),
                  (pose_motor(setup.pose),))
    rows = list(problem.rows(state))
    jacobian = np.concatenate([r.jacobian for r in rows])
    white = np.concatenate([r.whitener for r in rows])
    scale, prior = column_scale(problem), prior_weights(problem, "prior")
    data = jacobian.reshape(-1, jacobian.shape[-1]) * scale * use
    stacked = np.concatenate([data, np.diag(prior * scale * use)])
    u, s, vt = svd(stacked)
    seen = s > UNSEEN * s.max(initial=1e-300)
    inverse = (vt[seen].T / s[seen]) @ u[:, seen].T * scale[:, None]
    half = (vt[seen].T / s[seen]) * scale[:, None]
    free = len(problem.free)
    pull = inverse[:, len(data):][:, :free] * prior[:free]
    return LinearCalibration(inverse[:, :len(data)], pull, white, half @ half.T, bool(use.any()),
                  bool(use[:free].any()))


def calibrate(
    setup: MeasurementSetup, linear: LinearCalibration, g: Array, noise: Array
) -> Calibrated:
    """Return what a calibration finds of machines whose true parameters are ``g`` (M, P).

    Machines at which the nominal Jacobian does not converge, or that cannot take a pose
    to be measured (it is left out then), are identified one by one (:func:`alone`).

    Args:
        setup: how they are measured.
        linear: the estimate to use.
        g: true parameters (M, P).
        noise: white noise of the measurements (M, N, m).
    """
    found = _chord(setup, linear, g, noise)
    if not linear.open:
        return replace(found, settled=np.ones(len(g), dtype=np.bool_))
    parameters, registration, settled = found.g.copy(), found.registration, found.settled.copy()
    frame, target, turn = (np.array(a) for a in (registration.frame, registration.target,
                                                 registration.target_rotation))
    for i in np.flatnonzero(~settled):
        fit = alone(setup, linear, g[i], noise[i])
        if fit is not None:
            own = fit.state.registrations[0]
            parameters[i], frame[i] = fit.state.g, own.frame
            target[i], turn[i], settled[i] = own.target, own.target_rotation, True
    return Calibrated(parameters, Registration(frame, target, turn, registration.homing), settled)


def alone(
    setup: MeasurementSetup, linear: LinearCalibration, g: Array, noise: Array
) -> Fit | None:
    """Return the fit of one machine (P,) by `identify`; None where there is none.

    It starts at the truth, next to the minimum that matters: what a calibration is worth, not
    how it gets there from the nominal one. ``noise``: white (N, m), as :func:`calibrate` takes it.
    """
    mechanism, instrument = setup.mechanism, setup.instrument
    model = Model(mechanism, g)
    real, there, _ = newton(model.closure(setup.q), pose_motor(setup.pose))
    raw = np.asarray(linalg.solve(linear.white, noise[..., None])[..., 0], dtype=np.float64)
    seen, gaps = np.split(raw, [raw.shape[1] - mechanism.surplus], axis=1)
    q = setup.q
    if mechanism.surplus:
        q = readings(model, real, gaps)
        there &= finite_rows(q)
    data = perturbed(instrument.dataset(q, pose_vector(real), {}, mechanism), seen,
                     mechanism.motion)
    free = list(setup.problem.free) if linear.geometry else []
    problem = Problem(mechanism, (data.take(there),), tuple(free))
    first = mechanism.values.copy()
    first[free] = g[free]
    closed, here, _ = newton(Model(mechanism, first).closure(q[there]), real[there])
    if not here.all():
        return None
    try:
        fit = identify(problem, FitOptions(robust=False), near=True,
                       start=State(first, (instrument.registration,), (closed,)))
    except PpmcalError:
        return None
    return fit if fit.converged else None


def perturbed(data: Dataset, raw: Array, motion: Motion) -> Dataset:
    """Return measurements with errors ``raw`` (N, m) of the coordinates measured, m and rad."""
    if data.kind.scalar:
        return replace(data, value=data.value + raw[:, 0])
    whole = np.zeros((len(raw), 6))
    whole[:, list(data.kind.coordinates(motion))] = raw
    own = cga.motor_from_rotation_vector(np.nan_to_num(data.rotation), np.zeros(3))
    shake = cga.motor_from_rotation_vector(whole[:, 3:], np.zeros(3))
    turned = cga.rotation_vector(cga.compose(shake, own))
    return replace(data, position=data.position + whole[:, :3],
                   rotation=np.where(np.isnan(data.rotation), np.nan, turned))


def _chord(
    setup: MeasurementSetup, linear: LinearCalibration, g: Array, noise: Array
) -> Calibrated:
    """Return the fixed point of the nominal estimate; ``settled`` where it was reached."""
    problem, mechanism = setup.problem, setup.mechanism
    m, n = len(g), len(setup.q)
    owner, open_ = np.repeat(np.arange(m), n), problem.opens[0]
    q, start = np.tile(setup.q, (m, 1)), np.tile(pose_motor(setup.pose), (m, 1))
    truth = setup.instrument.registration
    true = Model(mechanism, g[owner])
    real, reached, _ = newton(true.closure(q), start)
    if mechanism.surplus:
        q = inverse(true, real).q  # what encoders show: limbs follow the pose that all agree on
    shown = predict(truth, real)
    now = Calibrated(np.tile(mechanism.values, (m, 1)), Registration(
        np.tile(truth.frame, (m, 1)), np.tile(truth.target, (m, 1)),
        np.tile(truth.target_rotation, (m, 1)), truth.homing), np.zeros(m, dtype=np.bool_))
    free, pose = list(problem.free), start
    usable = np.asarray(reached.reshape(m, n).all(axis=1), dtype=np.bool_)
    small = np.zeros((m, len(problem.columns)), dtype=np.bool_)
    sigma = np.where(linear.sigma > 0.0, linear.sigma, 1.0)
    for _ in range(ROUNDS):
        closure = Model(mechanism, now.g[owner]).closure(q)
        pose, found, _ = newton(closure, pose)
        usable &= found.reshape(m, n).all(axis=1)
        raw = _residual(shown, predict(now.seen_by(owner), pose), setup)
        if mechanism.surplus:
            raw = np.concatenate([raw, -unexplained(closure, pose)], axis=1)
        white = (linear.white @ raw.reshape(m, n, -1, 1))[..., 0] + noise
        step = white.reshape(m, -1) @ linear.gain.T
        step += (mechanism.nominals[free] - now.g[:, free]) @ linear.pull.T
        step[~usable] = 0.0
        now = _moved(now, step, free, open_)
        small[:] = np.abs(step) <= SETTLED * sigma
        if small[usable].all():
            break
        pose = np.where(usable[owner][:, None], pose, start)
    return replace(now, settled=usable & small.all(axis=1))


def readings(model: Model, pose: Array, gaps: Array) -> Array:
    """Return the joints (R, k) that encoders of surplus limbs show at poses (R, 8).

    They are nan beyond reach. ``gaps`` (R, s): what they are to miss of the closure, m, by noise.
    """
    q = inverse(model, pose).q
    for _ in range(NOISY):
        closure = model.closure(q)
        c, lines = closure.misclosure_and_lines(pose)
        own = surplus(model.mechanism, closure.pose_matrix(pose, lines))
        joint = closure.joint_matrix(pose, lines)
        turned = np.swapaxes(joint, -1, -2)
        c = c[..., None] + own @ gaps[..., None]
        q = q - np.asarray(linalg.solve(turned @ joint, turned @ c))[..., 0]
    return q


def predicted(setup: MeasurementSetup, q: Array, pose: Array) -> Array:
    """Return the rms position error (T,) that the linear model expects after calibration, m.

    At joints (T, k) and poses (T, 6), of the target as the instrument sees it.
    """
    problem, mechanism = setup.problem, setup.mechanism
    name = problem.datasets[0].name
    knowledge = ParameterCovariance(problem.columns, setup.linear.covariance, {},
                                    {name: problem.opens[0].about}, {})
    rows = unknown_environment(*q.shape)
    jacobian = prediction_jacobian(Model(mechanism), setup.instrument.registration, pose, q,
                                   knowledge, name, rows)
    part = jacobian[:, :mechanism.motion.axes]
    square = np.einsum("tmi,ij,tmj->t", part, setup.linear.covariance, part)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _moved(now: Calibrated, step: Array, free: list[int], open_: NuisanceColumns) -> Calibrated:
    """Return parameters and registrations moved by steps (M, C)."""
    g = now.g.copy()
    g[:, free] += step[:, :len(free)]
    return Calibrated(g, open_.moved(now.registration, step), now.settled)


def _residual(
    shown: tuple[Array, Array], predicted: tuple[Array, Array], setup: MeasurementSetup
) -> Array:
    """Return shown - predicted (R, m) as the instrument has it: m, rad, m."""
    kind, motion = setup.instrument.kind, setup.mechanism.motion
    if kind.along_line:
        far, near = (np.linalg.norm(p[0], axis=1) for p in (shown, predicted))
        return np.asarray((far - near)[:, None])
    both = np.concatenate([shown[0] - predicted[0], turn_between(shown[1], predicted[1])],
                          axis=1)
    return np.asarray(both[:, list(kind.coordinates(motion))])
