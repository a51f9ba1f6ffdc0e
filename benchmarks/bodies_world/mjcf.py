"""MJCF as text: elements, solver settings, and the parts that all machines have.

Lengths are in m, masses in kg, angles in rad.

Loops are closed by ``connect`` constraints. MuJoCo's constraints are soft: at rest one gives way by
(1 - d)/d A f/k under the force f, with A the inverse of the mass that it moves and
k = 1/(TIME d)² for small dampings. d is at its largest, 0.9999, and TIME two steps, so that
100 N on 1 kg open a loop by 0.01 um. Armature (reflected inertia of a rotor, which has no
weight) keeps A small where bodies are light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np

STEP = 5e-4
"""Time step, s,"""
TIME = 1e-3
"""and time constant of a constraint, s."""
HARD = f'solref="{TIME} 1" solimp="0.9999 0.9999 0.001 0.5 2"'
STUCK = {"solreffriction": f"{TIME} 1", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}
LIGHT = 0.05
"""Mass of a link, kg: links are light, their weight is no part of any file."""


@dataclass(frozen=True)
class Faults:
    """What is not rigid, straight or smooth in a world.

    ``drive``: stiffness of the spring between encoder and load side of every drive, N/m or
    N m/rad; ``friction``: of the load side, N or N m; ``fold``: stiffness of the hinge that
    halves the platform, N m/rad; ``stand``: stiffness of the ball joint below the base, N m/rad;
    ``lean``: turns of the weight about the base's x and y, rad. None: there is none.
    """

    drive: float | None = None
    friction: float = 0.0
    fold: float | None = None
    stand: float | None = None
    lean: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Drive:
    """A motor: type of its joint (``slide``, ``hinge``), inertia of its rotor, gains of its servo.

    ``rotor``: kg or kg m²; ``gain``: N/m or N m/rad; ``damping``: per second of these.
    """

    joint: str
    rotor: float
    gain: float
    damping: float


SLIDE = Drive("slide", 1.0, 2e6, 4e3)
HINGE = Drive("hinge", 0.1, 2e5, 3e2)


def text(value: object) -> str:
    """Return an attribute: numbers with 17 digits."""
    if isinstance(value, str):
        return value
    return " ".join(f"{v:.17g}" for v in np.atleast_1d(np.asarray(value, dtype=float)))


def element(tag: str, children: Sequence[str] = (), **attributes: object) -> str:
    """Return an element; a trailing underscore of a name is left out (``class_``)."""
    head = "".join(f" {k.rstrip('_')}={quoteattr(text(v))}" for k, v in attributes.items())
    return f"<{tag}{head}/>" if not children else f"<{tag}{head}>{''.join(children)}</{tag}>"


def inertia(mass: float, size: float = 0.1) -> str:
    """Return the inertia of a body as of a ball of a radius, its centre at the body's origin."""
    return element("inertial", pos=[0, 0, 0], mass=mass, diaginertia=[0.4 * mass * size**2] * 3)


def joint(kind: str, axis: Sequence[float], rotor: float, **more: object) -> str:
    """Return a joint; ``rotor``: inertia without weight, also what damps it."""
    return element("joint", type=kind, axis=axis, armature=rotor, **more)


def driven(name: str, drive: Drive, axis: Sequence[float], at: float, faults: Faults,
           children: Sequence[str]) -> tuple[str, str]:
    """Return a drive's bodies, and the name of that to which ``children`` belong.

    The motor's joint is what the encoder reads: ``at`` in the pose in which the world is put
    together. Where drives yield, the load side has a joint of its own beside the motor's, with
    friction on what both stand on; a spring between them (``spring``) moves it.
    """
    motor = joint(drive.joint, axis, drive.rotor, name=name, ref=at)
    if faults.drive is None:
        return element("body", [motor, inertia(LIGHT), *children], name=f"{name}_load"
                       ), f"{name}_load"
    rubbing = {"frictionloss": faults.friction, **STUCK} if faults.friction else {}
    load = joint(drive.joint, axis, drive.rotor, name=f"{name}_after", ref=at, **rubbing)
    return (element("body", [motor, inertia(LIGHT)], name=f"{name}_motor")
            + element("body", [load, inertia(LIGHT), *children], name=f"{name}_load")
            ), f"{name}_load"


def spring(name: str, drive: Drive, faults: Faults) -> str:
    """Return what a motor moves its load side by: a spring that is loose where both are alike."""
    damping = 2.0 * float(np.sqrt((faults.drive or 0.0) * 3.0 * drive.rotor))
    both = [element("joint", joint=f"{name}{end}", coef=coef)
            for end, coef in (("", 1.0), ("_after", -1.0))]
    return element("fixed", both, name=f"{name}_spring", stiffness=faults.drive, damping=damping,
                   springlength=0.0)


def connect(one: str, other: str, anchor: Sequence[float]) -> str:
    """Return a loop closed: the point of body ``one`` that is, as assembled, also on ``other``."""
    return (f'<connect body1="{one}" body2="{other}" anchor="{text(anchor)}" {HARD}/>')


def servo(name: str, drive: Drive) -> str:
    """Return a motor's position servo."""
    return element("position", name=name, joint=name, kp=drive.gain, kv=drive.damping)


def weight(lean: tuple[float, float]) -> np.ndarray:
    """Return the acceleration of gravity (3,), m/s², turned about x, then y."""
    (sx, sy), (cx, cy) = np.sin(lean), np.cos(lean)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return about_y @ about_x @ np.array([0.0, 0.0, -9.80665])


def model(bodies: Sequence[str], loops: Sequence[str], motors: Sequence[str], drive: Drive,
          faults: Faults) -> str:
    """Return the whole file."""
    option = element(
        "option", [element("flag", refsafe="disable", contact="disable")], timestep=STEP,
        integrator="implicitfast", solver="Newton", tolerance=1e-14, iterations=100,
        gravity=weight(faults.lean))
    springs = [spring(n, drive, faults) for n in motors] if faults.drive is not None else []
    return element("mujoco", [
        element("compiler", angle="radian", autolimits="true"), option,
        element("worldbody", bodies), element("equality", loops), element("tendon", springs),
        element("actuator", [servo(n, drive) for n in motors])])
