"""What is left is learned: hidden shapes outside of the library, none where there is none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import real_priors
import yaml
from helpers.commands import ppmcal
from helpers.learned import (
    ROBUST,
    WEATHER,
    campaign,
    diagnosed,
    dip,
    fitted,
    hidden,
    learned_of,
    squared,
    terms,
)

import ppmcal as face
from ppmcal.calibration.fit.fit_result import Fit, FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.diagnosis.held_out_gap import measure_gap, training_part
from ppmcal.diagnosis.learned_terms import visible
from ppmcal.diagnosis.learning import Shape, Term, learned
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.term_candidates import Visible, columns_from
from ppmcal.io import read_mechanism
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

ROD, RADIUS = 300.0, 150.0


def touches(size: float, count: int = 15) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Return a linear delta and touches of a level bed, and of waves of it, mm."""
    turns = np.radians([210.0, 330.0, 90.0])
    start = {"radius": RADIUS, "arms": [ROD] * 3, "angles": np.degrees(turns).tolist(),
             "stepdists": [0.01] * 3, "endstops": [0.0] * 3}
    grid = np.linspace(-70.0, 70.0, count)
    x, y = (v.ravel() for v in np.meshgrid(grid, grid))
    rng = np.random.default_rng(3)
    wave = size * np.sin(x / 9.0) * np.sin(y / 9.0) + 0.02 * rng.standard_normal(x.size)
    away = np.hypot(x[:, None] - RADIUS * np.cos(turns), y[:, None] - RADIUS * np.sin(turns))
    carriage = wave[:, None] + np.sqrt(ROD**2 - away**2)
    steps = (np.sqrt(ROD**2 - RADIUS**2) - carriage) / 0.01
    rows = np.column_stack([np.zeros(x.size), steps]).tolist()
    return real_priors.machine({"heights": rows, "distances": [], "geometry_start": start}, "fixed")


def test_a_level_bed_is_not_explained_by_its_own_height() -> None:
    """The predicted height of one plane is the residual itself; what nothing feels is no term."""
    mechanism, data = touches(0.1)
    fit = identify(Problem(mechanism, data, mechanism.free), FitOptions(robust=False))
    seen = visible(fit, fit.keep, Whitening())
    tried = terms(fit, seen)
    inputs = {(t.curve.input, t.curve.acts) for t in tried}
    assert {("x", "z"), ("y", "z"), ("travel", "joint")} <= inputs
    assert not any(i == "z" or acts in ("x", "y") for i, acts in inputs)
    # each can be judged
    assert all(s.root.shape[1] for t in tried for s in t.shapes)


@pytest.mark.long
def test_waves_of_a_level_bed_are_not_explained_away() -> None:
    mechanism, data = touches(0.1, 11)
    found = diagnose(Problem(mechanism, data, mechanism.free))
    assert found.verdict in ("unnamed", "partial")
    if found.learned is not None:
        # the waves are of x and y together, which no term of one input can be
        assert found.learned.gap.after > 1.0


def bowl(size: float = 0.03) -> list[dict[str, Any]]:
    """A bent bed: the platform is turned with x^2 and y^2."""
    x, y = np.linspace(430.0, 570.0, 41), np.linspace(220.0, 360.0, 41)
    return [hidden("x", x, size * ((x - 500.0) / 60.0) ** 4, acts="y"),
            hidden("y", y, size * ((y - 290.0) / 60.0) ** 4, acts="x")]


def told(folder: Path, effects: list[dict[str, Any]]) -> Mechanism:
    """Return the machine that knows what is hidden."""
    tree = yaml.safe_load((folder / "m.yaml").read_text())
    (folder / "told.yaml").write_text(yaml.safe_dump(tree | {"effects": effects}))
    return read_mechanism(folder / "told.yaml")


SHAPES = {"dip": [dip()], "speed squared": [squared()], "bowl": bowl()}


@pytest.mark.long
@pytest.mark.parametrize("shape", SHAPES)
def test_most_of_the_gap_is_closed_that_the_truth_closes(tmp_path: Path, shape: str) -> None:
    seed = 1
    mechanism, data = campaign(tmp_path, SHAPES[shape], seed, count=80)
    base, held = training_part(fitted(mechanism, data), DiagnosisOptions(seed=seed))
    found = diagnosed(mechanism, data, seed).learned
    assert found is not None
    best = measure_gap(base, with_mechanism(base, told(tmp_path, SHAPES[shape]), ROBUST), held, 1.0,
                       seed)
    assert best is not None
    assert best.closed is not None
    assert found.gap.closed is not None
    assert found.gap.confirmed
    assert found.gap.closed >= 0.8 * best.closed
    assert all(p.fixed for p in found.fit.problem.mechanism.parameters
               if p.name.startswith("learned."))


def of_leg2(fit: Fit, seen: Visible, *inputs: str) -> Term:
    """Return the function of one leg that follows some inputs."""
    (own,) = [t for t in terms(fit, seen) if t.curve.inputs == inputs
              and not t.curve.signed and t.on == (False, True, False)]
    return own


def shape_of(own: Term) -> Shape:
    """Return the likeliest shape of a term."""
    return own.shapes[own.likeliest]


def hidden_in(seen: Visible, own: Term, true: Callable[..., Array]) -> Array:
    """Return what rows (n,) have of any function of a term's inputs, white."""
    return columns_from(seen, own.curve.acts, own.on, [
        true(*own.curve.seen(p.setting))[..., None] for p in seen.system.parts])[:, 0]


def inside(seen: Visible, own: Term, true: Callable[..., Array], seed: int,
           at: Sequence[Array]) -> float:
    """Return the part of inputs at which the band of what is learned of a function has it."""
    there = hidden_in(seen, own, true)
    noise = np.random.default_rng(seed).standard_normal(there.size)
    found = learned_of(seen, own, there + noise)
    (curve,), (own,) = found.curves, found.terms
    nodes = np.meshgrid(*[curve.nodes, curve.by_nodes][:len(at)], indexing="ij")
    basis = curve.basis(*at)
    sigma = np.sqrt(np.einsum("ij,jk,ik->i", basis, curve.covariance, basis))
    away = basis @ (curve.values - shape_of(own).gauged(true(*(x.ravel() for x in nodes))))
    return float(np.mean(np.abs(away) <= 1.96 * sigma))


@pytest.mark.slow
def test_the_band_holds_the_truth(tmp_path: Path) -> None:
    """In the rows of one campaign, dip and noise drawn anew: pointwise over the range, what
    geometry does as well taken out of both.
    """
    fit = fitted(*campaign(tmp_path, [], 1, count=50))
    seen = visible(fit, fit.keep, Whitening())
    own = of_leg2(fit, seen, "travel")
    at = np.linspace(own.curve.nodes[0], own.curve.nodes[-1], 100)[2:-2]
    held = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        effect = dip(rng.uniform(395.0, 485.0), rng.uniform(15.0, 45.0), 0.02)

        def true(x: Array, effect: dict[str, Any] = effect) -> Array:
            return 1e-3 * np.interp(1e3 * x, effect["nodes"], effect["values"])

        held.append(inside(seen, own, true, seed, [at]))
    assert 0.93 <= np.mean(held) <= 0.97, np.mean(held)


@pytest.mark.slow
def test_the_band_of_two_inputs_holds_the_truth(tmp_path: Path) -> None:
    """In the rows of one campaign, noise drawn anew: waves of travel that grow with temperature.

    What each of the inputs does by itself is in it.
    """
    fit = fitted(*campaign(tmp_path, [], 1, count=50, conditions=WEATHER))
    seen = visible(fit, fit.keep, Whitening())
    own = of_leg2(fit, seen, "travel", "temperature")
    at = [np.concatenate([i[:, 1] for i in both]) for both in zip(*(
        own.curve.seen(p.setting) for p in seen.system.parts), strict=True)]
    held = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        wave, phase, zero = rng.uniform(0.12, 0.3), rng.uniform(0.0, 6.0), rng.uniform(-10.0, 5.0)

        def true(x: Array, warm: Array, wave: float = wave, phase: float = phase,
                 zero: float = zero) -> Array:
            return np.asarray(2e-5 * np.cos(2.0 * np.pi * x / wave + phase) * (warm - zero) / 10.0)

        held.append(inside(seen, own, true, seed, at))
    assert 0.93 <= np.mean(held) <= 0.97, np.mean(held)


@cache
def _seen() -> tuple[Fit, Visible]:
    """Rows of a machine with a dip, made once."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        fit = fitted(*campaign(Path(folder), [dip()], 1, count=30))
        return fit, visible(fit, fit.keep, Whitening())


@pytest.mark.long
def test_what_is_learned_is_free_of_what_geometry_does() -> None:
    """A free offset: no constant is learned, so the term moves no zero of a joint."""
    fit, seen = _seen()
    own = of_leg2(fit, seen, "travel")
    assert np.abs(seen.basis.T @ own.free).max() < 1e-9 * np.abs(own.columns).max()
    (curve,) = learned(seen, [(own.curve, own.on)]).curves
    constant = np.ones(curve.nodes.size)
    for shape in own.shapes:
        assert shape.lost.shape[1] >= 1
        np.testing.assert_allclose(shape.held @ shape.root, 0.0, atol=1e-6 * np.abs(
            shape.held).max() * np.abs(shape.root).max())
        assert np.linalg.norm(own.columns @ shape.gauged(constant)) < 0.25 * np.linalg.norm(
            own.columns @ constant)
        # of what is learned, and of what it may be besides, nothing is of that kind
        for values in (curve.values, *curve.modes.T):
            assert np.linalg.norm(own.columns @ (values - shape.gauged(values))) < (
                0.02 * np.linalg.norm(own.columns @ curve.values))


@pytest.mark.slow
def test_nothing_is_learned_of_noise() -> None:
    """Rows of geometry and noise alone: the term is nothing beside what it may be."""
    fit, seen = _seen()
    own = of_leg2(fit, seen, "travel")
    noise = np.random.default_rng(4).standard_normal(seen.system.residual.size)
    (quiet,), (dipped,) = (found.curves for found in (
        learned_of(seen, own, noise), learned(seen, [(own.curve, own.on)])))
    sigma = np.sqrt(np.diag(quiet.covariance))
    assert np.all(np.abs(quiet.values) < 3.0 * sigma)
    assert np.abs(quiet.values).max() < 0.05 * np.abs(dipped.values).max()


@pytest.mark.long
def test_a_diagnosis_learns_and_its_model_helps_the_next_session(tmp_path: Path) -> None:
    """From files: the verdict stays, the model has the term, another session fits it better."""
    campaign(tmp_path, [dip(deep=0.06)], 5, count=60)
    run = ppmcal("diagnose", "m.yaml", "s/measurements.csv", "--out", "d",
                 cwd=tmp_path)
    assert run.code == 1
    found = yaml.safe_load((tmp_path / "d" / "diagnosis.json").read_text())
    assert found["verdict"] in ("unnamed", "partial")
    (entry,) = found["learned"]
    assert (entry["input"], entry["on"], entry["acts"]) == ("travel", ["leg2"], "joint")
    assert entry["unit"] == entry["input_unit"] == "mm"
    assert entry["gap"]["after"] < entry["gap"]["before"]
    at = np.interp(440.0, entry["x"], entry["value"]) - np.median(entry["value"])
    assert at == pytest.approx(-0.06, abs=0.015)
    assert "Learned, with no cause claimed: error of leg2 by its travel" in run.out
    assert (tmp_path / "d" / "terms.svg").exists()
    model = yaml.safe_load((tmp_path / "d" / "model.yaml").read_text())
    (term,) = [e for e in model["effects"] if e["kind"] == "learned"]
    assert term["nodes"][0] == pytest.approx(entry["low"])
    # the same machine again, from elsewhere
    plan = yaml.safe_load((tmp_path / "s.yaml").read_text())
    half = {k: 0.9 * v for k, v in plan["poses"]["random"]["half_range"].items()}
    truth = yaml.safe_load((tmp_path / "s" / "truth.json").read_text())
    plan |= {"errors": truth["errors"], "frame": {"x": -20, "y": 11, "rz": -3}, "seed": 77}
    plan["poses"]["random"] |= {"half_range": half, "count": 25}
    (tmp_path / "again.yaml").write_text(yaml.safe_dump(plan))
    ppmcal("simulate", "m.yaml", "again.yaml", "--out", "again", cwd=tmp_path, expect=0)
    without = {**model, "effects": [e for e in model["effects"] if e is not term]}
    (tmp_path / "without.yaml").write_text(yaml.safe_dump(without))
    (tmp_path / "with.yaml").write_text(yaml.safe_dump(model))
    fits = [face.identify(str(tmp_path / f"{w}.yaml"), str(tmp_path / "again/measurements.csv"),
                          free="none", keep_outliers=True) for w in ("without", "with")]
    rms = [f.record.entries()["residual"]["after"]["position"]["rms"] for f in fits]
    assert rms[1] < 0.6 * rms[0]
