"""Frames of joints: counted along each limb, each there once; chains with and without a drive."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.model.limbs import kinds as limb_kinds
from ppmcal.model.limbs.chain import Chain, U, joint, slide, turn
from ppmcal.model.limbs.driven import cut_at_drive


@pytest.mark.parametrize("kind", limb_kinds())
def test_joints_are_counted_once_each_and_along_the_limb(kind: str) -> None:
    """From 1 on, from base to platform; each has six components of its own.

    Limbs that hold rotations have frames for some of the joints of their name.
    """
    found = limb_kinds()[kind]
    steps = [s for s in found.steps if s.joint]
    numbers = [int(s.slots[0].name.partition(".")[0].removeprefix("joint")) for s in steps]
    if found.surface.angles:
        assert sorted(set(numbers)) == numbers and numbers[0] == 1
        assert numbers[-1] <= sum(letter.isupper() for letter in kind)
    else:
        assert sorted(numbers) == list(range(1, len(numbers) + 1))
    for chain in (found.base, found.middle):
        own = [int(s.slots[0].name.partition(".")[0].removeprefix("joint"))
               for s in chain.steps if s.joint]
        assert own == sorted(own)
    for step, number in zip(steps, numbers, strict=True):
        assert {s.name for s in step.slots} == {
            f"joint{number}.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")}
    names = [s.name for s in found.slots]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("drive", ["slide", "turn", ""])
def test_a_chain_that_is_not_driven_has_no_twist_of_a_drive(drive: str) -> None:
    """One that is has it in the axes of its root, wherever the drive stands."""
    moved = {"slide": (slide(U, "x"),), "turn": (turn(U),), "": ()}[drive]
    chain = Chain((slide("a", "x"), joint(1), *moved, slide("b", "y")))
    values = {"a": np.array([[0.3, 0.4]]), "b": np.array([[0.5, 0.7]])}
    found = cut_at_drive(chain, values, (U, "a", "b"), 2)
    assert found is not None
    assert set(found.still) == {"a"} | ({U} if drive else {"b"})
    assert set(found.carried) == ({"b"} if drive else set())
    if drive:
        assert (np.abs(found.still[U]).max(axis=1) > 0.0).all()
        np.testing.assert_array_equal(found.drive[0], found.drive[1])
    else:
        assert not found.drive.any()
