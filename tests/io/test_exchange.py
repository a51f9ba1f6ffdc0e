"""A result folder changes in one step; what a killed run leaves is finished or swept."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.commands import tree

from ppmcal.errors import BadInput
from ppmcal.store import transaction
from ppmcal.store.folder import running
from ppmcal.store.inputs import track_input
from ppmcal.store.output import LongText, Output
from ppmcal.store.stage import INSIDE, hidden
from ppmcal.store.transaction import move_in, recover, staged, write_journal

WAYS = ("whole", "one by one")


@pytest.fixture(params=WAYS)
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Put files into folders in one step, or as where there is no such thing."""
    if request.param != "whole":
        monkeypatch.setattr(transaction, "_renameat2", lambda: None)
    elif transaction._renameat2() is None:
        pytest.skip("no such system call here")
    return str(request.param)


def write(folder: Path, command: str = "identify", **files: str) -> None:
    with running(command, folder), Output(folder) as out:
        for stem, text in files.items():
            out.add(f"{stem}.csv", text)


def left(folder: Path) -> list[str]:
    """Return the stages that are in a folder, and below it."""
    return [p.name for p in folder.rglob(".ppmcal.*") if p.name.endswith(".part")]


def test_what_stays_is_the_same_file(tmp_path: Path, way: str) -> None:
    folder = tmp_path / "out"
    write(folder, a="old", b="old")
    folder.chmod(0o750)
    (folder / "notes.txt").write_text("mine")
    (folder / "link").symlink_to("nowhere")
    note, place = (folder / "notes.txt").stat(), folder.stat().st_ino
    write(folder, a="new")
    now = (folder / "notes.txt").stat()
    assert (now.st_ino, now.st_mtime_ns, now.st_nlink) == (note.st_ino, note.st_mtime_ns, 1)
    assert os.readlink(folder / "link") == "nowhere"
    assert folder.stat().st_mode & 0o777 == 0o750
    assert (folder.stat().st_ino != place) == (way == "whole")
    assert sorted(p.name for p in folder.iterdir() if p.name[0] != ".") == [
        "a.csv", "link", "notes.txt"]
    assert os.listdir(tmp_path) == ["out"] and not left(tmp_path)


def test_a_file_that_comes_in_the_last_moment_stays(tmp_path: Path,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    folder, swap = tmp_path / "out", transaction._exchanged
    write(folder, a="old")

    def late(one: Path, other: Path) -> bool:
        (folder / "late.txt").write_text("mine")
        return swap(one, other)

    monkeypatch.setattr(transaction, "_exchanged", late)
    write(folder, a="new")
    assert (folder / "late.txt").read_text() == "mine"
    assert (folder / "a.csv").read_text() == "new"


def test_a_file_that_is_saved_meanwhile_is_the_saved_one(tmp_path: Path, way: str) -> None:
    """As editors save: under another name, which then takes the place of the first."""
    folder, note = tmp_path / "out", tmp_path / "out" / "notes.txt"
    write(folder, a="old")
    note.write_text("old")

    def late() -> Iterator[str]:
        (tmp_path / "saved").write_text("mine")
        (tmp_path / "saved").replace(note)
        yield "new"

    with running("identify", folder), Output(folder) as out:
        out.add("a.csv", LongText(late))
    assert note.read_text() == "mine"
    assert (folder / "a.csv").read_text() == "new"


@pytest.mark.parametrize("place", ["working folder", "of the shell", "with folders", "link"])
def test_folders_that_must_not_be_renamed(place: str, tmp_path: Path,
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    write(folder, a="old")
    asked, inode = folder, folder.stat().st_ino
    if place == "working folder":
        monkeypatch.chdir(folder)
        asked = Path(".")
    elif place == "of the shell":
        monkeypatch.setenv("PWD", str(folder))
    elif place == "with folders":
        (folder / "deeper").mkdir()
        (folder / "deeper" / "notes.txt").write_text("mine")
    else:
        asked = tmp_path / "link"
        asked.symlink_to("out")
    write(asked, a="new")
    assert (folder / "a.csv").read_text() == "new"
    assert (folder.stat().st_ino == inode) == (place != "link")
    assert place != "link" or asked.is_symlink()
    assert place != "with folders" or (folder / "deeper" / "notes.txt").read_text() == "mine"
    assert not left(tmp_path)


def test_a_folder_behind_a_link_that_is_not_there_yet(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("far/out")
    write(tmp_path / "link", a="new")
    assert (tmp_path / "far" / "out" / "a.csv").read_text() == "new"


def killed_while_moving(folder: Path, moved: int) -> None:
    """Leave a folder as a run does that is killed after so many files (a, b new; c goes)."""
    stage = folder / INSIDE
    (stage / "new").mkdir(parents=True)
    (stage / "lock").write_text("")
    for name in ("a.csv", "b.csv"):
        (stage / "new" / name).write_text("new")
    write_journal(stage, ["a.csv", "b.csv"], ["c.csv"])
    for name in ("a.csv", "b.csv")[:moved]:
        (stage / "new" / name).replace(folder / name)


@pytest.mark.parametrize("moved", [0, 1, 2])
@pytest.mark.parametrize("who", ["reader", "writer", "loader"])
def test_what_a_killed_run_was_moving_is_moved_before_anything_is_read(
        moved: int, who: str, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    write(folder, a="old", b="old", c="old")
    killed_while_moving(folder, moved)
    if who == "reader":
        track_input(folder / "a.csv")
    elif who == "loader":
        recover(folder)
    else:
        with pytest.raises(BadInput, match="edited"), running("identify", folder):
            pass    # its record is none of the new ones
    assert [(folder / f"{n}.csv").exists() for n in "abc"] == [True, True, False]
    assert {(folder / f"{n}.csv").read_text() for n in "ab"} == {"new"}
    assert not left(tmp_path)


def test_without_a_journal_the_old_ones_stay(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    write(folder, a="old")
    before = tree(folder)
    for stage in (folder / INSIDE, tmp_path / hidden("out")):
        (stage / "new").mkdir(parents=True)
        (stage / "new" / "a.csv").write_text("ne")
        (stage / "lock").write_text("")
        (stage / "journal.json.part").write_text('{"files": [')
    recover(folder)
    assert (folder / "a.csv").read_text() == "old"
    with running("identify", folder):
        pass
    assert tree(folder) == before and os.listdir(tmp_path) == ["out"]


def test_half_a_result_that_cannot_be_finished_is_not_read(tmp_path: Path,
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    write(folder, a="old", b="old", c="old")
    killed_while_moving(folder, 1)

    def failing(self: Path, other: Path) -> Path:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", failing)
        with pytest.raises(BadInput, match="half old, half new"):
            track_input(folder / "b.csv")
    track_input(folder / "b.csv")
    assert (folder / "b.csv").read_text() == "new"


@pytest.mark.parametrize("content", [
    '{"files": ["../outside"], "gone": []}', '{"files": [], "gone": ["/etc/x"]}', '{"files": 3}',
    '["a"]', "{", '{"files": [".."], "gone": []}', "[" * 9999])
def test_a_strange_journal_moves_nothing(content: str, tmp_path: Path) -> None:
    stage = tmp_path / "out" / INSIDE
    (stage / "new").mkdir(parents=True)
    (stage / "old").mkdir()
    (tmp_path / "out" / "outside").write_text("mine")
    (stage / "journal.json").write_text(content)
    (stage / "lock").write_text("")
    before = tree(tmp_path)
    with pytest.raises(BadInput, match="not a journal of ppmcal"):
        recover(tmp_path / "out")
    assert {k: v for k, v in tree(tmp_path).items() if not k.endswith("lock")} == {
        k: v for k, v in before.items() if not k.endswith("lock")}


@pytest.mark.parametrize("link", ["new", "old", "stage"])
def test_a_stage_that_leads_elsewhere_moves_nothing(link: str, tmp_path: Path) -> None:
    far, folder = tmp_path / "far", tmp_path / "out"
    far.mkdir()
    folder.mkdir()
    (far / "a.csv").write_text("secret")
    stage = folder / INSIDE
    if link == "stage":
        (far / "new").mkdir()
        (far / "new" / "a.csv").write_text("secret")
        (far / "journal.json").write_text('{"files": ["a.csv"], "gone": []}')
        stage.symlink_to(far)
    else:
        (stage / ({"new": "old", "old": "new"}[link])).mkdir(parents=True)
        (stage / link).symlink_to(far)
        (stage / "journal.json").write_text('{"files": ["a.csv"], "gone": ["a.csv"]}')
    before = tree(far)
    with pytest.raises(BadInput):
        recover(folder)
    assert not (folder / "a.csv").exists() and tree(far) == before


def test_move_in_may_be_done_again_from_anywhere(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    write(folder, a="old", b="old", c="old")
    killed_while_moving(folder, 1)
    journal = (folder / INSIDE / "journal.json").read_bytes()
    move_in(folder / INSIDE, folder)
    (folder / INSIDE / "journal.json").write_bytes(journal)
    move_in(folder / INSIDE, folder)
    assert (folder / "a.csv").read_text() == "new" == (folder / "b.csv").read_text()


# ---------------------------------------------------------------- two runs

HOLD = """
import sys
from pathlib import Path
from ppmcal.store.folder import running
with running("diagnose", Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path: Path):
    """Return a process that is writing into ``out``."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, tmp_path / "out"], text=True,
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_run_is_told_who_is_writing(other: subprocess.Popen[str], tmp_path: Path) -> None:
    said = rf"another run is writing there: ppmcal diagnose, process {other.pid}, since 20\d\d-"
    with pytest.raises(BadInput, match=said) as error, running("identify", tmp_path / "out"):
        raise AssertionError("it ran")
    assert error.value.exit_code == 2
    with pytest.raises(BadInput, match=said):
        Output(tmp_path / "out").write()
    write(tmp_path / "out2", a="new")    # another folder is free
    other.communicate("")    # it is done
    write(tmp_path / "out", a="new")
    assert sorted(os.listdir(tmp_path)) == ["out", "out2"]


def test_the_lock_of_a_dead_process_is_none(other: subprocess.Popen[str], tmp_path: Path) -> None:
    other.kill()
    other.wait()
    assert (tmp_path / hidden("out") / "lock").exists()
    write(tmp_path / "out", a="new")
    assert os.listdir(tmp_path) == ["out"]


def test_a_child_does_not_hold_the_lock_of_its_parent(tmp_path: Path) -> None:
    read, wrote = os.pipe()
    with staged(tmp_path / "out", "identify"):
        child = os.fork()
        if not child:
            os.close(wrote)
            os.read(read, 1)
            os._exit(0)
    try:
        with staged(tmp_path / "out", "identify"):
            pass
    finally:
        os.close(wrote)
        os.close(read)
        os.waitpid(child, 0)


def test_single_files_of_other_names_do_not_wait_for_each_other(tmp_path: Path) -> None:
    with staged(tmp_path, "init", "a.yaml"):
        with staged(tmp_path, "init", "b.yaml"):
            pass
        with pytest.raises(BadInput, match="another run"), staged(tmp_path, "init", "a.yaml"):
            pass


def test_a_run_without_results_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), running("identify", tmp_path / "far" / "away" / "out"):
        raise ZeroDivisionError
    assert os.listdir(tmp_path) == []


def test_long_and_odd_names(tmp_path: Path) -> None:
    for name in ("x" * 250, "a\nb", "-dash", "'\"", os.fsdecode(b"\xff\xfe"), "🦀" * 60, " "):
        write(tmp_path / name, a="old")
        write(tmp_path / name, a="new")
        assert (tmp_path / name / "a.csv").read_text() == "new"
    assert not left(tmp_path)


def test_the_lock_says_who_holds_it(tmp_path: Path) -> None:
    with staged(tmp_path / "out", "plan") as stage:
        held = json.loads((stage.place / "lock").read_text())
    assert (held["command"], held["process"]) == ("plan", os.getpid())
