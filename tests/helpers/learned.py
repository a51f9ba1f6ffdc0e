"""Campaigns of a machine with functions that no library knows, to be learned."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import ppmcal as face
from helpers.diagnoses import BOXES, CONFIGS, STATION
from ppmcal.calibration.fit.fit_result import Fit, FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.diagnosis.learning import Learned, Term, learned, term
from ppmcal.diagnosis.observed_directions import observed_motion
from ppmcal.diagnosis.question import at_nominal
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.diagnosis.term_candidates import Visible, all_settings, forms
from ppmcal.errors import NoResult
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.linalg import Array, without_range
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

ROBUST = FitOptions()
WEATHER = {"velocity": 30, "payload": [0, 20], "temperature": {"mean": 21, "swing": 9}}


def hidden(input_: str, x: Array, y: Array, **more: Any) -> dict[str, Any]:
    """Return an effect of the simulator that is any function, known without error."""
    return {"kind": "learned", "input": input_, "nodes": x.tolist(), "values": y.tolist(),
            "covariance": np.zeros((x.size, x.size)).tolist()} | more


def dip(at: float = 440.0, wide: float = 18.0, deep: float = 0.05) -> dict[str, Any]:
    """A worn place of one leg's screw."""
    x = np.linspace(250.0, 650.0, 161)
    return hidden("travel", x, -deep * np.exp(-(((x - at) / wide) ** 2)), on=["leg2"])


def squared(size: float = 0.02) -> dict[str, Any]:
    """An error of all joints with the square of speed."""
    x = np.linspace(-40.0, 40.0, 41)
    return hidden("velocity", x, size * (x / 30.0) ** 2)


def warped(size: float = -0.004) -> dict[str, Any]:
    """An error of leg2 with the square of its travel, per 100 mm, and 10 K away from 20 C."""
    x, by = np.linspace(250.0, 650.0, 41), np.linspace(5.0, 35.0, 7)
    value = size * (x[:, None] / 100.0) ** 2 * (by - 20.0) / 10.0
    return {"kind": "learned", "on": ["leg2"], "input": "travel", "nodes": x.tolist(),
            "by": "temperature", "by_nodes": by.tolist(), "values": value.tolist(),
            "covariance": np.zeros((value.size, value.size)).tolist()}


def campaign(folder: Path, effects: list[dict[str, Any]], seed: int, count: int = 40,
             out: str = "s", **changes: Any) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Return a machine and measurements of it with effects that the machine's file has not."""
    name = "3-RPR"
    machine = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    (folder / "m.yaml").write_text(yaml.safe_dump(machine, sort_keys=False))
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": BOXES[name] | {"count": count}}, "effects": effects,
                "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
                "approach": "both", "conditions": {"velocity": 30, "payload": [0, 20]},
                "errors": {"random": {"scale": 1.0}}, "seed": seed} | STATION[name] | changes
    (folder / f"{out}.yaml").write_text(yaml.safe_dump(scenario))
    result = face.simulate(str(folder / "m.yaml"), str(folder / f"{out}.yaml"))
    result.save(folder / out)
    mechanism = read_mechanism(folder / "m.yaml")
    return mechanism, read_campaign([folder / out / "measurements.csv"], mechanism)


def terms(fit: Fit, seen: Visible) -> list[Term]:
    """Return the terms that rows could tell."""
    motion, out = observed_motion(seen.system), list[Term]()
    for curve, on in forms(seen, all_settings(fit)):
        with suppress(NoResult):
            out.append(term(seen, motion, curve, on))
    return out


def learned_of(seen: Visible, own: Term, values: Array) -> Learned:
    """Return one term learned of rows of the nominal machine that have white values (n,)."""
    return learned(with_values(seen, values), [(own.curve, own.on)])


def with_values(seen: Visible, values: Array) -> Visible:
    """Return rows of the nominal machine that have other values (N m,), white."""
    system = seen.system
    away = at_nominal(system)[0] - system.residual.reshape(-1)
    return replace(seen, left=without_range(values, seen.basis), system=replace(
        system, residual=(values - away).reshape(system.residual.shape)))


def diagnosed(mechanism: Mechanism, data: tuple[Dataset, ...], seed: int = 0) -> Diagnosis:
    """Return the diagnosis of a campaign."""
    return diagnose(Problem(mechanism, data, mechanism.free), DiagnosisOptions(seed=seed))


def fitted(mechanism: Mechanism, data: tuple[Dataset, ...]) -> Fit:
    return identify(Problem(mechanism, data, mechanism.free), ROBUST)
