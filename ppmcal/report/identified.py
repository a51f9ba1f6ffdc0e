"""What the page makes of ``identify``: the chapter with its machine, and what needs a look."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from ppmcal.calibration.fit import Noise
from ppmcal.calibration.knowledge import FAR
from ppmcal.io.results import identification_wording as wording
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import ParameterEstimate, before_words
from ppmcal.io.results.identification_tables import (
    NEXT_TABLE,
    PARAMETER_TABLE,
    RESIDUAL_TABLE,
    quantity_of,
    used,
    white,
)
from ppmcal.io.results.parts import ErrorSize, campaign_sentences
from ppmcal.plotting.canvas import Drawing
from ppmcal.report.html import (
    NBSP,
    Cell,
    bullets,
    count,
    definitions,
    error_bar,
    exact,
    figures,
    name_cell,
    number,
    number_cell,
    paragraph,
    part,
    probability,
    sig,
    table,
    text_cell,
    to_sigma,
    typeset,
    whole,
    with_unit,
)
from ppmcal.report.machine_section import machine_drawings, machine_section
from ppmcal.report.records import Identified, ReportData
from ppmcal.report.residual_figures import coordinate_figures, residual_figures
from ppmcal.report.rows import DataRows, excluded, excluded_rows, gross_error_section, rows_section
from ppmcal.report.section import Chapter, Folder, Kind, Section, chapter, filled
from ppmcal.report.verdict import IN_THE_FIT, figure, headline, unseen
from ppmcal.wording import MOST, abbreviate_list


def identifiability_section(record: IdentificationRecord) -> Section | None:
    """Return what these data cannot identify."""
    lines = [*wording.open_sentences(record.collinear, record.scale),
             *wording.flat_sentences(record.flats),
             *wording.unchecked_sentences(record.unchecked), *campaign_sentences(record.campaign)]
    return Section("Identifiability", bullets([typeset(t) for t in lines])) if lines else None


STAGES = (("before", "before"), ("after", "after"), ("holdout", "held out"))
COLUMNS = ("mean", "rms", "p95", "max")


def identified_section(one: Identified, index: int, title: str, body: str = "") -> Section:
    """Return the chapter about one identification.

    ``index``: its place on the page, from 0; ``body``: ready HTML before its parts.
    """
    r = one.record
    units = {p.name: p.unit for p in r.parameters}
    return Section(title, body, one.folder, parts=filled([
        accuracy(one), *plots(one, index), rows_section(one, index), excluded(one, index),
        gross_error_section(r, units, index), parameters(r),
        identifiability_section(r), redundant(r), correlations(r)]))


def errors(one: Identified) -> Iterator[tuple[str, str, ErrorSize]]:
    """Yield kind, name and statistics of each error: before, after, held out."""
    residual = one.record.residual
    for kind in dict.fromkeys(k for s, _ in STAGES for k in getattr(residual, s)):
        for stage, name in STAGES:
            part = figure(one, stage, kind)
            if any(getattr(part, c) is not None for c in COLUMNS):
                yield kind, f"{kind}, {name}", part


def accuracy(one: Identified) -> Section | None:
    """Return the table of errors before, after and held out."""
    residual, found = one.record.residual, list(errors(one))
    rows = [[text_cell(name), text_cell(part.unit),
             *(number_cell(getattr(part, c)) for c in COLUMNS)] for _, name, part in found]
    if not rows:
        return None
    kinds = list(dict.fromkeys(kind for kind, *_ in found))
    words = [one.record.holdout_note, before_words(residual.before_is).strip()]
    if kinds == ["closure"]:
        words.append("Closure is how far each limb is from closing at the pose that suits all "
                     "best, as a length.")
    elif "closure" in kinds:
        words.append("Closure is the limb condition at the measured poses, as a length.")
    note = " ".join(w[0].upper() + w[1:].rstrip(".") + "." for w in words if w)
    return Section("Error before and after", '<div class="pair">'
                   + table("p95: 95 % of the rows are below it", ["error", "unit", *COLUMNS], rows)
                   + f"<div>{_fit_facts(one.record)}{paragraph(note, 'note')}</div></div>")


def _fit_facts(r: IdentificationRecord) -> str:
    """Return noise, rank, iterations and observability."""
    facts = _noise_facts(r.noise)
    if r.rank is not None:
        of = f" of {r.columns} unknowns, frames and targets included" if r.columns else ""
        facts.append(("Rank", f"{r.rank}{of}"))
    if r.iterations is not None:
        state = {True: ", converged", False: ", not converged", None: ""}[r.converged]
        facts.append(("Iterations", f"{r.iterations}{state}"))
    if r.prior_scale is not None and r.prior_scale != 1.0:
        facts.append(("Tolerances scaled by", sig(r.prior_scale)))
    index = [f"{k}{NBSP}{sig(v)}" for k, v in sorted(r.observability.items())
             if k in ("O1", "O2", "O3", "O4", "O5")]
    facts.append(("Observability indices", " · ".join(index)))
    facts.append(("Measured region", "; ".join(
        f"{name} {' … '.join(with_unit(e, r.units.name(quantity_of(name)), 4) for e in ends)}"
        for name, ends in r.measured_volume.items())))
    return definitions(facts)


def _noise_facts(noise: Noise) -> list[tuple[str, str]]:
    """Return what the residuals say about the stated or estimated noise."""
    facts: list[tuple[str, str]] = []
    if math.isfinite(noise.sigma_ratio):
        facts.append((f"Residual over {noise.source} noise", sig(noise.sigma_ratio)))
    if len(noise.by_dataset) > 1:
        facts.append(("The same by file",
                      ", ".join(f"{n} {sig(v)}" for n, v in noise.by_dataset.items())))
    if math.isfinite(noise.chi2):
        facts.append(("χ² of the noise", _chi2(noise.chi2, noise.degrees, noise.chi2_p)))
    if math.isfinite(noise.prior_chi2) and noise.prior_degrees > 0.0:
        facts.append(("χ² of errors against tolerances",
                      _chi2(noise.prior_chi2, noise.prior_degrees, noise.prior_p)))
    if noise.repeat_ratio is not None:
        facts.append((f"Scatter of repeats over {noise.source} noise", sig(noise.repeat_ratio)))
    return facts


def _chi2(value: float, degrees: float | None, p: float | None) -> str:
    """Return a chi-squared in words."""
    return f"{sig(value, 4)} with {sig(degrees, 4)} degrees of freedom, {probability(p)}".rstrip(
        ", ")


def parameters(r: IdentificationRecord) -> Section | None:
    """Return the table of parameters; fixed ones follow in a table of their own."""
    if not r.parameters:
        return None
    free = r.free
    fixed = [p for p in r.parameters if p.status == "fixed"]
    heads = ["parameter", "unit", "nominal", "value", "95 % interval", "error", "tolerance",
             "error against tolerance", "sigma by noise", "sigma, data only", "status"]
    note = ("Bars: error in tolerances, shaded: one to each side, ends: three; "
            "line: 95 % interval; red tip: beyond the end.")
    note = " ".join([note, *(f"{t}." for t in wording.short_intervals(r.method))])
    out = paragraph(note, "note") + table("", heads, [_row(p) for p in free], sort=True)
    if fixed:
        rows = [[name_cell(p.name), number_cell(p.value, exact(p.value)), text_cell(p.unit)]
                for p in fixed]
        name = f"{count(len(fixed), 'parameter')} held fixed"
        out += (f"<details><summary>{name}</summary>"
                + table("", ["parameter", "value", "unit"], rows) + "</details>")
    far = sum(bool(p.far) for p in free)
    return Section("Parameters", out, f"{count(len(free), 'parameter')} identified"
                   + f", {far} {FAR}" * bool(far))


def _row(p: ParameterEstimate) -> list[Cell]:
    sigma, value, low, high = p.sigma, p.value, p.low, p.high
    if low is None and high is None and p.half is not None and value is not None:
        low, high = value - p.half, value + p.half
    interval = "–" if low is None and high is None else (
        f"{to_sigma(low, sigma)} … {to_sigma(high, sigma)}")
    return [name_cell(p.name), text_cell(p.unit), number_cell(p.nominal, exact(p.nominal)),
            number_cell(value, to_sigma(value, sigma)), number_cell(low, interval),
            number_cell(p.error, to_sigma(p.error, sigma), bad=bool(p.far)),
            number_cell(p.tolerance, exact(p.tolerance)),
            Cell(error_bar(p.error, p.tolerance, p.half),
                 number(p.tolerances)),
            number_cell(sigma, sig(sigma, 2)), number_cell(p.sigma_data, sig(p.sigma_data, 2)),
            text_cell(p.status_words, "warn" if p.status == "redundant" or p.disagree else "")]


def redundant(r: IdentificationRecord) -> Section | None:
    """Return the redundant combinations, one line for each quantity."""
    rows = [[name_cell(c.name or "?"), text_cell(typeset(wording.combination(c)), "wrap")]
            for c in r.redundant]
    if not rows:
        return None
    note = ("A change of the quantity and this change of the others act alike: only their "
            "combination can be identified, and predictions do not depend on how it is split; the "
            "prior splits it by the tolerances. Coefficients are in the file's units.")
    names = abbreviate_list([c.name or "?" for c in r.redundant])
    said = "" if len(rows) <= MOST else paragraph(
        f"{len(rows)} parameters are only identified in combination with others: {names}.")
    if r.unidentifiable:
        total = sum(s.combinations for s in r.unidentifiable)
        said = paragraph(f"{total} redundant: combinations that these data cannot identify: "
                         f"{wording.unidentifiable_words(r.unidentifiable)}.")
    return Section("Redundant combinations", said
                   + table("", ["one unit of", "acts like"], rows) + paragraph(note, "note"),
                   count(len(rows), "combination"), folded=True)


def correlations(r: IdentificationRecord) -> Section | None:
    """Return the strongest correlations."""
    found = sorted(((-abs(c.value), c) for c in r.correlations if c.value is not None),
                   key=lambda f: f[0])
    rows = [[name_cell(c.a), name_cell(c.b), number_cell(c.value)] for _, c in found[:12]]
    if not rows:
        return None
    more = f"the strongest 12 of {len(found)}" if len(found) > 12 else ""
    return Section("Strong correlations",
                   table(more, ["parameter", "with", "correlation"], rows, sort=True),
                   count(len(found), "pair"), folded=True)


def drawings(one: Identified, index: int = 0) -> dict[str, list[Drawing]]:
    """Return the pictures of residuals: of all together, and of each coordinate."""
    rows = DataRows.of(one, index)
    return {"residuals": residual_figures(rows), "coordinates": coordinate_figures(rows)}


def plots(one: Identified, index: int) -> list[Section]:
    """Return the residual plots, those of single coordinates folded."""
    t = one.residuals
    if t is None:
        return []
    keep = used(t)
    out = whole(int((~keep).sum()))
    note = count(t.size, "row") + ("" if keep.all() else f", {out} of them left out of the fit")
    drawn = drawings(one, index)
    each = drawn["coordinates"]
    return [Section("Residuals", figures(drawn["residuals"]), note),
            Section("Residuals by coordinate", figures(each), count(len(each), "plot"),
                    folded=True)]


FEW = 3
"""So many parts of a calibration are open where there are several calibrations."""


def is_fit(folder: Folder) -> bool:
    """Whether a folder holds a fit; residuals alone may be those of a diagnosis."""
    return folder.has("identification.json", "parameters.csv", "identified.yaml") or (
        folder.has("residuals.csv") and not folder.has("diagnosis.json", "effects.csv"))


def _read(folder: Folder) -> Iterator[Identified]:
    if is_fit(folder):
        yield Identified(
            folder.name, PARAMETER_TABLE.parameters(folder.record(IdentificationRecord),
                                                    folder.table(PARAMETER_TABLE)),
            folder.table(RESIDUAL_TABLE), next=folder.table(NEXT_TABLE),
            diagnosed=folder.has("diagnosis.json", "effects.csv"))


def calibration(one: Identified, data: ReportData) -> Chapter:
    """Return the chapter of a calibration."""
    (n,) = (n for n, other in enumerate(data.identified) if other is one)
    return f"Calibration in {one.folder}", partial(_calibration, one, n, data)


def _calibration(one: Identified, n: int, data: ReportData) -> Section:
    """Return the chapter about a calibration, the machine drawn in it."""
    days = abbreviate_list([d.name for d in one.record.datasets], most=2)
    several = len(data.identified) > 1
    name = ": ".join(filter(None, [f"Calibration of {one.name}", days])) if several else (
        "Calibration")
    found = identified_section(one, n, name, part("tiles", _tiles(one, data)))
    drawn = chapter("The machine", lambda: Section(
        "The machine", machine_section(one, n, data.diagnosed, len(data.identified))))
    return replace(found, parts=tuple(
        replace(p, folded=p.folded or (several and i >= FEW))
        for i, p in enumerate(filled([drawn, *found.parts]))))


def _tiles(one: Identified, data: ReportData) -> list[dict[str, Any]]:
    """Return the key figures: rms of each kind of error before, and of poses no fit has seen."""
    out = []
    for kind, after in one.record.residual.after.items():
        before, found = figure(one, "before", kind).rms, unseen(one, kind, data)
        fitted = [] if after.rms is None else [with_unit(after.rms, after.unit)]
        flow = [] if before is None else [with_unit(before, after.unit)]
        flow += [found[0]] if found else fitted
        more = [f"{IN_THE_FIT} {v}" for v in fitted if found]
        if after.max is not None:
            more.append(f"largest {IN_THE_FIT} {with_unit(after.max, after.unit)}")
        if flow:
            out.append({"what": f"{kind.capitalize()}, rms before → "
                        f"{found[1] if found else IN_THE_FIT}", "flow": flow,
                        "more": " · ".join(more)})
    return out


def place(one: Identified, data: ReportData) -> str:
    """Return what an identification is called: by its folder where several have its name."""
    same = [other for other in data.identified if other.name == one.name]
    return one.name if len(same) == 1 else one.folder


def _findings(one: Identified, data: ReportData) -> list[tuple[str, str]]:
    record = one.record
    out = [*record.all_findings(), *wording.unchecked_sentences(record.unchecked),
           *campaign_sentences(record.campaign)]
    if record.scale is not None and (told := wording.scale_sentence(record.scale)):
        out.append(told)
    out += [] if "findings" in record.given else _of_fields(record)
    return [(place(one, data), text) for text in out]


def _of_fields(record: IdentificationRecord) -> list[str]:
    """Return what the fields of a file say that lists no findings."""
    out = []
    if record.excluded:
        out.append(f"{count(len(record.excluded), 'row')} left out of the fit")
    verdict, fine = wording.noise_verdict(record.noise)
    if not fine:
        out.append(verdict)
    if record.converged is False:
        out.append("the fit had not converged")
    if record.far:
        out.append(f"{FAR}: {abbreviate_list([p.name for p in record.far], 'parameters.csv')}")
    return out


def _shown(one: Identified, _: ReportData) -> dict[str, Any]:
    record = one.record.entries()
    out: dict[str, Any] = {"folder": one.folder, "identification": record,
                           "parameters": record.get("parameters", ())}
    if one.residuals is not None:
        out["residuals"] = {
            "rows": one.residuals.size, "used": int(used(one.residuals).sum()),
            "white_rms": white(one.residuals, one.freedoms).rms,
            "excluded": [{"dataset": e.dataset, "row": e.row, "reason": e.reason}
                         for e in excluded_rows(one)]}
    return out


IDENTIFY: Kind[Identified] = Kind(
    "identified", "identifications", "identification", 20,
    ("identification.json", "parameters.csv", "residuals.csv", "identified.yaml"), _read,
    lambda one, data: [] if one.diagnosed else [calibration(one, data)],
    _shown, lambda one: [("identify", one.record)], _findings,
    lambda one, _: {"machine": machine_drawings(one), **drawings(one)}, headline)
