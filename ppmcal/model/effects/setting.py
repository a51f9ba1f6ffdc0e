"""The inputs of effects in the rows (:class:`Setting`) and their contributions (:class:`Shift`).

A contribution is a change of limb slots row by row (a joint that is not where the controller
assumes it is a change of ``offset``), a twist of the platform, or a stretch of measured positions.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.history import History
from ppmcal.model.motions import Motion

Rows = NDArray[np.int64] | NDArray[np.bool_]

PLACE = {"x": 0, "y": 1, "z": 2, "rx": 3, "ry": 4, "rz": 5}


@dataclass(frozen=True, eq=False)
class Shift:
    """Contributions of effects in N rows, SI.

    Attributes:
        slots: (limb index, slot name) -> change of that slot (N,); ``offset`` is the
            joint's own coordinate u.
        pose: platform displacement of the origin and rotation vector, base axes (N, 6).
        stretch: change of the map from true to measured position, measuring frame,
            (N or 1, 3, 3): measured = (1 + stretch) true.
        frame: displacement of the base relative to the instrument: of the base's origin and
            rotation vector, base axes (N, 6).
        target: of the measured body relative to the platform, at the platform's origin and in its
            axes (N, 6). Neither moves the machine.
        targets: the same for single ones of several targets on the platform, by data set name.
    """

    slots: Mapping[tuple[int, str], Array] = field(default_factory=dict)
    pose: Array | None = None
    stretch: Array | None = None
    frame: Array | None = None
    target: Array | None = None
    targets: Mapping[str, Array] = field(default_factory=dict)

    def take(self, rows: Rows) -> Shift:
        """Return the shift of some rows."""
        stretch = self.stretch
        if stretch is not None and stretch.shape[0] > 1:
            stretch = stretch[rows]
        return Shift({s: v[rows] for s, v in self.slots.items()},
                     None if self.pose is None else self.pose[rows], stretch,
                     None if self.frame is None else self.frame[rows],
                     None if self.target is None else self.target[rows],
                     {name: v[rows] for name, v in self.targets.items()})

    def of(self, target: str) -> Shift:
        """Return the shift for one of several targets, by its data set's name."""
        if not self.targets:
            return self
        own = [v for v in (self.target, self.targets.get(target)) if v is not None]
        return replace(self, target=functools.reduce(np.add, own) if own else None, targets={})

    def times(self, factor: float) -> Shift:
        """Return the shift scaled by a number."""
        pose, stretch, frame, target = (
            None if v is None else factor * v
            for v in (self.pose, self.stretch, self.frame, self.target))
        return Shift({s: factor * v for s, v in self.slots.items()}, pose, stretch, frame, target,
                     {name: factor * v for name, v in self.targets.items()})


def total(shifts: Sequence[Shift]) -> Shift:
    """Return the sum of shifts."""
    slots: dict[tuple[int, str], Array] = {}
    targets: dict[str, Array] = {}
    for shift in shifts:
        for name, value in shift.slots.items():
            slots[name] = slots[name] + value if name in slots else value
        for target, value in shift.targets.items():
            targets[target] = targets[target] + value if target in targets else value

    def added(parts: Sequence[Array | None]) -> Array | None:
        known = [p for p in parts if p is not None]
        return functools.reduce(np.add, known) if known else None

    return Shift(slots, added([s.pose for s in shifts]), added([s.stretch for s in shifts]),
                 added([s.frame for s in shifts]), added([s.target for s in shifts]), targets)


@dataclass(frozen=True)
class LimbSetting:
    """Data on one limb for effects: its actuator and lengths, slot -> value, m.

    ``struts``: lengths of its bars; ``offset`` stands for u if the strut is driven.
    ``base`` and ``platform``: coordinates of its joint centres. ``pulls_only``: it is a rope.
    """

    actuator: int
    struts: Mapping[str, Array]
    base: Mapping[str, Array]
    platform: Mapping[str, Array]
    pulls_only: bool = False


@dataclass(frozen=True, eq=False)
class Setting:
    """Inputs of effects in N rows with k actuators; nan where not recorded.

    Attributes:
        motion: the coordinates of the platform.
        turning: (k,) whether the actuated joint rotates; otherwise it slides.
        travel: ratio q (N, k), m or rad. stroke: its range (k, 2), nan where unknown.
        approach: direction from which each joint came, +1 or -1 (N, k).
        velocity: of u (N, k), per second.
        temperature: minus 20 degrees Celsius, K (N,).
        wrench: on the platform at its origin, base axes (N, 6), N and N m.
        time: s (N,).
        row: number in the campaign (N,); inf after it.
        limbs: one each.
        load_of: returns the load on the actuators (N, k), N or N m, under a wrench (N, 6).
        forces_of: returns the force carried by each limb under a wrench (N, limbs, 3), base axes.
        tensions_of: returns the tensions of the joints (N, k) if some (k,) pull by 1 and the
            others hold against them; None: no joints can.
        tension_of: returns the tension of the joints (N, k), N, measured or under a wrench
            (N, 6); nan if neither determines it.
        span_of: returns the horizontal distance between the ends of each limb (N, limbs), m.
        weight: the payload's weight as part of the wrench's force (N, 3), N.
        gravity: its direction in the file, base axes (3,).
        turn: rotation of the platform (N, 3, 3), from its axes to the base's.
        known: the same with the load on the platform as recorded, if effects change it.
        pose_of: returns the closed pose of the platform (N, 6), base axes, rotation as a vector.
        touch: whether a flat was touched (N,), None: nowhere.
        until: row at which another event replaces this one, by joint (k,); None: never.
        history: all rows in the order of their visit, None if unknown; ``place``: index of these
            rows in it (N,), -1 if not in it; ``ratio`` of the drives (k,).
        past_load_of: returns the load on the actuators there (H, k); ``carried``: kinds and values
            of the effects that change the load on the platform.
    """

    motion: Motion
    turning: Bools
    travel: Array
    stroke: Array
    approach: Array
    velocity: Array
    temperature: Array
    wrench: Array
    time: Array
    row: Array
    limbs: tuple[LimbSetting, ...]
    load_of: Callable[[Array], Array]
    forces_of: Callable[[Array], Array]
    weight: Array
    gravity: Array
    turn: Array
    until: Array | None = None
    known: Setting | None = None
    history: History | None = None
    place: Ints | None = None
    ratio: Array | float = 1.0
    past_load_of: Callable[[], Array] | None = None
    carried: tuple[str | float, ...] = ()
    pose_of: Callable[[], Array] | None = None
    touch: Bools | None = None
    tensions_of: Callable[[Bools], Array] | None = None
    tension_of: Callable[[Array], Array] | None = None
    span_of: Callable[[], Array] | None = None

    @cached_property
    def load(self) -> Array:
        """F = J_q^T wrench (N, k): positive if it pushes towards larger u."""
        return self.load_of(self.wrench)

    @cached_property
    def forces(self) -> Array:
        """Force of each limb on the base, transmitted from the platform (N, limbs, 3), N."""
        return self.forces_of(self.wrench)

    def tensions(self, on: Bools) -> Array:
        """Return the tensions of all joints (N, k) relative to that with which ``on`` (k,) pull.

        0 for a rope that would have to push, which is slack; nan where the others cannot hold.
        """
        if self.tensions_of is None:
            return np.full_like(self.travel, np.nan)
        return np.maximum(self.tensions_of(on), 0.0)

    @cached_property
    def tension(self) -> Array:
        """Tension of each joint (N, k), N; negative if it would have to push, nan if unknown."""
        return self.tension_of(self.wrench) if self.tension_of else np.full_like(self.travel,
                                                                                 np.nan)

    @cached_property
    def spans(self) -> Array:
        """Horizontal distance between the ends of each limb (N, limbs), m."""
        return self.span_of() if self.span_of else np.full(
            (len(self.travel), len(self.limbs)), np.nan)

    def points(self, body: str) -> Array:
        """Return the joint centres of ``base`` or ``platform`` in its axes (N or 1, limbs, 3), m.

        Coordinates that limbs do not have, such as z in the plane, are 0.
        """
        slots = [getattr(limb, body) for limb in self.limbs]
        rows = max((np.size(v) for s in slots for v in s.values()), default=1)
        each = [{name[-1]: v for name, v in s.items()} for s in slots]
        return np.stack([np.stack([np.broadcast_to(s.get(c, 0.0), (rows,)) for c in "xyz"], axis=-1)
                         for s in each], axis=1)

    @cached_property
    def pose(self) -> Array:
        """The platform's closed pose (N, 6) x, y, z, rx, ry, rz, m and rad; nan if unknown."""
        return self.pose_of() if self.pose_of else np.full((self.time.size, 6), np.nan)

    def since(self, row: float) -> Array:
        """Return 1 from a row on until another event replaces it, otherwise 0, by joint (N, k)."""
        until = np.full(self.turning.size, np.inf) if self.until is None else self.until
        at = self.row[:, None]
        return np.where((at >= row) & ((at < until) | np.isinf(until)), 1.0, 0.0)

    def slack(self, width: Array | float) -> tuple[Array, Array]:
        """Return play's output minus u (N, k) for a full width, and d/d width.

        A negative width leads instead of lagging. nan if the order of the rows is unknown.
        """
        width = np.broadcast_to(np.asarray(width, dtype=float), self.turning.shape)
        if self.history is None:
            return np.full_like(self.travel, np.nan), np.full_like(self.travel, np.nan)
        way = np.where(width < 0.0, -1.0, 1.0)
        behind, slope = self.history.slack(0.5 * np.abs(width / self.ratio))
        turned = np.sign(self.ratio)
        return self._then(way * self.ratio * behind), self._then(0.5 * turned * slope)

    def unsettled(self, width: Array | float, start: float = 1.0) -> Array:
        """Return how far play of a full width may deviate from :meth:`slack` (N, k).

        Its state before the first row is unknown: 0 once a joint has crossed the width. ``start``:
        that state, -1 to 1 half widths off u; 1 gives the largest deviation.
        """
        width = np.broadcast_to(np.asarray(width, dtype=float), self.turning.shape)
        if self.history is None:
            return np.full_like(self.travel, np.nan)
        return np.abs(self.ratio) * self._then(
            self.history.unsettled(0.5 * np.abs(width / self.ratio), start))

    def late(self, tau: float) -> tuple[Array, Array]:
        """Return the temperature lagged by tau (N,), K, and its derivative by tau."""
        history = self.history
        if tau <= 0.0:  # no history needed
            return self.temperature, np.zeros_like(self.temperature)
        if history is None or not history.timed:
            return np.full_like(self.temperature, np.nan), np.full_like(self.temperature, np.nan)
        found, slope = history.lagged("temperature", lambda: history.temperature, tau)
        return self._then(found), self._then(slope)

    def worked(self, tau: float) -> tuple[Array, Array]:
        """Return each joint's travel per second, lagged by tau (N, k), and its d/d tau."""
        history = self.history
        if history is None or not history.timed:
            return np.full_like(self.travel, np.nan), np.full_like(self.travel, np.nan)
        found, slope = history.lagged("rate", history.rate, tau)
        return np.abs(self.ratio) * self._then(found), np.abs(self.ratio) * self._then(slope)

    @cached_property
    def move(self) -> Array:
        """How far each joint moved from the previous row (N, k), m or rad; nan if unknown."""
        if self.history is None:
            return np.full_like(self.travel, np.nan)
        return self.ratio * self._then(self.history.once("moved", self.history.moved))

    def late_load(self, tau: float) -> tuple[Array, Array]:
        """Return the actuators' load, lagged by tau (N, k), and its derivative by tau."""
        history = self.history
        if history is None or not history.timed or self.past_load_of is None:
            return np.full_like(self.travel, np.nan), np.full_like(self.travel, np.nan)
        found, slope = history.lagged(f"load {self.carried}", self.past_load_of, tau)
        return self._then(found), self._then(slope)

    def _then(self, past: Array) -> Array:
        """Return values of the history at these rows (N, ...), nan for rows not in it."""
        assert self.place is not None
        there = (self.place >= 0).reshape(-1, *[1] * (past.ndim - 1))
        return np.where(there, past[self.place], np.nan)

    def at_joints(self, change: Array, on: Bools) -> Shift:
        """Return the shift of joint coordinates u by ``change`` (N, k) on some actuators."""
        return Shift({(i, "offset"): change[:, limb.actuator]
                      for i, limb in enumerate(self.limbs) if on[limb.actuator]})

    def scaled(self, shift: Shift, factor: Array) -> Shift:
        """Return a shift of slots times ``factor`` (N, k), by the joint of each limb."""
        return Shift({(i, slot): v * factor[:, self.limbs[i].actuator]
                      for (i, slot), v in shift.slots.items()})

    def at_struts(self, per_unit: Array, on: Bools) -> Shift:
        """Return relative changes ``per_unit`` (N, k) by joint of the struts."""
        return Shift({(i, slot): value * per_unit[:, limb.actuator]
                      for i, limb in enumerate(self.limbs) if on[limb.actuator]
                      for slot, value in limb.struts.items()})

    def at_slots(self, which: str, per_unit: Array, on: Bools) -> Shift:
        """Return relative changes ``per_unit`` (N,) of the slots ``struts``, ``base``..."""
        return Shift({(i, slot): value * per_unit
                      for i, limb in enumerate(self.limbs) if on[limb.actuator]
                      for slot, value in getattr(limb, which).items()})
