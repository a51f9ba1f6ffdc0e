"""Tables of poses and joints in other units, dialects and files hold the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.commands import ppmcal as run
from helpers.commands import rows

import ppmcal
from ppmcal.errors import BadInput
from ppmcal.io import read_joints, read_poses
from ppmcal.io.tables import as_table

HEXAPOD = ppmcal.load(ppmcal.shipped("6-UPS"))
POSES = np.array([[10.5, -3.25, 2000.125, 1.5, -2.0, 0.75], [0.0, 4.5, 1990.0, 0.0, 1.0, -3.0]])
HEADER = ["x", "y", "z", "rx", "ry", "rz"]


def lines(header: list[str], cells: np.ndarray, separator: str = ",", mark: str = ".") -> str:
    body = [separator.join(repr(float(v)).replace(".", mark) for v in row) for row in cells]
    return "\n".join([separator.join(header), *body]) + "\n"


@pytest.mark.parametrize(("separator", "mark"), [(",", "."), (";", ","), ("\t", ","), (";", ".")])
@pytest.mark.parametrize("bom", ["", "\ufeff", "sep={}\n"])
def test_dialects_are_one_table(tmp_path: Path, separator: str, mark: str, bom: str) -> None:
    path = tmp_path / "p.csv"
    path.write_text(bom.format(separator) + lines(HEADER, POSES, separator, mark), encoding="utf-8")
    (tmp_path / "plain.csv").write_text(lines(HEADER, POSES))
    one, two = (read_poses(p, HEXAPOD) for p in (path, tmp_path / "plain.csv"))
    assert one.poses.tobytes() == two.poses.tobytes() and one.given[0] == two.given[0]


def test_units_in_headers_are_converted_and_repeated_in_the_machine_s(tmp_path: Path) -> None:
    other = POSES * [1e-3, 1e3, 1.0, np.pi / 180, 1.0, 1.0]
    header = ["x [m]", "y (um)", "z [mm]", "rx [rad]", "ry [°]", "rz"]
    (tmp_path / "p.csv").write_text(lines(header, other))
    table = read_poses(tmp_path / "p.csv", HEXAPOD)
    (tmp_path / "plain.csv").write_text(lines(HEADER, POSES))
    np.testing.assert_allclose(table.poses, read_poses(tmp_path / "plain.csv", HEXAPOD).poses,
                               rtol=1e-14)
    assert list(table.given[0]) == HEADER
    np.testing.assert_allclose(np.stack(table.given[1], axis=1), POSES, rtol=1e-14)
    run("kinematics", "inverse", ppmcal.shipped("6-UPS"), "p.csv", "--out", "k", cwd=tmp_path)
    found = rows(tmp_path / "k" / "kinematics.csv")
    assert float(found[0]["x"]) == pytest.approx(10.5)


def test_units_of_joints_twists_and_euler_angles(tmp_path: Path) -> None:
    q = np.arange(2000.0, 2012.0).reshape(2, 6)
    names = [f"q_leg{i}" for i in range(1, 7)]
    (tmp_path / "j.csv").write_text(lines([f"{n} [in]" for n in names[:1]] + names[1:], q))
    assert read_joints(tmp_path / "j.csv", HEXAPOD).q[0, 0] == pytest.approx(2000 * 0.0254)
    (tmp_path / "p.csv").write_text("x,y,z,euler_1 [rad],euler_2,euler_3,vx [m/s],remark (in)\n"
                                    "1,2,2000,0.1,0,0,0.5,fine\n")
    table = read_poses(tmp_path / "p.csv", HEXAPOD, "euler-xyz")
    assert table.poses[0, 3] == pytest.approx(0.1)
    assert table.extra["vx"][0] == pytest.approx(500.0)
    assert table.extra["remark (in)"] == ("fine",)


@pytest.mark.parametrize("suffix", ["xlsx", "parquet"])
def test_spreadsheets_and_parquet(tmp_path: Path, suffix: str) -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(POSES, columns=["x [mm]", *HEADER[1:]])
    path = tmp_path / f"p.{suffix}"
    if suffix == "xlsx":
        pytest.importorskip("openpyxl")
        frame.to_excel(path, index=False)
    else:
        pytest.importorskip("pyarrow")
        frame.to_parquet(path)
    assert read_poses(path, HEXAPOD).poses[1, 2] == pytest.approx(1.99)


@pytest.mark.parametrize(("header", "says"), [
    ("x [furlong],y,z,rx,ry,rz", "unknown unit 'furlong'"),
    ("x [deg],y,z,rx,ry,rz", "x cannot be in deg"),
    ("x [mm],x (m),z,rx,ry,rz", "two columns are called 'x'"),
    ("x,y,z,rx [counts],ry,rz", "rx is in counts")])
def test_units_that_cannot_be_are_refused(tmp_path: Path, header: str, says: str) -> None:
    (tmp_path / "p.csv").write_text(f"{header}\n1,2,3,4,5,6\n")
    with pytest.raises(BadInput) as refused:
        read_poses(tmp_path / "p.csv", HEXAPOD)
    assert says in str(refused.value) and "p.csv: header" in str(refused.value)


def test_words_in_memory_are_the_numbers_that_they_are_in_a_csv() -> None:
    """To Python 1_10 and 11_0 are the same number, and two poses would be one."""
    words = ["1_10", "11_0", "\u0663", "infinity"]
    table = as_table({"pose": words, "x": [" 1.5 ", "+2", "nan", 3]}, loose={"pose"}.__contains__)
    assert table.text == {"pose": tuple(words)}
    np.testing.assert_array_equal(table.numbers["x"], [1.5, 2.0, np.nan, 3.0])
    with pytest.raises(BadInput, match="row 1, column x"):
        as_table({"x": ["1_0", 5]}, (), "t", lambda name: False)
