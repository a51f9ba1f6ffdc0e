"""What the page makes of rows that each went well or not: of ``compensate`` and ``kinematics``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from ppmcal.calibration.compensation import KINDS
from ppmcal.io.csv import Table
from ppmcal.io.results.commands import (
    COMMAND_TABLE,
    CommandsRecord,
    accepted_sentence,
    error_sizes,
    predicted_errors,
)
from ppmcal.io.results.kinematics import (
    KINEMATICS_TABLE,
    KinematicsRecord,
    modes_sentence,
    solved_sentence,
)
from ppmcal.notes import Note
from ppmcal.plotting.canvas import Drawing
from ppmcal.report.design import scalars
from ppmcal.report.html import (
    MAX_ROWS,
    count,
    csv_cell,
    figures,
    number_cell,
    paragraph,
    sig,
    table,
    text_cell,
    whole,
)
from ppmcal.report.kinematics_figures import is_shown, kinematics_figures
from ppmcal.report.records import CheckedRows, ReportData
from ppmcal.report.residual_figures import command_figure
from ppmcal.report.section import Folder, Kind, Section, filled


def refused(rows: CheckedRows[Any]) -> Section | None:
    """Return the rows that were refused or have a remark."""
    t = rows.table
    if t is None or not rows.flagged:
        return None
    status, reason = t.words("status"), t.words("reason")
    body = [[number_cell(float(i + 1), f"{i + 1}"), text_cell(status[i]),
             text_cell(reason[i], "wrap")]
            for i in rows.flagged[:MAX_ROWS]]
    more = (f"the first {MAX_ROWS} of {whole(len(rows.flagged))}; {rows.kind}.csv has them all"
            if len(rows.flagged) > MAX_ROWS else "")
    return Section(f"{count(len(rows.flagged), 'row')} refused or with a remark",
                   table(more, ["row", "status", "reason"], body, sort=True))


def attention(rows: CheckedRows[Any], _: ReportData) -> list[tuple[str, str]]:
    """Return what the record says, and how many rows did not go well, each with the folder."""
    said = list(getattr(rows.record, "findings", ())) + list(getattr(rows.record, "notes", ()))
    if rows.flagged and rows.table is not None:
        said.append(Note(f"{whole(len(rows.flagged))} of {count(rows.table.size, 'row')} of "
                         f"{rows.kind}.csv refused or with a remark"))
    return [(rows.folder, text) for text in said]


def summed_up(rows: CheckedRows[Any], _: ReportData) -> dict[str, Any]:
    """Return the summary of commands.csv or kinematics.csv."""
    t = rows.table
    out: dict[str, Any] = {"folder": rows.folder, "record": rows.record.entries()}
    if t is None:
        return out
    good = rows.accepted
    out["rows"], out["accepted"] = t.size, int(good.sum())
    for name in (h for h in t.header if h.startswith(("error_", "sigma_"))):
        if found := error_sizes(t.number(name)[good]):
            out[name] = found._asdict()
    status, reason = t.words("status"), t.words("reason")
    out["flagged"] = [{"row": i + 1, "status": status[i], "reason": reason[i]}
                      for i in rows.flagged]
    return out


CHAPTERS = {"path": "Path", "pose": "Pose", "joints": "Joints", "rates": "Rates",
            "singularity": "Distance to singularity"}


def _of_kinematics(rows: CheckedRows[KinematicsRecord]) -> dict[str, list[Drawing]]:
    return {} if rows.table is None else kinematics_figures(rows.record, rows.table)


def kinematics_section(rows: CheckedRows[KinematicsRecord]) -> Section:
    """Return how many rows were solved, and those that were not."""
    size = rows.table.size if rows.table is not None else 0
    done = size - len(rows.flagged)
    text, modes = f"{solved_sentence(done, size)}." if size else "", rows.record.modes
    if modes is not None:
        said = modes_sentence(modes, rows.record.mode_method, rows.record.all_modes)
        text = (f"{count(sum(modes), 'pose')} in {count(len(modes), 'row')} of "
                f"joint values. {said} The machine's own is drawn.")
    parts = [Section(CHAPTERS[name], figures(drawings), count(len(drawings), "picture"),
                     folded=name in ("pose", "rates"))
             for name, drawings in _of_kinematics(rows).items()]
    return Section("Kinematics", paragraph(text) + scalars(rows.record.entries()), rows.folder,
                   parts=filled([*parts, refused(rows)]))


def _kinematics_of(folder: Folder) -> Iterator[CheckedRows[KinematicsRecord]]:
    if folder.has("kinematics.csv", "kinematics.json"):
        yield CheckedRows(folder.name, "kinematics", folder.record(KinematicsRecord), folder.table(
            KINEMATICS_TABLE, is_shown))


KINEMATICS: Kind[CheckedRows[KinematicsRecord]] = Kind(
    "kinematics", "kinematics", "kinematics", 80, ("kinematics.csv", "kinematics.json"),
    _kinematics_of, lambda r, _: [(f"Kinematics in {r.folder}", partial(kinematics_section, r))],
    summed_up, lambda r: [("kinematics", r.record)], attention, lambda r, _: _of_kinematics(r))


SHOWN = 30
"""Rows of commands.csv that are shown; the file holds them all."""


def compensation_section(rows: CheckedRows[CommandsRecord], lengths: Mapping[str, str]) -> Section:
    """Return summary, first rows and refused rows of a compensation."""
    t = rows.table
    out = []
    if t is None:
        return Section("Compensation", scalars(rows.record.entries()), rows.folder)
    good = rows.accepted
    out.append(paragraph(f"{accepted_sentence(int(good.sum()), t.size)}."))
    sizes = {(kind, stage): error_sizes(values[good]) for kind in KINDS
             for stage, values in predicted_errors(t, kind).items()}
    stats = [[text_cell(f"{kind}, {stage}"), text_cell(lengths.get(KINDS[kind], "")),
              *map(number_cell, found)] for (kind, stage), found in sizes.items() if found]
    out.append(table("Error predicted, accepted targets; corrected: the model's own uncertainty, "
                     "1 sigma", ["error", "unit", "mean", "rms", "max"], stats))
    if not any(sizes[kind, "corrected"] for kind in KINDS):
        out.append(paragraph("What corrected commands leave is unknown: the model's own "
                             "uncertainty is not in the file.", "note"))
    if parts := rows.record.parts_sentence():
        out.append(paragraph(parts))
    out.append(figures(_of_commands(rows, lengths)))
    return Section("Compensation", "".join(out), rows.folder,
                   parts=filled([_commands(t, np.flatnonzero(good)), refused(rows)]))


def _of_commands(rows: CheckedRows[CommandsRecord], lengths: Mapping[str, str]) -> list[Drawing]:
    return [p for k, q in KINDS.items()
            if (p := command_figure(rows, k, lengths.get(q, ""))) is not None]


def _commands(t: Table, rows: Sequence[int] | np.ndarray[Any, Any]) -> Section:
    """Return the first accepted rows: what was wanted, what to send, and by how much it differs."""
    sent = [h for h in t.header if h.startswith(("q_", "cmd_")) and not h.endswith("_nominal")]
    errors = [h for h in t.header if h in t.numbers
              and not h.startswith(("q_", "cmd_")) and h not in ("x", "y")]
    asked = [h for h in t.header if h in t.text or h in ("x", "y")]
    asked = [h for h in asked if h not in ("status", "reason")]
    heads = ["row", *asked]
    for s in sent:
        heads += [s, f"Δ {s}"] if f"{s}_nominal" in t.numbers else [s]
    body = []
    for i in rows[:SHOWN]:
        cells = [number_cell(float(i) + 1.0, f"{i + 1}")]
        cells += [csv_cell(t.text[h][i]) if h in t.text else number_cell(t.numbers[h][i],
                                                                sig(float(t.numbers[h][i]), 6))
                  for h in asked]
        for s in sent:
            value = float(t.numbers[s][i])
            cells.append(number_cell(value, sig(value, 7)))
            if f"{s}_nominal" in t.numbers:
                cells.append(number_cell(value - float(t.numbers[f"{s}_nominal"][i])))
        cells += [number_cell(float(t.numbers[e][i])) for e in errors]
        body.append(cells)
    more = (f"the first {SHOWN} of {whole(len(rows))} accepted targets; commands.csv has all digits"
            if len(rows) > SHOWN else "rounded; commands.csv has all digits")
    plain = [h.removeprefix("error_").replace("_", " ") if h.startswith("error_")
             else h.replace("_", " ") for h in errors]
    note = f"{more[:1].upper()}{more[1:]}. Δ: change against the uncorrected command."
    return Section("Commands", paragraph(note, "note")
                   + table("", [*heads, *plain], body, sort=True) if body else "")


def units_of(rows: CheckedRows[CommandsRecord], data: ReportData) -> Mapping[str, str]:
    """Return the units of errors: its JSON's, else those on which all identifications agree."""
    units = rows.record.units
    if units:
        return {"length": units.get("error_position_before", ""),
                "angle": units.get("error_rotation_before", "")}
    found = [i.record.units for i in data.identified]
    return asdict(found[0]) if found and all(f == found[0] for f in found) else {}


def _commands_of(folder: Folder) -> Iterator[CheckedRows[CommandsRecord]]:
    if folder.has("commands.csv", "commands.json"):
        yield CheckedRows(folder.name, "commands", folder.record(CommandsRecord),
                           folder.table(COMMAND_TABLE))


COMPENSATE: Kind[CheckedRows[CommandsRecord]] = Kind(
    "compensated", "compensations", "compensation", 40, ("commands.csv", "commands.json"),
    _commands_of, lambda r, data: [
        (f"Commands in {r.folder}", lambda: compensation_section(r, units_of(r, data)))],
    summed_up, lambda r: [("compensate", r.record)], attention,
    lambda r, data: {"commands": _of_commands(r, units_of(r, data))})
