"""What ``ppmcal export`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import (
    Arguments,
    Command,
    Machine,
    Path_,
    argument,
    option,
    regardless,
)
from ppmcal.controllers import about, examples, exported, own


def _names() -> str:
    *others, last = exported()
    return f"{', '.join(others)} or {last}."


def _about() -> str:
    return " ".join(f"{{form}} {one}" for one in about())


@dataclass(frozen=True)
class ExportArguments(Arguments):
    """For which controller, and against what."""

    form: str = argument("FORMAT", _names, complete="ppmcal.controllers:exported")
    model: Machine = argument("MODEL", "The identified machine, or its file.", words="machine")
    old: Path_ | None = option(
        None, "The controller's file in use, to predict the gain against",
        otherwise="the nominal values of {model}")
    poses: Path_ | None = option(None, "Wanted poses, for formats that are tables of them.")
    write: bool = option(
        False, "Put the new numbers into --old "
        f"({', '.join(name for name, one in own().items() if one.copies)}), which is kept beside "
        "as it was; it has to be the file that {model} was read from.")
    regardless: bool = regardless(
        "a model whose fit had not converged or whose residuals are far beyond the noise of its "
        "own measurements, and of numbers that are not better than the old ones")


COMMAND = Command(
    "export", ExportArguments,
    about=("Write {model} as a controller's configuration takes it.",
           _about,
           "The file is read back, and the machine is driven through the controller's own "
           "arithmetic with the old and the new numbers; what the controller cannot express is "
           "listed with what that costs. Refused, unless --regardless says so: a model whose fit "
           "had not converged or whose residuals are far beyond the noise of its own measurements, "
           "numbers that are predicted to be worse than the old ones, and those of a fit that "
           "predicts what it has not seen no better than the machine did before. Writes the "
           "controller's file and export.json."),
    examples=examples("export"),
    out="exported", replace="--overwrite", result="ExportResult",
    record=("export", "ppmcal.io.results.export:ExportRecord"),
    raises="BadInput: a machine that this controller does not drive, or an option without use. "
           "NoResult: the file does not read back as what it was written from, or it is not safe "
           "to use it.",
    shares={"reading the table": 0.15, "correcting the grid": 12.0, "how sure the model is": 5.0,
            "predicting errors of the grid": 2.5, "writing the results": 1.6})
