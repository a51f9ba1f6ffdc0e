"""A machine in a firmware's numbers: read off where they can hold it, else fitted, at what cost.

What a controller makes of commands is compared with them over a grid of the workspace. A turn
about z and a shift in the plane of the bed are taken out first, of every configuration alike:
they say where a print lies on the bed and change no print.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.delta.firmware import DeltaFirmware, DeltaFit, DeltaNumbers
from ppmcal.controllers.delta.geometry import (
    MM,
    DeltaDrive,
    DeltaGeometry,
    delta_geometry,
    drive_of,
    driven,
    platform_jacobian,
    reached,
    travel,
    triple,
)
from ppmcal.controllers.delta.geometry import axis as tower_axis
from ppmcal.controllers.export import (
    AXIS_OFFSET,
    Exported,
    NotExpressed,
    Number,
    effects_lacking,
    head,
    misread,
    offset_words,
    refuse_poses,
)
from ppmcal.controllers.number_intervals import fitted, following
from ppmcal.controllers.pose_errors import ErrorSummary, PlanarMotion, rms
from ppmcal.errors import NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

EXACT = 1e-9
"""A firmware expresses a machine whose largest error is below this, m."""
NEGLIGIBLE = 1e-7
"""Turns (rad) and shifts (m) below this are rounding, not worth a word."""
STEP = 1e-4
"""Step of the differences by the numbers, mm and deg."""
DISC = 0.8
HEIGHTS = (0.0, 0.025, 0.05, 0.075, 0.1)
ACROSS = 9
ENOUGH = 20


def project(mechanism: Mechanism, firmware: DeltaFirmware[Any, DeltaNumbers],
            old: DeltaNumbers | None = None) -> DeltaFit[DeltaNumbers]:
    """Return the machine in a firmware's numbers; ``old`` defaults to its nominal ones."""
    drive = drive_of(mechanism)
    start = delta_geometry(drive)
    points = grid(drive, start)
    exact = _best(drive, start, points)
    best = exact.rounded()
    new, given = firmware.of(best, old), old

    def named(p: Array) -> Mapping[str, float]:
        return {name: value for name, _, value in firmware.table(firmware.of(_geometry(p), given))}

    if old is None:
        first = drive_of(mechanism.nominal())
        old = firmware.of(_best(first, delta_geometry(first), points), None)
    at_old, at_new = (driven(drive, firmware.travel(n, points)) for n in (old, new))
    both = reached_with_both(at_old, at_new, mechanism.source, firmware.endstops)
    reach, lacks = points[both], tuple(_not_expressed(drive, points, firmware))
    removed = laid_on(reached(drive, best, reach), reach)[1]
    return DeltaFit(new, old, error_summary(at_old[both], reach),
                    error_summary(at_new[both], reach), reach, DISC * start.radius * MM, lacks,
                    tuple(_notes(drive, removed, firmware)),
                    following(lambda m: _errors(drive_of(m), points), mechanism, _numbers(exact),
                              np.full(9, STEP), named))


def grid(drive: DeltaDrive, geometry: DeltaGeometry) -> Array:
    """Return points (N, 3), m, of a disc at five heights that both sides reach, within limits."""
    points = disc(DISC * geometry.radius * MM, ACROSS, HEIGHTS)
    limits = drive.mechanism.limits
    down = travel(geometry, points)
    q = drive.joints(down)
    with np.errstate(invalid="ignore"):
        good = np.all((q >= limits[:, 0]) & (q <= limits[:, 1]) & (down >= 0.0), axis=1)
    points = points[good]
    points = points[np.isfinite(reached(drive, geometry, points)).all(axis=1)]
    if len(points) < ENOUGH:
        raise NoResult("the machine reaches next to nothing between z = 0 and 100 mm within 80 % "
                       "of its radius", drive.mechanism.source,
                       "The bed is z = 0: put the origin there, and check `limits`")
    return np.asarray(points, dtype=float)


def disc(radius: float, across: int, heights: Sequence[float]) -> Array:
    """Return points (N, 3), m, of discs at heights, of squares of so many points across."""
    side = np.linspace(-radius, radius, across)
    x, y, z = (a.ravel() for a in np.meshgrid(side, side, heights, indexing="ij"))
    return np.asarray(np.stack([x, y, z], axis=-1)[np.hypot(x, y) <= radius * (1.0 + 1e-9)])


def reached_with_both(at_old: Array, at_new: Array, source: str, endstops: str) -> Bools:
    """Return which points (N,) a machine reaches with the old numbers and with the new ones.

    Raises:
        NoResult: next to none; ``endstops`` is what the old numbers call these.
    """
    both = finite_rows(at_old) & finite_rows(at_new)
    if both.sum() < ENOUGH:
        raise NoResult("with the old configuration the machine reaches next to nothing of the "
                       "new one's workspace", source,
                       f"Check that --old is this printer's, and its {endstops}")
    return both


def predicted_errors(drive: DeltaDrive, geometry: DeltaGeometry, points: Array) -> ErrorSummary:
    """Return how far the machine, driven with ``geometry``, misses ``points`` (N, 3)."""
    return error_summary(reached(drive, geometry, points), points)


def error_summary(at: Array, points: Array) -> ErrorSummary:
    """Return how far a machine that goes to ``at`` (N, 3) misses ``points`` (N, 3)."""
    error, removed = laid_on(at, points)
    size = np.linalg.norm(error, axis=1)
    return ErrorSummary(rms(size), float(np.max(size)), count=len(size), removed=removed)


def laid_on(at: Array, wanted: Array) -> tuple[Array, PlanarMotion]:
    """Align ``at`` with ``wanted``, (N, 3) each, by a turn about z and a shift along x and y.

    With a and w the points as complex numbers about their means, the turn of least squares is
    the argument of sum(conj(a) w). Returns what is left (N, 3), and the motion.
    """
    a, w = at[:, 0] + 1j * at[:, 1], wanted[:, 0] + 1j * wanted[:, 1]
    turn = float(np.angle(np.vdot(a - a.mean(), w - w.mean())))
    shift = complex(w.mean() - np.exp(1j * turn) * a.mean())
    left = np.exp(1j * turn) * a + shift - w
    return (np.stack([left.real, left.imag, at[:, 2] - wanted[:, 2]], axis=-1),
            PlanarMotion(turn, (shift.real, shift.imag)))


def _best(drive: DeltaDrive, start: DeltaGeometry, points: Array) -> DeltaGeometry:
    """Return the geometry with the smallest squared errors at ``points``; c stays at 90 deg."""
    if predicted_errors(drive, start, points).max < EXACT:
        return start

    def slopes(p: Array) -> Array:
        at, here = reached(drive, _geometry(p), points), travel(_geometry(p), points)
        moves = platform_jacobian(drive, _geometry(p), points)
        columns = []
        for step in np.diag(np.full(len(p), STEP)):
            ends = []
            for side in (step, -step):
                q = drive.joints(travel(_geometry(p + side), points)) - drive.joints(here)
                ends.append(laid_on(at + (moves @ q[..., None])[..., 0], points)[0].ravel() / MM)
            columns.append((ends[0] - ends[1]) / (2.0 * STEP))
        return np.nan_to_num(np.stack(columns, axis=-1))

    return _geometry(fitted(_errors(drive, points), _numbers(start), "the numbers for the firmware",
                            60, slopes, np.array([1.0, 0.3, 0.3, *[1.0] * 6])))


def _geometry(p: Array) -> DeltaGeometry:
    """Return the geometry of the numbers (9,) that are fitted, mm and degrees."""
    return DeltaGeometry(float(p[0]), (float(p[1]), float(p[2]), 90.0), triple(p[3:6]),
                         triple(p[6:9]))


def _numbers(geometry: DeltaGeometry) -> Array:
    """Return the numbers (9,) that are fitted."""
    return np.array([geometry.radius, *geometry.angles[:2], *geometry.arms, *geometry.endstops])


def _errors(drive: DeltaDrive, points: Array) -> Callable[[Array], Array]:
    """Return what makes errors at points (N, 3), mm (3N,), of the numbers (9,)."""
    def errors(p: Array) -> Array:
        error = laid_on(reached(drive, _geometry(p), points), points)[0] / MM
        return np.asarray(np.where(np.isfinite(error), error, 1e3).ravel(), dtype=float)

    return errors


def _groups(
    drive: DeltaDrive, firmware: DeltaFirmware[Any, Any]
) -> Iterator[tuple[int, str, str, tuple[int, ...]]]:
    """Yield limb, group, words and parameters of what the firmware has no number for."""
    mechanism = drive.mechanism
    g, nominal = mechanism.values, mechanism.nominals
    seen: set[int] = set()
    for i in sorted(drive.towers):
        limb = mechanism.limbs[i]
        groups: dict[str, list[int]] = {}
        for slot, p in limb.slots.direct:
            name = _group(slot, drive)
            if name:
                groups.setdefault(name, []).append(p)
        way = tower_axis(mechanism, i)
        lean = float(np.degrees(np.hypot(way[0], way[1])))
        for name, used in groups.items():
            if name == "base.direction" and lean > 1e-9:
                yield (i, name, f"tower {_tower_name(drive, i)} leans by {lean:.4g} deg",
                       tuple(used))
            elif name == "ratio" and g[used[0]] != nominal[used[0]] and used[0] not in seen:
                seen.add(used[0])
                yield (i, name, f"drive {limb.name} travels {g[used[0]] / nominal[used[0]]:.6f} "
                       f"times what it should: {firmware.scale}", tuple(used))
            elif name.startswith("joint") and np.any(g[used]):
                yield i, name, f"frame error of {limb.name}.{name}", tuple(used)
            elif name.endswith(AXIS_OFFSET) and g[used[0]]:
                yield i, name, offset_words(limb.name, float(g[used[0]])), tuple(used)


def _tower_name(drive: DeltaDrive, limb: int) -> str:
    """Return what the machine calls the tower of a limb."""
    own = drive.mechanism.limbs[limb]
    return drive.mechanism.actuators[own.actuator] if drive.tilts else own.name


def _group(slot: str, drive: DeltaDrive) -> str:
    """Return the group of a slot that firmwares have no number for, else nothing.

    Of six rods frames of joints may say where these are.
    """
    if slot.startswith("base.direction.") or (slot.startswith("joint") and not drive.tilts):
        return slot.rpartition(".")[0]
    return slot if slot == "ratio" or slot.endswith(AXIS_OFFSET) else ""


def _not_expressed(drive: DeltaDrive, points: Array, firmware: DeltaFirmware[Any, Any]
                   ) -> Iterator[NotExpressed]:
    """Yield what the firmware has no number for, each with the cost of that alone."""
    mechanism = drive.mechanism
    for i, name, words, used in _groups(drive, firmware):
        yield NotExpressed(words, tuple(mechanism.names[p] for p in used),
                           _cost(drive_of(_only(drive, i, name, used)), points))
    if drive.tilts:
        level = drive_of(_only(drive, -1, "", ()))
        turn = cga.rotation_vector(forward(Model(mechanism), drive.joints(
            travel(delta_geometry(drive), points))).pose)
        most = float(np.degrees(np.nanmax(np.hypot(turn[:, 0], turn[:, 1]))))
        names = {mechanism.names[p] for limb in mechanism.limbs for slot, p in limb.slots.direct
                 if slot.startswith("platform.point.") and not mechanism.parameters[p].fixed}
        yield NotExpressed(f"the effector tilts, by up to {most:.2g} deg: two rods of a tower are "
                           "not parallel", tuple(sorted(names)), _cost(level, points))
    yield from effects_lacking(mechanism, instruments=True)


def _cost(alone: DeltaDrive, points: Array) -> ErrorSummary | None:
    """Return what such a machine misses points by with the best numbers; None: reaches few."""
    start = delta_geometry(alone)
    fits = points[np.isfinite(reached(alone, start, points)).all(axis=1)]
    return None if len(fits) < ENOUGH else predicted_errors(alone, _best(alone, start, fits), fits)


def _only(drive: DeltaDrive, limb: int, name: str, used: tuple[int, ...]) -> Mechanism:
    """Return the machine with this one group and the others of the kind as firmwares have them."""
    mechanism = drive.mechanism
    g = mechanism.values.copy()
    limbs = list(mechanism.limbs)
    for i, own in enumerate(mechanism.limbs):
        for slot, p in own.slots.direct:
            if _group(slot, drive) and p not in used:
                g[p] = mechanism.nominals[p] if slot == "ratio" else 0.0
        tower = limb >= 0 and own.actuator == mechanism.limbs[limb].actuator
        if not (tower and name == "base.direction"):
            up = np.array([0.0, 0.0, np.sign(tower_axis(mechanism, i)[2])])
            limbs[i] = replace(own, constants={**own.constants, "base.direction": up})
    return replace(mechanism.with_values(g), limbs=tuple(limbs), effects=())


def _notes(drive: DeltaDrive, removed: PlanarMotion, firmware: DeltaFirmware[Any, Any]
           ) -> Iterator[Note]:
    """Yield what a user should know of how the machine became the firmware's."""
    mechanism = drive.mechanism
    limbs = [mechanism.limbs[i] for i in drive.towers]
    names = [_tower_name(drive, i) for i in drive.towers]
    pairs = list(zip(names, firmware.towers, strict=True))
    if not all(tower.endswith(name) for name, tower in pairs):
        yield Note("towers: " + ", ".join(f"{name} is {tower}" for name, tower in pairs), NOTE)
    if abs(removed.turn) > NEGLIGIBLE:
        yield Note(f"the machine is turned by {np.degrees(removed.turn):.4g} deg about z, so that "
                   f"tower {names[2]} stands at 90 deg; prints turn with it", NOTE)
    if np.hypot(*removed.shift) > NEGLIGIBLE:
        yield Note(
            f"the model's x = y = 0 becomes {removed.shift[0] / MM:.4g}, "
            f"{removed.shift[1] / MM:.4g} mm: {firmware.title} counts from the middle of the "
            f"towers, and so has one {firmware.radius} for them", NOTE)
    values = [limb.slots.values(mechanism.values) for limb in limbs]
    if any(v.get(f"platform.point.{c}", 0.0) for v in values for c in "xy"):
        yield Note(f"the effector's radius is taken off {firmware.radius}: only the difference "
                   "shows", NOTE)
    if any(v.get(f"{part}.point.z", 0.0) for v in values for part in ("base", "platform")):
        yield Note(f"heights of joints went into {firmware.endstops}", NOTE)


def export_delta(firmware: DeltaFirmware[Any, Any], mechanism: Mechanism, old: Path | None,
                 poses: Path | None) -> Exported:
    """Return the machine in a firmware's numbers; see :class:`ppmcal.controllers.export.Exporter`.

    Raises:
        BadInput: no linear delta, or an option without use.
        NoResult: the lines would not be read as meant, or the firmware would not take them.
    """
    refuse_poses(firmware.name, poses)
    config = None if old is None else firmware.read(old)
    found = project(mechanism, firmware, None if config is None else firmware.numbers(config))
    notes = (*found.notes, *firmware.notes(found))
    text = firmware.text(found.new, head(mechanism.name, found.before, found.after,
                                         found.not_expressed, notes, firmware.how(found.new)))
    if firmware.numbers(firmware.parse(text, firmware.file)) != found.new:
        raise misread(firmware.file)
    firmware.check(found.new, mechanism.source)
    before = {(name, unit): value for name, unit, value in firmware.table(found.old)}
    return Exported(
        firmware.name, firmware.title, {firmware.file: text},
        f"{firmware.title}'s numbers hold "
        + (firmware.fitted if found.not_expressed else "all of the geometry"),
        tuple(Number(name, before.get((name, unit)), value, unit)
              for name, unit, value in firmware.table(found.new)),
        f"{len(found.points)} points, {found.radius * 1e3:.0f} mm around the middle, z 0 to 100 "
        "mm; offset and rotation on the bed ignored",
        found.before, found.after, found.not_expressed, notes,
        tuple(firmware.advice(found, old, config)),
        {"grid": {"points": len(found.points), "radius": found.radius / MM,
                  "part_of_radius": DISC, "z": [z / MM for z in HEIGHTS]}},
        np.pad(found.points, ((0, 0), (0, 3)),
               constant_values=np.nan if mechanism.motion.turns else 0.0), again=found.again)
