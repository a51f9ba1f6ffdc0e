"""The export of ropes to one point, in the anchors of a firmware that declares its conventions.

Of its anchors a firmware makes rope lengths for any place, in a frame that the anchors or the
lines' zero define. The machine is driven with these, old and new: how far it then is from what was
asked, in that frame, is the error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ppmcal.controllers.export import (
    Exported,
    NotExpressed,
    Number,
    effect_lacking,
    head,
    misread,
    refuse_poses,
)
from ppmcal.controllers.pose_errors import MM, ErrorSummary, pose_errors
from ppmcal.controllers.pose_grid import at_rest, default_grid, instrument_notes
from ppmcal.controllers.ropes.machine import RopeGeometry, rope_geometry
from ppmcal.controllers.text import read_text
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.limits import TABLE_BYTES
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

EXACT = 1e-9
"""Lengths and ratios that differ by less, m, are alike."""
MOST = 1500
"""Poses of the grid that are tried."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Where a firmware's frame is in the machine's base: its axes (3, 3) as rows, and origin, m."""

    axes: Array
    origin: Array

    def inside(self, points: Array) -> Array:
        """Return points (N, 3) of the base in the firmware's frame."""
        return np.asarray((points - self.origin) @ self.axes.T)


@dataclass(frozen=True)
class RopeFirmware:
    """What a firmware of ropes makes of its anchors.

    Attributes:
        name, title: of the format; file: that is written.
        order: limbs of a machine in the firmware's order; raises BadInput for a machine that it
            does not drive.
        frame: the firmware's frame in a machine, with ropes in its order.
        zero: the rope lengths' part that it computes itself, so that no offset is missing, for
            anchors (k, 3), m; lengths of ropes less that are joint values.
        table: name and value of each number that is written for anchors (k, 3), mm.
        text: the file for anchors, mm, below a comment; read: anchors (k, 3), mm, of such a file.
        decimals: of a number in it.
        shifted: what becomes of a machine identified in another frame, which is at ``{}``.
        advice: how to bring the numbers into the machine, for an old file.
        scaled: what to do where ropes give another length than they count.
    """

    name: str
    title: str
    file: str
    order: Callable[[Mechanism], list[int]]
    frame: Callable[[Mechanism, RopeGeometry], Frame]
    zero: Callable[[Array], Array]
    table: Callable[[Array], Iterable[tuple[str, float]]]
    text: Callable[[Array, str], str]
    read: Callable[[str, str], Array]
    decimals: int
    shifted: str
    advice: Callable[[Path | None], str]
    scaled: str


def export_ropes(firmware: RopeFirmware, mechanism: Mechanism, old: Path | None,
                 poses: Path | None) -> Exported:
    """Return the machine in a firmware's anchors; see :class:`ppmcal.controllers.export.Exporter`.

    Raises:
        BadInput: a machine that it does not drive, or an option without use.
        NoResult: the file reads back as other numbers.
    """
    refuse_poses(firmware.name, poses)
    order = firmware.order(mechanism)
    ropes, nominal = (rope_geometry(m, order) for m in (mechanism, mechanism.nominal()))
    frame, exact = _anchors(firmware, mechanism, ropes)
    new = np.round(exact, firmware.decimals) + 0.0
    present = _present(firmware, mechanism.nominal(), nominal, old)
    if mechanism.motion.planar and not new[:, 2].any():
        present[:, 2] = 0.0     # joint values are lengths in the plane, whatever the file says
    wanted = default_grid(mechanism).poses(mechanism)
    wanted = wanted[:: 1 + len(wanted) // MOST]
    points = frame.inside(wanted[:, :3])

    def errors(anchors: Array, real: Mechanism = mechanism) -> ErrorSummary:
        """Return how far ``real`` is from wanted poses, driven with anchors (k, 3), mm."""
        lengths = np.linalg.norm(points[:, None] - anchors * MM, axis=2)
        # what a firmware counts as a length is one by the nominal ratio
        q = np.empty((len(wanted), len(real.actuators)))
        q[:, [real.limbs[i].actuator for i in order]] = (
            lengths - firmware.zero(anchors * MM)) / nominal.ratio
        reached = reached_poses(Model(real), q, at_rest(real, len(q))).pose
        return pose_errors(real, reached, pose_motor(np.nan_to_num(wanted)))

    before, after = errors(present), errors(new)
    parts = tuple(_parts(firmware, [mechanism.limbs[i].name for i in order],
                         ropes.ratio / nominal.ratio, ropes.offset - firmware.zero(exact * MM)))
    lacks = tuple(_lacks(mechanism, parts, partial(errors, exact)))
    elsewhere = shift_words(frame)
    notes = (*([Note(firmware.shifted.format(elsewhere), NOTE)] if elsewhere else []),
             *instrument_notes(mechanism))
    text = firmware.text(new, head(mechanism.name, before, after, lacks, notes))
    if not np.array_equal(firmware.read(text, firmware.file), new):
        raise misread(firmware.file)
    olds = dict(firmware.table(present))
    return Exported(
        firmware.name, firmware.title, {firmware.file: text},
        f"{firmware.title}'s anchors hold {'most' if lacks else 'all'} of the geometry",
        tuple(Number(name, olds.get(name), value, "mm") for name, value in firmware.table(new)),
        f"{len(wanted)} places of a box about home", before, after, lacks, notes,
        (Note(firmware.advice(old), NOTE),), poses=wanted, again=lambda m: dict(
            firmware.table(_anchors(firmware, m, rope_geometry(m, firmware.order(m)))[1])))


def _anchors(firmware: RopeFirmware, mechanism: Mechanism, ropes: RopeGeometry
             ) -> tuple[Frame, Array]:
    """Return the firmware's frame in a machine, and the anchors (k, 3) in that, mm."""
    frame = firmware.frame(mechanism, ropes)
    return frame, np.asarray(frame.inside(ropes.anchors) / MM)


def _present(firmware: RopeFirmware, mechanism: Mechanism, ropes: RopeGeometry, old: Path | None
             ) -> Array:
    """Return the anchors in use (k, 3), mm: of the old file, else of the nominal machine."""
    if old is None:
        anchors = _anchors(firmware, mechanism, ropes)[1]
        return np.asarray(np.round(anchors, firmware.decimals) + 0.0)
    return firmware.read(read_text(old, limit=TABLE_BYTES), str(old))


def _parts(firmware: RopeFirmware, names: list[str], longer: Array, apart: Array) -> Iterator[str]:
    """Yield what of ropes anchors cannot hold: that they are ``apart`` (k,), m, and ``longer``."""
    if np.ptp(apart) > EXACT or abs(apart[0]) > EXACT:
        yield "ropes are longer than they read by " + ", ".join(
            f"{value / MM:.4g} mm ({name})" for name, value in zip(names, apart, strict=True))
    if np.abs(longer - 1.0).max() > EXACT:
        yield f"{firmware.scaled}: " + ", ".join(
            f"{value:.6g} ({name})" for name, value in zip(names, longer, strict=True))


def _lacks(mechanism: Mechanism, parts: tuple[str, ...], cost: Callable[[Mechanism], ErrorSummary]
           ) -> Iterator[NotExpressed]:
    """Yield what anchors alone cannot hold, with what that costs."""
    if parts:
        bare = replace(mechanism, effects=tuple(e for e in mechanism.effects if e.kind.height))
        slots = tuple(n for n in mechanism.names if n.endswith((".offset", ".ratio")))
        yield NotExpressed("; ".join(parts), slots, cost(bare))
    for effect in mechanism.effects:
        if not effect.kind.instrument and not effect.kind.height:
            yield effect_lacking(mechanism, effect, "")


def shift_words(frame: Frame) -> str:
    """Return where a firmware's frame is in the model's base, empty where it is the same one."""
    turn = float(np.degrees(np.arctan2(frame.axes[0, 1], frame.axes[0, 0])))
    place = ", ".join(f"{v:.4g}" for v in frame.origin / MM)
    if np.abs(frame.origin).max() < EXACT and abs(turn) < 1e-9:
        return ""
    return f"({place}) mm" + (f", turned by {turn:.4g} deg" if abs(turn) >= 1e-9 else "")
