"""Many campaigns of many machines: each as its command alone would do it, then seen together."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

from ppmcal.api.campaign import COMPARE, Job, finished, run_campaign
from ppmcal.api.inputs import Path_, source_of
from ppmcal.api.result import Progress, Result, silent
from ppmcal.design.processes import cores as all_cores
from ppmcal.design.processes import over
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import Output, csv_text
from ppmcal.io.batch_manifest import Campaign, read_manifest
from ppmcal.io.folder import current, running
from ppmcal.io.parquet import refuse_without_pyarrow
from ppmcal.io.results.batch import TABLE, CampaignRecord, campaigns_table
from ppmcal.wording import counted


@dataclass(frozen=True, eq=False, repr=False)
class BatchResult(Result):
    """What many campaigns came to.

    Attributes:
        records: one for each campaign, in the manifest's order, then what changed since the
            campaign before.
        done_before: names of those that were finished already.
    """

    COMMAND: ClassVar[str] = "batch"
    TABLE: ClassVar[str] = "campaigns.csv"

    records: tuple[CampaignRecord, ...]
    done_before: tuple[str, ...]

    @property
    def campaigns(self) -> list[CampaignRecord]:
        """The campaigns of the manifest."""
        return [r for r in self.records if r.command != COMPARE]

    @property
    def failed(self) -> list[CampaignRecord]:
        """The campaigns that have no result."""
        return [r for r in self.campaigns if r.failed]

    @property
    def needs_a_look(self) -> bool:
        """Whether a campaign failed, has findings, or a machine has changed."""
        return any(r.exit_code for r in self.records)

    @cached_property
    def _files(self) -> dict[str, str | bytes]:
        from ppmcal.report.batch import batch_page

        return {TABLE: campaigns_table(self.records), "batch.html": batch_page(self.records)}

    def files(self) -> Mapping[str, str | bytes]:
        """Return campaigns.parquet and batch.html."""
        return self._files

    def tables(self) -> Mapping[str, str | bytes]:
        """Return a line for each campaign, as a table besides the files."""
        names = ("campaign", "machine", "date", "command", "exit_code", "verdict", "message")
        return {self.TABLE: csv_text(names, [[getattr(r, n) for r in self.records]
                                             for n in names])}

    def headline(self) -> str:
        """Return how many campaigns of how many machines there are, and how they ended."""
        own = self.campaigns
        machines = len({r.machine for r in own})
        look = sum(r.exit_code == 1 for r in own)
        ends = [f"{look} {'needs' if look == 1 else 'need'} a look"] * bool(look) + [
            f"{len(self.failed)} failed"] * bool(self.failed)
        done = sum(r.campaign in self.done_before for r in own)
        before = f" ({done} {'was' if done == 1 else 'were'} finished before)" if done else ""
        return (f"{counted(len(own), 'campaign')} of {counted(machines, 'machine')}"
                f"{before}: {', '.join(ends) or 'nothing needs a look'}.")


def batch(manifest: Path_, out: Path_, *, cores: int | None = None, scheduler: str | None = None,
          force: bool = False, progress: Progress = silent) -> BatchResult:
    """Run the campaigns of a manifest, and see them together.

    Each campaign's folder has the same bytes as its command writes, run in the manifest's folder.
    A campaign that is finished, by the content of its inputs, its options and the version of
    ppmcal, is not run again; one that fails is reported, and the others go on.

    Args:
        manifest: YAML file, see ``ppmcal schema batch``.
        out: folder of the results; machine/date/command within it. ``save`` with the same
            folder adds the table and the page.
        cores: processes to run in  [default: all processors].
        scheduler: run on the cluster of this dask scheduler, such as ``tcp://10.0.0.5:8786``,
            whose workers see manifest, data and results under the same paths.
        force: replace results that were edited, or that ppmcal did not write.
        progress: called with a line of text now and then.

    Raises:
        BadInput: anything wrong in the manifest, or no such scheduler.
        NoResult: the workers were lost, or write to folders that are not seen here.
    """
    campaigns = read_manifest(manifest)
    refuse_without_pyarrow(str(Path(out) / TABLE))
    folder = Path(manifest).absolute().parent
    job = Job(str(folder), os.path.relpath(Path(out).absolute(), folder), force)
    with contextlib.nullcontext() if current().command else running("batch", Path(out), force):
        Output(out).write()    # the folder is ours from now on, whatever happens
    processes = cores or all_cores()
    records, before = _run(job, campaigns, processes, scheduler, progress)
    later, known = _run(job, since_last_time(campaigns, records, job), processes, scheduler,
                        progress)
    records += later
    source = source_of("batch", [str(manifest)], None)
    return BatchResult(source, tuple(_findings(records)), tuple(records), (*before, *known))


def _run(job: Job, campaigns: Sequence[Campaign], processes: int, scheduler: str | None,
         progress: Progress) -> tuple[list[CampaignRecord], list[str]]:
    """Run the campaigns that are not finished; return all records, and who was finished."""
    found: dict[str, CampaignRecord] = {}
    with contextlib.chdir(job.folder):
        for campaign in campaigns:
            record = finished(job, campaign)
            if record is not None:
                found[campaign.name] = record
    before = list(found)
    todo = [c for c in campaigns if c.name not in found]
    failed = 0
    for campaign, code in zip(todo, over(run_campaign, job, todo, processes, scheduler),
                              strict=True):
        failed += code > 1
        try:
            found[campaign.name] = CampaignRecord.read(job.kept(campaign))
        except BadInput:
            raise NoResult("is not there, though a worker has written it", str(job.kept(campaign)),
                           "Give a folder that workers see under the same path") from None
        progress(f"{len(found)} of {len(campaigns)} campaigns"
                 + f", {failed} failed" * bool(failed))
    return [found[c.name] for c in campaigns], before


def since_last_time(campaigns: Sequence[Campaign], records: Sequence[CampaignRecord], job: Job
                    ) -> list[Campaign]:
    """Return comparisons of each machine's last two calibrations that were identified."""
    groups: dict[tuple[str, str, str], list[tuple[str, str, str]]] = {}
    for c, r in zip(campaigns, records, strict=True):
        if c.command == "identify" and not r.failed:
            kind = c.name.rpartition("/")[2]
            groups.setdefault((c.machine, kind, r.design), []).append(
                (c.date, job.place(c), c.name))
    out = []
    for (machine, kind, design), own in groups.items():
        if len(own) > 1:
            (_, old, _), (date, new, name) = sorted(own)[-2:]
            out.append(Campaign(f"{name.removesuffix(kind)}{COMPARE}-{kind}", machine, date,
                                design, COMPARE, old, (new,)))
    return out


def _findings(records: Sequence[CampaignRecord]) -> Iterator[str]:
    """Yield who failed, with the message."""
    for r in records:
        if r.failed:
            yield f"{r.campaign} failed (exit code {r.exit_code}): {r.message}"
