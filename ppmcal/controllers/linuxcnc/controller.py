"""``export linuxcnc``: HAL pins of genhexkins for a hexapod, and notes for its INI file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.export import (
    AXIS_OFFSET,
    Exported,
    NotExpressed,
    Number,
    effects_lacking,
    head,
    misread,
    offset_words,
)
from ppmcal.controllers.linuxcnc.fit import (
    EXACT,
    GenhexkinsSetting,
    LinuxcncDrive,
    best,
    commands,
    drive_of,
    errors_by,
    genhexkins_setting,
    grid,
    joints,
    numbers,
    points,
    predicted_errors,
    reached,
    rounded,
    within,
)
from ppmcal.controllers.linuxcnc.hal import (
    STRUTS,
    HexapodGeometry,
    Joint,
    format_hal,
    format_joints,
    parse_hal,
    parse_joints,
    pins,
    read_geometry,
    read_hal,
)
from ppmcal.controllers.linuxcnc.pentakins import export_pentapod, is_pentapod
from ppmcal.controllers.number_intervals import following
from ppmcal.controllers.pose_errors import next_to_none
from ppmcal.errors import BadInput
from ppmcal.io import read_poses
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.units import LENGTHS

HAL, JOINTS = "genhexkins.hal", "joints.ini"
WORD = {"mm": "mm", "in": "inch"}
"""Units of points as LinuxCNC calls them."""
ENOUGH = 20
STEP = 1e-7
"""Step of differences by the numbers, m and 1."""
APART = 1.6
"""Points that spread by more than this, or its inverse, of what they should are not these."""
OTHER = 0.2
"""A strut whose points are nearer to another limb's than this part of the way is that one."""


@dataclass(frozen=True, eq=False)
class Over:
    """The poses over which errors are predicted, motors (N, 8), and what to say of them."""

    pose: Array
    words: str
    notes: tuple[Note, ...] = ()


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return the machine in genhexkins' numbers, or pentakins'; see :class:`export.Exporter`."""
    if is_pentapod(mechanism):
        return export_pentapod(mechanism, old, poses)
    present = None if old is None else read_geometry(read_hal(old))
    unit = _unit(mechanism, present, old)
    drive = drive_of(mechanism, LENGTHS[unit])
    around, far, turn = grid(drive)
    if len(around) < ENOUGH:
        raise next_to_none(mechanism)
    exact = best(drive, genhexkins_setting(drive, present), around)
    new = rounded(exact)
    old_pins = genhexkins_setting(drive_of(mechanism.nominal(), drive.unit)).geometry
    before = GenhexkinsSetting(
        old_pins if present is None else present, np.ones(STRUTS), np.zeros(STRUTS)
    )
    over = Over(around, f"{len(around)} poses within the limits, up to {far * 1e3:.0f} mm along "
                f"each axis and {np.degrees(turn):.0f} deg from home") if poses is None else (
        _given(mechanism, poses))
    over = _taken(drive, (before, new), over, old)
    was, after = (predicted_errors(drive, setting, over.pose) for setting in (before, new))
    ini = tuple(joint.rounded() for joint in joints(drive, new))
    lacks = tuple(_not_expressed(mechanism, drive, around))
    notes = (*over.notes, *_notes(drive, new, unit, poses is not None and _lateral(drive) != []))
    return Exported(
        "linuxcnc", "LinuxCNC", _files(
            drive, new.geometry, ini, unit, head(mechanism.name, was, after, lacks, notes)),
        f"genhexkins' numbers hold {'most of it, fitted' if lacks else 'all of the geometry'}",
        tuple(_numbers(before.geometry, new.geometry, ini, unit)), over.words, was,
        after, lacks, notes, tuple(_advice(ini, unit)),
        {"length_unit": unit, "poses": len(over.pose)}, pose_vector(over.pose),
        again=following(
            lambda m: errors_by(drive_of(m, drive.unit), around), mechanism,
            numbers(exact, drive.unit), np.full(48, STEP),
            lambda p: _named(exact.geometry, p, drive.unit)))


def _unit(mechanism: Mechanism, present: HexapodGeometry | None, old: Path | None) -> str:
    """Return ``mm`` or ``in``: in which unit the present points are as large as nominal.

    Without present points, the inch if the mechanism file is in inches.

    Raises:
        BadInput: they are another machine's, or numbered otherwise.
    """
    if present is None:
        return "in" if mechanism.units.length == "in" else "mm"
    nominal = drive_of(mechanism.nominal(), 1.0).legs
    size = _extent(nominal.base) + _extent(nominal.platform)
    held = _extent(np.array(present.base)) + _extent(np.array(present.platform))
    for unit in ("mm", "in"):
        if size / APART < held * LENGTHS[unit] < size * APART:
            there = np.hstack([present.base, present.platform]) * LENGTHS[unit]
            here = np.hstack([nominal.base, nominal.platform])
            _same_order(mechanism, np.linalg.norm(there[:, None] - here, axis=-1), old)
            return unit
    raise BadInput(f"its points are spread by {held:.4g}, nominal ones by {size * 1e3:.4g} mm",
                   str(old), "Give the HAL file of this machine, in mm or inch")


def _same_order(mechanism: Mechanism, away: Array, old: Path | None) -> None:
    """Refuse struts that stand at another limb's place; ``away`` (strut 6, limb 6), m."""
    nearest = np.argmin(away, axis=1)
    for n in np.flatnonzero(away[range(STRUTS), nearest] < OTHER * np.diag(away)):
        raise BadInput(f"strut {n} stands where {mechanism.limbs[nearest[n]].name} is drawn, not "
                       f"{mechanism.limbs[n].name}", str(old),
                       "Order the limbs of MODEL as the file numbers its struts")


def _extent(values: Array) -> float:
    """Return the root mean square distance of points (6, 3) from their middle."""
    return float(np.sqrt(np.mean(np.sum((values - values.mean(axis=0)) ** 2, axis=1))))


def _given(mechanism: Mechanism, path: Path) -> Over:
    """Return the poses of a CSV that the machine takes within its limits."""
    wanted = read_poses(path, mechanism).poses
    open_ = np.flatnonzero(~finite_rows(wanted))
    if open_.size:
        raise BadInput("the pose has an empty coordinate", f"{path}: row {open_[0] + 1}",
                       f"A pose of this machine is {', '.join(mechanism.coordinates)}")
    pose = pose_motor(wanted)
    good = within(mechanism, pose)
    if not good.any():
        raise BadInput("the machine takes none of these poses within its limits", str(path),
                       "Give platform poses in the base frame, in the units of MODEL")
    lost = len(pose) - int(good.sum())
    return Over(pose[good], f"the {int(good.sum())} poses of {path}", () if not lost else (
        Note(f"{lost} of the {len(pose)} poses are out of reach or limits and left aside", NOTE),))


def _taken(
    drive: LinuxcncDrive,
    settings: tuple[GenhexkinsSetting, GenhexkinsSetting],
    over: Over,
    old: Path | None,
) -> Over:
    """Return the poses that the machine takes with both settings."""
    good = np.logical_and(
        *(finite_rows(reached(drive, setting, over.pose)) for setting in settings)
    )
    if np.mean(good) < 0.5:
        raise BadInput("with these points the machine does not get to most of the poses",
                       str(old or drive.mechanism.source),
                       "Check that they are this machine's, and its struts numbered as in MODEL")
    lost = int(np.sum(~good))
    return replace(over, pose=over.pose[good], notes=(*over.notes, *(
        [Note(f"{lost} poses that it does not get to with the old points are left aside", NOTE)]
        if lost else [])))


def _files(
    drive: LinuxcncDrive, geometry: HexapodGeometry, ini: tuple[Joint, ...], unit: str, comment: str
) -> dict[str, str]:
    """Return the two files, read back and found equal.

    Raises:
        NoResult: they do not read back as what they were written from.
    """
    names = [limb.name for limb in drive.mechanism.limbs]
    pose = commands(drive.mechanism.home[None], drive.unit)[0]
    texts = {
        HAL: format_hal(geometry, names, f"{comment}\nPins of LinuxCNC's genhexkins; lengths in "
                        f"{WORD[unit]}, as [TRAJ]LINEAR_UNITS must be."),
        JOINTS: format_joints(ini, names, "\n".join([
            f"What {HAL} needs of the machine's INI file; lengths in {WORD[unit]}.",
            "'present' is what stands there while the measurements were made: change it once.",
            "HOME is the joint position at the model's home pose; both have to match. That is",
            f"[TRAJ]HOME = {' '.join(f'{v + 0.0:.6f}' for v in np.round(pose, 6))}"]))}
    if (read_geometry(parse_hal(texts[HAL], HAL)) != geometry
            or parse_joints(texts[JOINTS], JOINTS) != ini):
        raise misread(f"{HAL}, {JOINTS}")
    return texts


def _numbers(
    old: HexapodGeometry, new: HexapodGeometry, ini: tuple[Joint, ...], unit: str
) -> Iterator[Number]:
    """Yield the 36 coordinates, and per joint the changes of the INI file."""
    present = pins(old)
    for pin, value in pins(new).items():
        yield Number(pin, present[pin], value, unit)
    for n, joint in enumerate(ini):
        yield Number(f"[JOINT_{n}] stretch", 1.0, joint.stretch, "")
        yield Number(f"[JOINT_{n}] shift", 0.0, joint.shift, unit)


def _named(pins_of: HexapodGeometry, p: Array, unit: float) -> Mapping[str, float]:
    """Return the numbers (48,) that are fitted as :func:`_numbers` calls them."""
    base, platform = (p[i:i + 18].reshape(6, 3) / unit for i in (0, 18))
    geometry = replace(pins_of, base=points(base), platform=points(platform))
    ini = tuple(Joint(0.0, f, d) for d, f in zip(p[36:42] / unit, p[42:], strict=True))
    return {n.name: n.new for n in _numbers(geometry, geometry, ini, "")}


def _lateral(drive: LinuxcncDrive) -> list[int]:
    """Return the struts whose joints stand so far beside the driven line that lengths show it."""
    legs = drive.legs
    strut = cga.move_point(drive.mechanism.home, legs.platform) - legs.base
    shown = legs.beside**2 / (2.0 * np.linalg.norm(strut, axis=1))
    return [int(n) for n in np.flatnonzero(shown > EXACT)]


def _not_expressed(mechanism: Mechanism, drive: LinuxcncDrive, around: Array
                   ) -> Iterator[NotExpressed]:
    """Yield what genhexkins has no number for, each with the cost of that alone."""
    def lacking(words: str, used: list[int]) -> NotExpressed:
        alone = drive_of(_only(mechanism, used), drive.unit)
        pose = around[within(alone.mechanism, around)]
        cost = None if len(pose) < ENOUGH else predicted_errors(
            alone, best(alone, genhexkins_setting(alone), pose), pose)
        return NotExpressed(words, tuple(mechanism.names[p] for p in used), cost)

    for strut in _lateral(drive):
        limb = mechanism.limbs[strut]
        yield lacking(f"joints 2 and 3 of {limb.name} stand "
                      f"{drive.legs.beside[strut] * 1e3:.4g} mm beside the driven line",
                      [p for slot, p in limb.slots.direct
                       if slot.startswith(("joint2.", "joint3.")) and mechanism.values[p]])
    for limb in mechanism.limbs:
        for slot, p in limb.slots.direct:
            if slot.endswith(AXIS_OFFSET) and mechanism.values[p]:
                yield lacking(offset_words(limb.name, float(mechanism.values[p])), [p])
    yield from effects_lacking(mechanism, instruments=True)


def _only(mechanism: Mechanism, used: list[int]) -> Mechanism:
    """Return the machine with joints right but for ``used``, without effects.

    Right: nothing in the frames of joints 2 and 3, and universal joints whose axes meet.
    """
    g = mechanism.values.copy()
    for limb in mechanism.limbs:
        for slot, p in limb.slots.direct:
            apart = slot.startswith(("joint2.", "joint3.")) or slot.endswith(AXIS_OFFSET)
            if apart and p not in used:
                g[p] = 0.0
    return replace(mechanism.with_values(g), effects=())


def _notes(
    drive: LinuxcncDrive, new: GenhexkinsSetting, unit: str, fitted_elsewhere: bool
) -> Iterator[Note]:
    """Yield what a user should know of how the machine became genhexkins'."""
    mechanism, legs, geometry = drive.mechanism, drive.legs, new.geometry
    yield Note(
        f"limbs {mechanism.limbs[0].name} to {mechanism.limbs[-1].name} are struts and joints "
        f"0 to 5; lengths are in {WORD[unit]}", NOTE)
    shifted = [limb.name for limb in mechanism.limbs if any(
        limb.slots.values(mechanism.values).get(f"joint1.{c}", 0.0) for c in "xyz")]
    if shifted:
        yield Note(f"shifts of joint 1 went into the base points of {', '.join(shifted)}", NOTE)
    if np.any(legs.along):
        yield Note("shifts of joints 2 and 3 along the driven lines went into HOME_OFFSET", NOTE)
    if geometry.screw_lead:
        yield Note(
            f"screw-lead {geometry.screw_lead:g} and the joints' axes stay as they are: the "
            "model knows nothing of nuts that turn with the joints, so its joint values have "
            "to be strut lengths, without genhexkins.correction", NOTE)
    if geometry.spindle_offset or geometry.tool_offset:
        yield Note("spindle-offset and tool-offset stay as they are; the figures are those of the "
                   "platform's own origin", NOTE)
    if fitted_elsewhere:
        yield Note("the numbers were fitted over poses around home, not over the given ones", NOTE)


def _advice(ini: tuple[Joint, ...], unit: str) -> Iterator[Note]:
    """Yield how to bring the numbers into the controller."""
    yield Note(f"Load {HAL} by HALFILE in place of the lines that set these pins now; "
               f"[TRAJ]LINEAR_UNITS must be {WORD[unit]}.", NOTE)
    changed = [str(n) for n, j in enumerate(ini) if (j.stretch, j.shift) != (1.0, 0.0)]
    if changed:
        yield Note(
            f"Change the INI file's sections of joints {', '.join(changed)} as {JOINTS} says, "
            "once: the points are right only together with that.", NOTE)
