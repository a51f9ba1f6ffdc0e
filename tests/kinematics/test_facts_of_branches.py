"""Which of two joint values is meant, and what tables cannot hold."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ppmcal
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.entry_tables import entry_tables
from ppmcal.kinematics.inverse import _choose


def chosen(roots: tuple[float, float], quantity: str = "angle", ratio: float = 1.0,
           branch: int | None = None, home: float = np.nan, sign: int = 1, name: str = "branch"
           ) -> int:
    limb = SimpleNamespace(actuator=0, branch=branch, slots=SimpleNamespace(
        values=lambda g: {"ratio": ratio}), kind=SimpleNamespace(branch_sign=sign, branch=name,
                                                                strut=False))
    machine: Any = SimpleNamespace(limbs=(limb,), home_q=np.array([home]), values=None,
                                   actuator_quantity=(quantity,))
    return _choose(machine, 0, np.array(roots))


@pytest.mark.parametrize(("roots", "larger"), [
    ((2.0, -2.5), 0), ((-2.5, 2.0), 1), ((3.0, 3.3), 0), ((-0.5, 6.0), 1), ((0.5, 6.0), 0)])
def test_the_larger_turn_is_so_within_half_a_turn_of_0(roots: tuple[float, float], larger: int
                                                       ) -> None:
    """Whole turns are none; a gear below 0 turns the other way; a branch may be the smaller."""
    assert chosen(roots) == larger
    assert chosen(roots, branch=1) == larger
    assert chosen(roots, branch=-1) == 1 - larger
    assert chosen(roots, sign=-1) == 1 - larger
    assert chosen(roots, ratio=-1.0) == 1 - larger
    assert chosen(tuple(r / 3.0 for r in roots), ratio=3.0) == larger  # type: ignore[arg-type]


def test_the_larger_way_is_so_as_it_is() -> None:
    assert chosen((0.3, 9.0), "length") == 1
    assert chosen((0.3, 9.0), "length", branch=-1) == 0


@pytest.mark.parametrize(("home", "near"), [(0.2, 0), (-3.0, 1), (3.0, 1), (6.4, 0)])
def test_home_says_which_unless_a_branch_does(home: float, near: int) -> None:
    """Roots 0 and 2.8: nearest by the shorter way round."""
    assert chosen((0.0, 2.8), home=home) == near
    assert chosen((0.0, 2.8), home=home, branch=1) == 1


def test_an_elbow_is_a_side_not_a_size() -> None:
    for roots in ((0.0, 1.0), (1.0, 0.0)):
        assert chosen(roots, name="elbow", branch=1) == 1
        assert chosen(roots, name="elbow", branch=-1) == 0
        assert chosen(roots, name="elbow", sign=-1) == 0


@pytest.mark.parametrize(("ratio", "homing", "there"), [
    (np.ones((1, 3)), 4, True), (np.ones((5, 3)), 4, False), (np.ones((5, 3)), None, True)])
def test_a_gear_that_differs_by_row_has_no_table_of_homing(ratio: Any, homing: int | None,
                                                           there: bool) -> None:
    model = Model(ppmcal.load(ppmcal.shipped("3-RPR")))
    closure = model.closure(np.full((5, 3), 0.4), ())
    groups = [replace(g, values={**g.values, "ratio": ratio}) for g in closure.groups]
    own: Any = SimpleNamespace(model=model, groups=groups, slots=closure.slots,
                               columns=closure.columns)
    found = entry_tables(own, [()] * len(groups), {}, homing)
    assert (found is not None) == there
