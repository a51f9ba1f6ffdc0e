"""Every kind's equation once more, row by row and joint by joint, of a machine that is none.

Its four limbs share three drives in another order, one of them turns and one has a gear below 0,
rows come out of order, and one has no past: nothing is 1, centred or equal by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.model.effects import (
    EffectKind,
    LimbSetting,
    ScanRange,
    Setting,
    effect_kinds,
)
from ppmcal.model.effects.inputs import Inputs
from ppmcal.model.effects.product import FACTORS, product
from ppmcal.model.effects.setting import PLACE, Shift
from ppmcal.model.history import History, lagged, slack
from ppmcal.model.motions import PLANAR, SPATIAL, TRANSLATIONAL, Motion, motions

Array = NDArray[np.float64]
Values = Mapping[str, float]
RATIO = np.array([2.0, -0.5, 1.5])
DRIVES = (2, 0, 1, 0)
PLACES = np.array([3, 0, -1, 6, 5, 8])
ON = np.array([True, False, True])


def history() -> History:
    rng = np.random.default_rng(11)
    return History(rng.uniform(-0.3, 0.5, (9, 3)), np.cumsum(rng.uniform(5.0, 40.0, 9)),
                   rng.uniform(-4.0, 6.0, 9), rng.uniform(-60.0, 60.0, (9, 6)),
                   rng.uniform(-9.0, 9.0, (9, 3)), np.array([True, True, True]))


def turn_of(vector: Array) -> Array:
    angle = float(np.linalg.norm(vector))
    k = np.cross(np.eye(3), vector / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k)


def rows(motion: Motion = "spatial") -> Setting:
    """Return six rows of three drives and four limbs."""
    rng, past = np.random.default_rng(12), history()

    def points(body: str) -> dict[str, Array]:
        return {f"{body}.point.{c}": np.asarray(rng.uniform(-1.0, 1.0)) for c in "xyz"}

    limbs = tuple(LimbSetting(a, {"length": np.asarray(rng.uniform(0.4, 1.2)),
                                  "offset": rng.uniform(0.4, 1.2, 6)}, points("base"),
                              points("platform"), a != 1) for a in DRIVES)
    travel = RATIO * np.where((PLACES >= 0)[:, None], past.q[PLACES], 0.21)
    load, forces = rng.uniform(-90.0, 90.0, (6, 3)), rng.uniform(-50.0, 50.0, (6, 4, 3))
    pose = rng.uniform(-0.6, 0.6, (6, 6))
    tension = np.random.default_rng(14).uniform(-0.5, 2.0, (6, 3))
    return Setting(
        motion, np.array([False, True, False]), travel,
        np.array([[-0.7, 1.3], [-0.4, 0.3], [-0.9, 0.8]]), rng.choice((-1.0, 1.0), (6, 3)),
        rng.uniform(-0.2, 0.2, (6, 3)), rng.uniform(-4.0, 6.0, 6), rng.uniform(-60.0, 60.0, (6, 6)),
        rng.uniform(100.0, 900.0, 6), np.array([2.0, 7.0, 4.0, 5.0, np.inf, 9.0]), limbs,
        lambda w: load, lambda w: forces, rng.uniform(-9.0, 9.0, (6, 3)),
        np.array([0.2, -0.3, -0.9]), np.stack([turn_of(v) for v in pose[:, 3:]]),
        until=np.array([np.inf, 9.0, 7.0]), history=past, place=PLACES, ratio=RATIO,
        past_load_of=lambda: rng_load(), pose_of=lambda: pose,
        touch=np.array([True, True, False, True, True, False]),
        tensions_of=lambda on: tension, tension_of=lambda w: 40.0 * tension,
        span_of=lambda: np.abs(pose[:, :4]))


def rng_load() -> Array:
    return np.random.default_rng(13).uniform(-90.0, 90.0, (9, 3))


def then(past: Array) -> Array:
    """Return what was at the rows, nan for the one without a place."""
    return np.stack([past[p] if p >= 0 else np.full(past.shape[1:], np.nan) for p in PLACES])


def since(at: Setting, row: float) -> Array:
    assert at.until is not None
    return np.array([[float(r >= row and (np.isinf(u) or r < u)) for u in at.until]
                     for r in at.row])


def over_stroke(at: Setting, v: Values) -> Array:
    low, high = (np.where(np.isnan(v[n]), at.stroke[:, c], v[n]) for c, n in
                 enumerate(("low", "high")))
    return np.asarray(-1.0 + 2.0 * (at.travel - low) / (high - low))


def play(at: Setting, width: Array | float) -> Array:
    """Return p - u of u itself: the gear is in it already."""
    return then(slack(RATIO * history().q, np.broadcast_to(0.5 * np.abs(width), 3))[0]
                ) * np.sign(width)


def compliance(at: Setting, v: Values) -> Array:
    middle = 0.5 * (v["low"] + v["high"])
    return at.load / v["stiffness"] * (1.0 + v["by_stroke"] * (at.travel - middle)) / (
        1.0 + v["hardening"] * np.abs(at.load))


def friction(at: Setting, v: Values) -> Array:
    part = np.exp(-np.abs(at.velocity) / v["speed"])
    return at.approach * (v["static"] * part + v["dynamic"] * (1.0 - part))


def curvature(at: Setting, v: Values) -> Array:
    s = over_stroke(at, v)
    return (v["p2"] * (3 * s**2 - 1) / 2 + v["p3"] * (5 * s**3 - 3 * s) / 2
            + v["p4"] * (35 * s**4 - 30 * s**2 + 3) / 8)


def periodic(at: Setting, v: Values) -> Array:
    w = 2.0 * np.pi * at.travel / v["period"]
    return v["cos"] * np.cos(w) + v["sin"] * np.sin(w)


def eccentricity(at: Setting, v: Values) -> Array:
    q = at.travel
    return (v["cos"] * np.cos(q) + v["sin"] * np.sin(q) + v["cos2"] * (2 * np.cos(q)**2 - 1)
            + v["sin2"] * 2 * np.sin(q) * np.cos(q))


STROKES = {"low": -0.75, "high": 1.15}
OPEN = {"low": np.nan, "high": np.nan}
BASIC: dict[str, tuple[Values, Callable[[Setting, Values], Array]]] = {
    "gain": ({"gain": 0.03}, lambda at, v: v["gain"] * at.travel),
    "curvature": ({"p2": 0.01, "p3": -0.03, "p4": 0.07, **STROKES}, curvature),
    "periodic": ({"cos": 0.03, "sin": -0.05, "period": 0.37}, periodic),
    "eccentricity": ({"cos": 0.03, "sin": -0.05, "cos2": 0.07, "sin2": 0.02}, eccentricity),
    "backlash": ({"width": 0.03}, lambda at, v: at.approach * v["width"] / 2),
    "windup": ({"width": 0.03}, lambda at, v: at.approach * v["width"] * np.abs(at.load)),
    "lag": ({"tau": 0.3}, lambda at, v: -v["tau"] * at.velocity),
    "compliance": ({"stiffness": 700.0, "hardening": 0.03, "by_stroke": 0.4, **STROKES},
                   compliance),
    "clearance": ({"width": 0.03}, lambda at, v: np.sign(at.load) * v["width"] / 2),
    "friction": ({"static": 0.05, "dynamic": 0.02, "speed": 0.07}, friction),
    "creep": ({"give": 1e-3, "tau": 35.0}, lambda at, v: v["give"] * then(
        lagged(history().time, rng_load(), v["tau"])[0])),
    "play": ({"width": 0.3}, lambda at, v: play(at, v["width"])),
    "hysteresis": ({"w1": 0.1, "w2": -0.3, "w3": 0.2, **STROKES}, lambda at, v: sum(
        (v[n] * play(at, part * 1.9) for n, part in
         (("w1", 0.004), ("w2", 0.03), ("w3", 0.2))), np.zeros((6, 3)))),
    "zero_shift": ({"shift": 0.03, "from_row": 4.0}, lambda at, v: v["shift"] * since(at, 4.0)),
    "product": ({"width": 0.03, "width_0": -0.05}, lambda at, v: 0.5 * at.approach * (
        v["width_0"] + v["width"] * at.temperature[:, None])),
}


@pytest.mark.parametrize(("name", "ends"), [(n, e) for n, (v, _) in BASIC.items() for e in (
    (True, False) if "low" in v else (True,))])
def test_equations_of_joints(name: str, ends: bool) -> None:
    """Of the joints that it is on, limb by limb; strokes that are open are those of the joints."""
    values, equation = BASIC[name]
    at, kind = rows(), effect_kinds()[name]
    want = equation(at, values)
    if not ends:
        values = dict(values) | OPEN
        at = replace(at, stroke=np.tile([STROKES["low"], STROKES["high"]], (3, 1)))
    found = kind.evaluate(at, ON, values).shift
    assert set(found.slots) == {(i, "offset") for i, a in enumerate(DRIVES) if ON[a]}
    for (i, _), change in found.slots.items():
        np.testing.assert_allclose(change, want[:, DRIVES[i]], rtol=1e-11, atol=1e-14)
    assert (found.pose, found.stretch, found.frame, found.target) == (None,) * 4


def test_a_stroke_of_its_own_for_each_joint() -> None:
    at = rows()
    for name in ("curvature", "hysteresis"):
        kind, values = effect_kinds()[name], dict(BASIC[name][0])
        whole = kind.evaluate(at, np.ones(3, dtype=bool), values | OPEN).shift.slots
        for i, a in enumerate(DRIVES):
            low, high = at.stroke[a]
            alone = kind.evaluate(at, np.arange(3) == a, values | {"low": low, "high": high})
            np.testing.assert_allclose(whole[i, "offset"], alone.shift.slots[i, "offset"],
                                       rtol=1e-11)
            half = kind.evaluate(at, np.arange(3) == a, values | {"low": np.nan, "high": high})
            np.testing.assert_allclose(whole[i, "offset"], half.shift.slots[i, "offset"],
                                       rtol=1e-11)


def heat(at: Setting, source: str, each: bool, tau: float) -> Array:
    """Return what a slot grows by, per unit of its coefficient (6, 3)."""
    past = history()
    if source == "thermometer":
        warm = lagged(past.time, past.temperature, tau)[0]
        return np.repeat((then(warm) if tau else at.temperature)[:, None], 3, axis=1)
    rate = np.abs(np.diff(RATIO * past.q, axis=0)) / np.diff(past.time)[:, None]
    work = then(lagged(past.time, np.concatenate([np.zeros((1, 3)), rate]), tau)[0])
    return work if each else np.repeat(work.mean(axis=1)[:, None], 3, axis=1)


@pytest.mark.parametrize(("name", "slots", "each"), [
    ("leg_thermal", "struts", True), ("base_thermal", "base", False),
    ("platform_thermal", "platform", False)])
@pytest.mark.parametrize("source", ["thermometer", "motion"])
@pytest.mark.parametrize("tau", [0.0, 35.0])
def test_what_is_warm_grows_in_proportion(name: str, slots: str, each: bool, source: str,
                                          tau: float) -> None:
    file = effect_kinds()[name].from_file
    assert file is not None
    units: Any = None
    kind, at = file.make({"from": source}, units, "length"), rows()
    if source == "motion" and not tau:
        tau = 4.0
    size = next(n for n in ("expansion", "growth") if n in
                {s.name for s in kind.parameters(SPATIAL)})
    found = kind.evaluate(at, ON, {size: 0.3, "tau": tau}).shift.slots
    want = 0.3 * heat(at, source, each, tau)
    assert set(found) == {(i, s) for i, limb in enumerate(at.limbs) if ON[limb.actuator]
                          for s in getattr(limb, slots)}
    for (i, slot), change in found.items():
        np.testing.assert_allclose(change, getattr(at.limbs[i], slots)[slot] * want[:, DRIVES[i]],
                                   rtol=1e-9)


@pytest.mark.parametrize("motion", motions().values(), ids=str)
def test_the_bodies_that_give_way_move_by_their_compliance_times_the_wrench(motion: Motion) -> None:
    """The platform about its origin; the base about its own, and the platform is carried along."""
    at, rng = rows(motion), np.random.default_rng(3)
    file = effect_kinds()["base_compliance"].from_file
    assert file is not None
    units: Any = None
    for about in ("platform", "base"):
        kind = file.make({"about": about}, units, "length")
        if not kind.exists_in(motion):
            continue
        values = {s.name: rng.uniform(-1e-3, 1e-3) for s in kind.parameters(motion)}
        matrix = np.zeros((6, 6))
        for name, v in values.items():
            c, w = name.rsplit("_", 1)
            i, j = PLACE[c], 3 * (w[0] == "m") + "xyz".index(w[1])
            matrix[i, j] = v
            if about == "base":
                matrix[j, i] = v
        dof = list(motion.dof)
        assert (matrix[np.ix_(dof, dof)] != 0.0).all()
        assert np.count_nonzero(matrix) == len(dof)**2
        p = at.pose[:, :3]
        wrench = at.wrench.copy()
        if about == "base":
            wrench[:, 3:] += np.cross(p, at.wrench[:, :3])
        twist = wrench @ matrix.T
        if about == "base":
            twist[:, :3] += np.cross(twist[:, 3:], p)
        found = kind.evaluate(at, ON, values).shift
        assert found.pose is not None
        np.testing.assert_allclose(found.pose, twist, rtol=1e-11, atol=1e-14)
        assert not found.slots


@pytest.mark.parametrize("name", ["drift", "target_shift", "base_shift"])
@pytest.mark.parametrize("motion", motions().values(), ids=str)
def test_steps_and_rates_of_every_coordinate(name: str, motion: Motion) -> None:
    at, kind = rows(motion), effect_kinds()[name]
    values = {s.name: 0.01 * (n + 1.3) for n, s in enumerate(kind.parameters(motion))}
    factor = at.time if name == "drift" else since(at, 4.0)[:, 0]
    want = np.zeros((6, 6))
    for c in set(values) & set(PLACE):
        want[:, PLACE[c]] = values[c] * factor
    found = kind.evaluate(at, ON, values | ({} if name == "drift" else {"from_row": 4.0})).shift
    where = {"drift": "pose", "target_shift": "target", "base_shift": "frame"}[name]
    np.testing.assert_allclose(getattr(found, where), want, rtol=1e-12)
    others = {"pose", "target", "frame", "stretch"} - {where}
    assert all(getattr(found, o) is None for o in others)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
def test_what_a_camera_sees_of_a_plane(angle: float) -> None:
    """Shorter along one direction, as long across it; a scale is one of all directions."""
    d, n = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle),
                                                                   0.0])
    tilt = effect_kinds()["tilt"].evaluate(rows(PLANAR), ON, {"shrink": 0.02, "direction": angle})
    stretch = tilt.shift.stretch
    assert stretch is not None
    np.testing.assert_allclose(stretch[0] @ d, -0.02 * d, atol=1e-15)
    np.testing.assert_allclose(stretch[0] @ n, 0.0 * n, atol=1e-15)
    scale = effect_kinds()["sensor_scale"].evaluate(rows(), ON, {"scale": 0.03}).shift.stretch
    assert scale is not None
    np.testing.assert_allclose(scale, 0.03 * np.eye(3)[None], atol=1e-15)


def test_a_weight_is_turned_as_a_body_is() -> None:
    """About both base axes across gravity at once; what else pushes stays as it is."""
    at = rows()
    kind = effect_kinds()["gravity_tilt"]
    assert kind.carried is not None
    weight, wrench = kind.carried(at, {"first": 0.3, "second": -0.5})
    np.testing.assert_allclose(weight, at.weight @ turn_of(np.array([0.3, -0.5, 0.0])).T,
                               rtol=1e-12)
    np.testing.assert_allclose(wrench[:, :3] - at.wrench[:, :3], weight - at.weight, atol=1e-12)
    np.testing.assert_array_equal(wrench[:, 3:], at.wrench[:, 3:])
    for gravity, vector in (((9.0, 1.0, -2.0), (0.0, 0.3, -0.5)), ((1.0, -9.0, 2.0),
                                                                  (0.3, 0.0, -0.5))):
        weight, _ = kind.carried(replace(at, gravity=np.array(gravity)),
                                 {"first": 0.3, "second": -0.5})
        np.testing.assert_allclose(weight, at.weight @ turn_of(np.array(vector)).T, rtol=1e-12)
    flat, _ = kind.carried(rows(PLANAR), {"turn": 0.4})
    np.testing.assert_allclose(flat, at.weight @ turn_of(np.array([0.0, 0.0, 0.4])).T, rtol=1e-12)


def test_a_weight_beside_the_origin_has_a_moment() -> None:
    at, kind = rows(), effect_kinds()["payload_offset"]
    assert kind.carried is not None
    weight, wrench = kind.carried(at, {"x": 0.1, "y": -0.2, "z": 0.3})
    np.testing.assert_array_equal(weight, at.weight)
    for n in range(6):
        arm = at.turn[n] @ [0.1, -0.2, 0.3]
        np.testing.assert_allclose(wrench[n, 3:] - at.wrench[n, 3:], np.cross(arm, at.weight[n]),
                                   atol=1e-12)
    np.testing.assert_array_equal(wrench[:, :3], at.wrench[:, :3])


def test_a_plate_moves_where_it_is_pushed_and_beside_it() -> None:
    """Centre i by give sum_j exp(-(d_ij/reach)^2/2) f_j: in the plane, by every coordinate."""
    at, reach = rows(PLANAR), 0.7
    at = replace(at, turn=np.repeat(turn_of(np.array([0.0, 0.0, 0.6]))[None], 6, axis=0))
    kind = effect_kinds()["plate_compliance"]
    found = kind.evaluate(at, ON, {"base": 0.02, "platform": 0.05, "reach": reach}).shift.slots
    for body, give in (("base", 0.02), ("platform", 0.05)):
        place = np.array([[limb_part(at, i, body, c) for c in "xyz"] for i in range(4)])
        for n in range(6):
            force = at.forces[n] if body == "base" else -at.forces[n] @ at.turn[n]
            for i in range(4):
                near = np.exp(-np.sum((place - place[i])**2, axis=1) / reach**2 / 2.0)
                for c, axis in enumerate("xyz"):
                    assert found[i, f"{body}.point.{axis}"][n] == pytest.approx(
                        give * float(near @ force[:, c]), rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("reach", [1e-6, 1e-120, -1e-300])
def test_a_plate_of_no_reach_moves_where_it_is_pushed_alone(reach: float) -> None:
    """A fit may step there; no number is too small, and nothing depends on it any more."""
    at, values = rows(PLANAR), {"base": 0.02, "platform": 0.0}
    with np.errstate(all="raise", under="ignore"):
        found = effect_kinds()["plate_compliance"].evaluate(at, ON, values | {"reach": reach})
    near = effect_kinds()["plate_compliance"].evaluate(at, ON, values | {"reach": 1e-4})
    for slot, moved in near.shift.slots.items():
        np.testing.assert_allclose(found.shift.slots[slot], moved, atol=1e-15)
    assert all(not du.any() for du in found.by["reach"].slots.values())


def limb_part(at: Setting, i: int, body: str, c: str) -> float:
    return float(getattr(at.limbs[i], body)[f"{body}.point.{c}"])


def test_a_hill_of_the_flat_is_seen_as_a_hollow() -> None:
    """Where it is touched; elsewhere nothing is."""
    at, kind = rows(TRANSLATIONAL), effect_kinds()["bed_shape"]
    values = {s.name: 0.0 for s in kind.parameters(TRANSLATIONAL)} | {
        "radius": 0.4, "bowl": 0.01, "twist": 0.03}
    found = kind.evaluate(at, ON, values).shift.frame
    assert at.touch is not None
    x, y = at.pose[:, 0] / 0.4, at.pose[:, 1] / 0.4
    want = np.where(at.touch, -0.01 * (x**2 + y**2) - 0.03 * 2.0 * x * y, 0.0)
    assert found is not None
    np.testing.assert_allclose(found[:, 2], want, rtol=1e-12)
    assert not found[:, [0, 1, 3, 4, 5]].any()
    bare = kind.evaluate(replace(at, touch=None), ON, values).shift.frame
    assert bare is not None
    assert not bare.any()


def variants() -> list[tuple[str, Motion]]:
    """Return every kind with each motion, and what is tried in its place."""
    return [(kind.name, motion) for kind in effect_kinds().values() for motion in kind.motions]


def tried(kind: EffectKind, motion: Motion) -> list[EffectKind]:
    others = list(kind.variants(motion)) if kind.variants else []
    file = [product(kind, c) for c in FACTORS] if kind.name in ("gain", "lag") else []
    return [kind, *(k for k in [*others, *file] if motion in k.motions)]


def parts(shift: Shift) -> dict[object, Array]:
    whole = {n: getattr(shift, n) for n in ("pose", "stretch", "frame", "target")}
    slots: dict[object, Array] = dict(shift.slots.items())
    return slots | {n: v for n, v in whole.items() if v is not None}


@pytest.mark.parametrize(("name", "motion"), variants())
def test_every_derivative_is_the_slope_of_what_is_added(name: str, motion: Motion) -> None:
    """Of kinds that are made by a file or tried in another's place too, at values off 0."""
    at = rows(motion)
    at = replace(at, travel=np.where(np.isfinite(at.travel), at.travel, 0.2))
    for kind in tried(effect_kinds()[name], motion):
        if kind.carried is not None:
            continue
        values = off_zero(kind, motion)
        terms = kind.evaluate(at, ON, values)
        free = [s for s in kind.parameters(motion) if not s.constant]
        assert set(terms.by) >= {s.name for s in free if s.name != kind.onset}
        for spec in free:
            if spec.name == kind.onset:
                continue
            h = 1e-6 * abs(values[spec.name])
            above, below = (parts(kind.evaluate(at, ON, values | {
                spec.name: values[spec.name] + step}).shift) for step in (h, -h))
            slopes = parts(terms.by[spec.name])
            assert set(slopes) <= set(above)
            for where in above:
                differs = (above[where] - below[where]) / (2.0 * h)
                slope = np.broadcast_to(slopes.get(where, 0.0), differs.shape)
                size = max(float(np.nanmax(np.abs(slope))), 1e-9)
                np.testing.assert_allclose(differs / size, slope / size, atol=2e-6,
                                           err_msg=f"{kind.title} {spec.name}")


def off_zero(kind: EffectKind, motion: Motion) -> dict[str, float]:
    own = {"stiffness": 700.0, "hardening": 0.03, "by_stroke": 0.4, **STROKES, "period": 0.37,
           "speed": 0.07, "tau": 35.0, "reach": 0.7, "radius": 0.4, "direction": 0.4,
           "from_row": 4.0, "shrink": 0.02, "scale": 0.7}
    return {s.name: own.get(s.name, 0.01 * (1.3 + n)) for n, s in enumerate(
        kind.parameters(motion))} | ({"tau": 0.3} if kind.needs == ("vel",) else {})


# --- what a search tries ---------------------------------------------------------------------

DATA = ScanRange(0.4, 20, tuple(range(1, 21)), 50.0, 0.5, 0.2, (0.001, 0.004, 0.01, 0.03), 60.0,
                 3600.0, 0.03)
DIMENSIONS = {"length": (1, 0, 0), "joint": (1, 0, 0), "s": (0, 1, 0), "load": (0, 0, 1),
              "N": (0, 0, 1), "1": (0, 0, 0), "angle": (0, 0, 0)}


def scale_of(quantity: str, units: tuple[float, float, float]) -> float:
    """Return what a quantity is multiplied with in other units of length, time and load."""
    above, _, below = quantity.partition("/")
    out = 1.0
    for part, sign in ((above, 1), (below, -1)):
        for name in filter(None, part.split(".")):
            out *= float(np.prod([u ** (sign * d) for u, d in zip(units, DIMENSIONS[name],
                                                                  strict=True)]))
    return out


SCANNED = [(k.name, m, n) for k in effect_kinds().values() for m in k.motions
           for n, kind in enumerate(tried(k, m)) if any(s.scan for s in kind.parameters(m))]


@pytest.mark.parametrize(("name", "motion", "n"), SCANNED)
def test_what_a_search_tries_has_the_unit_of_the_data(name: str, motion: Motion, n: int) -> None:
    """In other units of length, time and load the same values are tried, none twice."""
    kind = tried(effect_kinds()[name], motion)[n]
    units = length, time, load = 3.0, 7.0, 0.2
    other = ScanRange(length * DATA.stroke, DATA.poses, DATA.rows, load * DATA.load,
                      length * DATA.size, length * DATA.near,
                      tuple(length * m for m in DATA.moves), time * DATA.step,
                      time * DATA.duration, length / time * DATA.speed)
    for spec in (s for s in kind.parameters(motion) if s.scan is not None):
        assert spec.scan is not None
        here, there = (np.array(spec.scan(d)) for d in (DATA, other))
        np.testing.assert_allclose(there, here * scale_of(spec.quantity, units), rtol=1e-12)
        assert len(set(here)) == len(here) > 1, spec.name
        steps = np.diff(here)
        assert (steps > 0.0).all() or (steps < 0.0).all(), spec.name


@pytest.mark.parametrize(("name", "motion", "n"), SCANNED)
def test_what_a_search_tries_can_be_seen_in_the_data(name: str, motion: Motion, n: int) -> None:
    """Times between a row and the campaign, ways within the stroke, speeds about the recorded."""
    kind = tried(effect_kinds()[name], motion)[n]
    ends = {"s": (DATA.step, DATA.duration), "joint": (1e-4 * DATA.stroke, DATA.stroke),
            "length": (DATA.near / 2.0, DATA.size), "angle": (0.0, np.pi - 1e-9),
            "joint/s": (DATA.speed / 10.0, DATA.speed * 10.0)}
    for spec in (s for s in kind.parameters(motion) if s.scan is not None):
        assert spec.scan is not None
        if spec.name == "at":     # a place, on either side of the middle
            assert max(map(abs, spec.scan(DATA))) < DATA.near / 2.0
        elif spec.quantity in ends:
            low, high = ends[spec.quantity]
            found = spec.scan(DATA)
            assert low * (1.0 - 1e-12) <= min(found), spec.name
            assert max(found) <= high * (1.0 + 1e-12), spec.name
            # evenly spread: no two far nearer to each other than others are
            ways = np.diff(sorted(found))
            ratios = np.array(sorted(found)[1:]) / np.maximum(sorted(found)[:-1], 1e-300)
            assert min(ways.max() / ways.min(), ratios.max() / ratios.min()) < 3.0, spec.name


def test_events_are_looked_for_with_rows_on_either_side() -> None:
    onset = next(s for s in effect_kinds()["zero_shift"].parameters(SPATIAL) if s.scan)
    assert onset.scan is not None
    few = onset.scan(replace(DATA, rows=tuple(range(10, 20))))
    assert list(few) == [13, 14, 15, 16, 17]
    assert list(onset.scan(replace(DATA, rows=tuple(range(5))))) == []
    assert list(onset.scan(replace(DATA, rows=tuple(range(6))))) == [3]
    assert list(onset.scan(replace(DATA, rows=tuple(range(155))))) == list(range(3, 153))
    many = np.array(onset.scan(replace(DATA, rows=tuple(range(1000)))))
    assert many.size == 150
    assert (many[0], many[-1]) == (3, 997)
    assert set(np.diff(many)) == {6, 7}


def test_a_plate_is_not_looked_for_within_what_is_about_one_joint() -> None:
    scan = next(s for s in effect_kinds()["plate_compliance"].parameters(SPATIAL) if s.scan).scan
    assert scan is not None
    np.testing.assert_allclose(scan(replace(DATA, size=1.0, near=0.1)), [0.3, 0.6, 0.9])
    np.testing.assert_allclose(scan(replace(DATA, size=1.0, near=0.9)), [0.6, 0.9])
    assert scan(replace(DATA, size=0.0, near=0.0)) == []
    assert scan(replace(DATA, size=1.0, near=0.0)) == []


# --- what kinds say of their numbers -----------------------------------------------------------

EVERY = [(k.name, m, n) for k in effect_kinds().values() for m in k.motions
         for n, _ in enumerate(tried(k, m))]


@pytest.mark.parametrize(("name", "motion", "n"), EVERY)
def test_sizes_defaults_and_ranges_of_every_number(name: str, motion: Motion, n: int) -> None:
    """Sizes are small parts of what they are of, defaults do nothing, ranges begin at 0 or below.

    Of what may be nothing 0 is possible and usual; what may not begins far below any machine's.
    """
    kind = tried(effect_kinds()[name], motion)[n]
    for s in kind.parameters(motion):
        assert s.default is None or np.isnan(s.default) or s.default == 0.0 or (
            kind.name, s.name) in {("bed_shape", "radius"), ("learned", "scale")}, s.name
        assert 0.0 < s.size <= {"s": 1.0, "1/joint": 0.1, "1/load": 1e-4}.get(s.quantity, 0.01)
        assert s.low in (-np.inf, 0.0) or s.low == -s.high or 0.0 < s.low <= 1e-6, s.name
        assert s.high in (1.0, 0.1, 120e-6) or np.isinf(s.high), s.name
        low, high = s.usual
        assert low in (-np.inf, 0.0, s.low) or low == -high or s.reciprocal or (
            s.quantity == "joint/load"), s.name
        if s.default == 0.0:
            assert s.low <= 0.0 <= s.high, s.name
            assert low <= 0.0 <= high, s.name


@pytest.mark.parametrize("name", effect_kinds())
def test_a_worked_case_is_a_usual_one(name: str) -> None:
    """Its numbers are possible and named, those of a drive usual for a stroke of a metre."""
    kind = effect_kinds()[name]
    assert kind.worked is not None
    for s in (s for m in kind.motions for s in kind.parameters(m)):
        if s.name in kind.worked.values and s.name not in ("low", "high"):
            v = kind.worked.values[s.name]
            assert s.low <= v <= s.high, s.name
            assert s.usual[0] <= v <= s.usual[1] or s.per_stroke, s.name


def test_inputs_are_what_they_are_called() -> None:
    rng = np.random.default_rng(4)
    fields: dict[str, Any] = {n: rng.normal(size=(5, 2)) for n in (
        "travel", "approach", "velocity", "load", "move")}
    fields |= {n: rng.normal(size=5) for n in ("temperature", "row")}
    fields |= {"wrench": rng.normal(size=(5, 6)), "pose": rng.normal(size=(5, 6)),
               "point": rng.normal(size=(5, 3)), "time": np.array([np.nan, 7.0, 5.0, 9.0, 6.0])}
    at = Inputs(**fields)
    kinds = {k.input.name: k.input for k in effect_kinds().values()}
    np.testing.assert_array_equal(kinds["time"].value(at), [np.nan, 2.0, 0.0, 4.0, 1.0])
    never = replace(at, time=np.full(5, np.nan))
    assert np.isnan(kinds["time"].value(never)).all()
    np.testing.assert_array_equal(kinds["wound load"].value(at),
                                  fields["approach"] * np.abs(fields["load"]))
    for name, known in kinds.items():
        if name in fields and name != "time":
            np.testing.assert_array_equal(known.value(at), fields[name])
        assert known.classes == (name == "direction")
        assert known.own_component == (name == "point")
        assert known.of_machine == (name in ("time", "wrench", "pose", "point"))


@pytest.mark.parametrize(("name", "motion"), variants())
def test_what_a_kind_depends_on_is_what_it_says(name: str, motion: Motion) -> None:
    """On the pose or the load; linear or not; in the instrument or not; constants are no slopes."""
    at = rows(motion)
    rng = np.random.default_rng(5)
    elsewhere = replace(at, load_of=lambda w: rng.uniform(-90.0, 90.0, (6, 3)),
                        forces_of=lambda w: rng.uniform(-50.0, 50.0, (6, 4, 3)),
                        pose_of=lambda: rng.uniform(-0.6, 0.6, (6, 6)) + np.eye(6)[2],
                        tensions_of=lambda on: rng.uniform(0.5, 2.0, (6, 3)),
                        tension_of=lambda w: rng.uniform(20.0, 80.0, (6, 3)))
    for kind in tried(effect_kinds()[name], motion):
        if kind.carried is not None or kind.name == "learned":
            continue
        values = off_zero(kind, motion)
        terms = kind.evaluate(at, ON, values)
        here, there = (parts(s) for s in (terms.shift, kind.evaluate(elsewhere, ON, values).shift))
        assert kind.uses_load == any(not np.array_equal(here[w], there[w], equal_nan=True)
                                     for w in here), kind.title
        assert kind.instrument == bool(set(here) & {"frame", "target", "stretch"}), kind.name
        specs = {s.name: s for s in kind.parameters(motion)}
        assert set(terms.by) >= {n for n, s in specs.items() if not s.constant}
        assert not any(specs[n].constant for n in terms.by), kind.name
        for n in (n for n, s in specs.items() if not s.constant):
            twice = kind.evaluate(at, ON, values | {n: 2.0 * values[n]}).by[n]
            changed = any(not np.allclose(v, parts(twice)[w], rtol=1e-9, atol=0.0, equal_nan=True)
                          for w, v in parts(terms.by[n]).items())
            assert changed == (specs[n].nonlinear or specs[n].reciprocal) or (kind.name, n) in {
                ("compliance", "by_stroke"), ("play", "width")}, (kind.title, n)
            if specs[n].default == 0.0:
                assert specs[n].optional == specs[n].nonlinear, (kind.title, n)


def test_parts_of_a_stroke_are_of_errors_of_a_drive() -> None:
    """What is usual is told in parts of the stroke where it is a way of the joint."""
    for kind in effect_kinds().values():
        for s in (s for m in kind.motions for one in tried(kind, m) for s in one.parameters(m)):
            told = bool(np.isfinite(s.usual).any())
            drive = s.quantity.split("/")[0] == "joint" and s.quantity in ("joint", "joint/K")
            assert s.of_stroke == (drive and not s.constant), (kind.name, s.name)
            assert s.per_stroke == (s.quantity == "1/joint"), (kind.name, s.name)
            assert told or not (s.of_stroke or s.per_stroke), (kind.name, s.name)
            assert s.usual_scale(4.0) == (4.0 if s.of_stroke else 0.25 if s.per_stroke else 1.0)


def test_traits_and_the_kinds_that_have_them() -> None:
    having: dict[str, set[str]] = {
        "by_sign": {"clearance"},
        "opposed": {"rope_stretch", "anchor_give"},
        "under_weight": {"compliance"}, "one_by_one": {"plate_compliance"},
        "nuisance": {"bed_shape"}, "instrument": {"base_shift", "bed_shape", "sensor_scale",
                                                  "target_shift", "tilt"}}
    kinds = effect_kinds().values()
    for trait, names in having.items():
        assert {k.name for k in kinds if getattr(k, trait)} == names, trait
    assert {k.name for k in kinds if k.carried} == {"gravity_tilt", "payload_offset"}
    assert {k.name for k in kinds if k.seldom} == {"plate_compliance"}
    assert {k.name for k in kinds if not k.per_actuator and not k.body} == {
        "bed_shape", "drift", "missing_length", "plate_compliance", "sensor_scale", "tilt"}
    assert {(k.name, s.name) for k in kinds for m in k.motions for s in k.parameters(m)
            if s.scaling} == {("play", "width")}


def test_ropes_stretch_and_frames_give_by_the_tension_of_each_rope() -> None:
    """Of joints that are no ropes nothing changes; a rope that would have to push is slack."""
    at = rows(PLANAR)
    tension = np.maximum(at.tensions_of(ON), 0.0) if at.tensions_of else at.travel
    assert (tension == 0.0).any()
    for name, parameter in (("rope_stretch", "strain"), ("anchor_give", "give"),
                            ("missing_length", "length")):
        found = effect_kinds()[name].evaluate(at, ON, {parameter: 0.004}).shift.slots
        assert {i for i, _ in found} == {i for i, a in enumerate(DRIVES) if a != 1}
        for (i, slot), du in found.items():
            assert slot == "offset"
            force = np.ones(6) if name == "missing_length" else tension[:, DRIVES[i]]
            own = at.limbs[i].struts["offset"] if parameter == "strain" else np.ones(6)
            np.testing.assert_allclose(du, 0.004 * own * force, rtol=1e-12)
    none = replace(at, tensions_of=None)
    assert np.isnan(none.tensions(ON)).all()
