"""Sentences: what to say about a result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ppmcal.io.results.diagnosis_wording import verdict as diagnosis_verdict
from ppmcal.io.results.identification_parts import ResidualSummary, Summaries
from ppmcal.io.results.identification_wording import noise_verdict
from ppmcal.report import comparison as compare_section
from ppmcal.report.format import count, listed, typeset, whole, with_unit
from ppmcal.report.records import ComparedMachines, Identified, ReportData, ResidualRows


def figure(one: Identified, stage: str, kind: str) -> ResidualSummary:
    """Return the errors of one stage (before, after, holdout) and kind, an empty one if missing."""
    found: Summaries = getattr(one.record.residual, stage)
    return found.get(kind) or ResidualSummary()


def main_kind(one: Identified) -> str:
    """Return the kind of error to head the page with: position if there is one."""
    kinds = ("position", "rotation", *one.record.residual.after)
    return next((k for k in kinds if figure(one, "after", k).rms is not None), "")


def headline(one: Identified) -> list[str]:
    """Return one or two sentences about an identification."""
    rows = sum(d.rows or 0 for d in one.record.datasets)
    used = sum(d.used or 0 for d in one.record.datasets)
    source = f" from {whole(used)} of {whole(rows)} measurements" if rows else ""
    first = f"{one.name} was calibrated{source}"
    kind = main_kind(one)
    if kind:
        after = figure(one, "after", kind)
        a, b, h = (figure(one, s, kind).rms for s in ("before", "after", "holdout"))
        unit = after.unit
        if a is not None and b is not None:
            verb = "fell" if b <= a else "rose"
            first += (f": the rms {kind} error {verb} from {with_unit(a, unit)} to "
                      f"{with_unit(b, unit)}")
        elif b is not None:
            first += f": the rms {kind} error is {with_unit(b, unit)}"
        if h is not None:
            first += f", and is {with_unit(h, unit)} on poses that the fit had not seen"
    out = [first + "."]
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
    """Return what the user must look at, as (where, sentence)."""
    out: list[tuple[str, str]] = []
    for one in data.identified:
        out += [(one.name, t) for t in _of_identified(one)]
    said = {(one.folder, t) for one in data.identified for t in _of_identified(one)}
    for d in data.diagnosed:
        out += [(d.folder, t) for t in d.record.findings if (d.folder, t) not in said]
        if d.record.verdict in ("weak", "named-set", "partial", "unnamed"):
            out.append((d.folder, f"Diagnosis: {diagnosis_verdict(d.record)}"))
    for rows in (*data.compensated, *data.kinematics):
        out += [(rows.folder, t) for t in _of_rows(rows)]
    for other in data.others:
        out += [(other.folder, finding_text(f)) for f in other.record.findings or ()]
    for v in data.validated:
        out += [(v.folder, t) for t in v.record.findings]
    for c in data.compared:
        out += [(c.folder, t) for t in (*compare_section.attention(c.record), *c.record.findings)]
    for exported in data.exported:
        out += [(exported.folder, t) for t in exported.record.attention()]
    for t in data.comparisons:
        out += [(t.identified, text) for text in _of_truth(t)]
    return list(dict.fromkeys(out))


def _of_identified(one: Identified) -> list[str]:
    record = one.record
    out = [*record.findings, *map(typeset, record.gross_errors.shift_sentences())]
    if "findings" not in record.model_fields_set:
        if record.excluded:
            out.append(f"{count(len(record.excluded), 'row')} left out of the fit")
        verdict, fine = noise_verdict(record.noise)
        out += [] if fine else [typeset(verdict)]
    if record.converged is False and not any("converged" in t for t in out):
        out.append("the fit had not converged")
    far = [p.name for p in record.parameters if (p.tolerances or 0.0) > 3.0]
    if far:
        out.append(f"{count(len(far), 'parameter')} more than 3 tolerances from nominal: "
                   + listed(far))
    return out


def _of_rows(rows: ResidualRows) -> list[str]:
    flagged = len(rows.flagged)
    if not flagged or rows.table is None:
        return []
    return [f"{whole(flagged)} of {count(rows.table.size, 'row')} of {rows.kind}.csv "
            "refused or with a remark"]


def _of_truth(c: ComparedMachines) -> list[str]:
    far = [r.name for r in c.rows if r.z is not None and abs(r.z) > 4.0]
    return [f"{count(len(far), 'identified error')} more than 4 sigma from the simulated truth: "
            + listed(far)] if far else []
