"""Measurement files as one campaign: unique names, shared frames, several targets of one body."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ppmcal.calibration.interpretation import without_shared
from ppmcal.errors import BadInput, unknown
from ppmcal.io.body_targets import (
    TargetPart,
    named_targets,
    refuse_unsaid,
    stands,
    wide_parts,
)
from ppmcal.io.csv import Table
from ppmcal.io.dataset_reader import dataset_of, read_files, table_path
from ppmcal.io.sidecar import SidecarFile, sidecar_path
from ppmcal.io.sidecar_values import point_of
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.sessions import as_campaigns
from ppmcal.wording.progress import stage


@stage("reading the measurements")
def read_datasets(path: str | os.PathLike[str], mechanism: Mechanism) -> list[Dataset]:
    """Return the measurements of one CSV with its sidecar, a data set for each target of the body.

    Raises:
        BadInput: as :func:`ppmcal.io.dataset_reader.read_dataset`; targets that the file does not
            have, or that the sidecar does not.
    """
    return datasets_in(*read_files(table_path(path), mechanism), mechanism)


def datasets_in(table: Table, file: SidecarFile, side: str, mechanism: Mechanism
                ) -> list[Dataset]:
    """Return the data sets of a table: one, or one for each of the sidecar's ``targets``.

    These share frame, rows, commanded poses and stands of the machine; each has its own point.

    Raises:
        BadInput: as :func:`read_datasets`.
    """
    if file.targets is None:
        refuse_unsaid(table, file, side)
        return [dataset_of(table, file, side, mechanism)]
    if not file.instrument.kind.of_poses or file.instrument.kind.blind:
        raise BadInput(f"the instrument '{file.instrument.kind}' sees no targets",
                       f"{side}: targets", "Take them out")
    long = named_targets(table, file, side)
    parts = _of_rows(*long, side, mechanism) if long else _of_columns(table, file, side, mechanism)
    body = file.name or Path(table.source).stem
    out = list[Dataset]()
    for part in parts:
        at = point_of(file.targets[part.mark], mechanism.motion, part.units, side,
                      f"targets.{part.mark}")
        frame = part.frame
        if out and frame.fitted and frame.same_as is None:
            frame = replace(frame, same_as=out[0].name)
        out.append(replace(part, name=f"{body} {part.mark}", body=body, frame=frame, target=at))
    return out


def _of_rows(table: Table, file: SidecarFile, names: Sequence[str], side: str,
             mechanism: Mechanism) -> list[Dataset]:
    """Return the parts of a table whose rows each are of one target (N,)."""
    assert file.targets is not None
    whole = dataset_of(table, file, side, mechanism)
    own = np.array(names, dtype=object)[whole.rows - 1]
    whole = replace(whole, stands=stands(whole.groups, own.tolist()))
    out = list[Dataset]()
    for name in file.targets:
        rows = np.flatnonzero(own == name)
        if not rows.size:
            raise BadInput(f"no row of the target '{name}' can be used", whole.source,
                           "Fill in its empty cells, or take it out of `targets`")
        part = replace(whole.take(rows), mark=name)
        out.append(part if not out else replace(part, findings=(), dropped=()))
    return out


def _of_columns(table: Table, file: SidecarFile, side: str, mechanism: Mechanism
                ) -> list[Dataset]:
    """Return the parts of a table with columns of each target."""
    out, told = list[Dataset](), set[str]()
    for part in wide_parts(table, file, mechanism):
        try:
            data = dataset_of(part.table, part.file, side, mechanism, part.target)
        except BadInput as error:
            raise BadInput(error.what, _place(error.where, part), error.hint) from None
        own = {column: header for header, column in part.columns.items()}
        out.append(replace(
            data, mark=part.target, wide=True, headers={**data.headers, **own}, stands=data.rows,
            headed={n: (own.get(n, h), unit) for n, (h, unit) in data.headed.items()},
            read=file.read.model_dump(exclude_unset=True),
            findings=tuple(n for n in data.findings if n not in told)))
        told |= set(data.findings)
    return out


def _place(where: str, part: TargetPart) -> str:
    """Return a place in the part of one target as it is in the file: a column by its header."""
    before, found, column = where.rpartition("column ")
    header = {own: header for header, own in part.columns.items()}.get(column)
    if header:
        return f"{before}{found}{header}"
    return where if found else f"{where} (target {part.target})"


def read_campaign(paths: Sequence[str | os.PathLike[str]], mechanism: Mechanism
                  ) -> tuple[Dataset, ...]:
    """Return the data sets of one campaign, with unique names and ``same_as`` resolved.

    A frame that is the same as one that is given is given too; a chain of ``same_as`` ends
    at the data set whose frame is fitted.

    Raises:
        BadInput: as :func:`read_datasets`; two data sets of one name, or a name in
            ``same_as`` that is not among them.
    """
    return joined([d for p in paths for d in read_datasets(p, mechanism)])


def joined(data: Sequence[Dataset]) -> tuple[Dataset, ...]:
    """Return data sets as one campaign; see :func:`read_campaign`."""
    by_name: dict[str, Dataset] = {}
    for d in data:
        if d.name in by_name:
            raise BadInput(f"two data sets are called '{d.name}' (the other is "
                           f"{by_name[d.name].source})", d.source,
                           "Give each sidecar its own `name`, and each file only once")
        by_name[d.name] = d
    return as_campaigns(without_shared([replace(d, frame=_resolve(d, by_name)) for d in data]))


def _resolve(data: Dataset, by_name: dict[str, Dataset]) -> Unknown:
    frame, seen = data.frame, [data.name]
    while frame.same_as is not None:
        source = Path(by_name[seen[-1]].source)
        # a table that is in memory has no file
        side = sidecar_path(source) if source.suffix else f"sidecar of {source}"
        place = f"{side}: frame.same_as"
        others = [n for n in by_name if n not in seen]
        if frame.same_as == seen[-1]:
            raise BadInput("a data set has its own frame, this names itself", place,
                           "Write `frame: unknown`, or name another data set" + (
                               f": {', '.join(others)}" if others else ""))
        if frame.same_as not in by_name and not others:
            raise BadInput(f"unknown data set '{frame.same_as}': no other data set is given", place,
                           f"Give '{frame.same_as}' too, or write `frame: unknown`")
        if frame.same_as not in by_name:
            error = unknown("data set", frame.same_as, others, place)
            raise BadInput(error.what, place, f"{error.hint} Give the other file too")
        if frame.same_as in seen:
            raise BadInput(f"the data sets refer to each other in a circle "
                           f"({' -> '.join([*seen, frame.same_as])})", place,
                           "Write `frame: unknown` in one of them")
        seen.append(frame.same_as)
        frame = by_name[frame.same_as].frame
    if len(seen) == 1 or not frame.fitted:
        return frame
    return Unknown(True, frame.value, seen[-1])
