"""The sidecar of a measurement file: the YAML of the same stem."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, TypeVar

import numpy as np
from pydantic import BeforeValidator, model_validator

from ppmcal.design.virtual_instrument import Instrument
from ppmcal.errors import BadInput
from ppmcal.io.header import ReadFile, bare_name
from ppmcal.io.noise_limits import refuse_sigma
from ppmcal.io.schema import (
    LARGEST,
    Flag,
    Label,
    Positive,
    Registered,
    Strict,
    UnitsFile,
    check,
    choice,
    each,
    is_number,
    numbers,
    refuse,
    show,
)
from ppmcal.io.sidecar_values import (
    actuator_noise,
    at_point,
    frame_of,
    neither,
    point_of,
    rotation_of,
    scale_of,
)
from ppmcal.io.yaml import read_yaml
from ppmcal.linalg import Array
from ppmcal.model.dataset import NO_OFFSET, Unknown
from ppmcal.model.instruments import InstrumentKind, instruments
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import Motion
from ppmcal.units import Units

N = TypeVar("N")
FORMAT = "ppmcal/dataset/1"
EXAMPLE = """format: ppmcal/dataset/1
units: {{length: mm, angle: deg}}
instrument: {instrument}
frame: {frame}
target: unknown
"""
OF_POSES = "{kind: pose, sigma: {position: 0.01, rotation: 0.002}}"
OF_NUMBERS = {"distance": ("{kind: distance, sigma: {distance: 0.01}, point: unknown}", "known"),
              "height": ("{kind: plane, sigma: {height: 0.01}}", "unknown")}
"""Instrument and frame of an example, by the column that is there."""
ONE_OR_SEVERAL = ("there are several `targets`, and one `target`",
                  "Take `target` out, or write it as one of the `targets`")


_noise = each(numbers(
    lambda v: 0 <= v <= LARGEST, "a standard deviation",
    "Write a number of 0 or more, or one for each actuator: {leg1: 0.003}"))


def targets_given(value: object) -> object:
    """Refuse what are not names of targets with their places."""
    if value is None:
        return None
    if not isinstance(value, dict) or not value:
        raise refuse(f"{show(value)} does not name targets",
                     "Write {T1: unknown, T2: unknown}, or points [x, y, z] in platform axes")
    for name in value:
        if isinstance(name, bool) or not isinstance(name, str | int) or not str(name).strip():
            raise refuse(f"{show(name)} is not the name of a target", "Name it as the file does")
    return {str(name).strip(): place for name, place in value.items()}


class Sigmas(Strict, Generic[N]):
    """Standard deviations of an instrument, numbers of a sort ``N``."""

    position: N | None = None
    """Of each measured coordinate x, y, z."""
    range: N | None = None
    """Of a tracker's distances, in place of `position`."""
    angle: N | None = None
    """Of either angle of a tracker."""
    rotation: N | None = None
    """Of each measured angle."""
    height: N | None = None
    """Of a height (kind plane)."""
    distance: N | None = None
    """Of a distance (kind distance)."""


class SigmaFile(Sigmas[Positive]):
    """Standard deviations of the instrument and, optionally, of the drives."""

    value: Positive | None = None
    """Of what an encoder at a joint reads (kind joint), an angle or, of a slide, a length."""
    actuator: Annotated[Any, BeforeValidator(_noise)] = 0.0
    """Of the joint values: one number, or one by actuator."""
    estimated: Flag = False
    """Whether these only begin an estimate by the residuals, as which they count a few rows."""


class InstrumentFile(Strict):
    """``instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}``."""

    examples: ClassVar[Mapping[str, str]] = {"kind": "kind: pose",
                                             "sigma": "sigma: {position: 0.01}"}
    kind: Annotated[InstrumentKind, Registered("instrument kind", instruments)]
    """What is measured."""
    sigma: SigmaFile
    """Standard deviations of the noise."""
    point: Any = None
    """The fixed point that distances are measured from, or `unknown`."""
    at: Label | None = None
    """The joint that an encoder is at, such as `leg1.joint2` (kind joint)."""
    offset: Any = None
    """What an encoder at a joint reads more than is true: unknown, known (nothing), or a number."""
    station: Any = None
    """Where a tracker of `range` and `angle` stood, in the measured axes  [default: origin]."""


class SidecarFile(Strict):
    """The sidecar's keys; without an instrument there is no frame and no target to say of."""

    examples: ClassVar[Mapping[str, str]] = {
        "format": f"format: {FORMAT}",
        "units": "units: {length: mm, angle: deg}",
        "instrument": "instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}",
        "frame": "frame: unknown",
        "target": "target: unknown",
    }

    @model_validator(mode="before")
    @classmethod
    def _assumed(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and data.get("targets") is not None:
            if "target" in data:
                raise refuse(*ONE_OR_SEVERAL)
            data = {**data, "target": "unknown"}
        kind = _kind_named(data)
        if kind is None:
            # what a kind needs is known with the kind: one that there is not is refused first
            return {"frame": "unknown", "target": "unknown", **data} if _kind_given(data) else data
        if kind.along_line and data["instrument"].get("point") is None:
            data = {"frame": "known", **data}      # between two platform positions: it has none
        # an instrument that shows joints alone has neither, whatever is written, nor tilts a target
        last = {"frame": "known"} if kind.inside else {}
        last |= {"target": "known"} if kind.inside or not kind.of_poses else {}
        return {**kind.assumed, **data, **last}

    format: Annotated[str, choice("format", FORMAT)]
    """What this file is."""
    units: UnitsFile
    """Units of every number in this file and in the CSV."""
    instrument: InstrumentFile
    """What measured."""
    frame: Any
    """Pose of the base in the measuring frame: unknown, known (the same), given, or defined."""
    target: Any
    """The measured point in platform axes: unknown, known (the origin) or a point."""
    targets: Annotated[dict[str, Any] | None, BeforeValidator(targets_given)] = None
    """In place of `target`, several points of the platform: name -> unknown, known or a point."""
    name: Label | None = None
    """Name of the data set  [default: the file's]."""
    target_rotation: Any = "known"
    """Rotation vector of the measured body: known (none), unknown or a vector."""
    scale: Any = "known"
    """Measured lengths over true ones: known (1), unknown, a number, or a value with its sigma."""
    approach: Annotated[str, choice("approach", "columns", "sequence", "unknown")] | None = None
    """Directions of approach: dir_ columns, the order of rows, or unknown."""
    homing: Annotated[str, choice("homing", "shared", "per-file")] = "shared"
    """Whether the joints' zeros are those of the machine or of this file."""
    read: ReadFile = ReadFile()
    """How to read the CSV, where it is not as the contract has it."""


def _kind_given(data: Any) -> str:
    """Return what a sidecar's content has for the kind of instrument, empty where it has none."""
    instrument = data.get("instrument") if isinstance(data, Mapping) else None
    name = instrument.get("kind") if isinstance(instrument, Mapping) else None
    return name if isinstance(name, str) else ""


def _kind_named(data: Any) -> InstrumentKind | None:
    """Return the kind of instrument that a sidecar's content names, None where it names none."""
    return instruments().get(_kind_given(data))


def sidecar_path(csv_path: Path) -> Path:
    """Return the path of a CSV's sidecar, ``.yaml`` where there is neither that nor ``.yml``."""
    if not csv_path.name:
        raise BadInput("is a folder, not a file", str(csv_path), "Give the path of a CSV")
    short = csv_path.with_suffix(".yml")
    long = csv_path.with_suffix(".yaml")
    return short if short.is_file() and not long.is_file() else long


def _example(header: Sequence[str]) -> str:
    """Return a sidecar for a table with these columns."""
    instrument, frame = next((OF_NUMBERS[bare_name(c)] for c in header
                              if bare_name(c) in OF_NUMBERS), (OF_POSES, "unknown"))
    return EXAMPLE.format(instrument=instrument, frame=frame)


def read_sidecar(csv_path: Path, header: Sequence[str] = ()) -> tuple[SidecarFile, str]:
    """Return the sidecar of a CSV, and its path for messages.

    ``header``: of the table, for the example where there is none.

    Raises:
        BadInput: there is none (the message shows one to write), or it is wrong.
    """
    path = sidecar_path(csv_path)
    if path.is_file():
        return check(SidecarFile, read_yaml(path), str(path)), str(path)
    raise BadInput(f"the measurement file has no sidecar {path.name} (units, instrument, frame)",
                   str(csv_path), f"Write {path}, for example:\n{_example(header)}with your own "
                   "values")


def sidecar_of(content: Mapping[str, Any], mechanism: Mechanism) -> SidecarFile:
    """Return what a sidecar would hold, given as a mapping.

    Left out, ``units`` are the mechanism file's, ``frame`` and ``target`` unknown, or what the kind
    of instrument assumes.

    Raises:
        BadInput: as :func:`read_sidecar`.
    """
    units = {"length": mechanism.units.length, "angle": mechanism.units.angle}
    kind = _kind_named(content)
    target = {} if content.get("targets") is not None else {"target": "unknown"}
    return check(SidecarFile, {"format": FORMAT, "units": units, "frame": "unknown", **target,
                               **(kind.assumed if kind else {}), **content}, "sidecar")


def sigma_needs(file: SidecarFile, source: str, rotation: bool) -> None:
    """Refuse a sidecar without the standard deviations that its instrument needs."""
    kind, sigma = file.instrument.kind, file.instrument.sigma
    place = f"{source}: instrument.sigma"
    if not kind.of_poses and kind.sigma_of(sigma) is None:
        raise BadInput(f"the key '{kind.sigma}' is missing", place, "Add the standard deviation "
                       f"of a reading, such as `{kind.sigma}: 0.002`")
    if tracked(file.instrument, place):
        of_sight(kind, place)
    elif kind.of_poses and kind.sigma_stated(sigma) is None and not kind.blind:
        raise BadInput("the key 'position' is missing", place,
                       "Add the instrument's standard deviation, such as `position: 0.01`")
    if kind.sees_rotation and rotation and sigma.rotation is None:
        raise BadInput("the key 'rotation' is missing", place,
                       "Add the standard deviation of a measured angle, such as "
                       "`rotation: 0.002`, or write `kind: position`")


def tracked(instrument: Any, place: str) -> bool:
    """Whether noise is that of a distance and two angles; refuse half of it, and both ways at once.

    ``instrument``: the block of a sidecar or scenario; ``place``: its sigma's.
    """
    sigma = instrument.sigma
    given = [name for name in ("range", "angle") if getattr(sigma, name) is not None]
    if len(given) == 1:
        other, = {"range", "angle"} - set(given)
        raise BadInput(f"the key '{other}' is missing", place, f"Add it beside `{given[0]}`, such "
                       "as {range: 0.01, angle: 0.0003}, or write `position` alone")
    if given and sigma.position is not None:
        raise BadInput("the noise of positions is said twice", f"{place}.position",
                       "Take it out, or `range` and `angle`")
    if not given and instrument.station is not None:
        raise BadInput("only noise by `range` and `angle` depends on where a tracker stood",
                       place.replace("sigma", "station"), "Take it out, or add them to `sigma`")
    return bool(given)


def of_sight(kind: InstrumentKind, place: str) -> None:
    """Refuse noise by distance and angles of what does not measure positions by them."""
    if not kind.of_poses or kind.blind or kind.scalar:
        raise BadInput(f"the instrument '{kind}' has no line of sight", f"{place}.range",
                       "Take out `range` and `angle`")


def station_of(instrument: Any, motion: Motion, units: Units, source: str) -> Array:
    """Return where a tracker stood (3,), m."""
    found = point_of(instrument.station or "known", motion, units, source, "instrument.station")
    if found.fitted:
        raise BadInput("a tracker's noise needs to know about where it stood",
                       f"{source}: instrument.station", "Write its position, such as "
                       "[2500, 0, 800]; a tracker's own files have it at the origin")
    return found.value


def offset_of(file: InstrumentFile, units: Units, source: str) -> Unknown:
    """Return what an encoder's readings are more than the true ones (1,): unknown, or given, SI."""
    kind, raw, place = file.kind, file.offset, f"{source}: instrument.offset"
    if kind.placed is None:
        if raw is not None:
            raise BadInput(f"the instrument '{kind}' has no offset", place, "Take it out")
        return NO_OFFSET
    if raw in (None, "unknown", "known"):
        return Unknown(raw != "known", np.zeros(1))
    if not is_number(raw):
        raise neither(raw, place, "a number")
    return Unknown(False, np.array([float(raw)]) * units.factor(kind.quantity))


def located(file: SidecarFile, mechanism: Mechanism, source: str) -> SidecarFile:
    """Return a sidecar whose instrument is at the joint that it names, if it is at one.

    Raises:
        BadInput: as :meth:`InstrumentKind.located`, or an instrument that tells nothing here.
    """
    own = file.instrument
    kind = own.kind.located(own.at, mechanism, source)
    return file.model_copy(update={"instrument": own.model_copy(update={"kind": kind})})


def read_instrument(path: str | os.PathLike[str], mechanism: Mechanism) -> Instrument:
    """Return the instrument that a sidecar describes (contract section 2), SI.

    Raises:
        BadInput: anything wrong in the file, or an instrument that cannot be planned for.
    """
    source = str(path)
    file = located(check(SidecarFile, read_yaml(Path(path)), source), mechanism, source)
    units, kind, sigma = file.units.units(), file.instrument.kind, file.instrument.sigma
    kind.refuse(mechanism.motion, mechanism.surplus, source, mechanism.gravity)
    if tracked(file.instrument, f"{source}: instrument.sigma"):
        raise BadInput("how far a tracker will stand from the poses is not known before",
                       f"{source}: instrument.sigma.range",
                       "Write `position: ` in its place, the noise at a typical distance")
    sigma_needs(file, source, mechanism.motion.turns)
    frame = frame_of(file.frame, mechanism.motion, units, source)
    if frame.same_as is not None:
        raise BadInput("a plan has one instrument, and no other data set to refer to", f"{source}: "
                       "frame.same_as", "Write unknown, known, or the pose")
    if kind.along_line:
        frame = at_point(frame, _fixed_point(file, mechanism, units, source))
    length, angle = units.factor("length"), units.factor("angle")
    own, scalar = kind.sigma_stated(sigma), kind.scalar
    of = units.factor(kind.quantity) if scalar else length
    found = Instrument(
        kind, np.nan if scalar else (sigma.position or np.nan) * length,
        (sigma.rotation or np.nan) * angle if kind.sees_rotation or kind.of_turn else np.nan,
        (own or np.nan) * of if scalar else np.nan,
        actuator_noise(sigma.actuator, mechanism, mechanism.joint_factors(units), source),
        frame, point_of(file.target, mechanism.motion, units, source),
        rotation_of(file.target_rotation, units, source), scale=scale_of(file.scale, kind, source),
        offset=offset_of(file.instrument, units, source))
    for value, quantity in ((found.sigma_position, "length"), (found.sigma_rotation, "angle"),
                            (found.sigma_value, kind.quantity if scalar else "length")):
        refuse_sigma(np.array([value]), quantity, mechanism, units, f"{source}: instrument.sigma")
    return found


def _fixed_point(file: SidecarFile, mechanism: Mechanism, units: Units, source: str) -> Unknown:
    """Return the point that distances are measured from, as far as a plan must know it."""
    raw, place = file.instrument.point, f"{source}: instrument.point"
    if raw in (None, "unknown"):
        raise BadInput("which distances tell most depends on where the fixed point is", place,
                       "Write it as well as you know it, such as `point: [0, 0, 500]`, in the "
                       "base frame, and `frame: unknown` to have it fitted; distances between two "
                       "platform positions, which have none, are not planned")
    return point_of(raw, mechanism.motion, units, source, "instrument.point")
