"""Inverse, forward and velocity kinematics of a table, and how sure they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ppmcal.calibration.compensation import (
    ParameterCovariance,
    PoseRows,
    forward_sigma,
    independent,
    joint_sigma,
    left_joint_sigma,
    sigma_by_differences,
)
from ppmcal.calibration.fit import secondary, stretched
from ppmcal.commands.inputs import files_of, load, place_of, refuse_unrecorded
from ppmcal.commands.kinematics.options import WHICH, KinematicsArguments
from ppmcal.commands.result import Result
from ppmcal.design.every_mode import EveryMode, every_mode
from ppmcal.design.intersection import forward_by_intersection
from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io import csv_text, read_joints, read_poses, twists
from ppmcal.io.grid import read_point
from ppmcal.io.pose_fields import check_convention
from ppmcal.io.poses import Given
from ppmcal.io.results.beside_model import of_other_values
from ppmcal.io.results.kinematics import (
    COVARIANCE,
    LOCKED,
    SIGMAS,
    TOLERANCES,
    KinematicsRecord,
    KinematicsUncertainty,
    ModelSigma,
    PoseFormat,
    kinematics_columns,
    modes_sentence,
    solved_sentence,
)
from ppmcal.io.results.knowledge import KNOWLEDGE, knowledge_of, read_identification
from ppmcal.io.results.tables import joint_columns
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import shifted
from ppmcal.kinematics.partial_pose import PoseConvention, inverse_partial, pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.kinematics.tables import (
    KinematicsTable,
    forward_table,
    inverse_table,
    tool_poses,
    velocity_table,
)
from ppmcal.linalg import Array, Ints, finite_rows
from ppmcal.model.dataset import Environment, environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.notes import Note
from ppmcal.store.provenance import source_of
from ppmcal.wording import pluralize
from ppmcal.wording.told import Told

OWNER = "the machine's effects"
HOW_SURE = "how well the model is known"
UNKNOWN = ModelSigma(entry=KinematicsUncertainty(source=COVARIANCE))
"""Where that could not be had."""
Solve = Callable[[Model], Array]


@dataclass(frozen=True, eq=False, repr=False)
class KinematicsResult(Result):
    """Kinematics of N rows.

    Attributes:
        mechanism: the machine; which: ``inverse``, ``forward`` or ``velocity``.
        table: joint values, poses, rates, conditioning, status and reason of each row, SI.
        form: tool point, measured poses and convention of rotations in the files.
        given: header and columns of the table as it was given; with all assembly modes, repeated
            for each of them.
        modes: which assembly mode each row is, where all of them were asked for.
        sure: how well the model itself is known: standard deviations, file units.
        pictures: whether pictures are among the files.
    """

    COMMAND: ClassVar[str] = "kinematics"
    TABLE: ClassVar[str] = "kinematics.csv"

    mechanism: Mechanism
    which: str
    table: KinematicsTable
    form: PoseFormat
    given: Given
    modes: EveryMode | None
    sure: ModelSigma
    pictures: bool

    @property
    def q(self) -> Array:
        """Joint values (N, k), m and rad."""
        return self.table.q

    @property
    def pose(self) -> Array:
        """Poses (N, 6): x, y, z in m, rotation vector in rad; of the tool if there is one."""
        return self.table.pose if self.form.pose is None else self.form.pose

    @property
    def own(self) -> KinematicsTable:
        """Kinematics of the rows that were asked for: with all modes, of the machine's own one."""
        return self.table if self.modes is None else self.modes.home

    @property
    def failed(self) -> list[tuple[int, str, str]]:
        """Rows (from 1) that are not ok, each with status and reason."""
        pairs = zip(self.own.status, self.own.reason, strict=True)
        return [(n + 1, s, r) for n, (s, r) in enumerate(pairs) if s != "ok"]

    @property
    def asked(self) -> int:
        """How many rows the table has."""
        return len(self.own.status)

    @cached_property
    def _written(self) -> tuple[dict[str, Any], int]:
        return kinematics_columns(self.mechanism, self.table, self.which, self.given, self.form,
                                  self.modes, self.sure.columns)

    @property
    def columns(self) -> dict[str, Any]:
        """Columns of kinematics.csv (N,), file units."""
        return self._written[0]

    @property
    def gimbal_lock(self) -> int:
        """How many rows have only two of their three Euler angles determined."""
        return self._written[1]

    @cached_property
    def record(self) -> KinematicsRecord:
        """The content of kinematics.json."""
        return KinematicsRecord.of(self.mechanism, self.table, self.which, self.form,
                                   list(self.columns), self.provenance, self.modes,
                                   self.sure.entry)

    def files(self) -> Mapping[str, str | bytes]:
        """Return kinematics.csv, kinematics.json and, where wanted, pictures."""
        texts = {self.TABLE: csv_text(list(self.columns), list(self.columns.values())),
                 self.record.FILE: self.record.text()}
        if not self.pictures:
            return texts
        from ppmcal.report.figure_files import kinematics_pictures

        return {**texts, **kinematics_pictures(self.record, self.columns, self.mechanism.name)}

    @property
    def row_failures(self) -> Sequence[str]:
        """Sentences on rows that are not ok."""
        return [Note(f"row {n}: {s}: {r}") for n, s, r in self.failed]

    @property
    def exit_code(self) -> int:
        """3 where no row has a result."""
        lost = self.own.status and {*self.own.status} <= {"not converged", "singular"}
        return 3 if lost else super().exit_code

    def told(self) -> Iterator[Told]:
        """Yield how many rows are ok, and of how many an angle is not determined."""
        yield self.headline()
        if self.gimbal_lock:
            yield f"{pluralize(self.gimbal_lock, 'row')}: {LOCKED}."

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        lines = {} if self.modes is None else {"modes": len(self.table.status)}
        return {"format": "ppmcal/kinematics-summary/1", "rows": self.asked,
                "not_ok": len(self.failed), **lines, "gimbal_lock": self.gimbal_lock,
                "provenance": self.provenance}

    def headline(self) -> str:
        """Return how many rows are ok, and how sure they are."""
        modes = self.modes
        more = "" if modes is None else (
            f" {modes_sentence(modes.counts, modes.method, modes.complete)}")
        return (f"{self.mechanism.name}: {self.which} kinematics, "
                f"{solved_sentence(self.asked - len(self.failed), self.asked)}.{more} "
                f"{self.sure.entry.words()}")


def run(asked: KinematicsArguments) -> KinematicsResult:
    """Return the kinematics of every row of a table.

    Rows are a path in their order: singularities crossed and assembly modes changed on the
    way are marked in ``status``.
    """
    which, table, method = asked.which, asked.table, asked.method
    refuse_unknown("kinematics", [which], WHICH)
    _refuse_options(asked)
    machine, dataset, seed = load(asked.mechanism), asked.dataset, asked.seed
    convention = _point(asked.tool, machine), check_convention(asked.rotation, machine)
    found, rows, given, solve = _solved(which, machine, table, convention, method)
    modes, used, pose = None, None, None
    if asked.all_modes:
        modes = every_mode(Model(machine), found, method, seed)
        found, given, rows = modes.table, _repeated(given, modes.row), rows.take(modes.row)
        used = seed if modes.method == "search" else None
    if dataset is not None:
        pose = _as_measured(machine, dataset, found, rows)
    elif convention[0] is not None:
        pose = tool_poses(Model(machine), found.pose, convention[0])
    form = PoseFormat(convention[0], pose, convention[1], method if which == "forward" else "")
    notes = list[Note]()
    seen = machine.registrations[dataset] if dataset is not None else Registration() if (
        convention[0] is None) else PoseConvention(convention[0]).registration
    solved = SolvedRows(which, PoseRows(found.pose, found.q, rows), seen, dataset or "", solve)
    files, sure = secondary(HOW_SURE, lambda: model_sigma(machine, solved), ((), UNKNOWN), notes)
    source = source_of("kinematics", [*machine.inputs, *files_of(table), *files], used)
    return KinematicsResult(source, tuple(notes), machine, which, found, form, given, modes, sure,
                            asked.pictures)


def _refuse_options(asked: KinematicsArguments) -> None:
    """Refuse options that do not go together (BadInput)."""
    for option, given in (("--dataset", asked.dataset is not None),
                          ("--method", asked.method != "newton"), ("--all", asked.all_modes)):
        if given and asked.which != "forward":
            why = (": every limb's inverse kinematics is in closed form"
                   if option == "--method" else "")
            raise BadInput(f"{option} goes with forward{why}", "", "Leave it out")
    if asked.dataset is not None and asked.tool is not None:
        raise BadInput("--tool and --dataset do not go together: the instrument measures its own "
                       "target", "", "Leave one of them out")
    if asked.dataset is not None and asked.all_modes:
        raise BadInput("--all and --dataset do not go together: the instrument sees one pose a row",
                       "", "Leave one of them out")


def _repeated(given: Given, row: Ints) -> Given:
    """Return the columns of a table with each row as often as it is in ``row`` (M,)."""
    header, columns = given
    return header, tuple(tuple(c[n] for n in row) if isinstance(c, tuple) else
                         np.asarray(c)[row] for c in columns)


def _point(tool: str | Sequence[float] | None, mechanism: Mechanism) -> Array | None:
    """Return the tool point (3,), m; one of a planar machine is in its plane."""
    if tool is None:
        return None
    point = read_point(tool, mechanism)
    if mechanism.motion.planar and point[2] != 0.0:
        raise BadInput("the tool of a planar machine is a point of its plane", "--tool",
                       f"Write X,Y in {mechanism.units.length}")
    return point


def _solved(which: str, machine: Mechanism, table: Any, asked: tuple[Array | None, str],
            method: str) -> tuple[KinematicsTable, Environment, Given, Solve | None]:
    """Return the kinematics of a table, the environment of its rows, and the table as it stands.

    Last, how joint values and rates follow from another model of the machine.
    """
    model, (tool, rotation) = Model(machine), asked

    def instead(_: str) -> str:
        return f", or take the effect out of {machine.source}"

    if which == "forward":
        joints = read_joints(table, machine)
        rows = environment(joints.environment, machine.actuators, machine.gravity, joints.q)
        refuse_unrecorded(machine, rows, OWNER, place_of(table, "joints"), instead)
        found = forward_by_intersection(model, joints.q) if method == "intersection" else None
        return forward_table(model, joints.q, rows, found), rows, joints.given, None
    poses = read_poses(table, machine, rotation)
    rows = environment(poses.environment, machine.actuators, machine.gravity,
                       np.full((len(poses.poses), len(machine.actuators)), np.nan))
    refuse_unrecorded(machine, rows, OWNER, place_of(table, "poses"), instead)
    convention = PoseConvention(np.zeros(3) if tool is None else tool, rotation)
    if which == "inverse":
        return (inverse_table(model, poses.poses, rows, convention), rows, poses.given,
                lambda other: inverse_partial(other, poses.poses, rows, convention).q)
    motion = twists(poses.extra, machine)
    if motion is None:
        raise BadInput("no velocity columns", place_of(table, "poses"),
                       "Add vx, vy, vz, wx, wy, wz as far as the machine has them")

    def again(other: Model) -> Array:
        moving = velocity_table(other, poses.poses, motion, rows, convention)
        return np.concatenate([moving.q, moving.rate], axis=1)

    return (velocity_table(model, poses.poses, motion, rows, convention), rows, poses.given, again)


def _as_measured(mechanism: Mechanism, dataset: str, found: KinematicsTable, rows: Environment
                 ) -> Array:
    """Return the poses (N, 6) as an instrument of the model's file would show them."""
    refuse_unknown("data set", [dataset], mechanism.registrations,
                   f"{mechanism.source}: measurement.datasets")
    registration = mechanism.registrations[dataset]
    seen = np.full_like(found.pose, np.nan)
    good = finite_rows(found.pose)
    pose = pose_motor(found.pose[good])
    seen[good] = measured_pose(registration, pose)
    shift = shifted(Model(mechanism), rows.take(good), found.q[good], pose).shift
    if shift is not None:
        seen[good, :3] = stretched(seen[good, :3], shift.stretch)
    return seen


MOST = 200
"""From so many rows at most, evenly spread, what tolerances allow is reported."""


def carried(mechanism: Mechanism) -> tuple[ParameterCovariance, str, tuple[str, ...]] | None:
    """Return what a machine's file carries: a covariance beside it, sigmas, tolerances, or None.

    With it go the word for where it is from, and the files behind it. A nominal file is not taken
    for the machine of an identification.json that happens to lie beside it: only a file with
    sigmas was written by a calibration.

    Raises:
        BadInput: the identification.json beside a calibrated machine cannot be used.
    """
    sigma = {p.name: p.sigma for p in mechanism.parameters
             if p.sigma is not None and np.isfinite(p.sigma)}
    if sigma:
        beside = Path(mechanism.source).with_name(KNOWLEDGE)
        record = read_identification(beside) if mechanism.inputs and beside.is_file() else None
        if record is not None and not of_other_values(record, mechanism):
            return knowledge_of(record, mechanism, beside), COVARIANCE, (str(beside),)
        return independent(mechanism, sigma), SIGMAS, ()
    allowed = {p.name: p.prior_sigma for i, p in enumerate(mechanism.parameters)
               if i in mechanism.free and p.prior_sigma is not None}
    return (independent(mechanism, allowed), TOLERANCES, ()) if allowed else None


@dataclass(frozen=True, eq=False)
class SolvedRows:
    """Kinematics that were solved, and how they follow from the machine.

    ``at``: poses, joint values and conditions (N rows); ``registration``: what sees the platform,
    of the data set ``dataset``, if any; ``solve``: joint values and rates of a model (N, k) or
    (N, 2 k), for inverse kinematics and velocities.
    """

    which: str
    at: PoseRows
    registration: Registration
    dataset: str
    solve: Solve | None


def model_sigma(mechanism: Mechanism, solved: SolvedRows) -> tuple[tuple[str, ...], ModelSigma]:
    """Return the files behind what is known of a model, and how well that knows its kinematics.

    The latter as columns in file units, and as the entry of the JSON.
    """
    known = carried(mechanism)
    if known is None:
        return (), ModelSigma()
    knowledge, source, files = known
    k, at = len(mechanism.actuators), solved.at
    if source == TOLERANCES and solved.solve is None and len(at.q) > MOST:
        at = at.take(np.linspace(0, len(at.q) - 1, MOST).astype(int))
    if solved.which == "forward":
        position, rotation = forward_sigma(Model(mechanism), solved.registration, at, knowledge,
                                           solved.dataset)
        columns = {"sigma_position": position / mechanism.units.factor("length")}
        if mechanism.motion.turns:
            columns["sigma_rotation"] = rotation / mechanism.units.factor("angle")
        return files, ModelSigma.of(mechanism, columns, source, solved.dataset or "base")
    q = _joints(mechanism, solved, knowledge)
    columns = joint_columns(mechanism, q[:, :k], "sigma_q_{}")
    if q.shape[1] > k:
        columns |= joint_columns(mechanism, q[:, k:], "sigma_rate_{}")
    return files, ModelSigma.of(mechanism, columns, source, "")


def _joints(mechanism: Mechanism, solved: SolvedRows, knowledge: ParameterCovariance) -> Array:
    """Return standard deviations of joint values, and of rates where they were asked for, SI."""
    model, short = Model(mechanism), mechanism.dependent > 0
    if solved.which == "inverse" and not short:
        return joint_sigma(model, solved.at, knowledge)
    assert solved.solve is not None
    found = sigma_by_differences(solved.solve, mechanism, knowledge)
    k = len(mechanism.actuators)
    left = left_joint_sigma(model, solved.at, knowledge)
    found[:, :k] = np.hypot(found[:, :k], left)
    if short:
        # a pose that names everything lies on this machine's surface alone
        near = joint_sigma(model, solved.at, knowledge)
        found[:, :k] = np.where(np.isnan(found[:, :k]), near, found[:, :k])
    return found
