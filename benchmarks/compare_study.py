"""Pairs of calibrations with a known change between them: what does `compare` say?

    python benchmarks/compare_study.py [--pairs 60] [--none 60] [--size 1] [--seed 1]

Machines: a delta printer that touches its bed in 37 places, one that does so in 7 and frees six
parameters, a hexapod under a tracker, a planar stage; set up as in practice: frame, target and body
are stated as known, homing as shared. Between the two sessions nothing changes, or the machine is
homed anew, the bed is moved, one rod or leg is exchanged, the instrument is moved, the measured
body is defined anew. Half of the pairs have something in both sessions that the model does not know
(waves of a bed, of drives), of thrice the noise; half of the hexapods and stages are measured at
the same poses again. Right: what changed is named first, or as likely as the first.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml
from numpy.typing import NDArray
from real_deltas import mechanism_text

from ppmcal.calibration.fit import FitOptions, Posterior, Problem, identify, noise_check, with_noise
from ppmcal.calibration.sessions.change_detection import Comparison, between, posterior_of
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import PLANE
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]
CONFIGS = Path(__file__).resolve().parent.parent / "configs"
MM = 1e-3
NOISE = {"printer": (0.01 * MM, 0.0), "7 touches": (0.01 * MM, 0.0),
         "hexapod": (0.02 * MM, 4e-5), "stage": (0.01 * MM, 2e-5)}
BOX = {"hexapod": [0.25, 0.25, 0.2, 0.15, 0.15, 0.15], "stage": [0.08, 0.08, 0, 0, 0, 0.2]}
TRAVEL = {"hexapod": 0.5, "stage": 0.2}
"""Of a leg, m."""
PRINTERS = ("printer", "7 touches")
POSES = {"hexapod": 60, "stage": 40}
CHANGES = {
    "printer": ("homing", "bed height", "bed tilt", "one rod"),
    "7 touches": ("homing", "bed height", "bed tilt"),
    "hexapod": ("homing", "one leg", "instrument", "body"),
    "stage": ("homing", "one leg", "instrument", "body")}
ACCEPTED = {
    "homing": ("homing of all joints alike", "homing of every joint"),
    "bed height": ("height of the bed",), "bed tilt": ("tilt of the bed",
                                                        "height and tilt of the bed"),
    "instrument": ("instrument moved", "instrument shifted"),
    "body": ("measured body defined anew", "rotation of the measured body")}


@dataclass
class World:
    """What is true in one session."""

    g: Array
    homing: Array
    registration: Registration
    bed: Array
    waves: float


def printer(rods: str) -> Mechanism:
    """Return a delta printer; ``rods``: ``single``, free within 0.3 mm, or ``fixed``."""
    geometry = {"radius": 135.0, "arms": [300.0] * 3, "angles": [210.0, 330.0, 90.0],
                "endstops": [330.0] * 3, "stepdists": [0.0125] * 3}
    tree = yaml.safe_load(mechanism_text(geometry, rods))
    tree["tolerances"] = {"point": 0.5, "angle": 0.3, "length": 0.3, "offset": 0.5}
    path = Path(os.environ.get("TMPDIR", "/tmp")) / f"compare-study-{os.getpid()}.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    try:
        return read_mechanism(path)
    finally:
        path.unlink()


def drawn(mechanism: Mechanism, rng: np.random.Generator) -> Array:
    """Return parameters (P,) drawn from their tolerances."""
    g = mechanism.nominals.copy()
    for p in mechanism.free:
        g[p] += (mechanism.parameters[p].prior_sigma or 0.0) * rng.normal()
    return g


def places(kind: str, mechanism: Mechanism, rng: np.random.Generator) -> Array:
    """Return poses (N, 6) to visit; of a printer its pattern of 37 points."""
    if kind in PRINTERS:
        rings = [(0.0, 1), (100.0, 6)] if kind == "7 touches" else [
            (0.0, 1), (35.0, 6), (70.0, 12), (105.0, 18)]
        spots = [(r * np.cos(a), r * np.sin(a)) for r, n in rings
                 for a in 2.0 * np.pi * np.arange(n) / n]
        pose = np.zeros((len(spots), 6))
        pose[:, :2] = MM * np.array(spots)
        return pose
    away = rng.uniform(-1.0, 1.0, (POSES[kind], 6)) * BOX[kind]
    return np.asarray(mechanism.home_pose + away)


def waves(q: Array, size: float, travel: float) -> Array:
    """Return an error of the drives (N, k) that no model here knows: a wave over the travel."""
    return np.asarray(size * np.sin(9.0 * q / travel + 2.0 * np.arange(q.shape[1])))


def measured(kind: str, mechanism: Mechanism, world: World, pose: Array,
             rng: np.random.Generator) -> Dataset:
    """Measure a session: joint values as read, and what the instrument shows."""
    noise = NOISE[kind]
    model = Model(mechanism, world.g)
    if kind in PRINTERS:
        pose = pose + np.array([1, 1, 0, 0, 0, 0]) * rng.uniform(-1.0, 1.0, pose.shape) * MM
        x, y = pose[:, 0], pose[:, 1]
        pose[:, 2] = (world.bed[0] + world.bed[1] * y - world.bed[2] * x
                      + world.waves * np.sin(x / 0.03) * np.cos(y / 0.025))
        q = inverse(model, pose_motor(pose)).q - world.homing
        data = Dataset.of_poses("touches", q, np.full((len(q), 6), np.nan), noise, False)
        return replace(data, kind=PLANE, value=rng.normal(0.0, noise[0], len(q)),
                       sigma_value=np.full(len(q), noise[0]))
    found = inverse(Model(mechanism), pose_motor(pose))
    q = found.q[found.reached]
    true = q + world.homing + waves(q, world.waves, TRAVEL[kind])
    seen = measured_pose(world.registration, forward(model, true).pose)
    seen = seen + rng.normal(size=seen.shape) * np.repeat(noise, 3)
    if kind == "stage":
        seen[:, [2, 3, 4]] = np.nan
    return Dataset.of_poses("poses", q, seen, noise, False)


def changed(kind: str, what: str, mechanism: Mechanism, old: World, rng: np.random.Generator,
            part: float = 1.0) -> tuple[World, tuple[str, ...]]:
    """Return the second session's world, and the names that are right."""
    def size(low: float, high: float, count: int = 1) -> Array:
        return np.asarray(part * rng.uniform(low, high, count) * rng.choice([-1.0, 1.0], count))

    joints = len(mechanism.actuators)
    one = int(rng.integers(joints))
    if what == "homing":
        unit = 1.0 / 0.0125 if kind in PRINTERS else MM  # steps, or SI
        shift = (np.full(joints, size(0.1, 0.3)[0]) if kind == "printer"
                 else size(0.1, 0.3, joints))
        return replace(old, homing=old.homing + unit * shift), ACCEPTED[what]
    if what == "bed height":
        return replace(old, bed=old.bed + [size(0.1, 0.3)[0] * MM, 0, 0]), ACCEPTED[what]
    if what == "bed tilt":
        return replace(old, bed=old.bed + [0, *(1e-3 * size(1.0, 3.0, 2))]), ACCEPTED[what]
    if what in ("one rod", "one leg"):
        limb = mechanism.limbs[one].name
        name = f"{limb}.{'length' if what == 'one rod' else 'offset'}"
        g = old.g.copy()
        g[mechanism.names.index(name)] += size(0.2, 0.6)[0] * MM
        return replace(old, g=g), (name, f"homing of {mechanism.actuators[one]}")
    move = size(0.3, 1.0, 6) * MM
    if kind == "stage":
        move[[2, 3, 4]] = 0.0
    if what == "instrument":
        return replace(old, registration=Registration.of_pose(move)), ACCEPTED[what]
    return replace(old, registration=Registration.of_pose(np.zeros(6), move[:3], move[3:])
                   ), ACCEPTED[what]


def known(mechanism: Mechanism, data: Dataset, label: str) -> Posterior:
    """Return what `identify` would write of a session."""
    fit = identify(Problem(mechanism, (data,), mechanism.free), FitOptions())
    fit = with_noise(fit, noise_check(fit).inflation, FitOptions())
    return posterior_of(fit, {label: label})


def pair(kind: str, what: str, mechanism: Mechanism, unmodelled: bool, again: bool,
         rng: np.random.Generator, part: float) -> tuple[Comparison, tuple[str, ...]]:
    """Return the comparison of two sessions, and the right names."""
    noise = NOISE[kind][0]
    old = World(drawn(mechanism, rng), np.zeros(len(mechanism.actuators)), Registration(),
                np.zeros(3), 3.0 * noise * unmodelled)
    new, right = (old, ()) if what == "none" else changed(kind, what, mechanism, old, rng,
                                                              part)
    first = places(kind, mechanism, rng)
    second = first if again else places(kind, mechanism, rng)
    one, two = (known(mechanism, measured(kind, mechanism, w, p, rng), label)
                for w, p, label in ((old, first, "a"), (new, second, "b")))
    g = mechanism.values.copy()
    g[list(two.places)] = two.value
    return between(mechanism.with_values(g), one, two, {}, rng)[0], right


def interval(hits: int, count: int) -> str:
    """Return a share in per cent with its 95 % interval (Wilson 1927)."""
    if not count:
        return "-"
    z, p = 1.96, hits / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(p * (1 - p) / count + z * z / (4 * count**2))
    return f"{100 * p:.0f} % ({100 * (middle - half):.0f}-{100 * (middle + half):.0f})"


def show(title: str, rows: list[tuple[str, bool, bool, bool]],
         wanted: Callable[[str, bool, bool], bool]) -> None:
    """Print one line: how many, seen, right first or tied, other names."""
    mine = [r for r in rows if wanted(r[0], r[2], r[3])]
    print(f"{title:28s} {len(mine):4d}  {interval(sum(r[1] for r in mine), len(mine))}")


def main() -> None:
    """Print each pair, then the shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=60, help="with a change")
    parser.add_argument("--none", type=int, default=60, help="without any")
    parser.add_argument("--size", type=float, default=1.0, help="of the changes, as a factor")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quiet", action="store_true")
    given = parser.parse_args()
    machines = {"printer": printer("single"), "7 touches": printer("fixed"),
                "hexapod": read_mechanism(CONFIGS / "6-UPS.yaml"),
                "stage": read_mechanism(CONFIGS / "3-RPR.yaml")}
    begun, rows, chi2 = time.time(), [], []
    for n in range(given.pairs + given.none):
        rng = np.random.default_rng([given.seed, n])
        kind = list(machines)[n % len(machines)]
        turn = n // len(machines)
        what = "none" if n >= given.pairs else CHANGES[kind][turn % len(CHANGES[kind])]
        unmodelled, again = (bool(b) for b in rng.integers(2, size=2))
        again |= kind in PRINTERS
        found, right = pair(kind, what, machines[kind], unmodelled, again, rng, given.size)
        first = [c.name for c in found.changes[:1]]
        tied = {n for c in found.changes[:1] for n in c.instead}
        good = not found.changed if what == "none" else bool(
            first and (first[0] in right or tied & set(right)))
        rows.append((f"{kind} {what}", good, unmodelled, again))
        if what == "none":
            chi2.append((kind, unmodelled, again, found.chi2 / found.freedom))
        if not given.quiet and not good:
            names = "; ".join(c.name + (f" (or {', '.join(c.instead[:3])})" if c.instead else "")
                              for c in found.changes)
            print(f"{n:4d} {kind:10s}{what:11s}{'unmodelled ' if unmodelled else ''}"
                  f"{'same poses ' if again else ''}chi2 {found.chi2:.3g} of {found.freedom}, "
                  f"noise {found.noise.old:.2f}, {found.noise.new:.2f}, share "
                  f"{found.noise.share:.2f}: {names or 'nothing named'}")
    print(f"\nRight first or tied{'':9s}    n  share (95 %)")
    for name in dict.fromkeys(r[0] for r in rows if not r[0].endswith("none")):
        show(name, rows, lambda k, u, a, name=name: k == name)
    show("all changes", rows, lambda k, u, a: not k.endswith("none"))
    show("  with unmodelled effect", rows, lambda k, u, a: not k.endswith("none") and u)
    print(f"\nNothing changed, none named{'':1s}    n  share (95 %)")
    for kind in machines:
        show(kind, rows, lambda k, u, a, kind=kind: k == f"{kind} none")
    show("all", rows, lambda k, u, a: k.endswith("none"))
    show("  with unmodelled effect", rows, lambda k, u, a: k.endswith("none") and u)
    print("\nchi-squared over its degrees of freedom where nothing changed, mean")
    for kind in machines:
        for u in (False, True):
            for a in (True, False):
                mine = [c[3] for c in chi2 if c[:3] == (kind, u, a)]
                if mine:
                    print(f"{kind:9s} {'unmodelled' if u else '':11s}"
                          f"{'same poses' if a else 'other poses':12s} {len(mine):3d}  "
                          f"{np.mean(mine):.2f}")
    print(f"{time.time() - begun:.0f} s")


if __name__ == "__main__":
    main()
