"""Rows that cannot be solved cost few steps of Newton's method where joints are led."""

from __future__ import annotations

import numpy as np
import pytest

import ppmcal
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.forward import CONTRACTION, newton
from ppmcal.kinematics.inverse import home_state


def test_a_row_that_does_not_contract_is_given_up_after_its_second_step(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows beside it are solved to the same poses as with it."""
    model = Model(ppmcal.load(ppmcal.shipped("3-RPR")))
    home = home_state(model.mechanism)
    q = home.q + np.array([[1e-3, -1e-3, 2e-3], [0.0, 0.0, 0.0]])
    q[1] = home.q * [0.05, 4.0, 0.05]    # legs that do not meet
    start = np.tile(model.mechanism.home, (2, 1))
    asked: list[int] = []
    matrix = Closure.pose_matrix
    monkeypatch.setattr(Closure, "pose_matrix", lambda *a: (asked.append(1), matrix(*a))[1])
    found = newton(model.closure(q), start)
    long = len(asked)
    asked.clear()
    short = newton(model.closure(q), start, most=CONTRACTION)
    assert found[1].tolist() == short[1].tolist() == [True, False]
    assert short[0][0] == pytest.approx(found[0][0], abs=1e-10)
    assert short[2][1] > CONTRACTION
    assert len(asked) < long
