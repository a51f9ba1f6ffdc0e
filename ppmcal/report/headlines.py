"""Sentences: what to say about a result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ppmcal.calibration.knowledge import FAR
from ppmcal.io.results.campaign import campaign_sentences
from ppmcal.io.results.commands import CommandsRecord, TargetError
from ppmcal.io.results.diagnosis_wording import unconfirmed
from ppmcal.io.results.diagnosis_wording import verdict as diagnosis_verdict
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import ResidualSummary, Summaries
from ppmcal.io.results.identification_wording import noise_verdict
from ppmcal.io.results.record import Provenance
from ppmcal.io.results.validation import misled
from ppmcal.report import comparison as compare_section
from ppmcal.report.format import count, typeset, whole, with_unit
from ppmcal.report.records import (
    ComparedMachines,
    Diagnosed,
    Identified,
    ReportData,
    ResidualRows,
    Simulated,
)
from ppmcal.wording import some

IN_THE_FIT = "in the fit"


def figure(one: Identified, stage: str, kind: str) -> ResidualSummary:
    """Return the errors of one stage (before, after, holdout) and kind, an empty one if missing."""
    found: Summaries = getattr(one.record.residual, stage)
    return found.get(kind) or ResidualSummary()


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
            promised = c.record.predicted.get(kind, TargetError())
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
    names = some([d.name for d in one.record.datasets if d.name])
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


def attention(data: ReportData) -> list[tuple[str, str]]:
    """Return what the user must look at, as (where, sentence); designs add theirs in `look_at`.

    Whatever the page warns of stands here: that nothing needs a closer look is said where this
    list is empty, and nowhere else.
    """
    out: list[tuple[str, str]] = []
    for one in data.identified:
        out += [(place(one, data), t) for t in _of_identified(one)]
    said = {(one.folder, t) for one in data.identified for t in _of_identified(one)}
    for d in data.diagnosed:
        out += [(d.folder, t) for t in _of_diagnosed(d) if (d.folder, t) not in said]
    for rows in (*data.compensated, *data.kinematics):
        out += [(rows.folder, t) for t in _of_rows(rows)]
    for other in data.others:
        out += [(other.folder, finding_text(f)) for f in other.record.findings or ()]
    for v in data.validated:
        out += [(v.folder, t) for t in (*v.record.findings, *misled(v.record.datasets))]
    for c in data.compared:
        out += [(c.folder, t) for t in (*compare_section.attention(c.record), *c.record.findings)]
    for exported in data.exported:
        out += [(exported.folder, t) for t in exported.record.attention()]
    for s in data.simulated:
        out += [(s.folder, t) for t in _of_simulated(s)]
    for t in data.comparisons:
        out += [(t.identified, text) for text in _of_truth(t)]
    return list(dict.fromkeys((where, typeset(text)) for where, text in out))


def place(one: Identified, data: ReportData) -> str:
    """Return what an identification is called: by its folder where several have its name."""
    same = [other for other in data.identified if other.name == one.name]
    return one.name if len(same) == 1 else one.folder


def _of_identified(one: Identified) -> list[str]:
    record = one.record
    out = [*record.findings, *record.gross_errors.shift_sentences(),
           *record.gross_errors.unchecked_sentences(), *campaign_sentences(record.campaign)]
    scale = record.identifiability.scale
    if scale is not None and scale.sentence():
        out.append(scale.sentence())
    return out if "findings" in record.given else [*out, *_of_fields(record)]


def _of_fields(record: IdentificationRecord) -> list[str]:
    """Return what the fields of a file say that lists no findings."""
    out = []
    if record.excluded:
        out.append(f"{count(len(record.excluded), 'row')} left out of the fit")
    verdict, fine = noise_verdict(record.noise)
    if not fine:
        out.append(verdict)
    if record.converged is False:
        out.append("the fit had not converged")
    far = [p.name for p in record.parameters if p.far]
    if far:
        out.append(f"{FAR}: {some(far, 'parameters.csv')}")
    return out


def _of_diagnosed(d: Diagnosed) -> list[str]:
    r = d.record
    out = list(r.findings)
    if r.verdict not in ("", "none", "named"):
        out.append(f"Diagnosis: {diagnosis_verdict(r)}")
    if r.confirmed is False and r.effects and not out:
        out.append(unconfirmed(r))
    return [*out, *misled(r.validation)]


def _of_simulated(s: Simulated) -> list[str]:
    gone = () if s.truth is None else s.truth.left_out
    return [f"{count(len(gone), 'pose')} could not be simulated: "
            + some(gone, "truth.json, left_out")] if gone else []


def _of_rows(rows: ResidualRows) -> list[str]:
    flagged, notes = len(rows.flagged), list(getattr(rows.record, "notes", ()))
    if not flagged or rows.table is None:
        return notes
    return [*notes, f"{whole(flagged)} of {count(rows.table.size, 'row')} of {rows.kind}.csv "
            "refused or with a remark"]


def _of_truth(c: ComparedMachines) -> list[str]:
    if c.other:
        return [other_machine(c)]
    far = [r.name for r in sorted(c.rows, key=lambda r: -abs(r.z or 0.0))
           if r.z is not None and abs(r.z) > 4.0]
    return [f"{count(len(far), 'identified error')} more than 4 sigma from the simulated truth: "
            + some(far, "the table of errors true and found")] if far else []


def other_machine(c: ComparedMachines) -> str:
    """Return that the model is not the machine simulated, empty where it is."""
    many = len(c.other)
    return (f"the model identified is not the machine simulated: {count(many, 'nominal value')} "
            f"{'differs' if many == 1 else 'differ'} ({some(c.other)}); true errors count from the "
            "model's own nominal values, which its tolerances may not allow for") if many else ""
