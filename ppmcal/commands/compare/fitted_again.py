"""Calibrations fitted anew to the tables behind them, with other parameters free."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ppmcal.calibration.fit import Fit, FitOptions, Posterior, Problem
from ppmcal.calibration.sessions import fitted_together
from ppmcal.commands.identify.run import fitted_rows
from ppmcal.commands.inputs import prepared
from ppmcal.errors import BadInput, NoResult, PpmcalError
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.inputs import digest_of
from ppmcal.store.provenance import IN_MEMORY
from ppmcal.store.runs import FoundInputs, RecordedRun, runs_of
from ppmcal.wording import abbreviate_list

FUNCTION = "identify.identify"


def with_equal_freedoms(mechanism: Mechanism, folders: Sequence[Path],
                        known: tuple[Posterior, Posterior]
                        ) -> tuple[tuple[Posterior, Posterior], list[str]]:
    """Return two calibrations with all parameters free that either had, and the files behind.

    Both are fitted anew to their own rows, which are read again.

    Args:
        mechanism: the newer machine.
        folders: of the older and the newer calibration.
        known: what the two knew with their own parameters free.

    Raises:
        BadInput, NoResult: why that cannot be done.
    """
    free = sorted({*known[0].places, *known[1].places})
    runs = [_run(folder) for folder in folders]
    # the newer machine has every effect that the older one had
    run, places = runs[1]
    machine = _path(places, run.source.options["mechanism"])
    old, new = (_fitted(*one, machine, free, mechanism.names) for one in runs)
    methods = {_method(run) for run, _ in runs}
    both = fitted_together(old, new, known, FitOptions(
        methods.pop() if len(methods) == 1 else "prior"))
    return both, sorted({_path(places, p) for _, places in runs for p in places})


def _run(folder: Path) -> tuple[RecordedRun, Mapping[str, Path]]:
    """Return the run that wrote a calibration, and where each of its inputs is, unchanged.

    Raises:
        BadInput: it is not known how it was made, or its inputs have changed.
    """
    where = str(folder)
    run = next((r for r in runs_of(folder) if r.source.function == FUNCTION), None)
    if run is None or _in_memory(run.source.options):
        raise BadInput("it is not recorded from which files it was made", where)
    if run.source.options.get("keep"):
        raise BadInput("carries on an earlier calibration, whose rows it does not have", where)
    found = FoundInputs(run, None)
    if wrong := found.wrong:
        state = "has changed since" if wrong[0].now else "is not there any more"
        raise BadInput(f"{wrong[0].file}, behind it, {state}", where)
    _refuse_other_sidecars(run, found.places)
    return run, found.places


def _refuse_other_sidecars(run: RecordedRun, places: Mapping[str, Path]) -> None:
    """Refuse a table beside which, where it is read, stands another sidecar than was recorded.

    Raises:
        BadInput: with the sidecar's name.
    """
    stems = {os.path.splitext(path)[0]: places[path] for path in _tables(run) if path in places}
    for other, digest in run.source.inputs.items():
        table = stems.get(os.path.splitext(other)[0])
        if table is not None and digest != digest_of(table.with_name(os.path.basename(other))):
            raise BadInput(f"{other}, behind it, has changed since beside {table}", str(run.folder))


def _tables(run: RecordedRun) -> list[str]:
    data = run.source.options["data"]
    return list(data) if isinstance(data, list) else [data]


def _in_memory(options: Mapping[str, Any]) -> bool:
    """Whether machine or data were objects of Python, which no file holds."""
    data = options.get("data")
    every = [options.get("mechanism"), *(data if isinstance(data, list) else [data])]
    return any(not isinstance(v, str) or IN_MEMORY in v for v in every)


def _path(places: Mapping[str, Path], path: str) -> str:
    """Return where an input is, as seen from here.

    A path that is not a recorded input is returned as it is, and so is one that still leads to it:
    whoever runs this again, elsewhere, finds and names the same file.
    """
    there = places.get(path, Path(path))
    return path if there == Path(path) else os.path.relpath(there)


def _method(run: RecordedRun) -> str:
    own = run.source.options
    return "flat" if own.get("prior") == "flat" else str(own.get("method", "prior"))


def _fitted(run: RecordedRun, places: Mapping[str, Path], machine: str, free: Sequence[int],
            names: Sequence[str]) -> Fit:
    """Return a fit of a run's own rows, whose inputs are at ``places``, with these free.

    Raises:
        BadInput, NoResult: as ``identify``; or the machine's file has other parameters.
    """
    own = run.source.options
    found, datasets = prepared(machine, [_path(places, d) for d in _tables(run)])
    if list(found.names) != list(names):
        raise BadInput(f"{machine} has other parameters than the calibration", str(run.folder))
    method = _method(run)
    options = FitOptions("prior" if method == "damped" else method,
                         robust=not own.get("keep_outliers"))
    found = replace(found, free=tuple(free), optional=())
    return fitted_rows(Problem(found, datasets, found.free), options,
                       str(own.get("sigma", "stated")))[0]


def reason(error: PpmcalError, only: Sequence[str]) -> str:
    """Return why calibrations with other parameters free could not be compared."""
    assert isinstance(error, BadInput | NoResult)
    where = f"{error.where}: " if error.where else ""
    return (f"{abbreviate_list(only)} {'were' if len(only) > 1 else 'was'} free in only one of "
            "the two, and they could not be fitted anew with the same ones free "
            f"({where}{error.what}); identify both with the same --free")
