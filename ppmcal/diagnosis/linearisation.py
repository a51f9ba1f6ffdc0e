"""The linear problem at a fit: rows, geometry and hypotheses, whitened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import column_scale
from ppmcal.diagnosis.hypotheses import Hypothesis, Library
from ppmcal.diagnosis.linear_system import INVISIBLE, System, Whitening, range_basis
from ppmcal.linalg import Array, column_lengths, without_range

VISIBLE = 1e-4
"""Directions of unit columns count as absorbed if the geometry leaves less than this of them."""
WEAK_VISIBILITY = 0.2
"""Effects are weakly testable if the geometry leaves less than this part of them."""


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The linear problem at one state, and the hypotheses in the model there.

    Attributes:
        system, library, noise: rows, hypotheses, whitening.
        basis: of the geometry, whitened (n, r); residual (n,) whitened, with the contributions of
            effects already in the state added back.
        chosen: indices of the hypotheses in the model.
        added: columns of the problem that belong to effects under test.
    """

    system: System
    library: Library
    noise: Whitening
    basis: Array
    residual: Array
    chosen: tuple[int, ...]
    added: tuple[int, ...] = ()

    @property
    def freedom(self) -> int:
        """Degrees of freedom: values less the rank of the geometry."""
        return self.system.count - int(self.basis.shape[1])

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """All hypotheses."""
        return self.library.hypotheses

    @property
    def named(self) -> tuple[Hypothesis, ...]:
        """The hypotheses in the model."""
        return tuple(self.hypotheses[i] for i in self.chosen)

    def some(self, which: Sequence[int]) -> Array:
        """Return some whitened columns of the library (n, k)."""
        return self.noise.apply(self.library.some(which), self.system)

    def past(self, which: Sequence[int]) -> tuple[Array, Array]:
        """Return some columns scaled to unit length, without geometry (n, k), and their lengths."""
        columns = self.some(which)
        length = column_lengths(columns)
        return without_range(columns / length, self.basis), length

    def plane(self, which: Sequence[int]) -> Array:
        """Return a basis (n, r) of some columns without geometry."""
        return range_basis(self.past(which)[0], VISIBLE)

    def visibility(self, which: Sequence[int]) -> float:
        """Return the part of the columns' length that the geometry leaves, rms."""
        return float(np.sqrt(np.mean(column_lengths(self.past(which)[0]) ** 2)))

    def sizes(self, which: Sequence[int]) -> Array:
        """Return the least-squares coefficients (k,) of some columns, next to the geometry."""
        unit, length = self.past(which)
        return np.asarray(linalg.lstsq(unit, self.residual, rcond=VISIBLE)[0] / length)

    def left(self, chosen: Sequence[int]) -> Array:
        """Return the residual (n,) without geometry and some hypotheses."""
        basis = self.explained(chosen)
        return np.asarray(self.residual - basis @ (basis.T @ self.residual))

    def explained(self, chosen: Sequence[int]) -> Array:
        """Return a basis (n, r) of the geometry and some hypotheses."""
        columns = [c for i in chosen for c in self.hypotheses[i].columns]
        return np.concatenate([self.basis, self.plane(columns)], axis=1) if columns else self.basis


def linearisation_of(system: System, found: Library, chosen: Sequence[int], noise: Whitening,
                     added: Sequence[int] = ()) -> Linearisation:
    """Return the linear problem of a library with the chosen hypotheses in the model."""
    basis = range_basis(noise.apply(system.jacobian, system), INVISIBLE)
    residual = noise.apply(system.residual[..., None], system)[:, 0]
    return Linearisation(system, found, noise, basis, residual, tuple(chosen), tuple(added))


def without(system: System, added: Sequence[int]) -> System:
    """Take effects already in a fit out of the geometry, and add their contribution back."""
    if not added:
        return system
    rest = [c for c in range(system.jacobian.shape[-1]) if c not in set(added)]
    scale = column_scale(system.problem)
    residual = system.residual.copy()
    own = scaling_columns(system, added)
    for c in added:
        if c in own:
            residual += own[c]
            continue
        parameter = system.problem.mechanism.parameters[system.problem.free[c]]
        value = float(system.state.g[system.problem.free[c]])
        if parameter.size is None:
            value -= parameter.nominal
        if not parameter.nonlinear:  # otherwise it only shapes the others
            sign = -1.0 if parameter.reciprocal else 1.0
            residual += sign * system.jacobian[..., c] / scale[c] * value
    return replace(system, jacobian=system.jacobian[..., rest], residual=residual)


def scaling_columns(system: System, columns: Sequence[int]) -> dict[int, Array]:
    """Return the contributions (N, m) of effects that scale with the parameter of a column.

    These are not the derivative times the parameter.
    """
    place = {system.problem.free[c]: c for c in columns if c < len(system.problem.free)}
    mechanism, out = system.problem.mechanism, {}
    for effect in mechanism.effects:
        scaling = [effect.parameters[s.name] for s in effect.kind.parameters(mechanism.motion)
                   if s.scaling and effect.parameters[s.name] in place]
        if scaling:
            values = {n: float(system.state.g[p]) for n, p in effect.parameters.items()}
            out[place[scaling[0]]] = system.column([
                effect.kind.evaluate(p.setting, np.array(effect.on), values).shift
                for p in system.parts])
    return out
