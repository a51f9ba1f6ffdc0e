"""What ``ppmcal verify`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, Path_, argument, option


@dataclass(frozen=True)
class VerifyArguments(Arguments):
    """Which results, and where their inputs may be."""

    folders: tuple[Path_, ...] = argument(
        "DIRS...", "Folders that commands, or save of their results, wrote; also those within.",
        folder=True)
    inputs: Path_ | None = option(
        None, "Folder to look for the inputs in, by name and content, where they are not any more "
        "where they were.", folder=True)


COMMAND = Command(
    "verify", VerifyArguments,
    about=("Make the results in {folders} again, and compare them value by value.",
           "Inputs are checked by their SHA-256. With the same version, libraries and processor "
           "every byte must be the same; elsewhere numbers may be off by a little, and everything "
           "else not at all, but for the wording of another version. Writes nothing. Exit code 0 "
           "same, or in other words, 1 something differs, 2 an input is missing or has changed, or "
           "a later version wrote keys that this one does not know, 3 the run itself fails."),
    examples=("ppmcal verify identified", "ppmcal verify identified --inputs archive"),
    result="VerificationResult",
    record=("verification", "ppmcal.io.results.verification:VerificationRecord"),
    recorded=False,
    raises="BadInput: a folder is not there, or holds no results.")
