"""Cross-validated choice of freedoms: which of nested sets predicts left-out rows best.

Freedoms beyond the usual ones cost rows, and what they fit need not be there on another day. Every
set is fitted without each block of neighbouring rows in turn, and predicts that block. The freedoms
of the file are kept, because its tolerances state what is unknown, unless another set predicts
better by a twentieth and by more than a standard error; then the smallest set within one standard
error of the best is kept (Breiman et al., Classification and Regression Trees, 1984). The sets
differ little from the smallest, so one step from its fit replaces each fit: linear algebra on rows.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import (
    LEAST,
    WORTH,
    Fit,
    FitOptions,
    Problem,
    column_scale,
    prior_weights,
    to_prior,
    values_taken,
    with_estimated_noise,
)
from ppmcal.calibration.knowledge.intervals import spatial_blocks
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.given import Conditioned
from ppmcal.inference.predictive import predicted
from ppmcal.inference.priors import WIDE
from ppmcal.linalg import Array, Ints, reciprocals
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.units import Finite
from ppmcal.wording import pluralize

log = logging.getLogger(__package__)

FEWEST = 3
"""Fewest blocks for a standard error."""


@dataclass(frozen=True)
class FreedomSet:
    """One set of freedoms; its figures are bare.

    Attributes:
        adds: parameters that it has beyond the previous set; for the first: all.
        missed: rms prediction error of left-out rows over their noise.
        behind: excess of its mean square over that of the best set, and ``error``, the
            standard error of this excess; 0 for the best.
        kept: whether it is in the fit, as a file states for each.
    """

    adds: tuple[str, ...]
    missed: Finite
    behind: Finite
    error: Finite
    kept: bool = False


@dataclass(frozen=True)
class FreedomChoice:
    """Result of cross-validation: the sets, smallest first; the file's set; the set kept.

    ``blocks``: number of blocks left out in turn.
    """

    sets: tuple[FreedomSet, ...]
    usual: int
    kept: int
    blocks: int


def with_chosen_freedoms(problem: Problem, options: FitOptions, which: Sequence[bool]
                         ) -> tuple[Problem, FreedomChoice | None]:
    """Return the problem with those freedoms of its machine that predict left-out rows best.

    Args:
        problem: machine, data and what the file frees.
        options: of the fits; without the tolerances as prior nothing is chosen.
        which: data sets whose noise is estimated.

    Raises:
        BadInput, NoResult: see :func:`ppmcal.calibration.fit.identify`.
    """
    machine = problem.mechanism
    if not machine.optional:
        log.info("the file leaves no freedoms to choose from")
    if not machine.optional or options.method != "prior" or problem.earlier is not None:
        return problem, None
    levels, usual = _levels(machine)
    small = replace(problem, mechanism=replace(machine, free=levels[0]), free=levels[0])
    fit, _ = with_estimated_noise(small, options, which)
    choice = freedom_choice(fit, levels, usual)
    free = tuple(sorted(p for level in levels[:1 + (usual if choice is None else choice.kept)]
                        for p in level))
    parameters = tuple(replace(p, fixed=False) if i in free else p
                       for i, p in enumerate(machine.parameters))
    chosen = replace(machine, parameters=parameters, free=free, optional=())
    return replace(problem, mechanism=chosen, free=free), choice


def _levels(machine: Mechanism) -> tuple[list[tuple[int, ...]], int]:
    """Return what each nested set adds, the smallest first, and the last that the file frees."""
    taken: set[int] = set()
    levels: list[tuple[int, ...]] = []
    usual = 0
    for n, patterns in enumerate(machine.optional, 1):
        own = tuple(i for i, p in enumerate(machine.parameters) if i not in taken
                    and p.prior_sigma is not None and any(p.matches(x) for x in patterns))
        taken.update(own)
        levels.append(own)
        usual = n if set(own) & set(machine.free) else usual
    return [tuple(p for p in machine.free if p not in taken), *levels], usual


def choice_sentence(choice: FreedomChoice) -> Note:
    """Return which freedoms were kept, and the prediction error of left-out rows for each set."""
    out = []
    for n, one in enumerate(choice.sets):
        adds = f"+ {_shortened(one.adds)}" if n else pluralize(len(one.adds), "parameter")
        out.append(f"{adds} {one.missed:.3g}")
    kept = "the smallest set" if not choice.kept else (
        f"+ {_shortened(choice.sets[choice.kept].adds)}")
    why = "as the file has it" if choice.kept == choice.usual else (
        "better by more than a standard error")
    return Note(f"Cross-validation error (x noise, {choice.blocks} blocks of space): "
                f"{', '.join(out)}. Using: {kept}, {why}.", NOTE, "freedoms")


def _shortened(names: Sequence[str]) -> str:
    return ", ".join(names[:2]) + (f" and {len(names) - 2} more" if len(names) > 2 else "")


def freedom_choice(fit: Fit, levels: Sequence[Sequence[int]], usual: int
                   ) -> FreedomChoice | None:
    """Return the one of nested sets that best predicts left-out rows; None with too few rows.

    Args:
        fit: of the smallest set, with the noise to use.
        levels: parameters that each set has beyond the previous one; the first is the fit's own.
        usual: the set that is kept unless another is better.
    """
    if fit.information.count - values_taken(fit) < LEAST:
        return None
    machine = fit.problem.mechanism
    order = [p for level in levels for p in level]
    wide = fit.problem.changed(free=tuple(order))
    rows, block, values = _by_block(fit, wide)
    blocks = int(block.max(initial=-1)) + 1
    if blocks < FEWEST:
        return None
    unit, count, size = column_scale(wide), len(order), len(wide.columns)
    away = to_prior(wide, fit.state) / unit
    ends = np.cumsum([len(level) for level in levels])
    square = np.stack([_left_out(rows, block, prior_weights(wide, "prior") * unit, away,
                                 np.r_[:end, count:size]) for end in ends])
    total = square.sum(axis=1)
    best = int(np.argmin(total))
    apart = square - square[best]
    error = np.sqrt(blocks * np.var(apart, axis=1, ddof=1))
    kept = usual
    worth = total[best] < (1.0 - WORTH) ** 2 * total[usual]
    if worth and apart[usual].sum() > error[usual]:
        kept = int(np.flatnonzero(apart.sum(axis=1) <= error)[0])
    sets = tuple(FreedomSet(tuple(machine.names[p] for p in level), float(np.sqrt(t / values)),
                            float(a / values), float(e / values))
                 for level, t, a, e in zip(levels, total, apart.sum(axis=1), error, strict=True))
    return FreedomChoice(sets, usual, kept, blocks)


def _by_block(fit: Fit, wide: Problem) -> tuple[Array, Ints, float]:
    """Return white rows (n, C + 1), residual last, the block of each (n,), and number of values."""
    block, unit = spatial_blocks(fit), column_scale(wide)
    rows, label, values = list[Array](), list[Ints](), 0.0
    for part in wide.rows(fit.state, True, fit.keep):
        own = np.concatenate([part.jacobian * unit, part.residual[..., None]], axis=-1)
        rows.append(own.reshape(-1, unit.size + 1))
        label.append(np.repeat(block[part.dataset][part.index], own.shape[1]))
        values += part.count
    return np.concatenate(rows), np.unique(np.concatenate(label), return_inverse=True)[1], values


def _left_out(rows: Array, block: Ints, prior: Array, away: Array, columns: Array) -> Array:
    """Return each block's sum of squared prediction errors from a fit of the others (B,).

    Args:
        rows: white (n, C + 1), the residual last, columns in natural units.
        block: block number of each row (n,).
        prior: weight of each column.
        away: distance of each column from its nominal.
        columns: of the set; the others are at their nominals.
    """
    given = Conditioned.nothing(MatrixColumns(np.zeros((len(rows), 0))),
                                rows[:, -1] - rows[:, :-1] @ away)
    given = given.taking(rows[:, columns] * reciprocals(prior, float(WIDE))[columns])
    return np.asarray(np.bincount(block, predicted(given, block).error**2), dtype=float)
