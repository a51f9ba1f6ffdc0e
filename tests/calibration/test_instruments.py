"""Heights of a flat and distances: derivatives, what they can tell, and what they promise."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows
from helpers.instruments import BOX, SIGMA, Array, data_of, joints, truth
from helpers.paths import ROOT

from ppmcal.calibration.fit.fit_result import Fit, FitOptions, prediction_covariance
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.noise_estimate import noise_ratios, with_estimated_noise
from ppmcal.calibration.fit.problem import Problem
from ppmcal.io import read_mechanism
from ppmcal.model.mechanism import Mechanism

CONFIGS = ROOT / "configs"


def machine(name: str) -> Mechanism:
    return read_mechanism(CONFIGS / f"{name}.yaml")


CASES = [(m, k) for m in BOX for k in ("plane", "point", "pair")
         if not (m == "3-RPR" and k == "plane")]


def session(name: str, kind: str, n: int, seed: int, noise: float = 0.0, unknown: bool = True,
            scale: float = 0.3) -> tuple[Problem, Array]:
    rng = np.random.default_rng(seed)
    mechanism = machine(name)
    g = truth(mechanism, rng, scale)
    q = joints(mechanism, name, n, rng)
    second = joints(mechanism, name, n, rng) if kind == "pair" else None
    data = data_of(mechanism, "plane" if kind == "plane" else "distance", q, second, g, rng, noise,
                   unknown)
    return Problem(mechanism, (data,), mechanism.free), g


@pytest.mark.long_cases(
    "6-UPS-pair", "linapod-pair", "linapod-plane", "6-UPS-plane", "delta-rotary-plane",
    "delta-rotary-point")
@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_derivatives(name: str, kind: str) -> None:
    """Every column against central differences of the residuals, poses solved anew."""
    problem, _ = session(name, kind, 6, 3)
    data = replace(problem.datasets[0], sigma_actuator=np.full(
        problem.datasets[0].q.shape[1], 3e-6))
    for d in (problem.datasets[0], data):
        now = replace(problem, datasets=(d,))
        state = now.start()
        (exact,) = now.rows(state)
        scale = np.concatenate([np.full(len(now.free), 1e-5), 1e-2 * now.open_scale()])
        for c in range(len(now.columns)):
            step = np.zeros(len(now.columns))
            step[c] = scale[c]
            (up,) = now.rows(now.moved(state, step), False)
            (down,) = now.rows(now.moved(state, -step), False)
            slope = -(up.raw - down.raw) / (2.0 * scale[c])
            found = np.linalg.inv(exact.whitener) @ exact.jacobian[..., c][..., None]
            away = np.abs(found[..., 0] - slope)
            assert np.max(away) < 1e-5 * max(1.0, np.max(np.abs(slope))), now.columns[c]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_exact_data_are_fitted_exactly(name: str, kind: str) -> None:
    """To a part of the noise that the sidecar states: tolerances still pull a little."""
    problem, _ = session(name, kind, 80, 5)
    fit = identify(replace(problem, datasets=(replace(
        problem.datasets[0], sigma_value=np.full(80, 1e-6)),)))
    worst = max(float(np.max(np.abs(r.raw))) for r in fit.problem.rows(fit.state, False))
    assert fit.converged
    assert worst < 1e-6


def white_errors(fit: Fit, g: Array) -> Array:
    """Return each identified parameter's error over its promised standard deviation."""
    covariance = prediction_covariance(fit)
    free = list(fit.problem.free)
    sigma = np.sqrt(np.diagonal(covariance))[:len(free)]
    return np.asarray((fit.state.g[free] - g[free]) / sigma)


@pytest.mark.long_cases("linapod-plane")
@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [("6-UPS", "point"), ("6-UPS", "pair"),
                                            ("delta-linear", "plane"), ("linapod", "plane")])
def test_what_is_promised_is_kept(name: str, kind: str) -> None:
    """A draw wire, a ball bar, touches of a flat: 95 % intervals hold in 95 % (12 campaigns)."""
    errors = []
    for seed in range(12):
        problem, g = session(name, kind, 120, 50 + seed, SIGMA, scale=1.0)
        errors.append(white_errors(identify(problem, FitOptions(robust=False)), g))
    away = np.concatenate(errors)
    # errors of one campaign hang together: not more than 8 parameters count as independent
    spread = np.sqrt(0.95 * 0.05 / (12 * 8))
    assert abs(np.mean(np.abs(away) < 1.96) - 0.95) < 3.0 * spread
    assert 0.8 < np.sqrt(np.mean(away**2)) < 1.2


@pytest.mark.slow
def test_heights_alone_cannot_fix_scale() -> None:
    """Rods and radius of a delta grow together unseen; one distance settles it."""
    problem, g = session("delta-linear", "plane", 80, 9, SIGMA, unknown=False)
    other, _ = session("delta-linear", "point", 20, 9, SIGMA, unknown=False)
    alone = identify(problem)
    both = identify(replace(problem, datasets=(*problem.datasets, *other.datasets)))
    place = list(problem.free).index(problem.mechanism.names.index("rod"))

    def sigma(fit: Fit) -> float:
        return float(np.sqrt(prediction_covariance(fit)[place, place]))

    assert sigma(both) < 0.5 * sigma(alone)
    assert abs(both.state.g[problem.free[place]] - g[problem.free[place]]) < 4.0 * sigma(both)


def scenario(folder: Path, name: str, **changes: object) -> None:
    ppmcal("init", name, "--out", "m.yaml", "--force", cwd=folder, expect=0)
    content = yaml.safe_load((folder / "m.scenario.yaml").read_text())
    for gone in ("instrument", "frame", "target", "approach", "conditions", "effects"):
        content.pop(gone, None)
    (folder / "s.yaml").write_text(yaml.safe_dump(content | changes))


@pytest.mark.long
def test_commands_with_heights_and_distances(tmp_path: Path) -> None:
    """Simulated, fitted together, reported; residuals under their own names."""
    scenario(tmp_path, "delta-linear", instrument={"kind": "plane", "sigma": {"height": 0.01}},
             frame={"x": 0, "y": 0, "z": 3, "rx": 0.2, "ry": -0.1, "rz": 0})
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "a", cwd=tmp_path, expect=0)
    scenario(tmp_path, "delta-linear", instrument={
        "kind": "distance", "sigma": {"distance": 0.01}, "point": [250, 100, -50]}, frame="known")
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "b", cwd=tmp_path, expect=0)
    for folder, name in (("a", "touches"), ("b", "wire")):
        side = tmp_path / folder / "measurements.yaml"
        side.write_text(yaml.safe_dump(yaml.safe_load(side.read_text()) | {"name": name}))
    ppmcal("identify", "m.yaml", "a/measurements.csv", "b/measurements.csv", "--out", "i",
           cwd=tmp_path, expect=0)
    alone = ppmcal("identify", "m.yaml", "a/measurements.csv", "--out", "h", cwd=tmp_path,
                   expect=0)
    assert "Constrained by the prior" in alone.out
    ratio = {}
    for folder in "hi":
        found = json.loads((tmp_path / folder / "identification.json").read_text())
        ratio[folder] = next(p["of_tolerance"] for p in found["parameters"] if p["name"] == "rod")
    assert ratio["h"] > 0.9
    assert ratio["i"] < 0.7
    table = rows(tmp_path / "i" / "residuals.csv")
    touches = [r for r in table if r["dataset"] == "touches"]
    assert all(abs(float(r["after_height"])) < 0.06 for r in touches)
    assert all(r["after_distance"] == "nan" for r in touches)
    model = yaml.safe_load((tmp_path / "i" / "identified.yaml").read_text())
    wire = model["measurement"]["datasets"]["wire"]["frame"]
    assert abs(wire["x"] + 250) < 2.0
    assert abs(model["measurement"]["datasets"]["touches"]["frame"]["z"] - 3.0) < 1.0
    ppmcal("report", "a", "i", "--out", "r", cwd=tmp_path, expect=0)


@pytest.mark.long
def test_backlash_in_touches_of_a_flat(tmp_path: Path) -> None:
    """Few rows of one number each: what alternates is not taken for correlated noise."""
    scenario(tmp_path, "delta-linear", instrument={"kind": "plane", "sigma": {"height": 0.01}},
             approach="both", frame="known",
             effects=[{"kind": "backlash", "parameters": {"width": 0.05}}])
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "a", cwd=tmp_path, expect=0)
    ppmcal("diagnose", "m.yaml", "a/measurements.csv", cwd=tmp_path)
    found = json.loads((tmp_path / "diagnosed" / "diagnosis.json").read_text())
    (effect,) = found["effects"]
    assert effect["kind"] == "backlash"
    width = effect["parameters"]["width"]
    assert abs(width["value"] - 0.05) < 4.0 * width["sigma"] < 0.05


def test_a_planar_machine_touches_no_flat(tmp_path: Path) -> None:
    scenario(tmp_path, "3-RPR", instrument={"kind": "plane", "sigma": {"height": 0.01}})
    run = ppmcal("simulate", "m.yaml", "s.yaml", "--out", "a", cwd=tmp_path, expect=2)
    assert "s.yaml: instrument.kind" in run.err


@pytest.mark.slow
def test_noise_of_each_instrument_is_found() -> None:
    """Stated noise off by 3 and by 0.4: estimated within its own uncertainty, weights right."""
    found = []
    for seed in range(3):
        heights, g = session("delta-linear", "plane", 80, 100 + seed, 3.0 * SIGMA, scale=1.0)
        points, _ = session("delta-linear", "point", 60, 100 + seed, 0.4 * SIGMA, scale=1.0)
        both = replace(heights, datasets=(*heights.datasets, *points.datasets))
        fit, factor = with_estimated_noise(both, FitOptions(robust=False))
        found.append(factor / [3.0, 0.4])
        again, redundancy = noise_ratios(fit)
        assert np.allclose(again, 1.0, atol=0.02)
        assert redundancy.sum() < 140
        assert np.all(np.abs(white_errors(fit, g)) < 5.0)
    # one estimate is good to 1/sqrt(2 n), n about 70 and 50
    assert np.allclose(np.mean(found, axis=0), 1.0, atol=3.0 * 0.1 / np.sqrt(3))


@pytest.mark.slow
def test_a_wrong_sigma_is_estimated_on_request(tmp_path: Path) -> None:
    scenario(tmp_path, "delta-linear", instrument={"kind": "plane", "sigma": {"height": 0.05}},
             frame="known")
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "a", cwd=tmp_path, expect=0)
    side = tmp_path / "a" / "measurements.yaml"
    side.write_text(side.read_text().replace("height: 0.05", "height: 0.01"))
    wrong = ppmcal("identify", "m.yaml", "a/measurements.csv", cwd=tmp_path, expect=1)
    assert "noise" in wrong.out
    run = ppmcal("identify", "m.yaml", "a/measurements.csv", "--sigma", "estimated", "--out", "e",
                 cwd=tmp_path, expect=0)
    factor = float(run.out.split("noise ")[1].split(" times")[0])
    assert 3.5 < factor < 6.5
    ppmcal("identify", "m.yaml", "a/measurements.csv", "--sigma", "estimated", "--method", "damped",
           "--out", "f", cwd=tmp_path, expect=2)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "repeats"), [("delta-linear", 1), ("6-UPS", 2)])
def test_distances_between_positions_are_simulated_and_identified(
        tmp_path: Path, name: str, repeats: int) -> None:
    """simulate writes to_q columns; identify reads them, and the noise is the stated one."""
    home = machine(name).home_pose / ([1e-3] * 3 + [np.pi / 180] * 3)
    turns = machine(name).motion.turns_freely
    box = {"x": 60, "y": 60, "z": 50} | ({"rx": 6, "ry": 6, "rz": 6} if turns else {})
    center = dict(zip(box, home[:len(box)].tolist(), strict=True))
    scenario = {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": center, "half_range": box, "count": 101}},
        "errors": {"random": {"scale": 0.3}}, "repeats": repeats, "approach": "one", "seed": 4,
        "instrument": {"kind": "distance", "between": "positions", "sigma": {"distance": 0.01}}}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
    config = CONFIGS / f"{name}.yaml"
    ppmcal("simulate", config, "s.yaml", "--out", "sim", cwd=tmp_path, expect=0)
    table = rows(tmp_path / "sim" / "measurements.csv")
    assert len(table) == 101 * repeats
    ends = {(r["pose"], *(r[c] for c in r if c.startswith("to_q_"))) for r in table}
    assert len(ends) == 101
    found = ppmcal("identify", config, "sim/measurements.csv", "--json", cwd=tmp_path,
                   expect=0).json
    assert found["noise"]["sigma_ratio"] == pytest.approx(1.0, abs=0.25)
    assert found["noise"]["chi2_p"] > 1e-3


@pytest.mark.parametrize(("change", "words"), [
    ({"kind": "pose"}, "only distances without a fixed point"),
    ({"point": [0, 0, 0]}, "only distances without a fixed point"),
    ({"between": "poles"}, "positions")])
def test_odd_distances_are_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    instrument = {"kind": "distance", "between": "positions", "sigma": {"distance": 0.01}} | change
    (tmp_path / "s.yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": {"x": 0, "y": 0, "z": 0}, "half_range": {"x": 10},
                             "count": 5}}, "instrument": instrument}))
    run = ppmcal("simulate", CONFIGS / "delta-linear.yaml", "s.yaml", cwd=tmp_path, expect=2)
    assert words in run.err
