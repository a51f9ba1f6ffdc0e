"""Possible causes: every kind of effect, for all actuators together and for each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.absorbed import testable
from ppmcal.diagnosis.at_sessions import session_starts, zeros_are_known
from ppmcal.diagnosis.by_session import by_session
from ppmcal.diagnosis.grids import NEAR, Grids, lowest, sign, start_values, usual_range
from ppmcal.diagnosis.hypotheses import (
    SOME_FILES,
    Collector,
    Hypothesis,
    Library,
    Untestable,
    frozen_slots,
    shapes,
)
from ppmcal.diagnosis.library_columns import only_slots
from ppmcal.diagnosis.linear_system import System
from ppmcal.diagnosis.misread_columns import misread_columns
from ppmcal.kinematics.effect_response import carried_by
from ppmcal.kinematics.needed_columns import by_load, lacking
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import WRENCH
from ppmcal.model.effects import (
    GEOMETRY,
    EffectKind,
    EffectParameter,
    Setting,
    Shift,
    effect_kinds,
)
from ppmcal.model.mechanism import joint_groups, limbs_with_free, usable_joints
from ppmcal.model.sessions import campaign, targets_beside_others
from ppmcal.notes import NOTE, Note

UNBORNE = "it shows only through compliance under load, and the model has none"
STARTS = (np.arange(16) + 0.5) / 8.0 - 1.0
"""Possible states of an effect with memory before the first row, as parts of the largest."""
SEEN = 0.05
"""Modes of these states below this part of the largest mode are negligible."""
APART = 1e-3
"""Coordinates of a step with less than this part independent of earlier ones are not identifiable.

Larger than the rotation of a target by a step already in the model, and smaller than the ratio of
a target's distance from the others to that from the platform's origin.
"""


class _Kinds(Collector):
    """Builds the hypotheses of every kind of effect.

    ``tried``: parameters that the fit frees only for the test.
    """

    def __init__(self, system: System, tried: Sequence[int] = ()) -> None:
        super().__init__(system)
        self.grids = Grids(system)
        self.starts = session_starts(system.problem)
        effects, under_test = system.problem.mechanism.effects, set(tried)
        lasting = [e.kind for e in effects if not set(e.parameters.values()) & under_test]
        self.bears = any(k.uses_load and k.carried is None and not k.instrument for k in lasting)
        self.there = {k.name for k in lasting}
        self.bearing = next((k for k in effect_kinds().values() if k.under_weight
                             and k.exists_in(self.motion) and len(set(self.turning)) == 1), None)

    def kind(self, kind: EffectKind) -> None:
        """Add all hypotheses of one kind."""
        usable = usable_joints(self.system.problem.mechanism, kind)
        if kind.nuisance or not kind.exists_in(self.motion) or not usable.any() or (
                "touch" in kind.needs and not self._touched()) or (
                kind.instrument and self.system.problem.blind):
            return
        usable = usable & ~self._free_already(kind)
        on, missing, lack = self._recorded(kind, usable)
        if missing:
            self.untestable.append(Untestable(
                kind.label, missing, Note(f"not recorded in {' and '.join(lack)}", NOTE, SOME_FILES)
                if lack else "not recorded, or the same in every row"))
        if not on.any():
            return
        if kind.carried is not None and not self.bears and self.bearing is None:
            self.untestable.append(Untestable(kind.label, ("a compliance in the model",), UNBORNE))
            return
        specs = [s for s in kind.parameters(self.motion) if not (s.constant or s.optional)
                 and (s.scaling or s.scan is None) and self._varies(s)
                 and s.unless not in self.there]
        if kind.onset and not kind.per_actuator:
            specs = self._told_apart(kind, on, specs)
        for some in [[s] for s in specs] if kind.one_by_one else [specs] if specs else []:
            for constants in self.grids.of(kind, some[0].name):
                if constants.get(kind.onset) not in self.starts.values():
                    self._hypotheses(kind, on, constants, some)
            if kind.onset:
                self._at_sessions(kind, on, some)

    def _hypotheses(self, kind: EffectKind, on: Bools, constants: dict[str, float],
                    specs: Sequence[EffectParameter]) -> None:
        values = start_values(kind, self.motion) | constants
        requires = None if kind.carried is None or self.bears or self.bearing is None else (
            self.bearing.name, tuple(self.actuators))
        low = tuple(-NEAR * constants[s.name] if s.scaling else lowest(s) for s in specs)
        high = tuple(NEAR * constants[s.name] if s.scaling else s.high for s in specs)
        usual = tuple(usual_range(s, self.grids.stroke) for s in specs)
        usual, ratio = (usual, ()) if requires is None else ((), usual)
        shown = {n: v for n, v in constants.items() if np.isfinite(v)}
        strokes = tuple(n for n in kind.stroke_ends(self.motion) if n in constants)
        names = tuple(s.name for s in specs)
        of_kind = partial(Hypothesis, kind.name, strokes=strokes, effect=kind,
                          part=names[0] if kind.one_by_one else "", requires=requires,
                          ratio=ratio)

        def add(on: tuple[str, ...], columns: tuple[int, ...], constants: dict[str, float],
                starts: Sequence[tuple[int, int]] = ()) -> None:
            self.hypotheses.append(of_kind(on, True, names, low, high, columns, usual,
                                           constants, starts=tuple(starts)))

        if not kind.per_actuator:
            add((), self._columns(kind, on, values, specs), shown)
            return
        if kind.opposed:
            for pulling in map(np.array, joint_groups(self.system.problem.mechanism, kind)):
                if not pulling[~on].any():
                    add(tuple(np.array(self.actuators)[pulling].tolist()),
                        self._columns(kind, pulling, values, specs), shown)
            return
        own = {} if strokes or kind.onset else self._each(kind, on, values, specs)
        starts = {}
        for a in np.flatnonzero(on):
            ends = self.grids.ends(strokes, int(a))
            if a not in own:
                own[int(a)] = self._columns(kind, np.arange(on.size) == a, values | ends, specs)
            starts[int(a)] = list(self._starts(kind, int(a), values | ends, specs))
            add((self.actuators[a],), own[int(a)], shown | ends, starts[int(a)])
        same = len(set(self.turning[on].tolist())) == 1
        if len(own) > 1 and same:
            where = self._columns(kind, on, values, specs) if strokes else tuple(
                self.columns.sum_of(cs) for cs in zip(*own.values(), strict=True))
            on_names = tuple(self.actuators[a] for a in own)
            each = [s for a in own for s in (self._starts(kind, a, values, specs) if strokes
                                             else starts[a])]
            add(on_names, where, shown, each)
            self.hypotheses.append(of_kind(
                on_names, False,
                tuple(f"{self.actuators[a]}:{n}" for a in own for n in names), low * len(own),
                high * len(own), tuple(c for cs in own.values() for c in cs), usual * len(own),
                shown, starts=tuple((c, n * len(names) + of) for n, a in enumerate(own)
                             for c, of in starts[a])))

    def _at_sessions(self, kind: EffectKind, on: Bools, specs: Sequence[EffectParameter]) -> None:
        """Add an event at each session start; at the first only one with a size per joint."""
        known = zeros_are_known(self.system.problem)
        for n, (label, row) in enumerate(self.starts.items()):
            begin = len(self.hypotheses)
            self._hypotheses(kind, on, {kind.onset: row}, specs)
            own = [replace(h, begins=label, beside=n == 0) for h in self.hypotheses[begin:]]
            self.hypotheses[begin:] = [h for h in own if n or (known and not h.shared)]

    def _starts(self, kind: EffectKind, a: int, values: dict[str, float],
                specs: Sequence[EffectParameter]) -> Iterator[tuple[int, int]]:
        """Add columns for an effect's unknown state before the first row, for each parameter.

        They have the second moments of all possible states, taken as equally probable. Yields the
        index of each and its parameter; none if the state is known.
        """
        if kind.unsettled is None:
            return
        parts = self.system.parts
        one, none = np.arange(self.turning.size) == a, {s.name: 0.0 for s in specs}
        ends = np.cumsum([0, *(len(p.setting.travel) for p in parts)])
        for n, s in enumerate(specs):
            size = values[s.name] if s.scaling else 1.0
            own = values | none | {s.name: size}
            each = np.array([np.concatenate([kind.unsettled(p.setting, one, own, start)[:, a]
                                             for p in parts]) for start in STARTS])
            _, length, ways = linalg.svd(each / (abs(size) * np.sqrt(len(STARTS))))
            for du in (length[:, None] * ways)[length > SEEN * length[0]]:
                yield self.columns.shifted([
                    p.setting.at_joints(np.where(one, du[b:e, None], 0.0), one)
                    for p, (b, e) in zip(parts, pairwise(ends), strict=True)]), n

    def _columns(self, kind: EffectKind, on: Bools, values: dict[str, float],
                 specs: Sequence[EffectParameter]) -> tuple[int, ...]:
        """Add one column for each parameter of an effect; return their indices."""
        if not kind.onset:
            return tuple(self.columns.shifted(shifts, factor)
                         for factor, shifts in self._shifts(kind, on, values, specs))
        after = self._row_numbers >= values[kind.onset]
        return tuple(self.columns.later(column, after)
                     for column in self._step_columns(kind, on, specs))

    def _step_columns(self, kind: EffectKind, on: Bools, specs: Sequence[EffectParameter]
                      ) -> list[Array]:
        """Return an event's columns (N, m) as if it had been present throughout.

        They are the same whenever it happens, except that earlier rows are then 0.
        """
        key = kind.label, tuple(on.tolist()), tuple(s.name for s in specs)
        if key not in self._steps:
            values = start_values(kind, self.motion) | {kind.onset: -np.inf}
            self._steps[key] = [factor * self.system.column(shifts) for factor, shifts
                                in self._shifts(kind, on, values, specs)]
        return self._steps[key]

    def _told_apart(self, kind: EffectKind, on: Bools, specs: Sequence[EffectParameter]
                    ) -> list[EffectParameter]:
        """Return the coordinates of a step that some campaign distinguishes from earlier ones.

        If only one point of a body is seen, rotations of the body are shifts of that point.
        """
        columns = self._step_columns(kind, on, specs)
        rows: dict[str, list[int]] = {}
        for p in self.system.parts:
            rows.setdefault(campaign(self.system.problem.datasets[p.dataset]), []).extend(
                range(p.at.start, p.at.stop))
        told = {n for own in rows.values()
                for n in _apart([c[own].reshape(-1) for c in columns])}
        return [s for n, s in enumerate(specs) if n in told]

    def _each(self, kind: EffectKind, on: Bools, values: dict[str, float],
              specs: Sequence[EffectParameter]) -> dict[int, tuple[int, ...]]:
        """Add the columns of a kind on each actuator alone, all evaluated at once.

        Empty if the kind shifts more than the slots of its own limbs.
        """
        if kind.carried is not None:
            return {}
        found = self._shifts(kind, on, values, specs)
        if not all(only_slots(s) for _, shifts in found for s in shifts):
            return {}
        limbs = self.system.problem.mechanism.limbs
        return {int(a): tuple(
            self.columns.shifted([Shift({(i, slot): v for (i, slot), v in s.slots.items()
                                         if limbs[i].actuator == a}) for s in shifts], factor)
            for factor, shifts in found) for a in np.flatnonzero(on)}

    def _shifts(self, kind: EffectKind, on: Bools, values: dict[str, float],
                specs: Sequence[EffectParameter]) -> list[tuple[float, list[Shift]]]:
        """Return for each parameter a factor and the shifts of all parts that it multiplies."""
        if kind.carried is not None:
            by = [carried_by(kind, p.response.closure.model, p.setting, self._borne(on))
                  for p in self.system.parts]
            return [(1.0, [b[s.name] for b in by]) for s in specs]
        terms = [kind.evaluate(p.setting, on, values) for p in self.system.parts]
        return [(sign(s) / values[s.name], [t.shift for t in terms]) if s.scaling
                else (sign(s), [t.by[s.name] for t in terms]) for s in specs]

    @cached_property
    def _row_numbers(self) -> Array:
        return np.concatenate([p.response.rows.row for p in self.system.firsts])

    @cached_property
    def _steps(self) -> dict[tuple[str, tuple[bool, ...], tuple[str, ...]], list[Array]]:
        return {}

    def _borne(self, on: Bools) -> Callable[[Setting], Shift] | None:
        """Return the shifts of a unit compliance under load; None: those of the model's effects."""
        kind = self.bearing
        if self.bears or kind is None:
            return None
        values = start_values(kind, self.motion)
        return lambda at: kind.evaluate(at, on, values).shift

    def _varies(self, spec: EffectParameter) -> bool:
        """Whether a wrench component that a parameter depends on is ever applied."""
        if not spec.component:
            return True
        at = [WRENCH.index(c) for c in spec.component.split()]
        return any(np.nanmax(np.abs(p.setting.wrench[:, at]), initial=0.0) > 0.0
                   for p in self.system.parts)

    def _touched(self) -> bool:
        """Whether rows are touches of a flat."""
        touches = [p.response.rows.touch for p in self.system.parts]
        return any(t is not None and t.any() for t in touches)

    def _recorded(self, kind: EffectKind, usable: Bools
                  ) -> tuple[Bools, tuple[str, ...], tuple[str, ...]]:
        """Return the actuators whose columns are present in every part, and the missing columns.

        Last, the files that lack them, if other files have them.
        """
        on = usable.copy()
        missing: list[str] = []
        lack: dict[str, bool] = {}
        for part in self.system.parts:
            name = self.system.problem.datasets[part.dataset].name
            needs = by_load(kind.needs, self.system.problem.mechanism, part.response.rows)
            for a in np.flatnonzero(usable):
                gone = lacking(needs, (self.actuators[a],), (int(a),), part.response.rows)
                lack[name] = lack.get(name, False) or bool(gone)
                if gone:
                    on[a] = False
                    missing += gone
        for a in np.flatnonzero(on):
            gone = self._constant(kind, int(a))
            if gone:
                on[a] = False
                missing += gone
        files = () if all(lack.values()) else tuple(n for n, lacks in lack.items() if lacks)
        return on, tuple(dict.fromkeys(missing)), files

    def _constant(self, kind: EffectKind, a: int) -> list[str]:
        """Return needed columns that never change, or a load that is never applied.

        Their effect is a constant, which the geometry absorbs.
        """
        rows = [p.response.rows for p in self.system.parts]
        out = []
        for need in kind.needs:
            if need in ("order", "past", "touch"):
                continue    # two rows are enough to have an order
            if need in ("dir", "vel"):
                values = [(r.approach if need == "dir" else r.velocity)[:, [a]] for r in rows]
                name = f"{need}_{self.actuators[a]}"
            elif need in ("load", "wrench"):
                if not any(np.any(np.nan_to_num(r.wrench)) for r in rows):
                    out.append("payload")
                continue
            elif need == "tension":
                if not any(np.any(np.nan_to_num(p.setting.tension[:, a])) for p in
                           self.system.parts):
                    out.append(f"tension_{self.actuators[a]}")
                continue
            else:
                values = [getattr(r, need)[:, None] for r in rows]
                name = need
            column = np.concatenate(values)
            if not np.nanmax(column) - np.nanmin(column) > 1e-9 * np.nanmax(np.abs(column)):
                out.append(name)
        return out

    def _free_already(self, kind: EffectKind) -> Bools:
        """Return the actuators with a free parameter equivalent to the kind (k,)."""
        out = np.zeros(self.turning.size, dtype=bool)
        problem = self.system.problem
        for limb in limbs_with_free(problem.mechanism, kind.same_as, problem.free):
            out[limb.actuator] = True
        return out


def _apart(columns: Sequence[Array]) -> Iterator[int]:
    """Yield the indices of columns (n,) independent of earlier ones, see :data:`APART`."""
    basis = np.zeros((len(columns[0]), 0))
    for n, column in enumerate(columns):
        more = column - basis @ (basis.T @ column)
        size = np.linalg.norm(more)
        if size > APART * np.linalg.norm(column):
            basis = np.column_stack([basis, more / size])
            yield n


def library(system: System, kinds: Sequence[str] | None = None, tried: Sequence[int] = (),
            misread: bool = False, apart: bool = False) -> Library:
    """Return every hypothesis that these data could test.

    ``kinds``: only these; ``tried``: parameters that the fit frees only for the test; ``misread``:
    also effects of misinterpreted columns; ``apart``: also effects with a size per session.
    """
    maker, beside = _Kinds(system, tried), targets_beside_others(system.problem.datasets)
    for name, kind in effect_kinds().items():
        if kinds is None or name in kinds:
            for variant in kind.variants(maker.motion) if kind.variants else (kind,):
                maker.kind(variant)
            if kind.of_target is not None:
                for one in map(kind.of_target, beside):
                    maker.kind(one)
    if apart:
        maker.hypotheses += by_session(maker)
    if kinds is None or GEOMETRY in kinds:
        frozen_slots(maker, tried)
    if kinds is None:
        shapes(maker)
    if misread:
        maker.misread += misread_columns(maker)
    return testable(maker.library(), system)
