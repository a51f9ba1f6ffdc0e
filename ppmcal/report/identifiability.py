"""What an identification says besides its numbers: identifiability and gross errors."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.io.results.campaign import campaign_sentences
from ppmcal.io.results.gross_errors import GrossErrorSummary
from ppmcal.io.results.identifiability import flat_sentences
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.report.format import exact, number, typeset
from ppmcal.report.html import (
    MAX_ROWS,
    bullets,
    name_cell,
    number_cell,
    paragraph,
    table,
    text_cell,
)
from ppmcal.report.rows import row_key
from ppmcal.report.section import Section


def identifiability_section(record: IdentificationRecord) -> Section | None:
    """Return what these data cannot identify."""
    lines = [*record.identifiability.sentences(), *flat_sentences(record.flats),
             *record.gross_errors.unchecked_sentences(), *campaign_sentences(record.campaign)]
    return Section("Identifiability", bullets([typeset(t) for t in lines])) if lines else None


def gross_error_section(found: GrossErrorSummary, units: Mapping[str, str], index: int
                        ) -> Section | None:
    """Return what the rows left out said, and what they would have done to the parameters."""
    rows = [[text_cell(r.dataset), number_cell(r.row, exact(r.row)), text_cell(r.coordinate),
             number_cell(r.value, _digits(r.value)), number_cell(r.predicted, _digits(r.predicted)),
             text_cell(r.unit), number_cell(r.times)] for r in found.rows]
    out = table(_first("What those rows say, and what all others say of them", len(rows)),
                ["data set", "row", "number", "measured", "the others say", "unit",
                 "times the noise"], rows[:MAX_ROWS], sort=True,
                keys=[row_key(index, r.dataset, r.row or 0) for r in found.rows[:MAX_ROWS]])
    body = [[name_cell(name), number_cell(e.now, _digits(e.now)),
             number_cell(e.with_them, _digits(e.with_them)), text_cell(units.get(name, ""))]
            for name, e in found.would_be.items()
            if e.now is not None and e.with_them is not None]
    out += table(_first("What parameters would be with them", len(body)),
                 ["parameter", "now", "with them", "unit"], body[:MAX_ROWS], sort=True)
    if not out:
        return None
    note = "These rows were left out because the others contradict them."
    return Section("Gross errors", paragraph(note, "note") + out, folded=True)


def _digits(value: float | None) -> str:
    """Return a number to six digits, as the console shows it."""
    x = number(value)
    return "–" if x is None else f"{x:.6g}".replace("-", "−")


def _first(caption: str, size: int) -> str:
    return caption + (f"; the first {MAX_ROWS} of {size}" if size > MAX_ROWS else "")
