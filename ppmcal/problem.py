"""Whitened residuals and their Jacobian for a machine, its stations and the data.

Columns: first the free geometry parameters, then what each data set leaves open (frame,
target, target rotation, homing). Rows are produced in chunks of poses, so that memory
stays small however many there are:

    d prediction = by_pose . dpose,    dpose = -A^-1 (Bg dg + Jq dh),

one small inverse per pose and one outer product per leg ([LIN] section 2.5).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.align import no_pose, start_station
from ppmcal.arrays import known
from ppmcal.closure import Closure, Model
from ppmcal.conditions import Conditions
from ppmcal.dataset import Dataset
from ppmcal.effects import Shift
from ppmcal.equilibrium import platform_pose, reach, settle
from ppmcal.influence import Response, conditions_of, shifted
from ppmcal.mechanism import Mechanism
from ppmcal.observation import Station, View, noise, pivot, view, whitener

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
CHUNK = 2048


@dataclass(frozen=True)
class State:
    """Where the fit stands: parameters (P,), one station per data set, poses (N, 8) each."""

    g: Array
    stations: tuple[Station, ...]
    poses: tuple[Array, ...]


@dataclass(frozen=True)
class Rows:
    """One chunk of whitened rows.

    ``residual`` (n, m) white; ``jacobian`` (n, m, C) of the white prediction;
    ``observed`` (n, m); ``raw`` (n, m) in m and rad; ``whitener`` (n, m, m);
    ``index`` (n,) rows of the data set; ``response`` how predictions move along shifts,
    None where no Jacobian was asked for.
    """

    dataset: int
    index: NDArray[np.int64]
    residual: Array
    jacobian: Array
    observed: Bools
    raw: Array
    whitener: Array
    response: Response | None = None


@dataclass(frozen=True)
class Open:
    """Columns of one data set's open quantities: name -> (column slice, components)."""

    frame: slice
    target: slice
    target_rotation: slice
    homing: slice
    about: Array


@dataclass(frozen=True, eq=False)
class Problem:
    """A machine and its measurements.

    ``free`` are parameter indices (F,); ``pivots`` the points about which frames are turned,
    one (3,) per data set, default each one's middle; ``given`` their conditions, default as
    their columns say.
    """

    mechanism: Mechanism
    datasets: tuple[Dataset, ...]
    free: tuple[int, ...]
    pivots: tuple[Array, ...] | None = None
    given: tuple[Conditions, ...] | None = None

    @cached_property
    def _layout(self) -> tuple[tuple[Open, ...], tuple[str, ...]]:
        return _lay_out(self)

    @property
    def opens(self) -> tuple[Open, ...]:
        """Column layout of each data set's open quantities."""
        return self._layout[0]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns: parameters, then ``frame.x of NAME`` and the like (C,)."""
        return self._layout[1]

    @cached_property
    def conditions(self) -> tuple[Conditions, ...]:
        """What effects depend on, by data set."""
        return self.given or tuple(conditions_of(self.mechanism, d) for d in self.datasets)

    @cached_property
    def frame_parts(self) -> tuple[int, ...]:
        """Components of a frame that the motion allows."""
        return (0, 1, 5) if self.mechanism.motion == "planar" else (0, 1, 2, 3, 4, 5)

    @property
    def target_parts(self) -> tuple[int, ...]:
        """Components of a target point."""
        return (0, 1) if self.mechanism.motion == "planar" else (0, 1, 2)

    @property
    def turn_parts(self) -> tuple[int, ...]:
        """Components of a target rotation."""
        return (2,) if self.mechanism.motion == "planar" else (0, 1, 2)

    def open_scale(self) -> Array:
        """Return one natural unit per open column (C - F,): 1e-3 of the reach, 1e-3 rad.

        Homing is counted in 1e-3 of the largest range of a joint.
        """
        ends = [d.q[known(d.q)] for d in self.datasets if known(d.q).any()]
        joint = max((float(np.ptp(q, axis=0).max()) for q in ends), default=1.0) or 1.0

        def unit(column: str) -> float:
            what, part = column.split(" of ")[0].split(".", 1)
            if what == "homing":
                return joint
            return 1.0 if part.startswith("r") else self.mechanism.reach

        return 1e-3 * np.array([unit(name) for name in self.columns[len(self.free):]])

    def start(self) -> State:
        """Return the starting state: present values, poses from home, aligned frames."""
        model = Model(self.mechanism)
        poses = tuple(reach(model, d.q, c).closed
                      for d, c in zip(self.datasets, self.conditions, strict=True))
        for d, pose in zip(self.datasets, poses, strict=True):
            if not known(pose).any():
                raise no_pose(self.mechanism, d)
        stations: list[Station] = []
        for d, pose in zip(self.datasets, poses, strict=True):
            stations.append(start_station(d, pose, len(self.mechanism.actuators),
                                          self.mechanism.motion))
        for i, d in enumerate(self.datasets):
            if d.frame.same_as:
                stations[i] = replace(stations[i], frame=stations[self.shared(d)].frame)
        return State(self.mechanism.values, tuple(stations), poses)

    def shared(self, data: Dataset) -> int:
        """Return the index of the data set whose frame ``data`` uses."""
        return next(i for i, d in enumerate(self.datasets) if d.name == data.frame.same_as)

    def solve(self, state: State) -> State:
        """Return the state with its poses solved anew at its parameters."""
        model = Model(self.mechanism, state.g)
        poses = tuple(settle(model, self.joints(i, state), self.conditions[i], state.poses[i])[0]
                      for i in range(len(self.datasets)))
        return replace(state, poses=poses)

    def joints(self, index: int, state: State) -> Array:
        """Return the joint values of a data set with its homing shifts applied (N, k)."""
        return self.datasets[index].q + state.stations[index].homing

    def moved(self, state: State, step: Array) -> State:
        """Return the state moved by a step (C,), poses solved anew."""
        g = state.g.copy()
        for p, s in zip(self.free, step[:len(self.free)].tolist(), strict=True):
            g[p] = self.mechanism.parameters[p].stepped(float(g[p]), s)
        stations = tuple(self._station(s, o, step)
                         for s, o in zip(state.stations, self.opens, strict=True))
        return self.solve(State(g, stations, state.poses))

    def _station(self, station: Station, open_: Open, step: Array) -> Station:
        frame = np.zeros(6)
        parts = step[open_.frame]
        frame[list(self.frame_parts)[:parts.size]] = parts
        target, turn, homing = np.zeros(3), np.zeros(3), np.zeros_like(station.homing)
        target[list(self.target_parts)[:step[open_.target].size]] = step[open_.target]
        turn[list(self.turn_parts)[:step[open_.target_rotation].size]] = step[open_.target_rotation]
        homing[:step[open_.homing].size] = step[open_.homing]
        return Station(turned_about(station.frame, frame, open_.about), station.target + target,
                       station.target_rotation + turn, station.homing + homing)

    def rows(self, state: State, jacobian: bool = True,
             keep: Sequence[NDArray[np.bool_]] | None = None) -> Iterator[Rows]:
        """Yield whitened rows of all data sets, chunk by chunk.

        Rows whose pose is unknown (nan), and those not in ``keep``, are left out.
        """
        for i, data in enumerate(self.datasets):
            usable = known(state.poses[i])
            if keep is not None:
                usable &= keep[i]
            index = np.flatnonzero(usable)
            for begin in range(0, index.size, CHUNK):
                yield self._chunk(i, data, index[begin:begin + CHUNK], state, jacobian)

    def _chunk(self, i: int, data: Dataset, index: NDArray[np.int64], state: State,
               jacobian: bool) -> Rows:
        part, pose, station = data.take(index), state.poses[i][index], state.stations[i]
        rows = self.conditions[i].take(index)
        q = part.q + station.homing
        model = shifted(Model(self.mechanism, state.g), rows, q, pose)
        shift = model.shift
        seen = view(part, station, platform_pose(pose, shift), self.mechanism.motion,
                    self.opens[i].about, shift.stretch if shift else None)
        with_noise = bool(np.any(data.sigma_actuator > 0.0))
        n, m = seen.residual.shape
        full = np.zeros((n, m, len(self.columns) if jacobian else 0))
        by_joint, response = None, None
        if jacobian or with_noise:
            closure = model.closure(q, self.free if jacobian else ())
            lines = closure.lines(pose)
            spread = self._spread(seen, closure, pose, lines, shift)
            response = Response(closure, pose, lines, spread, seen, rows)
            by_joint = spread @ closure.joint_matrix(pose, lines)
            if jacobian:
                self._geometry(i, full, response, by_joint)
                response.effect_columns(full, self.free)
                self._stations(i, full, seen)
        white = whitener(seen, noise(part, self.mechanism.motion), by_joint, data.sigma_actuator)
        full = np.where(seen.observed[..., None], full, 0.0)
        if with_noise:
            residual, full = (white @ seen.residual[..., None])[..., 0], white @ full
        else:
            diagonal = np.diagonal(white, axis1=-2, axis2=-1)
            residual, full = diagonal * seen.residual, diagonal[..., None] * full
        return Rows(i, index, residual, full, seen.observed, seen.residual, white, response)

    def _spread(self, seen: View, closure: Closure, pose: Array, lines: Array,
                shift: Shift | None) -> Array:
        """Return d prediction / d condition (n, m, d): -by_pose A^-1."""
        by_pose = seen.by_pose
        if shift is not None and shift.pose is not None:
            # a turn of the closed pose comes out turned by the effects' own rotation
            turn = cga.motor_from_rotation_vector(shift.pose[:, 3:], np.zeros(3))
            by_pose = np.concatenate([by_pose[..., :3],
                                      by_pose[..., 3:] @ cga.rotation_matrix(turn)], axis=-1)
        return -np.swapaxes(np.linalg.solve(
            np.swapaxes(closure.pose_matrix(pose, lines), -1, -2),
            np.swapaxes(by_pose[..., self.mechanism.dof], -1, -2)), -1, -2)

    def _geometry(self, i: int, out: Array, response: Response, by_joint: Array) -> None:
        """Fill the columns of geometry and homing."""
        place = {p: c for c, p in enumerate(self.free)}
        for rows, parameters, block in response.closure.error_blocks(response.pose,
                                                                     response.lines):
            out[..., [place[p] for p in parameters]] += response.spread[..., rows] @ block
        homing = self.opens[i].homing
        if homing.stop > homing.start:
            out[..., homing] = by_joint

    def _stations(self, i: int, out: Array, seen: View) -> None:
        """Fill the columns of frame, target and target rotation."""
        open_ = self.opens[i]
        for columns, parts, source in (
                (open_.frame, self.frame_parts, seen.by_frame),
                (open_.target, self.target_parts, seen.by_target),
                (open_.target_rotation, self.turn_parts, seen.by_target_rotation)):
            if columns.stop > columns.start:
                out[..., columns] = source[..., list(parts)]


def _lay_out(problem: Problem) -> tuple[tuple[Open, ...], tuple[str, ...]]:
    names = [problem.mechanism.names[p] for p in problem.free]
    opens: dict[int, Open] = {}
    parts = ("x", "y", "z", "rx", "ry", "rz")
    by_name: dict[str, Open] = {}
    # a frame that another data set owns must have its columns before it is referred to
    for i, data in sorted(enumerate(problem.datasets), key=lambda d: bool(d[1].frame.same_as)):
        def take(wanted: bool, labels: Sequence[str], data: Dataset = data) -> slice:
            begin = len(names)
            if wanted:
                names.extend(f"{label} of {data.name}" for label in labels)
            return slice(begin, len(names))

        frame = take(data.frame.fitted and not data.frame.same_as,
                     [f"frame.{parts[p]}" for p in problem.frame_parts])
        about = problem.pivots[i] if problem.pivots else pivot(data)
        if data.frame.same_as and data.frame.same_as in by_name:
            frame, about = by_name[data.frame.same_as].frame, by_name[data.frame.same_as].about
        target = take(data.target.fitted, [f"target.{parts[p]}" for p in problem.target_parts])
        turns = data.target_rotation.fitted and data.kind == "pose" and (
            problem.mechanism.motion != "translational")
        turn = take(turns, [f"target_rotation.{parts[3 + p]}" for p in problem.turn_parts])
        homing = take(i > 0 and data.homing == "per-file",
                      [f"homing.{a}" for a in problem.mechanism.actuators])
        open_ = Open(frame, target, turn, homing, np.where(np.isfinite(about), about, 0.0))
        opens[i] = open_
        by_name[data.name] = open_
    return tuple(opens[i] for i in range(len(opens))), tuple(names)


def turned_about(frame: Array, step: Array, about: Array) -> Array:
    """Return a frame motor displaced by step[:3] and turned by step[3:] about a point."""
    turn = cga.motor_from_rotation_vector(step[3:], np.zeros(3))
    shift = about + step[:3] - cga.move_point(turn, about)
    return cga.compose(cga.motor_from_rotation_vector(step[3:], shift), frame)
