"""Torture the commands and print what came of it: ``python -m torture``."""

from __future__ import annotations

import argparse
import gc
import os
import shutil
import sys
import tempfile
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from torture import faults, surroundings
from torture.desk import COMMANDS, FILES, NOTHING, Case, cases, make_desk, remember, run
from torture.faults import Tally
from torture.trace import AVAILABLE, forked

KINDS = {"kills": faults.kills, "disks": faults.full_disks, "signals": faults.signals,
         "crowds": faults.crowds, "small": lambda case, _: surroundings.small_disks(case)}
WORLDS = {"names": surroundings.odd_names, "locales": surroundings.odd_locales}

COLUMNS = {"kills": ("kills",), "refused": ("disks",), "signals": ("signals",),
           "two runs": ("two at once",), "full": ("small disks", "read-only"),
           "others": ("odd names", "locales")}
"""Heading -> attempts that it counts."""
OUTCOMES = ("nothing", "old", "new", "finished when read")
MEMORY = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
"""Where it is done unless asked otherwise: on a disk, most of the time is spent waiting for it."""


def prepared(place: Path, names: list[str]) -> Path:
    """Return a folder with everything that the commands read."""
    desk = place / "desk"
    make_desk(desk)
    if {*names} <= {"import", "simulate", "kinematics", "demo", *FILES}:
        return desk
    for line in map(str.split, (
                 "identify mine.yaml run1.csv --out identified",
                 "simulate mine.yaml mine.scenario.yaml --seed 5 --out may",
                 "identify mine.yaml may/measurements.csv --out identified-may",
                 "compensate identified targets.csv --out compensated")):
        said = place / "said"
        if forked(lambda words=line: run([*words, "-q"], desk), said) not in faults.DONE:
            raise RuntimeError(f"{' '.join(line)}: {said.read_text(errors='replace')}")
    return desk


def main() -> int:
    """Run what is asked for; return 1 where something was wrong."""
    parser = argparse.ArgumentParser(prog="python -m torture", description=__doc__)
    parser.add_argument("names", nargs="*", help="commands  [default: all that write]")
    parser.add_argument("--kinds", default=",".join([*KINDS, *WORLDS]),
                        help=f"of {', '.join([*KINDS, *WORLDS])}")
    parser.add_argument("--every", type=int, default=1, help="at every so many calls only")
    parser.add_argument("--on", type=Path, default=None, help="folder on the file system to try")
    asked = parser.parse_args()
    if not AVAILABLE:
        sys.exit("Torture needs Linux on x86-64.")
    place = Path(tempfile.mkdtemp(prefix="torture-", dir=asked.on or MEMORY))
    try:
        return _all(asked, place)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _all(asked: argparse.Namespace, place: Path) -> int:
    kinds = asked.kinds.split(",")
    names = (asked.names or [*COMMANDS, *FILES, *NOTHING]) if {*kinds} & {*KINDS} else []
    desk = prepared(place, names)
    inputs = tree(desk)
    remember()
    total, began = Tally(), time.monotonic()
    print(f"{'':20}" + "".join(f"{heading:>9}" for heading in COLUMNS) + "  wrong")
    for case in cases(desk, place, names):
        case.restore("")
        _computed(case)
        gc.freeze()
        total += _told(case.work.name, [
            KINDS[k](case, asked.every) for k in kinds
            if k in KINDS])
    for kind in kinds:
        if kind in WORLDS and not asked.names:
            total += _told(kind, [WORLDS[kind](place)])
    if tree(desk) != inputs:
        total.wrong.append("an input has changed")
    _line("all", total)
    print(f"{time.monotonic() - began:.0f} s; kills and the like found the folder: "
          + ", ".join(f"{k} {total.seen[k]}" for k in OUTCOMES))
    return int(bool(total.wrong))


def tree(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder with its bytes."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def _told(name: str, tallies: list[Tally]) -> Tally:
    """Print a line of the table, and the first of what was wrong."""
    own = sum(tallies, Tally())
    _line(name, own)
    for wrong in own.wrong[:20]:
        print(f"    {wrong}")
    sys.stdout.flush()
    return own


def _computed(case: Case) -> None:
    """Run a command in this process, so that its children remember what it computed."""
    home = os.getcwd()
    try:
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
            case.child()
    finally:
        os.chdir(home)


def _line(name: str, tally: Tally) -> None:
    print(f"{name:20}" + "".join(f"{sum(tally.seen[k] for k in keys) or '':>9}"
                                 for keys in COLUMNS.values()) + f"  {len(tally.wrong)}")


if __name__ == "__main__":
    sys.exit(main())
