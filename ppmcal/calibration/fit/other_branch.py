"""Limbs that were measured the other way round than the file says: another elbow, another branch.

Forward kinematics close with either, so such a machine fits as well; commands would be joint values
at which it was never seen.
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
"""A row is at the other root where it is off that by less than this part of what they are apart."""
Ranges = Mapping[str, tuple[float, float]]


def both_ways(model: Model, index: int, pose: Array, near: float) -> Array:
    """Return joint values (N, 2) of a limb at poses (N, 8): as the file says, and the other way.

    Whole turns are those next to ``near``; nan where it cannot reach.
    """
    roots = to_joint(model, index, limb_roots(model, index, pose)[0])
    own = 1 if home_state(model.mechanism).roots[index] > 0 else 0
    return wrapped(model.mechanism, model.mechanism.limbs[index].actuator,
                   roots[:, [own, 1 - own]], near)


def branch_findings(problem: Problem, state: State) -> list[Note]:
    """Return which limbs most rows show the other way round, a sentence each."""
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
            out.append(Note(f"limb '{limb.name}' was measured the other way round than the file "
                            f"says: {problem.mechanism.actuators[limb.actuator]} at {seen}, where "
                            f"its '{limb.kind.branch}' gives {said} for the same poses, and so "
                            f"would commands. Set '{limb.kind.branch}', or the home joint values, "
                            "the other way", topic="branch"))
    return out


def _range(mechanism: Mechanism, actuator: int, values: Array) -> str:
    factor, unit = mechanism.joint_units[actuator]
    return f"{values.min() / factor:.4g} to {values.max() / factor:.4g} {unit}".rstrip()


def in_other_branch(model: Model, pose: Array, q: Array, ranges: Ranges
                    ) -> Iterator[tuple[int, str]]:
    """Yield which commands are outside what was measured where the limb's other way is inside it.

    Args:
        model: the identified machine.
        pose: the platform's motors (N, 8).
        q: commands (N, k).
        ranges: what was measured, by column (``q_leg1`` ...), SI.

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
            yield n, (f"limb '{limb.name}' the other way round than it was measured: {name} = "
                      f"{here[n] / factor:.6g} {unit}".rstrip() + ", measured "
                      f"{low / factor:.6g} to {high / factor:.6g} {unit}".rstrip()
                      + f"; its '{limb.kind.branch}' is the other one")
