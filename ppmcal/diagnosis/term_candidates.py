"""Possible inputs and targets of a learned term, and its whitened columns, one for each node.

A term is a spline through values at nodes (:mod:`ppmcal.model.effects.learned_curve`), of one
input or of two inputs of the same joint. Each of its columns is the derivative of the residuals by
the value at one node.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.diagnosis.linear_system import System, Whitening
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import setting
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.effects import Setting, Shift
from ppmcal.model.effects.learned import INPUTS, JOINT, LearnedCurve, LearnedInput
from ppmcal.model.effects.setting import PLACE
from ppmcal.model.mechanism import Mechanism

FINE, COARSE, FEWEST = 24, 12, 3
"""Most nodes over a joint's travel (wear is local) and over other inputs; the fewest nodes."""
PAIRED = (8, 3)
"""Nodes over the first and the second input of a pair."""
SECOND = ("velocity", "last move", "load", "temperature")
"""Second inputs of a function of a joint's travel, and of a function of an earlier one of these."""
PER_NODE = 3
"""Rows per node required on average."""
MARGIN = 0.005
"""The first and the last node are beyond the data by this part of their range."""
BEYOND = 30.0
"""A pose coordinate is an input if its range is this multiple of the residuals."""
TWIN = 0.9999
"""Of two columns with at least this cosine in the rows only one is tried."""
SEEN_BETTER = 1e-6
"""Relative difference in visibility that exceeds round-off."""
PASSING = ("time",)
"""Inputs that no later command can have: effects of them are reported, but not learned."""


@dataclass(frozen=True, eq=False)
class Visible:
    """Rows with a fit's whitened residual, and its part beyond geometry and named effects.

    ``basis`` (n, r): of geometry and effects; ``left`` (n,): the residual orthogonal to it.
    """

    system: System
    noise: Whitening
    basis: Array
    left: Array

    @property
    def freedom(self) -> int:
        """Degrees of freedom: values less fitted parameters."""
        return max(self.system.count - int(self.basis.shape[1]), 1)

    @cached_property
    def residual_coordinates(self) -> frozenset[str]:
        """Coordinates of the predicted pose that hardly vary except by the errors.

        If all touches have one height, the predicted z is that height minus the residual: a
        function of it explains every residual, even of unseen rows, and nothing else.
        """
        units = np.concatenate([u.reshape(-1, 6) for u in self.by_place])
        size = float(np.sqrt(np.mean(self.left**2)))
        found = set()
        for c in self.system.problem.mechanism.coordinates:
            place = slice(0, 3) if PLACE[c] < 3 else slice(3, 6)
            felt = float(np.sqrt(np.max(np.mean(units[:, place]**2, axis=0))))
            values = [INPUTS[c].value(p.setting) for p in self.system.parts]
            if float(np.ptp(np.concatenate(values))) * felt < BEYOND * size:
                found.add(c)
        return frozenset(found)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Coordinates of the pose that rows observe directly.

        A flat shows the platform's position along it only through its own tilt, as a small part of
        the height: millimetres along the flat appear as micrometres across it.
        """
        every = self.system.problem.mechanism.coordinates
        found = [np.zeros(6, dtype=bool), *(_by_itself(u.reshape(-1, 6)) for u in self.by_place)]
        return tuple(c for c in every if np.any(found, axis=0)[PLACE[c]])

    @cached_property
    def by_joint(self) -> list[Array]:
        """Columns (N, m, k) of one unit of each joint coordinate, by part of the system."""
        return [_units(p.column, p.of_joints) for p in self.system.parts]

    @cached_property
    def by_place(self) -> list[Array]:
        """The same for one unit of each pose coordinate (N, m, 6)."""
        return [_units(p.column, [Shift(pose=np.tile(np.eye(6)[c], (len(p.response.pose), 1)))
                                  for c in range(6)]) for p in self.system.parts]


def _by_itself(units: Array) -> Bools:
    """Return which coordinates are observed, and not just as a part of a better observed one (6,).

    ``units`` (n, 6): columns of one unit of each coordinate.
    """
    size = np.linalg.norm(units, axis=0)
    unit = units / np.where(size > 0.0, size, 1.0)
    cosine = np.abs(unit.T @ unit)
    kind = np.arange(6) // 3
    better = (kind[:, None] == kind) & (size[:, None] < (1.0 - SEEN_BETTER) * size)
    return np.asarray((size > 0.0) & ~np.any(better & (cosine > TWIN), axis=1))


def _units(column: Callable[[Shift], Array], shifts: Sequence[Shift]) -> Array:
    return np.stack([column(s) for s in shifts], axis=-1)


def all_settings(fit: Fit) -> list[Setting]:
    """Return the inputs of effects in all rows that have a pose, used or not."""
    problem, out = fit.problem, []
    for i, rows in enumerate(problem.environments):
        for q, pose in problem.ends(i, fit.state):
            good = finite_rows(pose) & finite_rows(q)
            model = Model(problem.mechanism, fit.state.g)
            out.append(setting(model, rows.take(good), q[good], pose[good]))
    return out


def _varies(values: Array) -> Bools:
    """Return which columns (N, p) vary by more than round-off."""
    return np.asarray(np.ptp(values, axis=0) > 1e-9 * np.max(np.abs(values), axis=0))


def forms(seen: Visible, everywhere: Sequence[Setting]
          ) -> Iterator[tuple[LearnedCurve, tuple[bool, ...]]]:
    """Yield curves in each recorded input, and the actuators that they act on.

    ``everywhere``: all rows that the nodes have to cover.
    """
    mechanism = seen.system.problem.mechanism
    k, groups = len(mechanism.actuators), joint_groups(mechanism)
    here = [p.setting for p in seen.system.parts]
    sided = all(np.isfinite(s.approach).all() for s in here) and any(
        _varies(s.approach).any() for s in here)
    for source in INPUTS.values():
        if source.name in PASSING or not _recorded(source, here, mechanism.coordinates):
            continue
        if source.name in seen.residual_coordinates:
            continue
        for on in groups:
            joint = mechanism.actuator_quantity[on.index(True)]
            curve = _curve(source, here, everywhere, on, joint)
            if curve is None or source.name in PLACE:
                continue
            yield curve, on
            if sided and not source.of_machine:
                yield replace(curve, signed=True), on
            yield from ((c, on) for c in _pairs(curve, here, everywhere, on))
        if source.of_machine:
            curve = _curve(source, here, everywhere, (True,) * k, "length")
            for acts in seen.coordinates if curve is not None else ():
                assert curve is not None
                yield replace(curve, acts=acts), (True,) * k


def _pairs(curve: LearnedCurve, here: Sequence[Setting], everywhere: Sequence[Setting],
           on: tuple[bool, ...]) -> Iterator[LearnedCurve]:
    """Yield the functions of an input and a second one, if there are enough rows."""
    order = ("travel", *SECOND)
    later = order[order.index(curve.input) + 1:] if curve.input in order else ()
    for name in later:
        source = INPUTS[name]
        other = _curve(source, here, everywhere, on, curve.joint) if _recorded(
            source, here, ()) else None
        rows = sum(s.time.size for s in here) * sum(on)
        if other is None or min(curve.nodes.size, rows // (PER_NODE * PAIRED[1])) < PAIRED[0]:
            continue
        nodes, by = (np.linspace(c.nodes[0], c.nodes[-1], n) for c, n in zip(
            (curve, other), PAIRED, strict=True))
        yield replace(curve, nodes=nodes, by=name, by_nodes=by, values=np.zeros(
            nodes.size * by.size), covariance=np.zeros((nodes.size * by.size,) * 2))


def _recorded(source: LearnedInput, here: Sequence[Setting], coordinates: Sequence[str]) -> bool:
    if source.name in PLACE and source.name not in coordinates:
        return False
    return all(np.isfinite(source.value(s)).all() for s in here)


def _curve(source: LearnedInput, here: Sequence[Setting], everywhere: Sequence[Setting],
           on: tuple[bool, ...], joint: str) -> LearnedCurve | None:
    """Return a curve over the range of an input, None if that has too few values."""
    def values(rows: Sequence[Setting]) -> Array:
        x = np.concatenate([source.value(s) for s in rows])
        x = x if x.ndim == 1 else x[:, np.array(on)].ravel()
        return np.asarray(x[np.isfinite(x)])

    most = FINE if source.name in ("travel", "last move") else COARSE
    nodes = nodes_over(values(here), values(everywhere), most)
    return None if nodes is None else LearnedCurve(
        source.name, nodes, np.zeros(nodes.size), np.zeros((nodes.size,) * 2), joint=joint)


def nodes_over(used: Array, whole: Array, most: int, fewest: int = FEWEST,
               margin: float = MARGIN) -> Array | None:
    """Return nodes (K,) over the range of an input, None if it has too few values.

    ``used``: its values in the rows in use; ``whole``: in all rows to be covered; ``margin``: part
    of the range by which the nodes extend beyond it.
    """
    width = float(np.ptp(whole))
    if not width > 1e-9 * float(np.abs(whole).max()):
        return None
    different = np.unique(np.round((used - whole.min()) / width, 6)).size
    count = min(most, different, used.size // PER_NODE)
    if count < fewest:
        return None
    return np.linspace(float(whole.min()) - margin * width, float(whole.max()) + margin * width,
                       count)


def joint_groups(mechanism: Mechanism) -> list[tuple[bool, ...]]:
    """Return sets of joints (k,) that act alike: each alone, and all if of one quantity."""
    k = len(mechanism.actuators)
    each = [tuple(a == b for b in range(k)) for a in range(k)]
    return each + ([(True,) * k] if k > 1 and len(set(mechanism.actuator_quantity)) == 1 else [])


def columns_of(seen: Visible, curve: LearnedCurve, on: Sequence[bool]) -> Array:
    """Return the whitened columns of a curve's values at its nodes (n, K)."""
    return columns_from(seen, curve.acts, on, [
        curve.weights(p.setting) for p in seen.system.parts])


def columns_from(seen: Visible, acts: str, on: Sequence[bool], weights: Sequence[Array]
                 ) -> Array:
    """Return the whitened columns (n, K) of functions that act like a curve.

    ``acts``: on a coordinate of the pose, or on the joints ``on``. ``weights``: the functions for
    the machine (N, K), or by joint (N, k, K), by part of the system.
    """
    system, columns = seen.system, []
    for i, (part, weight) in enumerate(zip(system.parts, weights, strict=True)):
        out = np.zeros((*system.residual.shape, weight.shape[-1]))
        columns.append(out)
        if acts != JOINT:
            unit = seen.by_place[i][..., PLACE[acts]]
            out[part.at, :unit.shape[1]] += unit[..., None] * weight[:, None, :]
            continue
        for a in np.flatnonzero(on):
            own = weight if weight.ndim == 2 else weight[:, a]
            unit = seen.by_joint[i][..., a]
            out[part.at, :unit.shape[1]] += unit[..., None] * own[:, None, :]
    return seen.noise.apply(sum(columns[1:], columns[0]), system)
