"""The page of a batch: who is worst, what machines have in common, what has changed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from html import escape
from urllib.parse import quote

import numpy as np

from ppmcal.calibration.fit import secondary
from ppmcal.calibration.validation import definition
from ppmcal.io.results.batch import CampaignQuantity, CampaignRecord, with_findings
from ppmcal.io.results.batch_common import (
    error_of,
    farthest_parameter,
    in_si,
    last_of_each,
    left,
    ranking,
)
from ppmcal.notes import Note
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Dots, Layer, Marks, Points, Strokes
from ppmcal.plotting.plot import row_y, rows_plot, span
from ppmcal.report.batch_common import (
    changes,
    common_effects,
    common_parameters,
    common_sentences,
    effects_over_time,
)
from ppmcal.report.format import count, typeset
from ppmcal.report.html import Cell, figures, number_cell, paragraph, table, text_cell
from ppmcal.report.section import Section, chapter, filled, page
from ppmcal.units import LENGTHS
from ppmcal.wording import abbreviate_list

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
