"""What no kind of the library does, as blocks: smooth functions of each recorded input, of time.

An unknown cause moves a joint, all joints alike, or the platform as a smooth function of something
that is recorded: a spline through nodes, whose values have a Matern covariance (5/2). Over time it
is any slow course, or a walk. Kennedy & O'Hagan 2001; Rasmussen & Williams 2006, 4.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, compress

import numpy as np

from ppmcal.diagnosis.grids import start_values
from ppmcal.diagnosis.kernels import LENGTHS, beyond_mean, matern, product_kernels
from ppmcal.diagnosis.linear_system import System, Whitening
from ppmcal.diagnosis.term_candidates import Visible, forms
from ppmcal.diagnosis.unknown_courses import courses_of
from ppmcal.diagnosis.unknown_functions import (
    ALONE,
    LOADED,
    Acted,
    CauseLook,
    Made,
    fine_functions,
    functions_of_each,
    of_others,
    over_travels,
    over_volume,
)
from ppmcal.diagnosis.unknown_memories import of_memories
from ppmcal.diagnosis.unknown_pairs import of_pairs
from ppmcal.diagnosis.unknown_ways import of_ways
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.priors import FAMILY, GOES_WITH, SHAPES, UNKNOWN
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.effects import Setting, effect_kinds
from ppmcal.model.effects.learned import JOINT, LearnedCurve

FUNCTIONS = (over_volume, of_others, functions_of_each, fine_functions, over_travels, of_pairs,
             of_memories)
"""What is made of what rows record."""
UNKNOWN_FAMILY = "unknown"
"""The family of what no kind of the library does."""
TOO_FINE = "a function of travel too fine to be seen"
PULLS = "what limbs pull against each other, another at each pose"
OFF_BY = "a constant in all distances"
OFF_REMEDY = ("look whether a ball's radius was left in the distances, or taken off twice; else "
              "measure a known one with the same instrument; correct the column `distance` by "
              "that constant")
MOST_PLACES = 400
"""Poses that may have a column each: so many take a third of the time of the rest."""
MOST_SCATTERED = 800
"""The same of rows: without it a joint's scatter is a long row of other causes."""
ROUND_OFF = 1e-11
AGAIN = "go to one pose again and again from the same side, and read {} each time"


@dataclass(frozen=True, eq=False)
class UnknownCause(CauseLook):
    """One block of columns ``number`` to ``number + width``, and what it looks like."""

    width: int
    roots: tuple[Array, ...]
    share: float

    def block(self, number: int) -> Block:
        """Return it as a block whose columns begin at a number."""
        return Block(self.label, UNKNOWN_FAMILY, tuple(range(number, number + self.width)),
                     float(np.log(float(UNKNOWN) * self.share)), roots=self.roots, low=self.low,
                     high=self.high, form=self.label, subject=self.subject)


class UnknownCauses:
    """All unknown causes that the rows of a system could tell, and their columns.

    Attributes:
        causes: one block each.
        columns: of all of them (n, T), zero where nothing was observed.
    """

    def __init__(self, system: System, everywhere: Sequence[Setting]) -> None:
        self.system = system
        inputs = [*self._of_inputs(everywhere),
                  *chain.from_iterable(functions(self._seen) for functions in FUNCTIONS),
                  *self._of_places(), *of_ways(self._seen), *self._of_loads()]
        trends = list(courses_of(system, self.zeros_of_joints, self.least))
        groups = [g for g in (inputs, trends) if g]
        shares: list[tuple[Made, float]] = []
        for group in groups:
            weights = {alike: sum(m.usual for m in group if m.together == alike)
                       for alike in (False, True)}
            each = (1.0 - SHAPES.value) / len(groups) / sum(w > 0.0 for w in weights.values())
            shares += [(m, each * m.usual / weights[m.together]) for m in group]
        shares += [(m, float(FAMILY) / float(UNKNOWN))
                   for m in (*self._of_references(), *self._of_pulls())]
        found = [(m, cause) for m, share in shares if (cause := self._cause(m, share))]
        self.causes = [cause for _, cause in found]
        self.columns = MatrixColumns(np.hstack([
            np.zeros((system.observed.size, 0)), *(m.columns for m, _ in found)]))

    @cached_property
    def zeros_of_joints(self) -> dict[str, Array]:
        """What the zero of each joint does, by a metre or a radian (N, m)."""
        names = self.system.problem.mechanism.actuators
        return {name: self._zero(np.arange(len(names)) == a) for a, name in enumerate(names)}

    def _zero(self, on: Bools) -> Array:
        return self.system.column([p.setting.at_joints(np.ones_like(p.setting.travel), on)
                                   for p in self.system.parts]) * self.system.observed

    @cached_property
    def least(self) -> float:
        """Rms, in sigmas, below which a column is a difference of equals: nothing but round-off."""
        return ROUND_OFF * max(float(np.max(np.abs(u))) for u in self.zeros_of_joints.values())

    def blocks(self, first: int) -> Iterator[tuple[Block, UnknownCause]]:
        """Yield all blocks; ``first``: number of the first column."""
        for cause in self.causes:
            yield cause.block(first), cause
            first += cause.width

    @cached_property
    def _seen(self) -> Visible:
        return Visible(self.system, Whitening(), np.zeros((self.system.observed.size, 0)),
                       self.system.residual.reshape(-1))

    def _cause(self, made: Made, share: float) -> UnknownCause | None:
        """Return it as a cause, None where its columns are nothing but round-off."""
        gram = made.columns.T @ made.columns
        if not np.isfinite(gram).all() or not np.trace(gram) > self.least**2 * self.system.count:
            return None
        return UnknownCause(width=made.columns.shape[1], share=share, **made.look,
                            roots=made.roots(gram, self.system.count))

    def _of_inputs(self, everywhere: Sequence[Setting]) -> Iterator[Made]:
        actuators = self.system.problem.mechanism.actuators
        for curve, on in forms(self._seen, everywhere):
            acted = (Acted(" ".join(compress(actuators, on)), JOINT, on) if curve.acts == JOINT
                     else Acted(curve.acts, curve.acts))
            alone = curve.inputs == ("travel",) and not acted.together
            yield acted.made(
                self._seen, f"a function of {' and '.join(curve.inputs)}"
                f"{' by direction' if curve.signed else ''}",
                [curve.weights(p.setting) for p in self.system.parts], self._kernels(curve, on),
                curve=curve, on=on, remedy=ALONE.format(acted.words, "it") if alone else "",
                usual=float(GOES_WITH) if curve.by or curve.signed else 1.0)

    def _kernels(self, curve: LearnedCurve, on: Sequence[bool]) -> list[Array]:
        """Return the kernels of a curve's values, by length.

        What one input does by itself, or a direction alone, is a cause of its own: a function of
        two, or by direction, is what is left of it (functional analysis of variance).
        """
        whole = [matern(curve.nodes, length) for length in LENGTHS]
        if not (curve.by or curve.signed):
            return whole
        acted = np.array(on)
        inputs = [[x if x.ndim == 1 else x[:, acted].ravel() for x in curve.seen(p.setting)]
                  for p in self.system.firsts]
        own = [np.concatenate(x) for x in zip(*inputs, strict=True)]
        if not curve.by:
            return beyond_mean(whole, curve.nodes, own[0])
        return product_kernels(curve.nodes, curve.by_nodes, own[0], own[1])

    def _of_places(self) -> Iterator[Made]:
        """Yield what a joint does at each pose by itself, the same at each visit, or in each row.

        At poses that is a function of its travel too fine for its course to be seen, such as a
        wave of a pitch that nobody listed; in rows a scatter of its own. One number that is not
        taken twice does not tell it from noise.
        """
        for name, own in self._at_poses.items():
            yield Made(f"{TOO_FINE} acting on {name}", own, subject=name,
                       remedy=ALONE.format(name, "it"))
        if self._all_at_poses is not None and not self.system.problem.mechanism.surplus:
            name = " ".join(self._at_poses)
            yield Made(f"{TOO_FINE} acting on {name}", self._all_at_poses, together=True,
                       remedy=ALONE.format("each joint", "it"))
        rows = self.system.group.size
        if 1 < rows <= MOST_SCATTERED and self.system.count >= 2 * rows:
            for name, own in self._at_each(np.arange(rows)).items():
                yield Made(f"something that differs from row to row acting on {name}", own,
                           subject=name, remedy=AGAIN.format(name))

    def _of_pulls(self) -> Iterator[Made]:
        """Yield what limbs that pull against each other do at each pose, as friction leaves it.

        As usual as any kind: in most runs of a router on four belts it is there.
        """
        if self._all_at_poses is not None and self.system.problem.mechanism.surplus:
            yield Made(PULLS, self._all_at_poses, together=True)

    @cached_property
    def _all_at_poses(self) -> Array | None:
        """What all joints do at each pose, each by itself; of them at once half as many poses."""
        each = [*self._at_poses.values()]
        alike = len(set(self.system.problem.mechanism.actuator_quantity)) == 1
        if len(each) < 2 or not alike or 2 * each[0].shape[1] > MOST_PLACES:
            return None
        return np.concatenate(each, axis=1)

    @cached_property
    def _at_poses(self) -> dict[str, Array]:
        """What each joint's zero does by itself at each of P poses, none where they are new."""
        group, rows = self.system.group, self.system.group.size
        poses, place = np.unique(group, return_inverse=True)
        again = 1 < poses.size <= MOST_PLACES and 2 * poses.size <= rows
        return self._at_each(place) if again else {}

    def _at_each(self, place: Ints) -> dict[str, Array]:
        """Return what each joint's zero does by itself at each of P places; rows are at (N,)."""
        there = np.eye(int(place.max()) + 1)[place][:, None, :]
        return {name: (unit[..., None] * there).reshape(-1, there.shape[-1])
                for name, unit in self.zeros_of_joints.items()}

    def _of_loads(self) -> Iterator[Made]:
        """Yield what gives way to the load in no way that the library has.

        Whatever is elastic answers the joints' loads by lengths of theirs, each load by all of
        them, and any two each other alike (Maxwell 1864).
        """
        parts, mechanism = self.system.parts, self.system.problem.mechanism
        loads = [p.setting.load for p in parts]
        count = len(mechanism.actuators)
        if (count < 2 or len(set(mechanism.actuator_quantity)) > 1
                or not all(np.isfinite(load).all() for load in loads)):
            return
        each = np.eye(count, dtype=bool)
        answers = [[self.system.column([
            p.setting.at_joints(np.repeat(load[:, [j]], count, axis=1), each[i])
            for p, load in zip(parts, loads, strict=True)]) * self.system.observed
            for j in range(count)] for i in range(count)]
        columns = [answers[i][j] + (answers[j][i] if i != j else 0.0)
                   for i in range(count) for j in range(i, count)]
        yield Made("something that gives way to the load",
                   np.stack([c.reshape(-1) for c in columns], axis=1), together=True,
                   remedy=LOADED)

    def _of_references(self) -> Iterator[Made]:
        """Yield errors of what the machine is measured against.

        They are as usual as any kind of effect, and name nothing that the machine has.
        """
        yield from self._of_distances()
        motion = self.system.problem.mechanism.motion
        for kind in effect_kinds().values():
            if not kind.nuisance or not kind.exists_in(motion):
                continue
            values, none = start_values(kind, motion), np.zeros(0, dtype=bool)
            terms = [kind.evaluate(p.setting, none, values) for p in self.system.parts]
            columns = [self.system.column([t.by[name] for t in terms]) * self.system.observed
                       for name in terms[0].by]
            yield Made(f"an error of what the machine is measured against ({kind.label})",
                       np.stack([c.reshape(-1) for c in columns], axis=1), remedy=kind.remedy)

    def _of_distances(self) -> Iterator[Made]:
        """Yield a constant that all distances have too much, whatever was measured."""
        lengths = np.zeros(self.system.residual.shape)
        for p in self.system.firsts:
            if self.system.problem.datasets[p.dataset].kind.along_line:
                one = p.whitened(lambda response: np.ones(response.seen.residual.shape))
                lengths[p.at, :one.shape[1]] = one
        if lengths.any():
            yield Made(OFF_BY, (lengths * self.system.observed).reshape(-1, 1), remedy=OFF_REMEDY)
