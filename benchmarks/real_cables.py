"""A real platform on four cables that do not cross: by its encoders alone, against motion capture.

    python benchmarks/real_cables.py --data DIR [--step 30] [--ways none level still]

DIR has `hard/cable-planar/`: the encoders of four cables (m) and, for half of that time, where
motion capture saw the platform. Every `--step` row is fitted without it, and its poses are laid
onto what motion capture saw, by a rigid motion and by one with a scale. Ways: `none`, the lengths
alone; `level`, with a platform that stays level to 0.03 rad (one sigma); `still`, as a platform
that does not turn at all.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import yaml

import ppmcal
from ppmcal import algebra as cga
from ppmcal.calibration.fit import FitOptions, Problem, identify, with_gauge
from ppmcal.io import read_mechanism
from ppmcal.linalg import Array

NAMES = ("c0", "c1", "c2", "c3")
ACTUATOR, LEVEL = 0.002, 0.03
"""Noise of the encoders, m, and how level the platform stays, rad."""
UNITS = {"units": {"length": "m", "angle": "rad"}}


def laid_onto(points: Array, seen: Array, scaled: bool) -> float:
    """Return the rms distance, mm, of points (N, 2) moved rigidly onto others, or with a scale."""
    a, b = points - points.mean(axis=0), seen - seen.mean(axis=0)
    u, s, vt = np.linalg.svd(a.T @ b)
    flip = np.array([1.0, np.sign(np.linalg.det(u @ vt))])
    scale = float(np.sum(s * flip) / np.sum(a**2)) if scaled else 1.0
    return float(1e3 * np.sqrt(np.mean(np.sum((scale * a @ (u * flip) @ vt - b) ** 2, axis=1))))


def one(folder: Path, tree: dict, table: dict[str, Array], way: str, place: Array) -> str:
    """Return a line of the table; ``place``: x, y and turn (N, 3) by motion capture, or nan."""
    if way == "still":
        tree = tree | {"motion": "planar-point"}
        tree["home"] = {"pose": {c: tree["home"]["pose"][c] for c in "xy"}}
    side = UNITS | {"instrument": {"kind": "none", "sigma": {"actuator": ACTUATOR}}}
    if way == "level":
        table = table | {"roll": np.zeros(len(place))}
        side = UNITS | {"target_rotation": "known", "instrument": {
            "kind": "inclinometer", "sigma": {"rotation": LEVEL, "actuator": ACTUATOR}}}
    file = folder / f"{way}.yaml"
    file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    data = ppmcal.read_data(file, table, sidecar=side, name=way)
    model = with_gauge(read_mechanism(file), data)
    fit = identify(Problem(model, data, model.free), FitOptions())
    pose = fit.state.poses[0]
    known = np.isfinite(place[:, 0]) & np.isfinite(pose[:, 0])
    at = cga.translation(pose)[known, :2]
    turn = cga.rotation_vector(pose)[np.isfinite(pose[:, 0]), 2]
    return (f"| {way} | {fit.converged} | {laid_onto(at, place[known, :2], False):.2f} mm | "
            f"{laid_onto(at, place[known, :2], True):.2f} mm | {turn.min():+.3f} to "
            f"{turn.max():+.3f} rad |")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--step", type=int, default=30)
    parser.add_argument("--ways", nargs="*", default=["none", "level", "still"])
    asked = parser.parse_args()
    source = asked.data / "hard" / "cable-planar"
    tree = yaml.safe_load((source / "four-cables-mechanism.yaml").read_text(encoding="utf-8"))
    rows = np.genfromtxt(source / "four-cables.csv", delimiter=",", names=True)[::asked.step]
    seen = np.genfromtxt(source / "a.csv", delimiter=",", names=True)
    place = np.stack([np.interp(rows["time"], seen["time"], seen[c], np.nan, np.nan)
                      for c in ("x", "y", "rz")], axis=1)
    print(f"Motion capture: turns {seen['rz'].min():+.3f} to {seen['rz'].max():+.3f} rad, "
          f"{int(np.isfinite(place[:, 0]).sum())} of {len(rows)} rows.")
    print("| way | converged | rigid | with a scale | turns |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for way in asked.ways:
            print(one(Path(folder), tree, {f"q_{n}": rows[f"q_{n}"] for n in NAMES}, way, place),
                  flush=True)


if __name__ == "__main__":
    main()
