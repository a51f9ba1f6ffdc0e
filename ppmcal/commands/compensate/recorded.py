"""In which form commands go back to the controller: as the measurement file has its joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.compensation import Compensation, PoseRows, joint_resolution, sent
from ppmcal.commands.spec import Path_
from ppmcal.errors import BadInput
from ppmcal.io.campaign import read_datasets
from ppmcal.io.recorded import with_decimals
from ppmcal.kinematics.closure import Model
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.recorded import RecordedForm
from ppmcal.notes import NOTE, Note

LOST = 0.1
"""Part of the model's own standard deviation that rounding may take."""
FINE = 1e-7
"""Part of the reach, or of a radian, that it may take where that is unknown."""

Forms = Sequence[tuple[str, RecordedForm | None]]
"""Data sets by name, with how each has its joints; None: as the mechanism file."""


def asked_form(path: Path_, machine: Mechanism) -> RecordedForm:
    """Return how a measurement file has its joints.

    Raises:
        BadInput: anything wrong in the file or its sidecar, or commanded quaternions.
    """
    found = read_datasets(path, machine)[0].recorded
    if found is None:
        raise BadInput("its commanded poses have quaternions, as which commands are not written",
                       f"{path}: header", "Leave --like out; commands.csv has cmd_rx, cmd_ry, "
                       "cmd_rz, the rotation vector")
    return found


def known_form(forms: Forms, frame: str, machine: Mechanism
               ) -> tuple[str, RecordedForm | None, list[Note]]:
    """Return which data set has its joints otherwise than the mechanism file, how, and notes.

    That of the targets' ``frame``; in base axes the first.
    """
    own = {f"q_{a}" for a in machine.actuators}
    there = [(name, form) for name, form in forms if form is not None
             and frame in ("", name) and form.values
             and all(c.name in own or c.name.startswith("cmd_") for c in form.values)]
    if not there:
        return "", None, []
    name, form = there[0]
    other = next((n for n, f in there if _without_digits(f) != _without_digits(form)), "")
    return name, form, [Note(
        f"{other} has its joints in another form than {name}, as which commands_recorded.csv has "
        "the commands: choose another file with --like", NOTE)] if other else []


def _without_digits(form: RecordedForm) -> RecordedForm:
    return replace(form, columns=tuple(replace(c, decimals=0) for c in form.values))


def with_digits(form: RecordedForm, machine: Mechanism, found: Compensation) -> RecordedForm:
    """Return a form with digits enough for commands: rounding takes little of what is known."""
    rows = sent(found)
    allowed = [max(LOST * float(np.min(sigma[rows], initial=np.inf)), 1e-2 * FINE * size)
               if rows.any() and np.isfinite(sigma[rows]).all() else FINE * size
               for sigma, size in ((found.sigma_position, machine.reach),
                                   (found.sigma_rotation, 1.0))]
    at = PoseRows(found.pose, np.where(rows[:, None], found.q, np.nan),
                  unknown_environment(*found.q.shape))
    joints = joint_resolution(Model(machine), at, *allowed) / machine.joint_factors()
    steps = {f"q_{a}": float(s) for a, s in zip(machine.actuators, joints, strict=True)}
    for c, name in zip(machine.dof, machine.coordinates, strict=True):
        quantity, size = ("length", allowed[0]) if c < 3 else ("angle", allowed[1])
        steps[f"cmd_{name}"] = 2.0 * size / machine.units.factor(quantity)
    return with_decimals(form, steps)
