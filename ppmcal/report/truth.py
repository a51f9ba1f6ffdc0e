"""Simulated truth against identified errors."""

from __future__ import annotations

from collections.abc import Sequence

from ppmcal.report.format import number
from ppmcal.report.records import ComparedMachines, Identified, Record, Simulated, TruthRow
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

    A campaign that was simulated again elsewhere differs in its last digits: a twin.
    """
    inputs = ((one.record.get("provenance") or {}).get("inputs") or {}).values()
    return any(d in inputs for d in (source.digest, *source.twins) if d)


def stray_note(source: Simulated, identified: Sequence[Identified]) -> str:
    """Return that a truth belongs to none of the identifications shown; empty if it does."""
    if source.truth is None or not identified or any(belongs(source, i) for i in identified):
        return ""
    return (f"The truth in {source.folder} belongs to none of the identifications shown: they "
            "used other measurements, so nothing is compared.")


def true_errors(truth: Record) -> dict[str, tuple[float, str]]:
    """Return (error, unit) by parameter, from ``errors`` or ``parameters`` of truth.json."""
    out: dict[str, tuple[float, str]] = {}
    for part in (truth.get("parameters"), truth.get("errors")):
        pairs = part.items() if isinstance(part, dict) else (
            [(e.get("name"), e) for e in part if isinstance(e, dict)]
            if isinstance(part, list) else [])
        for name, entry in pairs:
            unit = ""
            if isinstance(entry, dict):
                unit = str(entry.get("unit") or "")
                value = number(entry.get("error"))
                low, high = number(entry.get("nominal")), number(entry.get("value"))
                if value is None and low is not None and high is not None:
                    value = high - low
            else:
                value = number(entry) if part is truth.get("errors") else None
            if value is not None and isinstance(name, str):
                out[name] = (value, unit or out.get(name, (0.0, ""))[1])
    return out


def _rows(one: Identified, truth: Record) -> tuple[tuple[TruthRow, ...], list[str]]:
    """Return the parameters that both know, and those whose units do not match."""
    errors = true_errors(truth)
    units = truth.get("units") or {}
    rows, skipped = [], []
    for p in one.parameters:
        name, found = str(p.get("name") or ""), number(p.get("error"))
        if found is None or (name not in errors and p.get("status") == "fixed"):
            continue
        if name not in errors and not errors:
            continue
        true, unit = errors.get(name, (0.0, ""))
        own = str(p.get("unit") or "")
        factor = _factor(unit or _same_quantity(own, units), own)
        if factor is None:
            skipped.append(name)
            continue
        rows.append(TruthRow(name, own, true * factor, found, number(p.get("sigma")),
                             str(p.get("status") or "")))
    return tuple(rows), skipped


def _same_quantity(unit: str, units: Record) -> str:
    """Return the truth file's unit of the quantity that ``unit`` measures (``mm``, ``mm/unit``)."""
    bare = unit.removesuffix(PER_UNIT)
    quantity = "length" if bare in LENGTHS else "angle" if bare in ANGLES else ""
    own = str(units.get(quantity) or "")
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
