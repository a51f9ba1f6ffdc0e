"""What the page makes of ``compensate``: the errors to expect, the commands, what was refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
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
from ppmcal.plotting.canvas import Drawing
from ppmcal.report.checked_rows import attention, refused, summed_up
from ppmcal.report.html import (
    csv_cell,
    figures,
    number_cell,
    paragraph,
    sig,
    table,
    text_cell,
    whole,
)
from ppmcal.report.kind import Folder, Kind
from ppmcal.report.other import scalars
from ppmcal.report.records import CheckedRows, ReportData
from ppmcal.report.residual_figures import command_figure
from ppmcal.report.section import Section, filled

SHOWN = 30
"""Rows of commands.csv that are shown; the file holds them all."""


def compensation_section(rows: CheckedRows, lengths: Mapping[str, str]) -> Section:
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
    if isinstance(rows.record, CommandsRecord) and (parts := rows.record.parts_sentence()):
        out.append(paragraph(parts))
    out.append(figures(_of_commands(rows, lengths)))
    return Section("Compensation", "".join(out), rows.folder,
                   parts=filled([_commands(t, np.flatnonzero(good)), refused(rows)]))


def _of_commands(rows: CheckedRows, lengths: Mapping[str, str]) -> list[Drawing]:
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


def units_of(rows: CheckedRows, data: ReportData) -> Mapping[str, str]:
    """Return the units of errors: its JSON's, else those on which all identifications agree."""
    units = rows.record.units
    if units:
        return {"length": units.get("error_position_before", ""),
                "angle": units.get("error_rotation_before", "")}
    found = [i.record.units for i in data.identified]
    return asdict(found[0]) if found and all(f == found[0] for f in found) else {}


def _commands_of(folder: Folder) -> Iterator[CheckedRows]:
    if folder.has("commands.csv", "commands.json"):
        yield CheckedRows(folder.name, "commands", folder.record(CommandsRecord),
                           folder.table(COMMAND_TABLE))


COMPENSATE: Kind[CheckedRows] = Kind(
    "compensated", "compensations", "compensation", 40, ("commands.csv", "commands.json"),
    _commands_of, lambda r, data: [
        (f"Commands in {r.folder}", lambda: compensation_section(r, units_of(r, data)))],
    summed_up, lambda r: [("compensate", r.record)], attention,
    lambda r, data: {"commands": _of_commands(r, units_of(r, data))})
