"""What ``ppmcal identify`` takes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import (
    PARAMETERS,
    Arguments,
    Command,
    Machine,
    Measurements,
    Path_,
    leave_out,
    measurements,
    mechanism,
    option,
    seed,
    two_holdouts,
)


@dataclass(frozen=True)
class IdentifyArguments(Arguments):
    """What is fitted to what, how, and how it is judged."""

    mechanism: Machine = mechanism()
    data: Measurements = measurements()
    method: str = option(
        "prior", "prior: tolerances as prior; gcv: their common scale chosen by generalised "
        "cross-validation; damped: the scheme of the PPM paper.",
        choices=("prior", "gcv", "damped"), shown=True, key="Tolerances as prior, their common "
        "scale by cross-validation, or the damped scheme.")
    prior: str = option("tolerances", "flat: no prior at all.", choices=("tolerances", "flat"),
                        shown=True)
    damping: float = option(0.9, "The damping of --method damped.", least=0.0, above=True,
                            shown=True, key="Of the method damped.")
    iterations: int | None = option(
        None, "Stop after so many and write what was reached", least=1, most=100000,
        otherwise="60, damped: 6000, and no result without convergence",
        key="Stop after so many and write what was reached.")
    free: Sequence[str] | str = option(
        (), "Parameters that may change, in place of the file's; 'none' for frames only.",
        metavar="PATTERN", complete=PARAMETERS,
        key="Patterns of the parameters that may change, in place of the file's.")
    holdout: float | Measurements = option(
        0.2, "Poses to hold out, or other measurements to test on; 0 for none.",
        metavar="FRACTION|CSV", kind="str", shown=True,
        key="Part of the poses to hold out, or other measurements to test on.")
    leave_out: str = leave_out()
    sigma: str = option(
        "stated", "estimated: the noise of each file as its residuals show it, where the stated "
        "one does not fit.", choices=("stated", "estimated"), shown=True,
        key="Noise as the files state it, or as residuals show it.")
    start: Path_ | None = option(
        None, "Start from the values of an earlier calibration: its folder or identified.yaml.",
        metavar="OLD", kind="Machine",
        key="Start from an earlier calibration: its folder or identified.yaml.")
    keep: bool = option(
        False, "Carry on the calibration of --start (or of {mechanism}): what its data knew stays "
        "known; identification.json must be beside it.", key="Carry that calibration on.")
    keep_outliers: bool = option(False, "Use every row as it is.")
    seed: int = seed()

    def misuse(self, typed: Collection[str]) -> str:
        """Return why options do not go together."""
        if self.method != "damped" and "damping" in typed:
            return "--damping goes with --method damped."
        return two_holdouts(self.leave_out, typed)


COMMAND = Command(
    "identify", IdentifyArguments,
    about=("Identify the geometry of {mechanism} from the measurements {data} (CSV files).",
           "Writes identified.yaml (a mechanism file), parameters.csv, residuals.csv and "
           "identification.json."),
    examples=("ppmcal identify mine.yaml run1.csv",
              "ppmcal identify mine.yaml run1.csv run2.csv --leave-out session",
              "ppmcal identify mine.yaml run2.csv --start identified --keep --out kept"),
    out="identified", result="IdentificationResult",
    record=("identification", "ppmcal.io.results.identification:IdentificationRecord"),
    raises="BadInput: anything wrong in the files, or options that do not go together. NoResult: "
           "measurements that do not fit the machine at all, or no convergence.",
    shares={"reading the measurements": 0.4,
            "comparing the measurements with the nominal machine": 0.1,
            "choosing what to fit": 0.1, "fitting": 3.4, "looking for wrong rows": 0.1,
            "judging the fit": 6.4, "judging the campaign": 0.6, "writing the results": 2.5})
