"""One sound machine of every kind, and what every limb has to satisfy, in plain NumPy.

The machines go through real YAML text and the real reader. :func:`contract_lengths` is the
table of the contract, written out; :func:`chain_lengths` is the same linkage as a product of
4x4 matrices, so that the joints' frame errors have a place. Neither uses the program's algebra.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ppmcal import algebra as cga
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.mechanism import Mechanism

Array = NDArray[np.float64]
Limbs = list[dict[str, Any]]


# --- machines ---------------------------------------------------------------------------------

@dataclass(frozen=True)
class Case:
    """A machine of one kind: its motion, home pose and limbs, in mm and degrees.

    ``full`` are slots that have a default, given to every limb of the full machine.
    """

    motion: str
    home: Mapping[str, float]
    limbs: Limbs
    full: Mapping[str, float] = field(default_factory=dict)


def _turned(point: Sequence[float], degrees: float) -> list[float]:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return [c * point[0] - s * point[1], s * point[0] + c * point[1], *point[2:]]


def _planar(kind: str, base: Sequence[float], platform: Sequence[float], rz: float = 0.0,
            full: Mapping[str, float] | None = None, base_angle: float | None = None,
            platform_angle: float | None = None, branches: Sequence[int] = (),
            elbow: int | None = None, **lengths: float) -> Case:
    """Three limbs at 120 degrees, none quite like the other."""
    limbs: Limbs = []
    for i in range(3):
        turn = 120.0 * i
        a, b = _turned(base, turn), _turned(platform, turn)
        limb: dict[str, Any] = {
            "name": f"leg{i + 1}", "kind": kind,
            "base": {"point": [a[0] + 2.3 * i, a[1] - 1.7 * i]},
            "platform": {"point": [b[0] - 1.1 * i, b[1] + 1.9 * i]}}
        if base_angle is not None:
            limb["base"]["angle"] = base_angle + turn + 0.7 * i
        if platform_angle is not None:
            limb["platform"]["angle"] = platform_angle + turn - 0.9 * i
        limb |= {name: value + 0.5 * i for name, value in lengths.items()}
        if branches:
            limb["branch"] = branches[i]
        if elbow is not None:
            limb["elbow"] = elbow
        limbs.append(limb)
    return Case("planar", {"x": 4.0, "y": -3.0, "rz": rz}, limbs, full or {})


def _stewart() -> Case:
    limbs: Limbs = []
    for i, (a, b) in enumerate(zip((10, 110, 130, 230, 250, 350), (50, 70, 170, 190, 290, 310),
                                   strict=True)):
        limbs.append({"name": f"leg{i + 1}", "kind": "U(P)S",
                      "base": {"point": [*_turned([500.0 + i, 0.0], a), 3.0 * i]},
                      "platform": {"point": [*_turned([220.0 - i, 0.0], b), -2.0 * i]}})
    return Case("spatial", {"x": 5.0, "y": -8.0, "z": 450.0, "rx": 2.0, "ry": -3.0, "rz": 1.0},
                limbs)


def _hexaglide() -> Case:
    """[LIN] Table 1, corrected, in mm, with rails that are not quite parallel."""
    rows = (((25, 886, 0), (-126, 180, 200), 1250), ((-780, -421, 0), (-93, -199, 200), 1250),
            ((755, -465, 0), (219, 19, 200), 1250), ((-25, 886, 0), (115, 164, 400), 1700),
            ((-755, -465, 0), (-199, 17, 400), 1700), ((780, -421, 0), (85, -181, 400), 1700))
    limbs: Limbs = [
        {"name": f"leg{i + 1}", "kind": "(P)US",
         "base": {"point": list(a), "direction": [0.05 * math.cos(i), 0.05 * math.sin(i), 1.0]},
         "platform": {"point": list(b)}, "length": length}
        for i, (a, b, length) in enumerate(rows)]
    return Case("spatial", dict.fromkeys(("x", "y", "z", "rx", "ry", "rz"), 0.0), limbs)


def _cranks() -> Case:
    limbs: Limbs = []
    points = ((244.5, 52.0), (-77.3, 237.8), (-167.3, 185.8), (-167.3, -185.8), (-77.3, -237.8),
              (244.5, -52.0))
    ends = ((96.4, 114.9), (51.3, 141.0), (-147.7, 26.0), (-147.7, -26.0), (51.3, -141.0),
            (96.4, -114.9))
    for i, (a, b, axis) in enumerate(zip(points, ends, (0, -60, 120, 60, 240, 180), strict=True)):
        limbs.append({"name": f"leg{i + 1}", "kind": "(R)US",
                      "base": {"point": [*a, 2.0 * i], "axis": _turned([1.0, 0.0, 0.1], axis),
                               "zero": _turned([0.0, 1.0, 0.0], axis)},
                      "platform": {"point": [*b, -1.0 * i]}, "proximal": 100.0 + i,
                      "distal": 280.0 - i, "branch": -1})
    return Case("spatial", {"x": 0.0, "y": 0.0, "z": 245.0, "rx": 0.0, "ry": 0.0, "rz": 0.0}, limbs)


def _tripod(lateral: float) -> Case:
    """A 3-RPS: each foot steps back along its axis by what the strut steps forward."""
    limbs: Limbs = []
    for i in range(3):
        axis = _turned([0.0, 1.0, 0.0], 120.0 * i)
        foot = np.array([*_turned([85.0 + i, 0.0], 120.0 * i), 1.5 * i]) - lateral * np.array(axis)
        limbs.append({"name": f"leg{i + 1}", "kind": "R(P)S",
                      "base": {"point": [float(v) for v in foot], "axis": axis},
                      "platform": {"point": [*_turned([51.0 - i, 0.0], 120.0 * i), -0.5 * i]}})
        if lateral:
            limbs[-1]["lateral"] = lateral
    return Case("spatial", {"x": 0.0, "y": 0.0, "z": 100.0, "rx": 0.0, "ry": 0.0, "rz": 0.0}, limbs)


CASES: dict[str, Case] = {
    "R(P)R": _planar("R(P)R", (-500, -288), (-216, -125), 30.0, {"lateral": 15.0}),
    "(R)PR": _planar("(R)PR", (-500, -288), (-173, -100), 0.0, {"lateral": 12.0},
                     branches=(1, 1, -1)),
    "(R)RR": _planar("(R)RR", (-303, -175), (-87, -50), elbow=1, proximal=220, distal=210),
    "R(R)R": _planar("R(R)R", (-303, -175), (-130, -75), 30.0, elbow=1, proximal=220, distal=200),
    "(P)RR": _planar("(P)RR", (-400, -231), (0, -120), base_angle=0.0, length=250,
                     branches=(-1, -1, -1)),
    "P(R)R": _planar("P(R)R", (-310, -63), (-104, -60), base_angle=210.0, length=200),
    "(R)RP": _planar("(R)RP", (-346, -200), (-87, -50), 0.0, {"lateral": 9.0},
                     platform_angle=210.0, proximal=200, branches=(1, 1, -1)),
    "R(R)P": _planar("R(R)P", (-260, -150), (-127, 19), platform_angle=210.0, proximal=200),
    "R(P)P": _planar("R(P)P", (-260, -150), (-152, 62), platform_angle=210.0, slide_angle=60),
    "(P)RP": _planar("(P)RP", (-450, -260), (0, -100), base_angle=0.0, platform_angle=270.0),
    "(P)PR": _planar("(P)PR", (-450, -260), (0, -120), base_angle=0.0, slide_angle=60),
    "P(P)R": _planar("P(P)R", (-346, 0), (-104, -60), base_angle=210.0, slide_angle=60),
    "U(P)S": _stewart(),
    "(P)US": _hexaglide(),
    "(R)US": _cranks(),
    "R(P)S": _tripod(0.0),
}
KINDS = tuple(CASES)
PLANAR = tuple(k for k, c in CASES.items() if c.motion == "planar")
TOLERANCES = {"point": 0.3, "length": 0.3, "angle": 0.1, "offset": 0.4}


def mechanism_text(limbs: Limbs, motion: str, home: Mapping[str, float],
                   units: Mapping[str, str] | None = None, **more: Any) -> str:
    """Return a mechanism file's text; ``more`` are further keys, ``q`` goes into home."""
    q = more.pop("q", None)
    tree = {"format": "ppmcal/mechanism/1",
            "units": dict(units or {"length": "mm", "angle": "deg"}), "motion": motion,
            "limbs": limbs, "home": {"pose": dict(home)} | ({"q": q} if q else {}),
            "tolerances": TOLERANCES} | more
    return yaml.safe_dump(tree, sort_keys=False)


def read_text(text: str) -> Mechanism:
    """Write the text to a file and read it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "machine.yaml"
        path.write_text(text, encoding="utf-8")
        return read_mechanism(path)


def plain_text(kind: str, change: Callable[[int, dict[str, Any]], dict[str, Any]] | None = None,
               **more: Any) -> str:
    """Return the text of the machine of one kind, each limb passed through ``change``."""
    case = CASES[kind]
    limbs = [change(i, dict(limb)) if change else limb for i, limb in enumerate(case.limbs)]
    return mechanism_text(limbs, case.motion, case.home, **more)


@cache
def plain(kind: str) -> Mechanism:
    """Return the machine of one kind with nothing but what it needs."""
    return read_text(plain_text(kind))


@cache
def full(kind: str) -> Mechanism:
    """Return the machine with every slot that its kind can take, joint frames included.

    Every second limb has a drive ratio, every fourth a negative one.
    """
    case = _tripod(4.0) if kind == "R(P)S" else CASES[kind]
    limbs = []
    for i, limb in enumerate(case.limbs):
        limb = {**limb, **case.full, "offset": 3.0 + i}
        if i % 2:
            limb["ratio"] = -2.5 if i % 4 == 3 or len(case.limbs) == 3 else 4.0
        limbs.append(limb)
    return read_text(mechanism_text(limbs, case.motion, case.home, free=["*"]))


OFFSET_JOINTS = tuple((kind, body) for kind in ("U(P)S", "(P)US", "(R)US")
                      for body in ("base", "platform"))
"""Kinds that have a universal joint, and the bodies that can carry it."""


@cache
def offset_joints(kind: str, body: str, full: bool = False, size: float = 12.0) -> Mechanism:
    """Return the machine of a kind whose universal joints' axes miss each other, mm.

    Offsets have both signs and the first axes lie in many directions. ``full``: with every slot,
    joint frames included. Without ``size`` the axes of all joints are given, and meet.
    """

    def change(i: int, limb: dict[str, Any]) -> dict[str, Any]:
        own = dict(limb[body])
        if size:
            own["axis_offset"] = (-1.0) ** i * (size + i)
        if (kind, body) != ("(R)US", "base"):
            own["axis"] = [math.cos(i), math.sin(i), 0.3 - 0.1 * i]
        return {**limb, body: own, **({"offset": 3.0 + i, "ratio": 4.5 - i} if full else {})}

    return read_text(plain_text(kind, change, **({"free": ["*"]} if full else {})))


def delta(actuated: str, rods: int) -> Mechanism:
    """Return a delta, ``(P)US`` or ``(R)US``: three ideal parallelograms, or six rods in pairs."""
    limbs: Limbs = []
    sides = (0.0,) if rods == 3 else (-30.0, 30.0)
    for name, turn in zip("abc", (10.0, 125.0, 246.0), strict=True):
        for j, side in enumerate(sides):
            limb: dict[str, Any] = {"name": f"{name}{j}", "kind": actuated, "actuator": name,
                                    "platform": {"point": _turned([45.0, side, 0.0], turn)}}
            if actuated == "(P)US":
                limb["base"] = {"point": _turned([160.0, side, 0.0], turn),
                                "direction": [0.0, 0.0, 1.0]}
                limb |= {"length": 250.0, "branch": 1}
            else:
                limb["base"] = {"point": _turned([120.0, side, 0.0], turn),
                                "axis": _turned([0.0, 1.0, 0.0], turn),
                                "zero": _turned([1.0, 0.0, 0.0], turn)}
                limb |= {"proximal": 150.0, "distal": 350.0, "branch": -1}
            limbs.append(limb)
    home = {"x": 0.0, "y": 0.0, "z": 100.0 if actuated == "(P)US" else -380.0}
    if rods == 6:
        home |= {"rx": 0.0, "ry": 0.0, "rz": 0.0}
    return read_text(mechanism_text(limbs, "translational" if rods == 3 else "spatial", home))


def mixed(name: str) -> Mechanism:
    """Return a machine of limbs of different kinds, ``planar`` or ``spatial``."""
    if name == "planar":
        rods = [{"name": f"leg{i + 1}", "kind": "(P)RR", "base": {"point": [0.0, 5.0 * i],
                 "angle": 1.0 * i}, "platform": {"point": [x, 3.0 * i]}, "length": 400.0 + i,
                 "branch": -1} for i, x in enumerate((-120.0, 121.0))]
        strut = {"name": "leg3", "kind": "R(P)R", "base": {"point": [220.0, 700.0]},
                 "platform": {"point": [2.0, 100.0]}}
        return read_text(mechanism_text([*rods, strut], "planar",
                                        {"x": 500.0, "y": 250.0, "rz": 1.0}))
    case = CASES["U(P)S"]
    rail = {"name": "leg2", "kind": "(P)US", "base": {
        "point": [-171.0, 469.0, -300.0], "direction": [0.1, 0.0, 1.0]},
        "platform": case.limbs[1]["platform"], "length": 480.0, "branch": -1}
    crank = {"name": "leg4", "kind": "(R)US", "base": {
        "point": [-324.0, -386.0, 9.0], "axis": [0.7, -0.6, 0.1], "zero": [0.6, 0.7, 0.0]},
        "platform": case.limbs[3]["platform"], "proximal": 200.0, "distal": 460.0, "branch": -1}
    limbs = [case.limbs[0], rail, case.limbs[2], crank, case.limbs[4], case.limbs[5]]
    return read_text(mechanism_text(limbs, "spatial", case.home))


# --- poses ------------------------------------------------------------------------------------

def matrices(pose: Array) -> tuple[Array, Array]:
    """Return rotation matrices (N, 3, 3) and origins (N, 3) of platform-to-base motors."""
    pose = np.atleast_2d(pose)
    origin = cga.move_point(pose, np.zeros(3))
    axes = [cga.move_point(pose, np.eye(3)[k]) - origin for k in range(3)]
    return np.stack(axes, axis=-1), origin


def motors(rotation: Array, origin: Array) -> Array:
    """Return platform-to-base motors (N, 8)."""
    return cga.motor_from_rotation_vector(Rotation.from_matrix(rotation).as_rotvec(), origin)


def displaced(pose: Array, step: Array) -> Array:
    """Return motors after an origin displacement and a turn (..., 6) in base axes."""
    rotation, origin = matrices(pose)
    step = np.array(np.broadcast_to(step, (len(origin), 6)))
    return motors(Rotation.from_rotvec(step[:, 3:]).as_matrix() @ rotation, origin + step[:, :3])


def difference(after: Array, before: Array) -> Array:
    """Return (N, 6) origin displacement and rotation vector, base axes, between motors."""
    (r1, t1), (r0, t0) = matrices(after), matrices(before)
    return np.concatenate([t1 - t0, Rotation.from_matrix(
        r1 @ np.swapaxes(r0, 1, 2)).as_rotvec()], axis=1)


def joint_steps(model: Model) -> Array:
    """Return a moderate step of each joint value (k,): 3 % of the reach, or 0.08 rad."""
    mechanism = model.mechanism
    step = np.empty(len(mechanism.actuators))
    for limb in (mechanism.limbs[i] for i in mechanism.driven):
        ratio = limb.slots.values(model.parameters).get("ratio", 1.0)
        step[limb.actuator] = (0.03 * mechanism.reach if limb.kind.actuator == "length"
                               else 0.08) / abs(ratio)
    return step


def spread(model: Model, count: int = 5, seed: int = 1, size: float = 1.0) -> tuple[Array, Array]:
    """Return joint values (count, k) about home and the poses (count, 8) that belong to them."""
    home = home_state(model.mechanism).q
    part = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, home.size))
    q = home + size * joint_steps(model) * part
    found = forward(model, q)
    assert found.converged.all()
    return q, found.pose


def joint_coordinates(model: Model, q: Array) -> list[Array]:
    """Return u = ratio q + offset (N,) of each driven limb."""
    out = []
    for limb in (model.mechanism.limbs[i] for i in model.mechanism.driven):
        v = limb.slots.values(model.parameters)
        out.append(v.get("ratio", 1.0) * q[:, limb.actuator] + v.get("offset", 0.0))
    return out


# --- the contract's table ---------------------------------------------------------------------

def _point(v: Mapping[str, float], name: str) -> Array:
    return np.array([v[f"{name}.x"], v[f"{name}.y"], v.get(f"{name}.z", 0.0)])


def _d(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)


def _n(angle: Array) -> Array:
    return np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)


def _norm(x: Array) -> Array:
    return np.sqrt(np.sum(x * x, axis=-1))


def _dot(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=-1)


def _about(axis: Array, angle: Array, x: Array) -> Array:
    """Rotate x about the unit vector axis (Rodrigues)."""
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    return c * x + s * np.cross(axis, x) + (1 - c) * (axis @ x) * axis


def contract_lengths(kind: str, v: Mapping[str, float], c: Mapping[str, Array], u: Array,
                     pose: Array) -> Array:
    """Return by how far a limb is from closing (N, k), m: the table of the contract.

    Signs: positive where the platform is too far out along the leg's line. Joint frames and
    errors of directions are 0 here.
    """
    rotation, origin = matrices(pose)
    a, b = _point(v, "base.point"), origin + rotation @ _point(v, "platform.point")
    heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    psi = heading + v.get("platform.angle", 0.0)
    alpha = np.full_like(u, v.get("base.angle", 0.0))
    sigma, lateral = v.get("slide_angle", 0.0), v.get("lateral", 0.0)
    p = v.get("proximal", 0.0)
    ab, u1 = b - a, u[:, None]
    if v.get("base.axis_offset") or v.get("platform.axis_offset"):
        return _offset_length(kind, v, c, u, (a, b, rotation))[:, None]
    rows: Callable[[], Any] = {
        "R(P)R": lambda: _norm(ab) - np.hypot(u, lateral),
        "(R)PR": lambda: _dot(_n(u), ab) - lateral,
        "(R)RR": lambda: _norm(ab - p * _d(u)) - v["distal"],
        "R(R)R": lambda: _norm(ab) - np.sqrt(p**2 + v["distal"]**2
                                             + 2 * p * v["distal"] * np.cos(u)),
        "(P)RR": lambda: _norm(ab - u1 * _d(alpha)) - v["length"],
        "P(R)R": lambda: _dot(_n(alpha), ab - v["length"] * _d(alpha + u)),
        "(R)RP": lambda: lateral - _dot(_n(psi), a + p * _d(u) - b),
        "R(R)P": lambda: _dot(_n(psi), ab) + p * np.sin(u),
        "R(P)P": lambda: _dot(_n(psi), ab) + u * np.sin(sigma),
        "(P)RP": lambda: -_dot(_n(psi), a + u1 * _d(alpha) - b),
        "(P)PR": lambda: _dot(_n(alpha + sigma), ab - u1 * _d(alpha)),
        "P(P)R": lambda: _dot(_n(alpha), ab - u1 * _d(alpha + sigma)),
        "U(P)S": lambda: _norm(ab) - np.abs(u),
        "(P)US": lambda: _norm(ab - u1 * c["base.direction"]) - v["length"],
        "(R)US": lambda: _norm(ab - p * _about(c["base.axis"], u, c["base.zero"])) - v["distal"],
        "R(P)S": lambda: (_norm(ab) - np.hypot(u, lateral), ab @ c["base.axis"] - lateral),
    }[kind]
    return np.stack(np.atleast_2d(rows()), axis=-1)


def _offset_length(kind: str, v: Mapping[str, float], c: Mapping[str, Array], u: Array,
                   ends: tuple[Array, Array, Array]) -> Array:
    """Return by how much h^2 + (r - e)^2 is off, as a length (N,): the contract's section 6."""
    a, b, rotation = ends
    foot = {"U(P)S": lambda: a, "(P)US": lambda: a + u[:, None] * c["base.direction"],
            "(R)US": lambda: a + v["proximal"] * _about(c["base.axis"], u, c["base.zero"])}[kind]()
    rod = {"U(P)S": np.abs(u), "(P)US": v.get("length"), "(R)US": v.get("distal")}[kind]
    body = "base" if v.get("base.axis_offset") else "platform"
    axis = c["base.axis"] if body == "base" else rotation @ c["platform.axis"]
    h = _dot(b - foot, axis)
    r = _norm(np.cross(b - foot, axis))
    return np.hypot(h, r - v[f"{body}.axis_offset"]) - rod


# --- the same linkages as products of 4x4 matrices ------------------------------------------------

CHAINS: dict[str, tuple[str, str, str, str]] = {
    # family; base to the first passive joint; on to the second; platform to the second.
    # A, B points; J1 a joint about local z, J1x along local x; Rz:slot, X:slot, Y:slot, Z:slot
    # move; D:slot turns z onto a direction, and D:slot:other x towards that other one; Q turns z
    # onto an axis square to it.
    "R(P)R": ("sphere", "A J1", "J2x X:u Y:lateral J3", "B"),
    "(R)PR": ("guide", "A J1 Rz:u J2x", "Y:lateral J3", "B"),
    "(R)RR": ("sphere", "A J1 Rz:u X:proximal J2", "X:distal J3", "B"),
    "R(R)R": ("sphere", "A J1", "X:proximal J2 Rz:u X:distal J3", "B"),
    "(P)RR": ("sphere", "A Rz:base.angle J1x X:u J2", "X:length J3", "B"),
    "P(R)R": ("guide", "A Rz:base.angle J1x", "J2 Rz:u X:length J3", "B"),
    "(R)RP": ("slot", "A J1 Rz:u X:proximal J2", "-Y:lateral J3x", "B Rz:platform.angle"),
    "R(R)P": ("slot", "A J1", "X:proximal J2 Rz:u J3x", "B Rz:platform.angle"),
    "R(P)P": ("slot", "A J1", "J2x X:u Rz:slide_angle J3x", "B Rz:platform.angle"),
    "(P)RP": ("slot", "A Rz:base.angle J1x X:u J2", "J3x", "B Rz:platform.angle"),
    "(P)PR": ("guide", "A Rz:base.angle J1x X:u Rz:slide_angle J2x", "J3", "B"),
    "P(P)R": ("guide", "A Rz:base.angle J1x", "Rz:slide_angle J2x X:u J3", "B"),
    "U(P)S": ("sphere", "A J1", "J2 Z:u J3", "B"),
    "(P)US": ("sphere", "A D:base.direction J1 Z:u J2", "Z:length J3", "B"),
    "(R)US": ("sphere", "A D:base.axis J1 Rz:u X:proximal J2", "Z:distal J3", "B"),
    "R(P)S": ("circle", "A D:base.axis J1", "J2x X:u Z:lateral J3", "B"),
}
_AXIS = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "-Y": (0.0, -1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


def _place(rotation: Array, shift: Array) -> Array:
    n = max(np.size(rotation) // 9, np.size(shift) // 3)
    out = np.zeros((n, 4, 4))
    out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = rotation, shift, 1.0
    return out


def _oriented(axis: Array, zero: Array | None) -> Array:
    """Axes with z along ``axis``, x towards ``zero``, else the least parallel base axis."""
    x = np.eye(3)[int(np.argmin(np.abs(axis)))] if zero is None else zero
    x = x - (x @ axis) * axis
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def _element(step: str, v: Mapping[str, float], c: Mapping[str, Array], u: Array) -> Array:
    if step in "AB":
        return _place(np.eye(3), _point(v, "base.point" if step == "A" else "platform.point"))
    if step.startswith("J"):
        name = f"joint{step[1]}"
        part = np.array([v.get(f"{name}.{k}", 0.0) for k in ("x", "y", "z", "rx", "ry", "rz")])
        own = np.eye(3) if len(step) == 2 else np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
        return _place(Rotation.from_rotvec(own @ part[3:]).as_matrix(), own @ part[:3])
    if step == "Q":
        return _place(np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), np.zeros(3))
    what, slot, *zero = step.split(":")
    if what == "D":
        turn = Rotation.from_rotvec([v[f"{slot}.{k}"] for k in ("rx", "ry", "rz")]).as_matrix()
        return _place(turn @ _oriented(c[slot], c.get(zero[0] if zero else "base.zero")),
                      np.zeros(3))
    value = np.atleast_1d(u if slot == "u" else v.get(slot, 0.0))
    if what in ("Rx", "Rz"):
        about = [0.0, 0.0, 1.0] if what == "Rz" else [1.0, 0.0, 0.0]
        return _place(Rotation.from_rotvec(value[:, None] * about).as_matrix(), np.zeros(3))
    if what == "Pa":    # moves on without a turn
        return _place(np.eye(3), v["distal"] * np.stack(
            [np.cos(value), 0.0 * value, np.sin(value)], axis=-1))
    return _place(np.eye(3), value[:, None] * np.array(_AXIS[what]))


def chain(steps: str, v: Mapping[str, float], c: Mapping[str, Array], u: Array) -> Array:
    """Return the product (N, 4, 4) of a chain's steps, as :data:`CHAINS` writes them."""
    out = np.eye(4)[None]
    for step in steps.split():
        out = out @ _element(step, v, c, u)
    return out


def _first_axis(body: str, v: Mapping[str, float], c: Mapping[str, Array]) -> Array:
    turn = [v.get(f"{body}.axis.{k}", 0.0) for k in ("rx", "ry", "rz")]
    return Rotation.from_rotvec(turn).as_matrix() @ c[f"{body}.axis"]


def _two_axes(axis: Array, e: float, to_end: Array) -> Array:
    """Return where the second axis of a universal joint is, from the first (N, 3).

    The joint is turned about its first axis (N, 3), in all ways, until its second axis is square to
    the rod: halving finds the angle between one where the rod leans to one side and where it leans
    to the other. The offset points to the rod's other end, ``to_end`` (N, 3) away.
    """
    axis, to_end = np.broadcast_arrays(axis, to_end)
    out = np.empty(axis.shape)
    for i, (a, x) in enumerate(zip(axis, to_end, strict=True)):
        across = _oriented(a, None)[:, 0]

        def joint(t: float, a: Array = a, across: Array = across) -> tuple[Array, Array]:
            turn = Rotation.from_rotvec(t * a)
            return turn.apply(across), turn.apply(np.cross(a, across))

        grid = np.linspace(0.0, 2.0 * math.pi, 17)
        lean = [float(joint(t)[1] @ x) for t in grid]
        roots = [brentq(lambda t, x=x, joint=joint: joint(t)[1] @ x, low, high, xtol=1e-15)
                 for low, high, p, q in zip(grid, grid[1:], lean, lean[1:], strict=False)
                 if p * q < 0.0]
        n = next(joint(t)[0] for t in roots if joint(t)[0] @ x > 0.0)
        out[i] = e * n
    return out


def chain_lengths(kind: str, v: Mapping[str, float], c: Mapping[str, Array], u: Array,
                  pose: Array) -> Array:
    """Return by how far a limb is from closing (N, k), m, with all its frame errors.

    sphere: the two passive joints are as far apart as the link between them. guide: the
    platform's joint is where the passive slide on the base side carries it. slot: the limb's
    joint is where the passive slide on the platform holds it. circle: sphere and guide, the
    guide's normal being the hinge's axis.
    """
    family, first, second, last = CHAINS[kind]
    base, link = chain(first, v, c, u), chain(second, v, c, u)
    rotation, origin = matrices(pose)
    end = _place(rotation, origin) @ chain(last, v, c, u)
    start, stop = base[:, :3, 3], end[:, :3, 3]
    if v.get("base.axis_offset"):
        on = {"(P)US": lambda: _oriented(c["base.direction"], None).T @ _first_axis("base", v, c),
              "(R)US": lambda: np.array([0.0, 0.0, 1.0])}.get(
                  kind, lambda: _first_axis("base", v, c))()
        start = start + _two_axes(base[:, :3, :3] @ on, v["base.axis_offset"], stop - start)
    elif v.get("platform.axis_offset"):
        axis = end[:, :3, :3] @ _first_axis("platform", v, c)
        stop = stop + _two_axes(axis, v["platform.axis_offset"], start - stop)
    apart = stop - start
    reach = _norm(apart) - _norm(link[:, :3, 3])
    if family == "sphere":
        return reach[:, None]
    if family == "guide":
        return (_dot(base[:, :3, 1], apart) - link[:, 1, 3])[:, None]
    if family == "circle":
        return np.stack([reach, _dot(base[:, :3, 2], apart) - link[:, 2, 3]], axis=-1)
    return (_dot(end[:, :3, 1], apart) + np.linalg.inv(link)[:, 1, 3])[:, None]


def assert_slopes_of_lengths(model: Model, q: Array, pose: Array, by_joint_atol: float) -> None:
    """The closure's matrices are central differences of the limbs' own lengths."""
    closure, h = model.closure(q), 1e-5
    by_pose, by_joint = closure.pose_matrix(pose), closure.joint_matrix(pose)
    for column, coordinate in enumerate(model.mechanism.dof):
        step = h * np.eye(6)[coordinate]
        expected = (limb_lengths(model, q, displaced(pose, step))
                    - limb_lengths(model, q, displaced(pose, -step))) / (2.0 * h)
        np.testing.assert_allclose(by_pose[..., column], expected, rtol=1e-8, atol=1e-9)
    for k in range(q.shape[1]):
        step = h * np.eye(q.shape[1])[k]
        expected = (limb_lengths(model, q + step, pose)
                    - limb_lengths(model, q - step, pose)) / (2.0 * h)
        np.testing.assert_allclose(by_joint[..., k], expected, rtol=1e-8, atol=by_joint_atol)


def limb_lengths(model: Model, q: Array, pose: Array, own: Callable[..., Array] = chain_lengths,
                 only: int | None = None) -> Array:
    """Return all limbs' own lengths side by side (N, d), or one limb's."""
    parts = []
    for i, (limb, u) in enumerate(zip(model.mechanism.limbs, joint_coordinates(model, q),
                                      strict=True)):
        if only in (None, i):
            row = own(limb.kind.name, limb.slots.values(model.parameters), limb.constants, u, pose)
            parts.append(np.broadcast_to(row, (len(q), row.shape[1])))
    return np.concatenate(parts, axis=1)


def rows_of(mechanism: Mechanism) -> list[slice]:
    """Return the rows of the stacked conditions that belong to each limb."""
    out, row = [], 0
    for limb in mechanism.limbs:
        out.append(slice(row, row + (2 if limb.kind.name == "R(P)S" else 1)))
        row = out[-1].stop
    return out


FURTHER: dict[str, dict[str, object]] = {
    "product": {"of": ["backlash", "temperature"]},
    "learned": {"input": "travel", "nodes": [-1e4, -3e3, 4e3, 1e4],
                "values": [2e-5, -1e-5, 3e-5, 0.0],
                "covariance": [[1e-12 * (i == j) for j in range(4)] for i in range(4)]}}
"""What a file says beside joints and parameters of a kind that is made of that."""
