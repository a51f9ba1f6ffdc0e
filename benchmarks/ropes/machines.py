"""Machines on ropes: anchors and hooks, where the platform goes, and the file that says so, mm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Machine:
    """Nominal points (m, 3) of base and platform, mm; tolerance of both, and who pulls.

    ``centre``, ``half``: of the poses x, y, z and rotation vector (6,); ``instrument``: none or
    pose.
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

    @property
    def ropes(self) -> list[str]:
        """Names of the ropes."""
        return [f"r{i + 1}" for i in range(len(self.anchors))]

    @property
    def flat(self) -> bool:
        """Whether it moves in the plane."""
        return self.motion.startswith("planar")

    def file(self) -> dict:
        """Return the mechanism file."""
        size = 2 if self.flat else 3

        def points(p: Array, fixed: bool) -> object:
            values = [float(v) for v in p[:size]]
            if not fixed:
                return values
            return {c: {"value": v, "fixed": True}
                    for c, v in zip("xyz"[:size], values, strict=True)}

        own = self.motion == "planar-point"
        names = {"planar-point": "x y", "planar": "x y rz",
                 "spatial": "x y z rx ry rz"}[self.motion]
        at = dict(zip(("x", "y", "z", "rx", "ry", "rz"), self.centre, strict=True))
        return {"format": "ppmcal/mechanism/1", "name": self.name, "motion": self.motion,
                "units": {"length": "mm", "angle": "rad"}, "home": {"pose": {
                    c: float(at[c]) for c in names.split()}},
                "limbs": [{"name": n, "kind": "rope", "base": {"point": points(a, False)},
                           "platform": {"point": points(b, own)},
                           "offset": {"value": 0.0, "fixed": not self.offset}}
                          for n, a, b in zip(self.ropes, self.anchors, self.hooks,
                                             strict=True)],
                "tolerances": {"point": self.tolerance, "offset": self.offset or 1.0}}


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
MACHINES = {m.name: m for m in (BELTS, CABLES, CAGE)}
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


def balance(machine: Machine, units: Array, arms: Array) -> Array:
    """Return what tensions of one do to the platform (N, d, m)."""
    wrench = np.concatenate([units, np.cross(arms, units)], axis=-1)
    rows = {"planar-point": [0, 1], "planar": [0, 1, 5], "spatial": list(range(6))}
    return np.swapaxes(wrench[..., rows[machine.motion]], 1, 2)


def tensions(machine: Machine, units: Array, arms: Array) -> Array:
    """Return the tensions (N, m) where those that pull do so by 1 and the others hold."""
    every = balance(machine, units, arms)
    on = np.isin(np.arange(every.shape[2]), machine.pulling)
    out = np.ones((len(every), on.size))
    for n, each in enumerate(every):
        out[n, ~on] = np.linalg.solve(each[:, ~on], -each[:, on].sum(axis=1))
    return out
