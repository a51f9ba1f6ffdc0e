"""What the page makes of ``identify``: the chapter with its machine, and what needs a look."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from ppmcal.calibration.knowledge import FAR
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_tables import (
    NEXT_TABLE,
    PARAMETER_TABLE,
    RESIDUAL_TABLE,
    used,
    white,
)
from ppmcal.io.results.identification_wording import (
    noise_verdict,
    scale_sentence,
    unchecked_sentences,
)
from ppmcal.io.results.parts import campaign_sentences
from ppmcal.report.html import count, part, with_unit
from ppmcal.report.identification import drawings, excluded_rows, identified_section
from ppmcal.report.machine_section import machine_drawings, machine_section
from ppmcal.report.records import Identified, ReportData
from ppmcal.report.section import Chapter, Folder, Kind, Section, chapter, filled
from ppmcal.report.verdict import IN_THE_FIT, figure, headline, unseen
from ppmcal.wording import abbreviate_list

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
    out = [*record.all_findings(), *unchecked_sentences(record.unchecked),
           *campaign_sentences(record.campaign)]
    if record.scale is not None and (told := scale_sentence(record.scale)):
        out.append(told)
    out += [] if "findings" in record.given else _of_fields(record)
    return [(place(one, data), text) for text in out]


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
