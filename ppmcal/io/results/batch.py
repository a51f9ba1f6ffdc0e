"""What a batch keeps of each campaign, and the one table that it makes of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, fields
from typing import TYPE_CHECKING, ClassVar

from ppmcal.calibration.validation import Identification
from ppmcal.io.results.identification_parts import ParameterEstimate, summaries
from ppmcal.io.results.record import Part, Record, Shown, Text, UnitText, Whole
from ppmcal.io.tables import parquet_bytes
from ppmcal.wording import MOST, abbreviate_list, pluralize

if TYPE_CHECKING:       # every command has quantities, and few of them these records
    from ppmcal.io.results.comparison import ComparisonRecord
    from ppmcal.io.results.diagnosis import DiagnosisRecord


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


def fit_quantities(found: Identification) -> Iterator[CampaignQuantity]:
    """Yield errors, noise and parameters of a fit, file units."""
    fit, units = found.fit, found.mechanism.units
    stages = {"before": found.before.figures(fit.keep), "after": found.after.figures(fit.keep),
              "holdout": found.holdout}
    for stage, figures in stages.items():
        for kind, s in summaries(figures, units).items():
            yield CampaignQuantity(what="error", name=kind, parameter=stage, value=s.rms,
                                   unit=s.unit)
    yield CampaignQuantity(what="noise", name="residual", parameter="after",
                           value=found.noise.sigma_ratio)
    for estimate in found.estimates:
        e = ParameterEstimate.of(estimate, units)
        yield CampaignQuantity.filled(e, what="parameter")


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
