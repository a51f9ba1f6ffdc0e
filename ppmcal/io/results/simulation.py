"""measurements.csv, measurements.yaml and truth.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, ClassVar

import numpy as np
import yaml

from ppmcal.codec import unsaid
from ppmcal.io.csv_writer import csv_lines
from ppmcal.io.effects import effects_tree
from ppmcal.io.results.record import Record, Shown, Text, Whole
from ppmcal.io.results.tables import joint_columns
from ppmcal.io.yaml import printable
from ppmcal.model.dataset import ZERO_CELSIUS
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.simulation.scenario import Scenario
from ppmcal.simulation.simulate import Campaign
from ppmcal.store.output import Content
from ppmcal.store.provenance import Provenance
from ppmcal.units import Angle, ByCoordinate, Length, Units


class TruthRecord(Record):
    """truth.json, in ``units``: what was simulated, for a calibration to find.

    ``errors``: parameter -> true minus nominal, where they differ; ``parameters`` -> true value;
    ``frame``, ``target``, ``target_rotation``: where the instrument stood; ``targets``: the points
    of several targets, by name; ``outliers``: CSV
    rows; ``effects``: as in a mechanism file; ``left_out``: poses that could not be reached.
    """

    FILE: ClassVar[str] = "truth.json"
    FORMAT: ClassVar[str] = "ppmcal/truth/1"

    errors: Mapping[Text, Shown] = field(default_factory=dict)
    parameters: Mapping[Text, Shown] = field(default_factory=dict)
    frame: ByCoordinate[Mapping[Text, Shown]] = field(default_factory=dict)
    target: Length[tuple[Shown, ...]] = ()
    targets: Length[Mapping[Text, tuple[Shown, ...]]] = field(default_factory=dict)
    target_rotation: Angle[tuple[Shown, ...]] = ()
    outliers: tuple[Whole, ...] = ()
    effects: tuple[Mapping[str, Any], ...] = ()
    left_out: tuple[Text, ...] = ()
    units: Units = unsaid(Units)
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, mechanism: Mechanism, scenario: Scenario, campaign: Campaign,
           provenance: Mapping[str, Any]) -> TruthRecord:
        """Return the record of a campaign."""
        units = mechanism.units
        errors, values = {}, {}
        count = len(mechanism.parameters)
        for p, true, nominal in zip(mechanism.parameters, campaign.g[:count].tolist(),
                                    mechanism.nominals.tolist(), strict=True):
            f = units.factor(p.quantity)
            values[p.name] = true / f
            if true != nominal:
                errors[p.name] = (true - nominal) / f
        places: dict[str, Any] = {"targets": scenario.targets} if scenario.targets else {
            "target": scenario.target}
        return cls.filled(None, units, format=cls.FORMAT, errors=errors, parameters=values,
                          frame=dict(zip(POSE_COORDINATES, scenario.frame, strict=True)),
                          **places, target_rotation=scenario.target_rotation,
                          outliers=np.flatnonzero(campaign.outlier) + 1,
                          effects=effects_tree(campaign.with_effects), left_out=campaign.left_out,
                          units=units, provenance=Provenance(**provenance))


def files(mechanism: Mechanism, scenario: Scenario, campaign: Campaign, name: str,
          provenance: Mapping[str, Any]) -> dict[str, Content]:
    """Return file name -> text of everything that simulate writes, in the machine's units."""
    units = mechanism.units
    header: dict[str, Any] = {"pose": campaign.pose}
    header |= joint_columns(mechanism, campaign.q, "q_{}")
    if campaign.to_q is not None:
        header |= joint_columns(mechanism, campaign.to_q, "to_q_{}")
    if scenario.kind.scalar:
        header[scenario.kind.number] = campaign.value / units.factor(scenario.kind.quantity)
    else:
        seen = campaign.targets or {"": (campaign.position, campaign.rotation)}
        for target, (position, rotation) in seen.items():
            for c, column in zip(scenario.kind.coordinates(mechanism.motion),
                                 scenario.kind.columns(mechanism.motion), strict=True):
                part = position[:, c] if c < 3 else rotation[:, c - 3]
                header[f"{target}_{column}" if target else column] = part / units.factor(
                    "length" if c < 3 else "angle")
    header |= {f"dir_{a}": campaign.direction[:, i].astype(int)
               for i, a in enumerate(mechanism.actuators)}
    if campaign.velocity is not None:
        header |= joint_columns(mechanism, campaign.velocity, "vel_{}")
    if campaign.tension is not None:
        header |= {f"tension_{a}": column for a, column in zip(
            mechanism.actuators, campaign.tension.T, strict=True) if np.isfinite(column).any()}
    if campaign.payload is not None:
        header["payload"] = campaign.payload
    if campaign.temperature is not None:
        header["temperature"] = campaign.temperature - ZERO_CELSIUS
    header["time"] = campaign.time
    return {"measurements.csv": csv_lines(list(header), list(header.values())),
            "measurements.yaml": sidecar(mechanism, scenario, name),
            TruthRecord.FILE: TruthRecord.of(mechanism, scenario, campaign, provenance).text()}


def sidecar(mechanism: Mechanism, scenario: Scenario, name: str) -> str:
    """Return measurements.yaml: what a user would know, not what is true."""
    units = mechanism.units
    length, angle = units.factor("length"), units.factor("angle")
    kind = scenario.kind
    sigma: dict[str, Any] = {} if kind.blind or not kind.of_poses else {
        "position": _sigma(scenario.sigma_position, length)}
    if kind.scalar:
        sigma = {kind.sigma: _sigma(scenario.sigma_value, units.factor(kind.quantity))}
    if scenario.tracker is not None:
        sigma = {"range": _sigma(scenario.tracker[0], length),
                 "angle": _sigma(scenario.tracker[1], angle)}
    if kind.sees_rotation or kind.of_turn is not None:
        sigma["rotation"] = _sigma(scenario.sigma_rotation, angle)
    if np.any(scenario.sigma_actuator > 0.0):
        shown = joint_columns(mechanism, scenario.sigma_actuator[None], "{}")
        sigma["actuator"] = {k: float(v[0]) for k, v in shown.items()}
    content: dict[str, Any] = {
        "format": "ppmcal/dataset/1", "name": printable(name),
        "units": {"length": units.length, "angle": units.angle},
        "instrument": {"kind": kind.name, "sigma": sigma} | _point(scenario, length) | (
            {"at": kind.at} if kind.at else {}) | (
            {"station": (scenario.station / length).tolist()} if scenario.tracker else {}),
        "frame": "known" if scenario.frame_known or scenario.pairs else "unknown",
        **({"targets": dict.fromkeys(scenario.targets, "unknown")} if scenario.targets else {
            "target": "known" if scenario.target_known else "unknown"}),
        "target_rotation": "known" if scenario.target_rotation_known else "unknown",
        "approach": "columns"}
    return str(yaml.safe_dump(content, sort_keys=False))


def _point(scenario: Scenario, length: float) -> dict[str, Any]:
    """Return the fixed point of a distance instrument."""
    if not scenario.kind.along_line or scenario.pairs:
        return {}
    return {"point": (scenario.point / length).tolist() if scenario.point_known else "unknown"}


def _sigma(value: float, factor: float) -> float:
    """A sidecar's sigma must be above 0: without noise it says how exact the numbers are."""
    return value / factor if value > 0.0 else 1e-9 / factor
