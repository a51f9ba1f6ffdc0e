"""What ``ppmcal check`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import (
    CONSOLE,
    Arguments,
    Command,
    Machine,
    Measurements,
    Path_,
    measurements,
    mechanism,
    option,
)


@dataclass(frozen=True)
class CheckArguments(Arguments):
    """The machine, its measurements if there are any, and whether it is drawn."""

    mechanism: Machine = mechanism()
    data: Measurements = measurements(())
    draw: Path_ | None = option(
        None, "Draw the machine to scale, as an HTML page to turn and move, offline.",
        metavar="PATH", only=CONSOLE)


COMMAND = Command(
    "check", CheckArguments,
    about=("Check {mechanism}: schema, closure and singularity at home, units, what {data} can "
           "see.",),
    examples=("ppmcal check mine.yaml --draw machine.html", "ppmcal check mine.yaml run1.csv"),
    result="CheckResult", files=True, recorded=False,
    raises="BadInput: anything wrong in the files, with file, place and hint.",
    shares={"reading the measurements": 0.4, "checking": 4.0})
