"""What changed between two calibrations: compare.csv and comparison.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from pydantic import Field

from ppmcal.calibration.change_detection import Change, Comparison
from ppmcal.calibration.pose_difference import PoseDifference
from ppmcal.io import csv_text
from ppmcal.io.results.record import Part, Record, Shown, Text, Whole
from ppmcal.io.results.units import column_factor, parameter_unit
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units


class ParameterDifference(Part):
    """One parameter in both calibrations, file units."""

    name: Text = ""
    old: Shown | None = None
    new: Shown | None = None
    difference: Shown | None = None
    sigma: Shown | None = None
    unit: Text = ""
    p_alone: Shown | None = None
    status: Text = ""


class NamedChange(Part):
    """One change that the data name; ``instead``: parameters that explain them as well."""

    name: Text = ""
    value: Shown | None = None
    sigma: Shown | None = None
    unit: Text = ""
    p_value: Shown | None = None
    instead: tuple[Text, ...] = ()

    @classmethod
    def of(cls, c: Change, mechanism: Mechanism) -> NamedChange:
        """Return a change in file units."""
        f = column_factor(mechanism, c.name)
        return cls(name=c.name, value=c.value / f, sigma=c.sigma / f,
                   unit=parameter_unit(mechanism, c.name), p_value=c.p_value, instead=c.instead)


class Extent(Part):
    """Root mean square and largest size of something over poses."""

    rms: Shown | None = None
    max: Shown | None = None
    unit: Text = ""


class PlatformDifference(Part):
    """How far the platform of the new machine is from the old one's, at the same joints."""

    position: Extent = Extent()
    rotation: Extent = Extent()
    poses: Whole = 0

    @classmethod
    def of(cls, m: PoseDifference, units: Units) -> PlatformDifference:
        """Return a difference of poses in file units."""
        length, angle = units.factor("length"), units.factor("angle")
        return cls(position=Extent(rms=m.position_rms / length, max=m.position_max / length,
                                   unit=units.length),
                   rotation=Extent(rms=m.rotation_rms / angle, max=m.rotation_max / angle,
                                   unit=units.angle), poses=m.poses)


class ComparisonRecord(Record):
    """comparison.json, in the units of the new machine's file."""

    FILE: ClassVar[str] = "comparison.json"
    FORMAT: ClassVar[str] = "ppmcal/comparison/1"

    name: Text = ""
    verdict: Text = ""
    chi2: Shown | None = None
    degrees: Whole | None = None
    p_value: Shown | None = None
    changes: tuple[NamedChange, ...] = ()
    p_left: Shown | None = None
    platform: PlatformDifference | None = None
    parameters: tuple[ParameterDifference, ...] = ()
    findings: tuple[Text, ...] = ()
    provenance: Mapping[str, Any] = Field(default_factory=dict)

    @classmethod
    def of(cls, found: Comparison, mechanism: Mechanism, provenance: Mapping[str, Any],
           notes: Sequence[str] = ()) -> ComparisonRecord:
        """Return the record of a comparison."""
        moved = found.pose_difference
        return cls(format=cls.FORMAT, name=mechanism.name,
                   verdict="changed" if found.changed else "unchanged", chi2=found.chi2,
                   degrees=found.freedom, p_value=found.p_value,
                   changes=tuple(NamedChange.of(c, mechanism) for c in found.changes),
                   p_left=found.p_left,
                   platform=None if moved is None else PlatformDifference.of(moved,
                                                                             mechanism.units),
                   parameters=tuple(_parameters(found, mechanism)), findings=tuple(notes),
                   provenance=dict(provenance))

    def files(self) -> dict[str, str]:
        """Return file name -> text of everything that compare writes."""
        header = list(ParameterDifference.model_fields)
        return {"compare.csv": csv_text(header, [[getattr(p, h) for p in self.parameters]
                                                 for h in header]),
                self.FILE: self.text()}


def _parameters(found: Comparison, mechanism: Mechanism) -> list[ParameterDifference]:
    changed = {c.name for c in found.changes}
    instead = {n for c in found.changes for n in c.instead}
    out = []
    for i, name in enumerate(found.names):
        f = column_factor(mechanism, name)
        out.append(ParameterDifference(
            name=name, old=float(found.old[i]) / f, new=float(found.new[i]) / f,
            difference=float(found.new[i] - found.old[i]) / f, sigma=float(found.sigma[i]) / f,
            unit=parameter_unit(mechanism, name), p_alone=float(found.alone[i]),
            status="changed" if name in changed else
            "possible" if name in instead else "unchanged"))
    return out
