"""One campaign of a batch: run as its command would be, and remembered by its inputs."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ppmcal import __version__
from ppmcal.commands import command
from ppmcal.commands.batch.manifest import CampaignJob, options_of
from ppmcal.commands.face import carry_out, refused
from ppmcal.commands.spec import Arguments, Command, taken
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.io.results.batch import CampaignRecord
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.knowledge import KNOWLEDGE
from ppmcal.io.sidecar import sidecar_path
from ppmcal.store.folder import read_record, running
from ppmcal.store.inputs import Run, content_of, digest_of, under_way
from ppmcal.store.stage import HIDDEN
from ppmcal.store.transaction import clean_up

KEPT = f"{HIDDEN}batch"
"""Folder of what is remembered of each campaign, within that of the results."""
LOCK = threading.Lock()
"""Campaigns change the folder of the process: one at a time where a worker has threads."""
COMPARE = "compare"
PRODUCTS = (COMPARE, "compensate")
"""Commands that read what others have left beside the files that are named."""


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
