"""What is done to a command, and what its folders must look like afterwards."""

from __future__ import annotations

import errno
import os
import signal
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ppmcal.store.folder import RECORD, read_record
from ppmcal.store.transaction import recover
from torture.desk import NOTHING, Case, State, age, leftovers, states
from torture.trace import TAKING, End, Runner, forked

DONE = (0, 1)
SOME = 5


@dataclass
class Tally:
    """What came of many attempts: how often each outcome was seen, and what was wrong."""

    seen: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def __add__(self, other: Tally) -> Tally:
        return Tally(self.seen + other.seen, self.wrong + other.wrong)


@dataclass(frozen=True)
class Start:
    """A folder before a command, and as the command leaves it when nothing happens.

    Attributes:
        name: ``old``: results of an earlier run are there; empty: nothing is.
        before: states of the folders before.
        after: states of the folders after.
        calls: system calls that change files, in their order.
        code: exit code.
        first: runs the command.
        second: runs it meanwhile, or afterwards.
    """

    name: str
    before: dict[str, State]
    after: dict[str, State]
    calls: tuple[str, ...]
    code: int
    first: Runner
    second: Runner


def starts(case: Case) -> Iterator[Start]:
    """Yield where a command starts from: nothing, and results of before with notes beside."""
    case.restore("")
    code = forked(case.child)
    if code not in DONE:
        said = case.work.parent / "said"
        forked(case.child, said)
        raise RuntimeError(f"{' '.join(case.argv)}: exit code {code}\n{said.read_text()}")
    first, second = (Runner(case.child, case.work.parent / said) for said in ("said", "again"))
    found = []
    for name in ("", "old") if any(case.work.iterdir()) else ("",):
        if name:
            age(case)
            case.keep(name)
        case.restore(name)
        before = states(case.work)
        end = first.run()
        found.append(Start(name, before, states(case.work), end.calls, end.code, first, second))
    try:
        yield from found
    finally:
        first.close()
        second.close()


def kills(case: Case, every: int = 1) -> Tally:
    """Kill a command before each (or every so many) of its calls, and run it again."""
    tally = Tally()
    for start in starts(case):
        for number in range(1, len(start.calls) + 1, every):
            case.restore(start.name)
            notes = _notes(case)
            end = start.first.run(lambda n, _, child, at=number: _kill(child) if n == at
                                  else None)
            where = f"{case.work.name} {start.name}, call {number} {start.calls[number - 1]}"
            if not end.killed:
                tally.wrong.append(f"{where}: not killed, exit code {end.code}")
            tally.seen["kills"] += 1
            case.clean(case.temporary)    # nobody but the system sweeps that
            _judge(case, start, where, tally)
            _again(case, start, where, tally)
            if _notes(case) != notes:
                tally.wrong.append(f"{where}: the user's notes are others")
    return tally


def full_disks(case: Case, every: int = 1, code: int = errno.ENOSPC) -> Tally:
    """Refuse a command each of its calls, alone and with all that need space after it."""
    tally = Tally()
    for start in starts(case):
        for number in range(1, len(start.calls) + 1, every):
            for lasting in (False, True):
                case.restore(start.name)
                end = start.first.run(lambda n, name, _, at=number, on=lasting: code if n == at or
                                      (on and n > at and name in TAKING) else None)
                where = (f"{case.work.name} {start.name}, {errno.errorcode[code]} at call "
                         f"{number} {start.calls[number - 1]}{' and after' if lasting else ''}")
                tally.seen["disks"] += 1
                _refused(case, start, end, where, start.first.text(), tally)
                _judge(case, start, where, tally)
                if start.calls[number - 1] not in TAKING:
                    case.clean(case.temporary)    # what could not be taken away stays
                _again(case, start, where, tally, number)
    return tally


def signals(case: Case, every: int = 1) -> Tally:
    """Send Ctrl-C and SIGTERM before each call."""
    tally = Tally()
    for start in starts(case):
        for number in range(1, len(start.calls) + 1, every):
            for kind in (signal.SIGINT, signal.SIGTERM):
                case.restore(start.name)
                end = start.first.run(lambda n, _, child, at=number, k=kind:
                                      os.kill(child, k) if n == at else None)
                where = (f"{case.work.name} {start.name}, {kind.name} at call {number} "
                         f"{start.calls[number - 1]}")
                tally.seen["signals"] += 1
                if end.code != 128 + kind:
                    tally.wrong.append(f"{where}: exit code {end.code}")
                _silent(start.first.text(), where, tally)
                _judge(case, start, where, tally)
                _again(case, start, where, tally, number)
    return tally


def crowds(case: Case, every: int = 1) -> Tally:
    """Run a command while another of its kind is held before each of its calls."""
    tally = Tally()
    for start in starts(case):
        for number in range(1, len(start.calls) + 1, every):
            case.restore(start.name)
            found = list[int]()
            end = start.first.run(lambda n, *_, at=number, start=start, found=found:
                                  found.append(start.second.run().code) if n == at else None)
            where = f"{case.work.name} {start.name}, second run at call {number}"
            text = " ".join(start.second.text().split())
            busy = found == [2] and "another run is writing there" in text
            tally.seen["two at once"] += 1
            tally.seen["second refused"] += busy
            if not (busy or found[0] == start.code):
                tally.wrong.append(f"{where}: the second left with {found}: {text[-300:]}")
            if end.code != start.code and not (end.code == 2 and found[0] in DONE):
                tally.wrong.append(f"{where}: the first left with {end.code}")
            _silent(text, where, tally)
            if states(case.work) != start.after or leftovers(case.work):
                tally.wrong.append(f"{where}: {leftovers(case.work)}, "
                                   f"{_other(states(case.work), start)}")
    return tally


def _kill(child: int) -> None:
    os.kill(child, signal.SIGKILL)


def _notes(case: Case) -> list[int]:
    """Return the inodes of what is the user's."""
    return [(Path(p) / "notes.txt").stat().st_ino for p, _, files in sorted(os.walk(case.work))
            if "notes.txt" in files and ".part" not in p]


def _judge(case: Case, start: Start, where: str, tally: Tally) -> None:
    """Tell whether each folder is the old or the new one; finish what can be, as a reader does."""
    now = states(case.work)
    mixed = [f for f in _other(now, start) if case.name != "batch" or not _whole(
        case.work / f, now.get(f, {}), (start.before.get(f, {}), start.after.get(f, {})))]
    if mixed:
        tally.seen["finished when read"] += 1
        forked(lambda: [recover(case.work / f) for f in mixed] and 0)
        now = states(case.work)
        if any(now.get(f, {}) != start.after.get(f, {}) for f in mixed):
            tally.wrong.append(f"{where}: mixed: {mixed}")
    elif now == start.after != start.before:
        tally.seen["new"] += 1
    else:
        tally.seen["old" if start.name else "nothing"] += 1


def _other(now: dict[str, State], start: Start) -> list[str]:
    """Return folders that are neither the old nor the new one, whole."""
    def sound(folder: str) -> bool:
        held, old = now.get(folder, {}), start.before.get(folder, {})
        claimed = set(held) == {RECORD} and not old    # by a command that fills folders in it
        return claimed or held in (old, start.after.get(folder, {}))

    return [f for f in {*now, *start.before, *start.after} if not sound(f)]


def _whole(folder: Path, held: State, known: Sequence[State]) -> bool:
    """Whether a folder is as its own record has it: that of a batch may say which have failed."""
    return {*held} in map(set, known) and all(
        held.get(name) == written.digest for name, written in read_record(folder).files.items())


def _again(case: Case, start: Start, where: str, tally: Tally, number: int = 0) -> None:
    """Run the command once more: it must succeed and leave nothing but its results.

    Where nothing was left behind, one ``number`` in so many will do.
    """
    if number % SOME and not leftovers(case.work):
        return
    code = start.second.run().code
    now = states(case.work)
    if code != start.code or now != start.after or leftovers(case.work):
        tally.wrong.append(f"{where}: run again: exit code {code}, {_other(now, start)}, "
                           f"{leftovers(case.work)}")


def _refused(case: Case, start: Start, end: End, where: str, said: str, tally: Tally) -> None:
    """Check exit code and words of a command that was refused a call."""
    _silent(said, where, tally)
    now = states(case.work)
    done = (start.code,) if case.name in NOTHING else DONE
    refused = (2, 3) if case.name in NOTHING else (2,)
    if end.code not in (*done, *refused) or (
            end.code in done and now != start.after and case.name != "batch"):
        tally.wrong.append(f"{where}: exit code {end.code}, {_other(now, start)}: {said[-200:]}")
    if end.code in refused and now != start.before and case.name not in ("batch", "demo"):
        tally.wrong.append(f"{where}: refused, yet changed {_other(now, start)}: {said[-200:]}")


def _silent(said: str, where: str, tally: Tally) -> None:
    """Check that nothing broke."""
    if "fault of ppmcal" in " ".join(said.split()) or "Traceback" in said:
        tally.wrong.append(f"{where}: {said[-400:]}")
