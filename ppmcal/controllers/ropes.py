"""Ropes to one point: anchors, what joint values mean, the machine's files, and the export.

Of its anchors a firmware makes rope lengths for any place, in a frame that the anchors or the
lines' zero define. The machine is driven with these, old and new: how far it then is from what was
asked, in that frame, is the error.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePath

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.export import (
    Exported,
    NotExpressed,
    Number,
    effect_lacking,
    head,
    misread,
    refuse_poses,
)
from ppmcal.controllers.importing import MACHINE, machine_head, sidecar
from ppmcal.controllers.pose_errors import MM, ErrorSummary, pose_errors
from ppmcal.controllers.pose_grid import at_rest, default_grid, instrument_notes
from ppmcal.controllers.text import commented, read_text
from ppmcal.io import csv_text
from ppmcal.io.yaml import printable
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.skeleton import skeleton
from ppmcal.limits import TABLE_BYTES
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

SAME_PLACE = 3.0
"""RopeRun one after the other are of one place if they differ by less on every rope, mm."""


@dataclass(frozen=True, eq=False)
class RopeGeometry:
    """Ropes to one point that does not turn, SI, in the order of the limbs.

    Attributes:
        anchors: base axes, less where each rope holds the platform (k, 3); in the plane z is the
            height that an effect says.
        offset, ratio: rope length = ratio q + offset (k,).
    """

    anchors: Array
    offset: Array
    ratio: Array


def holds_a_point(mechanism: Mechanism, coordinates: tuple[str, ...], least: int) -> bool:
    """Return whether ``least`` or more straight limbs, each driven, hold a point that moves so."""
    limbs = mechanism.limbs
    return (mechanism.motion.coordinates == coordinates and len(limbs) >= least
            and all(limb.kind.strut and not limb.kind.pulley for limb in limbs)
            and len({limb.actuator for limb in limbs}) == len(limbs))


def rope_geometry(mechanism: Mechanism, order: Sequence[int] = ()) -> RopeGeometry:
    """Return the ropes of a machine at its values, in an order of limbs  [default: the file's]."""
    model, home = Model(mechanism), np.atleast_2d(mechanism.home)
    k = len(mechanism.actuators)
    none, one = np.zeros((1, k)), np.ones((1, k))
    limbs = skeleton(model, home, none)
    place = cga.translation(home)[0]
    anchors = np.array([(limb.base_point - limb.platform_point)[0] + place for limb in limbs])
    for effect in (e for e in mechanism.effects if e.kind.height):
        lifted = [effect.on[limb.actuator] for limb in mechanism.limbs]
        anchors[lifted, 2] = mechanism.values[effect.parameters[effect.kind.height]]
    at = [np.array([float(model.joint_coordinate(i, q)[0]) for i in range(len(limbs))])
          for q in (none, one)]
    own = list(order or range(len(limbs)))
    return RopeGeometry(anchors[own], at[0][own], (at[1] - at[0])[own])


@dataclass(frozen=True)
class Rope:
    """A rope, and what of its length is not in the joint value.

    Attributes:
        name: of the rope; anchor: where it begins, mm.
        offset: the slot as the file has it.
        held: coordinates of the anchor that define the frame, and are not open.
    """

    name: str
    anchor: tuple[float, ...]
    offset: str
    held: str = ""

    @property
    def place(self) -> str:
        """The anchor as the file has it."""
        own = dict(zip("xyz", map(_number, self.anchor), strict=False))
        if not self.held:
            return f"[{', '.join(own.values())}]"
        return "{" + ", ".join(
            f"{c}: {{value: {v}, fixed: true}}" if c in self.held else f"{c}: {v}"
            for c, v in own.items()) + "}"


@dataclass(frozen=True)
class RopeMachine:
    """Ropes that hold one point, mm.

    Attributes:
        name: of the machine; comment: the lines at the head of its file.
        motion: ``planar-point`` or ``translational``.
        ropes: in the order of the joints.
        home: where the point is in the middle.
        tolerances: by class of slot.
        limits: of the joint values (k, 2).
        more: further lines of the file.
    """

    name: str
    comment: str
    motion: str
    ropes: tuple[Rope, ...]
    home: tuple[float, ...]
    tolerances: Mapping[str, float]
    limits: Array
    more: str = ""


@dataclass(frozen=True, eq=False)
class RopeRun:
    """One run of joint values (N, k), mm, and where they stand in the controller's file.

    ``places``: measured positions (N, 3), mm, nan where there are none; None for no instrument.
    """

    joints: Array
    where: str
    places: Array | None = None


def _machine_yaml(machine: RopeMachine) -> str:
    """Return the commented mechanism file."""
    axes = "xyz"[:len(machine.home)]
    fixed = ", ".join(f"{c}: {{value: 0, fixed: true}}" for c in axes)
    ropes = "".join(f"""\
  - name: {rope.name}
    kind: rope
    base: {{point: {rope.place}}}
    platform: {{point: {{{fixed}}}}}
    offset: {rope.offset}
""" for rope in machine.ropes)
    home = ", ".join(f"{c}: {_number(v)}" for c, v in zip(axes, machine.home, strict=True))
    tolerances = ", ".join(f"{k}: {_number(v)}" for k, v in machine.tolerances.items())
    limits = ", ".join(f"{rope.name}: [{_number(low)}, {_number(high)}]"
                       for rope, (low, high) in zip(machine.ropes, machine.limits.tolist(),
                                                    strict=True))
    comment = "\n".join(commented(machine.comment))
    head = machine_head(machine.name, machine.motion)
    return f"""\
{comment}
{head}limbs:    # ropes that meet in one point, where platform's x, y, z are 0
{ropes}home: {{pose: {{{home}}}}}
tolerances: {{{tolerances}}}    # one standard deviation each
limits: {{{limits}}}
{machine.more}"""


def _number(value: float) -> str:
    return f"{value:.10g}"


def rope_files(machine: RopeMachine, runs: Sequence[RopeRun], source: str, sigma: float,
               position: float = 0.0) -> dict[str, str]:
    """Return name -> text of the mechanism file, and of a table and a sidecar for each run.

    Args:
        machine: whose joints are read.
        runs: at least one.
        source: the file's name.
        sigma: what joint values repeat to, mm; estimates begin there.
        position: standard deviation of measured places, mm.
    """
    out = {MACHINE: _machine_yaml(machine)}
    for n, run in enumerate(runs, 1):
        name = "measurements" if len(runs) == 1 else f"run_{n:0{len(str(len(runs)))}d}"
        header = ["pose", *(f"q_{rope.name}" for rope in machine.ropes)]
        columns = [places_of(run.joints), *run.joints.T]
        kind, known, rest = "none", dict[str, float](), ""
        if run.places is not None:
            header += "xyz"[:len(machine.home)]
            columns += list(run.places.T[:len(machine.home)])
            kind, known, rest = "position", {"position": position}, "frame: known\ntarget: known\n"
        out[f"{name}.csv"] = csv_text(header, columns)
        # a run by itself has its log's name: several logs may go to one fit
        own = re.sub(r"\W+", "_", PurePath(source).stem).strip("_") if len(runs) == 1 else ""
        out[f"{name}.yaml"] = sidecar(f"# {printable(f'{run.where} of {source}')}", own or name,
                                      kind, {**known, "actuator": sigma}, sigma, rest)
    return out


def places_of(joints: Array) -> Array:
    """Return a number per place (N,): readings one after the other that are alike share it."""
    out = np.zeros(len(joints), dtype=int)
    first = 0
    for n in range(1, len(joints)):
        again = bool(np.all(np.abs(joints[n] - joints[first]) < SAME_PLACE))
        first = first if again else n
        out[n] = out[n - 1] + (not again)
    return out + 1


# ---- the export, in the anchors of a firmware that declares its conventions


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
