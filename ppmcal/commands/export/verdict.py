"""Whether a controller's numbers are fit for use: yes, in part or no, why, and what nobody checked.

Reasons against them are refusals: of a fit that cannot be trusted (:func:`refuse_unfit`), of
numbers with which the machine would miss more than before, of a fit that predicts rows left out no
better than the machine did before it, of poses that the measurements leave open.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from ppmcal.calibration.fit import WORTH
from ppmcal.calibration.knowledge import FAR
from ppmcal.controllers.export import Exported
from ppmcal.controllers.pose_errors import MM
from ppmcal.errors import NoResult
from ppmcal.io.results.beside_model import calibration_of
from ppmcal.io.results.export import (
    LEAST,
    NO_GAIN,
    NOT_JUDGED,
    CommandErrors,
    ExportRecord,
    NotExpressedEntry,
    is_known,
)
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.parts import ErrorSize
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording import abbreviate_list

HARDLY = 0.3
"""With so much of what is there anyway, the sum of both in squares is a twentieth more."""


@dataclass(frozen=True)
class FitEvidence:
    """What the measurements behind a model say of it.

    ``before``, ``after``: errors of rows of the machine before the fit and with it; ``unseen``: of
    those that a fit had not seen, empty where none were kept out; ``size``: what is not known of
    the machine's size; ``far``: parameters that came out farther from nominal than tolerances
    allow, in words; ``what``: the quantity of the rows if it is not the predicted position.
    """

    before: ErrorSize = field(default_factory=ErrorSize)
    after: ErrorSize = field(default_factory=ErrorSize)
    unseen: ErrorSize = field(default_factory=ErrorSize)
    size: str = ""
    far: str = ""
    there: bool = False
    what: str = ""


def evidence_of(mechanism: Mechanism) -> FitEvidence:
    """Return what identification.json beside the model says, nothing where it is of another one.

    Raises:
        BadInput: it cannot be read.
    """
    own = calibration_of(mechanism)
    if own is None or own[2]:
        return FitEvidence()
    record, known = own[0], own[0].residual
    kinds = known.holdout or known.after
    kind = next((k for k in ("position", "rotation", *kinds) if k in kinds), "")
    none = ErrorSize()
    return FitEvidence(known.before.get(kind) or none, known.after.get(kind) or none,
                       known.holdout.get(kind) or none, _size(record), _far(record), True,
                       _quantities(record))


def _far(record: IdentificationRecord) -> str:
    """Return which parameters came out farther from nominal than tolerances allow."""
    found = sorted(((abs((p.error or 0.0) / (p.tolerance or 1.0)), p.name)
                    for p in record.far), reverse=True)
    return abbreviate_list([f"{name} by {times:.2g} times its tolerance" for times, name in found])


def _quantities(record: IdentificationRecord) -> str:
    """Return of what measurements are, in brackets; empty where they are positions or poses."""
    kinds = [find_instrument(d.kind) for d in record.datasets]
    names = dict.fromkeys(f"{k.number}s" for k in kinds)
    if not names or not all(k.scalar for k in kinds):
        return ""
    return (f" ({' and '.join(names)} where they were measured; predicted is the whole position, "
            "over the workspace)")


def _size(record: IdentificationRecord) -> str:
    """Return that no measurement holds the size, and what would; empty where one does."""
    scale = record.scale
    if scale is None or not (scale.open and scale.length > 0.0):
        return ""
    measured = any(find_instrument(d.kind).along_line for d in record.datasets)
    measure = "measure one distance"
    head = "size is checked only roughly" if measured else "size is not checked"
    if not math.isfinite(scale.sigma):
        return f"{head}: {measure}"
    if 0.0 < scale.needed <= scale.length:
        measure += f" of at least {scale.needed:.3g} {scale.unit}"
    return (f"{head}: {scale.length:.4g} {scale.unit} may be off by "
            f"{scale.times * scale.sigma:.2g} {scale.unit} (95 %); "
            f"{f'{measure} to {scale.measure_to:.2g} {scale.unit}' if measured else measure}")


def reasons_against(made: Exported, known: FitEvidence) -> Iterator[tuple[str, str]]:
    """Yield why the numbers must not be used, each with a hint.

    The model's own uncertainty is in the errors with the old numbers and with the new ones, and
    decides nothing.
    """
    before, after = made.before.rms, made.after.rms
    if after > before + NO_GAIN * MM:
        yield (f"the new {made.title} numbers are worse than the old ones: {after / MM:.3g} mm rms "
               f"with them, {before / MM:.3g} mm without", "Keep the old ones")
    first, unseen = known.before, known.unseen
    if not _better(known):
        seen = not is_known(unseen.rms)
        now = known.after if seen else unseen
        which = "its own measurements" if seen else "measurements that it has not seen"
        yield (f"the fit predicts {which} no better than the machine did before it: "
               f"{now.rms:.3g} {now.unit} rms with it{now.of_rows}, {first.rms:.3g} {first.unit} "
               "without",
               "Keep the old numbers; measure more poses, or ask `ppmcal diagnose` what is missing")
    if known.there and made.uncertainty.undetermined:
        yield ("the measurements leave the pose open all over the workspace",
               "Measure more, or give tolerances for what is not measured")


def _better(known: FitEvidence) -> bool:
    """Whether the fit predicts rows better than the machine before it did, unseen ones if any."""
    now = known.unseen if is_known(known.unseen.rms) else known.after
    first = known.before.rms
    return not (is_known(first) and is_known(now.rms)) or now.rms < first


def refuse_worse(made: Exported, known: FitEvidence, source: str, regardless: bool) -> list[Note]:
    """Refuse numbers that must not be used.

    Returns:
        What to warn of where they are written ``regardless``.

    Raises:
        NoResult: the first reason against them.
    """
    against = list(reasons_against(made, known))
    if against and not regardless:
        what, hint = against[0]
        raise NoResult(what, source, f"{hint}; --regardless writes the new ones all the same")
    return [Note(f"{what}; written anyway, because of --regardless") for what, _ in against[:1]]


def doubts(known: FitEvidence, source: str, overwrites: bool) -> list[Note]:
    """Return what to check before the numbers are used.

    Raises:
        NoResult: there is something, and the export ``overwrites`` the controller's own file.
    """
    if not known.far:
        return []
    found = Note(f"{FAR}: {known.far}. The nominal values (of a printer the lengths that you gave, "
                 "such as --rods), the tolerances, the units or the data are wrong there: check "
                 "them before you use these numbers", topic="tolerances")
    if overwrites:
        raise NoResult(found, source, "Without --write the lines are shown; --regardless writes "
                       "them all the same")
    return [found]


def verdict_of(record: ExportRecord, known: FitEvidence, warned: Sequence[str]) -> dict[str, Any]:
    """Return the verdict on what is written, as fields of the record.

    ``warned``: reasons against it that were set aside.
    """
    unchecked = tuple(filter(None, (
        known.size,
        "" if is_known(record.model.rms) else
        f"how well the numbers are known is not: {record.model.reason}")))
    if warned:
        return {"answer": "no", "why": str(warned[0]), "unchecked": unchecked}
    why = _gain(record, known)
    if not known.there:
        return {"answer": NOT_JUDGED, "unchecked": unchecked,
                "why": f"no calibration of this model lies beside it; {why}"}
    if _idle(record, known):
        return {"answer": "no", "why": f"there is hardly anything to gain; {why}",
                "unchecked": unchecked}
    if known.far:
        return {"answer": "only after a check", "unchecked": unchecked,
                "why": f"the machine comes out farther from nominal than tolerances allow; {why}"}
    lost = [entry.what for entry in record.not_expressed
            if _costs(entry, record.expected_after)]
    if lost:
        more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
        return {"answer": "only in part", "unchecked": unchecked,
                "why": f"{why}; {record.called} cannot express: {lost[0]}{more}"}
    return {"answer": "yes", "why": why, "unchecked": unchecked}


def _idle(record: ExportRecord, known: FitEvidence) -> bool:
    """Whether the promise is hardly better than that of the old numbers, and no row shows more."""
    old, new = record.expected_before.rms, record.expected_after.rms
    return (is_known(old) and is_known(new) and new > (1.0 - WORTH) * old
            and not is_known(known.unseen.rms))


def _costs(entry: NotExpressedEntry, expected: CommandErrors) -> bool:
    """Whether what cannot be expressed costs more than arithmetic, or nobody knows.

    And enough to show: with less than a part of what is to be ``expected`` anyway the sum of both
    is hardly more.
    """
    sizes = [] if entry.cost is None else [(entry.cost, expected),
                                           (entry.cost.rotation, expected.rotation)]
    known = [(cost.rms or 0.0, (anyway and anyway.rms) or 0.0) for cost, anyway in sizes
             if cost is not None and is_known(cost.rms)]
    return not known or any(cost > max(LEAST, HARDLY * anyway) for cost, anyway in known)


def _gain(record: ExportRecord, known: FitEvidence) -> str:
    """Return the errors promised before and after, and those of rows that no fit has seen."""
    old, new = record.expected_before, record.expected_after
    exact = not (is_known(old.rms) and is_known(new.rms))
    if exact:
        old, new = record.before, record.after
    text = (f"predicted error {old.rms_words()} rms with the old numbers, {new.rms_words()} with "
            f"the new ones{', if the model is exact' * exact}")
    first, unseen = known.before, known.unseen
    if is_known(first.rms) and is_known(unseen.rms):
        text += (f"; measurements that the fit had not seen{unseen.of_rows}: {first.rms:.2g} "
                 f"{first.unit} before, {unseen.rms:.2g} {unseen.unit} after{known.what}")
    return text
