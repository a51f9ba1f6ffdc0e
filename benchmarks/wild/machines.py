"""Machines: nominal geometry varied by seed, tolerances, and their mechanism file.

Geometry is in mm and rad inside, in mm and deg in the file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from .kinematics import COLUMNS, Geometry, inverse, platform_arms, rod_foot

MACHINES = ("3-RRR", "3-RPR", "delta-linear", "delta-rotary", "hexapod", "crank-hexapod")
KINDS = {
    "3-RRR": "(R)RR", "3-RPR": "R(P)R", "delta-linear": "(P)US", "delta-rotary": "(R)US",
    "hexapod": "U(P)S", "crank-hexapod": "(R)US",
}  # fmt: skip
EX, EZ = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
DOWN = np.array([0, 0, -1.0])


@dataclass(frozen=True)
class Slot:
    """One toleranced number: which leg, which field and component, its sigma (mm or rad)."""

    name: str
    field: str
    index: tuple[int, ...]
    sigma: float
    angle: bool


@dataclass(frozen=True)
class Machine:
    """Nominal machine; ``half`` is the workspace's half range per coordinate (mm, rad)."""

    name: str
    kind: str
    motion: str
    geometry: Geometry
    home: np.ndarray
    half: np.ndarray
    tolerances: dict[str, float]
    slots: tuple[Slot, ...]
    limits: np.ndarray

    @property
    def legs(self) -> list[str]:
        """Names of the legs, which are the names of the actuators."""
        return [f"leg{i + 1}" for i in range(self.geometry.base.shape[1])]

    @property
    def rotary(self) -> bool:
        """Whether the actuators turn."""
        return self.geometry.closure == "crank"

    @property
    def gravity(self) -> np.ndarray:
        """Direction of weight in base axes (3,)."""
        return np.array([0, -1.0, 0]) if self.motion == "planar" else DOWN


def pose_of(motion: str, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (N, d), mm and rad, as positions (N, 3) and rotations (N, 3, 3)."""
    full = np.zeros((len(values), 6))
    full[:, COLUMNS[motion]] = values
    return full[:, :3], Rotation.from_rotvec(full[:, 3:]).as_matrix()


def values_of(motion: str, pos: np.ndarray, rot: np.ndarray) -> np.ndarray:
    """Coordinates (N, d) of positions and rotations, mm and rad."""
    full = np.hstack([pos, Rotation.from_matrix(rot).as_rotvec()])
    return full[:, COLUMNS[motion]]


def _ring(radius, degrees, z=0.0) -> np.ndarray:
    angles = np.radians(degrees)
    radius = np.broadcast_to(radius, angles.shape)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), z + 0 * angles], axis=-1)


def _geometry(closure, base, platform, axis, zero, proximal=0.0, branch=1.0) -> Geometry:
    count = len(base)
    row = lambda x: np.broadcast_to(np.asarray(x, float), (count,))[None].copy()  # noqa: E731
    across = np.tile(EX, (count, 1)) if abs(axis[0] @ EX) < 0.9 else np.tile(EZ, (count, 1))
    across = across - np.sum(across * axis, -1, keepdims=True) * axis
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return Geometry(
        closure, base[None], platform[None], axis[None], zero[None], row(proximal), row(1.0),
        row(0.0), row(branch), across[None], row(0.0),
    )  # fmt: skip


def _rods_for(geo: Geometry, motion: str, home: np.ndarray, q: np.ndarray) -> Geometry:
    """Rod lengths rounded to 0.1 mm such that the machine is near joints q (L,) at home."""
    pos, rot = pose_of(motion, home[None])
    foot, _ = rod_foot(geo, q[None])
    rods = np.linalg.norm(pos[:, None] + platform_arms(geo, rot) - foot, axis=-1)
    geo = replace(geo, length=np.round(rods, 1))
    roots = [inverse(replace(geo, branch=np.full_like(rods, s)), pos, rot) for s in (1.0, -1.0)]
    near = [np.abs(root - q) for root in roots]
    return replace(geo, branch=np.where(near[0] <= near[1], 1.0, -1.0))


def _planar_rrr(rng):
    base = _ring(300 * (1 + 0.06 * rng.uniform(-1, 1, 3)), [-90, 30, 150] + rng.uniform(-6, 6, 3))
    plat = _ring(90 * (1 + 0.1 * rng.uniform(-1, 1, 3)), [-90, 30, 150] + rng.uniform(-8, 8, 3))
    home = np.array([rng.uniform(-10, 10), rng.uniform(-10, 10), rng.uniform(-0.1, 0.1)])
    axis, zero = np.tile(EZ, (3, 1)), np.tile(EX, (3, 1))
    inward = np.arctan2(-base[:, 1], -base[:, 0])
    geo = _geometry("crank", base.round(1), plat.round(1), axis, zero, 180 + 10 * rng.random())
    geo = _rods_for(geo, "planar", home, inward + np.radians(50 + 5 * rng.uniform(-1, 1, 3)))
    return "planar", geo, home, np.array([45, 45, np.radians(14)])


def _planar_rpr(rng):
    base = _ring(400 * (1 + 0.06 * rng.uniform(-1, 1, 3)), [-90, 30, 150] + rng.uniform(-6, 6, 3))
    plat = _ring(120 * (1 + 0.1 * rng.uniform(-1, 1, 3)), [-90, 30, 150] + rng.uniform(-8, 8, 3))
    home = np.array([rng.uniform(-20, 20), rng.uniform(-20, 20), np.radians(40)])
    axis, zero = np.tile(EZ, (3, 1)), np.tile(EX, (3, 1))
    geo = _geometry("strut", base.round(1), plat.round(1), axis, zero)
    return "planar", geo, home, np.array([80, 80, np.radians(18)])


def _delta_linear(rng):
    base = _ring(190 * (1 + 0.05 * rng.uniform(-1, 1, 3)), [-90, 30, 150] + rng.uniform(-5, 5, 3))
    plat = _ring(40 * (1 + 0.1 * rng.uniform(-1, 1, 3)), [-90, 30, 150] + rng.uniform(-5, 5, 3))
    home = np.array([0, 0, 120.0])
    axis, zero = np.tile(EZ, (3, 1)), np.tile(EX, (3, 1))
    geo = _geometry("slider", base.round(1), plat.round(1), axis, zero)
    geo = _rods_for(geo, "translational", home, np.full(3, 330.0) + rng.uniform(-10, 10, 3))
    return "translational", geo, home, np.array([60, 60, 80])


def _delta_rotary(rng):
    angles = np.array([-90, 30, 150]) + rng.uniform(-5, 5, 3)
    base, plat = (
        _ring(120 + rng.uniform(-6, 6, 3), angles),
        _ring(50 + rng.uniform(-4, 4, 3), angles),
    )
    zero = _ring(1.0, angles)
    axis = np.cross(EZ, zero)
    home = np.array([0, 0, -330.0])
    geo = _geometry("crank", base.round(1), plat.round(1), axis, zero, 150.0)
    geo = _rods_for(geo, "translational", home, np.radians(20 + rng.uniform(-4, 4, 3)))
    return "translational", geo, home, np.array([80, 80, 60])


def _hexapod(rng):
    turn = np.repeat([0, 120, 240], 2)
    base = _ring(
        300 + rng.uniform(-15, 15, 6), turn + np.tile([-20, 20], 3) + rng.uniform(-3, 3, 6)
    )
    plat = _ring(180 + rng.uniform(-9, 9, 6), turn + np.tile([-48, 48], 3) + rng.uniform(-3, 3, 6))
    base[:, 2], plat[:, 2] = rng.uniform(-8, 8, 6), rng.uniform(-8, 8, 6)
    home = np.array([0, 0, 400 + 30 * rng.uniform(-1, 1), 0, 0, 0])
    axis, zero = np.tile(EZ, (6, 1)), np.tile(EX, (6, 1))
    geo = _geometry("strut", base.round(1), plat.round(1), axis, zero)
    return "spatial", geo, home, np.array([60, 60, 50] + [np.radians(11)] * 3)


def _crank_hexapod(rng):
    turn = np.repeat([0, 120, 240], 2)
    angles = turn + np.tile([-30, 30], 3) + rng.uniform(-3, 3, 6)
    base = _ring(230 + rng.uniform(-10, 10, 6), angles)
    plat = _ring(150 + rng.uniform(-8, 8, 6), turn + np.tile([-46, 46], 3) + rng.uniform(-3, 3, 6))
    axis = _ring(1.0, angles)
    side = np.tile([1.0, -1.0], 3)[:, None]
    zero = np.cross(EZ, axis) * side
    axis = -axis * side  # a positive turn lifts the arm
    home = np.array([0, 0, 300 + 15 * rng.uniform(-1, 1), 0, 0, 0])
    geo = _geometry("crank", base.round(1), plat.round(1), axis, zero, 110.0)
    geo = _rods_for(geo, "spatial", home, np.radians(rng.uniform(-4, 4, 6)))
    return "spatial", geo, home, np.array([25, 25, 22] + [np.radians(5.5)] * 3)


BUILDERS = {
    "3-RRR": _planar_rrr, "3-RPR": _planar_rpr, "delta-linear": _delta_linear,
    "delta-rotary": _delta_rotary, "hexapod": _hexapod, "crank-hexapod": _crank_hexapod,
}  # fmt: skip


def _slots(geo: Geometry, motion: str, tol: dict[str, float]) -> tuple[Slot, ...]:
    axes = "xy" if motion == "planar" else "xyz"
    rod = "length" if geo.closure == "slider" else "distal"
    turned = {"slider": "direction", "crank": "axis", "strut": ""}[geo.closure]
    rotary = geo.closure == "crank"
    out = []
    for leg in range(geo.base.shape[1]):
        for part in ("base", "platform"):
            for i, axis in enumerate(axes):
                name = f"leg{leg + 1}.{part}.point.{axis}"
                out.append(Slot(name, part, (leg, i), tol["point"], False))
        if turned and motion != "planar":
            for i, axis in enumerate("xyz"):
                name = f"leg{leg + 1}.base.{turned}.r{axis}"
                out.append(Slot(name, "turn", (leg, i), tol["angle"], True))
        if rotary:
            out.append(Slot(f"leg{leg + 1}.proximal", "proximal", (leg,), tol["length"], False))
        if geo.closure != "strut":
            out.append(Slot(f"leg{leg + 1}.{rod}", "length", (leg,), tol["length"], False))
        out.append(Slot(f"leg{leg + 1}.offset", "offset", (leg,), tol["offset"], rotary))
    return tuple(out)


def with_errors(machine: Machine, errors: np.ndarray) -> Geometry:
    """Geometry with an error (mm or rad) in every slot, errors (slots,)."""
    geo = machine.geometry
    count = geo.base.shape[1]
    by = {f: np.zeros((count, 3)) for f in ("base", "platform", "turn")}
    by |= {f: np.zeros(count) for f in ("proximal", "length", "offset")}
    for slot, error in zip(machine.slots, errors, strict=True):
        by[slot.field][slot.index] = error
    plain = {f: getattr(geo, f) + by[f] for f in by if f != "turn"}
    geo = replace(geo, **plain)
    return geo.turned(by["turn"]) if np.any(by["turn"]) else geo


def draw_errors(machine: Machine, rng: np.random.Generator) -> np.ndarray:
    """Errors of all slots drawn from their tolerances, cut at 2.5 sigma (slots,)."""
    sigma = np.array([slot.sigma for slot in machine.slots])
    return np.clip(rng.normal(size=len(sigma)), -2.5, 2.5) * sigma


def build(name: str, seed: int) -> Machine:
    """Nominal machine of a name in MACHINES, its dimensions varied by the seed."""
    rng = np.random.default_rng([seed, 0, MACHINES.index(name)])
    motion, geo, home, half = BUILDERS[name](rng)
    tol = {"point": rng.choice([0.1, 0.2, 0.4]), "length": rng.choice([0.1, 0.2, 0.3])}
    tol["angle"] = np.radians(0.05)
    tol["offset"] = np.radians(0.15) if geo.closure == "crank" else rng.choice([0.2, 0.4])
    corners = home + half * 1.15 * rng.uniform(-1, 1, (600, len(home)))
    joints = inverse(geo, *pose_of(motion, corners))
    margin = 0.05 * np.ptp(joints, axis=0)
    limits = np.stack([joints.min(0) - margin, joints.max(0) + margin], axis=-1)
    tol = {k: float(v) for k, v in tol.items()}
    return Machine(
        name, KINDS[name], motion, geo, home, half, tol, _slots(geo, motion, tol), limits
    )
