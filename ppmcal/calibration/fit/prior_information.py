"""Information from earlier measurements: a calibration continued with new data.

At the end of a fit its rows are one triangle; with frames and targets eliminated, and without the
tolerances, |R s - r|^2 is what the data alone say about steps s of the parameters from there.
In a new fit these rows count like measurements, so that the tolerances count once, and what no data
ever saw stays redundant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from ppmcal.linalg import Array, range_basis, svd, unit_columns, without_range
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.same_rows import KnownRows
from ppmcal.plain import Line, Rows
from ppmcal.units import COLUMN, JOINTS, PARAMETERS, Finite, Key, Quantity

ROUND_OFF = 1e-9
"""Frame and target columns closer together than this, relative to their length, are confounded."""
BENT = 0.5
"""Where the null directions of two data sets differ only by the bend between them, a tolerance is
fewer standard deviations than this: neither carries information there."""
SEEN = 1e-2
"""A direction counts as seen if one tolerance in it is at least this many standard deviations."""


@dataclass(frozen=True, eq=False)
class PriorInformation:
    """Rows |matrix s - right|^2 of steps s from ``value``, per parameter.

    ``places`` (F,): indices of the machine's parameters; ``matrix`` (k, F), ``right`` (k,)
    white; ``value`` (F,) where the earlier fit ended, SI.
    """

    places: tuple[int, ...]
    matrix: Array
    right: Array
    value: Array

    def rows(self, mechanism: Mechanism, free: Sequence[int], g: Array) -> tuple[Array, Array]:
        """Return residual (k,) and Jacobian (k, F) at g (P,); others count as they are."""
        away = g[list(self.places)] - self.value
        slope = np.ones(len(self.places))
        for c, p in enumerate(self.places):
            if mechanism.parameters[p].reciprocal:
                slope[c] = (self.value[c] / g[p]) ** 2
                away[c] = self.value[c] - self.value[c] ** 2 / g[p]
        jacobian = np.zeros((self.right.size, len(free)))
        column = {p: c for c, p in enumerate(free)}
        for c, p in enumerate(self.places):
            if p in column:
                jacobian[:, column[p]] = self.matrix[:, c] * slope[c]
        return self.right - self.matrix @ away, jacobian


@dataclass(frozen=True, eq=False)
class PoseResiduals:
    """Residuals of a data set's rows that no column explains, SI.

    ``q`` (n, k) joint values, unit of q; ``rest`` (n, m) by measured coordinate, in base axes, 0
    where not measured; ``rotations``: how many of the m, the last ones, are rotations.
    """

    name: str
    kind: str
    q: Annotated[Rows, Quantity(of="joints"), Key("joints")]
    rest: Annotated[Rows, Quantity(of="coordinates")]
    rotations: int
    joints: ClassVar = (JOINTS,)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The quantities of the m."""
        width = len(self.rest[0]) if len(self.rest) else 0
        return ("length",) * (width - self.rotations) + ("angle",) * self.rotations


@dataclass(frozen=True, eq=False)
class SessionKnowledge:
    """Rows |matrix [s, c] - right|^2 of steps s of the parameters and c of known quantities.

    Attributes:
        names: of the c (K,): ``frame.x of NAME``, ``homing.a of session``, ``scale of NAME`` ...
        matrix, right: (k, F + K), (k,), white by the stated noise.
        scale: natural units of the c (K,), SI.
        noise: unexplained residuals over the stated noise.
        spread: the scatter that these give to estimates, pose by pose.
        degrees: its degrees of freedom.
        single: whether the rows are the measured ones, in their order.
        sights: residuals that no column explains, row by row, by data set.
    """

    names: tuple[str, ...]
    matrix: Annotated[Rows, Quantity(of="columns", per=True)]
    right: Line
    scale: Annotated[Line, Quantity(of="held_known"), Key("unit_of_columns")]
    noise: Finite
    spread: Finite
    degrees: Finite
    single: bool
    sights: Annotated[tuple[PoseResiduals, ...], Key("rows")]

    @property
    def held_known(self) -> tuple[str, ...]:
        """The quantities of the c."""
        return tuple(COLUMN + n for n in self.names)

    @property
    def columns(self) -> tuple[str, ...]:
        """The quantities of the steps s and of the c."""
        return (PARAMETERS, *self.held_known)


@dataclass(frozen=True, eq=False)
class DefiningParameters:
    """Parameters that define the frames of a fit to joint values alone, and were not fitted (G,).

    Attributes:
        names: of the parameters.
        scale: their natural units (G,), SI.
        seen: how the fitted parameters change, in these frames, as each of them moves by its
            natural unit (G, F), SI.
    """

    names: tuple[str, ...]
    scale: Annotated[Line, Quantity(of="quantities"), Key("unit")]
    seen: Annotated[Rows, Quantity(of="columns")]
    columns: ClassVar = (PARAMETERS,)

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities of these parameters."""
        return tuple(COLUMN + n for n in self.names)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Result of an identification, SI.

    Attributes:
        places: parameters that were free (F,).
        value: the estimate (F,), or the linearisation point from which ``step`` leads to it.
        matrix, right: rows |matrix s - right|^2 of its data about the value (k, F), (k,),
            white by the stated noise.
        tolerance: the prior's standard deviation (F,), inf without prior.
        scale: natural unit of each parameter (F,).
        inflation: factor on the stated noise from the noise check; it does not affect the
            tolerances.
        inputs: content hash -> name of the measurement tables behind it.
        source: the file.
        session: information in the data beyond its parameters; None if the file has none.
        known: rows by which copies of those tables are recognised.
        step: from the value to the estimate (F,), SI; None: the value is the estimate.
        defining: what defines its frames; None if nothing does, or if the file does not hold
            it.
    """

    places: tuple[int, ...]
    value: Array
    matrix: Array
    right: Array
    tolerance: Array
    scale: Array
    inflation: float
    inputs: Mapping[str, str]
    source: str
    session: SessionKnowledge | None = None
    known: tuple[KnownRows, ...] = ()
    step: Array | None = None
    defining: DefiningParameters | None = None

    def estimate(self, mechanism: Mechanism) -> Array:
        """Return the minimum of data and tolerances together (F,), SI."""
        if self.step is None:
            return self.value
        return np.array([mechanism.parameters[p].stepped(v, s) for p, v, s in zip(
            self.places, self.value.tolist(), self.step.tolist(), strict=True)])

    def pull(self) -> Array:
        """Return the gradient of the data's half chi-squared at the estimate (F,), SI."""
        left = self.right if self.step is None else self.right - self.matrix @ self.step
        return -np.asarray(self.matrix.T @ left) / self.inflation**2

    def data(self) -> PriorInformation:
        """Return the information of the data, without the prior."""
        return PriorInformation(self.places, self.matrix / self.inflation,
                                self.right / self.inflation, self.value)


def of_data(triangle: Array, right: Array, count: int, scale: Array) -> tuple[Array, Array]:
    """Return the rows (k, F), (k,) of the first ``count`` columns, the others eliminated.

    Args:
        triangle: all rows of a fit as |triangle s - right|^2 (C, C), (C,).
        right: see ``triangle``.
        count: number of parameters F; the rest are frames and targets.
        scale: natural unit of every parameter (F,).
    """
    nuisance = triangle[:, count:]
    block = np.concatenate([triangle[:, :count] * scale, right[:, None]], axis=1)
    if nuisance.shape[1]:
        block = without_range(block, range_basis(unit_columns(nuisance), ROUND_OFF))
    u, s, vt = svd(block[:, :-1])
    seen = s > SEEN
    return (s[seen, None] * vt[seen]) / scale, u[:, seen].T @ block[:, -1]
