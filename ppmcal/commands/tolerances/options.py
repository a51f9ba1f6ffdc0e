"""What ``ppmcal tolerances`` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import (
    Arguments,
    Command,
    Machine,
    Path_,
    Table,
    cores,
    mechanism,
    metric,
    option,
    scheduler,
    seed,
    tool,
)


@dataclass(frozen=True)
class TolerancesArguments(Arguments):
    """The accuracy that is wanted, and how machines are drawn, measured and judged."""

    mechanism: Machine = mechanism()
    accuracy: float | None = option(
        None, "Largest position error of the tool that is allowed.", metavar="LENGTH")
    rotation: float | None = option(
        None, "Largest rotation error that is allowed.", metavar="ANGLE")
    share: float = option(0.95, "Share of machines that must meet it, before calibration.",
                          "--yield", shown=True)
    method: str = option(
        "cost", "Which tolerances to verify: of least cost, of equal contributions, one for all, "
        "or the file's own.", choices=("cost", "equal", "mean", "file"), shown=True)
    poses: Table | None = option(None, "Task poses, a CSV", otherwise="drawn over the workspace")
    instrument: Path_ | None = option(
        None, "Calibrate with this instrument, a data set's YAML", metavar="SIDECAR",
        otherwise="one whose noise is a tenth of the accuracy")
    measure: int = option(30, "Poses that a calibration measures.", least=4, most=1000, shown=True)
    machines: int = option(1000, "Machines to simulate.", least=20, most=10_000_000, shown=True)
    metric: float | None = metric()
    tool: str | Sequence[float] | None = tool("what --instrument measures, or the origin")
    cores: int | None = cores()
    scheduler: str | None = scheduler()
    seed: int = seed()


COMMAND = Command(
    "tolerances", TolerancesArguments,
    about=("Find tolerances with which {mechanism} keeps an accuracy, and count the machines that "
           "do.",
           "Writes tolerances.csv, errors.csv, allocated.yaml (the machine with these "
           "tolerances), yield.png and tolerances.json."),
    examples=("ppmcal tolerances mine.yaml --accuracy 0.2 --machines 50",), out="tolerances",
    result="TolerancesResult",
    record=("tolerances", "ppmcal.io.results.tolerances:TolerancesRecord"),
    shares={"allocating tolerances": 0.6, "simulating": 2.6, "writing the results": 0.4})
