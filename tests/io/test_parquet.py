"""Parquet tables say the same as the CSV with the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ppmcal
from ppmcal.errors import BadInput
from ppmcal.io import read_dataset, read_table

pyarrow = pytest.importorskip("pyarrow", reason="reads and writes Parquet")
parquet = pytest.importorskip("pyarrow.parquet", reason="reads and writes Parquet")


def written(folder: Path, **columns: object) -> Path:
    path = folder / "data.parquet"
    parquet.write_table(pyarrow.table(dict(columns)), path)
    return path


def test_measurements_are_the_same_from_either(tmp_path: Path) -> None:
    folder = ppmcal.simulate(ppmcal.shipped("3-RPR"), ppmcal.shipped("3-RPR", True)).save(tmp_path)
    table = read_table(tmp_path / "measurements.csv")
    cells = {h: table.numbers[h] for h in table.header}
    parquet.write_table(pyarrow.table(cells), tmp_path / "measurements.parquet")
    machine = ppmcal.load(ppmcal.shipped("3-RPR"))
    one = read_dataset(tmp_path / "measurements.csv", machine)
    two = read_dataset(tmp_path / "measurements.parquet", machine)
    assert folder is not None
    for name in ("q", "position", "rotation", "groups", "sigma_position"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    (tmp_path / "measurements.csv").unlink()
    by_sidecar = read_dataset(tmp_path / "measurements.yaml", machine)
    np.testing.assert_array_equal(by_sidecar.q, one.q)


def test_words_empty_cells_and_whole_numbers(tmp_path: Path) -> None:
    path = written(tmp_path, x=[1, None, 3], name=["a", "b", None], y=[1.5, 2.5, None])
    table = read_table(path, text=("name",))
    np.testing.assert_array_equal(table.numbers["x"], [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(table.numbers["y"], [1.5, 2.5, np.nan])
    assert table.text["name"] == ("a", "b", "")


@pytest.mark.parametrize(("cells", "place", "what"), [
    ({"x": [1.0, 2.0], "y": ["1", "two"]}, "row 2, column y", "'two' is not a number"),
    ({"x": [1.0, 1e18]}, "row 2, column x", "too large"),
    ({"x": []}, "", "no rows")])
def test_what_is_wrong_is_told_with_its_place(tmp_path: Path, cells: dict[str, list[object]],
                                              place: str, what: str) -> None:
    path = written(tmp_path, **cells)
    with pytest.raises(BadInput) as refused:
        read_table(path)
    assert str(path) in str(refused.value)
    assert place in str(refused.value)
    assert what in str(refused.value)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, x=[1.0, 2.0])
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(BadInput, match="cannot be read as Parquet"):
        read_table(path)
