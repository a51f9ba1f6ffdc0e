"""Limbs measured in the opposite branch to the file's: the other elbow, the other root.

Forward kinematics close with either, so such a machine fits as well; but commands would be joint
values at which it was never measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state, to_joint, wrapped
from ppmcal.kinematics.limb_roots import limb_roots
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note

AT = 0.1
"""A row is at the other root if it is closer to it than this part of the roots' distance."""
Ranges = Mapping[str, tuple[float, float]]


def both_ways(model: Model, index: int, pose: Array, near: float) -> Array:
    """Return joint values (N, 2) of a limb at poses (N, 8): of the file's branch, and the other.

    Whole turns are those closest to ``near``; nan where it cannot reach.
    """
    roots = to_joint(model, index, limb_roots(model, index, pose)[0])
    own = 1 if home_state(model.mechanism).roots[index] > 0 else 0
    return wrapped(model.mechanism, model.mechanism.limbs[index].actuator,
                   roots[:, [own, 1 - own]], near)


def branch_findings(problem: Problem, state: State) -> list[Note]:
    """Return the limbs that most rows show in the opposite branch, one note each."""
    model = Model(problem.mechanism.with_values(state.g))
    ends = [e for i in range(len(problem.datasets)) for e in problem.ends(i, state)]
    q, pose = (np.concatenate(part) for part in zip(*ends, strict=True))
    good = finite_rows(q) & finite_rows(pose)
    q, pose = q[good], pose[good]
    out = []
    for index, limb in enumerate(model.mechanism.limbs):
        if limb.kind.branch is None or not good.any():
            continue
        here = q[:, limb.actuator]
        both = both_ways(model, index, pose, float(np.median(here)))
        with np.errstate(invalid="ignore"):
            other = np.abs(here - both[:, 1]) < AT * np.abs(both[:, 0] - both[:, 1])
        if 2 * int(other.sum()) > other.size:
            seen, said = (_range(problem.mechanism, limb.actuator, v[other])
                          for v in (here, both[:, 0]))
            out.append(Note(f"limb '{limb.name}' was measured in the opposite branch to the "
                            f"file's: {problem.mechanism.actuators[limb.actuator]} at {seen}, "
                            f"where its '{limb.kind.branch}' gives {said} for the same poses, and "
                            f"so would commands. Reverse '{limb.kind.branch}', or change the home "
                            "joint values", topic="branch"))
    return out


def _range(mechanism: Mechanism, actuator: int, values: Array) -> str:
    factor, unit = mechanism.joint_units[actuator]
    return f"{values.min() / factor:.4g} to {values.max() / factor:.4g} {unit}".rstrip()


def in_other_branch(model: Model, pose: Array, q: Array, ranges: Ranges
                    ) -> Iterator[tuple[int, str]]:
    """Yield commands outside the measured range for which the limb's other branch is inside it.

    Args:
        model: the identified machine.
        pose: the platform's motors (N, 8).
        q: commands (N, k).
        ranges: measured ranges by column (``q_leg1`` ...), SI.

    Yields:
        index of the row, and the reason to refuse it.
    """
    mechanism = model.mechanism
    for index, limb in enumerate(mechanism.limbs):
        name = mechanism.actuators[limb.actuator]
        if limb.kind.branch is None or f"q_{name}" not in ranges:
            continue
        low, high = ranges[f"q_{name}"]
        here = wrapped(mechanism, limb.actuator, q[:, limb.actuator], 0.5 * (low + high))
        rows = np.flatnonzero(((here < low) | (here > high)) & finite_rows(pose))
        if not rows.size:
            continue
        other = both_ways(model, index, pose[rows], 0.5 * (low + high))[:, 1]
        factor, unit = mechanism.joint_units[limb.actuator]
        for n in rows[(other >= low) & (other <= high)].tolist():
            yield n, (f"limb '{limb.name}' in the opposite branch to the measured one: {name} = "
                      f"{here[n] / factor:.6g} {unit}".rstrip() + ", measured "
                      f"{low / factor:.6g} to {high / factor:.6g} {unit}".rstrip()
                      + f"; reverse its '{limb.kind.branch}'")
