"""What a batch comes to: who is worst, what machines have in common, what has changed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ppmcal.calibration.knowledge import farthest
from ppmcal.calibration.sessions import FEWEST, CommonError, common_errors, share_interval
from ppmcal.io.results.batch import CampaignQuantity, CampaignRecord
from ppmcal.units import LENGTHS

MOST = 0.5
"""An effect is the design's where more than this share of all machines have it."""


KINDS = ("position", "closure", "rotation")
"""Kinds of error by which machines are ranked: the first that they have."""
APART = 3.0
"""Sizes differ from so many standard deviations of the difference on."""


def last_of_each(records: Sequence[CampaignRecord]) -> list[CampaignRecord]:
    """Return the latest campaign of each machine and command."""
    return list({(r.machine, r.command): r for r in sorted(records, key=lambda r: r.date)}.values())


def error_of(record: CampaignRecord, kind: str, stage: str) -> CampaignQuantity | None:
    """Return the rms error of a kind at a stage, None where it has none."""
    return next((q for q in record.of_kind("error")
                 if (q.name, q.parameter) == (kind, stage) and q.value is not None), None)


def left(record: CampaignRecord) -> CampaignQuantity | None:
    """Return what is left of the error: on unseen poses, else on those of the fit."""
    return next((q for kind in KINDS for stage in ("holdout", "after")
                 if (q := error_of(record, kind, stage)) is not None), None)


def in_si(q: CampaignQuantity | None) -> float:
    """Return a length in m, another number as it is; nan for none."""
    return float("nan") if q is None or q.value is None else q.value * LENGTHS.get(q.unit, 1.0)


def ranking(records: Sequence[CampaignRecord]) -> list[CampaignRecord]:
    """Return the latest fit of each machine, worst first; of compensate alone what it predicts."""
    best: dict[str, CampaignRecord] = {}
    order = ("compensate", "identify", "diagnose")
    for r in sorted(records, key=lambda r: (order.index(r.command), r.date)):
        if left(r) is not None and (r.machine not in best or r.command != "compensate"):
            best[r.machine] = r
    return sorted(best.values(), key=lambda r: -in_si(left(r)))


class FarthestParameter(NamedTuple):
    """The parameter that is most tolerances off nominal; ``far``: farther than chance has it."""

    name: str
    tolerances: float
    far: bool


def farthest_parameter(record: CampaignRecord) -> FarthestParameter | None:
    """Return the parameter of a fit that is farthest off, None without tolerances."""
    found = [(abs(q.value - q.nominal) / q.tolerance, q.name) for q in record.of_kind("parameter")
             if q.value is not None and q.nominal is not None and q.tolerance]
    if not found:
        return None
    most, name = max(found)
    return FarthestParameter(name, most, most > farthest(len(found)))


class EffectSizes(NamedTuple):
    """A size of an effect over machines: its mean and, of several, its standard deviation."""

    parameter: str
    unit: str
    mean: float
    spread: float | None


@dataclass(frozen=True)
class SharedEffect:
    """An effect that some of the machines have."""

    kind: str
    machines: tuple[str, ...]
    of: int
    low: float
    high: float
    sizes: tuple[EffectSizes, ...]

    @property
    def whose(self) -> str:
        """Return whether it is of the design, or of single units."""
        if self.of < FEWEST:
            return "too few machines to say"
        if self.low > MOST:
            return "the design's"
        return "perhaps the design's" if len(self.machines) > MOST * self.of else "the units'"


def _latest(records: Iterable[CampaignRecord], *commands: str) -> list[CampaignRecord]:
    return list({r.machine: r for r in sorted(records, key=lambda r: r.date)
                 if r.command in commands and not r.failed}.values())


def shared_effects(records: Sequence[CampaignRecord]) -> list[SharedEffect]:
    """Return the effects of the latest diagnosis of each machine, most frequent first."""
    diagnosed = [r for r in _latest(records, "diagnose") if r.verdict != "misread"]
    kinds = dict.fromkeys(q.name for r in diagnosed for q in r.of_kind("effect"))
    out = []
    for kind in kinds:
        own = [(r.machine, q) for r in diagnosed for q in r.of_kind("effect") if q.name == kind]
        machines = tuple(dict.fromkeys(m for m, _ in own))
        sizes = [_sizes(name, unit, [q.value for _, q in own if (q.parameter, q.unit) == (
            name, unit) and q.value is not None and q.sigma is not None]) for name, unit in
            dict.fromkeys((q.parameter, q.unit) for _, q in own if q.sigma is not None)]
        low, high = share_interval(len(machines), len(diagnosed))
        out.append(SharedEffect(kind, machines, len(diagnosed), low, high, tuple(sizes)))
    return sorted(out, key=lambda e: -len(e.machines))


def _sizes(name: str, unit: str, values: Sequence[float]) -> EffectSizes:
    return EffectSizes(name, unit, float(np.mean(values)),
                       float(np.std(values, ddof=1)) if len(values) > 1 else None)


def shared_parameters(records: Sequence[CampaignRecord]
                      ) -> list[tuple[str, str, float | None, CommonError]]:
    """Return name, unit, tolerance and mean error of each parameter, surest first.

    Of those that every machine has: what is there only where it was found is never 0 on average.
    """
    columns: dict[tuple[str, str], list[tuple[float, float | None]]] = {}
    fits = _latest(records, "identify", "diagnose")
    for r in fits:
        named = {q.name for q in r.of_kind("effect")}
        for q in r.of_kind("parameter"):
            if (q.value is not None and q.nominal is not None and q.status != "fixed"
                    and q.name.partition(".")[0] not in named):
                columns.setdefault((q.name, q.unit), []).append(
                    (q.value - q.nominal, q.tolerance))
    columns = {k: own for k, own in columns.items() if len(own) == len(fits)}
    found = common_errors([np.array([e for e, _ in own]) for own in columns.values()])
    out = [(name, unit, own[0][1], f) for ((name, unit), own), f in
           zip(columns.items(), found, strict=True) if f is not None]
    return sorted(out, key=lambda o: o[3].p_value)


class EffectChange(NamedTuple):
    """What a later diagnosis says anew of an effect: ``what`` happened to it, and both sizes."""

    what: str
    kind: str
    on: str
    old: CampaignQuantity | None = None
    new: CampaignQuantity | None = None


def effect_changes(old: CampaignRecord, new: CampaignRecord) -> Iterator[EffectChange]:
    """Yield which effects a later diagnosis names anew, no more, or with another size."""
    before, after = ({(q.name, q.on, q.parameter): q for q in r.of_kind("effect")}
                     for r in (old, new))
    for what, one, other in (("new", after, before), ("no longer named", before, after)):
        there = {k[:2] for k in other}
        for kind, on in dict.fromkeys(k[:2] for k in one if k[:2] not in there):
            yield EffectChange(what, kind, on)
    for key in after.keys() & before.keys():
        a, b = before[key], after[key]
        if (a.value is None or b.value is None or a.sigma is None or b.sigma is None
                or a.unit != b.unit):
            continue
        step, wide = b.value - a.value, math.hypot(a.sigma, b.sigma)
        if abs(step) > APART * wide > 0.0:
            yield EffectChange("changed", b.name, b.on, a, b)
