"""Causes without memory: play's sign, stiffness, heat, and errors of screws and joints.

Every maker draws legs and unit sizes from a generator and returns an Effect.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from .campaign import Run, total_wrench
from .kinematics import COLUMNS, platform_arms, pose_by_joint
from .world import Effect, State

Shape = Callable[[Run, dict], np.ndarray]


def unit(run: Run) -> str:
    """Unit of an actuator."""
    return "rad" if run.machine.rotary else "mm"


def tick(run: Run) -> float:
    """A small joint error: 0.02 mm, or the angle that gives about as much."""
    return 0.02 / 150 if run.machine.rotary else 0.02


def pick(rng, run: Run, how: str) -> tuple[int, ...]:
    """Legs: one | all | some (two)."""
    legs = run.q.shape[1]
    if how == "all":
        return tuple(range(legs))
    return tuple(sorted(int(i) for i in rng.choice(legs, 1 if how == "one" else 2, replace=False)))


def mask(run: Run, legs) -> np.ndarray:
    """One on the legs that are meant (L,)."""
    on = np.zeros(run.q.shape[1])
    on[list(legs)] = 1
    return on


def joint_effect(kind, legs, values, sized, units, shape: Shape, **more) -> Effect:
    """An effect that adds shape(run, values) (N, L) to the joints of some legs."""

    def apply(state: State, run: Run, v: dict) -> None:
        state.du += mask(run, legs) * shape(run, v)

    return Effect(kind, legs, values, sized, units, apply, **more)


def stroke(run: Run) -> np.ndarray:
    """Joint values from −1 to 1 over the joint range (N, L)."""
    low, high = run.machine.limits.T
    return (run.q - (low + high) / 2) / ((high - low) / 2)


def simple(kind: str, how: str, name: str, shape: Shape, size=None, per: str = ""):
    """Maker of an effect with one number, in actuator units (times ``per``)."""

    def make(rng, run: Run) -> Effect:
        legs = pick(rng, run, how)
        value = size(run) if size else tick(run)
        return joint_effect(kind, legs, {name: value}, (name,), {name: unit(run) + per}, shape)

    return make


def backlash(how: str, behind: bool = False):
    """Approach sign times half a width; ``behind``: the joint stays behind its encoder."""
    size = (lambda r: -tick(r)) if behind else None
    return simple("backlash", how, "width", lambda r, v: r.dirs * v["width"] / 2, size)


def windup(how: str):
    """Approach sign times load."""
    return simple("windup", how, "width", lambda r, v: r.dirs * v["width"] * np.abs(r.load),
                  lambda r: tick(r) / np.abs(r.load).mean(), "/N")  # fmt: skip


def gain(how: str):
    """Proportional error of an encoder."""
    return simple("gain", how, "gain", lambda r, v: v["gain"] * r.q, lambda r: 1e-4, "/unit")


def lag(how: str):
    """Joint behind by velocity times a delay."""
    return simple("lag", how, "tau", lambda r, v: -v["tau"] * r.speed,
                  lambda r: tick(r) / np.abs(r.speed).mean(), "·s/unit")  # fmt: skip


def clearance(how: str):
    """Half a width to the side where the load pushes."""
    return simple("clearance", how, "width", lambda r, v: np.sign(r.load) * v["width"] / 2)


def speed_squared(how: str):
    """Error with the square of speed: in no list."""
    return simple("learned", how, "size", lambda r, v: v["size"] * (r.speed / r.speed.std()) ** 2)


def periodic(how: str):
    """Screw or gear error: cosine and sine of the joint."""

    def make(rng, run):
        period = (
            np.radians(rng.choice([7.2, 10.0])) if run.machine.rotary else rng.choice([4.0, 5, 10])
        )
        legs, phase = pick(rng, run, how), rng.uniform(0, 2 * np.pi)
        values = {
            "cos": tick(run) * np.cos(phase),
            "sin": tick(run) * np.sin(phase),
            "period": period,
        }
        units = dict.fromkeys(values, unit(run))

        def shape(r, v):
            turn = 2 * np.pi * r.q / v["period"]
            return v["cos"] * np.cos(turn) + v["sin"] * np.sin(turn)

        return joint_effect("periodic", legs, values, ("cos", "sin"), units, shape)

    return make


def eccentricity(how: str):
    """Disc off its centre: once and twice per turn."""

    def make(rng, run):
        legs, size = pick(rng, run, how), tick(run) * rng.normal(size=4)
        values = dict(zip(("cos", "sin", "cos2", "sin2"), size, strict=True))

        def shape(r, v):
            return (v["cos"] * np.cos(r.q) + v["sin"] * np.sin(r.q)
                    + v["cos2"] * np.cos(2 * r.q) + v["sin2"] * np.sin(2 * r.q))  # fmt: skip

        units = dict.fromkeys(values, "rad")
        return joint_effect("eccentricity", legs, values, tuple(values), units, shape)

    return make


def curvature(how: str):
    """Smooth screw error: Legendre P2 to P4 over the joint range."""

    def make(rng, run):
        legs, size = pick(rng, run, how), tick(run) * rng.normal(size=3)
        values = dict(zip(("p2", "p3", "p4"), size, strict=True))

        def shape(r, v):
            return np.polynomial.legendre.legval(stroke(r), [0, 0, v["p2"], v["p3"], v["p4"]])

        units = dict.fromkeys(values, unit(run))
        return joint_effect("curvature", legs, values, tuple(values), units, shape)

    return make


def wear(how: str):
    """A worn place of the screw: a dip in the middle of the stroke. In no list."""

    def make(rng, run):
        at, wide = rng.uniform(-0.4, 0.4), rng.uniform(0.08, 0.15)
        values = {"depth": tick(run), "at": at, "wide": wide}
        return joint_effect(
            "learned", pick(rng, run, how), values, ("depth",),
            {"depth": unit(run), "at": "half stroke"},
            lambda r, v: -v["depth"] * np.exp(-(((stroke(r) - v["at"]) / v["wide"]) ** 2)),
        )  # fmt: skip

    return make


def compliance(how: str, hardening: bool = False, by_stroke: bool = False):
    """Load over stiffness, perhaps hardening (per N) or changing along the stroke."""

    def make(rng, run):
        give = tick(run) / np.abs(run.load).mean()
        values, units = {"give": give}, {"give": unit(run) + "/N"}
        if hardening:
            values["hardening"], units["hardening"] = 2.0 / np.abs(run.load).max(), "1/N"
        if by_stroke:
            values["by_stroke"], units["by_stroke"] = rng.choice([-0.7, 0.7]), "1/half stroke"

        def shape(r, v):
            soft = 1 + v.get("by_stroke", 0) * stroke(r)
            return v["give"] * soft * r.load / (1 + v.get("hardening", 0) * np.abs(r.load))

        return joint_effect("compliance", pick(rng, run, how), values, ("give",), units, shape)

    return make


def load_under(run: Run, wrench: np.ndarray) -> np.ndarray:
    """Actuator loads (N, L) under another wrench (N, 6)."""
    jac = pose_by_joint(run.geo, run.q, run.pos, run.rot, run.machine.motion)
    return np.einsum("ndl,nd->nl", jac, wrench[:, COLUMNS[run.machine.motion]])


def off_centre(rng, run: Run) -> Effect:
    """Compliance, with the payload's centre of mass beside the platform's origin."""
    arm = rng.uniform(-80, 80, 3) * ([1, 1, 0] if run.machine.motion == "planar" else [1, 1, 1])

    def shape(r, v):
        wrench = total_wrench(r)
        wrench[:, 3:] += np.cross(r.rot @ v["arm"], wrench[:, :3])
        return v["give"] * load_under(r, wrench)

    values = {"give": tick(run) / np.abs(run.load).mean(), "arm": arm}
    units = {"give": unit(run) + "/N", "arm": "mm"}
    return joint_effect("compliance", pick(rng, run, "all"), values, ("give",), units, shape,
                        note="payload's centre of mass is at arm, not at the origin")  # fmt: skip


def gravity_wrong(rng, run: Run) -> Effect:
    """Compliance, with weight not along the direction that the mechanism file says."""
    turn = rng.uniform(25, 50) * rng.choice([-1, 1])
    about = [0, 0, 1] if run.machine.motion == "planar" else _level(rng)
    spin = Rotation.from_rotvec(np.radians(turn) * np.array(about)).as_matrix()

    def shape(r, v):
        return v["give"] * load_under(
            r, np.hstack([total_wrench(r)[:, :3] @ spin.T, 0 * r.wrench[:, 3:]])
        )

    values = {"give": tick(run) / np.abs(run.load).mean(), "gravity": spin @ run.machine.gravity}
    units = {"give": unit(run) + "/N", "gravity": "direction"}
    return joint_effect("compliance", pick(rng, run, "all"), values, ("give",), units, shape,
                        note="weight acts along gravity, not as the file says")  # fmt: skip


def _level(rng) -> np.ndarray:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle), 0])


def joint_gap(how: str):
    """First and second axis of the base's universal joints do not meet."""

    def make(rng, run):
        legs = pick(rng, run, how)

        def apply(state, r, v):
            state.gap = state.gap + mask(r, legs) * v["axis_offset"]

        note = "geometry: base.axis_offset about base.axis, both missing in the file"
        values = {"axis_offset": 1.0, "axis": run.geo.u_axis[0, list(legs)]}
        units = {"axis_offset": "mm", "axis": "direction"}
        return Effect("geometry", legs, values, ("axis_offset",), units, apply, note=note)

    return make


def arms(run: Run) -> np.ndarray:
    """Platform joints in base axes (N, L, 3)."""
    return platform_arms(run.geo, run.rot)
