"""The machine of an identification as drawings: nominal and identified, over each other at home."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ppmcal.io import read_mechanism
from ppmcal.io.results.scene import Scene, SceneFrame, SceneMachine
from ppmcal.linalg import Array
from ppmcal.plotting.canvas import WIDTH, Drawing
from ppmcal.plotting.layers import Layer, Marks, Polyline
from ppmcal.plotting.plot import BOTTOM, LEFT, RIGHT, TOP, Axis, Plot, span
from ppmcal.report.format import with_label
from ppmcal.report.machine_section import machine_file
from ppmcal.report.records import Identified
from ppmcal.wording import number

VIEWS = ((0, 2, "from the front"), (0, 1, "from above"))
"""Axes to the right and up of the sides that a spatial machine is seen from."""
LEAST, MOST = 100.0, 330.0
"""Height of a view, points."""
GAP = np.full((1, 3), np.nan)


def machine_drawings(one: Identified) -> list[Drawing]:
    """Return the machine in its plane or from two sides, nothing where the folder holds none."""
    path = machine_file(one)
    if path is None:
        return []
    scene = Scene.of(read_mechanism(path), present="identified")
    return [_view(scene, a, b, side) for a, b, side in
            (((0, 1, ""),) if scene.flat else VIEWS)]


def _view(scene: Scene, a: int, b: int, side: str) -> Drawing:
    """Return the machine at home, seen along one axis."""
    lines, joints = zip(*_placed(scene), strict=True)
    several, layers = len(scene.machines) > 1, list[Layer]()
    for n, (machine, parts, at) in enumerate(zip(scene.machines, lines, joints, strict=True)):
        kind = ("before", "after")[n] if several else "ink"
        base, platform, links = parts
        layers += [Polyline(base[:, a], base[:, b], "", kind, 0.8, True),
                   Polyline(links[:, a], links[:, b], machine.name if several else "", kind),
                   Polyline(platform[:, a], platform[:, b], "", kind, 2.2),
                   Marks(at[:, a], at[:, b], kind, "o", 3.0)]
    every = np.concatenate([*joints, *(p for parts in lines for p in parts)])
    x, y, height = _square(every[:, a], every[:, b])
    names = [with_label("xyz"[i], scene.units.length) for i in (a, b)]
    unit, seen = scene.units.length, f", {side}" if side else ""
    drawn = (f" Nominal and identified at the same joint values, their differences drawn "
             f"{number(scene.magnification, 6)} times as large." if several else "")
    return Plot(x, y, (names[0], names[1]), layers, (unit, unit), height=TOP + height + BOTTOM,
                equal=True).drawing(
        f"The machine at home{seen}",
        f"Circles: joints; thick lines: platform; dashed: base.{drawn}",
        f"{len(scene.machines[0].limbs)} limbs of {scene.name} to scale.")


def _placed(scene: Scene) -> Iterator[tuple[tuple[Array, Array, Array], Array]]:
    """Yield lines (base, platform, links) and joints of each machine, (N, 3) each, file units.

    Differences from the first machine are magnified.
    """
    first = _points(scene.machines[0])
    for machine in scene.machines:
        base, platform, links, joints = (
            p + (scene.magnification - 1.0) * (p - p0) if p.shape == p0.shape else p
            for p, p0 in zip(_points(machine), first, strict=True))
        yield (base, platform, links), joints


def _points(machine: SceneMachine) -> tuple[Array, Array, Array, Array]:
    """Return base, platform, links and joints of a machine at home, (N, 3) each."""
    frame = machine.frames[0]
    links = [p for limb in frame.limbs for link in limb.links for p in (*link, GAP[0])]
    joints = [p for limb in frame.limbs for p in limb.joints]
    return (_outline(frame, "base", machine.base_outline),
            _outline(frame, "platform", machine.platform_outline),
            np.array(links, dtype=float).reshape(-1, 3),
            np.array(joints, dtype=float).reshape(-1, 3))


def _outline(frame: SceneFrame, side: str, order: tuple[int, ...]) -> Array:
    """Return the points of one side as a closed line (N + 1, 3)."""
    points = np.array([getattr(frame.limbs[i], side) for i in order], dtype=float).reshape(-1, 3)
    return np.concatenate([points, points[:1]])


def _square(x: Array, y: Array) -> tuple[Axis, Axis, float]:
    """Return axes with equal scales that hold the points, and the height of the plot."""
    wide, across, up = WIDTH - LEFT - RIGHT, span(x), span(y)
    own = wide * (up.high - up.low) / (across.high - across.low)
    height = float(np.clip(own, LEAST, MOST))
    return (_wider(across, max(own / height, 1.0)), _wider(up, max(height / own, 1.0)), height)


def _wider(axis: Axis, times: float) -> Axis:
    middle, half = 0.5 * (axis.low + axis.high), 0.5 * times * (axis.high - axis.low)
    return Axis(middle - half, middle + half)
