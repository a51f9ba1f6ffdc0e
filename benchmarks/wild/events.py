"""What happens once, from a row on: lost zeros, slipped encoders, bumped targets and bases.

Rows count from 0 here; the truth file gives both counts.
"""

from __future__ import annotations

import numpy as np

from .campaign import Run
from .kinematics import COLUMNS
from .physics import joint_effect, pick, tick, unit
from .world import Effect


def onset(rng, run: Run, low: float = 0.25, high: float = 0.75) -> int:
    """A row well inside the campaign."""
    return int(rng.integers(int(low * run.count), int(high * run.count)))


def since(run: Run, row: int) -> np.ndarray:
    """One from a row on (N, 1)."""
    return (np.arange(run.count) >= row)[:, None].astype(float)


def homed_again(how: str, low: float = 0.25, high: float = 0.75):
    """Zeros found anew, elsewhere: one leg, or every leg by an amount of its own."""

    def make(rng, run):
        legs, row = pick(rng, run, how), onset(rng, run, low, high)
        shift = np.zeros(run.q.shape[1])
        shift[list(legs)] = (
            tick(run) * rng.uniform(0.4, 1.5, len(legs)) * rng.choice([-1, 1], len(legs))
        )
        return joint_effect("zero_shift", legs, {"shift": shift}, ("shift",), {"shift": unit(run)},
                            lambda r, v: since(r, row) * v["shift"], row=row)  # fmt: skip

    return make


def there_and_back(rng, run: Run) -> Effect:
    """One leg's zero is off between two rows and right again after."""
    row, legs = onset(rng, run, 0.2, 0.45), pick(rng, run, "one")
    end = row + int(0.25 * run.count)
    return joint_effect(
        "zero_shift", legs, {"shift": tick(run), "until_index": end}, ("shift",),
        {"shift": unit(run)}, lambda r, v: (since(r, row) - since(r, end)) * v["shift"],
        row=row, note="ends before until_index",
    )  # fmt: skip


def slipped_turn(rng, run: Run) -> Effect:
    """An encoder loses one turn: 5 mm of screw, or 3.6 deg behind a gear of 100."""
    row, legs = onset(rng, run), pick(rng, run, "one")
    size = (np.radians(3.6) if run.machine.rotary else 5.0) * rng.choice([-1, 1])
    return joint_effect(
        "zero_shift", legs, {"shift": size}, (), {"shift": unit(run)},
        lambda r, v: since(r, row) * v["shift"], row=row, note="one turn",
    )  # fmt: skip


def slipped_counts(rng, run: Run) -> Effect:
    """An encoder loses a few counts (of 5 µm, or of the like angle)."""
    row, legs = onset(rng, run), pick(rng, run, "one")
    size = tick(run) / 4 * rng.integers(6, 20)
    return joint_effect(
        "zero_shift", legs, {"shift": size}, (), {"shift": unit(run)},
        lambda r, v: since(r, row) * v["shift"], row=row, note="counts",
    )  # fmt: skip


def bumped(what: str, low: float = 0.25, high: float = 0.75):
    """A step of the target's or of the base's pose (in platform, in base axes)."""

    def make(rng, run):
        row, step = onset(rng, run, low, high), np.zeros(6)
        cols = COLUMNS[run.machine.motion]
        step[cols] = (np.array([0.05] * 3 + [2e-4] * 3) * rng.normal(size=6))[cols]
        if run.machine.motion == "translational" and what == "base":
            step[3:] = 2e-4 * rng.normal(size=3)

        def apply(state, r, v):
            target = state.target_step if what == "target" else state.base_step
            target += since(r, row) * v["step"]

        units = {"step": "mm, rad"}
        return Effect(f"{what}_shift", (), {"step": step}, ("step",), units, apply, row=row)

    return make


def base_wanders(how: str):
    """The instrument's stand never rests: a slow wave, or a random walk. In no list."""

    def make(rng, run):
        cols = [c for c in COLUMNS[run.machine.motion] if c < 3]
        if how == "sways":
            path = np.zeros((run.count, 6))
            turns, phase = rng.uniform(0.5, 1.5), rng.uniform(0, 2 * np.pi)
            place = run.time / max(run.time[-1], 1.0)
            path[:, rng.choice(cols)] = 0.05 * np.sin(2 * np.pi * turns * place + phase)
        else:
            path = np.zeros((run.count, 6))
            path[:, cols] = 0.01 * np.cumsum(rng.normal(size=(run.count, len(cols))), axis=0)

        def apply(state, r, v):
            last = np.tile(path[-1:], (r.count - len(path), 1))  # rows after the campaign
            state.base_step += v["size"] * np.concatenate([path, last])

        return Effect("learned", (), {"size": 1.0}, ("size",), {"size": "1"}, apply,
                      note=f"base {how}")

    return make


def leg_settles(rng, run: Run) -> Effect:
    """A leg's zero comes to rest slowly, with the time since it was mounted. In no list."""
    legs, rest = pick(rng, run, "one"), rng.uniform(0.1, 0.4)
    return joint_effect(
        "learned", legs, {"size": tick(run)}, ("size",), {"size": unit(run)},
        lambda r, v: v["size"] * np.exp(-r.time / (rest * max(run.time[-1], 1.0)))[:, None],
        note="settles",
    )  # fmt: skip
