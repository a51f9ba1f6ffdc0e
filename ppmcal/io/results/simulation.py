"""measurements.csv, measurements.yaml, truth.json, and that truth against identified errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import yaml

from ppmcal.codec import unsaid
from ppmcal.io.csv import csv_lines
from ppmcal.io.effects import effects_tree
from ppmcal.io.results.identification_parts import ParameterEstimate
from ppmcal.io.results.record import Record, Shown, Text, Whole
from ppmcal.io.results.tables import finite_number, joint_columns
from ppmcal.io.yaml import printable
from ppmcal.linalg import Array
from ppmcal.model.dataset import ZERO_CELSIUS
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.simulation.scenario import Scenario
from ppmcal.simulation.simulate import Campaign
from ppmcal.store.output import Content
from ppmcal.store.provenance import Provenance
from ppmcal.units import ANGLES, LENGTHS, Angle, ByCoordinate, Length, Units
from ppmcal.wording import abbreviate_list


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
                          units=units, provenance=provenance)


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


PER_UNIT = "/unit"
"""Ends the unit of a drive's ratio."""
SAME = 1e-9
"""Nominal values are the same where they differ by less than this part of them."""
NOT_THERE = "not in the simulated machine, so there is nothing to compare"
OTHER_UNITS = "units do not match and are left out"
NEAR, FAR = 2.0, 4.0
"""Deviations beyond the first, in sigma, are counted; one beyond the second needs a look."""
BEYOND_NEAR = 0.0455
"""So large a part of normal deviates is beyond 2 sigma."""


@dataclass(frozen=True)
class TrueParameter:
    """What a truth file says of a parameter, in its units; None where it does not."""

    error: float | None
    value: float | None = None

    @property
    def nominal(self) -> float | None:
        """The simulated machine's nominal value."""
        return None if self.value is None or self.error is None else self.value - self.error


@dataclass(frozen=True)
class TruthRow:
    """One parameter: error put in, error found, in ``unit``; z = (found - true)/sigma.

    ``half``: of the 95 % interval, None without one.

    Of what has no nominal value, the values.
    """

    name: str
    unit: str
    true: float
    found: float
    sigma: float | None
    status: str
    half: float | None = None

    @property
    def difference(self) -> float:
        """Found minus true."""
        return self.found - self.true

    @property
    def z(self) -> float | None:
        """Deviation in standard deviations, None without a sigma."""
        if self.sigma is None or not self.sigma > 0.0:
            return None
        return self.difference / self.sigma


@dataclass(frozen=True)
class ComparedMachines:
    """Simulated truth against what was identified; ``note`` says what is left out.

    ``other``: parameters whose nominal values are not those of the simulated machine.
    """

    truth: str
    identified: str
    rows: tuple[TruthRow, ...]
    note: str = ""
    other: tuple[str, ...] = ()

    @property
    def z(self) -> Array:
        """Deviations of those parameters that have a sigma."""
        return np.array([r.z for r in self.rows if r.z is not None])

    def beyond(self, sigmas: float) -> list[str]:
        """Return the parameters that are more than so many sigma off, farthest first."""
        return [r.name for r in sorted(self.rows, key=lambda r: -abs(r.z or 0.0))
                if r.z is not None and abs(r.z) > sigmas]


def compared(truth: TruthRecord, parameters: Sequence[ParameterEstimate], folders: tuple[str, str]
             ) -> ComparedMachines:
    """Return the errors put in and found, against the nominal values of the model identified.

    A model with other nominal values than the simulated machine's is another machine: its true
    errors are those that its own nominal values have, and it is named.

    Args:
        truth: of the simulation.
        parameters: of the identification.
        folders: of both.
    """
    rows, other, lacking = list[TruthRow](), list[str](), dict[str, list[str]]()
    for p in parameters:
        known = _known(p.name, truth)
        # what has no nominal value, an effect's stiffness, is compared itself
        found = p.value if p.error is None and p.nominal is None else p.error
        if found is None or (known is None and p.status == "fixed"):
            continue
        factor = None if known is None else _factor(_same_quantity(p.unit, truth.units), p.unit)
        if known is None or factor is None:
            lacking.setdefault(NOT_THERE if known is None else OTHER_UNITS, []).append(p.name)
            continue
        true, differs = _true_error(p, known, factor)
        if differs:
            other.append(p.name)
        if p.status != "fixed" or true != 0.0:
            rows.append(TruthRow(p.name, p.unit, true, found, p.sigma, p.status, p.half))
    note = [f"{what[0].upper()}{what[1:]}: {abbreviate_list(names)}." for what,
            names in lacking.items()]
    return ComparedMachines(*folders, tuple(rows), " ".join(note), tuple(other))


def _known(name: str, truth: TruthRecord) -> TrueParameter | None:
    """Return what is true of a parameter, None where the simulated machine has none such."""
    value, error = (finite_number(values.get(name)) for values in (truth.parameters, truth.errors))
    if value is not None:
        return TrueParameter(error or 0.0, value)
    if name in truth.errors or not truth.parameters:    # a file of errors alone
        return TrueParameter(error or 0.0) if truth.errors else None
    found = list(_of_effect(name, truth))
    return TrueParameter(None, found[0]) if len(found) == 1 else None


def _of_effect(name: str, truth: TruthRecord) -> Iterator[float]:
    """Yield the values of ``kind.place.what`` in the simulated effects that hold there."""
    kind, _, rest = name.partition(".")
    place, _, what = rest.rpartition(".")
    for effect in truth.effects:
        on, values = effect.get("on"), effect.get("parameters")
        here = not on or (isinstance(on, list) and bool(place) and set(place.split("+")) <= set(on))
        if effect.get("kind") == kind and here and isinstance(values, dict):
            entry = values.get(what)
            value = finite_number(entry.get("value") if isinstance(entry, dict) else entry)
            if value is not None:
                yield value


def _true_error(p: ParameterEstimate, known: TrueParameter, factor: float) -> tuple[float, bool]:
    """Return the true error against the model's own nominal value, and whether that is another."""
    nominal = 0.0 if p.nominal is None else p.nominal
    if known.error is None or (p.error is None and known.value is not None):
        return (known.value or 0.0) * factor - nominal, False
    away = 0.0 if known.nominal is None or p.nominal is None else known.nominal * factor - nominal
    if p.unit in ANGLES:    # 348 degrees is -12
        away = math.remainder(away, math.tau / ANGLES[p.unit])
    differs = abs(away) > SAME * max(abs(nominal), abs(p.tolerance or 0.0), abs(p.error or 0.0))
    return known.error * factor + (away if differs else 0.0), differs


def _same_quantity(unit: str, units: Units) -> str:
    """Return the truth file's unit of the quantity that ``unit`` measures (``mm``, ``mm/unit``)."""
    bare = unit.removesuffix(PER_UNIT)
    quantity = "length" if bare in LENGTHS else "angle" if bare in ANGLES else ""
    own = units.name(quantity) if quantity else ""
    return own + unit.removeprefix(bare) if own else ""


def _factor(of: str, to: str) -> float | None:
    """Return what turns a number in ``of`` into one in ``to``; None if they do not match."""
    if of == to or not of or not to:
        return 1.0
    if of.endswith(PER_UNIT) != to.endswith(PER_UNIT):
        return None
    of, to = of.removesuffix(PER_UNIT), to.removesuffix(PER_UNIT)
    for table in (LENGTHS, ANGLES):
        if of in table and to in table:
            return table[of] / table[to]
    return None
