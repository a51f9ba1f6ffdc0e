"""Part of identification.json: rows by which copies of its tables are recognised later on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.calibration.interpretation import known_rows
from ppmcal.calibration.validation import Identification
from ppmcal.io.results.record import Finite, Part, Text, Whole
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.same_rows import CARRIED, KnownRows
from ppmcal.units import LARGEST

ANGLES = ("rx", "ry", "rz")


class RowsOfTable(Part):
    """Rows of a table, one text each, numbers in file units in the order of ``columns``.

    All, or of so many (``of``) some evenly spread; ``value`` is a height or distance; ``chance``,
    that two measurements of one pose agree in every digit, is bare.
    """

    source: Text = ""
    kind: Text = ""
    of: Whole = 0
    chance: Finite = 1.0
    columns: tuple[Text, ...] = ()
    rows: tuple[Text, ...] = ()

    @classmethod
    def of_rows(cls, known: KnownRows, mechanism: Mechanism) -> RowsOfTable:
        """Return the rows in file units."""
        table = known.table / _factors(known.columns, mechanism)
        return cls.filled(
            known, of=known.count,
            rows=tuple(",".join(f"{v:.13g}" for v in row) for row in table.tolist()))

    def known(self, mechanism: Mechanism) -> KnownRows:
        """Return the rows in SI.

        Raises:
            ValueError: they are not numbers, too large, or more or fewer than there are columns.
        """
        table = np.array([[float(v) for v in row.split(",")] for row in self.rows], dtype=float)
        table = table.reshape(len(self.rows), len(self.columns))
        if np.any(np.abs(table) > LARGEST):
            raise ValueError("too large")
        return KnownRows(self.source, self.kind, self.of, self.chance, self.columns,
                         table * _factors(self.columns, mechanism))


def rows_behind(result: Identification) -> tuple[KnownRows, ...]:
    """Return rows of the tables behind an identification, earlier ones that it carries on too."""
    found = [known_rows(d, result.mechanism.actuators) for d in result.fit.problem.datasets]
    found += result.earlier.known if result.earlier is not None else []
    return tuple(k.thinned(max(CARRIED // len(found), 1)) for k in found)


def _factors(columns: Sequence[str], mechanism: Mechanism) -> Array:
    """Return the SI values of file units of columns (c,)."""
    joints = {f"{head}{a}": f for head in ("q_", "to_q_")
              for a, (f, _) in zip(mechanism.actuators, mechanism.joint_units, strict=True)}
    length, angle = mechanism.units.factor("length"), mechanism.units.factor("angle")
    return np.array([joints[c] if c in joints else
                     angle if c.removeprefix("cmd_") in ANGLES else length for c in columns])
