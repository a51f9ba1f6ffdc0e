"""Reading a measurement file: CSV and sidecar to :class:`ppmcal.model.dataset.Dataset`, SI."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ppmcal.calibration.interpretation import (
    chance,
    steps_of,
    without_copies,
)
from ppmcal.errors import BadInput
from ppmcal.io import column_names as names
from ppmcal.io.body_targets import naming_columns
from ppmcal.io.clock import clock_of_words
from ppmcal.io.csv import Table, remark_table
from ppmcal.io.frame_definitions import by_first_pose, defined_frame
from ppmcal.io.header import MATRIX, ReadFile, bare_name, declared, header_columns, named
from ppmcal.io.measurement_columns import (
    further_columns,
    joint_values,
    measured,
    second_joints,
)
from ppmcal.io.noise_limits import refuse_noise
from ppmcal.io.reading import in_conventions, in_units
from ppmcal.io.recorded import form_of
from ppmcal.io.sidecar import SidecarFile, located, offset_of, read_sidecar, sidecar_path
from ppmcal.io.sidecar_values import actuator_noise, at_point, point_of, rotation_of, scale_of
from ppmcal.io.tables import SUFFIXES, read_table
from ppmcal.io.yaml import number_text
from ppmcal.kinematics.pose_readings import AXES, shifted_rows
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.repeats import commanded_poses, places, with_misread
from ppmcal.notes import FINDING, NOTE, Note
from ppmcal.units import Units
from ppmcal.wording import row_list

log = logging.getLogger(__package__)


def read_dataset(path: str | os.PathLike[str], mechanism: Mechanism) -> Dataset:
    """Return the measurements of one CSV with its sidecar, everything in SI.

    Args:
        path: the ``.csv``, ``.parquet`` or ``.xlsx``, or its sidecar, which has the same stem.
        mechanism: the machine, for actuator names, their units, and the motion.

    Rows that hold no joint values or nothing measured cannot be used; they are left out,
    named in ``findings``, and listed in ``dropped`` as (row, reason). With
    instrument ``distance``, ``extra["point"]`` is the fixed point as ``Unknown``, or None
    where distances are between two platform positions. Temperatures are in K.

    Raises:
        BadInput: anything wrong in either file, with file, place and hint.
    """
    return dataset_of(*read_files(table_path(path), mechanism), mechanism)


def table_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of a table, which has the stem of its sidecar where that is given."""
    csv_path = Path(path)
    if csv_path.suffix in (".yaml", ".yml"):
        suffixes = [s for s in SUFFIXES if csv_path.with_suffix(s).exists()]
        csv_path = csv_path.with_suffix((*suffixes, ".csv")[0])
    return csv_path


def read_files(path: Path, mechanism: Mechanism) -> tuple[Table, SidecarFile, str]:
    """Return a table, its sidecar, and that one's path; what nobody needs may be words.

    Raises:
        BadInput: as :func:`ppmcal.io.tables.read_table` and :func:`read_sidecar`.
    """
    header: Sequence[str] = ()
    if not sidecar_path(path).is_file():
        # what is wrong with the table comes first
        header = read_table(path, loose=may_be_words(ReadFile(), mechanism)).header
    file, side = read_sidecar(path, header)
    loose = may_be_words(file.read, mechanism, file.instrument.kind)
    return read_table(path, loose=loose, sheet=file.read.sheet), file, side


def may_be_words(read: ReadFile, mechanism: Mechanism, kind: InstrumentKind | None = None
                 ) -> Callable[[str], bool]:
    """Return what says of a header whether the column may hold words: labels, what nobody needs."""
    words = {*names.LABELS, *read.ignore, *naming_columns(read),
             *(h for own, h in read.columns.items() if own in names.LABELS)}
    known = [*names.known_columns(mechanism, kind), *MATRIX, *mechanism.actuators,
             *read.columns.values()]

    def loose(header: str) -> bool:
        return header in words or (header not in known
                                   and names.is_nobodys(bare_name(header), known))

    return loose


def dataset_of(table: Table, file: SidecarFile, side: str, mechanism: Mechanism,
               mark: str = "") -> Dataset:
    """Return a table of measurements as a data set, with what its sidecar ``side`` says.

    ``mark``: the target that it is of, where the file has several.
    """
    file = located(file, mechanism, side)
    source, units, read = table.source, file.units.units(), file.read
    kind = file.instrument.kind
    known = [*names.known_columns(mechanism, kind), *MATRIX]
    columns, findings = header_columns(table, read, mechanism, side, kind)
    convention = read.rotation or (
        "quat-xyzw" if any(c.name == "quat_x" for c in columns) else "rotvec")
    headers = {c.name: c.called for c in columns if c.name != c.called}
    headed = {c.name: (c.header, c.unit) for c in columns if c.unit}
    strange, more = names.strangers({c.name: table.text.get(c.header) for c in columns}, mechanism,
                                    known, source)
    columns, findings = [c for c in columns if c.name not in strange], [*findings, *more]
    table = _in_seconds(named(table, columns), read)
    columns = declared(columns, table, read, side)
    recorded = form_of(table, columns, read, mechanism, units)
    plain = in_units(table, columns, read, mechanism, units, kind)
    table = in_conventions(plain, read, mechanism, units, side)
    names.check_columns(table.header, mechanism, source, kind)
    findings += names.ambiguous_directions(table.header, mechanism, source)
    joint = mechanism.joint_factors(units)
    with names.offering(strange, mark):
        q, commanded = joint_values(table, mechanism, units, joint)
        seen, unused = measured(table, mechanism, file, side)
    sigma_actuator = actuator_noise(file.instrument.sigma.actuator, mechanism, joint, side)
    conditions = further_columns(table, mechanism, joint)
    approach, more = _approach(file, table)
    to_q = second_joints(table, mechanism, joint, kind)
    labels = _groups(table)
    meant = labels if not kind.blind or "pose" in table.header else places(q, sigma_actuator,
                                                                           mechanism.surplus)
    groups = commanded_poses(meant, q, (to_q, commanded), sigma_actuator, kind.touches)
    if kind.blind:
        groups = with_misread(groups, meant, q, sigma_actuator)
    data = Dataset(
        name=file.name or Path(source).stem, source=source, kind=kind,
        rows=np.arange(1, len(table) + 1, dtype=np.int64), q=q, commanded=commanded,
        **seen, to_q=to_q, sigma_actuator=sigma_actuator, groups=groups, labels=labels,
        columns=conditions, sessions=_sessions(table),
        frame=defined_frame(file, mechanism, units, side),
        target=point_of(file.target, mechanism.motion, units, side),
        target_rotation=rotation_of(file.target_rotation, units, side),
        scale=scale_of(file.scale, kind, side),
        offset=offset_of(file.instrument, units, side),
        estimated=file.instrument.sigma.estimated, homing=file.homing,
        approach=approach, findings=(*findings, *unused, *more,
                                     *_contradicted(labels, groups, source)),
        extra=_fixed_point(file, to_q, mechanism, units, side), units=units,
        convention=convention, read=read.model_dump(exclude_unset=True),
        headers=headers, headed=headed, recorded=recorded)
    kind.refuse(mechanism.motion, mechanism.surplus, side, mechanism.gravity)
    refuse_noise(data, mechanism, side)
    _remark(data, table, file, side)
    data = replace(data, chance=chance(data, steps_of(plain.numbers, data, mechanism.reach)))
    data = _usable(shifted_rows(_from_point(data, side), read.shift), mechanism, mark)
    return without_copies(by_first_pose(data, file, mechanism, side))


def _in_seconds(table: Table, read: ReadFile) -> Table:
    """Return the table with its times in s since the first where they are of a clock."""
    if "time" not in table.text:
        return table
    clock = clock_of_words(table.text["time"], lambda i: table.at("time", i), read.dates, read.zone)
    return table.put({"time": clock.seconds - clock.first})


def _from_point(data: Dataset, side: str) -> Dataset:
    """Return distances with the fixed point, of the measuring frame, as that frame's origin."""
    if not data.kind.along_line:
        return data
    point = data.extra["point"]
    if point is None:
        return replace(data, frame=Unknown(False, np.zeros(6)))
    assert isinstance(point, Unknown)
    if data.frame.same_as is not None:
        raise BadInput("distances cannot share a frame: the point that they are measured from "
                       "is their frame's origin", f"{side}: frame.same_as",
                       "Write `frame: known` and the point in the base frame, or `point: unknown`")
    return replace(data, frame=at_point(data.frame, point))


def _fixed_point(file: SidecarFile, to_q: Array | None, mechanism: Mechanism, units: Units,
                 side: str) -> dict[str, object]:
    """Return ``{"point": Unknown}`` for distances from a fixed point."""
    if not file.instrument.kind.along_line:
        return {}
    if to_q is not None:
        return {"point": None}
    if file.instrument.point is None:
        raise BadInput("distances need the point they are measured from",
                       f"{side}: instrument.point",
                       "Write `point: [x, y, z]` or `point: unknown` under `instrument`, or give "
                       "to_q_ columns for distances between two platform positions")
    return {"point": point_of(file.instrument.point, mechanism.motion, units, side,
                              "instrument.point")}


def _approach(file: SidecarFile, table: Table) -> tuple[str, list[Note]]:
    have = any(name.startswith("dir_") for name in table.header)
    if file.approach is None:
        return "columns" if have else "unknown", []
    if file.approach == "columns" and not have:
        return "unknown", [Note(
            f"{table.source}: the sidecar says `approach: columns`, but there are no dir_ columns; "
            "the direction of approach is taken as unknown.")]
    return file.approach, []


def _groups(table: Table) -> NDArray[np.int64]:
    """Return a label per commanded pose (N,), numbered in order of appearance."""
    n = len(table)
    if "pose" not in table.header:
        return np.arange(n, dtype=np.int64)
    labels: list[object]
    if "pose" in table.text:
        labels = [i if c.lower() in ("", "nan") else c for i, c in enumerate(table.text["pose"])]
        number: dict[object, int] = {}
        return np.array([number.setdefault(c, len(number)) for c in labels], dtype=np.int64)
    values = table.numbers["pose"]
    alone = np.isnan(values)
    _, first, inverse = np.unique(values[~alone], return_index=True, return_inverse=True)
    where = np.flatnonzero(~alone)
    start = np.arange(n, dtype=np.int64)
    start[~alone] = where[first][inverse]
    return np.asarray(np.unique(start, return_inverse=True)[1], dtype=np.int64)


def _contradicted(labels: NDArray[np.int64], groups: NDArray[np.int64], source: str) -> list[Note]:
    """Return that rows (N,) of one label are of different poses by their joints, if some are."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    apart = np.flatnonzero(groups != groups[first[inverse.reshape(-1)]])
    if not apart.size:
        return []
    count, other = np.unique(labels[apart]).size, int(apart[0])
    earlier = int(first[inverse.reshape(-1)[other]])
    reused = "one label stands" if count == 1 else f"{count} of {first.size} labels stand"
    return [Note(
        f"{source}, column pose: {reused} for different joint values (first at rows "
        f"{earlier + 1} and {other + 1}); such rows are not repeats, and count as separate "
        "poses. Give each commanded pose its own label.")]


def _sessions(table: Table) -> tuple[str, ...] | None:
    if "session" in table.text:
        return tuple("" if c.lower() == "nan" else c for c in table.text["session"])
    if "session" not in table.numbers:
        return None
    values, inverse = np.unique(table.numbers["session"], return_inverse=True)
    words = ["" if np.isnan(v) else number_text(float(v)) for v in values]
    return tuple(words[i] for i in inverse)


def _usable(data: Dataset, mechanism: Mechanism, mark: str) -> Dataset:
    """Leave out rows that hold no joint values or nothing measured, and say so."""
    seen = np.isfinite(np.column_stack([data.position, data.rotation, data.value])).any(axis=1)
    seen |= data.kind.blind
    joints, lacking = np.isfinite(data.q).all(axis=1), "a joint value is missing"
    if data.commanded is not None:
        given = np.isfinite(data.commanded[:, list(mechanism.dof)]).sum(axis=1)
        joints, lacking = given >= mechanism.freedoms, "a commanded coordinate is missing"
    if data.to_q is not None:
        joints &= np.isfinite(data.to_q).all(axis=1)
    findings, dropped = list(data.findings), list[tuple[int, str]]()
    for bad, reason in ((~joints, lacking),
                        (joints & ~seen, "nothing was measured" + f" of {mark}" * bool(mark))):
        rows = np.flatnonzero(bad)
        if rows.size:
            # of several targets one is hidden now and then
            findings.append(Note(
                f"{data.source}: {row_list(data.rows[rows] - 1)}: {reason}; left out.",
                NOTE if mark and reason != lacking else FINDING))
            dropped += [(int(i), reason) for i in data.rows[rows]]
    findings += _partly_empty(data, mechanism, np.asarray(joints & seen))
    if not dropped:
        return replace(data, findings=tuple(findings))
    keep = np.asarray(joints & seen)
    if not keep.any():
        commands = "joint values" if data.commanded is None else "a commanded pose"
        raise BadInput(f"no row has both {commands} and a measurement", data.source,
                       "Fill in the empty cells")
    return replace(data.take(keep), findings=tuple(findings),
                   dropped=tuple(sorted(dropped)))


def _partly_empty(data: Dataset, mechanism: Mechanism, used: Bools) -> Iterator[Note]:
    """Yield the empty cells of a point of which other coordinates are used, in rows (N,)."""
    if data.kind.scalar:
        return
    at = [c for c in data.kind.coordinates(mechanism.motion) if c < len(AXES)]
    missing = ~np.isfinite(data.position[:, at])
    for c, own in zip(at, missing.T, strict=True):
        rows = own & used & ~missing.all(axis=1)
        if rows.any() and not own.all():
            column = AXES[c]
            yield Note(f"{data.source}: {row_list(data.rows[rows] - 1)}: "
                       f"{data.headers.get(column, column)} is empty; what else was measured there "
                       "is used.", NOTE)


def _remark(data: Dataset, table: Table, file: SidecarFile, side: str) -> None:
    """Log what a table of measurements and its sidecar were taken to mean."""
    if not log.isEnabledFor(logging.INFO):
        return
    remark_table(table)
    sigma = ", ".join(f"{name} {value:g}" for name, value in
                      file.instrument.sigma.model_dump().items()
                      if isinstance(value, float | int) and not isinstance(value, bool) and value)
    log.info("%s: units %s and %s; instrument %s, sigma %s; frame %s, target %s; approach %s%s",
             side, file.units.length, file.units.angle, data.kind, sigma or "from columns",
             _state(data.frame), _state(data.target), data.approach,
             " (by default)" if file.approach is None else "")
    if data.headers or data.read:
        renamed = ", ".join(f"{own} from '{theirs}'" for own, theirs in data.headers.items())
        log.info("%s: read with %s", table.source, "; ".join(
            part for part in (renamed, str(data.read) if data.read else "") if part))


def _state(place: Unknown) -> str:
    if place.same_as is not None:
        return f"that of {place.same_as}"
    return "fitted" if place.fitted else "known"
