"""Sentences: what to say about a result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ppmcal.calibration.noise import FAILED_NOISE, OVERSTATED
from ppmcal.io.results.diagnosis_wording import verdict as diagnosis_verdict
from ppmcal.report import comparison as compare_section
from ppmcal.report.format import count, listed, number, probability, sig, whole, with_unit
from ppmcal.report.identifiability import moved_zeros
from ppmcal.report.records import ComparedMachines, Identified, ReportData, ResidualRows


def figure(one: Identified, stage: str, kind: str) -> Mapping[str, Any]:
    """Return the figures of one stage (before, after, holdout) and kind, {} if missing."""
    part = (one.record.get("residual") or {}).get(stage) or {}
    return part.get(kind) or {}


def main_kind(one: Identified) -> str:
    """Return the kind of error to head the page with: position if there is one."""
    for kind in ("position", "rotation"):
        if number(figure(one, "after", kind).get("rms")) is not None:
            return kind
    stages = (one.record.get("residual") or {}).get("after") or {}
    return next((k for k, v in stages.items() if number((v or {}).get("rms")) is not None), "")


def noise_verdict(noise: Mapping[str, Any]) -> tuple[str, bool]:
    """Return what the residuals say about the stated noise, and whether that is fine."""
    ratio, p = number(noise.get("sigma_ratio")), number(noise.get("chi2_p"))
    if ratio is None and p is None:
        return "", True
    tail = probability(p)
    if ratio is not None:
        tail = f"ratio {sig(ratio)}" + (f", {tail}" if tail else "")
    high = ratio is None or ratio > 1.0
    if (p is not None and p < FAILED_NOISE and high) or (p is None and (ratio or 0.0) > 1.3):
        return ("what remains is larger than the stated noise explains "
                f"({tail}): something is missing in the model, or sigma is too small"), False
    if ratio is not None and (ratio < 0.7 or (p is not None and p > 1.0 - FAILED_NOISE)):
        return (f"what remains is smaller than the stated noise ({tail}): "
                "sigma looks too large"), ratio >= OVERSTATED
    return f"what remains agrees with the stated noise ({tail})", True


def headline(one: Identified) -> list[str]:
    """Return one or two sentences about an identification."""
    sets = one.record.get("datasets") or []
    rows = sum(int(number(d.get("rows")) or 0) for d in sets)
    used = sum(int(number(d.get("used")) or 0) for d in sets)
    source = f" from {whole(used)} of {whole(rows)} measurements" if rows else ""
    first = f"{one.name} was calibrated{source}"
    kind = main_kind(one)
    if kind:
        before, after, held = (figure(one, s, kind) for s in ("before", "after", "holdout"))
        a, b, h = (number(f.get("rms")) for f in (before, after, held))
        unit = str(after.get("unit") or "")
        if a is not None and b is not None:
            verb = "fell" if b <= a else "rose"
            first += (f": the rms {kind} error {verb} from {with_unit(a, unit)} to "
                      f"{with_unit(b, unit)}")
        elif b is not None:
            first += f": the rms {kind} error is {with_unit(b, unit)}"
        if h is not None:
            first += f", and is {with_unit(h, unit)} on poses that the fit had not seen"
    out = [first + "."]
    verdict, _ = noise_verdict(one.record.get("noise") or {})
    if verdict:
        out.append(verdict[0].upper() + verdict[1:] + ".")
    return out


def redundancy(entry: Mapping[str, Any]) -> str:
    """Return the combination of a redundant parameter in words."""
    name, parts = str(entry.get("name") or "?"), entry.get("depends_on") or {}
    terms = sorted(((k, v) for k, v in parts.items() if number(v)), key=lambda t: -abs(t[1]))
    if not terms:
        return f"{name} has no effect on these measurements."
    shown = "".join(
        (" − " if v < 0 else " + " if i else "") + ("" if abs(abs(v) - 1) < 5e-4 else
                                                    f"{sig(abs(v))} × ") + k
        for i, (k, v) in enumerate(terms[:6])).strip()
    more = f" and {count(len(terms) - 6, 'smaller part')}" if len(terms) > 6 else ""
    return (f"One unit of {name} moves the measurements just as {shown}{more} would: "
            "only their combination can be identified.")


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
        out += [(other.folder, finding_text(f)) for f in other.record.get("findings") or ()]
    for other in data.compared:
        out += [(other.folder, t) for t in compare_section.attention(other.record)]
        out += [(other.folder, finding_text(f)) for f in other.record.get("findings") or ()]
    for exported in data.exported:
        out += [(exported.folder, t) for t in exported.record.attention()]
    for c in data.comparisons:
        out += [(c.identified, t) for t in _of_truth(c)]
    return list(dict.fromkeys(out))


def _of_identified(one: Identified) -> list[str]:
    record = one.record
    out = [finding_text(f) for f in record.get("findings") or ()]
    out += moved_zeros(record)
    if "findings" not in record:
        excluded = record.get("excluded") or ()
        if excluded:
            out.append(f"{count(len(excluded), 'row')} left out of the fit")
        verdict, fine = noise_verdict(record.get("noise") or {})
        out += [] if fine else [verdict]
    if record.get("converged") is False and not any("converged" in t for t in out):
        out.append("the fit had not converged")
    far = [str(p.get("name")) for p in one.parameters if (tolerances(p) or 0.0) > 3.0]
    if far:
        out.append(f"{count(len(far), 'parameter')} more than 3 tolerances from nominal: "
                   + listed(far))
    return out


def tolerances(p: Mapping[str, Any]) -> float | None:
    """Return a parameter's error in tolerances, None without one."""
    error, tolerance = number(p.get("error")), number(p.get("tolerance"))
    return abs(error) / tolerance if error is not None and tolerance else None


def _of_rows(rows: ResidualRows) -> list[str]:
    out = [finding_text(f) for f in rows.record.get("findings") or ()]
    flagged = len(rows.flagged)
    if flagged and rows.table is not None and not out:
        out.append(f"{whole(flagged)} of {count(rows.table.size, 'row')} of {rows.kind}.csv "
                   "refused or with a remark")
    return out


def _of_truth(c: ComparedMachines) -> list[str]:
    far = [r.name for r in c.rows if r.z is not None and abs(r.z) > 4.0]
    return [f"{count(len(far), 'identified error')} more than 4 sigma from the simulated truth: "
            + listed(far)] if far else []
