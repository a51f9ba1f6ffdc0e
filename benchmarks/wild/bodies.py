"""Causes in whole bodies: heat, bending plates, drifting and scaling instruments."""

from __future__ import annotations

import numpy as np

from .campaign import Run, total_wrench
from .kinematics import COLUMNS
from .physics import mask, pick
from .world import Effect

WARM = 1e-5  # per K


def warmth(run: Run) -> np.ndarray:
    """Temperature above 20 °C (N,)."""
    return run.temperature - 20.0


def grow(state, run: Run, part: str, legs, strain: np.ndarray) -> None:
    """Expand legs, base or platform by a strain (N,) or (N, L)."""
    strain = np.broadcast_to(strain if strain.ndim == 2 else strain[:, None], run.q.shape)
    if part == "leg":
        state.stretch += mask(run, legs) * strain
    elif part == "base":
        state.base += strain[..., None] * run.geo.base
    else:
        state.platform += strain[..., None] * run.geo.platform


def thermal(part: str, how: str = "all"):
    """Expansion of legs (every link of them), of base points or of platform points."""

    def make(rng, run):
        legs = pick(rng, run, how) if part == "leg" else ()
        apply = lambda s, r, v: grow(s, r, part, legs, v["expansion"] * warmth(r))  # noqa: E731
        return Effect(f"{part}_thermal", legs, {"expansion": WARM}, ("expansion",),
                      {"expansion": "1/K"}, apply)  # fmt: skip

    return make


def thermal_by_leg(rng, run: Run) -> Effect:
    """Every leg expands with a coefficient of its own."""
    legs = pick(rng, run, "all")
    values = {"expansion": WARM * rng.uniform(0.2, 2.5, len(legs))}
    apply = lambda s, r, v: grow(s, r, "leg", legs, v["expansion"] * warmth(r)[:, None])  # noqa: E731
    return Effect("leg_thermal", legs, values, ("expansion",), {"expansion": "1/K"}, apply,
                  note="one coefficient per leg")  # fmt: skip


def drift(rng, run: Run) -> Effect:
    """Twist of the pose with time, in base axes."""
    rate = np.zeros(6)
    size = np.array([0.02] * 3 + [1e-4] * 3) * rng.normal(size=6)
    rate[COLUMNS[run.machine.motion]] = size[COLUMNS[run.machine.motion]]

    def apply(state, r, v):
        state.base_step += r.time[:, None] * v["rate"]

    return Effect(
        "drift", (), {"rate": rate / run.time[-1]}, ("rate",), {"rate": "mm/s, rad/s"}, apply
    )


def sensor_scale(rng, run: Run) -> Effect:
    """Measured positions too large."""

    def apply(state, r, v):
        state.stretch_seen = state.stretch_seen * (1 + v["scale"])

    return Effect("sensor_scale", (), {"scale": 1e-4}, ("scale",), {"scale": "1"}, apply)


def tilt(rng, run: Run) -> Effect:
    """Planar: one direction of the measuring plane is seen too short."""
    angle = rng.uniform(0, np.pi)
    way = np.array([np.cos(angle), np.sin(angle), 0])

    def apply(state, r, v):
        state.stretch_seen = state.stretch_seen @ (np.eye(3) - v["shrink"] * np.outer(way, way))

    values = {"shrink": 2e-4, "direction": way[:2]}
    return Effect("tilt", (), values, ("shrink",), {"shrink": "1", "direction": "unit"}, apply)


def base_compliance(rng, run: Run) -> Effect:
    """The platform's twist follows the wrench, as if the stand gave way."""
    keep = np.zeros(6)
    keep[COLUMNS[run.machine.motion]] = 1
    give = keep * np.array([2e-4] * 3 + [2e-9] * 3) * rng.uniform(0.5, 2, 6)

    def apply(state, r, v):
        state.twist += total_wrench(r) * v["give"]

    units = {"give": "mm/N, rad/(N·mm), diagonal"}
    return Effect("base_compliance", (), {"give": give}, ("give",), units, apply)


def stand(rng, run: Run) -> Effect:
    """The base leans on springs about a point beside and below it, as the load's moment wants."""
    size = np.ptp(run.geo.base[0], axis=0).max()
    free = np.isin([3, 4, 5], COLUMNS[run.machine.motion])
    at = size * rng.uniform(-0.3, 0.3, 3) - [0, 0, size * rng.uniform(0.2, 0.8)]
    at = at * ([1, 1, 0] if run.machine.motion == "planar" else [1, 1, 1])
    give = free * 2e-9 * rng.uniform(0.5, 2, 3)

    def apply(state, r, v):
        wrench = total_wrench(r)
        moment = wrench[:, 3:] + np.cross(r.pos - v["at"], wrench[:, :3])
        turn = v["give"] * moment
        state.base_step += np.hstack([np.cross(v["at"], turn), turn])

    values, units = {"give": give, "at": at}, {"give": "rad/(N·mm), diagonal", "at": "mm"}
    return Effect("base_compliance", (), values, ("give",), units, apply, note="about at")


ALONE = 0.1
"""A plate that takes along the next joint by less than this part."""


def plate(part: str):
    """A plate that bends where the legs push: smooth influence between its joints."""

    def make(rng, run):
        points = (run.geo.base if part == "base" else run.geo.platform)[0]
        apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
        wide = rng.uniform(0.3, 0.6) * apart.max()
        values = {"give": 3e-4, "reach": wide}

        def apply(state, r, v):
            force = -r.rods if part == "base" else r.rods
            if part == "platform":
                force = np.einsum("nij,nli->nlj", r.rot, force)
            if r.machine.motion == "spatial":
                force = force * [0, 0, 1.0]
            field = v["give"] * np.exp(-((apart / v["reach"]) ** 2) / 2)
            bend = np.einsum("ij,njk->nik", field, force)
            target = state.base if part == "base" else state.platform
            target += bend

        # where no joint moves another one, each strut is only softer by its own seat
        near = np.exp(-((apart[~np.eye(len(apart), dtype=bool)].min() / wide) ** 2) / 2)
        units = {"give": "mm/N", "reach": "mm"}
        return Effect("plate_compliance", (), values, ("give",), units, apply, note=f"the {part}",
                      same=("compliance",) if near < ALONE else ())

    return make
