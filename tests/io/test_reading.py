"""The sidecar's block `read`: each key reads as the rewritten CSV; each refusal says where."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.mistakes import MACHINE, Row, inverse, scaled, session, swapped, turned
from scipy.spatial.transform import Rotation

import ppmcal
from ppmcal.commands.inputs import load, shipped
from ppmcal.errors import BadInput
from ppmcal.io.dataset_reader import read_dataset
from ppmcal.kinematics.rotations import ORDERS
from ppmcal.model.dataset import STANDARD_GRAVITY, Dataset
from ppmcal.model.mechanism import Mechanism

LEGS = tuple(f"q_leg{i}" for i in range(1, 7))
TURNS = ("rx", "ry", "rz")
QUATERNION = ("quat_x", "quat_y", "quat_z", "quat_w")
MATRIX = tuple(f"r{i}{j}" for i in "123" for j in "123")
Change = Callable[[list[Row]], None]


def with_read(path: Path, read: Mapping[str, Any]) -> Path:
    """Add a block `read` to the sidecar of a CSV."""
    side = path.with_suffix(".yaml")
    content = yaml.safe_load(side.read_text(encoding="utf-8"))
    side.write_text(yaml.safe_dump({**content, "read": dict(read)}), encoding="utf-8")
    return path


def conditions(rows: list[Row]) -> None:
    """Add what the sample does not record: temperature, payload, forces, velocity."""
    for n, row in enumerate(rows):
        row |= {"temperature": 18.0 + 0.1 * n, "payload": 0.5 * (n % 4), "fx": 1.0 + n,
                "vel_leg1": 3.0 - 0.1 * n}


def renamed(names: Mapping[str, str]) -> Change:
    """Give columns other headers."""
    def change(rows: list[Row]) -> None:
        for n, row in enumerate(rows):
            rows[n] = {names.get(k, k): v for k, v in row.items()}
    return change


def moved(name: str, factor: float, plus: float = 0.0) -> Change:
    def change(rows: list[Row]) -> None:
        for row in rows:
            row[name] = factor * float(row[name]) + plus
    return change


def rotations(names: tuple[str, ...], how: Callable[[Rotation], Any]) -> Change:
    """Write the rotations under other names, as ``how`` gives them."""
    def change(rows: list[Row]) -> None:
        for row in rows:
            turn = Rotation.from_rotvec([float(row.pop(k)) for k in TURNS], degrees=True)
            row.update(zip(names, np.ravel(how(turn)).tolist(), strict=True))
    return change


def mirrored(rows: list[Row]) -> None:
    """The poses of an instrument whose z axis points the other way."""
    for row in rows:
        row.update({k: -float(row[k]) for k in ("z", "rx", "ry")})


def added(rows: list[Row]) -> None:
    for n, row in enumerate(rows):
        row["operator's note"] = n


SAME: dict[str, tuple[Change, Mapping[str, Any]]] = {
    "columns": (renamed({"q_leg3": "Leg 3 encoder", "x": "X [mm]"}),
                {"columns": {"q_leg3": "Leg 3 encoder", "x": "X [mm]"}}),
    "columns exchanged": (swapped, {"columns": {"q_leg2": "q_leg3", "q_leg3": "q_leg2"}}),
    "ignore": (added, {"ignore": ["operator's note"]}),
    "units of joints": (scaled(("q_leg1", "q_leg4"), 1.0 / 25.4),
                        {"units": {"q_leg1": "in", "q_leg4": "in"}}),
    "units by pattern": (scaled(LEGS, 1e-3), {"units": {"q_*": "m"}}),
    "units of positions": (scaled(("x", "y", "z"), 1e3), {"units": dict.fromkeys("xyz", "um")}),
    "units of angles": (scaled(TURNS, np.pi / 180.0), {"units": dict.fromkeys(TURNS, "rad")}),
    "turns": (scaled(TURNS, 1.0 / 360.0), {"units": dict.fromkeys(TURNS, "turn")}),
    "velocity": (scaled(("vel_leg1",), 1e-3), {"units": {"vel_leg1": "m"}}),
    "Fahrenheit": (moved("temperature", 1.8, 32.0), {"units": {"temperature": "F"}}),
    "Kelvin": (moved("temperature", 1.0, 273.15), {"units": {"temperature": "K"}}),
    "grams": (moved("payload", 1e3), {"units": {"payload": "g"}}),
    "pounds": (moved("payload", 1.0 / 0.45359237), {"units": {"payload": "lb"}}),
    "payload in newton": (moved("payload", STANDARD_GRAVITY), {"units": {"payload": "N"}}),
    "kilonewton": (moved("fx", 1e-3), {"units": {"fx": "kN"}}),
    "minutes": (moved("time", 1.0 / 60.0), {"units": {"time": "min"}}),
    "signs": (scaled(("q_leg2", "rz"), -1.0), {"signs": {"q_leg2": -1, "rz": -1}}),
    "signs by pattern": (scaled(LEGS, -1.0), {"signs": {"q_*": -1}}),
    "rotation vector": (lambda rows: None, {"rotation": "rotvec"}),
    "quaternion": (rotations(QUATERNION, lambda r: r.as_quat()), {"rotation": "quat-xyzw"}),
    "quaternion, w first": (rotations(QUATERNION, lambda r: np.roll(r.as_quat(), 1)),
                            {"rotation": "quat-wxyz"}),
    "quaternion of length 2": (rotations(QUATERNION, lambda r: 2.0 * r.as_quat()),
                               {"rotation": "quat-xyzw"}),
    "matrix": (rotations(MATRIX, lambda r: r.as_matrix()), {"rotation": "matrix"}),
    **{f"euler-{order}": (
        lambda rows, o=order: turned(rows, lambda r: r.as_euler(o, degrees=True)),
        {"rotation": f"euler-{order}"}) for order in ORDERS},
    "inverse": (inverse, {"pose": "inverse"}),
    "mirror": (mirrored, {"mirror": "z"}),
    "columns, signs and units": (
        lambda rows: (swapped(rows), scaled(("q_leg2",), -1e-3)(rows))[0],
        {"columns": {"q_leg2": "q_leg3", "q_leg3": "q_leg2"}, "signs": {"q_leg3": -1},
         "units": {"q_leg3": "m"}}),
    "inverse and Euler angles": (
        lambda rows: (inverse(rows), turned(rows, lambda r: r.as_euler("XYZ", degrees=True)))[0],
        {"pose": "inverse", "rotation": "euler-XYZ"}),
    "quaternion with an inverse pose": (
        lambda rows: (inverse(rows), rotations(QUATERNION, lambda r: r.as_quat())(rows))[0],
        {"pose": "inverse", "rotation": "quat-xyzw"}),
}


@pytest.fixture(scope="module")
def machine() -> Mechanism:
    return load(MACHINE)


def same(one: Dataset, other: Dataset) -> None:
    """Whether two data sets hold the same measurements."""
    for name in ("rows", "q", "position", "sigma_position", "sigma_rotation", "groups"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-11,
                                   atol=1e-11, err_msg=name)
    matrices = [Rotation.from_rotvec(d.rotation).as_matrix() for d in (one, other)]
    np.testing.assert_allclose(*matrices, atol=1e-11)
    assert set(one.columns) == set(other.columns)
    for name in one.columns:
        np.testing.assert_allclose(one.columns[name], other.columns[name], rtol=1e-11,
                                   atol=1e-11, err_msg=name)


@pytest.mark.parametrize("name", SAME)
def test_a_file_read_through_the_block_is_the_rewritten_file(tmp_path: Path, machine: Mechanism,
                                                             name: str) -> None:
    change, read = SAME[name]

    def written_otherwise(rows: list[Row]) -> None:
        conditions(rows)
        change(rows)

    right = read_dataset(session(tmp_path / "right", conditions), machine)
    other = read_dataset(with_read(session(tmp_path / "other", written_otherwise), read), machine)
    same(other, right)


def test_rows_are_shifted_and_keep_their_numbers(tmp_path: Path, machine: Mechanism) -> None:
    right = read_dataset(session(tmp_path / "right"), machine)
    names = ("x", "y", "z", *TURNS)

    def late(rows: list[Row]) -> None:
        old = [[row[n] for n in names] for row in rows]
        for row, values in zip(rows[2:], old, strict=False):
            row.update(zip(names, values, strict=True))

    read = read_dataset(with_read(session(tmp_path / "late", late), {"shift": 2}), machine)
    n = len(right) - 2
    assert read.rows.tolist() == list(range(1, n + 1))
    same(read, right.take(np.arange(n)))


def test_rows_ahead_keep_the_numbers_of_their_joints(tmp_path: Path, machine: Mechanism) -> None:
    right = read_dataset(session(tmp_path / "right"), machine)
    ahead = read_dataset(with_read(session(tmp_path / "a"), {"shift": -1}), machine)
    assert ahead.rows.tolist() == list(range(2, len(right) + 1))
    np.testing.assert_array_equal(ahead.q, right.q[1:])
    np.testing.assert_array_equal(ahead.position, right.position[:-1])


def test_counts_of_a_drive(tmp_path: Path) -> None:
    """Counts of a rotary drive: 4096 in a turn, the numbers of the file over them."""
    machine = load(shipped("3-RRR-1"))
    names = [f"q_{a}" for a in machine.actuators]
    path = tmp_path / "run.csv"
    values = np.random.default_rng(3).integers(-900, 900, (6, 6))
    path.write_text("\n".join([",".join([*names, "x", "y", "rz"]),
                               *(",".join(map(str, row)) for row in values)]), encoding="utf-8")
    write_sidecar(path, {"units": {"q_*": "counts"}, "counts_per_turn": 4096})
    np.testing.assert_allclose(read_dataset(path, machine).q,
                               values[:, :3] / 4096 * 2.0 * np.pi, rtol=1e-12)


def write_sidecar(path: Path, read: Mapping[str, Any]) -> None:
    path.with_suffix(".yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.002}},
        "frame": "unknown", "target": "unknown", "read": dict(read)}), encoding="utf-8")


def test_foreign_layouts_take_columns_of_their_own(tmp_path: Path, machine: Mechanism) -> None:
    """A layout known by its header, one column of it under a name of the user's."""
    foreign = {"x": "x1", "y": "y1", "z": "z1", "rx": "phix1", "ry": "phiy1", "rz": "phiz1",
               **{n: n.removeprefix("q_") for n in LEGS}}

    def layout(rows: list[Row]) -> None:
        for n, row in enumerate(rows):
            rows[n] = {foreign[k]: row[k] for k in foreign}

    def own(rows: list[Row]) -> None:
        layout(rows)
        renamed({"leg3": "Leg 3 encoder"})(rows)

    plain = read_dataset(session(tmp_path / "plain", layout), machine)
    read = read_dataset(with_read(session(tmp_path / "own", own),
                                  {"columns": {"q_leg3": "Leg 3 encoder"}}), machine)
    same(read, plain)


# --- refusals -------------------------------------------------------------------------------------

REFUSED: dict[str, tuple[Mapping[str, Any], str, str, str]] = {
    "unknown header": ({"columns": {"q_leg2": "Leg 2 encodr"}}, "no column 'Leg 2 encodr'",
                       "read.columns.q_leg2", "Its columns are"),
    "unknown column of ours": ({"columns": {"q_leg9": "q_leg2"}}, "unknown column 'q_leg9'",
                               "read.columns", "q_leg"),
    "one header for two of ours": ({"columns": {"q_leg2": "q_leg3", "q_leg3": "q_leg3"}},
                                   "'q_leg3' is given for two", "read.columns",
                                   "Give each column once"),
    "two headers for one column": ({"columns": {"q_leg2": "q_leg3"}},
                                   "'q_leg3' and 'q_leg2' both are q_leg2",
                                   "read.columns.q_leg2", "ignore: [q_leg2]"),
    "nothing to ignore": ({"ignore": ["notes"]}, "no column 'notes'", "read.ignore", "Remove"),
    "a column that is not there": ({"units": {"temperature": "F"}}, "called 'temperature'",
                                   "read.units.temperature", "The columns are"),
    "a sign of no column": ({"signs": {"vel_*": -1}}, "called 'vel_*'", "read.signs.vel_*",
                            "The columns are"),
    "a unit that there is not": ({"units": {"x": "furlong"}}, "furlong", "read.units", "um"),
    "a unit that it cannot be": ({"units": {"x": "deg"}}, "x cannot be in deg", "read.units.x",
                                 "Write m or cm or mm"),
    "a length for an angle": ({"units": {"rx": "in"}}, "rx cannot be in in", "read.units.rx",
                              "rad"),
    "no unit at all": ({"units": {"pose": "mm"}}, "pose", "read.units.pose", "Remove the line"),
    "counts without their turn": ({"units": {"rx": "counts"}}, "counts in a turn are missing",
                                  "read.units.rx", "counts_per_turn: 4096"),
    "a sign of 2": ({"signs": {"x": 2}}, "2 is not a sign", "read.signs", "1 or -1"),
    "a convention of no name": ({"rotation": "euler-xyy"}, "euler-xyy", "read.rotation",
                                "euler-xy"),
    "a convention without columns": ({"rotation": "matrix"}, "missing: r11, r12", "read.rotation",
                                     "Name them under `columns`"),
    "a quaternion without columns": ({"rotation": "quat-wxyz"}, "missing: quat_x", "read.rotation",
                                     "Name them under `columns`"),
    "an axis of no name": ({"mirror": "w"}, "w", "read.mirror", "x"),
    "half a row": ({"shift": 0.5}, "not a number of rows", "read.shift", "whole number"),
    "no counts": ({"counts_per_turn": 0}, "not a number of counts", "read.counts_per_turn",
                  "positive"),
    "no mapping": ({"units": "in"}, "not a mapping", "read.units", "such as"),
    "an unknown key": ({"unit": {"x": "m"}}, "unit", "read", "units"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals_say_what_where_and_how_to_mend(tmp_path: Path, machine: Mechanism, name: str
                                                 ) -> None:
    read, what, where, mend = REFUSED[name]
    with pytest.raises(BadInput) as refused:
        read_dataset(with_read(session(tmp_path), read), machine)
    assert what in refused.value.what
    assert "run." in refused.value.where and where in refused.value.where
    assert mend in refused.value.hint


@pytest.mark.parametrize(("key", "value"), [("pose", "inverse"), ("mirror", "z")])
def test_quaternions_are_turned_round_under_their_convention(
        tmp_path: Path, machine: Mechanism, key: str, value: str) -> None:
    path = session(tmp_path, rotations(QUATERNION, lambda r: r.as_quat()))
    with pytest.raises(BadInput) as refused:
        read_dataset(with_read(path, {key: value}), machine)
    assert f"read.{key}" in refused.value.where
    assert "rotation: quat-xyzw" in refused.value.hint
    with_read(path, {key: value, "rotation": "quat-xyzw"})
    assert np.isfinite(read_dataset(path, machine).rotation).all()


@pytest.mark.parametrize("wrong", [
    lambda m: 1.01 * m, lambda m: m * np.array([1.0, 1.0, -1.0]),
    lambda m: np.where(np.eye(3) > 0, m + 0.1, m)])
def test_a_matrix_that_is_no_rotation_is_refused_with_its_row(
        tmp_path: Path, machine: Mechanism, wrong: Callable[[Any], Any]) -> None:
    path = session(tmp_path, rotations(MATRIX, lambda r: r.as_matrix()))
    lines = path.read_text(encoding="utf-8").splitlines()
    header = lines[0].split(",")
    cells = lines[5].split(",")
    at = [header.index(n) for n in MATRIX]
    matrix = wrong(np.array([float(cells[i]) for i in at]).reshape(3, 3))
    for i, value in zip(at, matrix.ravel().tolist(), strict=True):
        cells[i] = repr(value)
    lines[5] = ",".join(cells)
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(BadInput) as refused:
        read_dataset(with_read(path, {"rotation": "matrix"}), machine)
    assert "the matrix in row 5 is not a rotation" in refused.value.what
    assert str(path) in refused.value.where and "row 5" in refused.value.where
    assert "read.rotation" in refused.value.hint


@pytest.mark.parametrize(("read", "what", "where"), [
    ({"rotation": "euler-xyz"}, "no spatial rotation", "read.rotation"),
    ({"mirror": "z"}, "only x or y", "read.mirror")])
def test_the_plane_has_neither_euler_angles_nor_a_z_axis(
        tmp_path: Path, read: Mapping[str, Any], what: str, where: str) -> None:
    machine = load(shipped("3-RPR"))
    path = tmp_path / "run.csv"
    names = [f"q_{a}" for a in machine.actuators]
    path.write_text(",".join([*names, "x", "y", "rz"]) + "\n300,300,300,1,2,3\n",
                    encoding="utf-8")
    write_sidecar(path, read)
    with pytest.raises(BadInput) as refused:
        read_dataset(path, machine)
    assert what in refused.value.what and where in refused.value.where
    assert "run.yaml" in refused.value.where and refused.value.hint


def test_an_inverse_pose_needs_its_rotation(tmp_path: Path, machine: Mechanism) -> None:
    def points(rows: list[Row]) -> None:
        for row in rows:
            for name in TURNS:
                row.pop(name)

    path = session(tmp_path, points, lambda text: text.replace("kind: pose", "kind: position"))
    with pytest.raises(BadInput) as refused:
        read_dataset(with_read(path, {"pose": "inverse"}), machine)
    assert "missing: rx, ry, rz" in refused.value.what
    assert "run.yaml" in refused.value.where and "read.pose" in refused.value.where


@pytest.mark.parametrize(("letter", "low"), [("m", 0), ("t", 1), ("r", 0), ("T", 0)])
def test_homogeneous_matrices_under_their_usual_names(tmp_path, letter, low):
    """m00 ... m33 hold position and rotation; one that is none is refused with its deviation."""
    def change(rows):
        for row in rows:
            matrix = np.eye(4)
            matrix[:3, 3] = [float(row.pop(a)) for a in "xyz"]
            matrix[:3, :3] = Rotation.from_rotvec(
                [float(row.pop(a)) for a in ("rx", "ry", "rz")], degrees=True).as_matrix()
            row |= {f"{letter}{i + low}{j + low}": repr(float(matrix[i, j]))
                    for i in range(4) for j in range(4)}

    machine = load(MACHINE)
    plain = read_dataset(session(tmp_path / "plain"), machine)
    path = session(tmp_path / "matrix", change)
    side = path.with_suffix(".yaml")
    content = yaml.safe_load(side.read_text())
    side.write_text(yaml.safe_dump({**content, "read": {"rotation": "matrix"}}))
    found = read_dataset(path, machine)
    np.testing.assert_array_equal(found.position, plain.position)
    np.testing.assert_allclose(found.rotation, plain.rotation, atol=1e-13)
    said = ppmcal.read(path, machine).sentences[0]
    last = ", ".join(f"{letter}{low + 3}{low + j}" for j in range(4))
    assert f"Ignored: {last}." in said, "entries that are used are not ignored"
    lines = path.read_text().splitlines()
    place = f"{letter}{low}{low + 3}"
    path.write_text("\n".join([lines[0].replace(place, f"{place} [m]"), *lines[1:]]))
    in_metres = read_dataset(path, machine)
    np.testing.assert_allclose(in_metres.position[:, 0], 1000.0 * plain.position[:, 0], rtol=1e-15)
    np.testing.assert_array_equal(in_metres.position[:, 1:], plain.position[:, 1:])
    name = f"{letter}{low}{low + 1}"
    for column, value, says in ((name, "0.25", r"R R\^T is 0\.\d+ from the unit matrix"),
                                (f"{letter}{low + 3}{low}", "0.5", "last row of the matrix")):
        cells = lines[1].split(",")
        cells[lines[0].split(",").index(column)] = value
        path.write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]))
        with pytest.raises(BadInput, match=says):
            read_dataset(path, machine)


def test_singular_euler_angles_are_one_rotation(tmp_path):
    """In gimbal lock two triples are one rotation, and are read as one."""
    import numpy as np

    from ppmcal.kinematics.pose_readings import understood

    one, two = (understood(np.radians([[a, 90.0, b]]), "euler-ZYX") for a, b in ((30, 10), (20, 0)))
    np.testing.assert_allclose(one, two, atol=1e-7)
