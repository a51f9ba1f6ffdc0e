"""compare.csv and comparison.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ppmcal.calibration.change_detection import Change, Comparison
from ppmcal.io import csv_text, json_text
from ppmcal.io.results.units import column_factor, parameter_unit
from ppmcal.model.mechanism import Mechanism


def files(found: Comparison, mechanism: Mechanism, provenance: Mapping[str, Any],
          notes: Sequence[str] = ()) -> dict[str, str]:
    """Return file name -> text of everything that compare writes."""
    rows = entries(found, mechanism)
    header = list(rows[0]) if rows else []
    return {"compare.csv": csv_text(header, [[r[h] for r in rows] for h in header]),
            "comparison.json": json_text(summary(found, mechanism, provenance,
                                                  notes))}


def entries(found: Comparison, mechanism: Mechanism) -> list[dict[str, Any]]:
    """Return one entry per parameter, file units."""
    changed = {c.name for c in found.changes}
    instead = {n for c in found.changes for n in c.instead}
    out = []
    for i, name in enumerate(found.names):
        f = column_factor(mechanism, name)
        out.append({"name": name, "old": float(found.old[i]) / f, "new": float(found.new[i]) / f,
                    "difference": float(found.new[i] - found.old[i]) / f,
                    "sigma": float(found.sigma[i]) / f, "unit": parameter_unit(mechanism, name),
                    "p_alone": float(found.alone[i]),
                    "status": "changed" if name in changed else
                    "possible" if name in instead else "unchanged"})
    return out


def change(c: Change, mechanism: Mechanism) -> dict[str, Any]:
    """Return one named change, file units."""
    f = column_factor(mechanism, c.name)
    return {"name": c.name, "value": c.value / f, "sigma": c.sigma / f,
            "unit": parameter_unit(mechanism, c.name), "p_value": c.p_value, "instead": c.instead}


def summary(found: Comparison, mechanism: Mechanism, provenance: Mapping[str, Any],
            notes: Sequence[str] = ()) -> dict[str, Any]:
    """Return the content of comparison.json, file units."""
    units, moved = mechanism.units, None
    if found.pose_difference is not None:
        m, length, angle = found.pose_difference, units.factor("length"), units.factor("angle")
        moved = {"position": {"rms": m.position_rms / length, "max": m.position_max / length,
                              "unit": units.length},
                 "rotation": {"rms": m.rotation_rms / angle, "max": m.rotation_max / angle,
                              "unit": units.angle}, "poses": m.poses}
    return {"format": "ppmcal/comparison/1", "name": mechanism.name,
            "verdict": "changed" if found.changed else "unchanged",
            "chi2": found.chi2, "degrees": found.freedom, "p_value": found.p_value,
            "changes": [change(c, mechanism) for c in found.changes], "p_left": found.p_left,
            "platform": moved, "parameters": entries(found, mechanism),
            "findings": list(notes), "provenance": dict(provenance)}
