"""Where a search looks: the constants of a kind that it tries, and the ranges of coefficients."""

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
"""A size by which an effect nearly scales may be so many times that of its column, + or -."""


class Grids:
    """The constants to try of every kind, for the rows of one system; ``stroke``: the longest."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.mechanism = system.problem.mechanism
        self.stroke = system.stroke or 1.0

    def of(self, kind: EffectKind, part: str) -> list[dict[str, float]]:
        """Return the values of a kind's nonlinear parameters that are tried, fitted ones first.

        What is optional is tried one at a time, after the kind without. ``part``: of the machine,
        whose joints are apart as far as a scan may know.
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
        # of what is optional and not there nothing is spread over the stroke
        return [c if spread and all(s.optional and s.name not in c for s in spread) else c | ends
                for c in grid]

    def ends(self, names: Sequence[str], actuator: int | None = None) -> dict[str, float]:
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

    def _combined(self, kind: EffectKind, tried: Mapping[str, Sequence[float]]
                  ) -> list[dict[str, float]]:
        grid = [dict(zip(tried, map(float, values), strict=True))
                for values in product(*tried.values())]
        return self._fitted(kind, tried) + grid if tried else grid

    def _fitted(self, kind: EffectKind, names: Iterable[str]) -> list[dict[str, float]]:
        """Return what the fit has made of a kind's nonlinear parameters already.

        Or of the same parameters of another kind, lest it be better only for having been fitted.
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
        """Return what a scan may know of these rows, and of the joints of base or platform."""
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
    """Return sizes, with others between those whose ranges do not meet."""
    out = list[float]()
    for size in sorted(sizes):
        if out and size > NEAR**2 * out[-1]:
            steps = int(np.ceil(np.log(size / out[-1]) / np.log(NEAR**2)))
            out += np.geomspace(out[-1], size, steps + 1)[1:-1].tolist()
        out.append(size)
    return out


def start_values(kind: EffectKind, motion: Motion) -> dict[str, float]:
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


def sign(spec: EffectParameter) -> float:
    """Return the sign of d/d(1/k) at k = 1 against d/dk, for what is linear in 1/k."""
    return -1.0 if spec.reciprocal else 1.0


def lowest(spec: EffectParameter) -> float:
    """Return the smallest coefficient that a parameter may have, SI."""
    return 0.0 if spec.reciprocal else spec.low
