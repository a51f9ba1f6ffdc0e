"""Rows and sessions that do not belong: a part of identification.json, and what is said of it.

A sentence about an entry in which a number is missing is empty.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from ppmcal.calibration.fit import GrossError, GrossErrors, HomingShift, UncheckedRows, half_or
from ppmcal.io.results.parts import LeftOutRow
from ppmcal.io.results.units import JOINT, MachineUnits, column_factor, parameter_unit
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.wording import abbreviate_list

SHOWN = 3
CHANGED = 3
ROWS = 8


def shift_sentence(shift: HomingShift) -> str:
    """Return which joint's homing offset shifted in which session, by how much."""
    half = half_or(shift.half if math.isfinite(shift.half) else None, shift.sigma)
    if half is None or not (math.isfinite(shift.value + half) and shift.actuator and shift.session):
        return ""
    return (f"the homing offset of {shift.actuator} shifted in {shift.session}: by "
            f"{shift.value:+.4g} +- {half:.2g} {shift.unit or 'units'} against the "
            "others; give that session a file of its own with `homing: per-file`")


def unchecked_sentences(found: Iterable[UncheckedRows]) -> list[str]:
    """Return which rows nothing else checks, one sentence for each data set."""
    out = []
    for u in found:
        if u.dataset and u.rows:
            some = abbreviate_list([str(r) for r in u.rows], most=ROWS)
            rows = f"rows {some} have" if len(u.rows) > 1 else f"row {some} has"
            out.append(f"{u.dataset}: {rows} no backup: a wrong reading there would go unnoticed. "
                       "Measure one more.")
    return out


def would_be(found: GrossErrors, mechanism: Mechanism) -> dict[str, dict[str, float]]:
    """Return what rows left out would change: value ``now`` and ``with_them``, file units."""
    return {name: {"now": now / f, "with_them": then / f}
            for name, (now, then) in found.would.items()
            for f in [column_factor(mechanism, name)]}


def row_sentences(rows: Sequence[LeftOutRow],
                  would: Mapping[str, Mapping[str, float | None]], mechanism: Mechanism
                  ) -> list[str]:
    """Return which rows were left out, what for, and what they would change."""
    out = [f"  {r.dataset}, row {r.row}: {r.coordinate} {_of(r.value, r)}, where "
           + (f"its repeats say {_of(r.predicted, r)} ({_six(r.times, 3)} times their scatter)."
              if r.repeats else
              f"the others say {_of(r.predicted, r)} ({_six(r.times, 3)} times the noise).")
           + _slack(r)
           for r in sorted(rows, key=lambda r: -(r.times or 0.0))[:SHOWN]]
    if len(rows) > SHOWN:
        out.append(f"  ... and {len(rows) - SHOWN} more rows, see residuals.csv.")
    out += slack_in_common(rows)
    return out + [f"  With them {name} would be {_six(e.get('with_them'))} in place of "
                  f"{_six(e.get('now'))} {parameter_unit(mechanism, name)}."
                  for name, e in list(would.items())[:CHANGED]]


def gross_rows(found: GrossErrors, mechanism: Mechanism) -> tuple[LeftOutRow, ...]:
    """Return the rows that were left out in file units."""
    return tuple(_left_out(r, mechanism) for r in found.rows)


def _left_out(error: GrossError, mechanism: Mechanism) -> LeftOutRow:
    unit = JOINT + error.joint if error.joint else (
        "length" if error.coordinate < 3 else "angle")
    return LeftOutRow.filled(error, MachineUnits.of(mechanism),
                             coordinate=error.number or POSE_COORDINATES[error.coordinate],
                             unit=unit, **({"may_be_slack": error.slack} if error.slack else {}),
                             **({"repeats": True} if error.joint else {}))


def _of(value: float | None, row: LeftOutRow) -> str:
    return f"{_six(value)} {row.unit}".rstrip()


def _slack(row: LeftOutRow) -> str:
    if not row.may_be_slack:
        return ""
    return f" It may be {' or '.join(row.may_be_slack)} that was slack."


def slack_in_common(left_out: Sequence[LeftOutRow]) -> list[str]:
    """Return which ropes may have been slack in all rows left out where one may have been.

    One contradiction a row has a sign, and no more: in many rows it leaves fewer ropes.
    """
    rows = [r.may_be_slack for r in left_out if r.may_be_slack]
    if len(rows) < 2:
        return []
    common = [name for name in rows[0] if all(name in r for r in rows)]
    every = len({n for r in rows for n in r}) == len(common)
    if not common:
        return [f"  In {len(rows)} of these rows ropes may have been slack, but no rope in all."]
    also = "" if every else ", and no other"
    return [f"  In all {len(rows)} rows where ropes may have been slack it may be "
            f"{' or '.join(common)}{also}. Of one contradiction a row the sign alone tells."]


def _six(value: float | None, digits: int = 6) -> str:
    return "-" if value is None else f"{value:.{digits}g}"
