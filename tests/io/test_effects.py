"""Effects in mechanism and scenario files: units, names, round trips, and every refusal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers import machines
from helpers.machines import FURTHER
from helpers.paths import ROOT

from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism, read_scenario, write_mechanism
from ppmcal.model.effects import EffectKind, effect_kinds
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import SI, Units

CONFIGS = ROOT / "configs"
MOTION = {"3-RPR": "planar", "3-RRR-1": "planar", "delta-linear": "translational",
          "6-UPS": "spatial", "6-RUS": "spatial"}
TURNING = ("3-RRR-1", "6-RUS")
DEGREE = np.pi / 180.0
CASES = [(name, kind) for name, motion in MOTION.items() for kind, k in effect_kinds().items()
         if motion in k.motions and (k.joints != "turning" or name in TURNING)
         and (motion == "planar" or kind in ("backlash", "base_compliance", "drift"))]


def tree(name: str, effects: Any, **changes: Any) -> dict[str, Any]:
    """Return a machine of configs/ as plain data, with effects and other top-level keys."""
    data = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    assert isinstance(data, dict)
    return data | {"effects": effects} | changes


def read(folder: Path, name: str, effects: Any, **changes: Any) -> Mechanism:
    """Write such a machine as a file and read it."""
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(tree(name, effects, **changes), sort_keys=False))
    return read_mechanism(path)


def back(mechanism: Mechanism, folder: Path) -> Mechanism:
    """Write the machine and read it again."""
    path = folder / "back.yaml"
    path.write_text(write_mechanism(mechanism))
    return read_mechanism(path)


def found(mechanism: Mechanism) -> dict[str, float]:
    """Return the effects' parameters by name, SI."""
    own = [i for e in mechanism.effects for i in e.parameters.values()]
    return {mechanism.names[i]: mechanism.parameters[i].value for i in own}


def assert_same(a: Mechanism, b: Mechanism, ulps: int = 0) -> None:
    """Parameters, effects and what is free are equal, numbers to the last bit or nearly so."""
    assert a.names == b.names
    numbers = ("value", "nominal", "tolerance", "sigma", "size")
    for p, q in zip(a.parameters, b.parameters, strict=True):
        for n in numbers:
            x, y = getattr(p, n), getattr(q, n)
            assert (x is None) == (y is None), (p.name, n)
            if x is not None:
                np.testing.assert_allclose(y, x, rtol=ulps * 2.3e-16, atol=0.0, err_msg=p.name)
        blank: dict[str, Any] = dict.fromkeys(numbers, 0.0)
        assert replace(p, **blank) == replace(q, **blank)
    assert len(a.effects) == len(b.effects)
    for e, f in zip(a.effects, b.effects, strict=True):
        assert (e.kind.label, e.on, e.parameters) == (f.kind.label, f.on, f.parameters)
        assert (e.kind == f.kind) or e.kind.written is not None
        same_entries(e.kind, f.kind)
    assert a.free == b.free


def same_entries(a: EffectKind, b: EffectKind) -> None:
    """What kinds that are made of a file's entries were made of is equal, in SI."""
    one, other = (k.written(SI) if k.written else {} for k in (a, b))
    assert list(one) == list(other)
    for name, value in one.items():
        numbers = isinstance(value, list) and not isinstance(value[0], str)
        if numbers:
            np.testing.assert_allclose(np.array(other[name]), np.array(value), rtol=1e-14, atol=0.0)
        else:
            assert other[name] == value


# --- units --------------------------------------------------------------------------------------

UNITS = [  # machine, effect, its parameters in mm and deg, in SI
    ("3-RPR", "gain", {"gain": 1e-4}, {"gain": 1e-4}),
    ("3-RPR", "backlash", {"width": 0.02}, {"width": 2e-5}),
    ("3-RRR-1", "backlash", {"width": 0.02}, {"width": 0.02 * DEGREE}),
    ("3-RPR", "periodic", {"cos": 0.01, "sin": -0.02, "period": 5},
     {"cos": 1e-5, "sin": -2e-5, "period": 5e-3}),
    ("6-RUS", "periodic", {"cos": 0.01, "period": 30},
     {"cos": 0.01 * DEGREE, "sin": 0.0, "period": 30 * DEGREE}),
    ("6-RUS", "eccentricity", {"sin2": 0.01},
     {"cos": 0.0, "sin": 0.0, "cos2": 0.0, "sin2": 0.01 * DEGREE}),
    ("6-UPS", "curvature", {"p2": 0.3, "low": 1900, "high": 3400},
     {"p2": 3e-4, "p3": 0.0, "p4": 0.0, "low": 1.9, "high": 3.4}),
    ("3-RPR", "windup", {"width": 1e-4}, {"width": 1e-7}),
    ("3-RRR-1", "windup", {"width": 1e-4}, {"width": 1e-4 * DEGREE}),
    ("3-RPR", "compliance", {"stiffness": 20000, "hardening": 0.01, "by_stroke": 0.004,
                              "low": 200, "high": 700},
     {"stiffness": 2e7, "hardening": 0.01, "by_stroke": 4.0, "low": 0.2, "high": 0.7}),
    ("6-RUS", "compliance", {"stiffness": 10, "by_stroke": 0.01, "low": 0, "high": 90},
     {"stiffness": 10 / DEGREE, "hardening": 0.0, "by_stroke": 0.01 / DEGREE, "low": 0.0,
      "high": 90 * DEGREE}),
    ("6-UPS", "plate_compliance", {"base": 2e-4, "reach": 300},
     {"base": 2e-7, "platform": 0.0, "reach": 0.3}),
    ("6-UPS", "payload_offset", {"x": 50}, {"x": 0.05, "y": 0.0, "z": 0.0}),
    ("6-UPS", "gravity_tilt", {"second": 3}, {"first": 0.0, "second": 3 * DEGREE}),
    ("3-RPR", "gravity_tilt", {"turn": 3}, {"turn": 3 * DEGREE}),
    ("3-RPR", "clearance", {"width": 0.03}, {"width": 3e-5}),
    ("3-RPR", "lag", {"tau": 0.002}, {"tau": 0.002}),
    ("3-RPR", "leg_thermal", {"expansion": 11e-6}, {"expansion": 11e-6, "tau": 0.0}),
    ("6-UPS", "sensor_scale", {"scale": -1e-4}, {"scale": -1e-4}),
    ("3-RPR", "tilt", {"shrink": 1e-4, "direction": 30}, {"shrink": 1e-4,
                                                           "direction": 30 * DEGREE}),
    ("3-RPR", "drift", {"x": 1e-5, "rz": 2e-6}, {"x": 1e-8, "y": 0.0, "rz": 2e-6 * DEGREE}),
    ("delta-linear", "drift", {"z": 1e-5}, {"x": 0.0, "y": 0.0, "z": 1e-8}),
    ("3-RPR", "base_compliance", {"x_fx": 1e-5, "x_mz": 2e-5, "rz_fy": 3e-6, "rz_mz": 4e-6},
     {"x_fx": 1e-8, "x_fy": 0.0, "x_mz": 2e-8, "y_fx": 0.0, "y_fy": 0.0, "y_mz": 0.0,
      "rz_fx": 0.0, "rz_fy": 3e-6 * DEGREE, "rz_mz": 4e-6 * DEGREE}),
]


@pytest.mark.parametrize(("name", "kind", "given", "wanted"), UNITS)
def test_values_are_in_the_files_units(tmp_path: Path, name: str, kind: str,
                                       given: dict[str, float], wanted: dict[str, float]) -> None:
    """A load is in N, or N m at a joint that turns; what is left out is 0."""
    values = found(read(tmp_path, name, [{"kind": kind, "parameters": given}]))
    assert list(values) == [f"{kind}.{n}" for n in wanted]
    assert list(values.values()) == pytest.approx(list(wanted.values()), rel=1e-14)


def test_names_of_units(tmp_path: Path) -> None:
    """A stiffness is in N/mm, a turning one in N m/deg; results say so."""
    effects = [{"kind": "compliance", "parameters": {"stiffness": 5.0}},
               {"kind": "windup", "parameters": {"width": 1e-4}},
               {"kind": "leg_thermal", "parameters": {"expansion": 1e-5}},
               {"kind": "gain", "parameters": {"gain": 1e-5}}]
    for name, names in (("3-RPR", ["N/mm", "1/N", "1/mm", "mm", "mm", "mm/N", "1/K", "s", ""]),
                        ("3-RRR-1", ["N m/deg", "1/(N m)", "1/deg", "deg", "deg", "deg/(N m)",
                                     "1/K", "s", ""])):
        mechanism = read(tmp_path, name, effects)
        own = [mechanism.parameters[i] for e in mechanism.effects for i in e.parameters.values()]
        assert [mechanism.units.name(p.quantity) for p in own] == names


def test_with_a_ratio_lengths_stay_lengths(tmp_path: Path) -> None:
    """Where q counts revolutions, widths and periods are still in file units."""
    data = tree("3-RPR", [{"kind": "backlash", "parameters": {"width": 0.02}},
                          {"kind": "periodic", "parameters": {"cos": 0.01, "period": 5}}])
    for limb in data["limbs"]:
        limb["ratio"] = 5.0
    data["limits"] = {}
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    assert found(read_mechanism(path)) == pytest.approx({
        "backlash.width": 2e-5, "periodic.cos": 1e-5, "periodic.sin": 0.0,
        "periodic.period": 5e-3})


# --- labels -------------------------------------------------------------------------------------

def test_labels_of_effects_of_one_kind(tmp_path: Path) -> None:
    """All joints: the kind; some: their names; again: counted."""
    one: dict[str, Any] = {"kind": "backlash", "parameters": {"width": 0.02}}
    mechanism = read(tmp_path, "3-RPR", [
        one, one | {"on": ["leg1"]}, one | {"on": ["leg3", "leg1"]}, one, one | {"on": ["leg1"]},
        one | {"on": ["leg1", "leg2", "leg3"]}, {"kind": "drift"}, {"kind": "drift"}])
    assert [n.rpartition(".")[0] for n in found(mechanism)] == [
        "backlash", "backlash.leg1", "backlash.leg1+leg3", "backlash.2", "backlash.leg1.2",
        "backlash.3", *["drift"] * 3, *["drift.2"] * 3]
    assert [e.on for e in mechanism.effects[:3]] == [(True, True, True), (True, False, False),
                                                     (True, False, True)]
    assert len(set(mechanism.names)) == len(mechanism.names)
    assert_same(mechanism, back(mechanism, tmp_path))


def test_no_effects(tmp_path: Path) -> None:
    """An empty list, nothing, and no key at all are the same."""
    for effects in ([], None):
        assert read(tmp_path, "3-RPR", effects).effects == ()
    assert "effects" not in yaml.safe_load(write_mechanism(read(tmp_path, "3-RPR", [])))


def test_only_what_is_marked_is_free(tmp_path: Path) -> None:
    """A tolerance alone frees no effect; `free: true` does, with patterns for geometry or not."""
    effects = [{"kind": "backlash", "parameters": {"width": {"value": 0.02, "tolerance": 0.01}}},
               {"kind": "lag", "parameters": {"tau": {"value": 0.0, "free": True}}}]
    for changes in ({}, {"free": ["*.offset"]}, {"free": []}):
        mechanism = read(tmp_path, "3-RPR", effects, **changes)
        free = [mechanism.names[i] for i in mechanism.free]
        assert "lag.tau" in free
        assert "backlash.width" not in free
        assert_same(mechanism, back(mechanism, tmp_path))
        width = mechanism.parameters[mechanism.names.index("backlash.width")]
        assert width.tolerance == pytest.approx(1e-5)


def test_a_choice_of_parameters_may_name_those_of_effects(tmp_path: Path) -> None:
    """As after a fit of joint values alone, for which some of the geometry is held."""
    effects = [{"kind": "lag", "parameters": {"tau": {"value": 0.0, "free": True}}}]
    mechanism = read(tmp_path, "3-RPR", effects)
    held = replace(mechanism, free=mechanism.free[3:])
    assert "lag.tau" in yaml.safe_load(write_mechanism(held))["free"]
    assert back(held, tmp_path).free == held.free
    with pytest.raises(BadInput, match=r"the pattern 'lag\.tua' names no parameter"):
        read(tmp_path, "3-RPR", effects, free=["lag.tua"])


# --- round trips --------------------------------------------------------------------------------

def awkward(mechanism: Mechanism, kind: str, seed: int) -> dict[str, Any]:
    """Return every parameter with numbers that have many digits, each with other keys."""
    rng = np.random.default_rng(seed)
    out: dict[str, Any] = {}
    for i, s in enumerate(effect_kinds()[kind].parameters(mechanism.motion)):
        value = float(rng.uniform(1e-6, 1.5e-5)) * (1e9 if s.reciprocal else 1.0)
        if s.name in ("low", "high", "period", "direction"):
            value = float(rng.uniform(0.5, 1.0)) * (2.0 if s.name == "high" else 1.0)
        entry: dict[str, Any] = {"value": value}
        if i % 3 != 2:
            entry["tolerance"] = float("inf") if i % 3 else float(rng.uniform(1e-6, 1e-5))
        if i % 2:
            entry |= {"sigma": float(rng.uniform(1e-7, 1e-6)), "nominal": 0.5 * value}
        if not s.constant and i % 4 < 2:
            entry["free"] = True
        out[s.name] = entry if i % 5 != 4 else value
    return out


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_round_trip(tmp_path: Path, name: str, kind: str) -> None:
    """What is written reads back equal: values, joints, what is free, tolerances, sigmas."""
    plain = read(tmp_path, name, [])
    for seed, units in enumerate((Units("mm", "deg"), Units("in", "rad"), Units("um", "deg"))):
        effect: dict[str, Any] = {
            "kind": kind, **FURTHER.get(kind, {}), "parameters": awkward(plain, kind, seed)}
        if seed and effect_kinds()[kind].per_actuator:
            effect["on"] = list(plain.actuators[1:])
        mechanism = read(tmp_path, name, [effect])
        # in other units some numbers have no double that reads back as they are
        mechanism = replace(mechanism, units=units)
        again = back(mechanism, tmp_path)
        assert_same(mechanism, again, ulps=2 if seed else 0)
        assert write_mechanism(back(again, tmp_path)) == write_mechanism(again)


def test_plain_numbers_stay_plain(tmp_path: Path) -> None:
    """No key is written that says nothing."""
    effects = [{"kind": "backlash", "on": ["leg1"], "parameters": {"width": 0.02}},
               {"kind": "compliance", "parameters": {"stiffness": {"value": 2e4, "free": True}}},
               {"kind": "curvature", "parameters": {"p2": 0.1, "p3": 0.0, "p4": 0.0}}]
    written = yaml.safe_load(write_mechanism(read(tmp_path, "3-RPR", effects)))
    assert written["effects"] == effects


def test_values_of_a_fit_round_trip(tmp_path: Path) -> None:
    """Awkward doubles, as a fit leaves them, come back to the last bit or the one beside."""
    rng = np.random.default_rng(8)
    effects = [{"kind": k, "parameters": {}} for k in ("drift", "gain", "eccentricity")]
    mechanism = read(tmp_path, "6-RUS", effects)
    own = {i for e in mechanism.effects for i in e.parameters.values()}
    made = tuple(replace(p, value=float(rng.normal() * 1e-4), sigma=float(rng.uniform(0, 1e-5)))
                 if i in own else p for i, p in enumerate(mechanism.parameters))
    mechanism = replace(mechanism, parameters=made)
    assert_same(mechanism, back(mechanism, tmp_path), ulps=1)


# --- geometry -----------------------------------------------------------------------------------

def test_geometry_changes_slots(tmp_path: Path) -> None:
    """The values are errors, added to the slots; effects of one file add up."""
    plain = read(tmp_path, "3-RPR", [])
    effects = [{"kind": "geometry", "parameters": {"leg2.offset": 0.3, "leg1.base.point.x": -0.2}},
               {"kind": "geometry", "parameters": {"leg2.offset": 0.1}}]
    mechanism = read(tmp_path, "3-RPR", effects)
    assert mechanism.names == plain.names
    assert mechanism.effects == ()
    change = dict(zip(plain.names, mechanism.values - plain.values, strict=True))
    moved = {n: c for n, c in change.items() if c}
    assert moved == pytest.approx({"leg2.offset": 4e-4, "leg1.base.point.x": -2e-4})
    np.testing.assert_array_equal(mechanism.nominals, plain.nominals)
    assert_same(mechanism, back(mechanism, tmp_path))


def test_geometry_frees_a_slot_that_was_fixed(tmp_path: Path) -> None:
    """It names what the fit had not been allowed to change; that survives writing."""
    effects = [{"kind": "geometry", "parameters": {
        "leg1.platform.point.angle": {"value": 0.0, "tolerance": 0.1, "free": True}}}]
    mechanism = read(tmp_path, "3-RPR", effects)
    index = mechanism.names.index("leg1.platform.point.angle")
    assert index in mechanism.free
    assert mechanism.parameters[index].tolerance == pytest.approx(0.1 * DEGREE)
    again = back(mechanism, tmp_path)
    assert again.free == mechanism.free
    np.testing.assert_array_equal(again.values, mechanism.values)


def test_geometry_without_tolerance_survives_writing(tmp_path: Path) -> None:
    """A slot with no tolerance of its own, freed by a geometry entry, stays free."""
    data = tree("3-RPR", [{"kind": "geometry", "parameters": {
        "leg1.lateral": {"value": 0.2, "free": True}}}])
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    mechanism = read_mechanism(path)
    assert mechanism.names.index("leg1.lateral") in mechanism.free
    again = back(mechanism, tmp_path)
    assert again.names.index("leg1.lateral") in again.free
    np.testing.assert_array_equal(again.values, mechanism.values)


# --- scenarios ----------------------------------------------------------------------------------

SCENARIO: dict[str, Any] = {
    "format": "ppmcal/scenario/1", "units": {"length": "um", "angle": "rad"},
    "poses": {"random": {"center": {"x": 5e5, "y": 288675.0, "rz": 0.5},
                         "half_range": {"x": 1e4}, "count": 3}},
    "instrument": {"kind": "pose", "sigma": {"position": 1.0}}}


def test_a_scenarios_effects_are_in_its_own_units(tmp_path: Path) -> None:
    """They come after the machine's, and change nothing that the controller knows."""
    mechanism = read(tmp_path, "3-RPR", [{"kind": "backlash", "parameters": {"width": 0.02}}])
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(SCENARIO | {"effects": [
        {"kind": "backlash", "on": ["leg2"], "parameters": {"width": 30.0}},
        {"kind": "geometry", "parameters": {"leg1.offset": 7.0}}]}))
    acting = read_scenario(path, mechanism).with_effects
    assert found(acting) == pytest.approx({"backlash.width": 2e-5, "backlash.leg2.width": 3e-5})
    assert acting.names[:len(mechanism.names)] == mechanism.names
    shift = acting.values[:len(mechanism.names)] - mechanism.values
    assert shift[mechanism.names.index("leg1.offset")] == pytest.approx(7e-6)
    assert np.count_nonzero(shift) == 1


def test_a_scenarios_effect_is_refused_with_the_scenarios_name(tmp_path: Path) -> None:
    mechanism = read(tmp_path, "3-RPR", [])
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump(SCENARIO | {"effects": [{"kind": "lag", "on": ["leg9"]}]}))
    with pytest.raises(BadInput, match=r"s\.yaml: effects\[1\]\.on: unknown actuator 'leg9'"):
        read_scenario(path, mechanism)


# --- refusals -----------------------------------------------------------------------------------

def one(kind: str, **parameters: Any) -> list[dict[str, Any]]:
    return [{"kind": kind, "parameters": parameters}]


WIDTH: dict[str, Any] = {"kind": "backlash", "parameters": {"width": 0.02}}

# (name, machine, effects, place, what the message must say)
BROKEN: list[tuple[str, str, Any, str, str]] = [
    ("unknown kind", "3-RPR", one("backlsh", width=1), "effects[1].kind", "mean 'backlash'"),
    ("unknown geometry", "3-RPR", one("geometri"), "effects[1].kind",
     "mean 'geometry'"),
    ("second effect", "3-RPR", [WIDTH, *one("bakclash")], "effects[2].kind", "backlash"),
    ("no kind", "3-RPR", [{"parameters": {}}], "effects[1]", "kind"),
    ("kind is a number", "3-RPR", [{"kind": [3]}], "effects[1].kind", "name"),
    ("unknown key", "3-RPR", [WIDTH | {"onn": ["leg1"]}], "effects[1]", "'on'"),
    ("unknown actuator", "3-RPR", [WIDTH | {"on": ["leg4"]}], "effects[1].on", "leg1, leg2, leg3"),
    ("no actuator", "3-RPR", [WIDTH | {"on": []}], "effects[1].on", "at least one"),
    ("on is a word", "3-RPR", [WIDTH | {"on": "leg1"}], "effects[1].on", "list"),
    ("one limb of the whole", "3-RPR", [{"kind": "drift", "on": ["leg1"]}], "effects[1].on",
     "whole machine"),
    ("unknown parameter", "3-RPR", one("backlash", widht=1), "effects[1].parameters", "'width'"),
    ("missing value", "3-RPR", one("backlash"), "effects[1].parameters.width", "mm"),
    ("missing value beside free", "3-RPR", one("backlash", width={"free": True}),
     "effects[1].parameters.width", "no value"),
    ("missing stiffness", "6-RUS", one("compliance"), "effects[1].parameters.stiffness",
     "N m/deg"),
    ("missing period", "3-RPR", one("periodic", cos=1), "effects[1].parameters.period", "mm"),
    ("stiffness 0", "3-RPR", one("compliance", stiffness=0), "parameters.stiffness", "range"),
    ("stiffness below 0", "3-RPR", one("compliance", stiffness=-3), "parameters.stiffness",
     "range"),
    ("clearance below 0", "3-RPR", one("clearance", width=-0.1), "parameters.width", "range"),
    ("expansion", "3-RPR", one("leg_thermal", expansion=121e-6), "parameters.expansion", "0.00012"),
    ("expansion down", "3-RPR", one("base_thermal", expansion=-121e-6), "parameters.expansion",
     "1/K"),
    ("gain", "3-RPR", one("gain", gain=0.2), "parameters.gain", "range"),
    ("period 0", "3-RPR", one("periodic", period=0), "parameters.period", "range"),
    ("shrink", "3-RPR", one("tilt", shrink=-1e-4, direction=0), "parameters.shrink", "range"),
    ("lag", "3-RPR", one("lag", tau=2), "parameters.tau", " s"),
    ("word", "3-RPR", one("backlash", width="0.02"), "parameters.width", "'0.02'"),
    ("word inside", "3-RPR", one("backlash", width={"value": "0.02"}), "parameters.width.value",
     "'0.02'"),
    ("decimal comma", "3-RPR", one("backlash", width={"value": "0,02"}), "parameters.width.value",
     "decimal point"),
    ("yes", "3-RPR", one("backlash", width=True), "parameters.width", "True"),
    ("nan", "3-RPR", one("backlash", width=float("nan")), "parameters.width", "nan"),
    ("inf", "3-RPR", one("backlash", width=float("inf")), "parameters.width", "inf"),
    ("nothing", "3-RPR", one("backlash", width=None), "parameters.width", "nothing"),
    ("tolerance below 0", "3-RPR", one("backlash", width={"value": 1, "tolerance": -1}),
     "parameters.width.tolerance", "standard deviation"),
    ("free is a word", "3-RPR", one("backlash", width={"value": 1, "free": "yes"}),
     "parameters.width.free", "true or false"),
    ("key of a parameter", "3-RPR", one("backlash", width={"value": 1, "fixed": True}),
     "parameters.width", "'fixed'"),
    ("parameters is a list", "3-RPR", [{"kind": "lag", "parameters": [1]}],
     "effects[1].parameters", ""),
    ("eccentricity of a slide", "3-RPR", one("eccentricity", cos=1), "effects[1].on", "turn"),
    ("tilt in space", "6-UPS", one("tilt", shrink=1e-4, direction=0), "effects[1].kind",
     "planar"),
    ("tilt of a delta", "delta-linear", one("tilt", shrink=1e-4, direction=0),
     "effects[1].kind", "planar"),
    ("a coordinate that is not there", "3-RPR", one("drift", z=1), "effects[1].parameters",
     "x, y, rz"),
    ("a wrench that is not there", "delta-linear", one("base_compliance", x_mx=1),
     "effects[1].parameters", "x_fx"),
    ("a stroke cannot be fitted", "3-RPR", one("curvature", low={"value": 1, "free": True}),
     "parameters.low", "fitted"),
    ("stroke reversed", "3-RPR", one("curvature", p2=1, low=700, high=200), "effects[1]", "high"),
    ("stroke of nothing", "3-RPR", one("curvature", p2=1, low=200, high=200), "effects[1]",
     "high"),
    ("slot", "3-RPR", one("geometry", **{"leg1.ofset": 1}), "effects[1].parameters",
     "leg1.offset"),
    ("not a list", "3-RPR", {"kind": "backlash"}, "effects", "list of effects"),
    ("an empty mapping", "3-RPR", {}, "effects", "list of effects"),
    ("a word", "3-RPR", "backlash", "effects", "list of effects"),
    ("list of words", "3-RPR", ["backlash"], "effects[1]", "'backlash'"),
    ("list of numbers", "3-RPR", [1], "effects[1]", "1"),
]


@pytest.mark.parametrize(("name", "effects", "place", "says"),
                         [pytest.param(*case[1:], id=case[0]) for case in BROKEN])
def test_refused(tmp_path: Path, name: str, effects: Any, place: str, says: str) -> None:
    """Each with file, place and hint."""
    with pytest.raises(BadInput) as caught:
        read(tmp_path, name, effects)
    message = f"{caught.value.what} {caught.value.hint}"
    assert caught.value.where.startswith(str(tmp_path / "bench.yaml"))
    assert place in caught.value.where
    assert says in message
    assert caught.value.hint
    assert "\n" not in message


def test_a_free_gain_beside_a_free_ratio(tmp_path: Path) -> None:
    """The two are one: refused where the ratio is free, allowed where it is fixed."""
    effects = one("gain", gain={"value": 0.0, "free": True})
    for ratio, good in ((5.0, True), ({"value": 5.0, "tolerance": 0.01}, False),
                        ({"value": 5.0, "tolerance": 0.01, "fixed": True}, True)):
        data = tree("3-RPR", effects, limits={})
        data["limbs"][1]["ratio"] = ratio
        path = tmp_path / "bench.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        if good:
            assert read_mechanism(path).effects
            continue
        with pytest.raises(BadInput, match=r"bench\.yaml: effects\[1\].kind.*leg2.*free") as caught:
            read_mechanism(path)
        assert "Fix the ratio" in caught.value.hint
        data["effects"] = [effects[0] | {"on": ["leg1", "leg3"]}]
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        assert read_mechanism(path).effects


def test_joints_that_slide_and_joints_that_turn(tmp_path: Path) -> None:
    """They cannot share a width, which would be in mm and in degrees; one each is right."""
    data = tree("3-RPR", [WIDTH], limits={})
    data["limbs"][0] |= {"kind": "(R)RR", "proximal": 300, "distal": 250}
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    with pytest.raises(BadInput, match=r"bench\.yaml: effects\[1\]\.on.*each sort"):
        read_mechanism(path)
    data["effects"] = [WIDTH | {"on": ["leg3", "leg2"]}, WIDTH | {"on": ["leg1"]},
                       {"kind": "eccentricity", "on": ["leg1"], "parameters": {"cos": 0.1}},
                       {"kind": "leg_thermal", "on": ["leg1"], "parameters": {"expansion": 0.0}}]
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    mechanism = read_mechanism(path)
    values = found(mechanism)
    assert values["backlash.leg2+leg3.width"] == pytest.approx(2e-5)
    assert values["backlash.leg1.width"] == pytest.approx(0.02 * DEGREE)
    assert_same(mechanism, back(mechanism, tmp_path))


def test_effects_come_through_extends(tmp_path: Path) -> None:
    """The file on top decides; without its own, the one below."""
    below = tmp_path / "below.yaml"
    below.write_text(yaml.safe_dump(tree("3-RPR", [WIDTH]), sort_keys=False))
    top = tmp_path / "top.yaml"
    top.write_text("extends: below.yaml\n")
    assert found(read_mechanism(top)) == pytest.approx({"backlash.width": 2e-5})
    top.write_text("extends: below.yaml\neffects: [{kind: lag, parameters: {tau: 0.001}}]\n")
    assert list(found(read_mechanism(top))) == ["lag.tau"]


def test_every_limb_kind_takes_effects() -> None:
    """Nothing in reading depends on the kind of limb but whether its joint turns."""
    for kind in machines.KINDS:
        text = machines.plain_text(kind, effects=[
            {"kind": "backlash", "parameters": {"width": 0.01}},
            {"kind": "compliance", "parameters": {"stiffness": 100.0}}])
        assert [e.kind.name for e in machines.read_text(text).effects] == ["backlash",
                                                                          "compliance"]
