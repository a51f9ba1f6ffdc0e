"""What a firmware of linear deltas declares: its words, its file, its numbers, its arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from ppmcal.controllers.delta.gcode import Lines, with_lines
from ppmcal.controllers.delta.geometry import DeltaGeometry
from ppmcal.controllers.export import Again, Exported, NotExpressed
from ppmcal.controllers.pose_errors import ErrorSummary
from ppmcal.controllers.text import exact_text
from ppmcal.errors import BadInput, NoResult
from ppmcal.linalg import Array
from ppmcal.notes import NOTE, Note

DeltaConfig = TypeVar("DeltaConfig")
DeltaNumbers = TypeVar("DeltaNumbers")


@dataclass(frozen=True)
class DeltaFit(Generic[DeltaNumbers]):
    """A machine in a firmware's numbers.

    Attributes:
        new, old: what is written, and what it is compared with.
        before, after: errors of the machine driven with each.
        points: the commands compared (N, 3), m; radius: of their disc, m.
        not_expressed: what cannot be expressed; notes: what was done to express the rest.
        again: the numbers of another such machine.
    """

    new: DeltaNumbers
    old: DeltaNumbers
    before: ErrorSummary
    after: ErrorSummary
    points: Array
    radius: float
    not_expressed: tuple[NotExpressed, ...]
    notes: tuple[Note, ...]
    again: Again


@dataclass(frozen=True)
class DeltaFirmware(Generic[DeltaConfig, DeltaNumbers]):
    """A firmware whose numbers are those of :class:`DeltaGeometry`, in conventions of its own.

    ``DeltaConfig`` is its file as read, ``DeltaNumbers`` what that says of the geometry.

    Attributes:
        name: of the format; title: what people call it; file: that is written.
        towers: what it calls towers a, b, c; radius, endstops: what holds these.
        scale: what to do to a drive that travels so many times what it should.
        read: a file as read; parse: text, of a name, as read.
        numbers: what a file says of the geometry; all three raise BadInput.
        of: a geometry in its numbers, with what only old ones say.
        travel: how far below its endstop each carriage goes for points (N, 3), (N, 3), m.
        table: name, unit and value of every number that is written.
        text: lines of the file below a comment; how: in that comment, how to put them in place.
        advice: sentences on that, with the old file and its content, None where none is given.
        notes: what a user should know of the firmware's conventions.
        check: raises NoResult for numbers, of a source, that the firmware would not take.
        codes: the commands whose lines hold its numbers, and their letters; bare: a line without
            what a host shows before it; copy: what a copy of such lines is called. Empty of one
            that has other lines.
        fitted: what its numbers hold of a machine that they cannot express.
    """

    name: str
    title: str
    file: str
    towers: tuple[str, str, str]
    radius: str
    endstops: str
    scale: str
    read: Callable[[Path], DeltaConfig]
    parse: Callable[[str, str], DeltaConfig]
    numbers: Callable[[DeltaConfig], DeltaNumbers]
    of: Callable[[DeltaGeometry, DeltaNumbers | None], DeltaNumbers]
    travel: Callable[[DeltaNumbers, Array], Array]
    table: Callable[[DeltaNumbers], Iterable[tuple[str, str, float]]]
    text: Callable[[DeltaNumbers, str], str]
    how: Callable[[DeltaNumbers], Iterable[str]]
    advice: Callable[[DeltaFit[DeltaNumbers], Path | None, DeltaConfig | None], Iterable[Note]]
    notes: Callable[[DeltaFit[DeltaNumbers]], Iterable[Note]] = lambda _: ()
    check: Callable[[DeltaNumbers, str], None] = lambda *_: None
    fitted: str = "most of the geometry, fitted"
    codes: Mapping[int, str] = field(default_factory=dict)
    bare: Callable[[str], str] = str
    copy: str = ""


def patched_lines(firmware: DeltaFirmware[Lines, Any], made: Exported, old: Path) -> Exported:
    """Return an export with a copy of the file in use that holds the new lines.

    Raises:
        BadInput: the lines cannot be put into it, or what it runs may win over them.
        NoResult: the copy would not be read as meant.
    """
    for place in firmware.read(old).overruled():
        raise BadInput(f"{place} runs another file, whose M665 and M666 would win", str(old),
                       "Give that file as --old if it has them, or leave out --write")
    new = made.files[firmware.file]
    text = with_lines(exact_text(old), str(old), firmware.codes, new, firmware.bare)
    if firmware.numbers(firmware.parse(text, firmware.copy)) != firmware.numbers(
            firmware.parse(new, firmware.file)):
        raise NoResult("the copy with the new numbers reads back as something else", str(old),
                       "Leave out --write, and paste the lines")
    advice = Note(f"The {firmware.copy} written has the new lines below the old ones, which are "
                  "commented out.", NOTE)
    return replace(made, files={**made.files, firmware.copy: text}, advice=(advice,),
                   copy=firmware.copy)
