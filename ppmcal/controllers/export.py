"""What every export has in common: texts, numbers old and new, what they are worth and lack."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ppmcal.calibration.compensation import ParameterCovariance, model_sigma
from ppmcal.controllers.pose_errors import ErrorSummary, rms, rms_entry
from ppmcal.controllers.pose_grid import rest_columns
from ppmcal.errors import BadInput, NoResult
from ppmcal.io.results.beside_model import calibration_of
from ppmcal.io.results.export import (
    CommandErrors,
    ExportRecord,
    NotExpressedEntry,
)
from ppmcal.io.results.knowledge import KNOWLEDGE, knowledge_of
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Effect, Mechanism
from ppmcal.model.registration import Registration
from ppmcal.notes import Note
from ppmcal.store.provenance import Provenance
from ppmcal.wording.progress import stage


@dataclass(frozen=True)
class PoseUncertainty:
    """The model's own standard deviation, root mean square over poses; None where unknown.

    ``position`` m, ``rotation`` rad (None too where nothing turns); ``frame``: of which data set,
    or ``base``; ``reason``: why it is unknown; ``undetermined``: because measurements leave every
    pose open. ``before``: where that data set's instrument stands if the nominal geometry is
    believed; None where nothing says.
    """

    position: float | None
    rotation: float | None
    frame: str
    reason: str = ""
    undetermined: bool = False
    before: Registration | None = None


UNKNOWN = PoseUncertainty(None, None, "", f"{KNOWLEDGE} is not beside the model")


@stage("how sure the model is")
def pose_uncertainty(mechanism: Mechanism, poses: Array | None) -> PoseUncertainty:
    """Return how well a machine is known at platform poses (N, 6), base frame.

    In a measuring frame where there is one, of several in that in which it is known best: in base
    axes frame and offsets can stand in for each other. A measuring frame that is the base's is
    called so.

    Raises:
        BadInput: the identification.json beside the model cannot be used.
    """
    own = calibration_of(mechanism)
    if poses is None or own is None:
        return UNKNOWN
    record, path, other = own
    knowledge = knowledge_of(record, mechanism, path)
    if other:
        return PoseUncertainty(None, None, "base", f"{path.name} is not of this model ({other})")
    known = [_known_in(name, mechanism, poses, knowledge) for name in _frames(mechanism)]
    return min(known, key=lambda own: np.inf if own.position is None else own.position)


def _frames(mechanism: Mechanism) -> list[str]:
    """Return a data set of each measuring frame, "" for the base's where there is none.

    Targets of one body have one frame.
    """
    first: dict[bytes, str] = {}
    for name, stands in mechanism.registrations.items():
        first.setdefault(stands.frame_pose.tobytes(), name)
    return list(first.values()) or [""]


def _known_in(name: str, mechanism: Mechanism, poses: Array,
              knowledge: ParameterCovariance) -> PoseUncertainty:
    stands = mechanism.registration(name)
    called = name if stands.frame_pose.any() else "base"
    position, rotation = model_sigma(mechanism, poses, stands,
                                     knowledge, name, rest_columns(mechanism, len(poses)))
    seen = np.isfinite(position)
    if not seen.any():
        return PoseUncertainty(None, None, called, "no pose has an uncertainty",
                               undetermined=True)
    turns = mechanism.motion.turns
    believed = None if called == "base" else knowledge.before.get(name)
    return PoseUncertainty(rms(position[seen]), rms(rotation[seen]) if turns else None, called,
                           before=believed)


AXIS_OFFSET = ".axis_offset"
"""How the slots end whose universal joints no controller knows."""


def offset_words(limb: str, offset: float) -> str:
    """Return what a limb's universal joint is, its axes ``offset`` (m) apart."""
    return f"the axes of {limb}'s universal joint are {offset * 1e3:.4g} mm apart"


@dataclass(frozen=True)
class Number:
    """One number that the controller takes, in the controller's own unit.

    ``half``: of its 95 % interval, None where nobody knows.
    """

    name: str
    old: float | None
    new: float
    unit: str
    half: float | None = None


Again = Callable[[Mechanism], Mapping[str, float]]
"""The numbers, by name, of a machine that has other parameters and is the same otherwise."""


@dataclass(frozen=True)
class NotExpressed:
    """One thing that the controller cannot express, and what that alone costs (None: unknown)."""

    what: str
    parameters: tuple[str, ...]
    cost: ErrorSummary | None


def effect_lacking(mechanism: Mechanism, effect: Effect, words: str,
                   cost: ErrorSummary | None = None) -> NotExpressed:
    """Return an effect that the controller does not know; ``words`` say why."""
    return NotExpressed(f"effect {effect.kind.name}{words}",
                        tuple(mechanism.names[p] for p in effect.parameters.values()), cost)


def effects_lacking(mechanism: Mechanism, instruments: bool = False) -> Iterator[NotExpressed]:
    """Yield a machine's effects, for a controller that knows none; ``instruments``: theirs too."""
    for effect in mechanism.effects:
        if instruments or not effect.kind.instrument:
            yield effect_lacking(mechanism, effect,
                                 ", which the figures above do not hold either")


def head(name: str, before: ErrorSummary, after: ErrorSummary, lacks: Iterable[NotExpressed],
         notes: Iterable[Note] = (), how: Iterable[str] = ()) -> str:
    """Return the comment at the head of a file: errors, how to use it, what it lacks, notes."""
    return "\n".join([
        f"{name}: error of the platform's origin in base axes if the model is exact "
        f"{after.words()}, before {before.words()}.", *how,
        *remarks(lacks, notes)])


def remarks(lacks: Iterable[NotExpressed], notes: Iterable[Note]) -> Iterator[str]:
    """Yield what a file lacks and the notes, as lines of the comment at its head."""
    yield from (f"Cannot be expressed: {one.what}." for one in lacks)
    yield from (f"Note: {note}." for note in notes)


def refuse(given: Path | None, option: str, why: str, hint: str = "Leave it out") -> None:
    """Refuse an option that a format has no use for (BadInput)."""
    if given is not None:
        raise BadInput(why, option, hint)


def refuse_poses(controller: str, poses: Path | None) -> None:
    """Refuse poses for a controller that takes none (BadInput)."""
    refuse(poses, "--poses", f"{controller} takes numbers, not poses")


def other_machine(mechanism: Mechanism, hint: str) -> BadInput:
    """Return the error of a machine that a controller does not drive."""
    return BadInput(f"the machine is {mechanism.motion} with limbs "
                    f"{', '.join(limb.kind.name for limb in mechanism.limbs)}, which this "
                    "controller does not drive", mechanism.source,
                    f"{hint.rstrip('.')}. Send this machine the commands of `ppmcal compensate`, "
                    "or choose another format: `ppmcal export --help` lists them")


def misread(place: str, what: str = "the lines read back as other numbers", use: str = "them"
            ) -> NoResult:
    """Return the error of a text that does not read back as what it was written from."""
    return NoResult(what, place, f"This is a fault of ppmcal; do not use {use}")


@dataclass(frozen=True)
class Exported:
    """A machine as a controller takes it.

    Attributes:
        controller: the format's name; title: what people call it.
        files: file name -> text, read back and found equal before it gets here.
        summary: one sentence on what the controller holds of the machine.
        numbers: what is written, and what stood there before; old None where nothing did.
        over: over which commands the figures are, as the end of a sentence.
        before, after: errors of the machine driven by the controller's arithmetic with each, if
            the model is exact: ``after`` is what the format cannot express.
        poses: of the platform at which these are, base frame (N, 6), nan where open.
        uncertainty: how well the model itself is known there.
        not_expressed: what cannot be expressed; notes: what was done to express the rest.
        advice: sentences on how to bring the numbers into the controller.
        extra: more for export.json.
        copy: which of the files is a copy of the controller's own with the new numbers.
        again: the numbers of the machine with other parameters, by which it is worked out how well
            each is known; None where that is not, as of a table's largest entry.
    """

    controller: str
    title: str
    files: Mapping[str, str]
    summary: str
    numbers: tuple[Number, ...]
    over: str
    before: ErrorSummary
    after: ErrorSummary
    not_expressed: tuple[NotExpressed, ...] = ()
    notes: tuple[Note, ...] = ()
    advice: tuple[Note, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    poses: Array | None = None
    uncertainty: PoseUncertainty = UNKNOWN
    copy: str = ""
    again: Again | None = None

    def as_seen(self, mechanism: Mechanism) -> Exported:
        """Return the same with errors in the frame in which the model's uncertainty is.

        Of numbers that were nominal: commands were asked for where the instrument was then taken
        to stand. Base axes that no instrument measures move with the numbers. Of tables, whose
        poses are in base axes, the errors are there.
        """
        own = self.uncertainty
        if self.again is None or self.before.real is None or own.before is None:
            return self
        stands = mechanism.registration(own.frame)
        return replace(self, over=f"{self.over}, of the mark that {own.frame} measured",
                       before=self.before.seen(stands, own.before),
                       after=self.after.seen(stands, stands))

    def expected(self, errors: ErrorSummary) -> CommandErrors:
        """Return the error to expect with ``before`` or ``after``: what the model lacks is in both.

        As an entry of export.json, without a size where that is unknown.
        """
        own = self.uncertainty
        if own.position is None:
            return rms_entry(None, None)
        turn = None if errors.rotation_rms is None or own.rotation is None else float(
            np.hypot(errors.rotation_rms, own.rotation))
        return rms_entry(float(np.hypot(errors.rms, own.position)), turn)


class Exporter(Protocol):
    """A module, or an object, that writes one format."""

    def export(self, mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
        """Return the machine in this format.

        Args:
            mechanism: the calibrated machine; its nominal values are the controller's.
            old: the controller's present file, to predict the gain against.
            poses: wanted poses (CSV), for formats that are tables of them.

        Raises:
            BadInput: a machine that this controller does not drive, or an option without use.
            NoResult: the file does not read back as what it was written from.
        """
        ...


FEW_LINES = 30
"""A file of no more lines is shown, to be pasted."""


def _few_lines(exported: Exported) -> tuple[str, ...]:
    """Return the lines of the controller's file without comments, none of a long one."""
    text = next(iter(exported.files.values()), "")
    if text.count("\n") > 2 * FEW_LINES:
        return ()
    own = [line for line in text.splitlines() if not line.lstrip().startswith(("#", ";"))]
    found = tuple(line for line, above in zip(own, ["", *own], strict=False)
                  if line.strip() or above.strip())
    return found if len(found) <= FEW_LINES else ()


def record_of(exported: Exported, name: str, provenance: Mapping[str, Any]) -> ExportRecord:
    """Return export.json of the machine ``name``."""
    sure = exported.uncertainty
    return ExportRecord(
        format=ExportRecord.FORMAT, controller=exported.controller, name=name,
        units={"length": "mm", "angle": "deg"},
        parameters={n.name: n.new for n in exported.numbers},
        old={n.name: n.old for n in exported.numbers if n.old is not None},
        number_units={n.name: n.unit for n in exported.numbers},
        number_half={n.name: n.half for n in exported.numbers if n.half is not None},
        title=exported.title, summary=exported.summary, over=exported.over,
        lines=_few_lines(exported),
        lost=rms_entry(exported.after.rms, exported.after.rotation_rms),
        model=rms_entry(sure.position, sure.rotation, frame=sure.frame, reason=sure.reason),
        expected_before=exported.expected(exported.before),
        expected_after=exported.expected(exported.after),
        exact=not exported.not_expressed, read_back=True,
        before=exported.before.entry(), after=exported.after.entry(),
        not_expressed=tuple(
            NotExpressedEntry(what=lack.what, parameters=lack.parameters,
                              cost=None if lack.cost is None else lack.cost.entry())
            for lack in exported.not_expressed),
        notes=exported.notes, advice=exported.advice, files=tuple(exported.files),
        **exported.extra, provenance=Provenance(**provenance))
