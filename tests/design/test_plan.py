"""``ppmcal plan``: exchange against brute force, accuracy against a fit, files that can be used."""

import itertools
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows, write_csv
from helpers.paths import ROOT
from scipy.optimize import minimize

from ppmcal.design.plan import information as accuracy
from ppmcal.design.plan.candidate_poses import NEAR_SINGULAR, draw, evenly, listed, region_of
from ppmcal.design.plan.clearance import leg_distances, segment_distance, too_close
from ppmcal.design.plan.d_optimal import Design, Rules, exchange, greedy, log_det
from ppmcal.design.plan.information import offer, task_rows
from ppmcal.design.plan.path import by_way_of_home, lengths, moves, route, two_opt
from ppmcal.design.plan.plan import PlanOptions, plan
from ppmcal.design.plan.refine import PRICE, refined
from ppmcal.design.plan.settings import SETTABLE, PlanSettings, needs, offered, refuse, with_kinds
from ppmcal.design.virtual_instrument import default_instrument
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import read_mechanism
from ppmcal.io.results.plan import accuracy_table, pose_table
from ppmcal.io.results.record import in_units
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.tables import forward_table, inverse_table
from ppmcal.model.effects import effect_kinds
from ppmcal.units import Units

CONFIGS = ROOT / "configs"
MACHINES = ("3-RPR", "3-RPS", "delta-linear", "6-UPS")
ONCE = Rules(False, 1)


@cache
def machine(name):
    return read_mechanism(CONFIGS / f"{name}.yaml")


@cache
def pool(name, count=60, seed=3):
    drawn = machine(name).nominal()
    return draw(drawn, region_of(drawn), count, seed)


@cache
def possible(name, count=60, seed=3):
    found = pool(name, count, seed)
    mechanism = machine(name)
    return offer(mechanism.nominal(), default_instrument(mechanism), found,
                 np.arange(len(found)), {})


def aims(name, whole):
    mechanism = machine(name)
    drawn = mechanism.nominal()
    return task_rows(whole, default_instrument(mechanism), evenly(drawn, region_of(drawn), 20, 9),
                     {})


def planned_from(name, count, mechanism=None):
    """Return a plan that chooses among given poses, and is judged at them."""
    mechanism = mechanism or machine(name)
    given = (pool(name).pose, "given")
    return plan(mechanism, default_instrument(mechanism), PlanOptions(count), given, given)


def part(whole, keep):
    keep = np.asarray(keep)
    return replace(whole, pose=whole.pose[keep], jacobian=whole.jacobian[keep])


# --- the choice -----------------------------------------------------------------------------------

@pytest.mark.slow
@pytest.mark.parametrize("name, count", [("3-RPR", 5), ("3-RPS", 4), ("delta-linear", 6)])
def test_exchange_finds_the_best_of_all_subsets(name, count):
    whole = part(possible(name), np.arange(0, 60, 6))
    values = {s: log_det(whole, s) for s in itertools.combinations(range(len(whole)), count)}
    best = max(values.values())
    ends = [exchange(whole, start, ONCE, np.random.default_rng(seed)) for seed, start in
            enumerate([greedy(whole, count, ONCE), range(count), range(4, 4 + count)])]
    assert max(log_det(whole, rows) for rows in ends) == pytest.approx(best, abs=1e-8)
    assert np.ptp(list(values.values())) > 1.0  # there is something to choose
    for rows_ in ends:
        assert len(set(rows_)) == count


def fedorov(whole, start):
    """Swap the best pair of a chosen and a free row until none helps (Fedorov 1972)."""
    chosen, value = list(start), log_det(whole, start)
    while True:
        tried = [(log_det(whole, [*chosen[:i], new, *chosen[i + 1:]]), i, new)
                 for i in range(len(chosen)) for new in range(len(whole)) if new not in chosen]
        best, i, new = max(tried)
        if best <= value + 1e-9:
            return chosen
        chosen[i], value = new, best


@pytest.mark.parametrize("name", ["3-RPR", "6-UPS"])
@pytest.mark.slow
def test_exchange_against_fedorov_and_greedy(name):
    whole = part(possible(name), np.arange(0, 60, 2))
    start = greedy(whole, 7, ONCE)
    swapped = log_det(whole, fedorov(whole, start))
    ends = [exchange(whole, start, ONCE, np.random.default_rng(5)) for _ in range(2)]
    assert ends[0] == ends[1]
    assert log_det(whole, ends[0]) >= log_det(whole, start) - 1e-9
    assert log_det(whole, ends[0]) >= swapped - 0.05
    random = np.random.default_rng(1).permutation(len(whole))[:7]
    assert log_det(whole, exchange(whole, random, ONCE, np.random.default_rng(2))) > log_det(
        whole, random)


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_updates_of_rank_m_are_what_they_replace(name):
    whole, count = possible(name), 30
    design = Design.of(whole, range(count))
    for row in (40, 41, 42):
        design = design.added(row)
    design = design.removed(3).removed(41)
    assert design.age > 0  # not from scratch
    gains, losses = design.gains(), design.losses()
    value = log_det(whole, design.rows)
    for row in (50, 55, 59):
        assert gains[row] == pytest.approx(log_det(whole, [*design.rows, row]) - value, rel=1e-5)
    for i in (0, 5, 20):
        rest = [*design.rows[:i], *design.rows[i + 1:]]
        assert losses[i] == pytest.approx(value - log_det(whole, rest), rel=1e-5)
    aim = aims(name, whole)[0]
    before = accuracy.spreads(whole.information(np.array(design.rows))[None], (aim, aim))[0][0]
    after = accuracy.spreads(whole.information(np.array([*design.rows, 50]))[None],
                             (aim, aim))[0][0]
    assert design.cuts(aim)[50] == pytest.approx(before**2 - after**2, rel=1e-4)


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.slow_cases("delta-linear", "3-RPS")
def test_excursions_and_repeats(name):
    whole = part(possible(name), np.arange(6))
    rules = Rules(False, None)
    order = greedy(whole, 15, rules)
    counts = np.bincount(order, minlength=6)
    assert sorted(order[:6]) == list(range(6))  # no pose twice before each was taken once
    assert counts.min() == 2 and counts.max() == 3
    assert set(exchange(whole, order[:6], rules.sized(whole, 6), np.random.default_rng(0))) == set(
        range(6))


def test_frames_count_only_where_they_imitate_geometry():
    whole = possible("3-RPR")
    known = replace(whole, nuisance=np.zeros_like(whole.nuisance))
    assert whole.nuisance.sum() == 3
    chosen = list(range(20))
    full = whole.information(np.array(chosen))
    full += np.diag(np.where(whole.prior > 0.0, 0.0, 1e-6))
    open_ = whole.nuisance
    schur = full[~open_][:, ~open_] - full[~open_][:, open_] @ np.linalg.solve(
        full[open_][:, open_], full[open_][:, ~open_])
    assert log_det(whole, chosen) == pytest.approx(np.linalg.slogdet(schur)[1], rel=1e-9)
    assert log_det(known, chosen) > log_det(whole, chosen)


# --- candidates -----------------------------------------------------------------------------------

@pytest.mark.slow
@pytest.mark.parametrize("name", [*MACHINES, "3-RRR-1"])
def test_candidates_can_be_measured(name):
    found, mechanism = pool(name), machine(name)
    drawn = mechanism.nominal()
    assert len(found) > 50 and 0.2 < 1.0 - found.even.mean() < 0.5
    table = inverse_table(Model(drawn), found.pose)
    assert set(table.status) == {"ok"}
    assert found.singular_value.min() >= NEAR_SINGULAR
    assert not too_close(Model(drawn), found.q, found.pose).any()
    back = forward_table(Model(drawn), found.q)
    np.testing.assert_allclose(back.pose, found.pose, atol=1e-8)
    limits = np.isfinite(mechanism.limits)
    inside = (found.q >= mechanism.limits[:, 0]) & (found.q <= mechanism.limits[:, 1])
    assert inside[:, limits.all(axis=1)].all()


@pytest.mark.parametrize("name", ["3-RPR", "6-UPS"])
@pytest.mark.slow_cases("6-UPS")
def test_poses_on_the_edge_can_go_no_farther(name):
    drawn, found = machine(name).nominal(), pool(name)
    region = region_of(drawn)
    own = list(region.coordinates)
    farther = found.pose.copy()
    farther[:, own] += 0.05 * (found.pose[:, own] - region.home)
    table = inverse_table(Model(drawn), farther)
    good = np.array([s == "ok" for s in table.status])
    good &= ((farther[:, own] >= region.low) & (farther[:, own] <= region.high)).all(axis=1)
    smallest = table.singular_value
    good &= smallest >= NEAR_SINGULAR * smallest[0] / found.singular_value[0] * 0.99
    assert good[found.even].mean() > 0.5 and good[~found.even].mean() < 0.2


@pytest.mark.slow
def test_distance_of_segments_by_another_way():
    rng = np.random.default_rng(4)
    a = rng.normal(size=(4, 30, 3))
    a[1, 0] = a[0, 0] + 2.0 * (a[3, 0] - a[2, 0])  # parallel
    a[1, 1] = a[0, 1]  # a point
    a[2, 2], a[3, 2] = a[0, 2] - 1.0, a[0, 2] + 1.0  # crossing
    found = segment_distance(*a)
    assert found[2] == pytest.approx(0.0, abs=1e-12)
    for n in range(30):
        def apart(x, n=n):
            return float(np.linalg.norm(a[0, n] + x[0] * (a[1, n] - a[0, n])
                                        - a[2, n] - x[1] * (a[3, n] - a[2, n])))
        best = min(minimize(apart, s, bounds=[(0, 1)] * 2).fun
                   for s in itertools.product((0.1, 0.9), repeat=2))
        assert found[n] == pytest.approx(best, abs=2e-4)


def test_legs_that_cross_are_left_out():
    drawn = machine("6-UPS").nominal()
    pose = np.tile(drawn.home_pose, (3, 1))
    pose[:, 5] += np.radians([0.0, 120.0, 140.0])
    table = inverse_table(Model(drawn), pose)
    near = leg_distances(Model(drawn), table.q, pose_motor(table.pose)).min(axis=1)
    assert near[0] > near[1] > 0.02 * drawn.reach and near[2] < 1e-9  # turned so far that two meet
    assert list(too_close(Model(drawn), table.q, table.pose)) == [False, False, True]
    planar = machine("3-RPR").nominal()
    q = home_state(planar).q[None]
    assert not too_close(Model(planar), q, planar.home_pose[None]).any()


# --- accuracy -------------------------------------------------------------------------------------

def test_accuracy_of_designs_by_another_way():
    name = "3-RPR"
    whole = possible(name)
    g = aims(name, whole)
    found = accuracy.curve(whole, range(20), g)
    cov = np.linalg.inv(whole.information(np.arange(12)))
    assert found.position[11] == pytest.approx(np.sqrt(np.trace(g[0] @ cov)), rel=1e-6)
    assert found.rotation[11] == pytest.approx(np.sqrt(np.trace(g[1] @ cov)), rel=1e-6)
    assert (np.diff(found.position) < 1e-12).all()


def test_what_no_candidate_sees_stays():
    name = "3-RPR"
    whole = part(possible(name), [0, 1])
    g = aims(name, whole)
    left = accuracy.limit(whole, g)
    many = np.diag(whole.prior**2) + 1e7 * (whole.information(np.arange(2))
                                             - np.diag(whole.prior**2))
    assert left[0] > 1e-5
    assert left[0] == pytest.approx(accuracy.spreads(many[None], g)[0][0], rel=1e-3)
    assert accuracy.limit(possible(name), g)[0] < 1e-9
    wanted = 1.0001 * left[0]
    n = accuracy.extrapolated(whole, [0, 1], g, wanted)
    data = whole.information(np.arange(2)) - np.diag(whole.prior**2)
    at = [np.diag(whole.prior**2) + k / 2 * data for k in (0.9 * n, 1.1 * n)]
    errors = accuracy.spreads(np.array(at), g)[0]
    assert errors[0] > wanted > errors[1]
    assert accuracy.extrapolated(whole, [0, 1], g, 0.9 * left[0]) is None


def test_where_it_no_longer_pays():
    n = np.arange(1.0, 151.0)
    assert accuracy.still_pays(1.0 / np.sqrt(n)) == pytest.approx(50, abs=4)
    assert accuracy.still_pays(1.0 / np.sqrt(n[:30])) == 0
    errors = np.where(n < 10, np.inf, 1.0 / np.sqrt(n))
    assert accuracy.still_pays(errors) == pytest.approx(50, abs=4)
    assert accuracy.reaching(errors, 0.2) == 25
    assert accuracy.reaching(errors, 0.01) is None


@pytest.mark.slow
def test_refining_raises_information_and_keeps_its_price():
    name = "3-RPR"
    mechanism = machine(name)
    drawn, whole = mechanism.nominal(), possible(name)
    start = greedy(whole, 8, ONCE)
    g = aims(name, whole)
    found, richer, _, chosen = refined(
        drawn, region_of(drawn), default_instrument(mechanism), whole, pool(name), {}, start,
        g[0], np.random.default_rng(0))
    count = int((~whole.nuisance).sum())
    assert log_det(richer, chosen) > log_det(whole, start) + np.log(1.0 - PRICE) * count
    before, after = (accuracy.spreads(w.information(np.array(r))[None], g)[0][0]
                     for w, r in ((whole, start), (richer, chosen)))
    assert after < before
    assert set(inverse_table(Model(drawn), found.pose[-8:]).status) == {"ok"}


# --- settings -------------------------------------------------------------------------------------

def settings_of(kinds, payload=None, temperature=None, name="3-RPR", count=20):
    mechanism = machine(name)
    asked = PlanSettings(kinds, payload, temperature)
    return plan(mechanism, default_instrument(mechanism), PlanOptions(count, 1, asked, 40))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["3-RPR", "delta-linear"])
def test_backlash_and_compliance_need_both_ends(name):
    found = settings_of(("backlash", "compliance"), (0.0, 20.0), name=name)
    for actuator in machine(name).actuators:
        ways = found.columns[f"dir_{actuator}"]
        assert min((ways > 0).sum(), (ways < 0).sum()) >= 4
    payload = found.columns["payload"]
    assert min((payload == 0.0).sum(), (payload == 20.0).sum()) >= 4
    assert np.count_nonzero(np.diff(payload)) == 1  # loaded once
    names = found.offer.names
    assert {f"{k}.{a}.{p}" for a in machine(name).actuators for k, p in (
        ("backlash", "width"), ("compliance", "stiffness"))} <= set(names)
    # without the other end nothing is known of the compliance
    whole = found.offer
    c = names.index(f"compliance.{machine(name).actuators[0]}.stiffness")
    held = np.linalg.inv(whole.information(found.rows) + 1e-12 * np.eye(len(names)))[c, c]
    light = found.rows[payload == 0.0]
    bare = np.linalg.inv(whole.information(light) + 1e-12 * np.eye(len(names)))[c, c]
    assert bare > 1e3 * held


@pytest.mark.slow
def test_temperature_and_speed_at_both_ends():
    found = settings_of(("leg_thermal", "lag"), temperature=(291.15, 299.15))
    warm = found.columns["temperature"]
    assert set(np.round(warm, 6)) == {291.15, 299.15}
    assert np.count_nonzero(np.diff(warm)) == 1
    speed = np.abs(found.columns["vel_leg1"])
    assert len(np.unique(np.round(speed / speed.max(), 6))) >= 1
    assert (np.sign(found.columns["vel_leg1"]) == found.columns["dir_leg1"]).all()
    assert {-1.0, 1.0} == set(found.columns["dir_leg1"])


@pytest.mark.slow
def test_every_kind_is_planned_or_refused_with_a_reason():
    done = set()
    for name in ("3-RPR", "delta-rotary"):
        mechanism = machine(name)
        at = pool(name, 20)
        q = at.q
        for kind in effect_kinds():
            asked = PlanSettings((kind,), (1.0, 20.0), (291.15, 299.15))
            try:
                refuse(mechanism, asked)
            except BadInput as error:
                assert error.hint
                continue
            done.add(kind)
            with_effects = with_kinds(mechanism, asked, q)
            assert set(effect_kinds()[kind].needs) <= set(SETTABLE)
            assert {e.kind.name for e in with_effects.effects} == {kind}
            pose, columns = offered(with_effects, asked, q, at.pose, 0)
            assert bool(columns) == bool(needs(asked, with_effects))
            whole = offer(with_effects, default_instrument(mechanism), pool(name, 20), pose,
                          columns)
            assert any(n.startswith(kind) for n in whole.names)
    assert {"backlash", "compliance", "windup", "lag", "leg_thermal", "gain"} <= done
    assert not done & {"drift", "periodic", "tilt"}


def test_effects_of_the_file_keep_their_priors(tmp_path):
    text = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text())
    text["effects"] = [{"kind": "backlash", "parameters": {
        "width": {"value": 0.02, "tolerance": 0.01}}}, {"kind": "gain", "parameters": {
            "gain": {"value": 1e-4, "free": True}}}]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(text))
    mechanism = read_mechanism(tmp_path / "m.yaml")
    with_effects = with_kinds(mechanism, PlanSettings(("backlash",)), pool("3-RPR", 20).q)
    assert [e.kind.name for e in with_effects.effects] == ["backlash"]
    free = [with_effects.names[p] for p in with_effects.free]
    assert "backlash.width" in free and not any("gain" in n for n in free)


# --- the way --------------------------------------------------------------------------------------

def test_two_opt_against_all_orders():
    rng = np.random.default_rng(8)
    for _ in range(5):
        q, home, unit = rng.uniform(size=(7, 3)), rng.uniform(size=3), np.ones(3)
        apart, start = lengths(q, q, unit), lengths(home[None], q, unit)[0]

        def long(path, apart=apart, start=start):
            return start[path[0]] + sum(apart[a, b] for a, b in itertools.pairwise(path))

        path = two_opt(apart, start)
        assert sorted(path) == list(range(7))
        best = min(map(long, itertools.permutations(range(7))))
        nearest = [int(np.argmin(start))]
        while len(nearest) < 7:
            left = [i for i in range(7) if i not in nearest]
            nearest.append(min(left, key=lambda i, n=nearest: apart[n[-1], i]))
        assert best - 1e-12 <= long(path) <= long(nearest) + 1e-12
        assert long(path) < 1.25 * best
    line = np.linspace(0.0, 1.0, 9)[rng.permutation(9)][:, None]
    on_line = two_opt(lengths(line, line, np.ones(1)), line[:, 0])
    np.testing.assert_allclose(line[on_line, 0], np.linspace(0.0, 1.0, 9))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mixed-planar", "3-RPR"])
def test_moves_across_singularities_are_seen(name):
    drawn = machine(name).nominal()
    rng = np.random.default_rng(2)
    q = rng.uniform(drawn.limits[:, 0], drawn.limits[:, 1], (12, len(drawn.actuators)))
    table = forward_table(Model(drawn), q)
    ok = np.array([s == "ok" for s in table.status])
    crossed = np.array([s in ("crossed", "jump") and "row before" in r
                        for s, r in zip(table.status, table.reason, strict=True)])
    found = np.array(moves(drawn, q[:-1], q[1:]), dtype=object)
    assert all(found[n - 1] for n in np.flatnonzero(crossed) if n)
    same = np.flatnonzero(ok)
    assert moves(drawn, q[same], q[same]) == ("",) * same.size


@pytest.mark.slow
def test_route_is_short_and_keeps_blocks_together():
    found, drawn = pool("6-UPS"), machine("6-UPS").nominal()
    q = found.q[np.random.default_rng(0).permutation(len(found))[:20]]
    span = np.ptp(found.q, axis=0)
    free = route(drawn, q, span, np.zeros(20, dtype=int))
    blocks = np.arange(20) % 2
    split = route(drawn, q, span, blocks)
    assert sorted(free.order) == sorted(split.order) == list(range(20))
    assert free.after < 0.8 * free.before
    assert free.after <= split.after + 1e-9
    assert list(blocks[split.order]) == [0] * 10 + [1] * 10
    home = home_state(drawn).q
    travel = np.max(np.abs(np.diff(np.vstack([home, q[free.order]]), axis=0)) / span, axis=1)
    assert free.after == pytest.approx(travel.sum())
    assert free.via == by_way_of_home(drawn, q[free.order])


# --- the command ----------------------------------------------------------------------------------

@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Return a folder with a plan of 12 poses for the 3-RPR, and the run."""
    folder = tmp_path_factory.mktemp("plan")
    run = ppmcal("plan", CONFIGS / "3-RPR.yaml", "--count", 10, "--accuracy", 0.02, "--seed", 4,
                 "--out", folder / "plan", expect=0)
    return folder, run


@pytest.mark.slow
def test_what_is_written(planned):
    folder, run = planned
    out = folder / "plan"
    table = rows(out / "poses.csv")
    assert len(table) == 10 and max(len(line) for line in run.out.splitlines()) <= 80
    assert "Measure 10 poses" in run.out and "accuracy.png" in run.out
    record = json.loads((out / "plan.json").read_text())
    assert record["format"] == "ppmcal/plan/1" and record["count"] == 10
    assert record["findings"] == [] and record["provenance"]["seed"] == 4
    assert record["units"]["x"] == "mm" and record["units"]["sigma_rotation"] == "deg"
    assert set(record["observability"]) == {"planned", "random"}
    assert record["observability"]["planned"]["O1"] > record["observability"]["random"]["O1"]
    assert record["efficiency"] > 1.5
    assert (out / "accuracy.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert set(record["pictures"]) == {"accuracy.png"}
    curve = rows(out / "accuracy.csv")
    sigma = [float(r["sigma_position"]) for r in curve]
    assert [int(r["n"]) for r in curve] == list(range(int(curve[0]["n"]), 21))
    assert all(b <= a for a, b in itertools.pairwise(sigma))
    at = next(r for r in curve if r["n"] == "10")
    assert float(at["sigma_position_exchanged"]) < float(at["sigma_position_random"])
    first = min(int(r["n"]) for r in curve if float(r["sigma_position"]) <= 0.02)
    assert record["reaches_accuracy"] == first
    assert f"{first} measurements reach 0.02 mm" in " ".join(run.out.split())


@pytest.mark.slow
def test_the_same_seed_gives_the_same_plan(planned, tmp_path):
    folder, _ = planned
    run = ppmcal("plan", CONFIGS / "3-RPR.yaml", "--count", 10, "--accuracy", 0.02, "--seed", 4,
                 "--out", tmp_path / "plan", "--json", expect=0)
    assert (tmp_path / "plan" / "poses.csv").read_bytes() == (
        folder / "plan" / "poses.csv").read_bytes()
    assert run.json["format"] == "ppmcal/plan/1"


@pytest.mark.slow
def test_a_plan_can_be_measured_and_keeps_its_promise(planned):
    """The fit's own covariance is what the plan foresaw."""
    folder, _ = planned
    (folder / "s.yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"file": "plan/poses.csv"}, "errors": {"random": {"scale": 0.1}},
        "instrument": {"kind": "pose", "sigma": {"position": 0.03, "rotation": 0.006875493541}},
        "frame": {"x": 10, "y": 5, "rz": 3}, "approach": "one", "seed": 2}))
    ppmcal("simulate", CONFIGS / "3-RPR.yaml", "s.yaml", "--out", "sim", cwd=folder, expect=0)
    assert len(rows(folder / "sim" / "measurements.csv")) == 10
    ppmcal("identify", CONFIGS / "3-RPR.yaml", "sim/measurements.csv", "--holdout", 0, "--out",
           "fit", "--keep-outliers", cwd=folder)
    mechanism = machine("3-RPR")
    poses = np.array([[float(r[c]) for c in ("x", "y", "rz")]
                      for r in rows(folder / "plan" / "poses.csv")])
    full = np.zeros((10, 6))
    full[:, [0, 1, 5]] = poses * [1e-3, 1e-3, np.pi / 180.0]
    whole = offer(mechanism.nominal(), default_instrument(mechanism),
                  listed(mechanism.nominal(), full, "poses"), np.arange(10), {})
    sigma = dict(zip(whole.names, np.sqrt(np.diag(np.linalg.inv(
        whole.information(np.arange(10))))) * whole.scale, strict=True))
    found = {r["name"]: float(r["sigma"]) for r in rows(folder / "fit" / "parameters.csv")
             if r["sigma"]}
    factor = {p.name: mechanism.units.factor(p.quantity) for p in mechanism.parameters}
    shared = [n for n in sigma if n in found]
    assert len(shared) == len(mechanism.free)
    for name in shared:
        assert found[name] * factor[name] == pytest.approx(sigma[name], rel=0.05), name


@pytest.mark.slow
def test_files_are_in_the_machines_units():
    found = planned_from("3-RPR", 4)
    other = replace(found, mechanism=replace(found.mechanism, units=Units("in", "rad")))
    a, b = pose_table(found), pose_table(other)
    np.testing.assert_allclose(a["x"] / 25.4, b["x"], rtol=1e-12)
    np.testing.assert_allclose(np.radians(a["rz"]), b["rz"], rtol=1e-12)
    np.testing.assert_allclose(a["travel"], b["travel"])
    a, b = (in_units(accuracy_table(p), p.mechanism.units) for p in (found, other))
    np.testing.assert_allclose(a["sigma_position"] / 25.4, b["sigma_position"], rtol=1e-12)
    assert found.gain.min() > 0.0 and len(set(found.offer.pose[found.rows])) == 4


@pytest.mark.slow
def test_machines_with_fewer_drives_and_touches_of_a_flat(tmp_path):
    names = ("x", "y", "z")
    bed = [{"x": x, "y": y, "z": 5} for x in range(-90, 91, 30) for y in range(-90, 91, 30)]
    write_csv(tmp_path / "bed.csv", bed)
    (tmp_path / "probe.yaml").write_text(
        "format: ppmcal/dataset/1\nunits: {length: mm, angle: deg}\nframe: unknown\n"
        "target: known\ninstrument: {kind: plane, sigma: {height: 0.01}}\n")
    run = ppmcal("plan", CONFIGS / "delta-linear.yaml", "--instrument", "probe.yaml",
                 "--candidates", "bed.csv", "--count", 9, cwd=tmp_path)
    chosen = rows(tmp_path / "plan" / "poses.csv")
    given = {tuple(float(r[c]) for c in names) for r in bed}
    picked = {tuple(round(float(r[c]), 6) for c in names) for r in chosen}
    assert len(picked) == 9 and picked <= given
    assert run.code == int(bool(json.loads((tmp_path / "plan" / "plan.json").read_text())[
        "findings"]))
    found = planned_from("3-RPS", 5)
    poses = found.pool.pose[found.offer.pose[found.rows]]
    assert set(inverse_table(Model(machine("3-RPS").nominal()), poses).status) == {"ok"}


@pytest.mark.slow
def test_flat_priors_leave_out_what_cannot_be_told(tmp_path):
    text = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text())
    text["tolerances"] = dict.fromkeys(("point", "length", "angle", "offset"), float("inf"))
    text.pop("limits")
    (tmp_path / "flat.yaml").write_text(yaml.safe_dump(text))
    mechanism = read_mechanism(tmp_path / "flat.yaml")
    found = planned_from("3-RPR", 8, mechanism)
    assert len(found.offer.dropped) == 3  # theory: a frame's worth in the plane
    assert found.open_ended == mechanism.actuators
    with pytest.raises(BadInput, match="at least 4"):
        planned_from("3-RPR", 2, mechanism)


@pytest.mark.parametrize("arguments, words", [
    (("--for", "drift"), "depends on time"),
    (("--for", "backlsh"), "Did you mean 'backlash'"),
    (("--for", "compliance"), "--payload"),
    (("--for", "leg_thermal"), "--temperature"),
    (("--for", "clearance", "--payload", "0,5"), "two payloads above 0"),
    (("--for", "eccentricity"), "this machine has none"),
    (("--payload", "5"), "two numbers"),
    (("--payload", "20,0"), "lower to a higher"),
    (("--temperature", "warm,cold"), "not a number"),
    (("--instrument", "nowhere.yaml"), "no such file"),
    (("--candidates", "far.csv"), "none of the 2 poses can be used"),
    (("--tasks", "far.csv"), "none of the 2 poses can be used"),
    (("--instrument", "flat.yaml"), "cannot touch a flat"),
    (("--instrument", "distance.yaml"), "where the fixed point is"),
    (("--count", "1"), "2<=x<=1000"),
])
@pytest.mark.slow_cases("arguments11-none of the 2 poses can be used")
def test_refusals(arguments, words, tmp_path):
    head = "format: ppmcal/dataset/1\nunits: {length: mm, angle: deg}\nframe: unknown\n"
    (tmp_path / "flat.yaml").write_text(
        f"{head}target: known\ninstrument: {{kind: plane, sigma: {{height: 0.01}}}}\n")
    (tmp_path / "distance.yaml").write_text(
        f"{head}target: known\ninstrument: {{kind: distance, point: unknown, sigma: "
        "{distance: 0.01}}\n")
    (tmp_path / "far.csv").write_text("x,y,rz\n9000,0,0\n0,9000,0\n")
    run = ppmcal("plan", CONFIGS / "3-RPR.yaml", *arguments, cwd=tmp_path, expect=2)
    assert words in " ".join(run.err.split()) and "Traceback" not in run.err
    assert not (tmp_path / "plan").exists()


@pytest.mark.slow
def test_candidates_that_cannot_do_it_are_findings(tmp_path):
    write_csv(tmp_path / "few.csv", [{"x": 500, "y": 260, "rz": 25}, {"x": 520, "y": 280, "rz": 20},
                                     {"x": 9000, "y": 0, "rz": 0}])
    run = ppmcal("plan", CONFIGS / "3-RPR.yaml", "--candidates", "few.csv", "--count", 6,
                 "--accuracy", 0.001, cwd=tmp_path, expect=1)
    text = " ".join(run.out.split())
    assert "1 of the 3 candidates given cannot be used" in text
    assert "cannot be reached: ever more poses leave" in text


def test_a_singular_home_is_refused(tmp_path):
    text = yaml.safe_load((CONFIGS / "6-UPS.yaml").read_text())
    for i, limb in enumerate(text["limbs"]):
        limb["base"] = {"point": {"radius": 1000, "angle": 60 * i, "z": 0}}
        limb["platform"] = {"point": {"radius": 500, "angle": 60 * i, "z": 0}}
    text["home"] = {"pose": dict.fromkeys(("x", "y", "rx", "ry", "rz"), 0) | {"z": 1500}}
    text.pop("limits")
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(text))
    mechanism = read_mechanism(tmp_path / "m.yaml")
    with pytest.raises(NoResult, match="singularity at home"):
        plan(mechanism, default_instrument(mechanism))


@pytest.mark.long
def test_a_plan_with_settings_can_be_simulated_and_shows_what_it_was_made_for(tmp_path):
    """Approaches and payloads of poses.csv go into the simulation; the effects come out."""
    config = CONFIGS / "3-RPR.yaml"
    run = ppmcal("plan", config, "--count", 24, "--for", "backlash,compliance", "--payload", "0,20",
                 "--out", tmp_path / "p", "--json")
    assert any("backlash width to" in t for t in run.json["said"])
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"file": "p/poses.csv"}, "seed": 3,
                "effects": [{"kind": "backlash", "parameters": {"width": 0.2}},
                            {"kind": "compliance", "parameters": {"stiffness": 2000}}],
                "instrument": {"kind": "pose", "sigma": {"position": 0.03, "rotation": 0.0069}}}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", config, tmp_path / "s.yaml", "--out", tmp_path / "s", expect=0)
    asked, got = rows(tmp_path / "p" / "poses.csv"), rows(tmp_path / "s" / "measurements.csv")
    for name in ("pose", "dir_leg1", "dir_leg2", "dir_leg3", "payload"):
        assert [float(r[name]) for r in got] == [float(r[name]) for r in asked]
    (tmp_path / "m.yaml").write_text(config.read_text() + (
        "\neffects: [{kind: backlash, parameters: {width: {value: 0, free: true}}}, {kind: "
        "compliance, parameters: {stiffness: {value: 1e6, free: true}}}]\n"))
    ppmcal("identify", tmp_path / "m.yaml", tmp_path / "s" / "measurements.csv", "--out",
           tmp_path / "i")
    found = {r["name"]: r for r in rows(tmp_path / "i" / "parameters.csv")}
    for name, true in (("backlash.width", 0.2), ("compliance.stiffness", 2000.0)):
        value, sigma = float(found[name]["value"]), float(found[name]["sigma"])
        assert abs(value - true) < 4.0 * sigma < 0.3 * true
    scenario["conditions"] = {"payload": [0, 20]}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
    twice = ppmcal("simulate", config, tmp_path / "s.yaml", "--out", tmp_path / "t", expect=2)
    assert "has its own column payload" in twice.err.replace("\n", " ")


def test_home_outside_limits_and_odd_accuracies_are_refused(tmp_path):
    text = (CONFIGS / "3-RPR.yaml").read_text()
    start = text.index("\nlimits:") + 1
    (tmp_path / "m.yaml").write_text(text[:start] + "limits: {leg1: [200, 300]}\n"
                                     + text[text.index("\n", start):])
    run = ppmcal("plan", tmp_path / "m.yaml", "--out", tmp_path / "p", expect=2)
    assert "home is not within limits: leg1" in run.err.replace("\n", " ")
    for value in ("nan", "inf", "0"):
        run = ppmcal("plan", CONFIGS / "3-RPR.yaml", "--accuracy", value, "--out", tmp_path / "p",
                     expect=2)
        assert "not the size of an error" in run.err
