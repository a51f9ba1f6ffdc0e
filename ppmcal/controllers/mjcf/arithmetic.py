"""What MuJoCo makes of a model: where bodies are, and where joints must be so that loops close.

Of MJCF this knows what :mod:`ppmcal.controllers.mjcf.writer` writes: bodies with at most three
joints (slides before a hinge or ball, anchored at the body's origin), sites, ``connect`` between
sites, ``joint`` constraints of degree one, tendons from site to site, and one actuator per drive.
Loops are closed by Newton steps of least length; actuated joints are where they are told to be.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ppmcal import algebra as cga
from ppmcal.errors import BadInput
from ppmcal.linalg import Array, pinv

STEPS = 40
LARGEST = 0.5
"""Largest turn (rad) or part of the machine's size by which a joint moves in one step."""
CLOSED = 1e-12
"""A loop is closed where the gap is less, as a part of the machine's size."""


@dataclass(frozen=True)
class Dof:
    """One joint: its body, type, axis (3,) in that body, zero as MuJoCo counts, first column."""

    name: str
    body: int
    kind: str
    axis: Array
    ref: float
    column: int

    @property
    def columns(self) -> slice:
        """Its columns of a Jacobian."""
        return slice(self.column, self.column + (3 if self.kind == "ball" else 1))


@dataclass
class Tree:
    """A model: bodies in the order of the file, the world first.

    Attributes:
        parents: of each body. frames: body to parent at home, rotation (3, 3) and position (3,).
        joints: by name, each body's in order; sites: name -> body and position (3,), m.
        loops: pairs of sites in one place; coupled: joint -> the joint it follows, and its slope.
        ropes: tendon -> its two sites.
        actuators: name -> its joint or tendon, its gear, and what is added to ``ctrl``.
    """

    parents: list[int] = field(default_factory=lambda: [-1])
    names: list[str] = field(default_factory=lambda: ["world"])
    frames: list[tuple[Array, Array]] = field(
        default_factory=lambda: [(np.eye(3), np.zeros(3))])
    joints: dict[str, Dof] = field(default_factory=dict)
    sites: dict[str, tuple[int, Array]] = field(default_factory=dict)
    loops: list[tuple[str, str]] = field(default_factory=list)
    coupled: dict[str, tuple[str, float]] = field(default_factory=dict)
    ropes: dict[str, tuple[str, str]] = field(default_factory=dict)
    actuators: dict[str, tuple[str, float, float]] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """Number of columns of a Jacobian."""
        return max((d.columns.stop for d in self.joints.values()), default=0)

    def of_body(self, body: int) -> list[Dof]:
        """Return a body's joints, in order."""
        return [d for d in self.joints.values() if d.body == body]

    def above(self, body: int) -> list[Dof]:
        """Return the joints that move a body."""
        out: list[Dof] = []
        while body > 0:
            out += self.of_body(body)
            body = self.parents[body]
        return out


TreeState = dict[str, Array]
"""N poses of a tree: slides and hinges from home (N,), balls as matrices (N, 3, 3), by name."""


def at_home(tree: Tree, rows: int) -> TreeState:
    """Return ``rows`` times the state of the file."""
    return {n: np.tile(np.eye(3), (rows, 1, 1)) if d.kind == "ball" else np.zeros(rows)
            for n, d in tree.joints.items()}


def _moved(tree: Tree, state: TreeState, by: Array) -> TreeState:
    """Return a state after a step (N, width)."""
    return {name: state[name] @ _rotation(by[:, dof.columns]) if dof.kind == "ball"
            else state[name] + by[:, dof.column] for name, dof in tree.joints.items()}


def _rotation(vector: Array) -> Array:
    return np.asarray(cga.rotation_matrix(cga.motor_from_rotation_vector(
        vector, np.zeros_like(vector))))


@dataclass(frozen=True, eq=False)
class PlacedTree:
    """Where bodies are: rotations (N, 3, 3) and positions (N, 3), and each joint's axes.

    ``axes``: joint -> its axes (N, 3, 1 or 3) and the point they go through (N, 3), base axes.
    """

    bodies: list[tuple[Array, Array]]
    axes: Mapping[str, tuple[Array, Array]]

    def site(self, tree: Tree, name: str) -> Array:
        """Return where a site is (N, 3), m."""
        body, own = tree.sites[name]
        turn, place = self.bodies[body]
        return np.asarray(turn @ own + place)


def placed(tree: Tree, state: TreeState) -> PlacedTree:
    """Return where everything is."""
    rows = len(next(iter(state.values()))) if state else 1
    bodies = [(np.tile(np.eye(3), (rows, 1, 1)), np.zeros((rows, 3)))]
    axes = {}
    for body in range(1, len(tree.parents)):
        turn, place = bodies[tree.parents[body]]
        own, at = tree.frames[body]
        turn, place = turn @ own, turn @ at + place
        for dof in tree.of_body(body):
            value = state[dof.name]
            if dof.kind == "ball":
                axes[dof.name] = turn, place
                turn = turn @ value
                continue
            axis = turn @ dof.axis
            axes[dof.name] = axis[..., None], place
            if dof.kind == "slide":
                place = place + value[:, None] * axis
            else:
                turn = turn @ _rotation(value[:, None] * dof.axis)
        bodies.append((turn, place))
    return PlacedTree(bodies, axes)


def _rates(tree: Tree, at: PlacedTree, state: TreeState, name: str) -> Array:
    """Return how a site moves with each joint (N, 3, width), base axes."""
    body, place = tree.sites[name][0], at.site(tree, name)
    out = np.zeros((len(place), 3, tree.width))
    for dof in tree.above(body):
        axes, through = at.axes[dof.name]
        if dof.kind == "slide":
            out[..., dof.columns] = axes
            continue
        if dof.kind == "ball":      # steps of a ball are turns in the axes that it carries
            axes = axes @ state[dof.name]
        out[..., dof.columns] = np.cross(axes, (place - through)[..., None], axis=1)
    return out


def _gaps(tree: Tree, state: TreeState, lengths: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return how far loops and ropes are from closing (N, m), m, and the Jacobian of that.

    Ropes without a length (N,), m, among ``lengths`` are left out.
    """
    at = placed(tree, state)
    gaps, rates = [], []
    for one, other in tree.loops:
        gaps.append(at.site(tree, one) - at.site(tree, other))
        rates.append(_rates(tree, at, state, one) - _rates(tree, at, state, other))
    for name, length in lengths.items():
        one, other = tree.ropes[name]
        away = at.site(tree, one) - at.site(tree, other)
        now = np.linalg.norm(away, axis=1)
        moving = _rates(tree, at, state, one) - _rates(tree, at, state, other)
        gaps.append((now - length)[:, None])
        rates.append((away / now[:, None])[:, None] @ moving)
    return np.concatenate(gaps, axis=1), np.concatenate(rates, axis=1)


def closed(tree: Tree, start: TreeState, size: float, held: Sequence[str] = (),
           lengths: Mapping[str, Array] | None = None) -> tuple[TreeState, Array]:
    """Return the state in which loops and ropes close, and the largest gap left (N,), m.

    Args:
        tree: the model.
        start: where steps begin, N poses.
        size: of the machine, m.
        held: joints that stay there.
        lengths: of ropes.
    """
    spread = _spread(tree, size, held)
    state = start
    for _ in range(STEPS):
        gap, rate = _gaps(tree, state, lengths or {})
        if np.abs(gap).max() < CLOSED * size:
            break
        step = -(pinv(rate @ spread, 1e-10) @ gap[..., None])[..., 0]
        far = np.abs(step).max(axis=1, initial=0.0)
        step *= np.minimum(1.0, LARGEST / np.maximum(far, 1e-300))[:, None]
        state = _moved(tree, state, step @ spread.T)
    return state, np.asarray(np.abs(_gaps(tree, state, lengths or {})[0]).max(axis=1))


def _spread(tree: Tree, size: float, held: Sequence[str]) -> Array:
    """Return how joints move with what is free to move (width, free), turns and parts of the size.

    What is ``held`` does not, and followers go with their leaders.
    """
    spread = np.eye(tree.width)
    for name, (leader, slope) in tree.coupled.items():
        own, first = tree.joints[name].column, tree.joints[leader].column
        spread[own, own], spread[own, first] = 0.0, slope
    for name in held:
        spread[:, tree.joints[name].columns] = 0.0
    lever = np.ones(tree.width)
    for dof in tree.joints.values():
        lever[dof.columns] = size if dof.kind == "slide" else 1.0
    spread = spread * lever
    return np.asarray(spread[:, np.any(spread != 0.0, axis=0)])


def driven(tree: Tree, start: TreeState, ctrl: Mapping[str, Array]
           ) -> tuple[TreeState, dict[str, Array]]:
    """Return a state with actuated joints where ``ctrl`` (N,) has them, and ropes' lengths, m."""
    values, lengths = dict(start), {}
    for name, (moves, gear, added) in tree.actuators.items():
        length = (ctrl[name] + added) / gear
        if moves in tree.ropes:
            lengths[moves] = length
        else:
            values[moves] = length - tree.joints[moves].ref
    for name, (leader, slope) in tree.coupled.items():
        values[name] = slope * values[leader]
    return values, lengths


def actuated(tree: Tree) -> list[str]:
    """Return the joints that actuators hold, and those that follow them."""
    own = [moves for moves, _, _ in tree.actuators.values() if moves in tree.joints]
    return own + [n for n, (leader, _) in tree.coupled.items() if leader in own]


# --- reading --------------------------------------------------------------------------------------


def read(text: str) -> Tree:
    """Return the model of a file.

    Raises:
        BadInput: it is no XML.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as exc:
        raise BadInput(f"no XML: {exc}", "", "Give a MuJoCo model") from exc
    tree = Tree()
    for element in root.iterfind("worldbody/*"):
        _read_into(tree, element, 0)
    for element in root.iterfind("equality/connect"):
        tree.loops.append((element.attrib["site1"], element.attrib["site2"]))
    for element in root.iterfind("equality/joint"):
        slope = _numbers(element.attrib["polycoef"])[1]
        tree.coupled[element.attrib["joint1"]] = element.attrib["joint2"], float(slope)
    for element in root.iterfind("tendon/spatial"):
        one, other = (site.attrib["site"] for site in element)
        tree.ropes[element.attrib["name"]] = one, other
    for element in root.iterfind("actuator/general"):
        gain = _numbers(element.attrib["gainprm"])[0]
        bias = _numbers(element.attrib["biasprm"])
        moves = element.attrib.get("joint") or element.attrib["tendon"]
        tree.actuators[element.attrib["name"]] = (
            moves, float(_numbers(element.attrib["gear"])[0]), float(bias[0] / gain))
    return tree


def _read_into(tree: Tree, element: ET.Element, parent: int) -> None:
    """Add what is in a body."""
    if element.tag == "site":
        tree.sites[element.attrib["name"]] = parent, _numbers(element.attrib["pos"])
    elif element.tag in ("joint", "freejoint"):
        kind = element.attrib.get("type", "free" if element.tag == "freejoint" else "hinge")
        own = tree.frames[parent][0]
        made = ([("slide", own.T @ axis) for axis in np.eye(3)] + [("ball", np.zeros(3))]
                if kind == "free" else [(kind, _numbers(element.attrib.get("axis", "0 0 1")))])
        for number, (each, axis) in enumerate(made):
            name = element.attrib["name"] + (f".{number}" if kind == "free" else "")
            tree.joints[name] = Dof(name, parent, each, axis,
                                    float(element.attrib.get("ref", "0")), tree.width)
    elif element.tag == "body":
        number = len(tree.parents)
        tree.parents.append(parent)
        tree.names.append(element.attrib["name"])
        turn = cga.rotation_matrix(cga.motor_from_quaternion(    # MJCF has the scalar first
            np.roll(_numbers(element.attrib.get("quat", "1 0 0 0")), -1), np.zeros(3)))
        tree.frames.append((np.asarray(turn), _numbers(element.attrib.get("pos", "0 0 0"))))
        for inside in element:
            _read_into(tree, inside, number)


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])
