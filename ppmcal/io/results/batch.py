"""What a batch keeps of each campaign, their one table, and what they come to together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from ppmcal.calibration.knowledge import farthest
from ppmcal.calibration.sessions import FEWEST, CommonError, common_errors, share_interval
from ppmcal.io.results.record import Part, Record, Shown, Text, UnitText, Whole
from ppmcal.io.tables import parquet_bytes
from ppmcal.units import LENGTHS
from ppmcal.wording import MOST, abbreviate_list, pluralize

if TYPE_CHECKING:       # every command has quantities, and few of them these records
    from ppmcal.io.results.comparison import ComparisonRecord
    from ppmcal.io.results.diagnosis import DiagnosisRecord
    from ppmcal.io.results.identification import IdentificationRecord


class CampaignQuantity(Part):
    """One number of a campaign, in ``unit``.

    ``what`` says of what kind it is:

    - ``error``: rms of the residuals of a kind ``name`` at a stage ``parameter`` (before, after,
      holdout; of compensate before and after, as predicted);
    - ``noise``: rms of the residuals over the noise, before or after;
    - ``parameter``: an identified value with ``nominal``, ``sigma`` and ``tolerance``; ``half``,
      as of effects and changes: of its 95 % interval;
    - ``effect``: of a named effect ``name`` on the actuators ``on``, one of its parameters;
    - ``change``: since the campaign before, by ``value``, as compare names it;
    - ``refused``: targets without a command.
    """

    what: Text = ""
    name: Text = ""
    on: Text = ""
    parameter: Text = ""
    value: Shown | None = None
    sigma: Shown | None = None
    half: Shown | None = None
    nominal: Shown | None = None
    tolerance: Shown | None = None
    unit: UnitText = ""
    probability: Shown | None = None
    status: Text = ""


class CampaignRecord(Record):
    """What a batch remembers of a campaign: by which inputs it is finished, and what came out.

    ``key``: what was asked of it and by which version; ``inputs`` and ``outputs``: SHA-256 by
    path and by file name. ``exit_code`` is that of its command alone; ``message`` the error, or
    the result in a line.
    """

    FILE: ClassVar[str] = "campaign.json"
    FORMAT: ClassVar[str] = "ppmcal/campaign/1"

    campaign: Text = ""
    machine: Text = ""
    date: Text = ""
    design: Text = ""
    command: Text = ""
    typed: Text = ""
    exit_code: Whole = 0
    verdict: Text = ""
    message: Text = ""
    findings: tuple[Text, ...] = ()
    quantities: tuple[CampaignQuantity, ...] = ()
    key: Text = ""
    inputs: Mapping[Text, Text] = field(default_factory=dict)
    outputs: Mapping[Text, Text] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.exit_code > 1

    def of_kind(self, what: str) -> list[CampaignQuantity]:
        """Return the quantities of one kind."""
        return [q for q in self.quantities if q.what == what]


def with_findings(records: Sequence[CampaignRecord]) -> list[str]:
    """Return what a person must look at: who failed, changed or has findings; nothing: all is fine.

    Headline, console and page say that nothing needs a look where this is empty, only there.
    """
    failed = [f"{r.campaign} failed: {r.message}" for r in records if r.failed]
    changed = [r.machine for r in records if r.command == "compare" and r.verdict == "changed"]
    found = [r.campaign for r in records if r.exit_code == 1 and not (
        r.command == "compare" and r.verdict == "changed")]
    out = failed if len(failed) <= MOST else [
        f"{len(failed)} campaigns failed: "
        f"{abbreviate_list(failed, 'the table of those that failed', joint='; ')}"]
    if changed:
        out.append(f"changed since last time: {abbreviate_list(changed, 'the table of changes')}")
    if found:
        out.append(f"{pluralize(len(found), 'campaign')} with findings: "
                   f"{abbreviate_list(found, 'the table of campaigns')}")
    return out


def fit_quantities(record: IdentificationRecord) -> Iterator[CampaignQuantity]:
    """Yield errors, noise and parameters of a fit."""
    for stage in ("before", "after", "holdout"):
        for kind, s in getattr(record.residual, stage).items():
            yield CampaignQuantity(what="error", name=kind, parameter=stage, value=s.rms,
                                   unit=s.unit)
    yield CampaignQuantity(what="noise", name="residual", parameter="after",
                           value=record.noise.sigma_ratio)
    yield from (CampaignQuantity.filled(p, what="parameter") for p in record.parameters)


def effect_quantities(record: DiagnosisRecord) -> Iterator[CampaignQuantity]:
    """Yield the named effects of a diagnosis, and its residuals over the noise."""
    for stage, ratio in (("before", record.ratio_before), ("after", record.ratio_after)):
        yield CampaignQuantity(what="noise", name="diagnosis", parameter=stage, value=ratio)
    for effect in record.effects:
        own = CampaignQuantity(what="effect", name=effect.kind, on=", ".join(effect.on),
                               probability=effect.probability, status=record.verdict)
        if not effect.parameters:
            yield own
        for name, v in effect.parameters.items():
            yield own.changed(parameter=name, value=v.value, sigma=v.sigma, half=v.half,
                              unit=v.unit)


def change_quantities(record: ComparisonRecord) -> Iterator[CampaignQuantity]:
    """Yield the changes that a comparison names."""
    for change in record.changes:
        for n in change.numbers:
            yield CampaignQuantity.filled(
                n, what="change", name=change.name, parameter=n.name, half=n.wide,
                probability=change.probability, status=", ".join(change.instead))


def campaigns_table(records: Sequence[CampaignRecord]) -> bytes:
    """Return the Parquet table: for each campaign a row ``campaign``, then its quantities.

    The row of the campaign has its verdict as ``status`` and error or result as ``message``.
    """
    own = ("campaign", "machine", "date", "design", "command", "exit_code")
    rows = [({k: getattr(r, k) for k in own}, r, q) for r in records
            for q in (CampaignQuantity(what="campaign", status=r.verdict), *r.quantities)]
    columns: dict[str, tuple[str, list[object]]] = {
        k: ("int" if k == "exit_code" else "text", [head[k] for head, _, _ in rows]) for k in own}
    for f in fields(CampaignQuantity):
        kind = "text" if f.default == "" else "float"
        columns[f.name] = kind, [getattr(q, f.name) for _, _, q in rows]
    columns["message"] = "text", [r.message if q.what == "campaign" else "" for _, r, q in rows]
    columns["run"] = "text", [r.typed if q.what == "campaign" else "" for _, r, q in rows]
    return parquet_bytes(columns)


USUAL = 0.5
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
        if self.low > USUAL:
            return "the design's"
        return "perhaps the design's" if len(self.machines) > USUAL * self.of else "the units'"


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
