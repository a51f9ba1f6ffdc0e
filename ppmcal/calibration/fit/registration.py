"""Closed-form start for an unknown frame and target: measured = frame o pose o target.

Rotations first (they do not depend on any origin), then frame origin and target point as
one linear problem. For position-only data the start is the rigid alignment of the platform
origins, which a small target offset only perturbs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.fit.observation import rotation_residual, wrapped
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.instrument_readings import levelled, own_readings
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import predict
from ppmcal.kinematics.tables import refuse_singular_home
from ppmcal.linalg import Array, finite_rows, nearest_rotation
from ppmcal.model.dataset import Dataset
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import Motion
from ppmcal.model.registration import Registration


def start_scalar(data: Dataset, pose: Array, registration: Registration, motion: Motion
                 ) -> Registration:
    """Return the registration from which a fit of heights or distances starts.

    Args:
        data: heights, or distances.
        pose: platform motors at the rows' joint values (N, 8 or 16).
        registration: with known values, zeros elsewhere.
        motion: the machine's motion.

    Raises:
        BadInput: fewer rows than a flat or a point needs.
    """
    if not data.frame.fitted or data.to_q is not None:
        return registration
    rows = np.flatnonzero(finite_rows(pose) & np.isfinite(data.value))
    if rows.size < 3:
        raise _few(rows.size, "frame", data)
    point, _ = predict(registration, pose[rows])
    assert data.kind.start is not None
    step = data.kind.start(point, data.value[rows], motion)
    return replace(registration, frame=cga.compose(pose_motor(step), registration.frame))


def unscaled(data: Dataset) -> Dataset:
    """Return measurements divided by the file's scale, known or initial."""
    scale = float(data.scale.value[0])
    return data if scale == 1.0 else replace(data, position=data.position / scale,
                                             value=data.value / scale)


SUSPECT, BLUNDER = 5.0, 10.0
"""A row off by this many medians makes the start a robust one; one then off by so many medians is
ignored by the start."""
SUBSET, TRIALS, CONCENTRATED, DECIDING, ENOUGH = 6, 60, 5, 2000, 20_000
"""Rows per trial alignment, number of trials, rounds in which the nearer half decides, rows that
judge a trial (least trimmed squares, Rousseeuw and Van Driessen 1999), and maximum number of rows
aligned, since a fit only starts here."""


def start_registration(data: Dataset, pose: Array, mechanism: Mechanism) -> Registration:
    """Return initial frame and target; for an encoder at a joint its offset.

    Args:
        data: the measurements; known parts of frame and target are kept.
        pose: platform motors at the rows' joint values (N, 8), nan rows are ignored.
        mechanism: the machine; an unknown target may be as far away as the machine reaches.

    Raises:
        BadInput: fewer rows than an unknown frame or target needs.
    """
    motion, size = mechanism.motion, mechanism.reach
    registration = Registration.of_pose(data.frame.value, data.target.value,
                                        data.target_rotation.value)
    if data.kind.placed is not None:
        return _with_offset(data, pose, registration, mechanism)
    if not data.frame.fitted and not data.target.fitted and not data.target_rotation.fitted:
        return registration
    if data.kind.aligned is not None:
        return _levelled(data, pose, registration, mechanism)
    if data.kind.scalar:
        return start_scalar(data, pose, registration, motion)
    planar = motion.planar
    position = np.where([False, False, planar], 0.0, data.position)
    rows = np.flatnonzero(finite_rows(position) & finite_rows(pose))
    if rows.size < 3:
        raise _few(rows.size, "frame or target", data)
    rows = rows[np.linspace(0, rows.size - 1, min(rows.size, ENOUGH)).astype(int)]
    plain = _aligned(data, pose, position, rows, registration, planar, size)
    if rows.size < 2 * SUBSET:
        return plain
    some = rows[np.linspace(0, rows.size - 1, min(rows.size, DECIDING)).astype(int)]

    def misses(of: NDArray[np.int64], at: Registration) -> Array:
        return _misses(data, pose, position, of, at, motion)

    away = misses(some, plain)
    if np.max(away) <= SUSPECT * np.median(away):
        return plain
    rng = np.random.default_rng(0)
    trials = [_aligned(data, pose, position, rng.choice(some, SUBSET, replace=False), registration,
                       planar, size) for _ in range(TRIALS)]
    best = min([plain, *trials], key=lambda t: float(np.median(misses(some, t))))
    for _ in range(CONCENTRATED):
        # least trimmed squares: the nearer half decides, again and again
        away = misses(some, best)
        best = _aligned(data, pose, position, some[away <= np.median(away)], registration, planar,
                        size)
    away = misses(rows, best)
    near = rows[away <= BLUNDER * np.median(away)]
    return _aligned(data, pose, position, near, registration, planar, size)


def _with_offset(data: Dataset, pose: Array, registration: Registration, mechanism: Mechanism
                 ) -> Registration:
    """Return the registration with the offset that minimises a joint's errors in the median."""
    registration = replace(registration, offset=float(data.offset.value[0]))
    rows = np.flatnonzero(finite_rows(pose) & np.isfinite(data.value))
    if not data.offset.fitted:
        return registration
    if rows.size < 3:
        raise _few(rows.size, "offset", data)
    away = data.value[rows] - own_readings(data.kind, Registration(), Model(mechanism),
                                           data.q[rows], pose[rows])[:, 0]
    if data.kind.quantity == "angle":
        middle = float(np.angle(np.exp(1j * away).sum()))
        away = middle + wrapped(away - middle)
    return replace(registration, offset=float(np.median(away)))


def _levelled(data: Dataset, pose: Array, registration: Registration, mechanism: Mechanism
              ) -> Registration:
    """Return the registration with the base tilt and sensor mounting that best fit the angles."""
    angles = np.concatenate([data.position, data.rotation], axis=1)[
        :, list(data.kind.coordinates(mechanism.motion))]
    rows = np.flatnonzero(finite_rows(angles) & finite_rows(pose))
    if rows.size < 3:
        raise _few(rows.size, "tilt of the base or rotation of the sensor", data)
    up, still = levelled(mechanism), np.zeros(3)
    body = cga.rotation_matrix(cga.motor_from_rotation_vector(registration.target_rotation, still))
    assert data.kind.aligned is not None
    frame, body = data.kind.aligned(
        angles[rows], up @ cga.rotation_matrix(pose[rows]),
        (cga.rotation_matrix(registration.frame), body @ up.T),
        (data.frame.fitted, data.target_rotation.fitted))
    turn = cga.rotation_vector(cga.motor_from_matrix(body @ up, still))
    return replace(registration, target_rotation=turn, frame=cga.motor_from_matrix(
        frame, cga.translation(registration.frame)))


def _few(rows: int, what: str, data: Dataset) -> BadInput:
    return BadInput(f"only {rows} usable rows, but an unknown {what} needs at least 3", data.source,
                    "Measure more poses")


def _aligned(data: Dataset, pose: Array, position: Array, rows: NDArray[np.int64],
             registration: Registration, planar: bool, size: float) -> Registration:
    """Return the closed-form registration of the given rows."""
    rotation, origin = cga.rotation_matrix(pose[rows]), cga.translation(pose[rows])
    turn, body = _rotations(data, rows, rotation, origin, position[rows], registration, planar)
    shift, target = _origins(data, turn, rotation, origin, position[rows], registration, planar,
                             size)
    return Registration(cga.motor_from_matrix(turn, shift), target,
                        cga.rotation_vector(cga.motor_from_matrix(body, np.zeros(3))))


def _misses(data: Dataset, pose: Array, position: Array, rows: NDArray[np.int64],
            registration: Registration, motion: Motion) -> Array:
    """Return the errors of rows under a registration (R,), m; rotations times the extent."""
    point, turn = predict(registration, pose[rows])
    away = np.linalg.norm(position[rows] - point, axis=1)
    extent = float(np.median(np.linalg.norm(
        position[rows] - np.median(position[rows], axis=0), axis=1)))
    angle = np.linalg.norm(rotation_residual(data.take(rows), turn, motion), axis=1) if (
        motion.measures_rotation_vectors and data.kind.sees_rotation) else np.zeros(rows.size)
    return np.asarray(away + extent * np.nan_to_num(angle) + 1e-300, dtype=float)


def no_pose(mechanism: Mechanism, data: Dataset) -> BadInput:
    """Return the refusal of a data set without any row that fits the machine.

    Raises:
        NoResult: home is singular, so that no way leads from it.
    """
    refuse_singular_home(mechanism)
    at_home = home_state(mechanism).q
    rows = data.q[finite_rows(data.q)]
    if not rows.size:
        return BadInput("no row has all joint values", data.source,
                        "Check the q columns, or the commanded poses and the home pose")
    seen = np.median(rows, axis=0)
    worst = int(np.argmax(np.abs(seen - at_home)))
    factor, unit = mechanism.joint_units[worst]
    unit = f" {unit}" if unit else ""
    name = mechanism.actuators[worst]
    return BadInput(
        f"none of the {len(data)} rows has a pose at its joint values: q_{name} is about "
        f"{seen[worst] / factor:.4g}{unit}, but {at_home[worst] / factor:.4g}{unit} at home",
        f"{data.source}: column q_{name}", "Check units in its sidecar, that no columns are "
        "swapped, and the home pose and offsets of the mechanism file")


def _rotations(data: Dataset, rows: NDArray[np.int64], rotation: Array, origin: Array,
               position: Array, registration: Registration, planar: bool) -> tuple[Array, Array]:
    """Return the rotations of frame and target (3, 3)."""
    body = cga.rotation_matrix(cga.motor_from_rotation_vector(registration.target_rotation,
                                                              np.zeros(3)))
    turn = cga.rotation_matrix(registration.frame)
    measured = data.rotation[rows]
    if planar:
        measured = measured * np.array([np.nan, np.nan, 1.0])
        measured = np.where(np.isfinite(measured[:, 2:]), np.nan_to_num(measured), np.nan)
    whole = finite_rows(measured)
    translational = bool(np.ptp(rotation, axis=0).max() < 1e-12)
    if whole.sum() < 3 or (translational and data.target_rotation.fitted) or (
            not data.kind.sees_rotation):
        if data.frame.fitted:
            turn = frame_turn(data, rotation, origin, position, registration, planar)
        return turn, body
    seen = cga.rotation_matrix(cga.motor_from_rotation_vector(measured[whole], np.zeros(3)))
    own = rotation[whole]
    if data.frame.fitted and data.target_rotation.fitted:
        turn = frame_turn(data, rotation, origin, position, registration, planar)
        for _ in range(50):
            body = mean_rotation(np.swapaxes(turn @ own, -1, -2) @ seen, planar)
            turn = mean_rotation(seen @ np.swapaxes(own @ body, -1, -2), planar)
    elif data.frame.fitted:
        turn = mean_rotation(seen @ np.swapaxes(own @ body, -1, -2), planar)
    elif data.target_rotation.fitted:
        body = mean_rotation(np.swapaxes(turn @ own, -1, -2) @ seen, planar)
    return turn, body


def _origins(data: Dataset, turn: Array, rotation: Array, origin: Array, position: Array,
             registration: Registration, planar: bool, size: float) -> tuple[Array, Array]:
    """Return frame origin and target (3,) each: linear least squares with a prior on the target.

    A platform that hardly turns hardly separates its target from the frame's origin, and errors of
    its nominal geometry would put both metres away. So the target is held near the file's value,
    with the weight of a miss of ``size``, m, against the residuals, which are errors of the
    machine and not noise: many rows are worth no more than a few.
    """
    shift, target = cga.translation(registration.frame), registration.target
    seen = turn @ rotation
    rest = position - origin @ turn.T - seen @ target
    blocks, columns = [], []
    if data.frame.fitted:
        blocks.append(np.broadcast_to(np.eye(3), seen.shape))
        columns.append("shift")
    else:
        rest = rest - shift
    if data.target.fitted:
        blocks.append(seen)
        columns.append("target")
    if not blocks:
        return shift, target
    matrix = np.concatenate(blocks, axis=-1).reshape(-1, 3 * len(blocks))
    solution = linalg.lstsq(matrix, rest.reshape(-1), rcond=1e-9)[0]
    if data.target.fitted:
        missed = float(np.linalg.norm(rest.reshape(-1) - matrix @ solution))
        held = np.concatenate([np.zeros((3, matrix.shape[1] - 3)), np.eye(3)], axis=1)
        solution = linalg.lstsq(np.concatenate([matrix, held * missed / size]),
                                np.concatenate([rest.reshape(-1), np.zeros(3)]), rcond=1e-9)[0]
    found = dict(zip(columns, solution.reshape(-1, 3), strict=True))
    flat = np.array([1.0, 1.0, 0.0]) if planar else np.ones(3)
    return (found.get("shift", shift) * flat,
            (target + found.get("target", np.zeros(3))) * flat)


# --- the frame's rotation, in closed form ---------------------------------------------------------

SEARCHED, REFINED, STEPS = 300, 5, 25
"""Number of frame rotations tried, number refined, and maximum number of steps."""
NEGLIGIBLE = 1e-6
"""Singular values below this part of the largest count as zero."""


def frame_turn(data: Dataset, rotation: Array, origin: Array, position: Array,
               registration: Registration, planar: bool) -> Array:
    """Return the frame's rotation (3, 3) from positions alone.

    With a known target: the rigid alignment of the points (Kabsch). With an unknown one the
    points are not known, and for a machine that hardly moves sideways its platform's origins
    are useless; then the rotation is searched, with frame origin and target linear.

    Args:
        data: says whether the target is known.
        rotation: of the platform in the base frame (n, 3, 3).
        origin: of the platform in the base frame (n, 3), m.
        position: as measured (n, 3), m.
        registration: holds the target if it is known.
        planar: turn about z only.
    """
    points = origin if data.target.fitted else origin + rotation @ registration.target
    a, b = points - points.mean(axis=0), position - position.mean(axis=0)
    rigid = nearest_rotation(b.T @ a, planar)
    if not data.target.fitted:
        return rigid
    some = np.linspace(0, len(origin) - 1, min(len(origin), DECIDING)).astype(int)
    form = _miss_form(rotation[some], origin[some], position[some])
    trials = np.concatenate([rigid[None], _all_turns(planar)])
    best = trials[np.argsort(_miss(form, trials), kind="stable")[:REFINED]]
    refined = _refined(form, best, planar)
    return np.asarray(refined[np.argmin(_miss(form, refined))])


def _all_turns(planar: bool) -> Array:
    """Return rotations (t, 3, 3) spread over all, from seeded quaternions; planar: angles."""
    if planar:
        angles = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
        return cga.rotation_matrix(cga.rotor(np.array([0.0, 0.0, 1.0]), angles))
    quaternions = np.random.default_rng(0).normal(size=(SEARCHED, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return cga.rotation_matrix(cga.motor_from_quaternion(quaternions, np.zeros(3)))


def _miss_form(rotation: Array, origin: Array, position: Array) -> Array:
    """Return F (k, 10): ``|F [vec T, 1]|`` is the least residual for a frame rotation T.

    Rotated back into the base, position i is ``T' y_i = s + o_i + R_i t``: the columns of the
    frame's origin s and the target t do not depend on T, and are projected out once for all T.
    """
    n = origin.shape[0]
    y, o = position - position.mean(axis=0), origin - origin.mean(axis=0)
    by_turn = np.einsum("nj,ik->nijk", y, np.eye(3)).reshape(-1, 9)
    matrix = np.concatenate([by_turn, -o.reshape(-1, 1)], axis=1)
    rest = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), rotation], axis=-1)
    left, size, _ = linalg.svd(rest.reshape(-1, 6))
    basis = left[:, size > NEGLIGIBLE * size[0]]
    return linalg.triangle(matrix - basis @ (basis.T @ matrix))


def _residual(form: Array, turns: Array) -> Array:
    """Return the residuals (t, k) of rotations (t, 3, 3)."""
    return np.asarray(turns.reshape(-1, 9) @ form[:, :9].T + form[:, 9])


def _miss(form: Array, turns: Array) -> Array:
    """Return the squared residuals (t,) of rotations (t, 3, 3)."""
    return np.asarray(np.sum(_residual(form, turns) ** 2, axis=1))


def _refined(form: Array, turns: Array, planar: bool) -> Array:
    """Gauss-Newton on rotations (t, 3, 3) at once; each stops where a step no longer helps."""
    axes = cross_matrix(np.eye(3))[2:] if planar else cross_matrix(np.eye(3))
    missed = _miss(form, turns)
    for _ in range(STEPS):
        by_turn = (axes @ turns[:, None]).reshape(len(turns), len(axes), 9) @ form[:, :9].T
        step = np.einsum("tak,tk->ta", -linalg.pinv(np.swapaxes(by_turn, 1, 2), NEGLIGIBLE),
                         _residual(form, turns))
        vector = np.zeros((len(turns), 3))
        vector[:, -len(axes):] = step
        moved = cga.rotation_matrix(cga.motor_from_rotation_vector(vector, np.zeros(3))) @ turns
        miss = _miss(form, moved)
        better = miss < missed
        if not better.any():
            break
        turns = np.where(better[:, None, None], moved, turns)
        missed = np.where(better, miss, missed)
    return turns


def mean_rotation(rotations: Array, planar: bool) -> Array:
    """Return the mean of rotations (n, 3, 3): the proper one nearest to their sum."""
    return nearest_rotation(rotations.sum(axis=0), planar)
