"""Commands farther from the uncorrected ones than tolerances explain are refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.commands import ppmcal as run_command
from helpers.paths import ROOT

import ppmcal
from ppmcal.calibration.compensation.commands import Compensation, compensate
from ppmcal.calibration.compensation.pose_sigma import tolerance_sigma
from ppmcal.calibration.knowledge.parameter_estimates import IMPLAUSIBLE
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array
from ppmcal.model.effects import effect_kinds
from ppmcal.model.effects.learned import LearnedCurve, learned_kind
from ppmcal.model.mechanism import Given, Mechanism, with_effect
from ppmcal.model.registration import Registration

WANTED = np.array([[x, y, 0.0, 0.0, 0.0, 0.0] for x in (-0.05, 0.0, 0.05) for y in (0.0, 0.05)])


def machine() -> Mechanism:
    return ppmcal.load(ROOT / "configs" / "delta-linear.yaml")


def places(mechanism: Mechanism) -> Array:
    return mechanism.home_pose + WANTED


def commands(mechanism: Mechanism, **columns: Array) -> Compensation:
    return compensate(mechanism, places(mechanism), Registration(), columns=columns)


def off(mechanism: Mechanism, sizes: float, seed: int = 1) -> Mechanism:
    """Return a machine drawn from its tolerances, times ``sizes``."""
    rng = np.random.default_rng(seed)
    g = mechanism.values.copy()
    for i in mechanism.free:
        g[i] += sizes * float(mechanism.parameters[i].tolerance or 0.0) * rng.standard_normal()
    return mechanism.with_values(g)


def sideways(mechanism: Mechanism, size: float) -> Mechanism:
    """Return the machine with a learned term: x, by x, is off by ``size``, m."""
    x = np.linspace(-0.1, 0.1, 5)
    return with_effect(mechanism, learned_kind(LearnedCurve(
        "x", x, np.full(5, size), np.zeros((5, 5)), acts="x")), (True,) * 3, {})


@pytest.mark.slow
def test_tolerances_are_carried_to_the_platform() -> None:
    """One tolerance at a time, by differences."""
    mechanism = machine()
    model, wanted = Model(mechanism), places(mechanism)
    sigma, _ = tolerance_sigma(model, Registration(), wanted, inverse_table(model, wanted).q)
    square = np.zeros(len(wanted))
    for i in mechanism.free:
        g = mechanism.values.copy()
        g[i] += 0.01 * float(mechanism.parameters[i].tolerance or 0.0)
        square += (commands(mechanism.with_values(g)).position_before / 0.01) ** 2
    assert sigma == pytest.approx(np.sqrt(square), rel=0.02)


@pytest.mark.slow
def test_machines_within_tolerances_are_commanded() -> None:
    assert all(set(commands(off(machine(), 1.0, seed)).status) == {"ok"} for seed in range(8))


@pytest.mark.parametrize("part", [0.9, 1.1])
def test_beyond_what_tolerances_explain_is_refused(part: float) -> None:
    mechanism = machine()
    model, wanted = Model(mechanism), places(mechanism)
    sigma, _ = tolerance_sigma(model, Registration(), wanted, inverse_table(model, wanted).q)
    found = commands(sideways(mechanism, part * IMPLAUSIBLE * float(sigma.mean())))
    if part < 1.0:
        assert set(found.status) == {"ok"}
        return
    assert set(found.status) == {"refused"}
    assert np.isnan(found.q).all()
    assert "from the uncorrected command" in found.reason[0]
    # why is told in numbers
    assert np.isfinite(found.position_before).all()


@pytest.mark.slow
def test_without_a_tolerance_any_command_is_explained() -> None:
    mechanism = sideways(machine(), 0.02)
    assert set(commands(mechanism).status) == {"refused"}
    free = mechanism.free[0]
    known = list(mechanism.parameters)
    known[free] = replace(known[free], tolerance=None)
    assert set(commands(replace(mechanism, parameters=tuple(known))).status) == {"ok"}


def test_what_a_named_effect_does_is_explained_by_it() -> None:
    mechanism = machine()
    slack = with_effect(mechanism, effect_kinds()["backlash"], (True,) * 3, {"width": Given(0.06)})
    found = commands(slack, **{f"dir_{a}": np.ones(len(WANTED)) for a in mechanism.actuators})
    assert found.position_before.min() > 0.02
    assert set(found.status) == {"ok"}


def test_regardless_sends_no_machine_farther_than_tolerances_explain() -> None:
    """Whoever takes a correction that is worse than none has not said that the machine is bent."""
    mechanism = off(machine(), 40.0)
    targets = places(mechanism)[:, list(mechanism.dof)].copy()
    targets /= [mechanism.units.factor("length")] * 3
    made = ppmcal.compensate(mechanism, targets, frame="base", path=False, regardless=True)
    far = [r for _, r in made.refused if "that far from its drawing" in r]
    assert far
    assert all("larger tolerances (--regardless does not override this)" in r for r in far)
    assert np.isnan(made.compensation.q[[n - 1 for n, r in made.refused if r in far]]).all()
    for command in ("compensate", "export"):
        said = " ".join(run_command(command, "--help", cwd=ROOT, expect=0).out.split())
        assert re.search("--regardless Lift the refusal of .*, and no other; ends with exit code 1",
                         said)
