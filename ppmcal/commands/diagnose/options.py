"""What ``ppmcal diagnose`` takes."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import (
    CONSOLE,
    EFFECTS,
    PARAMETERS,
    Arguments,
    Command,
    Machine,
    Measurements,
    leave_out,
    measurements,
    mechanism,
    option,
    seed,
    two_holdouts,
)

WIDTH = 74
"""Columns of a reason."""


def priors() -> Iterator[str]:
    """Yield each number that decides what is in the data, with its reason below it."""
    from ppmcal.inference.priors import CORRELATIONS, table

    several = ", ".join(f"{c:g}" for c in CORRELATIONS)
    for name, value, reason in (
            *((name, f"{p.value:.4g}", p.reason) for name, p in table().items()),
            ("correlations", several, "noise from row to row may have, each as often")):
        yield f"{name.lower().replace('_', ' ')}: {value}"
        yield textwrap.indent(textwrap.fill(reason, WIDTH), "    ")


@dataclass(frozen=True)
class DiagnoseArguments(Arguments):
    """What is looked for in what, and how the gap is measured."""

    mechanism: Machine = mechanism()
    data: Measurements = measurements()
    free: Sequence[str] | str = option(
        (), "Geometry that the fit may change, in place of the file's choice; frozen slots are "
        "candidates.", metavar="PATTERN", complete=PARAMETERS,
        key="Geometry that the fit may change, in place of the file's choice.")
    kinds: Sequence[str] = option((), "Try only these kinds of effect (may be repeated)", "--kind",
                                  metavar="KIND", otherwise="all", complete=EFFECTS,
                                  key="Try only these kinds of effect.")
    holdout: float = option(
        0.27, "Part of the poses that no fit sees, on which the gap is measured.", least=0.0,
        most=0.9, shown=True, key="Part of the poses that no fit sees.")
    leave_out: str = leave_out()
    seed: int = seed()
    png: bool = option(False, "Write the pictures as PNG too.")
    priors: bool = option(
        False, "Print every number that decides what is in the data, and its reason.",
        only=CONSOLE, prints=priors)

    def misuse(self, typed: Collection[str]) -> str:
        """Return why options do not go together."""
        return two_holdouts(self.leave_out, typed)


COMMAND = Command(
    "diagnose", DiagnoseArguments,
    about=("Find the physical effect that the model of {mechanism} misses in the measurements "
           "{data}.",
           "Names what is probable with its size, adds it to the model and shows on held-out poses "
           "how much of the gap is gone; or says that nothing is missing, what has no name, what "
           "cannot be told apart and what to measure next. Writes model.yaml, effects.csv, "
           "residuals.csv, diagnosis.json and the pictures gap.svg, actuators.svg, inputs.svg and, "
           "where effects cannot be told apart, alternatives.svg. What is left of an unnamed or "
           "partly named disagreement is learned as smooth functions, if poses left out of the "
           "fits confirm them: terms.svg."),
    examples=("ppmcal diagnose mine.yaml run2.csv",), out="diagnosed", result="DiagnosisResult",
    record=("diagnosis", "ppmcal.io.results.diagnosis:DiagnosisRecord"),
    raises="BadInput: anything wrong in the files, or a kind that there is not. NoResult: "
           "measurements that do not fit the machine at all, or no convergence.",
    shares={"reading the measurements": 0.05,
            "comparing the measurements with the nominal machine": 0.1,
            "choosing what to fit": 0.01, "fitting geometry": 0.5,
            "searching for causes in the data": 10.3, "judging the campaign": 0.1,
            "writing the results": 1.6})
