"""What changed between two calibrations: compare.csv, comparison.json, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from ppmcal.calibration.change_detection import Change, Comparison
from ppmcal.calibration.pose_difference import PoseDifference
from ppmcal.io import csv_text
from ppmcal.io.results.record import Finite, Part, Provenance, Record, Text, Whole
from ppmcal.io.results.units import column_factor, parameter_unit
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units
from ppmcal.wording import counted

LEFT = 0.01
"""What is left is told where chance would leave as much this rarely."""


class ParameterDifference(Part):
    """One parameter in both calibrations, in ``unit``; ``p_alone`` is bare."""

    name: Text = ""
    old: Finite | None = None
    new: Finite | None = None
    difference: Finite | None = None
    sigma: Finite | None = None
    unit: Text = ""
    p_alone: Finite | None = None
    status: Text = ""


class NamedChange(Part):
    """One change that the data name, in ``unit``; ``instead``: parameters that explain it as well.

    ``p_value`` is bare.
    """

    name: Text = ""
    value: Finite | None = None
    sigma: Finite | None = None
    unit: Text = ""
    p_value: Finite | None = None
    instead: tuple[Text, ...] = ()

    @classmethod
    def of(cls, c: Change, mechanism: Mechanism) -> NamedChange:
        """Return a change in file units."""
        f = column_factor(mechanism, c.name)
        return cls(name=c.name, value=c.value / f, sigma=c.sigma / f,
                   unit=parameter_unit(mechanism, c.name), p_value=c.p_value, instead=c.instead)


class Extent(Part):
    """Root mean square and largest size of something over poses."""

    rms: Finite | None = None
    max: Finite | None = None
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
    """comparison.json, in the units of the new machine's file.

    ``chi2``, its ``degrees`` and ``p_value``, and ``p_left`` of what is not explained, are bare.
    """

    FILE: ClassVar[str] = "comparison.json"
    FORMAT: ClassVar[str] = "ppmcal/comparison/1"

    name: Text = ""
    verdict: Text = ""
    chi2: Finite | None = None
    degrees: Whole | None = None
    p_value: Finite | None = None
    changes: tuple[NamedChange, ...] = ()
    p_left: Finite | None = None
    platform: PlatformDifference | None = None
    parameters: tuple[ParameterDifference, ...] = ()
    findings: tuple[Text, ...] = ()
    provenance: Provenance = Provenance()

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
                   provenance=Provenance.model_validate(provenance))

    def files(self) -> dict[str, str]:
        """Return file name -> text of everything that compare writes."""
        header = list(ParameterDifference.model_fields)
        return {"compare.csv": csv_text(header, [[getattr(p, h) for p in self.parameters]
                                                 for h in header]),
                self.FILE: self.text()}


def verdict_sentence(r: ComparisonRecord) -> str:
    """Return whether the machine has changed, empty where the record does not say."""
    what = {"changed": "the machine has changed", "unchanged": "nothing has changed"}.get(r.verdict)
    if not what:
        return ""
    about = f"{r.name or 'Comparison'}: {counted(len(r.parameters), 'parameter')}; {what}"
    if r.chi2 is None or r.degrees is None:
        return f"{about}."
    chance = "" if r.p_value is None else f", p = {r.p_value:.2g}"
    return f"{about} (chi-squared {r.chi2:.4g} of {r.degrees} degrees of freedom{chance})."


def remainder_sentence(r: ComparisonRecord) -> str:
    """Return what the named changes do not explain, empty where they explain all."""
    if r.verdict == "changed" and not r.changes:
        return "No single parameter explains it."
    if r.changes and r.p_left is not None and r.p_left < LEFT:
        return f"That does not explain all of it (p = {r.p_left:.2g} of the rest)."
    return ""


def platform_sentence(r: ComparisonRecord) -> str:
    """Return what the change means at the platform, empty where that is not known."""
    if r.platform is None or r.platform.position.rms is None:
        return ""
    at, turned = r.platform.position, r.platform.rotation
    most = "" if at.max is None else f" and {at.max:.4g} {at.unit} at most"
    turn = f", {turned.rms:.4g} {turned.unit} rms" if turned.rms else ""
    over = (f", over {r.platform.poses} poses of the volume measured before"
            if r.platform.poses else "")
    return (f"At the same joints the platform is {at.rms:.4g} {at.unit} rms{most} from where it "
            f"was{turn}{over}.")


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
