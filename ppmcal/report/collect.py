"""From output folders to plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.results.simulation import ComparedMachines, compared
from ppmcal.io.tables import read_table
from ppmcal.linalg import Array
from ppmcal.report.kinds import KINDS, KNOWN
from ppmcal.report.records import Identified, ReportData, Simulated
from ppmcal.report.rows import with_measured
from ppmcal.report.section import Folder
from ppmcal.store.folder import CAMPAIGNS, RECORD
from ppmcal.store.inputs import digest_of
from ppmcal.store.transaction import recover
from ppmcal.wording.progress import stage

ROUND_OFF = 1e-11
"""Measurements are the same where they differ by less than this part of a column's largest."""


@stage("reading the results")
def collect(dirs: Sequence[Path]) -> ReportData:
    """Return what the folders hold.

    Raises:
        BadInput: no folder, a folder without any known file, or a broken file.
    """
    if not dirs:
        raise BadInput("no folder was given", "", "Name the output folders of earlier commands")
    unique = list({Path(d).absolute(): Path(d) for d in dirs}.values())
    parts: dict[str, Any] = {kind.place: () for kind in KINDS}
    for path in unique:
        recover(path)
        _refuse_strange(path)
        folder = Folder(path)
        for kind in KINDS:
            parts[kind.place] += tuple(kind.read(folder))
    found = ReportData.of(tuple(map(str, unique)), parts)
    simulated = tuple(with_copies(s, found.identified) for s in found.simulated)
    identified = tuple(with_measured(i, simulated) for i in found.identified)
    return replace(found, simulated=simulated, identified=identified,
                   comparisons=compare(identified, simulated))


def results_of(dirs: Sequence[Path]) -> list[Path]:
    """Return folders of results, with those within a batch in place of the batch's own.

    Raises:
        BadInput: a batch without any result, or a folder that cannot be read.
    """
    out = list[Path]()
    for path in dirs:
        if not (path / CAMPAIGNS).is_file():
            out.append(path)
            continue
        found = _results_below(path)
        if not found:
            raise BadInput("is the folder of a batch of which no campaign has a result", str(path),
                           "batch.html in it says why")
        out += found
    return out


def _results_below(folder: Path) -> list[Path]:
    """Return the folders of results in the folder of a batch: machine, date, command."""
    try:
        return sorted({p.parent for p in folder.glob(f"*/*/*/{RECORD}")
                       if any((p.parent / name).is_file() for name in KNOWN)})
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror or error})", str(folder),
                       "Name the output folder of an earlier command") from None


def _refuse_strange(folder: Path) -> None:
    """Refuse a path that is not a folder or holds none of the known files."""
    hint = "Name the output folder of an earlier command"
    try:
        if not folder.is_dir():
            what = "is a file, not a folder" if folder.exists() else "does not exist"
            raise BadInput(what, str(folder), hint)
        names = {p.name for p in folder.iterdir()}
        inner = sorted(p.name for p in folder.iterdir()
                       if p.is_dir() and any((p / k).is_file() for k in KNOWN))
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror or error})", str(folder), hint) from None
    if CAMPAIGNS in names:
        first = next(iter(_results_below(folder)), None)
        single = "" if first is None else f", or name folders of single results, such as {first}"
        raise BadInput("is the folder of a batch", str(folder),
                       f"Its page is batch.html in it: open that{single}")
    if names.isdisjoint(KNOWN):
        hint = f"Looked for: {', '.join(KNOWN)}."
        if inner:
            hint += f" Did you mean its folders {', '.join(inner[:8])}?"
        raise BadInput("holds no output of a ppmcal command", str(folder), hint)


def compare(identified: Sequence[Identified], simulated: Sequence[Simulated]
            ) -> tuple[ComparedMachines, ...]:
    """Return one comparison for each identification whose measurements were simulated here."""
    found = [compared(source.truth, one.record.parameters, (source.folder, one.folder))
             for one in identified for source in simulated
             if source.truth is not None and source.behind(one)]
    return tuple(c for c in found if c.rows)


def with_copies(one: Simulated, identified: Sequence[Identified]) -> Simulated:
    """Find the inputs of identifications that hold the same measurements to round-off."""
    if one.truth is None or not one.digest:
        return one
    file, copies = Path(one.folder) / "measurements.csv", set[str]()
    for fit in identified:
        copies |= {own for name, own in fit.record.provenance.inputs.items()
                   if name.endswith(".csv") and own not in ("", one.digest)
                   and digest_of(Path(name)) == own and _same_numbers(file, Path(name))}
    return replace(one, copies=tuple(sorted(copies)))


def _same_numbers(one: Path, other: Path) -> bool:
    """Whether two CSV files have the same columns, and numbers that differ by round-off at most."""
    try:
        a, b = (read_table(p, loose=lambda _: True, rowless=True) for p in (one, other))
    except BadInput:
        return False
    return (a.header, a.size, a.text) == (b.header, b.size, b.text) and all(
        _same_column(a.numbers[name], b.numbers[name]) for name in a.numbers)


def _same_column(one: Array, other: Array) -> bool:
    largest = float(np.max(np.abs(one), initial=0.0, where=np.isfinite(one)))
    return np.allclose(one, other, rtol=0.0, atol=ROUND_OFF * largest, equal_nan=True)
