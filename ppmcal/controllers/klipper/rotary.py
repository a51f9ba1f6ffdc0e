"""Klipper's rotary delta: what ``printer.cfg`` says of one, and the firmware's arithmetic.

Arm i turns in the upright plane through the middle at angle w_i, about a shoulder at radius R and
height H over the bed. For a point (x, y, z), with

    c = y cos w - x sin w,    d = x cos w + y sin w - R,    e = z - H,

its elbow is where the arm's circle and that of the rods in the plane, of radius
sqrt(lower^2 - c^2) about (d, e), meet, farther out; the motor's angle is that of the arm over the
horizontal. Homing sets it to the angle for (0, 0, ``position_endstop``), and motors count down
from there (Klipper: ``rotary_delta.py``, ``kin_rotary_delta.c``). Steps are not rounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ppmcal.controllers.delta.geometry import DIGITS, MM, TOWERS, Triple, triple
from ppmcal.controllers.klipper.config import Config, geared
from ppmcal.controllers.text import Rounded
from ppmcal.errors import BadInput
from ppmcal.linalg import Array

KINEMATICS = "rotary_delta"
SHOULDERS = (30.0, 150.0, 270.0)
"""Angles of the arms where nobody says, degrees."""


@dataclass(frozen=True)
class RotaryDelta(Rounded, digits=DIGITS):
    """The numbers of a rotary delta: mm and degrees; triples are arms a, b, c."""

    radius: float
    height: float
    angles: Triple
    upper: Triple
    lower: Triple
    endstops: Triple

    def named(self) -> dict[str, float]:
        """Return ``section.key`` and value of each number, mm and degrees."""
        out = {"printer.shoulder_radius": self.radius, "printer.shoulder_height": self.height}
        for i, arm in enumerate(TOWERS):
            out |= {f"stepper_{arm}.angle": self.angles[i],
                    f"stepper_{arm}.upper_arm_length": self.upper[i],
                    f"stepper_{arm}.lower_arm_length": self.lower[i],
                    f"stepper_{arm}.position_endstop": self.endstops[i]}
        return out

    def array(self) -> Array:
        """Return the numbers (14,) in their order."""
        return np.array([self.radius, self.height, *self.angles, *self.upper, *self.lower,
                         *self.endstops])

    @classmethod
    def of(cls, numbers: Array) -> RotaryDelta:
        """Return the geometry of numbers (14,)."""
        return cls(float(numbers[0]), float(numbers[1]),
                   *(triple(numbers[i:i + 3]) for i in (2, 5, 8, 11)))


def is_rotary(config: Config) -> bool:
    """Return whether a ``printer.cfg`` is that of a rotary delta."""
    kind = config.sections.get("printer", {}).get("kinematics")
    return kind is not None and kind.text == KINEMATICS


def read_rotary(config: Config) -> RotaryDelta:
    """Return the numbers of a ``printer.cfg``; b and c default to a's, as in the firmware.

    Raises:
        BadInput: a number is missing, or the arms do not get to the middle.
    """
    if not is_rotary(config):
        raise BadInput(f"kinematics is not {KINEMATICS}", config.at("printer", "kinematics"),
                       "Give the printer.cfg of a rotary delta")
    def each(key: str, usual: tuple[float | None, ...] = (None,) * 3, positive: bool = True
             ) -> Triple:
        out: list[float] = []
        for arm, default in zip(TOWERS, usual, strict=True):
            known = out[0] if out and default is None else default
            out.append(config.number(f"stepper_{arm}", key, known, positive=positive))
        return triple(out)

    delta = RotaryDelta(
        config.number("printer", "shoulder_radius", positive=True),
        config.number("printer", "shoulder_height", positive=True),
        each("angle", SHOULDERS, positive=False), each("upper_arm_length"),
        each("lower_arm_length"), each("position_endstop"))
    for arm, angle in zip(TOWERS, endstop_angles(delta), strict=True):
        if not math.isfinite(angle):
            raise BadInput(f"arm {arm} does not get to the middle at its endstop",
                           config.at(f"stepper_{arm}", "lower_arm_length"),
                           "Check shoulder_radius, shoulder_height and both lengths")
    return delta


def read_motor_step(config: Config, arm: str) -> float:
    """Return the motor's turn per microstep, degrees: a turn of the arm unless the file says.

    Raises:
        BadInput: the numbers give none.
    """
    name = f"stepper_{arm}"
    steps = config.number(name, "full_steps_per_rotation", 200.0, positive=True)
    steps *= config.number(name, "microsteps", positive=True)
    gear = config.section(name).get("gear_ratio")
    if gear is None or not gear.text:
        raise BadInput("is missing", config.at(name, "gear_ratio"),
                       "Klipper wants the teeth from motor to arm, such as `107:16, 60:16`")
    return 360.0 / geared(config, name, steps, "107:16, 60:16")


def arm_angles(delta: RotaryDelta, point: Array) -> Array:
    """Return the motors' angles (N, 3) for points (N, 3), m; rad over the horizontal.

    nan where an arm does not get there.
    """
    turn = np.radians(delta.angles)
    x, y, z = (point[:, None, i] / MM for i in range(3))
    across = y * np.cos(turn) - x * np.sin(turn)
    out = x * np.cos(turn) + y * np.sin(turn) - delta.radius
    up = z - delta.height
    upper, lower = np.array(delta.upper), np.array(delta.lower)
    far = np.hypot(out, up)
    with np.errstate(invalid="ignore", divide="ignore"):
        # the triangle of shoulder, elbow and the rods' end in the arm's plane
        inner = np.arccos((far**2 + upper**2 - lower**2 + across**2) / (2.0 * upper * far))
        inner = np.where(lower**2 >= across**2, inner, np.nan)
    toward = np.arctan2(up, out)
    both = np.stack([toward + inner, toward - inner])
    # the elbow that is farther out
    chosen = np.where(np.cos(both[0]) >= np.cos(both[1]), both[0], both[1])
    return np.asarray((chosen + np.pi) % (2.0 * np.pi) - np.pi)


def endstop_angles(delta: RotaryDelta) -> Array:
    """Return the motors' angles (3,) at the endstops, rad."""
    points = np.pad(MM * np.array(delta.endstops)[:, None], ((0, 0), (2, 0)))
    return np.asarray(np.diagonal(arm_angles(delta, points)))


def turns_down(delta: RotaryDelta, point: Array) -> Array:
    """Return how far below its endstop each arm is for points (N, 3), m: (N, 3), rad."""
    return np.asarray(endstop_angles(delta) - arm_angles(delta, point))
