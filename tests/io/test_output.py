"""Writing: CSV and JSON text, provenance, and files that appear whole or not at all."""

import csv
import io
import json
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import tree
from hypothesis import given, settings
from hypothesis import strategies as st

from ppmcal.errors import BadInput
from ppmcal.io import csv_text
from ppmcal.io.csv import CHUNK, csv_lines
from ppmcal.plain import json_text
from ppmcal.store.folder import RECORD, read_record, running
from ppmcal.store.inputs import current, read_bytes
from ppmcal.store.output import LongText, Output
from ppmcal.store.provenance import provenance


def test_output_appears_together(tmp_path):
    target = tmp_path / "new" / "out"
    with Output(target) as out:
        out.add("a.csv", "x\n1\n")
        out.add("b.bin", b"\x00")
        assert not target.exists()
    assert (target / "a.csv").read_text() == "x\n1\n"
    assert (target / "b.bin").read_bytes() == b"\x00"
    assert sorted(os.listdir(target.parent)) == ["out"]


def write(folder, command="identify", force=False, **files):
    """Write files (``a``: text of a.csv) as a run of a command does."""
    with running(command, folder, force), Output(folder) as out:
        for stem, text in files.items():
            out.add(f"{stem}.csv", text)


def held(folder):
    """Return name -> text of what a folder shows."""
    return {p.name: p.read_text() for p in folder.iterdir()
            if p.is_file() and not p.name.startswith(".")}


def test_output_replaces_its_own_beside_others(tmp_path):
    folder = tmp_path / "out"
    write(folder, a="old", b="old")
    (folder / "mine.txt").write_text("keep")
    write(folder, a="new")    # b would pass for a result of this run
    assert held(folder) == {"a.csv": "new", "mine.txt": "keep"}
    write(folder, b="new")
    assert held(folder) == {"b.csv": "new", "mine.txt": "keep"}
    assert os.listdir(tmp_path) == ["out"]


def foreign(folder):
    folder.mkdir()
    (folder / "mine.txt").write_text("")


def edited(folder):
    write(folder, a="old", b="old")
    (folder / "a.csv").write_text("mine")


def anothers(folder):
    write(folder, "diagnose", a="old")


def anothers_of_other_names(folder):
    write(folder, "diagnose", b="old")


def claimed(folder):
    """Make a folder that a command claimed for what it will put in folders of their own."""
    write(folder, "batch")
    (folder / "deeper").mkdir()


def beside(folder):
    write(folder, b="old")
    (folder / "a.csv").write_text("mine")


def damaged(folder):
    write(folder, a="old")
    (folder / RECORD).write_text('{"format": "ppmcal/folder/1", "files": {"a.csv": 3}}')


@pytest.mark.parametrize(("make", "said"), [
    (foreign, "mine.txt"), (edited, "a.csv was edited"), (anothers, "another command, diagnose"),
    (anothers_of_other_names, r"another command, diagnose \(b.csv\)"), (claimed, "command, batch"),
    (beside, "a.csv: was there before"), (damaged, "did not write")])
def test_output_replaces_nothing_else_unless_forced(tmp_path, make, said):
    folder = tmp_path / "out"
    make(folder)
    before = tree(folder)
    with pytest.raises(BadInput, match=said) as error:
        write(folder, a="new")
    assert "--force" in str(error.value)
    assert tree(folder) == before
    write(folder, force=True, a="new")
    assert held(folder)["a.csv"] == "new"
    write(folder, a="newer")    # and from now on it is this command's own
    assert held(folder)["a.csv"] == "newer"


def test_a_folder_that_shows_nothing_is_empty(tmp_path):
    (tmp_path / ".DS_Store").write_text("")
    write(tmp_path, a="new")
    assert held(tmp_path) == {"a.csv": "new"}


def test_what_was_edited_is_no_stale_result(tmp_path):
    folder = tmp_path / "out"
    write(folder, a="old", b="old")
    (folder / "b.csv").write_text("mine")
    write(folder, force=True, a="new")
    assert held(folder) == {"a.csv": "new", "b.csv": "mine"}


def test_a_claim_takes_nothing_away(tmp_path):
    folder = tmp_path / "out"
    write(folder, "batch", a="old")
    write(folder, "batch")
    assert held(folder) == {"a.csv": "old"}


def test_stale_results_come_back_where_the_new_ones_fail(tmp_path, monkeypatch):
    folder = tmp_path / "out"
    write(folder, a="old", b="old")
    (folder / "deeper").mkdir()    # so files are moved one by one
    before = tree(folder)
    replace = Path.replace

    def failing(self, other):
        if self.name == "b.csv" and "old" in str(other):
            raise OSError(28, "No space left on device")
        return replace(self, other)

    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(BadInput, match="No space"):
        write(folder, a="new")
    assert tree(folder) == before


def test_loose_files_go_among_others_without_a_record(tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    out = Output(tmp_path, loose=True)
    out.add("run.csv", "x\n")
    assert out.write() == [tmp_path / "run.csv"]
    assert sorted(os.listdir(tmp_path)) == ["mine.txt", "run.csv"]


def test_an_edited_file_is_refused_before_the_work(tmp_path):
    edited(tmp_path / "out")
    with pytest.raises(BadInput, match="was edited"), running("identify", tmp_path / "out"):
        raise AssertionError("the command ran")


@pytest.mark.parametrize("link", ["same", "symbolic", "hard"])
def test_an_input_is_never_replaced(tmp_path, link):
    source, folder = tmp_path / "data.csv", tmp_path / "out"
    folder.mkdir()
    if link == "same":
        source = folder / "a.csv"
    source.write_text("x\n1\n")
    if link == "symbolic":
        (folder / "a.csv").symlink_to(source)
    elif link == "hard":
        os.link(source, folder / "a.csv")
    before = tree(tmp_path)
    with (pytest.raises(BadInput, match=r"a\.csv: is an input of this run"),
          running("identify", folder, force=True), Output(folder) as out):
        read_bytes(source)
        out.add("a.csv", "new")
    assert tree(tmp_path) == before


def test_an_input_that_the_command_wrote_before_is_refused_when_it_is_read(tmp_path):
    write(tmp_path / "out", a="old")
    with running("identify", tmp_path / "out", force=True), pytest.raises(
            BadInput, match="is an input"):
        read_bytes(tmp_path / "out" / "a.csv")


def test_output_writes_nothing_after_an_error(tmp_path):
    with pytest.raises(RuntimeError), Output(tmp_path / "out") as out:
        out.add("a.csv", "new")
        raise RuntimeError
    assert os.listdir(tmp_path) == []


def test_output_rolls_back(tmp_path, monkeypatch):
    target = tmp_path / "out"
    write(target, "", a="old")
    (target / "deeper").mkdir()    # so files are moved one by one
    before = tree(target)
    out = Output(target)
    out.add("a.csv", "new")
    out.add("b.csv", "new")
    replace = Path.replace

    def failing(self, other):
        if Path(other).name == "b.csv":
            raise OSError(28, "No space left on device")
        return replace(self, other)

    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(BadInput, match="No space"):
        out.write()
    assert tree(target) == before
    assert os.listdir(tmp_path) == ["out"]


def test_output_refuses_a_file_as_folder(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(BadInput, match="not a folder"):
        Output(tmp_path / "out").write()
    with pytest.raises(BadInput, match="cannot be written"):
        Output(tmp_path / "out" / "deeper").write()


def test_output_into_a_folder_on_another_file_system(tmp_path):
    """The folder may be a mount, and what is above it need not be writable."""
    other = Path("/dev/shm")
    if not other.is_dir() or other.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("there is only one file system")
    with tempfile.TemporaryDirectory(dir=other) as folder:
        (tmp_path / "out").symlink_to(folder)
        with Output(tmp_path / "out") as out:
            out.add("a.csv", "x\n")
        assert sorted(os.listdir(folder)) == [RECORD, "a.csv"]
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("name", ["a" * 300, "a\0b"])
def test_output_refuses_an_impossible_name(tmp_path, name):
    with pytest.raises(BadInput, match="cannot be written"):
        Output(tmp_path / name).write()


def test_output_writes_names_that_utf8_cannot_hold(tmp_path):
    with Output(tmp_path / "out") as out:
        out.add("a.json", json_text({"file": os.fsdecode(b"run_\xe4")}))
    assert json.loads((tmp_path / "out" / "a.json").read_text()) == {"file": "run_\udce4"}


def test_output_names_are_plain():
    out = Output("x")
    for name in ("", "a/b", "..", RECORD):
        with pytest.raises(ValueError, match="plain"):
            out.add(name, "")
    out.add("a", "")
    with pytest.raises(ValueError, match="already"):
        out.add("a", "")


@pytest.mark.long
@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(allow_nan=False, allow_infinity=False), st.integers(-9, 9),
                          st.text(st.characters(codec="utf-8", exclude_characters="\r\0"))),
                min_size=1))
def test_csv_reads_back(rows):
    numbers, counts, words = zip(*rows, strict=True)
    text = csv_text(["a", "b,c", 'd"e'], [np.array(numbers), np.array(counts), words])
    back = list(csv.reader(io.StringIO(text, newline="")))
    assert back[0] == ["a", "b,c", 'd"e']
    assert [float(r[0]) for r in back[1:]] == list(numbers)
    assert [int(r[1]) for r in back[1:]] == list(counts)
    assert [r[2] for r in back[1:]] == list(words)


def test_csv_details():
    assert csv_text(["x"], [np.array([0.1, np.nan])]) == "x\n0.10000000000000001\nnan\n"
    assert csv_text(["x", "y"], [[True, False], [None, 1.5]]) == "x,y\ntrue,\nfalse,1.5\n"
    assert csv_text(["x"], [np.zeros(0)]) == "x\n"
    with pytest.raises(ValueError, match="lengths"):
        csv_text(["x", "y"], [[1], [1, 2]])
    with pytest.raises(ValueError, match="columns"):
        csv_text(["x", "y"], [[1]])


def test_json_is_plain():
    @dataclass
    class Thing:
        x: float

    obj = {"a": np.nan, "b": np.array([1.0, np.inf]), "c": np.float64(2.5), "d": np.int64(3),
           "e": (True, None), "f": Thing(1.5), "g": np.bool_(True), "h": Path("x"),
           "i": {1: np.array(2.0)}, "j": np.str_("abc")}
    assert json.loads(json_text(obj)) == {
        "a": None, "b": [1.0, None], "c": 2.5, "d": 3, "e": [True, None], "f": {"x": 1.5},
        "g": True, "h": "x", "i": {"1": 2.0}, "j": "abc"}


def test_provenance(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"abc")
    got = provenance([path], "ppmcal identify", 7)
    assert got["inputs"] == {
        str(path): "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"}
    assert (got["command"], got["seed"], got["numpy"]) == ("ppmcal identify", 7, np.__version__)
    with pytest.raises(BadInput, match="cannot be read"):
        provenance([tmp_path / "b"], "", None)


def test_results_name_what_was_read_whatever_becomes_of_the_file(tmp_path):
    path, gone = tmp_path / "a.txt", tmp_path / "gone.txt"
    path.write_bytes(b"abc")
    gone.write_bytes(b"abc")
    with running("identify", tmp_path / "out"):
        read_bytes(path)
        read_bytes(gone)
        path.write_bytes(b"saved anew")
        gone.unlink()
        named = provenance([path, gone], "", None)["inputs"]
        with Output(tmp_path / "out") as out:
            current().source.update(inputs={})
            out.add("a.csv", "1\n")
    own = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert named == {str(path): own, str(gone): own}
    assert read_record(tmp_path / "out").runs["identify"]["inputs"] == named


def test_a_long_table_is_written_as_it_is_made(tmp_path):
    """The same bytes as from one text, the record's digest too; a row that fails leaves nothing."""
    size = 2 * CHUNK + 7
    columns = [np.arange(size), np.linspace(0.0, 1.0, size),
               np.array(["a, b", None] + [""] * (size - 2), dtype=object)]
    lines = csv_lines(["row", "x", "word"], columns)
    with Output(tmp_path / "lines") as out:
        out.add("table.csv", lines)
    with Output(tmp_path / "text") as out:
        out.add("table.csv", csv_text(["row", "x", "word"], columns))
    made, told = (tmp_path / name / "table.csv" for name in ("lines", "text"))
    assert made.read_bytes() == told.read_bytes()
    assert made.read_text().splitlines()[1] == '0,0,"a, b"'
    assert len(made.read_text().splitlines()) == size + 1
    assert (tmp_path / "lines" / RECORD).read_bytes() == (tmp_path / "text" / RECORD).read_bytes()

    def broken():
        yield "row,x\n"
        raise OSError("no space left")

    with pytest.raises(BadInput, match="no space left"), Output(tmp_path / "broken") as out:
        out.add("other.csv", "a\n1\n")
        out.add("table.csv", LongText(broken))
    assert not (tmp_path / "broken").exists()
    assert not list(tmp_path.glob(".ppmcal.*"))
