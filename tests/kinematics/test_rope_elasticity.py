"""Ropes that stretch and sag: a plotter on two ropes, solved as a balance of forces by SciPy."""

import numpy as np
import pytest
import yaml
from helpers.machines import read_text
from helpers.paths import ROOT
from helpers.redundant import written
from scipy.integrate import quad
from scipy.optimize import brentq, fsolve

import ppmcal
from ppmcal import algebra as cga
from ppmcal.errors import BadInput
from ppmcal.io.mechanism_writer import write_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import setting
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.needed_columns import missing_columns
from ppmcal.model.dataset import environment

ANCHORS = np.array([[0.0, 0.0], [2.0, 0.1]])
ELONGATION, WEIGHT, MASS = 4e-5, 0.12, 2.0      # 1/N, N/m, kg
PULL = 9.80665 * MASS


def plotter(**entries):
    """Return the file of a pen on two ropes in an upright plane, mm."""
    limbs = [{"name": n, "kind": "rope", "base": {"point": [1e3 * float(x), 1e3 * float(y)]},
              "platform": {"point": {"x": {"value": 0, "fixed": True},
                                     "y": {"value": 0, "fixed": True}}},
              "offset": {"value": 0, "fixed": True}, **entries}
             for n, (x, y) in zip("lr", ANCHORS, strict=True)]
    return {"format": "ppmcal/mechanism/1", "name": "plotter", "units": {
        "length": "mm", "angle": "deg"}, "motion": "planar-point", "gravity": [0, -1],
        "limbs": limbs, "home": {"pose": {"x": 1000, "y": -800}}, "tolerances": {"point": 3}}


def hanging(u):
    """Return where the pen hangs on ropes of unloaded lengths u, and their tensions."""
    def left(x):
        away = ANCHORS - x[:2]
        chord = np.linalg.norm(away, axis=1)
        span = np.abs(away[:, 0])
        f = x[2:]
        reach = u + ELONGATION * u * f - WEIGHT**2 * span**2 * u / (24.0 * f**2)
        force = (f / chord) @ away - [0.0, PULL]
        return [*(chord - reach), *(force / PULL)]

    start = [1.0, -0.8, PULL / 1.3, PULL / 1.3]
    found, _, ok, _ = fsolve(left, start, xtol=1e-14, full_output=True)
    assert ok == 1 or np.abs(left(found)).max() < 1e-12
    return found[:2], found[2:]


def conditions(mechanism, u):
    return environment({"payload": np.full(len(u), MASS)}, mechanism.actuators, mechanism.gravity,
                       u)


U = np.array([[1.2, 1.3], [1.6, 0.9], [0.9, 1.7], [1.5, 1.5], [1.1, 1.25]])


def test_a_pen_hangs_where_forces_balance():
    mechanism = read_text(yaml.safe_dump(plotter(elongation=ELONGATION, weight=1e-3 * WEIGHT)))
    assert mechanism.names[-4:] == tuple(
        f"rope_elasticity.{n}.{p}" for n in "lr" for p in ("elongation", "weight"))
    found = reached_poses(Model(mechanism), U, conditions(mechanism, U))
    expected, tension = (np.array(v) for v in zip(*map(hanging, U), strict=True))
    np.testing.assert_allclose(cga.translation(found.pose)[:, :2], expected, rtol=0.0, atol=1e-11)
    at = setting(Model(mechanism), conditions(mechanism, U), U, found.closed, found.model)
    np.testing.assert_allclose(at.tension, tension, rtol=1e-8)
    assert np.all(np.linalg.norm(expected - [
        cga.translation(p)[:2] for p in reached_poses(Model(mechanism.nominal()), U).pose],
        axis=1) > 2e-4)


def test_the_sag_is_that_of_a_catenary():
    """Of level ropes and of steep ones: what the arc is longer than its chord, to 2 %."""
    for dx, dy in ((2.0, 0.0), (2.0, -1.5), (0.8, -2.0)):
        weight, chord = 0.5, np.hypot(dx, dy)
        for pull in (20.0, 60.0):       # of its horizontal part
            a = pull / weight

            def rise(x0, a=a, dx=dx, dy=dy):
                return a * (np.cosh((x0 + dx) / a) - np.cosh(x0 / a)) - dy

            x0 = brentq(rise, -200.0, 200.0, xtol=1e-14)
            arc = quad(lambda x, a=a, x0=x0: np.cosh((x0 + x) / a), 0.0, dx, epsabs=1e-14)[0]
            f = pull * chord / dx
            assert weight**2 * dx**2 * chord / (24.0 * f**2) == pytest.approx(arc - chord, rel=0.02)


@pytest.mark.long
def test_elongation_is_identified_beside_anchors(tmp_path):
    """Without noise: positions of a loaded pen tell how much ropes give, to 1e-9 m of places."""
    tree = plotter(elongation={"value": 0, "free": True, "tolerance": 1e-4}, weight=1e-3 * WEIGHT)
    path = written(tmp_path, tree)
    u = np.random.default_rng(2).uniform(0.9, 1.7, (40, 2))
    places = np.array([hanging(row)[0] for row in u])
    table = {"q_l": 1e3 * u[:, 0], "q_r": 1e3 * u[:, 1], "x": 1e3 * places[:, 0],
             "y": 1e3 * places[:, 1], "payload": np.full(len(u), MASS)}
    side = {"units": {"length": "mm", "angle": "deg"}, "frame": "known", "target": "known",
            "instrument": {"kind": "position", "sigma": {"position": 1e-6}}}
    data = ppmcal.read_data(path, {k: v[:30] for k, v in table.items()}, sidecar=side, name="pen")
    fitted = ppmcal.identify(path, data).identification.mechanism
    values = dict(zip(fitted.names, fitted.values, strict=True))
    assert values["rope_elasticity.l.elongation"] == pytest.approx(ELONGATION, rel=1e-5)
    found = reached_poses(Model(fitted), u[30:], conditions(fitted, u[30:])).pose
    np.testing.assert_allclose(cga.translation(found)[:, :2], places[30:], rtol=0.0, atol=1e-9)


def test_entries_of_limbs_are_effects():
    """Read as such, written as such, with their places in messages."""
    mechanism = read_text(yaml.safe_dump(plotter(elongation=ELONGATION)))
    assert [e.kind.name for e in mechanism.effects] == ["rope_elasticity"] * 2
    text = write_mechanism(mechanism)
    assert "elongation" not in yaml.safe_load(text)["limbs"][0]
    again = read_text(text)
    assert (again.names, again.values.tolist()) == (mechanism.names, mechanism.values.tolist())
    tree = plotter(elongation=-1)
    with pytest.raises(BadInput) as error:
        read_text(yaml.safe_dump(tree))
    assert "limbs.l.parameters.elongation" in error.value.where
    assert "outside the physical range" in error.value.what
    strut = yaml.safe_load((ROOT / "configs" / "stewart-7.yaml").read_text(encoding="utf-8"))
    strut["limbs"][0]["elongation"] = 1e-6
    with pytest.raises(BadInput) as error:
        read_text(yaml.safe_dump(strut))
    assert "unknown key 'elongation'" in error.value.what


def test_ropes_in_surplus_need_measured_tensions():
    """The load does not say how hard ropes pull against each other; columns do."""
    tree = yaml.safe_load((ROOT / "configs" / "cable-4-pulleys.yaml").read_text(encoding="utf-8"))
    for limb in tree["limbs"]:
        limb["elongation"] = 2e-6
    mechanism = read_text(yaml.safe_dump(tree))
    q = np.tile([1.97, 1.98, 1.96, 1.97], (3, 1))
    columns = {f"tension_c{i}": np.full(3, 100.0 * i) for i in range(1, 5)}
    load = environment({"payload": np.ones(3)}, mechanism.actuators, mechanism.gravity, q)
    assert missing_columns(mechanism, load) == tuple(columns)
    told = environment(columns, mechanism.actuators, mechanism.gravity, q)
    assert missing_columns(mechanism, told) == ()
    shift = reached_poses(Model(mechanism), q, told).model.shift
    np.testing.assert_allclose(shift.slots[1, "offset"], 2e-6 * 1.98 * 200.0, rtol=1e-12)
    pushed = environment({**columns, "tension_c2": np.full(3, -5.0)}, mechanism.actuators,
                         mechanism.gravity, q)
    assert not reached_poses(Model(mechanism), q, pushed).model.shift.slots[1, "offset"].any()


@pytest.mark.slow
def test_a_rope_that_would_have_to_push_is_a_finding(tmp_path):
    """By the load, or as it was measured; where all ropes pull nothing is said."""
    path = written(tmp_path, plotter())
    u = np.random.default_rng(2).uniform(0.9, 1.7, (20, 2))
    pen = reached_poses(Model(read_text(yaml.safe_dump(plotter()))), u).pose
    table = {"q_l": 1e3 * u[:, 0], "q_r": 1e3 * u[:, 1],
             **{c: 1e3 * cga.translation(pen)[:, i] for i, c in enumerate("xy")}}
    side = {"units": {"length": "mm", "angle": "deg"}, "frame": "known", "target": "known",
            "instrument": {"kind": "position", "sigma": {"position": 0.01}}}
    weight, aside = np.full(len(u), MASS), np.where(np.arange(len(u)) == 6, 200.0, 0.0)

    def said(**more):
        data = ppmcal.read_data(path, table | more, sidecar=side, name="pen")
        return [f for f in ppmcal.identify(path, data).identification.findings if "push" in f]

    assert said(payload=weight) == []
    (by_load,) = said(payload=weight, fx=aside)
    assert by_load.startswith("pen: r would have to push in row 7 (down to -")
    (measured,) = said(payload=weight, tension_l=np.where(aside, -3.0, 20.0))
    assert measured.startswith("pen: l would have to push in row 7 (down to -3 N): a rope is slack")
