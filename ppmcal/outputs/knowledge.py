"""Reading back what an identification knew: covariance and measured volume."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ppmcal.compensate import Knowledge
from ppmcal.errors import BadInput
from ppmcal.mechanism import POSE_COORDINATES, Mechanism, Registration
from ppmcal.outputs.identification import column_factor
from ppmcal.units import Units


def read_knowledge(path: Path, mechanism: Mechanism) -> Knowledge:
    """Return the knowledge in an identification.json.

    Raises:
        BadInput: not readable, not such a file, or of another machine.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] != "ppmcal/identification/1":
            raise KeyError("format")
        names = tuple(str(n) for n in content["covariance"]["names"])
        units = Units(**content["units"])
        matrix = np.array(content["covariance"]["matrix"], dtype=float)
        matrix = matrix.reshape(len(names), len(names))
        volume = {str(c): (float(low), float(high)) for c, (low, high) in
                  content["measured_volume"].items()}
        turn = {str(n): np.array(p, dtype=float) * units.factor("length") for n, p in
                content["covariance"]["frames_turn_about"].items()}
        before = {str(d["name"]): _registration(d["registration_before"], units)
                  for d in content["datasets"]}
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror})", str(path),
                       "Give the identification.json of this model") from None
    except (KeyError, TypeError, ValueError, AttributeError):
        raise BadInput("is not an identification.json of ppmcal", str(path),
                       "Run identify again, or remove it to go on without uncertainties") from None
    strangers = [n for n in names if " of " not in n and n not in mechanism.names]
    if strangers:
        raise BadInput(f"belongs to another machine: it has a parameter '{strangers[0]}'",
                       str(path), "Keep MODEL and its identification.json together")
    factor = np.array([column_factor(mechanism, n) for n in names])
    scaled = {c: (low * _unit(mechanism, c), high * _unit(mechanism, c))
              for c, (low, high) in volume.items()}
    return Knowledge(names, matrix * np.outer(factor, factor), scaled, turn, before)


def _registration(entry: dict[str, list[float]], units: Units) -> Registration:
    length, angle = units.factor("length"), units.factor("angle")
    frame = np.array(entry["frame"], dtype=float) * np.array([length] * 3 + [angle] * 3)
    return Registration(frame, np.array(entry["target"], dtype=float) * length,
                        np.array(entry["target_rotation"], dtype=float) * angle)


def _unit(mechanism: Mechanism, coordinate: str) -> float:
    index = POSE_COORDINATES.index(coordinate)
    return mechanism.units.factor("length" if index < 3 else "angle")
