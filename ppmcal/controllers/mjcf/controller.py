"""``export mjcf``: a machine as bodies, joints and closed loops of MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.export import (
    Exported,
    NotExpressed,
    Number,
    effect_lacking,
    refuse,
    remarks,
)
from ppmcal.controllers.mjcf.arithmetic import (
    Tree,
    TreeState,
    actuated,
    at_home,
    closed,
    driven,
    placed,
    read,
)
from ppmcal.controllers.mjcf.writer import PLATFORM, SITE, Home, limb_parts, text
from ppmcal.controllers.pose_errors import ErrorSummary, pose_errors, takes_none, within_limits
from ppmcal.controllers.pose_grid import at_rest, default_grid, instrument_notes
from ppmcal.errors import NoResult
from ppmcal.io import read_poses
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

FILE = "machine.xml"
MOST = 100
"""Poses of the grid at which the model is driven."""
WAY = (0.25, 0.5, 0.75, 1.0)
"""Parts of the way from home at which its loops are closed again."""
STARTS, SEED = 64, 1
ADVICE = Note(
    "The site `platform` is the platform's frame. Start with "
    "`mj_resetDataKeyframe(model, data, 0)`: there `ctrl` is that of home. Loops close at sites, "
    "which old versions of MuJoCo do not know.", NOTE)
ALIKE = 1e-9
"""The model is the machine where poses differ by less, as a part of its reach, or rad."""


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return the machine as a MuJoCo model; see :class:`ppmcal.controllers.export.Exporter`."""
    refuse(old, "--old", "a model of bodies is compared with the nominal geometry, not with "
           "another model")
    bare = replace(mechanism, effects=())
    if poses is None:
        wanted = default_grid(mechanism).poses(mechanism)
        wanted = wanted[:: 1 + len(wanted) // MOST]
    else:
        wanted = read_poses(poses, mechanism).poses
    platform, home = bodies_at_home(bare)
    driven_to = _way(bare, wanted)
    if not len(driven_to.q[-1]):
        raise takes_none(mechanism)
    lacks = tuple(_not_expressed(mechanism, driven_to))
    notes = (*_notes(mechanism), *instrument_notes(mechanism))
    content = text(bare, platform, home, "\n".join([
        f"{mechanism.name}, from ppmcal: lengths in m, angles in rad; read at home.",
        *remarks(lacks, notes)]))
    reached = _read_back(bare, read(content), driven_to)
    q = driven_to.q[-1]
    was = forward(Model(mechanism.nominal()), q).pose
    real = reached_poses(Model(mechanism), q, at_rest(mechanism, len(q))).pose
    return Exported(
        "mjcf", "MuJoCo", {FILE: content},
        f"MuJoCo's bodies hold {'the geometry' if lacks else 'all of the machine'}",
        tuple(_numbers(mechanism)), f"{len(q)} poses, at the same joint values",
        pose_errors(mechanism, real, was), pose_errors(mechanism, real, reached), lacks, notes,
        (ADVICE,), poses=driven_to.wanted,
        again=lambda m: {p.name: float(p.value) for p in m.parameters})


def bodies_at_home(mechanism: Mechanism) -> tuple[Array, Home]:
    """Return where bodies stand at home: the platform's motor (8,), and each joint.

    Raises:
        NoResult: the joints of a limb do not close.
    """
    q = home_state(mechanism).q[None]
    model = Model(mechanism)
    pose = forward(model, q).pose[0]
    home: dict[str, object] = {}
    for index, limb in enumerate(mechanism.limbs):
        tree = read(text(mechanism, pose, {}, only=[index]))
        own = [n for n, joint in tree.joints.items() if tree.names[joint.body] != PLATFORM]
        if not own:
            continue
        if limb.driven:
            home[limb.name] = float(model.joint_coordinate(index, q)[0])
        state = _assembled(tree, own, home.get(limb.name), limb.name, mechanism)
        home |= {n: state[n][0] for n in own if n not in home}
    return pose, home


def _assembled(tree: Tree, own: Sequence[str], u: object, name: str, mechanism: Mechanism
               ) -> TreeState:
    """Return the state of one limb (1 row) between base and platform at home.

    Of several the one whose joints are turned least.
    """
    rng = np.random.default_rng(SEED)
    start, size = at_home(tree, STARTS), mechanism.reach
    for joint in own:
        dof = tree.joints[joint]
        drawn = rng.uniform(-1.0, 1.0, (STARTS, 3))
        drawn[0] = 0.0
        if joint == name:
            start[joint] = np.full(STARTS, u)
        elif dof.kind == "ball":
            start[joint] = cga.rotation_matrix(
                cga.motor_from_rotation_vector(3.0 * drawn, np.zeros_like(drawn)))
        else:
            start[joint] = drawn[:, 0] * (size if dof.kind == "slide" else np.pi)
    for joint, (leader, slope) in tree.coupled.items():
        start[joint] = slope * start[leader]
    held = [n for n in tree.joints if n not in own or n == name]
    state, gap = closed(tree, start, size, held)
    size_of = np.zeros(STARTS)
    for joint in own:
        value = state[joint]
        if tree.joints[joint].kind == "ball":
            size_of += np.arccos(np.clip(0.5 * (np.trace(value, axis1=1, axis2=2) - 1.0), -1, 1))
        elif joint != name:
            size_of += np.abs(value) / (size if tree.joints[joint].kind == "slide" else 1.0)
    best = int(np.argmin(np.where(gap < ALIKE * size, size_of, np.inf)))
    if not gap[best] < ALIKE * size:
        raise NoResult(f"the joints of limb '{name}' do not close at home, by "
                       f"{gap.min() * 1e3:.3g} mm", mechanism.source,
                       "Look with `ppmcal check` whether home is on the limbs' surfaces")
    return {n: v[best:best + 1] for n, v in state.items()}


@dataclass(frozen=True, eq=False)
class _Way:
    """BodyJoint values (N, k) on the way from home to poses (N, 6), and the motors (N, 8) there."""

    wanted: Array
    q: list[Array]
    pose: Array


def _way(mechanism: Mechanism, wanted: Array) -> _Way:
    """Return the joint values that lead to those of the wanted poses that are within the limits."""
    found = [inverse_partial(Model(mechanism), mechanism.home_pose + part * (
        wanted - mechanism.home_pose)) for part in WAY]
    good = np.all([finite_rows(f.q) for f in found], axis=0)
    pose = np.full((len(wanted), 8), np.nan)
    if good.any():
        pose[good] = forward(Model(mechanism), found[-1].q[good], found[-1].pose[good],
                             found[-1].q[good]).pose
    good &= finite_rows(pose) & within_limits(mechanism, found[-1].q)
    return _Way(wanted[good], [f.q[good] for f in found], pose[good])


def _read_back(mechanism: Mechanism, tree: Tree, way: _Way) -> Array:
    """Return where the model that was read back brings the platform, motors (N, 8).

    Raises:
        NoResult: that is elsewhere than the machine.
    """
    state, gap = at_home(tree, len(way.wanted)), np.zeros(len(way.wanted))
    for q in way.q:
        state, lengths = driven(tree, state, dict(zip(mechanism.actuators, q.T, strict=True)))
        state, gap = closed(tree, state, mechanism.reach, actuated(tree), lengths)
    at = placed(tree, state)
    turn = at.bodies[tree.sites[SITE][0]][0]
    reached = cga.motor_from_matrix(turn, at.site(tree, SITE))
    apart = cga.compose(cga.reverse(way.pose), reached)
    off = max(float(np.abs(cga.translation(apart)).max() / mechanism.reach),
              float(np.abs(cga.rotation_vector(apart)).max()))
    if not off < ALIKE or not gap.max() < ALIKE * mechanism.reach:
        raise NoResult(f"the model reads back as another machine, {off:.2g} of its size away",
                       FILE, "This is a fault of ppmcal; do not use it")
    return np.asarray(reached)


def _numbers(mechanism: Mechanism) -> Iterator[Number]:
    """Yield what of the geometry is not nominal."""
    effects = {p for e in mechanism.effects for p in e.parameters.values()}
    for i, p in enumerate(mechanism.parameters):
        if i not in effects and p.value != p.nominal:
            yield Number(p.name, float(p.nominal), float(p.value),
                         {"length": "m", "angle": "rad"}.get(p.quantity, ""))


def _not_expressed(mechanism: Mechanism, way: _Way) -> Iterator[NotExpressed]:
    """Yield the effects, each with what it alone costs at rest."""
    q = way.q[-1]
    for effect in mechanism.effects:
        if effect.kind.instrument:
            continue
        alone = replace(mechanism, effects=(effect,))
        needs = effect.kind.needs
        why = (f", which depends on {', '.join(needs)} and is not in the figures either"
               if needs else "")
        yield effect_lacking(mechanism, effect, why, None if needs else _cost(alone, q, way.pose))


def _cost(mechanism: Mechanism, q: Array, pose: Array) -> ErrorSummary:
    real = reached_poses(Model(mechanism), q, at_rest(mechanism, len(q))).pose
    return pose_errors(mechanism, real, pose)


def _notes(mechanism: Mechanism) -> Iterator[Note]:
    """Yield what stands in the model that is not known of the machine, or otherwise than there."""
    for said in dict.fromkeys(p.said for p in limb_parts(mechanism) if p.said):
        yield Note(said, NOTE)
    yield Note("masses, inertias and gains are placeholders: no file of a machine has them", NOTE)
    if any(limb.kind.pulls_only for limb in mechanism.limbs):
        yield Note("ropes are tendons that their actuators pull; `ctrl` is the joint value, the "
                   "offset is in biasprm", NOTE)
    if any(not limb.kind.pulls_only for limb in mechanism.limbs if limb.driven):
        yield Note("`ctrl` of an actuator, and its length, are the joint value q: its gear is "
                   "1/ratio, and its joint counts u - offset, m or rad", NOTE)
