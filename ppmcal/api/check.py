"""A mechanism file, alone or with its measurements, before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np

from ppmcal.api.inputs import Machine, Measurements, Path_, data_files, prepared
from ppmcal.calibration.interpretation import Check
from ppmcal.calibration.interpretation import check as checked
from ppmcal.io import unit_findings
from ppmcal.io.results.scene import Scene
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism


@dataclass(frozen=True)
class CheckResult(Check):
    """What check found, with the machine, so that it can be drawn.

    Attributes:
        mechanism: the machine that was checked.
        inputs: the files that it and its measurements were read from.
    """

    mechanism: Mechanism | None = None
    inputs: tuple[str, ...] = ()

    @classmethod
    def of_machine(cls, mechanism: Mechanism, datasets: Sequence[Dataset] = ()) -> CheckResult:
        """Return a machine that nothing is found of, to be drawn: it may not reach home."""
        return cls((), (), float("nan"), np.full(len(mechanism.actuators), np.nan),
                   mechanism=mechanism, inputs=(*mechanism.inputs, *data_files(datasets)))

    @cached_property
    def scene(self) -> Scene:
        """The machine at home and at poses about it, in the units of its file."""
        assert self.mechanism is not None
        return Scene.of(self.mechanism)

    def draw(self, path: Path_) -> Path:
        """Write the machine, drawn to scale: one HTML page that needs no network.

        Args:
            path: the page; an earlier drawing there is replaced.

        Raises:
            BadInput: it cannot be written, or something other than a drawing is there.
        """
        from ppmcal.report.drawing import drawing_page, write_drawing

        assert self.mechanism is not None
        target = Path(path)
        write_drawing(target, drawing_page(self.scene, self.mechanism.source), self.inputs)
        return target


def check(mechanism: Machine, data: Measurements = ()) -> CheckResult:
    """Check a machine, and what measurements can tell of it.

    Args:
        mechanism: the machine, or its file.
        data: data sets, or paths of measurement files; none: the file alone.

    Returns:
        Gaps and conditioning at home, rank, and findings that need a look; ``draw(path)`` draws
        the machine.

    Raises:
        BadInput: anything wrong in the files, with file, place and mend.
    """
    machine, datasets = prepared(mechanism, data, needed=False)
    found = checked(machine, datasets, unit_findings(machine, datasets))
    return CheckResult(**{f.name: getattr(found, f.name) for f in fields(found)},
                       mechanism=machine, inputs=(*machine.inputs, *data_files(datasets)))
