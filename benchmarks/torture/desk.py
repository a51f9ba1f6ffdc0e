"""The commands that are tortured, the files they read, and what their folders may look like."""

from __future__ import annotations

import functools
import hashlib
import importlib
import json
import os
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

from ppmcal.commands import command, names, work
from ppmcal.commands.spec import taken
from ppmcal.store.folder import RECORD
from ppmcal.store.inputs import current

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
WORDS = {
    "batch": "{desk}/fleet.yaml --cores 1",
    "check": "{desk}/mine.yaml --draw machine.html",
    "demo": "-q",
    "diagnose": "{desk}/mine.yaml {desk}/run1.csv --kind backlash",
    "export": "grid {desk}/identified --poses {desk}/poses.csv",
    "init": "3-RPR --out mine.yaml --force",
    "kinematics": "inverse {desk}/mine.yaml {desk}/poses.csv",
    "plan": "{desk}/mine.yaml --count 12",
    "read": "{desk}/log.csv --mechanism {desk}/mine.yaml --sidecar {desk}/run1.yaml "
            "--out run.csv --force",
    "report": "{desk}/identified {desk}/compensated",
    "stiffness": "{desk}/stiff.yaml --grid x=-20:20:2,y=-20:20:2",
    "tolerances": "{desk}/mine.yaml --accuracy 0.2 --machines 20 --cores 1",
    "validate": "{desk}/identified {desk}/run1.csv",
    "verify": "{desk}/identified {desk}/compensated",
    "workspace": "{desk}/mine.yaml --grid x=-20:20:2,y=-20:20:2",
}
"""Words of those commands whose first example takes long, or is of other files."""
RESULTS = ("identified", "identified-may", "compensated")
"""Results that are on the desk."""


def words_of(name: str) -> str:
    """Return the words of a command before --out; files are on the desk."""
    if name in WORDS:
        return WORDS[name]
    own = shlex.split(command(name).examples[0])[2:]
    return " ".join(f"{{desk}}/{w}" if w in RESULTS or Path(w).suffix else w for w in own)


COMMANDS = {n: words_of(n) for n in names() if command(n).out}
"""Commands that write into a folder, and their words before --out."""
NOTHING = {n: words_of(n) for n in names() if not (command(n).out or command(n).files
                                                   or command(n).data)}
"""Those that write into a temporary folder only."""
FILES = {n: words_of(n) for n in names() if command(n).files}
"""Those that write single files among others."""
PAGES = {"ppmcal.report.batch": "batch_page", "ppmcal.report.drawing": "drawing_page"}
"""Functions besides the commands' own whose results are computed once: module -> name."""
State = Mapping[str, str]
"""The files of a folder: name -> SHA-256."""


def remember(put: Callable[[Any, str, Any], None] = setattr) -> None:
    """Let the work of each command, but what runs others, be done only once for the same words.

    ``put(module, name, function)`` puts a function there.
    """
    homes = [(work(n), "run") for n in names() if command(n).result and n not in NOTHING
             and not any(one.name == "out" and one.required for one in taken(
                 command(n).arguments))]
    for home, name in (*homes, *((importlib.import_module(m), n) for m, n in PAGES.items())):
        put(home, name, _once(getattr(home, name)))


def _once(function: Callable[..., Any]) -> Callable[..., Any]:
    known: dict[str, tuple[Any, dict[str, Any]]] = {}

    @functools.wraps(function)
    def called(*args: Any, **options: Any) -> Any:
        key = repr((args, sorted(options.items())))
        if key not in known:
            result = function(*args, **options)
            if hasattr(result, "save"):
                files = dict(result.files())
                object.__setattr__(result, "files", lambda: files)
            known[key] = result, dict(current().source)
        result, source = known[key]
        current().source.update(source)
        return result

    return called


def run(words: list[str], cwd: Path) -> int:
    """Run a command in this process; return its exit code."""
    from ppmcal.cli import main

    os.chdir(cwd)
    for name in ("PWD", "PPMCAL_DEBUG"):
        os.environ.pop(name, None)
    with mock.patch.object(sys, "argv", ["ppmcal", *words]):
        try:
            main()
        except SystemExit as stop:
            return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    return 0


def make_desk(folder: Path) -> None:
    """Put everything that the commands read into a folder."""
    folder.mkdir(parents=True)
    for source, name in {
            "hexapod.yaml": "mine.yaml", "scenario.yaml": "mine.scenario.yaml",
            "measurements.csv": "run1.csv", "measurements.yaml": "run1.yaml",
            "hidden/measurements.csv": "run2.csv", "hidden/measurements.yaml": "run2.yaml",
            "targets.csv": "targets.csv", "poses.csv": "poses.csv", "about.yaml": "about.yaml",
            "printer/printer.cfg": "printer.cfg"}.items():
        shutil.copy(SAMPLES / source, folder / name)
    for name in ("run1.csv", "run2.csv"):    # that they run, not what they find
        few = (folder / name).read_text(encoding="utf-8").splitlines(keepends=True)[:61]
        (folder / name).write_text("".join(few), encoding="utf-8")
    shutil.copy(folder / "run1.csv", folder / "log.csv")
    (folder / "stiff.yaml").write_text("extends: mine.yaml\nstiffness: {bar: 50, drive: 50}\n")
    (folder / "fleet.yaml").write_text(
        "format: ppmcal/batch/1\nmodel: mine.yaml\ncampaigns:\n"
        "  - {machine: hexapod-07, date: 2026-03-14, data: run1.csv}\n", encoding="utf-8")


@dataclass(frozen=True)
class Case:
    """One command in one place.

    Attributes:
        name: of the command.
        words: its arguments, without --out.
        work: the folder that it is run in; only the command's folders are in it.
        out: of its results, from ``work``; "." for results among others in the working folder.
        single: whether it has no --out.
    """

    name: str
    words: tuple[str, ...]
    work: Path
    out: str
    single: bool = False
    kept: dict[str, Path] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        return self.work / self.out

    @property
    def temporary(self) -> Path:
        """The folder for temporary files."""
        return self.work.with_name(f"{self.work.name}.tmp")

    @property
    def argv(self) -> list[str]:
        return [self.name, *self.words, *(() if self.single else ("--out", self.out))]

    def child(self) -> int:
        """Run the command, in a child: it changes the process."""
        tempfile.tempdir = str(self.temporary)
        return run(self.argv, self.work)

    def keep(self, name: str) -> None:
        """Keep the folder as it is now, under a name."""
        self.kept[name] = self.work.parent / f"{self.work.name}.{name}"
        shutil.rmtree(self.kept[name], ignore_errors=True)
        shutil.copytree(self.work, self.kept[name], symlinks=True)

    def restore(self, name: str) -> None:
        """Have the folder as it was kept, or empty, and no temporary files."""
        self.clean(self.temporary)
        self.clean(self.work)
        if name in self.kept:
            shutil.copytree(self.kept[name], self.work, symlinks=True, dirs_exist_ok=True)

    @staticmethod
    def clean(folder: Path) -> None:
        """Have a folder that is empty."""
        folder.mkdir(parents=True, exist_ok=True)
        for entry in os.scandir(folder):
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path)
            else:
                os.unlink(entry.path)


def cases(desk: Path, place: Path, names: list[str]) -> list[Case]:
    """Return the commands of these names in each of the places that they are tried in."""
    def words(text: str) -> tuple[str, ...]:
        return tuple(shlex.split(text.format(desk=desk)))

    found = [Case(n, words(t), place / n, "o") for n, t in COMMANDS.items() if n in names]
    found += [Case(n, words(t), place / f"{n}-here", ".")
              for n, t in COMMANDS.items() if n in names and n not in ("demo", "batch")]
    return found + [Case(n, words(t), place / n, ".", True)
                    for n, t in (FILES | NOTHING).items() if n in names]


def state(folder: Path) -> State:
    """Return the files of a folder and their SHA-256, the record among them; not its folders."""
    if not folder.is_dir():
        return {}
    return {e.name: hashlib.sha256(Path(e.path).read_bytes()).hexdigest()
            for e in os.scandir(folder)
            if e.is_file() and (e.name == RECORD or not e.name.startswith("."))}


def states(work: Path) -> dict[str, State]:
    """Return the state of each folder below one, hidden ones left out."""
    found = {}
    for path, folders, _ in os.walk(work):
        folders[:] = [f for f in folders if not f.startswith(".")]
        found[os.path.relpath(path, work)] = state(Path(path))
    return {k: v for k, v in found.items() if v}


def leftovers(work: Path) -> list[str]:
    """Return stages that are there below a folder, and beside it; and temporary files."""
    own = [os.path.relpath(Path(p) / f, work) for p, folders, files in os.walk(work)
           for f in (*folders, *files) if f.endswith(".part")]
    beside = [n for n in os.listdir(work.parent) if n == f".ppmcal.{work.name}.part"]
    temporary = work.with_name(f"{work.name}.tmp")
    return own + beside + (os.listdir(temporary) if temporary.is_dir() else [])


def age(case: Case) -> None:
    """Make results those of an earlier run: other content, one file more; notes of the user's."""
    folders = [path.parent for path in case.work.rglob(RECORD)]
    for folder in folders:
        record = json.loads((folder / RECORD).read_text())
        if record["files"]:
            command = next(iter(record["files"].values()))["command"]
            record["files"]["stale.csv"] = {"command": command, "sha256": ""}
            for name, entry in record["files"].items():
                text = f"old {name}\n".encode()
                (folder / name).write_bytes(text)
                entry["sha256"] = hashlib.sha256(text).hexdigest()
            record["files"] = dict(sorted(record["files"].items()))
            (folder / RECORD).write_text(json.dumps(record, indent=1) + "\n")
    if case.single:
        for path in case.work.iterdir():
            path.write_text(path.read_text() + "\nold\n")
    for folder in folders or [case.work]:
        (folder / "notes.txt").write_text("the user's\n")
        (folder / "link").symlink_to("notes.txt")
