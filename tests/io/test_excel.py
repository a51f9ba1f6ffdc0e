"""A spreadsheet says the same as the CSV with the same numbers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import ppmcal
from ppmcal.errors import BadInput
from ppmcal.io import read_dataset, read_table

openpyxl = pytest.importorskip("openpyxl", reason="reads and writes spreadsheets")


def written(path: Path, rows: list[list[Any]], title: str = "Data", before: str = "") -> Path:
    book = openpyxl.Workbook()
    book.remove(book.active)
    if before:
        book.create_sheet(before).append(["nothing", "here"])
    sheet = book.create_sheet(title)
    for row in rows:
        sheet.append(row)
    book.save(path)
    return path


def cells(path: Path) -> list[list[Any]]:
    table = read_table(path)
    return [list(table.header), *np.column_stack([table.numbers[h] for h in table.header]).tolist()]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    ppmcal.simulate(ppmcal.shipped("3-RPR"), ppmcal.shipped("3-RPR", True)).save(tmp_path)
    return tmp_path


def test_measurements_are_the_same_from_either(folder: Path) -> None:
    machine = ppmcal.load(ppmcal.shipped("3-RPR"))
    rows = cells(folder / "measurements.csv")
    rows[0] = [f"{h} [mm]" if h == "q_leg1" else h for h in rows[0]]
    written(folder / "measurements.xlsx", rows)
    one = read_dataset(folder / "measurements.csv", machine)
    two = read_dataset(folder / "measurements.xlsx", machine)
    for name in ("q", "position", "rotation", "groups", "sigma_position"):
        # openpyxl writes 16 digits
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-15)
    (folder / "measurements.csv").unlink()
    np.testing.assert_array_equal(read_dataset(folder / "measurements.yaml", machine).q, two.q)


def test_the_sidecar_names_the_sheet(folder: Path) -> None:
    machine = ppmcal.load(ppmcal.shipped("3-RPR"))
    rows = cells(folder / "measurements.csv")
    path = written(folder / "measurements.xlsx", rows, "Run 2", before="Notes")
    side = folder / "measurements.yaml"
    content = yaml.safe_load(side.read_text())
    side.write_text(yaml.safe_dump({**content, "read": {"sheet": "Run 2"}}))
    assert len(read_dataset(path, machine)) == len(rows) - 1
    with pytest.raises(BadInput, match="no sheet 'Run 2'"):
        read_dataset(folder / "measurements.csv", machine)
    side.write_text(yaml.safe_dump({**content, "read": {"sheet": "Run 3"}}))
    with pytest.raises(BadInput, match=r"unknown sheet 'Run 3'.*Notes, Run 2"):
        read_dataset(path, machine)


def test_words_empty_cells_and_blank_rows(tmp_path: Path) -> None:
    path = written(tmp_path / "d.xlsx", [[None], ["x", "name", " y "], [1, "a", 1.5], [],
                                         [None, 7, "2.5"]])
    table = read_table(path, loose={"name"}.__contains__)
    np.testing.assert_array_equal(table.numbers["x"], [1.0, np.nan])
    np.testing.assert_array_equal(table.numbers["y"], [1.5, 2.5])
    assert table.text["name"] == ("a", "7")


@pytest.mark.parametrize(("rows", "says"), [
    ([["x", "y"], [1, "two"]], ["row 1, column y", "'two' is not a number"]),
    ([["x", "y"], [1, "#DIV/0!"]], ["row 1, column y", "#DIV/0!"]),
    ([["x", "x"], [1, 2]], ["header", "two columns are called 'x'"]),
    ([["x", None], [1, 2]], ["header", "column 2 has no name"]),
    ([[1.5, 2.5], [1, 2]], ["header", "numbers, not column names"]),
    ([["x"]], ["no rows"]), ([], ["the sheet is empty"]),
    ([["x"], [1e18]], ["row 1", "out of range"])])
def test_what_is_wrong_is_told_with_its_place(tmp_path: Path, rows: list[list[Any]],
                                              says: list[str]) -> None:
    path = written(tmp_path / "d.xlsx", rows)
    with pytest.raises(BadInput) as refused:
        read_table(path)
    for words in (str(path), *says):
        assert words in str(refused.value)


def test_a_damaged_file_and_any_other_zip_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "d.xlsx", [["x"], [1.0]])
    whole = path.read_bytes()
    other = whole.replace(b"worksheets", b"wrksheetss")
    for data in (whole[:200], whole[:-40], b"PK\x03\x04", other):
        path.write_bytes(data)
        with pytest.raises(BadInput, match="cannot be read as a spreadsheet"):
            read_table(path)


def test_without_openpyxl_the_command_to_install_it_is_named(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "d.xlsx", [["x"], [1.0]])
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(BadInput, match=r"pip install 'ppmcal\[excel\]'"):
        read_table(path)
