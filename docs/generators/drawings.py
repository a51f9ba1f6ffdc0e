"""Drawings for the guides, computed from machines that ppmcal ships: the same every time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from generators.kinds import anchor_of, example_limb
from generators.paths import ROOT
from ppmcal import algebra as cga
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.rotations import from_euler
from ppmcal.kinematics.skeleton import LimbSkeleton, skeleton
from ppmcal.linalg import Array
from ppmcal.model.limbs import LimbKind, kinds
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import PLANAR, SPATIAL, Motion

INK, SOFT, BLUE, RED, GREEN = "#1f2933", "#9aa5b1", "#1f6feb", "#c2410c", "#15803d"
AXIS_COLOURS = (RED, GREEN, BLUE)
GROWTH = 0.12
"""By which part of the reach, or by how many rad, a joint grows in a drawing."""
VIEW = np.array([[0.87, 0.5, 0.0], [-0.22, 0.38, 0.9]])
"""Rows: right and up of the picture, in base axes."""


def drawings(folder: Path) -> None:
    """Write all drawings as SVG into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context({"svg.hashsalt": "ppmcal", "svg.fonttype": "path", "font.size": 9.0,
                         "font.family": "DejaVu Sans"}):
        for name, figure in figures():
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight",
                           pad_inches=0.1, facecolor="white")
            plt.close(figure)


def figures() -> Iterator[tuple[str, Figure]]:
    """Yield the name of each drawing and the drawing."""
    yield "frames", _frames()
    yield "rotations", _rotations()
    yield "joint", _joint()
    for name in ("3-RPR", "6-UPS", "delta-linear"):
        yield f"machine-{name}", _machine(_shipped(name))
    for kind in kinds().values():
        yield anchor_of(kind), _limb(kind)



def _shipped(name: str) -> Mechanism:
    return read_mechanism(ROOT / "configs" / f"{name}.yaml")


def _empty(width: float, height: float, columns: int = 1) -> tuple[Figure, list[Axes]]:
    figure, axes = plt.subplots(1, columns, figsize=(width, height), squeeze=False)
    for one in axes[0]:
        one.set_aspect("equal")
        one.axis("off")
    return figure, list(axes[0])


def _flat(points: Array, motion: Motion, side: bool = False) -> Array:
    """Return points (..., 3) as the picture has them (..., 2)."""
    if motion.planar:
        return points[..., :2]
    return points @ (np.array([[1.0, 0, 0], [0, 0, 1.0]]) if side else VIEW).T


def _arrow(axes: Axes, start: Array, end: Array, colour: str, text: str = "", style: str = "-|>",
           away: tuple[float, float] = (4, 4), width: float = 1.4) -> None:
    axes.annotate("", xy=tuple(end), xytext=tuple(start),
                  arrowprops={"arrowstyle": style, "color": colour, "lw": width,
                              "shrinkA": 0, "shrinkB": 0})
    axes.plot(*np.transpose([start, end]), lw=0)    # arrows alone set no limits
    if text:
        _label(axes, (np.asarray(start) + np.asarray(end)) / 2 if style == "<|-|>" else end,
               text, colour, away)


def _label(axes: Axes, place: Array, text: str, colour: str = INK,
           away: tuple[float, float] = (4, 4)) -> None:
    axes.annotate(text, tuple(place), xytext=away, textcoords="offset points", color=colour)


def _triad(axes: Axes, origin: Array, turn: Array, size: float, motion: Motion, name: str,
           away: tuple[float, float] = (-12, -12)) -> None:
    for c in range(2 if motion.planar else 3):
        _arrow(axes, _flat(origin, motion), _flat(origin + size * turn[:, c], motion),
               AXIS_COLOURS[c], "xyz"[c])
    _label(axes, _flat(origin, motion), name, INK, away)


def _limb_lines(axes: Axes, limb: LimbSkeleton, motion: Motion, colour: str, width: float = 2.0,
                n: int = 0) -> None:
    line = _flat(limb.polyline[n], motion)
    axes.plot(*line.T, color=colour, lw=width, solid_capstyle="round", zorder=2)
    for joint in limb.joints:
        at = _flat(joint.centre[n], motion)
        axes.plot(*at, "o", ms=6.5, mfc="white" if not joint.driven else colour, mec=colour,
                  mew=1.4, zorder=3)


def _outline(axes: Axes, points: Array, motion: Motion, colour: str, fill: str) -> None:
    flat = _flat(points, motion)
    middle = flat.mean(axis=0)
    order = np.argsort(np.arctan2(*(flat - middle).T[::-1]))
    axes.fill(*flat[order].T, fc=fill, ec=colour, lw=1.0, zorder=1, alpha=0.7)


def _grown(model: Model, index: int, step: float) -> tuple[Array, Array]:
    """Return poses (2, 8) and joint values (2, k): home, and a limb's joint grown by a step.

    The step, m or rad, is halved until the machine reaches it.
    """
    machine = model.mechanism
    home = home_state(machine).q
    ratio = (model.joint_coordinate(index, home[None] + 1.0)
             - model.joint_coordinate(index, home[None]))[0]
    for part in 0.5 ** np.arange(6):
        q = np.stack([home, home])
        q[1, machine.limbs[index].actuator] += part * step / ratio
        found = forward(model, q)
        if found.converged.all():
            return np.stack([machine.home, found.pose[1]]), q
    raise ValueError(f"{machine.name}: {machine.limbs[index].name} cannot be drawn")


def _limb(kind: LimbKind) -> Figure:
    """Draw one limb of a shipped machine, and where it goes when its joint grows."""
    machine = _shipped(example_limb(kind)[0].removesuffix(".yaml"))
    model = Model(machine)
    index = next(i for i, limb in enumerate(machine.limbs) if limb.kind.name == kind.name)
    # a passive limb is moved by another's drive
    moving = index if kind.driven else machine.driven[0]
    pose, q = _grown(model, moving, GROWTH * machine.reach
                     if machine.limbs[moving].kind.actuator == "length" else 2.0 * GROWTH)
    limb = skeleton(model, pose, q)[index]
    motion = machine.motion
    figure, (axes,) = _empty(4.6, 3.2)
    _limb_lines(axes, limb, motion, SOFT, 1.6, 1)
    _limb_lines(axes, limb, motion, INK)
    size = 0.14 * machine.reach
    _triad(axes, np.zeros(3) if motion.planar else limb.base_point[0], np.eye(3), size,
           motion, "base" if motion.planar else "")
    _label(axes, _flat(limb.base_point[0], motion), "A", INK, (7, -12))
    before, after = (_flat(limb.platform_point[n], motion) for n in (0, 1))
    way = (after - before) / np.linalg.norm(after - before)
    _label(axes, before, "B", INK, (-14 * way[0] - 4, -14 * way[1] - 4))
    if kind.driven:
        # a rope has no joint that is driven: its length is
        driven = next((j.centre for j in limb.joints if j.driven),
                      0.5 * (limb.base_point + limb.platform_point))
        _label(axes, _flat(driven[0], motion), "u", RED, (-14, 6))
    _arrow(axes, before, after, RED)
    axes.annotate("u grows" if kind.driven else "another's u grows", tuple(after),
                  xytext=tuple(10 * way), textcoords="offset points",
                  color=RED, ha="left" if way[0] >= 0 else "right")
    axes.margins(0.14)
    return figure


def _machine(machine: Mechanism) -> Figure:
    """Draw a whole machine at home with its names."""
    model, motion = Model(machine), machine.motion
    limbs = skeleton(model, machine.home[None], home_state(machine).q[None])
    figure, (axes,) = _empty(6.2, 4.4)
    base = np.array([limb.base_point[0] for limb in limbs])
    platform = np.array([limb.platform_point[0] for limb in limbs])
    _outline(axes, base, motion, SOFT, "#f1f4f8")
    for limb in limbs:
        _limb_lines(axes, limb, motion, INK, 1.6)
    _outline(axes, platform, motion, BLUE, "#dbe9ff")
    for i in range(len(limbs)):
        _label(axes, _flat(base[i], motion), f"A{i + 1}", INK, (6, -11))
        _label(axes, _flat(platform[i], motion), f"B{i + 1}", BLUE, (6, 4))
        _label(axes, _flat((base[i] + platform[i]) / 2, motion), machine.limbs[i].name, SOFT)
    size = 0.16 * machine.reach
    _triad(axes, np.zeros(3), np.eye(3), size, motion, "base frame", (-16, -16))
    _triad(axes, cga.translation(machine.home), cga.rotation_matrix(machine.home), size, motion,
           "platform frame", (-36, -16))
    axes.margins(0.1)
    return figure


def _frames() -> Figure:
    """Draw the chain measured = frame after pose after target, on the planar machine."""
    machine = _shipped("3-RPR")
    model = Model(machine)
    limbs = skeleton(model, machine.home[None], home_state(machine).q[None])
    reach = machine.reach
    figure, (axes,) = _empty(6.6, 4.6)
    _outline(axes, np.array([limb.platform_point[0] for limb in limbs]), PLANAR, BLUE, "#dbe9ff")
    for limb in limbs:
        _limb_lines(axes, limb, PLANAR, SOFT, 1.4)
    frame = cga.motor_from_rotation_vector(np.array([0, 0, 0.35]),
                                           np.array([-0.45, -0.12, 0.0]) * reach)
    origin, centre = cga.translation(frame), cga.translation(machine.home)
    turn = cga.rotation_matrix(machine.home)
    point = centre + turn @ (np.array([0.3, 0.12, 0.0]) * reach)
    _triad(axes, origin, cga.rotation_matrix(frame), 0.13 * reach, PLANAR,
           "measuring frame\n(of the instrument)", (-30, -30))
    _triad(axes, np.zeros(3), np.eye(3), 0.13 * reach, PLANAR, "base frame", (2, -16))
    _triad(axes, centre, turn, 0.13 * reach, PLANAR, "platform frame", (2, -18))
    axes.plot(*point[:2], "*", ms=13, color=RED, zorder=4)
    _label(axes, point[:2], "target: the measured point", RED, (9, 2))
    for start, end, text, away in ((origin, np.zeros(3), "frame", (-10, 8)),
                                   (np.zeros(3), centre, "pose", (-26, 8)),
                                   (centre, point, "target", (-8, 9))):
        axes.annotate("", xy=tuple(end[:2]), xytext=tuple(start[:2]), arrowprops={
            "arrowstyle": "-|>", "color": INK, "lw": 1.6, "linestyle": "--", "shrinkA": 3,
            "shrinkB": 5})
        _label(axes, (start + end)[:2] / 2, text, INK, away)
    axes.annotate("", xy=tuple(point[:2]), xytext=tuple(origin[:2]), arrowprops={
        "arrowstyle": "-|>", "color": RED, "lw": 1.2, "connectionstyle": "arc3,rad=-0.38",
        "shrinkA": 4, "shrinkB": 8})
    _label(axes, (origin + point)[:2] / 2 + np.array([-0.18, 0.3]) * reach, "measured: x, y, rz",
           RED)
    axes.margins(0.12)
    return figure


def _turned(axes: Axes, turns: list[Array], title: str) -> None:
    """Draw a triad before and after turns, later ones darker."""
    shades = np.linspace(0.25, 1.0, len(turns))
    for turn, shade in zip(turns, shades, strict=True):
        for c in range(3):
            end = _flat(turn[:, c], SPATIAL)
            axes.annotate("", xy=tuple(end), xytext=(0, 0), arrowprops={
                "arrowstyle": "-|>", "color": AXIS_COLOURS[c], "alpha": float(shade), "lw": 1.5,
                "shrinkA": 0, "shrinkB": 0})
            if turn is turns[-1]:
                _label(axes, end, "xyz"[c], AXIS_COLOURS[c], (3, 2))
    axes.set(xlim=(-1.0, 1.25), ylim=(-0.75, 1.2))
    axes.set_title(title, fontsize=9)


def _rotations() -> Figure:
    """Draw a rotation vector, and the same three angles about fixed and about moving axes."""
    figure, axes = _empty(8.8, 3.3, 3)
    angles = np.radians([30.0, 20.0, 40.0])

    def matrix(vector: Array) -> Array:
        return cga.rotation_matrix(cga.motor_from_rotation_vector(vector, np.zeros(3)))

    vector = from_euler(angles[None], "euler-xyz")[0]
    size = float(np.linalg.norm(vector))
    _turned(axes[0], [np.eye(3), matrix(vector)],
            "rotation vector\n[" + ", ".join(f"{v:.1f}" for v in np.degrees(vector)) + "] deg")
    _arrow(axes[0], np.zeros(2), _flat(1.25 * vector / size, SPATIAL), INK,
           f"{np.degrees(size):.1f}° about this axis", away=(-90, 8))
    for one, convention, words in ((axes[1], "euler-xyz", "fixed axes: x, then y, then z"),
                                   (axes[2], "euler-XYZ", "moving axes: x, new y, new z")):
        steps = [from_euler((angles * np.array(on))[None], convention)[0]
                 for on in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1))]
        _turned(one, [matrix(s) for s in steps], f"{convention} 30, 20, 40 deg\n{words}")
    return figure


def _joint() -> Figure:
    """Draw what joint value, ratio and offset are, and the two directions of approach."""
    figure, (axes,) = _empty(7.0, 2.2)
    axes.plot([0, 10], [0, 0], color=SOFT, lw=6, solid_capstyle="round")
    axes.plot([0], [0], "o", ms=9, mfc="white", mec=INK, mew=1.5)
    _label(axes, np.array([0, 0]), "joint of the base", INK, (-8, -20))
    axes.plot([6.5], [0], "s", ms=14, color=INK)
    _arrow(axes, np.array([0, 1.5]), np.array([1.6, 1.5]), BLUE, "offset", "<|-|>", (-14, 5))
    _arrow(axes, np.array([1.6, 1.5]), np.array([6.5, 1.5]), GREEN, "ratio q", "<|-|>", (-16, 5))
    _arrow(axes, np.array([0, -1.4]), np.array([6.5, -1.4]), INK, "u = ratio q + offset", "<|-|>",
           (-40, -13))
    for x in (1.6, 6.5):
        axes.plot([x, x], [-1.6, 1.9], ":", color=SOFT, lw=1)
    _label(axes, np.array([1.6, 0]), "q = 0", SOFT, (3, -14))
    _arrow(axes, np.array([5.0, 0.55]), np.array([6.1, 0.55]), RED, "dir = +1", away=(-58, -3))
    _arrow(axes, np.array([8.0, 0.55]), np.array([6.9, 0.55]), RED, "dir = −1", away=(30, -3))
    axes.margins(0.05)
    return figure
