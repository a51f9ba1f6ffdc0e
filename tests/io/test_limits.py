"""What is too large is refused soon, with the limit and the way round it; what is no file, too."""

import io
import json
import os
import re
import socket
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.broken import GOOD
from helpers.commands import ppmcal
from helpers.paths import ROOT

from ppmcal import limits
from ppmcal.errors import BadInput
from ppmcal.io import tables
from ppmcal.io.csv import csv_table
from ppmcal.io.grid import read_grid
from ppmcal.io.json import read_object
from ppmcal.io.mechanism_reader import read_mechanism
from ppmcal.io.results.knowledge import read_knowledge
from ppmcal.io.tables import read_table
from ppmcal.io.yaml import read_yaml
from ppmcal.store import inputs
from ppmcal.store.folder import running
from ppmcal.store.inputs import read_bytes

SOON = 10.0
"""Seconds of processor time: generous, on a slow machine."""
HEAD = "pose,q_leg1,q_leg2,q_leg3,x,y,rz"
ROW = "1,450.1,460.2,470.3,500.1,260.2,25.3\n"
BENCH = read_mechanism(GOOD / "good_bench.yaml")


def refused(call, *said):
    begun = time.process_time()
    with pytest.raises(BadInput) as caught:
        call()
    assert time.process_time() - begun < SOON
    error = caught.value
    assert error.where and error.hint
    for word in said:
        assert word in str(error)
    return str(error)


def table(text, loose=("session",)):
    return lambda: csv_table(text.encode(), "d.csv", loose.__contains__)


TABLES = {
    "1e5 columns": (",".join(f"c{i}" for i in range(100_000)) + "\n" + "1," * 99_999 + "1\n",
                    ["limit", "columns"]),
    "2000 columns": (",".join(f"c{i}" for i in range(2000)) + "\n" + "1," * 1999 + "1\n",
                     ["2,000 columns", "1,000"]),
    "10 MB of commas": ("," * 10_000_000, ["200,000", "line 1"]),
    "a row of commas": (HEAD + "\n" + "," * 10_000_000, ["line 2"]),
    "10 MB of newlines": (HEAD + "\n" * 10_000_000, ["rows", "2,000,000", "Split"]),
    "a number of 10 MB": (HEAD + "\n" + "1" * 10_000_000, ["line 2"]),
    "an open quote": (HEAD + '\n"' + "1\n" * 900_000, ["quotes"]),
    "many rows": (HEAD + "\n" + "1,,,,,,\n" * 2_000_002, ["rows", "Split"]),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_that_is_too_large(name):
    text, said = TABLES[name]
    refused(table(text), *said)


@pytest.mark.slow
@pytest.mark.parametrize("session", ["", ",monday"], ids=["numbers", "words"])
def test_one_word_among_many_rows(session):
    text = HEAD + (",session" if session else "") + "\n"
    text += ROW.replace("\n", session + "\n") * 400_000
    text += ROW.replace("460.2", "word").replace("\n", session + "\n")
    refused(table(text), "row 400001, column q_leg2", "'word'")


def test_many_good_rows_are_read_with_words_beside_them():
    n = 120_000
    text = HEAD + ",session\n" + "".join(
        ROW.replace("\n", f",day {i % 3}\n").replace("450.1", str(i)) for i in range(n))
    made = csv_table(text.encode(), "d.csv", {"session"}.__contains__)
    np.testing.assert_array_equal(made.numbers["q_leg1"], np.arange(n))
    assert made.text["session"][:4] == ("day 0", "day 1", "day 2", "day 0")
    assert len(made) == n


@pytest.mark.parametrize("mark", [",", ";", "\t"])
@pytest.mark.parametrize("words", [["1", "a", "02"], ["1", "", " 3 "], ["é", "x y", "0.5"]])
def test_words_and_numbers_come_out_alike_from_every_part(mark, words, monkeypatch):
    rows = [f"{i}{mark}{words[i % 3]}{mark}{i + 0.5}" for i in range(3000)]
    rows[1500] = f"1500{mark}\"{words[0]}\"{mark}1500.5"    # a quote sends all rows the slow way
    plain = "\n".join([f"a{mark}w{mark}b", *rows]).replace('"', "")
    quoted = "\n".join([f"a{mark}w{mark}b", *rows])
    monkeypatch.setattr("ppmcal.io.csv_body.CHUNK", 2000)
    fast, slow = (csv_table(t.encode(), "d", {"w"}.__contains__) for t in (plain, quoted))
    assert fast.text == slow.text
    assert set(fast.numbers) == set(slow.numbers)
    for name, values in slow.numbers.items():
        np.testing.assert_array_equal(fast.numbers[name], values)


def test_a_cell_of_spaces_is_empty():
    made = csv_table(b"x,y,rz\n1, ,3\n4,5,6\n , ,\n", "d.csv", lambda name: False)
    np.testing.assert_array_equal(made.numbers["y"], [np.nan, 5.0, np.nan])
    np.testing.assert_array_equal(made.numbers["rz"], [3.0, 6.0, np.nan])


@pytest.mark.parametrize("mark", [",", ";"])
def test_spaces_at_either_end_of_a_column_are_no_number(mark):
    """A quote sends the rows the slow way, column by column."""
    rows = [' ', 'w', '"1"'], ['2', ' v ', '3'], ['4', '"u "', ' ']
    data = "\n".join([f"a{mark}w{mark}b", *map(mark.join, rows)]).encode()
    made = csv_table(data, "d.csv", {"w"}.__contains__)
    np.testing.assert_array_equal(made.numbers["a"], [np.nan, 2.0, 4.0])
    np.testing.assert_array_equal(made.numbers["b"], [1.0, 3.0, np.nan])
    assert made.text["w"] == ("w", "v", "u")


YAMLS = {
    "numbers": lambda: "a: [" + "1," * 9_500_000 + "1]",
    "fewer numbers": lambda: "a: [" + "1," * 2_000_000 + "1]",
    "keys": lambda: "".join(f"k{i}: 1\n" for i in range(1_500_000)),
    "fewer keys": lambda: "".join(f"k{i}: 1\n" for i in range(150_000)),
    "laughs": lambda: "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9)),
    "deep": lambda: "[" * 100_000, "deep mappings": lambda: "{a: " * 100_000,
    "deep dashes": lambda: "- " * 100_000, "a circle": lambda: "a: &a [*a]",
}


@pytest.mark.parametrize("name", YAMLS)
def test_a_yaml_file_that_is_too_large(name, tmp_path):
    (tmp_path / "m.yaml").write_text(YAMLS[name]())
    refused(lambda: read_yaml(tmp_path / "m.yaml"), "m.yaml")


def test_endless_numbers_in_yaml(tmp_path):
    path = tmp_path / "m.yaml"
    path.write_text(f"a: {'9' * 100_000}\nb: 1e400\nc: -{'9' * 400}.5\n")
    assert list(read_yaml(path).values()) == [np.inf, np.inf, -np.inf]


JSONS = {
    "deep lists": ('{"a": ' + "[" * 100_000, ["the limit is 40"]),
    "deep but whole": ('{"a": ' + "[" * 500 + "]" * 500 + "}", ["the limit is 40"]),
    "deep mappings": ('{"a": ' * 900 + "1" + "}" * 900, ["the limit is 40"]),
    "a number of 5000 digits": ('{"a": ' + "9" * 5000 + "}", ["5000 digits"]),
    "a number of 299 digits": ('{"rank": ' + "9" * 299 + "}", None),
    "1e400": ('{"a": {"b": [1, 1e400]}}', ["a.b[1]", "finite"]),
    "nan": ('{"a": [NaN]}', ["a[0]", "finite"]),
    "many": ('{"a": [' + "1," * 10_100_000 + "1]}", ["keys and values", "10,000,000"]),
}


@pytest.mark.parametrize("name", JSONS)
def test_a_result_that_is_too_large(name, tmp_path):
    text, said = JSONS[name]
    path = tmp_path / "identification.json"
    path.write_text(text)
    if said is None:
        run = ppmcal("report", tmp_path, "--out", tmp_path / "r", expect=2)
        assert "rank" in run.err
    else:
        refused(lambda: read_object(path), "identification.json", *said)


CIRCLE = ("circle: {center: {x: 500, y: 290, rz: 10}, radius: 80, count: 30, "
          "swing: {rz: 5}}")
SCENARIOS = {
    "count": ("count: 30", "count: 10000000", ["10,000,000 poses", "1,000,000"]),
    "repeats": ("repeats: 1", "repeats: 10000000", ["rows", "2,000,000"]),
    "payloads": ("payload: [0, 20]", f"payload: [{', '.join(['1'] * 50_000)}]", ["rows"]),
    "random": (CIRCLE, "random: {center: {x: 5000, y: 290, rz: 10}, half_range: {x: 9, y: 9, "
               "rz: 5}, count: 450000}", ["none of 5000 random poses", "half_range"]),
    "grid": (CIRCLE,
             "grid: {center: {x: 500, y: 290, rz: 10}, half_range: {x: 9, y: 9, rz: 5}, "
             "counts: {x: 10000000, y: 10000000, rz: 10000000}}", ["over 10^21 poses"]),
}


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.slow_cases("payloads")
def test_a_scenario_that_asks_for_too_much(name, tmp_path):
    old, new, said = SCENARIOS[name]
    text = (GOOD / "good_scenario.yaml").read_text()
    assert old in text
    (tmp_path / "s.yaml").write_text(text.replace(old, new))
    begun = time.process_time()
    run = ppmcal("simulate", GOOD / "good_bench.yaml", "s.yaml", "--out", "o", cwd=tmp_path,
                 expect=2)
    assert time.process_time() - begun < SOON
    for word in said:
        assert word in " ".join(run.err.split())
    assert not (tmp_path / "o").exists()


def test_a_grid_and_a_plan_that_ask_for_too_much(tmp_path):
    refused(lambda: read_grid("x=0:1:10000000,y=0:1:10000000", BENCH), "2,000,000", "fewer")
    ppmcal("plan", GOOD / "good_bench.yaml", "--count", 10 ** 9, "--out", tmp_path / "o", expect=2)


@pytest.fixture
def strange(tmp_path):
    """Paths of what is no file."""
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(tmp_path / "s"))
        yield {"pipe": tmp_path / "pipe.csv", "loop": tmp_path / "loop.csv",
               "socket": tmp_path / "s", "folder": tmp_path, "device": Path("/dev/zero"),
               "name": Path("x" * 5000)}


@pytest.mark.parametrize("what", ["pipe", "loop", "socket", "folder", "device", "name"])
def test_what_is_no_file(what, strange, tmp_path):
    path = strange[what]
    refused(lambda: read_bytes(path))
    for args in (["check", path], ["check", GOOD / "good_bench.yaml", path],
                 ["kinematics", "inverse", GOOD / "good_bench.yaml", path, "--out", tmp_path / "o"],
                 ["import", "klipper", path, "--out", tmp_path / "o"],
                 ["compensate", path, path, "--out", tmp_path / "o"],
                 ["read", path, "--mechanism", GOOD / "good_bench.yaml", "--out",
                  tmp_path / "r.csv"],
                 ["report", path, "--out", tmp_path / "o"]):
        run = ppmcal(*args, expect=2)
        assert run.err.count("Error:") == 1


def test_the_working_folder_is_no_measurement(tmp_path):
    for path in ("", "."):
        ppmcal("check", GOOD / "good_bench.yaml", path, cwd=tmp_path, expect=2)
        ppmcal("read", path, "--mechanism", GOOD / "good_bench.yaml", "--out", "r.csv",
               cwd=tmp_path, expect=2)


def test_a_pipe_in_a_result(tmp_path):
    os.mkfifo(tmp_path / "effects.csv")
    (tmp_path / "diagnosis.json").write_text("{}")
    ppmcal("report", tmp_path, "--out", tmp_path / "r")    # no file, so not there


def test_a_file_that_changes_while_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "d.csv"
    path.write_text("a,b\n1,2\n")
    status, calls = os.fstat, []

    def growing(handle):
        if calls:
            with path.open("a") as more:
                more.write("3,4\n")
        calls.append(handle)
        return status(handle)

    monkeypatch.setattr(inputs.os, "fstat", growing)
    refused(lambda: read_bytes(path), "changed while it was read")


def test_a_file_that_changes_between_two_readings_of_a_run(tmp_path):
    (tmp_path / "d.csv").write_text("a,b\n1,2\n")
    with running("identify", tmp_path / "out"):
        read_bytes(tmp_path / "d.csv")
        read_bytes(tmp_path / "d.csv")
        (tmp_path / "d.csv").write_text("a,b\n1,3\n")
        refused(lambda: read_bytes(tmp_path / "d.csv"), "changed while ppmcal was at work on it")
    assert read_bytes(tmp_path / "d.csv")[-2:] == b"3\n"


def test_no_more_is_read_than_the_limit(tmp_path):
    (tmp_path / "big").write_bytes(b"x" * 100)
    refused(lambda: read_bytes(tmp_path / "big", limits.Limit(99, "bytes", "Cut it", "here")),
            "has 100 bytes; the limit is 99", "Cut it")


def test_a_spreadsheet_that_unpacks_to_too_much(tmp_path, monkeypatch):
    pytest.importorskip("openpyxl")
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive, \
            archive.open("xl/worksheets/sheet1.xml", "w", force_zip64=True) as sheet:
        for _ in range(3):
            sheet.write(b" " * 1_000_000)
    monkeypatch.setattr(tables, "UNPACKED_BYTES", replace(limits.UNPACKED_BYTES, most=2_000_000))
    (tmp_path / "t.xlsx").write_bytes(held.getvalue())
    refused(lambda: read_table(tmp_path / "t.xlsx"), "unpacked")


def sheet_of(path, rows, dimension="A1:B2"):
    """Write a sheet whose XML is what a program, or nobody, would write."""
    book = pytest.importorskip("openpyxl").Workbook()
    held = io.BytesIO()
    book.save(held)
    with zipfile.ZipFile(held) as made, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name in made.namelist():
            text = made.read(name).decode()
            if name == "xl/worksheets/sheet1.xml":
                text = text.replace('ref="A1:A1"', f'ref="{dimension}"')
                text = re.sub("<sheetData.*sheetData>|<sheetData ?/>",
                              f"<sheetData>{rows}</sheetData>", text)
                assert rows in text and dimension in text
            out.writestr(name, text)


def test_a_sheet_that_says_it_is_wide_and_long(tmp_path):
    """As sheets do whose whole columns have a format: five kilobytes, read as what they hold."""
    head = ('<row r="1"><c r="A1" t="str"><v>a</v></c><c r="B1" t="str"><v>b</v></c></row>'
            '<row r="2"><c r="A2"><v>1</v></c><c r="B2"><v>2</v></c></row>')
    last = '<row r="100000"><c r="A100000"><v>3</v></c></row>'
    sheet_of(tmp_path / "t.xlsx", head + last, "A1:XFD1048576")
    begun = time.process_time()
    table = read_table(tmp_path / "t.xlsx")
    assert time.process_time() - begun < SOON
    np.testing.assert_array_equal(table.numbers["a"], [1.0, 3.0])
    np.testing.assert_array_equal(table.numbers["b"], [2.0, np.nan])


def test_a_sheet_of_empty_cells_that_are_too_many(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "TABLE_CELLS", replace(limits.TABLE_CELLS, most=100_000))
    rows = "".join(f'<row r="{i}"><c r="A{i}"><v>1</v></c><c r="XFD{i}"/></row>'
                   for i in range(1, 10))
    sheet_of(tmp_path / "t.xlsx", rows)
    refused(lambda: read_table(tmp_path / "t.xlsx"), "cells; the limit is 100,000")


def test_a_parquet_file_with_too_many_columns(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path = tmp_path / "t.parquet"
    parquet.write_table(pyarrow.table({f"c{i}": [1.0] for i in range(1200)}), path)
    refused(lambda: read_table(path), "1,200 columns")


def test_messages_hold_nothing_that_steers_a_terminal(tmp_path):
    (tmp_path / "m.yaml").write_text('"\\e[2J\\u202e": 1\n' + f'"{"k" * 50_000}": 2\n')
    text = refused(lambda: read_mechanism(tmp_path / "m.yaml"))
    assert text.isprintable()
    (tmp_path / "n.yaml").write_text(f'? "{"k" * 50_000}"\n: 2\n')
    assert len(refused(lambda: read_mechanism(tmp_path / "n.yaml"))) < 10_000
    error = BadInput("\ud800 is half a letter", "a\x1bb", "x")
    assert "\\ud800" in str(error) and "\\x1b" in str(error)


def test_every_limit_is_in_the_table():
    named = {v for v in vars(limits).values() if isinstance(v, limits.Limit)}
    assert named == {*limits.FILE_LIMITS, *limits.ASKED_LIMITS}


def covariance(tmp_path, change):
    """Read an identification whose covariance was changed."""
    text = (ROOT / "tests" / "fuzz" / "corpus" / "results" / "identification.json").read_text()
    tree = json.loads(text)
    change(tree["covariance"]["matrix"])
    path = tmp_path / "identification.json"
    path.write_text(json.dumps(tree))
    return lambda: read_knowledge(path, BENCH)


def test_covariances_that_are_none(tmp_path):
    def negative(matrix):
        matrix[1][1] = -1e-9

    def not_alike(matrix):
        matrix[0][1] += 1e-3 * (matrix[0][0] * matrix[1][1]) ** 0.5

    def beyond_one(matrix):
        matrix[0][1] = matrix[1][0] = 1.1 * (matrix[0][0] * matrix[1][1]) ** 0.5

    def together(matrix):    # each pair may be as it is, the three may not
        for i in range(3):
            matrix[i] = [0.0] * len(matrix)
            for row in matrix:
                row[i] = 0.0
        for i in range(3):
            for j in range(3):
                matrix[i][j] = 1e-4 if i == j else -0.9e-4

    def not_finite(matrix):
        matrix[0][1] = matrix[1][0] = 1e400

    covariance(tmp_path, lambda matrix: None)()
    for change, said in ((negative, "not a variance"), (not_alike, "of a covariance"),
                         (beyond_one, "of a covariance"), (together, "together"),
                         (not_finite, "finite")):
        refused(covariance(tmp_path, change), "covariance.matrix", said)
