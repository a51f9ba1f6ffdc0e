"""Calibration where limbs gap: intervals that cover, limits, and what files say of it."""

import json

import numpy as np
import pytest
import yaml
from helpers.redundant import alone, belts, cables, gapped, machine, stewart, written

import ppmcal
from ppmcal.calibration.fit import (
    FitOptions,
    Problem,
    by_defining,
    identify,
    noise_check,
    posterior,
)
from ppmcal.calibration.validation import residuals
from ppmcal.commands.inputs import prepared
from ppmcal.errors import BadInput
from ppmcal.io.mechanism_writer import write_mechanism

HALF = {"x": 900, "y": 700}


def fitted(folder, tree, sigma=0.0, seed=7, **more):
    """Return a simulated campaign of joint values alone, and what is identified from it."""
    path = written(folder, tree)
    made = ppmcal.simulate(path, alone(tree, HALF, sigma=sigma, seed=seed, count=25, **more))
    return made, ppmcal.identify(path, made.data[0], holdout=0.0)


@pytest.mark.long
def test_intervals_cover_where_gaps_are_all_the_noise(tmp_path):
    """Forty machines: chi-squared of the errors in the frames defined, by the covariance told."""
    tree = {**gapped(belts(), (0.5, 0.2, 0.3, 0.1)), "tolerances": {"point": 4}}
    path = written(tmp_path, tree)
    square, freedom, ratio = 0.0, 0, []
    for seed in range(40):
        made = ppmcal.simulate(path, alone(tree, HALF, sigma=0.0, seed=seed, count=25))
        mechanism, data = prepared(path, made.data[0])
        free = list(mechanism.free)
        fit = identify(Problem(mechanism, data, mechanism.free), FitOptions(robust=False))
        # the true values, seen from the frames that held points define
        held = list(mechanism.defining)
        off = made.campaign.g[held] - fit.state.g[held]
        away = (made.campaign.g - fit.state.g)[free] - by_defining(
            mechanism.with_values(fit.state.g), data, free) @ off
        square += away @ np.linalg.solve(posterior(fit), away)
        freedom += len(free)
        ratio.append(noise_check(fit).sigma_ratio)
    # chi-squared of 200 numbers: 0.9 to 1.1 is twice its spread, frames add a little
    assert 0.75 < square / freedom < 1.3
    assert 0.93 < np.sqrt(np.mean(np.square(ratio))) < 1.07


@pytest.mark.long
def test_gaps_of_next_to_nothing_change_no_number(tmp_path):
    _, plain = fitted(tmp_path, belts(), 0.3)
    path = written(tmp_path, gapped(belts(), (1e-7,)), "gapped.yaml")
    made = ppmcal.simulate(written(tmp_path, belts()), alone(belts(), HALF, sigma=0.3, count=25))
    small = ppmcal.identify(path, made.data[0], holdout=0.0)
    np.testing.assert_allclose(small.mechanism.values, plain.mechanism.values, atol=1e-9)
    np.testing.assert_allclose(posterior(small.identification.fit),
                               posterior(plain.identification.fit), rtol=1e-6, atol=1e-15)


@pytest.mark.slow
def test_a_limb_that_gaps_counts_less(tmp_path):
    """Its residuals are told with what it may gap, the others' with their drives' noise."""
    _, found = fitted(tmp_path, gapped(belts(), (3.0, 0.0, 0.0, 0.0)), 0.2)
    fit = found.identification.fit
    sigma = residuals(fit.problem, fit.state).sigma[0]
    np.testing.assert_allclose(sigma[:, 0], np.hypot(3e-3, 2e-4), rtol=0.01)
    np.testing.assert_allclose(sigma[:, 1:], 2e-4, rtol=0.01)
    assert 0.7 < found.identification.noise.sigma_ratio < 1.3


@pytest.mark.long
def test_where_nobody_says_it_joints_are_exact_if_all_limbs_gap(tmp_path):
    """No `actuator` in the sidecar: with an instrument, and by joint values alone."""
    made, found = fitted(tmp_path, gapped(belts()))
    assert not np.any(found.identification.fit.problem.sigma_joints[0])
    assert "actuator" not in made.files()["measurements.yaml"]
    _, some = fitted(tmp_path, gapped(belts(), (0.3, 0.0)), 0.1)
    assert np.all(some.identification.fit.problem.sigma_joints[0] > 0.0)


@pytest.mark.slow
def test_it_is_written_back_as_the_file_has_it(tmp_path):
    tree = gapped(cables(), (0.3, 0.0, 0.2, 0.1))
    mechanism = machine(tmp_path, tree)
    assert mechanism.gaps == pytest.approx({"c0": 3e-4, "c2": 2e-4, "c3": 1e-4})
    assert yaml.safe_load(write_mechanism(mechanism))["closure"] == {
        "sigma": {"c0": 0.3, "c2": 0.2, "c3": 0.1}}
    for sigma in (0.25, {f"c{i}": 0.25 for i in range(4)}):
        both = machine(tmp_path, {**cables(), "closure": {"sigma": sigma}})
        assert yaml.safe_load(write_mechanism(both))["closure"] == {"sigma": 0.25}
    _, found = fitted(tmp_path, gapped(belts()))
    found.save(tmp_path / "found")
    again = ppmcal.load(tmp_path / "found" / "identified.yaml")
    assert again.gaps == found.mechanism.gaps != {}
    assert "closure" not in yaml.safe_load(write_mechanism(machine(tmp_path, cables())))
    assert not machine(tmp_path, {**cables(), "closure": {"sigma": 0}}).gaps


@pytest.mark.parametrize(("tree", "closure", "place", "said"), [
    (cables, {"sigma": {"c9": 0.1}}, "closure.sigma", "'c9'.*c0, c1, c2, c3"),
    (cables, {"sigma": -0.1}, "closure.sigma", "-0.1 is not a standard deviation.*0 or more"),
    (cables, {"sigma": {"c1": -1}}, "closure.sigma", "-1 is not a standard deviation"),
    (cables, {"sigma": "wide"}, "closure.sigma", "'wide' is not a standard deviation"),
    (cables, {"sigma": 1e9}, "closure.sigma", "implausible"),
    (cables, {"sigma": 1e-15}, "closure.sigma", "below the round-off.*or 0"),
    (cables, {}, "closure", "sigma"),
    (cables, {"gap": 1}, "closure", "'gap'.*sigma"),
    (cables, 0.1, "closure", "sigma"),
    (lambda: stewart(6), {"sigma": 0.1}, "closure", "6 conditions on 6 coordinates.*no other than "
     "noise of the drives.*sidecar")], ids=[
    "unknown limb", "negative", "negative limb", "word", "large", "small", "empty", "other key",
    "bare number", "no surplus"])
def test_what_cannot_be_meant_is_refused(tree, closure, place, said, tmp_path):
    with pytest.raises(BadInput, match=f"(?s){place}.*{said}|{said}.*{place}"):
        machine(tmp_path, {**tree(), "closure": closure})


SIDECAR = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"}}


def both_ways(folder):
    """Return a machine's file with its sidecar: as what ropes gap, and as their drives' noise."""
    out = []
    for name, tree, sigma in (("gaps", gapped(belts(), (0.3,)), {}),
                              ("drives", belts(), {"actuator": 0.3})):
        (folder / name).mkdir()
        instrument = {"instrument": {"kind": "none", "sigma": sigma}}
        (folder / name / "none.yaml").write_text(yaml.safe_dump({**SIDECAR, **instrument}))
        out.append((written(folder / name, tree), instrument, folder / name / "none.yaml"))
    return out


@pytest.mark.long
def test_a_gap_of_ropes_is_as_good_as_their_drives_noise(tmp_path):
    """What is planned, identified and validated is the same by either."""
    made = ppmcal.simulate(written(tmp_path, belts()), alone(belts(), HALF, sigma=0.3, count=60))
    tables = [{f"q_{n}": q[half] * 1e3 for n, q in zip(
        ("bl", "br", "tr", "tl"), made.campaign.q.T, strict=True)}
        for half in (slice(0, 30), slice(30, 60))]
    told = []
    for path, instrument, sidecar in both_ways(tmp_path):
        data = [ppmcal.read_data(path, table, sidecar=instrument) for table in tables]
        found = ppmcal.identify(path, data[0], holdout=0.0)
        checked = ppmcal.validate(found.mechanism, data[1])
        planned = ppmcal.plan(path, instrument=sidecar, count=8)
        told.append((found, checked, planned))
    one, other = (t[0].identification for t in told)
    np.testing.assert_allclose(one.mechanism.values, other.mechanism.values, atol=2e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(one.covariance)),
                               np.sqrt(np.diag(other.covariance)), rtol=2e-3)
    assert one.noise.sigma_ratio == pytest.approx(other.noise.sigma_ratio, rel=1e-3)
    records = [json.loads(t[1].files()["validation.json"]) for t in told]
    model, same = (r["datasets"][0]["errors"][0] for r in records)
    for what in ("rms", "p95", "max"):
        assert model["closure"][what] == pytest.approx(same["closure"][what], rel=1e-3)
    assert model["noise"] == pytest.approx(same["noise"], rel=1e-3)
    assert 0.5 < model["noise"] < 2.0
    chosen = [[line.split(",") for line in t[2].files()["poses.csv"].splitlines()] for t in told]
    assert chosen[0] == chosen[1]


def test_without_noise_of_joints_or_gaps_of_all_limbs_nothing_is_read(tmp_path):
    """The refusal names both."""
    table = {f"q_{name}": np.full(20, 1800.0) for name in ("bl", "br", "tr", "tl")}
    for tree in (belts(), gapped(belts(), (0.3, 0.0))):
        with pytest.raises(BadInput, match=r"may gap, `closure: \{sigma: 0.2\}` in the mechanism"):
            ppmcal.read_data(written(tmp_path, tree), table,
                             sidecar={"instrument": {"kind": "none", "sigma": {}}})
