"""M669 of a Hangprinter with RepRapFirmware, and machines of its auto-calibration's samples."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.hangprinter.config import DECIMALS, NAMES, parse_config
from ppmcal.controllers.hangprinter.importer import import_config as import_config
from ppmcal.controllers.ropes.export import Frame, RopeFirmware, export_ropes, shift_words
from ppmcal.controllers.ropes.machine import RopeGeometry, holds_a_point
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note


def order(mechanism: Mechanism) -> list[int]:
    """Return which limb is A, B, C, D and I: by their names, else as the file has them.

    Raises:
        BadInput: no four or five ropes to one point that moves in space.
    """
    limbs = mechanism.limbs
    if not holds_a_point(mechanism, ("x", "y", "z"), 4) or len(limbs) > len(NAMES):
        raise BadInput("a Hangprinter is four or five ropes to one point in space, `motion: "
                       "translational`", mechanism.source,
                       "Begin with `ppmcal import hangprinter FILE`, or `ppmcal init hangprinter`")
    names = [limb.name.upper() for limb in limbs]
    letters = list(NAMES[:len(limbs)])
    return [names.index(n) for n in letters] if set(names) == set(letters) else list(
        range(len(limbs)))


def frame(mechanism: Mechanism, ropes: RopeGeometry) -> Frame:
    """Return the frame whose origin is where all line positions are 0, axes as in the base.

    Raises:
        NoResult: the machine does not get there.
    """
    there = forward(Model(mechanism), np.zeros((1, len(mechanism.actuators))))
    if not finite_rows(there.pose).all():
        raise NoResult("the machine has no pose where all line positions are 0", mechanism.source,
                       "Line positions count from the origin: check the ropes' offsets")
    return Frame(np.eye(3), cga.translation(there.pose)[0])


def zero(anchors: Array) -> Array:
    """Return the line lengths (k,) with the nozzle at the origin, m."""
    return np.asarray(np.linalg.norm(anchors, axis=1))


def line_positions(anchors: Array, points: Array) -> Array:
    """Return line positions (N, k) at points (N, 3), m."""
    return np.asarray(np.linalg.norm(points[:, None] - anchors, axis=2) - zero(anchors))


def table(anchors: Array) -> Iterator[tuple[str, float]]:
    """Yield name and value, mm, of each number for anchors (k, 3), mm."""
    for name, place in zip(NAMES, anchors.tolist(), strict=False):
        for axis, value in zip("xyz", place, strict=True):
            yield f"M669 {name}{axis}", value


def text(anchors: Array, comment: str) -> str:
    """Return the line for ``config.g``."""
    head = "".join(f"; {line}\n" for line in comment.splitlines())
    places = " ".join(name + ":".join(f"{value:.{DECIMALS}f}" for value in place)
                      for name, place in zip(NAMES, anchors.tolist(), strict=False))
    more = "" if len(anchors) == 4 else f"N{len(anchors)} "
    return f"{head}M669 {more}{places}\n"


def read(content: str, source: str) -> Array:
    """Return the anchors (k, 3), mm, of a ``config.g``.

    Raises:
        BadInput: M669 is missing, or an anchor in it.
    """
    return parse_config(content, source).matrix(source)


def notes(found: Frame) -> Iterator[Note]:
    """Yield what becomes of a machine identified in another frame."""
    if words := shift_words(found):
        yield Note(
               "the firmware has its origin where all line positions are 0: in the model's base "
               f"that is at {words}, and places in the model are those of the printer less that",
               NOTE)


def advice(old: Path | None) -> Iterator[Note]:
    """Yield how to bring the numbers into the machine."""
    yield Note(
           f"Put the line of {HANGPRINTER.file} in place of M669's anchors in config.g, keep its "
           "other letters and M666, and home.", NOTE)


HANGPRINTER = RopeFirmware(
    "hangprinter", "Hangprinter", "hangprinter.g", order, frame, line_positions, zero, table, text,
    read, DECIMALS, advice, notes, "multiply each R of M666, as lines are longer than they count")
export = partial(export_ropes, HANGPRINTER)
