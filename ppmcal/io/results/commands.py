"""commands.csv and commands.json, and what is said of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ppmcal.calibration.compensation import (
    KINDS,
    Compensation,
    PoseRows,
    joint_resolution,
    sent,
)
from ppmcal.io.csv import Table
from ppmcal.io.csv_dialect import Dialect
from ppmcal.io.recorded import recorded_text, with_decimals
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
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.recorded import LABEL, RecordedForm
from ppmcal.notes import NOTE, Note
from ppmcal.store.provenance import Provenance
from ppmcal.units import Units
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
           provenance: Mapping[str, Any], frame: str, recorded: RecordedForm | None,
           base_axes: str, findings: Sequence[str], notes: Sequence[str]) -> CommandsRecord:
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


def command_files(record: CommandsRecord, columns: Sequence[Column], units: Units
                  ) -> dict[str, str]:
    """Return commands.csv and commands.json, and commands_recorded.csv where that is wanted."""
    made = {"commands.csv": table_text(columns, units)}
    if record.recorded is not None:
        values = {c.name: c.values for c in columns}
        made[RECORDED] = recorded_text(record.recorded, _labels(values), values)
    return {**made, record.FILE: record.text()}


def _labels(columns: Mapping[str, Any]) -> list[str]:
    """Return the targets' own names (N,), numbers where they have none."""
    given = columns.get(LABEL, ("",) * len(columns["status"]))
    words = [v if isinstance(v, str) else number_text(v) if np.isfinite(v) else ""
             for v in (given if isinstance(given, tuple) else np.asarray(given).tolist())]
    return [word.strip() or str(n) for n, word in enumerate(words, 1)]


LOST = 0.1
"""Part of the model's own standard deviation that rounding may take."""
FINE = 1e-7
"""Part of the reach, or of a radian, that it may take where that is unknown."""
Forms = Sequence[tuple[str, RecordedForm | None]]
"""Data sets by name, with how each has its joints; None: as the mechanism file."""


def known_form(forms: Forms, frame: str, machine: Mechanism
               ) -> tuple[str, RecordedForm | None, list[Note]]:
    """Return which data set has its joints otherwise than the mechanism file, how, and notes.

    That of the targets' ``frame``; in base axes the first.
    """
    own = {f"q_{a}" for a in machine.actuators}
    there = [(name, form) for name, form in forms if form is not None
             and frame in ("", name) and form.values
             and all(c.name in own or c.name.startswith("cmd_") for c in form.values)]
    if not there:
        return "", None, []
    name, form = there[0]
    other = next((n for n, f in there if _without_digits(f) != _without_digits(form)), "")
    return name, form, [Note(
        f"{other} has its joints in another form than {name}, as which commands_recorded.csv has "
        "the commands: choose another file with --like", NOTE)] if other else []


def _without_digits(form: RecordedForm) -> RecordedForm:
    return replace(form, columns=tuple(replace(c, decimals=0) for c in form.values))


def with_digits(form: RecordedForm, machine: Mechanism, found: Compensation) -> RecordedForm:
    """Return a form with digits enough for commands: rounding takes little of what is known."""
    rows = sent(found)
    allowed = [max(LOST * float(np.min(sigma[rows], initial=np.inf)), 1e-2 * FINE * size)
               if rows.any() and np.isfinite(sigma[rows]).all() else FINE * size
               for sigma, size in ((found.sigma_position, machine.reach),
                                   (found.sigma_rotation, 1.0))]
    at = PoseRows(found.pose, np.where(rows[:, None], found.q, np.nan),
                  unknown_environment(*found.q.shape))
    joints = joint_resolution(Model(machine), at, *allowed) / machine.joint_factors()
    steps = {f"q_{a}": float(s) for a, s in zip(machine.actuators, joints, strict=True)}
    for c, name in zip(machine.dof, machine.coordinates, strict=True):
        quantity, size = ("length", allowed[0]) if c < 3 else ("angle", allowed[1])
        steps[f"cmd_{name}"] = 2.0 * size / machine.units.factor(quantity)
    return with_decimals(form, steps)


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
