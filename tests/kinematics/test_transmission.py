"""Limbs near a dead point, and limbs in each other's way."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.machines import KINDS, plain, read_text
from helpers.paths import ROOT

from ppmcal.errors import BadInput
from ppmcal.kinematics.closed_at_home import transmissions
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_attempt, home_state
from ppmcal.kinematics.pose_sweep import pose_sweep
from ppmcal.kinematics.skeleton import Link, skeleton
from ppmcal.kinematics.transmission import _apart, interferences, transmissions_at


def crank(distal):
    return read_text((ROOT / "configs/3-RRR-1.yaml").read_text().replace(
        "distal: 220", f"distal: {distal}", 1))


@pytest.mark.parametrize("kind", KINDS)
def test_transmission_is_that_of_check_at_home(kind):
    own = plain(kind)
    value, roots = transmissions_at(Model(own), own.home[None], home_state(own).q[None])
    np.testing.assert_allclose(value[0], [t.value for t in transmissions(own)], rtol=1e-12)
    assert roots.shape == (1, len(own.limbs), 2)


def test_a_limb_that_is_stretched_moves_nothing():
    value = []
    for distal in (30.0, 30.5, 40.0):
        own = crank(distal)
        value.append(transmissions_at(Model(own), own.home[None], home_state(own).q[None])[0][0, 0])
    assert value[0] < 0.02 and value[0] < value[1] < value[2]


def test_home_out_of_reach_is_attempted_as_far_as_the_limb_goes():
    own = crank(20.0)
    with pytest.raises(BadInput, match=r"limb .leg1..*misses by about 10"):
        home_state(own)
    found = home_attempt(own)
    assert found.lost == (0,)
    np.testing.assert_allclose(found.missing, [0.01, 0.0, 0.0], atol=1e-6)
    limbs = skeleton(Model(own), own.home[None], found.q[None])
    # crank and rod point straight at the platform: what is missing is the gap between the ends
    np.testing.assert_allclose([limb.gap[0] for limb in limbs], [0.01, 0.0, 0.0], atol=1e-6)
    apart = limbs[0].ends[0] - limbs[0].ends[1]
    np.testing.assert_allclose(np.linalg.norm(apart, axis=-1), limbs[0].gap)
    sweep = pose_sweep(Model(own))
    assert sweep.lost == (0,) and len(sweep.pose) == 1


def test_what_is_reached_is_attempted_the_same():
    for kind in KINDS:
        own = plain(kind)
        assert home_attempt(own).lost == ()
        np.testing.assert_array_equal(home_attempt(own).q, home_state(own).q)


def test_segments_are_as_far_apart_as_their_points():
    rng = np.random.default_rng(3)
    p, p1, r, r1 = rng.normal(size=(4, 200, 3))
    distance, place = _apart((p, p1), (r, r1))
    t = np.linspace(0.0, 1.0, 101)[:, None, None]
    a, b = p + t * (p1 - p), r + t * (r1 - r)
    sampled = np.linalg.norm(a[:, None] - b[None], axis=-1).min(axis=(0, 1))
    assert np.all(distance <= sampled + 1e-12)
    assert np.all(sampled - distance < 0.08)
    assert np.isfinite(place).all()


def test_crossing_links_and_meeting_joints_are_found():
    own = plain("U(P)S")
    limbs = list(skeleton(Model(own), own.home[None], home_state(own).q[None]))
    drives = range(len(limbs))
    near = 1e-2 * own.reach
    assert interferences(limbs, near, drives) == []
    # the second limb's link is laid across the first one's
    one, two = limbs[0], limbs[1]
    middle = (one.links[0].start + one.links[0].end) / 2.0
    across = np.cross(one.links[0].end - one.links[0].start, [0.0, 0.0, 1.0])
    laid = Link("u", middle - across, middle + across)
    crossed = replace(two, links=(laid,), base_point=laid.start, platform_point=laid.end,
                      joints=())
    found = interferences([one, crossed], near, (0, 1))
    assert [f.joints for f in found] == [False] and found[0].distance[0] < 1e-9
    np.testing.assert_allclose(found[0].place, middle, atol=1e-9)
    assert interferences([one, crossed], near, (0, 0)) == []
    met = replace(crossed, base_point=one.base_point + 1e-4)
    assert interferences([one, met], near, (0, 1))[0].joints
