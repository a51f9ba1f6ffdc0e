"""Diagnosis with estimated noise: repeated if the named effects reduce the noise.

Noise estimated before effects are named includes unmodelled errors, and hides small effects. On a
redundant machine it mostly includes the limbs' mutual pull at each stop: if joint values alone were
read several times at each stop, these repeats give the noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import (
    Problem,
    identify,
    noise_quantity,
    repeats_scatter,
    secondary,
    typical_noise,
    with_own_noise,
)
from ppmcal.diagnosis.options import DiagnosisOptions
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.registration_rivals import diagnose_with_registration
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.diagnosis.wrong_files import without
from ppmcal.notes import NOTE, Note
from ppmcal.wording.progress import start_stage

LESS = 0.95
"""The noise counts as reduced below this part of its previous value."""


def diagnose_with_own_noise(problem: Problem, options: DiagnosisOptions
                            ) -> tuple[Diagnosis, list[Note]]:
    """Return the diagnosis with the noise that its own model leaves, and notes on that noise.

    Args:
        problem: machine, data and free geometry; noise as the files state it.
        options: of the diagnosis.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.diagnosis.diagnose.diagnose`.
    """
    # named effects are fitted to the same rows, with the same requirements
    problem = with_whole_rows(problem)
    own, told = with_own_noise(problem, options.fit)
    own, told = with_repeats_noise(own, told, options)
    found = diagnose_with_registration(own, options)
    if not found.effects or not any(d.estimated for d in own.datasets):
        return found, told
    notes = list[Note]()
    found, told = secondary("the noise with the named effects", lambda: _once_more(
        problem, own, found, told, options), (found, told), notes)
    return found, [*told, *notes]


def with_repeats_noise(problem: Problem, told: list[Note], options: DiagnosisOptions
                       ) -> tuple[Problem, list[Note]]:
    """Return the problem with the noise of repeated joint values alone, and notes on it.

    Args:
        problem: with the noise from residuals, which includes the limbs' pull at each stop.
        told: notes on that noise.
        options: of the diagnosis.
    """
    alone = [d.estimated and d.kind.blind for d in problem.datasets]
    if not any(alone):
        return problem, told
    fit = identify(problem, options.fit)
    datasets, said = list(problem.datasets), list(told)
    for n in np.flatnonzero(alone).tolist():
        found = repeats_scatter(fit, n, datasets[n].groups)
        if found is None or found[0] >= LESS:
            continue
        own = datasets[n] = replace(datasets[n].noisier(found[0]), estimated=False)
        of = noise_quantity(own)
        said.append(Note(
            f"{own.name}: noise {typical_noise(own) / own.units.factor(of):.3g} "
            f"{own.units.name(of)}, from repeated readings at one place.", NOTE, "noise"))
    return replace(problem, datasets=tuple(datasets)), said


def _once_more(problem: Problem, own: Problem, found: Diagnosis, told: list[Note],
               options: DiagnosisOptions) -> tuple[Diagnosis, list[Note]]:
    """Return the diagnosis with the noise left by the named effects if smaller, else ``found``.

    The prior takes such noise as poorly known, so one repetition is enough.
    """
    fit = found.identification.fit
    machine = fit.problem.mechanism.with_values(fit.state.g)
    gone = {d.name for d in fit.problem.datasets if not d.usable.any()}
    less, sentences = with_own_noise(
        replace(without(problem, gone), mechanism=machine, free=machine.free), options.fit)
    if not _quieter(less, own):
        return found, told
    start_stage("again with the noise left by the named effects")
    again = diagnose_with_registration(replace(own, datasets=less.datasets), options)
    # if less noise takes effects back, those that it adds are not credible
    return (again, sentences) if _names(found) <= _names(again) else (found, told)


def _names(found: Diagnosis) -> set[tuple[str, tuple[str, ...]]]:
    """Return the named effects by kind and actuators."""
    return {(e.kind, e.on) for e in found.effects}


def _quieter(new: Problem, old: Problem) -> bool:
    """Return whether the noise of a data set with estimated noise has decreased."""
    return any(typical_noise(a) < LESS * typical_noise(b)
               for a, b in zip(new.datasets, old.datasets, strict=True) if a.estimated)
