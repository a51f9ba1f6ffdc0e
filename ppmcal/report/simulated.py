"""What the page makes of ``simulate``: what was put in, against what was found in a fit of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from ppmcal.io.results.identification_tables import rms
from ppmcal.io.results.simulation import BEYOND_NEAR, FAR, NEAR, ComparedMachines, TruthRecord
from ppmcal.report.html import (
    Cell,
    count,
    figures,
    name_cell,
    number_cell,
    paragraph,
    sig,
    table,
    text_cell,
    to_sigma,
)
from ppmcal.report.records import Identified, ReportData, Simulated
from ppmcal.report.residual_figures import truth_figures
from ppmcal.report.rows import conditions
from ppmcal.report.section import Chapter, Folder, Kind, Section
from ppmcal.report.verdict import other_machine
from ppmcal.store.inputs import digest_of
from ppmcal.wording import abbreviate_list, sentence


def stray_note(source: Simulated, identified: Sequence[Identified]) -> str:
    """Return that a truth belongs to none of the identifications shown; empty if it does."""
    if source.truth is None or not identified or any(source.behind(i) for i in identified):
        return ""
    return (f"The truth in {source.folder} belongs to none of the identifications shown: they "
            "used other measurements, so nothing is compared.")


def simulation_section(s: Simulated, note: str = "") -> Section:
    """Return what was simulated; ``note`` is what to say of its truth."""
    rows = count(s.measurements.size, "measurement") if s.measurements is not None else "no CSV"
    seed = None if s.truth is None else s.truth.provenance.seed
    text = f"{rows} simulated in {s.folder}" + (f", seed {seed}." if seed is not None else ".")
    return Section("Simulation", paragraph(text) + paragraph(note))


def truth_section(c: ComparedMachines) -> Section:
    """Return the errors put in against those found."""
    body: list[list[Cell]] = []
    for r in c.rows:
        body.append([name_cell(r.name), number_cell(r.true, to_sigma(r.true, r.sigma)),
                     number_cell(r.found, to_sigma(r.found, r.sigma)),
                     number_cell(r.difference, to_sigma(r.difference, r.sigma)),
                     number_cell(r.sigma, sig(r.sigma, 2)), text_cell(r.unit),
                     number_cell(r.z, sig(r.z, 2), bad=abs(r.z or 0.0) > FAR), text_cell(r.status)])
    z, text = c.z, ""
    if z.size:
        off = len(c.beyond(NEAR))
        text = (f"{off} of {count(int(z.size), 'error')} found "
                f"{'is' if off == 1 else 'are'} more than {NEAR:g} sigma from the truth "
                f"(about {sig(BEYOND_NEAR * z.size, 2)} expected); rms of z {sig(rms(z))}.")
    heads = ["parameter", "error true", "error found", "found − true", "sigma", "unit", "z",
             "status"]
    told = " ".join(t for t in (sentence(other_machine(c)), c.note) if t)
    return Section("Simulated truth against identified", paragraph(text)
                   + paragraph(told, "bad") + figures(truth_figures(c))
                   + table("z = (found − true) / sigma", heads, body, sort=True),
                   f"{c.truth} and {c.identified}")


def _read(folder: Folder) -> Iterator[Simulated]:
    if not folder.has("truth.json", "measurements.csv"):
        return
    file, truth = folder.path / "measurements.csv", folder.has(TruthRecord.FILE)
    yield Simulated(folder.name, folder.record(TruthRecord) if truth else None,
                    conditions(file) if file.is_file() else None, digest_of(file))


def _chapters(s: Simulated, data: ReportData) -> Iterator[Chapter]:
    """Yield the simulation if nothing compares with it."""
    if s.folder not in {c.truth for c in data.comparisons}:
        yield f"Simulation in {s.folder}", lambda: simulation_section(
            s, stray_note(s, data.identified))


def _findings(s: Simulated, _: ReportData) -> list[tuple[str, str]]:
    gone = () if s.truth is None else s.truth.left_out
    return [(s.folder, f"{count(len(gone), 'pose')} could not be simulated: "
             + abbreviate_list(gone, "truth.json, left_out"))] if gone else []


def _of_truth(c: ComparedMachines) -> list[str]:
    if c.other:
        return [other_machine(c)]
    far = c.beyond(FAR)
    return [f"{count(len(far), 'identified error')} more than {FAR:g} sigma from the simulated "
            "truth: " + abbreviate_list(far, "the table of errors true and found")] if far else []


def _shown(s: Simulated, data: ReportData) -> dict[str, Any]:
    return {"folder": s.folder, "truth": s.truth and s.truth.entries(),
            "rows": s.measurements.size if s.measurements is not None else None,
            "sha256": s.digest, "note": stray_note(s, data.identified)}


def _compared(c: ComparedMachines, _: ReportData) -> dict[str, Any]:
    return {"truth": c.truth, "identified": c.identified, "note": c.note,
            "other_nominal_values": list(c.other),
            "parameters": [{**asdict(r), "z": r.z} for r in c.rows]}


SIMULATE: Kind[Simulated] = Kind(
    "simulated", "simulations", "simulation", 36, ("measurements.csv", "truth.json"), _read,
    _chapters, _shown, lambda s: [("simulate", s.truth)] if s.truth else [], _findings)
TRUTH: Kind[ComparedMachines] = Kind(
    "comparisons", "truth_against_identified", "", 35, (), lambda _: (),
    lambda c, _: [(f"Truth in {c.truth}", partial(truth_section, c))],
    _compared, lambda _: [], lambda c, _: [(c.identified, text) for text in _of_truth(c)],
    lambda c, _: {"truth": truth_figures(c)})
