"""Other assemblies: poses that close at the same joint values as the one reached from home.

One of them may be how the machine is assembled, mirrored. Or, with surplus limbs: while the
geometry is off, they may close best on either side of the true platform pose, and rows reached from
home end up on the wrong one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, newton
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism, joint_points

STARTS, MOST = 64, 6
"""Poses about the base from which assemblies are searched, and how many of these are tried."""
SAME = 1e-6
"""Poses closer than this part of the reach are the same assembly."""


def middle_row(datasets: Sequence[Dataset]) -> Array | None:
    """Return the joint values (k,) in the middle of all measured ones, None if there are none."""
    q = np.concatenate([d.q for d in datasets])
    q = q[finite_rows(q)]
    if not len(q):
        return None
    away = (q - np.median(q, axis=0)) / (np.ptp(q, axis=0) + 1e-12)
    return np.asarray(q[np.argmin(np.linalg.norm(away, axis=1))])


def assembled_at(mechanism: Mechanism, pose: Array, q: Array) -> Mechanism:
    """Return the machine with its home at a pose (6,) and joint values (k,), limbs unchanged."""
    limbs = tuple(limb if limb.kind.strut else replace(limb, branch=None)
                  for limb in mechanism.limbs)
    return replace(mechanism, home_pose=pose, home_q=q, limbs=limbs)


def other_starts(problem: Problem, state: State) -> Iterator[State]:
    """Yield states with the rows' poses reached from each other assembly of their middle row."""
    middle = middle_row(problem.datasets)
    if middle is None:
        return
    for pose in assemblies(problem.mechanism, middle):
        there = Model(assembled_at(problem.mechanism, pose, middle))
        yield replace(state, poses=tuple(problem.reached(i, there)
                                         for i in range(len(problem.datasets))))


def assemblies(mechanism: Mechanism, q: Array) -> Iterator[Array]:
    """Yield the poses (6,) at which the nominal machine closes at joint values (k,), each once.

    The pose reached from home is left out.
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
