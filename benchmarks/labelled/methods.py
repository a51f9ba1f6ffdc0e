"""Methods that answer a case from its files: the tool by its own commands, and the others."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import ppmcal
from labelled.baselines import METHODS
from labelled.cases import Case
from labelled.linear import linear_problem
from labelled.score import Answer, Name
from labelled.sources import Files, written
from ppmcal.diagnosis.result import Diagnosis, NamedEffect
from ppmcal.errors import PpmcalError

OURS = "ppmcal"
NAMES = (OURS, *METHODS)
ROWS = ("row",)
"""What a case asks that `identify` answers: which readings do not belong."""


def answers(case: Case, root: Path, methods: list[str], seed: int) -> dict[str, Answer]:
    """Return what each method says of one case, all from the same files."""
    out: dict[str, Answer] = {}
    with TemporaryDirectory() as scratch:
        files = written(case, root, Path(scratch) / "case")
        others = [m for m in methods if m != OURS]
        if OURS in methods:
            out[OURS] = _timed(case, lambda: ours(case, files))
        if others:
            begin = time.process_time()
            try:
                problem = linear_problem(files)
            except PpmcalError as error:
                return out | {m: Answer(case.id, refused=str(error)[:200]) for m in others}
            each = (time.process_time() - begin) / len(others)
            for m in others:
                found = _timed(case, lambda m=m: METHODS[m](problem, seed))
                out[m] = Answer(case.id, found.names, found.unknown, found.refused,
                                round(found.seconds + each, 2))
    return {m: out[m] for m in methods}


def _timed(case: Case, ask: Callable[[], tuple[tuple[Name, ...], float]]) -> Answer:
    """Return an answer with the CPU time that it took; what is refused says why."""
    begin = time.process_time()
    try:
        names, unknown = ask()
        refused = ""
    except PpmcalError as error:
        names, unknown, refused = (), 0.0, str(error)[:200]
    return Answer(case.id, names, unknown, refused, round(time.process_time() - begin, 2))


def ours(case: Case, files: Files) -> tuple[tuple[Name, ...], float]:
    """Return what `ppmcal identify` leaves out, and beyond readings what `ppmcal diagnose` names.

    The commands' defaults; as the library's functions, on the same files.
    """
    machine = ppmcal.load(files.mechanism)
    data = ppmcal.read_data(machine, *files.tables)
    if case.asks == ROWS:
        return _rows(ppmcal.identify(machine, data).identification, files), 0.0
    found: Diagnosis = ppmcal.diagnose(machine, data).diagnosis
    names, vague = [], [u.probability for u in found.unknown]
    for effect in found.effects:
        name = _name(effect)
        names.append(name)
        if name.probability < 0.5:
            vague.append(min(1.0, effect.probability + sum(effect.probabilities)))
    return (*_rows(found.identification, files), *names), min(1.0, max(vague, default=0.0))


def _name(effect: NamedEffect) -> Name:
    """Return a named effect; the same kind on other joints, as an alternative, is its kind too."""
    same = sum(p for label, p in zip(effect.alternatives, effect.probabilities, strict=True)
               if label.startswith(f"{effect.kind} "))
    slot = effect.hypothesis.slot
    rows = () if effect.onset is None else (effect.onset.row,)
    return Name(effect.kind, effect.on, slot, rows, min(1.0, effect.probability + same))


def _rows(identification: object, files: Files) -> tuple[Name, ...]:
    """Return readings that were left out, counted from 1 through all tables."""
    begin, start = 0, {}
    for table in files.tables:
        start[table.stem] = begin
        begin += sum(bool(line.strip()) for line in
                     table.read_text(encoding="utf-8").splitlines()) - 1
    return tuple(Name("row", rows=(start.get(r.dataset, 0) + r.row,))
                 for r in identification.gross_errors.rows)  # type: ignore[attr-defined]
