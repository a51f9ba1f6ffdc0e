"""Parts of diagnosis.json: one class for each of its objects, in file units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any

import numpy as np

from ppmcal.calibration.fit import half_interval
from ppmcal.calibration.knowledge import coverage
from ppmcal.diagnosis.derived_errors import derived
from ppmcal.diagnosis.held_out_gap import Gap
from ppmcal.diagnosis.result import (
    Candidate,
    Diagnosis,
    NamedEffect,
    Onset,
    SessionEffect,
)
from ppmcal.io.results.record import Part, Shown, Text, UnitText, Whole
from ppmcal.model.effects import GEOMETRY, effect_kinds
from ppmcal.units import Key, Units


class EffectValue(Part):
    """A parameter of an effect, or what follows from it, in ``unit``; sigma null if unknown.

    ``low``, ``high``: its 95 % interval, the size of the noise not being known exactly.
    """

    value: Shown | None = None
    sigma: Shown | None = None
    unit: UnitText = ""
    low: Shown | None = None
    high: Shown | None = None

    @classmethod
    def of(cls, value: float, sigma: float | None, quantity: str, units: Units, times: float
           ) -> EffectValue:
        """Return a value, SI, in file units; ``times``: sigmas to an end of its 95 % interval."""
        f, unit = units.factor(quantity), units.name(quantity)
        value /= f
        if sigma is None:
            return cls(value=value, unit=unit)
        sigma /= f
        return cls(value=value, sigma=sigma, unit=unit, low=value - times * sigma,
                   high=value + times * sigma)

    @property
    def half(self) -> float | None:
        """Half of the 95 % interval, None without one."""
        return half_interval(self.low, self.high, self.sigma)


def kind_of(label: str) -> str:
    """Return the kind of an alternative, without its part; of a slot of the geometry its name."""
    whole = label.split(" on ")[0]
    known = effect_kinds().get(whole.split()[0])
    return known.name if known is not None and known.one_by_one else whole


class EffectInSession(Part):
    """The size of an effect in one session, all else shared."""

    session: Text = ""
    parameters: Mapping[str, EffectValue] = field(default_factory=dict)

    @classmethod
    def each(cls, result: Diagnosis, found: SessionEffect | None) -> tuple[EffectInSession, ...]:
        """Return one entry for every session, file units."""
        if found is None:
            return ()
        mechanism = result.identification.mechanism
        units = mechanism.units
        quantities = [mechanism.parameters[mechanism.names.index(n)].quantity for n in found.names]
        return tuple(cls(session=label, parameters={
            n.rpartition(".")[2]: EffectValue.of(float(v), float(s), q, units, found.times)
            for n, q, v, s in zip(found.names, quantities, value, sigma, strict=True)})
            for label, value, sigma in zip(found.labels, found.value, found.sigma, strict=True))


class CalledEffect(Part):
    """An effect's ``kind``, ``label`` (what people call it) and actuators."""

    kind: Text = ""
    label: Text = ""
    on: tuple[Text, ...] = ()

    @property
    def called(self) -> str:
        """What people call it, in files of older versions too."""
        return self.label or self.kind


class DiagnosedEffect(CalledEffect):
    """An effect that the data name.

    ``label``: what people call its ``kind``, where kinds of one name differ.

    ``probability``: that it is there, and nothing else in its place; ``survival``: the part that
    geometry cannot imitate; ``alternatives``: kinds that the data cannot tell from it,
    ``alternatives_on`` with their actuators, ``probabilities`` and the ``odds`` for the effect
    against each; ``p_value``: null, as what was found has the smallest of thousands. ``derived`` is
    at ``mid_stroke``. ``sessions``: its size in each where there are several,
    ``same_in_sessions_p`` the probability of being the same. ``side``: of what changes with the
    direction of approach, whether the joint ``lags`` what its encoder reads (which sits before what
    gives way) or ``leads`` it (behind).
    """

    parameters: Mapping[str, EffectValue] = field(default_factory=dict)
    p_value: Shown | None = None
    visibility: Annotated[Shown | None, Key("survival")] = None
    alternatives: tuple[Text, ...] = ()
    alternatives_on: tuple[Text, ...] = ()
    odds: tuple[Shown | None, ...] = ()
    probability: Shown | None = None
    probabilities: tuple[Shown | None, ...] = ()
    mid_stroke: EffectValue | None = None
    derived: Mapping[str, EffectValue] = field(default_factory=dict)
    row: Onset | None = None
    sessions: tuple[EffectInSession, ...] = ()
    same_in_sessions_p: Shown | None = None
    side: Text = ""

    @classmethod
    def of(cls, result: Diagnosis, effect: NamedEffect) -> DiagnosedEffect:
        """Return one effect in file units."""
        return cls.filled(
            effect, label=effect.hypothesis.called, parameters=_parameters(result, effect),
            p_value=None, alternatives=tuple(kind_of(a) for a in effect.alternatives),
            alternatives_on=effect.alternatives,
            sessions=EffectInSession.each(result, effect.sessions),
            same_in_sessions_p=None if effect.sessions is None else effect.sessions.same,
            side=effect.side(result.identification.mechanism),
            **_event(result, effect), **_derived(result, effect))


class SuspectedEffect(CalledEffect):
    """Something that may be there but is too weak to be named; ``status``: ``weak``."""

    probability: Shown | None = None
    visibility: Annotated[Shown | None, Key("survival")] = None
    status: Text = ""

    @classmethod
    def of(cls, c: Candidate) -> SuspectedEffect:
        """Return a candidate that is not named."""
        return cls.filled(c, kind=c.hypothesis.kind, label=c.hypothesis.called, on=c.hypothesis.on)


class HeldOutGap(Part):
    """Residuals without and with the effects in rows left out of the fits, over the noise.

    ``closed`` = 1 - excess(after)/excess(before), with its 95 % ``interval``; ``rms_closed`` =
    1 - rms(after)/rms(before). ``chose``: what was chosen with the help of these rows, for
    which they are not unseen: ``effects``, ``learned terms``; sizes were not fitted to them.
    """

    noise: Shown | None = None
    before: Shown | None = None
    after: Shown | None = None
    closed: Shown | None = None
    rms_closed: Shown | None = None
    interval: tuple[Shown, ...] | None = None
    poses: Whole = 0
    chose: tuple[Text, ...] = ()

    @classmethod
    def of(cls, gap: Gap | None, chose: Sequence[str]) -> HeldOutGap:
        """Return the gap on held-out poses; ``chose``: what was chosen by them."""
        if gap is None:
            return cls(noise=1.0, before=None, after=None, closed=None, rms_closed=None,
                       interval=None, poses=0, chose=())
        return cls.filled(gap, noise=1.0, chose=tuple(chose), rms_closed=(
            1.0 - gap.after / gap.before if gap.before else None))


def _event(result: Diagnosis, effect: NamedEffect) -> dict[str, Any]:
    """Return the input row from which on an event holds, counted within its own file."""
    if (onset := effect.onset) is None:
        return {}
    datasets, kind = result.identification.fit.problem.datasets, effect.hypothesis.effect
    # of files with one time line the first that was at work then
    after = [d for d in datasets if d.before < onset.row]
    own = next((d for d in datasets if kind and d.name == kind.target),
               next(d for d in after if d.before == after[-1].before))
    return {"row": Onset(own.row_at(onset.row), own.row_at(onset.low), own.row_at(onset.high),
                         own.name)}


def _parameters(result: Diagnosis, effect: NamedEffect) -> dict[str, EffectValue]:
    """Return the parameters of one named effect, file units; of geometry by their full names."""
    units = result.identification.mechanism.units
    values = {e.name: e for e in result.identification.estimates}
    out = {}
    for name in effect.parameters:
        e = values[name]
        f = units.factor(e.quantity)
        geometry = effect.kind == GEOMETRY
        known = e.sigma is not None and np.isfinite(e.sigma)
        shown = (e.error if geometry else e.value) / f
        low, high = e.interval or (np.nan, np.nan)
        half = 0.5 * (high - low) / f
        there = known and np.isfinite(half)
        out[name if geometry else name.rsplit(".", 1)[1]] = EffectValue(
            value=shown, sigma=(e.sigma or 0.0) / f if known else None,
            unit=units.name(e.quantity), low=shown - half if there else None,
            high=shown + half if there else None)
    return out


def _derived(result: Diagnosis, effect: NamedEffect) -> dict[str, Any]:
    """Return what follows from an effect's parameters and where mid-stroke is, file units.

    Empty for kinds whose parameters say all; no mid-stroke where no figure is named for it.
    """
    found = derived(result.identification, effect.parameters)
    if found is None:
        return {}
    units = result.identification.mechanism.units
    times = coverage(result.identification.fit)
    stroke = {}
    if any(f.name.endswith("_mid_stroke") for f in found.all):
        stroke["mid_stroke"] = EffectValue.of(found.middle, None, found.quantity, units, times)
    return {**stroke, "derived": {
        f.name: EffectValue.of(f.value, f.sigma, f.quantity, units, times) for f in found.all}}
