"""A base on springs that stand somewhere: `about: base` against the balance of its springs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.machines import Array, spread
from helpers.paths import ROOT
from scipy.spatial.transform import Rotation

from ppmcal import algebra as cga
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.effects import effects_tree, with_effects
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.effects import find_effect
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import TRANSLATIONAL
from ppmcal.units import SI

HEXAPOD = read_mechanism(ROOT / "configs" / "6-UPS.yaml")
BENCH = read_mechanism(ROOT / "configs" / "3-RPR.yaml")
NAMES = {"planar": (("x", "y", "rz"), ("fx", "fy", "mz"), [0, 1, 5]),
         "spatial": (("x", "y", "z", "rx", "ry", "rz"), ("fx", "fy", "fz", "mx", "my", "mz"),
                     list(range(6)))}


def springs(feet: Array, stiffness: Array) -> Array:
    """Return the stiffness (6, 6) of springs (n, 3) N/m along x, y, z under feet (n, 3), m.

    Of each foot: its force on the base is -k (t + r x foot), its moment about the origin foot x it.
    """
    out = np.zeros((6, 6))
    for foot, k in zip(feet, stiffness, strict=True):
        displaced = np.hstack([np.eye(3), np.cross(np.eye(3), foot)])    # t + r x foot
        out += displaced.T @ np.diag(k) @ displaced
    return out


def standing(mechanism: Mechanism, compliance: Array) -> Mechanism:
    """Return a machine whose base has a compliance (6, 6), as a file gives it."""
    coordinates, wrench, at = NAMES[mechanism.motion.name]
    values = {f"{c}_{w}": float(compliance[at[i], at[j]]) for i, c in enumerate(coordinates)
              for j, w in enumerate(wrench) if j >= i}
    return with_effects(mechanism, [{"kind": "base_compliance", "about": "base",
                                     "parameters": values}], SI, "m.yaml")


def carried(mechanism: Mechanism, compliance: Array, wrench: Array) -> tuple[Array, Array]:
    """Return poses (n, 4, 4) of a platform on a base that has come to rest, and those said."""
    q, pose = spread(Model(mechanism), len(wrench), size=0.5)
    place, turn = cga.translation(pose), cga.rotation_matrix(pose)
    rows = replace(unknown_environment(*q.shape), wrench=wrench)
    found = reached_poses(Model(standing(mechanism, compliance)), q, rows).pose
    out = []
    for p, r, w in zip(place, turn, wrench, strict=True):
        # balance about the base's origin, springs displaced as by a small motion
        motion = compliance @ np.concatenate([w[:3], w[3:] + np.cross(p, w[:3])])
        tilted = Rotation.from_rotvec(motion[3:]).as_matrix()
        out.append(np.block([[tilted @ r, (tilted @ p + motion[:3])[:, None]],
                             [np.zeros((1, 3)), np.ones((1, 1))]]))
    said = np.tile(np.eye(4), (len(q), 1, 1))
    said[:, :3, :3], said[:, :3, 3] = cga.rotation_matrix(found), cga.translation(found)
    return np.array(out), said


def test_a_base_on_four_springs_off_its_origin() -> None:
    """The base turns about where its springs are, and carries the platform along."""
    rng = np.random.default_rng(3)
    feet = np.array([[0.9, 0.7, -0.4], [-0.6, 0.8, -0.5], [-0.7, -0.6, -0.3], [1.0, -0.5, -0.6]])
    stiff = springs(feet, rng.uniform(2e6, 9e6, (4, 3)))
    wrench = rng.normal(size=(5, 6)) * 200.0
    wanted, said = carried(HEXAPOD, np.linalg.inv(stiff), wrench)
    np.testing.assert_allclose(said, wanted, rtol=0.0, atol=2e-8)
    still, _ = carried(HEXAPOD, np.zeros((6, 6)), wrench)
    assert np.abs(wanted - still).max() > 1e-4


def test_a_base_in_the_plane() -> None:
    stiff = springs(np.array([[0.4, -0.2, 0.0], [0.9, 0.1, 0.0]]), np.full((2, 3), 3e7))
    compliance = np.zeros((6, 6))
    at = np.ix_([0, 1, 5], [0, 1, 5])
    compliance[at] = np.linalg.inv(stiff[at])
    wrench = np.array([[100.0, -300.0, 0.0, 0.0, 0.0, 20.0], [0.0, -80.0, 0.0, 0.0, 0.0, -9.0]])
    wanted, said = carried(BENCH, compliance, wrench)
    np.testing.assert_allclose(said, wanted, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("turns", [(2e-6, 5e-6, 1e-6), (2e-6, 5e-6, 0.0)])
def test_the_point_about_which_it_turns_is_told(turns: tuple[float, float, float]) -> None:
    """A turn about c moves the origin by -r x c; without moments about z two turns tell c."""
    center = np.array([0.2, -0.5, -0.9])
    turn = np.diag(turns)
    compliance = np.zeros((6, 6))
    compliance[3:, 3:] = turn
    compliance[:3, 3:] = np.array([np.cross(center, column) for column in turn.T]).T
    compliance[3:, :3] = compliance[:3, 3:].T
    machine = standing(HEXAPOD, compliance)
    (effect,) = machine.effects
    values = {n: machine.parameters[p].value for n, p in effect.parameters.items()}
    told = {d.name: d.value(values, 0.0) for d in effect.kind.derived}
    assert [told[f"center_{c}"] for c in "xyz"] == pytest.approx(center.tolist(), rel=1e-9)


def test_without_the_entry_it_is_about_the_platform() -> None:
    """Old files mean what they meant: the twist does not know where the platform is."""
    old = with_effects(HEXAPOD, [{"kind": "base_compliance", "parameters": {"rx_mx": 1e-8}}], SI,
                       "m.yaml")
    assert "about" not in effects_tree(old)[0]
    q, pose = spread(Model(HEXAPOD), 3, size=0.5)
    rows = replace(unknown_environment(*q.shape), wrench=np.tile([0, 0, -9e3, 90.0, 0, 0], (3, 1)))
    found = reached_poses(Model(old), q, rows).pose
    np.testing.assert_allclose(cga.translation(found), cga.translation(pose), atol=1e-12)
    told = effects_tree(standing(HEXAPOD, np.eye(6) * 1e-8))
    assert told[0]["about"] == "base"
    again = with_effects(HEXAPOD, told, HEXAPOD.units, "m.yaml")
    assert effects_tree(again) == told
    with pytest.raises(BadInput, match="about 'floor'") as caught:
        with_effects(HEXAPOD, [{"kind": "base_compliance", "about": "floor"}], SI, "m.yaml")
    assert caught.value.where == "m.yaml: effects[1].about"


def test_a_machine_that_only_translates_has_none() -> None:
    delta = read_mechanism(ROOT / "configs" / "delta-rotary.yaml")
    with pytest.raises(BadInput, match="only in planar, schoenflies and spatial motion"):
        with_effects(delta, [{"kind": "base_compliance", "about": "base"}], SI, "m.yaml")
    variants = find_effect("base_compliance").variants
    assert variants is not None
    assert {v.written is None for v in variants(TRANSLATIONAL)} == {True}
