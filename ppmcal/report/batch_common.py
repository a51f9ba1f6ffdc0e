"""What the machines of a batch have in common, and what changed since last time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.calibration.fit import half_or
from ppmcal.calibration.sessions import CERTAIN, CommonError
from ppmcal.io.results.batch import CampaignQuantity, CampaignRecord
from ppmcal.io.results.batch_common import (
    MOST,
    EffectChange,
    EffectSizes,
    effect_changes,
    shared_effects,
    shared_parameters,
)
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Dots, Layer, Points, Strokes, Zero
from ppmcal.plotting.plot import row_y, rows_plot, span
from ppmcal.report.format import count, probability, sig, to_sigma, typeset
from ppmcal.report.html import figures, name_cell, number_cell, paragraph, table, text_cell
from ppmcal.report.section import Section
from ppmcal.wording import abbreviate_list


def changes(compared: Sequence[CampaignRecord]) -> Section | None:
    """Return what has changed of each machine's geometry, the changed ones first."""
    rows = []
    for r in sorted(compared, key=lambda r: (r.verdict != "changed", r.machine)):
        what = "; ".join(_change(q) for q in r.of_kind("change"))
        if not what:
            what = typeset(r.message) if r.failed or r.verdict == "changed" else ""
        rows.append([text_cell(r.machine), text_cell(r.date),
                     text_cell(r.verdict, "warn" if r.exit_code else ""), text_cell(what, "wrap")])
    note = ("The last two identifications of each machine; what compare says of them is "
            "in the folder of the later date.")
    return Section("Geometry since last time",
                   table("", ["machine", "date", "geometry", "likeliest changes"], rows)
                   + paragraph(note, "note")) if rows else None


def _change(q: CampaignQuantity) -> str:
    name = f"{q.name}: {q.parameter}" if q.parameter else q.name
    wide = half_or(q.half, q.sigma)
    half = "" if wide is None else f" ± {sig(wide, 2)}"
    instead = f" (or {abbreviate_list(q.status.split(', '))})" if q.status else ""
    return f"{name} {to_sigma(q.value, q.sigma)}{half} {q.unit}".rstrip() + instead


def effects_over_time(records: Sequence[CampaignRecord]) -> Section | None:
    """Return which effects came, went or changed between each machine's last two diagnoses."""
    own: dict[tuple[str, str], list[CampaignRecord]] = {}
    for r in sorted(records, key=lambda r: r.date):
        if r.command == "diagnose" and not r.failed:
            own.setdefault((r.machine, r.campaign.rpartition("/")[2]), []).append(r)
    rows = [[text_cell(new.machine), text_cell(old.date), text_cell(new.date),
             text_cell("; ".join(found) or "the same effects", "wrap" if found else "wrap soft")]
            for *_, old, new in (o for o in own.values() if len(o) > 1)
            for found in [[_of_effect(c) for c in effect_changes(old, new)]]]
    rows.sort(key=lambda row: "soft" in row[3].kind)
    return Section("Effects since last time", table(
        "", ["machine", "earlier", "now", "what is new"], rows)) if rows else None


def _of_effect(c: EffectChange) -> str:
    if c.old is None or c.new is None:
        return f"{c.what}: {c.kind}" + (f" on {c.on}" if c.on else "")
    return (f"{c.kind} on {c.on}: {c.new.parameter} {to_sigma(c.old.value, c.old.sigma)} → "
            f"{to_sigma(c.new.value, c.new.sigma)} {c.new.unit}")


SHOWN, NAMES, ROW = 30, 150.0, 15.0


def common_sentences(records: Sequence[CampaignRecord]) -> list[str]:
    """Return what is the design's, in words."""
    out = [f"{e.kind} is {e.whose}: {len(e.machines)} of {count(e.of, 'machine')} have it."
           for e in shared_effects(records) if "design" in e.whose]
    off = [name for name, _, _, f in shared_parameters(records) if f.of_design]
    if off:
        out.append("Off nominal in the same way on all units, so by design: "
                   f"{abbreviate_list(off, most=6)}.")
    return out


def common_effects(records: Sequence[CampaignRecord]) -> Section | None:
    """Return the table of effects by how many machines have them."""
    rows = []
    for e in shared_effects(records):
        share = f"{100.0 * e.low:.0f} to {100.0 * e.high:.0f} %"
        rows.append([text_cell(e.kind),
                     number_cell(len(e.machines), f"{len(e.machines)} of {e.of}"),
                     number_cell(e.low, share), text_cell(e.whose, "warn" if e.low > MOST else ""),
                     text_cell("; ".join(map(_size, e.sizes)), "wrap"),
                     text_cell(abbreviate_list(e.machines, most=6), "wrap")])
    note = ("An effect that most machines have is the design's, not the unit's: certain where the "
            "95 % interval of the share lies above one half. One that all share may also be of an "
            "instrument that measured them all.")
    heads = ["effect", "machines", "share, 95 %", "whose", "size over machines", "which"]
    return Section("Effects that machines have in common", table("", heads, rows, sort=True)
                   + paragraph(note, "note")) if rows else None


def _size(s: EffectSizes) -> str:
    spread = "" if s.spread is None else f", spread {sig(s.spread, 2)}"
    return f"{s.parameter} {sig(s.mean)}{spread} {s.unit}".strip()


def common_parameters(records: Sequence[CampaignRecord]) -> Section | None:
    """Return the parameters that are off nominal alike on all machines."""
    found = shared_parameters(records)
    if not found:
        return None
    heads = ["parameter", "machines", "mean error", "95 %", "unit", "spread of units", "chance",
             "whose"]
    rows = [[name_cell(name), number_cell(f.machines, str(f.machines)), number_cell(f.mean),
             number_cell(f.half, f"± {sig(f.half, 2)}"), text_cell(unit), number_cell(f.spread),
             number_cell(f.p_value, probability(f.p_value)),
             text_cell("the design's" if f.of_design else "", "warn" if f.of_design else "")]
            for name, unit, _, f in found]
    sure = sum(f.of_design for *_, f in found)
    first = rows[:max(sure, 8)]
    out = table("", heads, first, sort=True)
    if len(rows) > len(first):
        out += (f"<details><summary>{count(len(rows) - len(first), 'further parameter')}"
                "</summary>" + table("", heads, rows[len(first):], sort=True) + "</details>")
    note = ("Chance: that machines drawn around nominal have such a mean, over all parameters; "
            f"below {CERTAIN:g} nominal is off by design (drawing, or controller settings that all "
            "share). Parameters that act alike stand in for each other.")
    return Section("Parameters that are off alike",
                   out + paragraph(note, "note") + figures([_picture(found)]))


def _picture(found: Sequence[tuple[str, str, float | None, CommonError]]) -> Drawing | None:
    """Return mean errors with their intervals and the spread of units, in tolerances."""
    shown = [(name, tolerance, f) for name, _, tolerance, f in found if tolerance][:SHOWN]
    if not shown:
        return None
    values = np.array([[f.mean / t, f.half / t, f.spread / t] for _, t, f in shown])
    mean, half, spread = values.T
    y = row_y(len(shown))
    said = Points([f"{name}\n± {sig(h, 2)} (95 %), spread of units {sig(s, 2)}"
                   for (name, _, _), h, s in zip(shown, half, spread, strict=True)])
    layers: list[Layer] = [
        Zero(upright=True), Strokes(y, mean - spread, mean + spread, "ink", 0.8, 0.4, True),
        Strokes(y, mean - half, mean + half, "after", 2.2, flat=True),
        Dots(mean, y, "after", 6.5, said)]
    ends = np.concatenate([mean - spread, mean + spread, mean - half, mean + half, [0.0]])
    return rows_plot(span(ends), "mean error / tolerance", layers,
                     [(n, f.of_design) for n, _, f in shown]).drawing(
        "Mean error over machines, in tolerances",
        "Dots with 95 % bars; thin lines: one standard deviation of units to each side. Bold: "
        f"the design's.{f' The {len(shown)} surest.' if len(shown) < len(found) else ''}",
        f"{len(shown)} parameters.")
