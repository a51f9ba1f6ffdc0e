"""Causes not in the library, as blocks: smooth functions of each recorded input and of time.

An unknown cause moves a joint, all joints alike, or the platform as a smooth function of a recorded
input: a spline through nodes, whose values have a Matern covariance (5/2). Over time it is any
slow drift, or a random walk. Kennedy & O'Hagan 2001; Rasmussen & Williams 2006, 4.2.
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
"""Generators of causes from recorded inputs."""
UNKNOWN_FAMILY = "unknown"
"""The family of causes not in the library."""
TOO_FINE = "a function of travel too fine to resolve"
PULLS = "limbs pulling against each other, differently at each pose"
OFF_BY = "a constant in all distances"
OFF_REMEDY = ("check whether a ball's radius was left in the distances, or subtracted twice; if "
              "not, measure a known distance with the same instrument; correct the column "
              "`distance` by that constant")
MOST_PLACES = 400
"""Most poses with a column each: this many take a third of the time of everything else."""
MOST_SCATTERED = 800
"""Most rows with a column each: without them a joint's scatter appears as many other causes."""
ROUND_OFF = 1e-11
AGAIN = "return to one pose repeatedly from the same side, and read {} each time"


@dataclass(frozen=True, eq=False)
class UnknownCause(CauseLook):
    """One block of ``width`` columns, and its description."""

    width: int
    roots: tuple[Array, ...]
    share: float

    def block(self, number: int) -> Block:
        """Return it as a block whose first column has a given number."""
        return Block(self.label, UNKNOWN_FAMILY, tuple(range(number, number + self.width)),
                     float(np.log(float(UNKNOWN) * self.share)), roots=self.roots, low=self.low,
                     high=self.high, form=self.label, subject=self.subject)


class UnknownCauses:
    """All unknown causes that the rows of a system could show, and their columns.

    Attributes:
        causes: one block each.
        columns: of all of them (n, T), zero where not observed.
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
        """The column of each joint's zero, per metre or radian (N, m)."""
        names = self.system.problem.mechanism.actuators
        return {name: self._zero(np.arange(len(names)) == a) for a, name in enumerate(names)}

    def _zero(self, on: Bools) -> Array:
        return self.system.column([p.setting.at_joints(np.ones_like(p.setting.travel), on)
                                   for p in self.system.parts]) * self.system.observed

    @cached_property
    def least(self) -> float:
        """Rms, in sigmas, below which a column is only round-off of cancelling terms."""
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
        """Return it as a cause, None if its columns are only round-off."""
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

        The main effect of one input, or of direction, is a separate cause: a function of two, or by
        direction, is the remaining interaction (functional analysis of variance).
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
        """Yield a joint's independent errors at each pose, equal at each visit, or in each row.

        By pose this is a function of its travel too fine to resolve, such as a wave of an unlisted
        pitch; by row it is a scatter of its own. Without repeats, a single number per row cannot
        distinguish it from noise.
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
                yield Made(f"a scatter from row to row acting on {name}", own,
                           subject=name, remedy=AGAIN.format(name))

    def _of_pulls(self) -> Iterator[Made]:
        """Yield errors of redundant limbs at each pose, pulling against each other with friction.

        As common as any kind: present in most runs of a router on four belts.
        """
        if self._all_at_poses is not None and self.system.problem.mechanism.surplus:
            yield Made(PULLS, self._all_at_poses, together=True)

    @cached_property
    def _all_at_poses(self) -> Array | None:
        """Independent errors of all joints at each pose; for at most half as many poses."""
        each = [*self._at_poses.values()]
        alike = len(set(self.system.problem.mechanism.actuator_quantity)) == 1
        if len(each) < 2 or not alike or 2 * each[0].shape[1] > MOST_PLACES:
            return None
        return np.concatenate(each, axis=1)

    @cached_property
    def _at_poses(self) -> dict[str, Array]:
        """Columns of each joint's zero at each of P poses, empty if poses are not revisited."""
        group, rows = self.system.group, self.system.group.size
        poses, place = np.unique(group, return_inverse=True)
        again = 1 < poses.size <= MOST_PLACES and 2 * poses.size <= rows
        return self._at_each(place) if again else {}

    def _at_each(self, place: Ints) -> dict[str, Array]:
        """Return columns of each joint's zero at each of P places; ``place``: of each row (N,)."""
        there = np.eye(int(place.max()) + 1)[place][:, None, :]
        return {name: (unit[..., None] * there).reshape(-1, there.shape[-1])
                for name, unit in self.zeros_of_joints.items()}

    def _of_loads(self) -> Iterator[Made]:
        """Yield an elastic response to the load that the library does not contain.

        Any elastic structure responds to the joints' loads by changes of their lengths, each load
        changing all of them, with a symmetric matrix (Maxwell 1864).
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
        yield Made("an elastic response to the load",
                   np.stack([c.reshape(-1) for c in columns], axis=1), together=True,
                   remedy=LOADED)

    def _of_references(self) -> Iterator[Made]:
        """Yield errors of the measurement reference.

        They are as common as any kind of effect, but are not errors of the machine.
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
            yield Made(f"an error of the measurement reference ({kind.label})",
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
