"""``ppmcal kinematics inverse|forward|velocity``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    command_line,
    finish,
    input_columns,
    json_option,
    leave,
    out_option,
    quiet_option,
)
from ppmcal.wording import counted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ppmcal.io.results.tables import Shown
    from ppmcal.kinematics.tables import KinematicsTable
    from ppmcal.model.dataset import Environment
    from ppmcal.model.mechanism import Mechanism


@click.command("kinematics")
@click.argument("which", type=click.Choice(["inverse", "forward", "velocity"]))
@click.argument("mech", type=FILE)
@click.argument("table", type=FILE)
@out_option("kinematics")
@click.option("--tool", default=None, metavar="X,Y,Z",
              help="Poses and velocities are those of this point in platform axes (X,Y where the "
              "machine is planar), in the unit of MECH; its axes are the platform's  [default: "
              "the platform origin].")
@click.option("--rotation", default="rotvec", show_default=True, metavar="CONVENTION",
              help="Spatial rotations in TABLE and in the results: rotvec (columns rx, ry, rz; a "
              "quaternion is read too), quat (quat_x, quat_y, quat_z, quat_w), or euler-xyz and "
              "the like: fixed axes in small letters, moving axes in capitals, any of the 24 "
              "orders (euler_1, euler_2, euler_3, in the order of the letters).")
@click.option("--method", type=click.Choice(["newton", "intersection"]), default="newton",
              show_default=True, help="forward: newton on the closure; or, for planar machines, "
              "the intersection of the limbs' circles and lines, as in the PPM paper.")
@click.option("--dataset", metavar="NAME", default=None,
              help="forward: the pose as this instrument of the model file would measure it.")
@quiet_option
@json_option
def command(which: str, mech: Path, table: Path, out: Path, tool: str | None, rotation: str,
            method: str, dataset: str | None, quiet: bool, as_json: bool) -> None:
    r"""Kinematics of every row of TABLE (poses, joints, or poses with velocities).

    Rows are a path in their order: singularities crossed and assembly modes changed on the
    way are marked. Velocities vx, vy, vz, wx, wy, wz are those of the tool point and the
    angular velocity in base axes. Writes kinematics.csv and kinematics.json.

    \b
    ppmcal kinematics inverse 6-UPS.yaml poses.csv
    ppmcal kinematics inverse 6-UPS.yaml poses.csv --tool 0,0,120
    ppmcal kinematics inverse 6-UPS.yaml poses.csv --rotation euler-ZYX
    ppmcal kinematics forward 6-UPS.yaml joints.csv --rotation quat
    ppmcal kinematics forward 3-RPR.yaml joints.csv --method intersection
    ppmcal kinematics velocity 3-RPR.yaml moves.csv --tool 30,-15
    """
    from ppmcal.io import Output, provenance, read_mechanism
    from ppmcal.io.results.tables import LOCKED, kinematics_files
    from ppmcal.io.rotations import check_convention

    console = Console(quiet, as_json)
    if which != "forward" and (dataset is not None or method != "newton"):
        raise click.UsageError(f"{'--method' if dataset is None else '--dataset'} goes with "
                               "forward.")
    if dataset is not None and tool is not None:
        raise click.UsageError("--tool and --dataset do not go together: the instrument measures "
                               "its own target.")
    mechanism = read_mechanism(mech)
    asked = _Asked(which, _point(tool, mechanism), check_convention(rotation, mechanism), method)
    result, rows = _solve(asked, mechanism, table)
    shown = _shown(asked, mechanism, dataset, result, rows)
    header, columns = input_columns(table)
    source = provenance([*mechanism.inputs, table], command_line(), None)
    files, locked = kinematics_files(mechanism, result, header, columns, which, source, shown)
    with Output(out) as output:
        for name, text in files.items():
            output.add(name, text)
    bad = [(n + 1, s, r) for n, (s, r) in enumerate(zip(result.status, result.reason, strict=True))
           if s != "ok"]
    console.say(f"{mechanism.name}: {which} kinematics of {counted(len(result.status), 'row')}, "
                f"{len(result.status) - len(bad)} ok.")
    if locked:
        console.say(f"{counted(locked, 'row')}: {LOCKED}.")
    console.warn_rows(mechanism.findings, [f"row {n}: {s}: {r}" for n, s, r in bad])
    finish(out, list(output.files), console)
    console.summary({"format": "ppmcal/kinematics/1", "rows": len(result.status),
                     "not_ok": len(bad), "gimbal_lock": locked, "provenance": source})
    if bad and all(s in ("not converged", "singular") for s in result.status):
        raise click.exceptions.Exit(3)
    leave(bool(bad))


class _Asked(NamedTuple):
    """What is asked for; ``tool`` (3,), m, None for the platform origin."""

    which: str
    tool: NDArray[Any] | None
    rotation: str
    method: str


def _point(tool: str | None, mechanism: Mechanism) -> NDArray[Any] | None:
    """Return the tool point (3,), m; one of a planar machine is in its plane."""
    from ppmcal.errors import BadInput
    from ppmcal.io.grid import read_point

    if tool is None:
        return None
    point = read_point(tool, mechanism)
    if mechanism.motion == "planar" and point[2] != 0.0:
        raise BadInput("the tool of a planar machine is a point of its plane", "--tool",
                       f"Write X,Y in {mechanism.units.length}")
    return point


def _shown(asked: _Asked, mechanism: Mechanism, dataset: str | None, result: KinematicsTable,
           rows: Environment) -> Shown:
    """Return how the results are to be written."""
    from ppmcal.io.results.tables import Shown
    from ppmcal.kinematics.closure import Model
    from ppmcal.kinematics.tables import tool_poses

    pose = None
    if dataset is not None:
        pose = _as_measured(mechanism, dataset, result, rows)
    elif asked.tool is not None:
        pose = tool_poses(Model(mechanism), result.pose, asked.tool)
    return Shown(asked.tool, pose, asked.rotation, asked.method if asked.which == "forward" else "")


def _enough(mechanism: Mechanism, rows: Environment, table: Path) -> None:
    """Refuse a table that lacks a column which the machine's effects depend on."""
    from ppmcal.errors import BadInput
    from ppmcal.kinematics.effect_response import missing_columns

    missing = missing_columns(mechanism, rows)
    if missing:
        raise BadInput(f"the machine's effects depend on {', '.join(missing)}, which is not there",
                       f"{table}: header", f"Add the column {missing[0]}, or take the effect out "
                       f"of {mechanism.source}")


def _solve(asked: _Asked, mechanism: Mechanism, table: Path) -> tuple[KinematicsTable, Environment]:
    import numpy as np

    from ppmcal.design.intersection import forward_by_intersection
    from ppmcal.errors import BadInput
    from ppmcal.io import read_joints, read_poses, twists
    from ppmcal.kinematics.closure import Model
    from ppmcal.kinematics.partial_pose import PoseConvention
    from ppmcal.kinematics.tables import forward_table, inverse_table, velocity_table
    from ppmcal.model.dataset import environment

    model = Model(mechanism)
    if asked.which == "forward":
        joints = read_joints(table, mechanism)
        rows = environment(joints.conditions, mechanism.actuators, mechanism.gravity, joints.q)
        _enough(mechanism, rows, table)
        found = (forward_by_intersection(model, joints.q) if asked.method == "intersection"
                 else None)
        return forward_table(model, joints.q, rows, found), rows
    poses = read_poses(table, mechanism, asked.rotation)
    rows = environment(poses.conditions, mechanism.actuators, mechanism.gravity,
                       np.zeros((len(poses.rows), len(mechanism.actuators))))
    _enough(mechanism, rows, table)
    convention = PoseConvention(np.zeros(3) if asked.tool is None else asked.tool, asked.rotation)
    if asked.which == "inverse":
        return inverse_table(model, poses.poses, rows, convention), rows
    motion = twists(poses.extra, mechanism)
    if motion is None:
        raise BadInput("no velocity columns", str(table),
                       "Add vx, vy, vz, wx, wy, wz as far as the machine has them")
    return velocity_table(model, poses.poses, motion, rows, convention), rows


def _as_measured(mechanism: Mechanism, dataset: str, result: KinematicsTable, rows: Environment
                 ) -> NDArray[Any]:
    import numpy as np

    from ppmcal.calibration.compensation import station_of
    from ppmcal.calibration.observation import stretched
    from ppmcal.errors import unknown
    from ppmcal.kinematics.closure import Model
    from ppmcal.kinematics.effect_response import shifted
    from ppmcal.kinematics.partial_pose import pose_motor
    from ppmcal.kinematics.registration import measured_pose
    from ppmcal.linalg import finite_rows

    if dataset not in mechanism.registrations:
        raise unknown("data set", dataset, mechanism.registrations, f"{mechanism.source}: "
                      "measurement.datasets")
    station = station_of(mechanism.registrations[dataset], len(mechanism.actuators))
    seen = np.full_like(result.pose, np.nan)
    good = finite_rows(result.pose)
    pose = pose_motor(result.pose[good])
    seen[good] = measured_pose(station, pose)
    shift = shifted(Model(mechanism), rows.take(good), result.q[good], pose).shift
    if shift is not None:
        seen[good, :3] = stretched(seen[good, :3], shift.stretch)
    return seen
