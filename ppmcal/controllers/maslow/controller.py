"""Anchors of a Maslow 4 as its ``maslow.yaml`` has them, and machines of its logs."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ppmcal.controllers.export import Exported
from ppmcal.controllers.maslow.importer import import_config as import_config
from ppmcal.controllers.maslow.reading import BELTS, anchors_of, goes_round, keys_of
from ppmcal.controllers.pose_errors import MM
from ppmcal.controllers.ropes.export import (
    Frame,
    RopeFirmware,
    export_ropes,
    horizontal,
    shift_words,
)
from ppmcal.controllers.ropes.machine import RopeGeometry, holds_a_point, rope_geometry
from ppmcal.controllers.text import read_text
from ppmcal.errors import BadInput, NoResult
from ppmcal.limits import TABLE_BYTES
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

COPY = "maslow.yaml"
DECIMALS = 3
WRITTEN = ("tl", "tr", "bl", "br")
"""In which order the firmware's file has the anchors."""


def order(mechanism: Mechanism) -> list[int]:
    """Return which limb is bl, br, tr and tl: by their names, else by where anchors are.

    Raises:
        BadInput: no four ropes to one point, or anchors that are no frame of the Maslow's.
    """
    if not holds_a_point(mechanism, ("x", "y"), 4) or len(mechanism.limbs) != 4:
        raise BadInput("a Maslow is four ropes to one point in the plane, `motion: planar-point`",
                       mechanism.source, "Begin with `ppmcal import maslow LOG`, or `ppmcal init "
                       "maslow`")
    anchors = rope_geometry(mechanism).anchors
    names = [limb.name.lower() for limb in mechanism.limbs]
    if set(names) == set(BELTS):
        found = [names.index(belt) for belt in BELTS]
    else:
        away = anchors - anchors.mean(axis=0)
        found = [int(i) for i in np.argsort(np.arctan2(away[:, 1], away[:, 0]))]
    if not goes_round(anchors[found] / MM):
        raise BadInput("the anchors bl, br, tr and tl do not go round counter-clockwise: they are "
                       "in one line, or the frame is mirrored", mechanism.source,
                       "Check which belt is which, and that x goes right and y up")
    return found


def frame(mechanism: Mechanism, ropes: RopeGeometry) -> Frame:
    """Return the Maslow's frame: origin at the bottom left anchor, x through the bottom right."""
    first, second = ropes.anchors[:2]
    return Frame(horizontal(second - first), first)


def lengths(anchors: Array, points: Array) -> Array:
    """Return what belts (N, 4) are at points (N, 3), m."""
    return np.asarray(np.linalg.norm(points[:, None] - anchors, axis=2))


def table(anchors: Array) -> Iterator[tuple[str, float]]:
    """Yield the keys and their values, mm, for anchors (4, 3), mm."""
    at = dict(zip(BELTS, anchors.tolist(), strict=True))
    for belt in WRITTEN:
        for axis, value in zip("XY", at[belt], strict=False):
            yield f"Maslow_{belt}{axis}", value


def text(anchors: Array, comment: str) -> str:
    """Return the lines for ``maslow.yaml``."""
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + "".join(f"{name}: {value:.{DECIMALS}f}\n" for name, value in table(anchors))


def read(content: str, source: str) -> Array:
    """Return the anchors (4, 3), mm, of a ``maslow.yaml``.

    Raises:
        BadInput: one is missing.
    """
    return np.pad(anchors_of(keys_of(content, source)), ((0, 0), (0, 1)))


def notes(found: Frame) -> Iterator[Note]:
    """Yield what becomes of a machine identified in another frame."""
    if words := shift_words(found):
        yield Note(
               "the Maslow has its origin at the bottom left anchor and its x axis through the "
               f"bottom right one: in the model's base that is at {words}, and places in the model "
               "are those of the router less that", NOTE)


def advice(old: Path | None) -> Iterator[Note]:
    """Yield how to bring the numbers into the machine."""
    yield Note(
           f"Put the lines of {MASLOW.file} in place of those of the machine's maslow.yaml, or "
           "send each as $/Maslow_tlX=VALUE, and restart."
           + ("" if old is None else f" --write makes a copy of {old} with them."), NOTE)


MASLOW = RopeFirmware(
    "maslow", "Maslow", "anchors.yaml", order, frame, lengths,
    lambda anchors: np.zeros(len(anchors)), table, text, read, DECIMALS, advice, notes,
    "belts give other lengths than they count, by a factor of")
export = partial(export_ropes, MASLOW)


def patch(exported: Exported, old: Path) -> Exported:
    """Return the export with a copy of the ``maslow.yaml`` that holds the new numbers.

    Raises:
        BadInput, NoResult: there is no such copy.
    """
    content = read_text(old, limit=TABLE_BYTES)
    for number in exported.numbers:
        line = re.compile(rf"^(\s*{number.name}\s*:[ \t]*)[^\s#]+", re.IGNORECASE | re.MULTILINE)
        content, count = line.subn(rf"\g<1>{number.new:.{DECIMALS}f}", content)
        if not count:
            content = content.rstrip("\n") + f"\n{number.name}: {number.new:.{DECIMALS}f}\n"
    if not np.array_equal(read(content, COPY), read(exported.files[MASLOW.file], MASLOW.file)):
        raise NoResult("the copy reads back as other numbers", str(old),
                       f"Put the lines of {MASLOW.file} there by hand")
    told = Note(f"The {COPY} written is a copy of {old} with the new numbers. Keep the old one, "
                "put the copy in its place, and restart.", NOTE)
    return replace(exported, files={**exported.files, COPY: content}, advice=(told,))
