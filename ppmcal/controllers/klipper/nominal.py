"""What a Klipper printer was meant to be: the body of its ``printer.cfg``, comments included.

``SAVE_CONFIG`` writes what a calibration found into ``#*#`` lines at the end and comments the
earlier value out where it stands. The saved numbers are a result of the very touches that are to
be fitted; taken as nominal and prior they would be believed twice.
"""

from __future__ import annotations

import re

import numpy as np

from ppmcal.controllers.delta.geometry import ANGLES, TOWERS, DeltaGeometry, Triple
from ppmcal.controllers.delta.printer import (
    FAR,
    WIDE_RODS,
    Nominal,
    far_radius,
    far_rods,
    nominal_of,
)
from ppmcal.controllers.klipper.config import LARGEST, Config
from ppmcal.controllers.klipper.lines import HEADER
from ppmcal.errors import BadInput
from ppmcal.notes import Note

SKEW = 5.0
"""So was an angle, degrees."""
_LINE = re.compile(r"(?P<out>[#;]*)\s*(?P<key>[A-Za-z_]+)\s*[:=]\s*"
                   r"(?P<value>[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)"
                   r"\s*(?:[#;].*)?$", re.ASCII)
_COMMENT, _BODY, _SAVED = "a comment", "the file", "the saved calibration"


def read_nominal(config: Config, active: DeltaGeometry, rods: float | None = None,
                 given: float | None = None) -> Nominal:
    """Return the nominal geometry of a printer whose last calibration gave ``active``.

    Args:
        config: its file.
        active: its numbers, saved ones before those in its body.
        rods: the rods' length as the user knows it, mm.
        given: delta_radius as the user knows it, mm.

    Raises:
        BadInput: ``rods`` do not reach the middle.
    """
    body, told = _body(config)
    findings = list(told)
    if given is not None:
        radius, radius_from = given, "--radius"
        findings += far_radius(given, active.radius)
    else:
        radius, radius_from = _one(config, body, "printer", "delta_radius", active.radius)
        if abs(radius - active.radius) > FAR:
            findings.append(_placeholder("delta_radius", radius, active.radius, radius_from))
            radius, radius_from = active.radius, _SAVED
    findings += far_rods(rods, active.arms)
    arms, arms_from, known = _rods(config, body, active, rods, findings)
    ends, ends_from = _towers(config, body, "position_endstop", active.endstops)
    if max(abs(e - own) for e, own in zip(ends, active.endstops, strict=True)) > FAR:
        findings.append(_placeholder("position_endstop", ends[0], active.endstops[0], ends_from))
        ends, ends_from = active.endstops, _SAVED
    origin = {"delta_radius": radius_from, "rods": arms_from, "endstops": ends_from}
    return nominal_of(
        config.source, DeltaGeometry(radius, _angles(body, active), arms, ends), active, origin,
        rods, {key for key, place in origin.items() if place == _SAVED}, known, findings)


def _placeholder(key: str, value: float, now: float, origin: str) -> Note:
    place = "in a comment of the body" if origin == _COMMENT else "in the body of the file"
    return Note(f"{key} {value:g} mm {place} is {abs(value - now):.3g} mm from the {now:g} mm that "
                "the printer saved: it is taken for a placeholder, not for the nominal value")


_Body = dict[tuple[str, str], tuple[float, bool]]


def _body(config: Config) -> tuple[_Body, list[Note]]:
    """Return (section, key) -> (value, whether it is commented out), and what is ambiguous."""
    out: _Body = {}
    several: dict[str, list[float]] = {}
    section = ""
    for line in (one.text for one in config.body):
        header = HEADER.match(line)
        if header:
            section = header[1].strip()
            continue
        found = _LINE.match(line.strip())
        if found is None:
            continue
        place = section, found["key"].lower()
        value, quiet = float(found["value"]), bool(found["out"])
        if not abs(value) <= LARGEST:
            raise BadInput(f"{found['value'][:40]} is out of range",
                           f"{config.source}: [{section}] {place[1]}", "Correct the number")
        if quiet and place in out and not out[place][1]:
            continue
        if quiet and place in out and out[place][0] != value:
            several.setdefault(f"[{section}] {place[1]}", [out[place][0]]).append(value)
        out[place] = value, quiet
    keys = ("delta_radius", "arm_length", "position_endstop", "angle")
    return out, [Note(f"{name}: {', '.join(f'{v:g}' for v in values)} are commented out: the last "
                      "is taken as nominal") for name, values in several.items()
                 if name.endswith(keys)]


def _one(config: Config, body: _Body, section: str, key: str, active: float) -> tuple[float, str]:
    """Return a value and where it is from, the saved one only where nothing else stands."""
    if (section, key) in body:
        value, quiet = body[section, key]
        return value, _COMMENT if quiet else _BODY
    entry = config.sections.get(section, {}).get(key)
    return active, _SAVED if entry is not None and entry.saved else _BODY


def _towers(config: Config, body: _Body, key: str, active: Triple) -> tuple[Triple, str]:
    """Return a value of each tower, those of b and c a's where they have none of their own."""
    values: list[float] = []
    origins: list[str] = []
    for i, tower in enumerate(TOWERS):
        value, origin = _one(config, body, f"stepper_{tower}", key, active[i])
        alone = (f"stepper_{tower}", key) not in body
        if i and alone and origins[0] != _SAVED:
            value, origin = values[0], origins[0]
        values.append(value)
        origins.append(origin)
    worst = _SAVED if _SAVED in origins else _COMMENT if _COMMENT in origins else _BODY
    return (values[0], values[1], values[2]), worst


def _rods(config: Config, body: _Body, active: DeltaGeometry, given: float | None,
          findings: list[Note]) -> tuple[Triple, str, bool]:
    """Return the rods, where they are from, and whether that is more than a saved result."""
    if given is not None:
        return (given, given, given), "--rods", True
    arms, origin = _towers(config, body, "arm_length", active.arms)
    if origin != _SAVED:
        return arms, origin, True
    mean = float(np.mean(active.arms))
    findings.append(Note(
        f"the rods' nominal length is not known: all that the file holds is what a calibration "
        f"saved ({', '.join(f'{a:g}' for a in active.arms)} mm). Their mean {mean:.3f} mm is taken "
        f"with a tolerance of {WIDE_RODS:g} mm; measure a rod from bearing to bearing, or look at "
        "its drawing, and give --rods LENGTH"))
    return (mean, mean, mean), _SAVED, False


def _angles(body: _Body, active: DeltaGeometry) -> Triple:
    """Return the towers' angles as drawn, those of the firmware where the file says nothing."""
    out = []
    for tower, usual, own in zip(TOWERS, ANGLES, active.angles, strict=True):
        value = body.get((f"stepper_{tower}", "angle"), (usual, True))[0]
        out.append(value if abs(value - own) <= SKEW else own)
    return out[0], out[1], out[2]
