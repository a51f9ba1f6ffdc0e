"""Three machines as bodies: a hexapod of six struts, a planar 3-RRR, a linear delta of six rods.

Every machine is assembled at its home pose, where joint centres and lengths say how long a strut
is or how high a carriage stands; from there on only MuJoCo says where it goes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .mjcf import (
    HINGE,
    LIGHT,
    SLIDE,
    Drive,
    Faults,
    connect,
    driven,
    element,
    inertia,
    joint,
    model,
)

PLATFORM = 1.0
"""Mass of a platform without payload, kg."""
PIVOT = np.array([0.0, 0.0, -0.2])
"""Of a stand that yields, m."""


@dataclass(frozen=True)
class Shape:
    """Geometry (m, rad): joint centres (L, 3) on the base and, in its axes, on the platform.

    ``lengths``: of links, (L,) each; ``offset`` (L,): what the encoder shows too little.
    """

    base: np.ndarray
    platform: np.ndarray
    lengths: dict[str, np.ndarray]
    offset: np.ndarray

    def wrong(self, rng: np.random.Generator, size: float, turn: float, axes: int) -> Shape:
        """Return it with errors of ``size`` in all lengths and the first ``axes`` coordinates.

        The encoders' zeros have errors of ``turn``.
        """
        keep = np.arange(3) < axes
        moved = [p + size * rng.normal(size=p.shape) * keep for p in (self.base, self.platform)]
        lengths = {k: v + size * rng.normal(size=v.shape) for k, v in self.lengths.items()}
        return Shape(*moved, lengths, self.offset + turn * rng.normal(size=self.offset.shape))


@dataclass(frozen=True)
class Machine:
    """A kind of machine: its name, motion, drives, home position (3,), m, nominal shape.

    ``reach`` (m or rad): joints go so far from home; ``build``: shape and faults to MJCF and the
    motors' values at home; ``limb``: name, shape and number of a limb to its record in a file.
    """

    name: str
    motion: str
    drive: Drive
    home: np.ndarray
    shape: Shape
    reach: float
    build: Callable[[Machine, Shape, Faults], tuple[str, np.ndarray]]
    kind: str
    more: dict[str, object] = field(default_factory=dict)

    @property
    def legs(self) -> list[str]:
        """Names of limbs, motors and joint columns."""
        return [f"leg{i + 1}" for i in range(len(self.shape.base))]


def circle(radius: float, angles_deg: list[float], z: float = 0.0) -> np.ndarray:
    """Return points on a circle (L, 3)."""
    a = np.radians(angles_deg)
    return np.column_stack([radius * np.cos(a), radius * np.sin(a), np.full(len(a), z)])


def payload(at: np.ndarray) -> str:
    """Return what the platform carries: a small body whose mass changes."""
    return element("body", [inertia(1e-6, 0.02)], name="payload", pos=at)


def platform(home: np.ndarray, faults: Faults, joints: list[str]) -> str:
    """Return the platform, measured at its origin.

    With a fold it is two plates on a hinge along its y axis: the instrument's mark and the payload
    are on the first of them, joints with x below 0 on the other.
    """
    parts = [*joints, inertia(PLATFORM), payload(np.zeros(3))]
    if faults.fold is not None:
        hinge = joint("hinge", [0, 1, 0], 1e-2, stiffness=faults.fold,
                      damping=2.0 * np.sqrt(0.05 * faults.fold), name="fold")
        parts.append(element("body", [hinge, inertia(0.5 * PLATFORM)], name="wing"))
    return element("body", parts, name="platform", pos=home)


def stand(bodies: list[str], faults: Faults) -> list[str]:
    """Return bodies of the base, on a ball joint with a spring where the stand yields."""
    if faults.stand is None:
        return bodies
    ball = element("joint", type="ball", stiffness=faults.stand, armature=1.0, name="stand",
                   damping=2.0 * np.sqrt(4.0 * faults.stand))
    inside = element("body", bodies, name="floor", pos=-PIVOT)
    return [element("body", [ball, inertia(20.0, 0.3), inside], name="stand", pos=PIVOT)]


def hexapod(machine: Machine, shape: Shape, faults: Faults) -> tuple[str, np.ndarray]:
    """Return six struts: a universal joint of two hinges, a sliding motor, a ball at the top."""
    tops = machine.home + shape.platform
    at = np.linalg.norm(tops - shape.base, axis=1)
    bodies, loops = [], []
    for i, name in enumerate(machine.legs):
        cross = [joint("hinge", axis, 1e-2) for axis in ([1, 0, 0], [0, 1, 0])]
        inner, last = driven(name, machine.drive, [0, 0, 1], at[i], faults, ())
        bodies.append(element("body", [*cross, inertia(LIGHT), inner], pos=shape.base[i],
                              zaxis=tops[i] - shape.base[i]))
        wing = faults.fold is not None and machine.shape.platform[i, 0] < 0.0
        loops.append(connect(last, "wing" if wing else "platform", [0, 0, at[i]]))
    bodies = [*stand(bodies, faults), platform(machine.home, faults, [element("freejoint")])]
    return model(bodies, loops, machine.legs, machine.drive, faults), at


def planar(machine: Machine, shape: Shape, faults: Faults) -> tuple[str, np.ndarray]:
    """Return three cranks with a rod each, all hinges along z; elbows turn left from the crank."""
    tops = machine.home + shape.platform
    arm, rod = shape.lengths["proximal"], shape.lengths["distal"]
    away = tops - shape.base
    far = np.linalg.norm(away, axis=1)
    inside = np.arccos((arm**2 + far**2 - rod**2) / (2.0 * arm * far))
    at = np.arctan2(away[:, 1], away[:, 0]) - inside
    bodies, loops = [], []
    for i, name in enumerate(machine.legs):
        elbow = arm[i] * np.array([np.cos(at[i]), np.sin(at[i]), 0.0])
        hinge = joint("hinge", [0, 0, 1], 1e-2)
        link = element("body", [hinge, inertia(LIGHT)], name=f"{name}_rod", pos=elbow)
        inner, _ = driven(name, machine.drive, [0, 0, 1], at[i], faults, [link])
        bodies.append(element("body", [inner], pos=shape.base[i]))
        loops.append(connect(f"{name}_rod", "platform", away[i] - elbow))
    free = [joint("slide", a, 0.0) for a in ([1, 0, 0], [0, 1, 0])] + [joint("hinge", [0, 0, 1], 0)]
    bodies.append(platform(machine.home, faults, free))
    return model(bodies, loops, machine.legs, machine.drive, faults), at


def delta(machine: Machine, shape: Shape, faults: Faults) -> tuple[str, np.ndarray]:
    """Return three carriages on vertical rails, a pair of parallel rods from each."""
    tops, rod = machine.home + shape.platform, shape.lengths["length"]
    away = tops - shape.base
    at = away[:, 2] + np.sqrt(rod**2 - away[:, 0] ** 2 - away[:, 1] ** 2)
    bodies, loops = [], []
    for i, name in enumerate(machine.legs):
        along = tops[i] - shape.base[i] - [0, 0, at[i]]
        out = machine.shape.base[i] / np.linalg.norm(machine.shape.base[i])
        rods = []
        for side in (-1, 1):
            cross = [joint("hinge", axis, 1e-2) for axis in ([1, 0, 0], [0, 1, 0])]
            place = side * 0.04 * np.array([-out[1], out[0], 0.0])
            rods.append(element("body", [*cross, inertia(LIGHT)], name=f"{name}_rod{side}",
                                pos=place, zaxis=-along))
            loops.append(connect(f"{name}_rod{side}", "platform", [0, 0, -rod[i]]))
        inner, _ = driven(name, machine.drive, [0, 0, 1], at[i], faults, rods)
        bodies.append(element("body", [inner], pos=shape.base[i] + [0, 0, at[i]]))
    bodies.append(platform(machine.home, faults, [element("freejoint")]))
    return model(bodies, loops, machine.legs, machine.drive, faults), at


def _shape(base: np.ndarray, top: np.ndarray, **lengths: float) -> Shape:
    legs = len(base)
    return Shape(base, top, {k: np.full(legs, v) for k, v in lengths.items()}, np.zeros(legs))


HEXAPOD = Machine(
    "hexapod", "spatial", SLIDE, np.array([0.0, 0.0, 0.42]),
    _shape(circle(0.24, [-10, 10, 110, 130, 230, 250]),
           circle(0.14, [-50, 50, 70, 170, 190, 290], -0.02)), 0.025, hexapod, "U(P)S")
PLANAR = Machine(
    "3-RRR", "planar", HINGE, np.zeros(3),
    _shape(circle(0.40, [90, 210, 330]), circle(0.12, [50, 170, 290]), proximal=0.24,
           distal=0.24), 0.22, planar, "(R)RR", {"elbow": 1})
DELTA = Machine(
    "delta", "translational", SLIDE, np.array([0.0, 0.0, 0.25]),
    _shape(circle(0.30, [90, 210, 330]), circle(0.06, [90, 210, 330]), length=0.45), 0.06, delta,
    "(P)US", {"branch": 1})
MACHINES = {m.name: m for m in (HEXAPOD, PLANAR, DELTA)}
