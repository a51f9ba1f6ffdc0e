"""The section about an export: what the controller takes, what it gains, what it cannot hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ppmcal.io.json import NUMBER, TEXT
from ppmcal.report import svg
from ppmcal.report.format import count, number, sig
from ppmcal.report.html import MAX_ROWS, Cell, amount, bullets, dotted, paragraph, table, words
from ppmcal.report.records import Other
from ppmcal.report.residual_figures import figure
from ppmcal.report.svg_bars import EDGE, Bars, linear_scale

Record = Mapping[str, Any]

_GAIN = {"unit": TEXT, "rms": NUMBER, "max": NUMBER,
         "rotation": {"unit": TEXT, "rms": NUMBER, "max": NUMBER}}
EXPORT = {
    **dict.fromkeys(("controller", "name", "title", "said", "over"), TEXT),
    "units": {"*": TEXT}, "number_units": {"*": TEXT}, "parameters": {"*": NUMBER},
    "old": {"*": NUMBER}, "gain": {"before": _GAIN, "after": _GAIN},
    "predicted": {"format": _GAIN, "after": _GAIN,
                  "model": {**_GAIN, "frame": TEXT, "reason": TEXT}},
    "not_expressed": [{"what": TEXT, "parameters": [TEXT], "cost": _GAIN}],
    "notes": [TEXT], "advice": [TEXT], "files": [TEXT], "provenance": {"inputs": {"*": TEXT}},
}
"""Shape of export.json."""
STAGES = (("before", "old", "r-explained"), ("after", "new", "r-after"))
ERRORS = (("rms", "rms"), ("max", "at most"))
"""Keys, and their names in a sentence."""
DECIMALS = {"mm": 4, "deg": 5}
NO_GAIN = 1e-6
"""Further than this the new numbers are worse than the old ones, mm."""


def export_section(one: Other) -> str:
    """Return everything about one export."""
    r = one.record
    out = [f"<h2>Export: {controller_html(r)}</h2>", paragraph(f"From {one.folder}.", "note"),
           paragraph(_said(r), "big"),
           _numbers(r), _gain(r), _lacks(r)]
    notes = [sentence(n) for n in (*(r.get("notes") or ()), *(r.get("advice") or ()))]
    return "".join([*out, "<h3>Notes</h3>" + bullets(notes) if notes else ""])


def attention(r: Record) -> list[str]:
    """Return what the user must look at: what cannot be expressed, and numbers that are worse."""
    out = [f"cannot be expressed: {lack.get('what') or '?'}"
           + (f": costs {cost}" if (cost := _cost(lack)) else "")
           for lack in r.get("not_expressed") or ()]
    before, after = (number(_stage(r, s).get("rms")) for s in ("before", "after"))
    if before is not None and after is not None and after > before + NO_GAIN:
        out.append(f"the new {controller(r)} numbers are worse than the old ones over this "
                   "workspace")
    return out


def controller(r: Record) -> str:
    """Return what people call the controller."""
    return str(r.get("title") or r.get("controller") or "controller")


def sentence(text: str) -> str:
    """Return text as a sentence."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


def _said(r: Record) -> str:
    head = f"{r.get('name') or controller(r)}: "
    files = [str(f) for f in r.get("files") or ()]
    written = f" Written: {', '.join(files)}." if files else ""
    if r.get("said"):
        return f"{head}{str(r['said']).rstrip('.')}.{written}"
    exact = {True: "all of it", False: "most of it"}.get(r.get("exact") is True)
    return f"{head}written for {controller(r)}, which holds {exact}.{written}"


def _numbers(r: Record) -> str:
    """Return what is written: old, new and change."""
    units, old = r.get("number_units") or {}, r.get("old") or {}
    rows = []
    for name, value in (r.get("parameters") or {}).items():
        was, new = number(old.get(name)), number(value)
        change = None if was is None or new is None else new - was
        rows.append([dotted(name), amount(was, fixed(was)), amount(new, fixed(new)),
                     amount(change, fixed(change, plus=True)), words(units.get(name) or "")])
    more = (f"the first {MAX_ROWS} of {len(rows)}, export.json has them all"
            if len(rows) > MAX_ROWS else "")
    caption = "; ".join(t for t in ("What is written, in the controller's own numbers", more) if t)
    return table(caption, ["parameter", "old", "new", "change", "unit"], rows[:MAX_ROWS], sort=True)


def _gain(r: Record) -> str:
    """Return the errors predicted with the old numbers and with the new ones."""
    rows: list[list[Cell]] = []
    for kind in ("position", "rotation"):
        for stage, name, _ in STAGES:
            part = _errors(_stage(r, stage), kind)
            if any(number(part.get(k)) is not None for k, _ in ERRORS):
                unit = str(part.get("unit") or "")
                rows.append([words(f"{kind}, {name}"), words(unit),
                             *(amount(part.get(k), fixed(part.get(k), DECIMALS.get(unit, 4)))
                               for k, _ in ERRORS)])
    if not rows:
        return ""
    over = f", over {str(r['over']).rstrip('.')}" if r.get("over") else ""
    drawings = "".join(_bars(r, k) for k in ("position", "rotation"))
    return ("<h3>Error predicted with the old and with the new numbers</h3>"
            + paragraph(f"The machine driven through the controller's arithmetic{over}, if the "
                        "model is exact.", "note") + paragraph(_expected(r))
            + table("", ["error", "unit", "rms", "max"], rows)
            + (f'<div class="plots">{drawings}</div>' if drawings else ""))


def _expected(r: Record) -> str:
    """Return what is left with the new numbers: of the format, of the model, and together."""
    told = r.get("predicted") or {}
    lacks, own, both = (told.get(k) or {} for k in ("format", "model", "after"))
    if number(lacks.get("rms")) is None:
        return ""
    text = f"What the format cannot express: {_size(lacks)}; the model's own uncertainty: "
    if number(own.get("rms")) is None or number(both.get("rms")) is None:
        return f"{text}unknown, as {own.get('reason') or 'nothing tells it'}."
    where = str(own.get("frame") or "base")
    where = "the base frame" if where == "base" else f"the frame of {where}"
    return (f"{text}{_size(own)} (1 sigma, rms over the poses, in {where}). Predicted error with "
            f"the new numbers: {_size(both)} rms.")


def _size(part: Record) -> str:
    """Return ``0.012 mm and 0.0031 deg``."""
    out = []
    for kind in ("position", "rotation"):
        errors = _errors(part, kind)
        if number(errors.get("rms")) is not None:
            out.append(f"{sig(errors['rms'], 2)} {errors.get('unit') or ''}".strip())
    return " and ".join(out)


def _bars(r: Record, kind: str) -> str:
    """Return a drawing of one kind of error, old and new."""
    parts = {s: _errors(_stage(r, s), kind) for s, _, _ in STAGES}
    values = {(s, k): max(number(parts[s].get(k)) or 0.0, 0.0) for s in parts for k, _ in ERRORS}
    top = max(values.values())
    if not top > svg.LEAST or any(number(parts[s].get(k)) is None for s, k in values):
        return ""
    unit = str(parts["after"].get("unit") or "")
    left, right = 78.0, svg.WIDTH - 86.0
    bars = Bars(linear_scale(top, left, right), left, right, 18.0)
    for key, _ in ERRORS:
        for stage, name, style in STAGES:
            value = values[stage, key]
            bars.text(f"{key}, {name}", room=left - EDGE)
            bars.bar(value, style, bars.y - 10.0, 12.0)
            bars.text(f"{fixed(value, DECIMALS.get(unit, 4))} {unit}".strip(),
                      x=bars.at(value) + 5.0)
            bars.y += 20.0
        bars.y += 6.0
    title = f"Predicted error of {kind}"
    drawing = svg.document(title, f"Rms and largest error, old and new, in {unit or 'its unit'}.",
                           bars.parts, height=bars.y - 8.0)
    return figure(drawing, f"{title}, rms and largest.", '<i class="key before"></i>old '
                  '<i class="key after"></i>new')


def _lacks(r: Record) -> str:
    """Return what the controller cannot express, and what that alone costs."""
    lacks = r.get("not_expressed") or ()
    if not lacks:
        return ""
    rows = [[words(lack.get("what"), "wrap"),
             words(", ".join(str(p) for p in lack.get("parameters") or ()), "wrap"),
             words(_cost(lack) or "not known", "wrap")] for lack in lacks]
    return (f"<h3>{count(len(rows), 'thing')} that {controller_html(r)} cannot express</h3>"
            + table("Cost: the error that it alone leaves", ["what", "parameters", "cost"], rows))


def controller_html(r: Record) -> str:
    """Return the controller's name for a headline."""
    return words(controller(r)).html


def _cost(lack: Record) -> str:
    """Return an error in words: ``0.0123 mm rms, 0.0456 mm at most``."""
    cost, out = lack.get("cost") or {}, []
    for kind in ("position", "rotation"):
        part = _errors(cost, kind)
        unit = str(part.get("unit") or "")
        shown = [f"{fixed(part[k], DECIMALS.get(unit, 4))} {unit} {name}" for k, name in ERRORS
                 if number(part.get(k)) is not None]
        out += [", ".join(shown)] if shown else []
    return "; ".join(out)


def _stage(r: Record, stage: str) -> Record:
    return (r.get("gain") or {}).get(stage) or {}


def _errors(part: Record, kind: str) -> Record:
    """Return the errors of position or of rotation."""
    return part if kind == "position" else part.get("rotation") or {}


def fixed(value: Any, decimals: int = 4, plus: bool = False) -> str:
    """Return a number with fixed decimals, as the console shows it."""
    x = number(value)
    if x is None:
        return "–"
    if abs(x) >= 1e7:
        return sig(x, 8)
    x = round(x, decimals) + 0.0
    return f"{x:{'+' if plus else ''}.{decimals}f}".replace("-", "−")
