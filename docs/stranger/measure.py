"""A day at the machine, without ppmcal: it is not quite as drawn, and a tracker looks on."""

import csv

import numpy as np

rng = np.random.default_rng(20)
BASE = np.array([[237, 41.8, 0], [-82.3, 226.1, 0], [-154.7, 184.3, 0],
                 [-154.7, -184.3, 0], [-82.3, -226.1, 0], [237, -41.8, 0]])
PLATFORM = np.array([[84.5, 90.6, -20], [36.2, 118.5, -20], [-120.7, 27.9, -20],
                     [-120.7, -27.9, -20], [36.2, -118.5, -20], [84.5, -90.6, -20]])
base = BASE + rng.normal(0, 0.3, BASE.shape)            # as it was really built, mm
platform = PLATFORM + rng.normal(0, 0.3, PLATFORM.shape)
zero = rng.normal(0, 0.3, 6)                            # what the encoders' zeros are off


def turn(vector):
    """Rodrigues: the matrix of a rotation vector, rad."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def vector_of(r):
    """The rotation vector of a matrix, rad."""
    angle = np.arccos((np.trace(r) - 1) / 2)
    return angle / (2 * np.sin(angle)) * np.array(
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])


tracker = turn(np.array([0.02, -0.03, 0.6])), np.array([900.0, -400.0, 250.0])
probe = np.array([30.0, 10.0, 45.0])                    # the target, on the platform
with open("run1.csv", "w", newline="") as file:
    table = csv.writer(file)
    table.writerow(["pose", *(f"q_leg{i}" for i in range(1, 7)), "x", "y", "z", "rx", "ry", "rz"])
    for pose in range(60):
        place = rng.uniform([-35, -35, 280], [35, 35, 340])
        r = turn(rng.uniform(-0.17, 0.17, 3))
        legs = np.linalg.norm(place + platform @ r.T - base, axis=1) - zero
        seen = tracker[0] @ (place + r @ probe) + tracker[1] + rng.normal(0, 0.01, 3)
        tilt = np.degrees(vector_of(tracker[0] @ r)) + rng.normal(0, 0.003, 3)
        table.writerow([pose, *np.round(legs, 4), *np.round(seen, 4), *np.round(tilt, 5)])
