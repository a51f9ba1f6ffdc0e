"""Tables of rows that each went well or not: what is the same of commands and kinematics."""

from __future__ import annotations

from typing import Any

from ppmcal.io.results.commands import error_sizes
from ppmcal.notes import Note
from ppmcal.report.html import MAX_ROWS, count, number_cell, table, text_cell, whole
from ppmcal.report.records import CheckedRows, ReportData
from ppmcal.report.section import Section


def refused(rows: CheckedRows) -> Section | None:
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


def attention(rows: CheckedRows, _: ReportData) -> list[tuple[str, str]]:
    """Return what the record says, and how many rows did not go well, each with the folder."""
    said = list(getattr(rows.record, "findings", ())) + list(getattr(rows.record, "notes", ()))
    if rows.flagged and rows.table is not None:
        said.append(Note(f"{whole(len(rows.flagged))} of {count(rows.table.size, 'row')} of "
                         f"{rows.kind}.csv refused or with a remark"))
    return [(rows.folder, text) for text in said]


def summed_up(rows: CheckedRows, _: ReportData) -> dict[str, Any]:
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
