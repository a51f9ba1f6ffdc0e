"""M669 of a Hangprinter with RepRapFirmware, and machines of its auto-calibration's samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.hangprinter.reading import (
    DECIMALS,
    NAMES,
    HangprinterConfig,
    Samples,
    Spools,
    parse_config,
    read_samples,
)
from ppmcal.controllers.importing import Imported
from ppmcal.controllers.ropes import (
    Frame,
    Rope,
    RopeFirmware,
    RopeGeometry,
    RopeMachine,
    RopeRun,
    export_ropes,
    holds_a_point,
    rope_files,
)
from ppmcal.controllers.text import commented, read_text
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import TRANSLATIONAL
from ppmcal.notes import Note
from ppmcal.wording import pluralize

SIGMA, POSITION = 0.5, 1.0
"""What line positions and measured places scatter by before it is estimated, mm."""
KNOWN, ROUGH = 50.0, 300.0
"""Tolerance of anchors that somebody said, and of the firmware's own, mm."""
AT_ORIGIN = 20.0
"""Tolerance of the line lengths where line positions are 0, mm."""
DEFAULT = {4: ((0.0, -2000.0, -100.0), (2000.0, 1000.0, -100.0), (-2000.0, 1000.0, -100.0),
               (0.0, 0.0, 3000.0)),
           5: ((0.0, -2000.0, -120.0), (2000.0, 0.0, -120.0), (0.0, 2000.0, -120.0),
               (-2000.0, 0.0, -120.0), (0.0, 0.0, 2000.0))}
"""The firmware's own anchors, mm, of machines with so many lines."""


def import_config(path: Path, options: Mapping[str, Any]) -> Imported:
    """Return a Hangprinter and its samples; see :class:`ppmcal.controllers.importing.Importer`.

    Raises:
        BadInput: anything wrong in the files.
    """
    samples = read_samples(path)
    given = options["anchors"]
    config = None if given is None else parse_config(read_text(given), str(given))
    anchors, origin, tolerance = _anchors(samples, config, str(given))
    findings = list[str]()
    runs = list(_runs(samples, None if config is None else config.spools, path, findings))
    _refuse_few(runs, path, anchors)
    lengths = next((s.lengths for s in samples if s.lengths is not None),
                   np.linalg.norm(anchors, axis=1))
    joints = np.concatenate([run.joints for run in runs])
    machine = _machine(path, joints, anchors, lengths, origin, tolerance,
                       all(run.places is None for run in runs))
    measured = sum(len(run.joints) for run in runs if run.places is not None)
    return Imported(
        rope_files(machine, runs, path.name, SIGMA, POSITION),
        f"{path}: a Hangprinter with {pluralize(len(joints), 'sample')} of "
        f"{joints.shape[1]} lines, {measured} of them at measured places. Anchors: {origin}.",
        {"runs": [len(run.joints) for run in runs], "lines": [run.where for run in runs],
         "measured": measured, "anchors": dict(zip(NAMES, anchors.tolist(), strict=False)),
         "anchors_from": origin},
        tuple(findings), () if given is None else (str(given),))


def _anchors(samples: Sequence[Samples], config: HangprinterConfig | None, given: str
             ) -> tuple[Array, str, float]:
    """Return anchors (k, 3), mm, from where, and their tolerance."""
    k = samples[0].motors.shape[1]
    if config is not None:
        out = config.matrix(given)
        if len(out) != k:
            raise BadInput(f"M669 has {len(out)} anchors, and samples are of {k} lines", given,
                           "Give the config.g of the machine that the samples are of")
        return out, "M669 of --anchors", KNOWN
    for one in samples:
        if one.anchors is not None:
            return one.anchors, f"those of {one.where}", KNOWN
    return np.array(DEFAULT[k]), "the firmware's own, which are rough", ROUGH


def _runs(samples: Sequence[Samples], spools: Spools | None, path: Path, findings: list[str]
          ) -> Iterator[RopeRun]:
    """Yield line positions of the samples with places, then of those without, set by set."""
    assumed = False
    for one in samples:
        own = spools or one.spools
        assumed = assumed or (own is None and one.turned)
        joints = (own or Spools()).line_positions(one.motors) if one.turned else one.motors
        n = len(one.places)
        if n:
            yield RopeRun(joints[:n], f"samples 1 to {n} of {one.where}", one.places)
        if n < len(joints):
            yield RopeRun(joints[n:], f"samples {n + 1} to {len(joints)} of {one.where}")
    if assumed:
        findings.append(Note(
            f"{path}: how large the spools are is not said: taken as the firmware's own, 75 mm and "
            "255 to 20 teeth; give the machine's config.g with M666 as --anchors"))


def _refuse_few(runs: Sequence[RopeRun], path: Path, anchors: Array) -> None:
    """Refuse samples that cannot tell the machine.

    Raises:
        BadInput: fewer numbers than are open.
    """
    k = len(anchors)
    said = sum(len(run.joints) * (k if run.places is not None else k - 3) for run in runs)
    open_ = 4 * k - (0 if any(run.places is not None for run in runs) else 6)
    if said <= open_:
        raise BadInput(f"the samples say {said} numbers, and {open_} of the machine are open",
                       str(path), f"Take more samples: each says {k - 3} without a measured place, "
                       f"and {k} with one")


def _machine(path: Path, joints: Array, anchors: Array, lengths: Array, origin: str,
             tolerance: float, blind: bool) -> RopeMachine:
    low, high = joints.min(axis=0), joints.max(axis=0)
    wide = 0.1 * (high - low) + 10.0
    limits = np.column_stack([np.floor((low - wide) / 10.0), np.ceil((high + wide) / 10.0)]) * 10.0
    k = len(anchors)
    middle = round(0.2 * float(anchors[:, 2].max() + anchors[:, 2].min()), -1)    # height, mm
    held = ("xyz", "xz", "z") if blind else ()    # three ends of a base that cannot turn
    return RopeMachine(
        f"Hangprinter of {path.name}",
        "A Hangprinter: lines hold a head that stays level. Joint values are line positions, by\n"
        "how much a line is longer than where they were zeroed, and offsets the lengths there.\n"
        f"Anchors: {origin}." + ("\nWhat is fixed of these defines the frame." if blind else ""),
        str(TRANSLATIONAL),
        tuple(Rope(name, tuple(place), f"{length:.6g}", fixed)
              for name, place, length, fixed in zip(
                  NAMES, anchors.tolist(), lengths.tolist(), (*held, *[""] * (k - len(held))),
                  strict=False)), (0.0, 0.0, middle),
        {"point": tolerance, "offset": max(AT_ORIGIN, tolerance)}, limits, """\
# Spools of another radius than the firmware takes: give a rope `ratio: {value: 1, tolerance: 0.01}`
# where places were measured.
""")


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


def table(anchors: Array) -> Iterator[tuple[str, float]]:
    """Yield name and value, mm, of each number for anchors (k, 3), mm."""
    for name, place in zip(NAMES, anchors.tolist(), strict=False):
        for axis, value in zip("xyz", place, strict=True):
            yield f"M669 {name}{axis}", value


def text(anchors: Array, comment: str) -> str:
    """Return the line for ``config.g``."""
    places = " ".join(name + ":".join(f"{value:.{DECIMALS}f}" for value in place)
                      for name, place in zip(NAMES, anchors.tolist(), strict=False))
    more = "" if len(anchors) == 4 else f"N{len(anchors)} "
    return "\n".join([*commented(comment, ";"), f"M669 {more}{places}"]) + "\n"


def read(content: str, source: str) -> Array:
    """Return the anchors (k, 3), mm, of a ``config.g``.

    Raises:
        BadInput: M669 is missing, or an anchor in it.
    """
    return parse_config(content, source).matrix(source)


HANGPRINTER = RopeFirmware(
    "hangprinter", "Hangprinter", "hangprinter.g", order, frame, zero, table, text, read, DECIMALS,
    shifted="the firmware has its origin where all line positions are 0: in the model's base that "
    "is at {}, and places in the model are those of the printer less that",
    advice=lambda _: "Put the line of hangprinter.g in place of M669's anchors in config.g, keep "
    "its other letters and M666, and home.",
    scaled="multiply each R of M666, as lines are longer than they count")
export = partial(export_ropes, HANGPRINTER)
