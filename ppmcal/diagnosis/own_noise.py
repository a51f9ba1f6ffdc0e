"""Diagnoses of files whose noise is to be estimated: again, where what was named leaves less.

Noise estimated before anything is named holds what is missing, and hides what is small. Where
limbs are held against each other it holds above all what they pull at each place: of joint values
alone that were read several times at each place the noise is what these repeats say.
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
"""The noise is less where it falls below this part of what it was."""


def diagnose_with_own_noise(problem: Problem, options: DiagnosisOptions
                            ) -> tuple[Diagnosis, list[Note]]:
    """Return the diagnosis with the noise that its own model leaves, and what that noise is.

    Args:
        problem: machine, data and free geometry; noise as the files state it.
        options: of the diagnosis.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.diagnosis.diagnose.diagnose`.
    """
    # what is named is fitted to the same rows, and needs the same of them
    problem = with_whole_rows(problem)
    own, told = with_own_noise(problem, options.fit)
    own, told = with_repeats_noise(own, told, options)
    found = diagnose_with_registration(own, options)
    if not found.effects or not any(d.estimated for d in own.datasets):
        return found, told
    notes = list[Note]()
    found, told = secondary("the noise that what was named leaves", lambda: _once_more(
        problem, own, found, told, options), (found, told), notes)
    return found, [*told, *notes]


def with_repeats_noise(problem: Problem, told: list[Note], options: DiagnosisOptions
                       ) -> tuple[Problem, list[Note]]:
    """Return the problem with the noise that repeats of joint values alone have, and what it is.

    Args:
        problem: with the noise that residuals show, which holds what limbs pull at each place.
        told: what that noise is.
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
            f"{own.units.name(of)}, as readings repeat at one place.", NOTE, "noise"))
    return replace(problem, datasets=tuple(datasets)), said


def _once_more(problem: Problem, own: Problem, found: Diagnosis, told: list[Note],
               options: DiagnosisOptions) -> tuple[Diagnosis, list[Note]]:
    """Return the diagnosis by the noise that the named leaves where that is less; else ``found``.

    Probabilities hold that such noise is hardly known: once more is as good as often.
    """
    fit = found.identification.fit
    machine = fit.problem.mechanism.with_values(fit.state.g)
    gone = {d.name for d in fit.problem.datasets if not d.usable.any()}
    less, sentences = with_own_noise(
        replace(without(problem, gone), mechanism=machine, free=machine.free), options.fit)
    if not _quieter(less, own):
        return found, told
    start_stage("again with the noise that what was named leaves")
    again = diagnose_with_registration(replace(own, datasets=less.datasets), options)
    # what less noise takes back is not a reason to believe what it brings
    return (again, sentences) if _names(found) <= _names(again) else (found, told)


def _names(found: Diagnosis) -> set[tuple[str, tuple[str, ...]]]:
    """Return what was named, and where."""
    return {(e.kind, e.on) for e in found.effects}


def _quieter(new: Problem, old: Problem) -> bool:
    """Return whether the noise of a data set that wants it estimated has become less."""
    return any(typical_noise(a) < LESS * typical_noise(b)
               for a, b in zip(new.datasets, old.datasets, strict=True) if a.estimated)
