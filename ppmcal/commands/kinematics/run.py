"""Inverse, forward and velocity kinematics of a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ppmcal.calibration.compensation import PoseRows
from ppmcal.calibration.fit import secondary, stretched
from ppmcal.commands.inputs import files_of, load, place_of, refuse_unrecorded
from ppmcal.commands.kinematics.options import KinematicsArguments
from ppmcal.commands.kinematics.result import KinematicsResult, Solve, SolvedRows, model_sigma
from ppmcal.design.every_mode import every_mode
from ppmcal.design.intersection import forward_by_intersection
from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io import read_joints, read_poses, twists
from ppmcal.io.grid import read_point
from ppmcal.io.pose_fields import check_convention
from ppmcal.io.poses import Given
from ppmcal.io.results.kinematics import (
    COVARIANCE,
    KinematicsUncertainty,
    ModeColumns,
    ModelSigma,
    PoseFormat,
)
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

WHICH = ("inverse", "forward", "velocity")
OWNER = "the machine's effects"
HOW_SURE = "how well the model is known"
UNKNOWN = ModelSigma(entry=KinematicsUncertainty(source=COVARIANCE))
"""Where that could not be had."""


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
    modes, used = None, None
    if asked.all_modes:
        every = every_mode(Model(machine), found, method, seed)
        modes = ModeColumns(every.row + 1, every.mode, every.own,
                            tuple(zip(found.status, found.reason, strict=True)), every.method,
                            every.complete)
        found, given, rows = every.table, _repeated(given, every.row), rows.take(every.row)
        used = seed if every.method == "search" else None
    pose = None
    if dataset is not None:
        pose = _as_measured(machine, dataset, found, rows)
    elif convention[0] is not None:
        pose = tool_poses(Model(machine), found.pose, convention[0])
    form = PoseFormat(convention[0], pose, convention[1], method if which == "forward" else "")
    notes = list[Note]()
    seen = machine.registrations[dataset] if dataset is not None else Registration() if (
        convention[0] is None) else PoseConvention(convention[0]).registration
    solved = SolvedRows(which, PoseRows(found.pose, found.q, rows), seen, dataset or "", solve)
    known, sure = secondary(HOW_SURE, lambda: model_sigma(machine, solved), (None, UNKNOWN), notes)
    source = source_of("kinematics", [*machine.inputs, *files_of(table),
                                      *(known.files if known else ())], used)
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
