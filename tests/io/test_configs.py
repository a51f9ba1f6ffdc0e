"""The mechanism files that users start from: each works as it is, in its whole scenario."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT
from numpy.typing import NDArray

from ppmcal.io import read_mechanism, read_scenario
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward, smallest_singular_value
from ppmcal.kinematics.inverse import Inverse, home_state
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.model.instruments import POSE, POSITION
from ppmcal.model.limbs import kinds
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Circle, Random, Scenario

Array = NDArray[np.float64]

CONFIGS = ROOT / "configs"
NAMES = sorted(p.stem for p in CONFIGS.glob("*.yaml"))
PLANAR = {
    "3-RPR": "R(P)R", "3-RPR-1": "(R)PR", "3-RRR-1": "(R)RR", "3-RRR-2": "R(R)R",
    "3-PRR-1": "(P)RR", "3-PRR-2": "P(R)R", "3-RRP-1": "(R)RP", "3-RRP-2": "R(R)P",
    "3-RPP-2": "R(P)P", "3-PRP-1": "(P)RP", "3-PPR-1": "(P)PR", "3-PPR-2": "P(P)R",
}
RANK = {  # theory, section 5, for a measured full pose; delta-linear: as its comment says
    "3-RPR": 12, "3-RPR-1": 15, "3-RRR-1": 21, "3-RRR-2": 21, "3-PRR-1": 18, "3-PRR-2": 18,
    "3-RRP-1": 18, "3-RRP-2": 18, "3-RPP-2": 15, "3-PRP-1": 15, "3-PPR-1": 15, "3-PPR-2": 15,
    "3-RPS": 27, "6-UPS": 42, "6-PUS": 54, "linapod": 54, "6-RUS": 66, "delta-linear": 7,
    "delta-rotary-6rods": 36,
    # three legs of 7; of the centre leg its joint, the direction of its axis, and the leg's line
    # with the turn about it
    "tricept": 3 * 7 + 3 + 2 + 5,
}
WELL_CONDITIONED = 0.05

each = pytest.mark.parametrize("name", NAMES)


@dataclass(frozen=True)
class Box:
    """A mechanism, its scenario, and poses of the scenario's box: center, corners, inside."""

    mechanism: Mechanism
    scenario: Scenario
    found: Inverse


def box_of(scenario: Scenario) -> tuple[Array, Array]:
    """Return center and half range (6,), the center nan where it is left to be solved for."""
    poses = scenario.poses
    if isinstance(poses, Random):
        return poses.center, poses.half_range
    assert isinstance(poses, Circle)
    half = poses.swing.copy()
    half[:2] += poses.radius
    return poses.center, half


@cache
def load(name: str) -> Box:
    mechanism = read_mechanism(CONFIGS / f"{name}.yaml")
    scenario = read_scenario(CONFIGS / "scenarios" / f"{name}.yaml", mechanism)
    center, half = box_of(scenario)
    moving = np.flatnonzero(half)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=moving.size)))
    inside = np.random.default_rng(1).uniform(-1.0, 1.0, (30, moving.size))
    wanted = np.tile(center, (1 + len(corners) + len(inside), 1))
    wanted[1:, moving] += np.concatenate([corners, inside]) * half[moving]
    return Box(mechanism, scenario, inverse_partial(Model(mechanism), wanted))


def rank(mechanism: Mechanism, found: Inverse) -> int:
    """Return how many combinations of the free parameters the platform's poses show."""
    free = list(mechanism.free)
    closure = Model(mechanism).closure(found.q, free)
    shown = np.linalg.solve(closure.pose_matrix(found.pose),
                            closure.error_matrix(found.pose, free))
    turning = [i for i, c in enumerate(mechanism.dof) if c >= 3]
    shown[:, turning] *= mechanism.length_scale
    columns = shown.reshape(-1, len(free)) * [mechanism.parameters[i].tolerance for i in free]
    singular = np.linalg.svd(columns, compute_uv=False)
    return int(np.sum(singular > 1e-9 * singular[0]))


def uncommented(name: str, tmp_path: Path, line: str) -> Mechanism:
    """Return the mechanism with a line of its file taken out of the comments."""
    text = (CONFIGS / f"{name}.yaml").read_text(encoding="utf-8")
    assert text.count(f"# {line}") == 1
    path = tmp_path / f"{name}.yaml"
    path.write_text(text.replace(f"# {line}", line), encoding="utf-8")
    return read_mechanism(path)


@pytest.mark.slow
def test_every_kind_has_a_file() -> None:
    used = {limb.kind.name for name in NAMES for limb in load(name).mechanism.limbs}
    assert used == set(kinds())


def test_every_file_has_a_scenario_and_a_line_in_the_readme() -> None:
    scenarios = sorted(p.stem for p in (CONFIGS / "scenarios").glob("*.yaml"))
    assert scenarios == NAMES
    readme = (CONFIGS / "README.md").read_text(encoding="utf-8")
    assert [n for n in NAMES if f"`{n}`" not in readme] == []


@pytest.mark.parametrize("name", PLANAR)
def test_the_file_name_says_the_kind(name: str) -> None:
    kind = PLANAR[name]
    assert {limb.kind.name for limb in load(name).mechanism.limbs} == {kind}
    first = (CONFIGS / f"{name}.yaml").read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith(f"# 3-{kind}: ")
    actuated = kind.index("(") + 1
    assert name in ("3-RPR", f"3-{kind.replace('(', '').replace(')', '')}-{actuated}")


@each
def test_reads_without_findings(name: str) -> None:
    mechanism = load(name).mechanism
    assert mechanism.findings == ()
    assert mechanism.name == name
    assert np.isfinite(mechanism.limits).all()


@each
def test_lines_fit_on_a_page(name: str) -> None:
    for path in (CONFIGS / f"{name}.yaml", CONFIGS / "scenarios" / f"{name}.yaml"):
        text = path.read_text(encoding="utf-8")
        assert text.startswith("# ") and text.isascii() and text.endswith("\n")
        assert max(len(line) for line in text.splitlines()) <= 100


@each
def test_home_closes_and_is_well_conditioned(name: str) -> None:
    mechanism = load(name).mechanism
    closure = Model(mechanism).closure(home_state(mechanism).q)
    # a machine with fewer drives than coordinates closes to the digits of its file
    close = 1e-12 if len(mechanism.actuators) == mechanism.equations else 1e-9
    assert np.max(np.abs(closure.lengths(mechanism.home[None]))) < close * mechanism.reach
    value, _ = smallest_singular_value(closure, mechanism.home[None])
    assert value[0] > WELL_CONDITIONED


@each
def test_the_whole_box_is_reached_without_singularity_within_limits(name: str) -> None:
    box = load(name)
    mechanism, found = box.mechanism, box.found
    assert [r for r in found.reason if r] == []
    assert np.all(found.q >= mechanism.limits[:, 0])
    assert np.all(found.q <= mechanism.limits[:, 1])
    closure = Model(mechanism).closure(found.q)
    value, sign = smallest_singular_value(closure, found.pose)
    at_home = Model(mechanism).closure(home_state(mechanism).q)
    assert np.all(value > WELL_CONDITIONED)
    assert np.all(sign == smallest_singular_value(at_home, mechanism.home[None])[1])


@each
def test_no_actuator_is_at_a_dead_point(name: str) -> None:
    box = load(name)
    matrix = Model(box.mechanism).closure(box.found.q).joint_matrix(box.found.pose)
    scale = np.array([1.0 if quantity == "length" else box.mechanism.reach
                      for quantity in box.mechanism.actuator_quantity])
    assert np.all(np.max(np.abs(matrix), axis=1) > 0.02 * scale)


@each
def test_forward_undoes_inverse(name: str) -> None:
    box = load(name)
    back = forward(Model(box.mechanism), box.found.q[-30:])
    assert back.converged.all()
    np.testing.assert_allclose(back.pose, box.found.pose[-30:], rtol=0.0, atol=1e-12)


@each
def test_the_scenario_shows_what_theory_says(name: str) -> None:
    box = load(name)
    if name in RANK:
        assert rank(box.mechanism, box.found) == RANK[name]
    pose = box.mechanism.motion.turns
    assert box.scenario.kind == (POSE if pose else POSITION)
    assert box.scenario.error_scale == 1.0
    assert not box.scenario.frame_known
    assert box.scenario.target_known != pose


def test_the_fifteen_of_the_planar_paper_are_a_comment_away(tmp_path: Path) -> None:
    line = 'free: ["*.base.point.?", "*.offset", "*.platform.point.radius", "*.joint1.rz"]'
    mechanism = uncommented("3-RPR", tmp_path, line)
    assert len(mechanism.free) == 15
    assert rank(mechanism, load("3-RPR").found) == 12


def test_the_126_of_the_linapod_are_a_comment_away(tmp_path: Path) -> None:
    mechanism = uncommented("linapod", tmp_path, 'free: ["*.joint?.*", "*.platform.point.*"]')
    assert len(mechanism.free) == 126


def test_the_linapod_closes_to_the_digits_of_its_table() -> None:
    q = home_state(load("linapod").mechanism).q
    np.testing.assert_allclose(q, [1.221] * 3 + [1.933] * 3, rtol=0.0, atol=7.5e-4)
