"""What is learned is commanded: on a simulated machine, whatever measured it, that does no harm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.diagnoses import CONFIGS
from helpers.instruments import joints
from helpers.learned import learned_of, terms
from numpy.typing import NDArray

from ppmcal.calibration.compensation.commands import compensate
from ppmcal.calibration.compensation.pose_sigma import tolerance_sigma
from ppmcal.calibration.fit.fit_result import Fit, FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.diagnose import DiagnosisOptions
from ppmcal.diagnosis.held_out_gap import training_part
from ppmcal.diagnosis.learned_terms import learned_terms, visible
from ppmcal.diagnosis.learning import term
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.observed_directions import observed_motion
from ppmcal.diagnosis.term_candidates import all_settings, forms
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.registration import predict
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.effects.learned import JOINT, LearnedCurve, learned_kind
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism, with_effect
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]

SIGMA = 1e-5
"""Of every instrument, m and rad."""
FLAT = np.array([0.0, 0.0, 0.001, 0.001, -0.002, 0.0])
"""A bed as it is under a printer: hardly tilted."""
FROM = np.array([0.3, -0.2, -0.25])
"""Where distances are measured from, base frame, m."""
TERMS = {"a leg": ("travel", JOINT), "across": ("x", "y"), "along": ("x", "x"), "up": ("x", "z")}
"""What is hidden: an input, and what it acts on."""
INSTRUMENTS = {"pose": "3-RPR", "position": "delta-linear", "plane": "delta-linear",
               "distance": "delta-linear"}


def hidden(mechanism: Mechanism, term: str, q: Array, size: float) -> Mechanism:
    """Return the machine with a bent function of the middle 95 % of an input's range, m."""
    source, acts = TERMS[term]
    at = (q[:, 0] if acts == JOINT else
          pose_vector(reached_poses(Model(mechanism), q).pose)[:, 0])
    low, high = float(at.min()), float(at.max())
    nodes = np.linspace(low - 0.5 * (high - low), high + 0.5 * (high - low), 61)
    part = (nodes - low) / (high - low)
    curve = LearnedCurve(source, nodes, size * np.sin(9.0 * part), np.zeros((61, 61)), acts=acts)
    k = len(mechanism.actuators)
    on = tuple(acts != JOINT or i == 0 for i in range(k))
    return with_effect(mechanism, learned_kind(curve), on, {})


def measured(mechanism: Mechanism, instrument: str, real: Mechanism, q: Array,
             rng: np.random.Generator) -> Dataset:
    """Return what an instrument measures of the real machine, frame unknown where it is."""
    pose = pose_vector(reached_poses(Model(real), q).pose)
    found = Dataset.of_poses("d", q, np.full((len(q), 6), np.nan), (SIGMA, SIGMA), False)
    if instrument in ("pose", "position"):
        noisy = pose + SIGMA * rng.standard_normal(pose.shape)
        planar = mechanism.motion.planar
        noisy[:, [2, 3, 4] if planar else [3, 4, 5]] = np.nan
        return replace(found, kind=find_instrument(instrument), position=noisy[:, :3],
                       rotation=noisy[:, 3:])
    start = np.zeros(6)
    if instrument == "distance":
        value, start[:3] = np.linalg.norm(pose[:, :3] - FROM, axis=1), -FROM
    else:
        flat = Registration.of_pose(FLAT, np.zeros(3))
        value = predict(flat, pose_motor(pose))[0][:, 2]
    return replace(found, kind=find_instrument(instrument),
                   value=value + SIGMA * rng.standard_normal(len(q)),
                   sigma_value=np.full(len(q), SIGMA),
                   frame=Unknown(instrument == "plane", start))


def campaign(instrument: str, term: str, size: float = 5e-5) -> tuple[Fit, Mechanism, Array]:
    """Return a fit of geometry, the real machine, and joint values elsewhere."""
    name = INSTRUMENTS[instrument]
    mechanism = read_mechanism(CONFIGS / f"{name}.yaml")
    rng = np.random.default_rng(5)
    q = joints(mechanism, name, 110, rng)
    if instrument == "plane":
        # a bed is touched where it is
        pose = pose_vector(reached_poses(Model(mechanism), q).pose)
        pose[:, 2] = mechanism.home_pose[2]
        q = inverse(Model(mechanism), pose_motor(pose)).q
    g = mechanism.values.copy()
    for i in mechanism.free:
        g[i] += 0.3 * float(mechanism.parameters[i].tolerance or 0.0) * rng.standard_normal()
    real = hidden(mechanism.with_values(g), term, q, size)
    data = measured(mechanism, instrument, real, q[:90], rng)
    fit = identify(Problem(mechanism, (data,), mechanism.free), FitOptions(robust=False))
    return fit, real, q[90:]


def driven(real: Mechanism, q: Array, wanted: Array) -> float:
    """Return how far off the real machine is with commands, rms, m."""
    away = pose_vector(reached_poses(Model(real), q).pose)[:, :3] - wanted[:, :3]
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


# each instrument with a joint and with what it sees best and worst of the platform; a machine in
# the plane, which is what measures whole poses here, has no height
CASES = [("pose", "a leg"), ("pose", "along"), ("position", "across"), ("position", "up"),
         ("plane", "a leg"), ("plane", "along"), ("plane", "up"), ("distance", "a leg"),
         ("distance", "up")]
QUICK = (("pose", "a leg"), ("position", "up"), ("plane", "along"))


@pytest.mark.long_cases("plane-a leg", "distance-a leg")
@pytest.mark.slow_cases(
    "pose-a leg", "position-up", *(f"{i}-{t}" for i, t in CASES if (i, t) not in QUICK))
@pytest.mark.parametrize(("instrument", "term"), CASES)
def test_what_is_learned_does_no_harm(instrument: str, term: str) -> None:
    """With it the real machine is no worse than with geometry alone, and within tolerances."""
    whole, real, q = campaign(instrument, term)
    options = DiagnosisOptions(seed=1, fit=FitOptions(robust=False))
    base, held = training_part(whole, options)
    source, acts = TERMS[term]
    own = [(curve, on) for curve, on in forms(visible(whole, whole.keep, Whitening()),
                                              all_settings(whole))
           if (curve.inputs, curve.acts, curve.signed) == ((source,), acts, False)
           and (acts != JOINT or (on == (True, *on[1:]) and sum(on) == 1))]
    assert own or (instrument, acts) in (("plane", "x"), ("plane", "y"))    # seen by its tilt only
    found = learned_terms((base, base.keep), (whole, whole.keep), own, held, Whitening(), 1.0,
                          options) if own else None
    if found is None:
        assert instrument in ("plane", "distance")
        return
    nominal = Model(whole.problem.mechanism.nominal())
    wanted = pose_vector(reached_poses(nominal, q).pose)
    allowed, _ = tolerance_sigma(nominal, Registration(), wanted, q)
    errors = {}
    for name, fit in {"geometry": whole, "learned": found.fit}.items():
        machine = fit.problem.mechanism.with_values(fit.state.g)
        sent = compensate(machine, wanted, Registration())
        good = np.array([s == "ok" for s in sent.status])
        assert good.any()
        errors[name] = driven(real, sent.q[good], wanted[good])
    assert errors["learned"] < errors["geometry"]
    assert errors["learned"] < max(driven(real, q, wanted), float(np.sqrt(np.mean(allowed**2))))


def test_of_a_flat_only_its_height_is_seen() -> None:
    """However it is tilted by what is usual; a term along it is nothing that could be learned."""
    fit, _, _ = campaign("plane", "up")
    seen = visible(fit, fit.keep, Whitening())
    acts = {t.curve.acts for t in terms(fit, seen)}
    assert acts == {JOINT, "z"}


@pytest.mark.slow
def test_shapes_that_move_the_platform_along_the_flat_alone_are_none() -> None:
    """Where three towers err alike by their own travel, some shapes move it sideways only."""
    def freedom(instrument: str) -> tuple[int, int]:
        fit, _, _ = campaign(instrument, "up")
        seen = visible(fit, fit.keep, Whitening())
        mine = next(t for t in terms(fit, seen)
                    if t.curve.acts == JOINT and t.curve.input == "travel" and all(t.on))
        all_seen = replace(observed_motion(seen.system), seen=np.eye(6))
        own, other = (t.shapes[0].root.shape[1]
                      for t in (mine, term(seen, all_seen, mine.curve, mine.on)))
        return own, other

    flat, position = freedom("plane"), freedom("position")
    assert flat[0] < flat[1]
    assert position[0] == position[1]


@pytest.mark.slow
def test_a_term_is_as_large_as_rows_show() -> None:
    """Ten times as large where rows say so, and nothing in rows of the geometry alone."""
    fit, _, _ = campaign("position", "up")
    seen = visible(fit, fit.keep, Whitening())
    own = next(t for t in terms(fit, seen) if (t.curve.inputs, t.curve.acts) == (("x",), "z"))
    bent = own.shapes[-1].gauged(1e-4 * np.sin(9.0 * np.linspace(0.0, 1.0, own.curve.nodes.size)))
    noise = np.random.default_rng(7).standard_normal(len(own.columns))
    for part in (1.0, 0.1, 0.0):
        (found,) = learned_of(seen, own, part * own.columns @ bent + noise).curves
        sigma = np.sqrt(np.diag(found.covariance))
        assert np.all(np.abs(found.values - part * bent) < 4.0 * sigma)
        assert sigma.max() < 0.2 * np.abs(bent).max()
