"""How tables of poses write spatial rotations: rotation vector, quaternion or Euler angles.

Euler angles stand in the columns ``euler_1, euler_2, euler_3``, in the order of the convention's
letters (:mod:`ppmcal.kinematics.rotations`) and in the file's angle unit.
"""

from __future__ import annotations

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.csv import Table
from ppmcal.io.pose_fields import COORDINATES, QUATERNION
from ppmcal.kinematics.rotations import CONVENTIONS
from ppmcal.model.mechanism import Mechanism

EULER = ("euler_1", "euler_2", "euler_3")
VECTOR = COORDINATES[3:]


def check_convention(name: str, mechanism: Mechanism) -> str:
    """Return the convention's name.

    Raises:
        BadInput: there is none of that name, or the machine does not rotate in space.
    """
    refuse_unknown("rotation convention", [name], CONVENTIONS, "--rotation")
    if name != "rotvec" and not mechanism.motion.turns_freely:
        turn = "its rotation is rz" if mechanism.motion.turns else "it does not turn"
        raise BadInput(f"a {mechanism.motion} machine has no spatial rotation: {turn}",
                       "--rotation", "Leave the option out")
    return name


def columns_of(convention: str) -> tuple[str, ...]:
    """Return the names of a convention's columns."""
    if convention == "rotvec":
        return VECTOR
    return QUATERNION if convention == "quat" else EULER


def under_vector_names(table: Table, convention: str) -> Table:
    """Return the table with its Euler angles under the names rx, ry, rz.

    Raises:
        BadInput: rotation columns of another convention, or Euler columns missing.
    """
    own = columns_of(convention)
    foreign = [c for c in (*VECTOR, *QUATERNION, *EULER) if c in table.header and c not in own]
    if convention == "rotvec":
        # a quaternion says by its columns' names that it is one; Euler angles beside are repeated
        turned = any(c in table.header for c in (*VECTOR, *QUATERNION))
        foreign = [] if turned else [c for c in foreign if c in EULER]
    if foreign:
        raise BadInput(f"the column {foreign[0]} is not of the rotation convention {convention}",
                       f"{table.source}: header", f"Name the rotation columns {', '.join(own)}, or "
                       "choose another --rotation")
    have = [c for c in EULER if c in table.header]
    if own != EULER or not have:
        return table
    missing = [c for c in EULER if c not in have]
    if missing:
        raise BadInput(f"there is no column {', '.join(missing)}", f"{table.source}: header",
                       f"Give all of {', '.join(EULER)}")
    names = dict(zip(EULER, VECTOR, strict=True))
    return table.named({c: names.get(c, c) for c in table.header})
