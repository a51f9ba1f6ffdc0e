"""Rows for a search: inputs of effects have to be recorded in every row, or in none.

A search cannot compare rows if a temperature or a direction of approach is missing. If it is
missing in few rows, these are left out (the first of a sequence, before a joint has moved); if in
many, the column is not used. A direction that whole files lack is +1 or -1 in their rows, but
unknown: the other files show what depends on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Problem, with_unknown_directions
from ppmcal.calibration.interpretation import rows_with_negative_struts
from ppmcal.inference.priors import MOST_GROSS
from ppmcal.kinematics.effect_response import environment_of
from ppmcal.linalg import Bools, finite_rows
from ppmcal.model.dataset import WRENCH, Dataset, Environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note


def with_whole_rows(problem: Problem) -> Problem:
    """Return the problem with every relevant column recorded in all usable rows.

    Rows with gaps are marked unusable, with the reason; columns that most rows lack are cleared,
    with a finding.
    """
    whole = [_whole(problem.mechanism, d, c)
             for d, c in zip(problem.datasets, problem.environments, strict=True)]
    datasets = with_unknown_directions(problem.mechanism, whole, [
        c if w is d else environment_of(problem.mechanism, w)
        for w, d, c in zip(whole, problem.datasets, problem.environments, strict=True)])
    if all(a is b for a, b in zip(datasets, problem.datasets, strict=True)):
        return problem
    return replace(problem, datasets=datasets, given=None)


def _whole(mechanism: Mechanism, data: Dataset, rows: Environment) -> Dataset:
    negative = rows_with_negative_struts(data, mechanism)
    if negative.any():
        data = data.without(negative, "a strut has a negative length here")
    columns, findings = dict(data.columns), list(data.findings)
    approach, changed = rows.approach.copy(), False
    needed = _needed(mechanism)
    for names, recorded in _recorded(mechanism, rows):
        have = int(recorded.sum())
        if have in (0, len(data)):
            continue
        changed = True
        if have >= (1.0 - MOST_GROSS.value) * len(data) or needed & set(names):
            data = data.without(~recorded, f"{names[0]} is not known here")
            continue
        findings.append(Note(f"{data.name}: {names[0]} is known in only {have} of {len(data)} "
                             "rows: not used", topic="columns"))
        for name in names:
            if name in columns:
                columns[name] = np.full(len(data), np.nan)
            if name.startswith("dir_"):
                approach[:, mechanism.actuators.index(name.removeprefix("dir_"))] = np.nan
    if not changed:
        return data
    return replace(data, columns=columns, findings=tuple(findings), visited=approach)


def _recorded(mechanism: Mechanism, rows: Environment) -> Iterator[tuple[tuple[str, ...], Bools]]:
    """Yield the columns of each quantity, and which rows have it (N,)."""
    for a, name in enumerate(mechanism.actuators):
        yield (f"dir_{name}",), np.isfinite(rows.approach[:, a])
        yield (f"vel_{name}",), np.isfinite(rows.velocity[:, a])
    yield ("temperature",), np.isfinite(rows.temperature)
    yield ("payload", *WRENCH), finite_rows(rows.wrench)
    yield ("time",), np.isfinite(rows.time)


def _needed(mechanism: Mechanism) -> set[str]:
    """Return the columns that effects already in the machine depend on."""
    out: set[str] = set()
    for effect in mechanism.effects:
        for need in effect.kind.needs:
            if need in ("dir", "vel"):
                out |= {f"{need}_{a}" for a in mechanism.actuators}
            else:
                out.add({"load": "payload", "wrench": "payload", "past": "time"}.get(need, need))
    return out
