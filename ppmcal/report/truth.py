"""Which simulated truth belongs to which identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.results.simulation import ComparedMachines, compared
from ppmcal.io.tables import read_table
from ppmcal.linalg import Array
from ppmcal.report.records import Identified, Simulated
from ppmcal.store.inputs import digest_of

ROUND_OFF = 1e-11
"""Measurements are the same where they differ by less than this part of a column's largest."""


def compare(identified: Sequence[Identified], simulated: Sequence[Simulated]
            ) -> tuple[ComparedMachines, ...]:
    """Return one comparison for each identification whose measurements were simulated here."""
    found = [compared(source.truth, one.record.parameters, (source.folder, one.folder))
             for one in identified for source in simulated
             if source.truth is not None and belongs(source, one)]
    return tuple(c for c in found if c.rows)


def belongs(source: Simulated, one: Identified) -> bool:
    """Whether the identification used these measurements: it names the check sum of a file of them.

    A campaign that was simulated again elsewhere differs in its last digits: a copy.
    """
    inputs = one.record.provenance.inputs.values()
    return any(d in inputs for d in (source.digest, *source.copies) if d)


def stray_note(source: Simulated, identified: Sequence[Identified]) -> str:
    """Return that a truth belongs to none of the identifications shown; empty if it does."""
    if source.truth is None or not identified or any(belongs(source, i) for i in identified):
        return ""
    return (f"The truth in {source.folder} belongs to none of the identifications shown: they "
            "used other measurements, so nothing is compared.")


def with_copies(one: Simulated, identified: Sequence[Identified]) -> Simulated:
    """Find the inputs of identifications that hold the same measurements to round-off."""
    if one.truth is None or not one.digest:
        return one
    file, copies = Path(one.folder) / "measurements.csv", set[str]()
    for fit in identified:
        copies |= {own for name, own in fit.record.provenance.inputs.items()
                   if name.endswith(".csv") and own not in ("", one.digest)
                   and digest_of(Path(name)) == own and _same_numbers(file, Path(name))}
    return replace(one, copies=tuple(sorted(copies)))


def _same_numbers(one: Path, other: Path) -> bool:
    """Whether two CSV files have the same columns, and numbers that differ by round-off at most."""
    try:
        a, b = (read_table(p, loose=lambda _: True, rowless=True) for p in (one, other))
    except BadInput:
        return False
    return (a.header, a.size, a.text) == (b.header, b.size, b.text) and all(
        _same_column(a.numbers[name], b.numbers[name]) for name in a.numbers)


def _same_column(one: Array, other: Array) -> bool:
    largest = float(np.max(np.abs(one), initial=0.0, where=np.isfinite(one)))
    return np.allclose(one, other, rtol=0.0, atol=ROUND_OFF * largest, equal_nan=True)
