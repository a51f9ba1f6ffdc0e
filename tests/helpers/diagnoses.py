"""What tests of several packages share: diagnoses."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import yaml

from helpers.commands import (
    Run,
    columns,
    pick,
    ppmcal,
)
from helpers.paths import ROOT

CONFIGS = ROOT / "configs"

BOXES: dict[str, Any] = {
    "3-RPR": {"center": {"x": 500, "y": 288.675, "rz": 30},
              "half_range": {"x": 60, "y": 60, "rz": 8}},
    "3-RPS": {"center": {"z": 100, "rx": 0, "ry": 0}, "half_range": {"z": 12, "rx": 8, "ry": 8}},
    "6-UPS": {"center": {"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0},
              "half_range": {"x": 200, "y": 200, "z": 150, "rx": 6, "ry": 6, "rz": 6}}}

STATION: dict[str, Any] = {
    "3-RPR": {"frame": {"x": 4, "y": -3, "rz": 1}, "target": [3, -2]},
    "3-RPS": {},
    "6-UPS": {"frame": {"x": 4, "y": -3, "z": 2, "rx": 0.2, "ry": -0.1, "rz": 1},
              "target": [3, -2, 5]}}

ALL: dict[str, Any] = {"payload": [0, 15, 30], "temperature": {"mean": 24, "swing": 6},
                       "velocity": 30}

DATA = "s/measurements.csv"

def effect(kind: str, on: list[str] | None = None, **parameters: float) -> dict[str, Any]:
    return {"kind": kind, "parameters": parameters} | ({"on": on} if on else {})


BACKLASH = effect("backlash", ["leg3"], width=0.03)

SQUEEZED = effect("compliance", stiffness=8000.0)

WARM = effect("leg_thermal", expansion=11e-6)

def simulate(folder: Path, name: str, effects: list[dict[str, Any]], count: int = 24,
             out: str = "s", free: list[str] | None = None, **changes: Any) -> Path:
    """Write a machine and a scenario and simulate it into ``out``; the machine has no effect."""
    machine = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    (folder / "m.yaml").write_text(yaml.safe_dump(machine | ({"free": free} if free else {}),
                                                  sort_keys=False))
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": BOXES[name] | {"count": count}}, "effects": effects,
                "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
                "approach": "both", "conditions": ALL, "errors": {"random": {"scale": 1.0}},
                "seed": 4} | STATION[name] | changes
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", out, cwd=folder, expect=0)
    return folder


def drop(folder: Path, *starts: str) -> None:
    """Take columns out of the measurements as if they had not been recorded."""
    names = [c for c in columns(folder / DATA) if not c.startswith(starts)]
    pick(folder / DATA, names, folder / DATA)


def found_in(folder: Path, out: str = "d") -> dict[str, Any]:
    return dict(json.loads((folder / out / "diagnosis.json").read_text()))


def diagnose(folder: Path, *args: str, out: str = "d") -> tuple[Run, dict[str, Any]]:
    """Run on s/; the exit code has to go with the verdict."""
    run = ppmcal("diagnose", "m.yaml", *(args or (DATA,)), "--out", out,
                 cwd=folder)
    assert run.code in (0, 1), run.err
    found = found_in(folder, out)
    findings = re.search(r"^! ", run.out, re.MULTILINE)     # notes among them leave the code
    clean = found["verdict"] in ("none", "named") and not findings
    assert run.code == (0 if clean else 1)
    return run, found


def named(found: dict[str, Any]) -> dict[str, set[str]]:
    """Return kind -> actuators over all named effects."""
    out: dict[str, set[str]] = {}
    for e in found["effects"]:
        out.setdefault(e["kind"], set()).update(e["on"])
    return out


def value(found: dict[str, Any], kind: str, name: str) -> dict[str, Any]:
    return dict(next(e for e in found["effects"] if e["kind"] == kind)["parameters"][name])
