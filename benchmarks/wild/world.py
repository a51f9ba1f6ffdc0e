"""What an effect does to a machine, and how much of it the geometry cannot imitate.

Arrays: N rows, L legs; mm, rad, N, s, °C.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from .campaign import Run, Setup, seen
from .kinematics import COLUMNS, forward, forward_of_each, moved
from .machines import with_errors


@dataclass
class State:
    """Departures of every row from the rigid machine.

    du (N, L); base, platform (N, L, 3) mm; stretch (N, L) relative growth of links; gap (L,)
    axis offset of universal joints; twist, base_step, target_step (N, 6); scale (3,) of the
    instrument along directions ``way`` (3, 3).
    """

    du: np.ndarray
    base: np.ndarray
    platform: np.ndarray
    stretch: np.ndarray
    gap: np.ndarray
    twist: np.ndarray
    base_step: np.ndarray
    target_step: np.ndarray
    stretch_seen: np.ndarray = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True)
class Effect:
    """One cause: its kind, legs, true parameters (those in ``sized`` grow with eta), units.

    ``apply(state, run, values)`` adds it to a state. ``note`` tells what a reader should know;
    ``same`` are kinds that do just the same on this machine.
    """

    kind: str
    legs: tuple[int, ...]
    values: dict[str, object]
    sized: tuple[str, ...]
    units: dict[str, str]
    apply: Callable[[State, Run, dict], None]
    row: int | None = None
    note: str = ""
    same: tuple[str, ...] = ()

    def scaled(self, scale: float) -> Effect:
        """The same effect, so many times as large."""
        grown = {k: np.asarray(v) * scale if k in self.sized else v for k, v in self.values.items()}
        return replace(self, values=grown)


def rest(run: Run) -> State:
    """No departure."""
    n, legs = run.q.shape
    six = lambda: np.zeros((n, 6))  # noqa: E731
    return State(
        np.zeros((n, legs)), np.zeros((n, legs, 3)), np.zeros((n, legs, 3)), np.zeros((n, legs)),
        np.zeros(legs), six(), six(), six(),
    )  # fmt: skip


def poses(run: Run, effects: list[Effect]) -> tuple[np.ndarray, np.ndarray, State]:
    """True poses in the base frame (N, 3), (N, 3, 3) and the state behind them."""
    state = rest(run)
    for effect in effects:
        effect.apply(state, run, effect.values)
    geo, grow = run.geo, 1 + state.stretch
    du = state.du + (run.u * state.stretch if geo.closure == "strut" else 0.0)
    geo = replace(
        geo, base=geo.base + state.base, platform=geo.platform + state.platform,
        length=geo.length * grow, proximal=geo.proximal * grow, u_gap=geo.u_gap + state.gap,
    )  # fmt: skip
    pos, rot = forward(geo, run.q + du, run.pos, run.rot, run.machine.motion)
    return *moved(pos, rot, state.twist), state


def measured(run: Run, place: Setup, effects: list[Effect]) -> tuple[np.ndarray, np.ndarray]:
    """Noise-free measured positions (N, 3) and rotations (N, 3, 3)."""
    pos, rot, state = poses(run, effects)
    point, turned = seen(place, pos, rot, state.base_step, state.target_step)
    return point @ state.stretch_seen.T, turned


def whitened(place: Setup, motion: str, a: tuple, b: tuple) -> np.ndarray:
    """Difference b − a of measured poses over sigma, flat: rows by measured coordinates."""
    turn = Rotation.from_matrix(b[1] @ np.swapaxes(a[1], 1, 2)).as_rotvec() / place.sigma_rot
    both = np.hstack([(b[0] - a[0]) / place.sigma_pos, turn])
    cols = COLUMNS[motion] if place.instrument == "pose" else [0, 1, 2]
    return both[:, cols].ravel()


STEP, TURN = 0.02, 1e-4  # of differences: mm, rad


def shifted_setup(place: Setup, kind: str, i: int, step: float) -> Setup:
    """Setup with its target or its frame a step (mm or rad) aside along coordinate i."""
    if kind == "target":
        return replace(place, target=place.target + step * np.eye(3)[i])
    if i < 3:
        return replace(place, frame_pos=place.frame_pos + step * np.eye(3)[i])
    turn = Rotation.from_rotvec(step * np.eye(3)[i - 3]).as_matrix()
    return replace(place, frame_rot=turn @ place.frame_rot)


def open_setup(place: Setup, motion: str) -> list[tuple[str, int]]:
    """Coordinates of frame and target that a user would have to fit."""
    if place.known:
        return []
    free = COLUMNS[motion] if motion != "translational" else range(6)
    kinds = [("frame", i) for i in free]
    return kinds + [("target", i) for i in range(2 if motion == "planar" else 3)]


def jacobian(run: Run, place: Setup, errors: np.ndarray) -> np.ndarray:
    """Whitened measurements' derivative by slots, frame and target (entries, parameters)."""
    machine, motion = run.machine, run.machine.motion
    columns, shifted, steps = [], [], [TURN if s.angle else STEP for s in machine.slots]
    for j, step in enumerate(steps):
        for sign in (-1, 1):
            other = errors.copy()
            other[j] += sign * step
            shifted.append(with_errors(machine, other))
    found = forward_of_each(shifted, run.q, run.pos, run.rot, motion)
    for step, *ends in zip(steps, found[::2], found[1::2], strict=True):
        columns.append(whitened(place, motion, *(seen(place, *at) for at in ends)) / (2 * step))
    for kind, i in open_setup(place, motion):
        step = TURN if kind == "frame" and i > 2 else STEP
        ends = [seen(shifted_setup(place, kind, i, s * step), run.pos, run.rot) for s in (-1, 1)]
        columns.append(whitened(place, motion, *ends) / (2 * step))
    return np.column_stack(columns)


@dataclass(frozen=True)
class Judge:
    """Measures effects: what is left of them after geometry, frame and target."""

    run: Run
    place: Setup
    basis: np.ndarray
    rank: int
    plain: tuple[np.ndarray, np.ndarray]

    def left(self, flat: np.ndarray) -> np.ndarray:
        """The part of a whitened vector that no parameter imitates."""
        return flat - self.basis @ (self.basis.T @ flat)

    def sizes(self, effects: list[Effect]) -> tuple[float, float]:
        """RMS over sigma of the effects after and before the projection."""
        now = measured(self.run, self.place, effects)
        flat = whitened(self.place, self.run.machine.motion, self.plain, now)
        return float(np.sqrt(np.mean(self.left(flat) ** 2))), float(np.sqrt(np.mean(flat**2)))

    def scale_for(self, effect: Effect, eta: float) -> float:
        """How many times as large the effect must be to leave eta."""
        scale = 1.0
        for _ in range(25):
            now, before = self.sizes([effect.scaled(scale)])
            if now < 1e-4 * before or now == 0:
                raise ValueError(f"{effect.kind}: the geometry swallows all of it")
            if abs(now / eta - 1) < 1e-3:
                break
            scale *= float(np.clip(eta / now, 0.05, 20))
        return scale


def judge(run: Run, place: Setup, errors: np.ndarray) -> Judge:
    """Projector of a campaign, rank cut at 1e-6 of the largest scaled singular value."""
    columns = jacobian(run, place, errors)
    norm = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns / np.where(norm > 0, norm, 1), full_matrices=False)
    rank = int(np.sum(s > 1e-6 * s[0]))
    return Judge(run, place, u[:, :rank], rank, seen(place, run.pos, run.rot))
