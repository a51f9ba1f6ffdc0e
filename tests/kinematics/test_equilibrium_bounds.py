"""Rows without an equilibrium are given up as soon as that shows; what settles is as it was."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import machines

from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import ROUNDS, SETTLED, hopeless
from ppmcal.kinematics.equilibrium import reached_poses, settle
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.dataset import environment

REACH = 0.5
LIMIT = SETTLED * REACH


def verdicts(moves):
    """Return in which round each row is given up, by how far it moves in each, or None."""
    last = np.full(len(moves[0]), np.inf)
    out = [None] * last.size
    for n, change in enumerate(np.array(moves, dtype=float)):
        lost = hopeless(change, last, LIMIT, ROUNDS - 1 - n, REACH)
        last = change
        out = [n if o is None and gone else o for o, gone in zip(out, lost, strict=True)]
    return out


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 0.1, 0.3, 0.45])
def test_what_settles_in_all_rounds_is_never_given_up(factor):
    moves = [[1e-2 * REACH * factor**n] for n in range(ROUNDS)]
    assert moves[-1][0] < LIMIT
    assert verdicts(moves) == [None]


@pytest.mark.parametrize("factor", [0.8, 0.99, 1.0, 1.5, 10.0])
def test_what_cannot_settle_is_given_up_at_once(factor):
    assert verdicts([[1e-2 * REACH * factor**n] for n in range(4)])[0] in (1, 2)


def test_round_off_that_stays_is_no_sign_of_anything():
    assert verdicts([[1e-2 * REACH], [3.0 * LIMIT], [3.0 * LIMIT], [0.5 * LIMIT]]) == [None]


def test_rows_are_judged_one_by_one_and_those_without_a_pose_left_alone():
    still, wild, lost = [1e-2, 1e-6, 1e-10], [1e-2, 2e-2, 4e-2], [np.nan] * 3
    assert verdicts(np.transpose([still, wild, lost])) == [None, 1, None]


@pytest.mark.parametrize("moved", [0.0, 1e-9, 1e-6, 1e-3])
def test_a_yielding_machine_settles_from_its_equilibrium(moved):
    """Near by, poses move by what the slots did a round before: that is no lack of progress."""
    text = machines.plain_text("U(P)S", effects=[
        {"kind": "compliance", "parameters": {"stiffness": 200.0}}])
    mechanism = machines.read_text(text)
    model, rng = Model(mechanism), np.random.default_rng(3)
    q = home_state(mechanism).q + mechanism.reach * 0.03 * rng.uniform(-1.0, 1.0, (30, 6))
    load = environment({"payload": np.linspace(0.0, 100.0, 30)}, mechanism.actuators,
                       mechanism.gravity, q)
    there = reached_poses(model, q, load).closed
    again, _ = settle(model, q + moved * mechanism.reach, load, there)
    assert np.isfinite(there).all()
    assert np.isfinite(again).all()
