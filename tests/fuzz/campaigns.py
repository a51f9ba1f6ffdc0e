"""Poor campaigns end to end, as a user of the Python face would have them: too few rows, poses that
repeat, empty cells, columns that never change, loads and temperatures that no workshop has.

A case is a JSON text with everything in it, so that what failed once stays the same case: machine,
columns, sidecar and the calls. Anything but a result or a refusal with a reason is a fault, and so
is a warning.
"""

import json
import random

import numpy as np
from helpers import machines
from helpers.paths import ROOT

import ppmcal
from fuzz.readers import Reader
from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.tables import pose_vector

SECONDS = 60.0
"""Of processor time, for all calls of a case."""
MACHINES = ("3-RPR", "3-RPR", "3-PRR-1", "3-RRR-1", "delta-linear", "delta-rotary", "3-RPS",
            "6-UPS")
ROWS = (1, 2, 3, 4, 5, 6, 8, 10, 14, 20, 30)
EFFECTS = ({"kind": "backlash", "parameters": {"width": {"value": 0.02, "free": True}}},
           {"kind": "curvature", "parameters": {"p2": {"value": 0.0, "free": True}}},
           {"kind": "leg_thermal", "parameters": {"expansion": {"value": 1e-5, "free": True}}},
           {"kind": "compliance", "parameters": {"stiffness": 1000.0}},
           {"kind": "play", "parameters": {"width": {"value": 0.01, "free": True}}},
           {"kind": "zero_shift", "parameters": {"shift": {"value": 0.0, "free": True},
                                                 "from_row": 3}})
ABSURD = (0.0, 20.0, -300.0, 1e4, 1e9, -1e-300, 5e-324)


def case(rng):
    """Return a case as bytes: a JSON text."""
    name = rng.choice(MACHINES)
    kind = rng.choice(("pose", "pose", "position", "distance",
                       "distance" if "R-" in name or name == "3-RPR" else "plane"))
    raw = {"machine": name, "effects": rng.sample(EFFECTS, rng.choice((0, 0, 0, 1))),
           "table": {}, "sidecar": _sidecar(kind, rng), "calls": _calls(rng)}
    try:
        raw["table"] = _table(name, kind, rng)
    except ppmcal.PpmcalError:
        raw["table"] = {"x": [1.0]}
    return json.dumps(raw).encode()


def _sidecar(kind, rng):
    number = {"plane": "height", "distance": "distance"}.get(kind, "position")
    sigma = {number: rng.choice((1e-9, 0.001, 0.01, 0.01, 0.05, 10.0))}
    if kind == "pose":
        sigma["rotation"] = rng.choice((1e-9, 0.001, 0.01, 5.0))
    if rng.random() < 0.2:
        sigma["actuator"] = rng.choice((0.001, 0.1, 10.0))
    if rng.random() < 0.2:
        sigma["estimated"] = True
    side = {"units": {"length": "mm", "angle": "deg"}, "instrument": {"kind": kind, "sigma": sigma},
            "frame": rng.choice(("unknown", "unknown", "known")),
            "target": rng.choice(("unknown", "known", "known"))}
    if kind == "distance" and rng.random() < 0.9:
        side["instrument"]["point"] = rng.choice(("unknown", [0.0, 0.0, 0.0], [900.0, 10.0, 50.0]))
    if rng.random() < 0.3:
        side["approach"] = rng.choice(("columns", "sequence", "unknown"))
    if rng.random() < 0.1:
        side["homing"] = "per-file"
    if rng.random() < 0.1:
        side["scale"] = "unknown"
    if kind == "pose" and rng.random() < 0.2:
        side["target_rotation"] = "unknown"
    return side


def _calls(rng):
    fit = {}
    for name, values in (("method", ("gcv", "damped")), ("prior", ("flat",)),
                         ("sigma", ("estimated",)), ("leave_out", ("session",)),
                         ("holdout", (0.0, 0.5, 0.95)), ("keep_outliers", (True,)),
                         ("free", (["*.offset"], "none")), ("iterations", (1, 3))):
        if rng.random() < 0.12:
            fit[name] = rng.choice(values)
    calls = [("check", {}), ("identify", fit), ("diagnose", {}), ("validate", {}),
             ("compensate", {})]
    return rng.sample(calls, rng.choice((1, 2, 3)))


def _table(name, kind, rng):
    """Return columns in mm and degrees: what a machine with errors of its own would show."""
    machine = ppmcal.load(_machine({"machine": name, "effects": []}))
    noise = np.random.default_rng(rng.getrandbits(32))
    model = Model(machine)
    home, step = home_state(machine).q, machines.joint_steps(model)
    n = rng.choice(ROWS)
    spread = rng.choice((0.0, 1e-6, 1.0, 4.0, 4.0, 8.0))
    q = home + spread * step * noise.uniform(-1, 1, (n, home.size))
    if rng.random() < 0.3:
        q = q[noise.integers(0, max(1, n // 3), n)]
    if rng.random() < 0.1:
        q[:, noise.integers(0, home.size)] = home[0]
    true = machine.with_values(machine.values + 3e-4 * noise.standard_normal(machine.values.size))
    pose = forward(Model(true), q).pose
    vector = pose_vector(np.where(np.isfinite(pose), pose, cga.identity_motor()))
    vector[~np.isfinite(pose).all(axis=1)] = np.nan
    vector[:, :3] *= 1e3
    vector[:, 3:] = np.degrees(vector[:, 3:])
    vector += rng.choice((0.0, 0.01, 0.01, 5.0)) * noise.standard_normal(vector.shape)
    scale = [1e3 if k == "length" else 180.0 / np.pi for k in machine.actuator_quantity]
    table = {f"q_{a}": q[:, i] * scale[i] for i, a in enumerate(machine.actuators)}
    table |= _measured(vector, kind, machine.motion, q * scale, machine.actuators, rng, noise)
    _more(table, n, machine, rng, noise)
    return _spoilt(table, rng, noise)


def _measured(vector, kind, motion, q, actuators, rng, noise):
    if kind == "plane":
        return {"height": vector[:, 1 if motion.planar else 2]}
    if kind == "distance":
        if rng.random() < 0.7:
            return {"distance": np.linalg.norm(vector[:, :3], axis=1)}
        other = noise.permutation(len(vector))
        return {**{f"to_q_{a}": q[other, i] for i, a in enumerate(actuators)},
                "distance": np.linalg.norm(vector[:, :3] - vector[other, :3], axis=1)}
    planar = motion.planar
    names = ["x", "y"] if planar else ["x", "y", "z"]
    if kind == "pose":
        names += ["rz"] if planar else ["rx", "ry", "rz"] if motion.turns_freely else []
    return {c: vector[:, ("x", "y", "z", "rx", "ry", "rz").index(c)] for c in names}


def _more(table, n, machine, rng, noise):
    """Add columns of the circumstances, sound ones and absurd ones."""
    for name in ("payload", "fx", "fy", "mz", "temperature", "time"):
        if rng.random() < 0.25:
            table[name] = rng.choice((
                np.full(n, rng.choice(ABSURD)), 10.0 * np.arange(n), noise.uniform(0, 30, n),
                noise.choice(ABSURD, n)))
    for a in (*machine.actuators, "x"):
        if rng.random() < 0.3:
            table[f"dir_{a}"] = noise.choice((-1.0, 1.0), n) if rng.random() < 0.7 else np.ones(n)
        if rng.random() < 0.1:
            table[f"vel_{a}"] = noise.choice((0.0, 5.0, -5.0, 1e9), n)
    if rng.random() < 0.3:
        table["pose"] = noise.integers(0, max(1, n // 2), n).astype(float)
    if rng.random() < 0.15:
        table["session"] = noise.integers(0, 3, n).astype(float)
    if rng.random() < 0.1:
        table["sigma_x"] = noise.choice((1e-9, 0.01, 1e9), n)


def _spoilt(table, rng, noise):
    """Return the columns with empty cells, constant columns and gross errors."""
    n = len(next(iter(table.values())))
    for name, values in table.items():
        if rng.random() < 0.06:
            values = np.where(noise.random(n) < rng.choice((0.1, 0.5, 1.0)), np.nan, values)
        if rng.random() < 0.04:
            values = np.full(n, values[0])
        if rng.random() < 0.05:
            values = np.where(noise.random(n) < 0.15, values + rng.choice((1.0, 1e3, 1e9)), values)
        table[name] = values
    return {k: [None if np.isnan(v) else float(v) for v in values] for k, values in table.items()}


def _machine(raw):
    import yaml

    content = yaml.safe_load((ROOT / "configs" / f"{raw['machine']}.yaml").read_text())
    return content | {"effects": raw["effects"]} if raw["effects"] else content


def run(data):
    """Make the calls of a case; what each returns is written out, as its files and for a notebook.

    The first refusal ends the case: it is raised.
    """
    raw = json.loads(data)
    machine = ppmcal.load(_machine(raw))
    table = {k: [np.nan if v is None else v for v in values] for k, values in raw["table"].items()}
    rows = ppmcal.read_data(machine, table, sidecar=raw["sidecar"])
    model, refusal, came = machine, None, []
    for name, options in raw["calls"]:
        try:
            if name == "compensate":
                result = ppmcal.compensate(model, _targets(machine), frame="base")
            else:
                call = getattr(ppmcal, name)
                result = call(model if name == "validate" else machine, rows, **options)
            _look_at(result)
            came.append(name)
            if name in ("identify", "diagnose"):
                model = result
        except ppmcal.PpmcalError as error:
            refusal = refusal or error
    if refusal is not None:
        raise refusal
    return " ".join(["read", *came])


def _look_at(result):
    assert repr(result) and all(isinstance(f, str) and f for f in result.findings)
    if not hasattr(result, "files"):
        return
    assert all(result.files())
    assert result._repr_html_()
    json.dumps(dict(result.provenance))


def _targets(machine):
    home = machine.home_pose
    names = ("x", "y", "z", "rx", "ry", "rz")
    scale = [1e3] * 3 + [180.0 / np.pi] * 3
    return {c: [float(v * s)] for c, v, s in zip(names, home, scale, strict=True)
            if c in machine.coordinates}


def campaigns():
    """Return name -> what takes a case, with a way to draw more of them."""
    seeds = tuple(case(random.Random(i)) for i in range(3))
    return {"campaign": Reader("campaign", run, seeds, SECONDS, case)}
