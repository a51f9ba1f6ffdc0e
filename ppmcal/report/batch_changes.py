"""What changed since last time: geometry as compare finds it, and effects as diagnosed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from ppmcal.calibration.fit import half_or
from ppmcal.io.results.batch import CampaignQuantity, CampaignRecord
from ppmcal.report.format import listed, sig, to_sigma, typeset
from ppmcal.report.html import paragraph, table, text_cell
from ppmcal.report.section import Section

APART = 3.0
"""Sizes differ from so many standard deviations of the difference on."""


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
    instead = f" (or {listed(q.status.split(', '), 3)})" if q.status else ""
    return f"{name} {to_sigma(q.value, q.sigma)}{half} {q.unit}".rstrip() + instead


def effect_changes(records: Sequence[CampaignRecord]) -> Section | None:
    """Return which effects came, went or changed between each machine's last two diagnoses."""
    own: dict[tuple[str, str], list[CampaignRecord]] = {}
    for r in sorted(records, key=lambda r: r.date):
        if r.command == "diagnose" and not r.failed:
            own.setdefault((r.machine, r.campaign.rpartition("/")[2]), []).append(r)
    rows = [[text_cell(new.machine), text_cell(old.date), text_cell(new.date),
             text_cell("; ".join(found) or "the same effects", "wrap" if found else "wrap soft")]
            for *_, old, new in (o for o in own.values() if len(o) > 1)
            for found in [list(differences(old, new))]]
    rows.sort(key=lambda row: "soft" in row[3].kind)
    return Section("Effects since last time", table(
        "", ["machine", "earlier", "now", "what is new"], rows)) if rows else None


def differences(old: CampaignRecord, new: CampaignRecord) -> Iterator[str]:
    """Yield which effects a later diagnosis names anew, no more, or with another size."""
    before, after = ({(q.name, q.on, q.parameter): q for q in r.of_kind("effect")}
                     for r in (old, new))
    for text, one, other in (("new", after, before), ("no longer named", before, after)):
        there = {k[:2] for k in other}
        for name, on in dict.fromkeys(k[:2] for k in one if k[:2] not in there):
            yield f"{text}: {name}" + (f" on {on}" if on else "")
    for key in after.keys() & before.keys():
        a, b = before[key], after[key]
        if (a.value is None or b.value is None or a.sigma is None or b.sigma is None
                or a.unit != b.unit):
            continue
        step, wide = b.value - a.value, math.hypot(a.sigma, b.sigma)
        if abs(step) > APART * wide > 0.0:
            yield (f"{b.name} on {b.on}: {b.parameter} {to_sigma(a.value, a.sigma)} → "
                   f"{to_sigma(b.value, b.sigma)} {b.unit}")
