"""What ``ppmcal kinematics`` takes, and its Python functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import (
    Arguments,
    Command,
    Face,
    Machine,
    Table,
    argument,
    mechanism,
    option,
    seed,
)

WHICH = ("inverse", "forward", "velocity")


@dataclass(frozen=True)
class KinematicsArguments(Arguments):
    """Which kinematics of which table, and how poses are written."""

    which: str = argument("", "inverse, forward or velocity; see the functions of these names.",
                          choices=WHICH)
    mechanism: Machine = mechanism()
    table: Table = argument("TABLE", "Poses, joint values, or poses with velocities.",
                            words="table")
    tool: str | Sequence[float] | None = option(
        None, "Poses and velocities are those of this point in platform axes (X,Y where the "
        "machine is planar), in the unit of {mechanism}; its axes are the platform's",
        metavar="X,Y,Z", otherwise="the platform origin")
    rotation: str = option(
        "rotvec", "Spatial rotations in {table} and in the results: rotvec (columns rx, ry, rz; a "
        "quaternion is read too), quat (quat_x, quat_y, quat_z, quat_w), or euler-xyz and "
        "the like: fixed axes in small letters, moving axes in capitals, any of the 24 "
        "orders (euler_1, euler_2, euler_3, in the order of the letters).", metavar="CONVENTION",
        shown=True)
    method: str = option(
        "newton", "forward: newton on the closure; or the intersection of the limbs' spheres, "
        "circles, planes and lines, as in the PPM paper: of planar machines, deltas of three "
        "parallelograms and 3-RPS.", choices=("newton", "intersection"), shown=True)
    dataset: str | None = option(
        None, "forward: the pose as this instrument of the model file would measure it.",
        metavar="NAME")
    all_modes: bool = option(
        False, "forward: every assembly mode of each row, a line for each; the column own marks "
        "the machine's own, that of home and the branches.", "--all")
    seed: int = seed()
    pictures: bool = option(
        False, "Write the path, pose, joints with their limits, rates and the distance to "
        "singularity as PNG, over a column time or t (s), else by row.")


OF_FORWARD = ("method", "dataset", "all_modes", "seed")
POSES = ("poses", "Path of a CSV, data frame, mapping of columns, or array (N, d) of the machine's "
         "coordinates, in the mechanism file's units.")
JOINTS = ("joints", "Path of a CSV with columns ``q_<actuator>``, data frame, mapping, or array "
          "(N, k).")
MOVES = ("moves", "As the poses of :func:`ppmcal.inverse`, with velocities beside them.")

COMMAND = Command(
    "kinematics", KinematicsArguments,
    about=("Kinematics of every row of {table} (poses, joints, or poses with velocities).",
           "Rows are a path in their order: singularities crossed and assembly modes changed on "
           "the way are marked. Velocities vx, vy, vz, wx, wy, wz are those of the tool point and "
           "the angular velocity in base axes. Writes kinematics.csv and kinematics.json, and "
           "pictures if they are asked for."),
    examples=("ppmcal kinematics inverse mine.yaml poses.csv --tool 0,0,10",
              "ppmcal kinematics forward mine.yaml joints.csv --rotation quat",
              "ppmcal kinematics forward mine.yaml joints.csv --all",
              "ppmcal kinematics inverse mine.yaml poses.csv --pictures"),
    out="kinematics", result="KinematicsResult",
    record=("kinematics", "ppmcal.io.results.kinematics:KinematicsRecord"),
    raises="BadInput: anything wrong in the table, or options that do not go together.",
    faces=(
        Face("inverse", ("Return the joint values of platform poses.",), {"which": "inverse"},
             {"table": POSES}, OF_FORWARD),
        Face("forward", ("Return the platform poses of joint values.",), {"which": "forward"},
             {"table": JOINTS}),
        Face("velocity", (
            "Return the joint rates of poses with velocities ``vx, vy, vz, wx, wy, wz``.",
            "Velocities are those of the tool point, and the angular velocity in base axes, in the "
            "mechanism file's units per second."), {"which": "velocity"}, {"table": MOVES},
            OF_FORWARD, "BadInput: anything wrong in the table, no velocity columns.")),
    shares={"reading the table": 0.15, "forward kinematics": 2.7, "inverse kinematics": 4.0,
            "writing the results": 1.0})
