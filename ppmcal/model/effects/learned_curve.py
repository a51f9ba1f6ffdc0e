"""Learned discrepancy beyond all named effects: a smooth function of one or two recorded inputs.

The function is a natural cubic spline through ``values`` at ``nodes``, for two inputs a product of
splines at ``nodes`` x ``by_nodes``: linear in the values, and known from the first node to the
last; nan beyond. It claims no cause. ``covariance``: uncertainty of ``values``. Source: Kennedy &
O'Hagan 2001, model discrepancy, with the constraint of Plumlee 2017: the part that geometry and
named effects can absorb is left to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from ppmcal import linalg
from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.inputs import DIRECTION
from ppmcal.model.effects.kind import KnownRange, Terms, linear
from ppmcal.model.effects.setting import PLACE, Setting, Shift
from ppmcal.units import Units, to_file

JOINT = "joint"
"""In place of a pose coordinate: the term acts on the coordinate u of a joint."""


@dataclass(frozen=True, eq=False)
class LearnedInput:
    """A possible input: ``value`` of each joint (N, k), or of the machine (N,), SI.

    ``quantity``: with ``joint`` and ``load``; ``needs``: columns; ``zero``: the value in files that
    is 0 in SI; ``by_pose``: it is known only with the pose.
    """

    name: str
    quantity: str
    needs: tuple[str, ...]
    value: Callable[[Setting], Array]
    of_machine: bool = True
    zero: float = 0.0
    by_pose: bool = False

    @property
    def variable(self) -> str:
        """Its name in :class:`Setting`: ``travel``, ``move``, ``pose.x``."""
        return f"pose.{self.name}" if self.name in PLACE else self.name.removeprefix("last ")


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


@dataclass(frozen=True, eq=False)
class LearnedCurve:
    """A function of an input: spline through ``values`` (n,) at ``nodes`` (n,), SI.

    Attributes:
        input: key of :data:`INPUTS`.
        nodes, values, covariance: (n,), (n,), (n, n); with a second input of m nodes the values
            are (n m,), those of the first node first.
        signed: multiplied by the direction of approach (+1 or -1).
        acts: :data:`JOINT`, or the pose coordinate that it displaces, base axes.
        joint: ``length`` or ``angle``: quantity of the joints.
        by: a second input, empty for none; by_nodes (m,): its nodes.
    """

    input: str
    nodes: Array
    values: Array
    covariance: Array
    signed: bool = False
    acts: str = JOINT
    joint: str = "length"
    by: str = ""
    by_nodes: Array = field(default_factory=lambda: np.zeros(1))

    def at(self, x: Array, by: Array | None = None) -> Array:
        """Return the function (...) at inputs (...), with second ones ``by``; nan outside nodes."""
        return np.asarray(self.basis(x, by) @ self.values)

    def basis(self, x: Array, by: Array | None = None) -> Array:
        """Return the weights of the values in the function at inputs (...), (..., n or n m)."""
        own = spline_basis(self.nodes, x)
        if not self.by:
            return own
        assert by is not None
        other = spline_basis(self.by_nodes, by)
        whole = own[..., :, None] * other[..., None, :]
        return whole.reshape(*whole.shape[:-2], -1)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The input, and the second one if there is one."""
        return (self.input, self.by) if self.by else (self.input,)

    def seen(self, setting: Setting) -> tuple[Array, ...]:
        """Return its inputs in N rows, of each joint (N, k) or the machine (N,), in one shape."""
        return alike([INPUTS[name].value(setting) for name in self.inputs])

    def weights(self, setting: Setting) -> Array:
        """Return the weights of the values in N rows: (N, K), or by joint (N, k, K)."""
        found = self.basis(*self.seen(setting))
        if not self.signed:
            return found
        found = found if found.ndim == 3 else found[:, None]
        return np.asarray(found * setting.approach[..., None])

    @cached_property
    def modes(self) -> Array:
        """Independent errors of the values, one standard deviation each (n, r)."""
        w, v = linalg.eigh(0.5 * (self.covariance + self.covariance.T))
        use = w > 1e-12 * max(float(w.max(initial=0.0)), 1e-300)
        return np.asarray(v[:, use] * np.sqrt(w[use]))

    @property
    def quantity(self) -> str:
        """``length`` or ``angle``: quantity of the values."""
        if self.acts == JOINT:
            return self.joint
        return "angle" if self.acts[0] == "r" else "length"

    @property
    def input_quantity(self) -> str:
        """The input's quantity, with the joints' own in place of ``joint`` and ``load``."""
        return self.quantity_of(self.input)

    def quantity_of(self, name: str) -> str:
        """Return the same for any input."""
        load = {"length": "N", "angle": "N.m"}[self.joint]
        return INPUTS[name].quantity.replace("joint", self.joint).replace("load", load)

    def shift(self, setting: Setting, on: Bools, values: Array) -> Shift:
        """Return the shift (N rows) of a function with other ``values`` at the nodes."""
        added = self.weights(setting) @ values
        if self.acts != JOINT:
            pose = np.zeros((len(added), 6))
            pose[:, PLACE[self.acts]] = added
            return Shift(pose=pose)
        if added.ndim == 1:
            added = np.repeat(added[:, None], on.size, axis=1)
        return setting.at_joints(added, on)

    def terms(self, setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
        """Du or dpose = scale f(input), times the direction where ``signed``."""
        return linear(values, {"scale": self.shift(setting, on, self.values)})

    def spread(self, setting: Setting, on: Bools, values: Mapping[str, float]) -> list[Shift]:
        """Return the shifts of its independent errors, one standard deviation each."""
        return [self.shift(setting, on, values["scale"] * mode) for mode in self.modes.T]

    @property
    def known(self) -> tuple[KnownRange, ...]:
        """The range in which it is known, by input."""
        ends = {self.input: self.nodes, **({self.by: self.by_nodes} if self.by else {})}
        return tuple(KnownRange(name, self.quantity_of(name), float(x[0]), float(x[-1]),
                                INPUTS[name].zero, INPUTS[name].value)
                     for name, x in ends.items())

    def entries(self, units: Units) -> dict[str, object]:
        """Return the entries of the file."""
        own = units.factor(self.quantity)
        out: dict[str, object] = {"input": self.input}
        if self.signed:
            out["by"] = DIRECTION.name
        if self.by:
            out |= {"by": self.by, "by_nodes": self._nodes(self.by, self.by_nodes, units)}
        values = [to_file(v, own) for v in self.values.tolist()]
        m = self.by_nodes.size
        return out | {"acts": self.acts, "nodes": self._nodes(self.input, self.nodes, units),
                      "values": [values[i:i + m] for i in range(0, len(values), m)]
                      if self.by else values,
                      "covariance": [[to_file(v, own**2) for v in row]
                                     for row in self.covariance.tolist()]}

    def _nodes(self, name: str, nodes: Array, units: Units) -> list[float]:
        per = si_factor(units, self.quantity_of(name))
        return [to_file(v, per) + INPUTS[name].zero for v in nodes.tolist()]


def alike(inputs: Sequence[Array]) -> tuple[Array, ...]:
    """Return inputs in N rows, each of the machine (N,) or joints (N, k), in one shape."""
    wide = max(x.ndim for x in inputs)
    return tuple(np.broadcast_arrays(*(x[:, None] if x.ndim < wide else x for x in inputs)))


def spline_basis(nodes: Array, x: Array) -> Array:
    """Return the natural cubic spline's weights (..., n) of values at nodes (n,); nan outside."""
    from scipy.interpolate import CubicSpline  # reading files does not need SciPy

    inside = np.isfinite(x) & (x >= nodes[0]) & (x <= nodes[-1])
    safe = np.where(inside, x, nodes[0])
    if nodes.size == 2:
        part = (safe - nodes[0]) / (nodes[1] - nodes[0])
        found = np.stack([1.0 - part, part], axis=-1)
    else:
        found = CubicSpline(nodes, np.eye(nodes.size), bc_type="natural")(safe)
    return np.asarray(np.where(inside[..., None], found, np.nan))


def si_factor(units: Units, quantity: str) -> float:
    """Return the SI value of a file unit; temperatures stay in kelvin."""
    return 1.0 if quantity == "deg C" else units.factor(quantity)
