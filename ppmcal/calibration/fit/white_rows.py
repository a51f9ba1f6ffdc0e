"""White rows: values in units of their noise, uncorrelated.

Targets measured at one stand share the noise of its joints. Their rows are whitened one after the
other: those of a target conditional on those of the targets before it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.raw_rows import RawRows
from ppmcal.calibration.fit.response import Response
from ppmcal.linalg import Array, Bools, Ints


@dataclass(frozen=True, eq=False)
class Companion:
    """Values of another target at the stands of n rows, whose noise is correlated with theirs.

    Attributes:
        dataset: of that target; ``index`` (n,): its rows, arbitrary where it has none.
        mix: coefficients of its m' values in the white rows (n, m, m'); 0 where it has no row.
        observed, raw: its values (n, m'), as in :class:`Rows`; ``jacobian`` (n, m', C) of their
            prediction, m and rad.
        response: of these values to shifts.
    """

    dataset: int
    index: Ints
    mix: Array
    observed: Bools
    raw: Array
    jacobian: Array
    response: Response

    def share(self, raw: Array) -> Array:
        """Return the contribution of the companion's values (n, m') to white rows (n, m)."""
        return np.asarray((self.mix @ np.where(self.observed, raw, 0.0)[..., None])[..., 0])

    @property
    def columns(self) -> Array:
        """Contribution of its columns to those of white rows (n, m, C)."""
        return np.asarray(self.mix @ self.jacobian)


def whitened(whitener: Array, observed: Bools, raw: Array,
             others: Iterable[tuple[Companion, Array]]) -> Array:
    """Return values (n, m), m and rad, whitened (n, m), given those of companions (n, m')."""
    out = np.asarray((whitener @ np.where(observed, raw, 0.0)[..., None])[..., 0])
    for companion, values in others:
        out = out + companion.share(values)
    return out


@dataclass(frozen=True)
class Rows:
    """One chunk of whitened rows.

    ``residual`` (n, m) white; ``jacobian`` (n, m, C) of the white prediction;
    ``observed`` (n, m); ``raw`` (n, m) in m and rad; ``whitener`` (n, m, m);
    ``index`` (n,) rows of the data set; ``response`` of the predictions to shifts, None without
    Jacobian; ``second``: the same for the other end of a distance between two platform
    positions; ``weight`` (n,): as in the data set; ``surplus``: number of closure residuals
    that no pose explains, the last of the m values; ``companions``: other targets at the same
    stands, on which whitening is conditional: ``whitener @ raw`` plus their shares.
    """

    dataset: int
    index: Ints
    residual: Array
    jacobian: Array
    observed: Bools
    raw: Array
    whitener: Array
    response: Response | None = None
    second: Response | None = None
    weight: Array | None = None
    surplus: int = 0
    companions: tuple[Companion, ...] = ()

    def whitened(self, raw: Array, others: Sequence[Array] | None = None) -> Array:
        """Return values (n, m), m and rad, whitened, given values (n, m') of each companion.

        ``others`` None: the companions' values are 0.
        """
        return whitened(self.whitener, self.observed, raw, zip(
            self.companions, others or (), strict=False))

    @property
    def measured(self) -> Array:
        """Errors of the measured values, m and rad, nan where the instrument measures none."""
        own = slice(self.raw.shape[1] - self.surplus)
        return np.where(self.observed[:, own], self.raw[:, own], np.nan)

    @property
    def own_jacobian(self) -> Array:
        """White columns (n, m, C) of the rows' own values, without those of companions."""
        out = self.jacobian
        for companion in self.companions:
            out = out - companion.columns
        return out

    def raw_jacobian(self) -> Array:
        """Return d prediction of the measured values (n, m, C), m and rad, unweighted."""
        whole = linalg.solve(self.whitener, self.own_jacobian)
        return np.asarray(whole[:, :whole.shape[1] - self.surplus])

    def some_columns(self, group: Mapping[int, tuple[slice, Bools]]) -> Array | float:
        """Return white columns (n, m, T) that act in some rows only.

        Args:
            group: by data set, which T of the C columns, and in which of its rows (N,).

        Returns:
            0 if the rows have none of these data sets.
        """
        parts = ([(self.dataset, self.index, self.own_jacobian)] if self.dataset in group else [])
        parts += [(c.dataset, c.index, c.columns) for c in self.companions if c.dataset in group]
        out: Array | float = 0.0
        for dataset, index, jacobian in parts:
            at, acts = group[dataset]
            out = out + jacobian[..., at] * acts[index][:, None, None]
        return out

    @property
    def count(self) -> float:
        """Number of measured values, weighted by row."""
        each = self.observed.sum(axis=1)
        return int(each.sum()) if self.weight is None else float(self.weight @ each)

    def squares(self) -> tuple[float, float]:
        """Return the sum of white squares of the measured values, and their number."""
        return float(np.sum(np.where(self.observed, self.residual, 0.0) ** 2)), self.count


def white_rows(dataset: int, index: Ints, own: RawRows,
               others: Sequence[tuple[int, Ints, RawRows]]) -> Rows:
    """Return whitened rows ``index`` (n,) of a data set.

    Args:
        dataset: number of the data set.
        index: which of its rows.
        own: these rows.
        others: data set, rows (n,) and values of each other target at the same stands.
    """
    seen, root = own.seen, None if own.weight is None else np.sqrt(own.weight)[:, None, None]
    m = seen.residual.shape[1]
    whole = own.whitener_given([r for _, _, r in others]) if others else own.whitener()
    whole = whole if root is None else root * whole
    white, companions, begin = whole[..., -m:], list[Companion](), 0
    for number, rows, r in others:
        end = begin + r.seen.residual.shape[1]
        companions.append(Companion(
            number, rows, whole[..., begin:end], r.seen.observed, r.seen.residual,
            np.where(r.seen.observed[..., None], r.jacobian, 0.0), r.responses[0]))
        begin = end
    observed = seen.observed
    if own.each_by_itself:
        diagonal = np.diagonal(white, axis1=-2, axis2=-1)
        residual, full = diagonal * seen.residual, diagonal[..., None] * own.jacobian
    else:
        residual = (white @ np.where(observed, seen.residual, 0.0)[..., None])[..., 0]
        full = white @ np.where(observed[..., None], own.jacobian, 0.0)
        for companion in companions:
            residual = residual + companion.share(companion.raw)
            full = full + companion.columns
    first, second = (*own.responses, None, None)[:2]
    return Rows(dataset, index, residual, full, observed, seen.residual, white, first, second,
                own.weight, own.surplus, tuple(companions))
