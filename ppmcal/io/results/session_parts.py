"""Part of identification.json: what a session's data say of what was held known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.calibration.fit import PoseResiduals, SessionKnowledge
from ppmcal.io.results.record import Finite, Flag, Part, Text, Whole
from ppmcal.io.results.units import Numbers, column_factor
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units


class SessionRows(Part):
    """Rows of a data set: joint values, and by coordinate what no column explains, base axes.

    File units; ``rotations``, how many of the coordinates are rotations, is bare.
    """

    name: Text = ""
    kind: Text = ""
    joints: tuple[Numbers, ...] = ()
    rest: tuple[Numbers, ...] = ()
    rotations: Whole = 0

    @classmethod
    def of(cls, s: PoseResiduals, mechanism: Mechanism) -> SessionRows:
        """Return the rows in file units."""
        joint = np.array([f for f, _ in mechanism.joint_units])
        rest = s.rest / rest_factors(s.rest.shape[1], s.rotations, mechanism.units)
        return cls.filled(s, joints=s.q / joint, rest=rest)


def rest_factors(count: int, rotations: int, units: Units) -> Array:
    """Return the SI value of a file unit of so many coordinates, the last ones rotations."""
    return np.array([units.factor("length")] * (count - rotations)
                    + [units.factor("angle")] * rotations)


class SessionInformation(Part):
    """What the data say of parameters and of what was held known, file units.

    ``names`` of the latter; |matrix [s, c] - right|^2, white by the stated noise; ``noise`` (over
    the stated one, of so many ``degrees``; ``spread`` as estimates scatter by it) and ``rows``:
    what is left; ``single``: the rows of the matrix are the measured ones.
    """

    names: tuple[Text, ...] = ()
    matrix: tuple[Numbers, ...] = ()
    right: Numbers = ()
    unit_of_columns: Numbers = ()
    noise: Finite | None = None
    spread: Finite | None = None
    degrees: Finite | None = None
    single: Flag = False
    rows: tuple[SessionRows, ...] = ()

    @classmethod
    def of(cls, s: SessionKnowledge, mechanism: Mechanism, parameters: Sequence[str]
           ) -> SessionInformation:
        """Return the entry in file units."""
        f = np.array([column_factor(mechanism, n) for n in (*parameters, *s.names)])
        return cls.filled(s, matrix=s.matrix * f, unit_of_columns=s.scale / f[len(parameters):],
                          rows=tuple(SessionRows.of(d, mechanism) for d in s.sights))
