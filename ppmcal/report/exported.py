"""The section about an export: what the controller takes, what it gains, what it cannot hold."""

from __future__ import annotations

from functools import partial
from typing import Any

from ppmcal.io.results.export import (
    CommandErrors,
    ExportRecord,
    error_size,
)
from ppmcal.io.results.parts import ErrorSize
from ppmcal.plotting.bars import Chart, Row
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.style import SMALLEST
from ppmcal.report.html import (
    MAX_ROWS,
    bullets,
    count,
    figures,
    name_cell,
    number,
    number_cell,
    paragraph,
    part,
    sig,
    table,
    text_cell,
)
from ppmcal.report.records import Held, ReportData
from ppmcal.report.section import Kind, Section, filled, recorded
from ppmcal.report.verdict import verdicts
from ppmcal.wording import sentence

STAGES = (("before", "old"), ("after", "new"))
ERRORS = (("rms", "rms"), ("max", "at most"))
"""Keys, and their names in a sentence."""


def export_section(one: Held[ExportRecord], led: bool = False) -> Section:
    """Return everything about one export; ``led``: the page begins with its verdict already."""
    r = one.record
    notes = [sentence(n) for n in (*r.notes, *r.advice)]
    verdict = "" if led else paragraph(r.judged, "big")
    head = verdict + _lines(r) + paragraph(_said(r), "" if verdict or led else "big")
    return Section(f"Export: {r.called}", head + _numbers(r), one.folder,
                   parts=filled([_gain(r), _not_expressed(r),
                                 Section("Notes", bullets(notes)) if notes else None]))


def _led(one: Held[ExportRecord], data: ReportData) -> bool:
    """Return whether the page begins with the verdict of its only export."""
    return bool(one.record.judged) and len(data.exported) == 1 and not verdicts(data)


def _said(r: ExportRecord) -> str:
    head = f"{r.name or r.called}: "
    written = f" Written: {', '.join(r.files)}." if r.files else ""
    if r.summary:
        return f"{head}{r.summary.rstrip('.')}.{written}"
    return (f"{head}written for {r.called}, which holds {'all' if r.exact else 'most'} of it."
            f"{written}")


def _lines(r: ExportRecord) -> str:
    """Return the lines to paste, empty where there are none or many."""
    if not r.lines:
        return ""
    file = r.files[0] if r.files else "the file"
    return paragraph(f"Lines to paste, in {file}:") + part("lines", r.lines)


def _numbers(r: ExportRecord) -> str:
    """Return what is written: old, new and change, and how well it is known."""
    rows, known = [], bool(r.number_half)
    for name, new in r.parameters.items():
        was, now = number(r.old.get(name)), number(new)
        change = None if was is None or now is None else now - was
        half = number(r.number_half.get(name))
        rows.append([name_cell(name), number_cell(was, fixed(was)), number_cell(now, fixed(now)),
                     number_cell(change, fixed(change, plus=True)),
                     *[number_cell(half, "–" if half is None else sig(half, 3))] * known,
                     text_cell(r.number_units.get(name, ""))])
    more = (f"the first {MAX_ROWS} of {len(rows)}, export.json has them all"
            if len(rows) > MAX_ROWS else "")
    caption = "; ".join(t for t in ("What is written, in the controller's own numbers", more) if t)
    head = ["parameter", "old", "new", "change", *["± 95 %"] * known, "unit"]
    note = paragraph(r.intervals_sentence().replace("+-", "±"), "note") if known else ""
    return table(caption, head, rows[:MAX_ROWS], sort=True) + note


def _gain(r: ExportRecord) -> Section | None:
    """Return the errors predicted with the old numbers and with the new ones."""
    rows = []
    for kind in ("position", "rotation"):
        for stage, name in STAGES:
            part = _errors(r, stage, kind)
            values = [getattr(part, key) for key, _ in ERRORS]
            if any(number(v) is not None for v in values):
                rows.append([text_cell(f"{kind}, {name}, model exact"),
                             text_cell(part.unit),
                             *(number_cell(v, error_size(v, part.unit) or "–") for v in values)])
    for label, whole in (("old", r.expected_before), ("new", r.expected_after)):
        for kind, size in (("position", whole), ("rotation", whole.rotation)):
            if size is not None and number(size.rms) is not None:
                rows.append([text_cell(f"{kind}, {label}, expected"), text_cell(size.unit),
                             number_cell(size.rms, error_size(size.rms, size.unit)),
                             number_cell(None, "")])
    if not rows:
        return None
    over = f", over {r.over.rstrip('.')}" if r.over else ""
    note = (f"The machine driven through the controller's arithmetic{over}, if the model is "
            "exact; expected: with the model's own uncertainty.")
    return Section("Error predicted with the old and with the new numbers",
                   paragraph(note, "note") + paragraph(r.predicted_sentence())
            + table("", ["error", "unit", "rms", "max"], rows)
            + figures(drawings(r)))


def drawings(r: ExportRecord) -> list[Drawing]:
    """Return the pictures of errors, old and new."""
    return [p for k in ("position", "rotation") if (p := _bars(r, k)) is not None]


def _bars(r: ExportRecord, kind: str) -> Drawing | None:
    """Return a picture of one kind of error, old and new."""
    parts = {s: _errors(r, s, kind) for s, _ in STAGES}
    known = {(s, k): number(getattr(parts[s], k)) for s in parts for k, _ in ERRORS}
    values = {at: max(v or 0.0, 0.0) for at, v in known.items()}
    top = max(values.values())
    if not top > SMALLEST or None in known.values():
        return None
    unit = parts["after"].unit
    rows = [Row(f"{key}, {name}", ((values[stage, key], name),),
                f"{error_size(values[stage, key], unit)} {unit}".strip())
            for key, _ in ERRORS for stage, name in STAGES]
    return Chart(rows, "linear", 0.0, top, unit, beside=True).drawing(
        f"Predicted error of {kind}", "Rms and largest.",
        f"Rms and largest error, old and new, in {unit or 'its unit'}.",
        key=(("before", "old"), ("after", "new")))


def _not_expressed(r: ExportRecord) -> Section | None:
    """Return what the controller cannot express, and what that alone costs."""
    if not r.not_expressed:
        return None
    rows = [[text_cell(entry.what, "wrap"), text_cell(", ".join(entry.parameters), "wrap"),
             text_cell((entry.cost and entry.cost.words()) or "not known", "wrap")]
            for entry in r.not_expressed]
    return Section(f"{count(len(rows), 'thing')} that {r.called} cannot express", table(
        "Cost: the error that it alone leaves", ["what", "parameters", "cost"], rows))


def _errors(r: ExportRecord, stage: str, kind: str) -> CommandErrors | ErrorSize:
    """Return the errors of position or of rotation, ``before`` or ``after``."""
    part: CommandErrors = getattr(r, stage)
    return part if kind == "position" else part.rotation or ErrorSize()


def fixed(value: Any, decimals: int = 4, plus: bool = False) -> str:
    """Return a number with fixed decimals, as the console shows it."""
    x = number(value)
    if x is None:
        return "–"
    if abs(x) >= 1e7:
        return sig(x, 8)
    x = round(x, decimals) + 0.0
    return f"{x:{'+' if plus else ''}.{decimals}f}".replace("-", "−")


EXPORT: Kind[Held[ExportRecord]] = Kind(
    "exported", "exports", "export", 50, (ExportRecord.FILE,), recorded(ExportRecord),
    lambda one, data: [
        (f"Export in {one.folder}", partial(export_section, one, led=_led(one, data)))],
    lambda one, _: {"folder": one.folder, "export": one.record.entries()},
    lambda one: [("export", one.record)],
    lambda one, _: [(one.folder, text) for text in one.record.all_findings()],
    lambda one, _: {"errors": drawings(one.record)},
    lambda one, _: [text for text in [one.record.judged] if text])
