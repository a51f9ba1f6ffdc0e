"""How the predictions of rows move along shifts of any kind."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.observation import ResidualJacobian
from ppmcal.kinematics.closure import Closure
from ppmcal.kinematics.effect_response import effect_terms, setting
from ppmcal.linalg import Array
from ppmcal.model.dataset import Environment
from ppmcal.model.effects import Setting, Shift


@dataclass(frozen=True, eq=False)
class Response:
    """How the predictions of n rows move along shifts of any kind.

    ``by_equation`` (n, m, d) is d prediction/d closure equation at closed poses ``pose`` (n, 8),
    which are number ``end`` of those seen.
    """

    closure: Closure
    pose: Array
    lines: Array
    by_equation: Array
    seen: ResidualJacobian
    rows: Environment
    end: int = 0

    @cached_property
    def _by_slot(self) -> dict[tuple[int, str], Array]:
        return {}

    def by_slot(self, limb: int, slot: str) -> Array:
        """Return d prediction/d slot (n, m)."""
        if (limb, slot) not in self._by_slot:
            block = self.closure.slot_matrix(self.pose, limb, (slot,), self.lines)
            self._by_slot[limb, slot] = (self.by_equation @ block)[..., 0]
        return self._by_slot[limb, slot]

    def column(self, shift: Shift) -> Array:
        """Return how predictions (n, m) move along a shift."""
        out = np.zeros(self.seen.residual.shape)
        for (limb, slot), change in shift.slots.items():
            out += self.by_slot(limb, slot) * np.broadcast_to(change, (len(out),))[:, None]
        if shift.pose is not None:
            out += (self.seen.by_poses[self.end] @ shift.pose[..., None])[..., 0]
        for twist in self._of_instrument(shift):
            out += (self.seen.by_poses[self.end] @ twist[..., None])[..., 0]
        if shift.stretch is not None:
            moved = shift.stretch @ self.seen.points[self.end][..., None]
            out += (self.seen.by_points[self.end] @ moved)[..., 0]
        return out

    def _of_instrument(self, shift: Shift) -> Iterator[Array]:
        """Yield the platform twists (n, 6), base axes, that look like a moved frame or target."""
        if shift.frame is not None:
            step, turn = shift.frame[:, :3], shift.frame[:, 3:]
            yield np.concatenate([step + np.cross(turn, cga.translation(self.pose)), turn], axis=1)
        if shift.target is not None:
            own = cga.rotation_matrix(self.pose)
            yield np.concatenate([(own @ shift.target[:, part, None])[..., 0]
                                  for part in (slice(0, 3), slice(3, 6))], axis=1)

    def setting(self) -> Setting:
        """Return what effects may know of these rows."""
        model = self.closure.model
        return setting(replace(model, shift=None), self.rows, self.closure.q, self.pose, model)

    def effect_columns(self, out: Array, free: Sequence[int]) -> None:
        """Fill the columns of free effect parameters (n, m, C), in place.

        The change of an actuator's load with the pose is left out: it is smaller by deflection
        over reach, and only the step, not the minimum, depends on it.
        """
        model = self.closure.model
        if not model.mechanism.effects:
            return
        place = {p: c for c, p in enumerate(free)}
        for effect, terms in effect_terms(model.mechanism, model.parameters, self.setting()):
            for name, p in effect.parameters.items():
                if p in place:
                    out[..., place[p]] += self.column(terms.by[name])
