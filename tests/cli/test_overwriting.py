"""What commands replace: their own results of before; never inputs, nor the work of others."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from helpers.commands import ppmcal, tree
from helpers.shared import shared_demo
from torture.desk import COMMANDS, make_desk, remember

from ppmcal.commands import command, names
from ppmcal.commands.demo import run as demo_run
from ppmcal.errors import BadInput
from ppmcal.store.folder import RECORD, read_record, running
from ppmcal.store.inputs import digest_of
from ppmcal.store.output import Output

FOLDERS = {name: words.replace("{desk}/", "") for name, words in COMMANDS.items()}
"""Commands that write into a folder, and their words before --out."""
FILES = {
    "init": "6-UPS --out mine.yaml",
    "read": "log.csv --mechanism mine.yaml --sidecar run1.yaml --out run1.csv",
    "check": "mine.yaml --draw mine.yaml",
}
"""Those that write single files, in a way that would replace what is there."""
TWO = {name for name in names() if command(name).replace != "--force"}
"""Those that lift a refusal too, with --regardless: what replaces files is --overwrite there."""
OUT = "demo-results"
"""Where each of them writes."""

pytestmark = pytest.mark.slow


def replacing(name: str) -> str:
    """Return the option of a command to write where files are."""
    return "--overwrite" if name in TWO else "--force"


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with everything that the commands read."""
    folder = tmp_path_factory.mktemp("desk") / "files"
    make_desk(folder)
    for line in ("identify mine.yaml run1.csv --out identified",
                 "simulate mine.yaml mine.scenario.yaml --seed 5 --out may",
                 "identify mine.yaml may/measurements.csv --out identified-may",
                 "compensate identified targets.csv --out compensated"):
        assert ppmcal(*shlex.split(line), "-q", cwd=folder).code in (0, 1)
    return folder


@pytest.fixture
def here(desk: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(desk, tmp_path / "desk"))


@pytest.fixture(scope="module")
def remembering() -> list[tuple[object, str, object]]:
    """Return module, name and substitute of what computes, once for the same words."""
    found: list[tuple[object, str, object]] = []
    remember(lambda *function: found.append(function))
    return found


@pytest.fixture(scope="module")
def done(desk: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[int, Path]]:
    """Return a command's exit code, and a folder in which it wrote; each is run once."""
    @cache
    def made(name: str) -> tuple[int, Path]:
        folder = Path(shutil.copytree(desk, tmp_path_factory.mktemp("done") / "desk"))
        if name == "demo":
            shutil.copytree(shared_demo(tmp_path_factory) / OUT, folder / OUT)
            return 0, folder
        run = ppmcal(name, *shlex.split(FOLDERS[name]), "--out", OUT, cwd=folder)
        assert run.code in (0, 1), run.err
        return run.code, folder

    return made


def test_every_command_that_writes_single_files_is_tried() -> None:
    assert {*FILES} == {name for name in names() if command(name).files}


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_with_other_work_is_refused(name: str, here: Path) -> None:
    (here / "mine").mkdir()
    for number in range(5):
        (here / "mine" / f"notes{number}.txt").write_text("mine")
    before = tree(here)
    run = ppmcal(name, *shlex.split(FOLDERS[name]), "--out", "mine", cwd=here, expect=2)
    assert "notes0.txt, notes1.txt, notes2.txt and 2 more" in " ".join(run.err.split())
    assert f"{replacing(name)}." in run.err and "--out" in run.err
    assert ("--force" in run.err) == (name not in TWO) and "--regardless" not in run.err
    assert not run.out and tree(here) == before


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_of_another_command_is_refused(name: str, here: Path) -> None:
    other = "may" if name != "simulate" else "identified"
    before = tree(here)
    run = ppmcal(name, *shlex.split(FOLDERS[name]), "--out", other, cwd=here, expect=2)
    owner = "simulate" if name != "simulate" else "identify"
    assert f"results of another command, {owner}" in " ".join(run.err.split())
    assert tree(here) == before


@pytest.mark.long_cases("certify", "demo", "figures", "plan", "compare")
@pytest.mark.parametrize("name", FOLDERS)
def test_a_command_replaces_its_own_results_and_takes_stale_ones_away(
        name: str, done: Callable[[str], tuple[int, Path]], tmp_path: Path,
        remembering: list[tuple[object, str, object]], monkeypatch: pytest.MonkeyPatch) -> None:
    """What is computed stays the same, so it is computed once: here files count."""
    for function in remembering:
        monkeypatch.setattr(*function)
    words = [name, *shlex.split(FOLDERS[name]), "--out", OUT]
    if name == "stiffness":
        pytest.importorskip("matplotlib")
    if name == "demo":    # most of its time; what these two replace are cases of their own
        steps = demo_run._steps
        monkeypatch.setattr(demo_run, "_steps", lambda *given: [
            s for s in steps(*given) if s.words[0] not in ("diagnose", "report")])
    code, folder = done(name)
    here = Path(shutil.copytree(folder, tmp_path / "desk"))
    record = json.loads((here / OUT / RECORD).read_text())
    if record["files"]:
        (here / OUT / "old.csv").write_text("x\n")
        digest = "73cb3858a687a8494ca3323053016282f3dad39d42cf62ca4e79dda2aac7d9ac"
        record["files"]["old.csv"] = {"command": name, "sha256": digest}
        (here / OUT / RECORD).write_text(json.dumps(record))
    (here / OUT / "notes.txt").write_text("mine")
    again = ppmcal(*words, cwd=here)
    assert again.code == code, again.err
    assert not (here / OUT / "old.csv").exists()
    assert (here / OUT / "notes.txt").read_text() == "mine"


@pytest.mark.long_cases("certify", "plan")
@pytest.mark.parametrize("name", FOLDERS)
def test_no_force_replaces_an_input(name: str, done: Callable[[str], tuple[int, Path]], here: Path
                                    ) -> None:
    """Every input stands in the folder of the results too, under each name that is written."""
    words = [name, *shlex.split(FOLDERS[name])]
    inputs = [here / w for w in words[1:] if (here / w).is_file()]
    if not inputs:
        return
    names = list(json.loads((done(name)[1] / OUT / RECORD).read_text())["files"])
    if not names:
        return
    (here / OUT).mkdir()
    for target in names:
        (here / OUT / target).hardlink_to(inputs[-1])
    before = {path: path.read_bytes() for path in inputs}
    run = ppmcal(*words, "--out", OUT, replacing(name), cwd=here, expect=2)
    assert "is an input of this run" in " ".join(run.err.split())
    assert {path: path.read_bytes() for path in inputs} == before


@pytest.mark.parametrize("name", sorted(TWO))
def test_what_lifts_a_refusal_replaces_nothing(name: str, here: Path) -> None:
    """--force did both: it is refused with its two successors, and --overwrite replaces."""
    (here / "mine").mkdir()
    (here / "mine" / "notes.txt").write_text("mine")
    before = tree(here)
    words = [name, *shlex.split(FOLDERS[name]), "--out", "mine"]
    run = ppmcal(*words, "--force", cwd=here, expect=2)
    assert "--overwrite replaces files, --regardless lifts a refusal" in " ".join(run.err.split())
    assert not run.out and tree(here) == before
    run = ppmcal(*words, "--regardless", cwd=here, expect=2)
    assert "holds files that ppmcal did not write" in " ".join(run.err.split())
    assert not run.out and tree(here) == before
    assert ppmcal(*words, "--overwrite", cwd=here).code in (0, 1)
    assert (here / "mine" / RECORD).is_file()
    assert (here / "mine" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", FILES)
def test_single_files_do_not_replace_what_is_there(name: str, here: Path) -> None:
    before = tree(here)
    run = ppmcal(name, *shlex.split(FILES[name]), cwd=here, expect=2)
    assert "mine.yaml" in run.err or "run1.csv" in run.err
    assert tree(here) == before


def test_the_data_of_a_run_is_no_place_for_its_results(here: Path) -> None:
    """Where the data is, `simulate --out .` would write over real measurements."""
    shutil.copy(here / "run1.csv", here / "measurements.csv")
    shutil.copy(here / "run1.yaml", here / "measurements.yaml")
    before = tree(here)
    for words in ("simulate mine.yaml mine.scenario.yaml --out .",
                  "identify mine.yaml measurements.csv --out .",
                  "import klipper printer.cfg --out ."):
        run = ppmcal(*shlex.split(words), cwd=here, expect=2)
        assert "holds files that ppmcal did not write" in " ".join(run.err.split())
    assert tree(here) == before


def test_an_edited_machine_is_not_imported_over(here: Path) -> None:
    ppmcal("import", "klipper", "printer.cfg", cwd=here, expect=0)
    machine = here / "imported" / "machine.yaml"
    machine.write_text(machine.read_text() + "# my rods\n")
    before = tree(here)
    run = ppmcal("import", "klipper", "printer.cfg", cwd=here, expect=2)
    assert "machine.yaml was edited" in " ".join(run.err.split())
    assert tree(here) == before


FULL = """
import resource, sys
from ppmcal.cli import main
import ppmcal.commands.simulate.run
resource.setrlimit(resource.RLIMIT_FSIZE, (700, 700))
main()
"""


@pytest.mark.long_cases(
    "check mine.yaml --draw machine.html", "import klipper printer.cfg --out o",
    "init 6-UPS --out mine.yaml --force", "simulate mine.yaml mine.scenario.yaml --out may")
@pytest.mark.skipif(sys.platform != "linux", reason="has no such limit")
@pytest.mark.parametrize("line", [
    "init 6-UPS --out new.yaml", "init 6-UPS --out mine.yaml --force",
    "check mine.yaml --draw machine.html", "import klipper printer.cfg --out o",
    "simulate mine.yaml mine.scenario.yaml --out may"])
def test_a_file_that_cannot_be_written_to_its_end_leaves_nothing(line: str, here: Path) -> None:
    """As on a full disk: `init` left half a file."""
    before = tree(here)
    done = subprocess.run([sys.executable, "-c", FULL, *shlex.split(line)], cwd=here, text=True,
                          capture_output=True, check=False)
    assert done.returncode == 2 and "cannot be written (File too large)" in " ".join(
        done.stderr.split()), done.stderr
    assert tree(here) == before
    assert not [p for p in here.rglob(".ppmcal.*") if p.name.endswith(".part")]


def test_a_machine_that_another_extends_is_an_input(here: Path) -> None:
    (here / "run.yaml").write_bytes((here / "mine.yaml").read_bytes())
    (here / "mine.yaml").write_text("extends: run.yaml\n")
    before = tree(here)
    run = ppmcal("read", "log.csv", "--mechanism", "mine.yaml", "--sidecar", "run1.yaml", "--out",
                 "run.csv", "--force", cwd=here, expect=2)
    assert "run.yaml: is an input of this run" in " ".join(run.err.split())
    assert tree(here) == before


@pytest.mark.parametrize("alias", ["hard link", "symbolic link", "way round"])
@pytest.mark.parametrize("line", [
    "read log.csv --mechanism mine.yaml --sidecar run1.yaml --out {} --force",
    "identify mine.yaml log.csv --out {} --force"])
def test_an_input_under_another_name_stays(line: str, alias: str, here: Path) -> None:
    shutil.copy(here / "run1.yaml", here / "log.yaml")
    other = here / "out" / "residuals.csv"
    other.parent.mkdir()
    if alias == "hard link":
        other.hardlink_to(here / "log.csv")
    elif alias == "symbolic link":
        other.symlink_to(here / "log.csv")
    else:
        shutil.copy(here / "log.csv", here / "residuals.csv")
        shutil.copy(here / "log.yaml", here / "residuals.yaml")
        line = line.replace("log.csv", "residuals.csv")
        other = here / "identified" / ".." / "residuals.csv"
    before = tree(here)
    run = ppmcal(*shlex.split(line.format(other if line.startswith("read") else other.parent)),
                 cwd=here, expect=2)
    assert "is an input of this run" in " ".join(run.err.split())
    assert tree(here) == before


def test_read_leaves_no_half_of_its_two_files(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace = Path.replace

    def failing(self: Path, other: Path) -> Path:
        if Path(other).name == "run.yaml":
            raise OSError(28, "No space left on device")
        return replace(self, other)

    monkeypatch.setattr(Path, "replace", failing)
    before = tree(here)
    run = ppmcal("read", "log.csv", "--mechanism", "mine.yaml", "--sidecar", "run1.yaml", "--out",
                 "run.csv", cwd=here, expect=2)
    assert "No space left" in run.err
    assert tree(here) == before


@pytest.mark.parametrize("text", [
    '{"format": "ppmcal/folder/1", "commands": 5, "files": {}}', "[5]", "{",
    '{"format": "ppmcal/folder/1", "commands": ["plan"]}'])
def test_a_record_that_is_no_list_of_commands_names_none(text: str, tmp_path: Path) -> None:
    (tmp_path / RECORD).write_text(text)
    assert read_record(tmp_path).commands == ()
    assert read_record(tmp_path).runs == {}


@pytest.mark.parametrize("deep", [False, True])
def test_a_record_takes_nothing_away_elsewhere(deep: bool, tmp_path: Path) -> None:
    """Folders come from others too; with a folder in it files are moved one by one."""
    folder, mine = tmp_path / "out", tmp_path / "mine.csv"
    (folder / "within" if deep else folder).mkdir(parents=True)
    mine.write_text("1\n")
    names = ("../mine.csv", str(mine), "..", ".", "")
    (folder / RECORD).write_text(json.dumps({"format": "ppmcal/folder/1", "files": {
        n: {"command": "plan", "sha256": digest_of(mine)} for n in names}, "commands": ["plan"]}))
    for text in ("2\n", "3\n"):
        with running("plan", folder), Output(folder) as out:
            out.add("poses.csv", text)
    assert mine.read_text() == "1\n"
    assert (folder / "poses.csv").read_text() == "3\n"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="makes a pipe")
def test_a_pipe_in_a_result_s_place_was_edited(tmp_path: Path) -> None:
    with running("plan", tmp_path), Output(tmp_path) as out:
        out.add("poses.csv", "1\n")
    (tmp_path / "poses.csv").unlink()
    os.mkfifo(tmp_path / "poses.csv")
    with pytest.raises(BadInput, match="was edited since"), running("plan", tmp_path):
        pass
    (tmp_path / RECORD).unlink()
    os.mkfifo(tmp_path / RECORD)
    assert not read_record(tmp_path).sound
