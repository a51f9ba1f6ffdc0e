"""What cannot be predicted counts as unknown, not as nothing: such rows have no command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers.paths import ROOT

import ppmcal
from ppmcal.calibration.compensation.commands import Compensation, Knowledge, compensate
from ppmcal.calibration.compensation.model_averaging import Reading, Readings, Targets, averaged
from ppmcal.calibration.compensation.safe_commands import sent
from ppmcal.calibration.validation.left_out_rows import DoubtfulStretch
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration


def machine() -> Mechanism:
    return ppmcal.load(ROOT / "configs" / "3-RRR-1.yaml")


def targets(mechanism: Mechanism) -> Array:
    """Return poses along a line from home outward."""
    away = np.zeros((5, 6))
    away[:, 0] = np.linspace(0.0, 0.1, 5)
    return mechanism.home_pose + away


def knowledge(mechanism: Mechanism) -> Knowledge:
    names = tuple(mechanism.names[i] for i in mechanism.free)
    return Knowledge(names, 1e-12 * np.eye(len(names)), {}, {}, {})


def commands(mechanism: Mechanism, known: Knowledge | None) -> Compensation:
    return compensate(mechanism, targets(mechanism), Registration(), known)


def test_a_row_of_which_nobody_knows_how_sure_it_is_is_refused() -> None:
    mechanism = machine()
    known = knowledge(mechanism)
    q = commands(mechanism, known).q[:, 0]
    lost = DoubtfulStretch(mechanism.actuators[0], float(q[2]) - 1e-6, float(q[2]) + 1e-6,
                           position=np.nan, rotation=0.0)
    found = commands(mechanism, replace(known, doubtful=(lost,)))
    assert [s == "ok" for s in found.status] == [True, True, False, True, True]
    assert "how well the measurements know the machine" in found.reason[2]
    assert np.isnan(found.q[2]).all()
    # without a calibration nothing is known of any row, which is told and no refusal
    assert set(commands(mechanism, None).status) == {"ok"}


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
    rival = Reading("backlash", "", 2.0, mechanism.with_values(g))
    result, _ = averaged(mechanism, found, Readings((rival,), None), known,
                         Targets(targets(mechanism), "", {}))
    assert 0 < sent(result).sum() < len(result.status)
    assert np.isfinite(result.sigma_position[sent(result)]).all()
    assert all("does not take these joint values" in r
               for r in np.array(result.reason)[~sent(result)])
