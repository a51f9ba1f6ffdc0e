"""Every kind of effect against its equation, differences, virtual work and equilibrium.

The tests run over the registry: a kind without a worked case fails. All numbers are SI.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.machines import FURTHER, KINDS, Array, delta, difference, full, mixed, spread
from helpers.paths import ROOT

from ppmcal import algebra as cga
from ppmcal.calibration.fit.observation import stretched
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.io import read_mechanism
from ppmcal.io.effects import with_effects
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import environment_of, setting, shifted, with_strokes
from ppmcal.kinematics.equilibrium import consistent_joints, reached_poses, uses_load
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.loads import loads
from ppmcal.kinematics.needed_columns import missing_columns
from ppmcal.kinematics.registration import displaced, measured_pose
from ppmcal.kinematics.tables import forward_table, inverse_table, pose_motor, pose_vector
from ppmcal.model.dataset import (
    WRENCH,
    Dataset,
    Environment,
    environment,
    unknown_environment,
    ways,
)
from ppmcal.model.effects import (
    EffectKind,
    Inputs,
    LimbSetting,
    ScanRange,
    Setting,
    effect_kinds,
    find_effect,
)
from ppmcal.model.effects.setting import Shift
from ppmcal.model.history import History
from ppmcal.model.limbs import kinds as limb_kinds
from ppmcal.model.mechanism import Mechanism, usable_joints
from ppmcal.model.registration import Registration
from ppmcal.units import SI

CONFIGS = ROOT / "configs"
MACHINES = ("3-RPR", "6-UPS", "linapod", "delta-rotary", "6-RUS", "3-RPS")
ROPES = "cable-4-planar"
"""For what only ropes do."""
CONTRACT = ("gain", "curvature", "periodic", "eccentricity", "backlash", "windup", "lag",
            "compliance", "clearance", "base_compliance", "leg_thermal", "base_thermal",
            "platform_thermal", "drift", "sensor_scale", "tilt")
COLUMNS = {"dir", "vel", "temperature", "load", "tension", "wrench", "time", "row", "order", "past",
           "touch"}
each_kind = pytest.mark.parametrize("kind", effect_kinds())
each_machine = pytest.mark.parametrize("name", MACHINES)


@cache
def machine(name: str) -> Mechanism:
    return read_mechanism(CONFIGS / f"{name}.yaml")


def fits(kind: EffectKind, mechanism: Mechanism) -> bool:
    """Whether an effect of this kind can act on all actuators of the machine."""
    return kind.exists_in(mechanism.motion) and bool(usable_joints(mechanism, kind).all())


CASES = [(name, kind) for name in MACHINES for kind, k in effect_kinds().items()
         if fits(k, machine(name))] + [(ROPES, kind) for kind, k in effect_kinds().items()
                                       if k.joints == "ropes"]
FEW = ("3-RPR", "delta-rotary", "3-RPS", ROPES)
"""One machine for each motion, the last with fewer drives than coordinates."""
few_cases = pytest.mark.parametrize(("name", "kind"), [c for c in CASES if c[0] in FEW])
one_each = pytest.mark.parametrize(("name", "kind"), [
    (own[n % len(own)], kind) for n, kind in enumerate(effect_kinds()) if (
        own := [name for name in FEW if (name, kind) in CASES])])
"""Every kind on one machine, the motions in turn."""


def sizes(mechanism: Mechanism, kind: str) -> dict[str, float]:
    """Return moderate values of all parameters, SI: they move joints by some 1e-5 of the reach."""
    size = 2e-5 * (mechanism.reach if mechanism.actuator_quantity[0] == "length" else 1.0)
    load = 100.0 * (1.0 if mechanism.actuator_quantity[0] == "length" else mechanism.reach)
    own = {"windup": {"width": size / load},
           "compliance": {"stiffness": load / size, "hardening": 0.5 / load, "by_stroke": 0.4,
                          "low": -0.5, "high": 2.9},
           "plate_compliance": {"base": size / 100.0, "platform": 2.0 * size / 100.0,
                                "reach": 0.4 * mechanism.reach},
           "payload_offset": dict.fromkeys("xyz", 0.02), "gravity_tilt": {
               s.name: 0.3 for s in effect_kinds()["gravity_tilt"].parameters(mechanism.motion)},
           "periodic": {"cos": size, "sin": -size, "period": 0.3},
           "tilt": {"shrink": 2e-5, "direction": 0.4}, "lag": {"tau": 1e-4},
           "bed_shape": {s.name: mechanism.reach if s.constant else 1e-4 for s in
                         effect_kinds()["bed_shape"].parameters(mechanism.motion)},
           "gain": {"gain": 3e-5}, "sensor_scale": {"scale": -2e-5},
           "curvature": {"p2": size, "p3": -size, "p4": 0.5 * size, "low": -0.5, "high": 2.9},
           "eccentricity": {"cos": size, "sin": -size, "cos2": 0.5 * size, "sin2": size},
           "friction": {"static": size, "dynamic": 0.4 * size, "speed": 0.04},
           "hysteresis": {"w1": 1e-4, "w2": -3e-5, "w3": 2e-5, "low": -0.5, "high": 2.9},
           "creep": {"give": size / load, "tau": 90.0}, "product": {"width": 0.2 * size}}
    if kind in own:
        known = {s.name for s in effect_kinds()[kind].parameters(mechanism.motion)}
        return {n: v for n, v in own[kind].items() if n in known}
    if kind.endswith("_thermal"):
        # a slot's own growth is left out of the derivative by that slot: 5 K at 1e-6 per K
        return {"expansion": 1e-6, "tau": 70.0}
    specs = effect_kinds()[kind].parameters(mechanism.motion)
    if kind not in ("base_compliance", "drift"):
        return {s.name: size if s.name == "width" else 10.0 * s.size for s in specs}
    length = {"base_compliance": 1e-7, "drift": 4e-8}[kind]
    # turns stay below 1e-5 rad
    return {s.name: length * (1.0 - 0.3 * (i % 4)) * (
        0.04 / max(1.0, mechanism.reach) if s.name.startswith("r") else 1.0)
        / (mechanism.reach if "_m" in s.name else 1.0) for i, s in enumerate(specs)}


def beside(mechanism: Mechanism, kind: str) -> dict[str, object]:
    """Return what a file says beside the parameters of a kind; of those that pull the first."""
    pulling = {"on": list(mechanism.actuators[:mechanism.surplus])}
    return FURTHER.get(kind, {}) | (pulling if effect_kinds()[kind].opposed else {})


def acting(mechanism: Mechanism, *effects: Mapping[str, Any]) -> Mechanism:
    """Return the machine with effects as a file in SI units would give them."""
    return with_effects(mechanism, list(effects), SI, "effects.yaml")


def with_kind(mechanism: Mechanism, kind: str, free: bool = False) -> Mechanism:
    """Return the machine with one effect of a kind, at moderate values.

    What says what is carried shows through a compliance.
    """
    if effect_kinds()[kind].carried is not None:
        mechanism = acting(mechanism, {"kind": "compliance", "parameters": {
            "stiffness": sizes(mechanism, "compliance")["stiffness"]}})
    constant = {s.name for s in effect_kinds()[kind].parameters(mechanism.motion) if s.constant}
    return acting(mechanism, {"kind": kind, **beside(mechanism, kind), "parameters": {
        n: {"value": v, "free": free and n not in constant}
        for n, v in sizes(mechanism, kind).items()}})


def recorded(mechanism: Mechanism, q: Array, seed: int = 3) -> dict[str, Array]:
    """Return every column that an effect may need, SI, of rows visited in their order."""
    n = len(q)
    rng = np.random.default_rng(seed)
    columns = {"temperature": 293.15 + rng.uniform(-5.0, 5.0, n), "payload": rng.uniform(2, 20, n),
               "time": np.sort(rng.uniform(0.0, 500.0, n))}
    columns |= {f: rng.uniform(-60.0, 60.0, n) for f in ("fx", "fy", "fz")}
    columns |= {m: rng.uniform(-20.0, 20.0, n) * mechanism.reach for m in ("mx", "my", "mz")}
    for a, way in zip(mechanism.actuators, ways(q).T, strict=True):
        columns[f"dir_{a}"] = np.nan_to_num(way, nan=1.0)
        columns[f"vel_{a}"] = rng.uniform(-0.1, 0.1, n)
    pulls = np.random.default_rng(seed + 1).uniform(20.0, 90.0, (n, len(mechanism.actuators)))
    return columns | {f"tension_{a}": f for a, f in zip(mechanism.actuators, pulls.T, strict=True)}


@cache
def sample(mechanism: Mechanism, n: int = 4, size: float = 0.5) -> tuple[Array, Environment]:
    """Return joint values about home and conditions of the rows."""
    q, _ = spread(Model(mechanism), n, size=size)
    return q, replace(
        environment(recorded(mechanism, q), mechanism.actuators, mechanism.gravity, q),
        touch=np.ones(len(q), dtype=bool))


@cache
def bare(mechanism: Mechanism) -> Array:
    """Return the poses of the sample without effects (4, 8)."""
    return reached_poses(Model(mechanism), sample(mechanism)[0]).pose


# --- the registry -------------------------------------------------------------------------------

def one_row(kind: EffectKind, **fields: float) -> Setting:
    """Return a setting of one row, one actuator and one limb, with some fields set."""
    own = {part: {slot: np.array(fields[part])} if part in fields else {} for part, slot in
           (("struts", "length"), ("base", "base.point.x"), ("platform", "platform.point.x"))}
    if kind.joints == "ropes":
        own["struts"] = {"offset": np.array([fields["travel"]])}

    def row(name: str, *shape: int) -> Array:
        return np.full(shape, fields.get(name, np.nan))

    def past(name: str, *shape: int) -> Array:
        return np.stack([np.full(shape, fields.get(f"{name}_before", np.nan)), row(name, *shape)])

    history = History(past("travel", 1), np.array([0.0, fields.get("time", 1.0)]),
                      past("temperature"), past("wrench", 6), past("weight", 3),
                      np.array([True]))
    return Setting(kind.motions[0], np.array([kind.joints == "turning"]), row("travel", 1, 1),
                   np.full((1, 2), np.nan), row("approach", 1, 1), row("velocity", 1, 1),
                   row("temperature", 1), row("wrench", 1, 6), row("time", 1),
                   row("row", 1), (LimbSetting(0, own["struts"], own["base"], own["platform"],
                                              kind.joints == "ropes"),),
                   lambda wrench: row("load", 1, 1), lambda wrench: row("forces", 1, 1, 3),
                   row("weight", 1, 3), np.array([0.0, -1.0, 0.0]), np.eye(3)[None],
                   history=history, place=np.array([1]), past_load_of=lambda: past("load", 1),
                   pose_of=lambda: np.array([[fields.get(c, 0.0) for c in "xyz"] + [0.0] * 3]),
                   touch=np.array([bool(fields.get("touch"))]),
                   tensions_of=lambda on: np.where(on, row("tension", 1, 1), 0.0),
                   tension_of=lambda wrench: row("pull", 1, 1), span_of=lambda: row("span", 1, 1))


def first_change(kind: EffectKind, values: Mapping[str, float], **fields: float) -> float:
    """Return what an effect adds: to u or a slot, the pose, the wrench or a measured 1 m."""
    if kind.carried is not None:
        wrench = kind.carried(one_row(kind, wrench=0.0, **fields), values)[1][0]
        return float(wrench[np.flatnonzero(wrench)[0]])
    shift = kind.evaluate(one_row(kind, **fields), np.array([True]), values).shift
    if shift.slots:
        return float(np.ravel(next(iter(shift.slots.values())))[0])
    for twist in (shift.pose, shift.frame, shift.target):
        if twist is not None:
            return float(twist[0][np.flatnonzero(twist[0])[0]])
    assert shift.stretch is not None
    return float(shift.stretch[0, 0, 0])


def test_the_contracts_kinds_are_there() -> None:
    assert set(CONTRACT) <= set(effect_kinds())


@each_kind
def test_worked_case(kind: str) -> None:
    """Every kind shows one case in plain numbers, and it comes out."""
    found = effect_kinds()[kind]
    assert found.worked is not None
    result = first_change(found, found.worked.values, **found.worked.setting)
    assert found.worked.result != 0.0
    assert result == pytest.approx(found.worked.result, rel=1e-12)


@each_kind
def test_what_belongs_to_actuators_does_nothing_on_none(kind: str) -> None:
    """What does nothing there belongs to them, or to a body of the machine."""
    found = effect_kinds()[kind]
    assert found.worked is not None
    shift = found.evaluate(one_row(found, **found.worked.setting), np.array([False]),
                           found.worked.values).shift
    parts = [*shift.slots.values(), *(p for p in (shift.pose, shift.frame, shift.target,
                                                  shift.stretch) if p is not None)]
    nothing = all(np.all(p == 0.0) for p in parts)
    assert nothing == (found.per_actuator or (bool(found.body) and nothing))


@each_kind
def test_described(kind: str) -> None:
    """Every kind says its equation and source, and its parameters what they are."""
    found = effect_kinds()[kind]
    assert found.name == kind
    assert found.equation
    assert found.source
    assert set(found.needs) <= COLUMNS
    for motion in found.motions:
        specs = found.parameters(motion)
        assert specs
        assert len({s.name for s in specs}) == len(specs)
        for s in specs:
            above, _, below = s.quantity.partition("/")
            assert above in ("length", "angle", "joint", "load", "1", "s"), s.name
            assert below in ("", "length", "angle", "joint", "load", "s", "K", "N", "N.m"), s.name
            assert s.low < s.high
            assert s.default is None or np.isnan(s.default) or s.low <= s.default <= s.high


FOLLOWED = {
    "gain": "travel", "curvature": "travel", "eccentricity": "travel", "periodic": "phase",
    "backlash": "direction", "windup": "wound load", "lag": "velocity", "compliance": "load",
    "clearance": "load", "base_compliance": "wrench", "leg_thermal": "temperature",
    "base_thermal": "temperature", "platform_thermal": "temperature", "drift": "time",
    "sensor_scale": "point", "tilt": "point", "zero_shift": "row", "target_shift": "row",
    "base_shift": "row"}


@pytest.mark.parametrize("kind", CONTRACT)
def test_what_residuals_are_drawn_against(kind: str) -> None:
    assert effect_kinds()[kind].input.name == FOLLOWED[kind]


@each_kind
def test_traits_fit_together(kind: str) -> None:
    """Traits name parameters, slots and components that there are; a scan stays in its range."""
    found = effect_kinds()[kind]
    slots = {s.name for limb in limb_kinds().values() for s in limb.slots}
    assert set(found.same_as) <= slots
    assert not found.remedy.endswith(".")
    for motion in found.motions:
        specs = {s.name: s for s in found.parameters(motion)}
        assert not found.period or specs[found.period].nonlinear
        assert len(found.stroke_ends(motion)) in (0, 2)
        for s in specs.values():
            assert s.component in ("", *WRENCH)
            assert not (s.constant and s.nonlinear) or s.name in (found.onset, "at")
            assert not s.optional or (s.nonlinear and s.default == 0.0)
            assert s.low < 0.0 or not s.scaling or s.default is None
            data = ScanRange(0.3, 20, tuple(range(1, 21)), 50.0, 0.4, 0.2)
            tried = s.scan(data) if s.scan is not None else []
            assert all(s.low <= v <= s.high for v in tried)
            assert (len(tried) > 1) == s.nonlinear
    rows, k = 5, 2
    inputs = Inputs(*(np.ones((rows, k)) for _ in range(4)), np.ones(rows), np.ones((rows, 6)),
                  np.ones(rows), np.ones(rows), np.ones((rows, 6)), np.ones((rows, 3)),
                    np.ones((rows, k)))
    shape = found.input.value(inputs).shape
    parts = len(found.input.components)
    assert shape == (rows, parts) if parts else shape in ((rows,), (rows, k))


@pytest.mark.parametrize(("change", "words"), [
    ({"needs": ("humidity",)}, "needs humidity; columns are dir, vel, load"),
    ({"name": "geometry"}, "an error of slots already"),
    ({"period": "gain"}, "the period 'gain' is not a parameter with a scan")])
def test_a_kind_that_makes_no_sense(change: dict[str, Any], words: str) -> None:
    """An unknown column, the name of the geometry, a period that no search tries."""
    with pytest.raises(ValueError, match=words):
        replace(effect_kinds()["gain"], **change)


WORKED = [  # kind, parameters, setting, what the contract's table says
    ("gain", {"gain": 1e-3}, {"travel": -0.4}, -4e-4),
    ("periodic", {"cos": 2e-5, "sin": 7e-5, "period": 0.4}, {"travel": 0.2}, -2e-5),
    ("eccentricity", {"cos": 0.0, "sin": 0.0, "cos2": 0.0, "sin2": 3e-4},
     {"travel": np.pi / 4.0}, 3e-4),
    ("eccentricity", {"cos": 5e-4, "sin": 0.0, "cos2": 3e-4, "sin2": 0.0}, {"travel": np.pi},
     -2e-4),
    ("backlash", {"width": 2e-5}, {"approach": 1.0}, 1e-5),
    ("windup", {"width": 1e-7}, {"approach": 1.0, "load": -50.0}, 5e-6),
    ("lag", {"tau": 2e-3}, {"velocity": -0.05}, 1e-4),
    ("compliance", {"stiffness": 1e7}, {"load": -200.0}, -2e-5),
    ("clearance", {"width": 2e-5}, {"load": 3.0}, 1e-5),
    ("clearance", {"width": 2e-5}, {"load": 0.0}, 0.0),
    ("leg_thermal", {"expansion": 1e-5, "tau": 0.0}, {"temperature": -3.0, "struts": 0.7}, -2.1e-5),
    ("base_thermal", {"expansion": 1e-5, "tau": 0.0}, {"temperature": -3.0, "base": -0.7}, 2.1e-5),
    ("platform_thermal", {"expansion": 1e-5, "tau": 0.0}, {"temperature": 3.0, "platform": 0.2},
     6e-6),
    ("tilt", {"shrink": 1e-3, "direction": np.pi / 3.0}, {}, -2.5e-4),
    # P2 = (3 s^2 - 1)/2, P3 = (5 s^3 - 3 s)/2, P4 = (35 s^4 - 30 s^2 + 3)/8 at s = 1/2
    ("curvature", {"p2": 1e-4, "p3": 0.0, "p4": 0.0, "low": 1.0, "high": 5.0}, {"travel": 4.0},
     -0.125e-4),
    ("curvature", {"p2": 0.0, "p3": 1e-4, "p4": 0.0, "low": 1.0, "high": 5.0}, {"travel": 4.0},
     -0.4375e-4),
    ("curvature", {"p2": 0.0, "p3": 0.0, "p4": 1e-4, "low": 1.0, "high": 5.0}, {"travel": 4.0},
     -0.2890625e-4),
]


@pytest.mark.parametrize(("kind", "values", "fields", "result"), WORKED)
def test_the_contracts_equations(kind: str, values: dict[str, float], fields: dict[str, float],
                                 result: float) -> None:
    """Signs and factors of the contract's table."""
    found = first_change(effect_kinds()[kind], values, **fields)
    assert found == pytest.approx(result, rel=1e-12, abs=1e-20)


# --- nothing comes of nothing -----------------------------------------------------------------

def nothing(mechanism: Mechanism, kind: str) -> dict[str, float]:
    """Return parameters at which the effect adds nothing."""
    keep = {"period": 0.3, "low": -0.5, "high": 2.9, "stiffness": 1e12, "direction": 0.4,
            "reach": 0.2, "speed": 0.04, "radius": 0.1}
    if kind == "creep":
        keep["tau"] = 90.0
    return {n: keep.get(n, 0.0) for n in sizes(mechanism, kind)}


@few_cases
def test_zero_parameters_change_nothing(name: str, kind: str) -> None:
    """Neither the pose nor the joints nor what is measured, to the last digit."""
    mechanism = machine(name)
    q, rows = sample(mechanism)
    still = acting(mechanism, {"kind": kind, **beside(mechanism, kind),
                               "parameters": nothing(mechanism, kind)})
    still = still.with_values(np.where(still.values == 1e12, 1e30, still.values))
    found = reached_poses(Model(still), q, rows)
    for i in range(len(mechanism.limbs)):
        np.testing.assert_array_equal(found.model.joint_coordinate(i, q),
                                      Model(mechanism).joint_coordinate(i, q))
    # loads are found by repetition, whose last steps round off
    np.testing.assert_allclose(found.pose, bare(mechanism), rtol=0.0,
                               atol=1e-14 if uses_load(still) else 0.0)
    shift = found.model.shift
    assert shift is not None
    assert shift.stretch is None or not shift.stretch.any()


# --- derivatives --------------------------------------------------------------------------------

def registration_of(mechanism: Mechanism) -> Registration:
    """Return an instrument that stands askew and sees a point off the platform's origin."""
    flat = mechanism.motion.planar
    frame = np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.4] if flat
                     else [0.3, -0.2, 0.5, 0.2, -0.3, 0.4]) * ([mechanism.reach] * 3 + [1.0] * 3)
    target = mechanism.reach * np.array([0.05, -0.03, 0.0 if flat else 0.04])
    turn = np.array([0.0, 0.0, 0.1] if flat else [0.1, -0.2, 0.05])
    return Registration.of_pose(frame, target, turn)


def measured(plain: Mechanism, mechanism: Mechanism) -> tuple[Problem, State]:
    """Return a fit of exact measurements, frame and target open, and its solution.

    Positions move by much less than the reach, and by more than nothing.
    """
    q, rows = sample(plain)
    q, found = consistent_joints(Model(mechanism), q, rows)
    shift = found.model.shift
    assert shift is not None
    pose = displaced(found.pose, shift)
    moved = np.abs(stretched(cga.translation(pose), shift.stretch)
                   - cga.translation(bare(plain))).max()
    assert 1e-9 * mechanism.reach < moved < 3e-3 * mechanism.reach
    registration = registration_of(mechanism)
    seen = measured_pose(registration, pose)
    seen[:, :3] = stretched(seen[:, :3], shift.stretch)
    if mechanism.motion.planar:
        seen[:, 2:5] = np.nan
    if not mechanism.motion.turns:
        seen[:, 3:] = np.nan
    data = Dataset.of_poses("d", q, seen, (1.0, 1.0), fitted=True)
    data = replace(data, columns=recorded(plain, q))
    state = State(mechanism.values, (registration,), (found.closed,))
    touched = any("touch" in e.kind.needs for e in mechanism.effects)
    return Problem(mechanism, (data,), mechanism.free, given=(rows,) if touched else None), state


BLIND = 1e-12
"""A derivative below this is none: turns of an axis about itself, say."""


def directions(problem: Problem, jacobian: Array) -> dict[str, Array]:
    """Return small steps (C,): each effect parameter, and mixtures of all other columns.

    A step moves what is measured by some 1e-6 of the reach, each column of a mixture alike.
    """
    names = list(problem.columns)
    scale = np.abs(jacobian).max(axis=(0, 1))
    reach_ = max(problem.mechanism.reach, 0.1)
    size = 1e-6 * reach_ / np.where(scale > BLIND, scale, reach_)
    values = dict(zip(problem.mechanism.names, problem.mechanism.values, strict=True))
    for c, name in enumerate(names):
        # what acts through a curve needs steps that are small against the value itself
        part = {"period": 1e-5, "stiffness": 1e-2, "direction": 1e-3, "hardening": 1e-2,
                "reach": 1e-3, "turn": 1e-2, "first": 1e-2, "second": 1e-2, "tau": 1e-3,
                "speed": 1e-3}.get(name.rsplit(".")[-1])
        if name in values and part is not None:
            size[c] = part * values[name]
    effects = problem.mechanism.effects
    place = {p: c for c, p in enumerate(problem.free)}
    groups: dict[str, list[int]] = {}
    for e in effects:
        free = [place[p] for p in e.parameters.values() if p in place]
        if free:
            groups.setdefault(e.kind.name, []).extend(free)
    own = {c for group in groups.values() for c in group}
    groups["geometry and registration"] = [c for c in range(len(names)) if c not in own]
    out = {}
    rng = np.random.default_rng(5)
    for group, members in groups.items():
        if len(groups) == 2 and group == effects[-1].kind.name and len(members) <= 6:
            out |= {names[c]: size * (np.arange(len(names)) == c) for c in members}
            continue
        step = np.zeros(len(names))
        step[members] = size[members] * rng.choice([-1.0, 1.0], len(members))
        out[group] = step
    return out


def slopes_apart(problem: Problem, state: State) -> dict[str, float]:
    """Return by direction how far derivatives are from differences, as a part of the largest."""
    def white(step: Array) -> Array:
        # at no residual, how the noise itself changes with the machine adds nothing
        return np.concatenate([r.residual for r in problem.rows(
            problem.moved(state, step), False)])

    jacobian = np.concatenate([r.jacobian for r in problem.rows(state)])
    out = {}
    for name, step in directions(problem, jacobian).items():
        found = -(white(step) - white(-step)) / 2.0
        scale = float(np.sum(np.abs(jacobian).max(axis=(0, 1)) * np.abs(step)))
        out[name] = float(np.abs(found - jacobian @ step).max()) / scale
    return out


def flat(shift: Shift, n: int) -> dict[object, Array]:
    """Return all that a shift of N rows adds, by slot or part."""
    whole = {"pose": shift.pose, "stretch": shift.stretch, "frame": shift.frame,
             "target": shift.target}
    return {s: np.broadcast_to(v, (n,)) for s, v in shift.slots.items()} | {
        part: v for part, v in whole.items() if v is not None}


@few_cases
def test_terms_say_their_own_derivatives(name: str, kind: str) -> None:
    """What an effect adds, row by row, by each of its parameters, against differences."""
    mechanism = with_kind(machine(name), kind)
    q, rows = sample(machine(name))
    at = setting(Model(mechanism), rows, q, bare(machine(name)))
    effect = mechanism.effects[-1]
    on = np.array(effect.on)
    values = {n: float(mechanism.values[p]) for n, p in effect.parameters.items()}

    def shift(parameter: str, step: float) -> dict[object, Array]:
        moved = values | {parameter: values[parameter] + step}
        return flat(effect.kind.evaluate(at, on, moved).shift, len(q))

    for parameter, slope in effect.kind.evaluate(at, on, values).by.items():
        step = 1e-5 * (abs(values[parameter]) or 1e-2)
        above, below = shift(parameter, step), shift(parameter, -step)
        for part, told in flat(slope, len(q)).items():
            # a term whose size is nothing is left out of the sum
            differs = (above.get(part, 0.0) - below.get(part, 0.0)) / (2.0 * step)
            np.testing.assert_allclose(told, differs, rtol=0.0, err_msg=f"{parameter}: {part}",
                                       atol=3e-7 * max(np.abs(told).max(), 1e-12))


def assert_derivatives(name: str, kinds: tuple[str, ...]) -> None:
    plain = machine(name)
    acted = plain
    for kind in kinds:
        acted = with_kind(acted, kind, free=True)
    problem, state = measured(plain, acted)
    residual = np.concatenate([r.raw for r in problem.rows(state)])
    assert np.abs(residual).max() < 1e-13 * max(1.0, plain.reach)
    allowed = 1e-3 if uses_load(acted) else 1e-5
    apart = slopes_apart(problem, state)
    assert len(apart) >= 1 + len(kinds)
    assert {n: a for n, a in apart.items() if a > allowed} == {}


@pytest.mark.long_cases("3-RPS-payload_offset")
@pytest.mark.slow
@one_each
def test_derivatives_against_differences(name: str, kind: str) -> None:
    """By the effect's parameters, and by geometry, frame and target with the effect at work."""
    assert_derivatives(name, (kind,))


READ: dict[str, Mapping[str, Any]] = {
    "heat of motion": {"kind": "base_thermal", "from": "motion",
                       "parameters": {"growth": 0.1, "tau": 70.0}},
    "compliance about base": {"kind": "base_compliance", "about": "base"}}


def about_base(mechanism: Mechanism) -> dict[str, float]:
    """Return moderate values of every compliance of the base: it turns by less than 1e-5 rad."""
    kind = find_effect("base_compliance").from_file.make({"about": "base"}, SI, "length")
    size = max(1.0, mechanism.reach)
    return {s.name: 1e-8 * (1.0 - 0.3 * (i % 4)) / size ** (
        s.name.startswith("r") + s.name[-2:-1].count("m"))
        for i, s in enumerate(kind.parameters(mechanism.motion))}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "read"), [(n, r) for n in FEW for r in READ if (
    n, r) != ("delta-rotary", "compliance about base")])
def test_derivatives_of_what_a_file_makes(name: str, read: str) -> None:
    """As above, of kinds that are other ones by an entry of the file."""
    plain, entry = machine(name), READ[read]
    values = entry.get("parameters") or about_base(plain)
    acted = acting(plain, {**entry, "parameters": {
        n: {"value": v, "free": True} for n, v in values.items()}})
    problem, state = measured(plain, acted)
    assert {n: a for n, a in slopes_apart(problem, state).items() if a > 1e-3} == {}


@pytest.mark.long_cases("6-RUS-loaded", "6-UPS-loaded", "linapod-light")
@pytest.mark.slow
@pytest.mark.parametrize("heavy", [False, True], ids=["light", "loaded"])
@pytest.mark.parametrize("name", sorted(set(MACHINES) - set(FEW)))
def test_derivatives_with_all_effects_at_work(name: str, heavy: bool) -> None:
    """The same on machines with six legs: all kinds together, those that need loads apart."""
    # what changes the load itself has its own cases: together they give way too far for a step
    kinds = tuple(k for n, k in CASES if n == name and effect_kinds()[k].uses_load == heavy
                  and effect_kinds()[k].carried is None)
    assert len(kinds) >= 3
    assert_derivatives(name, kinds)


@pytest.mark.slow
def test_load_derivatives_lack_only_the_loads_own_change() -> None:
    """What is left out shrinks with the deflection."""
    soft = machine("3-RPR")
    apart = []
    for stiffness in (1e5, 1e6, 1e7):
        problem, state = measured(soft, acting(soft, {"kind": "compliance",
            "parameters": {"stiffness": {"value": stiffness, "free": True}}}))
        apart.append(slopes_apart(problem, state)["compliance.stiffness"])
    assert apart[0] > 5.0 * apart[1] > 25.0 * apart[2]


# --- loads --------------------------------------------------------------------------------------

def load_machines() -> dict[str, Mechanism]:
    """Return every kind of limb with ratios and offsets, deltas, and machines of mixed limbs."""
    out = {f"full {k}": full(k) for k in KINDS}
    out |= {f"delta {k} {n}": delta(k, n) for k in ("(P)US", "(R)US") for n in (3, 6)}
    out |= {f"mixed {k}": mixed(k) for k in ("planar", "spatial")}
    return out | {name: machine(name) for name in MACHINES}


LOADED = load_machines()


@pytest.mark.slow
@pytest.mark.parametrize("name", LOADED)
def test_loads_by_virtual_work(name: str) -> None:
    """f_i du_i is the work of the wrench on the pose's change, joint by joint."""
    mechanism = LOADED[name]
    model = Model(mechanism)
    q, pose = spread(model, 4, size=0.5)
    rng = np.random.default_rng(2)
    wrench = rng.uniform(-1.0, 1.0, (4, 6)) * ([100.0] * 3 + [100.0 * mechanism.reach] * 3)
    # the work of what the motion cannot do is nothing
    wrench[:, [i for i in range(6) if i not in mechanism.dof]] *= 7.0
    found = loads(model, q, pose, wrench)
    assert found.shape == q.shape
    ratio = np.ones(q.shape[1])
    for limb in mechanism.limbs:
        ratio[limb.actuator] = limb.slots.values(model.parameters).get("ratio", 1.0)
    h = 1e-5 * np.array([mechanism.reach if a == "length" else 1.0
                         for a in mechanism.actuator_quantity])
    for a in range(q.shape[1]):
        step = np.zeros(q.shape[1])
        step[a] = h[a] / ratio[a]
        ahead, behind = (forward(model, q + way * step, pose, q).pose for way in (1.0, -1.0))
        # differences of rotation vectors of small turns, base axes, about the origin
        move = (difference(ahead, pose) - difference(behind, pose)) / (2.0 * h[a])
        work = np.sum(wrench * move, axis=1)
        np.testing.assert_allclose(found[:, a], work, rtol=0.0,
                                   atol=1e-7 * float(np.abs(found).max()), err_msg=str(a))


def test_a_weight_pulls_struts_shut() -> None:
    """f is positive where the wrench pushes towards larger u: a weight on legs is negative."""
    legs = machine("6-UPS")
    q, pose = spread(Model(legs), 1, size=0.0)
    rows = environment({"payload": np.array([100.0])}, legs.actuators, legs.gravity, q)
    np.testing.assert_allclose(rows.wrench[0], [0.0, 0.0, -980.665, 0.0, 0.0, 0.0], rtol=1e-15)
    f = loads(Model(legs), q, pose, rows.wrench)
    assert (f < -150.0).all()
    assert np.abs(f).max() < 980.665
    soft = Model(acting(legs, {"kind": "compliance", "parameters": {"stiffness": 1e6}}))
    sunk = reached_poses(soft, q, rows)
    assert cga.translation(sunk.pose)[0, 2] < cga.translation(pose)[0, 2] - 1e-4


def test_no_load_where_nothing_bears_it() -> None:
    """Rows without a wrench, and rows without a pose, have no load."""
    mechanism = machine("3-RPR")
    q, pose = spread(Model(mechanism), 4)
    wrench = np.full((4, 6), 10.0)
    wrench[0, 3] = np.nan
    pose[1], q[2] = np.nan, np.nan
    found = loads(Model(mechanism), q, pose, wrench)
    assert np.isnan(found[:3]).all()
    assert np.isfinite(found[3]).all()


# --- equilibrium --------------------------------------------------------------------------------

def soft_drive(mechanism: Mechanism, rows: Environment, q: Array, part: float) -> float:
    """Return the stiffness at which the largest load deflects by a part of the reach, or rad."""
    f = loads(Model(mechanism), q, forward(Model(mechanism), q).pose, rows.wrench)
    return float(np.nanmax(np.abs(f)) / (part * (
        mechanism.reach if mechanism.actuator_quantity[0] == "length" else 1.0)))


@pytest.mark.slow
@each_machine
def test_equilibrium_of_a_very_soft_drive(name: str) -> None:
    """Deflections of centimetres: u = ratio q + offset + f/k with f at that very pose."""
    mechanism = machine(name)
    q, rows = sample(mechanism, 5, 0.3)
    k = soft_drive(mechanism, rows, q, 0.02)
    soft = Model(acting(mechanism, {"kind": "compliance", "parameters": {"stiffness": k}}))
    found = reached_poses(soft, q, rows)
    assert np.isfinite(found.closed).all()
    there = inverse(Model(mechanism), found.closed)
    assert there.reached.all()
    f = loads(Model(mechanism), there.q, found.closed, rows.wrench)
    size = mechanism.reach if mechanism.actuator_quantity[0] == "length" else 1.0
    assert np.abs(f / k).max() > 0.01 * size
    np.testing.assert_allclose(there.q, q + f / k, rtol=0.0, atol=1e-9 * size)


def test_equilibrium_with_a_ratio() -> None:
    """The deflection is one of u; with a ratio of -2.5 the joint value changes by less."""
    mechanism = full("U(P)S")
    q, rows = sample(mechanism, 4, 0.3)
    k = soft_drive(mechanism, rows, q, 0.02)
    found = reached_poses(Model(acting(mechanism, {"kind": "compliance", "parameters": {
        "stiffness": k}})), q, rows)
    there = inverse(Model(mechanism), found.closed)
    f = loads(Model(mechanism), there.q, found.closed, rows.wrench)
    ratio = np.array([limb.slots.values(mechanism.values).get("ratio", 1.0)
                      for limb in mechanism.limbs])
    assert len(set(ratio)) == 3
    np.testing.assert_allclose(ratio * there.q, ratio * q + f / k, rtol=0.0,
                               atol=1e-9 * mechanism.reach)


def test_rows_do_not_depend_on_each_other() -> None:
    """A row that nobody knows the load of, or that cannot be reached, spoils no other."""
    mechanism = machine("6-UPS")
    q, rows = sample(mechanism, 5)
    soft = Model(acting(mechanism, {"kind": "compliance", "parameters": {"stiffness": 1e5}}))
    alone = reached_poses(soft, q[3:4], rows.take(np.array([3]))).pose
    wrench = rows.wrench.copy()
    wrench[0] = np.nan
    q = q.copy()
    q[1, 0] = 50.0
    q[2, 3] = np.nan
    found = reached_poses(soft, q, replace(rows, wrench=wrench)).pose
    assert np.isnan(found[:3]).all()
    np.testing.assert_allclose(found[3:4], alone, rtol=0.0, atol=1e-11)


# --- the way back -------------------------------------------------------------------------------

def wanted_about(mechanism: Mechanism) -> Array:
    """Return wanted poses (4, 6) about home; a machine with few drives leaves some open."""
    wanted = pose_vector(bare(mechanism))
    short = mechanism.equations - len(mechanism.actuators)
    if short:
        wanted[:, [0, 1, 5]] = np.nan
    if mechanism.motion.planar:
        wanted[:, 2:5] = 0.0
    return wanted


@pytest.mark.slow
@one_each
def test_joints_that_make_up_for_effects(name: str, kind: str) -> None:
    """The joints of the inverse reach the wanted pose, and are others than without effects."""
    plain, mechanism = machine(name), with_kind(machine(name), kind)
    wanted, rows = wanted_about(plain), sample(plain)[1]
    table = inverse_table(Model(mechanism), wanted, rows)
    assert set(table.status) == {"ok"}
    found = reached_poses(Model(mechanism), table.q, rows)
    named = np.isfinite(wanted)
    got = pose_vector(found.pose)
    np.testing.assert_allclose(got[named], wanted[named], rtol=0.0, atol=1e-9 * mechanism.reach)
    np.testing.assert_allclose(table.pose, got, rtol=0.0, atol=1e-9 * max(1.0, mechanism.reach))
    assert found.model.shift is not None
    shift = found.model.shift
    acts = shift.stretch is None and shift.frame is None and shift.target is None
    assert acts == (np.abs(table.q - sample(plain)[0]).max() > 1e-10 * mechanism.reach)


@each_machine
def test_forward_table_with_effects(name: str) -> None:
    """The table of poses is where the machine goes."""
    mechanism = acting(machine(name), *({"kind": k, "parameters": sizes(machine(name), k)}
                                        for k in ("compliance", "backlash", "drift")))
    q, rows = sample(machine(name))
    table = forward_table(Model(mechanism), q, rows)
    assert set(table.status) == {"ok"}
    reached = reached_poses(Model(mechanism), q, rows).pose
    np.testing.assert_allclose(table.pose, pose_vector(reached), rtol=0.0, atol=1e-11)


@pytest.mark.slow
def test_the_way_back_with_soft_drives_and_all_else() -> None:
    """Deflections of centimetres and six further effects, open coordinates solved for."""
    for name in ("6-UPS", "3-RPS"):
        mechanism = machine(name)
        wanted = wanted_about(mechanism)
        q, rows = sample(mechanism)
        k = soft_drive(mechanism, rows, q, 0.02)
        kinds = ("backlash", "drift", "base_compliance", "leg_thermal", "windup", "gain")
        whole = acting(mechanism, {"kind": "compliance", "parameters": {"stiffness": k}},
                       *({"kind": n, "parameters": {p: 10.0 * v for p, v in
                          sizes(mechanism, n).items()}} for n in kinds))
        table = inverse_table(Model(whole), wanted, rows)
        assert set(table.status) == {"ok"}, name
        got = pose_vector(reached_poses(Model(whole), table.q, rows).pose)
        named = np.isfinite(wanted)
        np.testing.assert_allclose(got[named], wanted[named], rtol=0.0,
                                   atol=1e-9 * mechanism.reach)


@pytest.mark.parametrize("turn", [np.pi - 1e-9, np.pi, np.pi + 0.4, -3.5])
def test_the_way_back_beyond_half_a_turn(turn: float) -> None:
    """A platform wanted beyond half a turn is not asked to turn by another whole one."""
    home = {"x": 0.0, "y": 0.0, "rz": float(turn)}
    mechanism = full("R(P)R")
    mechanism = replace(mechanism, home_pose=np.array([*mechanism.home_pose[:5], turn]))
    wanted = np.array([[home["x"], home["y"], 0.0, 0.0, 0.0, turn]])
    drifting = acting(mechanism, {"kind": "drift", "parameters": {
        "x": 1e-6, "y": 2e-6, "rz": 1e-6}})
    rows = environment({"time": np.array([100.0])}, mechanism.actuators, mechanism.gravity,
                       np.zeros((1, 3)))
    table = inverse_table(Model(drifting), wanted, rows)
    plain = inverse_table(Model(mechanism), wanted - [[1e-4, 2e-4, 0.0, 0.0, 0.0, 1e-4]])
    np.testing.assert_allclose(table.q, plain.q, rtol=0.0, atol=1e-12)


def test_what_is_not_given_is_said_row_by_row() -> None:
    mechanism = with_kind(machine("3-RPR"), "backlash")
    wanted = wanted_about(machine("3-RPR"))[:3]
    columns = {f"dir_{a}": np.array([1.0, np.nan, -1.0]) for a in mechanism.actuators}
    rows = environment(columns, mechanism.actuators, mechanism.gravity, np.zeros((3, 3)))
    table = inverse_table(Model(mechanism), wanted, rows)
    assert [s == "ok" for s in table.status] == [True, False, True]
    assert "not given" in table.reason[1]
    back = forward_table(Model(mechanism), np.nan_to_num(table.q, nan=0.45), rows)
    assert np.isnan(back.pose[1]).any()
    assert "not given" in back.reason[1]
    assert back.status[0] == back.status[2] == "ok"


# --- physics ------------------------------------------------------------------------------------

@pytest.mark.parametrize("name", ["6-UPS", "3-RPR", "3-RPS", "6-RUS", "delta-rotary", "3-RRR-1"])
def test_a_machine_that_grows_evenly_keeps_its_shape(name: str) -> None:
    """Base, legs and platform alike: the platform's turn stays and its place scales."""
    mechanism = machine(name)
    q, rows = sample(mechanism, 4)
    rows = replace(rows, temperature=np.array([15.0, -20.0, 3.0, 0.0]))
    grown = acting(mechanism, *({"kind": f"{part}_thermal", "parameters": {"expansion": 23e-6}}
                                for part in ("leg", "base", "platform")))
    plain, found = (pose_vector(reached_poses(Model(m), q, rows).pose) for m in (mechanism, grown))
    factor = 1.0 + 23e-6 * rows.temperature
    np.testing.assert_allclose(found[:, :3], plain[:, :3] * factor[:, None], rtol=0.0,
                               atol=1e-12 * mechanism.reach)
    np.testing.assert_allclose(found[:, 3:], plain[:, 3:], rtol=0.0, atol=1e-11)


def test_twists_of_the_platform_are_about_its_origin() -> None:
    """Drift and frame compliance displace origin and axes apart from each other."""
    mechanism = machine("6-UPS")
    q, rows = sample(mechanism, 3)
    plain = forward(Model(mechanism), q).pose
    values = {"x": 1e-7, "y": -2e-7, "z": 3e-7, "rx": 1e-6, "ry": 2e-6, "rz": -1e-6}
    drifting = acting(mechanism, {"kind": "drift", "parameters": values})
    found = reached_poses(Model(drifting), q, rows)
    np.testing.assert_allclose(difference(found.pose, plain),
                               np.outer(rows.time, list(values.values())), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found.closed, plain, rtol=0.0, atol=1e-14)
    soft = acting(mechanism, {"kind": "base_compliance", "parameters": {"x_my": 1e-9,
                                                                        "rz_fz": 3e-9}})
    moved = difference(reached_poses(Model(soft), q, rows).pose, plain)
    np.testing.assert_allclose(moved[:, 0], 1e-9 * rows.wrench[:, 4], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(moved[:, 5], 3e-9 * rows.wrench[:, 2], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(moved[:, 1:5], 0.0, rtol=0.0, atol=1e-13)


def test_effects_add_up_and_act_where_they_are_put() -> None:
    """Two effects of one kind on different joints; u = ratio q + offset + both."""
    mechanism = full("U(P)S")
    q, rows = sample(mechanism, 4)
    a = mechanism.actuators
    both = acting(mechanism, {"kind": "backlash", "on": [a[1]], "parameters": {"width": 4e-5}},
                  {"kind": "backlash", "on": [a[4], a[1]], "parameters": {"width": 2e-5}},
                  {"kind": "lag", "on": [a[1]], "parameters": {"tau": 1e-3}})
    assert both.names[-3:] == (f"backlash.{a[1]}.width", f"backlash.{a[1]}+{a[4]}.width",
                               f"lag.{a[1]}.tau")
    found = reached_poses(Model(both), q, rows).model
    ratio = mechanism.limbs[1].slots.values(mechanism.values)["ratio"]
    for i in range(6):
        own = Model(mechanism).joint_coordinate(i, q)
        extra = {1: 3e-5 * rows.approach[:, 1] - 1e-3 * ratio * rows.velocity[:, 1],
                 4: 1e-5 * rows.approach[:, 4]}.get(i, 0.0)
        np.testing.assert_allclose(found.joint_coordinate(i, q), own + extra, rtol=0.0,
                                   atol=1e-15)


def test_limbs_that_share_a_drive_share_its_error() -> None:
    """Both rods of a pair see the same backlash: the platform stays level."""
    mechanism = delta("(P)US", 6)
    q, rows = sample(mechanism, 4)
    loose = acting(mechanism, {"kind": "backlash", "parameters": {"width": 1e-4}})
    found = reached_poses(Model(loose), q, rows)
    same = forward(Model(mechanism), q + 0.5e-4 * rows.approach).pose
    np.testing.assert_allclose(found.pose, same, rtol=0.0, atol=1e-13)


def test_the_stroke_comes_from_the_file_the_limits_or_the_data() -> None:
    """In that order; P2 is 1 at both ends of the stroke."""
    bounded, free = machine("3-RPR"), full("R(P)R")
    low, high = bounded.limits.T
    for mechanism, q in ((bounded, np.stack([low, high])),
                         (free, spread(Model(free), 5)[0])):
        curved = acting(mechanism, {"kind": "curvature", "parameters": {"p2": 1e-4}})
        known = Model(with_strokes(curved, q))
        rows = unknown_environment(*q.shape)
        shift = shifted(known, rows, q, np.full((len(q), 8), np.nan)).shift
        change = np.stack([shift.slots[i, "offset"] for i in range(3)], axis=-1)
        assert change.max() == pytest.approx(1e-4, rel=1e-12)
        if mechanism is bounded:
            np.testing.assert_allclose(change, 1e-4, rtol=1e-12)
    given = acting(bounded, {"kind": "curvature", "parameters": {"p2": 1e-4, "low": 0.0,
                                                                 "high": 0.9}})
    shift = shifted(Model(with_strokes(given, low[None])), unknown_environment(1, 3),
                    np.array([[0.45, 0.9, 0.0]]), np.full((1, 8), np.nan)).shift
    np.testing.assert_allclose([shift.slots[i, "offset"][0] for i in range(3)],
                               [-0.5e-4, 1e-4, 1e-4], rtol=1e-12)


# --- conditions ---------------------------------------------------------------------------------

def test_environment_of_columns() -> None:
    """Payload along gravity plus the given wrench; temperature above 20 degrees Celsius."""
    columns = {"payload": np.array([2.0, np.nan]), "fy": np.array([5.0, 5.0]),
               "mz": np.array([1.0, 1.0]), "temperature": np.array([295.15, 293.15]),
               "vel_b": np.array([0.3, -0.1])}
    rows = environment(columns, ["a", "b"], np.array([0.0, -0.6, -0.8]), np.zeros((2, 2)))
    np.testing.assert_allclose(rows.wrench[0], [0.0, 5.0 - 2.0 * 9.80665 * 0.6,
                                                -2.0 * 9.80665 * 0.8, 0.0, 0.0, 1.0], rtol=1e-15)
    assert np.isnan(rows.wrench[1, :3]).any()
    np.testing.assert_allclose(rows.temperature, [2.0, 0.0])
    np.testing.assert_array_equal(rows.velocity, [[np.nan, 0.3], [np.nan, -0.1]])
    assert np.isnan(rows.approach).all()
    assert np.isnan(rows.time).all()


def test_ways_of_a_sequence() -> None:
    """A joint at rest keeps its direction; nothing is known before it has moved."""
    q = np.array([[0.0, 1.0, 0.0], [1.0, 1.0, -1.0], [1.0, 0.5, -1.0], [0.5, 0.5, 2.0]])
    np.testing.assert_array_equal(ways(q), [[np.nan, np.nan, np.nan], [1.0, np.nan, -1.0],
                                            [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]])
    rows = environment({}, ["a", "b", "c"], np.array([0.0, 0.0, -1.0]), q, sequence=True)
    np.testing.assert_array_equal(rows.approach, ways(q))


def test_directions_of_the_platform_become_directions_of_joints() -> None:
    """dir_x, dir_y: the side from which each joint came if the platform moved that way."""
    mechanism = machine("3-RPR")
    model = Model(mechanism)
    q, pose = spread(model, 4)
    way = np.array([[1.0, np.nan], [-1.0, np.nan], [np.nan, 1.0], [1.0, -1.0]])
    data = Dataset.of_poses("d", q, pose_vector(pose), (1.0, 1.0), fitted=False)
    rows = environment_of(mechanism, replace(data, columns={"dir_x": way[:, 0],
                                                           "dir_y": way[:, 1]}))
    step = np.zeros((4, 6))
    step[:, :2] = 1e-5 * np.nan_to_num(way)
    moved = inverse(model, pose_motor(pose_vector(pose) + step)).q
    np.testing.assert_array_equal(rows.approach, np.sign(moved - q))
    both = environment_of(mechanism, replace(data, columns={
        "dir_x": way[:, 0], "dir_y": way[:, 1], "dir_leg2": np.array([1.0, 1.0, np.nan, 1.0])}))
    np.testing.assert_array_equal(both.approach[[0, 1, 3], 1], 1.0)
    np.testing.assert_array_equal(both.approach[:, [0, 2]], rows.approach[:, [0, 2]])


NEEDED = {"play": "approach: sequence", "hysteresis": "approach: sequence",
          "friction": "dir_leg1", "creep": "payload", "product": "dir_leg1",
          "backlash": "dir_leg1", "windup": "dir_leg1", "lag": "vel_leg1", "compliance": "payload",
          "clearance": "payload", "base_compliance": "payload", "leg_thermal": "temperature",
          "base_thermal": "temperature", "platform_thermal": "temperature", "drift": "time"}


@pytest.mark.parametrize("kind", (*CONTRACT, "play", "hysteresis", "friction", "creep", "product"))
def test_missing_columns_are_named(kind: str) -> None:
    mechanism = machine("3-RRR-1" if kind == "eccentricity" else "3-RPR")
    found = missing_columns(with_kind(mechanism, kind), unknown_environment(4, 3))
    assert (found[0] if found else None) == NEEDED.get(kind)
    q = sample(mechanism)[0]
    rows = environment(recorded(mechanism, q), mechanism.actuators, mechanism.gravity, q)
    assert not missing_columns(with_kind(mechanism, kind), rows)
