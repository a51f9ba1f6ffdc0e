"""Several measurement files as one campaign: unique names, frames that are shared."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ppmcal.calibration.interpretation import without_shared
from ppmcal.errors import BadInput, unknown
from ppmcal.io.dataset_reader import read_dataset
from ppmcal.io.sidecar import sidecar_path
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.sessions import as_campaigns


def read_campaign(paths: Sequence[str | os.PathLike[str]], mechanism: Mechanism
                  ) -> tuple[Dataset, ...]:
    """Return the data sets of one campaign, with unique names and ``same_as`` resolved.

    A frame that is the same as one that is given is given too; a chain of ``same_as`` ends
    at the data set whose frame is fitted.

    Raises:
        BadInput: as :func:`read_dataset`; two data sets of one name, or a name in
            ``same_as`` that is not among them.
    """
    return joined([read_dataset(p, mechanism) for p in paths])


def joined(data: Sequence[Dataset]) -> tuple[Dataset, ...]:
    """Return data sets as one campaign; see :func:`read_campaign`."""
    by_name: dict[str, Dataset] = {}
    for d in data:
        if d.name in by_name:
            raise BadInput(f"two data sets are called '{d.name}' (the other is "
                           f"{by_name[d.name].source})", d.source,
                           "Give each sidecar its own `name`, and each file only once")
        by_name[d.name] = d
    return as_campaigns(without_shared([replace(d, frame=_resolve(d, by_name)) for d in data]))


def _resolve(data: Dataset, by_name: dict[str, Dataset]) -> Unknown:
    frame, seen = data.frame, [data.name]
    while frame.same_as is not None:
        source = Path(by_name[seen[-1]].source)
        # a table that is in memory has no file
        side = sidecar_path(source) if source.suffix else f"sidecar of {source}"
        place = f"{side}: frame.same_as"
        others = [n for n in by_name if n not in seen]
        if frame.same_as == seen[-1]:
            raise BadInput("a data set has its own frame, this names itself", place,
                           "Write `frame: unknown`, or name another data set" + (
                               f": {', '.join(others)}" if others else ""))
        if frame.same_as not in by_name and not others:
            raise BadInput(f"unknown data set '{frame.same_as}': no other data set is given", place,
                           f"Give '{frame.same_as}' too, or write `frame: unknown`")
        if frame.same_as not in by_name:
            error = unknown("data set", frame.same_as, others, place)
            raise BadInput(error.what, place, f"{error.hint} Give the other file too")
        if frame.same_as in seen:
            raise BadInput(f"the data sets refer to each other in a circle "
                           f"({' -> '.join([*seen, frame.same_as])})", place,
                           "Write `frame: unknown` in one of them")
        seen.append(frame.same_as)
        frame = by_name[frame.same_as].frame
    if len(seen) == 1 or not frame.fitted:
        return frame
    return Unknown(True, frame.value, seen[-1])
