"""The report as plain data, for other programs: all records as they are, and the comparisons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ppmcal import __version__
from ppmcal.io.output import plain
from ppmcal.report.compare_section import parameters
from ppmcal.report.data import Columns, Comparison, Identified, ReportData, Rows
from ppmcal.report.design_section import look_at
from ppmcal.report.page import summary, title
from ppmcal.report.residuals import used, white
from ppmcal.report.sections import excluded_rows
from ppmcal.report.truth import stray_note


def to_json(data: ReportData) -> dict[str, Any]:
    """Return what the report says as JSON can hold it.

    The records of the commands are repeated as they are; tables with a line for each
    measurement stay in their CSV and are summed up here.
    """
    out = {
        "format": "ppmcal/report/1", "version": __version__, "title": title(data),
        "folders": list(data.folders), "headline": summary(data),
        "attention": [{"where": w, "what": t} for w, t in look_at(data)],
        "identifications": [_identified(i) for i in data.identified],
        "diagnoses": [{"folder": d.folder, "diagnosis": d.record, "candidates": _rows(d.effects)}
                      for d in data.diagnosed],
        "compensations": [_table(r) for r in data.compensated],
        "kinematics": [_table(r) for r in data.kinematics],
        "simulations": [{"folder": s.folder, "truth": s.truth,
                         "rows": s.measurements.size if s.measurements is not None else None,
                         "sha256": s.digest, "note": stray_note(s, data.identified)}
                        for s in data.simulated],
        "others": [{"folder": o.folder, "kind": o.kind, "record": o.record,
                    "rows": o.table.size if o.table is not None else None} for o in data.others],
        "designs": [{"folder": d.folder, "kind": d.kind, "record": d.record, "rows": d.rows,
                     "pictures": [{"file": p.file, "caption": p.caption, "size": p.size,
                                   "problem": p.problem} for p in d.pictures]}
                    for d in data.designed],
        "comparisons": [{"folder": o.folder, "comparison": o.record, "parameters": parameters(o)}
                        for o in data.compared],
        "exports": [{"folder": o.folder, "export": o.record} for o in data.exported],
        "truth_against_identified": [_comparison(c) for c in data.comparisons],
    }
    return {k: plain(v) for k, v in out.items()}


def _identified(one: Identified) -> dict[str, Any]:
    out: dict[str, Any] = {"folder": one.folder, "identification": one.record,
                           "parameters": one.parameters}
    if one.residuals is not None:
        values = white(one.residuals)
        out["residuals"] = {
            "rows": one.residuals.size, "used": int(used(one.residuals).sum()),
            "white_rms": float(np.sqrt(np.mean(values**2))) if values.size else None,
            "excluded": excluded_rows(one)}
    return out


def _table(rows: Rows) -> dict[str, Any]:
    """Return the summary of commands.csv or kinematics.csv."""
    t = rows.table
    out: dict[str, Any] = {"folder": rows.folder, "record": rows.record}
    if t is None:
        return out
    good = np.ones(t.size, dtype=bool)
    good[list(rows.flagged)] = False
    out["rows"], out["accepted"] = t.size, int(good.sum())
    for name in (h for h in t.header if h.startswith("error_")):
        values = t.number(name)[good]
        values = values[np.isfinite(values)]
        if values.size:
            out[name] = {"mean": float(values.mean()),
                         "rms": float(np.sqrt(np.mean(values**2))), "max": float(values.max())}
    status, reason = t.words("status"), t.words("reason")
    out["flagged"] = [{"row": i + 1, "status": status[i], "reason": reason[i]}
                      for i in rows.flagged]
    return out


def _rows(table: Columns | None) -> list[dict[str, Any]]:
    """Return a small CSV row by row."""
    if table is None:
        return []
    columns: dict[str, Sequence[Any]] = {**table.text,
                                         **{k: v.tolist() for k, v in table.numbers.items()}}
    return [{h: columns[h][i] for h in table.header} for i in range(table.size)]


def _comparison(c: Comparison) -> dict[str, Any]:
    return {"truth": c.truth, "identified": c.identified, "note": c.note,
            "parameters": [{**asdict(r), "z": r.z} for r in c.rows]}
