"""What data showed beyond all named effects: a smooth function of one recorded input.

The function is a natural cubic spline through ``values`` at ``nodes``: linear in the values, and
known from the first node to the last; beyond them it is nan. It claims no cause. ``values`` are
uncertain by ``covariance``. Source: Kennedy & O'Hagan 2001, discrepancy of a model, with the
constraint of Plumlee 2017: what geometry and named effects could do is left to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from ppmcal.errors import BadInput, unknown
from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.inputs import (
    DIRECTION,
    LOAD,
    MOVE,
    POSE,
    TEMPERATURE,
    TRAVEL,
    VELOCITY,
)
from ppmcal.model.effects.inputs import TIME as TIME_INPUT
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    FromFile,
    KnownRange,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import COORDINATES, PLACE, Setting, Shift
from ppmcal.units import Units, to_file

MOST_NODES = 200
JOINT = "joint"
"""In the place of a pose coordinate: the term acts on the coordinate u of a joint."""
SYMMETRIC = 1e-6
"""A covariance may be off symmetry, or below zero, by this part of its largest number."""


@dataclass(frozen=True, eq=False)
class LearnedInput:
    """What a term may follow: ``value`` of each joint (N, k), or of the machine (N,), SI.

    ``quantity``: with ``joint`` and ``load``; ``needs``: columns; ``zero``: what files call SI's
    0; ``by_pose``: it is known only with the pose.
    """

    name: str
    quantity: str
    needs: tuple[str, ...]
    value: Callable[[Setting], Array]
    of_machine: bool = True
    zero: float = 0.0
    by_pose: bool = False


def _coordinate(place: int, setting: Setting) -> Array:
    return setting.pose[:, place]


INPUTS = {i.name: i for i in (
    LearnedInput("travel", "joint", (), lambda s: s.travel, of_machine=False),
    LearnedInput("velocity", "joint/s", ("vel",), lambda s: s.velocity, of_machine=False),
    LearnedInput("last move", "joint", ("order",), lambda s: s.move, of_machine=False),
    LearnedInput("load", "load", ("load",), lambda s: s.load, of_machine=False, by_pose=True),
    LearnedInput("temperature", "deg C", ("temperature",), lambda s: s.temperature, zero=20.0),
    LearnedInput("time", "s", ("time",), lambda s: s.time),
    *(LearnedInput(c, "angle" if c[0] == "r" else "length", (), partial(_coordinate, p),
                   by_pose=True) for c, p in PLACE.items()))}
FOLLOWED = {"travel": TRAVEL, "velocity": VELOCITY, "last move": MOVE,
            "load": LOAD, "temperature": TEMPERATURE,
            "time": TIME_INPUT, **dict.fromkeys(PLACE, POSE)}


@dataclass(frozen=True, eq=False)
class LearnedCurve:
    """A function of an input: spline through ``values`` (n,) at ``nodes`` (n,), SI.

    Attributes:
        input: key of :data:`INPUTS`.
        nodes, values, covariance: (n,), (n,), (n, n).
        signed: times the direction of approach (+1 or -1).
        acts: :data:`JOINT`, or the pose coordinate that it displaces, base axes.
        joint: ``length`` or ``angle``: what the joints are.
    """

    input: str
    nodes: Array
    values: Array
    covariance: Array
    signed: bool = False
    acts: str = JOINT
    joint: str = "length"

    def at(self, x: Array) -> Array:
        """Return the function (...) at inputs (...); nan outside of the nodes."""
        return np.asarray(self.basis(x) @ self.values)

    def basis(self, x: Array) -> Array:
        """Return how the function at inputs (...) follows from the values (..., n)."""
        return spline_basis(self.nodes, x)

    @cached_property
    def modes(self) -> Array:
        """Independent errors of the values, one standard deviation each (n, r)."""
        w, v = np.linalg.eigh(0.5 * (self.covariance + self.covariance.T))
        use = w > 1e-12 * max(float(w.max(initial=0.0)), 1e-300)
        return np.asarray(v[:, use] * np.sqrt(w[use]))

    @property
    def quantity(self) -> str:
        """``length`` or ``angle``: what the values are."""
        if self.acts == JOINT:
            return self.joint
        return "angle" if self.acts[0] == "r" else "length"

    @property
    def input_quantity(self) -> str:
        """The input's quantity, with the joints' own in place of ``joint`` and ``load``."""
        load = {"length": "N", "angle": "N.m"}[self.joint]
        return INPUTS[self.input].quantity.replace("joint", self.joint).replace("load", load)

    def shift(self, setting: Setting, on: Bools, values: Array) -> Shift:
        """Return the shift (N rows) of a function with other ``values`` (n,) at the nodes."""
        added = self.basis(INPUTS[self.input].value(setting)) @ values
        if self.acts != JOINT:
            pose = np.zeros((len(added), 6))
            pose[:, PLACE[self.acts]] = added
            return Shift(pose=pose)
        if added.ndim == 1:
            added = np.repeat(added[:, None], on.size, axis=1)
        return setting.at_joints(added * setting.approach if self.signed else added, on)

    def terms(self, setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
        """Du or dpose = scale f(input), times the direction where ``signed``."""
        return linear(values, {"scale": self.shift(setting, on, self.values)})

    def spread(self, setting: Setting, on: Bools, values: Mapping[str, float]) -> list[Shift]:
        """Return the shifts of its independent errors, one standard deviation each."""
        return [self.shift(setting, on, values["scale"] * mode) for mode in self.modes.T]

    def entries(self, units: Units) -> dict[str, object]:
        """Return the entries of the file."""
        source, own = INPUTS[self.input], units.factor(self.quantity)
        per = _factor(units, self.input_quantity)
        out: dict[str, object] = {"input": self.input}
        if self.signed:
            out["by"] = DIRECTION.name
        out["acts"] = self.acts
        return out | {"nodes": [to_file(v, per) + source.zero for v in self.nodes.tolist()],
                      "values": [to_file(v, own) for v in self.values.tolist()],
                      "covariance": [[to_file(v, own**2) for v in row]
                                     for row in self.covariance.tolist()]}


def spline_basis(nodes: Array, x: Array) -> Array:
    """Return the natural cubic spline's weights (..., n) of values at nodes (n,); nan outside."""
    from scipy.interpolate import CubicSpline  # reading files needs no scipy

    inside = np.isfinite(x) & (x >= nodes[0]) & (x <= nodes[-1])
    safe = np.where(inside, x, nodes[0])
    if nodes.size == 2:
        part = (safe - nodes[0]) / (nodes[1] - nodes[0])
        found = np.stack([1.0 - part, part], axis=-1)
    else:
        found = CubicSpline(nodes, np.eye(nodes.size), bc_type="natural")(safe)
    return np.asarray(np.where(inside[..., None], found, np.nan))


def learned_kind(curve: LearnedCurve) -> EffectKind:
    """Return the kind of effect that is this function."""
    source = INPUTS[curve.input]
    needs = (*source.needs, *(("dir",) if curve.signed else ()))
    motions = tuple(m for m, names in COORDINATES.items() if curve.acts in (JOINT, *names)
                    and (source.name not in PLACE or source.name in names))
    known = KnownRange(source.name, curve.input_quantity, float(curve.nodes[0]),
                       float(curve.nodes[-1]), source.zero, source.value)
    return EffectKind(
        LEARNED, "du, or a pose coordinate, = scale f(input), f a spline through values at nodes",
        "Kennedy & O'Hagan 2001; Plumlee 2017", fixed_list(SCALE), needs, curve.terms,
        per_actuator=curve.acts == JOINT, motions=motions, uses_load=source.by_pose,
        worked=WORKED, follows=FOLLOWED[curve.input], remedy="measure more rows over its range",
        from_file=FROM_FILE, written=curve.entries, variants=_never, known=known,
        spread=curve.spread, title=f"{LEARNED} from {curve.input}")


def _never(motion: str) -> Sequence[EffectKind]:
    """No search tries it: it is learned from what is left."""
    return ()


def _factor(units: Units, quantity: str) -> float:
    return 1.0 if quantity == "deg C" else units.factor(quantity)


def _from_file(given: Mapping[str, object], units: Units, joint: str) -> EffectKind:
    """Return the kind of a file's entries; see :class:`FromFile`."""
    name = given.get("input")
    if name not in INPUTS:
        raise unknown("input", name, INPUTS, "input")
    source = INPUTS[str(name)]
    acts = given.get("acts", JOINT)
    if acts not in (JOINT, *PLACE):
        raise unknown("coordinate", acts, (JOINT, *PLACE), "acts")
    by = given.get("by")
    if by not in (None, DIRECTION.name):
        raise unknown("class", by, (DIRECTION.name,), "by")
    if acts != JOINT and (by is not None or not source.of_machine):
        raise BadInput(f"a function of each joint's {DIRECTION.name if by else source.name} cannot "
                       f"act on {acts}", "acts", f"Write `acts: {JOINT}`")
    nodes = _numbers(given, "nodes", None)
    if not 2 <= nodes.size <= MOST_NODES or np.any(np.diff(nodes) <= 0.0):
        raise BadInput("the nodes do not rise from one to the next", "nodes",
                       f"Give 2 to {MOST_NODES} values of the input, in rising order")
    values = _numbers(given, "values", nodes.shape)
    covariance = _numbers(given, "covariance", (nodes.size, nodes.size))
    largest = float(np.abs(covariance).max())
    if (np.any(np.abs(covariance - covariance.T) > SYMMETRIC * largest)
            or np.linalg.eigvalsh(covariance).min() < -SYMMETRIC * largest):
        raise BadInput("this is no covariance: not symmetric, or of a negative variance",
                       "covariance", "Copy it whole, or write zeros where the values are certain")
    found = LearnedCurve(source.name, nodes, values, covariance, by is not None, str(acts), joint)
    own = units.factor(found.quantity)
    per = _factor(units, found.input_quantity)
    return learned_kind(LearnedCurve(source.name, (nodes - source.zero) * per, values * own,
                              covariance * own**2, by is not None, str(acts), joint))


def _numbers(given: Mapping[str, object], name: str, shape: tuple[int, ...] | None) -> Array:
    """Return the numbers of an entry, of a shape."""
    want = "a list of numbers" if shape is None else " by ".join(map(str, shape)) + " numbers"
    try:
        found = np.array(given.get(name), dtype=float)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    if not np.isfinite(found).all() or (found.ndim != 1 if shape is None else
                                        found.shape != shape):
        raise BadInput(f"'{name}' is not {want}", name, f"Give {want}, one for each node")
    return found


LEARNED = "learned"
SCALE = EffectParameter("scale", "1", 1.0, size=1e-3)
FROM_FILE = FromFile(("input", "by", "acts", "nodes", "values", "covariance"), _from_file)
WORKED = Worked({"scale": 1.0}, {"travel": 0.5}, 1e-5)
register(learned_kind(LearnedCurve("travel", np.array([0.0, 1.0]), np.array([0.0, 2e-5]),
                            np.zeros((2, 2)))))

__all__ = ["INPUTS", "JOINT", "LearnedCurve", "LearnedInput", "learned_kind", "spline_basis"]
