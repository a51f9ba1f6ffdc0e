"""What changed between two calibrations: compare.csv, comparison.json, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from ppmcal.calibration.fit import half_or
from ppmcal.calibration.sessions import Change, Comparison, PoseDifference
from ppmcal.inference.priors import SURE
from ppmcal.io import csv_text
from ppmcal.io.results.parts import ErrorSize, UncertainValue
from ppmcal.io.results.record import Finite, Flag, Part, Record, Text, Whole
from ppmcal.io.results.tables import WrittenTable, finite_number
from ppmcal.io.results.units import MachineUnits
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.provenance import Provenance
from ppmcal.units import COLUMN, Key, OfUnit
from ppmcal.wording import abbreviate_list, percent, pluralize

SHOWN = 4
FITS_DIFFER = 2.5
"""Two fits differ otherwise than a change says where they do by so many standard deviations."""
ALIKE, HIDING = 0.3, 1.3
"""Misfit that is alike, and noise over the stated one, are reported from so much on."""
NOT_COMPARED = "not compared"
COMPARE_TABLE = WrittenTable("compare.csv", lambda name: name not in ("name", "unit", "status"))


class ParameterDifference(Part):
    """One parameter in both calibrations, in ``unit``; ``p_alone`` is bare.

    ``difference`` is that of the two fits, in which parameters stand in for each other;
    ``explained`` is what the named changes say of it; ``half``: of its 95 % interval, the size of
    the noise not being known exactly.
    """

    name: Text = ""
    old: OfUnit[Finite | None] = None
    new: OfUnit[Finite | None] = None
    difference: OfUnit[Finite | None] = None
    sigma: OfUnit[Finite | None] = None
    unit: Text = ""
    p_alone: Finite | None = None
    status: Text = ""
    explained: OfUnit[Finite | None] = None
    half: OfUnit[Finite | None] = None

    @property
    def wide(self) -> float | None:
        """Half of the 95 % interval of the difference, None without one."""
        return half_or(self.half, self.sigma)

    @property
    def in_sigmas(self) -> float | None:
        """The difference over its sigma, None where it is not known or beyond reason."""
        if self.difference is None or self.sigma is None or not self.sigma > 0.0:
            return None
        return finite_number(self.difference / self.sigma)

    @property
    def wide_in_sigmas(self) -> float:
        """Half of the 95 % interval over sigma."""
        return (self.wide or 0.0) / (self.sigma or 1.0)


class NamedChange(Part):
    """One change that the data name, in ``unit``; ``instead``: what explains it as well.

    ``half``: of its 95 % interval. ``probability`` is bare. A change of several numbers has them in
    ``parts``, and none itself.
    """

    name: Text = ""
    value: Finite | None = None
    sigma: Finite | None = None
    unit: Text = ""
    probability: Finite | None = None
    instead: tuple[Text, ...] = ()
    parts: tuple[UncertainValue, ...] = ()
    half: Finite | None = None

    @classmethod
    def of(cls, c: Change, mechanism: Mechanism, times: float) -> NamedChange:
        """Return a change in file units; ``times``: sigmas to an end of the 95 % interval."""
        parts = [UncertainValue.filled(p, MachineUnits.of(mechanism), unit=COLUMN + p.column,
                                     half=times * p.sigma) for p in c.parts]
        if len(parts) == 1:
            return cls.filled(parts[0], name=c.name, probability=c.probability, instead=c.instead)
        return cls.filled(c, parts=parts)

    @property
    def numbers(self) -> tuple[UncertainValue, ...]:
        """The numbers of the change, of one number without a name."""
        return self.parts or (UncertainValue(value=self.value, sigma=self.sigma, unit=self.unit,
                                           half=self.half),)


class ComparisonRecord(Record):
    """comparison.json, in the units of the new machine's file.

    ``chi2``, its ``degrees`` and ``p_value`` are bare, and decide nothing; so are the probabilities
    that ``nothing`` has changed, and that something ``unlisted`` has.
    ``noise_old``, ``noise_new``: of the data over the stated ones, bare; ``alike``: which part of
    the residuals' square comes back at the same poses, bare too.
    ``moved``, ``turned``: how far the platform of the new machine is from the old one's, at the
    same joints; of ``over_poses``.
    ``fitted_anew``: parameters that only one of the two had free, and both have here.
    ``again``: whether both were fitted to their measurements again, from one point.
    ``verdict``: ``changed``, ``unchanged``, or ``not compared`` for the reason ``why_not``, without
    any of these.
    """

    FILE: ClassVar[str] = "comparison.json"
    FORMAT: ClassVar[str] = "ppmcal/comparison/1"

    name: Text = ""
    verdict: Text = ""
    why_not: Text = ""
    fitted_anew: tuple[Text, ...] = ()
    again: bool = False
    chi2: Finite | None = None
    degrees: Whole | None = None
    p_value: Finite | None = None
    nothing: Finite | None = None
    changes: tuple[NamedChange, ...] = ()
    unlisted: Finite | None = None
    moved: Annotated[ErrorSize | None, Key("platform.position", whole=True)] = None
    turned: Annotated[ErrorSize, Key("platform.rotation")] = ErrorSize()
    over_poses: Annotated[Whole, Key("platform.poses")] = 0
    noise_old: Annotated[Finite | None, Key("noise.old")] = None
    noise_new: Annotated[Finite | None, Key("noise.new")] = None
    alike: Annotated[Finite | None, Key("noise.alike")] = None
    same_poses: Annotated[Flag, Key("noise.same_poses")] = False
    parameters: tuple[ParameterDifference, ...] = ()
    findings: tuple[Text, ...] = ()
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, found: Comparison, mechanism: Mechanism, provenance: Mapping[str, Any],
           notes: Sequence[str] = (), anew: Sequence[str] = (), *, again: bool = False
           ) -> ComparisonRecord:
        """Return the record of a comparison; ``anew``: ``fitted_anew``."""
        own: dict[str, Any] = {"format": cls.FORMAT, "name": mechanism.name,
                               "findings": tuple(notes), "provenance": provenance}
        if found.why_not:
            return cls(**own, verdict=NOT_COMPARED, why_not=found.why_not)
        return cls(**own, verdict="changed" if found.changed else "unchanged", chi2=found.chi2,
                   degrees=found.freedom, p_value=found.p_value, nothing=found.nothing,
                   changes=tuple(NamedChange.of(c, mechanism, found.coverage)
                                 for c in found.changes), unlisted=found.unlisted,
                   **_moved(found.pose_difference, mechanism),
                   noise_old=found.noise.old, noise_new=found.noise.new,
                   alike=1.0 - found.noise.share**2, same_poses=found.noise.same,
                   parameters=tuple(_parameters(found, mechanism)), fitted_anew=tuple(anew),
                   again=again)

    def files(self) -> dict[str, str]:
        """Return file name -> text of everything that compare writes."""
        header = [f.name for f in fields(ParameterDifference)]
        return {COMPARE_TABLE.file: csv_text(header, [[getattr(p, h) for p in self.parameters]
                                                 for h in header]),
                self.FILE: self.text()}


def verdict_sentence(r: ComparisonRecord) -> str:
    """Return whether the machine has changed, empty where the record does not say."""
    if r.verdict == NOT_COMPARED:
        return (f"{r.name or 'Comparison'}: whether the machine has changed cannot be told: "
                f"{r.why_not}.")
    what = {"changed": "the machine has changed", "unchanged": "nothing has changed"}.get(r.verdict)
    if not what:
        return ""
    about = f"{r.name or 'Comparison'}: {pluralize(len(r.parameters), 'parameter')}; {what}"
    if r.chi2 is None or r.degrees is None:
        return f"{about}."
    chance = "" if r.p_value is None else f", p = {r.p_value:.2g}"
    sure = "" if r.nothing is None else f"; probability of no change {r.nothing:.2g}"
    return f"{about} (chi-squared {r.chi2:.4g} of {r.degrees} degrees of freedom{chance}{sure})."


def _anew(r: ComparisonRecord) -> str:
    """Return what both were fitted anew with, empty where they are compared as they were."""
    if not r.fitted_anew:
        return ("Both were fitted to their measurements again, from one point; values are of those "
                "fits." if r.again else "")
    return (f"Only one of the two had these free: {', '.join(r.fitted_anew)}. Both were fitted to "
            "their measurements again with these free; values are of those fits.")


def _remainder(r: ComparisonRecord) -> str:
    """Return what the named changes do not explain, empty where they explain all."""
    if r.verdict == "changed" and not r.changes:
        return "Nothing by itself explains it."
    if r.changes and (r.unlisted or 0.0) > float(SURE):
        return (f"That does not explain all of it: something that is not listed has changed too "
                f"(probability {r.unlisted:.3g}).")
    return ""


def about_changes(r: ComparisonRecord) -> list[str]:
    """Return what else is to be said of the changes: what they leave, what hides or shares them."""
    return [s for s in (_remainder(r), _apart(r), noise_sentence(r), _anew(r)) if s]


def change_sentence(c: NamedChange) -> str:
    """Return what changed, by how much, and what explains it as well."""
    numbers = ", ".join(f"{n.name} {n.value or 0.0:+.4g} +- {n.wide or 0.0:.2g} {n.unit}"
                        .strip() for n in c.numbers)
    about = f"{c.name}: {numbers} (95 %)" if c.parts else f"{c.name} changed by {numbers} (95 %)"
    more = " or others" if len(c.instead) > SHOWN else ""
    return about + (f"; as likely: {', '.join(c.instead[:SHOWN])}{more}." if c.instead else ".")


def _apart(r: ComparisonRecord) -> str:
    """Return where the two fits differ otherwise than the named changes say, empty if nowhere.

    Parameters that trade with each other share a change among them in each fit as noise and
    tolerances would have it, so that a changed one can differ little, and others more.
    """
    if not r.changes:
        return ""
    odd = [p for p in r.parameters if p.difference is not None and p.sigma
           and (abs(p.difference - (p.explained or 0.0)) > FITS_DIFFER * p.sigma
                or abs(p.difference - (p.explained or 0.0)) > 0.5 * abs(p.explained or np.inf))]
    if not odd:
        return ""
    return ("Each fit by itself shares the change out among parameters that act alike: the two "
            f"differ otherwise in {abbreviate_list([p.name for p in odd])}. What changed is what "
            "all data say together.")


def noise_sentence(r: ComparisonRecord) -> str:
    """Return what hides changes: misfit beyond the noise, and whether it is alike in both."""
    if r.noise_old is None or r.noise_new is None or r.alike is None:
        return ""
    parts = []
    if r.alike > ALIKE:
        parts.append(f"{percent(r.alike)} of the model's error is common to both, so it is "
                     "not a change.")
    times = [f"{v:.3g} times what the files state in the {label} calibration"
             for label, v in (("old", r.noise_old), ("new", r.noise_new)) if v > HIDING]
    if times:
        parts.append("After the fit the residuals scatter " + " and ".join(times)
                     + ": noise, or model error. The test and every +- "
                     "here allow for it" + ("." if r.same_poses else
                                        "; at the same poses in both, smaller changes would show."))
    return " ".join(parts)


def platform_sentence(r: ComparisonRecord) -> str:
    """Return what the change means at the platform, empty where that is not known."""
    at, turned = r.moved, r.turned
    if at is None or at.rms is None:
        return ""
    most = "" if at.max is None else f" and {at.max:.4g} {at.unit} at most"
    turn = f", {turned.rms:.4g} {turned.unit} rms" if turned.rms else ""
    over = (f", over {r.over_poses} poses of the volume measured before" if r.over_poses else "")
    chance = ("" if at.by_chance is None else f" Noise alone would make {at.by_chance:.4g} "
              f"{at.unit} rms of it" + (f" and {turned.by_chance:.4g} {turned.unit}."
                                        if turn and turned.by_chance is not None else "."))
    return (f"At the same joints the platform is {at.rms:.4g} {at.unit} rms{most} from where it "
            f"was{turn}{over}.{chance}")


def _moved(m: PoseDifference | None, mechanism: Mechanism) -> dict[str, Any]:
    """Return how far the platform is from where it was, file units, as fields of the record."""
    if m is None:
        return {"moved": None}
    if mechanism.self_calibrated and not mechanism.motion.turns:    # frames turn to be laid
        m = replace(m, rotation_rms=0.0, rotation_max=0.0, rotation_chance=0.0)
    units = mechanism.units
    return {
        "moved": ErrorSize.filled(None, units, rms=m.position_rms, max=m.position_max,
                                  by_chance=m.position_chance, unit="length"),
        "turned": ErrorSize.filled(None, units, rms=m.rotation_rms, max=m.rotation_max,
                                   by_chance=m.rotation_chance, unit="angle"),
        "over_poses": m.poses}


def _parameters(found: Comparison, mechanism: Mechanism) -> list[ParameterDifference]:
    instead, units = {n for c in found.changes for n in c.instead}, MachineUnits.of(mechanism)
    return [ParameterDifference.filled(
        None, units, name=name, old=old, new=new, difference=new - old, sigma=sigma,
        unit=COLUMN + name, p_alone=alone, explained=explained, half=found.coverage * sigma,
        status="changed" if explained else "possible" if name in instead else "unchanged")
        for name, old, new, sigma, alone, explained in zip(
            found.names, *(v.tolist() for v in (found.old, found.new, found.sigma, found.alone,
                                                found.explained)), strict=True)]
