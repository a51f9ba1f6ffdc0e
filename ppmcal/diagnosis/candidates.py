"""What could be missing: every kind of effect, for all actuators together and for each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import product

import numpy as np

from ppmcal.diagnosis.hypotheses import (
    Collector,
    Hypothesis,
    Library,
    Untestable,
    frozen_slots,
    shapes,
)
from ppmcal.diagnosis.linear_system import System, SystemPart
from ppmcal.diagnosis.search import Search, columns_of
from ppmcal.kinematics.effect_response import carried_by, lacking, setting
from ppmcal.linalg import Bools, finite_rows
from ppmcal.model.dataset import WRENCH
from ppmcal.model.effects import (
    GEOMETRY,
    EffectKind,
    EffectParameter,
    ScanRange,
    Setting,
    Shift,
    effect_kinds,
)
from ppmcal.model.mechanism import limbs_with_free

UNBORNE = "it shows only through what gives way to the load, of which the model has nothing"
ALIKE = 0.5
"""It looks like an effect if it explains this part of what the effect does."""


def unrecorded_load(to: Collector) -> None:
    """Add what kinds do under a constant weight of 1 N, where no load was recorded."""
    if any(finite_rows(p.response.rows.wrench).any() for p in to.system.parts):
        return
    settings = [_weighed(p, to) for p in to.system.parts]
    for kind in effect_kinds().values():
        if kind.under_weight and to.motion in kind.motions:
            _under_weight(to, kind, settings)


def _under_weight(to: Collector, kind: EffectKind, settings: Sequence[Setting]) -> None:
    specs = [s for s in kind.parameters(to.motion) if not s.constant and not s.extra]
    values = start_values(kind, to.motion)
    own = {}
    for a, name in enumerate(to.actuators):
        one = np.arange(len(to.actuators)) == a
        terms = [kind.evaluate(s, one, values).by for s in settings]
        own[name] = tuple(to.add(_sign(s) * to.system.column([by[s.name] for by in terms]))
                          for s in specs)
    whole = tuple(to.add(np.sum([to.columns[c] for c in cs], axis=0))
                  for cs in zip(*own.values(), strict=True))
    for on, columns in [((name,), cs) for name, cs in own.items()] + [(to.actuators, whole)]:
        to.unrecorded.append(Hypothesis(
            kind.name, tuple(on), True, tuple(s.name for s in specs),
            tuple(_lowest(s) for s in specs), tuple(s.high for s in specs), columns))


def start_values(kind: EffectKind, motion: str) -> dict[str, float]:
    """Return where the linear model of a kind is taken: at nothing, a reciprocal one at 1."""
    return {s.name: 1.0 if s.reciprocal else s.default if s.constant and s.default is not None
            else 0.0 for s in kind.parameters(motion)}


def usual_range(spec: EffectParameter, stroke: float) -> tuple[float, float]:
    """Return the range of a parameter's coefficient in machines, SI; ``stroke``: the longest."""
    low, high = spec.usual
    if spec.reciprocal:
        return 1.0 / high, 1.0 / low if low > 0.0 else np.inf
    scale = spec.usual_scale(stroke)
    return scale * low, scale * high


def _sign(spec: EffectParameter) -> float:
    """Return the sign of d/d(1/k) at k = 1 against d/dk, for what is linear in 1/k."""
    return -1.0 if spec.reciprocal else 1.0


def _lowest(spec: EffectParameter) -> float:
    return 0.0 if spec.reciprocal else spec.low


def _weighed(part: SystemPart, to: Collector) -> Setting:
    """Return the setting of a part under the weight."""
    response = part.response
    wrench = np.zeros((len(response.pose), 6))
    wrench[:, :3] = to.system.problem.mechanism.gravity
    model = response.closure.model
    return setting(replace(model, shift=None), replace(response.rows, wrench=wrench),
                   response.closure.q, response.pose, model)


def look_alikes(search: Search, hypotheses: Sequence[Hypothesis], chosen: Sequence[int], effect: int
                ) -> list[Hypothesis]:
    """Return the best of ``hypotheses`` that explains most of what a chosen effect does, if any."""
    hypothesis = search.hypotheses[effect]
    if hypothesis.slot or not hypothesis.on:
        return []
    rest = search.test.given(columns_of(search, [i for i in chosen if i != effect]))
    goal = float(rest.explained(np.array([hypothesis.columns]))[0][0])
    best: tuple[float, Hypothesis] | None = None
    for other in hypotheses:
        if not set(other.on) & set(hypothesis.on) or rest.right[other.columns[0]] <= 0.0:
            continue
        share = float(rest.explained(np.array([other.columns]))[0][0]) / goal
        if share >= ALIKE and (best is None or share > best[0]):
            best = share, other
    return [best[1]] if best else []


class _Kinds(Collector):
    """Makes the hypotheses of every kind of effect.

    ``tried``: parameters that the fit frees only under test.
    """

    def __init__(self, system: System, tried: Sequence[int] = ()) -> None:
        super().__init__(system)
        effects, under_test = system.problem.mechanism.effects, set(tried)
        self.bears = any(e.kind.uses_load and e.kind.carried is None
                         and not set(e.parameters.values()) & under_test for e in effects)
        self.bearing = next((k for k in effect_kinds().values() if k.under_weight
                             and self.motion in k.motions and len(set(self.turning)) == 1), None)

    def kind(self, kind: EffectKind) -> None:
        """Add all hypotheses of one kind."""
        usable = self.turning if kind.joints == "turning" else np.ones_like(self.turning)
        if self.motion not in kind.motions or not usable.any():
            return
        usable = usable & ~self._free_already(kind)
        on, missing = self._recorded(kind, usable)
        if missing:
            self.untestable.append(Untestable(
                kind.name, missing, "not recorded, or the same in every row"))
        if not on.any():
            return
        if kind.carried is not None and not self.bears and self.bearing is None:
            self.untestable.append(Untestable(kind.name, ("a compliance in the model",), UNBORNE))
            return
        specs = [s for s in kind.parameters(self.motion)
                 if not s.constant and not s.extra and s.scan is None and self._varies(s)]
        for some in [[s] for s in specs] if kind.one_by_one else [specs] if specs else []:
            for constants in self._grids(kind, some[0].name):
                self._hypotheses(kind, on, constants, some)

    def _hypotheses(self, kind: EffectKind, on: Bools, constants: dict[str, float],
                    specs: Sequence[EffectParameter]) -> None:
        values = start_values(kind, self.motion) | constants
        leans = None if kind.carried is None or self.bears or self.bearing is None else (
            self.bearing.name, tuple(self.actuators))
        low = tuple(_lowest(s) for s in specs)
        high = tuple(s.high for s in specs)
        usual = tuple(usual_range(s, self._stroke()) for s in specs) if leans is None else ()
        shown = {n: v for n, v in constants.items() if np.isfinite(v)}
        strokes = tuple(n for n in kind.stroke_ends(self.motion) if n in constants)
        # an extra is paid for twice: its value, and that it was looked for
        searched = len(constants) - len(strokes) + sum(
            s.extra and s.name in constants for s in kind.parameters(self.motion))
        turns = self._stroke() / constants[kind.period] if kind.period else 0.0
        names = tuple(s.name for s in specs)
        of_kind = partial(Hypothesis, kind.name, searched=searched, turns=turns, strokes=strokes,
                          part=names[0] if kind.one_by_one else "",
                          leans=leans)

        def add(on: tuple[str, ...], columns: tuple[int, ...], constants: dict[str, float]) -> None:
            self.hypotheses.append(of_kind(on, True, names, low, high, columns, usual, constants))

        if not kind.per_actuator:
            add((), self._columns(kind, on, values, specs), shown)
            return
        own: dict[int, tuple[int, ...]] = {}
        for a in np.flatnonzero(on):
            ends = self._ends(strokes, int(a))
            own[int(a)] = self._columns(kind, np.arange(on.size) == a, values | ends, specs)
            add((self.actuators[a],), own[int(a)], shown | ends)
        same = len(set(self.turning[on].tolist())) == 1
        if len(own) > 1 and same:
            where = self._columns(kind, on, values, specs) if strokes else tuple(
                self.add(np.sum([self.columns[c] for c in cs], axis=0))
                for cs in zip(*own.values(), strict=True))
            on_names = tuple(self.actuators[a] for a in own)
            add(on_names, where, shown)
            self.hypotheses.append(of_kind(
                on_names, False,
                tuple(f"{self.actuators[a]}:{n}" for a in own for n in names), low * len(own),
                high * len(own), tuple(c for cs in own.values() for c in cs), usual * len(own),
                shown))

    def _columns(self, kind: EffectKind, on: Bools, values: dict[str, float],
                 specs: Sequence[EffectParameter]) -> tuple[int, ...]:
        """Add one column for each parameter of an effect; return where they are."""
        terms = [kind.evaluate(p.setting, on, values).by if kind.carried is None
                 else carried_by(kind, p.response.closure.model, p.setting, self._borne(on))
                 for p in self.system.parts]
        return tuple(self.add(_sign(s) * self.system.column([by[s.name] for by in terms]))
                     for s in specs)

    def _borne(self, on: Bools) -> Callable[[Setting], Shift] | None:
        """Return what gives way to the load, at a coefficient of 1; None: the model's effects."""
        kind = self.bearing
        if self.bears or kind is None:
            return None
        values = start_values(kind, self.motion)
        return lambda at: kind.evaluate(at, on, values).shift

    def _varies(self, spec: EffectParameter) -> bool:
        """Whether the wrench component on which a parameter acts is ever applied."""
        if not spec.component:
            return True
        at = WRENCH.index(spec.component)
        return any(np.nanmax(np.abs(p.setting.wrench[:, at]), initial=0.0) > 0.0
                   for p in self.system.parts)

    def _recorded(self, kind: EffectKind, usable: Bools) -> tuple[Bools, tuple[str, ...]]:
        """Return the actuators whose columns are there in every part, and missing columns."""
        on = usable.copy()
        missing: list[str] = []
        for part in self.system.parts:
            for a in np.flatnonzero(usable):
                gone = lacking(kind.needs, (self.actuators[a],), (int(a),), part.response.rows)
                if gone:
                    on[a] = False
                    missing += gone
        for a in np.flatnonzero(on):
            gone = self._constant(kind, int(a))
            if gone:
                on[a] = False
                missing += gone
        return on, tuple(dict.fromkeys(missing))

    def _constant(self, kind: EffectKind, a: int) -> list[str]:
        """Return needed columns that never change, or a load that is never there.

        What they cause is a constant, which geometry has too.
        """
        rows = [p.response.rows for p in self.system.parts]
        out = []
        for need in kind.needs:
            if need in ("dir", "vel"):
                values = [(r.approach if need == "dir" else r.velocity)[:, [a]] for r in rows]
                name = f"{need}_{self.actuators[a]}"
            elif need in ("load", "wrench"):
                if not any(np.any(np.nan_to_num(r.wrench)) for r in rows):
                    out.append("payload")
                continue
            else:
                values = [getattr(r, need)[:, None] for r in rows]
                name = need
            column = np.concatenate(values)
            if not np.nanmax(column) - np.nanmin(column) > 1e-9 * np.nanmax(np.abs(column)):
                out.append(name)
        return out

    def _free_already(self, kind: EffectKind) -> Bools:
        """Return the actuators where something free is the same as the kind (k,)."""
        out = np.zeros(self.turning.size, dtype=bool)
        problem = self.system.problem
        for limb in limbs_with_free(problem.mechanism, kind.same_as, problem.free):
            out[limb.actuator] = True
        return out

    def _grids(self, kind: EffectKind, part: str) -> list[dict[str, float]]:
        """Return the values of a kind's nonlinear parameters that are tried, fitted ones first.

        What is extra is tried one at a time, after the kind without. ``part``: of the machine,
        whose joints are apart as far as a scan may know.
        """
        specs = kind.parameters(self.motion)
        scans = {s.name: s.scan for s in specs if s.scan is not None}
        tried = {n: scan(self._range(part)) for n, scan in scans.items()}
        extras = [s.name for s in specs if s.extra]
        own = {n: v for n, v in tried.items() if n not in extras}
        grid = self._combined(kind, own)
        for name in extras:
            grid += [c for c in self._combined(kind, {**own, name: tried[name]}) if c[name] != 0.0]
        known = np.isfinite(self.system.parts[0].setting.stroke).all()
        ends = {} if known else self._ends(kind.stroke_ends(self.motion))
        spread = [s for s in specs if s.of_stroke or s.per_stroke]
        return [constants | ends if any(not s.extra or s.name in constants for s in spread)
                else constants for constants in grid]

    def _combined(self, kind: EffectKind, tried: Mapping[str, Sequence[float]]
                  ) -> list[dict[str, float]]:
        grid = [dict(zip(tried, map(float, values), strict=True))
                for values in product(*tried.values())]
        return self._fitted(kind, tried) + grid if tried else grid

    def _range(self, part: str) -> ScanRange:
        """Return what a scan may know of these rows, and of the joints of base or platform."""
        points = self.system.parts[0].setting.points(part if part == "platform" else "base")[0]
        apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
        size = float(apart.max())
        near = float(np.min(apart + np.where(np.eye(len(points)), np.inf, 0.0)))
        return replace(self._rows, size=size, near=min(near, size))

    @cached_property
    def _rows(self) -> ScanRange:
        rows = np.unique(np.concatenate([p.response.rows.row for p in self.system.parts]))
        loads = [p.setting.load for p in self.system.parts]
        load = max(float(np.max(np.abs(f[np.isfinite(f)]), initial=0.0)) for f in loads)
        return ScanRange(self._stroke(), np.unique(self.system.group).size,
                         tuple(rows.tolist()), load)

    def _fitted(self, kind: EffectKind, names: Iterable[str]) -> list[dict[str, float]]:
        """Return what the fit has made of a kind's nonlinear parameters already."""
        g = self.system.state.g
        return [{n: float(g[e.parameters[n]]) for n in names}
                for e in self.system.problem.mechanism.effects if e.kind.name == kind.name]

    def _ends(self, names: Sequence[str], actuator: int | None = None) -> dict[str, float]:
        """Return the stroke of one joint, or the range of all: limits, else as measured.

        ``names``: of the constants that are its low and its high end; none: nothing.
        """
        if not names:
            return {}
        travel = np.concatenate([p.setting.travel for p in self.system.parts])
        limits = self.system.parts[0].setting.stroke
        some = slice(None) if actuator is None else [actuator]
        ends = limits[some] if np.isfinite(limits[some]).all() else np.stack(
            [travel.min(axis=0), travel.max(axis=0)], axis=-1)[some]
        return dict(zip(names, (float(ends[:, 0].min()), float(ends[:, 1].max())), strict=True))

    def _stroke(self) -> float:
        return self.system.stroke or 1.0


def library(system: System, kinds: Sequence[str] | None = None, tried: Sequence[int] = ()
            ) -> Library:
    """Return every hypothesis that these data could test.

    ``kinds``: only these; ``tried``: parameters that the fit frees only under test.
    """
    maker = _Kinds(system, tried)
    for name, kind in effect_kinds().items():
        if kinds is None or name in kinds:
            maker.kind(kind)
    if kinds is None or GEOMETRY in kinds:
        frozen_slots(maker, tried)
    if kinds is None:
        shapes(maker)
        unrecorded_load(maker)
    return maker.library()
