"""Tolerances in sentences, and what the user must look at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.design.tolerance_allocation import count
from ppmcal.io.results.tolerance_tables import StageYield, ToleranceResult
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording import number

METHOD_WORDS = {"cost": "of least cost", "equal": "of equal contributions", "mean": "one for all",
                "file": "as in the file"}


def sentences(r: ToleranceResult, stages: Sequence[StageYield]) -> list[str]:
    """Return the results in words, the most important first."""
    units = r.machine.units
    return [_demanded(r), *_mean_deviation(r), *(_in_specification(y, units.length)
                                                for y in stages),
            *_calibrated(r), _linear_check(r)]


def _demanded(r: ToleranceResult) -> str:
    units, d = r.machine.units, r.demand
    parts = ((d.position, "length"), (d.rotation, "angle"))
    asked = [units.words(value, quantity) for value, quantity in parts if value is not None]
    return (f"{r.machine.name}: {len(r.sources)} errors, tolerances {METHOD_WORDS[r.chosen]}, for "
            f"{' and '.join(asked)} at each of {len(r.fleet.tasks.q)} task poses.")


def _mean_deviation(r: ToleranceResult) -> list[str]:
    if r.sigma_one is None:
        return []
    return ["One standard deviation for all errors that gives an rms error of the accuracy "
            f"at home: {r.machine.units.words(r.sigma_one, 'length')} (accuracy "
            "over the amplification index)."]


def _in_specification(y: StageYield, length: str) -> str:
    low, high = y.interval
    size = "" if y.position_rms is None else (
        f"; {number(y.position_rms)} {length} rms"
        + (f" of the {y.going} that have a result" if y.machines > y.going else ""))
    return (f"{y.words.capitalize()}: {y.share:.1%} of {y.machines} machines in "
            f"specification (95 % interval {low:.1%} to {high:.1%}){size}.")


def _calibrated(r: ToleranceResult) -> list[str]:
    setup, units = r.fleet.setup, r.machine.units
    if setup is None or not np.isfinite(setup.instrument.sigma_position):
        return []
    predicted = "" if r.predicted is None else (
        f"; the linear model expects {units.words(r.predicted, 'length')} rms")
    return [f"Calibrated with {len(setup.q)} poses, instrument {setup.instrument.kind} of "
            f"{units.words(setup.instrument.sigma_position, 'length')}{predicted}."]


def _linear_check(r: ToleranceResult) -> str:
    agree, poses = int(r.check.agrees.sum()), len(r.check.agrees)
    return ("As built, linear prediction and nonlinear machines agree in position at "
            f"{agree} of {poses} task poses (a difference of {r.check.seen:.0%} would show)"
            + ("." if agree == poses else "; where they do not, trust the machines drawn "
               "(errors.csv, linear_agrees)."))


def findings(r: ToleranceResult, mechanism: Mechanism) -> list[str]:
    """Return what must be looked at: machines that cannot take poses, a yield missed."""
    out = [*mechanism.findings, *r.notes]
    built = r.judged.built
    lost = int((~np.isfinite(built.position)).any(axis=1).sum())
    if lost:
        out.append(Note(
            f"{lost} of {len(built.position)} machines cannot take every task pose: they "
            "count as out of specification"))
    for _, words, errors in r.stages()[1:]:
        more = int((~np.isfinite(errors.position)).any(axis=1).sum()) - lost
        if more > 0:
            out.append(Note(
                f"{words}: {more} more machines have no result (no converged fit, or a task "
                "pose out of their reach): they count as out of specification"))
    high = count(built, r.demand).interval[1]
    wrong = lost > 0 or not r.check.agrees.all()
    if high < r.demand.share and r.chosen != "file" and wrong:
        out.append(Note(
            f"fewer machines than wanted are in specification as built ({high:.1%} at most, "
            f"wanted {r.demand.share:.1%}): the linear model is not good enough here"))
    return out
