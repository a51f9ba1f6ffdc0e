"""Effects that the library does not know, to see what a diagnosis makes of them.

Each is linear in one size. Places within a joint's stroke are given as parts of the range that
the session visited, so that the effect always shows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hidden_effects import LIBRARY, chosen, small
from hidden_scene import Array, Cause, Change, Kind, Scene, positive, signed
from numpy.typing import NDArray

DENT = 0.1
"""Full width at half height of a local bump, part of the visited range."""
TAKE_UP = 0.1
"""Travel, as a part of the visited range, over which play is taken up to 1 - 1/e."""
OVERSHOOT = (0.01, 0.2)
"""How far a drive overshoots in order to come back, part of the visited range."""


def _part(scene: Scene) -> Array:
    """Return where each joint stands within its visited range, 0 to 1, (N, k)."""
    low, high = scene.visited[:, 0], scene.visited[:, 1]
    return np.asarray((scene.q - low) / (high - low), dtype=float)


def _joints(scene: Scene, cause: Cause, error: Array) -> Change:
    return Change(joints=np.where(chosen(scene, cause), error, 0.0))


def _random_walk(scene: Scene, cause: Cause) -> Change:
    """The measuring frame wanders: independent steps from row to row in every coordinate.

    ``step``: m for one row; turns by the same over the platform's length scale, about the
    middle of the field, in measuring axes.
    """
    rng = np.random.default_rng([cause.seed, 11])
    free = [0, 1, 5] if scene.mechanism.motion.planar else list(range(6))
    walk = np.zeros((len(scene.q), 6))
    walk[:, free] = np.cumsum(rng.normal(size=(len(walk), len(free))), axis=0)
    walk[:, 3:] /= scene.mechanism.length_scale
    return Change(frame=cause.parameters["step"] * walk)


def _bump(scene: Scene, cause: Cause) -> Change:
    """A Gaussian dent of ``height`` (m or rad) at ``place`` of the visited range."""
    width = DENT / (2.0 * np.sqrt(2.0 * np.log(2.0)))
    away = (_part(scene) - cause.parameters["place"]) / width
    return _joints(scene, cause, cause.parameters["height"] * np.exp(-0.5 * away**2))


def _kink(scene: Scene, cause: Cause) -> Change:
    """Two straight lines that meet at mid-stroke: ``rise`` (m or rad) over the upper half."""
    return _joints(scene, cause, cause.parameters["rise"] * np.maximum(
        2.0 * _part(scene) - 1.0, 0.0))


def taken_up(scene: Scene, seed: int) -> Array:
    """Return how far the play of each joint is taken up, -1 to 1, (N, k), row by row.

    A travel t in direction s brings the state x to s + (x - s) exp(-t/L). A joint that has to
    be approached against its way overshoots by a random distance and comes back.
    """
    rng = np.random.default_rng([seed, 12])
    place = _part(scene)
    low, high = np.log(OVERSHOOT)
    beyond = np.exp(rng.uniform(low, high, place.shape))
    way = np.diff(place, axis=0, prepend=place[:1])
    against = np.sign(way) != scene.approach
    there = np.exp(-(np.abs(way) + np.where(against, beyond, 0.0)) / TAKE_UP)
    back = np.where(against, np.exp(-beyond / TAKE_UP), 1.0)
    out = np.empty_like(place)
    state = np.zeros(place.shape[1])
    for n, (side, s) in enumerate(zip(np.sign(way), scene.approach, strict=True)):
        first = np.where(against[n], -s, np.where(side == 0.0, s, side))
        state = first + (state - first) * there[n]
        state = s + (state - s) * back[n]
        out[n] = state
    return out


def _play_memory(scene: Scene, cause: Cause) -> Change:
    """Backlash of ``width`` (m or rad) that is taken up only in part."""
    return _joints(scene, cause, cause.parameters["width"] / 2.0 * taken_up(scene, cause.seed))


def _saturation(scene: Scene, cause: Cause) -> Change:
    """Measured positions drawn in, the more so the farther from the field's middle.

    rho = distance over the field's radius; inward by ``size`` (rho - tanh rho), m.
    """
    def sensor(point: Array) -> Array:
        away = point - point.mean(axis=0)
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        rho = distance / distance.max()
        inward = cause.parameters["size"] * (np.tanh(rho) - rho)
        return np.asarray(inward * away / np.maximum(distance, 1e-12), dtype=float)

    return Change(sensor=sensor)


def _one(name: str, sign: Callable[[np.random.Generator], float]
         ) -> Callable[[Scene, np.random.Generator], dict[str, float]]:
    return lambda scene, rng: {name: small(scene) * sign(rng)}


def _draw_bump(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    """A place that several rows pass: the densest of some random ones on the fewest."""
    places: NDArray[np.float64] = rng.uniform(0.25, 0.75, 5)
    near = np.abs(_part(scene)[:, :, None] - places) < DENT / 2.0
    best = int(np.argmax(near.sum(axis=0).min(axis=0)))
    return {"height": small(scene) * signed(rng), "place": float(places[best])}


UNKNOWN: dict[str, Kind] = {
    "random_walk": Kind(_random_walk, lambda s, rng: {"step": 1e-6 * s.mechanism.reach},
                        ("step",)),
    "bump": Kind(_bump, _draw_bump, ("height",), joints=True),
    "kink": Kind(_kink, _one("rise", signed), ("rise",), joints=True),
    "play_memory": Kind(_play_memory, _one("width", positive), ("width",), joints=True),
    "saturation": Kind(_saturation, lambda s, rng: {"size": 1e-5 * s.mechanism.reach}, ("size",)),
}


def _never(scene: Scene, rng: np.random.Generator) -> dict[str, float]:
    raise NotImplementedError("a frozen slot is drawn by hidden.draw()")


KINDS: dict[str, Kind] = {
    **LIBRARY, "geometry": Kind(lambda s, c: Change(geometry=c.parameters), _never, ()), **UNKNOWN}
"""All kinds: the library's, frozen slots, and those that no library knows."""
