"""Readings of encoders at the joints of closed limbs, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Closure
from ppmcal.kinematics.limb_groups import slot_columns
from ppmcal.linalg import Array
from ppmcal.model.limbs import ClosureSurface
from ppmcal.model.limbs.axis_offset import offset_slot
from ppmcal.model.limbs.chain import Chain, U, Values
from ppmcal.model.limbs.kind import LimbKind
from ppmcal.model.limbs.passive_joints import EncoderJoint, joints_of


@dataclass(frozen=True, eq=False)
class JointReading:
    """The joint ``at`` (``leg1.joint2``) of N rows with joints locked at ``closure.q``.

    ``pose``: closed platform motors (N, 8).
    """

    closure: Closure
    pose: Array
    at: str

    @cached_property
    def limb(self) -> int:
        """Index of the limb."""
        names = [limb.name for limb in self.closure.model.mechanism.limbs]
        return names.index(self.at.rpartition(".")[0])

    @property
    def _kind(self) -> LimbKind:
        return self.closure.model.mechanism.limbs[self.limb].kind

    @property
    def _joint(self) -> EncoderJoint:
        return joints_of(self._kind)[self.at.rpartition(".")[2]]

    @cached_property
    def _values(self) -> Values:
        model = self.closure.model
        return {**model.limb_values[self.limb], U: model.joint_coordinate(self.limb,
                                                                          self.closure.q)}

    @property
    def value(self) -> Array:
        """Reading without an offset (N,), rad or m."""
        return self._read[0]

    @cached_property
    def by_pose(self) -> Array:
        """Derivative by the platform's displacement and rotation (N, 6), base axes."""
        line = self._read[1]
        direction, moment = line[:, :3], line[:, 3:]
        return np.concatenate([direction, moment - np.cross(cga.translation(self.pose), direction)],
                              axis=-1)

    def _chains(self) -> tuple[Chain, Values]:
        """Return the base's chain up to the joint, and values for it.

        For a universal joint up to its state before it turns, where its first axis' angle is 0.
        """
        base, values = self._kind.base, self._values
        if self._joint.read is None or offset_slot(base) is None:
            return base, values
        return Chain(base.steps[:-1]), {**values, base.steps[-1].needs: 0.0}

    @cached_property
    def _read(self) -> tuple[Array, Array, Array]:
        n, read = len(self.pose), self._joint.read
        if read is None:
            nothing = np.zeros((n, 6))
            return np.broadcast_to(np.asarray(self._values[U]), (n,)), nothing, nothing
        base, values = self._chains()
        ends = [np.broadcast_to(chain.evaluate(values, ())[0], (n, 8))
                for chain in (base, self._kind.middle)]
        held = cga.compose(self.pose, self._kind.platform.evaluate(self._all, ())[0])
        value, line, own = read(ends[0], ends[1], held)
        return value, np.broadcast_to(line, (n, 6)), np.broadcast_to(own, (n, 6))

    @cached_property
    def _all(self) -> Values:
        return {**self._values, **self._kind.turn(self._values, self.pose)}

    def by_slots(self, slots: Sequence[str]) -> Array:
        """Return the derivative by slots of its limb (N, S) with the platform at rest.

        ``offset`` and ``ratio`` count as the drive's u.
        """
        names = [U if s in ("offset", "ratio") else s for s in slots]
        if self._joint.read is None:
            return np.broadcast_to([float(name == U) for name in names],
                                   (len(self.pose), len(names)))
        base, values = self._chains()
        body = self._kind.evaluate(self._values, names, self.pose)
        own = ClosureSurface(
            body.fixed, body.moving, body.scale, body.radius, body.point_moves,
            self._read[2][:, None], base.evaluate(values, names)[1], body.middle, body.platform)
        return np.asarray(slot_columns(own, self._read[1][:, None], self.pose, names)[:, 0])

    def by_parameters(self, columns: Sequence[int], names: Sequence[str]) -> Array:
        """Return the derivative by parameters (N, P) that feed these slots of the limb."""
        model, q = self.closure.model, self.closure.q
        limb = model.mechanism.limbs[self.limb]
        raw = np.array(self.by_slots(names))
        if "ratio" in names:
            raw[:, list(names).index("ratio")] *= q[:, limb.actuator]
        return np.asarray(raw @ limb.slots.jacobian(model.parameters, names, columns))

    @cached_property
    def by_joint(self) -> Array:
        """Derivative by joint values (N, k) with the platform at rest, per unit of q."""
        limb = self.closure.model.mechanism.limbs[self.limb]
        out = np.zeros_like(self.closure.q)
        out[:, limb.actuator] = self.by_slots((U,))[:, 0] * self._values.get("ratio", 1.0)
        return out
