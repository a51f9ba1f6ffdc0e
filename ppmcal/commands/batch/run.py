"""Many campaigns of many machines: each as its command alone would do it, then seen together."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from ppmcal import __version__
from ppmcal.commands import command
from ppmcal.commands.batch.manifest import CampaignJob, options_of, read_manifest
from ppmcal.commands.batch.options import BatchArguments
from ppmcal.commands.face import carry_out, refused
from ppmcal.commands.result import Result
from ppmcal.commands.spec import Arguments, Command, taken
from ppmcal.design.processes import cores as all_cores
from ppmcal.design.processes import over
from ppmcal.errors import BadInput, NoResult, PpmcalError
from ppmcal.io import csv_text
from ppmcal.io.results.batch import CampaignRecord, campaigns_table, with_findings
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.knowledge import KNOWLEDGE
from ppmcal.io.sidecar import sidecar_path
from ppmcal.io.tables import refuse_without_pyarrow
from ppmcal.notes import FINDING, NOTE, Note
from ppmcal.store.folder import CAMPAIGNS, read_record, running
from ppmcal.store.inputs import Run, content_of, current, digest_of, under_way
from ppmcal.store.output import Output
from ppmcal.store.provenance import source_of
from ppmcal.store.stage import HIDDEN
from ppmcal.store.transaction import clean_up
from ppmcal.wording import pluralize
from ppmcal.wording.progress import stage
from ppmcal.wording.told import Findings, Told

SHOWN = 10
"""Campaigns without a result that the console names."""
COLUMNS = ("campaign", "machine", "date", "command", "exit_code", "verdict", "message")
"""What a line says of a campaign."""
KEPT = f"{HIDDEN}batch"
"""Folder of what is remembered of each campaign, within that of the results."""
LOCK = threading.Lock()
"""Campaigns change the folder of the process: one at a time where a worker has threads."""
COMPARE = "compare"
PRODUCTS = (COMPARE, "compensate")
"""Commands that read what others have left beside the files that are named."""


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

    def remarks(self) -> Sequence[str]:
        """Return how the campaigns ended: a finding where one did not end well."""
        ended = any(r.exit_code for r in self.records)
        return [Note(self.headline(), FINDING if ended else NOTE)]

    @cached_property
    def _files(self) -> dict[str, str | bytes]:
        from ppmcal.report.batch import batch_page

        return {CAMPAIGNS: campaigns_table(self.records), "batch.html": batch_page(self.records)}

    def files(self) -> Mapping[str, str | bytes]:
        """Return campaigns.parquet and batch.html."""
        return self._files

    def tables(self) -> Mapping[str, str | bytes]:
        """Return a line for each campaign, as a table besides the files."""
        return {self.TABLE: csv_text(COLUMNS, [[getattr(r, n) for r in self.records]
                                               for n in COLUMNS])}

    @property
    def warnings(self) -> list[str]:
        """Nothing: what failed is printed with the campaigns."""
        return []

    def told(self) -> Iterator[Told]:
        """Yield how the campaigns ended, and which failed."""
        yield self.headline()
        for line in list(_findings(self.failed))[:SHOWN]:
            yield Findings([line])
        if len(self.failed) > SHOWN:
            yield (
                f"... and {pluralize(len(self.failed) - SHOWN, 'further campaign')} that failed, "
                   "see batch.html.")

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        return {"format": "ppmcal/batch-summary/1", "headline": self.headline(),
                "finished_before": list(self.done_before),
                "campaigns": [{k: getattr(r, k) for k in COLUMNS} for r in self.records]}

    def headline(self) -> str:
        """Return how many campaigns of how many machines there are, and how they ended."""
        own = self.campaigns
        machines = len({r.machine for r in own})
        look = sum(r.exit_code == 1 for r in own)
        changed = sum(r.exit_code == 1 for r in self.records if r.command == COMPARE)
        ends = [f"{look} {'needs' if look == 1 else 'need'} a look"] * bool(look) + [
            f"{len(self.failed)} failed"] * bool(self.failed) + [
            f"{pluralize(changed, 'comparison')} to look at"] * bool(changed)
        if not ends and with_findings(self.records):
            ends = ["see batch.html"]
        done = sum(r.campaign in self.done_before for r in own)
        before = f" ({done} {'was' if done == 1 else 'were'} finished before)" if done else ""
        return (f"{pluralize(len(own), 'campaign')} of {pluralize(machines, 'machine')}"
                f"{before}: {', '.join(ends) or 'nothing needs a look'}.")


def run(asked: BatchArguments) -> BatchResult:
    """Run the campaigns of a manifest, and see them together.

    Each campaign's folder has the same bytes as its command writes, run in the manifest's folder.
    A campaign that is finished, by the content of its inputs, its options and the version of
    ppmcal, is not run again; one that fails is reported, and the others go on.
    """
    manifest, out = asked.manifest, asked.out
    campaigns = read_manifest(manifest)
    refuse_without_pyarrow(str(Path(out) / CAMPAIGNS))
    folder = Path(manifest).absolute().parent
    at = BatchPlace(str(folder), os.path.relpath(Path(out).absolute(), folder), asked.force)
    with contextlib.nullcontext() if current().command else running(
            "batch", Path(out), asked.force):
        Output(out).write()    # the folder is ours from now on, whatever happens
    with contextlib.chdir(folder):
        lines = lines_of(campaigns, at)
        found = _finished(at, lines)
    before = tuple(found)
    todo = [tuple(c for c in line if c.name not in found) for line in lines]
    todo = [line for line in todo if line]
    with stage("calibrating", len(todo)) as work:
        for codes in over(run_line, at, todo, asked.cores or all_cores(),
                          asked.scheduler):
            found |= _read(at, todo, codes)
            failed = sum(r.failed for r in found.values())
            work.done()
            work.note(f"{len(found)} of {sum(map(len, lines))} campaigns"
                      + f", {failed} failed" * (failed > 0))
    named = [*campaigns, *(c for line in lines for c in line if c.command == COMPARE)]
    records = tuple(found[c.name] for c in named if c.name in found)
    inputs = _inputs(Path(manifest).parent, records, at)
    current().sums.update(inputs)
    source = source_of("batch", [str(manifest), *inputs], None)
    return BatchResult(source, tuple(_findings(records)), records, before)


def _inputs(folder: Path, records: Sequence[CampaignRecord], at: BatchPlace) -> dict[str, str]:
    """Return path -> SHA-256 of what campaigns have read, but for what a batch writes itself."""
    return {str(folder / name): digest for record in records
            for name, digest in record.inputs.items()
            if digest and not os.path.normpath(name).startswith(at.out + os.sep)}


def lines_of(campaigns: Sequence[CampaignJob], at: BatchPlace) -> list[tuple[CampaignJob, ...]]:
    """Return what one process does in a row: a campaign, or the last two of a machine.

    After the last two that were identified comes the comparison of the one with the other.
    """
    groups: dict[tuple[str, str], list[CampaignJob]] = {}
    for c in campaigns:
        if c.command == "identify":
            groups.setdefault((c.machine, c.name.rpartition("/")[2]), []).append(c)
    rows = {}
    for (machine, kind), own in groups.items():
        if len(own) > 1:
            old, new = sorted(own, key=lambda c: c.date)[-2:]
            rows[new.name] = (old, new, CampaignJob(
                f"{new.name.removesuffix(kind)}{COMPARE}-{kind}", machine, new.date, new.design,
                COMPARE, at.place(old), (at.place(new),)))
    earlier = {old.name for old, *_ in rows.values()}
    return [rows.get(c.name, (c,)) for c in campaigns if c.name not in earlier]


def run_line(at: BatchPlace, line: tuple[CampaignJob, ...]) -> dict[str, int]:
    """Run campaigns one after the other; return the exit code of each that was run, by name."""
    codes: dict[str, int] = {}
    for campaign in line:
        if campaign.command != COMPARE or all(code < 2 for code in codes.values()):
            codes[campaign.name] = run_campaign(at, campaign)
    return codes


def _finished(at: BatchPlace, lines: Sequence[Sequence[CampaignJob]]) -> dict[str, CampaignRecord]:
    """Return what is known of campaigns before, comparisons only where nothing else is to do."""
    found: dict[str, CampaignRecord] = {}
    for line in lines:
        for campaign in line:
            record = None
            if campaign.command != COMPARE or all(c.name in found for c in line[:-1]):
                record = finished(at, campaign)
            if record is not None:
                found[campaign.name] = record
    return found


def _read(at: BatchPlace, todo: Sequence[Sequence[CampaignJob]], names: Collection[str]
          ) -> dict[str, CampaignRecord]:
    """Return what was written of campaigns that a process has run."""
    paths = {c.name: at.kept(c) for line in todo for c in line if c.name in names}
    try:
        return {name: recalled(path) for name, path in paths.items()}
    except BadInput as error:
        raise NoResult("is not there, though a worker has written it", error.where,
                       "Give a folder that the workers see under the same path") from None


def _findings(records: Sequence[CampaignRecord]) -> Iterator[Note]:
    """Yield who failed, with the message."""
    for r in records:
        if r.failed:
            yield Note(f"{r.campaign} failed (exit code {r.exit_code}): {r.message}")


# ---- one campaign


@dataclass(frozen=True)
class BatchPlace:
    """Where all campaigns of a batch read and write: folders, as seen from the manifest's."""

    folder: str
    out: str
    force: bool

    def place(self, campaign: CampaignJob) -> str:
        """Return the folder of a campaign's results, from the manifest's folder."""
        return os.path.join(self.out, *campaign.name.split("/"))

    def kept(self, campaign: CampaignJob) -> Path:
        """Return where a campaign is remembered."""
        *above, name = campaign.name.split("/")
        # names may have points in them
        return Path(self.folder, self.out, KEPT, *above, f"{name}.json")


def finished(at: BatchPlace, campaign: CampaignJob) -> CampaignRecord | None:
    """Return what is remembered of a campaign whose inputs and results are as they were then.

    The working folder is the manifest's.
    """
    path = at.kept(campaign)
    if not path.is_file():
        return None
    try:
        record = recalled(path)
    except BadInput:
        return None
    place = Path(at.place(campaign))
    clean_up(place)
    _remove(path.with_suffix(".part"))
    same = (not record.failed and record.key == _key(at, campaign) and bool(record.outputs)
            and all(digest_of(Path(p)) == d for p, d in record.inputs.items())
            and all(digest_of(place / name) == d for name, d in record.outputs.items()))
    # machines may have been put into another design since
    return record.changed(design=campaign.design or record.design) if same else None


def recalled(path: Path) -> CampaignRecord:
    """Return what is remembered of a campaign: a note of the batch's own, and no input of it.

    Raises:
        BadInput: it is not there, or damaged.
    """
    with under_way(None):
        return CampaignRecord.read(path)


def _key(at: BatchPlace, campaign: CampaignJob) -> str:
    """Return the hash of what is asked, and of the version that answers."""
    options = json.dumps([campaign.command, campaign.model, campaign.data, campaign.options])
    asked = json.dumps([__version__, options, at.place(campaign)])
    return hashlib.sha256(asked.encode()).hexdigest()


def run_campaign(at: BatchPlace, campaign: CampaignJob) -> int:
    """Run one campaign as its command would, remember how it ended, and return the exit code."""
    with LOCK, contextlib.chdir(at.folder):
        place, kept = at.place(campaign), at.kept(campaign)
        typed = campaign.typed(place)
        own = CampaignRecord(
            format=CampaignRecord.FORMAT, campaign=campaign.name, machine=campaign.machine,
            date=campaign.date, design=campaign.design, command=campaign.command, typed=typed,
            key=_key(at, campaign))
        run = Run()
        try:
            with running(campaign.command, Path(place), at.force, typed) as run:
                record = own.changed(**_result(campaign, place))
        except Exception as error:
            record = own.changed(**_failure(error))
        seen = {*run.read.values(), *_named(campaign)}
        record = record.changed(
            inputs={p: content_of(p, run) for p in sorted(seen)},
            outputs={} if record.failed else read_record(Path(place)).of(campaign.command))
        _keep(kept, record)
    return record.exit_code


def _named(campaign: CampaignJob) -> set[str]:
    """Return files on which a campaign depends, there or not, besides those that it has read."""
    files = {campaign.model, *campaign.data}
    files |= {str(sidecar_path(Path(d))) for d in campaign.data}
    if campaign.command in PRODUCTS:
        files |= {str(Path(campaign.model).with_name(n))
                  for n in (KNOWLEDGE, DiagnosisRecord.FILE)}
    return {f for f in files if not Path(f).is_dir()}


def _keep(path: Path, record: CampaignRecord) -> None:
    """Write a record, whole or not at all."""
    part = path.with_suffix(".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(record.text(), encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise BadInput(f"cannot be written ({error.strerror or error})", str(path),
                       "Check permissions and space, and start the batch again") from None
    finally:
        _remove(part)


def _remove(part: Path) -> None:
    """Take away a record that was not written to its end."""
    with contextlib.suppress(OSError):
        part.unlink(missing_ok=True)


def _result(campaign: CampaignJob, place: str) -> dict[str, Any]:
    """Run a campaign's command, save its files and return what came out."""
    spec = command(campaign.command)
    asked = arguments_of(spec, campaign)
    try:
        result = carry_out(spec, asked)
    except PpmcalError as error:
        refused(spec, error, asked, Path(place))
        raise
    result.save(place)
    return {"exit_code": result.exit_code, "message": result.headline(),
            "findings": result.findings, "quantities": tuple(result.quantities()),
            "verdict": result.verdict, "design": campaign.design or result.mechanism.name}


def arguments_of(spec: Command, campaign: CampaignJob) -> Arguments:
    """Return what a command is asked for by a campaign: its files in their order, then options."""
    every = list(taken(spec.arguments))
    files = [one for one in every if one.option.argument][1:]
    first = next(one for one in every if one.option.argument)
    called = options_of(spec.name)
    given = ({files[0].name: campaign.data} if files[0].several else
             {one.name: path for one, path in zip(files, campaign.data, strict=False)})
    return spec.arguments(**{first.name: campaign.model, **given},
                          **{called[k].name: v for k, v in campaign.options})


def _failure(error: BaseException) -> dict[str, Any]:
    """Return exit code and message of an error, as the command line has them."""
    if isinstance(error, PpmcalError):
        code, text = error.exit_code, str(error)
    elif isinstance(error, MemoryError):
        code, text = 3, "not enough memory for this many rows."
    else:
        code, text = 3, (f"ppmcal failed: {type(error).__name__}: {error}. This is a fault of "
                         "ppmcal: run the campaign alone with PPMCAL_DEBUG=1, and report it.")
    return {"exit_code": code, "verdict": "failed", "message": text}
