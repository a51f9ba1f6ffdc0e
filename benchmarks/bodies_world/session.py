"""A campaign in a world: joints are commanded, everything settles, encoders and pose are read.

What is recorded of a joint is its motor's ``qpos``, as an encoder on the motor reads it. The
servo's own droop under load is then no error of the campaign: only what lies behind the encoder is,
as on a real drive.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from .machines import Machine, Shape
from .mjcf import Faults

STILL, CREEP = 1e-7, 1e-5
"""A world has settled when no speed (m/s, rad/s) is larger; with friction the second: MuJoCo's
friction is soft too, and what sticks creeps on by some 1e-6 rad/s,"""
BRISK, SLOW = 50.0, 0.2
"""Largest acceleration of a move, m/s² or rad/s²; with friction the second, at which inertia is a
small part of friction: what is fast shoots ahead when it stops, and sticks there."""
PATIENCE = 6000
"""or after so many steps, which is an error."""


class Unsettled(RuntimeError):
    """A world went on moving."""


@dataclass(frozen=True)
class Run:
    """What was recorded, N rows in the order taken, without noise.

    ``q`` (N, L): encoders, m or rad; ``position`` (N, 3), m, ``rotation`` (N, 3, 3): platform in
    the base; ``payload`` (N,), kg; ``direction`` (N, L): +1 after a move up, -1 down.
    """

    q: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    payload: np.ndarray
    direction: np.ndarray


class World:
    """A machine put together, at rest at home."""

    def __init__(self, machine: Machine, shape: Shape, faults: Faults) -> None:
        text, self.home = machine.build(machine, shape, faults)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self.encoders = [self.model.joint(name).qposadr[0] for name in machine.legs]
        self.platform = self.model.body("platform").id
        self.load = self.model.body("payload").id
        self.still, self.pace = (CREEP, SLOW) if faults.friction else (STILL, BRISK)
        self.data.ctrl[:] = self.home
        self.target = self.home.copy()
        self.settle()

    def carry(self, mass: float) -> None:
        """Put a payload (kg) in place of what is carried."""
        self.model.body_mass[self.load] = mass + 1e-6
        self.model.body_inertia[self.load] = 0.4 * (mass + 1e-6) * 0.02**2
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))   # sums of masses

    def go(self, target: np.ndarray) -> None:
        """Move all joints to their targets together, each in one direction, and settle."""
        away, start = target - self.target, self.target
        time = np.sqrt(5.78 * np.abs(away).max() / self.pace)
        parts = max(10, int(time / (10 * self.model.opt.timestep)))
        for t in np.linspace(0.0, 1.0, parts + 1)[1:]:
            self.data.ctrl[:] = start + t**3 * (10.0 - 15.0 * t + 6.0 * t**2) * away
            mujoco.mj_step(self.model, self.data, nstep=10)
        self.target = target
        self.settle()

    def settle(self) -> None:
        """Step until nothing moves."""
        for _ in range(PATIENCE // 50):
            mujoco.mj_step(self.model, self.data, nstep=50)
            if np.abs(self.data.qvel).max() < self.still:
                return
        raise Unsettled(f"a speed of {np.abs(self.data.qvel).max():.1e} after {PATIENCE} steps")

    def read(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the encoders (L,), the platform's position (3,) and rotation (3, 3)."""
        mujoco.mj_kinematics(self.model, self.data)
        return (self.data.qpos[self.encoders].copy(), self.data.xpos[self.platform].copy(),
                self.data.xmat[self.platform].reshape(3, 3).copy())


def measure(machine: Machine, shape: Shape, faults: Faults, targets: np.ndarray,
            payload: np.ndarray) -> Run:
    """Visit targets (N, L), joint values from home, with payloads (N,), kg, one after another."""
    world = World(machine, shape, faults)
    rows, before, ways = [], world.target, []
    for away, mass in zip(targets, payload, strict=True):
        world.carry(float(mass))
        world.go(world.home + away)
        ways.append(np.sign(world.target - before))
        before = world.target
        rows.append(world.read())
    q, position, rotation = (np.array(part) for part in zip(*rows, strict=True))
    return Run(q - shape.offset, position, rotation, payload, np.array(ways))
