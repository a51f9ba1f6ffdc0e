"""Machines, and the sessions in which they are measured: poses, conditions, noise, data sets.

Random streams are separate, so that the same seed gives the same machine, poses, conditions and
noise whatever is hidden in the session.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from hidden_scene import Array, Scene, solved
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppmcal import algebra as cga
from ppmcal.calibration.fit import coordinates
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, smallest_singular_value
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.tables import home_singular_value
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import POSE, POSITION
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import Motion
from ppmcal.model.registration import Registration

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
WELL_CONDITIONED = 0.3
"""Poses are kept whose smallest singular value is at least this part of home's."""
ROW_TIME = 60.0
REFERENCE = 293.15
SWING = 4.0
"""Largest departure from 20 degrees Celsius, K."""
STRAIGHT = 0.6
"""Temperature must not follow time: its correlation with time stays below this."""
OUTLIER = 20.0
FRAME, TARGET = 3e-3, 5e-3
"""Standard deviation of frame (m and rad) and target (m)."""


@dataclass(frozen=True)
class Machine:
    """A nominal machine and the box about home (half widths per coordinate, m and rad)."""

    file: str
    half_range: tuple[float, ...]

    def __call__(self) -> Mechanism:
        """Return the machine as drawn."""
        return _read(self.file)


@cache
def _read(file: str) -> Mechanism:
    return read_mechanism(CONFIGS / f"{file}.yaml")


def machines() -> dict[str, Machine]:
    """Return the machines of the study by name; calling one gives its Mechanism."""
    boxes = {
        "3-RPR": (0.10, 0.10, 0.17), "3-RRR-1": (0.06, 0.06, 0.25),
        "3-PRR-1": (0.06, 0.06, 0.25), "3-PPR-1": (0.06, 0.06, 0.17),
        "delta-rotary": (0.10, 0.10, 0.06), "delta-linear": (0.06, 0.06, 0.08),
        "6-UPS": (0.30, 0.30, 0.25, 0.20, 0.20, 0.20),
        "linapod": (0.12, 0.12, 0.15, 0.14, 0.14, 0.14),
        "6-RUS": (0.025, 0.025, 0.02, 0.12, 0.12, 0.12),
    }
    return {name: Machine(name, box) for name, box in boxes.items()}


@dataclass(frozen=True)
class Options:
    """How a campaign is measured.

    Attributes:
        poses: commanded poses; each gives 2 ``repeats`` rows, half of them from either side.
        sigma: of position (m) and rotation (rad). row_sigmas: every row has its own, 0.5 to 2
            times that, stated.
        ar: AR(1) coefficient in row order. tails: ``normal`` or ``t4``, of unit variance.
        outliers: share of rows that are off by 20 sigma.
        actuator: repeatability of drives that slide (m) and that turn (rad).
        columns: what is recorded of dir, vel, temperature, payload, time.
        payloads: kg, one drawn for each row.
        errors: scale of the geometry's errors, in tolerances.
    """

    poses: int = 60
    repeats: int = 1
    sigma: tuple[float, float] = (5e-6, 2e-5)
    row_sigmas: bool = False
    ar: float = 0.0
    tails: str = "normal"
    outliers: float = 0.0
    actuator: tuple[float, float] = (0.0, 0.0)
    columns: tuple[str, ...] = ("dir", "vel", "temperature", "payload", "time")
    payloads: tuple[float, ...] = (0.0, 5.0, 10.0, 20.0)
    errors: float = 1.0

    def __post_init__(self) -> None:
        """Refuse names that do not exist."""
        if self.tails not in ("normal", "t4"):
            raise ValueError(f"tails: {self.tails} is not normal or t4")
        unknown = set(self.columns) - {"dir", "vel", "temperature", "payload", "time"}
        if unknown:
            raise ValueError(f"columns: {', '.join(sorted(unknown))} cannot be recorded")


def stream(seed: int, purpose: int) -> np.random.Generator:
    """Return the random stream of one purpose."""
    return np.random.default_rng([seed, purpose])


def drawn_scene(machine: Machine, seed: int, options: Options) -> Scene:
    """Return a session without effects and noise: a true machine, poses and conditions."""
    mechanism = machine()
    g = mechanism.values.copy()
    free = list(mechanism.free)
    tolerances = np.array([mechanism.parameters[p].tolerance or 0.0 for p in free])
    g[free] += options.errors * tolerances * stream(seed, 1).normal(size=len(free))
    q, wanted = _poses(machine, options.poses, stream(seed, 2))
    rng = stream(seed, 3)
    side = rng.choice((-1.0, 1.0), size=q.shape)
    visits = np.concatenate([np.arange(options.poses)] * (2 * options.repeats))
    sides = np.concatenate([side, -side] * options.repeats)
    order = rng.permutation(visits.size)
    visits, sides = visits[order], sides[order]
    slow, fast = (0.02, 0.2) if mechanism.actuator_quantity[0] == "angle" else (
        0.005 * mechanism.reach, 0.05 * mechanism.reach)
    speed = np.exp(rng.uniform(np.log(slow), np.log(fast), sides.shape))
    model = Model(mechanism, g)
    return Scene(
        mechanism, g, _registration(mechanism, stream(seed, 4)), q[visits],
        solved(model, q, wanted, q)[visits], sides, sides * speed,
        _temperature(visits.size, rng),
        rng.choice(np.array(options.payloads, dtype=np.float64), visits.size),
        ROW_TIME * np.arange(visits.size, dtype=np.float64), visits)


def _poses(machine: Machine, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return joint values (count, k) and poses (count, 8) of the nominal machine in its box."""
    mechanism = machine()
    model = Model(mechanism)
    at_home, side = home_singular_value(mechanism)
    found_q, found = [], []
    for _ in range(50):
        step = np.zeros((2 * count, 6))
        step[:, mechanism.dof] = rng.uniform(-1.0, 1.0, (2 * count, len(mechanism.dof)))
        step[:, mechanism.dof] *= machine.half_range
        turn = Rotation.from_rotvec(step[:, 3:]) * Rotation.from_rotvec(mechanism.home_pose[3:])
        pose = cga.motor_from_rotation_vector(turn.as_rotvec(), mechanism.home_pose[:3]
                                              + step[:, :3])
        reached = inverse(model, pose)
        low, high = mechanism.limits[:, 0], mechanism.limits[:, 1]
        good = reached.reached & ((reached.q >= low) & (reached.q <= high)).all(axis=1)
        pose, q = pose[good], reached.q[good]
        value, sign = smallest_singular_value(model.closure(q), pose)
        back = forward(model, q)
        same = np.linalg.norm(cga.translation(back.pose) - cga.translation(pose), axis=1)
        good = (back.converged & (same < 1e-9) & (sign == side)
                & (value > WELL_CONDITIONED * at_home))
        found_q.append(q[good])
        found.append(pose[good])
        if sum(len(p) for p in found) >= count:
            return np.concatenate(found_q)[:count], np.concatenate(found)[:count]
    raise ValueError(f"the box of {machine.file} is hardly within its workspace")


def _temperature(rows: int, rng: np.random.Generator) -> Array:
    """Return K above 20 degrees Celsius (N,): a walk or a wave that does not follow time."""
    time = np.arange(rows) / rows
    while True:
        if rng.uniform() < 0.5:
            swing = np.sin(2.0 * np.pi * (rng.uniform(1.5, 4.0) * time + rng.uniform()))
        else:
            swing = np.cumsum(rng.normal(size=rows))
            swing -= swing.mean()
        if rows < 4 or abs(np.corrcoef(swing, time)[0, 1]) < STRAIGHT:
            return np.asarray(SWING * swing / np.abs(swing).max(), dtype=float)


def _registration(mechanism: Mechanism, rng: np.random.Generator) -> Registration:
    """Return where the instrument truly stands: some millimetres and milliradians off."""
    parts = [0, 1, 5] if mechanism.motion.planar else list(range(6))
    frame, target = np.zeros(6), np.zeros(3)
    frame[parts] = FRAME * rng.normal(size=len(parts))
    places = [p for p in parts if p < 3]
    target[places] = TARGET * rng.normal(size=len(places))
    return Registration.of_pose(frame, target)


def joint_noise(scene: Scene, options: Options) -> Array:
    """Return the repeatability of the drives by actuator (k,), unit of q."""
    return np.array([options.actuator[1 if q == "angle" else 0]
                     for q in scene.mechanism.actuator_quantity])


def recorded(scene: Scene, seen: Array, options: Options, seed: int) -> Dataset:
    """Return measurements (N, 6) as the data set that their files would read as."""
    mechanism = scene.mechanism
    kind = POSE if mechanism.motion.turns else POSITION
    data = Dataset.of_poses("hidden", scene.q, seen, options.sigma, True)
    shown = np.isin(np.arange(6), coordinates(replace(data, kind=kind), mechanism.motion))
    seen = np.where(shown, seen, np.nan)
    own = np.ones(len(seen))
    if options.row_sigmas:
        own = np.exp(stream(seed, 5).uniform(np.log(0.5), np.log(2.0), len(seen)))
    columns: dict[str, Array] = {}
    for name, values in (("dir", scene.approach), ("vel", scene.velocity)):
        if name in options.columns:
            columns |= {f"{name}_{a}": values[:, i] for i, a in enumerate(mechanism.actuators)}
    for name, value in (("temperature", scene.temperature + REFERENCE),
                        ("payload", scene.payload), ("time", scene.time)):
        if name in options.columns:
            columns[name] = value
    return replace(
        data, kind=kind, position=seen[:, :3], rotation=seen[:, 3:], groups=scene.groups,
        sigma_position=data.sigma_position * own[:, None],
        sigma_rotation=data.sigma_rotation * own[:, None], columns=columns,
        sigma_actuator=joint_noise(scene, options),
        approach="columns" if "dir" in options.columns else "unknown")


def with_noise(data: Dataset, motion: Motion, options: Options, seed: int
               ) -> tuple[Dataset, NDArray[np.int64]]:
    """Return the data set with the instrument's noise, and which rows are outliers."""
    rng = stream(seed, 6)
    n, shown = len(data), list(coordinates(data, motion))
    white = np.zeros((n, 6))
    drawn = rng.normal(size=(n, 6)) if options.tails == "normal" else (
        rng.standard_t(4.0, size=(n, 6)) / np.sqrt(2.0))
    white[0] = drawn[0]
    fresh = np.sqrt(1.0 - options.ar**2)
    for row in range(1, n):
        white[row] = options.ar * white[row - 1] + fresh * drawn[row]
    off = np.sort(stream(seed, 7).choice(n, round(options.outliers * n), replace=False))
    way = stream(seed, 8).normal(size=(n, len(shown)))[off]
    way *= OUTLIER / np.linalg.norm(way, axis=1, keepdims=True)
    white[np.ix_(off, np.array(shown))] += way
    noise = white * np.concatenate([data.sigma_position, data.sigma_rotation], axis=1)
    position, rotation = data.position + noise[:, :3], data.rotation + noise[:, 3:]
    if motion.turns_freely:
        rotation = (Rotation.from_rotvec(noise[:, 3:])
                    * Rotation.from_rotvec(data.rotation)).as_rotvec()
    return replace(data, position=position, rotation=rotation), off.astype(np.int64)
