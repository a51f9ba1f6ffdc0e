"""Rows and sessions that do not belong, in words and as JSON."""

from __future__ import annotations

from typing import Any

from ppmcal.calibration.homing_shift import HomingShift
from ppmcal.calibration.outliers import GrossError, GrossErrors
from ppmcal.io.results import identifiability_wording as told
from ppmcal.io.results.units import column_factor, parameter_unit
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism

SHOWN = 5


def shifts(found: GrossErrors, mechanism: Mechanism) -> list[str]:
    """Return one finding per zero that moved."""
    return [told.zero_moved(_moved(mechanism, s)) for s in found.shifts]


def sentences(found: GrossErrors, mechanism: Mechanism) -> list[str]:
    """Return which rows were left out and what for, and which nothing checks."""
    out = []
    for b in found.rows[:SHOWN]:
        factor, unit, name = _coordinate(mechanism, b)
        out.append(f"  {b.dataset}, row {b.row}: {name} {b.value / factor:.6g} {unit}, where the "
                   f"others say {b.predicted / factor:.6g} {unit} ({b.times:.3g} times the noise).")
    if len(found.rows) > SHOWN:
        out.append(f"  ... and {len(found.rows) - SHOWN} more rows, see residuals.csv.")
    for name, (now, then) in list(found.would.items())[:3]:
        f = column_factor(mechanism, name)
        out.append(f"  With them {name} would be {then / f:.6g} in place of {now / f:.6g} "
                   f"{parameter_unit(mechanism, name)}.")
    return out + [told.unchecked(e) for e in _unchecked(found)]


def entry(found: GrossErrors, mechanism: Mechanism) -> dict[str, Any]:
    """Return the same for identification.json, file units."""
    rows = []
    for b in found.rows:
        factor, unit, name = _coordinate(mechanism, b)
        rows.append({"dataset": b.dataset, "row": b.row, "coordinate": name,
                     "value": b.value / factor, "predicted": b.predicted / factor, "unit": unit,
                     "times": b.times})
    would = {name: {"now": now / column_factor(mechanism, name),
                    "with_them": then / column_factor(mechanism, name)}
             for name, (now, then) in found.would.items()}
    return {"rows": rows, "would_be": would,
            "zeros_moved": [_moved(mechanism, s) for s in found.shifts],
            "unchecked": _unchecked(found)}


def _moved(mechanism: Mechanism, s: HomingShift) -> dict[str, Any]:
    factor, unit = mechanism.joint_units[mechanism.actuators.index(s.actuator)]
    return {"session": s.session, "actuator": s.actuator, "value": s.value / factor,
            "sigma": s.sigma / factor, "unit": unit, "p_value": s.p_value}


def _unchecked(found: GrossErrors) -> list[dict[str, Any]]:
    return [{"dataset": n, "rows": r} for n, r in found.unchecked]


def _coordinate(mechanism: Mechanism, b: GrossError) -> tuple[float, str, str]:
    """Return SI value of the unit, unit, and name of a coordinate."""
    quantity = "length" if b.coordinate < 3 else "angle"
    name = b.number or POSE_COORDINATES[b.coordinate]
    return mechanism.units.factor(quantity), mechanism.units.name(quantity), name
