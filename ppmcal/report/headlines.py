"""Sentences: what to say about a result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ppmcal.io.results.commands import CommandsRecord
from ppmcal.io.results.identification_parts import Summaries
from ppmcal.io.results.identification_wording import noise_verdict
from ppmcal.io.results.parts import ErrorChange, ErrorSize
from ppmcal.io.results.truth import ComparedMachines
from ppmcal.report.format import count, typeset, whole, with_unit
from ppmcal.report.records import Identified, ReportData
from ppmcal.store.provenance import Provenance
from ppmcal.wording import abbreviate_list

IN_THE_FIT = "in the fit"


def figure(one: Identified, stage: str, kind: str) -> ErrorSize:
    """Return the errors of one stage (before, after, holdout) and kind, an empty one if missing."""
    found: Summaries = getattr(one.record.residual, stage)
    return found.get(kind) or ErrorSize()


def main_kind(one: Identified) -> str:
    """Return the kind of error to head the page with: position if there is one."""
    kinds = ("position", "rotation", *one.record.residual.after)
    return next((k for k in kinds if figure(one, "after", k).rms is not None), "")


def accuracy(one: Identified, data: ReportData) -> str:
    """Return the error to expect of poses that no fit has seen, where it is known, else in the fit.

    Empty where neither is known.
    """
    kind = main_kind(one)
    before, after = (figure(one, s, kind).rms for s in ("before", "after"))
    if after is None:
        return ""
    unit = figure(one, "after", kind).unit
    more = [f"{with_unit(before, unit)} before"] if before is not None else []
    first, where = unseen(one, kind, data) or (with_unit(after, unit), IN_THE_FIT)
    if where != IN_THE_FIT:
        more.append(f"{with_unit(after, unit)} {IN_THE_FIT}")
    return f"rms {kind} error {first} {where}" + (f" ({', '.join(more)})" if more else "")


def unseen(one: Identified, kind: str, data: ReportData) -> tuple[str, str] | None:
    """Return the error with its unit, and of what it is: of poses kept out, else of other data.

    Else what is promised of commands; None where nothing of these is there.
    """
    held = figure(one, "holdout", kind)
    if held.rms is not None:
        return with_unit(held.rms, held.unit), "on poses kept out of the fit"
    for v in data.validated:
        for day in v.record.datasets if _is_of(one, v.record.provenance) else ():
            size = getattr(day.errors[0], kind, None) if day.errors else None
            if size is not None and size.rms is not None:
                return with_unit(size.rms, size.unit), f"on {day.name}, which no fit has seen"
    for c in data.compensated:
        if isinstance(c.record, CommandsRecord) and _is_of(one, c.record.provenance):
            promised = c.record.predicted.get(kind, ErrorChange())
            if promised.after is not None:
                return (with_unit(promised.after, promised.unit),
                        f"promised for {count(c.record.rows or 0, 'target')}")
    return None


def _is_of(one: Identified, provenance: Provenance) -> bool:
    """Whether a result was made with the machine in the folder of an identification."""
    return any(Path(name).absolute().parent == Path(one.folder).absolute()
               for name in provenance.inputs)


def headline(one: Identified, data: ReportData) -> list[str]:
    """Return one or two sentences about an identification; none where a diagnosis says them."""
    if one.diagnosed:
        return []
    rows = sum(d.rows or 0 for d in one.record.datasets)
    used = sum(d.used or 0 for d in one.record.datasets)
    names = abbreviate_list([d.name for d in one.record.datasets if d.name])
    source = f" from {whole(used)} of {whole(rows)} measurements" if rows else ""
    source += f" ({names})" if source and names else ""
    first = f"{one.name} was calibrated{source}"
    out = [": ".join(filter(None, (first, accuracy(one, data)))) + "."]
    verdict, _ = noise_verdict(one.record.noise)
    if verdict:
        out.append(typeset(verdict[0].upper() + verdict[1:] + "."))
    return out


def finding_text(entry: Any) -> str:
    """Return a finding as one sentence, whatever form it has."""
    if isinstance(entry, Mapping):
        place = entry.get("where") or entry.get("place") or entry.get("file") or ""
        what = entry.get("what") or entry.get("text") or entry.get("message") or entry.get(
            "finding") or ", ".join(f"{k}: {v}" for k, v in entry.items())
        parts = [f"{place}: {what}" if place else str(what), str(entry.get("mend") or "")]
        return " ".join(p for p in parts if p)
    return str(entry)


def other_machine(c: ComparedMachines) -> str:
    """Return that the model is not the machine simulated, empty where it is."""
    many = len(c.other)
    return (f"the model identified is not the machine simulated: {count(many, 'nominal value')} "
            f"{'differs' if many == 1 else 'differ'} ({abbreviate_list(c.other)}); true errors "
            "count from the model's own nominal values, which its tolerances may not allow for"
            ) if many else ""
