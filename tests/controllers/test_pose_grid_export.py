"""Tables of corrected poses: what they hold, and what a controller makes of them in between."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import columns, number, ppmcal, rows, tree, write_csv
from helpers.paths import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from ppmcal.controllers.pose_grid import (
    Corrected,
    corrected,
    default_grid,
    interpolated,
    nearest_rotations,
)
from ppmcal.io import read_mechanism, write_mechanism
from ppmcal.kinematics.region import Grid, named
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.folder import RECORD

CONFIGS = ROOT / "configs"
COUNTS = {"3-RPR": 11 * 11 * 9, "delta-linear": 11**3, "6-UPS": 5**3 * 3**3, "3-RPS": 11 * 9 * 9}


def identified(name: str, seed: int = 5, size: float = 1.0) -> Mechanism:
    """A shipped machine whose free parameters are off by their tolerances, drawn."""
    machine = read_mechanism(CONFIGS / f"{name}.yaml")
    g = machine.values.copy()
    rng = np.random.default_rng(seed)
    for i in machine.free:
        g[i] += size * rng.normal() * (machine.parameters[i].tolerance or 0.0)
    return machine.with_values(g)


def written(folder: Path, machine: Mechanism) -> Path:
    path = folder / "m.yaml"
    path.write_text(write_mechanism(machine))
    return path


def edited(folder: Path, name: str = "3-RPR", **change: Any) -> Path:
    """A shipped machine with other top-level keys, None to take one out."""
    whole = {**yaml.safe_load((CONFIGS / f"{name}.yaml").read_text()), **change}
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in whole.items() if v is not None}))
    return path


def legs(machine: Mechanism, pose: np.ndarray) -> np.ndarray:
    """Joint values (k,), mm, of struts between points at full pose (6,) mm, rad; by matrices."""
    turn = Rotation.from_rotvec(pose[3:]).as_matrix()
    out = []
    for limb in machine.limbs:
        v = limb.slots.values(machine.values)
        a, b = (1e3 * np.array([v.get(f"{part}.point.{c}", 0.0) for c in "xyz"])
                for part in ("base", "platform"))
        out.append(np.linalg.norm(pose[:3] + turn @ b - a) - 1e3 * v.get("offset", 0.0))
    return np.array(out)


def table(folder: Path) -> dict[str, np.ndarray]:
    found = rows(folder / "grid.csv")
    return {c: np.array([number(r, c) for r in found]) for c in columns(folder / "grid.csv")}


# ---------------------------------------------------------------- the gain

@pytest.mark.slow
@pytest.mark.parametrize(("name", "factor"), [("3-RPR", 500), ("delta-linear", 150),
                                              ("6-UPS", 300), ("3-RPS", 500)])
def test_errors_between_the_poses_shrink(tmp_path: Path, name: str, factor: float) -> None:
    run = ppmcal("export", "grid", written(tmp_path, identified(name)), "--json", "--out",
                 tmp_path / "o", expect=0)
    found = run.json
    before, after = found["gain"]["before"], found["gain"]["after"]
    print(f"{name}: {found['rows']} rows, in between {before['rms']:.4f} mm rms to "
          f"{after['rms']:.6f}, {before['rms'] / after['rms']:.0f} times smaller")
    assert found["rows"] == COUNTS[name] and not found["left_out"]
    assert found["exact"] and found["read_back"]
    assert before["rms"] > factor * after["rms"] > 0.0
    if name != "delta-linear":
        assert before["rotation"]["rms"] > 0.5 * factor * after["rotation"]["rms"] > 0.0
    else:
        assert "rotation" not in after


@pytest.mark.parametrize("name", ["3-RPR", "6-UPS"])
@pytest.mark.slow
def test_the_gain_by_hand(tmp_path: Path, name: str) -> None:
    """Corner weights, strut lengths by matrices, the true machine's pose by a root finder."""
    true = identified(name)
    drawn = true.nominal()
    run = ppmcal("export", "grid", written(tmp_path, true), "--json", "--out", tmp_path / "o",
                 expect=0)
    got = table(tmp_path / "o")
    names = list(run.json["grid"])
    dof = ["xyz".index(n) if n in "xyz" else 3 + ["rx", "ry", "rz"].index(n) for n in names]
    levels = [np.array(run.json["grid"][n]) for n in names]
    shape = [len(level) for level in levels]
    change = np.stack([got[f"cmd_{n}"] - got[n] for n in names], axis=-1).reshape(*shape, -1)
    unit = np.where(np.array(dof) < 3, 1.0, np.pi / 180.0)
    rng = np.random.default_rng(11)

    def full(values: np.ndarray) -> np.ndarray:
        out = np.zeros(6)
        out[dof] = values * unit
        return out

    errors = {"before": [], "after": []}
    for _ in range(25):
        wanted = np.array([rng.uniform(level[0], level[-1]) for level in levels])
        cell = [min(np.searchsorted(lv, w, side="right") - 1, len(lv) - 2)
                for lv, w in zip(levels, wanted, strict=True)]
        part = [(w - lv[c]) / (lv[c + 1] - lv[c]) for lv, w, c in
                zip(levels, wanted, cell, strict=True)]
        add = np.zeros(len(dof))
        for corner in itertools.product((0, 1), repeat=len(dof)):
            weight = np.prod([p if up else 1 - p for p, up in zip(part, corner, strict=True)])
            add += weight * change[tuple(c + up for c, up in zip(cell, corner, strict=True))]
        for label, command in (("before", wanted), ("after", wanted + add)):
            q = legs(drawn, full(command))
            # angles weigh as at an arm of 500 mm, so that the root finder sees like numbers
            scale = np.where(np.array(dof) < 3, 1.0, 180.0 / np.pi / 500.0)
            real = scale * fsolve(lambda s, q=q, scale=scale: legs(true, full(s * scale)) - q,
                                  wanted / scale, xtol=1e-13)
            away = (real - wanted)[[d < 3 for d in dof]]
            errors[label].append(float(np.linalg.norm(away)))
    for label, sizes in errors.items():
        told = run.json["gain"][label]
        assert max(sizes) <= 1.2 * told["max"]
        assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(told["rms"], rel=0.4)


@pytest.mark.slow
def test_the_table_holds_poses_commands_and_joints(tmp_path: Path) -> None:
    true = identified("3-RPR")
    run = ppmcal("export", "grid", written(tmp_path, true), "--json", "--out", tmp_path / "o")
    assert run.code == 0 and sorted(tree(tmp_path / "o")) == [RECORD, "export.json", "grid.csv"]
    legs_ = ["q_leg1", "q_leg2", "q_leg3"]
    assert columns(tmp_path / "o" / "grid.csv") == ["x", "y", "rz", "cmd_x", "cmd_y", "cmd_rz",
                                                    *legs_]
    got = table(tmp_path / "o")
    assert run.json["columns"]["cmd_rz"] == "deg" and run.json["columns"]["q_leg1"] == "mm"
    across = np.meshgrid(*run.json["grid"].values(), indexing="ij")
    for name, level in zip(("x", "y", "rz"), across, strict=True):
        np.testing.assert_allclose(got[name], level.ravel(), rtol=0, atol=1e-9)
    for n in range(0, len(got["x"]), 97):
        wanted, command = (np.array([got[p + "x"][n], got[p + "y"][n], 0, 0, 0,
                                     np.radians(got[p + "rz"][n])]) for p in ("", "cmd_"))
        q = np.array([got[name][n] for name in legs_])
        np.testing.assert_allclose(legs(true, wanted), q, atol=1e-8)
        np.testing.assert_allclose(legs(true.nominal(), command), q, atol=1e-8)
    assert all(np.all((got[q] >= 200) & (got[q] <= 700)) for q in legs_)


@pytest.mark.slow
def test_a_machine_as_drawn_is_told_what_is_wanted(tmp_path: Path) -> None:
    run = ppmcal("export", "grid", CONFIGS / "delta-linear.yaml", "--json", "--out",
                 tmp_path / "o", expect=0)
    got = table(tmp_path / "o")
    for name in "xyz":
        np.testing.assert_allclose(got[f"cmd_{name}"], got[name], atol=1e-8)
    assert run.json["gain"]["before"]["max"] < 1e-7 > run.json["gain"]["after"]["max"]


@pytest.mark.slow
def test_a_machine_with_fewer_drives_is_commanded_in_what_they_move(tmp_path: Path) -> None:
    machine = identified("3-RPS")
    assert [("x", "y", "z", "rx", "ry", "rz")[c] for c in named(machine)] == ["z", "rx", "ry"]
    run = ppmcal("export", "grid", written(tmp_path, machine), "--json", "--out", tmp_path / "o",
                 expect=0)
    assert list(run.json["grid"]) == ["z", "rx", "ry"]
    assert any("x, y, rz follow" in n for n in run.json["notes"])
    assert np.ptp(table(tmp_path / "o")["x"]) > 0.1    # parasitic, and in the table


# ---------------------------------------------------------------- effects

@pytest.mark.slow
def test_effects_of_state_are_taken_at_rest_and_listed(tmp_path: Path) -> None:
    effects = [{"kind": "gain", "parameters": {"gain": 0.001}},
               {"kind": "backlash", "parameters": {"width": 0.05}},
               {"kind": "compliance", "parameters": {"stiffness": 500}},
               {"kind": "leg_thermal", "parameters": {"expansion": 1e-5}},
               {"kind": "tilt", "parameters": {"shrink": 1e-4, "direction": 20}}]
    path = edited(tmp_path, effects=effects)
    found = ppmcal("export", "grid", path, "--json", "--out", tmp_path / "o", expect=1).json
    what = [lack["what"].split(",")[0] for lack in found["not_expressed"]]
    assert what == ["effect backlash", "effect compliance", "effect leg_thermal"]
    assert all(lack["cost"] is None for lack in found["not_expressed"])
    assert any("tilt belongs to the instrument" in n for n in found["notes"])
    got = table(tmp_path / "o")
    drawn = read_mechanism(CONFIGS / "3-RPR.yaml")
    at = np.array([got["x"][5], got["y"][5], 0, 0, 0, np.radians(got["rz"][5])])
    np.testing.assert_allclose([got[f"q_leg{i}"][5] for i in (1, 2, 3)],
                               legs(drawn, at) / 1.001, atol=1e-8)
    assert found["gain"]["before"]["rms"] > 100 * found["gain"]["after"]["rms"]


# ---------------------------------------------------------------- lists of poses

@pytest.mark.slow
def test_a_list_is_corrected_at_its_poses_only(tmp_path: Path) -> None:
    path = written(tmp_path, identified("3-RPR"))
    write_csv(tmp_path / "p.csv", [{"x": 500, "y": 290, "rz": 30, "dir_leg1": 1},
                                   {"x": 520, "y": 280, "rz": 25, "dir_leg1": 1},
                                   {"x": 900, "y": 280, "rz": 25, "dir_leg1": 1},
                                   {"x": 1e5, "y": 280, "rz": 25, "dir_leg1": -1}])
    run = ppmcal("export", "grid", path, "--poses", tmp_path / "p.csv", "--json", "--out",
                 tmp_path / "o", expect=1)
    found = run.json
    got = table(tmp_path / "o")
    assert got["x"].tolist() == pytest.approx([500, 520]) and found["rows"] == 2
    assert sum(found["left_out"].values()) == 2 and "grid" not in found
    words = " ".join(found["notes"])
    assert "2 of 4 poses, left out" in found["not_expressed"][0]["what"]
    assert "nothing is predicted" in words
    assert "dir_leg1 are not used" in words and "ppmcal compensate" in words
    assert found["gain"]["after"]["max"] < 1e-8 < 0.1 < found["gain"]["before"]["max"]
    same = corrected(read_mechanism(path), np.array([[0.5, 0.29, 0, 0, 0, np.radians(30)]]))
    assert got["cmd_x"][0] == pytest.approx(1e3 * same.command[0, 0], abs=1e-12)
    told = ppmcal("export", "grid", path, "--poses", tmp_path / "p.csv", cwd=tmp_path, expect=1)
    assert "poses themselves, none in between" in " ".join(told.out.split())


def test_wanted_turns_beyond_half_a_turn_keep_their_way_of_counting(tmp_path: Path) -> None:
    """A machine about 180 degrees: commands are 179.9 or 180.1, never -179.9."""
    whole = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text())
    for limb, angle in zip(whole["limbs"], (60, 180, 300), strict=True):
        limb["platform"]["point"]["angle"]["value"] = angle
        limb["offset"] = {"value": 0.4, "nominal": 0.0}
    whole["home"]["pose"]["rz"] = 180
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(whole))
    write_csv(tmp_path / "p.csv", [{"x": 495 + a, "y": 285, "rz": 180 + a}
                                   for a in (-0.05, -0.01, 0.0, 0.01, 0.05)])
    ppmcal("export", "grid", "m.yaml", "--poses", "p.csv", "--out", "o", cwd=tmp_path, expect=0)
    got = table(tmp_path / "o")
    assert np.abs(got["cmd_rz"] - got["rz"]).max() < 1.0


@pytest.mark.slow
def test_lists_that_lead_nowhere_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, identified("3-RPR"))
    write_csv(tmp_path / "p.csv", [{"x": 5000, "y": 290, "rz": 30}])
    run = ppmcal("export", "grid", path, "--poses", "p.csv", cwd=tmp_path, expect=3)
    assert "none of the 1 poses" in run.err and "p.csv" in run.err
    for text, words in (("x,y\n1,2\n", ["rz"]), ("", ["empty"]), ("x,y,rz\n1,2\n", ["row 1"]),
                        ("x,y,rz\n1,a,3\n", ["row 1", "column y"]), ("a\n1\n", ["pose column"])):
        (tmp_path / "p.csv").write_text(text)
        run = ppmcal("export", "grid", path, "--poses", "p.csv", cwd=tmp_path, expect=2)
        assert "p.csv" in run.err and all(w in run.err for w in words), run.err
        assert "Traceback" not in run.err
    run = ppmcal("export", "grid", path, "--poses", "q.csv", cwd=tmp_path, expect=2)
    assert "q.csv" in run.err and sorted(tree(tmp_path)) == ["m.yaml", "p.csv"]


# ---------------------------------------------------------------- refusals

@pytest.mark.slow
def test_bad_options_and_machines_are_refused(tmp_path: Path) -> None:
    path = edited(tmp_path)
    run = ppmcal("export", "grid", path, "--old", path, cwd=tmp_path, expect=2)
    assert "--old" in run.err and "nominal geometry" in run.err
    assert "Did you mean 'grid'?" in ppmcal("export", "gird", path, cwd=tmp_path, expect=2).err
    path = edited(tmp_path, limits={"leg1": [200, 700], "leg2": [200, 700]})
    run = ppmcal("export", "grid", path, cwd=tmp_path, expect=2)
    assert "leg3 has no limits" in run.err and "--poses" in run.err
    path = edited(tmp_path, limits={f"leg{i}": [200, 210] for i in (1, 2, 3)})
    run = ppmcal("export", "grid", path, cwd=tmp_path, expect=3)
    assert "hardly any pose" in run.err and "limits" in run.err
    path.write_text("format: ppmcal/mechanism/1\nlimbs: [")
    run = ppmcal("export", "grid", path, cwd=tmp_path, expect=2)
    assert "m.yaml" in run.err and "fault of ppmcal" not in run.err


def test_rows_without_a_command_are_left_out_and_counted() -> None:
    """Cells with such a corner are not interpolated."""
    grid = Grid((0, 1), (np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0])))
    wanted = np.zeros((6, 6))
    command = np.ones((6, 6))
    command[4] = np.nan
    found = Corrected(wanted, command, np.zeros((6, 2)), np.isfinite(command[:, 0]), {"x": 1})
    got = interpolated(grid, found, np.array([[0.5, 0.5], [1.5, 0.5]]))
    np.testing.assert_allclose(got[0], 1.0)
    assert np.isnan(got[1]).all()


# ---------------------------------------------------------------- laws

@settings(max_examples=40, deadline=None)
@given(st.integers(1, 4), st.integers(0, 2**31))
def test_what_is_linear_in_each_coordinate_is_exact(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels = tuple(np.cumsum(rng.uniform(0.1, 1.0, rng.integers(2, 5))) for _ in range(count))
    grid = Grid(tuple(range(count)), levels)
    weights = rng.normal(size=(2,) * count)

    def law(x: np.ndarray) -> np.ndarray:
        out = np.broadcast_to(weights, (len(x), *weights.shape))
        for i in range(count):
            out = out[:, 0] + x[:, i].reshape(-1, *[1] * (count - 1 - i)) * out[:, 1]
        return out

    at = np.stack([a.ravel() for a in np.meshgrid(*levels, indexing="ij")], axis=-1)
    wanted = np.zeros((len(at), 6))
    command = np.tile(law(at)[:, None], (1, 6))
    found = Corrected(wanted, command, np.zeros((len(at), 1)), np.ones(len(at), bool), {})
    tried = grid.inside(20, rng)
    np.testing.assert_allclose(interpolated(grid, found, tried)[:, 2], law(tried), atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3),
       st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3))
def test_the_nearer_rotation_vector_is_the_same_turn(turn: list[float], by: list[float]) -> None:
    to = np.concatenate([np.zeros(3), turn])[None]
    short = Rotation.from_rotvec(np.add(turn, by)).as_rotvec()
    found = nearest_rotations(np.concatenate([np.ones(3), short])[None], to)[0, 3:]
    same = Rotation.from_rotvec(found) * Rotation.from_rotvec(short).inv()
    assert same.magnitude() < 1e-7
    assert np.linalg.norm(found - turn) <= np.linalg.norm(short - turn) + 1e-12


@pytest.mark.slow
def test_the_default_grid_is_inside_limits_of_the_drawing() -> None:
    for name in ("3-RPR", "6-UPS"):
        machine = read_mechanism(CONFIGS / f"{name}.yaml")
        grid = default_grid(machine)
        low, high = machine.limits.T * 1e3
        for pose in grid.poses(machine)[::7]:
            mm = np.nan_to_num(pose * [1e3, 1e3, 1e3, 1, 1, 1])
            assert np.all((legs(machine, mm) >= low - 1e-6) & (legs(machine, mm) <= high + 1e-6))
        home = machine.home_pose[list(grid.coordinates)]
        assert all(lv[0] < h < lv[-1] for lv, h in zip(grid.levels, home, strict=True))
