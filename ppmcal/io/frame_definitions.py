"""``frame: {points: ...}`` and ``frame: {first_pose: true}`` of a sidecar.

Both say where the base is in the measuring frame, as well as it was measured: the frame is given,
and what is promised in base axes has the uncertainty of what defines them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.schema import is_number, show
from ppmcal.io.sidecar import SidecarFile, station_of, tracked
from ppmcal.io.sidecar_values import frame_of, point_of
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.frame_definition import frame_by_points, frame_by_pose, frame_covariance
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.rotations import vector_like
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset, Unknown, tracker_noise
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import FIRST_POSE, DefinedFrame, Registration
from ppmcal.notes import NOTE, Note
from ppmcal.units import Units

POINTS = {"origin": "the base frame's origin", "x_axis": "a point of its x axis",
          "plane": "a point of its x-y plane where y is positive"}
"""Points that define a base frame; a planar machine's has no plane."""
TOLD = 0.1
"""Points whose noise turns an axis by more than this, rad, do not define it."""
EXAMPLE = "{points: {origin: [0, 0, 0], x_axis: [900, 0, 0], plane: [100, 700, 0]}}"


def defined_frame(file: SidecarFile, mechanism: Mechanism, units: Units, side: str) -> Unknown:
    """Return where the base stands in the measuring frame, as a sidecar says or defines it.

    One that the first pose defines is the base's own until that is read: see :func:`by_first_pose`.

    Raises:
        BadInput: as :func:`frame_of`; points that lie too near one another or on one line, or
            whose noise nobody tells.
    """
    raw = file.frame
    if isinstance(raw, dict) and "first_pose" in raw:
        if raw != {"first_pose": True}:
            raise BadInput(f"{show(raw)} cannot be used here", f"{side}: frame",
                           "Write {first_pose: true} and nothing else")
        return Unknown(False, np.zeros(6))
    if not isinstance(raw, dict) or "points" not in raw:
        return frame_of(raw, mechanism.motion, units, side)
    refuse_unknown("key", raw, ("points", "sigma"), f"{side}: frame")
    if file.scale != "known":
        raise BadInput("the points are measured in the instrument's own scale, which is not 1",
                       f"{side}: frame.points", "Write the base's pose, or unknown; or take "
                       "`scale` out")
    points = _points(raw["points"], mechanism, units, side)
    noise = _noise(raw.get("sigma"), file, points, mechanism, units, side)
    _refuse_line(points, noise, units, side)
    size = points.size
    covariance = np.zeros((size, size))
    for i, one in enumerate(noise):
        covariance[3 * i:3 * i + 3, 3 * i:3 * i + 3] = one

    def frame(values: Array) -> Array:
        return frame_by_points(values.reshape(-1, 3))

    words = f"{('two', 'three')[len(points) - 2]} points"
    return Unknown(False, pose_vector(frame(points.ravel())), defined=DefinedFrame(
        words, frame_covariance(frame, points.ravel(), covariance)))


def _points(raw: object, mechanism: Mechanism, units: Units, side: str) -> Array:
    """Return the points (2 or 3, 3), m, of the measuring frame."""
    place, planar = f"{side}: frame.points", mechanism.motion.planar
    needed = [*POINTS][:2 if planar else 3]
    if not isinstance(raw, dict):
        raise BadInput(f"{show(raw)} does not name points", place,
                       f"Write frame: {EXAMPLE}, each as the instrument measured it")
    if planar and "plane" in raw:
        raise BadInput("the base frame of a planar machine has no plane to be defined",
                       f"{place}.plane", "Take it out")
    refuse_unknown("point", raw, needed, place)
    for name in needed:
        if name not in raw:
            raise BadInput(f"the point '{name}' is missing", place,
                           f"Add {POINTS[name]}, as the instrument measured it")
        if isinstance(raw[name], str):
            raise BadInput(f"{show(raw[name])} cannot be used here", f"{place}.{name}",
                           "Write the point as the instrument measured it")
    return np.array([point_of(raw[name], mechanism.motion, units, side,
                              f"frame.points.{name}").value for name in needed])


def _noise(own: object, file: SidecarFile, points: Array, mechanism: Mechanism, units: Units,
           side: str) -> Array:
    """Return the covariance (n, 3, 3) of points (n, 3), m^2."""
    sigma, length, place = file.instrument.sigma, units.factor("length"), f"{side}: frame.sigma"
    if own is not None and (not is_number(own) or not own > 0.0):
        raise BadInput(f"{show(own)} is not a standard deviation", place,
                       "Write a number greater than 0")
    plain = own if own is not None else sigma.position
    if plain is None and tracked(file.instrument, f"{side}: instrument.sigma"):
        root = tracker_noise(points, station_of(file.instrument, mechanism.motion, units, side),
                             (sigma.range or 0.0) * length,
                             (sigma.angle or 0.0) * units.factor("angle"))
    elif plain is None:
        raise BadInput("how well the points were measured is not told", place,
                       "Add their standard deviation beside `points`, such as `sigma: 0.01`")
    else:
        root = float(plain) * length * np.tile(np.eye(3), (len(points), 1, 1))
    if mechanism.motion.planar:
        root = root * np.array([1.0, 1.0, 0.0])
    return np.asarray(root @ np.swapaxes(root, 1, 2))


def _refuse_line(points: Array, noise: Array, units: Units, side: str) -> None:
    """Refuse points that tell an axis no better than their noise."""
    place, sigma = f"{side}: frame.points", float(np.sqrt(noise.diagonal(0, 1, 2).max()))
    ahead = points[1] - points[0]
    far = float(np.linalg.norm(ahead))
    noisy = f"their noise is {units.words(sigma, 'length')}"
    if sigma >= TOLD * far:
        raise BadInput(f"the points `origin` and `x_axis` are {units.words(far, 'length')} apart, "
                       f"and {noisy}: they tell no direction", place,
                       "Measure a point of the x axis farther from the origin")
    if len(points) < 3:
        return
    height = float(np.linalg.norm(np.cross(ahead / far, points[2] - points[0])))
    if sigma >= TOLD * height or height < 1e-6 * far:
        raise BadInput("the three points lie on one line: `plane` is "
                       f"{units.words(height, 'length')} off the line through `origin` and "
                       f"`x_axis`, and {noisy}, so that the base may be turned about its x axis",
                       place, "Measure a point of the x-y plane well off that line")


def by_first_pose(data: Dataset, file: SidecarFile, mechanism: Mechanism, side: str) -> Dataset:
    """Return measurements with the frame in which the nominal machine's first pose is right.

    Where the sidecar asks for it. Repeats of that pose count together.

    Raises:
        BadInput: an instrument or a machine that shows no rotation, a target that is not known, or
            joint values that the nominal machine does not take.
    """
    if not isinstance(file.frame, Mapping) or "first_pose" not in file.frame:
        return data
    place = f"{side}: frame.first_pose"
    _refuse_half(data, file, mechanism, place)
    first = np.flatnonzero(data.groups == data.groups[0])
    measured = np.concatenate([data.position, data.rotation], axis=1)[first]
    if mechanism.motion.planar:
        measured[:, [2, 3, 4]] = 0.0
    good = np.isfinite(measured).all(axis=1)
    if not good.any():
        raise BadInput("the first pose was not measured in full", place,
                       "Begin the file with a row that was, or write frame: unknown")
    row, measured = int(first[0]), measured[good]
    pose = _nominal_pose(data, row, mechanism, place)
    stands = Registration(target=data.target.value, target_rotation=data.target_rotation.value)
    measured[:, 3:] = vector_like(measured[:, 3:], np.broadcast_to(measured[0, 3:], (
        len(measured), 3)))
    seen, count = measured.mean(axis=0), len(measured)
    sigma = np.concatenate([data.sigma_position[first][good], data.sigma_rotation[first][good]],
                           axis=1)
    parts = [*range(6)] if not mechanism.motion.planar else [0, 1, 5]
    variance = np.zeros(6)
    variance[parts] = np.sum(sigma[:, parts] ** 2, axis=0) / count**2

    def frame(values: Array) -> Array:
        # noise turns the body about the measuring frame's axes
        turned = cga.compose(cga.motor_from_rotation_vector(values[3:], np.zeros(3)),
                             cga.motor_from_rotation_vector(seen[3:], np.zeros(3)))
        return frame_by_pose(np.concatenate([seen[:3] + values[:3], cga.rotation_vector(turned)]),
                             pose, stands)

    note = Note(f"{data.source}: the base axes are where the nominal machine is right at the first "
                "pose: what it errs there moves the base's points in them, which their tolerances "
                "have to allow", NOTE)
    return replace(data, findings=(*data.findings, note), frame=Unknown(
        False, pose_vector(frame(np.zeros(6))), defined=DefinedFrame(
            FIRST_POSE, frame_covariance(frame, np.zeros(6), np.diag(variance)))))


def _refuse_half(data: Dataset, file: SidecarFile, mechanism: Mechanism, place: str) -> None:
    """Refuse a first pose of which part stays unknown."""
    if not data.kind.sees_rotation or not mechanism.motion.turns:
        what = (f"the instrument '{data.kind}' shows" if not data.kind.sees_rotation else
                f"poses of a {mechanism.motion} machine have")
        raise BadInput(f"a frame is defined by a first pose with its rotation, and {what} none",
                       place, f"Define it by points of the base, frame: {EXAMPLE}")
    if file.targets is not None or data.target.fitted or data.target_rotation.fitted:
        what = "target" if file.targets is not None or data.target.fitted else "target_rotation"
        raise BadInput(f"a first pose defines the frame of a mark that is known, and the {what} is "
                       "not", place, "Write where it is on the platform, or define the frame by "
                       f"points of the base, frame: {EXAMPLE}")
    if data.scale.fitted or data.scale.value[0] != 1.0:
        raise BadInput("the first pose is measured in the instrument's own scale, which is not 1",
                       place, "Take `scale` out, or write frame: unknown")


def _nominal_pose(data: Dataset, row: int, mechanism: Mechanism, place: str) -> Array:
    """Return the motor (8,) of the pose at which the controller believed the platform."""
    if data.commanded is not None:
        given = data.commanded[row]
        if not np.isfinite(given).all():
            raise BadInput("the first commanded pose has open coordinates", place,
                           "Give it in full, or define the frame by points of the base")
        return pose_motor(given)
    found = forward(Model(mechanism.nominal()), data.q[row:row + 1])
    if not np.isfinite(found.pose).all():
        raise BadInput("the nominal machine has no pose at the first row's joint values", place,
                       "Begin the file with a row that it has one for")
    return np.asarray(found.pose[0])
