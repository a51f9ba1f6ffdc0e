"""Encoders in another assembly mode than home's: the machine was put together mirrored.

At the same drive values the limbs close in other places too, and encoders at joints show which.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Problem, assembled_at, assemblies, middle_row
from ppmcal.calibration.interpretation.interpretation_error import FileFault, Interpretation
from ppmcal.calibration.interpretation.limits import ALLOWED, TELLING
from ppmcal.calibration.interpretation.score import Score, score
from ppmcal.kinematics.partial_pose import pose_words
from ppmcal.linalg import Array
from ppmcal.wording import number


def other_assembly(problem: Problem) -> tuple[Interpretation, ...]:
    """Return that encoders at joints are in another assembly mode; empty if they are not."""
    datasets, mechanism = problem.datasets, problem.mechanism
    if not datasets or not all(d.kind.placed is not None or d.kind.blind for d in datasets):
        return ()
    middle = middle_row(datasets)
    if middle is None:
        return ()
    tried = [(found.noise, pose) for pose in assemblies(mechanism, middle)
             if _lands(found := _score_at(problem, pose, middle))]
    if not tried:
        return ()
    noise, pose = min(tried, key=lambda t: t[0])
    joints = ", ".join(
        f"{name} = {number(value / factor)} {unit}".rstrip() for name, value, (factor, unit) in
        zip(mechanism.actuators, middle.tolist(), mechanism.joint_units, strict=True))
    text = ("the machine is in another assembly than the file says: its encoders agree to within "
            f"{number(noise, 2)} times the noise if, at {joints}, the platform stands at "
            f"{pose_words(mechanism, pose)}")
    return (Interpretation(mechanism.source, (FileFault("assembly", ("home",), text),)),)


def _lands(found: Score) -> bool:
    return found.noise <= TELLING and found.geometry <= ALLOWED


def _score_at(problem: Problem, pose: Array, q: Array) -> Score:
    """Return the score of the machine with its home at a pose (6,) and joint values (k,)."""
    home = assembled_at(problem.mechanism, pose, q)
    return score(replace(problem, mechanism=home, pivots=None, given=None), np.inf)
