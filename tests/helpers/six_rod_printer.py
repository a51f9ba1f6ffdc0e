"""A delta printer whose effector tilts, simulated without the package: six rods, SciPy's solver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.optimize import brentq, fsolve
from scipy.spatial.transform import Rotation

ANGLES = np.radians([210.0, 330.0, 90.0])
STEP = 0.0025
TRIGGER = 1.5
"""mm of travel per microstep; height of the nozzle at the trigger, mm."""


class SixRodPrinter:
    """What the printer is, mm; its firmware believes in ``numbers``."""

    def __init__(self, seed: int, apart: float = 1.0) -> None:
        rng = np.random.default_rng(seed)
        self.numbers = {"radius": 140.0, "angles": ANGLES, "arms": np.full(3, 300.0),
                        "ends": np.full(3, 330.0)}
        radius, spacing, self.effector = 140.0 + rng.normal(0.0, 0.4), 60.0, 40.0
        at = ANGLES + np.radians([*rng.normal(0.0, 0.2, 2), 0.0])
        self.ends = 330.0 + rng.normal(0.0, 0.4, 3)
        rod = 300.0 + rng.normal(0.0, 0.15)
        self.tower = np.repeat(np.arange(3), 2)
        side = np.tile([-0.5, 0.5], 3)[:, None] * spacing
        out, across = (np.stack([f(at), g(at), 0.0 * at], axis=1)[self.tower] for f, g in (
            (np.cos, np.sin), (lambda a: -np.sin(a), np.cos)))
        flat, along = (np.stack([f(ANGLES), g(ANGLES), 0.0 * at], axis=1)[self.tower]
                       for f, g in ((np.cos, np.sin), (lambda a: -np.sin(a), np.cos)))
        self.base = (radius + self.effector) * out + side * across + apart * rng.normal(
            0.0, 0.07, (6, 3))
        self.joint = self.effector * flat + side * along + apart * rng.normal(0.0, 0.05, (6, 3))
        self.rods = rod + apart * rng.normal(0.0, 0.05, 6)

    def down(self, point: np.ndarray) -> np.ndarray:
        """Return how far the firmware sends each carriage below its endstop."""
        n = self.numbers
        foot = n["radius"] * np.stack([np.cos(n["angles"]), np.sin(n["angles"])], axis=1)
        top = n["ends"] + np.sqrt(n["arms"]**2 - n["radius"]**2)
        return top - np.sqrt(n["arms"]**2 - np.sum((foot - point[:2])**2, axis=1)) - point[2]

    def tip(self, point: np.ndarray, offset: tuple[float, float]) -> np.ndarray:
        """Return where the tip beside the nozzle is when the nozzle is sent to a point."""
        height = self.ends + np.sqrt(300.0**2 - 140.0**2) - self.down(point)
        carriage = self.base + np.outer(height[self.tower], [0.0, 0.0, 1.0])

        def gap(pose: np.ndarray) -> np.ndarray:
            held = pose[:3] + Rotation.from_rotvec(pose[3:]).apply(self.joint)
            return np.linalg.norm(carriage - held, axis=1) - self.rods

        pose = fsolve(gap, [*point, 0.0, 0.0, 0.0], xtol=1e-12)
        assert np.abs(gap(pose)).max() < 1e-8
        return pose[:3] + Rotation.from_rotvec(pose[3:]).apply([*offset, 0.0])

    def touched(self, place: np.ndarray, offset: tuple[float, float], height: float) -> np.ndarray:
        """Return where the nozzle has been sent when the tip is at that height."""
        z = brentq(lambda z: self.tip(np.array([*place, z]), offset)[2] - height, -9.0, 9.0,
                   xtol=1e-9)
        return np.array([*place, z])

    def config(self, path: Path, probe: tuple[float, float], probed: np.ndarray,
               by_hand: np.ndarray, sigma: float, seed: int) -> Path:
        """Write a printer.cfg with what the probe and the nozzle have touched."""
        rng = np.random.default_rng(seed)
        lines = ["[printer]", "kinematics: delta", "delta_radius: 140", "[probe]",
                 f"x_offset: {probe[0]}", f"y_offset: {probe[1]}", f"z_offset: {TRIGGER}"]
        for tower in "abc":
            lines += [f"[stepper_{tower}]", "rotation_distance: 40", "microsteps: 80",
                      "arm_length: 300", "position_endstop: 330"]
        lines.append("[delta_calibrate]")
        for name, places, offset, height in (("height", probed, probe, TRIGGER),
                                             ("manual_height", by_hand, (0.0, 0.0), 0.0)):
            for i, place in enumerate(places):
                at = self.touched(place, offset, height) + [0.0, 0.0, rng.normal(0.0, sigma)]
                steps = ", ".join(f"{s:.3f}" for s in self.down(at) / STEP)
                lines += [f"{name}{i}: {height}", f"{name}{i}_pos: {steps}"]
        path.write_text("\n".join(lines) + "\n")
        return path


def places(count: int, radius: float) -> np.ndarray:
    """Return so many places (count, 2), spread evenly over a disc."""
    n = np.arange(count)
    return (radius * np.sqrt((n + 0.5) / count))[:, None] * np.stack(
        [np.cos(2.399963 * n), np.sin(2.399963 * n)], axis=1)
