"""A stage that is not quite as drawn, and a camera above it that sees two marks on it."""

import csv
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

rng = np.random.default_rng(31)
base = np.array([[-210, -125], [210, -125], [0, 242]]) + rng.normal(0, 0.25, (3, 2))
platform = np.array([[0, -60], [52, 30], [-52, 30]]) + rng.normal(0, 0.25, (3, 2))
zero = rng.normal(0, 0.25, 3)
marks = {"T1": np.array([20.0, 5.0]), "T2": np.array([-25.0, 12.0])}
camera, lens = np.deg2rad(37.0), np.array([312.0, 205.0])


def turned(angle, points):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def legs(pose):
    ends = pose[:2] + turned(pose[2], platform)
    return np.linalg.norm(ends - base, axis=1) - zero


def seen(pose, mark):
    return turned(camera, pose[:2] + turned(pose[2], marks[mark])) + lens


def measure():
    with open("camera.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["q_leg1", "q_leg2", "q_leg3", "T1_x", "T1_y", "T2_x", "T2_y"])
        for _ in range(40):
            pose = rng.uniform([-40, -40, -0.2], [40, 40, 0.2])
            both = np.concatenate([seen(pose, "T1"), seen(pose, "T2")]) + rng.normal(0, 0.01, 4)
            table.writerow([*np.round(legs(pose), 4), *np.round(both, 4)])


def drive(commands, goals):
    """Print how far mark T1 ends from where it should be."""
    away = []
    for joints, goal in zip(commands, goals, strict=True):
        q = np.array([float(joints[f"q_leg{n}"]) for n in (1, 2, 3)])
        pose = least_squares(lambda p, q: legs(p) - q, [0, 0, 0], xtol=1e-14, args=(q,)).x
        away.append(np.linalg.norm(seen(pose, "T1") - [float(goal["x"]), float(goal["y"])]))
    print(f"T1 is off by {np.sqrt(np.mean(np.square(away))):.4f} mm rms, {max(away):.4f} at most")


if len(sys.argv) == 1:
    measure()
else:
    drive(*(list(csv.DictReader(Path(n).read_text().splitlines())) for n in sys.argv[1:]))
