"""One pass: linearise at a fit, whiten, test the library, choose."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import Problem, State, column_scale
from ppmcal.diagnosis.added_variable_test import AddedVariableTest, prepared, seen_noise
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.hypotheses import Hypothesis, Library
from ppmcal.diagnosis.linear_system import (
    INVISIBLE,
    System,
    Whitening,
    build,
    range_basis,
)
from ppmcal.diagnosis.rivals import held, settled
from ppmcal.diagnosis.search import DETECT, NAME, Search, prepare
from ppmcal.diagnosis.selection import choose
from ppmcal.diagnosis.thinning import thinned
from ppmcal.diagnosis.wandering import WANDERING, instead, wandered
from ppmcal.diagnosis.white_columns import WhiteColumns
from ppmcal.diagnosis.whitening import PureError, estimate, pure_error, simulated
from ppmcal.linalg import Array, Bools, unit_columns

log = logging.getLogger(__package__)

DRAWS = 2000
SURE_OF_NOISE = 2.0
WEAK_SURVIVAL = 0.2
"""Effects of which the geometry leaves less than this are weakly testable."""


@dataclass(frozen=True, eq=False)
class Stage:
    """The linear problem at one state, its tests and what was chosen.

    Attributes:
        system, library, noise: rows, hypotheses, whitening.
        basis: of the geometry, whitened (n, r); residual (n,) whitened, the contributions
            of effects that the state already has added back.
        search: tests and thresholds; chosen: indices of hypotheses.
        log_p: of every hypothesis before anything is chosen (F,).
        pure: scatter of repeats, if there are any.
        added: columns of the problem that belong to effects under test.
        as_named: whether effects were only in the range in which they are named.
    """

    system: System
    library: Library
    noise: Whitening
    basis: Array
    residual: Array
    search: Search
    chosen: tuple[int, ...]
    log_p: Array
    pure: PureError | None
    added: tuple[int, ...] = ()
    as_named: bool = False

    @property
    def columns(self) -> Array:
        """The whitened library (n, T), made where it is asked for."""
        return self.some(range(self.library.count))

    def some(self, which: Sequence[int]) -> Array:
        """Return some whitened columns (n, k)."""
        return self.noise.apply(self.library.some(which), self.system)

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """All hypotheses, those made while choosing included."""
        return self.search.hypotheses

    @property
    def named(self) -> tuple[Hypothesis, ...]:
        """The chosen hypotheses that have a name."""
        return tuple(self.search.hypotheses[i] for i in named_only(self))

    @property
    def wanders(self) -> bool:
        """Whether machine or instrument wander in time, in no way that has a name."""
        return any(self.search.hypotheses[i].kind == WANDERING for i in self.chosen)


def named_only(stage: Stage) -> tuple[int, ...]:
    """Return the chosen hypotheses without anonymous shapes."""
    return tuple(i for i in stage.chosen if not stage.hypotheses[i].anonymous)


def run_stage(problem: Problem, state: State, keep: Sequence[Bools], seed: int,
              kinds: Sequence[str] | None = None, draws: int = DRAWS,
              added: Sequence[int] = (), like: Search | None = None,
              hold: Sequence[Hypothesis] = (), as_named: bool = False) -> Stage:
    """Return the tests at a state.

    Args:
        problem: machine, data and what is free.
        state: the fit.
        keep: rows to use, by data set; where there are very many, some of them.
        seed: of the simulated noise.
        kinds: which kinds to try; default all.
        draws: of noise, for the thresholds.
        added: columns of the problem that belong to effects under test: they count as
            hypotheses, not as geometry.
        like: an earlier search of the same library and rows, whose thresholds hold.
        hold: what was chosen before, which stays unless something is better.
        as_named: effects only in the range in which they are named.
    """
    system = without(build(problem, state, thinned(problem, keep)), added)
    found = library(system, kinds, [problem.free[c] for c in added], as_named)
    noise = estimate(system, found)
    rng = np.random.default_rng(seed)
    for _ in range(2):
        stage = _tested(system, found, noise, rng, draws, like, hold)
        grids = [c for i in stage.chosen for c in stage.hypotheses[i].columns
                 if stage.hypotheses[i].constants and c < found.count]
        grids += instead(stage.search, stage.chosen, found.courses)
        if not grids or noise.rho == 0.0:
            break
        noise = estimate(system, found, grids)
    log.info("%d hypotheses in %d columns of %d rows; noise correlated %.2g from row to row; "
             "detected below p = %.2g, named below %.2g; chosen: %s", len(stage.hypotheses),
             found.count, system.count, noise.rho, np.exp(stage.search.detect),
             np.exp(stage.search.name), ", ".join(f.label for f in stage.named) or "none")
    return replace(stage, added=tuple(added), as_named=as_named)


def bare_stage(system: System, found: Library, chosen: Sequence[int], added: Sequence[int] = ()
               ) -> Stage:
    """Return the linear problem of a library with hypotheses in the model that were chosen."""
    noise = estimate(system, found, [c for i in chosen for c in found.hypotheses[i].columns])
    basis, residual, _, test = _whitened(system, found, noise)
    search = Search(test, found.hypotheses, float(np.log(DETECT)), float(np.log(NAME)),
                    np.zeros(0))
    return Stage(system, found, noise, basis, residual, search, tuple(chosen),
                 np.zeros(len(found.hypotheses)), pure_error(system), tuple(added))


def without(system: System, added: Sequence[int]) -> System:
    """Take effects that a fit already has out of the geometry, and put back what they do."""
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
        if not parameter.nonlinear:  # else it only shapes others
            sign = -1.0 if parameter.reciprocal else 1.0
            residual += sign * system.jacobian[..., c] / scale[c] * value
    return replace(system, jacobian=system.jacobian[..., rest], residual=residual)


def scaling_columns(system: System, columns: Sequence[int]) -> dict[int, Array]:
    """Return what effects do (N, m) that scale with the parameter of one of some columns.

    They are not their derivative times it.
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


def _whitened(system: System, found: Library, noise: Whitening
              ) -> tuple[Array, Array, WhiteColumns, AddedVariableTest]:
    """Return a basis of the geometry, the residual and the library, white, and their tests."""
    basis = range_basis(noise.apply(system.jacobian, system), INVISIBLE)
    residual = noise.apply(system.residual[..., None], system)[:, 0]
    columns = WhiteColumns.of(found.products, noise, system, basis)
    return basis, residual, columns, prepared(columns, columns.length, columns.hidden, basis,
                                              residual, system.count)


def _tested(system: System, found: Library, noise: Whitening, rng: np.random.Generator,
            draws: int, like: Search | None, hold: Sequence[Hypothesis]) -> Stage:
    basis, residual, columns, test = _whitened(system, found, noise)
    left = residual - basis @ (basis.T @ residual)
    drawn = simulated(noise, system, basis, left, 0 if like else draws, rng)
    search = prepare(test, _cautious(found.hypotheses, noise), seen_noise(columns, basis, drawn),
                     like)
    start = search.values()
    search, chosen = wandered(*settled(search, choose(search)), found.courses)
    search, chosen = held(search, chosen, hold)
    # in the library's order, whichever was found first
    return Stage(system, found, noise, basis, residual, search, tuple(sorted(chosen)), start,
                 pure_error(system))


def _cautious(hypotheses: Sequence[Hypothesis], noise: Whitening) -> list[Hypothesis]:
    """Return the hypotheses, those of events with the long-run variance that there may be.

    (1 + rho)/(1 - rho) of AR(1) at rho two standard deviations higher, over that at rho.
    """
    most = min(noise.rho + SURE_OF_NOISE * noise.rho_error, 0.95)
    caution = (1.0 + most) / (1.0 - most) * (1.0 - noise.rho) / (1.0 + noise.rho)
    return [replace(f, caution=max(caution, 1.0)) if f.effect is not None and f.effect.onset else f
            for f in hypotheses]


def explained(stage: Stage) -> tuple[Array, Array]:
    """Return a basis (n, r) of geometry and chosen effects, and the residual free of both."""
    columns = np.concatenate(
        [
            np.zeros((len(stage.residual), 0)),
            *(form_columns(stage, stage.hypotheses[i]) for i in stage.chosen),
        ],
        axis=1,
    )
    extra = columns - stage.basis @ (stage.basis.T @ columns)
    basis = np.concatenate([stage.basis, range_basis(unit_columns(extra))], axis=1)
    return basis, stage.residual - basis @ (basis.T @ stage.residual)


def form_columns(stage: Stage, hypothesis: Hypothesis) -> Array:
    """Return a hypothesis's whitened columns (n, k)."""
    if max(hypothesis.columns) < stage.library.count:
        return stage.some(hypothesis.columns)
    each = [stage.some(c) for c in single_columns(stage.hypotheses, hypothesis)]
    return np.sum(each, axis=0) if hypothesis.shared else np.concatenate(each, axis=-1)


def of_single(columns: Array, hypotheses: Sequence[Hypothesis], hypothesis: Hypothesis) -> Array:
    """Return the columns (..., k) of a hypothesis on a few actuators from those of each alone.

    Raises:
        KeyError: an actuator has no hypothesis of its own.
    """
    each = [columns[..., c] for c in single_columns(hypotheses, hypothesis)]
    return np.sum(each, axis=0) if hypothesis.shared else np.concatenate(each, axis=-1)


def single_columns(hypotheses: Sequence[Hypothesis], hypothesis: Hypothesis
                   ) -> list[tuple[int, ...]]:
    """Return the columns of each actuator alone; raises KeyError as :func:`of_single`."""
    if not hypothesis.on:
        raise KeyError(hypothesis.label)    # of the whole machine there are no parts
    own = {f.on[0]: f for f in hypotheses if f.family == hypothesis.family and len(f.on) == 1
           and f.alike(hypothesis)}
    return [own[a].columns for a in hypothesis.on]
