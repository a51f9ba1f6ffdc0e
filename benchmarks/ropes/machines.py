"""Machines of new kinds: anchors and hooks, where the platform goes, and the file that says so, mm.

Most hang on ropes; one has seven struts, and one two arms of two bars, whose angles are told as
the way of the elbow, mm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray
NAMES = ("x", "y", "z", "rx", "ry", "rz")
ELBOWS = (-1, 1)
"""How those of two arms turn from crank to rod, counter-clockwise 1."""
COORDINATES = {"planar-point": [0, 1], "planar": [0, 1, 5], "translational": [0, 1, 2],
               "spatial": [0, 1, 2, 3, 4, 5]}


@dataclass(frozen=True)
class Machine:
    """Nominal points (m, 3) of base and platform, mm; tolerance of both, and who pulls.

    ``centre``, ``half``: of the poses x, y, z and rotation vector (6,); ``instrument``: none or
    pose. ``kind`` of the limbs; ``bars``: crank and rod of arms, where limbs have them.
    """

    name: str
    motion: str
    anchors: Array
    hooks: Array
    tolerance: float
    pulling: tuple[int, ...]
    centre: tuple[float, ...]
    half: tuple[float, ...]
    instrument: str = "none"
    offset: float = 0.0
    kind: str = "rope"
    bars: tuple[float, ...] = ()

    @property
    def ropes(self) -> list[str]:
        """Names of the ropes."""
        return [f"r{i + 1}" for i in range(len(self.anchors))]

    @property
    def flat(self) -> bool:
        """Whether it moves in the plane."""
        return self.motion.startswith("planar")

    @property
    def pointed(self) -> bool:
        """Whether all limbs meet in one point."""
        return self.motion in ("planar-point", "translational")

    @property
    def coordinates(self) -> list[int]:
        """Which of x, y, z and rotation vector its poses have."""
        return COORDINATES[self.motion]

    def in_joints(self, way: Array | float) -> Array | float:
        """Return ways in mm as joint values of its file, mm or rad."""
        return way / self.bars[0] if self.bars else way

    def file(self) -> dict:
        """Return the mechanism file."""
        size = 2 if self.flat else 3

        def points(p: Array, fixed: bool) -> object:
            values = [float(v) for v in p[:size]]
            if not fixed:
                return values
            return {c: {"value": v, "fixed": True}
                    for c, v in zip("xyz"[:size], values, strict=True)}

        at = {NAMES[c]: float(self.centre[c]) for c in self.coordinates}
        arms = [{"proximal": self.bars[0], "distal": self.bars[1], "elbow": e}
                for e in ELBOWS] if self.bars else [{}] * len(self.anchors)
        return {"format": "ppmcal/mechanism/1", "name": self.name, "motion": self.motion,
                "units": {"length": "mm", "angle": "rad"}, "home": {"pose": at},
                "limbs": [{"name": n, "kind": self.kind, "base": {"point": points(a, False)},
                           "platform": {"point": points(b, self.pointed)},
                           "offset": {"value": 0.0, "fixed": not self.offset}, **more}
                          for n, a, b, more in zip(self.ropes, self.anchors, self.hooks, arms,
                                                   strict=True)],
                "tolerances": {"point": self.tolerance, "length": self.tolerance,
                               "offset": self.in_joints(self.offset or 1.0)}}


def _corners(x: float, y: float, z: float = 0.0) -> Array:
    return np.array([[0.0, 0.0, z], [x, 0.0, z], [x, y, z], [0.0, y, z]])


BELTS = Machine("belts", "planar-point", _corners(3000.0, 2100.0), np.zeros((4, 3)), 15.0, (0, 1),
                (1500.0, 1050.0, 0, 0, 0, 0), (900.0, 550.0, 0, 0, 0, 0))
CABLES = Machine("cables", "planar", _corners(2900.0, 2400.0), np.array(
    [[-90.0, 60.0, 0.0], [90.0, 60.0, 0.0], [90.0, -60.0, 0.0], [-90.0, -60.0, 0.0]]), 3.0, (0,),
    (1450.0, 1200.0, 0, 0, 0, 0), (700.0, 500.0, 0, 0, 0, 0.14), "pose", 2.0)
CAGE = Machine("cage", "spatial", np.concatenate(
    [_corners(3000.0, 2500.0), _corners(3000.0, 2500.0, 2000.0)]), np.array(
    [[x * s, y * t, z] for x, y, z in ((200.0, 80.0, 150.0), (100.0, 200.0, -150.0))
     for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]), 3.0, (0, 1),
    (1500.0, 1250.0, 1000.0, 0, 0, 0), (700.0, 550.0, 450.0, 0.12, 0.12, 0.12), "pose", 2.0)
HANGING = Machine("hanging", "translational", np.array(
    [[0.0, -1600.0, -120.0], [1300.0, 1250.0, -160.0], [-1400.0, 750.0, -150.0],
     [20.0, 10.0, 2350.0]]), np.zeros((4, 3)), 10.0, (3,), (0.0, 0.0, 500.0, 0, 0, 0),
    (500.0, 450.0, 400.0, 0, 0, 0))
SEVEN = Machine("seven-legs", "spatial", np.array(
    [[600.0 * np.cos(t), 600.0 * np.sin(t), 0.0] for t in np.radians(
        [10.0, 110.0, 130.0, 230.0, 250.0, 350.0])] + [[120.0, 160.0, 0.0]]), np.array(
    [[300.0 * np.cos(t), 300.0 * np.sin(t), 0.0] for t in np.radians(
        [50.0, 70.0, 170.0, 190.0, 290.0, 310.0])] + [[-130.0, 40.0, 0.0]]), 1.0, (),
    (0.0, 0.0, 700.0, 0, 0, 0), (150.0, 150.0, 120.0, 0.2, 0.2, 0.2), "pose", 1.0, "U(P)S")
ARMS = Machine("five-bar", "planar-point", np.array([[-240.0, 0.0, 0.0], [240.0, 0.0, 0.0]]),
               np.zeros((2, 3)), 1.0, (), (0.0, 760.0, 0, 0, 0, 0), (200.0, 120.0, 0, 0, 0, 0),
               "pose", 1.0, "(R)RR", (480.0, 640.0))
MACHINES = {m.name: m for m in (BELTS, CABLES, CAGE, HANGING, SEVEN, ARMS)}
SQUARE = {f"{m.name}-square": replace(m, name=f"{m.name}-square", anchors=m.anchors[:count],
                                      hooks=m.hooks[:count], pulling=())
          for m, count in ((CABLES, 3), (CAGE, 6))}
"""Without the ropes that are more than freedoms: none can be pulled against the others."""


def turn(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector, rad."""
    angle = float(np.linalg.norm(vector))
    k = np.cross(np.eye(3), vector / (angle or 1.0))
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


def ropes(anchors: Array, hooks: Array, poses: Array) -> tuple[Array, Array, Array]:
    """Return lengths (N, m), unit vectors to the anchors (N, m, 3), and arms (N, m, 3)."""
    arms = np.stack([hooks @ turn(p[3:]).T for p in poses])
    along = anchors - (poses[:, None, :3] + arms)
    length = np.linalg.norm(along, axis=-1)
    return length, along / length[..., None], arms


def ways(machine: Machine, anchors: Array, hooks: Array, bars: Array, poses: Array) -> Array:
    """Return what the joints read (N, m) at poses, mm: lengths, or ways of elbows about motors.

    ``bars`` (m, 2): crank and rod of each limb, empty where there are none.
    """
    if not bars.size:
        return ropes(anchors, hooks, poses)[0]
    reach = poses[:, None, :2] - anchors[:, :2]
    d = np.linalg.norm(reach, axis=-1)
    crank, rod = bars.T
    inner = np.arccos((crank**2 + d**2 - rod**2) / (2.0 * crank * d))
    angle = np.arctan2(reach[..., 1], reach[..., 0]) - np.array(ELBOWS) * inner
    return angle * machine.bars[0]


def balance(machine: Machine, units: Array, arms: Array) -> Array:
    """Return what tensions of one do to the platform (N, d, m)."""
    wrench = np.concatenate([units, np.cross(arms, units)], axis=-1)
    return np.swapaxes(wrench[..., machine.coordinates], 1, 2)


def tensions(machine: Machine, units: Array, arms: Array) -> Array:
    """Return the tensions (N, m) where those that pull do so by 1 and the others hold.

    Of what neither pulls nor hangs on ropes, 1.
    """
    if not machine.pulling:
        return np.ones(units.shape[:2])
    every = balance(machine, units, arms)
    on = np.isin(np.arange(every.shape[2]), machine.pulling)
    out = np.ones((len(every), on.size))
    for n, each in enumerate(every):
        out[n, ~on] = np.linalg.solve(each[:, ~on], -each[:, on].sum(axis=1))
    return out
