"""From output folders to plain data."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.folder_record import digest_of
from ppmcal.io.results.commands import CommandsRecord
from ppmcal.io.results.comparison import ComparisonRecord
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.export import ExportRecord
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.kinematics import KinematicsRecord
from ppmcal.io.results.record import AnyRecord
from ppmcal.io.results.record import Record as JsonRecord
from ppmcal.io.results.simulation import TruthRecord
from ppmcal.io.results.validation import ValidationRecord
from ppmcal.io.stage import settle
from ppmcal.report.design_records import DESIGN_FILES, designed
from ppmcal.report.measured_rows import is_condition, is_place, with_measured
from ppmcal.report.records import (
    Columns,
    ComparedCalibrations,
    ControllerExport,
    Diagnosed,
    Identified,
    Other,
    OtherDays,
    ReportData,
    ResidualRows,
    Simulated,
)
from ppmcal.report.sources import (
    is_command_number,
    is_kinematics_number,
    is_number_column,
    is_shown_of_kinematics,
    read_columns,
)
from ppmcal.report.truth import compare
from ppmcal.wording.progress import stage

COMPARE_WORDS = frozenset({"name", "unit", "status"})
"""Columns of compare.csv that are words; the others are numbers."""

ROUND_OFF = 1e-11
"""Measurements are the same where they differ by less than this part of a column's largest."""
KNOWN = ("measurements.csv", "truth.json", "identification.json", "parameters.csv",
         "residuals.csv", "identified.yaml", "diagnosis.json", "effects.csv", "commands.csv",
         "commands.json", "kinematics.csv", "kinematics.json", "check.json", "poses.csv",
         "poses.json", "map.csv", "compare.csv", "comparison.json", "export.json",
         "validation.json", *DESIGN_FILES)
"""Files by which a folder is recognised as a command's output."""


@stage("reading the results")
def collect(dirs: Sequence[Path]) -> ReportData:
    """Return what the folders hold.

    Raises:
        BadInput: no folder, a folder without any known file, or a broken file.
    """
    if not dirs:
        raise BadInput("no folder was given", "", "Name the output folders of earlier commands")
    found: dict[str, list[Any]] = {k: [] for k in ("identified", "diagnosed", "compensated",
                                                   "kinematics", "simulated", "others",
                                                   "designed", "compared", "exported", "validated")}
    unique = list({Path(d).absolute(): Path(d) for d in dirs}.values())
    for folder in unique:
        settle(folder)
        _refuse_strange(folder)
        for key, part in _parts(folder):
            found[key].append(part)
    found["simulated"] = [_with_copies(s, found["identified"]) for s in found["simulated"]]
    identified = tuple(with_measured(i, found["simulated"]) for i in found["identified"])
    parts = {k: tuple(v) for k, v in found.items() if k != "identified"}
    return ReportData(tuple(str(d) for d in unique), identified, **parts,
                      comparisons=compare(identified, found["simulated"]))


def _refuse_strange(folder: Path) -> None:
    """Refuse a path that is not a folder or holds none of the known files."""
    mend = "Name the output folder of an earlier command"
    try:
        if not folder.is_dir():
            what = "is a file, not a folder" if folder.exists() else "does not exist"
            raise BadInput(what, str(folder), mend)
        names = {p.name for p in folder.iterdir()}
        inner = sorted(p.name for p in folder.iterdir()
                       if p.is_dir() and any((p / k).is_file() for k in KNOWN))
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror or error})", str(folder), mend) from None
    if names.isdisjoint(KNOWN):
        mend = f"Looked for: {', '.join(KNOWN)}."
        if inner:
            mend += f" Did you mean its folders {', '.join(inner[:8])}?"
        raise BadInput("holds no output of a ppmcal command", str(folder), mend)


def _parts(folder: Path) -> list[tuple[str, Any]]:
    """Return the pieces of one folder, each with its place in the report."""
    name = str(folder)

    def has(*files: str) -> bool:
        return any((folder / f).is_file() for f in files)

    def table(file: str, only: Collection[str] | None = None,
              numeric: Callable[[str], bool] = is_number_column) -> Columns | None:
        wanted = None if only is None else only.__contains__
        return read_columns(folder / file, wanted=wanted, numeric=numeric) if has(file) else None

    out: list[tuple[str, Any]] = []
    if has("truth.json", "measurements.csv"):
        out.append(("simulated", _simulated(folder)))
    diagnosed = has("diagnosis.json", "effects.csv")
    fitted = has("identification.json", "parameters.csv", "identified.yaml") or (
        has("residuals.csv") and not diagnosed)
    wanted = table("next.csv") if fitted or diagnosed else None
    if fitted:
        found = _with_parameters(_record(IdentificationRecord, folder),
                                 lambda: table("parameters.csv"))
        out.append(("identified", Identified(name, found, table("residuals.csv"),
                                             diagnosed=diagnosed, next=wanted)))
    if diagnosed:
        rest = None if out and out[-1][0] == "identified" else table("residuals.csv")
        out.append(("diagnosed", Diagnosed(name, _record(DiagnosisRecord, folder),
                                           table("effects.csv"), rest, wanted)))
    if has("commands.csv", "commands.json"):
        out.append(("compensated", ResidualRows(
            name, "commands", _record(CommandsRecord, folder),
            table("commands.csv", numeric=is_command_number))))
    if has("kinematics.csv", "kinematics.json"):
        out.append(("kinematics", ResidualRows(
            name, "kinematics", _record(KinematicsRecord, folder),
            read_columns(folder / "kinematics.csv", wanted=is_shown_of_kinematics,
                         numeric=is_kinematics_number) if has("kinematics.csv") else None)))
    designs = designed(folder)
    out += [("designed", d) for d in designs]
    held = {file for d in designs for file in d.rows}
    for kind, stem in (("check", "check"), ("plan", "poses"), ("map", "map")):
        if f"{stem}.csv" not in held and has(f"{stem}.csv", f"{stem}.json"):
            found_json = folder / f"{stem}.json"
            any_record = AnyRecord.read(found_json) if found_json.is_file() else AnyRecord()
            out.append(("others", Other(name, kind, any_record, table(f"{stem}.csv", only=()))))
    if has("comparison.json", "compare.csv"):
        compared = _with_parameters(
            _record(ComparisonRecord, folder),
            lambda: table("compare.csv", numeric=lambda c: c not in COMPARE_WORDS))
        out.append(("compared", ComparedCalibrations(name, compared)))
    if has("validation.json"):
        out.append(("validated", OtherDays(name, _record(ValidationRecord, folder))))
    if has("export.json"):
        out.append(("exported", ControllerExport(name, ExportRecord.read(folder / "export.json"))))
    return out


R = TypeVar("R", bound=JsonRecord)
P = TypeVar("P", IdentificationRecord, ComparisonRecord)


def _record(kind: type[R], folder: Path) -> R:
    """Return a folder's JSON of one kind, an empty one if it is not there."""
    path = folder / kind.FILE
    return kind.read(path) if path.is_file() else kind()


def _with_parameters(record: P, table_of: Callable[[], Columns | None]) -> P:
    """Return a record that has no parameters with those of a CSV."""
    rows = None if record.parameters else table_of()
    if rows is None:
        return record
    table = [{**{k: v[i] for k, v in rows.text.items()},
              **{k: float(v[i]) if np.isfinite(v[i]) else None for k, v in rows.numbers.items()}}
             for i in range(rows.size)]
    return record.changed(parameters=type(record).checked(
        {"parameters": table}, Path(rows.source)).parameters)


def _simulated(folder: Path) -> Simulated:
    file = folder / "measurements.csv"
    here = file.is_file()
    return Simulated(str(folder), _record(TruthRecord, folder)
                     if (folder / TruthRecord.FILE).is_file() else None,
                     read_columns(file, whole=False, wanted=is_condition, numeric=is_place)
                     if here else None,
                     digest_of(file) if here else "")


def _with_copies(one: Simulated, identified: Sequence[Identified]) -> Simulated:
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
        a, b = (read_columns(p, whole=False, numeric=lambda _: False) for p in (one, other))
    except BadInput:
        return False
    return a.header == b.header and a.size == b.size and all(
        _same_column(a.words(name), b.words(name)) for name in a.header)


def _same_column(one: Sequence[str], other: Sequence[str]) -> bool:
    if tuple(one) == tuple(other):
        return True
    try:
        a, b = (np.array([float(v or "nan") for v in column]) for column in (one, other))
    except ValueError:
        return False
    largest = float(np.max(np.abs(a), initial=0.0, where=np.isfinite(a)))
    return np.allclose(a, b, rtol=0.0, atol=ROUND_OFF * largest, equal_nan=True)
