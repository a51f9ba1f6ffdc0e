"""Encoders at joints and inclinometers: rows by differences, exact data, intervals, messages."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from helpers.redundant import apart, stewart
from scipy.spatial.transform import Rotation

import ppmcal
from ppmcal import algebra as cga
from ppmcal.calibration.fit import FitOptions, Problem, identify, posterior, with_gauge
from ppmcal.errors import BadInput
from ppmcal.io.mechanism_reader import read_mechanism
from ppmcal.io.results import plan_wording as wording
from ppmcal.io.sidecar import read_instrument
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, moved
from ppmcal.kinematics.instrument_readings import levelled, own_readings, sensor_turn
from ppmcal.kinematics.inverse import inverse
from ppmcal.model.instruments import find_instrument
from ppmcal.model.registration import Registration

HALF = {"3-RPR": {"x": 100, "y": 100, "rz": 20},
        "6-UPS": {"x": 250, "y": 250, "z": 200, "rx": 12, "ry": 12, "rz": 12},
        "stewart": {"x": 80, "y": 80, "z": 60, "rx": 10, "ry": 10, "rz": 10}}
TILT = {"kind": "inclinometer", "sigma": {"rotation": 0.001}}


def file_of(name, **more):
    """Return a mechanism file as a mapping; struts of a hexapod have their first axes given."""
    if name == "stewart":
        tree = stewart()
    else:
        tree = yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8"))
    if name == "6-UPS":
        for i, limb in enumerate(tree["limbs"]):
            limb["base"]["axis"] = {"value": [float(np.cos(i)), float(np.sin(i)), 0.0],
                                    "tolerance": 0.0}
    return tree | more


def encoder(at, sigma=0.002, **more):
    return {"kind": "joint", "at": at, "sigma": {"value": sigma}, **more}


def scenario(tree, instrument, count=60, seed=7, **more):
    return {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
            "poses": {"random": {"center": tree["home"]["pose"], "half_range": HALF[tree["name"]],
                                 "count": count}},
            "errors": {"random": {"scale": 1.0}}, "instrument": instrument, "seed": seed, **more}


def measured(tree, instrument, **more):
    """Return a simulation, and its data under the name of the joint or the instrument."""
    made = ppmcal.simulate(read_mechanism(tree), scenario(tree, instrument, **more))
    return made, replace(made.data[0], name=instrument.get("at", instrument["kind"]))


# --- tilts in plain numpy -------------------------------------------------------------------------

@pytest.mark.parametrize("weight", [None, [0.0, 0.0, -1.0], [0.3, -0.2, -0.9], [0.0, -1.0, 0.0]])
def test_roll_and_pitch_are_those_of_rotations_about_z_y_and_x(weight):
    tree = file_of("6-UPS", **({"gravity": weight} if weight else {}))
    mechanism, rng = read_mechanism(tree), np.random.default_rng(3)
    up = -np.array(weight or [0.0, 0.0, -1.0])
    up /= np.linalg.norm(up)
    turns, tilt, mount = 0.3 * rng.normal(size=(6, 3)), np.array([0.02, -0.01, 0.4]), np.array(
        [0.1, -0.05, 0.8])
    registration = Registration.of_pose(np.concatenate([np.zeros(3), tilt]),
                                        target_rotation=mount)
    pose = cga.motor_from_rotation_vector(turns, rng.normal(size=(6, 3)))
    found = own_readings(find_instrument("inclinometer"), registration, Model(mechanism),
                         np.zeros((6, 6)), pose)
    # the shortest turn from up to z, by its axis and angle
    axis = np.cross(up, [0.0, 0.0, 1.0])
    size = np.linalg.norm(axis)
    level = Rotation.from_rotvec(axis / (size or 1.0) * np.arctan2(size, up[2]))
    np.testing.assert_allclose(levelled(mechanism), level.as_matrix(), atol=1e-12)
    whole = (Rotation.from_rotvec(tilt) * level * Rotation.from_rotvec(turns)
             * Rotation.from_rotvec(mount) * level.inv())
    _, pitch, roll = whole.as_euler("ZYX").T
    np.testing.assert_allclose(found, np.stack([roll, pitch], axis=1), atol=1e-12)
    np.testing.assert_allclose(sensor_turn(mechanism, registration, pose)[1], whole.as_matrix(),
                               atol=1e-12)


def test_in_the_plane_the_tilt_is_the_turn():
    mechanism = read_mechanism(file_of("3-RPR"))
    pose = np.array([[0.5, 0.3, 0.0, 0.0, 0.0, a] for a in (-0.4, 0.1, 0.9)])
    found = own_readings(find_instrument("inclinometer"), Registration(), Model(mechanism),
                         np.zeros((3, 3)), cga.motor_from_rotation_vector(pose[:, 3:], pose[:, :3]))
    np.testing.assert_allclose(found[:, 0], [-0.4, 0.1, 0.9], atol=1e-15)


# --- rows by differences --------------------------------------------------------------------------

CASES = {"passive": ("3-RPR", encoder("leg2.joint1"), {}),
         "platform's": ("3-RPR", encoder("leg3.joint3"), {}),
         "drive": ("3-RPR", encoder("leg1.joint2", 0.01), {}),
         "universal": ("6-UPS", encoder("leg4.joint1"), {}),
         "noisy drives": ("6-UPS", {**encoder("leg4.joint1"), "sigma": {
             "value": 0.002, "actuator": 0.01}}, {}),
         "tilt": ("6-UPS", TILT, {"frame": {"x": 0, "y": 0, "z": 0, "rx": 0.5, "ry": 0.3, "rz": 0},
                                  "target_rotation": [3, -2, 20]}),
         "in the plane": ("3-RPR", TILT, {"target_rotation": [0, 0, 7]}),
         "seven legs": ("stewart", {**TILT, "sigma": {"rotation": 0.001, "actuator": 0.003}},
                        {"errors": {"random": {"scale": 0.1}}}),
         "seven drives": ("stewart", encoder("leg2.joint2", 0.01), {})}
EFFECTS = [{"kind": "backlash", "parameters": {"width": {"value": 0.05, "free": True,
                                                        "tolerance": 0.1}}},
           {"kind": "base_compliance", "parameters": {
               "z_fz": {"value": 1e-4, "tolerance": 1e-4, "free": True},
               "rx_fz": {"value": 1e-5, "tolerance": 1e-5, "free": True}}}]


@pytest.mark.long_cases("seven drives", "seven legs")
@pytest.mark.parametrize("case", CASES)
@pytest.mark.slow_cases("tilt", "universal", "noisy drives")
def test_rows_move_as_differences_say(case):
    name, instrument, more = CASES[case]
    tree = file_of(name)
    made, data = measured(tree, instrument, count=6, **more)
    mechanism = replace(made.mechanism, free=tuple(
        p for p in made.mechanism.free if ".platform.point.angle" not in made.mechanism.names[p]))
    # with surplus limbs what eliminates the poses is held in a step
    compare(Problem(mechanism, (replace(data, homing="alone"),), mechanism.free),
            2e-3 if mechanism.surplus else 2e-6)


def compare(problem, atol=2e-6):
    """Hold the Jacobian of what was measured against central differences of predictions."""
    start = problem.start()
    (rows,) = problem.rows(start)
    raw = rows.raw_jacobian()
    scale = np.concatenate([[1e-5] * len(problem.free), 1e-2 * problem.open_scale()])

    def at(step):
        (there,) = problem.rows(problem.moved(start, step), False)
        # the pose of a row goes along, with what it says of the instrument
        return -there.measured

    for c, name in enumerate(problem.columns):
        step = scale[c] * np.eye(len(scale))[c]
        by = (at(step) - at(-step)) / (2.0 * scale[c])
        size = max(1.0, float(np.abs(by).max()))
        np.testing.assert_allclose(raw[..., c], by, atol=atol * size, err_msg=name)


@pytest.mark.parametrize("instrument", [encoder("leg2.joint1"), TILT], ids=["joint", "tilt"])
def test_effects_move_rows_as_differences_say(instrument):
    """What moves the platform beyond its limbs tilts it, and leaves their joints alone."""
    tree = file_of("6-UPS", effects=EFFECTS, free=["*.offset"])
    made, data = measured(tree, instrument, count=6, approach="both",
                          conditions={"payload": [0, 200]}, errors={"leg1.offset": 0.5})
    machine = made.mechanism
    compare(Problem(machine, (data,), machine.free), 2e-5)


# --- exact data -----------------------------------------------------------------------------------

def off(found, made, count=20):
    """Return how far poses at fresh joint values are from the truth, frames laid together, m."""
    mechanism, true = found.identification.mechanism, Model(made.campaign.with_effects,
                                                            made.campaign.g)
    step = np.zeros((count, 6))
    step[:, mechanism.dof] = 0.1 * np.random.default_rng(99).uniform(
        -1.0, 1.0, (count, len(mechanism.dof)))
    pose = moved(np.tile(mechanism.home, (count, 1)), step)
    ours = forward(Model(mechanism), inverse(true, pose).q)
    assert ours.converged.all()
    return apart(mechanism, ours.pose, pose)


@pytest.mark.slow
def test_a_square_machine_calibrates_itself_by_passive_encoders():
    """Three angles a row, offsets unknown: the base is held as gauge, nothing is redundant."""
    tree = file_of("3-RPR")
    data = [measured(tree, encoder(at, 1e-9, offset=turn))
            for at, turn in (("leg1.joint1", 12), ("leg2.joint1", -200), ("leg3.joint3", 77))]
    made = data[0][0]
    found = ppmcal.identify(made.mechanism, [d for _, d in data])
    problem = found.identification.fit.problem
    (gauge,) = (f for f in problem.mechanism.findings if f.topic == "gauge")
    assert gauge.startswith("leg1.base.point.x, leg1.base.point.y, leg2.base.point.y are held")
    assert found.identification.rank == len(problem.columns)
    assert problem.columns[-3:] == ("offset.rz of leg1.joint1", "offset.rz of leg2.joint1",
                                    "offset.rz of leg3.joint3")
    assert off(found, made) < 1e-9
    turns = [np.degrees(r.offset) for r in found.identification.fit.state.registrations]
    np.testing.assert_allclose(turns, [12, 160, 77], atol=1e-2)


@pytest.mark.slow
def test_one_passive_encoder_alone_is_a_calibration_too():
    """With a typed offset the base's turn is seen: two coordinates are held, not three."""
    tree = file_of("3-RPR", free=["*.base.point.?", "*.offset"])
    made, data = measured(tree, encoder("leg1.joint1", 1e-9), count=80)
    data = replace(data, offset=replace(data.offset, fitted=False))
    problem = ppmcal.identify(made.mechanism, data).identification.fit.problem
    (gauge,) = (f for f in problem.mechanism.findings if f.topic == "gauge")
    assert gauge.startswith("leg1.base.point.x, leg1.base.point.y are held")


@pytest.mark.long
def test_a_hexapod_with_poses_and_a_set_of_encoders():
    tree = file_of("6-UPS")
    joints = [measured(tree, encoder(f"leg{n}.joint1", 1e-9, offset=20 * n)) for n in (1, 3, 5)]
    made, poses = measured(tree, {"kind": "pose", "sigma": {"position": 1e-7, "rotation": 1e-8}},
                           frame={"x": 900, "y": 100, "z": 50, "rx": 3, "ry": 2, "rz": 30},
                           target=[10, 20, 30])
    found = ppmcal.identify(made.mechanism, [poses, *(d for _, d in joints)])
    assert off(found, made) < 1e-9
    # one campaign: a pose that is held out is held out of all of them
    assert len({d.campaign for d in found.identification.fit.problem.datasets}) == 1


@pytest.mark.long
def test_a_hexapod_with_positions_and_tilts():
    tree = file_of("6-UPS")
    made, tilts = measured(tree, {**TILT, "sigma": {"rotation": 1e-8}}, count=80, frame={
        "x": 0, "y": 0, "z": 0, "rx": 0.4, "ry": -0.3, "rz": 0}, target_rotation=[2, -3, 33])
    _, points = measured(tree, {"kind": "position", "sigma": {"position": 1e-7}}, count=80,
                         frame={"x": 900, "y": 100, "z": 50, "rx": 3, "ry": 2, "rz": 30},
                         target=[110, -120, 30])
    found = ppmcal.identify(made.mechanism, [tilts, points])
    assert off(found, made) < 1e-9
    assert "frame.rx of inclinometer" in found.identification.columns
    assert "frame.rz of inclinometer" not in found.identification.columns


# --- intervals ------------------------------------------------------------------------------------

@pytest.mark.long
def test_intervals_of_self_calibrations_cover():
    """95 % intervals of nine parameters hold some 95 % of the truths, drawn where nothing is held.
    """
    tree, inside, seeds = file_of("3-RPR"), 0, 20
    for leg, held in (("leg1", "xy"), ("leg2", "y")):
        base = next(limb["base"] for limb in tree["limbs"] if limb["name"] == leg)
        base["point"] = {c: {"value": v, "fixed": True} if c in held else v
                         for c, v in zip("xy", base["point"], strict=True)}
    machine = read_mechanism(tree)
    tau = {machine.names[p]: 1e3 * float(machine.parameters[p].tolerance) for p in machine.free}
    for seed in range(seeds):
        drawn = np.random.default_rng([7, seed]).normal(size=len(tau)).tolist()
        errors = {n: t * z for (n, t), z in zip(tau.items(), drawn, strict=True)}
        # one machine, and noise of its own in each file
        data = [measured(tree, encoder(f"leg{n}.joint1", 0.003), count=30, seed=3 * seed + n,
                         errors=errors) for n in (1, 2, 3)]
        made, files = data[0][0], tuple(d for _, d in data)
        machine = with_gauge(made.mechanism, files)
        assert machine is made.mechanism
        free = list(machine.free)
        fit = identify(Problem(machine, files, machine.free), FitOptions(robust=False))
        sigma = np.sqrt(np.diagonal(posterior(fit)))[:len(free)]
        inside += int((np.abs(fit.state.g[free] - made.campaign.g[free]) <= 1.96 * sigma).sum())
    assert len(free) == 9
    assert 0.9 < inside / (9 * seeds) < 0.99


# --- files and messages ---------------------------------------------------------------------------

def read(tree, columns, instrument, n=8, **more):
    mechanism = read_mechanism(tree)
    q = inverse(Model(mechanism), mechanism.home[None]).q[0] / mechanism.joint_factors()
    table = {f"q_{a}": np.full(n, v) + 5.0 * np.random.default_rng(i).uniform(-1.0, 1.0, n)
             for i, (a, v) in enumerate(zip(mechanism.actuators, q, strict=True))}
    return ppmcal.read_data(mechanism, table | columns, sidecar={
        "units": {"length": "mm", "angle": "deg"}, "instrument": instrument, **more})


def test_what_a_sidecar_need_not_say():
    (data,) = read(file_of("3-RPR"), {"value": np.linspace(10, 40, 8)}, encoder("leg1.joint1"))
    assert (data.offset.fitted, data.frame.fitted, data.target.fitted) == (True, False, False)
    np.testing.assert_allclose(data.value, np.radians(np.linspace(10, 40, 8)))
    np.testing.assert_allclose(data.sigma_value, np.radians(0.002))
    (data,) = read(file_of("3-RPR"), {"value": np.linspace(10, 40, 8)},
                   encoder("leg1.joint2", offset=3))
    assert not data.offset.fitted
    np.testing.assert_allclose(data.offset.value, 3e-3)
    np.testing.assert_allclose(data.value, 1e-3 * np.linspace(10, 40, 8))
    (data,) = read(file_of("6-UPS"), {"roll": np.linspace(0, 4, 8), "pitch": np.linspace(0, 4, 8)},
                   TILT)
    assert data.target_rotation.fitted and not data.target.fitted
    np.testing.assert_allclose(data.rotation[:, 0], np.radians(np.linspace(0, 4, 8)))
    assert np.isnan(data.rotation[:, 2]).all() and np.isnan(data.position).all()


ANGLES = {"roll": np.linspace(0, 4, 8), "pitch": np.linspace(0, 4, 8)}
VALUE = {"value": np.linspace(10, 40, 8)}


@pytest.mark.parametrize(("name", "columns", "instrument", "more", "said"), [
    ("3-RPR", VALUE, encoder("leg1.joint4"), {}, r"Choose one of: leg1.joint1 \(R\), leg1.joint2"),
    ("3-RPR", VALUE, {"kind": "joint", "sigma": {"value": 1}}, {}, "the joint that the encoder is"),
    ("3-RPR", VALUE, {"kind": "joint", "at": "leg1.joint1", "sigma": {"position": 1}}, {},
     "the key 'value' is missing"),
    ("3-RPR", {}, encoder("leg1.joint1"), {}, "there is no column value"),
    ("3-RPR", VALUE, encoder("leg1.joint1", offset="maybe"), {}, "instrument.offset"),
    ("3-RPR", VALUE, {**encoder("leg1.joint1"), "kind": "plane"}, {}, "'plane' is not at a joint"),
    ("3-RPR", VALUE, encoder("leg1.joint1"), {"scale": 1.01}, "no lengths that have a scale"),
    ("6-UPS", {"roll": ANGLES["roll"]}, TILT, {}, "there is no column pitch"),
    ("6-UPS", ANGLES, {"kind": "inclinometer", "sigma": {"position": 1}}, {},
     "the key 'rotation' is missing"),
    ("6-UPS", ANGLES, {**TILT, "offset": 1}, {}, "'inclinometer' has no offset"),
    ("6-UPS", ANGLES | {"x": ANGLES["roll"]}, TILT, {}, None)])
def test_bad_input_is_told(name, columns, instrument, more, said):
    if said is None:
        (data,) = read(file_of(name), columns, instrument, **more)
        assert any("columns x: not used, because the instrument's kind is `inclinometer`" in f
                   for f in data.findings)
        return
    with pytest.raises(BadInput, match=said):
        read(file_of(name), columns, instrument, **more)


def test_machines_that_never_tilt_are_refused():
    tree = yaml.safe_load((ROOT / "configs" / "delta-linear.yaml").read_text(encoding="utf-8"))
    with pytest.raises(BadInput, match="translational machine never tilts"):
        read(tree, ANGLES, TILT)
    with pytest.raises(BadInput, match="needs gravity"):
        read(file_of("3-RPR", gravity=[0, 0, -1]), {"roll": ANGLES["roll"]}, TILT)


def test_too_few_rows_for_what_is_open():
    for tree, columns, instrument, said in (
            (file_of("3-RPR"), VALUE, encoder("leg1.joint1"), "an unknown offset needs"),
            (file_of("6-UPS"), ANGLES, TILT, "tilt of the base or rotation of the sensor")):
        short = {k: np.where(np.arange(8) < 2, v, np.nan) for k, v in columns.items()}
        with pytest.raises(BadInput, match=said):
            ppmcal.identify(read_mechanism(tree), read(tree, short, instrument))


@pytest.mark.slow
def test_plans_have_such_instruments_and_fleets_do_not(tmp_path):
    side = tmp_path / "encoder.yaml"
    side.write_text(yaml.safe_dump({"format": "ppmcal/dataset/1", "units": {
        "length": "mm", "angle": "deg"}, "instrument": encoder("leg1.joint1")}))
    mechanism = read_mechanism(file_of("3-RPR"))
    found = read_instrument(side, mechanism)
    assert (found.kind.at, found.sigma_value, found.offset.fitted) == (
        "leg1.joint1", pytest.approx(np.radians(0.002)), True)
    made = ppmcal.plan(mechanism, instrument=side, count=6)
    assert wording.instrument(made.plan) == (
        "Instrument: joint at leg1.joint1, standard deviation value 0.002 deg; offset unknown.")
    with pytest.raises(BadInput, match="fleets are not measured with the instrument 'joint'"):
        ppmcal.tolerances(mechanism, accuracy=0.5, instrument=side)


def test_columns_have_units_of_their_own_and_are_nobodys_elsewhere():
    (data,) = read(file_of("3-RPR"), {"value [rad]": np.linspace(0.2, 0.7, 8)},
                   encoder("leg1.joint1"))
    np.testing.assert_allclose(data.value, np.linspace(0.2, 0.7, 8))
    (data,) = read(file_of("6-UPS"), {"roll [rad]": 0.01 * ANGLES["roll"],
                                      "pitch": ANGLES["pitch"]}, TILT)
    np.testing.assert_allclose(data.rotation[:, 0], 0.01 * ANGLES["roll"])
    points = {c: np.arange(8.0) for c in "xyz"}
    (data,) = read(file_of("6-UPS"), points | ANGLES | {"value": np.arange(8.0)},
                   {"kind": "position", "sigma": {"position": 0.02}})
    assert any("columns roll, pitch, value: not used, nobody knows them" in f
               for f in data.findings)


@pytest.mark.parametrize("name", ["3-RPR", "6-UPS"])
def test_each_angle_of_a_tilt_counts(name):
    """They are no incomplete rotation, of which nothing would be said."""
    made, data = measured(file_of(name), TILT, count=8)
    counts = Problem(made.mechanism, (data,), made.mechanism.free).counts(0, np.arange(8))
    assert counts.tolist() == [1 if name == "3-RPR" else 2] * 8


@pytest.mark.slow
def test_a_tilt_that_was_read_wrongly_is_left_out():
    tree = file_of("6-UPS")
    made, data = measured(tree, TILT, count=40)
    rotation = data.rotation.copy()
    rotation[11, 0] += np.radians(2.0)
    wrong = replace(data, rotation=rotation)
    free = tuple(p for p in made.mechanism.free if ".platform.point.angle" not in
                 made.mechanism.names[p])
    fit = identify(Problem(made.mechanism, (wrong,), free), FitOptions())
    assert np.flatnonzero(~fit.keep[0]).tolist() == [11]
