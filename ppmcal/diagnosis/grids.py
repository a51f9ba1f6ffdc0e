"""The search grid: the constants of each kind that are tried, and the ranges of coefficients."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import product

import numpy as np

from ppmcal.diagnosis.linear_system import System
from ppmcal.diagnosis.scan_range import scan_range
from ppmcal.kinematics.needed_columns import lacking
from ppmcal.model.effects import EffectKind, EffectParameter, ScanRange
from ppmcal.model.motions import Motion

NEAR = 4.0
"""A size that an effect nearly scales with may be this many times that of its column, + or -."""


class Grids:
    """The constants to try for each kind, in the rows of one system; ``stroke``: the longest."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.mechanism = system.problem.mechanism
        self.stroke = system.stroke or 1.0

    def of(self, kind: EffectKind, part: str) -> list[dict[str, float]]:
        """Return the values to try for a kind's nonlinear parameters, fitted ones first.

        Optional parameters are tried one at a time, after the kind without them. ``part``: of the
        machine, whose joint spacing a scan may use.
        """
        specs = kind.parameters(self.mechanism.motion)
        data = self._range(part)
        tried = {s.name: _meeting(s.scan(data)) if s.scaling else s.scan(data)
                 for s in specs if s.scan is not None}
        optional = [s for s in specs if s.optional]
        own = {n: v for n, v in tried.items() if n not in [s.name for s in optional]}
        grid = self._combined(kind, own)
        for s in optional:
            if not self._lacks(s):
                grid += [c for c in self._combined(kind, {**own, s.name: tried[s.name]})
                         if c[s.name] != s.default]
        known = np.isfinite(self.system.parts[0].setting.stroke).all()
        ends = {} if known else self.ends(kind.stroke_ends(self.mechanism.motion))
        spread = [s for s in specs if s.of_stroke or s.per_stroke]
        # an optional parameter that is absent is not spread over the stroke
        return [c if spread and all(s.optional and s.name not in c for s in spread) else c | ends
                for c in grid]

    def ends(self, names: Sequence[str], actuator: int | None = None) -> dict[str, float]:
        """Return the stroke of one joint, or the range of all: the limits, otherwise as measured.

        ``names``: of the constants for its low and its high end; if empty, so is the result.
        """
        if not names:
            return {}
        travel = np.concatenate([p.setting.travel for p in self.system.parts])
        limits = self.system.parts[0].setting.stroke
        some = slice(None) if actuator is None else [actuator]
        ends = limits[some] if np.isfinite(limits[some]).all() else np.stack(
            [travel.min(axis=0), travel.max(axis=0)], axis=-1)[some]
        return dict(zip(names, (float(ends[:, 0].min()), float(ends[:, 1].max())), strict=True))

    def _combined(self, kind: EffectKind, tried: Mapping[str, Sequence[float]]
                  ) -> list[dict[str, float]]:
        grid = [dict(zip(tried, map(float, values), strict=True))
                for values in product(*tried.values())]
        return self._fitted(kind, tried) + grid if tried else grid

    def _fitted(self, kind: EffectKind, names: Iterable[str]) -> list[dict[str, float]]:
        """Return values already fitted for a kind's nonlinear parameters.

        Also those of another kind with the same parameters, so that being fitted is no advantage.
        """
        g, motion = self.system.state.g, self.mechanism.motion
        own = {s.name: s.scan for s in kind.parameters(motion)}
        scans = {n: own[n] for n in names}
        found = []
        for e in self.mechanism.effects:
            theirs = {s.name: s.scan for s in e.kind.parameters(motion)}
            if all(theirs.get(n) is scan for n, scan in scans.items()):
                found.append({n: float(g[e.parameters[n]]) for n in scans})
        return [f for n, f in enumerate(found) if f not in found[:n]]

    def _range(self, part: str) -> ScanRange:
        """Return the data that a scan may use: on these rows, and on base or platform joints."""
        points = self.system.parts[0].setting.points(part if part == "platform" else "base")[0]
        apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
        size = float(apart.max())
        near = float(np.min(apart + np.where(np.eye(len(points)), np.inf, 0.0)))
        return replace(self._rows, size=size, near=min(near, size))

    @cached_property
    def _rows(self) -> ScanRange:
        return scan_range(self.system)

    def _lacks(self, spec: EffectParameter) -> bool:
        """Whether a column that only this parameter needs is missing."""
        names = self.mechanism.actuators
        return any(lacking(spec.needs, names, range(len(names)), p.response.rows)
                   for p in self.system.parts)


def _meeting(sizes: Sequence[float]) -> list[float]:
    """Return sizes, with more inserted wherever ranges do not meet."""
    out = list[float]()
    for size in sorted(sizes):
        if out and size > NEAR**2 * out[-1]:
            steps = int(np.ceil(np.log(size / out[-1]) / np.log(NEAR**2)))
            out += np.geomspace(out[-1], size, steps + 1)[1:-1].tolist()
        out.append(size)
    return out


def start_values(kind: EffectKind, motion: Motion) -> dict[str, float]:
    """Return the point at which a kind is linearised: 0, or 1 for reciprocal parameters."""
    return {s.name: 1.0 if s.reciprocal else s.default if s.constant and s.default is not None
            else 0.0 for s in kind.parameters(motion)}


def usual_range(spec: EffectParameter, stroke: float) -> tuple[float, float]:
    """Return the usual range of a coefficient in machines, SI; ``stroke``: the longest."""
    low, high = spec.usual
    if spec.reciprocal:
        return 1.0 / high, 1.0 / low if low > 0.0 else np.inf
    scale = spec.usual_scale(stroke)
    return scale * low, scale * high


def sign(spec: EffectParameter) -> float:
    """Return the sign of d/d(1/k) relative to d/dk at k = 1, for effects linear in 1/k."""
    return -1.0 if spec.reciprocal else 1.0


def lowest(spec: EffectParameter) -> float:
    """Return the smallest coefficient that a parameter may have, SI."""
    return 0.0 if spec.reciprocal else spec.low
