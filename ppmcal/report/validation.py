"""The chapters about what no fit has seen: how frozen machines predict it, and certificates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from ppmcal.io.results.certificate import (
    CertificateRecord,
    ErrorMap,
    Heading,
    NamedLines,
    PrintedTable,
    Words,
    blocks,
    title,
)
from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.validation import PredictedError, ValidatedDataset, ValidationRecord
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Layer, Marks, Points, Strokes
from ppmcal.plotting.plot import Axis, row_y, rows_plot, span
from ppmcal.report.html import (
    Cell,
    definitions,
    figures,
    number_cell,
    paragraph,
    sig,
    table,
    text_cell,
    typeset,
)
from ppmcal.report.records import Held, ReportData
from ppmcal.report.section import Kind, Section, recorded

ROW, NAMES = 17.0, 170.0
"""Height of a line and room for names, points."""
STYLES = {"better": "after", "worse": "out"}


def days(datasets: Sequence[ValidatedDataset]) -> str:
    """Return picture, table and words of every data set."""
    out = figures(drawings(datasets))
    for data in datasets:
        out += paragraph(typeset(data.prediction()))
        how = typeset(data.basis())
        out += table(how, _heads(data), [_row(e) for e in data.errors]) if data.errors else ""
    return out


def misled(datasets: Sequence[ValidatedDataset]) -> list[str]:
    """Return what a person must look at."""
    return [text for data in datasets for text in data.misled()]


def lead(record: ValidationRecord) -> str:
    """Return what the page begins with."""
    return typeset(" ".join(d.model_sentence() for d in record.datasets[:3]))


def _heads(data: ValidatedDataset) -> list[str]:
    """Return the heads of the columns, units among them."""
    first = data.errors[0]
    size = first.size
    unit = "" if size is None else f", {size.unit}"
    more = [f"rotation, {first.rotation.unit} rms"] if first.position and first.rotation else []
    error = "closure" if data.alone else "error"
    return ["machine", f"{error}{unit} rms", "its 95 %", f"95 % point{unit}", f"largest{unit}",
            *more, f"better by{unit}", "its 95 %", ""]


def _row(e: PredictedError) -> list[Cell]:
    """Return a machine's line."""
    size = e.size or ErrorSize()
    between = _between(e.low, e.high, 2) if e.verdict else ""
    more = [number_cell(e.rotation.rms)] if e.position and e.rotation else []
    return [text_cell(e.model), number_cell(size.rms),
            number_cell(size.rms_low, _between(size.rms_low,
            size.rms_high)), number_cell(size.p95), number_cell(size.max), *more,
            number_cell(e.closer, sig(e.closer, 2) if e.verdict else ""),
            number_cell(e.low, between),
            text_cell(e.verdict, "warn" if e.verdict == "worse" else "")]


def _between(low: float | None, high: float | None, digits: int = 3) -> str:
    """Return both ends of an interval, empty where one is open."""
    return "" if low is None or high is None else f"{sig(low, digits)} to {sig(high, digits)}"


def drawings(datasets: Sequence[ValidatedDataset]) -> list[Drawing]:
    """Return the pictures of predicted data sets."""
    return [p for d in datasets if (p := picture(d)) is not None]


def picture(data: ValidatedDataset) -> Drawing | None:
    """Return the error of every machine on one data set, None where nothing is to compare."""
    shown = [(e, size.rms, size.unit) for e in data.errors if (size := e.size)
             and size.rms is not None]
    if len(shown) < 2:
        return None
    machines, rms, units = zip(*shown, strict=True)
    unit = units[0]
    layers, ends = _layers(machines, rms, unit)
    x = span(ends)
    return rows_plot(Axis(max(x.low, 0.0), x.high), f"error, {unit} rms", layers,
                     [(e.model, i == 0) for i, e in enumerate(machines)], unit, NAMES, ROW).drawing(
        f"Error on {data.name}, {unit} rms",
        "Frozen machines, the registration alone fitted. Bars: 95 % of the difference from the "
        "first, drawn by pose. A machine whose bar does not reach the grey line is surely "
        "better or worse.", f"{len(shown)} machines with their errors.", _key(machines))


def _key(shown: Sequence[PredictedError]) -> tuple[tuple[str, str], ...]:
    there = {e.verdict for e in shown}
    return tuple((kind, f"surely {word}") for word, kind in STYLES.items() if word in there)


def _layers(shown: Sequence[PredictedError], rms: Sequence[float], unit: str
            ) -> tuple[list[Layer], list[float]]:
    """Return a mark and a bar for each machine, and all ends of x."""
    first, ends = rms[0], [0.0, *rms]
    layers: list[Layer] = [Strokes([first], [0.0], [float(len(shown))], "ink", 1.0, 0.4)]
    for e, value, y in zip(shown, rms, row_y(len(shown)).tolist(), strict=True):
        kind, said = STYLES.get(e.verdict, "ink"), e.model
        if e.verdict and e.low is not None and e.high is not None:
            low, high = first - e.high, first - e.low
            layers.append(Strokes([y], [low], [high], kind, flat=True))
            ends += [low, high]
            said += f"\n95 %: {sig(low)} … {sig(high)} {unit}"
        layers.append(Marks(np.array([value]), np.array([y]), kind, "o", points=Points([said])))
    return layers, ends


VALIDATE: Kind[Held[ValidationRecord]] = Kind(
    "validated", "validations", "validation", 60, (ValidationRecord.FILE,),
    recorded(ValidationRecord),
    lambda one, _: [(f"Validation in {one.folder}", partial(
        Section, "On other measurements", days(one.record.datasets), one.folder))],
    lambda one, _: {"folder": one.folder, "validation": one.record.entries()},
    lambda one: [("validate", one.record)], lambda one, _: [
        (one.folder, text) for text in (*one.record.findings, *misled(one.record.datasets))],
    lambda one, _: {"validation": drawings(one.record.datasets)},
    lambda one, _: [lead(one.record)])


def certificate_section(one: Held[CertificateRecord]) -> Section:
    """Return everything that a certificate states but its map, which its own page has."""
    parts: list[tuple[str, str]] = [("", "")]
    for block in blocks(one.record):
        match block:
            case Heading(text):
                parts.append((text, ""))
                continue
            case NamedLines(pairs):
                html = definitions([(name, typeset(text)) for name, text in pairs])
            case PrintedTable(heads, rows, _, right):
                html = table("", heads, [[
                    (number_cell(cell, typeset(cell)) if i in right else text_cell(typeset(cell)))
                    for i, cell in enumerate(row)] for row in rows])
            case Words(text):
                html = paragraph(typeset(text))
            case ErrorMap():
                html = paragraph("Drawn on the certificate itself, certificate.html.", "note")
        parts[-1] = (parts[-1][0], parts[-1][1] + html)
    (_, who), *chapters = parts
    return Section(title(one.record), who, one.folder, parts=tuple(
        Section(name, body) for name, body in chapters if body))


def _certified(one: Held[CertificateRecord], _: ReportData) -> Iterator[tuple[str, str]]:
    """Yield what the certificate itself warns of, and a limit that is not kept."""
    if one.record.result == "fail":
        yield one.folder, f"certificate {one.record.number}: the agreed limit is not kept"
    yield from ((one.folder, text) for text in one.record.findings)


CERTIFY: Kind[Held[CertificateRecord]] = Kind(
    "certified", "certificates", "certificate", 65, (CertificateRecord.FILE,),
    recorded(CertificateRecord),
    lambda one, _: [(title(one.record), partial(certificate_section, one))],
    lambda one, _: {"folder": one.folder, "record": one.record.entries(whole=True)},
    lambda one: [("certify", one.record)], _certified)
