"""export.json: what a controller takes of a machine, what it gains, and what it cannot hold.

Errors are in mm and degrees, the numbers in the controller's own units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar, TypeGuard

from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.record import Flag, Part, Record, Shown, Text, Whole
from ppmcal.notes import Note
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key
from ppmcal.wording import MOST

NO_GAIN = 1e-6
"""Further than this the new numbers are worse than the old ones, mm."""
LEAST = 1e-4
"""Below so many mm or degrees it is arithmetic."""
LACKS = "cannot be expressed: "
DECIMALS = {"mm": 4, "deg": 5}
LARGEST_FIXED = 1e7


class CommandErrors(Part):
    """Errors of position over the commands compared and, if there is one, of rotation.

    ``turn`` about z, deg, and ``shift`` in the plane of the bed, mm, were taken out. Of the model's
    own standard deviation in ``frame``, rms over the poses: the ``reason`` why it is unknown.
    """

    rms: Shown | None = None
    max: Shown | None = None
    unit: Text = ""
    frame: Text = ""
    reason: Text = ""
    rotation: ErrorSize | None = None
    turn: Annotated[Shown | None, Key("taken_out.turn")] = None
    shift: Annotated[tuple[Shown | None, ...], Key("taken_out.shift")] = ()

    def words(self) -> str:
        """Return ``0.0123 mm rms, 0.0456 mm at most; 0.00120 deg rms, ...``, empty for none.

        What is no more than arithmetic is ``below 0.0001 mm``.
        """
        out = []
        for part in (self, self.rotation):
            if part is not None:
                values = ((error_size(part.rms, part.unit), "rms"),
                          (error_size(part.max, part.unit), "at most"))
                shown = [f"{value} {part.unit} {word}" for value, word in values if value]
                out += [", ".join(shown)] if shown else []
        return "; ".join(out)

    def rms_words(self) -> str:
        """Return ``0.012 mm and 0.0031 deg``, two digits each."""
        return " and ".join(f"{_two_digits(part.rms)} {part.unit}".strip()
                            for part in (self, self.rotation) if part and is_known(part.rms))


class NotExpressedEntry(Part):
    """One thing that the controller cannot express, and what that alone costs."""

    what: Text = ""
    parameters: tuple[Text, ...] = ()
    cost: CommandErrors | None = None

    def words(self) -> str:
        """Return what cannot be expressed, with its cost where it is known."""
        cost = "" if self.cost is None else self.cost.words()
        return f"{self.what or '?'}" + (f": costs {cost}" if cost else "")


NOT_JUDGED = "not judged"


class ExportRecord(Record):
    """export.json; the keys from ``length_unit`` on are those of single formats.

    ``answer``: whether to use what is written: ``yes``, ``only in part``, ``only after a
    check``, ``no`` or ``not judged``, and ``why``, in a sentence; ``unchecked``: what no
    measurement says, each as the end of one.
    ``before``, ``after``: errors of the machine driven with the old and with the new numbers, if
    the model is exact; ``lost``, ``model``, ``expected_after``: what is left with the new ones,
    rms, of the format, of the model, and of both; ``expected_before``: with the old ones, the
    model's own uncertainty in it too. ``lines``: those to paste, where the file has few.
    ``number_half``: half of the 95 % interval of each number, in its unit, of those known.
    """

    FILE: ClassVar[str] = "export.json"
    FORMAT: ClassVar[str] = "ppmcal/export/1"

    controller: Text = ""
    name: Text = ""
    units: Mapping[str, Text] = field(default_factory=dict)
    parameters: Mapping[str, Shown | None] = field(default_factory=dict)
    old: Mapping[str, Shown | None] = field(default_factory=dict)
    number_units: Mapping[str, Text] = field(default_factory=dict)
    number_half: Mapping[str, Shown | None] = field(default_factory=dict)
    title: Text = ""
    answer: Annotated[Text, Key("verdict.answer")] = ""
    why: Annotated[Text, Key("verdict.why")] = ""
    unchecked: Annotated[tuple[Text, ...], Key("verdict.unchecked")] = ()
    lines: tuple[Text, ...] = ()
    summary: Annotated[Text, Key("said")] = ""
    over: Text = ""
    lost: Annotated[CommandErrors, Key("predicted.format")] = CommandErrors()
    model: Annotated[CommandErrors, Key("predicted.model")] = CommandErrors()
    expected_before: Annotated[CommandErrors, Key("predicted.before")] = CommandErrors()
    expected_after: Annotated[CommandErrors, Key("predicted.after")] = CommandErrors()
    exact: Flag = False
    read_back: Flag = False
    before: Annotated[CommandErrors, Key("gain.before")] = CommandErrors()
    after: Annotated[CommandErrors, Key("gain.after")] = CommandErrors()
    not_expressed: tuple[NotExpressedEntry, ...] = ()
    notes: tuple[Text, ...] = ()
    advice: tuple[Text, ...] = ()
    files: tuple[Text, ...] = ()
    length_unit: Text = ""
    poses: Whole = 0
    type: Whole = 0
    seed: Whole = 0
    rows: Whole = 0
    tables: Mapping[str, Any] = field(default_factory=dict)
    left_out: Mapping[str, Whole] = field(default_factory=dict)
    columns: Mapping[str, Text] = field(default_factory=dict)
    grid: Mapping[str, Any] = field(default_factory=dict)
    tried: Mapping[str, Any] = field(default_factory=dict)
    provenance: Provenance = Provenance()

    @property
    def judged(self) -> str:
        """``Paste this: yes, ...``; of files that nobody pastes, only what a calibration says."""
        if not self.answer or (not self.lines and self.answer == NOT_JUDGED):
            return ""
        return " ".join(f"{part[:1].upper()}{part[1:].rstrip('.')}." for part in (
            f"{'Paste this' if self.lines else 'Use this'}: {self.answer}; {self.why}",
            *self.unchecked))

    def predicted_sentence(self) -> str:
        """Return what is left with the new numbers, empty where the file does not say."""
        if not is_known(self.lost.rms):
            return ""
        text = (f"What the format cannot express: {self.lost.rms_words()} rms; the model's own "
                "uncertainty: ")
        if not (is_known(self.model.rms) and is_known(self.expected_after.rms)):
            return f"{text}unknown, as {self.model.reason or 'the file does not say it'}."
        base = self.model.frame in ("", "base")
        where = "the base frame" if base else f"the frame of {self.model.frame}"
        before = self.expected_before
        old = f"; with the old ones: {before.rms_words()}" if is_known(before.rms) else ""
        return (f"{text}{self.model.rms_words()} (1 sigma, rms over the poses, in {where}). "
                "Predicted error with the new numbers: "
                f"{self.expected_after.rms_words()} rms{old}.")

    def intervals_sentence(self) -> str:
        """Return what the intervals of numbers hold, empty where none is known."""
        if not self.number_half:
            return ""
        return ("+- 95 %: what the measurements leave open of each number; numbers go together, "
                "so that the machine is known better with all of them than by one. 0: fixed by "
                "how the format counts, or in the model.")

    @property
    def called(self) -> str:
        """What people call the controller."""
        return self.title or self.controller or "controller"

    def lacking(self) -> list[Note]:
        """Return what cannot be expressed with its cost, of many the costliest in one sentence."""
        many = sorted(self.not_expressed, key=_cost, reverse=True)
        if len(many) <= MOST:
            return [Note(f"{LACKS}{entry.words()}") for entry in self.not_expressed]
        first = "; ".join(e.words() for e in many[:MOST])
        return [Note(
            f"{LACKS}{first}; and {len(many) - MOST} more, each of which costs less (all in "
            f"{self.FILE})")]

    def all_findings(self) -> list[Note]:
        """Return what the user must look at: what cannot be expressed, numbers that are worse."""
        out = self.lacking()
        old, new = self.before, self.after
        if old.rms is not None and new.rms is not None and new.rms > old.rms + NO_GAIN:
            out.append(Note(f"the new {self.called} numbers are worse than the old ones over this "
                            "workspace"))
        elif old.rotation and new.rotation and _more(old.rotation.rms, new.rotation.rms):
            out.append(Note(
                f"the new {self.called} numbers are worse than the old ones in rotation, "
                f"if the model is exact: {_two_digits(new.rotation.rms or 0.0)} "
                f"{new.rotation.unit} rms with them, "
                f"{_two_digits(old.rotation.rms or 0.0)} without"))
        return out


def _more(old: float | None, new: float | None) -> bool:
    """Whether a new error is more than an old one, and more than arithmetic."""
    return old is not None and new is not None and new > max(old + NO_GAIN, LEAST)


def _cost(entry: NotExpressedEntry) -> float:
    """Return what an entry costs, in the unit of its position; unknown is most."""
    return entry.cost.rms if entry.cost and is_known(entry.cost.rms) else math.inf


def is_known(value: float | None) -> TypeGuard[float]:
    """Whether there is a finite number."""
    return value is not None and math.isfinite(value)


def fixed(value: float | None, unit: str = "") -> str:
    """Return a number with the decimals that suit its unit, empty for none."""
    if not is_known(value):
        return ""
    decimals = DECIMALS.get(unit, 4)
    # a rounded -0 is 0
    return (f"{value:.8g}" if abs(value) >= LARGEST_FIXED else
            f"{round(value, decimals) + 0.0:.{decimals}f}")


def error_size(value: float | None, unit: str = "") -> str:
    """Return an error as :func:`fixed`, of one that is only arithmetic what it is below."""
    text, decimals = fixed(value, unit), DECIMALS.get(unit, 4)
    smallest = 10.0**-decimals
    return f"below {smallest:.{decimals}f}" if text and abs(value or 0.0) < smallest else text


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value >= LEAST else f"below {LEAST:g}"
