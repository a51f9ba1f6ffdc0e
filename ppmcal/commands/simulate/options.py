"""What ``ppmcal simulate`` takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ppmcal.commands.spec import Arguments, Command, Machine, Path_, argument, mechanism, seed


@dataclass(frozen=True)
class SimulateArguments(Arguments):
    """The machine, and how it is measured."""

    mechanism: Machine = mechanism()
    scenario: Path_ | Mapping[str, Any] = argument(
        "SCENARIO", "Path of a scenario file, or a mapping with its keys.", words="scenario")
    seed: int | None = seed(None)


COMMAND = Command(
    "simulate", SimulateArguments,
    about=("Simulate measurements of {mechanism} as {scenario} says.",
           "Writes measurements.csv, measurements.yaml and truth.json."),
    examples=("ppmcal simulate mine.yaml mine.scenario.yaml --seed 7",), out="simulated",
    result="SimulationResult",
    record=("truth", "ppmcal.io.results.simulation:TruthRecord"),
    raises="BadInput: anything wrong in the files. NoResult: no pose can be reached.",
    shares={"simulating": 5.5, "writing the results": 1.2})
