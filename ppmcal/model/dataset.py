"""Measurements, checked once on reading; SI, plain arrays, one row per measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.linalg import Array, Bools, Ints, row_by_row, taken
from ppmcal.model.history import History, history_of, straight, ways
from ppmcal.model.instruments import POSE, InstrumentKind
from ppmcal.model.recorded import RecordedForm
from ppmcal.model.registration import DefinedFrame
from ppmcal.notes import Note
from ppmcal.units import SI, Units
from ppmcal.wording import pluralize


@dataclass(frozen=True)
class Unknown:
    """A pose, point, rotation or scale that is either given or to be fitted.

    ``value`` holds the given value, or zeros; ``same_as`` names another data set whose fitted
    value is shared; ``sigma``: prior standard deviation of a fitted scale about ``value``, None
    without a prior; ``defined``: what defines a given frame.
    """

    fitted: bool
    value: Array
    same_as: str | None = None
    sigma: float | None = None
    defined: DefinedFrame | None = None


TRUE_SCALE = Unknown(False, np.ones(1))
"""The scale of an instrument without scale error."""
NO_OFFSET = Unknown(False, np.zeros(1))
"""The offset of an instrument without zero error."""


@dataclass(frozen=True, repr=False)
class Dataset:
    """One CSV with its sidecar.

    Attributes:
        name: the sidecar's name, unique within a campaign.
        source: path of the CSV, for messages.
        kind: of instrument.
        rows: row numbers in the CSV, counting data rows from 1, (N,).
        q: joint values by actuator in SI (m, rad; dimensionless where the drive has a
            ratio), (N, k); nan where the file gives a commanded pose instead.
        commanded: commanded poses (N, 6), nan where unused, or None.
        position: measured position (N, 3), nan where not measured (planar: z is nan).
        rotation: measured rotation vector (N, 3), nan where not measured (planar: only z); for an
            inclinometer its angles, each in the component of its coordinate.
        value: heights, distances or joint readings (N,), nan for other instruments.
        to_q: second joint values of a distance between two platform positions, or None.
        sigma_position, sigma_rotation: standard deviations (N, 3).
        sigma_value: of ``value`` (N,).
        covariance: of the position (N, 3, 3), m^2, where its coordinates are correlated, as a
            tracker's are; or of position and rotation (N, 6, 6), m and rad; None: uncorrelated.
        sigma_actuator: noise of the joints, by actuator (k,), 0 where none; unit of q.
        groups: integer label per commanded pose (repeats share it), (N,).
        labels: the file's own pose labels, whatever the joints are (N,); None: as groups.
        columns: further columns by name in SI: ``dir_leg1``, ``vel_leg1``,
            ``temperature``, ``payload``, ``time``, ``fx`` ...; (N,) each, nan = missing.
        sessions: label per row, or None.
        frame, target, target_rotation: known or to be fitted; (6,), (3,), (3,).
        scale: the file's lengths over the true ones (1,), known or to be fitted, with a normal
            prior where it has a ``sigma``.
        offset: readings of an encoder at a joint minus the true values (1,), SI.
        estimated: whether the stated noise is only the starting value of an estimate.
        homing: ``shared`` or ``per-file``; inside the program also ``alone``: open even in the
            first file.
        approach: ``columns``, ``sequence`` or ``unknown``.
        visited: direction of approach of each joint (N, k), +1 or -1, nan where unknown; None:
            as given by the columns and ``approach``. Keeps the directions that follow from the
            order of the rows when rows are taken out.
        unusable: why a row must not be used, "" where it may, by row; None: all may.
        findings: warnings from reading, each naming the row or column.
        dropped: rows of the CSV without usable content: (row number, reason).
        extra: data specific to one kind of instrument.
        units: of the file.
        convention: of its rotation columns: ``rotvec``, ``quat-xyzw`` ...
        read: the sidecar's own block ``read``.
        headers: our column -> the file's header, where they differ.
        headed: our column -> the file's header, and the unit given in it.
        recorded: the form of joints or commanded poses in the file; None: not from a file.
        chance: that two measurements of one pose agree in every digit, given noise and digits.
        before: rows of the campaign's files before this one.
        moments: the rows' numbers on the time line of the campaign (N,); None: consecutive,
            see :meth:`numbers`.
        campaign: name shared by the files of one campaign; empty: a campaign of its own.
        whole: the data set before rows were taken out, which were visited all the same; None:
            itself. ``place``: indices of its rows in that one (N,).
        body: name of the file that several targets share; empty: the file has one target.
            ``mark``: the target's name; ``wide``: it has its own measured columns there, whose
            names are in ``headers``.
        stands: a label per stop of the machine (N,), shared by all targets seen there; None: rows
            with one number on the time line.
        weight: the fraction of each row's information that counts (N,); None: all of it.
        gap_factor: scales the standard deviations of the limbs' gaps along with the other noise.
    """

    name: str
    source: str
    kind: InstrumentKind
    rows: NDArray[np.int64]
    q: Array
    commanded: Array | None
    position: Array
    rotation: Array
    value: Array
    to_q: Array | None
    sigma_position: Array
    sigma_rotation: Array
    sigma_value: Array
    sigma_actuator: Array
    groups: NDArray[np.int64]
    columns: Mapping[str, Array]
    sessions: tuple[str, ...] | None
    frame: Unknown
    target: Unknown
    target_rotation: Unknown
    labels: NDArray[np.int64] | None = None
    scale: Unknown = TRUE_SCALE
    offset: Unknown = NO_OFFSET
    estimated: bool = False
    homing: str = "shared"
    approach: str = "unknown"
    visited: Array | None = None
    unusable: tuple[str, ...] | None = None
    findings: tuple[Note, ...] = ()
    dropped: tuple[tuple[int, str], ...] = ()
    extra: Mapping[str, object] = field(default_factory=dict)
    units: Units = SI
    convention: str = "rotvec"
    read: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    headed: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    recorded: RecordedForm | None = None
    chance: float = 1.0
    before: int = 0
    moments: Ints | None = None
    campaign: str = ""
    body: str = ""
    mark: str = ""
    wide: bool = False
    stands: Ints | None = None
    whole: Dataset | None = None
    place: Ints | None = None
    weight: Array | None = None
    gap_factor: float = 1.0
    covariance: Array | None = None

    @classmethod
    def of_poses(cls, name: str, q: Array, pose: Array, sigma: tuple[float, float],
                 fitted: bool) -> Dataset:
        """Return full poses (N, 6) at joints ``q`` (N, k) as if measured, nan where not.

        ``sigma``: standard deviations of position and rotation; ``fitted``: whether frame, target
        and target rotation are to be fitted; otherwise they are the base's and platform's own.
        """
        n, one = pose.shape[0], np.ones((pose.shape[0], 3))
        point = Unknown(fitted, np.zeros(3))
        return cls(
            name=name, source=name, kind=POSE, rows=np.arange(1, n + 1), q=q, commanded=None,
            position=pose[:, :3], rotation=pose[:, 3:], value=np.full(n, np.nan), to_q=None,
            sigma_position=sigma[0] * one, sigma_rotation=sigma[1] * one,
            sigma_value=np.ones(n), sigma_actuator=np.zeros(q.shape[1]), groups=np.arange(n),
            columns={}, sessions=None, frame=Unknown(fitted, np.zeros(6)), target=point,
            target_rotation=point)

    def __repr__(self) -> str:
        """Return name, kind of instrument and number of rows."""
        return f"<data set {self.name}: {self.kind}, {pluralize(len(self), 'row')}>"

    @property
    def entire(self) -> Dataset:
        """The data set with all rows, before any were taken out."""
        return self if self.whole is None else self.whole

    def __len__(self) -> int:
        """Return the number of rows N."""
        return int(self.rows.shape[0])

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Which rows may be used (N,)."""
        return np.array([not why for why in self.unusable or ("",) * len(self)], dtype=np.bool_)

    def take(self, keep: NDArray[np.int64] | NDArray[np.bool_]) -> Dataset:
        """Return the data set with only the rows ``keep`` (indices or mask)."""
        sessions, unusable = (
            None if words is None else tuple(np.asarray(words, dtype=object)[keep])
            for words in (self.sessions, self.unusable))
        visited = self.directions()
        return replace(
            self, rows=self.rows[keep], q=self.q[keep],
            commanded=None if self.commanded is None else self.commanded[keep],
            position=self.position[keep], rotation=self.rotation[keep],
            value=taken(self.value, keep),
            to_q=None if self.to_q is None else self.to_q[keep],
            sigma_position=taken(self.sigma_position, keep),
            sigma_rotation=taken(self.sigma_rotation, keep),
            sigma_value=taken(self.sigma_value, keep),
            covariance=None if self.covariance is None else self.covariance[keep],
            groups=self.groups[keep],
            labels=None if self.labels is None else self.labels[keep],
            columns={n: c[keep] for n, c in self.columns.items()}, sessions=sessions,
            visited=None if visited is None else visited[keep], unusable=unusable,
            moments=None if self.moments is None else self.moments[keep],
            stands=None if self.stands is None else self.stands[keep],
            whole=self.entire,
            place=np.arange(len(self))[keep] if self.place is None else self.place[keep],
            weight=None if self.weight is None else self.weight[keep])

    def numbers(self) -> Ints:
        """Return the rows' numbers across all files (N,); rows of one moment share a number."""
        return self.rows + self.before if self.moments is None else self.moments

    def row_at(self, number: int) -> int:
        """Return the row of the file with a number on the time line, or the last before it."""
        if self.moments is None:
            return max(number - self.before, 1)
        place = int(np.searchsorted(self.moments, number, side="right")) - 1
        return int(self.rows[max(place, 0)])

    def noisier(self, factor: float) -> Dataset:
        """Return the data set with its standard deviations times ``factor``."""
        def noisy(sigma: Array) -> Array:
            return factor * sigma

        return replace(
            self, sigma_position=row_by_row(noisy, self.sigma_position),
            sigma_rotation=row_by_row(noisy, self.sigma_rotation),
            sigma_value=row_by_row(noisy, self.sigma_value),
            sigma_actuator=noisy(self.sigma_actuator), gap_factor=factor * self.gap_factor,
            covariance=None if self.covariance is None else factor**2 * self.covariance)

    def without(self, rows: NDArray[np.bool_], reason: str) -> Dataset:
        """Return the data set with ``rows`` (N,) marked unusable; earlier reasons are kept."""
        old = self.unusable or ("",) * len(self)
        return replace(self, unusable=tuple(
            r or (reason if out else "") for r, out in zip(old, rows.tolist(), strict=True)))

    def own_column(self, name: str) -> str:
        """Return a column's name in the sidecar, ``T2_x`` if several targets have such a column."""
        shared = not self.wide or name not in self.headers or name.startswith("q_")
        return name if shared else f"{self.mark}_{name}"

    def alone(self) -> Dataset:
        """Return the data set with its own frame instead of one shared with another data set."""
        if self.frame.same_as is None:
            return self
        return replace(self, frame=replace(self.frame, same_as=None, fitted=True))

    def directions(self) -> Array | None:
        """Return the directions of approach by the order of the rows (N, k), or None."""
        if self.visited is None and self.approach == "sequence":
            return ways(self.q)
        return self.visited


def tracker_noise(position: Array, station: Array, distance: float, angle: float) -> Array:
    """Return the symmetric root (N, 3, 3) of the covariance of a tracker's positions (N, 3), m.

    Args:
        position: as measured, m.
        station: position of the tracker (3,), same frame.
        distance: standard deviation along the line of sight, m.
        angle: standard deviation of either angle across it, rad.
    """
    way = position - station
    far = np.linalg.norm(way, axis=1)
    ahead = way / np.where(far > 0.0, far, 1.0)[:, None]
    along = ahead[:, :, None] * ahead[:, None, :]
    return np.asarray(distance * along + (angle * far)[:, None, None] * (np.eye(3) - along))


STANDARD_GRAVITY = 9.80665
REFERENCE_TEMPERATURE, ZERO_CELSIUS = 293.15, 273.15
POUND = 0.45359237
PAYLOADS = {"kg": 1.0, "g": 1e-3, "lb": POUND, "N": 1.0 / STANDARD_GRAVITY}
"""Accepted units of a payload, in kg."""
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True)
class Environment:
    """The conditions that effects depend on, in N rows with k joints, SI; nan where not recorded.

    ``approach``, ``velocity`` (of q) (N, k); ``temperature`` K above 20 degrees Celsius (N,);
    ``wrench`` on the platform (N, 6), and ``weight``, the payload's part of its force (N, 3);
    ``time`` s (N,). ``row``: number in the campaign, counted from 1 across its files in order
    (N,); inf: after all of them. ``history``: all rows of the file in the order of their visit,
    None if unknown; ``place``: index of each row in it (N,), -1 if not in it. ``touch``: whether a
    flat was touched there (N,), None: nowhere. ``stood``: a label per stop (N,) where only joint
    readings were measured, None: the joints are where they were commanded. ``tension``: measured
    rope tensions (N, k), N, None: not measured.
    """

    approach: Array
    velocity: Array
    temperature: Array
    wrench: Array
    time: Array
    row: Array
    weight: Array
    history: History | None = None
    place: Ints | None = None
    touch: Bools | None = None
    stood: Ints | None = None
    tension: Array | None = None

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_] | slice) -> Environment:
        """Return the environment of some rows, with the complete history."""
        return Environment(self.approach[rows], self.velocity[rows], self.temperature[rows],
                           self.wrench[rows], self.time[rows], self.row[rows],
                           self.weight[rows], self.history,
                           None if self.place is None else self.place[rows],
                           None if self.touch is None else self.touch[rows],
                           None if self.stood is None else self.stood[rows],
                           None if self.tension is None else self.tension[rows])

    def with_directions(self) -> Environment:
        """Return it with joints marked as direct only where the recorded directions agree."""
        if self.history is None or self.place is None:
            return self
        direct = self.history.direct & straight(self.history, self.place, self.approach)
        return replace(self, history=replace(self.history, direct=direct))


def unknown_environment(rows: int, joints: int) -> Environment:
    """Return an environment in which nothing was recorded."""
    one, many = unknown(rows), unknown(rows, joints)
    return Environment(many, many, one, unknown(rows, 6), one, np.broadcast_to(np.inf, rows),
                       unknown(rows, 3))


def unknown(*shape: int) -> Array:
    """Return a read-only array of nan that occupies one number: there may be a million rows."""
    return np.broadcast_to(np.array(np.nan), shape)


def _by_joint(columns: Mapping[str, Array], what: str, actuators: Sequence[str], n: int) -> Array:
    """Return the columns ``what_<actuator>`` (N, k), nan where missing."""
    names = [f"{what}_{a}" for a in actuators]
    if not any(name in columns for name in names):
        return unknown(n, len(names))
    return np.stack([columns.get(name, unknown(n)) for name in names], axis=-1)


def environment(columns: Mapping[str, Array], actuators: Sequence[str], gravity: Array,
                q: Array, sequence: bool = False) -> Environment:
    """Return the environment that columns in SI describe.

    Args:
        columns: ``dir_<actuator>``, ``vel_<actuator>``, ``temperature`` in K, ``payload`` in
            kg, ``fx`` ..., ``time``, ``tension_<actuator>``; (N,) each.
        actuators: names of the joints.
        gravity: direction of weight in base axes (3,).
        q: joint values (N, k), nan where not known.
        sequence: the rows were visited in order, so that the move from the previous row is the
            direction of approach; otherwise ``time`` gives the order.
    """
    n = q.shape[0]
    blank = unknown(n)
    approach = ways(q) if sequence else _by_joint(columns, "dir", actuators, n)
    velocity = _by_joint(columns, "vel", actuators, n)
    wrench, force = unknown(n, 6), unknown(n, 3)
    if "payload" in columns or any(w in columns for w in WRENCH):
        given = [np.asarray(columns.get(w, np.zeros(n))) for w in WRENCH]
        weight = STANDARD_GRAVITY * np.asarray(columns.get("payload", np.zeros(n)))
        wrench, force = np.stack(given, axis=-1), weight[:, None] * gravity
        wrench[:, :3] += force
    temperature = columns.get("temperature", blank) - REFERENCE_TEMPERATURE
    time = columns.get("time", blank)
    # a joint whose direction is 0 throughout is never moved: it stays where it is
    rests = np.all(approach == 0.0, axis=0)
    history, place = history_of(
        np.where(rests, 0.0, q), time, temperature, wrench, force, sequence)
    tension = _by_joint(columns, "tension", actuators, n) if any(
        c.startswith("tension_") for c in columns) else None
    return Environment(approach, velocity, temperature, wrench, time, np.full(n, np.inf), force,
                       history, place, tension=tension).with_directions()


def with_platform_directions(found: Environment, by_axis: Array, drive: Array) -> Environment:
    """Fill in joint approach directions from those recorded for the platform.

    Args:
        found: environment with unknown approach.
        by_axis: ``dir_x, dir_y, dir_z`` (N, 3), 0 or nan where not recorded.
        drive: dq/d(platform displacement) at each row (N, k, 3).
    """
    way = np.sign(np.einsum("nkc,nc->nk", drive, np.nan_to_num(by_axis)))
    recorded = np.asarray(np.isfinite(by_axis).any(axis=1))[:, None] & (way != 0.0)
    return replace(found, approach=np.where(np.isfinite(found.approach) | ~recorded,
                                            found.approach, way))
