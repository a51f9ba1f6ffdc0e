"""Where joints and bars stand: chains that close, bars as long as the file says, drives' signs."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.machines import (
    KINDS,
    OFFSET_JOINTS,
    PLANAR,
    delta,
    full,
    joint_coordinates,
    matrices,
    mixed,
    offset_joints,
    plain,
    spread,
)
from helpers.paths import ROOT
from scipy.spatial.transform import Rotation

import ppmcal.kinematics.skeleton as module
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.pose_sweep import pose_sweep
from ppmcal.kinematics.skeleton import FOLD, GUIDE, skeleton
from ppmcal.model.limbs import kinds

CONFIGS = sorted(p.stem for p in (ROOT / "configs").glob("*.yaml"))
MACHINES = {
    **{f"plain {k}": lambda k=k: plain(k) for k in KINDS},
    **{f"full {k}": lambda k=k: full(k) for k in KINDS},
    **{f"offset {k} {b}": lambda k=k, b=b: offset_joints(k, b, full=True)
       for k, b in OFFSET_JOINTS},
    **{f"delta {k} {n}": lambda k=k, n=n: delta(k, n) for k in ("(P)US", "(R)US") for n in (3, 6)},
    **{f"mixed {n}": lambda n=n: mixed(n) for n in ("planar", "spatial")},
    **{c: lambda c=c: read_mechanism(ROOT / "configs" / f"{c}.yaml") for c in CONFIGS}}


@cache
def placed(name):
    """Return a machine's model, joint values, poses and limbs."""
    model = Model(replace(MACHINES[name](), effects=()))
    q, pose = spread(model, count=4)
    if model.mechanism.surplus:     # joint values of their own contradict each other there
        q = inverse(model, pose).q
    return model, q, pose, skeleton(model, pose, q)


def coordinates_of(model, q):
    """Return u of each limb, None of passive ones."""
    driven = iter(joint_coordinates(model, q))
    return [next(driven) if limb.driven else None for limb in model.mechanism.limbs]


@pytest.mark.slow_cases(
    "offset (P)US base", "offset (P)US platform", "offset (R)US base", "offset (R)US platform",
    "offset U(P)S base", "offset U(P)S platform", "cable-8-pulleys")
@pytest.mark.parametrize("name", MACHINES)
def test_every_limb_is_one_line_from_the_files_base_point_to_the_platforms(name):
    model, _, pose, limbs = placed(name)
    mechanism = model.mechanism
    near = 1e-9 * mechanism.reach
    rotation, origin = matrices(pose)
    assert len(limbs) == len(mechanism.limbs)
    for limb, own, v in zip(limbs, mechanism.limbs, model.limb_values, strict=True):
        a, b = (np.array([v.get(f"{own.kind.point(side)}.{c}", 0.0) for c in "xyz"])
                for side in ("base", "platform"))
        assert limb.name == own.name and limb.kind == own.kind.name
        for before, after in zip(limb.links, limb.links[1:], strict=False):
            np.testing.assert_allclose(before.end, after.start, atol=near)
        line = limb.polyline
        np.testing.assert_allclose(line[:, 0], np.broadcast_to(a, line[:, 0].shape), atol=near)
        np.testing.assert_allclose(line[:, -1], rotation @ b + origin, atol=near)
        np.testing.assert_allclose(limb.platform_point, rotation @ b + origin, atol=near)
        assert limb.gap.max() < near
        for joint in limb.joints:
            apart = np.linalg.norm(line - joint.centre[:, None], axis=-1).min(axis=1)
            np.testing.assert_allclose(apart, 0.0, atol=near)


@pytest.mark.parametrize("name", MACHINES)
def test_bars_are_as_long_as_the_file_says_and_drives_as_u(name):
    model, q, _, limbs = placed(name)
    for limb, v, u in zip(limbs, model.limb_values, coordinates_of(model, q), strict=True):
        if kinds()[limb.kind].pulley:       # in tests/model/test_pulleys.py
            continue
        bars = [slot for slot in ("length", "proximal", "distal", "lateral") if v.get(slot)]
        assert [k.name for k in limb.links if k.name in bars] == bars
        for link in limb.links:
            if link.name not in (GUIDE, FOLD):
                size = np.linalg.norm(link.end - link.start, axis=-1)
                np.testing.assert_allclose(size, np.abs(u if link.name == "u" else v[link.name]),
                                           rtol=1e-12)


@pytest.mark.parametrize("name", MACHINES)
def test_drives_grow_along_or_about_their_axis(name):
    """A wrong sign of an axis, a zero or u shows as another place of the next joint."""
    model, q, _, limbs = placed(name)
    for limb, u in zip(limbs, coordinates_of(model, q), strict=True):
        drive = limb.drive
        if drive is None:
            assert not kinds()[limb.kind].driven
            continue
        np.testing.assert_allclose(drive.u, u, rtol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(drive.axis, axis=-1), 1.0, rtol=1e-12)
        # a rope has no joints, and what the slide of a limb that holds rotations is in has no frame
        if limb.joints and not (drive.prismatic and kinds()[limb.kind].surface.angles
                                and not any(j.driven for j in limb.joints)):
            assert [j.driven for j in limb.joints].count(True) == 1
            joint = next(j for j in limb.joints if j.driven)
            assert joint.kind == ("P" if drive.prismatic else "R")
        if drive.prismatic:
            link = next(k for k in limb.links if k.name == "u")
            start = drive.centre if kinds()[limb.kind].pulley else link.start
            np.testing.assert_allclose(link.end - start, u[:, None] * drive.axis, atol=1e-12)
            continue
        behind = [n for n in limb.polyline.swapaxes(0, 1)
                  if np.linalg.norm(n - drive.centre, axis=-1).min() > 1e-6]
        turned = drive.centre + Rotation.from_rotvec(u[:, None] * drive.axis).apply(
            drive.zero - drive.centre)
        reach = model.mechanism.reach
        guided = any(k.name == GUIDE and np.allclose(k.start, drive.centre) for k in limb.links)
        if not guided and np.linalg.norm(drive.zero - drive.centre, axis=-1).min() > 1e-6:
            assert min(np.abs(turned - n).max() for n in behind) < 1e-9 * reach


@pytest.mark.parametrize("name", MACHINES)
def test_passive_slides_go_along_their_joints_axis(name):
    _, _, _, limbs = placed(name)
    for limb in limbs:
        if limb.kind in ("UPU", "UPR"):     # no frame tells where their slide stands
            continue
        guides = [k for k in limb.links if k.name == GUIDE]
        free = [j for j in limb.joints if j.kind == "P" and not j.driven]
        assert len(guides) == len(free)
        for guide, joint in zip(guides, free, strict=True):
            away = np.cross(guide.end - guide.start, joint.axis)
            np.testing.assert_allclose(away, 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_joint_frame_errors_are_drawn_and_close(kind):
    """Errors of every joint in the plane, of every joint in space."""
    machine = full(kind)
    own = ("x", "y", "rz") if kind in PLANAR else ("x", "y", "z", "rx", "ry", "rz")
    rng = np.random.default_rng(3)
    g = machine.values.copy()
    for i, p in enumerate(machine.parameters):
        if ".joint" in p.name and _plane_keeps(machine, p.name, own):
            g[i] = rng.uniform(-1.0, 1.0) * 1e-3
    model = Model(machine.with_values(g))
    q = home_state(machine).q[None]
    pose = forward(model, q).pose
    for limb in skeleton(model, pose, q):
        assert limb.gap.max() < 1e-9
        assert any(k.name.startswith("joint") for k in limb.links)


def _plane_keeps(machine, name, own):
    """Whether an error leaves a planar limb in its plane: a slide's own z lies in it."""
    joint, component = name.split(".")[-2:]
    if len(own) == 6:
        return True
    kind = machine.limbs[0].kind
    step = next(s for s in kind.steps if s.joint and s.slots[0].name.startswith(joint))
    twist = dict(step.twists({}))[f"{joint}.{component}"]
    return not np.any(np.asarray(twist)[[0, 1, 5]])


def test_no_kind_is_named():
    text = Path(module.__file__).read_text(encoding="utf-8")
    assert not [k for k in KINDS if f'"{k}"' in text]


@pytest.mark.parametrize("name", CONFIGS)
def test_the_sweep_keeps_to_the_surface_and_the_limits(name):
    model = Model(replace(MACHINES[name](), effects=()))
    mechanism, sweep = model.mechanism, pose_sweep(model)
    assert sweep.coordinate[0] == -1 and len(sweep.coordinate) == len(sweep.q) == len(sweep.pose)
    gaps = model.closure(sweep.q).lengths(pose_motor(sweep.pose))
    assert np.abs(gaps).max() < 1e-9 * mechanism.reach
    low, high = mechanism.limits.T
    assert ((sweep.q >= low) & (sweep.q <= high)).all()
    moved = {c for c in sweep.coordinate if c >= 0}
    assert moved | set(sweep.still) == set(mechanism.dof) and not moved & set(sweep.still)
    for n, c in enumerate(sweep.coordinate):
        if c >= 0:
            by = sweep.pose[n, c] - mechanism.home_pose[c]
            assert by == pytest.approx(sweep.step[n], abs=1e-9)
            assert abs(by) <= max(0.35, 0.1 * mechanism.reach) * 1.001
