"""The page of a batch: who is worst, what machines have in common, what has changed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from html import escape
from urllib.parse import quote

import numpy as np

from ppmcal.calibration.fit import half_or, secondary
from ppmcal.calibration.sessions import CERTAIN, CommonError
from ppmcal.calibration.validation import definition
from ppmcal.io.results.batch import (
    USUAL,
    CampaignQuantity,
    CampaignRecord,
    EffectChange,
    EffectSizes,
    effect_changes,
    error_of,
    farthest_parameter,
    in_si,
    last_of_each,
    left,
    ranking,
    shared_effects,
    shared_parameters,
    with_findings,
)
from ppmcal.notes import Note
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Dots, Layer, Marks, Points, Strokes, Zero
from ppmcal.plotting.plot import row_y, rows_plot, span
from ppmcal.report.html import (
    Cell,
    count,
    figures,
    name_cell,
    number_cell,
    paragraph,
    probability,
    sig,
    table,
    text_cell,
    to_sigma,
    typeset,
)
from ppmcal.report.section import Section, chapter, filled, page
from ppmcal.units import LENGTHS
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
                     number_cell(e.low, share), text_cell(e.whose, "warn" if e.low > USUAL else ""),
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
                   out + paragraph(note, "note") + figures([_change_picture(found)]))


def _change_picture(found: Sequence[tuple[str, str, float | None, CommonError]]) -> Drawing | None:
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


PLOTTED = 40
"""At most so many machines are drawn."""


def batch_page(records: Sequence[CampaignRecord]) -> str:
    """Return one self-contained page about the campaigns of a batch."""
    own = [r for r in records if r.command != "compare"]
    failed = [r for r in own if r.failed]
    designs: dict[str, list[CampaignRecord]] = {}
    for r in records:
        if not r.failed:
            designs.setdefault(r.design, []).append(r)
    several = len(designs) > 1
    chapters = [c for name, some in designs.items() for c in
                ([Section(name or "Machines", parts=_design(some))] if several else _design(some))]
    compared = [r for r in records if r.command == "compare"]
    chapters += filled([_failed(failed), chapter("What has changed", lambda: changes(compared)),
                        _campaigns(own)])
    machines = len({r.machine for r in own})
    lead = [f"{count(len(own), 'campaign')} of {count(machines, 'machine')}: "
            f"{sum(r.exit_code == 0 for r in own)} done without findings, "
            f"{sum(r.exit_code == 1 for r in own)} to look at, {len(failed)} failed."]
    left_out = list[Note]()
    common = [s for some in designs.values() for s in secondary(
        "what machines have in common", partial(common_sentences, some), [], left_out)]
    lead += dict.fromkeys(left_out)
    return page(title=f"Batch: {count(machines, 'machine')}", lead=[*lead, *common],
                look=[typeset(t) for t in with_findings(records)],
                folders=count(len(own), "campaign"), chapters=chapters)


def _design(records: Sequence[CampaignRecord]) -> tuple[Section, ...]:
    """Return the sections about the machines of one design."""
    latest = [r for r in last_of_each(records) if r.command != "compare"]
    ranked = ranking(latest)
    return filled([
        _ranking(ranked, latest),
        chapter("Effects in common", lambda: common_effects(records)),
        chapter("Parameters in common", lambda: common_parameters(records)),
        chapter("Effects over time", lambda: effects_over_time(records))])


def _ranking(ranked: Sequence[CampaignRecord], latest: Sequence[CampaignRecord]
             ) -> Section | None:
    """Return the table and picture of machines, worst first."""
    if not ranked:
        return None
    rows = []
    blind = set[bool]()
    for i, r in enumerate(ranked, 1):
        q = left(r)
        assert q is not None
        blind.add(q.name == "closure")
        before = error_of(r, q.name, "before")
        after = error_of(r, q.name, "after")
        noise = next((n.value for n in reversed(r.of_kind("noise")) if n.parameter == "after"),
                     None)
        rows.append([_link(r, r.machine), number_cell(i, str(i)), text_cell(r.date),
                     text_cell(r.command),
                     _amount(before), _amount(after), _amount(error_of(r, q.name, "holdout")),
                     text_cell(f"{q.unit} {q.name}".strip()), number_cell(noise),
                     *_farthest(r), text_cell(_named(r.machine, latest), "wrap"),
                     text_cell("to look at" if r.exit_code else "", "warn" if r.exit_code else "")])
    heads = ["machine", "rank", "date", "by", "rms error before", "after", "on unseen poses", "of",
             "after / noise", "farthest parameter", "tolerances off", "effects", "status"]
    meanings = "; of joint values alone: ".join(map(definition, sorted(blind)))
    note = ("Ranked by what is left: the rms error on poses that the fit has not seen, else on its "
            f"own; of each machine the latest fit. Before: {meanings}.")
    used = [i for i in range(len(heads)) if any(row[i].html not in ("", "–") for row in rows)]
    return Section("Machines, worst first", paragraph(note, "note") + table(
        "", [heads[i] for i in used], [[row[i] for i in used] for row in rows], sort=True)
        + figures([_picture(ranked)]))


def _amount(q: CampaignQuantity | None) -> Cell:
    return number_cell(None if q is None else q.value)


def _link(record: CampaignRecord, text: str) -> Cell:
    """Return a cell that leads to the folder of the results, beside the page, if there are any."""
    if record.failed:
        return text_cell(text)
    return Cell(f'<a href="{escape(quote(record.campaign))}/">{escape(text)}</a>')


def _farthest(record: CampaignRecord) -> tuple[Cell, Cell]:
    """Return the parameter that is most tolerances off nominal, and how many."""
    found = farthest_parameter(record)
    if found is None:
        return text_cell(""), number_cell(None)
    return text_cell(found.name), number_cell(found.tolerances, bad=found.far)


def _named(machine: str, latest: Sequence[CampaignRecord]) -> str:
    """Return the effects that the latest diagnosis of a machine names."""
    for r in latest:
        if r.machine == machine and r.command == "diagnose":
            names = list(dict.fromkeys(q.name + (f" on {q.on}" if q.on else "")
                                       for q in r.of_kind("effect")))
            return abbreviate_list(names, most=6) or r.verdict
    return ""


def _picture(ranked: Sequence[CampaignRecord]) -> Drawing | None:
    """Return errors before, after and on unseen poses of each machine on a logarithmic scale."""
    kinds = [(r, q) for r in ranked[:PLOTTED] if (q := left(r)) is not None]
    name, unit = kinds[0][1].name, kinds[0][1].unit
    shown = [(r.machine, in_si(error_of(r, name, "before")), in_si(q)) for r, q in kinds
             if q.name == name]
    factor = LENGTHS.get(unit, 1.0)
    values = np.array([v[1:] for v in shown]) / factor
    if len(shown) < 2 or not np.isfinite(values).any():
        return None
    less = f" The {len(shown)} worst of {len(ranked)}." if len(shown) < len(ranked) else ""
    y, names = row_y(len(shown)), [s[0] for s in shown]
    layers: list[Layer] = [
        Strokes(y, values.min(axis=1), values.max(axis=1), "ink", 0.8, 0.4, flat=True),
        Marks(values[:, 0], y, "before", "o", 5.6, Points(names)),
        Dots(values[:, 1], y, "after", 6.5, Points(names))]
    return rows_plot(span(values, log=True), f"rms {name} error ({unit})", layers,
                     [(n, False) for n in names], unit).drawing(
        f"Error in {name} of each machine",
        f"Rings: with nominal geometry; dots: what is left after the fit.{less}",
        f"{len(shown)} machines.", (("ring", "before"), ("after", "left")))


def _failed(failed: Sequence[CampaignRecord]) -> Section | None:
    """Return who failed, with message and the command to try alone."""
    rows = [[text_cell(r.campaign), number_cell(r.exit_code, str(r.exit_code)),
             text_cell(r.message, "wrap"),
             Cell(f"<code>{escape(r.typed)}</code>", kind="wrap")] for r in failed]
    note = "The command alone does the same from the manifest's folder."
    return Section("Failed", table("", ["campaign", "exit code", "message", "alone"], rows)
                   + paragraph(note, "note")) if rows else None


def _campaigns(records: Sequence[CampaignRecord]) -> Section:
    """Return all campaigns, folded away."""
    rows = [[_link(r, r.campaign), text_cell(r.date), number_cell(r.exit_code, str(r.exit_code)),
             text_cell(r.verdict), text_cell(typeset(r.message), "wrap")] for r in records]
    return Section("All campaigns", "", parts=(Section(
        count(len(rows), "campaign"), table(
            "", ["campaign", "date", "exit code", "verdict", "result"], rows, sort=True),
        folded=True),))
