"""How well a model is known over the poses of an export: what no controller's numbers can help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ppmcal.calibration.compensation import model_sigma
from ppmcal.controllers.pose_errors import rms, rotation_rms
from ppmcal.controllers.pose_grid import rest_columns
from ppmcal.io.results.export import CommandErrors
from ppmcal.io.results.knowledge import knowledge_of, read_identification
from ppmcal.io.results.own_calibration import of_other_values
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import stage

KNOWLEDGE = "identification.json"


@dataclass(frozen=True)
class PoseUncertainty:
    """The model's own standard deviation, root mean square over poses; None where unknown.

    ``position`` m, ``rotation`` rad (None too where nothing turns); ``frame``: of which data set,
    or ``base``; ``reason``: why it is unknown.
    """

    position: float | None
    rotation: float | None
    frame: str
    reason: str = ""

    def entry(self) -> CommandErrors:
        """Return the entry of export.json, mm and degrees."""
        return CommandErrors(rms=None if self.position is None else self.position * 1e3,
                                unit="mm", frame=self.frame, reason=self.reason,
                                **rotation_rms(self.rotation))


UNKNOWN = PoseUncertainty(None, None, "", f"{KNOWLEDGE} is not beside the model")


@stage("how sure the model is")
def pose_uncertainty(mechanism: Mechanism, poses: Array | None, model: Path) -> PoseUncertainty:
    """Return how well the file ``model`` is known at platform poses (N, 6), base frame.

    In the measuring frame of the model's only data set, as ``compensate`` takes it; with none or
    several in the base frame, where frame and offsets can stand in for each other.

    Raises:
        BadInput: the identification.json beside the model cannot be used.
    """
    path = model.with_name(KNOWLEDGE)
    if poses is None or mechanism.source not in mechanism.inputs or not path.exists():
        return UNKNOWN
    record = read_identification(path)
    knowledge = knowledge_of(record, mechanism, path)
    other = of_other_values(record, mechanism)
    if other:
        return PoseUncertainty(None, None, "base", f"{path.name} is not of this model ({other})")
    names = list(mechanism.registrations)
    name = names[0] if len(names) == 1 else ""
    position, rotation = model_sigma(mechanism, poses, mechanism.registration(name),
                                     knowledge, name, rest_columns(mechanism, len(poses)))
    seen = np.isfinite(position)
    if not seen.any():
        return PoseUncertainty(None, None, name or "base", "no pose has an uncertainty")
    turns = mechanism.motion.turns
    return PoseUncertainty(rms(position[seen]), rms(rotation[seen]) if turns else None,
                           name or "base")
