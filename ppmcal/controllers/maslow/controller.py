"""Anchors of a Maslow 4 as its ``maslow.yaml`` has them, and machines of its logs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from ppmcal.controllers.export import Exported
from ppmcal.controllers.importing import Imported
from ppmcal.controllers.maslow.reading import (
    BELTS,
    LONGEST,
    NEEDED,
    anchors_of,
    goes_round,
    heights_of,
    keys_of,
    read_keys,
    read_log,
)
from ppmcal.controllers.pose_errors import MM
from ppmcal.controllers.ropes import (
    Frame,
    Rope,
    RopeFirmware,
    RopeGeometry,
    RopeMachine,
    export_ropes,
    holds_a_point,
    rope_files,
    rope_geometry,
)
from ppmcal.controllers.text import commented, read_text
from ppmcal.errors import BadInput, NoResult
from ppmcal.limits import TABLE_BYTES
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import PLANAR_POINT
from ppmcal.notes import NOTE, Note
from ppmcal.wording import pluralize

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


def horizontal(x_axis: Array) -> Array:
    """Return the axes (3, 3), as rows, of a frame whose x axis is along a vector in the plane."""
    along = x_axis / np.linalg.norm(x_axis)
    up = np.array([0.0, 0.0, 1.0])
    return np.array([along, np.cross(up, along), up])


def frame(mechanism: Mechanism, ropes: RopeGeometry) -> Frame:
    """Return the Maslow's frame: origin at the bottom left anchor, x through the bottom right."""
    first, second = ropes.anchors[:2] * [1.0, 1.0, 0.0]
    return Frame(horizontal(second - first), first)


def table(anchors: Array) -> Iterator[tuple[str, float]]:
    """Yield the keys and their values, mm, for anchors (4, 3), mm."""
    at = dict(zip(BELTS, anchors.tolist(), strict=True))
    axes = "XYZ" if anchors[:, 2].any() else "XY"
    for belt in WRITTEN:
        for axis, value in zip(axes, at[belt], strict=False):
            yield f"Maslow_{belt}{axis}", value


def text(anchors: Array, comment: str) -> str:
    """Return the lines for ``maslow.yaml``."""
    return "\n".join([*commented(comment), *(
        f"{name}: {value:.{DECIMALS}f}" for name, value in table(anchors))]) + "\n"


def read(content: str, source: str) -> Array:
    """Return the anchors (4, 3), mm, of a ``maslow.yaml``.

    Raises:
        BadInput: one is missing.
    """
    keys = keys_of(content, source)
    return np.column_stack([anchors_of(keys), heights_of(keys)])


MASLOW = RopeFirmware(
    "maslow", "Maslow", "anchors.yaml", order, frame, lambda anchors: np.zeros(len(anchors)),
    table, text, read, DECIMALS,
    shifted="the Maslow has its origin at the bottom left anchor and its x axis through the bottom "
    "right one: in the model's base that is at {}, and places in the model are those of the "
    "router less that",
    advice=lambda old: "Put the lines of anchors.yaml in place of those of the machine's "
    "maslow.yaml, or send each as $/Maslow_tlX=VALUE, and restart."
    + ("" if old is None else f" --write makes a copy of {old} with them."),
    scaled="belts give other lengths than they count, by a factor of")
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
    copied, new = read(content, COPY), read(exported.files[MASLOW.file], MASLOW.file)
    if not np.array_equal(copied[:, :2], new[:, :2]) or (
            new[:, 2].any() and not np.array_equal(copied, new)):
        raise NoResult("the copy reads back as other numbers", str(old),
                       f"Put the lines of {MASLOW.file} there by hand")
    told = Note(f"The {COPY} written is a copy of {old} with the new numbers. Keep the old one, "
                "put the copy in its place, and restart.", NOTE)
    return replace(exported, files={**exported.files, COPY: content}, advice=(told,))


SIGMA = 0.5
"""What readings scatter by before it is estimated, mm."""
USUAL = (3000.0, 2100.0)
"""Width and height of a frame of which nothing is known, mm."""
KNOWN, ROUGH = 30.0, 100.0
"""Tolerance of anchors that somebody or the firmware knew, and of others, mm."""
DIGITS = 6
CROSSED = 0.02
"""Squares of opposite belts have one sum at a rectangle; if these differ by more than this part,
and by less than half of that with two names exchanged, they are."""


def import_config(path: Path, options: Mapping[str, Any]) -> Imported:
    """Return a Maslow and its readings; see :class:`ppmcal.controllers.importing.Importer`.

    Raises:
        BadInput: anything wrong in the files or options.
    """
    log = read_log(path)
    for name in ("width", "height"):
        if options[name] is not None and not 0.0 < options[name] < LONGEST:
            raise BadInput(f"{options[name]} is not a {name} in mm", f"--{name}",
                           f"Give the distance of anchors, such as --{name} 2100")
    given = options["anchors"]
    keys = log.keys if given is None else read_keys(Path(given))
    rows = np.concatenate([run.joints for run in log.runs])
    anchors, origin, tolerance = _anchors(rows, keys, "--anchors" if given else path.name,
                                          options["width"], options["height"])
    heights = _heights(rows, keys, "--anchors" if given else path.name)
    machine = _machine(path, rows, anchors, origin, tolerance, heights)
    findings = list(log.findings)
    if exchanged := _exchanged(rows):
        findings.append(Note(
            f"{path}: the readings suit a frame with four corners better with {exchanged} "
            "exchanged: check which belt is which"))
    counts = [len(run.joints) for run in log.runs]
    return Imported(
        rope_files(machine, log.runs, path.name, SIGMA),
        f"{path}: a Maslow with {pluralize(len(rows), 'reading')} of its belts in "
        f"{pluralize(len(counts), 'run')}. Anchors: {origin}.",
        {"runs": counts, "lines": [run.where for run in log.runs],
         "anchors": dict(zip(BELTS, anchors.tolist(), strict=True)), "anchors_from": origin,
         **({"heights": dict(zip(BELTS, heights.tolist(), strict=True))} if heights.any() else {})},
        tuple(findings), () if given is None else (str(given),))


def _anchors(rows: Array, keys: Mapping[str, float], source: str, width: float | None,
             height: float | None) -> tuple[Array, str, float]:
    """Return anchors (4, 2), mm, in the order of the belts, from where, and their tolerance."""
    at = anchors_of(keys)
    if width is None and height is None and all(k in keys for k in NEEDED) and goes_round(at):
        axes = horizontal(np.append(at[1] - at[0], 0.0))[:2, :2]    # of the frame that is held
        return ((at - at[0]) @ axes.T + 0.0).round(DIGITS), f"tlX ... brY of {source}", KNOWN
    w, h, own = _rectangle(rows)
    origin = ("--width and --height" if width and height else f"{'--width' if width else ''}"
              f"{'--height' if height else ''}{', and ' if width or height else ''}"
              + ("a rectangle that suits the readings" if own else
                 "the usual frame of {:g} x {:g} mm".format(*USUAL)))
    w, h = width or w, height or h
    return (np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]]), f"{origin}, {w:g} x {h:g} mm",
            KNOWN if width and height else ROUGH)


def _rectangle(rows: Array) -> tuple[float, float, bool]:
    """Return width and height, mm, of the rectangle that rows (N, 4) suit, and whether one does."""
    bl, br, tr, tl = rows.T

    def misfit(size: Array) -> Array:
        w, h = size
        x = (bl**2 - br**2 + tl**2 - tr**2 + 2.0 * w**2) / (4.0 * w)
        y = (bl**2 - tl**2 + br**2 - tr**2 + 2.0 * h**2) / (4.0 * h)
        return np.concatenate([np.hypot(x, y) - bl, np.hypot(w - x, y) - br,
                               np.hypot(w - x, h - y) - tr, np.hypot(x, h - y) - tl])

    # both ends of a side see any place: their belts reach at least from one to the other
    start = [np.quantile(np.minimum(*pair), 0.05) for pair in ((bl + br, tl + tr),
                                                               (bl + tl, br + tr))]
    found = least_squares(misfit, start, loss="soft_l1", f_scale=10.0)
    w, h = (round(float(v), -1) for v in found.x)
    if not found.success or not all(0.2 * u < v < 5.0 * u for u, v in zip(USUAL, (w, h),
                                                                         strict=True)):
        return *USUAL, False
    return w, h, True


def _exchanged(rows: Array) -> str:
    """Return which neighbours' names are mixed up in rows (N, 4), empty where none are."""
    neighbours = (((1, 0, 2, 3), "bl and br, or tr and tl,"),
                  ((0, 2, 1, 3), "br and tr, or bl and tl,"))
    other, told = min((_crossed(rows[:, order]), told) for order, told in neighbours)
    own = _crossed(rows)
    return told if own > max(CROSSED, 2.0 * other) else ""


def _crossed(rows: Array) -> float:
    """Return by which part sums of squares of opposite belts typically differ."""
    bl, br, tr, tl = (rows**2).T
    return float(np.median(np.abs(bl + tr - br - tl) / (bl + tr + br + tl)))


def _heights(rows: Array, keys: Mapping[str, float], source: str) -> Array:
    """Return how far anchors (4,) are above the plane, mm, 0 where no key says it."""
    heights = heights_of(keys)
    for belt, height, shortest in zip(BELTS, heights, rows.min(axis=0), strict=True):
        if height >= shortest:
            raise BadInput(f"{belt}Z is {height:g} mm, and the belt reads {shortest:g} mm: no belt "
                           "is shorter than its anchor is high", source,
                           "Check the unit: heights of anchors are mm")
    return heights


def _effects(heights: Array) -> str:
    """Return the lines that say how high anchors (4,) are, mm; none where all are 0."""
    if not heights.any():
        return ""
    lines = "".join(f"  - {{kind: rope_height, on: [{belt}], "
                    f"parameters: {{height: {height:.10g}}}}}\n" for belt, height in
                    zip(BELTS, heights.tolist(), strict=True) if height)
    return f"""\
# How far anchors are above the router's plane, as the firmware has it: a belt reads more than its
# length in the plane. To have one found: height: {{value: 34, tolerance: 10, free: true}}. Take
# these out where readings are lengths in the plane already.
effects:
{lines}"""


def _machine(path: Path, rows: Array, anchors: Array, origin: str, tolerance: float,
             heights: Array) -> RopeMachine:
    ends = np.column_stack([np.floor(0.08 * rows.min(axis=0)), np.ceil(0.11 * rows.max(axis=0))])
    home = np.round(anchors.mean(axis=0), 1)
    return RopeMachine(
        f"Maslow of {path.name}",
        "A Maslow: four belts hold a router. Anchors are about where they are:\n"
        f"{origin}.\nThe origin is the bottom left anchor, and the x axis goes through the bottom "
        "right one:\nwhat is fixed of these defines the frame.", str(PLANAR_POINT),
        tuple(Rope(belt, tuple(at), "{share: belt_end, value: 0, fixed: true}",
                   {"bl": "xy", "br": "y"}.get(belt, ""))
              for belt, at in zip(BELTS, anchors.tolist(), strict=True)),
        tuple(home.tolist()), {"point": tolerance, "offset": 3.0}, 10.0 * ends, """\
# What is never counted of a belt, its end or the arm of the sled, is the same for all: take `fixed`
# out of belt_end to find it.
""" + _effects(heights))
