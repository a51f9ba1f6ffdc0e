"""The measured rows of an identification, placed on its machine, and the poses that are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ppmcal import algebra as cga
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.io.campaign import read_datasets
from ppmcal.io.csv import Table
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import FittedDataset
from ppmcal.io.results.identification_tables import norm, row_key, used
from ppmcal.io.results.scene import ScenePoses
from ppmcal.io.results.scene_machine import MeasuredPose, Point, point_of
from ppmcal.io.sidecar import sidecar_path
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import with_joints
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import InstrumentKind, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES, Motion
from ppmcal.model.registration import Registration
from ppmcal.notes import NOTE, Note
from ppmcal.store.inputs import digest_of
from ppmcal.wording import pluralize

POINTS, WORST = 2000, 200
"""So many rows are drawn at most; so many of them are the worst, and as many left out ones."""
POSES_OF_WORST, POSES_OF_NEXT = 4, 24
"""The machine is drawn at so many rows that miss most, and at most so many to measure next."""
NEXT = "next:"
"""Keys of poses to measure next begin so; those of measured rows with a number."""
CHUNK = 500
"""Poses that are solved at once: no compiler is waited for."""
STAGES = ("before", "after")


@dataclass(frozen=True)
class FittedRows:
    """What a folder says of the rows of a fit: identification.json and residuals.csv."""

    folder: str
    record: IdentificationRecord
    residuals: Table | None = None


@dataclass(frozen=True)
class PlacedRows:
    """Measured rows with the machine's poses.

    Attributes:
        points: one for each of R rows.
        q: their joint values (R, k), SI; pose: motors of the platform (R, 8).
        notes: what is not drawn, and why.
    """

    points: tuple[MeasuredPose, ...]
    q: Array
    pose: Array
    notes: tuple[Note, ...]


def placed_rows(one: FittedRows, index: int, mechanism: Mechanism, most: int = POINTS
                ) -> PlacedRows:
    """Return the rows of residuals.csv where the machine has the measured point.

    The place is that of the model without effects at the row's joint values, in base axes; errors
    are those of residuals.csv, turned into base axes.

    Args:
        one: the fit.
        index: its index among several that are drawn.
        mechanism: the machine that it found.
        most: so many rows at most.
    """
    nothing = PlacedRows((), np.zeros((0, len(mechanism.actuators))), np.zeros((0, 8)), ())
    table = one.residuals
    if table is None or not table.size:
        return replace(nothing, notes=(
            Note("There is no residuals.csv, so no measured rows are drawn.", NOTE),))
    rows, thinned = _chosen(table, most)
    names = np.array(table.words("dataset"), dtype=object)
    plain = replace(mechanism, effects=())
    found, notes = [nothing], [*thinned]
    for entry in one.record.datasets:
        own = rows[(names[rows] == entry.name) | (len(one.record.datasets) == 1)]
        if not own.size:
            continue
        try:
            data = with_joints(plain, _read(one, entry, mechanism))
        except (PpmcalError, OSError) as error:
            what = getattr(error, "what", None) or error
            notes.append(Note(f"The rows of {entry.name} are not drawn: {what}.", NOTE))
            continue
        found.append(_of_dataset(table, own, data, entry, plain, index))
    joined = PlacedRows(tuple(p for f in found for p in f.points),
                        np.concatenate([f.q for f in found]),
                        np.concatenate([f.pose for f in found]), ())
    notes += [n for f in found for n in f.notes]
    return replace(joined, notes=tuple(notes))


def _chosen(table: Table, most: int) -> tuple[Ints, tuple[Note, ...]]:
    """Return the rows to draw, and how they were chosen where they are not all."""
    if table.size <= most:
        return np.arange(table.size), ()
    part = min(WORST, most // 4)
    size = np.nan_to_num(_size(table, np.arange(table.size), "after"), nan=-1.0)
    keep = used(table)
    worst = np.argsort(np.where(keep, -size, 1.0), kind="stable")[:part]
    out = np.flatnonzero(~keep)
    out = out[np.linspace(0, out.size - 1, min(part, out.size)).astype(int)]
    rest = most - part - out.size
    even = np.linspace(0, table.size - 1, max(rest, 1)).astype(int)
    rows = np.unique(np.concatenate([worst, out, even]))
    return rows, (Note(
        f"{rows.size} of {table.size} rows are drawn: every "
        f"{max(2, round(table.size / max(rest, 1)))}th or so, the {part} worst, and "
        f"{pluralize(int(out.size), 'row')} left out.", NOTE),)


def _read(one: FittedRows, entry: FittedDataset, mechanism: Mechanism) -> Dataset:
    """Return the data set of a file that is still the one which was fitted.

    Raises:
        BadInput: it is not there, or has changed.
    """
    inputs = one.record.provenance.inputs
    name = next(iter(one.record.provenance.inputs_of(entry.source)), "")
    file = Path(name).name or entry.name
    if not name:
        raise BadInput("the record does not say which file they are of", one.folder)
    folder = Path(one.folder).absolute()
    places = [Path(name), *(base / part for base in (folder, folder.parent)
                            for part in (name, Path(name).name))]
    there = [p for p in dict.fromkeys(places) if p.is_file()]
    same = next((p for p in there if digest_of(p) == inputs[name]), None)
    if same is None:
        raise BadInput(f"{file} {'has changed since' if there else 'is not where it was'}",
                       one.folder)
    side = sidecar_path(same)
    recorded = [own for k, own in inputs.items() if Path(k).name == side.name]
    if recorded and digest_of(side) not in recorded:
        raise BadInput(f"{side.name}, beside {file}, has changed since", one.folder)
    found = read_datasets(same, mechanism)
    return next((d for d in found if d.name == entry.name), found[0])


def _of_dataset(table: Table, rows: Ints, data: Dataset, entry: FittedDataset,
                plain: Mechanism, index: int) -> PlacedRows:
    """Return some rows of one data set."""
    number = np.nan_to_num(table.number("row")[rows], nan=-1.0).astype(int)
    at = np.clip(np.searchsorted(data.rows, number), 0, max(len(data) - 1, 0))
    known: Bools = np.zeros(len(rows), dtype=bool)
    if len(data):
        known = np.asarray(data.rows[at] == number)
    rows, at = rows[known], at[known]
    model = Model(plain)
    pose = _poses(model, data.q[at])
    good = finite_rows(pose)
    lost = int(np.count_nonzero(~good) + np.count_nonzero(~known))
    rows, at, pose = rows[good], at[good], pose[good]
    after, before = (None if e is None else e.in_si(plain.units) for e in (
        entry.registration, entry.registration_before))
    after = after or plain.registration(entry.name)
    before = before or after
    point = cga.move_point(pose, after.target)
    along = None
    if data.kind.along_line:
        along = _lines(model, data, at, pose, after, point)
    errors = [_in_base(_vectors(table, rows, stage, data.kind, plain.motion), registration)
              if along is None else table.number(f"{stage}_{data.kind.number}")[rows, None] * along
              for stage, registration in zip(STAGES, (before, after), strict=True)]
    notes: tuple[Note, ...] = ()
    if lost:
        notes = (Note(f"{pluralize(lost, 'row')} of {entry.name} {'has' if lost == 1 else 'have'} "
                      "no pose of this machine or no joint values.", NOTE),)
    if data.kind.along_line:
        notes += (Note(f"Errors of {entry.name} are along the measured distance.", NOTE),)
    return PlacedRows(_points(table, rows, plain, (entry.name, index), point, errors),
                      data.q[at], pose, notes)


def _points(table: Table, rows: Ints, plain: Mechanism, owner: tuple[str, int], point: Array,
            errors: Sequence[Array]) -> tuple[MeasuredPose, ...]:
    """Return the points, file units; ``errors``: before and after (R, 3), base axes."""
    f, (name, index) = plain.units.factor("length"), owner
    keep, reasons = used(table)[rows], table.words("reason")
    values = [_size(table, rows, s) for s in STAGES]
    turns = [norm(_residual(table, rows, s, POSE_COORDINATES[3:]).T) for s in STAGES]
    numbers = table.number("row")[rows].astype(int).tolist()
    return tuple(MeasuredPose(
        label=f"row {row} of {name}", key=row_key(index, name, row), point=point_of(point[n] / f),
        value=values[1][n], value_before=values[0][n],
        error=_vector(errors[1][n]), error_before=_vector(errors[0][n]),
        turn=turns[1][n], turn_before=turns[0][n],
        used=bool(keep[n]), reason=reasons[rows[n]]) for n, row in enumerate(numbers))


def _poses(model: Model, q: Array) -> Array:
    """Return the poses at joint values (R, k), a few at once; nan where there is none."""
    parts = [forward(model, q[i:i + CHUNK]).pose for i in range(0, len(q), CHUNK)]
    return np.concatenate(parts) if parts else np.zeros((0, 8))


def _size(table: Table, rows: Ints, stage: str) -> Array:
    """Return how large the error of each row's point or number is (R,), file units."""
    return norm(_residual(table, rows, stage, (*POSE_COORDINATES[:3], *number_names())).T)


def _vectors(table: Table, rows: Ints, stage: str, kind: InstrumentKind, motion: Motion) -> Array:
    """Return residuals in the measuring frame's axes (R, 3), nan where not measured.

    A number of a point, such as a height, is its coordinate that the kind shows.
    """
    vector = _residual(table, rows, stage)
    if kind.scalar and kind.of_poses:
        vector[:, kind.coordinates(motion)[0]] = table.number(f"{stage}_{kind.number}")[rows]
    return vector


def _in_base(vector: Array, registration: Registration) -> Array:
    """Return vectors in base axes (R, 3), file units; nan where nothing is known."""
    seen = np.isfinite(vector)
    turned = np.where(seen, vector, 0.0) @ cga.rotation_matrix(registration.frame)
    return np.where(np.any(seen, axis=1)[:, None], turned, np.nan)


def _lines(model: Model, data: Dataset, at: Ints, pose: Array, registration: Registration,
           point: Array) -> Array:
    """Return the unit vectors along measured distances (R, 3), base axes."""
    if data.to_q is None:
        start = np.broadcast_to(cga.translation(cga.reverse(registration.frame)), point.shape)
    else:
        start = cga.move_point(_poses(model, data.to_q[at]), registration.target)
    apart = point - start
    size = np.linalg.norm(apart, axis=1, keepdims=True)
    return np.asarray(apart / np.where(size > 0.0, size, 1.0))


def _residual(table: Table, rows: Ints, stage: str,
              columns: Sequence[str] = POSE_COORDINATES[:3]) -> Array:
    """Return residuals (R, c), file units, nan where not measured."""
    return np.stack([table.number(f"{stage}_{c}")[rows] for c in columns], axis=1)


def _vector(vector: Array) -> Point | None:
    return point_of(vector) if np.isfinite(vector).all() else None


def with_poses(mechanism: Mechanism, rows: PlacedRows, most: int
                ) -> tuple[tuple[MeasuredPose, ...], ScenePoses]:
    """Return the points with their nearest drawn pose, and the poses to draw the machine at."""
    if not rows.points:
        return (), ScenePoses((), (), rows.q)
    place = pose_vector(rows.pose)
    place[:, 3:] *= mechanism.length_scale
    worst = np.argsort([-(p.value or 0.0) if p.used else 1.0 for p in rows.points], kind="stable")
    chosen, nearest = spread_rows(place, worst[:POSES_OF_WORST].tolist(), most)
    own = set(chosen)
    points = tuple(p.changed(
        frame=chosen.index(n) if n in own else int(nearest[n]), own=n in own)
        for n, p in enumerate(rows.points))
    return points, ScenePoses([rows.points[n].label for n in chosen],
                              [rows.points[n].key for n in chosen], rows.q[chosen])


def spread_rows(place: Array, first: Sequence[int], most: int) -> tuple[list[int], Array]:
    """Return rows that lie far from each other, in order, and of each row the nearest of them.

    Args:
        place: of R rows (R, d), all of one unit.
        first: rows that are among them, unless they are at one place.
        most: so many at most.
    """
    start = [int(np.argmin(np.linalg.norm(place - place.mean(axis=0), axis=1))), *first]
    apart, chosen = np.full(len(place), np.inf), list[int]()
    while len(chosen) < min(most, len(place)):
        n = start.pop(0) if start else int(np.argmax(apart))
        if not apart[n] > 0.0:
            if not start:
                break
            continue
        chosen.append(n)
        apart = np.minimum(apart, np.linalg.norm(place - place[n], axis=1))
    chosen.sort()
    distance = np.linalg.norm(place[:, None] - place[None, chosen], axis=-1)
    return chosen, np.argmin(distance, axis=1)


def with_next(poses: ScenePoses, wanted: Table | None, mechanism: Mechanism) -> ScenePoses:
    """Return poses followed by those of next.csv, by its joint values.

    Args:
        poses: to draw the machine at.
        wanted: next.csv, in the file's units; None without one.
        mechanism: the machine.
    """
    names = [f"q_{a}" for a in mechanism.actuators]
    if wanted is None or not set(names) <= set(wanted.numbers):
        return poses
    factors = np.array([factor for factor, _ in mechanism.joint_units])
    q = np.stack([wanted.number(n) for n in names], axis=-1) * factors
    q, first = np.unique(q, axis=0, return_index=True)
    order = np.argsort(first)[:POSES_OF_NEXT]
    rows = [int(r) + 1 for r in first[order]]
    return ScenePoses([*poses.labels, *(_label(wanted, r) for r in rows)],
                      [*poses.keys, *(f"{NEXT}{r}" for r in rows)],
                      np.concatenate([poses.q, q[order]]))


def _label(wanted: Table, row: int) -> str:
    """Return which row it is, and the load it is measured under if there is one."""
    more: Sequence[str] = [f"{name} {wanted.number(name)[row - 1]:.4g}"
                           for name in ("mass", "payload", "temperature")
                           if name in wanted.numbers]
    return f"measure next, row {row}" + "".join(f", {m}" for m in more)
