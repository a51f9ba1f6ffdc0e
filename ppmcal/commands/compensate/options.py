"""What ``ppmcal compensate`` takes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import (
    Arguments,
    CalibratedMachine,
    Command,
    Machine,
    Path_,
    Table,
    argument,
    option,
    regardless,
)


def assumed(given: Sequence[str]) -> dict[str, float]:
    """Return name -> value of what is assumed.

    Raises:
        ValueError: not of the form NAME=VALUE, or named twice.
    """
    out: dict[str, float] = {}
    for one in given:
        name, _, text = one.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not name or not math.isfinite(value):
            raise ValueError(f"--assume {one}: write NAME=VALUE, such as temperature=22.")
        if name in out:
            raise ValueError(f"--assume {one}: {name} has a value already.")
        out[name] = value
    return out


@dataclass(frozen=True)
class CompensateArguments(Arguments):
    """The identified machine, the wanted poses, and what they mean."""

    model: Machine | CalibratedMachine = argument(
        "MODEL", "The identified machine: its file, or what identify or diagnose returned.")
    targets: Table = argument(
        "TARGETS", "Poses: path of a CSV, data frame, mapping of columns or array (N, d) of the "
        "machine's coordinates, in the mechanism file's units.")
    frame: str | None = option(
        None, "Data set whose measuring frame the targets are in: poses of the mark that it "
        "measured, which need not be the platform's origin. Or 'base': poses of the platform's "
        "origin in the base frame", metavar="NAME", otherwise="the model's only data set",
        key="Data set whose measuring frame the targets are in, or base.")
    knowledge: Path_ | None = option(None, "identification.json of {model}",
                                     otherwise="beside it",
                                     key="identification.json of the model.")
    approach: str = option(
        "columns", "Directions of approach: from dir_ columns, or from the order of the targets.",
        choices=("columns", "sequence"), shown=True)
    path: bool = option(
        True, "Targets are visited in their order: judge the straight ways between them too, or "
        "each target alone.", "--path/--no-path", shown=True, key="Targets are visited in their "
        "order: judge the ways between them too  [default: true].")
    assume: Mapping[str, float] | None = option(
        None, "A condition of all targets that has no column, such as temperature=22.",
        metavar="NAME=VALUE", kind="str", several=True, reads=assumed,
        key="Conditions of all targets that have no column, such as {temperature: 22}.")
    like: Path_ | None = option(
        None, "Measurement file: commands_recorded.csv has the commands as that has its joints, "
        "in its units, under its headers, with its decimal mark", metavar="FILE",
        otherwise="the identification's own file, where that is otherwise than {model}",
        key="Measurement file as which commands_recorded.csv has the commands.")
    regardless: bool = regardless(
        "a model whose fit had not converged or whose residuals are far beyond the noise of its "
        "own measurements, and of corrections that are predicted to be worse than none",
        "Lift the refusals of a model that is not fit for use, and of corrections worse than none.")


COMMAND = Command(
    "compensate", CompensateArguments,
    about=("Turn the wanted poses {targets} into corrected commands of the identified {model}.",
           "Without --frame base, {targets} say where the measured mark is to be, in the frame of "
           "the instrument that measured it; with it, where the platform's origin is to be, in "
           "base axes.",
           "Rows outside limits, across singularities, far outside the measured volume, farther "
           "from the uncorrected command than tolerances explain, worse off with the correction "
           "than without, or unsafe to reach from the previous row are refused, each with "
           "its reason. A model whose fit had not converged, or whose residuals are far beyond the "
           "noise of its own measurements, is refused as a whole. --regardless lifts that, and the "
           "refusal of rows worse off; what may break the machine stays refused. Writes "
           "commands.csv and commands.json; and, where joints were recorded in other units, under "
           "other headers or with other marks than the machine's file has, commands_recorded.csv, "
           "which has them so."),
    examples=("ppmcal compensate identified targets.csv --frame base",), out="compensated",
    replace="--overwrite", result="CompensationResult",
    record=("commands", "ppmcal.io.results.commands:CommandsRecord"),
    raises="BadInput: anything wrong in the files, or a frame that the model does not know. "
           "NoResult: commands that are predicted to be worse than none, a model whose fit had not "
           "converged or whose residuals are far beyond the noise of its own measurements, or a "
           "singular home.",
    shares={"reading the table": 0.15, "finding commands": 11.9, "writing the results": 1.6})
