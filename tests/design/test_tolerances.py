"""Tolerances from an accuracy, and the share of simulated machines that keep it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import number, ppmcal, rows
from helpers.paths import ROOT
from scipy.optimize import minimize

from ppmcal import algebra as cga
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.linearisation import column_scale
from ppmcal.calibration.fit.problem import Problem
from ppmcal.design.error_jacobian import Poses
from ppmcal.design.error_sources import geometry_only, sources, tolerances
from ppmcal.design.monte_carlo import Fleet, MachineErrors, batches, run, together
from ppmcal.design.plan.candidate_poses import evenly, region_of
from ppmcal.design.processes import over
from ppmcal.design.recalibration import MeasurementSetup, calibrate, predicted, readings
from ppmcal.design.tolerance_allocation import Demand, StageYield, check, count
from ppmcal.design.tolerance_costs import (
    cost,
    demand,
    equal_parts,
    is_sensitive,
    least_cost,
    one_for_all,
)
from ppmcal.design.virtual_instrument import Instrument, default_instrument
from ppmcal.io import read_mechanism, write_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.least_squares_closure import unexplained
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.region import named
from ppmcal.kinematics.registration import predict
from ppmcal.kinematics.tables import inverse_table
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism

CONFIGS = ROOT / "configs"


def machine(name: str) -> Mechanism:
    return geometry_only(read_mechanism(CONFIGS / f"{name}.yaml"))


def fleet(name: str, kind: str | None = None, measured: int = 30) -> Fleet:
    m = machine(name)
    found = sources(m)
    region = region_of(m)
    tasks, poses = evenly(m, region, 12, 1), evenly(m, region, measured, 2)
    instrument = default_instrument(m)
    if kind is not None:
        instrument = replace(instrument, kind=find_instrument(kind),
                             sigma_value=instrument.sigma_position)
    return Fleet(m, tuple(s.parameter for s in found), tolerances(m, found),
                 Poses(tasks.q, pose_motor(tasks.pose), np.zeros(3)),
                 MeasurementSetup(m, instrument, poses.q, poses.pose))


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


# ---------------------------------------------------------------- allocation

A = np.array([3.0, 0.5, 0.0, 7.0, 1e-14])


def test_each_allocation_meets_the_demand() -> None:
    for tau in (equal_parts(A), least_cost(A, np.ones(5), np.ones(5)),
                least_cost(A, np.array([1.0, 5, 1, 0.2, 1]), np.array([2.0, 1, 1, 0.5, 1]))):
        use = is_sensitive(A)
        assert use.tolist() == [True, True, False, True, False]
        assert np.isinf(tau[~use]).all()
        assert np.sum((A[use] * tau[use]) ** 2) == pytest.approx(1.0)
    unit = np.array([1.0, 1.0, 1.0, 0.1, 0.1])
    assert np.sum((A * one_for_all(A, unit)) ** 2) == pytest.approx(1.0)
    np.testing.assert_allclose(
        A[is_sensitive(A)] * equal_parts(A)[is_sensitive(A)], 1.0 / np.sqrt(3.0)
    )


def test_least_cost_is_what_a_general_solver_finds() -> None:
    a = np.array([3.0, 0.5, 7.0])
    for weight, exponent in ((np.ones(3), np.ones(3)),
                             (np.array([1.0, 5.0, 0.2]), np.array([2.0, 1.0, 0.5]))):
        tau = least_cost(a, weight, exponent)
        found = minimize(lambda x, w=weight, p=exponent: cost(np.exp(x), w, p), np.log(tau) + 0.3,
                         constraints={"type": "eq", "fun": lambda x: 1 - np.sum(
                             (a * np.exp(x)) ** 2)}, options={"ftol": 1e-14, "maxiter": 500})
        np.testing.assert_allclose(np.exp(found.x), tau, rtol=1e-4)
        # and cheaper than the others
        assert cost(tau, weight, exponent) < cost(equal_parts(a), weight, exponent)


def test_cost_allocation_survives_any_units() -> None:
    for scale in (1e-12, 1.0, 1e12):
        tau = least_cost(A * scale, np.ones(5), np.ones(5))
        use = is_sensitive(A)
        assert np.sum((A[use] * scale * tau[use]) ** 2) == pytest.approx(1.0)


def test_position_and_rotation_are_demanded_together() -> None:
    by_position, by_rotation = np.array([3.0, 4.0]), np.array([0.1, 0.0])
    np.testing.assert_allclose(demand(by_position, by_rotation, 2.0, 0.1),
                               [np.hypot(1.5, 1.0), 2.0])
    np.testing.assert_allclose(demand(by_position, by_rotation, None, 0.1), [1.0, 0.0])


# ---------------------------------------------------------------- fleets

@pytest.mark.long
def test_a_seed_gives_the_same_machines_on_one_core_and_on_two() -> None:
    one = fleet("3-RPR")
    items = batches(430, 7)
    assert [n for n, _ in items] == [100, 100, 100, 100, 30]
    alone = together(list(over(run, one, items, 1)))
    shared = together(list(over(run, one, items, 2)))
    for stage in ("built", "registered", "calibrated"):
        np.testing.assert_array_equal(getattr(alone, stage).position,
                                      getattr(shared, stage).position)
    # and the first of them whatever the number asked for
    fewer = together(list(over(run, one, batches(200, 7), 1)))
    np.testing.assert_array_equal(fewer.built.position, alone.built.position[:200])
    other = together(list(over(run, one, batches(200, 8), 1)))
    assert not np.allclose(other.built.position, fewer.built.position)


@pytest.mark.long
def test_a_cluster_gives_the_same_machines(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False,
                                  dashboard_address=None, protocol="tcp",
                                  local_directory=str(tmp_path)) as cluster:
        options = ("--accuracy", 0.5, "--machines", 120, "--json", "--seed", 3)
        far = ppmcal("tolerances", CONFIGS / "3-RPR.yaml", *options, "--scheduler",
                     cluster.scheduler_address, "--out", tmp_path / "far").json
    near = ppmcal("tolerances", CONFIGS / "3-RPR.yaml", *options, "--out", tmp_path / "near").json
    assert far["yield"] == near["yield"]
    assert (tmp_path / "far/errors.csv").read_bytes() == (tmp_path / "near/errors.csv").read_bytes()


@pytest.mark.slow
def test_no_scheduler_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    run_ = ppmcal("tolerances", CONFIGS / "3-RPR.yaml", "--accuracy", 1, "--scheduler", "nonsense",
                  "--out", tmp_path / "o", expect=2)
    assert "no scheduler answers" in run_.err.replace("\n", " ")


@pytest.mark.long_cases(
    "cable-4-planar-pose", "stewart-7-position", "3-RPR-pose", "6-UPS-pose",
    "delta-linear-position")
@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [
    ("3-RPR", "pose"), ("3-RPR", "position"), ("6-UPS", "pose"), ("6-UPS", "distance"),
    ("delta-linear", "position"), ("delta-linear", "plane"), ("3-RPS", "pose"),
    ("cable-4-planar", "pose"), ("stewart-7", "position")])
def test_the_fleet_is_calibrated_as_identify_would(name: str, kind: str) -> None:
    """Five machines, each measured and identified on its own with the same noise."""
    one = fleet(name, kind, 40)
    setup, m = one.setup, one.mechanism
    rng = np.random.default_rng(4)
    g = np.tile(m.values, (5, 1))
    g[:, list(one.wanted)] += rng.normal(size=(5, len(one.wanted))) * one.sigma
    width = len(find_instrument(kind).coordinates(m.motion))
    noise = rng.normal(size=(5, len(setup.q), width + m.surplus))
    noise[..., width:] = 0.0
    found = calibrate(setup, setup.linear, g, noise)
    assert found.settled.all()
    sigma = setup.linear.sigma[:len(setup.problem.free)]
    for i in range(5):
        data = measured(setup, g[i], noise[i])
        fit = identify(Problem(m, (data,), m.free), FitOptions(robust=False))
        free = list(m.free)
        # the chord's fixed point differs from Gauss-Newton's by second order only
        apart = (found.g[i, free] - fit.state.g[free]) / sigma
        assert np.abs(apart).max() < 0.25, (i, np.abs(apart).max())
        assert rms((found.g[i, free] - g[i, free]) / sigma) < 2.0


@pytest.mark.long_cases("cable-8-pulleys")
@pytest.mark.parametrize("name", ["cable-4-planar", "stewart-7", "cable-8-pulleys"])
@pytest.mark.slow
def test_readings_follow_the_platform_and_miss_the_closure_as_asked(name: str) -> None:
    """Joints commanded at which limbs contradict each other, then what their encoders show."""
    one = fleet(name, "pose", 10)
    m, rng = one.mechanism, np.random.default_rng(6)
    g = m.values.copy()
    g[list(one.wanted)] += rng.normal(size=len(one.wanted)) * one.sigma
    model = Model(m, g)
    pose, there, _ = newton(model.closure(one.setup.q), pose_motor(one.setup.pose))
    gaps = rng.normal(size=(len(pose), m.surplus)) * 1e-4
    own = unexplained(model.closure(one.setup.q), pose)
    assert there.all() and np.abs(own).max() > 1e-6
    found = unexplained(model.closure(readings(model, pose, gaps)), pose)
    assert np.abs(found + gaps).max() < 1e-12


def measured(setup: MeasurementSetup, g: np.ndarray, noise: np.ndarray) -> Dataset:
    """What the setup's instrument shows of one machine, as a data set."""
    m, instrument = setup.mechanism, setup.instrument
    real, _, _ = newton(Model(m, g).closure(setup.q), pose_motor(setup.pose))
    # encoders of surplus limbs read how long they are at the pose that all agree on
    q = inverse_table(Model(m, g), pose_vector(real)).q if m.surplus else setup.q
    clean = instrument.dataset(q, pose_vector(real), {}, m)
    # noise of the joints, where the machine states it, moves what is seen along with the rest
    raw = np.linalg.solve(setup.linear.white, noise[..., None])[..., 0]
    if instrument.kind.scalar:
        return replace(clean, value=clean.value + raw[:, 0])
    pick = list(instrument.kind.coordinates(m.motion))
    whole = np.zeros((len(noise), 6))
    whole[:, pick] = raw[:, :len(pick)]
    position = clean.position + whole[:, :3]
    turn = predict(instrument.registration, real)[1]
    shake = cga.motor_from_rotation_vector(whole[:, 3:], np.zeros(3))
    shaken = cga.rotation_vector(cga.compose(shake, cga.motor_from_matrix(turn, np.zeros(3))))
    rotation = np.where(np.isnan(clean.rotation), np.nan, shaken)
    return replace(clean, position=position, rotation=rotation)


@pytest.mark.long_cases(
    "cable-4-planar", "cable-8-pulleys", "stewart-7", "linapod", "3-PPR-1", "3-RRR-1")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["3-RPR", "6-UPS", "linapod", "delta-rotary", "6-RUS", "3-PPR-1",
                                  "3-RRR-1", "cable-4-planar", "cable-8-pulleys", "stewart-7"])
def test_linear_prediction_and_machines_drawn_agree(name: str) -> None:
    one = fleet(name)
    found = together([run(one, b) for b in batches(200, 5)])
    compared = check(one, found.built)
    assert compared.agrees.mean() > 0.9
    expected = predicted(one.setup, one.tasks.q, pose_vector(one.tasks.motor))
    assert rms(found.calibrated.position) == pytest.approx(rms(expected), rel=0.15)
    assert rms(found.calibrated.position) < rms(found.registered.position) < 1.2 * rms(
        found.built.position)


@pytest.mark.long_cases("delta-linear-6rods")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["3-RPS", "delta-linear-6rods"])
def test_what_too_few_drives_cannot_command_is_left(name: str) -> None:
    """Next to perfect knowledge: what remains is what the named coordinates do not settle."""
    one = fleet(name)
    m, tasks = one.mechanism, one.tasks
    instrument = replace(one.setup.instrument, sigma_position=1e-8, sigma_rotation=1e-8,
                         frame=replace(one.setup.instrument.frame, fitted=False))
    one = replace(one, setup=replace(one.setup, instrument=instrument))
    count_, seed = batches(8, 5)[0]
    found = run(one, (count_, seed))
    g = np.tile(m.values, (8, 1))
    rng = np.random.default_rng(batches(8, 5)[0][1])
    g[:, list(one.wanted)] += rng.normal(size=(8, len(one.wanted))) * one.sigma
    wanted = pose_vector(tasks.motor)
    open_ = [c for c in range(6) if c not in named(m)]
    asked = wanted.copy()
    asked[:, open_] = np.nan
    for i in range(8):
        table = inverse_table(Model(m.with_values(g[i])), asked)
        away = np.linalg.norm(table.pose[:, :3] - wanted[:, :3], axis=1)
        np.testing.assert_allclose(found.calibrated.position[i], away, atol=2e-6)
    assert rms(found.calibrated.rotation) > 1e-5


@pytest.mark.long
def test_machines_far_from_the_drawing_are_identified_one_by_one(tmp_path: Path) -> None:
    """Tolerances of millimetres: the drawing's Jacobian does not lead there; fits still do."""
    path = changed(tmp_path, "tolerances: {point: 5, length: 5, angle: 1, offset: 5}")
    found = ppmcal("tolerances", path, "--accuracy", 0.1, "--method", "file", "--machines", 40,
                   "--json", "--out", tmp_path / "o").json
    built, _, calibrated = found["yield"]
    assert built["share"] == 0.0
    lost = 40 - built["going"]
    assert calibrated["in_specification"] >= 40 - lost - 1
    assert calibrated["position_rms"] < 0.01


def changed(folder: Path, line: str, name: str = "3-RPR") -> Path:
    """A shipped file with its tolerances in another line."""
    text = (CONFIGS / f"{name}.yaml").read_text()
    start = text.index("\ntolerances:") + 1
    path = folder / "changed.yaml"
    path.write_text(text[:start] + line + text[text.index("\n", start):])
    return path


@pytest.mark.long
def test_a_machine_without_result_never_stops_the_others(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ppmcal.design.monte_carlo.BATCH", 20)
    path = changed(tmp_path, "tolerances: {point: 20, length: 20, angle: 5, offset: 20}")
    # a whole batch, and one machine in a batch of its own
    run_ = ppmcal("tolerances", path, "--accuracy", 100, "--method", "file", "--machines",
                  21, "--cores", 1, "--out", tmp_path / "o", expect=1)
    assert "cannot take every task pose" in run_.out.replace("\n", " ")


@pytest.mark.slow
def test_the_check_says_where_the_linear_model_is_wrong() -> None:
    """Next to a singularity errors of a tolerance are no longer small."""
    one = fleet("3-RPR")
    m = one.mechanism
    poses = np.array([[0.5, 0.288675, 0, 0, 0, np.radians(r)] for r in (30.0, 0.25)])
    table = inverse_table(Model(m), poses)
    near = replace(one, tasks=Poses(table.q, pose_motor(poses), np.array([0.2, 0.0, 0.0])),
                   setup=None)
    found = together([run(near, b) for b in batches(600, 5)])
    assert check(near, found.built).agrees.tolist() == [True, False]


# ---------------------------------------------------------------- shares

def test_a_machine_that_cannot_go_there_is_out_of_specification() -> None:
    errors = MachineErrors(np.array([[0.1, 0.2], [0.1, np.nan], [0.1, 0.4]]), np.zeros((3, 2)))
    assert count(errors, Demand(0.3, None, 0.9)).in_specification == 1
    assert count(errors, Demand(None, 0.1, 0.9)).in_specification == 3


def test_the_interval_of_a_share_covers_it() -> None:
    rng = np.random.default_rng(2)
    for p in (0.5, 0.95):
        inside = 0
        for hits in rng.binomial(60, p, 2000):
            low, high = StageYield(int(hits), 60).interval
            inside += low <= p <= high
        assert inside / 2000 > 0.945
    assert StageYield(0, 10).interval[0] == 0.0 and StageYield(10, 10).interval[1] == 1.0


# ---------------------------------------------------------------- the command

@pytest.mark.long
@pytest.mark.parametrize(("name", "method"), [
    ("3-RPR", "cost"), ("6-UPS", "mean"), ("delta-linear", "equal")])
def test_the_wanted_share_of_machines_comes_out(name: str, method: str, tmp_path: Path) -> None:
    """The scale comes from the linear model's draws, the share from other, nonlinear machines."""
    found = ppmcal("tolerances", CONFIGS / f"{name}.yaml", "--accuracy", 0.3, "--method", method,
                   "--machines", 400, "--yield", 0.9, "--json", "--out", tmp_path / "o").json
    built = next(y for y in found["yield"] if y["stage"] == "built")
    low, high = built["interval"]
    # 4000 draws set the scale: their own error, half a percent, comes on top
    assert low - 0.015 < 0.9 < high + 0.015
    costs = found["costs"]
    assert costs["cost"] <= costs["equal"] * 1.001 and costs["cost"] <= costs["mean"] * 1.001


@pytest.mark.long
def test_the_allocated_file_is_a_machine_with_these_tolerances(tmp_path: Path) -> None:
    ppmcal("tolerances", CONFIGS / "6-UPS.yaml", "--accuracy", 0.2, "--machines", 20, "--out",
           tmp_path / "o")
    again = read_mechanism(tmp_path / "o" / "allocated.yaml")
    tau = {p.name: p.tolerance for p in again.parameters}
    for row in rows(tmp_path / "o" / "tolerances.csv"):
        wanted = number(row, "chosen") * again.units.factor(
            "length" if row["unit"] == "mm" else "angle")
        assert tau[row["name"]] == pytest.approx(wanted, rel=1e-12)
    found = ppmcal("tolerances", tmp_path / "o" / "allocated.yaml", "--accuracy", 0.2, "--method",
                   "file", "--machines", 400, "--json", "--out", tmp_path / "p").json
    assert found["yield"][0]["share"] == pytest.approx(0.95, abs=0.04)


@pytest.mark.slow
def test_costs_of_the_file_decide(tmp_path: Path) -> None:
    """Where offsets are dear, they get wider tolerances than where they are cheap."""
    text = (CONFIGS / "3-RPR.yaml").read_text()
    found = {}
    for weight in (0.01, 100):
        path = tmp_path / f"c{weight}.yaml"
        path.write_text(text + f"\ncost: {{offset: {weight}, point: {{weight: 1, exponent: 2}}}}\n")
        ppmcal("tolerances", path, "--accuracy", 0.5, "--machines", 20, "--out", tmp_path / "o")
        found[weight] = {r["name"]: number(r, "chosen") for r in
                         rows(tmp_path / "o" / "tolerances.csv")}
        again = read_mechanism(tmp_path / "o" / "allocated.yaml")
        assert again.cost == {"offset": (weight, 1.0), "point": (1.0, 2.0)}
        assert read_mechanism(path).cost == again.cost
    assert found[100]["leg1.offset"] > 2.0 * found[0.01]["leg1.offset"]
    assert found[100]["leg1.base.point.x"] < found[0.01]["leg1.base.point.x"]


@pytest.mark.slow
def test_task_poses_that_cannot_be_reached_are_named(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("x,y,rz\n500,288,30\n5000,288,30\n520,300,25\n")
    run_ = ppmcal("tolerances", CONFIGS / "3-RPR.yaml", "--accuracy", 1, "--poses",
                  tmp_path / "p.csv", "--machines", 20, "--json", "--out", tmp_path / "o", expect=1)
    assert any("row 2" in f for f in run_.json["findings"])
    assert len(rows(tmp_path / "o" / "errors.csv")) == 2


@pytest.mark.slow
def test_unknown_tolerances_are_not_drawn_from(tmp_path: Path) -> None:
    path = changed(tmp_path, "tolerances: {point: .inf, length: 0.3, angle: 0.1, offset: 0.4}")
    run_ = ppmcal("tolerances", path, "--accuracy", 1, "--method", "file", "--out", tmp_path / "o",
                  expect=2)
    assert "has no tolerance to draw from" in run_.err.replace("\n", " ")
    ppmcal("tolerances", path, "--accuracy", 1, "--machines", 20, "--out", tmp_path / "o")
    found = ppmcal("sensitivity", path, "--home-only", "--json", "--out", tmp_path / "s", expect=1)
    assert any("without a finite tolerance" in f for f in found.json["findings"])
    table = {r["name"]: r["tolerance"] for r in rows(tmp_path / "s" / "sensitivity.csv")}
    assert np.isnan(float(table["leg1.base.point.x"] or "nan"))
    assert float(table["leg1.offset"]) > 0.0


@pytest.mark.slow
def test_every_stage_is_judged_at_the_same_point(tmp_path: Path) -> None:
    """Nothing to register: a known frame. Then registering alone changes nothing."""
    (tmp_path / "i.yaml").write_text(
        "format: ppmcal/dataset/1\nunits: {length: mm, angle: deg}\ninstrument: {kind: pose, "
        "sigma: {position: 0.01, rotation: 0.01}}\nframe: known\ntarget: [0, 0, 500]\n")
    found = ppmcal("tolerances", CONFIGS / "6-UPS.yaml", "--accuracy", 1, "--method", "file",
                   "--instrument", tmp_path / "i.yaml", "--machines", 20, "--json", "--out",
                   tmp_path / "o").json
    built, registered, _ = found["yield"]
    assert registered["position_rms"] == pytest.approx(built["position_rms"], rel=1e-9)


@pytest.mark.slow
def test_ratios_of_drives_are_weighed_by_their_travel(tmp_path: Path) -> None:
    text = (CONFIGS / "delta-linear.yaml").read_text()
    ratio = "    ratio: {value: -0.0125, tolerance: 1e-6}\n"
    lines, home = [], False
    for line in text.splitlines(keepends=True):
        home = line.startswith("limits:")
        lines.append("" if home else line)
        if line.startswith("    kind:"):
            lines.append(ratio)
    path = tmp_path / "steps.yaml"
    path.write_text("".join(lines))
    found = ppmcal("sensitivity", path, "--home-only", "--json", "--out", tmp_path / "o").json
    assert found["home"]["amplification_position"] < 20.0
    ppmcal("tolerances", path, "--accuracy", 1, "--machines", 20, "--out", tmp_path / "t")
    units = {r["slot"]: r["unit"] for r in rows(tmp_path / "t" / "tolerances.csv")}
    assert units["ratio"] == "mm per unit"


@pytest.mark.parametrize(("line", "words"), [
    ("cost: {pint: 1}", "unknown class of slots 'pint'"),
    ("cost: {point: -1}", "not greater than 0"),
    ("cost: {point: {weight: 1, exponent: 0}}", "not greater than 0"),
    ("cost: {point: {power: 2}}", "unknown key 'power'"),
    ("cost: 3", "mapping"),
])
def test_broken_costs_are_refused(line: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text((CONFIGS / "3-RPR.yaml").read_text() + f"\n{line}\n")
    run_ = ppmcal("check", path, expect=2)
    assert words in run_.err.replace("\n", " ") or "dictionary" in run_.err


def test_a_written_machine_without_costs_has_none() -> None:
    assert "cost" not in write_mechanism(read_mechanism(CONFIGS / "3-RPR.yaml"))


@pytest.mark.parametrize(("name", "options", "words"), [
    ("3-RPR", (), "no accuracy is demanded"),
    ("3-RPR", ("--accuracy", "-1"), "not the size of an error"),
    ("3-RPR", ("--accuracy", "nan"), "not the size of an error"),
    ("delta-linear", ("--accuracy", "1", "--rotation", "1"), "does not turn"),
    ("3-RPR", ("--accuracy", "1", "--metric", "0"), "is not a length"),
    ("3-RPR", ("--accuracy", "1", "--yield", "nan"), "is not a share"),
    ("3-RPR", ("--accuracy", "1", "--yield", "1"), "is not a share"),
    ("3-RPR", ("--accuracy", "1", "--poses", "none.csv"), "none.csv"),
    ("delta-linear", ("--accuracy", "1", "--tool", "0,0,-10"), "not known after a calibration"),
])
def test_bad_options_are_refused(name: str, options: tuple[str, ...], words: str,
                                 tmp_path: Path) -> None:
    run_ = ppmcal("tolerances", CONFIGS / f"{name}.yaml", *options, "--out", tmp_path / "o",
                  expect=2)
    assert words in run_.err.replace("\n", " ")
    assert not (tmp_path / "o").exists()


def test_natural_units_are_those_of_the_columns() -> None:
    one = fleet("3-RPR")
    assert column_scale(one.setup.problem).shape == one.setup.linear.sigma.shape
    assert isinstance(one.setup.instrument, Instrument)
