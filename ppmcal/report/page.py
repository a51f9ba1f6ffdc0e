"""The page: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from ppmcal import __version__
from ppmcal.io.output import plain
from ppmcal.io.results.diagnosis_wording import lead as diagnosis_headline
from ppmcal.report.comparison import comparison_section
from ppmcal.report.comparison import verdict as comparison_verdict
from ppmcal.report.controllers import export_section
from ppmcal.report.design import design_headline, design_section, look_at
from ppmcal.report.diagnosis import diagnosis_section
from ppmcal.report.format import exact, listed, with_unit
from ppmcal.report.headlines import IN_THE_FIT, figure, headline, unseen
from ppmcal.report.html import amount, definitions, part, table, words
from ppmcal.report.identification import excluded_rows, identified_section
from ppmcal.report.machine_section import machine_section
from ppmcal.report.other import (
    compensation_section,
    kinematics_section,
    other_section,
    simulation_section,
    truth_section,
)
from ppmcal.report.records import (
    Columns,
    ComparedCalibrations,
    ComparedMachines,
    Identified,
    ReportData,
    ResidualRows,
)
from ppmcal.report.residuals import used, white
from ppmcal.report.section import Section, chapter, filled, page
from ppmcal.report.truth import stray_note
from ppmcal.report.validation import lead as validation_lead
from ppmcal.report.validation import validation_section
from ppmcal.report.verdict import verdicts
from ppmcal.wording import gathered
from ppmcal.wording.progress import stage

MOST_LOOKED_AT = 60
FEW = 3
"""So many parts of a calibration are open where there are several calibrations."""


@stage("drawing the page")
def to_html(data: ReportData) -> str:
    """Return the report as one self-contained page."""
    verdict = verdicts(data)
    return page(title=title(data), lead=[] if verdict else summary(data), verdicts=verdict,
                look=_look(data), chapters=chapters(data), folders=", ".join(data.folders))


def chapters(data: ReportData) -> list[Section]:
    """Return the chapters of the page in the order of the work; studies without data come last."""
    compared = {c.truth for c in data.comparisons}
    out = [chapter(f"Output in {o.folder}", partial(other_section, o)) for o in data.others]
    out += [chapter(f"Simulation in {s.folder}", partial(
        lambda s: simulation_section(s, stray_note(s, data.identified)), s))
        for s in data.simulated if s.folder not in compared]
    fits = [(chapter(f"Calibration in {one.folder}", partial(_calibration, one, n, data)), one)
            for n, one in enumerate(data.identified)]
    out += [section for section, one in fits if not one.diagnosed]
    out += [chapter(f"Diagnosis in {d.folder}", partial(diagnosis_section, d))
           for d in data.diagnosed]
    out += [section for section, one in fits if one.diagnosed]
    out += [chapter(f"Truth in {c.truth}", partial(truth_section, c)) for c in data.comparisons]
    out += [chapter(f"Commands in {r.folder}", partial(
        lambda r: compensation_section(r, units_of(r, data)), r)) for r in data.compensated]
    out += [chapter(f"Export in {e.folder}", partial(export_section, e)) for e in data.exported]
    out += [chapter(f"Validation in {v.folder}", partial(validation_section, v))
            for v in data.validated]
    out += [chapter(f"Comparison in {c.folder}", partial(comparison_section, c))
            for c in data.compared]
    out += [chapter(f"Kinematics in {r.folder}", partial(kinematics_section, r))
            for r in data.kinematics]
    several = len(data.designed) + len(data.identified) > 1
    out += [chapter(f"Error analysis in {d.folder}", partial(design_section, d, several))
            for d in data.designed]
    return [*out, chapter("Where this comes from", lambda: _provenance(data))]


def _calibration(one: Identified, n: int, data: ReportData) -> Section:
    """Return the chapter about a calibration, the machine drawn in it."""
    days = listed([d.name for d in one.record.datasets], 2)
    several = len(data.identified) > 1
    name = ": ".join(filter(None, [f"Calibration of {one.name}", days])) if several else (
        "Calibration")
    found = identified_section(one, n, name, part("tiles", _tiles(one, data)))
    drawn = chapter("The machine", lambda: Section(
        "The machine", machine_section(one, n, data.diagnosed, len(data.identified))))
    return replace(found, parts=tuple(
        replace(p, folded=p.folded or (several and i >= FEW))
        for i, p in enumerate(filled([drawn, *found.parts]))))


def title(data: ReportData) -> str:
    """Return the page's title."""
    names = list(dict.fromkeys(i.name for i in data.identified))
    if names:
        return f"Calibration report: {', '.join(names)}"
    names = list(dict.fromkeys(d.record.name for d in data.designed if d.record.name))
    return f"Error analysis: {', '.join(names)}" if names else "ppmcal report"


def summary(data: ReportData) -> list[str]:
    """Return the headline's sentences."""
    out = [s for one in data.identified for s in headline(one, data)] + _verdicts(data)
    if not out:
        parts = [(len(data.simulated), "simulation"), (len(data.diagnosed), "diagnosis"),
                 (len(data.compensated), "compensation"), (len(data.kinematics), "kinematics"),
                 (len(data.validated), "validation"), (len(data.compared), "comparison"),
                 (len(data.exported), "export"), (len(data.designed), "error analysis"),
                 (len(data.others), "further output")]
        held = ", ".join(f"{n} × {name}" if n > 1 else name for n, name in parts if n)
        out.append(f"Results found: {held}. No identification is among them.")
    return out


def _verdicts(data: ReportData) -> list[str]:
    """Return what diagnoses, comparisons and error analyses come to."""
    out = [*(validation_lead(v.record) for v in data.validated),
           *(diagnosis_headline(d.record) for d in data.diagnosed),
           *(comparison_verdict(o.record) for o in data.compared),
           *(design_headline(d) for d in data.designed)]
    return [t for t in out if t]


def _tiles(one: Identified, data: ReportData) -> list[dict[str, Any]]:
    """Return the key figures: rms of each kind of error before, and of poses no fit has seen."""
    out = []
    for kind, after in one.record.residual.after.items():
        before, found = figure(one, "before", kind).rms, unseen(one, kind, data)
        fitted = [] if after.rms is None else [with_unit(after.rms, after.unit)]
        flow = [] if before is None else [with_unit(before, after.unit)]
        flow += [found[0]] if found else fitted
        more = [f"{IN_THE_FIT} {v}" for v in fitted if found]
        if after.max is not None:
            more.append(f"largest {IN_THE_FIT} {with_unit(after.max, after.unit)}")
        if flow:
            out.append({"what": f"{kind.capitalize()}, rms before → "
                        f"{found[1] if found else IN_THE_FIT}", "flow": flow,
                        "more": " · ".join(more)})
    return out


def _look(data: ReportData) -> list[str]:
    """Return what the user must look at."""
    items = look_at(data)
    several = len({where for where, _ in items}) > 1
    lines = [f"{where}: {text}" if several else text for where in dict.fromkeys(w for w, _ in items)
             for text in gathered([t for w, t in items if w == where], "all in the JSON file")]
    more = len(lines) - MOST_LOOKED_AT
    return lines[:MOST_LOOKED_AT] + ([f"and {more} more, in the JSON files"] if more > 0 else [])


def units_of(rows: ResidualRows, data: ReportData) -> Mapping[str, str]:
    """Return the units of errors: its JSON's, else those on which all identifications agree."""
    units = rows.record.units
    if units:
        return {"length": units.get("error_position_before", ""),
                "angle": units.get("error_rotation_before", "")}
    found = [i.record.units for i in data.identified]
    return asdict(found[0]) if found and all(f == found[0] for f in found) else {}


def records(data: ReportData) -> list[tuple[str, Mapping[str, Any]]]:
    """Return every JSON that was read, as (folder: kind, record)."""
    out: list[tuple[str, Mapping[str, Any]]]
    out = [(f"{i.folder}: identify", i.record.entries()) for i in data.identified]
    out += [(f"{d.folder}: diagnose", d.record.entries()) for d in data.diagnosed]
    out += [(f"{r.folder}: {'compensate' if r.kind == 'commands' else r.kind}", r.record.entries())
            for r in (*data.compensated, *data.kinematics)]
    out += [(f"{d.folder}: {d.kind}", d.record.entries()) for d in data.designed]
    out += [(f"{o.folder}: {o.kind}", o.record.entries()) for o in data.others]
    out += [(f"{c.folder}: compare", c.record.entries()) for c in data.compared]
    out += [(f"{v.folder}: validate", v.record.entries()) for v in data.validated]
    out += [(f"{e.folder}: export", e.record.entries()) for e in data.exported]
    out += [(f"{s.folder}: simulate", s.truth.entries()) for s in data.simulated if s.truth]
    return out


def _datasets(record: Mapping[str, Any]) -> str:
    """Return the data sets of a fit."""
    rows = [[words(d.get("name")), words(d.get("kind")), words(d.get("source")),
             amount(d.get("rows"), exact(d.get("rows"))),
             amount(d.get("used"), exact(d.get("used")))]
            for d in record.get("datasets") or () if isinstance(d, Mapping)]
    return table("", ["data set", "instrument", "file", "rows", "used"], rows)


def _provenance(data: ReportData) -> Section:
    """Return versions, commands, seeds and the check sums of all inputs."""
    out = []
    for name, record in records(data):
        p = record.get("provenance") or {}
        facts = [("Command", str(p.get("command") or ""))]
        facts += [(k.capitalize(), str(p[k])) for k in
                  ("version", "seed", "numpy", "scipy", "python") if p.get(k) is not None]
        facts.append(("Method", str(record.get("method") or "")))
        inputs = [[words(f), words(h, "hash")] for f, h in (p.get("inputs") or {}).items()]
        sums = table("", ["input", "SHA-256"], inputs)
        if sums or any(v for _, v in facts):
            out.append(Section(name, definitions(facts, "Command") + _datasets(record) + sums,
                               folded=True))
    return Section("Where this comes from", parts=tuple(out))


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
        "diagnoses": [{"folder": d.folder, "diagnosis": d.record.entries(),
                       "candidates": _rows(d.effects)} for d in data.diagnosed],
        "compensations": [_table(r) for r in data.compensated],
        "kinematics": [_table(r) for r in data.kinematics],
        "simulations": [{"folder": s.folder, "truth": s.truth and s.truth.entries(),
                         "rows": s.measurements.size if s.measurements is not None else None,
                         "sha256": s.digest, "note": stray_note(s, data.identified)}
                        for s in data.simulated],
        "others": [{"folder": o.folder, "kind": o.kind, "record": o.record.entries(),
                    "rows": o.table.size if o.table is not None else None} for o in data.others],
        "designs": [{"folder": d.folder, "kind": d.kind, "record": d.record.entries(),
                     "rows": d.rows,
                     "pictures": [{"file": p.file, "caption": p.caption, "size": p.size,
                                   "problem": p.problem} for p in d.pictures]}
                    for d in data.designed],
        "validations": [{"folder": v.folder, "validation": v.record.entries()}
                        for v in data.validated],
        "comparisons": [_compared(c) for c in data.compared],
        "exports": [{"folder": o.folder, "export": o.record.entries()} for o in data.exported],
        "truth_against_identified": [_comparison(c) for c in data.comparisons],
    }
    return {k: plain(v) for k, v in out.items()}


def _identified(one: Identified) -> dict[str, Any]:
    record = one.record.entries()
    out: dict[str, Any] = {"folder": one.folder, "identification": record,
                           "parameters": record.get("parameters", ())}
    if one.residuals is not None:
        values = white(one.residuals)
        out["residuals"] = {
            "rows": one.residuals.size, "used": int(used(one.residuals).sum()),
            "white_rms": float(np.sqrt(np.mean(values**2))) if values.size else None,
            "excluded": [e.entries(whole=True) for e in excluded_rows(one)]}
    return out


def _table(rows: ResidualRows) -> dict[str, Any]:
    """Return the summary of commands.csv or kinematics.csv."""
    t = rows.table
    out: dict[str, Any] = {"folder": rows.folder, "record": rows.record.entries()}
    if t is None:
        return out
    good = np.ones(t.size, dtype=bool)
    good[list(rows.flagged)] = False
    out["rows"], out["accepted"] = t.size, int(good.sum())
    for name in (h for h in t.header if h.startswith(("error_", "sigma_"))):
        values = t.number(name)[good]
        values = values[np.isfinite(values)]
        if values.size:
            out[name] = {"mean": float(values.mean()),
                         "rms": float(np.sqrt(np.mean(values**2))), "max": float(values.max())}
    status, reason = t.words("status"), t.words("reason")
    out["flagged"] = [{"row": i + 1, "status": status[i], "reason": reason[i]}
                      for i in rows.flagged]
    return out


def _compared(c: ComparedCalibrations) -> dict[str, Any]:
    record = c.record.entries()
    return {"folder": c.folder, "comparison": record, "parameters": record.get("parameters", ())}


def _rows(table: Columns | None) -> list[dict[str, Any]]:
    """Return a small CSV row by row."""
    if table is None:
        return []
    columns: dict[str, Sequence[Any]] = {**table.text,
                                         **{k: v.tolist() for k, v in table.numbers.items()}}
    return [{h: columns[h][i] for h in table.header} for i in range(table.size)]


def _comparison(c: ComparedMachines) -> dict[str, Any]:
    return {"truth": c.truth, "identified": c.identified, "note": c.note,
            "other_nominal_values": list(c.other),
            "parameters": [{**asdict(r), "z": r.z} for r in c.rows]}
