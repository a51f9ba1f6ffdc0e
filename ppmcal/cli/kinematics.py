"""``ppmcal kinematics inverse|forward|velocity``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from ppmcal.words import counted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ppmcal.conditions import Conditions
    from ppmcal.kinematics import Table
    from ppmcal.mechanism import Mechanism


@click.command("kinematics")
@click.argument("which", type=click.Choice(["inverse", "forward", "velocity"]))
@click.argument("mech", type=FILE)
@click.argument("table", type=FILE)
@out_option("kinematics")
@click.option("--dataset", metavar="NAME", default=None,
              help="forward: the pose as this instrument of the model file would measure it.")
@quiet_option
@json_option
def command(which: str, mech: Path, table: Path, out: Path, dataset: str | None, quiet: bool,
            as_json: bool) -> None:
    """Kinematics of every row of TABLE (poses, joints, or poses with velocities).

    Rows are a path in their order: singularities crossed and assembly modes changed on the
    way are marked. Writes kinematics.csv and kinematics.json.
    """
    from ppmcal.files import Output, provenance, read_mechanism
    from ppmcal.outputs.tables import kinematics_files

    console = Console(quiet, as_json)
    mechanism = read_mechanism(mech)
    result, rows = _solve(which, mechanism, table)
    seen = None
    if dataset is not None:
        if which != "forward":
            raise click.UsageError("--dataset goes with forward.")
        seen = _as_measured(mechanism, dataset, result, rows)
    header, columns = input_columns(table)
    source = provenance([*mechanism.inputs, table], command_line(), None)
    with Output(out) as output:
        for name, text in kinematics_files(mechanism, result, header, columns, which, source,
                                           seen).items():
            output.add(name, text)
    bad = [(n + 1, s, r) for n, (s, r) in enumerate(zip(result.status, result.reason, strict=True))
           if s != "ok"]
    console.say(f"{mechanism.name}: {which} kinematics of {counted(len(result.status), 'row')}, "
                f"{len(result.status) - len(bad)} ok.")
    console.warn_rows(mechanism.findings, [f"row {n}: {s}: {r}" for n, s, r in bad])
    finish(out, list(output.files), console)
    console.summary({"format": "ppmcal/kinematics/1", "rows": len(result.status),
                     "not_ok": len(bad), "provenance": source})
    if bad and all(s in ("not converged", "singular") for s in result.status):
        raise click.exceptions.Exit(3)
    leave(bool(bad))


def _enough(mechanism: Mechanism, rows: Conditions, table: Path) -> None:
    """Refuse a table that lacks a column which the machine's effects depend on."""
    from ppmcal.errors import BadInput
    from ppmcal.influence import missing_columns

    missing = missing_columns(mechanism, rows)
    if missing:
        raise BadInput(f"the machine's effects depend on {', '.join(missing)}, which is not there",
                       f"{table}: header", f"Add the column {missing[0]}, or take the effect out "
                       f"of {mechanism.source}")


def _solve(which: str, mechanism: Mechanism, table: Path) -> tuple[Table, Conditions]:
    import numpy as np

    from ppmcal.closure import Model
    from ppmcal.conditions import conditions
    from ppmcal.errors import BadInput
    from ppmcal.files import read_joints, read_poses, twists
    from ppmcal.kinematics import forward_table, inverse_table, velocity_table

    model = Model(mechanism)
    if which == "forward":
        joints = read_joints(table, mechanism)
        rows = conditions(joints.conditions, mechanism.actuators, mechanism.gravity, joints.q)
        _enough(mechanism, rows, table)
        return forward_table(model, joints.q, rows), rows
    poses = read_poses(table, mechanism)
    rows = conditions(poses.conditions, mechanism.actuators, mechanism.gravity,
                      np.zeros((len(poses.rows), len(mechanism.actuators))))
    _enough(mechanism, rows, table)
    if which == "inverse":
        return inverse_table(model, poses.poses, rows), rows
    motion = twists(poses.extra, mechanism)
    if motion is None:
        raise BadInput("no velocity columns", str(table),
                       "Add vx, vy, vz, wx, wy, wz as far as the machine has them")
    return velocity_table(model, poses.poses, motion, rows), rows


def _as_measured(mechanism: Mechanism, dataset: str, result: Table, rows: Conditions
                 ) -> NDArray[Any]:
    import numpy as np

    from ppmcal.arrays import known
    from ppmcal.closure import Model
    from ppmcal.compensate import station_of
    from ppmcal.errors import unknown
    from ppmcal.influence import shifted
    from ppmcal.observation import measured_pose, stretched
    from ppmcal.targets import pose_motor

    if dataset not in mechanism.registrations:
        raise unknown("data set", dataset, mechanism.registrations, f"{mechanism.source}: "
                      "measurement.datasets")
    station = station_of(mechanism.registrations[dataset], len(mechanism.actuators))
    seen = np.full_like(result.pose, np.nan)
    good = known(result.pose)
    pose = pose_motor(result.pose[good])
    seen[good] = measured_pose(station, pose)
    shift = shifted(Model(mechanism), rows.take(good), result.q[good], pose).shift
    if shift is not None:
        seen[good, :3] = stretched(seen[good, :3], shift.stretch)
    return seen
