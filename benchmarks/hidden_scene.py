"""A measuring session, and how changes that effects make show in what is measured.

A session without effects is a :class:`Scene`; what an effect adds to it is a :class:`Change`,
linear in the effect's size; :func:`measure` solves the forward kinematics again with all changes
in. The load on an actuator comes from virtual work, f = wrench . d(pose)/du, by central
differences of the forward kinematics. Nothing here uses the program's effects.

Everything is SI: m, rad, N, kg, s, K.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, moved
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.effects import Shift
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]
Values = Mapping[str, float]

STANDARD_GRAVITY = 9.80665
VIRTUAL_STEP = 1e-4
"""Step of the virtual work: this part of the reach, or so many rad."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A session of N rows and k joints with nothing hidden and no noise.

    Attributes:
        mechanism: as drawn; ``free`` is what an identification may change.
        g: the true parameters (P,); registration: where the instrument truly stands.
        q: joint values that the controller believed (N, k); pose: true poses (N, 8).
        approach: +-1 (N, k); velocity: of q (N, k), with the sign of the approach.
        temperature: K above 20 degrees Celsius (N,); payload: kg (N,); time: s (N,).
        groups: which commanded pose (N,).
    """

    mechanism: Mechanism
    g: Array
    registration: Registration
    q: Array
    pose: Array
    approach: Array
    velocity: Array
    temperature: Array
    payload: Array
    time: Array
    groups: NDArray[np.int64]

    @cached_property
    def model(self) -> Model:
        """The true machine."""
        return Model(self.mechanism, self.g)

    @property
    def rotary(self) -> bool:
        """Whether the drives turn."""
        return self.mechanism.actuator_quantity[0] == "angle"

    @cached_property
    def visited(self) -> Array:
        """Smallest and largest joint value of the session (k, 2)."""
        return np.stack([self.q.min(axis=0), self.q.max(axis=0)], axis=-1)

    @cached_property
    def stroke(self) -> Array:
        """The drives' travel (k, 2): the limits, else what was visited."""
        limits = self.mechanism.limits
        return np.where(np.isfinite(limits).all(axis=1, keepdims=True), limits, self.visited)

    @cached_property
    def wrench(self) -> Array:
        """Force and moment on the platform at its origin, base axes (N, 6)."""
        force = STANDARD_GRAVITY * self.payload[:, None] * self.mechanism.gravity
        return np.concatenate([force, np.zeros_like(force)], axis=1)

    @cached_property
    def load(self) -> Array:
        """Load on the actuators (N, k), N or N m, positive towards larger u."""
        n, k = self.q.shape
        step = VIRTUAL_STEP * (1.0 if self.rotary else self.mechanism.reach)
        aside = step * np.eye(k)[:, None, :]
        q = np.concatenate([self.q + aside, self.q - aside]).reshape(-1, k)
        found = solved(self.model, q, np.tile(self.pose, (2 * k, 1)),
                       np.tile(self.q, (2 * k, 1))).reshape(2, k, n, 8)
        travel = cga.translation(found[0]) - cga.translation(found[1])
        turn = cga.rotation_vector(cga.compose(found[0], cga.reverse(found[1])))
        twist = np.concatenate([travel, turn], axis=-1) / (2.0 * step)
        return np.asarray(np.einsum("knc,nc->nk", twist, self.wrench), dtype=float)


@dataclass(frozen=True)
class Cause:
    """One hidden effect.

    ``on``: names of actuators, all of which share the parameters, empty where the effect is
    not one of joints; ``parameters``: SI; ``seed``: of what it draws by itself.
    """

    kind: str
    on: tuple[str, ...]
    parameters: Values
    seed: int = 0


@dataclass(frozen=True)
class Change:
    """What causes add to a scene.

    Attributes:
        joints: change of u by actuator (N, k), m or rad.
        slots: (limb, slot name) -> change (N,).
        pose: platform displacement of its origin and turn, base axes (N, 6).
        frame: displacement and turn of what is measured about the field's middle, (N, 6).
        sensor: positions (N, 3) in the measuring frame -> what the sensor adds (N, 3).
        geometry: parameter name -> error.
    """

    joints: Array | None = None
    slots: Mapping[tuple[int, str], Array] = field(default_factory=dict)
    pose: Array | None = None
    frame: Array | None = None
    sensor: Callable[[Array], Array] | None = None
    geometry: Values = field(default_factory=dict)


@dataclass(frozen=True)
class Kind:
    """A kind of effect.

    Attributes:
        change: what a cause adds to a scene. draw: its parameters, at a small size.
        sizes: the parameters that scale with the effect, inversely if ``inverse``.
        joints: whether it acts on chosen actuators. fits: machines for which it makes sense.
    """

    change: Callable[[Scene, Cause], Change]
    draw: Callable[[Scene, np.random.Generator], dict[str, float]]
    sizes: tuple[str, ...]
    inverse: bool = False
    joints: bool = False
    fits: Callable[[Mechanism], bool] = lambda mechanism: True


def solved(model: Model, q: Array, start: Array, start_q: Array) -> Array:
    """Return poses (N, 8) at joints ``q`` next to ``start``; all must exist."""
    found = forward(model, q, start=start, start_q=start_q)
    if not found.converged.all():
        raise ValueError("a hidden effect drives the machine out of its workspace")
    return found.pose


def measure(scene: Scene, changes: Sequence[Change] = (), jitter: Array | None = None) -> Array:
    """Return position and rotation vector in the measuring frame (N, 6), without noise.

    ``jitter``: what the joints miss at random (N, k), unit of q.
    """
    pose = scene.pose
    slots, g = _slots(scene, changes)
    if slots or jitter is not None or any(c.geometry for c in changes):
        model = Model(scene.mechanism, g, Shift(slots) if slots else None)
        q = scene.q if jitter is None else scene.q + jitter
        pose = solved(model, q, pose, scene.q)
    for change in changes:
        if change.pose is not None:
            pose = moved(pose, change.pose)
    seen = measured_pose(scene.registration, pose)
    for change in changes:
        if change.frame is not None:
            seen = _wandered(seen, change.frame)
    added = [c.sensor(seen[:, :3]) for c in changes if c.sensor is not None]
    if added:
        seen = np.concatenate([seen[:, :3] + np.sum(added, axis=0), seen[:, 3:]], axis=1)
    return seen


def _slots(scene: Scene, changes: Sequence[Change]) -> tuple[dict[tuple[int, str], Array], Array]:
    """Return the changes of all slots, and the parameters with their hidden errors (P,)."""
    slots: dict[tuple[int, str], Array] = {}
    g = scene.g.copy()
    for change in changes:
        mine = dict(change.slots)
        if change.joints is not None:
            for i, limb in enumerate(scene.mechanism.limbs):
                own = change.joints[:, limb.actuator]
                mine[i, "offset"] = mine[i, "offset"] + own if (i, "offset") in mine else own
        for name, value in mine.items():
            slots[name] = slots[name] + value if name in slots else value
        for parameter, error in change.geometry.items():
            g[scene.mechanism.names.index(parameter)] += error
    return slots, g


def _wandered(seen: Array, step: Array) -> Array:
    """Return measurements (N, 6) displaced and turned about their middle by steps (N, 6)."""
    turn = Rotation.from_rotvec(step[:, 3:])
    middle = seen[:, :3].mean(axis=0)
    point = middle + turn.apply(seen[:, :3] - middle) + step[:, :3]
    rotation = (turn * Rotation.from_rotvec(seen[:, 3:])).as_rotvec()
    return np.concatenate([point, rotation], axis=1)


def times(cause: Cause, kind: Kind, factor: float) -> Cause:
    """Return the cause with its effect scaled by a factor; a kind without sizes scales all."""
    by = factor if not kind.inverse else 1.0 / factor if factor else np.inf
    return replace(cause, parameters={
        name: float(value * by) if name in kind.sizes or not kind.sizes else value
        for name, value in cause.parameters.items()})


def positive(rng: np.random.Generator) -> float:
    """Return a factor between 0.5 and 2."""
    return float(np.exp(rng.uniform(-np.log(2.0), np.log(2.0))))


def signed(rng: np.random.Generator) -> float:
    """Return a factor between 0.5 and 2 of either sign."""
    return positive(rng) * float(rng.choice((-1.0, 1.0)))


class Impossible(ValueError):
    """The effect cannot have the wanted size on this machine."""


class Absorbed(Impossible):
    """The geometry swallows the effect: no size of it shows."""


class Unphysical(Impossible):
    """The effect would have to be larger than it can be."""
