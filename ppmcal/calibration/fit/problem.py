"""Whitened residuals and their Jacobian for a machine, its registrations and the data.

Columns: the free geometry parameters, then the nuisance parameters of each data set (frame,
target, target rotation, homing). Rows are produced in chunks of poses, which bounds memory
however many there are:

    d prediction = by_pose . dpose,    dpose = -A^-1 (Bg dg + Jq dh),

one small inverse per pose and one outer product per leg ([LIN] section 2.5).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.calibration.fit.instrument_tables import Sighting
from ppmcal.calibration.fit.nuisance_columns import NuisanceColumns, lay_out
from ppmcal.calibration.fit.observation import gap_noise, joint_noise, white_measurements
from ppmcal.calibration.fit.poses_from_home import PosesFromHome
from ppmcal.calibration.fit.prior_information import PriorInformation
from ppmcal.calibration.fit.raw_rows import RawRows, RowMaker
from ppmcal.calibration.fit.registration import no_pose, start_registration, unscaled
from ppmcal.calibration.fit.response import RowsAtRest
from ppmcal.calibration.fit.unknown_directions import direction_sigma
from ppmcal.calibration.fit.white_rows import Rows, white_rows
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import environment_of, shifted
from ppmcal.kinematics.equilibrium import reached_poses, settle
from ppmcal.kinematics.forward import Minima
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.dataset import Dataset, Environment, unknown_environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.model.sessions import companions

CHUNK, LONG_CHUNK = 2048, 16384
"""Rows per chunk, with effects and without; without them compiled loops need little memory."""
PIECE = 65536
"""Data sets larger than this are not prepared whole for the compiled loops."""


@dataclass(frozen=True)
class State:
    """Where the fit stands: parameters (P,), one registration per data set, poses (N, 8) each.

    For distances between two platform positions a row holds both poses (N, 16).
    """

    g: Array
    registrations: tuple[Registration, ...]
    poses: tuple[Array, ...]


def white_squares(problem: Problem, state: State, keep: Sequence[Bools]) -> tuple[float, float]:
    """Return the sum of white squares over rows (N,) of each data set, and the number of values."""
    each = [rows.squares() for rows in problem.rows(state, False, keep)]
    return sum(square for square, _ in each), sum(count for _, count in each)


def squares_by_noise_of(one: tuple[Problem, State], other: tuple[Problem, State],
                        keep: Sequence[Bools]) -> float:
    """Return the sum of white squares of ``one`` state, its rows weighted as at the ``other``.

    Geometry and registration carry the joint noise to the measured point, so the noise depends on
    the state: residuals of two fits are comparable only if both are whitened by the same noise.

    Args:
        one: whose residuals count; same data sets as the other's, whatever they leave open.
        other: the state at which they are whitened.
        keep: rows (N,) by data set that have a pose in both.
    """
    (problem, state), (by, at) = one, other
    pairs = zip(problem.rows(state, False, keep), by.rows(at, False, keep), strict=True)
    return sum(float(np.sum(noise.whitened(r.raw, [c.raw for c in r.companions])**2))
               for r, noise in pairs)


@dataclass(frozen=True, eq=False)
class Problem:
    """A machine and its measurements.

    ``free`` are parameter indices (F,); ``pivots`` the points about which frames are turned,
    one (3,) per data set, by default its centroid; ``given`` their environments, by default
    from their columns; ``earlier``: prior information from earlier measurements; ``home``: poses
    that this problem, or one it derives from, reached from home; ``at_rest``: its closed rows,
    for fits in which only frames and targets move.
    """

    mechanism: Mechanism
    datasets: tuple[Dataset, ...]
    free: tuple[int, ...]
    pivots: tuple[Array, ...] | None = None
    given: tuple[Environment, ...] | None = None
    earlier: PriorInformation | None = None
    home: PosesFromHome = field(default_factory=PosesFromHome)
    at_rest: RowsAtRest = field(default_factory=RowsAtRest)

    def alone(self, data: Dataset) -> Problem:
        """Return the problem of one data set by itself, with a frame of its own."""
        return self.afresh(datasets=(data.alone(),))

    def afresh(self, **fields: Any) -> Problem:
        """Return the problem with other fields, and nothing known from those it had."""
        return replace(self, pivots=None, given=None, earlier=None, **fields)

    def changed(self, **fields: Any) -> Problem:
        """Return the problem with other fields, its frames turned about the same points."""
        return replace(self, pivots=tuple(o.about for o in self.opens), **fields)

    def weighted(self, weights: Sequence[Array] | None) -> Problem:
        """Return the problem with weights for the rows (N,) of its data sets; None: all equal."""
        given = [None] * len(self.datasets) if weights is None else [
            None if np.all(w == 1.0) else w for w in weights]
        out = replace(self, datasets=tuple(
            d if w is d.weight else replace(d, weight=w)
            for d, w in zip(self.datasets, given, strict=True)))
        if "environments" in self.__dict__:   # independent of row weights
            out.__dict__["environments"] = self.environments
        return out

    @property
    def weights(self) -> list[Array]:
        """The weights of rows, by data set (N,)."""
        return [np.ones(len(d)) if d.weight is None else d.weight for d in self.datasets]

    def values(self, index: int, rows: Ints, each: Ints) -> float:
        """Return the weighted number of values in some rows (n,), ``each`` (n,) values per row."""
        weight = self.datasets[index].weight
        return int(each.sum()) if weight is None else float(weight[rows] @ each)

    @cached_property
    def _layout(self) -> tuple[tuple[NuisanceColumns, ...], tuple[str, ...]]:
        return lay_out(self.mechanism, self.datasets, self.free, self.pivots)

    @property
    def blind(self) -> bool:
        """Whether all data are joint values alone."""
        return all(d.kind.blind for d in self.datasets)

    @property
    def opens(self) -> tuple[NuisanceColumns, ...]:
        """Column layout of each data set's nuisance parameters."""
        return self._layout[0]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns: parameters, then ``frame.x of NAME`` and the like (C,)."""
        return self._layout[1]

    @cached_property
    def environments(self) -> tuple[Environment, ...]:
        """The variables that effects depend on, by data set."""
        return self.given or tuple(environment_of(self.mechanism, d) for d in self.datasets)

    @cached_property
    def sigma_joints(self) -> tuple[Array, ...]:
        """Noise of the joints by data set (k,), unit of q; unknown directions count as noise."""
        own = tuple(joint_noise(self.mechanism, d) for d in self.datasets)
        if not any("dir" in e.kind.needs for e in self.mechanism.effects):
            return own
        return tuple(np.hypot(s, direction_sigma(self.mechanism, e))
                     for s, e in zip(own, self.environments, strict=True))

    @cached_property
    def sigma_gaps(self) -> tuple[Array, ...]:
        """Standard uncertainty of closure gaps by data set (m,), 0 where limbs close exactly."""
        return tuple(gap_noise(self.mechanism, d) for d in self.datasets)

    @cached_property
    def noisy_closure(self) -> tuple[bool, ...]:
        """Whether joints or gaps have noise, which the geometry carries to the measurement."""
        return tuple(bool(np.any(joints > 0.0) or np.any(gaps > 0.0))
                     for joints, gaps in zip(self.sigma_joints, self.sigma_gaps, strict=True))

    def open_scale(self) -> Array:
        """Return one natural unit per nuisance column (C - F,): 1e-3 of the reach, 1e-3 rad.

        The unit of homing is 1e-3 of the largest joint range, that of a scale 1e-3.
        """
        joint = self._joint_range

        def unit(column: str) -> float:
            what, _, part = column.split(" of ")[0].partition(".")
            if what == "scale":
                return 1.0
            if what == "homing":
                return joint
            return 1.0 if part.startswith("r") else self.mechanism.reach

        return 1e-3 * np.array([unit(name) for name in self.columns[len(self.free):]])

    @cached_property
    def _joint_range(self) -> float:
        """The largest joint range, unit of q; 1 where no joint moves."""
        ends = [d.q[finite_rows(d.q)] for d in self.datasets if finite_rows(d.q).any()]
        return max((float(np.ptp(q, axis=0).max()) for q in ends), default=1.0) or 1.0

    def start(self) -> State:
        """Return the starting state: present values, poses from home, aligned frames.

        Raises:
            BadInput: no row of a data set fits the machine, or too few rows for its frame.
        """
        model = Model(self.mechanism)
        poses = tuple(self.reached(i, model) for i in range(len(self.datasets)))
        for d, pose in zip(self.datasets, poses, strict=True):
            if not finite_rows(pose).any():
                raise no_pose(self.mechanism, d)
        registrations = [replace(start_registration(unscaled(d), pose, self.mechanism),
                                 scale=float(d.scale.value[0]))
                         for d, pose in zip(self.datasets, poses, strict=True)]
        for i, d in enumerate(self.datasets):
            if d.frame.same_as:
                shared = registrations[self.shared(d)].frame
                registrations[i] = replace(registrations[i], frame=shared)
        return State(self.mechanism.values, tuple(registrations), poses)

    def reached(self, index: int, model: Model, homing: Array | float = 0.0) -> Array:
        """Return a data set's poses reached from home (N, 8); both poses of distances (N, 16)."""
        data = self.datasets[index]
        ends = [q + homing for q in (data.q, data.to_q) if q is not None]
        return np.concatenate([
            self.home.of(model, q, partial(self._led, index, model, q)) for q in ends], axis=1)

    def _led(self, index: int, model: Model, q: Array) -> Array:
        """Return the poses (N, 8) of a data set at joint values (N, k), reached from home."""
        return np.concatenate([reached_poses(model, q[rows], environment).closed
                               for rows, environment in self.chunks(index)])

    def shared(self, data: Dataset) -> int:
        """Return the index of the data set whose frame ``data`` uses."""
        return next(i for i, d in enumerate(self.datasets) if d.name == data.frame.same_as)

    def solve(self, state: State, wary: bool = True, minima: Minima | None = None) -> State:
        """Return the state with its poses solved again at its parameters.

        ``wary``, ``minima``: see :func:`ppmcal.kinematics.equilibrium.settle`.
        """
        model = Model(self.mechanism, state.g)
        poses = tuple(np.concatenate([
            np.concatenate([settle(model, q, environment, pose, wary, minima)[0]
                            for q, pose in self.ends(i, state, rows)], axis=1)
            for rows, environment in self.chunks(i)]) for i in range(len(self.datasets)))
        return replace(state, poses=poses)

    def chunks(self, index: int) -> Iterator[tuple[slice, Environment]]:
        """Yield a data set's rows in chunks with their environments, to bound memory.

        Yields at least one chunk, which may be empty.
        """
        size = len(self.datasets[index])
        chunk = CHUNK if self.mechanism.effects else LONG_CHUNK
        for begin in range(0, max(size, 1), chunk):
            rows = slice(begin, min(begin + chunk, size))
            yield rows, self._at(index, rows)

    def _at(self, index: int, rows: Ints | slice) -> Environment:
        """Return the environment of some rows; a cheap unknown one for machines without effects."""
        if self.mechanism.effects:
            return self.environments[index].take(rows)
        count = rows.stop - rows.start if isinstance(rows, slice) else len(rows)
        return unknown_environment(count, len(self.mechanism.actuators))

    def ends(self, index: int, state: State, rows: Ints | slice = slice(None)
             ) -> list[tuple[Array, Array]]:
        """Return joint values (n, k) and poses (n, 8) of some rows.

        One pair; two for distances between two platform positions.
        """
        data, pose = self.datasets[index], state.poses[index]
        homing = state.registrations[index].homing
        ends = [(data.q[rows] + homing, pose[rows, :8])]
        if data.to_q is not None:
            ends.append((data.to_q[rows] + homing, pose[rows, 8:]))
        return ends

    def sighting(self, index: int, state: State) -> Sighting:
        """Return a data set as its instrument observes the machine."""
        return Sighting(self.mechanism, self.datasets[index], state.registrations[index],
                        self.opens[index], self.sigma_joints[index], self.sigma_gaps[index])

    def joints(self, index: int, state: State) -> Array:
        """Return the joint values of a data set with its homing shifts applied (N, k)."""
        return self.datasets[index].q + state.registrations[index].homing

    def moved(self, state: State, step: Array, wary: bool = True) -> State:
        """Return the state moved by a step (C,), poses solved again; ``wary``: see the solver."""
        g = state.g.copy()
        for p, s in zip(self.free, step[:len(self.free)].tolist(), strict=True):
            g[p] = self.mechanism.parameters[p].stepped(float(g[p]), s)
        registrations = tuple(o.moved(s, step)
                              for s, o in zip(state.registrations, self.opens, strict=True))
        there = State(g, registrations, state.poses)
        homed = any(o.homing.stop > o.homing.start for o in self.opens)
        return self.solve(there, wary) if self.free or homed else there

    def kept(self, state: State, minima: Minima) -> State:
        """Return an accepted state, with rows that stand out solved again for surplus limbs.

        This takes long, so it is not done for every trial step.
        """
        return self.solve(state, minima=minima) if self.mechanism.surplus else state

    def rows(self, state: State, jacobian: bool = True,
             keep: Sequence[NDArray[np.bool_]] | None = None) -> Iterator[Rows]:
        """Yield whitened rows of all data sets, chunk by chunk, white across data sets too.

        Rows whose pose is unknown (nan), and those not in ``keep``, are left out.
        """
        given = self.shared_stands(state, keep)
        for i in range(len(self.datasets)):
            yield from self.rows_of(i, state, jacobian, None if keep is None else keep[i], given)

    def shared_stands(self, state: State, keep: Sequence[Bools] | None) -> list[Bools] | None:
        """Return the rows used if targets share stands, whose joint noise is common; else None."""
        return self.used(state, keep) if any(self.companions) else None

    def used(self, state: State, keep: Sequence[Bools] | None) -> list[Bools]:
        """Return which rows (N,) of each data set have a pose and are in ``keep`` (if given)."""
        there = [finite_rows(pose) for pose in state.poses]
        return there if keep is None else [t & k for t, k in zip(there, keep, strict=True)]

    def rows_of(self, i: int, state: State, jacobian: bool = True, keep: Bools | None = None,
                given: Sequence[Bools] | None = None) -> Iterator[Rows]:
        """Yield whitened rows of one data set, chunk by chunk; see :meth:`rows`.

        ``given``: rows (N,) of all data sets; whitening is conditional on those of earlier targets
        at the same stands, which share the joint noise. None: each row is whitened by itself.
        """
        usable = finite_rows(state.poses[i])
        if keep is not None:
            usable &= keep
        index = np.flatnonzero(usable)
        for begin in range(0, index.size, CHUNK):
            yield self._chunk(i, index[begin:begin + CHUNK], state, jacobian, given)

    @cached_property
    def companions(self) -> list[list[tuple[int, Ints]]]:
        """The earlier targets at the stands of each data set's rows; see :func:`companions`."""
        if not any(self.noisy_closure):
            return [[] for _ in self.datasets]
        return [[(j, rows) for j, rows in own if self.noisy_closure[i] and self.noisy_closure[j]]
                for i, own in enumerate(companions(self.datasets))]

    def earlier_rows(self, state: State, size: int) -> Array:
        """Return prior information as white rows (k, size), the residual last."""
        if self.earlier is None:
            return np.zeros((0, size))
        residual, jacobian = self.earlier.rows(self.mechanism, self.free, state.g)
        out = np.zeros((residual.size, size))
        out[:, :len(self.free)], out[:, -1] = jacobian, residual
        return out

    def measured(self, index: int, rows: Ints) -> tuple[Array, Array, Ints]:
        """Return measurements of some rows: x ... rz (n, 6), 1/sigma (n, m), number of values (n,).

        The first two are 0 where nothing was measured.
        """
        data = self.datasets[index]
        if len(data) > PIECE:
            return white_measurements(data, self.mechanism.motion, rows)
        if index not in self._kept:
            self._kept[index] = white_measurements(data, self.mechanism.motion)
        seen, white, number = self._kept[index]
        if rows.size == len(data):
            return seen, white, number
        return seen[rows], white[rows], number[rows]

    def counts(self, index: int, rows: Ints) -> Ints:
        """Return the number of values in rows (n,) of a data set: measured, and surplus closure."""
        ends = 1 if self.datasets[index].to_q is None else 2
        return np.asarray(self.measured(index, rows)[2] + ends * self.mechanism.surplus)

    @cached_property
    def _kept(self) -> dict[int, tuple[Array, Array, Ints]]:
        return {}

    def _chunk(self, i: int, index: Ints, state: State, jacobian: bool,
               given: Sequence[Bools] | None) -> Rows:
        own = self._raw(i, index, state, jacobian)
        if given is None:
            return white_rows(i, index, own, ())
        others: list[tuple[int, Ints, RawRows]] = []
        for j, rows in self.companions[i]:
            at = rows[index]
            there = (at >= 0) & given[j][at]
            if there.any():
                at = np.where(there, at, at[there][0])
                others.append((j, at, self._raw(j, at, state, jacobian).only(there)))
                own = own.without_surplus(there)
        return white_rows(i, index, own, others)

    def _raw(self, i: int, index: Ints, state: State, jacobian: bool) -> RawRows:
        rows = self._at(i, index)

        def surroundings() -> Environment:
            # a response may be asked for about effects that the machine does not have
            return rows if self.mechanism.effects else self.environments[i].take(index)

        ends = self.ends(i, state, index)
        models = [shifted(Model(self.mechanism, state.g), rows, q, pose) for q, pose in ends]
        return RowMaker(self.sighting(i, state), models, ends, surroundings, self.free,
                        len(self.columns) if jacobian else None,
                        None if self.free or self.mechanism.effects else self.at_rest).made(index)
