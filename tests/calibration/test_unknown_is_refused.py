"""What cannot be predicted counts as unknown, not as nothing: such rows have no command."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.paths import ROOT

import ppmcal
from ppmcal.calibration.compensation.commands import Compensation, compensate
from ppmcal.calibration.compensation.model_averaging import (
    CandidateModel,
    Readings,
    Targets,
    averaged,
)
from ppmcal.calibration.compensation.pose_sigma import ParameterCovariance
from ppmcal.calibration.compensation.safe_commands import sent
from ppmcal.calibration.validation.left_out_rows import DoubtfulStretch
from ppmcal.io.effects import with_effects
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.units import SI


def machine() -> Mechanism:
    return ppmcal.load(ROOT / "configs" / "3-RRR-1.yaml")


def targets(mechanism: Mechanism) -> Array:
    """Return poses along a line from home outward."""
    away = np.zeros((5, 6))
    away[:, 0] = np.linspace(0.0, 0.1, 5)
    return mechanism.home_pose + away


def knowledge(mechanism: Mechanism) -> ParameterCovariance:
    names = tuple(mechanism.names[i] for i in mechanism.free)
    return ParameterCovariance(names, 1e-12 * np.eye(len(names)), {}, {}, {})


def commands(mechanism: Mechanism, known: ParameterCovariance | None) -> Compensation:
    return compensate(mechanism, targets(mechanism), Registration(), known)


@pytest.mark.slow
def test_a_row_of_which_nobody_knows_how_sure_it_is_is_refused() -> None:
    mechanism = machine()
    known = knowledge(mechanism)
    q = commands(mechanism, known).q[:, 0]
    lost = DoubtfulStretch(mechanism.actuators[0], float(q[2]) - 1e-6, float(q[2]) + 1e-6,
                           position=np.nan, rotation=0.0)
    found = commands(mechanism, replace(known, doubtful=(lost,)))
    assert [s == "ok" for s in found.status] == [True, True, False, True, True]
    assert "the model's uncertainty there" in found.reason[2]
    assert np.isnan(found.q[2]).all()
    # without a calibration nothing is known of any row, which is told and no refusal
    assert set(commands(mechanism, None).status) == {"ok"}


@pytest.mark.slow
def test_a_row_that_a_rival_machine_cannot_reach_is_refused() -> None:
    mechanism = machine()
    known = knowledge(mechanism)
    found = commands(mechanism, known)
    assert sent(found).all()
    # with a rod so much shorter the outer rows are out of its reach
    g = mechanism.values.copy()
    for limb in mechanism.limbs[:1]:
        for slot, place in limb.slots.direct:
            if slot == "distal":
                g[place] -= 0.08
    rival = CandidateModel("backlash", "", 2.0, mechanism.with_values(g))
    result, _ = averaged(mechanism, found, Readings((rival,), None), known,
                         Targets(targets(mechanism), "", {}))
    assert 0 < sent(result).sum() < len(result.status)
    assert np.isfinite(result.sigma_position[sent(result)]).all()
    assert all("does not take these joint values" in r
               for r in np.array(result.reason)[~sent(result)])


@pytest.mark.slow
@pytest.mark.parametrize("effect", [
    {"kind": "friction", "parameters": {"static": 2e-3, "dynamic": 1e-3, "speed": 0.02}},
    {"kind": "lag", "parameters": {"tau": 5e-3}}])
def test_a_rival_that_needs_velocities_counts_as_at_rest(effect: dict[str, Any]) -> None:
    """Targets are places, seldom with velocities; all of them had been refused."""
    mechanism = machine()
    known = knowledge(mechanism)
    found = commands(mechanism, known)
    first, joint = f"{effect['kind']} on one", mechanism.actuators[0]
    rival = CandidateModel(first, "", 2.0, with_effects(
        mechanism, [{**effect, "on": [joint]}], SI, "test"), (first,))
    columns = {f"dir_{a}": np.ones(5) for a in mechanism.actuators}
    result, notes = averaged(mechanism, found, Readings((rival,), None), known,
                             Targets(targets(mechanism), "", columns))
    assert sent(result).all()
    assert any(first in n and "at rest" in n and f"vel_{joint}" in n for n in notes)
    resting = columns | {f"vel_{joint}": np.zeros(5)}
    same, notes = averaged(mechanism, found, Readings((rival,), None), known,
                           Targets(targets(mechanism), "", resting))
    np.testing.assert_array_equal(result.sigma_position, same.sigma_position)
    assert not any("at rest" in n for n in notes)
    moving = columns | {f"vel_{joint}": np.full(5, 0.5)}
    other, _ = averaged(mechanism, found, Readings((rival,), None), known,
                        Targets(targets(mechanism), "", moving))
    assert not np.allclose(other.sigma_position, same.sigma_position)
