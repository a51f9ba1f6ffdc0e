"""The chapter about a certificate: what it states, laid out as the page's other chapters."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

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
from ppmcal.report.html import definitions, number_cell, paragraph, table, text_cell, typeset
from ppmcal.report.records import Held, ReportData
from ppmcal.report.section import Kind, Section, recorded


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


def findings(one: Held[CertificateRecord], _: ReportData) -> Iterator[tuple[str, str]]:
    """Yield what the certificate itself warns of, and a limit that is not kept."""
    if one.record.result == "fail":
        yield one.folder, f"certificate {one.record.number}: the agreed limit is not kept"
    for text in one.record.findings:
        yield one.folder, text


CERTIFY: Kind[Held[CertificateRecord]] = Kind(
    "certified", "certificates", "certificate", 65, (CertificateRecord.FILE,),
    recorded(CertificateRecord),
    lambda one, _: [(title(one.record), partial(certificate_section, one))],
    lambda one, _: {"folder": one.folder, "record": one.record.entries(whole=True)},
    lambda one: [("certify", one.record)], findings)
