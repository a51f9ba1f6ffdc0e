"""Simulated truth against identified errors."""

from __future__ import annotations

from collections.abc import Sequence

from ppmcal.io.results.record import UnitNames
from ppmcal.io.results.simulation import TruthRecord
from ppmcal.report.format import number
from ppmcal.report.records import ComparedMachines, Identified, Simulated, TruthRow
from ppmcal.units import ANGLES, LENGTHS

PER_UNIT = "/unit"
"""Ends the unit of a drive's ratio."""


def compare(identified: Sequence[Identified], simulated: Sequence[Simulated]
            ) -> tuple[ComparedMachines, ...]:
    """Return one comparison for each identification whose measurements were simulated here."""
    out = []
    for one in identified:
        for source in simulated:
            if source.truth is None or not belongs(source, one):
                continue
            rows, skipped = _rows(one, source.truth)
            units = f"Units do not match and are left out: {', '.join(skipped)}." * bool(skipped)
            if rows:
                out.append(ComparedMachines(source.folder, one.folder, rows, units))
    return tuple(out)


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


def _rows(one: Identified, truth: TruthRecord) -> tuple[tuple[TruthRow, ...], list[str]]:
    """Return the parameters that both know, and those whose units do not match."""
    errors = {n: e for n, value in truth.errors.items() if (e := number(value)) is not None}
    rows, skipped = [], []
    for p in one.record.parameters if errors else ():
        if p.error is None or (p.name not in errors and p.status == "fixed"):
            continue
        factor = _factor(_same_quantity(p.unit, truth.units), p.unit)
        if factor is None:
            skipped.append(p.name)
            continue
        rows.append(TruthRow(p.name, p.unit, errors.get(p.name, 0.0) * factor, p.error, p.sigma,
                             p.status))
    return tuple(rows), skipped


def _same_quantity(unit: str, units: UnitNames) -> str:
    """Return the truth file's unit of the quantity that ``unit`` measures (``mm``, ``mm/unit``)."""
    bare = unit.removesuffix(PER_UNIT)
    quantity = "length" if bare in LENGTHS else "angle" if bare in ANGLES else ""
    own = units.of_quantity(quantity) if quantity else ""
    return own + unit.removeprefix(bare) if own else ""


def _factor(of: str, to: str) -> float | None:
    """Return what turns a number in ``of`` into one in ``to``; None if they do not match."""
    if of == to or not of or not to:
        return 1.0
    if of.endswith(PER_UNIT) != to.endswith(PER_UNIT):
        return None
    of, to = of.removesuffix(PER_UNIT), to.removesuffix(PER_UNIT)
    for table in (LENGTHS, ANGLES):
        if of in table and to in table:
            return table[of] / table[to]
    return None
