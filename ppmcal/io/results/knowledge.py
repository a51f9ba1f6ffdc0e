"""Reading back what an identification knew: covariance and measured volume."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.calibration.compensation import Knowledge
from ppmcal.calibration.posterior import Posterior
from ppmcal.errors import BadInput
from ppmcal.io.json import FINITE, TEXT, read_json
from ppmcal.io.results.units import column_factor
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism, Registration
from ppmcal.units import Units


def read_knowledge(path: Path, mechanism: Mechanism) -> Knowledge:
    """Return the knowledge in an identification.json.

    Raises:
        BadInput: not readable, not such a file, or of another machine.
    """
    content = read_content(path, WITHOUT)
    try:
        names = tuple(str(n) for n in content["covariance"]["names"])
        units = _units(content, path)
        matrix = np.array(content["covariance"]["matrix"], dtype=float)
        matrix = matrix.reshape(len(names), len(names))
        volume = {str(c): _ends(low, high) for c, (low, high) in
                  content["measured_volume"].items()}
        turn = {str(n): np.array(p, dtype=float) * units.factor("length") for n, p in
                content["covariance"]["frames_turn_about"].items()}
        before = {str(d["name"]): _registration(d["registration_before"], units)
                  for d in content["datasets"]}
        left = content.get("unexplained") or {}
        unexplained = (left.get("position", {}).get("rms", 0.0) * units.factor("length"),
                       left.get("rotation", {}).get("rms", 0.0) * units.factor("angle"))
    except FORMS as error:
        raise _no_such(path, WITHOUT) from error
    of_machine(names, mechanism, path)
    factor = np.array([column_factor(mechanism, n) for n in names])
    scaled = {c: (low * _unit(mechanism, c), high * _unit(mechanism, c))
              for c, (low, high) in volume.items()}
    return Knowledge(names, matrix * np.outer(factor, factor), scaled, turn, before, unexplained)


FORMS = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError)
"""What reading a file of another form raises."""
LONGEST = 1e15
"""File units: no value of a parameter and no pose is as large."""
_SHAPE = {
    "format": TEXT, "units": {"*": TEXT}, "measured_volume": {"*": [FINITE]},
    "parameters": [{"name": TEXT, "value": FINITE}],
    "covariance": {
        "names": [TEXT], "prior": (FINITE,), "inflation": FINITE, "matrix": [(FINITE,)],
        "data": {"matrix": [[FINITE]], "right": [FINITE], "unit_of_parameters": [FINITE]},
        "frames_turn_about": {"*": [FINITE]}},
    "unexplained": {"*": {"rms": FINITE, "unit": TEXT}},
    "datasets": [{"name": TEXT, "source": TEXT, "registration_before": {"*": [FINITE]}}],
    "provenance": {"inputs": {"*": TEXT}}, "earlier": {"*": TEXT}}


def read_content(path: Path, mend: str) -> dict[str, Any]:
    """Return what an identification.json holds.

    Raises:
        BadInput: not readable, not such a file, or a number in it that is none.
    """
    content = read_json(path, _SHAPE)
    if content.get("format") != "ppmcal/identification/1":
        raise _no_such(path, mend)
    return content


def _no_such(path: Path, mend: str) -> BadInput:
    return BadInput("is not an identification.json of this version of ppmcal", str(path), mend)


def _units(content: Mapping[str, Any], path: Path) -> Units:
    try:
        return Units(**content["units"])
    except BadInput as error:
        raise error.at(str(path)) from None


def _ends(low: float, high: float) -> tuple[float, float]:
    if not -LONGEST < low <= high < LONGEST:
        raise ValueError("no range")
    return float(low), float(high)


def of_machine(names: Sequence[str], mechanism: Mechanism, path: Path) -> None:
    """Refuse a file whose parameters the machine does not have.

    Raises:
        BadInput: it belongs to another machine.
    """
    strangers = [n for n in names if " of " not in n and n not in mechanism.names]
    if strangers:
        raise BadInput(f"belongs to another machine: it has a parameter '{strangers[0]}'",
                       str(path), "Keep MODEL and its identification.json together")


def read_posterior(path: Path, mechanism: Mechanism) -> Posterior:
    """Return what an identification.json knows of a machine's parameters.

    Raises:
        BadInput: not readable, not such a file, of another machine, or of an old version.
    """
    content = read_content(path, AGAIN)
    try:
        entry = content["covariance"]
        names = [str(n) for n in entry["names"] if " of " not in n]
        count = len(names)
        right = np.array(entry["data"]["right"], dtype=float)
        matrix = np.array(entry["data"]["matrix"], dtype=float).reshape(right.size, count)
        scale = np.array(entry["data"]["unit_of_parameters"], dtype=float).reshape(count)
        tau = np.array([np.inf if t is None else float(t) for t in entry["prior"][:count]])
        inflation = float(entry["inflation"])
        found = {str(p["name"]): float(p["value"]) for p in content["parameters"]}
        units = _units(content, path)
        value = np.array([found[n] for n in names])
        sums = {str(k): str(v) for k, v in content["provenance"]["inputs"].items()}
        inputs = {sums[d["source"]]: str(d["source"]) for d in content["datasets"]}
        inputs |= {str(k): str(v) for k, v in content.get("earlier", {}).items()}
    except FORMS as error:
        raise _no_such(path, AGAIN) from error
    sound = (np.all(np.abs(value) < LONGEST) and len(set(names)) == count and tau.size == count
             and np.all(tau > 0.0) and np.all(scale > 0.0) and 1.0 <= inflation < np.inf)
    if not sound:
        raise _no_such(path, AGAIN)
    of_machine(names, mechanism, path)
    if (units.length, units.angle) != (mechanism.units.length, mechanism.units.angle):
        raise BadInput(f"is in {units.length} and {units.angle}, the machine in "
                       f"{mechanism.units.length} and {mechanism.units.angle}", str(path),
                       "Use the machine file that it was made with")
    factor = np.array([column_factor(mechanism, n) for n in names])
    return Posterior(tuple(mechanism.names.index(n) for n in names), value * factor,
                     matrix / factor, right, tau * factor, scale * factor, inflation, inputs,
                     str(path))


AGAIN = "Run identify again"
WITHOUT = "Run identify again, or remove it to go on without uncertainties"


def refuse_twice(before: Posterior, source: Mapping[str, Any]) -> None:
    """Refuse to count measurements that an earlier calibration holds already.

    Raises:
        BadInput: a table in the provenance ``source`` is behind ``before``.
    """
    for name, digest in source["inputs"].items():
        if digest in before.inputs:
            raise BadInput(f"is in that calibration already, as {before.inputs[digest]}", name,
                           "Give new measurements only, or leave out --keep")


def _registration(entry: dict[str, list[float]], units: Units) -> Registration:
    length, angle = units.factor("length"), units.factor("angle")
    frame = np.array(entry["frame"], dtype=float) * np.array([length] * 3 + [angle] * 3)
    return Registration(frame, np.array(entry["target"], dtype=float) * length,
                        np.array(entry["target_rotation"], dtype=float) * angle)


def _unit(mechanism: Mechanism, coordinate: str) -> float:
    index = POSE_COORDINATES.index(coordinate)
    return mechanism.units.factor("length" if index < 3 else "angle")
