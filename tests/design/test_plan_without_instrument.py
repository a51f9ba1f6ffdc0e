"""Plans for joint values alone: gauge, predicted against fitted sigmas, and what fixes scale."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT

import ppmcal
from ppmcal.calibration.fit import with_gauge
from ppmcal.design.plan.path import moves
from ppmcal.design.plan.plan import PlanOptions, plan
from ppmcal.design.virtual_instrument import default_instrument
from ppmcal.io.mechanism_reader import read_mechanism
from ppmcal.io.results.plan_wording import sentences
from ppmcal.io.sidecar import read_instrument
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, moved
from ppmcal.kinematics.inverse import inverse

COUNT = 15
CONFIGS = ROOT / "configs"


@pytest.fixture(scope="module")
def none(tmp_path_factory):
    """Return the sidecar of joint values alone."""
    path = tmp_path_factory.mktemp("none") / "none.yaml"
    path.write_text("format: ppmcal/dataset/1\nunits: {length: mm, angle: deg}\n"
                    "instrument: {kind: none, sigma: {actuator: 0.3}}\n")
    return path


@pytest.fixture(scope="module")
def chosen(none):
    mechanism = read_mechanism(CONFIGS / "maslow.yaml")
    return plan(mechanism, read_instrument(none, mechanism), PlanOptions(COUNT, 3))


def predicted(found, rows):
    """Return sigma by column, SI, of a fit to some rows of the offer."""
    covariance = np.linalg.inv(found.offer.information(np.asarray(rows)))
    return dict(zip(found.offer.names, np.sqrt(np.diag(covariance)) * found.offer.scale,
                    strict=True))


@pytest.mark.slow
def test_the_gauge_is_that_of_identify(chosen):
    mechanism = read_mechanism(CONFIGS / "maslow.yaml")
    data = chosen.instrument.dataset(chosen.pool.q, chosen.pool.pose, {}, mechanism)
    assert chosen.mechanism.free == with_gauge(mechanism, [data]).free
    said = sentences(chosen, None, ())
    assert sum("define the frames" in s for s in said) == 1
    assert any("in the base's frame" in s for s in said)
    assert any(s.startswith("Without an instrument: joint values alone") for s in said)
    assert not any("Scale" in s for s in said)


@pytest.mark.slow
def test_planned_places_tell_more_than_random_ones(chosen):
    own = predicted(chosen, chosen.rows)
    rng = np.random.default_rng(5)
    even = np.flatnonzero(chosen.pool.even[chosen.offer.pose])
    strangers = [predicted(chosen, rng.choice(even, COUNT, replace=False)) for _ in range(20)]
    for name, sigma in own.items():
        assert sigma < np.mean([s[name] for s in strangers]), name


@pytest.mark.slow
def test_predicted_sigmas_are_those_of_a_fit(chosen):
    mechanism = read_mechanism(CONFIGS / "maslow.yaml")
    pose = chosen.offer.pose[chosen.rows]
    data = chosen.instrument.dataset(chosen.pool.q[pose], chosen.pool.pose[pose], {}, mechanism)
    noise = np.random.default_rng(6).normal(size=data.q.shape) * 3e-4
    found = ppmcal.identify(mechanism, replace(data, q=data.q + noise)).identification
    sigma = dict(zip(found.columns, np.sqrt(np.diag(found.covariance)), strict=True))
    for name, value in predicted(chosen, chosen.rows).items():
        assert sigma[name] == pytest.approx(value, rel=0.05), name


@pytest.mark.long
def test_one_distance_fixes_the_scale_where_ratios_are_free(none, tmp_path):
    tree = yaml.safe_load((CONFIGS / "maslow.yaml").read_text())
    for limb in tree["limbs"]:
        limb["ratio"] = {"share": "per_unit", "value": 1, "tolerance": 0.01}
    path = tmp_path / "maslow.yaml"
    path.write_text(yaml.safe_dump(tree))
    mechanism = read_mechanism(path)
    found = plan(mechanism, read_instrument(none, mechanism), PlanOptions(COUNT, 3))
    (said,) = (s for s in sentences(found, None, ()) if s.startswith("Scale"))
    assert "the data alone leave it open" in said and "One distance of at least" in said
    assert "between rows" in said


@pytest.mark.slow
def test_places_are_those_where_all_ropes_can_pull(chosen):
    """Between the anchors: beyond them two ropes cannot pull against the others."""
    x, y = chosen.pool.pose[:, :2].T
    assert ((x > 0.0) & (x < 3.0) & (y > 0.0) & (y < 2.1)).all()
    assert chosen.pool.left_out["with slack ropes"] > 0
    (said,) = (s for s in sentences(chosen, None, ()) if s.startswith("Chosen from"))
    assert "with slack ropes" in said


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cable-4-planar", "cable-8"])
def test_ways_of_surplus_limbs_are_those_of_the_platform(name):
    """Ropes whose lengths went straight from place to place would contradict each other."""
    mechanism = read_mechanism(CONFIGS / f"{name}.yaml")
    model = Model(mechanism)
    step = np.zeros((2, 6))
    step[:, mechanism.dof] = np.array([[-0.15], [0.15]])
    step[:, 3:] = 0.0
    pose = moved(np.tile(mechanism.home, (2, 1)), step)
    q = inverse(model, pose).q
    assert moves(mechanism, q[:1], q[1:]) == ("",)
    middle = forward(model, q.mean(axis=0, keepdims=True)).pose
    assert np.abs(model.closure(q.mean(axis=0, keepdims=True)).lengths(middle)).max() > 1e-3
    far = q[1:] + 10.0 * mechanism.reach
    assert moves(mechanism, q[:1], far) != ("",)


@pytest.mark.long
def test_a_guessed_instrument_says_that_none_is_needed():
    for name, said in (("maslow", True), ("3-RPR", False)):
        mechanism = read_mechanism(CONFIGS / f"{name}.yaml")
        found = plan(mechanism, default_instrument(mechanism), PlanOptions(8, 3))
        assert ("`instrument: {kind: none}`" in " ".join(sentences(found, None, ()))) is said
