"""Parameters that a fit held: what their tolerances do to estimates and to what is promised."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import ppmcal
from helpers.instruments import data_of, joints
from helpers.paths import ROOT

from ppmcal.calibration.compensation.pose_sigma import ParameterCovariance, prediction_jacobian
from ppmcal.calibration.fit.fit_result import Fit, FitOptions, prediction_covariance
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.knowledge.consider_parameters import considered, held
from ppmcal.io import read_mechanism
from ppmcal.io.results.knowledge import read_knowledge
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array
from ppmcal.model.dataset import Unknown, unknown_environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

SIGMA = 1e-5
KEPT = ("rod",)
"""What the fits hold."""


def printer() -> tuple[Mechanism, tuple[int, ...]]:
    """Return a delta, and its parameters without its rods."""
    mechanism = read_mechanism(ROOT / "configs" / "delta-linear.yaml")
    return mechanism, tuple(p for p in mechanism.free
                            if not mechanism.names[p].endswith(KEPT))


def touched(mechanism: Mechanism, free: tuple[int, ...], g: Array, rng: np.random.Generator,
            noise: float = SIGMA) -> Fit:
    """Return the fit to touches of a flat by the machine ``g``, how the flat lies known."""
    at = np.zeros((30, 6))
    at[:, :3] = mechanism.home_pose[:3]
    at[:, :2] += rng.uniform(-0.08, 0.08, (30, 2))
    q = inverse_table(Model(mechanism), at).q
    data = data_of(mechanism, "plane", q, None, g, rng, noise, True)
    data = replace(data, frame=Unknown(False, np.zeros(6)), target=Unknown(False, np.zeros(3)),
                   sigma_value=np.full(len(q), SIGMA))
    # the heights of the machine itself, in its own base
    pose = pose_vector(forward(Model(mechanism, g), q).pose)
    data = replace(data, value=pose[:, 2] + rng.normal(0.0, max(noise, 1e-300), len(q)))
    return identify(Problem(replace(mechanism, free=free), (data,), free),
                    FitOptions(robust=False))


def test_what_is_held_is_what_may_be_off_and_is_not_fitted() -> None:
    mechanism, free = printer()
    names = [mechanism.names[p] for p in held(mechanism, free)]
    assert names == [n for n in mechanism.names if n.endswith(KEPT)] != []
    assert held(mechanism, mechanism.free) == ()


@pytest.mark.slow
def test_estimates_err_with_what_is_held_as_is_foretold() -> None:
    """Against fits to exact rows of machines of which one rod is off."""
    mechanism, free = printer()
    rng = np.random.default_rng(4)
    kept = considered(touched(mechanism, free, mechanism.values, rng, 0.0))
    for c, name in enumerate(kept.names):
        step, found = 1e-3 * kept.sigma[c], []
        for sign in (1.0, -1.0):
            g = mechanism.values.copy()
            g[mechanism.names.index(name)] += sign * step
            fit = touched(mechanism, free, g, np.random.default_rng(4), 0.0)
            found.append(fit.state.g[list(free)])
        slope = (found[0] - found[1]) / (2.0 * step)
        np.testing.assert_allclose(slope, kept.gain[:, c],
                                   atol=0.02 * np.abs(kept.gain[:, c]).max())


@pytest.mark.long
def test_promises_count_what_was_held_as_far_as_nothing_made_up_for_it() -> None:
    """Machines drawn from all tolerances, the rods too, which touches of a flat alone leave held.

    The mean square of the true error over the promised one: 1. Without the rods the promise is
    too small, and with their tolerance only added, as if the fit knew nothing of it, too large.
    """
    mechanism, free = printer()
    rng = np.random.default_rng(11)
    may = [p for p, one in enumerate(mechanism.parameters)
           if one.prior_sigma is not None and not one.fixed]
    wanted = joints(mechanism, "delta-linear", 20, rng)
    square = np.zeros(4)
    for _ in range(60):
        g = mechanism.values.copy()
        g[may] += rng.normal(size=len(may)) * [mechanism.parameters[p].prior_sigma for p in may]
        fit = touched(mechanism, free, g, rng)
        kept, model = considered(fit), Model(mechanism, fit.state.g)
        pose = pose_vector(forward(model, wanted).pose)
        real = pose_vector(forward(Model(mechanism, g), wanted).pose)
        square[0] += np.mean(np.sum((real - pose)[:, :3] ** 2, axis=1))
        whole = kept.beside(prediction_covariance(fit))
        knowledge = ParameterCovariance((*fit.problem.columns, *kept.names), whole, {}, {}, {})
        jacobian = prediction_jacobian(model, Registration(), pose, wanted, knowledge, "",
                                       unknown_environment(*wanted.shape))
        bare, own = whole.copy(), len(fit.problem.columns)
        bare[:own, :own] = prediction_covariance(fit)
        added = bare.copy()
        added[:own, own:] = added[own:, :own] = 0.0
        bare[own:] = bare[:, own:] = 0.0
        for n, covariance in enumerate((whole, bare, added), 1):
            square[n] += np.mean(np.einsum("nmc,cd,nmd->n", jacobian, covariance, jacobian))
    with_held, without, only_added = square[0] / square[1:]
    assert 0.6 < with_held < 1.6
    assert without > 2.0 and only_added < 0.5


@pytest.mark.slow
def test_it_is_written_read_back_and_in_every_promise(tmp_path: Path) -> None:
    ppmcal("init", "delta-linear", "--out", "m.yaml", cwd=tmp_path, expect=0)
    ppmcal("simulate", "m.yaml", "m.scenario.yaml", "--out", "d", cwd=tmp_path)
    sigma = {}
    for out, free in (("all", ()), ("held", ("--free", "*.offset"))):
        ppmcal("identify", "m.yaml", "d/measurements.csv", *free, "--out", out, "--holdout", "0",
               cwd=tmp_path)
        machine = read_mechanism(tmp_path / out / "identified.yaml")
        knowledge = read_knowledge(tmp_path / out / "identification.json", machine)
        sigma[out] = dict(zip(knowledge.names, np.sqrt(np.diagonal(knowledge.covariance)),
                              strict=True))
        assert np.linalg.eigvalsh(knowledge.covariance / np.outer(
            *2 * [list(sigma[out].values())])).min() > -1e-6
    more = set(sigma["held"]) - {n for n in machine.names if n.endswith(".offset")}
    own = {n for n in more if " of " not in n}
    assert own
    for name in own:
        parameter = machine.parameters[machine.names.index(name)]
        assert sigma["held"][name] == pytest.approx(parameter.tolerance, rel=1e-6)
