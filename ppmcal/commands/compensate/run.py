"""Wanted poses into corrected commands."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ppmcal.calibration.compensation import (
    KINDS,
    Compensation,
    ParameterCovariance,
    Targets,
    averaged,
    is_worse,
    refused,
    sent,
    unsafe_ways,
    worse_rows,
)
from ppmcal.calibration.compensation import compensate as compensated
from ppmcal.calibration.fit import secondary
from ppmcal.commands.compensate.notes import (
    after_events,
    beyond_measured,
    defined_axes,
    doubts,
    loose_axes,
)
from ppmcal.commands.compensate.options import CompensateArguments
from ppmcal.commands.inputs import files_of, load, place_of, refuse_unfit, refuse_unrecorded
from ppmcal.commands.result import CalibratedMachine, Result
from ppmcal.commands.spec import Machine, Path_
from ppmcal.errors import BadInput, NoResult, refuse_unknown
from ppmcal.io import read_poses
from ppmcal.io.campaign import read_datasets
from ppmcal.io.poses import PoseTable
from ppmcal.io.results.batch import CampaignQuantity
from ppmcal.io.results.beside_model import of_other_values, read_other_models
from ppmcal.io.results.commands import (
    RECORDED,
    CommandsRecord,
    Forms,
    accepted_sentence,
    command_columns,
    command_files,
    form_words,
    known_form,
    target_sentence,
    with_digits,
)
from ppmcal.io.results.knowledge import KNOWLEDGE, knowledge_of, read_identification
from ppmcal.io.results.record import Column
from ppmcal.kinematics.needed_columns import ORDER
from ppmcal.kinematics.tables import refuse_singular_home
from ppmcal.model.dataset import WRENCH, environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.recorded import RecordedForm
from ppmcal.model.registration import Registration
from ppmcal.notes import NOTE, Note
from ppmcal.store.provenance import source_of
from ppmcal.wording import pluralize
from ppmcal.wording.told import Told


@dataclass(frozen=True, eq=False, repr=False)
class CompensationResult(Result):
    """Corrected commands.

    Attributes:
        mechanism: the identified machine.
        compensation: joint values ``q`` (N, k) SI, status and reason, predicted errors.
        frame: data set whose measuring frame the targets are in, empty for the base.
        knowledge: what the calibration knew, None where it is not known.
        notes: sentences on what is not known; a finding where an analysis of it failed.
        targets: header and columns of the wanted poses, as they were given.
        recorded: how commands_recorded.csv has the commands, and what has its joints so; None:
            there is none.
    """

    COMMAND: ClassVar[str] = "compensate"
    TABLE: ClassVar[str] = "commands.csv"
    UNTOLD: ClassVar[tuple[str, ...]] = ("units",)

    mechanism: Mechanism
    compensation: Compensation
    frame: str
    knowledge: ParameterCovariance | None
    notes: tuple[Note, ...]
    targets: tuple[tuple[str, ...], tuple[Any, ...]]
    recorded: tuple[str, RecordedForm] | None = None

    @property
    def refused(self) -> list[tuple[int, str]]:
        """Rows (from 1) that have no command, each with its reason."""
        found = self.compensation
        return [(n + 1, r) for n, (s, r) in enumerate(zip(found.status, found.reason, strict=True))
                if s != "ok"]

    def files(self) -> Mapping[str, str | bytes]:
        """Return commands.csv, commands.json and perhaps commands_recorded.csv."""
        return command_files(self.record, self._columns, self.mechanism.units)

    @cached_property
    def record(self) -> CommandsRecord:
        """The content of commands.json."""
        return CommandsRecord.of(self.mechanism, self.compensation, self._columns,
                                 self.provenance, self.frame,
                                 self.recorded[1] if self.recorded else None, self.base_axes,
                                 self.findings, self.notes)

    @cached_property
    def _columns(self) -> list[Column]:
        return command_columns(self.mechanism, self.compensation, *self.targets)

    @property
    def base_axes(self) -> str:
        """What defines the base axes, empty where the calibration's own tolerances do."""
        axes = self.knowledge.base_axes if self.knowledge is not None else None
        return "" if axes is None else f"{axes[1].by} of {axes[0]}"

    @property
    def warnings(self) -> list[str]:
        """What needs a look, and what is not known."""
        return [*self.findings, *self.notes]

    def remarks(self) -> Sequence[str]:
        """Return what needs a look, what is not known, and rows that have no command."""
        return [*self.warnings, *self.row_failures]

    @property
    def row_failures(self) -> Sequence[str]:
        """Sentences on rows that have no command."""
        return [Note(f"row {n} refused: {r}") for n, r in self.refused]

    def told(self) -> Iterator[Told]:
        """Yield how many targets have commands, for which point, and the errors to expect."""
        yield self.headline()
        yield self.point()
        predicted = self.record.predicted
        for kind, size in predicted.items():
            if size.words():
                yield f"Predicted {kind} error: {size.words()}."
        if any(size.after is not None for size in predicted.values()):
            unexplained = self.knowledge is not None and any(self.knowledge.unexplained)
            held = ", which the points that were held define" * (
                self.mechanism.self_calibrated and self.mechanism.gauge == "base")
            yield (f"The remaining error is the model's own uncertainty (1 sigma, in the frame of "
                   f"{self.frame or 'its base'}{held})"
                   f"{', with the unexplained residuals' * unexplained}.")
            if parts := self.record.parts_sentence():
                yield parts
        if self.recorded is not None:
            name, form = self.recorded
            yield f"{RECORDED} has the commands as {name} has its joints: {form_words(form)}."

    def quantities(self) -> Iterator[CampaignQuantity]:
        """Yield the errors to expect, and how many targets have no command."""
        units = self.mechanism.units
        for stage, rms in zip(("before", "after"), self.errors(), strict=True):
            yield CampaignQuantity(
                what="error", name="position", parameter=stage, unit=units.length,
                value=None if rms is None else rms / units.factor("length"))
        yield CampaignQuantity(what="refused", value=float(len(self.refused)))

    def headline(self) -> str:
        """Return how many targets have commands."""
        total = len(self.compensation.status)
        return (f"{self.mechanism.name}: {accepted_sentence(total - len(self.refused), total)}, "
                f"in the frame of {self.frame or 'the base'}.")

    def point(self) -> str:
        """Return which point of the platform targets are of, as a sentence."""
        return target_sentence(self.mechanism, self.frame)

    def errors(self, kind: str = "position") -> tuple[float | None, float | None]:
        """Return rms errors to expect without and with correction, SI; None: unknown.

        Of ``position``, m, or ``rotation``, rad; what is not known of the model is in both.
        """
        return self.compensation.rms(kind)[:2]


def run(asked: CompensateArguments) -> CompensationResult:
    """Turn wanted poses into corrected commands of an identified machine."""
    model, knowledge, targets = asked.model, asked.knowledge, asked.targets
    machine, known, files, notes, forms = _known(model, knowledge)
    lifted = refuse_unfit(machine, None if knowledge is None else Path(knowledge),
                          asked.regardless)
    registration, name = _frame(machine, asked.frame)
    form_of, form, more = known_form(forms, name, machine)
    notes += more
    if asked.like is not None:
        form_of, form = Path(asked.like).name, _asked_form(asked.like, machine)
    refuse_singular_home(machine)
    poses = read_poses(targets, machine, assume=asked.assume or {})
    sequence = asked.approach == "sequence"
    _refuse_short(machine, poses, place_of(targets, "poses"), sequence)
    found = compensated(machine, poses.poses, registration, known, name, poses.environment,
                        sequence)
    readings, others = ((model.readings, []) if isinstance(model, CalibratedMachine) else
                        read_other_models(Path(machine.source), machine))
    found, told = averaged(machine, found, readings, known,
                           Targets(poses.poses, name, poses.environment, sequence))
    inputs = [*machine.inputs, *files_of(targets), *files, *others]
    result = CompensationResult(source_of("compensate", inputs, None), (), machine, found, name,
                                known, (), poses.given)
    worse = worse_rows(machine, found)
    if asked.regardless and worse:
        lifted.append(Note(
            f"{pluralize(len(worse), 'row')} commanded though refused without --regardless "
            f"(first row {min(worse) + 1}: {worse[min(worse)]})"))
    else:
        _refuse_worse(result, worse, machine.source)
        found = refused(found, worse)
    found = refused(found, unsafe_ways(machine, found)) if asked.path else found
    beside = list[Note]()
    notes += [
        *told,
        *secondary("which machine and axes commands are for", lambda: [
            *loose_axes(machine, known, name), *defined_axes(known, name),
            *after_events(machine, name)], [], beside),
        *secondary("whether targets are in another frame",
                   lambda: [*_in_other_frames(machine, found, poses, name)], [], beside),
        *secondary("where the model is doubtful", lambda: doubts(found, machine, known), [],
                   beside),
        *secondary("where commands go beyond what was measured", lambda: [*beyond_measured(
            found, machine, known, poses, asked.path)], [], beside), *beside]
    return replace(result, findings=tuple(lifted), compensation=found, notes=tuple(notes),
                   recorded=None if form is None else (
                       form_of, with_digits(form, machine, found)))


def _known(model: Machine | CalibratedMachine, knowledge: Path_ | None
           ) -> tuple[Mechanism, ParameterCovariance | None, list[str], list[Note], Forms]:
    """Return the machine, what its calibration knew, the file of that, notes, and forms of joints.

    The last are by data set, None where one is as the machine's file.
    """
    if isinstance(model, CalibratedMachine):
        own = model.identification
        return model.mechanism, ParameterCovariance.of(own), [], [], [
            (d.name, None if d.recorded is None or d.recorded.as_machine else d.recorded)
            for d in own.fit.problem.datasets]
    machine = load(model)
    notes = [*machine.findings]
    path = Path(knowledge) if knowledge is not None else Path(machine.source).with_name(KNOWLEDGE)
    # nothing lies beside a machine that is in memory
    if knowledge is not None or (machine.source in machine.inputs and path.exists()):
        record = read_identification(path)
        known = knowledge_of(record, machine, path)
        other = of_other_values(record, machine)
        forms = [(d.name, d.recorded) for d in record.datasets]
        if not other:
            return machine, known, [str(path)], notes, forms
        notes.append(Note(f"{path} is not of {machine.source} as it is now ({other}): "
                          "uncertainties are unknown; run identify again", NOTE))
        return machine, None, [str(path)], notes, forms
    ranges = machine.measured is not None and machine.measured.ranges
    notes.append(Note(f"{path} is not there: uncertainties are unknown" + ("" if ranges else (
        " and so is the measured volume: poses far outside it are not refused")), NOTE))
    return machine, None, [], notes, []


def _asked_form(path: Path_, machine: Mechanism) -> RecordedForm:
    """Return how a measurement file has its joints.

    Raises:
        BadInput: anything wrong in the file or its sidecar, or commanded quaternions.
    """
    found = read_datasets(path, machine)[0].recorded
    if found is None:
        raise BadInput("its commanded poses have quaternions, as which commands are not written",
                       f"{path}: header", "Leave --like out; commands.csv has cmd_rx, cmd_ry, "
                       "cmd_rz, the rotation vector")
    return found


def _refuse_worse(result: CompensationResult, worse: Collection[int], source: str) -> None:
    """Refuse corrections that are predicted to be worse than none, together and in most rows.

    A few rows that are, ``worse``, do not refuse the others.

    Raises:
        NoResult: with both predictions.
    """
    found, machine = result.compensation, result.mechanism
    if 2 * len(worse) < int(sent(found).sum()):
        return
    for kind, quantity in KINDS.items():
        before, after = result.errors(kind)
        if before is None or after is None or not is_worse(
                machine, kind, np.array(before), np.array(after)):
            continue
        factor, unit = machine.units.factor(quantity), machine.units.name(quantity)
        raise NoResult(
            f"these corrections are predicted to be worse than none: {after / factor:.3g} {unit} "
            f"rms of {kind} with them, {before / factor:.3g} {unit} without, the model's "
            "uncertainty in both", source,
            "Send the uncorrected commands; or measure more, or at these poses, and identify "
            "again; --regardless makes the corrected ones all the same")


def _refuse_short(mechanism: Mechanism, poses: PoseTable, source: str, sequence: bool) -> None:
    """Refuse targets that lack a column which the machine's effects depend on."""
    n = len(poses.poses)
    # in a sequence every joint's direction follows from the order
    joints = np.tile(np.arange(n, dtype=float)[:, None], (1, len(mechanism.actuators)))
    rows = environment(poses.environment, mechanism.actuators, mechanism.gravity, joints, sequence)
    if rows.history is not None:    # whether joints went straight is seen once they are known
        rows = replace(rows, history=replace(rows.history, direct=np.ones(joints.shape[1], bool)))
    refuse_unrecorded(mechanism, rows, "the model's effects", source, _or_assume)
    # a load that the measurements had is none of 0 where only another one is given
    seen = mechanism.measured.ranges if mechanism.measured else {}
    needs = {need for effect in mechanism.effects for need in effect.kind.needs}
    lacking = [c for c in ("payload", *WRENCH) if any(seen.get(c, ())) and c not in
               poses.environment and needs & {"load", "wrench"}]
    if lacking:
        raise BadInput(f"the model was identified with {', '.join(lacking)}, which is not there",
                       f"{source}: header", f"Add the column {lacking[0]}"
                       + _or_assume(lacking[0]))


def _or_assume(column: str) -> str:
    """Return what may be done instead of adding a column; of an order there is no one value."""
    return "" if column == ORDER else (
        f", or give one value for all rows with --assume {column}=VALUE")


def _frame(mechanism: Mechanism, frame: str | None) -> tuple[Registration, str]:
    """Return the registration that the targets are in, and its name."""
    names = list(mechanism.registrations)
    # what was calibrated by joints and tilts alone has none
    if frame == "base" or (frame is None and (mechanism.self_calibrated or (
            not names and mechanism.measured is not None))):
        return Registration(), ""
    if frame is None:
        stands = {(r.frame.tobytes(), r.target.tobytes(), r.target_rotation.tobytes())
                  for r in mechanism.registrations.values()}
        if len(stands) == 1:    # of several files alike any tells the same
            return true_lengths(mechanism.registrations[names[0]]), names[0]
        what = (f"the model knows {len(names)} data sets, each with its frame and target" if names
                else "the model knows no measuring frame: it was not identified")
        raise BadInput(what, f"{mechanism.source}: measurement.datasets",
                       f"Choose with --frame: {', '.join([*names, 'base'])}")
    refuse_unknown("data set", [frame], [*names, "base"], "--frame")
    return true_lengths(mechanism.registrations[frame]), frame


def _in_other_frames(mechanism: Mechanism, found: Compensation, poses: PoseTable, frame: str
                     ) -> Iterator[Note]:
    """Yield the frame in which targets can be reached of which none can be in the one given."""
    if sent(found).any():
        return
    for other in ("base", *mechanism.registrations):
        registration, name = _frame(mechanism, other)
        if name != frame:
            there = int(sent(compensated(mechanism, poses.poses, registration, None, name,
                                         poses.environment)).sum())
            if 2 * there > len(poses.poses):
                yield Note("none of the targets can be reached in the frame of "
                           f"{frame or 'the base'}, but {pluralize(there, 'target')} can in that "
                           f"of {name or 'the base'}: --frame {other!r}?")
                return


def true_lengths(registration: Registration) -> Registration:
    """Return where an instrument stands, without its scale: wanted lengths are true ones."""
    return replace(registration, scale=1.0)
