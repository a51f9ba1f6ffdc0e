"""Machines that calibrate themselves: joint values alone, against a truth they were made from."""

import json

import numpy as np
import pytest
import yaml
from helpers.diagnoses import CONFIGS
from helpers.redundant import alone, apart, belts, cables, gapped, rope_cage, stewart, written

import ppmcal
from ppmcal import algebra as cga
from ppmcal.calibration.compensation import ParameterCovariance
from ppmcal.calibration.compensation.kinematics_sigma import PoseRows, forward_sigma
from ppmcal.calibration.fit import by_defining, seen_from_frames
from ppmcal.calibration.fit.problem import white_squares
from ppmcal.commands.inputs import prepared
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, moved
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.registration import Registration

HALF = {"belts": {"x": 900, "y": 700}, "cable-4-planar": {"x": 700, "y": 500, "rz": 8},
        "stewart": {"x": 80, "y": 80, "z": 60, "rx": 10, "ry": 10, "rz": 10},
        "cage": {"x": 800, "y": 600, "z": 500, "rx": 15, "ry": 15, "rz": 15}}
HELD = {"belts": 3, "cable-4-planar": 6, "stewart": 12, "cage": 12}


def fresh(model, count=20, size=1.0):
    """Return poses (count, 8) that no campaign has seen, and the joint values there."""
    mechanism = model.mechanism
    rng = np.random.default_rng(99)
    step = np.zeros((count, 6))
    half = np.where(np.arange(6) < 3, 0.1, 0.1)
    step[:, mechanism.dof] = (size * rng.uniform(-1.0, 1.0, step.shape) * half)[:, mechanism.dof]
    pose = moved(np.tile(mechanism.home, (count, 1)), step)
    return pose, inverse(model, pose).q


def crossed():
    """Return the file of a platform on four cables in the plane that cross, as it is shipped."""
    tree = yaml.safe_load((CONFIGS / "cable-4-planar.yaml").read_text(encoding="utf-8"))
    return {n: v for n, v in tree.items() if n != "limits"}


@pytest.mark.long_cases("crossed", "rope_cage", "stewart")
@pytest.mark.parametrize("tree", [belts, crossed, stewart, rope_cage], ids=lambda t: t.__name__)
@pytest.mark.slow
def test_what_is_found_is_the_truth_in_another_frame(tree, tmp_path):
    """Joints without noise: poses that no row had come out to less than 1e-9 m."""
    file = tree()
    path = written(tmp_path, file)
    made = ppmcal.simulate(path, alone(file, HALF[file["name"]], sigma=1e-9))
    found = ppmcal.identify(path, made.data[0], holdout=0.0)
    count = HELD[file["name"]]
    problem = found.identification.fit.problem
    gauge, = (f for f in problem.mechanism.findings if f.topic == "gauge" and " are held" in f)
    assert gauge.split(" are held")[0].count(",") == count - 1
    assert found.identification.rank == len(problem.columns) == len(problem.free)
    true = Model(made.campaign.with_effects, made.campaign.g)
    pose, q = fresh(true)
    machine = found.identification.mechanism
    ours = forward(Model(machine), q)
    assert ours.converged.all()
    assert apart(machine, ours.pose, pose) < 1e-9


@pytest.mark.long
def test_an_effect_that_follows_the_joints_is_in_the_machine(tmp_path):
    """Without an instrument it follows from the pose, and so settles with it."""
    bent = {"kind": "gain", "on": ["tl"], "parameters": {"gain": 2e-3}}
    scenario = alone(belts(), HALF["belts"], 20, sigma=1e-3, effects=[bent])
    made = ppmcal.simulate(written(tmp_path, belts()), scenario)
    fits = [ppmcal.identify(written(tmp_path, belts() | more, f"{n}.yaml"), made.data[0],
                            holdout=0.0).identification.fit
            for n, more in enumerate(({"effects": [bent]}, {}))]
    told, untold = (white_squares(f.problem, f.state, f.keep)[0] for f in fits)
    values = 20 * 2
    assert told < 3 * values < untold


def test_no_instrument_and_no_surplus_is_refused(tmp_path):
    file = stewart(6)
    path = written(tmp_path, file)
    with pytest.raises(BadInput, match="as many closure equations as freedoms"):
        ppmcal.simulate(path, alone(file, HALF["stewart"]))


def test_the_noise_of_joints_has_to_be_said(tmp_path):
    path = written(tmp_path, belts())
    table = {f"q_{name}": np.full(20, 1800.0) for name in ("bl", "br", "tr", "tl")}
    with pytest.raises(BadInput, match="the noise of the joint values is missing"):
        ppmcal.read_data(path, table, sidecar={"instrument": {"kind": "none", "sigma": {}}})


@pytest.mark.long
def test_a_wrong_reading_is_found_by_its_limb(tmp_path):
    file = belts()
    path = written(tmp_path, file)
    made = ppmcal.simulate(path, alone(file, HALF["belts"], sigma=0.2))
    data = made.data[0]
    q = data.q.copy()
    q[11, 2] += 0.02
    object.__setattr__(data, "q", q)
    found = ppmcal.identify(path, data)
    (row,) = found.identification.gross_errors.rows
    assert row.row == 12 and row.number == "gap_tr"


def in_their_frames(found, g):
    """Return the true values seen from the frames that held parameters define, (P,)."""
    problem, out = found.identification.fit.problem, g.copy()
    held = list(problem.mechanism.defining)
    off = g[held] - found.mechanism.values[held]
    out[held] -= off
    out[list(problem.free)] -= by_defining(problem.mechanism.with_values(
        found.identification.fit.state.g), problem.datasets, problem.free) @ off
    return out


def belts_of(gauge, tolerance=4):
    """Return the file of four belts with small tolerances: frames turn by little."""
    return {**belts(), "tolerances": {"point": tolerance}, "gauge": gauge}


@pytest.mark.slow
@pytest.mark.parametrize("tree", [belts, crossed, stewart], ids=lambda t: t.__name__)
def test_a_coordinate_that_defines_a_frame_moves_what_is_seen_from_there(tree, tmp_path):
    """It alone, or the others as they are seen to: the same poses in frames that are apart."""
    file = tree()
    path = written(tmp_path, file)
    made = ppmcal.simulate(path, alone(file, HALF[file["name"]], 20))
    machine, datasets = prepared(str(path), [made.data[0]])
    held, seen = seen_from_frames(machine, datasets, machine.free)
    assert set(held) == set(machine.defining)
    for p, others in zip(held, seen.T, strict=True):
        own, rest = machine.values.copy(), machine.values.copy()
        own[p] += 1e-6
        rest[list(machine.free)] += 1e-6 * others
        pose, q = fresh(Model(machine, own), count=8)
        there = forward(Model(machine, rest), q).pose
        assert apart(machine, there, pose) < 1e-10


@pytest.mark.long
@pytest.mark.parametrize("gauge", ["base", "tolerances"])
def test_promised_errors_are_the_true_ones_in_the_frame_that_is_defined(gauge, tmp_path):
    """Held points have no error in the frame that they define; tolerances promise the drawing's."""
    file = belts_of(gauge)
    path = written(tmp_path, file)
    promised, true = [], []
    for seed in range(24):
        made = ppmcal.simulate(path, alone(file, HALF["belts"], sigma=0.3, seed=seed))
        found = ppmcal.identify(path, made.data[0], holdout=0.0)
        machine, g = found.identification.mechanism, made.campaign.g
        seen = in_their_frames(found, g) if gauge == "base" else g
        _, q = fresh(Model(made.campaign.with_effects, g), size=6.0)
        ours = forward(Model(machine), q).pose
        away = cga.translation(ours) - cga.translation(
            forward(Model(made.campaign.with_effects, seen), q).pose)
        rows = PoseRows(pose_vector(ours), q, unknown_environment(*q.shape))
        sigma, _ = forward_sigma(Model(machine), Registration(), rows,
                                 ParameterCovariance.of(found.identification))
        promised.append(np.mean(sigma**2))
        true.append(np.mean(np.sum(away**2, axis=1)))
    assert 0.8 < np.sqrt(np.mean(promised) / np.mean(true)) < 1.25


@pytest.mark.long
def test_what_defines_the_frame_is_no_uncertainty_and_stays_so(tmp_path):
    """Not of the machine that was calibrated, nor where its file is calibrated again."""
    file = belts_of("base", 20)
    path = written(tmp_path, file)
    made = ppmcal.simulate(path, alone(file, HALF["belts"], sigma=0.3))
    first = ppmcal.identify(path, made.data[0])
    first.save(tmp_path / "first")
    again = ppmcal.identify(tmp_path / "first" / "identified.yaml", made.data[0])
    for found in (first, again):
        considered = found.identification.considered
        machine = found.identification.fit.problem.mechanism
        names = [machine.names[p] for p in machine.defining]
        assert len(names) == 3 and not set(names) & set(considered.names)
    assert not first.mechanism.registrations and first.mechanism.self_calibrated


@pytest.mark.long
def test_blocks_of_rows_differ_in_units_of_their_own_noise(tmp_path):
    """A gap that is smooth over the workspace: intervals are those of a cluster-robust sandwich."""
    file = belts()
    path = written(tmp_path, file)
    made = ppmcal.simulate(path, alone(file, HALF["belts"], count=200, sigma=0.2))
    data = made.data[0]
    q = data.q.copy()
    q[:, 0] += 2e-3 * np.sin(4.0 * q[:, 0]) * np.cos(3.0 * q[:, 1])
    object.__setattr__(data, "q", q)
    found = ppmcal.identify(path, data).identification
    sigma = np.sqrt(np.diagonal(found.covariance))
    noise = np.array([e.half_by_noise for e in found.estimates if e.status == "identified"])
    half = np.array([e.half for e in found.estimates if e.status == "identified"])
    assert found.blocks is not None and not found.blocks.sessions
    # all by one factor, which is that of the gaps and no ratio of tolerances
    assert np.ptp(half / noise) < 0.1 * np.median(half / noise)
    assert 1.2 < np.median(half / noise) < 12.0 and np.all(sigma * 1.9 < half * 1.6)


def pulled(file, strain, seed):
    """Return a scenario of belts of which the lower ones pull."""
    return {**alone(file, HALF["belts"], sigma=0.3, seed=seed), "errors": {}, "effects": [
        {"kind": "rope_stretch", "on": ["bl", "br"], "parameters": {"strain": strain}}]}


@pytest.fixture(scope="module")
def before_the_change(tmp_path_factory):
    """Return a folder with the file of belts, and what was identified where they pull little."""
    folder = tmp_path_factory.mktemp("pulled")
    path = written(folder, belts())
    made = ppmcal.simulate(path, pulled(belts(), 0.001, 11))
    ppmcal.identify(path, made.data[0], holdout=0.0).save(folder / "old")
    return folder


@pytest.mark.parametrize("strain", [0.001, 0.003])
@pytest.mark.long
def test_a_changed_pull_of_ropes_is_what_compare_names(strain, before_the_change, tmp_path):
    path = before_the_change / "m.yaml"
    made = ppmcal.simulate(path, pulled(belts(), strain, 12))
    ppmcal.identify(path, made.data[0], holdout=0.0).save(tmp_path / "new")
    found = ppmcal.compare(before_the_change / "old", tmp_path / "new").comparison
    if strain == 0.001:
        assert not found.changed
        return
    (change,) = found.changes
    assert change.name == "stretch of ropes on bl, br"
    assert abs(change.parts[0].value - 0.002) < 4.0 * change.parts[0].sigma


@pytest.mark.parametrize(("anchor", "moved"), [
    ("tr.base.point.x", 0.0), ("tr.base.point.x", 4.0), ("bl.base.point.y", 4.0)])
@pytest.mark.long
def test_compare_of_machines_whose_limbs_gap_names_the_anchor_that_moved(anchor, moved, tmp_path):
    """Each has the frame that its own gauge defines; where nothing moved, nothing is named."""
    file = gapped(belts())
    path = written(tmp_path, file)
    for seed in (3, 4):
        errors = {"tl.base.point.x": 12, anchor: moved * (seed == 4)}
        made = ppmcal.simulate(path, alone(file, HALF["belts"], 40, 0.1, seed=seed, errors=errors))
        ppmcal.identify(path, made.data[0], holdout=0.0).save(tmp_path / str(seed))
    found = ppmcal.compare(tmp_path / "3", tmp_path / "4").comparison
    assert [c.name for c in found.changes] == [anchor] * bool(moved)
    for change in found.changes:
        assert abs(change.parts[0].value - 1e-3 * moved) < 4.0 * change.parts[0].sigma < 2e-3
    file = tmp_path / "4" / "identification.json"
    tree = json.loads(file.read_text())
    frame = tree["covariance"]["defining"]
    assert frame["names"] == ["bl.base.point.x", "bl.base.point.y", "br.base.point.y"]
    for broken in ({"names": ["tr.base.point.x", *frame["names"][1:]]}, {"unit": [1.0]},
                   {"seen": frame["seen"][:2]}, {"unit": [0.0, 1.0, 1.0]}):
        tree["covariance"]["defining"] = frame | broken
        file.write_text(json.dumps(tree))
        with pytest.raises(BadInput, match=r"is not an identification\.json of this version"):
            ppmcal.compare(tmp_path / "3", tmp_path / "4")


@pytest.mark.long
def test_other_runs_are_validated_by_how_far_limbs_are_from_closing(tmp_path):
    file = belts()
    path = written(tmp_path, file)
    one, other = (ppmcal.simulate(path, alone(file, HALF["belts"], sigma=0.3, seed=seed,
                                              errors={"tr.base.point.x": 12})).data[0]
                  for seed in (3, 4))
    model = ppmcal.identify(path, one)
    told = ppmcal.validate(model, other)
    (data,) = told.record.datasets
    first, nominal = data.errors
    assert first.position is None and first.closure.unit == "mm"
    # two of four equations are left to the noise: gaps are that much smaller
    assert 0.15 < first.closure.rms < 0.28 and 0.85 < first.noise < 1.2
    assert set(first.limbs) == {"bl", "br", "tr", "tl"}
    assert nominal.model == "nominal" and nominal.verdict == "worse"
    text = " ".join(str(t) for t in told.told())
    assert "joint values alone" in text and "fitted: nothing" not in text
    header = told.files()["validation.csv"].splitlines()[0]
    assert "closure_rms" in header and told.record.column_units["closure_rms"] == "mm"


@pytest.mark.slow
def test_before_is_told_without_an_instrument_that_is_not_there(tmp_path):
    file = belts()
    path = written(tmp_path, file)
    made = ppmcal.simulate(path, alone(file, HALF["belts"], sigma=0.3))
    found = ppmcal.identify(path, made.data[0])
    text = " ".join(str(t) for t in found.told())
    assert "errors are how far limbs are from closing" in text and "frame and target" not in text


@pytest.mark.long_cases("cage")
@pytest.mark.parametrize(("tree", "exchanged"), [
    (belts, "bl with br, tr with tl"), (cables, "c0 with c3, c1 with c2"),
    (rope_cage, "r1 with r2, r3 with r4, r5 with r6, r7 with r8"), (stewart, None)],
    ids=["belts", "cables", "cage", "stewart"])
@pytest.mark.slow_cases("cables")
def test_the_mirror_image_is_told_where_it_fits_as_well(tree, exchanged, tmp_path):
    file = tree()
    path = written(tmp_path, file)
    half = {**HALF, "cables": {"x": 700, "y": 500, "rz": 8}}[file["name"]]
    made = ppmcal.simulate(path, alone(file, half, count=30, sigma=1e-3))
    findings = [f for f in prepared(path, made.data[0], ())[0].findings if "mirror image" in f]
    assert len(findings) == (exchanged is not None)
    for said in findings:
        assert said.topic == "gauge" and said.level == "note"
        assert f"exchanging {exchanged} fits as well" in said
