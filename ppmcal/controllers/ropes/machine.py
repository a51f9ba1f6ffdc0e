"""A machine on ropes to one point: anchors, what joint values mean, and its files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.importing import MACHINE, machine_head, sidecar
from ppmcal.controllers.text import commented
from ppmcal.io import csv_text
from ppmcal.io.yaml import printable
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.skeleton import skeleton
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

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
