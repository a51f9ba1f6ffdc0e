"""What ``ppmcal sensitivity`` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import (
    PARAMETERS,
    Arguments,
    Command,
    Machine,
    Table,
    grid,
    mechanism,
    metric,
    option,
    tool,
)


@dataclass(frozen=True)
class SensitivityArguments(Arguments):
    """Which errors, where, and at which point of the platform."""

    mechanism: Machine = mechanism()
    poses: Table | None = option(None, "Poses to look at, a CSV.")
    grid: str | None = grid()
    home_only: bool = option(False, "Look at home alone, draw no maps.")
    all_components: bool = option(
        False, "All error components of every joint frame and the platform points (21 for a leg), "
        "also those that the closure cancels.")
    free: Sequence[str] = option((), "Errors to look at, by name", metavar="PATTERN",
                                 otherwise="the file's free parameters", complete=PARAMETERS)
    tool: str | Sequence[float] | None = tool()
    metric: float | None = metric()
    sigmas: float = option(1.0, "Worst case: every error at this many standard deviations.",
                           shown=True)
    together: Sequence[str] = option(
        (), "Try the linear model with these errors all off by the same amount", metavar="PATTERN",
        otherwise="all errors at once by their tolerances")
    size: float | None = option(
        None, "With --together: also print what an error of this size does.", metavar="ERROR")


COMMAND = Command(
    "sensitivity", SensitivityArguments,
    about=("Tell what each geometric error of {mechanism} does to the tool.",
           "Writes sensitivity.csv (the Jacobian at home, errors ranked), map.csv (amplification "
           "index, root sum square and worst case by pose), linearity.csv, pictures and "
           "sensitivity.json."),
    examples=("ppmcal sensitivity mine.yaml --home-only",), out="sensitivity",
    result="SensitivityResult",
    record=("sensitivity", "ppmcal.io.results.sensitivity:SensitivityRecord"),
    raises="BadInput: anything wrong in the files or options. NoResult: home is singular.",
    shares={"what each error does": 0.3, "writing the results": 1.9})
