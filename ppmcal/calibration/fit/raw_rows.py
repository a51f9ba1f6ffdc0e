"""Rows before whitening: residuals with their columns, and the parts of their noise.

The noise of a row is that of the instrument, coordinate by coordinate or, for a tracker, one
covariance of the position; and that of the joints, carried to the measurements by the geometry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.instrument_tables import Sighting
from ppmcal.calibration.fit.latent_poses import most_likely
from ppmcal.calibration.fit.observation import (
    ResidualJacobian,
    joint_covariance,
    noise,
    view,
)
from ppmcal.calibration.fit.response import ClosedRows, Response, RowsAtRest, with_surplus
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import platform_pose
from ppmcal.kinematics.registration import by_displacement, displaced
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.dataset import Environment


@dataclass(frozen=True, eq=False)
class RawRows:
    """Rows before whitening; in rows that are not present nothing is observed.

    Attributes:
        seen: with the residuals (n, m).
        jacobian: of the prediction (n, m, C).
        sigma: standard deviations of the instrument (n, m).
        position: covariance of the first p <= m coordinates of ``sigma`` (n, p, p), None if it is
            diagonal.
        carried: change of a row by one standard deviation of each joint, and of each equation with
            a gap (n, m, k); None if they have no noise.
        weight: of each row (n,), None: all equal.
        responses: of the row's ends.
        surplus: number of closure residuals that no pose explains, the last of the m values.
    """

    seen: ResidualJacobian
    jacobian: Array
    sigma: Array
    position: Array | None
    carried: Array | None
    weight: Array | None
    responses: tuple[Response, ...]
    surplus: int

    @property
    def each_by_itself(self) -> bool:
        """Whether the noise of the values is uncorrelated."""
        return self.carried is None and self.position is None

    @property
    def moved(self) -> Array:
        """Change of the observed values by the noise of joints and gaps (n, m, k); k may be 0."""
        if self.carried is None:
            return np.zeros((*self.sigma.shape, 0))
        return np.where(self.seen.observed[..., None], self.carried, 0.0)

    def covariance(self) -> Array:
        """Return the covariance of the noise (n, m, m); unobserved values have variance 1."""
        safe = np.where(self.seen.observed, self.sigma, 1.0)
        out = np.eye(safe.shape[1]) * (safe**2)[..., None]
        if self.carried is not None:
            moved = self.moved
            out = moved @ np.swapaxes(moved, -1, -2) + out
        if self.position is not None:
            p = self.position.shape[-1]
            observed = self.seen.observed[:, :p]
            both = observed[:, :, None] & observed[:, None, :] & ~np.eye(p, dtype=bool)
            out[:, :p, :p] += np.where(both, self.position, 0.0)
        return np.asarray(out)

    def whitener(self) -> Array:
        """Return W (n, m, m), the inverse of the covariance's lower root, which whitens r."""
        if self.each_by_itself:
            return np.eye(self.sigma.shape[1]) / np.where(
                self.seen.observed, self.sigma, 1.0)[..., None]
        return inverse_root(self.covariance())

    def whitener_given(self, others: Sequence[RawRows]) -> Array:
        """Return W (n, m, M), which whitens the rows given others read at the same joint values.

        The last m rows of the inverse root of the covariance of all M values, the others' first
        (Golub and Van Loan, 4.2.9). A row of lower weight has a larger covariance.
        """
        rows = (*others, self)
        moved = np.concatenate([r.moved for r in rows], axis=1)
        whole = moved @ np.swapaxes(moved, -1, -2)
        begin = 0
        for r in rows:
            end = begin + r.sigma.shape[1]
            less = None if r is self else r.weight
            whole[:, begin:end, begin:end] = r.covariance() / (
                1.0 if less is None else less[:, None, None])
            begin = end
        return inverse_root(whole)[:, -self.sigma.shape[1]:]

    def only(self, there: Bools) -> RawRows:
        """Return the rows with nothing observed except in rows ``there`` (n,)."""
        return self._observed(self.seen.observed & there[:, None])

    def without_surplus(self, there: Bools) -> RawRows:
        """Return the rows without the surplus closure of rows ``there`` (n,)."""
        m = self.sigma.shape[1]
        last = np.arange(m) >= m - self.surplus
        return self._observed(self.seen.observed & ~(last & there[:, None]))

    def _observed(self, observed: Bools) -> RawRows:
        return replace(self, seen=replace(self.seen, observed=observed))


def inverse_root(covariance: Array) -> Array:
    """Return the inverse of the lower root of covariances (n, m, m)."""
    # scale to unit diagonal first: metres and radians differ by orders of magnitude
    d = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    root = linalg.cholesky(covariance / (d[..., :, None] * d[..., None, :]))
    return np.asarray(linalg.inv(root) / d[..., None, :], dtype=float)


@dataclass(frozen=True, eq=False)
class RowMaker:
    """Makes some rows (n,) of a data set.

    Attributes:
        sighting: the data set, as its instrument observes the machine.
        models: the machine with the effects that act in these rows, one for each end.
        ends: joint values (n, k) and poses (n, 8) of each end.
        surroundings: the environment, whatever effects the machine has.
        free: parameters with columns; ``columns``: number of these and the data sets' own, None
            for no Jacobian.
        at_rest: known closed rows, if no parameters are free and there are no effects.
    """

    sighting: Sighting
    models: Sequence[Model]
    ends: Sequence[tuple[Array, Array]]
    surroundings: Callable[[], Environment]
    free: Sequence[int]
    columns: int | None
    at_rest: RowsAtRest | None = None

    def made(self, index: Ints) -> RawRows:
        """Return the rows ``index`` (n,)."""
        sighting, motion = self.sighting, self.sighting.mechanism.motion
        part = replace(sighting, data=sighting.data.take(index))
        sigma, surplus = noise(part.data, motion), sighting.mechanism.surplus
        ends = self._likely(part, index, sigma) if surplus and len(self.ends) == 1 else self.ends
        seen = self._look(part, [pose for _, pose in ends])
        bases: list[tuple[Array, slice] | None] = [None] * len(ends)
        if surplus:
            seen, bases = with_surplus(
                seen, [m.closure(q) for (q, _), m in zip(ends, self.models, strict=True)],
                [pose for _, pose in ends])
            sigma = np.pad(sigma, ((0, 0), (0, seen.residual.shape[1] - sigma.shape[1])))
        noisy = bool(np.any(sighting.sigma_joint > 0.0) or np.any(sighting.sigma_gap > 0.0))
        responses = tuple(
            Response(self._closed(model, q, pose), seen, self.surroundings, end, bases[end],
                     sighting.data.name)
            for end, ((q, pose), model) in enumerate(zip(ends, self.models, strict=True))
        ) if noisy or self.columns is not None else ()
        return RawRows(
            seen, np.where(seen.observed[..., None], self._jacobian(seen, responses), 0.0), sigma,
            joint_covariance(part.data, motion), self._carried(responses) if noisy else None,
            part.data.weight, responses, len(ends) * surplus)

    def _closed(self, model: Model, q: Array, pose: Array) -> ClosedRows:
        """Return the closure at poses (n, 8), with the columns needed."""
        if self.at_rest is not None:
            return self.at_rest.of(model, q, pose)
        return ClosedRows(model.closure(q, () if self.columns is None else self.free), pose)

    def _look(self, part: Sighting, closed: Sequence[Array]) -> ResidualJacobian:
        """Return what the instrument observes in some rows at poses (n, 8) that close."""
        data, shift = part.data, self.models[0].shift
        shift = None if shift is None else shift.of(data.name)
        platforms = [platform_pose(pose, model.shift)
                     for pose, model in zip(closed, self.models, strict=True)]
        # a joint is in a limb, before whatever moves the platform after it
        at_joint = data.kind.placed is not None
        seen = view(data, part.registration,
                    closed if at_joint else [displaced(p, shift) for p in platforms],
                    part.mechanism.motion, part.columns.about, shift.stretch if shift else None,
                    [] if data.kind.of_poses else [m.closure(q) for (q, _), m in zip(
                        self.ends, self.models, strict=True)])
        if at_joint:
            return seen
        moved = [by_displacement(p, shift) for p in platforms]
        return replace(seen, by_poses=tuple(
            by if d is None else by @ d for by, d in zip(seen.by_poses, moved, strict=True)))

    def _likely(self, part: Sighting, index: Ints, sigma: Array) -> list[tuple[Array, Array]]:
        """Return joint values and most likely poses of rows of contradicting limbs."""
        (q, pose), = self.ends
        closure = self.models[0].closure(q)
        found = self.sighting.likely_poses(index, pose, closure)
        return [(q, most_likely(closure, lambda at: self._look(part, [at]), pose, sigma,
                                part.sigma_joint, part.sigma_gap) if found is None else found)]

    def _carried(self, responses: Sequence[Response]) -> Array:
        """Return the change of rows by one sigma of joints and gaps (n, m, k)."""
        joints, gaps = self.sighting.sigma_joint, self.sighting.sigma_gap
        by_noise = [by for r in responses for by in (
            [r.by_joint, r.by_equation] if gaps.any() else [r.by_joint])]
        sigma = [joints, gaps] if gaps.any() else [joints]
        return np.asarray(np.concatenate(by_noise, axis=-1)
                          * np.concatenate(sigma * len(responses)))

    def _jacobian(self, seen: ResidualJacobian, responses: Sequence[Response]) -> Array:
        """Return the columns (n, m, C) of geometry, effects and nuisance parameters."""
        full = np.zeros((*seen.residual.shape, self.columns or 0))
        if self.columns is None:
            return full
        for response in responses:
            own = np.zeros_like(full) if response.end else full
            response.geometry_columns(own, self.free, self.sighting.columns.homing)
            response.effect_columns(own, self.free)
            if response.end:
                full += own
        self.sighting.columns.fill(full, seen)
        return full
