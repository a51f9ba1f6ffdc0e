"""The page: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ppmcal import __version__
from ppmcal.plain import plain
from ppmcal.report.html import definitions, exact, number_cell, table, text_cell, typeset
from ppmcal.report.kinds import IN_ORDER, KINDS
from ppmcal.report.records import ReportData
from ppmcal.report.section import Section, chapter, page
from ppmcal.report.verdict import Verdict, verdicts
from ppmcal.wording import collapse_similar
from ppmcal.wording.progress import stage

MOST_LOOKED_AT = 60


@stage("drawing the page")
def to_html(data: ReportData) -> str:
    """Return the report as one self-contained page."""
    verdict, own = verdicts(data), _own_findings(data)
    chapters = [chapter(name, make) for kind in IN_ORDER for one in kind.of(data)
                for name, make in kind.chapters(one, data)]
    chapters.append(chapter("Where this comes from", lambda: _provenance(data)))
    return page(title=title(data), lead=[] if verdict else summary(data), verdicts=verdict,
                look=_looked_at(own), calm=not (own or _doubts(verdict)), chapters=chapters,
                folders=", ".join(data.folders))


def title(data: ReportData) -> str:
    """Return the page's title."""
    names = list(dict.fromkeys(i.name for i in data.identified))
    if names:
        return f"Calibration report: {', '.join(names)}"
    names = list(dict.fromkeys(d.record.name for d in data.designed if d.record.name))
    return f"Error analysis: {', '.join(names)}" if names else "ppmcal report"


def summary(data: ReportData) -> list[str]:
    """Return the headline's sentences."""
    if out := [text for kind in IN_ORDER for one in kind.of(data)
               for text in kind.lead(one, data) if text]:
        return out
    parts = [(len(kind.of(data)), kind.noun) for kind in IN_ORDER]
    held = ", ".join(f"{n} × {noun}" if n > 1 else noun for n, noun in parts if n and noun)
    return [f"Results found: {held}. No identification is among them."]


def all_findings(data: ReportData) -> list[tuple[str, str]]:
    """Return all that the user must look at, as (where, sentence).

    Whatever the page warns of stands here: that nothing needs a closer look is said where this
    list is empty, and nowhere else.
    """
    return _own_findings(data) or _doubts(verdicts(data))


def _doubts(verdict: Sequence[Verdict]) -> list[tuple[str, str]]:
    """Return what the first lines of the page doubt: a doubt is one though it is no finding."""
    return [(v.of, f"{line.question} {line.word}. {line.text}") for v in verdict
            for line in v.lines if line.state != "ok"]


def _own_findings(data: ReportData) -> list[tuple[str, str]]:
    """Return the same but for what the first lines of the page say themselves.

    A diagnosis and the fit in its folder have findings in common: once, of which comes first.
    """
    found: dict[tuple[str, str], tuple[str, str]] = {}
    for kind in IN_ORDER:
        for one in kind.of(data):
            folder = getattr(one, "folder", "")
            for where, text in kind.findings(one, data):
                told = typeset(text)
                found.setdefault((folder or where, told), (where, told))
    return list(found.values())


def _looked_at(items: Sequence[tuple[str, str]]) -> list[str]:
    """Return findings as the page lists them, those that are alike in one."""
    several = len({where for where, _ in items}) > 1
    lines = [f"{where}: {text}" if several else text for where in dict.fromkeys(w for w, _ in items)
             for text in collapse_similar([t for w, t in items if w == where],
                                          "all in the JSON file")]
    more = len(lines) - MOST_LOOKED_AT
    return lines[:MOST_LOOKED_AT] + ([f"and {more} more, in the JSON files"] if more > 0 else [])


def _datasets(record: Mapping[str, Any]) -> str:
    """Return the data sets of a fit."""
    rows = [[text_cell(d.get("name")), text_cell(d.get("kind")), text_cell(d.get("source")),
             number_cell(d.get("rows"), exact(d.get("rows"))),
             number_cell(d.get("used"), exact(d.get("used")))]
            for d in record.get("datasets") or () if isinstance(d, Mapping)]
    return table("", ["data set", "instrument", "file", "rows", "used"], rows)


def _provenance(data: ReportData) -> Section:
    """Return versions, commands, seeds and the check sums of all inputs."""
    out = []
    every = [(f"{getattr(one, 'folder', '')}: {command}", found.entries()) for kind in IN_ORDER
             for one in kind.of(data) for command, found in kind.records(one)]
    for name, record in every:
        p = record.get("provenance") or {}
        facts = [("Command", str(p.get("command") or ""))]
        facts += [(k.capitalize(), str(p[k])) for k in
                  ("version", "seed", "numpy", "scipy", "python") if p.get(k) is not None]
        facts.append(("Method", str(record.get("method") or "")))
        inputs = [[text_cell(f), text_cell(h, "hash")] for f, h in (p.get("inputs") or {}).items()]
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
        "attention": [{"where": w, "what": t} for w, t in all_findings(data)],
        **{kind.key: [kind.shown(one, data) for one in kind.of(data)] for kind in KINDS}}
    return {k: plain(v) for k, v in out.items()}
