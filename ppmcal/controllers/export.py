"""What every export has in common: texts, numbers old and new, what they are worth and lack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from ppmcal.controllers.model_uncertainty import UNKNOWN, Certainty
from ppmcal.controllers.pose_errors import PoseErrors
from ppmcal.errors import unknown
from ppmcal.io import json_text
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

GROUP = "ppmcal.controllers"
FORMATS = {"klipper": "klipper_export", "linuxcnc": "linuxcnc_export",
           "reprap": "reprap", "joints": "joint_tables_export", "grid": "pose_grid_export"}
"""Formats of ppmcal, and the modules beside this one that write them; each is one more file."""
NO_GAIN = 1e-9


@dataclass(frozen=True)
class ErrorSummary:
    """Errors over the commands compared: of position, m, and of rotation, rad, if there is one."""

    rms: float
    max: float
    rotation_rms: float | None = None
    rotation_max: float | None = None
    more: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Number:
    """One number that the controller takes, in the controller's own unit."""

    name: str
    old: float | None
    new: float
    unit: str


@dataclass(frozen=True)
class Lacking:
    """One thing that the controller cannot express, and what that alone costs (None: unknown)."""

    what: str
    parameters: tuple[str, ...]
    cost: ErrorSummary | None


@dataclass(frozen=True)
class Exported:
    """A machine as a controller takes it.

    Attributes:
        controller: the format's name; title: what people call it.
        files: file name -> text, read back and found equal before it gets here.
        said: one sentence on what the controller holds of the machine.
        numbers: what is written, and what stood there before; old None where nothing did.
        over: over which commands the figures are, as the end of a sentence.
        before, after: errors of the machine driven by the controller's arithmetic with each, if
            the model is exact: ``after`` is what the format cannot express.
        poses: of the platform at which these are, base frame (N, 6), nan where open.
        certainty: how well the model itself is known there.
        lacks: what cannot be expressed; notes: what was done to express the rest.
        advice: sentences on how to bring the numbers into the controller.
        extra: more for export.json.
    """

    controller: str
    title: str
    files: Mapping[str, str]
    said: str
    numbers: tuple[Number, ...]
    over: str
    before: ErrorSummary
    after: ErrorSummary
    lacks: tuple[Lacking, ...] = ()
    notes: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    poses: Array | None = None
    certainty: Certainty = UNKNOWN

    @property
    def predicted(self) -> ErrorSummary | None:
        """The error to expect with the new numbers: what they lack, and what the model lacks."""
        own = self.certainty
        if own.position is None:
            return None
        turn = None if self.after.rotation_rms is None or own.rotation is None else float(
            np.hypot(self.after.rotation_rms, own.rotation))
        return ErrorSummary(float(np.hypot(self.after.rms, own.position)), np.nan, turn)

    @property
    def findings(self) -> list[str]:
        """What the user must look at."""
        out = [f"cannot be expressed: {lack.what}"
               + ("" if lack.cost is None else f": costs {words(lack.cost)}")
               for lack in self.lacks]
        if self.after.rms > self.before.rms + NO_GAIN:
            out.append(f"the new {self.title} numbers are worse than the old ones over this "
                       "workspace")
        return out


class Exporter(Protocol):
    """A module, or an object, that writes one format."""

    def export(self, mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
        """Return the machine in this format.

        Args:
            mechanism: the calibrated machine; its nominal values are the drawing.
            old: the controller's present file, to predict the gain against.
            poses: wanted poses (CSV), for formats that are tables of them.

        Raises:
            BadInput: a machine that this controller does not drive, or an option without use.
            NoResult: the file does not read back as what it was written from.
        """
        ...


def formats() -> dict[str, EntryPoint]:
    """Return by name where each format's module is, those of other packages last.

    Another package adds a format through the entry-point group ``ppmcal.controllers``: the
    entry has the format's name in small letters and loads an :class:`Exporter`.

    Raises:
        ValueError: a name is taken.
    """
    out: dict[str, EntryPoint] = {}
    own = [EntryPoint(n, f"ppmcal.controllers.{m}", GROUP) for n, m in FORMATS.items()]
    for entry in (*own, *entry_points(group=GROUP)):
        if entry.name in out:
            raise ValueError(f"format '{entry.name}' is registered twice")
        out[entry.name] = entry
    return out


def exporter(name: str) -> Exporter:
    """Return what writes format ``name``, whatever its case; no other format's module is loaded.

    Raises:
        BadInput: there is no such format.
    """
    known = formats()
    if name.lower() not in known:
        raise unknown("format", name, known)
    return cast("Exporter", known[name.lower()].load())


def figure(found: PoseErrors) -> ErrorSummary:
    """Return errors over poses as exports show them."""
    return ErrorSummary(found.rms, found.max, found.rotation_rms, found.rotation_max)


def words(figure: ErrorSummary) -> str:
    """Return errors for people: ``0.0123 mm rms, 0.0456 mm at most``."""
    out = f"{figure.rms * 1e3:.4f} mm rms, {figure.max * 1e3:.4f} mm at most"
    if figure.rotation_rms is not None and figure.rotation_max is not None:
        out += (f"; {np.degrees(figure.rotation_rms):.5f} deg rms, "
                f"{np.degrees(figure.rotation_max):.5f} deg at most")
    return out


def all_files(exported: Exported, name: str, provenance: Mapping[str, Any]) -> dict[str, str]:
    """Return file name -> text of everything that an export writes."""
    return {**exported.files, "export.json": json_text(summary(exported, name, provenance))}


def summary(exported: Exported, name: str, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of export.json: mm and degrees, numbers in the controller's units."""
    return {
        "format": "ppmcal/export/1", "controller": exported.controller, "name": name,
        "units": {"length": "mm", "angle": "deg"},
        "parameters": {n.name: n.new for n in exported.numbers},
        "old": {n.name: n.old for n in exported.numbers if n.old is not None},
        "number_units": {n.name: n.unit for n in exported.numbers},
        "title": exported.title, "said": exported.said, "over": exported.over,
        "predicted": _predicted(exported),
        "exact": not exported.lacks, "read_back": True,
        "gain": {"before": _figure(exported.before), "after": _figure(exported.after)},
        "not_expressed": [{"what": lack.what, "parameters": lack.parameters,
                           "cost": None if lack.cost is None else _figure(lack.cost)}
                          for lack in exported.lacks],
        "notes": exported.notes, "advice": exported.advice, "files": list(exported.files),
        **exported.extra, "provenance": dict(provenance)}


def _predicted(exported: Exported) -> dict[str, Any]:
    """Return what is left with the new numbers, rms: of the format, of the model, and of both."""
    def entry(part: ErrorSummary | None) -> dict[str, Any]:
        out: dict[str, Any] = {"rms": None if part is None else part.rms * 1e3, "unit": "mm"}
        if part is not None and part.rotation_rms is not None:
            out["rotation"] = {"rms": float(np.degrees(part.rotation_rms)), "unit": "deg"}
        return out

    return {"format": entry(exported.after), "model": exported.certainty.entry(),
            "after": entry(exported.predicted)}


def _figure(figure: ErrorSummary) -> dict[str, Any]:
    out: dict[str, Any] = {"rms": figure.rms * 1e3, "max": figure.max * 1e3, "unit": "mm"}
    if figure.rotation_rms is not None and figure.rotation_max is not None:
        out["rotation"] = {"rms": float(np.degrees(figure.rotation_rms)),
                           "max": float(np.degrees(figure.rotation_max)), "unit": "deg"}
    return {**out, **figure.more}
