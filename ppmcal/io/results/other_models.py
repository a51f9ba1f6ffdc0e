"""Reading back the other readings of the measurements that `diagnose` wrote beside model.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ppmcal.calibration.model_averaging import Reading, Readings
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.json import FINITE, TEXT, read_json
from ppmcal.model.mechanism import Mechanism

RECORD = "diagnosis.json"
_SHAPE = {"format": TEXT, "other_models": [{"file": TEXT, "effect": TEXT, "instead_of": TEXT,
                                            "odds": FINITE}]}


def read_other_models(model: Path, mechanism: Mechanism) -> tuple[Readings, list[str]]:
    """Return the other readings of the measurements behind a model, and the files they are in.

    Args:
        model: path of the model file; only a ``model.yaml`` beside a diagnosis.json has any.
        mechanism: the model.

    Raises:
        BadInput: the record or a file that it names cannot be read, or is of another machine.
    """
    path = model.with_name(RECORD)
    if model.name != "model.yaml" or not path.exists():
        return Readings((), None), []
    others, without, read = [], None, [str(path)]
    for entry in read_json(path, _SHAPE).get("other_models") or []:
        file, other = _read(model, entry, mechanism, path)
        read.append(file)
        if entry.get("effect"):
            odds = max(float(entry.get("odds") or 1.0), 1e-3)
            others.append(Reading(entry["effect"], entry.get("instead_of") or "", odds, other))
        else:
            without = other
    return Readings(tuple(others), without), read


def _read(model: Path, entry: dict[str, Any], mechanism: Mechanism, path: Path
          ) -> tuple[str, Mechanism]:
    name = str(entry.get("file") or "")
    if not name or Path(name).name != name:
        raise BadInput(f"names '{name}', which is no file beside it", f"{path}: other_models",
                       "Run diagnose again")
    file = model.with_name(name)
    other = read_mechanism(file)
    if [limb.name for limb in other.limbs] != [limb.name for limb in mechanism.limbs]:
        raise BadInput(f"is of another machine than {model}", str(file), "Run diagnose again")
    return str(file), other
