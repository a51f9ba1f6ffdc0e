"""``ppmcal kinematics inverse|forward|velocity``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import (
    FILE,
    MODEL,
    Console,
    console_options,
    examples,
    finish,
    leave,
    out_option,
    seed_option,
)
from ppmcal.wording import counted


@click.command("kinematics", epilog=examples(
    "ppmcal kinematics inverse mine.yaml poses.csv --tool 0,0,10",
    "ppmcal kinematics forward mine.yaml joints.csv --rotation quat",
    "ppmcal kinematics forward mine.yaml joints.csv --all",
    "ppmcal kinematics inverse mine.yaml poses.csv --pictures"))
@click.argument("which", type=click.Choice(["inverse", "forward", "velocity"]))
@click.argument("mech", type=MODEL)
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
              show_default=True, help="forward: newton on the closure; or the intersection of "
              "the limbs' spheres, circles, planes and lines, as in the PPM paper: of planar "
              "machines, deltas of three parallelograms and 3-RPS.")
@click.option("--dataset", metavar="NAME", default=None,
              help="forward: the pose as this instrument of the model file would measure it.")
@click.option("--all", "all_modes", is_flag=True,
              help="forward: every assembly mode of each row, a line for each; the column own "
              "marks the machine's own, that of home and the branches.")
@click.option("--pictures", is_flag=True,
              help="Write the path, pose, joints with their limits, rates and the distance to "
              "singularity as PNG, over a column time or t (s), else by row.")
@seed_option
@console_options
def command(which: str, mech: Path, table: Path, out: Path, tool: str | None, rotation: str,
            method: str, dataset: str | None, all_modes: bool, pictures: bool, seed: int | None,
            console: Console) -> None:
    """Kinematics of every row of TABLE (poses, joints, or poses with velocities).

    Rows are a path in their order: singularities crossed and assembly modes changed on the
    way are marked. Velocities vx, vy, vz, wx, wy, wz are those of the tool point and the
    angular velocity in base axes. Writes kinematics.csv and kinematics.json, and pictures if
    they are asked for.
    """
    from ppmcal.api.kinematics import kinematics
    from ppmcal.io.results.kinematics import LOCKED

    result = kinematics(which, mech, table, tool=tool, rotation=rotation, method=method,
                        dataset=dataset, all_modes=all_modes, seed=seed or 0, pictures=pictures)
    written, failed = result.save(out), result.failed
    console.say(result.headline())
    if result.gimbal_lock:
        console.say(f"{counted(result.gimbal_lock, 'row')}: {LOCKED}.")
    console.warn_rows([*result.mechanism.findings, *result.findings],
                      [f"row {n}: {s}: {r}" for n, s, r in failed])
    finish(out, [p.name for p in written], console)
    lines = {"modes": len(result.table.status)} if all_modes else {}
    console.summary({"format": "ppmcal/kinematics-summary/1", "rows": result.asked,
                     "not_ok": len(failed), **lines, "gimbal_lock": result.gimbal_lock,
                     "provenance": result.provenance})
    if failed and len(failed) == result.asked and all(s in ("not converged", "singular")
                                           for _, s, _ in failed):
        raise click.exceptions.Exit(3)
    leave(bool(failed or result.findings))
