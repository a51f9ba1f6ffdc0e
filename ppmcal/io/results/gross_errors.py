"""Rows and sessions that do not belong: a part of identification.json, and what is said of it.

A sentence about an entry in which a number is missing is empty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field

from ppmcal.calibration.fit import GrossError, GrossErrors, HomingShift, half_or
from ppmcal.io.results.parts import LeftOutRow
from ppmcal.io.results.record import Finite, Part, Text, Whole
from ppmcal.io.results.units import column_factor, of_joints, parameter_unit
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import Note
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


class UncheckedRows(Part):
    """Rows that nothing else checks."""

    dataset: Text = ""
    rows: tuple[Whole, ...] = ()

    def sentence(self) -> str:
        """Return which rows nothing else checks."""
        if not (self.dataset and self.rows):
            return ""
        some = abbreviate_list([str(r) for r in self.rows], most=ROWS)
        rows = (f"rows {some} have" if len(self.rows) > 1 else f"row {some} has")
        return (f"{self.dataset}: {rows} no backup: a wrong reading there would go unnoticed. "
                "Measure one more.")


class GrossErrorSummary(Part):
    """What does not belong.

    ``would_be``: parameters that the rows left out would change: ``now``, and ``with_them``, in
    the unit of each.
    """

    rows: tuple[LeftOutRow, ...] = ()
    would_be: Mapping[Text, Mapping[Text, Finite | None]] = field(default_factory=dict)
    homing_shifts: tuple[HomingShift, ...] = ()
    unchecked: tuple[UncheckedRows, ...] = ()

    @classmethod
    def of(cls, found: GrossErrors, mechanism: Mechanism) -> GrossErrorSummary:
        """Return the entry in file units."""
        changed = {name: {"now": now / f, "with_them": then / f}
                   for name, (now, then) in found.would.items()
                   for f in [column_factor(mechanism, name)]}
        return cls(rows=tuple(_left_out(r, mechanism) for r in found.rows), would_be=changed,
                   homing_shifts=of_joints(found.homing_shifts, mechanism),
                   unchecked=tuple(UncheckedRows(dataset=n, rows=r) for n, r in found.unchecked))

    def shift_sentences(self) -> list[Note]:
        """Return one finding for each homing offset that shifted."""
        return [Note(text) for s in self.homing_shifts if (text := shift_sentence(s))]

    def unchecked_sentences(self) -> list[str]:
        """Return which rows nothing else checks, one sentence for each data set."""
        return list(filter(None, (u.sentence() for u in self.unchecked)))


def row_sentences(found: GrossErrorSummary, mechanism: Mechanism) -> list[str]:
    """Return which rows were left out, what for, and what they would change."""
    out = [f"  {r.dataset}, row {r.row}: {r.coordinate} {_six(r.value)} {r.unit}, where the "
           f"others say {_six(r.predicted)} {r.unit} ({_six(r.times, 3)} times the noise)."
           + _slack(r)
           for r in sorted(found.rows, key=lambda r: -(r.times or 0.0))[:SHOWN]]
    if len(found.rows) > SHOWN:
        out.append(f"  ... and {len(found.rows) - SHOWN} more rows, see residuals.csv.")
    out += slack_in_common(found)
    return out + [f"  With them {name} would be {_six(e.get('with_them'))} in place of "
                  f"{_six(e.get('now'))} {parameter_unit(mechanism, name)}."
                  for name, e in list(found.would_be.items())[:CHANGED]]


def _left_out(error: GrossError, mechanism: Mechanism) -> LeftOutRow:
    """Return the entry of a row in file units."""
    return LeftOutRow.filled(error, mechanism.units,
                             coordinate=error.number or POSE_COORDINATES[error.coordinate],
                             unit="length" if error.coordinate < 3 else "angle",
                             **({"may_be_slack": error.slack} if error.slack else {}))


def _slack(row: LeftOutRow) -> str:
    if not row.may_be_slack:
        return ""
    return f" It may be {' or '.join(row.may_be_slack)} that was slack."


def slack_in_common(found: GrossErrorSummary) -> list[str]:
    """Return which ropes may have been slack in all rows left out where one may have been.

    One contradiction a row has a sign, and no more: in many rows it leaves fewer ropes.
    """
    rows = [r.may_be_slack for r in found.rows if r.may_be_slack]
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
