"""What ``ppmcal read`` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from ppmcal.commands.spec import (
    CONSOLE,
    PYTHON,
    Arguments,
    Command,
    Machine,
    Path_,
    argument,
    needed,
    option,
)


@dataclass(frozen=True)
class ReadArguments(Arguments):
    """Which files of which machine, how they are put together, and where to."""

    files: Path_ | Sequence[Path_] = argument(
        "FILES...", "A table with joint values and what was measured; or a joint log, and lists of "
        "points (name, x, y, z and perhaps time) that are put beside it; or a bag with both.",
        kind="Machine", several=True)
    mechanism: Machine = needed("The machine that was measured.")
    out: Path_ | None = option(None, "CSV to write; its sidecar has the same stem.", only=CONSOLE,
                               typed="run.csv", shown=True)
    force: bool = option(False, "Overwrite files that exist; never an input.", only=CONSOLE)
    sidecar: Path_ | None = option(None, "What the numbers are, and how to read them",
                                   otherwise="the YAML beside one of {files}")
    join: str | None = option(
        None, "How points find their rows: a point's name is the log's `pose`, or by the nearest "
        "time", otherwise="name where names agree", choices=("name", "time"))
    tolerance: float = option(0.5, "How far apart two times may be, s.", metavar="S", least=0.0,
                              shown=True)
    partial: bool = option(False, "Leave out points and rows that match nothing, and name them.")
    interpolate: bool = option(
        False, "Joint values between the rows about a point's time, not those of the nearest.")
    clock_offset: float | str | None = option(
        None, "What the points' clock is ahead of the log's, s; find: from the motion that both "
        "saw, refused unless it is clear.", metavar="S|find", kind="str")
    names: str | None = option(
        None, "How points are called where several targets are on the platform, such as "
        "{pose}_{target}: one CSV for each target.", metavar="PATTERN")
    combined: bool = option(
        False, "Of several targets on the platform whose points are known: one CSV of poses, with "
        "each row's covariance, where three are seen (in the plane two).")
    units: str | None = option(
        None, "Length unit of points whose header names none", otherwise="the sidecar's",
        choices=("m", "cm", "mm", "um", "in"))
    name: str = option("run", "Of the files that save writes, without their ends.", only=PYTHON)

    def completed(self) -> Self:
        """Return the arguments with the name that ``out`` says."""
        return self if self.out is None else replace(self, name=Path(self.out).stem)


COMMAND = Command(
    "read", ReadArguments,
    about=("Turn {files} of instruments and controllers into a measurement file.",
           "{files} are a table, or a joint log and lists of points (name, x, y, z, perhaps time), "
           "separated by commas, semicolons, tabs or spaces; or recordings of ROS (CSV or bag). "
           "Says what it understood, and writes a CSV and its sidecar."),
    examples=("ppmcal read log.csv points.txt --mechanism mine.yaml --out joined.csv",
              "ppmcal read log.csv points.txt --mechanism mine.yaml --join name --partial"),
    result="ReadResult", files=True,
    raises="BadInput: anything wrong in the files, rows that cannot be joined, or no joint values.")
