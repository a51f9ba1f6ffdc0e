"""Axis offsets of universal joints in the mechanism file: read, written, refused."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from helpers import machines
from helpers.machines import OFFSET_JOINTS

from ppmcal.errors import BadInput
from ppmcal.io.mechanism_writer import write_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.mechanism import Mechanism

each = pytest.mark.parametrize(("kind", "body"), OFFSET_JOINTS)


def plus(text: str) -> str:
    """Return a file's text with -0 written as 0: YAML reads it as the integer."""
    return re.sub(r"-0(?=[,\]}])", "0", text)


def edited(kind: str, changes: dict[str, dict[str, Any]], **more: Any) -> Mechanism:
    """Return the machine of a kind with keys added under base or platform of every limb."""
    def change(_: int, limb: dict[str, Any]) -> dict[str, Any]:
        return {**limb, **{body: {**limb[body], **keys} for body, keys in changes.items()}}

    return machines.read_text(machines.plain_text(kind, change, **more))


@pytest.mark.long_cases("(P)US-base", "(R)US-platform", "U(P)S-platform")
@each
@pytest.mark.slow
def test_a_file_written_and_read_is_the_same_machine(kind: str, body: str) -> None:
    """As drawn, after a fit that moved offset and axes, and with joint frames."""
    for full in (False, True):
        drawn = machines.offset_joints(kind, body, full=full)
        rng = np.random.default_rng(3)
        q, pose = machines.spread(Model(drawn))
        g = drawn.values + 2e-3 * rng.uniform(-1.0, 1.0, drawn.values.size)
        for mechanism in (drawn, drawn.with_values(g)):
            text = write_mechanism(mechanism)
            again = machines.read_text(text)
            assert again.names == mechanism.names
            assert again.free == mechanism.free
            # a crank's axis and zero are made square again, which costs a last digit
            if mechanism is drawn or kind != "(R)US":
                assert plus(write_mechanism(again)) == plus(text)
            np.testing.assert_allclose(Model(again).closure(q).misclosure(pose),
                                       Model(mechanism).closure(q).misclosure(pose), atol=1e-15)
            same, was = (Model(m.nominal()).closure(q).misclosure(pose)
                         for m in (again, mechanism))
            np.testing.assert_allclose(same, was, atol=1e-9)


@each
def test_what_the_file_does_not_say_is_not_there(kind: str, body: str) -> None:
    """Without keys: no parameters of the joint, but that of the crank's own axis, fixed at 0."""
    text = write_mechanism(machines.plain(kind))
    assert "axis_offset" not in text
    own = [n for n in machines.plain(kind).names if "axis_offset" in n]
    assert own == ([f"leg{i + 1}.base.axis_offset" for i in range(6)] if kind == "(R)US" else [])
    given = machines.offset_joints(kind, body, size=0.0)
    new = [p for p in given.parameters if p.name not in machines.plain(kind).names]
    if (kind, body) != ("(R)US", "base"):
        assert [p.name for p in new] == [f"leg{i + 1}.{body}.axis_offset" for i in range(6)]
    assert all(p.fixed and p.value == 0.0 for p in new)
    text = write_mechanism(given)
    assert "axis_offset" not in text
    assert plus(write_mechanism(machines.read_text(text))) == plus(text)


def test_what_is_free() -> None:
    """An offset in the file has the tolerance of lengths; its axis errors where e is not 0."""
    axis = [0.0, 1.0, 0.2]
    for offset, turns in ((0, False), (3, True), ({"value": 2, "nominal": 0}, False)):
        found = edited("U(P)S", {"base": {"axis": axis, "axis_offset": offset}})
        names = {found.parameters[i].name for i in found.free}
        assert "leg1.base.axis_offset" in names
        assert ("leg1.base.axis.rx" in names) == turns
    fixed = edited("U(P)S", {"platform": {"axis": axis,
                                          "axis_offset": {"value": 4, "fixed": True}}})
    assert "leg3.platform.axis_offset" not in {fixed.parameters[i].name for i in fixed.free}
    asked = edited("U(P)S", {"base": {"axis": {"value": axis, "tolerance": 0.5}}})
    assert {"leg2.base.axis.rx"} <= set(asked.names)


def test_an_axis_shared_by_all_legs() -> None:
    keys = {"axis": {"share": "a", "value": [1.0, 0.0, 0.0]},
            "axis_offset": {"share": "e", "value": 3.0}}
    shared = edited("(P)US", {"platform": keys})
    assert {"a.rx", "a.ry", "a.rz", "e"} <= set(shared.names)
    assert write_mechanism(machines.read_text(write_mechanism(shared))) == write_mechanism(shared)


AXIS = [1.0, 0.0, 0.0]
REFUSED = {
    "offset without axis": (
        "U(P)S", {"base": {"axis_offset": 1}}, {}, "limbs.leg1", "not the first axis",
        "Add `axis: [1, 0, 0]` under `base`"),
    "the platform's without axis": (
        "(R)US", {"platform": {"axis_offset": {"value": 0, "tolerance": 1}}}, {}, "limbs.leg1",
        "not the first axis", "under `platform`"),
    "free without axis": (
        "(P)US", {}, {"free": ["leg2.base.axis_offset"]}, "free", "leg2 has no base.axis",
        "Add `axis: [1, 0, 0]`"),
    "axis of no length": (
        "(P)US", {"base": {"axis": [0, 0, 0], "axis_offset": 1}}, {}, "limbs.leg1.base.axis",
        "points nowhere", "Write a vector"),
    "both ends": (
        "U(P)S", {"base": {"axis": AXIS}, "platform": {"axis": AXIS}}, {},
        "limbs.leg1.base.axis", "one universal joint", "Leave out"),
    "both ends of a crank": (
        "(R)US", {"base": {"axis_offset": 1}, "platform": {"axis": AXIS}}, {},
        "limbs.leg1.base.axis_offset", "one universal joint", "Leave out"),
    "not a universal joint": (
        "R(P)S", {"base": {"axis_offset": 1}}, {}, "limbs.leg1.base", "axis_offset", ""),
    "not a number": (
        "U(P)S", {"base": {"axis": AXIS, "axis_offset": "wide"}}, {},
        "limbs.leg1.base.axis_offset", "", ""),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(case: str) -> None:
    kind, keys, more, place, what, mend = REFUSED[case]
    with pytest.raises(BadInput) as refused:
        edited(kind, keys, **more)
    assert place in refused.value.where
    assert what in refused.value.what
    assert mend in refused.value.hint


def test_a_home_within_the_offset_is_refused() -> None:
    wide = edited("U(P)S", {"base": {"axis": AXIS, "axis_offset": 4000.0}})
    with pytest.raises(BadInput, match="within the axis_offset"):
        home_state(wide)
