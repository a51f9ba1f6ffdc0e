"""The effects of the contract's table, implemented a second time.

Nothing here uses the program's effects: each kind is its line of the table on a
:class:`hidden_scene.Scene`, in SI. s = approach, f = load on the actuator, T = temperature
minus 20 degrees Celsius.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hidden_scene import (
    STANDARD_GRAVITY,
    Array,
    Cause,
    Change,
    Kind,
    Scene,
    Values,
    positive,
    signed,
)
from numpy.typing import NDArray

from ppmcal.model.mechanism import Mechanism

STRUTS = ("R(P)R", "U(P)S", "R(P)S")
"""Limbs whose driven slide is the strut itself."""
LENGTHS = ("length", "proximal", "distal")
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
LOADS = ("fx", "fy", "fz", "mx", "my", "mz")


def small(scene: Scene) -> float:
    """Return a small error of a joint: a 1e-5 part of the reach, or 1e-5 rad."""
    return 1e-5 * (1.0 if scene.rotary else scene.mechanism.reach)


def chosen(scene: Scene, cause: Cause) -> NDArray[np.bool_]:
    """Return which actuators a cause acts on (k,)."""
    return np.array([a in cause.on for a in scene.mechanism.actuators])


def of_joints(error: Callable[[Scene, Values], Array]) -> Callable[[Scene, Cause], Change]:
    """Return the change of an effect that adds ``error(scene, parameters)`` (N, k) to u."""
    def change(scene: Scene, cause: Cause) -> Change:
        return Change(joints=np.where(chosen(scene, cause), error(scene, cause.parameters), 0.0))

    return change


def _legendre(scene: Scene, p: Values) -> Array:
    low, high = scene.stroke[:, 0], scene.stroke[:, 1]
    x = 2.0 * (scene.q - low) / (high - low) - 1.0
    return np.asarray(p["p2"] * (3.0 * x**2 - 1.0) / 2.0 + p["p3"] * (5.0 * x**3 - 3.0 * x) / 2.0
                      + p["p4"] * (35.0 * x**4 - 30.0 * x**2 + 3.0) / 8.0, dtype=float)


def _waves(scene: Scene, p: Values) -> Array:
    turn = 2.0 * np.pi * scene.q / p["period"]
    return np.asarray(p["cos"] * np.cos(turn) + p["sin"] * np.sin(turn), dtype=float)


def _off_centre(scene: Scene, p: Values) -> Array:
    q = scene.q
    return np.asarray(p["cos"] * np.cos(q) + p["sin"] * np.sin(q) + p["cos2"] * np.cos(2.0 * q)
                      + p["sin2"] * np.sin(2.0 * q), dtype=float)


def _pitch(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    """A screw of some millimetres, or a gear: several periods within what is visited."""
    least = float(np.ptp(scene.visited, axis=1).min())
    pitches = (2.0 * np.pi / np.array([24, 36, 48, 60, 90, 120]) if scene.rotary
               else np.array([2e-3, 4e-3, 5e-3, 8e-3, 10e-3, 16e-3, 20e-3, 25e-3]))
    usable = pitches[pitches < least / 3.0]
    phase = rng.uniform(0.0, 2.0 * np.pi)
    return {"cos": small(scene) * np.cos(phase), "sin": small(scene) * np.sin(phase),
            "period": float(rng.choice(usable[-4:] if usable.size else pitches[:1]))}


def _stiff(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    return {"stiffness": positive(rng) * float(np.abs(scene.load).max()) / small(scene)}


def _joint_kinds() -> dict[str, Kind]:
    def one(name: str, sign: Callable[[np.random.Generator], float], unit: float = 0.0
            ) -> Callable[[Scene, np.random.Generator], dict[str, float]]:
        return lambda scene, rng: {name: (unit or small(scene)) * sign(rng)}

    def several(*names: str) -> Callable[[Scene, np.random.Generator], dict[str, float]]:
        return lambda scene, rng: {n: small(scene) * signed(rng) for n in names}

    def turning(mechanism: Mechanism) -> bool:
        return set(mechanism.actuator_quantity) == {"angle"}

    around = ("cos", "sin", "cos2", "sin2")
    return {
        "gain": Kind(of_joints(lambda s, p: p["gain"] * s.q), one("gain", signed, 1e-5),
                     ("gain",), joints=True),
        "curvature": Kind(of_joints(_legendre), several("p2", "p3", "p4"), ("p2", "p3", "p4"),
                          joints=True),
        "periodic": Kind(of_joints(_waves), _pitch, ("cos", "sin"), joints=True),
        "eccentricity": Kind(of_joints(_off_centre), several(*around), around, joints=True,
                             fits=turning),
        "backlash": Kind(of_joints(lambda s, p: s.approach * p["width"] / 2.0),
                         one("width", positive), ("width",), joints=True),
        "windup": Kind(of_joints(lambda s, p: s.approach * p["width"] * np.abs(s.load)),
                       lambda s, rng: {"width": 1.0 / _stiff(s, rng)["stiffness"]}, ("width",),
                       joints=True),
        "lag": Kind(of_joints(lambda s, p: -p["tau"] * s.velocity), one("tau", positive, 1e-3),
                    ("tau",), joints=True),
        "compliance": Kind(of_joints(lambda s, p: s.load / p["stiffness"]), _stiff,
                           ("stiffness",), inverse=True, joints=True),
        "clearance": Kind(of_joints(lambda s, p: np.sign(s.load) * p["width"] / 2.0),
                          one("width", positive), ("width",), joints=True),
    }


def _base_compliance(scene: Scene, cause: Cause) -> Change:
    """``z_fz``: displacement along z for a force along z, m/N, and so on."""
    give = np.zeros((6, 6))
    for name, value in cause.parameters.items():
        moves, load = name.split("_")
        give[COMPONENTS.index(moves), LOADS.index(load)] = value
    return Change(pose=scene.wrench @ give.T)


def _draw_give(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    """What the weight moves, mostly along itself: 1e-5 of the reach at full load."""
    down = int(np.argmax(np.abs(scene.mechanism.gravity)))
    unit = 1e-5 * scene.mechanism.reach / (STANDARD_GRAVITY * float(scene.payload.max()) or 1.0)
    out = {}
    for i in scene.mechanism.dof:
        size = positive(rng) if i == down else 0.3 * float(rng.normal())
        out[f"{COMPONENTS[i]}_{LOADS[down]}"] = size * unit / (
            scene.mechanism.length_scale if i > 2 else 1.0)
    return out


def _drift(scene: Scene, cause: Cause) -> Change:
    rate = np.zeros(6)
    for i, name in enumerate(COMPONENTS):
        rate[i] = cause.parameters.get(name, 0.0)
    return Change(pose=scene.time[:, None] * rate)


def _draw_drift(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    whole = 1e-5 * scene.mechanism.reach / float(scene.time.max())
    turn = whole / scene.mechanism.length_scale
    return {c: float(rng.normal()) * (turn if c.startswith("r") else whole)
            for c in scene.mechanism.coordinates}


def _leg_thermal(scene: Scene, cause: Cause) -> Change:
    strain = cause.parameters["expansion"] * scene.temperature
    slots: dict[tuple[int, str], Array] = {}
    for i, limb in enumerate(scene.mechanism.limbs):
        values = limb.slots.values(scene.g)
        slots |= {(i, s): strain * values[s] for s in LENGTHS if s in values}
        if limb.kind.name in STRUTS:
            slots[i, "offset"] = strain * scene.model.joint_coordinate(i, scene.q)
    return Change(slots=slots)


def _has_struts(mechanism: Mechanism) -> bool:
    return any(limb.kind.name in STRUTS or any(s in LENGTHS for s, _ in limb.slots.direct)
               for limb in mechanism.limbs)


def _points_thermal(body: str) -> Callable[[Scene, Cause], Change]:
    def change(scene: Scene, cause: Cause) -> Change:
        strain = cause.parameters["expansion"] * scene.temperature
        slots: dict[tuple[int, str], Array] = {}
        for i, limb in enumerate(scene.mechanism.limbs):
            for slot, value in limb.slots.values(scene.g).items():
                if slot.startswith(f"{body}.point.") and slot[-2:] in (".x", ".y", ".z"):
                    slots[i, slot] = strain * value
        return Change(slots=slots)

    return change


def _tilt(scene: Scene, cause: Cause) -> Change:
    angle, shrink = cause.parameters["direction"], cause.parameters["shrink"]
    d = np.array([np.cos(angle), np.sin(angle), 0.0])
    return Change(sensor=lambda point: -shrink * (point @ d)[:, None] * d)


def _sensor_scale(scene: Scene, cause: Cause) -> Change:
    return Change(sensor=lambda point: cause.parameters["scale"] * point)


def _expansion(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    return {"expansion": 5e-6 * positive(rng)}


def _machine_kinds() -> dict[str, Kind]:
    heat = ("expansion",)
    return {
        "base_compliance": Kind(_base_compliance, _draw_give, ()),
        "leg_thermal": Kind(_leg_thermal, _expansion, heat, fits=_has_struts),
        "base_thermal": Kind(_points_thermal("base"), _expansion, heat),
        "platform_thermal": Kind(_points_thermal("platform"), _expansion, heat),
        "drift": Kind(_drift, _draw_drift, ()),
        "sensor_scale": Kind(_sensor_scale, lambda s, rng: {"scale": 1e-5 * signed(rng)},
                             ("scale",)),
        "tilt": Kind(_tilt, lambda s, rng: {"shrink": 1e-5 * positive(rng),
                                            "direction": float(rng.uniform(0.0, np.pi))},
                     ("shrink",), fits=lambda m: m.motion.planar),
    }


LIBRARY: dict[str, Kind] = {**_joint_kinds(), **_machine_kinds()}
"""All kinds of the contract but ``geometry``, whose parameters are the frozen slots themselves."""
