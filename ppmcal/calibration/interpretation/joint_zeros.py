"""Joints with another zero than in the mechanism file: its home is elsewhere.

A machine whose drives are set to zero at home has its lengths there as offsets. If the platform
stood decimetres from the file's home then, limbs contradict each other so smoothly that the
geometry bends to fit, as if it were another machine. One constant for each joint then explains
joint values alone, and does so with a geometry within its tolerances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import (
    Fit,
    Problem,
    State,
    distances,
    explained_distances,
    identify,
    posterior,
)
from ppmcal.calibration.interpretation.interpretation_error import FileFault, Interpretation
from ppmcal.calibration.interpretation.limits import ALLOWED, FAR, LANDS, TELLING
from ppmcal.calibration.interpretation.score import rms, tolerances_away
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_vector, pose_words
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import number

STEPS, STILL = 12, 1e-6
"""Steps towards the zeros with the geometry fixed: if they are the cause, a few are enough."""
MOST_OUT = 1.0 / 3.0
"""Part of rows left out beyond which the others prove nothing."""


@dataclass(frozen=True, eq=False)
class JointZeros:
    """Amounts by which joints read too little (k,), unit of q, with standard uncertainties.

    ``mechanism``: fitted together with them; ``times``: residuals relative to the noise.
    """

    mechanism: Mechanism
    shift: Array
    sigma: Array
    times: float

    @property
    def far(self) -> list[int]:
        """Joints whose zero is off by more than their tolerances and the fit leave open."""
        return np.flatnonzero(np.abs(self.shift) > FAR * self.sigma).tolist()

    @property
    def home(self) -> Array | None:
        """Platform pose at home's joint values (8,), None if limbs do not meet."""
        model = Model(self.mechanism)
        q = home_state(self.mechanism).q + self.shift
        closure = model.closure(q[None])
        pose, found, _ = newton(closure, self.mechanism.home[None])
        if not found[0] or len(self.far) < 2:
            return None
        apart = np.linalg.norm(closure.lengths(pose))
        allowed = np.linalg.norm(closure.joint_matrix(pose)[0] * self.sigma)
        return pose[0] if apart <= LANDS * allowed else None


def joint_zeros(problem: Problem) -> JointZeros | None:
    """Return the constants with which joint values alone are of this machine, or None."""
    mechanism, datasets = problem.mechanism, problem.datasets
    if (not problem.blind or problem.earlier is not None or not problem.free
            or any(d.homing != "shared" for d in datasets)):
        return None
    k = len(mechanism.actuators)
    if mechanism.surplus * sum(map(len, datasets)) < 2 * k * len(datasets):
        return None    # so few numbers would agree with any machine
    shifted = replace(problem, pivots=None, given=None, datasets=tuple(
        replace(d, homing="alone") for d in datasets))
    try:
        near = [replace(r, homing=_shift_of_nominal(Model(mechanism), d.q)) for d, r in
                zip(datasets, problem.start().registrations, strict=True)]
        start = State(mechanism.values, tuple(near), tuple(
            np.tile(mechanism.home, (len(d), 1)) for d in datasets))
        start = shifted.solve(start)
        rows = [finite_rows(pose) for pose in start.poses]
        if explained_distances(shifted, start).times(rows) > LANDS:
            return None
        return _judged(identify(shifted, start=start))
    except PpmcalError:
        return None


def _shift_of_nominal(model: Model, q: Array) -> Array:
    """Return the constants (k,) with which limbs of the nominal machine agree best at q (N, k)."""
    shift, q = np.zeros(q.shape[1]), q[finite_rows(q)]
    home = np.tile(model.mechanism.home, (len(q), 1))
    for _ in range(STEPS):
        closure = model.closure(q + shift)
        pose, good, _ = newton(closure, home)
        if not good.any():
            break
        c, lines = closure.misclosure_and_lines(pose)
        a, by = closure.pose_matrix(pose, lines), closure.joint_matrix(pose, lines)
        free = np.eye(a.shape[1]) - a @ linalg.pinv(a)    # what poses cannot absorb
        rows, left = (free @ by)[good], (free @ c[..., None])[good, :, 0]
        step = linalg.pinv(rows.reshape(-1, len(shift))) @ -left.ravel()
        shift = shift + step
        if np.abs(step).max() < STILL * model.mechanism.reach:
            break
    return shift


def _judged(fit: Fit) -> JointZeros | None:
    """Return the joint zeros if a fit with them is sound and all files have the same ones."""
    problem, state = fit.problem, fit.state
    rows = sum(map(len, problem.datasets))
    times = distances(problem, state).times(fit.keep)
    if (not fit.converged or sum(int(k.sum()) for k in fit.keep) < (1.0 - MOST_OUT) * rows
            or times > TELLING or rms(tolerances_away(problem, state)) > ALLOWED):
        return None
    variance = np.diagonal(posterior(fit)) * max(1.0, times) ** 2
    shift = np.stack([r.homing for r in state.registrations])
    sigma = np.sqrt(np.stack([variance[o.homing] for o in problem.opens]))
    found = JointZeros(problem.mechanism.with_values(state.g), shift.mean(axis=0),
                       sigma.max(axis=0), times)
    alike = np.all(np.abs(shift - found.shift) <= FAR * found.sigma)
    return found if found.far and alike else None


def zeros_elsewhere(problem: Problem) -> tuple[Interpretation, ...]:
    """Return that joints count from another zero, and where home is then; empty if they do not."""
    found = joint_zeros(problem)
    if found is None:
        return ()
    mechanism, home = problem.mechanism, found.home
    names = [f"q_{a}" for a in mechanism.actuators]
    which = found.far if home is None else list(range(len(names)))
    words = ", ".join(f"{names[a]} {found.shift[a] / factor:+.4g} {unit}".rstrip()
                      for a in which for factor, unit in [mechanism.joint_units[a]])
    off = (f"joint zeros are off by {words} (to be added to the readings); with them limbs "
           f"agree to {number(found.times, 2)} times the noise and the geometry is within its "
           "tolerances")
    text = off if home is None else (
        f"home is far off: at its joint values the platform stands at "
        f"{pose_words(mechanism, pose_vector(home[None])[0])}, not at "
        f"{pose_words(mechanism, pose_vector(mechanism.home[None])[0])}. So {off}")
    kind = "zero" if home is None else "home"
    return (Interpretation(mechanism.source, (FileFault(
        kind, tuple(names[a] for a in which), text),)),)
