"""How many geometric errors each machine shows, to which instrument: the table of the theory."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from numpy.typing import NDArray

from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.linearisation import column_scale, qr_factor
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.rank import Rank, analyse
from ppmcal.calibration.validation.summary import rank_of
from ppmcal.io import read_mechanism, read_scenario
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Circle, Random, Scenario
from ppmcal.simulation.simulate import simulate

Array = NDArray[np.float64]

CONFIGS = ROOT / "configs"
# theory, section 5: machine (lateral in mm, if it has one) -> rank with full pose, one point
TABLE: dict[tuple[str, float | None], tuple[int | None, int]] = {
    ("3-RPR", None): (15, 14), ("3-PRP-1", None): (15, 14), ("3-RPP-2", None): (15, 14),
    ("3-RPR-1", None): (15, 14), ("3-PPR-1", None): (15, 14), ("3-PPR-2", None): (15, 14),
    ("3-PRR-1", None): (18, 17), ("3-RRP-1", None): (18, 17), ("3-RRP-1", 9.0): (18, 17),
    ("3-RRP-2", None): (18, 17), ("3-RPR-1", 9.0): (18, 17), ("3-PRR-2", None): (18, 17),
    ("3-RRR-1", None): (21, 20), ("3-RRR-2", None): (21, 20), ("3-RPS", None): (27, 24),
    ("6-UPS", None): (42, 39), ("6-PUS", None): (54, 51), ("linapod", None): (54, 51),
    ("6-RUS", None): (66, 63), ("delta-rotary", None): (None, 24),
    ("delta-linear", None): (None, 18),
}
SYMMETRIC = {"3-PPR-1": (10, 14), "3-PPR-2": (10, 14), "3-PRR-2": (13, 17)}
PAPER = ["*.base.point.?", "*.offset", "*.platform.point.radius", "*.joint1.rz"]
COUNT = 30


@dataclass(frozen=True)
class Setup:
    """A machine and where it is measured; poses as its scenario says, or its own."""

    mechanism: Mechanism
    scenario: Scenario


def opened(tree: Any) -> Any:
    """Return a mechanism file's tree with nothing shared and nothing fixed."""
    if isinstance(tree, dict):
        return opened(tree["value"]) if "value" in tree else {k: opened(v) for k, v in tree.items()}
    return [opened(v) for v in tree] if isinstance(tree, list) else tree


def read_tree(tree: Any) -> Mechanism:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "machine.yaml"
        path.write_text(yaml.safe_dump(tree), encoding="utf-8")
        return read_mechanism(path)


def tree_of(name: str) -> Any:
    return yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))


def scenario_of(name: str, mechanism: Mechanism) -> Scenario:
    """Return poses spread over the scenario's box, without errors."""
    scenario = read_scenario(CONFIGS / "scenarios" / f"{name}.yaml", mechanism)
    shape = scenario.poses
    if isinstance(shape, Circle):
        half = shape.swing.copy()
        half[:2] += shape.radius / math.sqrt(2.0)
        shape = Random(shape.center, half, COUNT)
    assert isinstance(shape, Random)
    return replace(scenario, poses=replace(shape, count=COUNT), error_scale=None)


@cache
def setup(name: str, lateral: float | None = None, whole: bool = True) -> Setup:
    """Return a machine of ``configs/``, every slot free (``whole``) or as it is."""
    tree = opened(tree_of(name)) if whole else tree_of(name)
    if lateral is not None:
        for limb in tree["limbs"]:
            limb["lateral"] = lateral
    mechanism = read_tree(tree)
    return Setup(mechanism, scenario_of(name, mechanism))


@cache
def symmetric(name: str) -> Setup:
    """Return the machine with its threefold symmetry to the last digit, not to the file's."""
    tree = opened(tree_of(name))
    for side in ("base", "platform"):
        first = tree["limbs"][0][side]
        x, y = first["point"]
        for i, limb in enumerate(tree["limbs"]):
            turn = 120.0 * i
            limb[side] = {"point": {"radius": math.hypot(x, y),
                                    "angle": math.degrees(math.atan2(y, x)) + turn}}
            if "angle" in first:
                limb[side]["angle"] = first["angle"] + turn
    mechanism = read_tree(tree)
    return Setup(mechanism, scenario_of(name, mechanism))


def fit_of(case: Setup, kind: str, unknown: bool, target: Array | None = None,
           free: tuple[int, ...] | None = None) -> Fit:
    """Return the machine at its nominals as a fit, measured without noise."""
    mechanism = case.mechanism
    target = np.zeros(3) if target is None else target
    frame = case.scenario.frame if unknown else np.zeros(6)
    plan = replace(case.scenario, kind=find_instrument(kind), frame=frame, target=target,
                   sigma_position=0.0,
                   sigma_rotation=0.0, outliers=0.0)
    seen = simulate(mechanism, plan, 3)
    n = len(seen.q)
    data = Dataset(
        name="a", source="a", kind=find_instrument(kind), rows=np.arange(1, n + 1), q=seen.q,
        commanded=None,
        position=seen.position, rotation=seen.rotation, value=np.full(n, np.nan), to_q=None,
        sigma_position=np.full((n, 3), 1e-5), sigma_rotation=np.full((n, 3), 3e-5),
        sigma_value=np.ones(n), sigma_actuator=np.zeros(len(mechanism.actuators)),
        groups=seen.pose, columns={}, sessions=None, frame=Unknown(unknown, np.zeros(6)),
        target=Unknown(unknown, np.zeros(3) if unknown else target),
        target_rotation=Unknown(False, np.zeros(3)))
    problem = Problem(mechanism, (data,), mechanism.free if free is None else free)
    return at_start(problem)


def at_start(problem: Problem, order: NDArray[np.int64] | None = None) -> Fit:
    """Return the problem's start as a fit, its rows taken in another ``order``."""
    if order is not None:
        problem = replace(problem, datasets=tuple(d.take(order) for d in problem.datasets))
    state = problem.start()
    keep = tuple(np.ones(len(d), dtype=bool) for d in problem.datasets)
    return Fit(problem, state, qr_factor(problem, state, keep), np.zeros(len(problem.columns)),
               column_scale(problem), keep, 0, True)


def label(case: tuple[str, float | None]) -> str:
    return case[0] + ("-lateral" if case[1] else "")


def assert_clear_of_round_off(rank: Rank) -> None:
    size, s = len(rank.kept), rank.singular
    assert s[size - 1] > 1e-6 * s[0]
    assert np.all(s[size:] < 1e-12 * s[0])


@pytest.mark.slow
@pytest.mark.parametrize("case", [c for c, r in TABLE.items() if r[0]], ids=label)
def test_rank_with_the_full_pose(case: tuple[str, float | None]) -> None:
    rank, total, _ = rank_of(fit_of(setup(*case), "pose", False))
    assert total == TABLE[case][0]
    assert_clear_of_round_off(rank)
    assert rank_of(fit_of(setup(*case), "pose", True))[1] == TABLE[case][0]


@pytest.mark.slow
@pytest.mark.parametrize("case", [c for c in TABLE if c[0] not in SYMMETRIC], ids=label)
def test_rank_with_one_measured_point(case: tuple[str, float | None]) -> None:
    planar = setup(*case).mechanism.motion.planar
    off = [0.03, -0.02, 0.0 if planar else 0.05]
    for target, unknown in (([0.0, 0.0, 0.0], False), (off, False), (off, True)):
        rank, total, _ = rank_of(fit_of(setup(*case), "position", unknown, np.array(target)))
        assert total == TABLE[case][1]
        if not (TABLE[case][0] or unknown):
            assert_clear_of_round_off(rank)


@pytest.mark.parametrize("unknown", [False, True], ids=["known", "unknown"])
@pytest.mark.parametrize("name", SYMMETRIC)
def test_the_centre_of_a_symmetric_machine_shows_less(name: str, unknown: bool) -> None:
    case, (fewer, usual) = symmetric(name), SYMMETRIC[name]
    assert rank_of(fit_of(case, "position", False))[1] == fewer
    off_centre = np.array([0.03, -0.02, 0.0])
    assert rank_of(fit_of(case, "position", unknown, off_centre))[1] == usual
    assert rank_of(fit_of(case, "pose", unknown))[1] == TABLE[name, None][0]


def test_the_symmetric_rank_is_one_of_the_nominal_only() -> None:
    # with the parts as made the centre does feel the rotation: look again at the fitted values
    for name, (_, usual) in SYMMETRIC.items():
        case = symmetric(name)
        rng = np.random.default_rng(5)
        g = case.mechanism.nominals.copy()
        for p in case.mechanism.free:
            g[p] += (case.mechanism.parameters[p].tolerance or 0.0) * rng.normal()
        made = replace(case.mechanism, parameters=tuple(
            replace(p, value=v, nominal=v) for p, v in
            zip(case.mechanism.parameters, g.tolist(), strict=True)))
        assert rank_of(fit_of(Setup(made, case.scenario), "position", False))[1] == usual


@pytest.mark.parametrize("unknown", [False, True], ids=["known", "unknown"])
def test_a_delta_of_six_rods_on_three_drives_shows_36(unknown: bool) -> None:
    # as configs/ has it: both rods of a pair hang on one arm
    assert rank_of(fit_of(setup("delta-rotary-6rods", whole=False), "pose", unknown))[1] == 36


@pytest.mark.parametrize("unknown", [False, True], ids=["known", "unknown"])
def test_a_mixed_machine_is_the_sum_of_its_limbs(unknown: bool) -> None:
    # two (P)RR of six each, one R(P)R of five
    assert rank_of(fit_of(setup("mixed-planar"), "pose", unknown))[1] == 17
    assert rank_of(fit_of(setup("mixed-planar"), "position", unknown))[1] == 16


# --- the planar paper's fifteen ---------------------------------------------------------------

@cache
def paper() -> Mechanism:
    """[PPM] section 4.5: one radius for each leg, its angle as drawn, passive angles free."""
    return read_tree({**tree_of("3-RPR"), "free": PAPER})


def on_the_circle(swing: float) -> Setup:
    scenario = read_scenario(CONFIGS / "scenarios" / "3-RPR.yaml", paper())
    shape = scenario.poses
    assert isinstance(shape, Circle)
    swings = np.array([0.0, 0.0, 0.0, 0.0, 0.0, math.radians(swing)])
    return Setup(paper(), replace(scenario, poses=replace(shape, swing=swings), error_scale=None))


def test_three_of_the_papers_fifteen_are_redundant() -> None:
    for swing in (5.0, 12.0):
        rank, total, redundant = rank_of(fit_of(on_the_circle(swing), "pose", False))
        assert len(paper().free) == 15
        assert (len(rank.kept), total) == (12, 12)
        assert [d.name for d in redundant] == [f"leg{i}.joint1.rz" for i in (1, 2, 3)]
        # a passive angle of a closed loop acts like nothing at all
        assert all(not d.depends_on for d in redundant)


def test_at_constant_orientation_six_are_lost() -> None:
    rank, total, redundant = rank_of(fit_of(on_the_circle(0.0), "pose", False))
    assert (len(rank.kept), total) == (9, 9)
    names = [d.name for d in redundant]
    assert len(names) == 6
    passive = {f"leg{i}.joint1.rz" for i in (1, 2, 3)}
    assert passive < set(names)
    # in each leg, base joint and platform joint are confounded
    others = [d for d in redundant if d.name not in passive]
    assert sorted(d.name.split(".")[0] for d in others) == ["leg1", "leg2", "leg3"]
    for d in others:
        leg = d.name.split(".")[0]
        assert {n.split(".")[0] for n in d.depends_on} == {leg}


# --- the same answer every time -----------------------------------------------------------------

CHOSEN = ["3-RPR", "3-PPR-1", "3-RPS", "6-PUS", "6-RUS", "delta-linear"]


@pytest.mark.parametrize("name", CHOSEN)
def test_repeated_and_permuted_runs_agree(name: str) -> None:
    case = setup(name)
    kind = "position" if not case.mechanism.motion.turns else "pose"
    problem = fit_of(case, kind, True).problem
    expected = rank_of(at_start(problem))
    size = len(problem.datasets[0])
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(size) if seed else np.arange(size)
        rank, total, redundant = rank_of(at_start(problem, order))
        assert total == expected[1]
        assert rank.kept == expected[0].kept
        assert rank.dropped == expected[0].dropped
        assert [d.name for d in redundant] == [d.name for d in expected[2]]
        for d, e in zip(redundant, expected[2], strict=True):
            assert d.depends_on.keys() == e.depends_on.keys()
            for other, value in d.depends_on.items():
                assert value == pytest.approx(e.depends_on[other], rel=1e-6)


@pytest.mark.parametrize("name", CHOSEN)
def test_units_of_the_file_do_not_change_the_choice(name: str) -> None:
    fit = fit_of(setup(name), "position", True)
    count = len(fit.problem.free)
    first = analyse(fit.information.root, count, fit.scale[:count])
    unit = np.array([1e3 if p.quantity == "length" else 57.3 for p in
                     (fit.problem.mechanism.parameters[i] for i in fit.problem.free)])
    columns = fit.information.root.copy()
    columns[:, :count] /= unit
    again = analyse(columns, count, fit.scale[:count] * unit)
    assert (again.kept, again.dropped) == (first.kept, first.dropped)


@pytest.mark.parametrize("name", ["3-PPR-1", "3-RPS", "6-PUS"])
def test_a_redundant_parameter_acts_like_what_it_depends_on(name: str) -> None:
    fit = fit_of(setup(name), "pose", False)
    columns = list(fit.problem.columns)
    triangle = fit.information.root
    largest = float(np.linalg.norm(triangle * fit.scale, axis=0).max())
    redundant = rank_of(fit)[2]
    assert redundant
    for d in redundant:
        c = columns.index(d.name)
        combined = sum((v * triangle[:, columns.index(n)] for n, v in d.depends_on.items()),
                       np.zeros(len(columns)))
        miss = np.linalg.norm(triangle[:, c] - combined) * fit.scale[c]
        assert miss < 1e-5 * largest


@pytest.mark.parametrize("kind", ["pose", "position"])
def test_fewer_poses_than_columns_give_their_number_of_rows(kind: str) -> None:
    fit = fit_of(setup("6-UPS"), kind, False)
    few = at_start(fit.problem, np.arange(3))
    assert rank_of(few)[1] == (18 if kind == "pose" else 9)


def test_no_free_parameter_has_rank_nought() -> None:
    rank, total, redundant = rank_of(fit_of(setup("3-RPR"), "pose", False, free=()))
    assert (len(rank.kept), total, redundant) == (0, 0, ())
    # only the registration is open: three of the frame, two of the target
    assert rank_of(fit_of(setup("3-RPR"), "pose", True, free=()))[1] == 5
