"""commands.csv and commands.json, and what is said of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ppmcal.calibration.compensation import KINDS, Compensation
from ppmcal.io.csv import Table
from ppmcal.io.csv_dialect import Dialect
from ppmcal.io.recorded import recorded_text
from ppmcal.io.results.identification_tables import rms
from ppmcal.io.results.parts import ErrorChange
from ppmcal.io.results.record import Column, Record, Text, Whole, table_text
from ppmcal.io.results.tables import (
    WrittenTable,
    column_units,
    filled_columns,
    joint_columns,
    pose_columns,
)
from ppmcal.io.yaml import number_text
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.recorded import LABEL, RecordedForm
from ppmcal.store.provenance import Provenance
from ppmcal.wording import number, pluralize

RECORDED = "commands_recorded.csv"
"""Commands as a measurement file has its joints, without rows that have none."""


class CommandsRecord(Record):
    """commands.json: how many targets have no command, and the ``units`` of every column.

    ``predicted``: rms over the commands of the errors to expect, position and rotation: ``before``
    of uncorrected commands, the nominal machine's, ``after`` of corrected ones, as the columns
    ``error_..._before`` and ``error_..._after`` of commands.csv have them row by row: the model's
    uncertainty is in both. Where it is unknown, ``before`` is that of an exact model.
    ``frame``: in which they are; ``targets``: which point of the platform targets are of;
    ``findings``: what needs a look; ``recorded``: how commands_recorded.csv, where it is written,
    has the commands. ``base_axes``: what defines these axes, where something does.
    """

    FILE: ClassVar[str] = "commands.json"
    FORMAT: ClassVar[str] = "ppmcal/commands/1"

    rows: Whole | None = None
    refused: Whole | None = None
    frame: Text = ""
    targets: Text = ""
    predicted: Mapping[Text, ErrorChange] = field(default_factory=dict)
    findings: tuple[Text, ...] = ()
    notes: tuple[Text, ...] = ()
    units: Mapping[Text, Text] = field(default_factory=dict)
    recorded: RecordedForm | None = None
    base_axes: Text = ""
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, mechanism: Mechanism, result: Compensation, columns: Sequence[Column],
           provenance: Mapping[str, Any], notes: Sequence[str], frame: str,
           findings: Sequence[str] = (), recorded: RecordedForm | None = None,
           base_axes: str = "") -> CommandsRecord:
        """Return the record of commands with the columns of their table."""
        own = {c.name: mechanism.units.name(c.quantity) for c in columns if c.quantity}
        more: dict[str, Any] = {} if recorded is None else {"recorded": recorded}
        more |= {"base_axes": base_axes} if base_axes else {}
        return cls(format=cls.FORMAT, rows=len(result.status), frame=frame or "base",
                   targets=target_sentence(mechanism, frame),
                   predicted=_predicted(mechanism, result),
                   refused=sum(s != "ok" for s in result.status), findings=tuple(findings),
                   notes=tuple(notes),
                   units=column_units(mechanism, [c.name for c in columns]) | own,
                   provenance=Provenance(**provenance),
                   **more)

    def summary(self) -> dict[str, Any]:
        """Return the content without the units."""
        return {k: v for k, v in self.entries().items() if k != "units"}

    def parts_sentence(self) -> str:
        """Return what of the error to expect is the machine's and what the frame's, if it is known.

        Only of what defines the base axes; a fitted frame and the machine's geometry take from each
        other what the data leave open, so that neither has a part of its own.
        """
        if not self.base_axes:
            return ""
        if self.frame != "base":
            return (f"It is the machine's alone: targets are in the frame of {self.frame}, where "
                    "the noise of what defines the base axes does not count.")
        machine, frame = (" and ".join(
            f"{number(getattr(one, part))} {one.unit}" for one in self.predicted.values()
            if getattr(one, part) is not None) for part in ("machine", "frame"))
        if not machine:
            return ""
        return (f"Of it {machine} is the machine's own; {frame} is that of the base frame, as "
                f"defined by {self.base_axes}: one motion of all targets together.")


def _predicted(mechanism: Mechanism, result: Compensation) -> dict[str, ErrorChange]:
    """Return the errors of the commands in file units; what was refused has none."""
    out = {}
    for kind, quantity in KINDS.items():
        sizes = result.rms(kind)
        if sizes[0] is None or (kind == "rotation" and not mechanism.motion.turns):
            continue
        before, after, sigma = sizes
        frame, machine = result.parts(kind)
        parts = {} if frame is None else {"machine": machine, "frame": frame}
        out[kind] = ErrorChange.filled(None, mechanism.units, before=before, after=after,
                                       sigma=sigma, **parts, unit=quantity)
    return out


@dataclass(frozen=True)
class CommandColumn:
    """A column of commands.csv: its name, its quantity, and its N values in SI.

    ``quantity`` is as of :class:`Column`; the unit in commands.json follows from it.
    """

    name: str
    quantity: str
    values: Callable[[Compensation], Any]


def _expected(kind: str, when: int) -> Callable[[Compensation], Any]:
    return lambda result: result.expected(kind)[when]


def _columns() -> Iterator[CommandColumn]:
    for kind, quantity in KINDS.items():
        for when, word in enumerate(("before", "after")):
            yield CommandColumn(f"error_{kind}_{word}", quantity, _expected(kind, when))
    for kind, quantity in KINDS.items():
        yield CommandColumn(f"sigma_{kind}", quantity, attrgetter(f"sigma_{kind}"))
    yield CommandColumn("status", "", lambda result: list(result.status))
    yield CommandColumn("reason", "", lambda result: list(result.reason))


COLUMNS = list(_columns())
"""Behind the targets and the joints and poses that are sent, in their order."""
COMMAND_TABLE = WrittenTable("commands.csv", lambda name: (
    name in ("x", "y") or name.startswith(("q_", "cmd_"))
    or any(c.name == name and c.quantity for c in COLUMNS)))
"""Other columns of the targets are the user's, as they stand there."""


def command_columns(mechanism: Mechanism, result: Compensation, header: Sequence[str],
                    columns: Sequence[Any]) -> list[Column]:
    """Return the columns of commands.csv: those of the targets, then the commands.

    Joints, poses and the targets' columns are in file units already, the others are SI.
    """
    added = [Column(n, v) for n, v in (
        joint_columns(mechanism, result.q, "q_{}")
        | joint_columns(mechanism, result.q_nominal, "q_{}_nominal")
        | pose_columns(mechanism, result.command, "cmd_")).items()]
    added += [Column(one.name, one.values(result), one.quantity) for one in COLUMNS]
    ours = {c.name for c in added}
    filled = filled_columns(header, columns, pose_columns(mechanism, result.seen))
    return [*(Column(n, c) for n, c in zip(header, filled, strict=True) if n not in ours), *added]


def command_files(mechanism: Mechanism, result: Compensation, header: Sequence[str],
                  columns: Sequence[Any], provenance: Mapping[str, Any], notes: Sequence[str],
                  frame: str = "", findings: Sequence[str] = (),
                  recorded: RecordedForm | None = None, base_axes: str = ""
                  ) -> tuple[dict[str, str], CommandsRecord]:
    """Return commands.csv and commands.json, and the record in the latter.

    With commands_recorded.csv where commands are wanted in a ``recorded`` form too.
    """
    found = command_columns(mechanism, result, header, columns)
    record = CommandsRecord.of(mechanism, result, found, provenance, notes, frame,
                               findings, recorded, base_axes)
    made = {"commands.csv": table_text(found, mechanism.units)}
    if recorded is not None:
        sent = joint_columns(mechanism, result.q, "q_{}") | pose_columns(
            mechanism, result.command, "cmd_")
        made[RECORDED] = recorded_text(
            recorded, _labels(header, columns, len(result.status)), sent)
    return {**made, record.FILE: record.text()}, record


def _labels(header: Sequence[str], columns: Sequence[Any], count: int) -> list[str]:
    """Return the targets' own names (N,), numbers where they have none."""
    given = dict(zip(header, columns, strict=True)).get(LABEL, ("",) * count)
    words = [v if isinstance(v, str) else number_text(v) if np.isfinite(v) else ""
             for v in (given if isinstance(given, tuple) else np.asarray(given).tolist())]
    return [word.strip() or str(n) for n, word in enumerate(words, 1)]


def form_words(form: RecordedForm) -> str:
    """Return ``in, 5 decimals, separated by semicolons, decimal commas``."""
    units = list(dict.fromkeys(c.unit for c in form.values if c.unit))
    decimals = sorted({c.decimals for c in form.values})
    digits = " to ".join(str(d) for d in dict.fromkeys((decimals[0], decimals[-1])))
    return ", ".join([*([" and ".join(units)] if units else []), f"{digits} decimals",
                      str(Dialect(form.separator, form.decimal))])


def target_sentence(mechanism: Mechanism, frame: str) -> str:
    """Return which point of the platform targets are of, in the frame of a data set or the base."""
    if not frame:
        return "Targets are poses of the platform's origin, in the base frame."
    registration, units = mechanism.registration(frame), mechanism.units
    place = registration.target[[c for c in mechanism.dof if c < 3]] / units.factor("length")
    turned = (" and turned as that body is" if np.any(registration.target_rotation) else "")
    if not place.any():
        return (f"Targets are poses of the platform's origin{turned}, as {frame} measured it "
                "(--frame base: in the base frame).")
    at = ", ".join(f"{v:.4g}" for v in place)
    return (f"Targets are where the mark that {frame} measured is to be{turned}: "
            f"{np.linalg.norm(place):.4g} {units.length} from the platform's origin ({at} "
            f"{units.length} in its axes). With --frame base they are poses of that origin.")


class ErrorSizes(NamedTuple):
    """Sizes of some errors, in the unit of their column."""

    mean: float
    rms: float
    max: float


def error_sizes(values: Array) -> ErrorSizes | None:
    """Return mean, rms and largest of what is finite, None where nothing is."""
    values = values[np.isfinite(values)]
    if not values.size:
        return None
    return ErrorSizes(float(values.mean()), rms(values), float(values.max()))


def predicted_errors(table: Table, kind: str) -> dict[str, Array]:
    """Return by stage the errors (N,) that commands.csv says are to be expected of one kind.

    In its units; of corrected commands nan where the model's own uncertainty is unknown. In files
    of earlier versions that uncertainty, ``sigma``, is not in what is left of the arithmetic.
    """
    left = np.nan_to_num(table.number(f"error_{kind}_after"))
    return {"uncorrected": table.number(f"error_{kind}_before"),
            "corrected": np.maximum(left, table.number(f"sigma_{kind}"))}


def accepted_sentence(accepted: int, targets: int) -> str:
    """Return how many targets have commands."""
    return f"{accepted} of {pluralize(targets, 'target')} can be commanded"
