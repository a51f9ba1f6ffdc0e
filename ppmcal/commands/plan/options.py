"""What ``ppmcal plan`` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, Machine, Path_, Table, mechanism, option, seed

MOST_COUNT = 1000
"""Measurements that a plan may have."""


@dataclass(frozen=True)
class PlanArguments(Arguments):
    """What measures, what it is for, and what can be set."""

    mechanism: Machine = mechanism()
    count: int | None = option(None, "Measurements to take", least=2, most=MOST_COUNT,
                               otherwise="until one more hardly helps")
    instrument: Path_ | None = option(
        None, "What measures, as beside a measurement file", metavar="SIDECAR.yaml",
        otherwise="the full pose, a tenth of the tolerances")
    tasks: Table | None = option(
        None, "Poses at which the machine has to be exact", metavar="POSES.csv",
        otherwise="the whole region")
    candidates: Table | None = option(
        None, "Poses to choose from", metavar="POSES.csv",
        otherwise="drawn in the machine's region")
    effects: Sequence[str] = option(
        (), "Effects to be shown too, such as backlash,compliance.", "--for", metavar="KINDS")
    payload: str | Sequence[float] | None = option(
        None, "Payloads that can be put on, kg.", metavar="LOW,HIGH")
    temperature: str | Sequence[float] | None = option(
        None, "Temperatures that can be set, deg C.", metavar="LOW,HIGH")
    tension: str | Sequence[float] | None = option(
        None, "Mean tensions by which ropes can be pulled tight, N.", metavar="LOW,HIGH")
    accuracy: float | None = option(
        None, "Wanted standard deviation of position at the tasks, in MECH's length unit.")
    seed: int = seed()


COMMAND = Command(
    "plan", PlanArguments,
    about=("Choose the poses of {mechanism} that are worth measuring.",
           "D-optimal for the parameters that {mechanism} leaves free, with its tolerances as "
           "prior; ordered into a short path. Writes poses.csv, accuracy.csv, plan.json and "
           "accuracy.png."),
    examples=("ppmcal plan mine.yaml --count 15",), out="plan",
    result="PlanResult",
    record=("plan", "ppmcal.io.results.plan:PlanRecord"),
    raises="BadInput: anything wrong in the files or options. NoResult: no pose can be reached.",
    shares={"drawing candidates": 0.9, "information of each candidate": 0.2, "choosing": 2.6,
            "writing the results": 0.6})
