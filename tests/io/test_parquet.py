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
    table = read_table(path, loose={"name"}.__contains__)
    np.testing.assert_array_equal(table.numbers["x"], [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(table.numbers["y"], [1.5, 2.5, np.nan])
    assert table.text["name"] == ("a", "b", "")


@pytest.mark.parametrize(("cells", "place", "what"), [
    ({"x": [1.0, 2.0], "y": ["1", "two"]}, "row 2, column y", "'two' is not a number"),
    ({"x": [1.0, 1e18]}, "row 2, column x", "out of range"),
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


def test_one_long_word_in_the_dictionary_of_many_rows_is_refused_before_it_is_unpacked(
        tmp_path: Path) -> None:
    held = pyarrow.DictionaryArray.from_arrays(np.zeros(10_000, dtype=np.int32), ["x" * 150_000])
    path = written(tmp_path, x=np.zeros(10_000), note=held)
    assert path.stat().st_size < 20_000
    before = pyarrow.total_allocated_bytes()
    with pytest.raises(BadInput, match="when unpacked"):
        read_table(path, loose={"note"}.__contains__)
    assert pyarrow.total_allocated_bytes() - before < 10_000_000


@pytest.mark.parametrize(("column", "what"), [
    (["x" * 300_000] * 2, "letters in one cell"),
    (["x" * 250_000, *["y"] * 9], "letters in one cell"),
    ([[1.0, 2.0], [3.0]], "several values in a row"),
    ([{"a": 1.0}, {"a": 2.0}], "several values in a row")])
def test_cells_that_no_table_has_are_refused(tmp_path: Path, column: list[object],
                                             what: str) -> None:
    path = written(tmp_path, x=[1.0] * len(column), note=column)
    with pytest.raises(BadInput, match=what):
        read_table(path, loose={"note"}.__contains__)


def test_a_long_word_for_a_number_is_told_in_part(tmp_path: Path) -> None:
    with pytest.raises(BadInput) as refused:
        read_table(written(tmp_path, x=["y" * 150_000, "z"]))
    assert len(str(refused.value)) < 1000


def test_words_of_a_dictionary_are_read_as_they_stand(tmp_path: Path) -> None:
    words = ["b", None, "a", "b", " c"] * 300
    path = written(tmp_path, x=np.arange(1500.0), note=pyarrow.array(words).dictionary_encode())
    found = read_table(path, loose={"note"}.__contains__).text["note"]
    assert found == tuple(w or "" for w in words)


def test_names_that_are_no_utf8_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, x=[1.0, 2.0], note=["a", "b"])
    path.write_bytes(path.read_bytes().replace(b"note", b"n\xe1te"))
    with pytest.raises(BadInput, match="cannot be read as Parquet"):
        read_table(path, loose={"note"}.__contains__)
