"""Whether ropes can hold the platform at the mechanism file's home."""

from __future__ import annotations

from collections.abc import Iterator

from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.loads import tight_ropes
from ppmcal.linalg import range_basis
from ppmcal.model.mechanism import Mechanism, joint_points
from ppmcal.notes import Note

HINT = "Check the anchors, `gravity` and the home pose"


def not_held_at_home(mechanism: Mechanism) -> str:
    """Return that ropes cannot hold the platform at home, neither by each other nor by its weight.

    Empty if they can, and for machines other than those of surplus ropes alone.
    """
    if not mechanism.surplus or not all(limb.kind.pulls_only for limb in mechanism.limbs):
        return ""
    model, q, motor = Model(mechanism), home_state(mechanism).q[None], mechanism.home[None]
    if any(tight_ropes(model, q, motor, weight)[0] for weight in (False, True)):
        return ""
    anchors = joint_points(mechanism)[0]
    rank = range_basis(anchors - anchors.mean(axis=0), least=1e-6 * mechanism.reach).shape[1]
    where = {0: "point", 1: "line", 2: "plane"}[rank] if rank < mechanism.motion.axes else ""
    return ("the ropes cannot hold the platform at home: they cannot all pull, neither "
            "against each other nor with its weight" + bool(where) * (
                f". Their anchors lie in one {where}, and home is not where the platform hangs "
                "from it"))


def slack_at_home(mechanism: Mechanism) -> Iterator[Note]:
    """Yield :func:`not_held_at_home` as a finding."""
    told = not_held_at_home(mechanism)
    if told:
        yield Note(f"{told}. {HINT}.", topic="home")
