"""Which errors an analysis looks at: the file's free ones, or every joint frame's components.

[LIN] section 2.5 gives each of a leg's three joint frames six error components and the
platform point its three: 21 per leg, 126 for six legs, also those that the closure cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import SlotSpec
from ppmcal.model.mechanism import Limb, Mechanism
from ppmcal.model.parameters import RATIO, Parameter, SlotMap

PLATFORM_POINT = "platform.point"
PART_OF_REACH = 1e-3
ANGLE = 1e-3


@dataclass(frozen=True)
class Source:
    """One error: its parameter index, and the limbs and the slot group that it belongs to.

    ``limb``: a limb's name, or ``shared``; ``group``: ``base.point``, ``joint2``, ``length``;
    ``kind``: of the limb; ``tolerance_class``: ``point``, ``length``, ``angle``, ``offset``.
    """

    parameter: int
    limb: str
    group: str
    kind: str
    tolerance_class: str


def geometry_only(mechanism: Mechanism) -> Mechanism:
    """Return the machine without effects, as they stand or as they may be fitted."""
    return replace(mechanism, effects=())


def sources(mechanism: Mechanism) -> tuple[Source, ...]:
    """Return the free errors of the geometry, in parameter order; effects are none."""
    fed: dict[int, list[tuple[Limb, str]]] = {}
    for limb in mechanism.limbs:
        for slot, p in limb.slots.direct:
            fed.setdefault(p, []).append((limb, slot))
        for x, _, r, a in limb.slots.polar:
            fed.setdefault(r, []).append((limb, x))
            fed.setdefault(a, []).append((limb, x))
    out = []
    for p in mechanism.free:
        if p not in fed:
            continue
        limbs = {limb.name: limb for limb, _ in fed[p]}
        groups = dict.fromkeys(group_of(slot) for _, slot in fed[p])
        kinds = dict.fromkeys(limb.kind.name for limb in limbs.values())
        out.append(Source(p, next(iter(limbs)) if len(limbs) == 1 else "shared",
                          " + ".join(groups), " + ".join(kinds),
                          mechanism.parameters[p].tolerance_class))
    return tuple(out)


def group_of(slot: str) -> str:
    """Return the slot without its component.

    >>> group_of("base.point.x"), group_of("joint2.rz"), group_of("length")
    ('base.point', 'joint2', 'length')
    """
    head, _, tail = slot.rpartition(".")
    return head if head and tail in ("x", "y", "z", "rx", "ry", "rz") else slot


def all_components(mechanism: Mechanism) -> Mechanism:
    """Return the machine with every joint frame's components and platform points free.

    Each slot of each limb becomes a parameter of its own at its present value, so that what
    limbs share, or give by radius and angle, is taken apart. Tolerances are the slot's own, else
    those of its class in the file, else a thousandth of the reach, or 1e-3 rad.
    """
    made: list[Parameter] = []
    free: list[int] = []
    limbs = []
    for limb in mechanism.limbs:
        now = limb.slots.values(mechanism.values)
        nominal = limb.slots.values(mechanism.nominals)
        own = dict(limb.slots.direct)
        direct = []
        for spec in (*limb.kind.slots, *limb.kind.joint_slots):
            if spec.name not in now and (spec.name == RATIO or spec.needs):
                continue
            asked = spec in limb.kind.joint_slots or group_of(spec.name) == PLATFORM_POINT
            p = own.get(spec.name)
            known = None if p is None else mechanism.parameters[p].tolerance
            if asked:
                known = (None if p is None else mechanism.parameters[p].prior_sigma) or _of_class(
                    mechanism, spec)
            value = now.get(spec.name, spec.default or 0.0)
            direct.append((spec.name, len(made)))
            free += [len(made)] if asked else []
            made.append(Parameter(f"{limb.name}.{spec.name}", spec.quantity, value,
                                  nominal.get(spec.name, value), known, not asked,
                                  spec.tolerance_class))
        limbs.append(replace(limb, slots=SlotMap(tuple(direct))))
    return replace(mechanism, limbs=tuple(limbs), parameters=tuple(made), free=tuple(free),
                   free_patterns=None, effects=())


def _of_class(mechanism: Mechanism, spec: SlotSpec) -> float:
    """Return the tolerance of a slot's class, or the default where it is none to draw from."""
    given = mechanism.class_tolerance(spec.tolerance_class, spec.quantity)
    if given is not None and 0.0 < given < np.inf:
        return given
    return PART_OF_REACH * mechanism.reach if spec.quantity == "length" else ANGLE


def tolerances(mechanism: Mechanism, found: Sequence[Source]) -> Array:
    """Return one standard deviation of each error (S,), SI; 0 where there is none."""
    return np.array([mechanism.parameters[s.parameter].prior_sigma or 0.0 for s in found])


def natural_units(mechanism: Mechanism, found: Sequence[Source], metric: float) -> Array:
    """Return how large an error of each kind counts like an error of 1 m (S,).

    Lengths 1; angles 1/metric; ratios of drives what moves the joint by that much at the largest
    joint value of home or limits.
    """
    out = np.ones(len(found))
    for i, s in enumerate(found):
        p = mechanism.parameters[s.parameter]
        if p.quantity != "length":
            out[i] /= metric
        if p.per_unit:
            out[i] /= _largest_joint(mechanism, s.parameter)
    return out


def _largest_joint(mechanism: Mechanism, parameter: int) -> float:
    """Return the largest joint value of the drives that a ratio belongs to, unit of q."""
    q = home_state(mechanism).q
    ends = np.where(np.isfinite(mechanism.limits), mechanism.limits, q[:, None])
    mine = [limb.actuator for limb in mechanism.limbs
            if any(p == parameter for _, p in limb.slots.direct)]
    largest = float(np.abs(np.concatenate([ends[mine].ravel(), q[mine]])).max())
    return largest if largest > 0.0 else 1.0
