"""What every export has in common: texts, numbers old and new, what they are worth and lack."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ppmcal.controllers.model_uncertainty import UNKNOWN, PoseUncertainty
from ppmcal.controllers.pose_errors import ErrorSummary
from ppmcal.errors import BadInput, NoResult
from ppmcal.io.results.export import (
    CommandErrors,
    ExportRecord,
    NotExpressedEntry,
    PredictedErrors,
)
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Effect, Mechanism
from ppmcal.notes import Note
from ppmcal.store.provenance import Provenance

AXIS_OFFSET = ".axis_offset"
"""How the slots end whose universal joints no controller knows."""


def offset_words(limb: str, offset: float) -> str:
    """Return what a limb's universal joint is, its axes ``offset`` (m) apart."""
    return f"the axes of {limb}'s universal joint are {offset * 1e3:.4g} mm apart"


@dataclass(frozen=True)
class Number:
    """One number that the controller takes, in the controller's own unit."""

    name: str
    old: float | None
    new: float
    unit: str


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
        f"{name}: error if the model is exact {after.words()}, before {before.words()}.", *how,
        *(f"Cannot be expressed: {one.what}." for one in lacks),
        *(f"Note: {note}." for note in notes)])


def refuse_poses(controller: str, poses: Path | None) -> None:
    """Refuse poses for a controller that takes none (BadInput)."""
    if poses is not None:
        raise BadInput(f"{controller} takes numbers, not poses", "--poses", "Leave it out")


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

    def expected(self, errors: ErrorSummary) -> ErrorSummary | None:
        """Return the error to expect with ``before`` or ``after``: what the model lacks is in both.

        None: unknown.
        """
        own = self.uncertainty
        if own.position is None:
            return None
        turn = None if errors.rotation_rms is None or own.rotation is None else float(
            np.hypot(errors.rotation_rms, own.rotation))
        return ErrorSummary(float(np.hypot(errors.rms, own.position)), np.nan, turn)


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


def record_of(exported: Exported, name: str, provenance: Mapping[str, Any]) -> ExportRecord:
    """Return export.json of the machine ``name``."""
    before, after = (CommandErrors(rms=None, unit="mm") if e is None else e.rms_entry() for e in (
        exported.expected(exported.before), exported.expected(exported.after)))
    return ExportRecord(
        format=ExportRecord.FORMAT, controller=exported.controller, name=name,
        units={"length": "mm", "angle": "deg"},
        parameters={n.name: n.new for n in exported.numbers},
        old={n.name: n.old for n in exported.numbers if n.old is not None},
        number_units={n.name: n.unit for n in exported.numbers},
        title=exported.title, summary=exported.summary, over=exported.over,
        predicted=PredictedErrors(
            format=exported.after.rms_entry(), model=exported.uncertainty.entry(),
            before=before, after=after),
        exact=not exported.not_expressed, read_back=True,
        before=exported.before.entry(), after=exported.after.entry(),
        not_expressed=tuple(
            NotExpressedEntry(what=lack.what, parameters=lack.parameters,
                              cost=None if lack.cost is None else lack.cost.entry())
            for lack in exported.not_expressed),
        notes=exported.notes, advice=exported.advice, files=tuple(exported.files),
        **exported.extra, provenance=Provenance(**provenance))
