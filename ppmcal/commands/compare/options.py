"""What ``ppmcal compare`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, Path_, argument


@dataclass(frozen=True)
class CompareArguments(Arguments):
    """Both calibrations."""

    old: Path_ = argument("OLD", "Folder that identify wrote, or the identified.yaml in it.",
                          kind="Machine")
    new: Path_ = argument("NEW", "The same of the later calibration, from other measurements.",
                          kind="Machine")


COMMAND = Command(
    "compare", CompareArguments,
    about=("Tell what changed between two calibrations {old} and {new} of one machine.",
           "Both are folders that identify wrote (or the identified.yaml in them), from different "
           "measurements. All parameters are judged together, with what was taken for known: "
           "homing, where bed, instrument and measured body were. The likeliest explanations of a "
           "change are named, and those that are as likely. If only one of the two had a parameter "
           "free, both are fitted to their measurements again with it free. Writes compare.csv and "
           "comparison.json."),
    examples=("ppmcal compare identified identified-may",), out="compared",
    result="ComparisonResult",
    record=("comparison", "ppmcal.io.results.comparison:ComparisonRecord"),
    raises="BadInput: anything wrong in the files, or another machine.")
