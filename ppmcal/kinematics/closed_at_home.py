"""Whether a machine closes at home within its file's accuracy, and how near dead points are.

"Closed" means closed within the last printed digit of every number, and three standard deviations
of the tolerances, propagated to each limb's closure equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.inverse import home_attempt, home_state, to_joint
from ppmcal.kinematics.transmission import transmissions_at
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

DEAD_POINT = 0.02
"""A limb's transmission at home below this is a finding."""
SAME = 1e-6
"""Conditions are independent if their smallest singular value exceeds this part of the largest."""
GOOD_TRANSMISSION = 0.5
"""A limb above this is not checked for tolerances that could bring it to a dead point."""


@dataclass(frozen=True)
class LimbGap:
    """A limb's gap at home with the file's q, and the gap allowed by digits and tolerances, m."""

    limb: str
    gap: float
    allowed: float

    @property
    def open(self) -> bool:
        """Whether the limb does not close."""
        return abs(self.gap) > self.allowed


@dataclass(frozen=True)
class Transmission:
    """How well a limb's joint moves the platform at home, and how far a dead point is.

    At a dead point (serial singularity) the two roots of the limb's inverse kinematics meet:
    an R-R limb is stretched or folded, a strut stands square to its rail.

    Attributes:
        limb: its name; kind: that of the limb.
        value: a pure number, 0 at a dead point, 1 at best: the sine of the joint's angle from
            it, or, for a prismatic joint, the part of its motion that goes along the strut.
        margin: the limb's reserve at home before it no longer reaches it, m.
        allowed: by how much digits and tolerances can change that, m.
    """

    limb: str
    kind: str
    value: float
    margin: float
    allowed: float

    @property
    def dead(self) -> bool:
        """Whether the limb is at a dead point, or its tolerances can bring it there."""
        return self.value < DEAD_POINT or self.margin < self.allowed


def home_gaps(mechanism: Mechanism) -> tuple[LimbGap, ...]:
    """Return each limb's gap at home with the file's q."""
    return _gaps(mechanism, mechanism.home_q) if np.isfinite(mechanism.home_q).all() else ()


def condition_gaps(mechanism: Mechanism) -> tuple[LimbGap, ...]:
    """Return the limbs that are open at home whatever the drives do, if the file gives no q."""
    if np.isfinite(mechanism.home_q).all():
        return ()
    return tuple(g for g in _gaps(mechanism, home_attempt(mechanism).q) if g.open)


def _gaps(mechanism: Mechanism, q: Array) -> tuple[LimbGap, ...]:
    """Return each limb's worst gap at home at joint values ``q`` (k,)."""
    model = Model(mechanism)
    everything = tuple(range(len(mechanism.parameters)))
    closure = model.closure(q, everything)
    gap = closure.lengths(mechanism.home[None])[0]
    allowed = _allowed(closure)
    out, row = [], 0
    for limb in mechanism.limbs:
        rows = slice(row, row + limb.kind.surface.equations)
        row = rows.stop
        worst = int(np.argmax(np.abs(gap[rows]) - allowed[rows]))
        out.append(LimbGap(limb.name, float(gap[rows][worst]), float(allowed[rows][worst])))
    return tuple(out)


def transmissions(mechanism: Mechanism) -> tuple[Transmission, ...]:
    """Return how well each driven limb's joint moves the platform at home.

    Raises:
        BadInput: the home pose cannot be reached.
    """
    model, pose, state = Model(mechanism), mechanism.home[None], home_state(mechanism)
    values, roots = transmissions_at(model, pose, state.q[None])
    everything = tuple(range(len(mechanism.parameters)))
    out, row = [], 0
    for i, limb in enumerate(mechanism.limbs):
        if not limb.driven:
            row += limb.kind.surface.equations
            continue
        pair, value = roots[0, i], float(values[0, i])
        half = float(pair[1] - pair[0]) / 2.0
        margin, allowed = np.inf, 0.0
        if value < GOOD_TRANSMISSION and half > 0.0:
            # the double root, on the closer side for this limb
            meet = float(pair[0]) + half + (np.pi if limb.kind.actuator != "length"
                                            and np.cos(half) < 0.0 else 0.0)
            q = state.q.copy()
            q[limb.actuator] = to_joint(model, i, np.array([meet]))[0]
            closure = model.closure(q, everything)
            margin = abs(float(closure.lengths(pose)[0, row]))
            allowed = float(_allowed(closure)[row])
        out.append(Transmission(limb.name, limb.kind.name, value, margin, allowed))
        row += limb.kind.surface.equations
    return tuple(out)


def held_twice(mechanism: Mechanism) -> int:
    """Return the number of redundant conditions at home among those that no drive changes."""
    closure = Model(mechanism).closure(home_attempt(mechanism).q)
    pose = mechanism.home[None]
    lines = closure.lines(pose)
    driven = np.abs(closure.joint_matrix(pose, lines)[0]).max(axis=1) > 0.0
    a = closure.pose_matrix(pose, lines)[0][~driven]
    a[:, [c >= 3 for c in mechanism.dof]] /= mechanism.length_scale
    if not a.size or not np.isfinite(a).all():
        return 0
    singular = linalg.singular_values(a[None])[0]
    return len(a) - int(np.sum(singular > SAME * singular[0]))


def _allowed(closure: Closure) -> Array:
    """Return the change of closure equations at home by last digits and tolerances (d,), m.

    ``closure`` must have been built for every parameter.
    """
    mechanism, pose = closure.model.mechanism, closure.model.mechanism.home[None]
    slopes = closure.error_matrix(pose, tuple(range(len(mechanism.parameters))))[0]
    digits = np.array([_digit(mechanism, p.quantity, p.value) for p in mechanism.parameters])
    tau = np.array([p.tolerance if p.tolerance is not None and np.isfinite(p.tolerance)
                    and not p.fixed else 0.0 for p in mechanism.parameters])
    joint_digits = np.array([_digit(mechanism, q, v) for q, v in
                             zip(mechanism.actuator_quantity, mechanism.home_q, strict=True)])
    pose_digits = np.array([_digit(mechanism, "length" if c < 3 else "angle",
                                   mechanism.home_pose[c]) for c in mechanism.dof])
    return np.asarray(np.abs(slopes) @ digits + np.abs(closure.joint_matrix(pose)[0]) @ joint_digits
                      + np.abs(closure.pose_matrix(pose)[0]) @ pose_digits
                      + 3.0 * np.sqrt(slopes**2 @ tau**2) + 1e-9 * mechanism.reach)


def _digit(mechanism: Mechanism, quantity: str, value: float) -> float:
    """Half the last printed digit; a plain 0 is exact by intent (an origin, an axis)."""
    return 0.0 if value == 0.0 else float(mechanism.digits.get(quantity, 0.0))
