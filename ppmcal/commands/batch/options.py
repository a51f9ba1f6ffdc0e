"""What ``ppmcal batch`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import (
    PYTHON,
    Arguments,
    Command,
    Path_,
    argument,
    cores,
    needed,
    option,
    scheduler,
)


@dataclass(frozen=True)
class BatchArguments(Arguments):
    """What is to be done, where to, and in which processes."""

    manifest: Path_ = argument("MANIFEST", "YAML file, see ``ppmcal schema batch``.")
    out: Path_ = needed("Folder of the results; machine/date/command within it. ``save`` with the "
                        "same folder adds the table and the page.", only=PYTHON)
    cores: int | None = cores()
    scheduler: str | None = scheduler()
    force: bool = option(False, "Replace results that were edited, or that ppmcal did not write.",
                         only=PYTHON, recorded=False)


COMMAND = Command(
    "batch", BatchArguments,
    about=("Identify, diagnose or compensate the campaigns of many machines that {manifest} lists.",
           "Each writes into its own folder machine/date/command of --out what its command alone "
           "would. One that fails is reported and the others go on; those that are finished are "
           "not run again. Writes campaigns.parquet, a table of all results, and batch.html: which "
           "machines are worst, what they have in common, and what has changed since last time."),
    examples=("ppmcal batch fleet.yaml --cores 2",), out="batch", result="BatchResult",
    record=("campaign", "ppmcal.io.results.batch:CampaignRecord"),
    raises="BadInput: anything wrong in the manifest, or no such scheduler. NoResult: the workers "
           "were lost, or write to folders that are not seen here.")
