"""Several targets of one body in one file: a column that names each row's, or columns of each.

The sidecar says which there are, and where they are on the platform, in place of `target`::

    targets: {T1: unknown, T2: [10, 0, 5], T3: unknown}

In a long file a row is of one target, and a column `target` names it; in a wide one a row is of
one pose, with columns `T1_x, T1_y, T1_z, T2_x, ...` (or `T1x`, or `x_T1`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from ppmcal.errors import BadInput, unknown
from ppmcal.io.column_names import plain_heading
from ppmcal.io.csv import Table, refuse_double
from ppmcal.io.header import ReadFile, bare_name
from ppmcal.io.pose_fields import COORDINATES, QUATERNION
from ppmcal.io.sidecar import SidecarFile
from ppmcal.linalg import Ints
from ppmcal.model.instruments import InstrumentKind, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import abbreviate_list

NAMING = ("target", "target name", "reflector", "mark", "point", "point name")
"""Headings of the column that names each row's target, once the sidecar says there are several."""
SURELY = NAMING[:4]
"""Those that are of nothing else."""
BETWEEN = "[ _.-]?"


@dataclass(frozen=True)
class TargetPart:
    """What a wide file has of one target: a table as if it were the only one.

    ``columns``: header -> our column, of those that are its own.
    """

    target: str
    table: Table
    file: SidecarFile
    columns: Mapping[str, str]


def naming_columns(read: ReadFile) -> list[str]:
    """Return the headers that the sidecar names as the column of targets' names."""
    return [read.columns["target"]] if "target" in read.columns else []


def named_targets(table: Table, file: SidecarFile, side: str) -> tuple[Table, SidecarFile,
                                                                       tuple[str, ...]] | None:
    """Return a long file without its column of targets, and the target of each row (N,).

    None where no column names targets.

    Raises:
        BadInput: a name that the sidecar does not have or the file does not, a cell without one,
            or rows that are to be shifted.
    """
    header = naming(table, file.read)
    if header is None:
        return None
    place = f"{side}: targets"
    names = tuple(n.strip() for n in table.labels(header))
    empty = np.array([n.lower() in ("", "nan") for n in names])
    table.refuse_rows(empty, header, "no target is named", "Name the target that was measured")
    targets = _targets(file)
    for i, name in enumerate(names):
        if name not in targets:
            error = unknown("target", name, targets, table.at(header, i))
            raise BadInput(error.what, table.at(header, i),
                           f"{error.hint} The sidecar has them under `targets`")
    for name in targets:
        if name not in names:
            raise BadInput(f"no row is of the target '{name}'", f"{place}.{name}",
                           f"Take it out; the column {header} names "
                           f"{abbreviate_list(list(dict.fromkeys(names)))}")
    if file.read.shift:
        raise BadInput("rows that each name their target cannot be shifted against the joints",
                       f"{side}: read.shift", "Take it out, and put the rows right in the file")
    columns = {k: v for k, v in file.read.columns.items() if k != "target"}
    return table.without((header,)), _reading(file, columns=columns), names


def _targets(file: SidecarFile) -> Mapping[str, Any]:
    assert file.targets is not None
    return file.targets


def _reading(file: SidecarFile, **changed: Any) -> SidecarFile:
    return file.model_copy(update={"read": file.read.model_copy(update=changed)})


def naming(table: Table, read: ReadFile) -> str | None:
    """Return the header of the column that names targets, None without one."""
    given = naming_columns(read)
    if given:
        if given[0] not in table.header:
            raise BadInput(f"{table.source} has no column '{given[0]}'", "read.columns.target",
                           f"Its columns are {', '.join(table.header)}")
        return given[0]
    free = [h for h in table.header if h not in read.ignore and h not in read.columns.values()]
    return next((h for name in NAMING for h in free if plain_heading(h) == name), None)


def wide_parts(table: Table, file: SidecarFile, mechanism: Mechanism) -> list[TargetPart]:
    """Return a table for each target of a wide file, in the order of the sidecar.

    Raises:
        BadInput: a target without columns, or with two for one coordinate, or a coordinate that
            nobody says the target of.
    """
    known = _coordinates(mechanism, file.instrument.kind)
    targets, read = _targets(file), file.read
    renamed = {header: own for own, header in read.columns.items()}
    own: dict[str, dict[str, str]] = {name: {} for name in targets}
    for header in table.header:
        if header not in read.ignore:
            for name, column in _found(renamed.get(header, bare_name(header)), targets, known):
                own[name][header] = column
    _refuse_unclear(table, own, known)
    every = {h: f"{name}_{c}" for name, columns in own.items() for h, c in columns.items()}
    out = []
    for name, columns in own.items():
        names = {h: columns.get(h, "") + h[len(bare_name(h)):] if h in columns else h
                 for h in table.header if h in columns or h not in every}
        out.append(TargetPart(name, table.named(names), _reading(
            file, **_read_of(table, read, columns, every)), columns))
    return out


def _coordinates(mechanism: Mechanism, kind: InstrumentKind) -> list[str]:
    seen = list(dict.fromkeys((*COORDINATES, *QUATERNION, *number_names(),
                               *kind.columns(mechanism.motion))))
    return [*seen, *(f"sigma_{c}" for c in (*seen, "position", "rotation"))]


def _found(header: str, targets: Mapping[str, Any], known: Sequence[str]
           ) -> list[tuple[str, str]]:
    """Return which target's which coordinate a header may be, none where it is of no target."""
    out = []
    for name in targets:
        mine = re.escape(name)
        found = re.fullmatch(f"{mine}{BETWEEN}(?P<c>[A-Za-z_]+)", header) or re.fullmatch(
            f"(?P<c>[A-Za-z_]+?){BETWEEN}{mine}", header)
        spread = re.fullmatch(f"sigma_{mine}{BETWEEN}(?P<c>[A-Za-z_]+)", header)
        column = f"sigma_{spread['c'].lower()}" if spread else found["c"].lower() if found else ""
        if column in known:
            out.append((name, column))
    return out


def _refuse_unclear(table: Table, own: Mapping[str, Mapping[str, str]], known: Sequence[str]
                    ) -> None:
    place = f"{table.source}: header"
    for name, columns in own.items():
        if not columns:
            raise BadInput(f"no column is of the target '{name}'", place,
                           f"Call its columns {name}_x, {name}_y, {name}_z; or give a column "
                           "`target` that names the target of each row")
        refuse_double([*columns.values()], place, "Rename or remove one of them",
                      f"columns of the target '{name}'")
    taken = [h for columns in own.values() for h in columns]
    for header in table.header:
        if taken.count(header) > 1:
            raise BadInput("it may be of two targets", f"{place}, column {header}",
                           "Rename the targets, or the column")
        if header not in taken and bare_name(header) in known and not bare_name(
                header).startswith("sigma"):
            raise BadInput("other columns say of which target they are, this one does not",
                           f"{place}, column {header}",
                           f"Call it {next(iter(own))}_{bare_name(header)}, or write "
                           f"`ignore: [{header}]` under `read` in the sidecar")


def _read_of(table: Table, read: ReadFile, mine: Mapping[str, str], every: Mapping[str, str]
             ) -> dict[str, Any]:
    """Return the sidecar's block as it is for the columns of one target, by its fields.

    ``mine``: header -> our column, of the target; ``every``: headers of all targets -> what these
    columns may be called too, however they are spelt: ``T1_x``.
    """
    called = {h: own for own, h in read.columns.items()}
    names = {h: called.get(h, bare_name(h)) for h in table.header}

    def hits(pattern: str) -> set[str]:
        """Return the headers that a name or a pattern of the sidecar is of."""
        return {h for h, name in names.items() if fnmatchcase(name, pattern)
                or fnmatchcase(every.get(h, name), pattern)}

    out: dict[str, Any] = {
        "columns": {own: h for own, h in read.columns.items() if h not in every}}
    for field in ("units", "signs"):
        said: dict[str, Any] = {}
        for pattern, value in getattr(read, field).items():
            hit = hits(pattern)
            others = hit - every.keys()
            if others or not hit:
                # columns of targets are named one by one, for a pattern may be of several
                said |= ({names[h]: value for h in others} if hit & every.keys()
                         else {pattern: value})
            said |= {mine[h]: value for h in hit if h in mine}
        out[field] = said
    return out


def refuse_unsaid(table: Table, file: SidecarFile, side: str) -> None:
    """Refuse a file that seems to be of several targets where the sidecar has one.

    Raises:
        BadInput: with what to write.
    """
    free = [h for h in table.header if h not in file.read.ignore
            and h not in file.read.columns.values()]
    found: list[str] = []
    where = ""
    for header in free:
        if plain_heading(header) in SURELY:
            each = list(dict.fromkeys(table.labels(header)))
            if 1 < len(each) <= len(table) / 2:
                found, where = each, f"the column {header} names several targets"
    axes = {bare_name(h).lower() for h in table.header}
    if not found and not axes & {"x", "y"} and not set("xy") & set(file.read.columns):
        pairs = (re.fullmatch(f"(.*[0-9A-Za-z]){BETWEEN}x", bare_name(h)) for h in free)
        names = [p[1] for p in pairs if p]
        # x, y, z and w are a rotation, no place
        found = [n for n in names if _has(free, n, "y") and not _has(free, n, "w")]
        found, where = (found, "columns are of several targets") if len(found) > 1 else ([], "")
    if found:
        written = ", ".join(f"{n}: unknown" for n in found[:4]) + (", ..." if found[4:] else "")
        raise BadInput(f"{where}, and the sidecar has one `target`", f"{side}: target",
                       f"Write `targets: {{{written}}}` in its place, with the point [x, y, z] of "
                       "those whose place on the platform is known")


def _has(headers: Sequence[str], name: str, axis: str) -> bool:
    return any(re.fullmatch(f"{re.escape(name)}{BETWEEN}{axis}", bare_name(h)) for h in headers)


def stands(group: Ints, target: Sequence[str]) -> Ints:
    """Return a label (N,) per stand of the machine, each target once in it.

    Rows one after the other of one commanded pose were measured at one stand; what is measured
    again there is another one's.

    Args:
        group: commanded pose of the rows (N,), in their order.
        target: which was measured (N,).

    >>> stands(np.array([0, 0, 0, 1, 1, 0]), ["a", "b", "a", "a", "b", "a"]).tolist()
    [0, 0, 1, 2, 2, 3]
    """
    stay = np.concatenate([[0], np.cumsum(np.diff(group) != 0)]) if group.size else group
    number: dict[tuple[int, int], int] = {}
    count: dict[tuple[int, str], int] = {}
    out = np.zeros(group.size, dtype=np.int64)
    for i, (at, name) in enumerate(zip(stay.tolist(), target, strict=True)):
        again = count[at, name] = count.get((at, name), -1) + 1
        out[i] = number.setdefault((at, again), len(number))
    return out

