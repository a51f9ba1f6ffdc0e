"""Commands on disks that are really full or read-only, in odd locales, with odd names of files."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torture.desk import NOTHING, Case, leftovers, run, states
from torture.faults import DONE, Start, Tally, _again, _judge, _refused, _silent, starts
from torture.trace import End, forked

NAMES = ("a b", "it's \"quoted\"", "line\nbreak", "-dash", "🦀", "{0}%s$(x)`y`", "semi;colon,comma",
         os.fsdecode(b"\xff\xfe latin"), "x" * 150, "<b>&amp;", "back\\slash", "İı")
LOCALES = ({"LC_ALL": "C"}, {"LC_ALL": "POSIX", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
           {"LC_ALL": "tr_TR.UTF-8"}, {"LC_ALL": "de_DE.ISO-8859-1", "LANG": "de_DE"})
SAID = "\0"
"""Ends what a command says, where several speak in one process."""
GROWTH = 1.15
"""From one size of a disk to the next."""


def may_mount() -> bool:
    """Whether file systems can be mounted here."""
    return os.geteuid() == 0 and shutil.which("mount") is not None


def small_disks(case: Case) -> Tally:
    """Run a command on file systems of a few kilobytes and more, until it fits; then read-only."""
    tally = Tally()
    said = case.work.parent / "said"
    if not may_mount():
        return tally
    for start in starts(case):
        size, code = 16, 2
        while code not in DONE and size < 200_000:
            with _mounted(case, start, size) as fits:
                if fits:
                    tally.seen["small disks"] += 1
                    code = forked(case.child, said)
                    _after(case, start, code, f"disk of {size} kB", tally)
                    if code not in DONE:
                        _mount(case, "remount,size=400m")
                        _again(case, start, f"{case.work.name}, grown from {size} kB", tally)
            size = int(size * GROWTH) // 4 * 4 + 4
        with _mounted(case, start, 100_000):
            _mount(case, "remount,ro")
            tally.seen["read-only"] += 1
            code = forked(case.child, said)
            _after(case, start, code, "read-only", tally)
            if code in DONE:
                tally.wrong.append(f"{case.work.name}: wrote to a read-only disk")
    return tally


def _after(case: Case, start: Start, code: int, what: str, tally: Tally) -> None:
    """Judge what a run on such a disk has left."""
    where = f"{case.work.name} {start.name}, {what}"
    said = (case.work.parent / "said").read_text(errors="replace")
    _refused(case, start, End(code, ()), where, said, tally)
    _judge(case, start, where, tally)
    if leftovers(case.work):
        tally.wrong.append(f"{where}: {leftovers(case.work)}")


@contextmanager
def _mounted(case: Case, start: Start, size: int) -> Iterator[bool]:
    """Have a file system of ``size`` kB where the command works; yield whether its start fits."""
    shutil.rmtree(_disk(case), ignore_errors=True)
    _disk(case).mkdir(parents=True)
    _mount(case, f"size={size}k")
    try:
        try:
            case.restore(start.name)
            fits = True
        except OSError:
            fits = False
        yield fits
    finally:
        subprocess.run(["umount", _disk(case)], check=True)


def _mount(case: Case, options: str) -> None:
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", _disk(case)], check=True)


def _disk(case: Case) -> Path:
    """Return where a command writes."""
    return case.temporary if case.name in NOTHING else case.work


def odd_names(place: Path) -> Tally:
    """Run a planar machine's job with odd names of files and folders."""
    tally = Tally()
    said = place / "said"
    for name in NAMES:
        folder = place / "names" / name
        folder.mkdir(parents=True)
        for line in _job(f"./{name}"):
            tally.seen["odd names"] += 1
            code = forked(lambda words=tuple(line), at=folder: run([*words], at), said)
            _silent(said.read_text(errors="replace"), f"{name!r}: {line[0]}", tally)
            if code not in DONE:
                tally.wrong.append(f"{name!r}: {line[0]}: {code}: "
                                   f"{said.read_text(errors='replace')[-300:]}")
                break
        if leftovers(folder) or len(states(folder)) != 4:
            tally.wrong.append(f"{name!r}: {leftovers(folder)} {list(states(folder))}")
    return tally


def odd_locales(place: Path) -> Tally:
    """Run it as processes of other locales, with a name that they cannot write."""
    tally = Tally()
    code = "import sys; from torture.surroundings import tell_job; tell_job(sys.argv[1])"
    path = os.pathsep.join(filter(None, [str(Path(__file__).resolve().parents[1]),
                                         os.environ.get("PYTHONPATH")]))
    job = [line[0] for line in _job("")]
    for number, wanted in enumerate(LOCALES):
        folder = place / f"locale{number}"
        folder.mkdir()
        done = subprocess.run(
            [sys.executable, "-c", code, "./Größe🦀"], cwd=folder, check=False,
            env={**os.environ, "PYTHONPATH": path, **wanted}, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT)
        *told, rest = done.stdout.decode(errors="replace").split(SAID)
        if rest or done.returncode:
            tally.wrong.append(f"{wanted}: ended by {done.returncode}: {rest[-300:]}")
        for command, text in zip(job, told, strict=False):
            tally.seen["locales"] += 1
            said, _, ended = text.rpartition("\n")
            _silent(said, f"{wanted}: {command}", tally)
            if int(ended) not in DONE:
                tally.wrong.append(f"{wanted}: {command}: {ended}: {said[-300:]}")
        if len(told) != len(job):
            tally.wrong.append(f"{wanted}: {len(told)} commands have ended")
    return tally


def tell_job(name: str) -> None:
    """Run the job in this process; after each command's words, write its exit code."""
    for line in _job(name):
        code = run(line, Path.cwd())
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os.write(1, f"\n{code}{SAID}".encode())
        if code not in DONE:
            break


def _job(name: str) -> Iterator[list[str]]:
    """Yield the commands of a small calibration, everything called by that name."""
    mech = f"{name}.yaml"
    yield ["init", "3-RPR", "--out", mech]
    yield ["check", mech, "--draw", f"{name}.html"]
    yield ["simulate", mech, f"{name}.scenario.yaml", "--out", f"{name}-s"]
    yield ["identify", mech, f"{name}-s/measurements.csv", "--out", f"{name}-i"]
    yield ["report", f"{name}-s", f"{name}-i", "--out", f"{name}-r"]
