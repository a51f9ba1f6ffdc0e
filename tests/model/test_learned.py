"""Learned terms in files: units, what is known where, refusals, commands and their uncertainty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows, write_csv
from helpers.paths import ROOT
from scipy.interpolate import CubicSpline

from ppmcal.calibration.compensation.pose_sigma import ParameterCovariance, model_sigma
from ppmcal.controllers.joints.tables import joint_tables, known_limits, table_command
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism, write_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import beyond, setting
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.tables import forward_table, inverse_table
from ppmcal.model.dataset import Environment, unknown_environment
from ppmcal.model.effects import Setting
from ppmcal.model.effects.learned import LearnedCurve, spline_basis
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.units import Units

TRAVEL: dict[str, Any] = {
    "kind": "learned", "on": ["leg2"], "input": "travel", "nodes": [1500, 1900, 2100, 2300, 3000],
    "values": [0.0, 0.11, -0.07, 0.05, 0.0],
    "covariance": (4e-4 * np.eye(5) + 1e-4).tolist()}
PLACE: dict[str, Any] = {
    "kind": "learned", "input": "x", "acts": "z", "nodes": [-150.0, -50, 50, 150],
    "values": [0.1, 0.0, 0.0, 0.1], "covariance": np.zeros((4, 4)).tolist()}
PAIR: dict[str, Any] = {
    "kind": "learned", "on": ["leg2"], "input": "travel", "nodes": [1500, 1900, 2100, 2300, 3000],
    "by": "temperature", "by_nodes": [15.0, 20, 31],
    "values": [[0.0, 0.1, 0.3], [-0.1, 0.0, 0.2], [0.05, 0.01, -0.1], [0.0, 0.0, 0.1], [0.2, 0, 0]],
    "covariance": (4e-4 * np.eye(15) + 1e-4).tolist()}
WARM: dict[str, Any] = {
    "kind": "learned", "input": "temperature", "nodes": [15.0, 20, 31], "by": "direction",
    "values": [0.01, 0.0, -0.02], "covariance": np.zeros((3, 3)).tolist()}


def read(folder: Path, *effects: dict[str, Any], **changes: Any) -> Mechanism:
    tree = yaml.safe_load((ROOT / "configs" / "6-UPS.yaml").read_text(encoding="utf-8"))
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump(tree | {"effects": list(effects)} | changes, sort_keys=False))
    return read_mechanism(path)


def about(mechanism: Mechanism, **changes: float) -> np.ndarray:
    pose = mechanism.home_pose.copy()
    for name, value in changes.items():
        pose[["x", "y", "z"].index(name)] += value
    return pose[None]


@pytest.mark.parametrize("units", [Units("mm", "deg"), Units("in", "rad"), Units("um", "deg")])
def test_what_is_written_reads_back_the_same(tmp_path: Path, units: Units) -> None:
    mechanism = replace(read(tmp_path, TRAVEL, PLACE, WARM, PAIR), units=units)
    text = write_mechanism(mechanism)
    (tmp_path / "back.yaml").write_text(text)
    again = read_mechanism(tmp_path / "back.yaml")
    assert write_mechanism(again) == text
    q = np.full((1, 6), 2.05)
    one, two = (reached_poses(Model(replace(m, effects=m.effects[:1])), q).pose
                for m in (mechanism, again))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, reached_poses(Model(replace(mechanism, effects=())), q).pose)


def test_the_function_is_the_natural_spline_and_its_unit_the_files(tmp_path: Path) -> None:
    """2.0 m of leg2 is 2000 mm in the file, and so on."""
    mechanism = read(tmp_path, TRAVEL)
    effect = mechanism.effects[0]
    q = np.linspace(1.95, 2.25, 7)[:, None] * np.ones(6)
    seen = reached_poses(Model(mechanism), q)
    shift = seen.model.shift
    assert shift is not None
    found = shift.slots[1, "offset"]
    expected = CubicSpline(TRAVEL["nodes"], TRAVEL["values"], bc_type="natural")(1e3 * q[:, 1])
    np.testing.assert_allclose(found, 1e-3 * expected, rtol=1e-12, atol=1e-15)
    assert list(shift.slots) == [(1, "offset")]
    assert effect.on == (False, True, False, False, False, False)


def test_of_two_inputs_it_is_the_spline_of_splines(tmp_path: Path) -> None:
    """Two ways: scipy's splines of the file's numbers, one after the other."""
    mechanism = read(tmp_path, PAIR)
    effect = mechanism.effects[0]
    warm = np.array([17.0, 22.5, 30.0])
    q = np.array([1.6, 2.0, 2.25])[:, None] * np.ones(6)
    at = _setting(mechanism, q, warm)
    found = effect.kind.evaluate(at, np.array(effect.on), {"scale": 1.0}).shift.slots[1, "offset"]
    across = CubicSpline(PAIR["by_nodes"], np.array(PAIR["values"]).T, bc_type="natural")(warm)
    expected = [CubicSpline(PAIR["nodes"], v, bc_type="natural")(1e3 * x)
                for v, x in zip(across, q[:, 1], strict=True)]
    np.testing.assert_allclose(found, 1e-3 * np.array(expected), rtol=1e-12)
    assert effect.kind.needs == ("temperature",)


def test_beyond_either_input_it_is_not_known(tmp_path: Path) -> None:
    mechanism = read(tmp_path, PAIR)
    q = np.array([2.0, 2.0, 3.2])[:, None] * np.ones(6)
    rows = _rows(3, np.array([25.0, 33.0, 25.0]))
    told = beyond(Model(mechanism), rows, q, np.tile(mechanism.home, (3, 1)))
    where = "effects[1] of the model is not known here: "
    assert told == ["", f"{where}temperature = 33 deg C, known 15 to 31",
                    f"{where}leg2 travel = 3200 mm, known 1500 to 3000"]


def test_weights_are_one_at_each_node_and_unknown_beyond() -> None:
    nodes = np.array([0.0, 1.0, 1.5, 4.0])
    assert np.allclose(spline_basis(nodes, nodes), np.eye(4), atol=1e-14)
    assert np.isnan(spline_basis(nodes, np.array([-1e-9, 4.0 + 1e-9, np.nan]))).all()


def test_the_covariance_is_that_of_the_modes() -> None:
    root = np.random.default_rng(1).normal(size=(4, 2))
    curve = LearnedCurve("travel", np.arange(4.0), np.zeros(4), root @ root.T)
    assert curve.modes.shape == (4, 2)
    np.testing.assert_allclose(curve.modes @ curve.modes.T, root @ root.T, atol=1e-12)


BAD = [({"input": "humidity"}, "input", "unknown input 'humidity'"),
       ({"nodes": [1, 3, 2]}, "nodes", "do not rise"),
       ({"nodes": [1, "x"]}, "nodes", "is not a list of numbers"),
       ({"values": [0.0, 0.1]}, "values", "is not 5 numbers"),
       ({"covariance": [[1.0]]}, "covariance", "is not 5 by 5 numbers"),
       ({"covariance": (-np.eye(5)).tolist()}, "covariance", "not a covariance"),
       ({"covariance": np.triu(np.ones((5, 5))).tolist()}, "covariance", "not a covariance"),
       ({"acts": "w"}, "acts", "unknown coordinate 'w'"),
       ({"acts": "z"}, "acts", "cannot act on z"),
       ({"by": "humidity"}, "by", "unknown class or input 'humidity'"),
       ({"by": "temperature"}, "by_nodes", "is not a list of numbers"),
       ({"by": "temperature", "by_nodes": [10, 30]}, "values", "is not 5 by 2 numbers"),
       ({"by": "temperature", "by_nodes": [30, 10]}, "by_nodes", "do not rise"),
       ({"by_nodes": [10, 30]}, "by_nodes", "second input, which is not named"),
       ({"by": "travel"}, "by", "second input equals the first"),
       ({"input": "x", "by": "load", "acts": "z"}, "acts", "each joint's load cannot act on z"),
       ({"knots": []}, "", "unknown key 'knots'")]


@pytest.mark.parametrize(("change", "place", "words"), BAD)
def test_a_term_that_makes_no_sense(tmp_path: Path, change: dict[str, Any], place: str,
                                    words: str) -> None:
    with pytest.raises(BadInput, match=words) as refused:
        read(tmp_path, TRAVEL | change)
    assert refused.value.where.endswith(f"effects[1]{'.' if place else ''}{place}")
    assert refused.value.hint


def test_a_coordinate_that_the_machine_has_not(tmp_path: Path) -> None:
    tree = yaml.safe_load((ROOT / "configs" / "3-RPR.yaml").read_text(encoding="utf-8"))
    (tmp_path / "p.yaml").write_text(yaml.safe_dump(tree | {"effects": [PLACE]}))
    with pytest.raises(BadInput, match="only in translational, schoenflies and spatial motion"):
        read_mechanism(tmp_path / "p.yaml")


def test_the_way_back_meets_the_target_inside_and_says_what_is_unknown_outside(
        tmp_path: Path) -> None:
    mechanism = read(tmp_path, TRAVEL, PLACE)
    model = Model(mechanism)
    wanted = np.concatenate([about(mechanism, x=x) for x in (0.0, 0.12, 0.2, -0.149)])
    table = inverse_table(model, wanted)
    assert table.status == ("ok", "ok", "unreachable", "ok")
    assert table.reason[2] == ("effects[2] of the model is not known here: x = 200 mm, known "
                               "-150 to 150")
    good = [0, 1, 3]
    np.testing.assert_allclose(forward_table(model, table.q).pose[good], wanted[good], atol=1e-11)
    bare = inverse_table(Model(mechanism.nominal()), wanted).q
    off = forward_table(model, bare)
    assert off.status[2] == "not converged"
    assert off.reason[2] == table.reason[2]


def test_a_joint_that_is_beyond_is_named(tmp_path: Path) -> None:
    mechanism = read(tmp_path, TRAVEL | {"nodes": [1500, 1600, 1700, 1800, 1900]})
    reason = inverse_table(Model(mechanism), about(mechanism)).reason[0]
    assert reason.startswith("effects[1] of the model is not known here: leg2 travel = ")
    assert reason.endswith(" mm, known 1500 to 1900")


def test_commands_inside_and_outside(tmp_path: Path) -> None:
    """Targets beyond the range are refused with the input and its range."""
    read(tmp_path, TRAVEL, PLACE)
    write_csv(tmp_path / "t.csv", [
        {"x": x, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0} for x in (0, 200)])
    run = ppmcal("compensate", "m.yaml", "t.csv", "--frame", "base", "--out", "c", cwd=tmp_path)
    assert run.code == 1
    one, two = rows(tmp_path / "c" / "commands.csv")
    assert one["status"] == "ok"
    assert two["status"] == "refused"
    assert "x = 200 mm, known -150 to 150" in two["reason"]


@pytest.mark.slow
def test_a_joint_table_ends_where_the_term_does(tmp_path: Path) -> None:
    """Inside, what the table commands stands where nominal kinematics means: offset and term."""
    nodes, values = [2500.0, 2550, 2600, 2700, 2750], [0.0, 0.05, -0.1, 0.05, 0.0]
    mechanism = read(tmp_path, TRAVEL | {"on": ["leg1"], "nodes": nodes, "values": values},
                     limits={f"leg{i}": [2300, 2900] for i in range(1, 7)})
    p = mechanism.names.index("leg1.offset")
    g = mechanism.values.copy()
    g[p] += 4e-4
    mechanism = mechanism.with_values(g)
    table = joint_tables(mechanism)[0]
    low, high = known_limits(mechanism)[0]
    assert (low, high) == (pytest.approx(2.5004, abs=1e-6), pytest.approx(2.7504, abs=1e-6))
    assert (table.table.nominal[0], table.table.nominal[-1]) == (
        pytest.approx(1e3 * low, abs=1e-6), pytest.approx(1e3 * high, abs=1e-6))
    n = np.linspace(low, high, 50)[1:-1]
    m = table_command(table.table, table.factor, n, np.ones(n.size))
    spline = CubicSpline(nodes, values, bc_type="natural")
    np.testing.assert_allclose(m + 4e-4 + 1e-3 * spline(1e3 * m), n, rtol=0.0, atol=3e-8)


@pytest.mark.long
def test_the_uncertainty_of_a_command_is_that_of_drawn_functions(tmp_path: Path) -> None:
    """Two ways: the covariance along derivatives, and poses of machines with values drawn."""
    mechanism = read(tmp_path, TRAVEL)
    wanted = np.concatenate([about(mechanism), about(mechanism, x=0.1, z=0.05)])
    nothing = ParameterCovariance((), np.zeros((0, 0)), {}, {}, {})
    sigma, turn = model_sigma(mechanism, wanted, Registration(), nothing, "", {})
    q = inverse_table(Model(mechanism), wanted).q
    rng, drawn = np.random.default_rng(2), []
    for _ in range(300):
        values = rng.multivariate_normal(TRAVEL["values"], TRAVEL["covariance"]).tolist()
        other = read(tmp_path, TRAVEL | {"values": values})
        drawn.append(forward_table(Model(other), q).pose)
    away = np.array(drawn) - wanted
    found = np.sqrt(np.mean(np.sum(away[..., :3] ** 2, axis=-1), axis=0))
    np.testing.assert_allclose(sigma, found, rtol=0.12)
    found = np.sqrt(np.mean(np.sum(away[..., 3:] ** 2, axis=-1), axis=0))
    np.testing.assert_allclose(turn, found, rtol=0.12)


def test_a_derivative_of_the_size(tmp_path: Path) -> None:
    """Against differences, with every input and action."""
    for effect in (TRAVEL, PLACE, PAIR):
        mechanism = read(tmp_path, effect | {"parameters": {"scale": {"value": 1.2, "free": True}}})
        p = mechanism.effects[0].parameters["scale"]
        assert p in mechanism.free
        evaluate = mechanism.effects[0].kind.evaluate
        at = _setting(mechanism, np.atleast_2d(home_state(mechanism).q), np.array([24.0]))
        on = np.array(mechanism.effects[0].on)
        up, down = (evaluate(at, on, {"scale": 1.2 + h}).shift for h in (1e-3, -1e-3))
        by = evaluate(at, on, {"scale": 1.2}).by["scale"]
        assert by.slots or by.pose is not None
        for slot, found in by.slots.items():
            assert np.all(found != 0.0)
            np.testing.assert_allclose((up.slots[slot] - down.slots[slot]) / 2e-3, found, rtol=1e-9)
        if by.pose is not None:
            assert up.pose is not None and down.pose is not None
            np.testing.assert_allclose((up.pose - down.pose) / 2e-3, by.pose, rtol=1e-9)


def _rows(count: int, celsius: np.ndarray) -> Environment:
    return replace(unknown_environment(count, 6), temperature=celsius - 20.0)


def _setting(mechanism: Mechanism, q: np.ndarray, celsius: np.ndarray) -> Setting:
    home = np.tile(mechanism.home, (len(q), 1))
    return setting(Model(mechanism), _rows(len(q), celsius), q, home)
