"""A table that ppmcal wrote is read back piece by piece, as it is at once."""

import numpy as np
import pytest

from ppmcal.errors import BadInput
from ppmcal.io.csv import csv_table
from ppmcal.io.results import tables
from ppmcal.io.results.identification_tables import RESIDUAL_TABLE
from ppmcal.store.inputs import current, reading

HEADER = "row,dataset,after_x,used,reason\n"
LONG = '"a, b\n""c"""'
"""A data set whose name has a comma, a line end and quotes."""
LINES = [f"{n},{'run' if n % 13 else LONG},{n / 8},{n % 2},{'' if n % 5 else 'weight 0.5'}\n"
         for n in range(1, 40)]


@pytest.fixture
def path(tmp_path, monkeypatch):
    """Return a table of many pieces."""
    monkeypatch.setattr(tables, "PIECE", 64)
    (tmp_path / "residuals.csv").write_text(HEADER + "".join(LINES))
    return tmp_path / "residuals.csv"


def test_pieces_make_the_table_that_they_are_cut_from(path, monkeypatch):
    held = []
    monkeypatch.setattr(tables, "csv_table", lambda data, *rest: (
        held.append(len(data)), csv_table(data, *rest))[1])
    found = RESIDUAL_TABLE.read(path)
    assert max(held) < len(HEADER) + 3 * 64 and len(held) > 10
    monkeypatch.setattr(tables, "PIECE", 1 << 25)
    whole = RESIDUAL_TABLE.read(path)
    assert len(held) > 11 and max(held) == path.stat().st_size
    assert (found.size, found.header, found.text) == (39, whole.header, whole.text)
    assert found.text["dataset"][-1] == 'a, b\n"c"'
    for name, column in whole.numbers.items():
        np.testing.assert_array_equal(found.numbers[name], column)


def test_some_columns_of_pieces(path):
    kept = RESIDUAL_TABLE.read(path, {"used"}.__contains__)
    assert set(kept.numbers) == {"used"} and not kept.text and kept.size == 39


def test_the_input_is_named_by_its_bytes(path):
    with reading():
        RESIDUAL_TABLE.read(path)
        noted = dict(current().sums)
        path.write_text(path.read_text() + LINES[0])
        with pytest.raises(BadInput, match="changed while ppmcal was at work on it"):
            RESIDUAL_TABLE.read(path)
    assert list(noted) == [str(path)]


@pytest.mark.parametrize(("n", "line", "what"), [
    (36, LINES[36].replace("run", "x,run"), "row 37"),
    (35, LINES[35].replace("36,", "36x,"), "row 36, column row"),
    (37, LINES[37].replace(",0,", ",perhaps,"), "row 38, column used"),
    (38, LINES[38].rstrip("\n"), "is cut off: its last line has no end"),
    (0, LINES[0] + "\xff\n", "row 2")])
def test_a_fault_is_told_with_its_place_in_the_file(path, n, line, what):
    path.write_text(HEADER + "".join([*LINES[:n], line, *LINES[n + 1:]]))
    with pytest.raises(BadInput) as refused:
        RESIDUAL_TABLE.read(path)
    assert what in f"{refused.value.where} {refused.value.what}"


@pytest.mark.parametrize("text", [HEADER + "".join(LINES) + '"', HEADER.rstrip("\n"), ""])
def test_what_is_no_whole_table_is_refused_as_at_once(path, monkeypatch, text):
    path.write_text(text)
    told = []
    for size in (64, 1 << 25):
        monkeypatch.setattr(tables, "PIECE", size)
        with pytest.raises(BadInput) as refused:
            RESIDUAL_TABLE.read(path)
        told.append(str(refused.value))
    assert told[0] == told[1]


@pytest.mark.parametrize("head", ["sep=,\n", "\ufeff"])
def test_what_spreadsheets_put_before_the_header(path, head):
    path.write_text(head + path.read_text(), encoding="utf-8")
    assert RESIDUAL_TABLE.read(path).size == 39


def test_a_header_alone(path):
    path.write_text(HEADER)
    assert RESIDUAL_TABLE.read(path).size == 0
