"""What ``ppmcal validate`` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import (
    Arguments,
    CalibratedMachine,
    Command,
    Machine,
    Measurements,
    Path_,
    argument,
    measurements,
    option,
    seed,
)


@dataclass(frozen=True)
class ValidateArguments(Arguments):
    """The machine, what it is judged by, and beside which others."""

    model: Machine | CalibratedMachine = argument(
        "MODEL", "The machine: its file, a folder that identify or diagnose wrote, or what these "
        "returned.")
    data: Measurements = measurements()
    against: Sequence[Path_] = option(
        (), "Another calibration of the machine (file or folder), judged by the same rows.",
        metavar="OTHER", kind="Machine")
    register: Sequence[str] | str | None = option(
        None, "What the registration fits", otherwise="what the files leave open, and what the "
        "data demand beyond it", choices=("frame", "target", "rotation", "homing", "none"))
    seed: int = seed()
    png: bool = option(False, "Write the picture as PNG too.")


COMMAND = Command(
    "validate", ValidateArguments,
    about=("Predict the measurements {data}, which no fit has seen, with {model} as it is.",
           "{model} is a mechanism file or a folder that identify or diagnose wrote. Only the "
           "registration is fitted. Each effect is left out in turn, and the nominal machine is "
           "judged beside it, all by the same rows. Figures have 95 % intervals over poses. Where "
           "the model predicts surely worse than itself without an effect, or than another "
           "machine, that is a finding: exit code 1. Writes validation.csv, validation.json and "
           "the picture validation.svg."),
    examples=("ppmcal validate identified run2.csv --against identified-may",), out="validated",
    result="ValidationResult",
    record=("validation", "ppmcal.io.results.validation:ValidationRecord"),
    raises="BadInput: anything wrong in the files, another machine, or rows that it cannot "
           "predict.",
    shares={"reading the measurements": 0.01, "looking at the noise": 2.2,
            "predicting with and without each effect": 2.9, "writing the results": 1.0})
