"""Machines that are measured twice and certified, with the files that it takes."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from helpers.commands import ppmcal
from helpers.diagnoses import CONFIGS

CIRCLE = {"circle": {"center": {"x": 500, "y": 288.675, "rz": 28}, "radius": 70, "count": 6,
                     "swing": {"rz": 4}}}
KINDS = {"3-RPR": {"poses": CIRCLE, "approach": "both", "repeats": 6, "seed": 8},
         "3-RPS": {"repeats": 2, "seed": 8}, "6-UPS": {"repeats": 2, "seed": 8},
         "delta-rotary": {"repeats": 2, "seed": 8}, "maslow": {"seed": 8}}
"""What another session of each machine is beside the scenario that comes with it."""
INSTRUMENT = {"make": "Leica AT960", "serial": "T-750123", "certificate": "D-K-2026-01",
              "calibrated": "2026-01-10", "uncertainty": 0.01, "coverage_factor": 2}
ABOUT: dict[str, Any] = {
    "format": "ppmcal/about/1", "units": {"length": "mm", "angle": "deg"}, "number": "C-2026-014",
    "machine": {"maker": "ACME", "serial": "A-0815"},
    "customer": {"name": "Customer & Sons", "country": "DE", "city": "Köln"},
    "laboratory": {"name": "Calibration Ltd", "country": "GB"}, "instrument": INSTRUMENT,
    "date": "2026-03-14", "operator": "A. Smith", "temperature": [19.5, 20.5],
    "conditions": {"humidity": "45 % to 55 %"}}


def write_about(folder: Path, name: str = "about.yaml", **more: Any) -> Path:
    """Write who certifies what; None takes a key away."""
    content = {k: v for k, v in (ABOUT | more).items() if v is not None}
    path = folder / name
    path.write_text(yaml.safe_dump(content, allow_unicode=True), encoding="utf-8")
    return path


def measure_twice(folder: Path, kind: str) -> None:
    """Write cal.csv and val.csv of one machine with its sidecars, the machine as m.yaml."""
    first = yaml.safe_load((CONFIGS / "scenarios" / f"{kind}.yaml").read_text(encoding="utf-8"))
    if kind == "maslow":
        first = {k: v for k, v in first.items() if k not in ("frame", "target")}
        first["instrument"] = {"kind": "none", "sigma": {"actuator": 0.3}}
    (folder / "m.yaml").write_bytes((CONFIGS / f"{kind}.yaml").read_bytes())
    _measured(folder, "cal", first)
    truth = json.loads((folder / "cal" / "truth.json").read_text(encoding="utf-8"))
    errors = {p["name"]: p["error"] for p in truth["errors"]} if isinstance(
        truth["errors"], list) else truth["errors"]
    _measured(folder, "val", first | KINDS[kind] | {"errors": errors})


def _measured(folder: Path, name: str, scenario: dict[str, Any]) -> None:
    (folder / f"{name}.scenario.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    ppmcal("simulate", "m.yaml", f"{name}.scenario.yaml", "--out", name, "--quiet", cwd=folder)
    for ending in ("csv", "yaml"):
        (folder / f"{name}.{ending}").write_bytes(
            (folder / name / f"measurements.{ending}").read_bytes())


def certificate(folder: Path, *more: Any, out: str = "certificate") -> dict[str, Any]:
    """Return certificate.json of a run."""
    run = ppmcal("certify", "identified", *more, "--out", out, "--quiet", cwd=folder)
    assert run.code in (0, 1), run.err
    found: dict[str, Any] = json.loads((folder / out / "certificate.json").read_text("utf-8"))
    return found


def columns(path: Path) -> dict[str, Any]:
    """Return a CSV as columns of numbers (N,)."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {k: np.array([float(r[k] or "nan") for r in rows]) for k in rows[0]}
