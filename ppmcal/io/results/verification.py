"""What ``ppmcal verify`` found: of each run inputs, arithmetic and, file by file, differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import ClassVar

from ppmcal.io.results.record import Part, Record, Shown, Text, Whole
from ppmcal.store.runs import InputCheck
from ppmcal.store.tally import (
    DIFFERS,
    LATER,
    OPEN,
    REWORDED,
    SAME,
    WITHIN,
    FileCheck,
    short_text,
)
from ppmcal.wording import pluralize

INPUT, FAILED, UNKNOWN = "input", "failed", "no record"
CODES = {SAME: 0, WITHIN: 0, REWORDED: 0, OPEN: 0, DIFFERS: 1, INPUT: 2, UNKNOWN: 2, LATER: 2,
         FAILED: 3}


class RunCheck(Part):
    """One run of a command, done again.

    ``environment``: what is not as it was then, in words; empty where every byte must be the same.
    """

    folder: Text = ""
    command: Text = ""
    status: Text = SAME
    message: Text = ""
    environment: tuple[Text, ...] = ()
    inputs: tuple[InputCheck, ...] = ()
    files: tuple[FileCheck, ...] = ()

    @property
    def exit_code(self) -> int:
        """0 same, within bounds or in other words; 1 differs; 2 not to be told; 3 failed."""
        return CODES.get(self.status, 3)

    def sentence(self) -> str:
        """Return how it ended."""
        head = f"{self.folder}: {self.command or 'no command'}"
        if self.status in (SAME, WITHIN):
            bytes_ = "" if self.environment else ", byte by byte"
            return f"{head}, run again: {self.status}{bytes_ if self.status == SAME else ''}."
        if self.status == REWORDED:
            return f"{head}, run again: the numbers are the same, the wording differs."
        if self.status == LATER:
            return (f"{head}, run again: all is the same that this version knows; verify the rest "
                    "with the version that wrote it.")
        if self.status == DIFFERS:
            wrong = sum(f.status == DIFFERS for f in self.files)
            return f"{head}, run again: {pluralize(wrong, 'file')} of {len(self.files)} differ" + (
                "s." if wrong == 1 else ".")
        if self.status == INPUT:
            return f"{head} cannot be run again: " + "; ".join(i.words() for i in self.inputs) + "."
        return f"{head}: {self.message}"


class VerificationRecord(Record):
    """What ``ppmcal verify --json`` prints."""

    FILE: ClassVar[str] = "verification.json"
    FORMAT: ClassVar[str] = "ppmcal/verification/1"

    bounds: Mapping[Text, Shown] = field(default_factory=dict)
    runs: tuple[RunCheck, ...] = ()
    exit_code: Whole = 0


def environment_words(then: Mapping[str, object], now: Mapping[str, object]) -> tuple[str, ...]:
    """Return what is not as it was, each with both values."""
    return tuple(f"{key.replace('_', ' ')} {short_text(then.get(key) or 'unknown')} then, "
                 f"{short_text(now.get(key) or 'unknown')} now"
                 for key in dict.fromkeys([*then, *now]) if then.get(key) != now.get(key))


def status_of(files: Sequence[FileCheck]) -> str:
    """Return the status of a run: the worst of its files'."""
    found = {f.status for f in files}
    return next((s for s in (DIFFERS, LATER, REWORDED, WITHIN) if s in found), SAME)
