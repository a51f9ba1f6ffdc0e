"""Encoders that are of another assembly mode than home's: the machine was put together mirrored.

At the same drives' values the limbs close in other places too, and encoders at joints show which.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation.interpretation_error import FileFault, Interpretation
from ppmcal.calibration.interpretation.limits import ALLOWED, TELLING
from ppmcal.calibration.interpretation.score import Score, score
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, newton
from ppmcal.kinematics.partial_pose import pose_vector, pose_words
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism, joint_points
from ppmcal.wording import number

STARTS, MOST = 64, 6
"""Poses about the base from which assemblies are looked for, and how many of these are tried."""
SAME = 1e-6
"""Poses closer than this part of the reach are one assembly."""


def other_assembly(problem: Problem) -> tuple[Interpretation, ...]:
    """Return that encoders at joints are of another assembly mode, empty where they are not."""
    datasets, mechanism = problem.datasets, problem.mechanism
    if not datasets or not all(d.kind.placed is not None or d.kind.blind for d in datasets):
        return ()
    q = np.concatenate([d.q for d in datasets])
    q = q[finite_rows(q)]
    if not len(q):
        return ()
    middle = q[np.argmin(np.linalg.norm((q - np.median(q, axis=0)) / (np.ptp(q, axis=0) + 1e-12),
                                        axis=1))]
    tried = [(found.noise, pose) for pose in _assemblies(mechanism, middle)
             if _lands(found := _score_at(problem, pose, middle))]
    if not tried:
        return ()
    noise, pose = min(tried, key=lambda t: t[0])
    joints = ", ".join(
        f"{name} = {number(value / factor)} {unit}".rstrip() for name, value, (factor, unit) in
        zip(mechanism.actuators, middle.tolist(), mechanism.joint_units, strict=True))
    text = ("the machine is assembled another way round than the file says: its encoders agree to "
            f"{number(noise, 2)} times the noise where, at {joints}, the platform stands at "
            f"{pose_words(mechanism, pose)}")
    return (Interpretation(mechanism.source, (FileFault("assembly", ("home",), text),)),)


def _lands(found: Score) -> bool:
    return found.noise <= TELLING and found.geometry <= ALLOWED


def _score_at(problem: Problem, pose: Array, q: Array) -> Score:
    """Return the score of the machine whose home is a pose (6,) at joint values (k,)."""
    mechanism = problem.mechanism
    limbs = tuple(limb if limb.kind.strut else replace(limb, branch=None)
                  for limb in mechanism.limbs)
    home = replace(mechanism, home_pose=pose, home_q=q, limbs=limbs)
    return score(replace(problem, mechanism=home, pivots=None, given=None), np.inf)


def _assemblies(mechanism: Mechanism, q: Array) -> Iterator[Array]:
    """Yield poses (6,) at which the nominal machine closes at joint values (k,), each once.

    That which home leads to is none of them.
    """
    rng, size = np.random.default_rng(0), np.zeros((STARTS, 6))
    dof = list(mechanism.dof)
    half = np.where(np.arange(6) < 3, mechanism.reach, np.pi)
    size[:, dof] = (rng.uniform(-1.0, 1.0, size.shape) * half)[:, dof]
    # on both sides of the base, wherever home is
    middle = joint_points(mechanism)[0].mean(axis=0)
    start = mechanism.home_pose + size
    along = [c for c in dof if c < 3]
    start[:, along] = (middle + size[:, :3])[:, along]
    model = Model(mechanism)
    found, good, _ = newton(model.closure(np.tile(q, (STARTS, 1))),
                            cga.motor_from_rotation_vector(start[:, 3:], start[:, :3]))
    corners = np.vstack([np.zeros(3), np.eye(3) * mechanism.reach])
    own = forward(model, q[None]).pose
    seen = [cga.move_point(motor, corners) for motor in own[finite_rows(own)]]
    for motor in found[good]:
        points = cga.move_point(motor, corners)
        if all(np.abs(points - other).max() > SAME * mechanism.reach for other in seen):
            seen.append(points)
            yield pose_vector(motor[None])[0]
        if len(seen) > MOST:
            return
