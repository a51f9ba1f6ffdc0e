"""Campaigns: what was commanded, under which conditions, and what an instrument saw.

Arrays: N rows in the order taken, L legs, d coordinates; mm, rad, N, N·mm, s, °C, kg.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from .kinematics import COLUMNS, Geometry, forward, inverse, pose_by_joint, rod_forces
from .machines import Machine, pose_of

GRAVITY = 9.80665


@dataclass(frozen=True)
class Plan:
    """How a campaign is run; every case of the catalogue names what it needs.

    approach: columns (a via point before every pose) | sequence. loads: payload | wrench.
    warm: a hall whose air swings by 12 to 20 K, and a fine instrument, as heat needs.
    fine: share of moves that are small steps. temperature: rise | swing | block | any.
    known: frame and target known. hide: columns left out of the file.
    """

    approach: str = "columns"
    loads: str = "payload"
    fine: float = 0.0
    temperature: str = "any"
    instrument: str = "any"
    known: bool = False
    pauses: float = 0.08
    load_blocks: bool = False
    hide: tuple[str, ...] = ()
    noise: str = "normal"
    warm: bool = False


@dataclass(frozen=True)
class Run:
    """Rows as they happened; ``pos``, ``rot`` are the poses without any effect.

    via (N, L): joints just before the last approach; dirs (N, L) its sign; speed (N, L) at
    the trigger, per second; load (N, L): actuator load f = J^T wrench; rods (N, L, 3): force
    of every rod on the platform.
    """

    machine: Machine
    geo: Geometry
    label: np.ndarray
    q: np.ndarray
    via: np.ndarray
    dirs: np.ndarray
    speed: np.ndarray
    time: np.ndarray
    temperature: np.ndarray
    payload: np.ndarray
    wrench: np.ndarray
    pos: np.ndarray
    rot: np.ndarray
    load: np.ndarray = field(default_factory=lambda: np.zeros(0))
    rods: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.q)

    @property
    def u(self) -> np.ndarray:
        """Joint variable with its true offset (N, L)."""
        return self.q + self.geo.offset


def commanded(machine: Machine, plan: Plan, rows: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Commanded coordinates (rows, d) and their labels (rows,): both approaches, repeats."""
    values, labels, label = [], [], 0
    while len(values) < rows:
        if values and rng.random() < plan.fine:
            step = 10 ** rng.uniform(-3.5, -1.0) * machine.half * rng.normal(size=len(machine.half))
            pose = np.clip(
                values[-1] + step, machine.home - machine.half, machine.home + machine.half
            )
            times = 1
        else:
            pose = machine.home + machine.half * rng.uniform(-1, 1, len(machine.half))
            times = 1 if plan.fine else rng.choice([1, 2, 2, 3], p=[0.3, 0.35, 0.25, 0.1])
        label += 1
        values += [pose] * times
        labels += [label] * times
    return np.array(values[:rows]), np.array(labels[:rows])


def approaches(machine: Machine, plan: Plan, q: np.ndarray, label: np.ndarray, rng) -> tuple:
    """Via joints (N, L) and approach signs (N, L) of every row."""
    n, legs = q.shape
    if plan.approach == "sequence":
        via = np.vstack([machine_home(machine), q[:-1]])
        dirs = np.sign(q - via)
        for k in range(n):  # a joint that did not move keeps its side
            dirs[k] = np.where(dirs[k] == 0, dirs[k - 1] if k else 1.0, dirs[k])
        return via, dirs
    dirs = rng.choice([-1.0, 1.0], size=(n, legs))
    again = np.flatnonzero(label[1:] == label[:-1]) + 1
    for k in again:
        if rng.random() < 0.8:
            dirs[k] = -dirs[k - 1]
    over = np.ptp(machine.limits, axis=1) * 0.03
    return q - dirs * over, dirs


def machine_home(machine: Machine) -> np.ndarray:
    """Nominal joints at the home pose (L,)."""
    return inverse(machine.geometry, *pose_of(machine.motion, machine.home[None]))[0]


def clock(plan: Plan, travel: np.ndarray, rng) -> np.ndarray:
    """Time stamps (N,) s: moving, settling, and now and then a pause."""
    step = 4 + 8 * travel / max(travel.max(), 1e-9) + rng.uniform(0, 2, len(travel))
    pause = rng.random(len(travel)) < plan.pauses
    step = step + pause * rng.uniform(60, 400, len(travel))
    return np.round(np.cumsum(step), 2)


def weather(plan: Plan, time: np.ndarray, rng) -> np.ndarray:
    """Air temperature (N,) °C."""
    kind = rng.choice(["rise", "swing", "block"]) if plan.temperature == "any" else plan.temperature
    span = max(time[-1], 1.0)
    if kind == "rise":
        shape = 1 - np.exp(-2.5 * time / span)
    elif kind == "swing":
        shape = 0.5 + 0.5 * np.sin(2 * np.pi * (rng.uniform(1.3, 2.6) * time / span + rng.random()))
    else:
        edges = np.sort(rng.uniform(0, span, 5))
        shape = rng.permutation(np.linspace(0, 1, 6))[np.searchsorted(edges, time)]
    slow = rng.normal(size=len(time)) * 0.03
    span = rng.uniform(5, 8) * (2.5 if plan.warm else 1.0)
    return np.round(18.5 + span * shape + slow, 3)


def loads(machine: Machine, plan: Plan, n: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Payload (N,) kg and the further wrench (N, 6), N and N·mm."""
    levels = np.array([0.0, 2.0, 5.0])
    payload = rng.choice(levels, size=n)
    if plan.load_blocks:
        payload = levels[np.repeat(rng.integers(0, 3, n), rng.integers(4, 12, n))[:n]]
    wrench = np.zeros((n, 6))
    if plan.loads == "wrench":
        wrench = np.hstack([rng.uniform(-60, 60, (n, 3)), rng.uniform(-6e3, 6e3, (n, 3))])
        if machine.motion == "planar":
            wrench[:, 2:5] = 0
        if machine.motion == "translational":
            wrench[:, 3:] = 0
        payload = np.zeros(n)
    return payload, np.round(wrench, 3)


def loaded(run: Run) -> Run:
    """The run with effect-free poses, actuator loads and rod forces filled in."""
    machine, geo = run.machine, run.geo
    pos, rot = forward(geo, run.q, run.pos, run.rot, machine.motion)
    total = total_wrench(run)
    jac = pose_by_joint(geo, run.q, pos, rot, machine.motion)
    load = np.einsum("ndl,nd->nl", jac, total[:, COLUMNS[machine.motion]])
    rods = rod_forces(geo, run.q, pos, rot, machine.motion, total)
    return replace(run, pos=pos, rot=rot, load=load, rods=rods)


def total_wrench(run: Run) -> np.ndarray:
    """Wrench at the platform's origin with the payload's weight (N, 6)."""
    total = run.wrench.copy()
    total[:, :3] += GRAVITY * run.payload[:, None] * run.machine.gravity
    return total


def take(machine: Machine, geo: Geometry, plan: Plan, rows: int, rng) -> Run:
    """A campaign of so many rows on a true machine."""
    values, label = commanded(machine, plan, rows, rng)
    pos, rot = pose_of(machine.motion, values)
    digits = 6 if machine.rotary else 4
    q = np.round(inverse(machine.geometry, pos, rot), digits)
    via, dirs = approaches(machine, plan, q, label, rng)
    travel = np.abs(np.diff(q, axis=0, prepend=machine_home(machine)[None])).max(axis=1)
    time = clock(plan, travel, rng)
    speed = dirs * np.abs(np.ptp(machine.limits, axis=1)) * 10 ** rng.uniform(-2.5, -0.7, (rows, 1))
    payload, wrench = loads(machine, plan, rows, rng)
    temperature = weather(plan, time, rng)
    return loaded(
        Run(machine, geo, label, q, via, dirs, speed, time, temperature, payload, wrench, pos, rot)
    )


def extended(run: Run, joints: np.ndarray, conditions: dict[str, np.ndarray]) -> Run:
    """The run with further rows (M, L) after its last; conditions as the run's fields."""
    m = len(joints)
    near = np.argmin(np.linalg.norm(run.q[None] - joints[:, None], axis=-1), axis=1)
    via = np.vstack([run.q[-1:], joints[:-1]])
    default = {
        "label": run.label[-1] + 1 + np.arange(m), "via": via,
        "dirs": np.where(joints >= via, 1.0, -1.0), "speed": np.zeros_like(joints),
        "time": run.time[-1] + 10.0 * (1 + np.arange(m)),
        "temperature": np.full(m, run.temperature[-1]), "payload": np.zeros(m),
        "wrench": np.zeros((m, 6)),
    }  # fmt: skip
    new = default | {"q": joints, "pos": run.pos[near], "rot": run.rot[near]}
    for key, value in conditions.items():
        new[key] = np.broadcast_to(np.asarray(value, float), np.shape(default[key]))
    return loaded(replace(run, **{k: np.concatenate([getattr(run, k), new[k]]) for k in new}))


@dataclass(frozen=True)
class Setup:
    """Frame (base in the measuring frame), target (mm, platform axes), instrument, sigmas."""

    frame_pos: np.ndarray
    frame_rot: np.ndarray
    target: np.ndarray
    instrument: str
    sigma_pos: float
    sigma_rot: float
    known: bool


def setup(machine: Machine, plan: Plan, rng) -> Setup:
    """Draw the instrument's place."""
    choices = {
        "planar": ["pose"],
        "translational": ["position"],
        "spatial": ["pose"] * 3 + ["position"],
    }
    kind = rng.choice(choices[machine.motion])
    if plan.instrument != "any" and machine.motion != "translational":
        kind = plan.instrument
    sigma, turn = rng.choice([0.005, 0.01, 0.02]), np.radians(rng.choice([0.001, 0.002, 0.004]))
    if plan.warm:
        sigma, turn = 0.002, np.radians(0.0005)
    frame_pos, target = rng.uniform(-800, 800, 3), rng.uniform(-60, 60, 3)
    spin = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    if machine.motion == "planar":
        spin = Rotation.from_rotvec([0, 0, rng.uniform(-np.pi, np.pi)]).as_matrix()
        frame_pos[2] = target[2] = 0
    if machine.motion == "translational" or plan.known:
        target = np.zeros(3)
    if plan.known:
        frame_pos, spin = np.zeros(3), np.eye(3)
    return Setup(frame_pos, spin, target, kind, float(sigma), float(turn), plan.known)


def seen(place: Setup, pos, rot, base_step=None, target_step=None) -> tuple[np.ndarray, np.ndarray]:
    """Measured positions (N, 3) and rotations (N, 3, 3) of base-frame poses.

    base_step (N, 6) moves the base in its own axes; target_step (N, 6) moves the target.
    """
    target = np.broadcast_to(place.target, pos.shape)
    if target_step is not None:
        turned = Rotation.from_rotvec(target_step[:, 3:]).as_matrix()
        target, rot_end = target + target_step[:, :3], rot @ turned
    else:
        rot_end = rot
    point = pos + np.einsum("nij,nj->ni", rot, target)
    if base_step is not None:
        step = Rotation.from_rotvec(base_step[:, 3:]).as_matrix()
        point = np.einsum("nij,nj->ni", step, point) + base_step[:, :3]
        rot_end = step @ rot_end
    return point @ place.frame_rot.T + place.frame_pos, place.frame_rot @ rot_end


__all__ = ["Plan", "Run", "Setup", "extended", "seen", "setup", "take", "total_wrench"]
