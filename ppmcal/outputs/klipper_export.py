"""klipper.cfg and export.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ppmcal.controllers.klipper import MM
from ppmcal.controllers.klipper_fit import DISC, HEIGHTS, Export, Misses
from ppmcal.errors import NoResult
from ppmcal.files import json_text
from ppmcal.files.klipper import (
    TOWERS,
    Geometry,
    format_geometry,
    parse_config,
    read_geometry,
)

CONFIG = "klipper.cfg"


def files(export: Export, name: str, provenance: Mapping[str, Any]) -> dict[str, str]:
    """Return file name -> text of everything that the export writes.

    Raises:
        NoResult: the lines do not read back as what they were written from.
    """
    text = format_geometry(export.new, _comment(export, name))
    same_again(read_geometry(parse_config(text, CONFIG)), export.new)
    return {CONFIG: text, "export.json": json_text(summary(export, name, provenance))}


def same_again(found: Geometry, written: Geometry) -> None:
    """Refuse an export that reads back as another one."""
    if found != written:
        raise NoResult("the lines read back as another geometry", CONFIG,
                       "This is a fault of ppmcal; do not use them")


def _comment(export: Export, name: str) -> str:
    lines = [f"{name}: predicted error {_both(export.after)}, before {_both(export.before)}.",
             "Paste above the #*# lines of printer.cfg, below the sections of the same names (the",
             "later value wins). Where #*# lines name the same keys, put the numbers there: they",
             "win over all others."]
    return "\n".join([*lines, *(f"Cannot be expressed: {lack.what}." for lack in export.lacks),
                      *(f"Note: {note}." for note in export.notes)])


def _both(found: Misses) -> str:
    return f"{found.rms / MM:.4f} mm rms, {found.max / MM:.4f} mm at most"


def keys(geometry: Geometry) -> dict[str, float]:
    """Return ``section.key`` -> value, mm and degrees."""
    out = {"printer.delta_radius": geometry.radius}
    for i, tower in enumerate(TOWERS):
        out |= {f"stepper_{tower}.angle": geometry.angles[i],
                f"stepper_{tower}.arm_length": geometry.arms[i],
                f"stepper_{tower}.position_endstop": geometry.endstops[i]}
    return out


def summary(export: Export, name: str, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of export.json: mm and degrees."""
    return {
        "format": "ppmcal/export/1", "controller": "klipper", "name": name,
        "units": {"length": "mm", "angle": "deg"},
        "parameters": keys(export.new), "old": keys(export.old),
        "exact": export.exact, "read_back": True,
        "gain": {"before": _misses(export.before), "after": _misses(export.after)},
        "not_expressed": [{"what": lack.what, "parameters": lack.parameters,
                           "cost": None if lack.cost is None else _misses(lack.cost)}
                          for lack in export.lacks],
        "notes": export.notes,
        "grid": {"points": len(export.points), "radius": export.radius / MM,
                 "part_of_radius": DISC, "z": [z / MM for z in HEIGHTS]},
        "provenance": dict(provenance)}


def _misses(found: Misses) -> dict[str, Any]:
    return {"rms": found.rms / MM, "max": found.max / MM, "unit": "mm",
            "taken_out": {"turn": float(np.degrees(found.turn)),
                          "shift": [v / MM for v in found.shift]}}
