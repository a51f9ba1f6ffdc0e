"""Inverse, forward and velocity kinematics of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ppmcal.api.inputs import (
    Machine,
    files_of,
    load,
    place_of,
    refuse_unrecorded,
    source_of,
)
from ppmcal.api.result import Result
from ppmcal.calibration.observation import stretched
from ppmcal.design.intersection import forward_by_intersection
from ppmcal.errors import BadInput, unknown
from ppmcal.io import read_joints, read_poses, twists
from ppmcal.io.grid import read_point
from ppmcal.io.poses import Given
from ppmcal.io.results.kinematics import PoseFormat, kinematics_files, solved_sentence
from ppmcal.io.rotations import check_convention
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import shifted
from ppmcal.kinematics.partial_pose import PoseConvention, pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.kinematics.tables import (
    KinematicsTable,
    forward_table,
    inverse_table,
    tool_poses,
    velocity_table,
)
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Environment, environment
from ppmcal.model.mechanism import Mechanism

WHICH = ("inverse", "forward", "velocity")
OWNER = "the machine's effects"


@dataclass(frozen=True, eq=False, repr=False)
class KinematicsResult(Result):
    """Kinematics of N rows.

    Attributes:
        mechanism: the machine; which: ``inverse``, ``forward`` or ``velocity``.
        table: joint values, poses, rates, conditioning, status and reason of each row, SI.
        form: tool point, measured poses and convention of rotations in the files.
        given: header and columns of the table as it was given.
    """

    COMMAND: ClassVar[str] = "kinematics"
    TABLE: ClassVar[str] = "kinematics.csv"

    mechanism: Mechanism
    which: str
    table: KinematicsTable
    form: PoseFormat
    given: tuple[tuple[str, ...], tuple[Any, ...]]

    @property
    def q(self) -> Array:
        """Joint values (N, k), m and rad."""
        return self.table.q

    @property
    def pose(self) -> Array:
        """Poses (N, 6): x, y, z in m, rotation vector in rad; of the tool if there is one."""
        return self.table.pose if self.form.pose is None else self.form.pose

    @property
    def failed(self) -> list[tuple[int, str, str]]:
        """Rows (from 1) that are not ok, each with status and reason."""
        pairs = zip(self.table.status, self.table.reason, strict=True)
        return [(n + 1, s, r) for n, (s, r) in enumerate(pairs) if s != "ok"]

    @cached_property
    def _made(self) -> tuple[dict[str, str], int]:
        header, columns = self.given
        return kinematics_files(self.mechanism, self.table, header, list(columns), self.which,
                                self.provenance, self.form)

    @property
    def gimbal_lock(self) -> int:
        """How many rows have only two of their three Euler angles determined."""
        return self._made[1]

    def files(self) -> Mapping[str, str | bytes]:
        """Return kinematics.csv and kinematics.json."""
        return dict(self._made[0])

    def headline(self) -> str:
        """Return how many rows are ok."""
        total = len(self.table.status)
        return (f"{self.mechanism.name}: {self.which} kinematics, "
                f"{solved_sentence(total - len(self.failed), total)}.")


def inverse(mechanism: Machine, poses: Any, *, tool: str | Sequence[float] | None = None,
            rotation: str = "rotvec") -> KinematicsResult:
    """Return the joint values of platform poses.

    Args:
        mechanism: the machine, or its file.
        poses: path of a CSV, data frame, mapping of columns, or array (N, d) of the machine's
            coordinates, in the mechanism file's units.
        tool: point whose poses they are, in platform axes  [default: the platform's origin].
        rotation: ``rotvec``, ``quat``, or ``euler-xyz`` and the like.

    Raises:
        BadInput: anything wrong in the table, or an option that does not go with the machine.
    """
    return kinematics("inverse", mechanism, poses, tool=tool, rotation=rotation)


def forward(mechanism: Machine, joints: Any, *, tool: str | Sequence[float] | None = None,
            rotation: str = "rotvec", method: str = "newton", dataset: str | None = None
            ) -> KinematicsResult:
    """Return the platform poses of joint values.

    Args:
        mechanism: the machine, or its file.
        joints: path of a CSV with columns ``q_<actuator>``, data frame, mapping, or array (N, k).
        tool: point whose poses are wanted, in platform axes.
        rotation: as for :func:`ppmcal.inverse`.
        method: ``newton`` on the closure, or ``intersection`` of the limbs' circles and lines
            for planar machines ([PPM]).
        dataset: the poses as this instrument of the model's file would measure them.

    Raises:
        BadInput: anything wrong in the table, or an option that does not go with the machine.
    """
    return kinematics("forward", mechanism, joints, tool=tool, rotation=rotation, method=method,
                      dataset=dataset)


def velocity(mechanism: Machine, moves: Any, *, tool: str | Sequence[float] | None = None,
             rotation: str = "rotvec") -> KinematicsResult:
    """Return the joint rates of poses with velocities ``vx, vy, vz, wx, wy, wz``.

    Velocities are those of the tool point, and the angular velocity in base axes, in the
    mechanism file's units per second. Arguments as for :func:`ppmcal.inverse`.

    Raises:
        BadInput: anything wrong in the table, no velocity columns.
    """
    return kinematics("velocity", mechanism, moves, tool=tool, rotation=rotation)


def kinematics(which: str, mechanism: Machine, table: Any, *,
               tool: str | Sequence[float] | None = None, rotation: str = "rotvec",
               method: str = "newton", dataset: str | None = None) -> KinematicsResult:
    """Return the kinematics of every row of a table.

    Rows are a path in their order: singularities crossed and assembly modes changed on the
    way are marked in ``status``.

    Args:
        which: ``inverse``, ``forward`` or ``velocity``; see the functions of these names.
        mechanism: the machine, or its file.
        table: poses, joint values, or poses with velocities; a path or a table in memory.
        tool: a point in platform axes, in the mechanism file's unit of length.
        rotation: ``rotvec``, ``quat``, or ``euler-xyz`` and the like.
        method: forward: ``newton`` or ``intersection``.
        dataset: forward: the pose as this instrument would measure it.

    Raises:
        BadInput: anything wrong in the table, or options that do not go together.
    """
    if which not in WHICH:
        raise unknown("kinematics", which, WHICH)
    if which != "forward" and (dataset is not None or method != "newton"):
        option = "--dataset" if dataset is not None else "--method"
        raise BadInput(f"{option} goes with forward", "", "Leave it out")
    if dataset is not None and tool is not None:
        raise BadInput("--tool and --dataset do not go together: the instrument measures its own "
                       "target", "", "Leave one of them out")
    machine = load(mechanism)
    point, convention = _point(tool, machine), check_convention(rotation, machine)
    found, rows, given = _solved(which, machine, table, (point, convention), method)
    pose = None
    if dataset is not None:
        pose = _as_measured(machine, dataset, found, rows)
    elif point is not None:
        pose = tool_poses(Model(machine), found.pose, point)
    form = PoseFormat(point, pose, convention, method if which == "forward" else "")
    source = source_of("kinematics", [*machine.inputs, *files_of(table)], None)
    return KinematicsResult(source, (), machine, which, found, form, given)


def _point(tool: str | Sequence[float] | None, mechanism: Mechanism) -> Array | None:
    """Return the tool point (3,), m; one of a planar machine is in its plane."""
    if tool is None:
        return None
    text = tool if isinstance(tool, str) else ",".join(repr(float(v)) for v in tool)
    point = read_point(text, mechanism)
    if mechanism.motion == "planar" and point[2] != 0.0:
        raise BadInput("the tool of a planar machine is a point of its plane", "--tool",
                       f"Write X,Y in {mechanism.units.length}")
    return point


def _solved(which: str, machine: Mechanism, table: Any, asked: tuple[Array | None, str],
            method: str) -> tuple[KinematicsTable, Environment, Given]:
    """Return the kinematics of a table, the environment of its rows, and the table as it stands."""
    model, (tool, rotation) = Model(machine), asked
    instead = f", or take the effect out of {machine.source}"
    if which == "forward":
        joints = read_joints(table, machine)
        rows = environment(joints.environment, machine.actuators, machine.gravity, joints.q)
        refuse_unrecorded(machine, rows, OWNER, place_of(table, "joints"), instead)
        found = forward_by_intersection(model, joints.q) if method == "intersection" else None
        return forward_table(model, joints.q, rows, found), rows, joints.given
    poses = read_poses(table, machine, rotation)
    rows = environment(poses.environment, machine.actuators, machine.gravity,
                       np.full((len(poses.rows), len(machine.actuators)), np.nan))
    refuse_unrecorded(machine, rows, OWNER, place_of(table, "poses"), instead)
    convention = PoseConvention(np.zeros(3) if tool is None else tool, rotation)
    if which == "inverse":
        return inverse_table(model, poses.poses, rows, convention), rows, poses.given
    motion = twists(poses.extra, machine)
    if motion is None:
        raise BadInput("no velocity columns", place_of(table, "poses"),
                       "Add vx, vy, vz, wx, wy, wz as far as the machine has them")
    return velocity_table(model, poses.poses, motion, rows, convention), rows, poses.given


def _as_measured(mechanism: Mechanism, dataset: str, found: KinematicsTable, rows: Environment
                 ) -> Array:
    """Return the poses (N, 6) as an instrument of the model's file would show them."""
    if dataset not in mechanism.registrations:
        raise unknown("data set", dataset, mechanism.registrations, f"{mechanism.source}: "
                      "measurement.datasets")
    registration = mechanism.registrations[dataset]
    seen = np.full_like(found.pose, np.nan)
    good = finite_rows(found.pose)
    pose = pose_motor(found.pose[good])
    seen[good] = measured_pose(registration, pose)
    shift = shifted(Model(mechanism), rows.take(good), found.q[good], pose).shift
    if shift is not None:
        seen[good, :3] = stretched(seen[good, :3], shift.stretch)
    return seen
