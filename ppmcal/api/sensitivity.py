"""What each error of the geometry does to the tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from ppmcal.api.inputs import Machine, files_of, load, recorded, source_of
from ppmcal.api.result import Result
from ppmcal.design.error_sources import all_components as every_component
from ppmcal.design.sensitivity import Sensitivity, SensitivityOptions, analyse
from ppmcal.errors import BadInput, unknown
from ppmcal.io import read_poses
from ppmcal.io.grid import metric_length, read_grid, read_point
from ppmcal.io.results.sensitivity import SensitivityRecord
from ppmcal.kinematics.region import Grid
from ppmcal.kinematics.tables import refuse_singular_home
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.parameters import unmatched


@dataclass(frozen=True, eq=False, repr=False)
class SensitivityResult(Result):
    """What the errors of a geometry do to the tool.

    Attributes:
        mechanism: the machine.
        sensitivity: the error Jacobian at home and over poses, amplification, linearity, SI.
        record: the content of sensitivity.json.
        grid: of the map, None without one; chosen_poses: whether poses were given instead.
    """

    COMMAND: ClassVar[str] = "sensitivity"
    TABLE: ClassVar[str] = "sensitivity.csv"

    mechanism: Mechanism
    sensitivity: Sensitivity
    record: SensitivityRecord
    grid: Grid | None
    chosen_poses: bool

    def files(self) -> Mapping[str, str | bytes]:
        """Return sensitivity.csv, map.csv, linearity.csv, pictures and sensitivity.json."""
        return dict(self.record.files(self.sensitivity, self.grid, self.chosen_poses))

    def headline(self) -> str:
        """Return the first sentence of what was found."""
        return self.record.said[0]


@recorded
def sensitivity(mechanism: Machine, *, poses: Any = None, grid: str | None = None,
                home_only: bool = False, all_components: bool = False, free: Sequence[str] = (),
                tool: str | Sequence[float] | None = None, metric: float | None = None,
                sigmas: float = 1.0, together: Sequence[str] = (), size: float | None = None
                ) -> SensitivityResult:
    """Tell what each geometric error of a machine does to the tool.

    Args:
        mechanism: the machine, or its file.
        poses: poses to look at, as a file or a table in memory.
        grid: poses of a grid about home, such as ``x=-100:100:41,y``  [default: a map of the
            first two coordinates].
        home_only: look at home alone.
        all_components: all error components of every joint frame and the platform points.
        free: errors to look at, by patterns of their names  [default: the free parameters].
        tool: the tool point ``X,Y,Z``, or its numbers, in platform axes  [default: the
            platform's origin].
        metric: an angular error of sigma/metric counts like a length error of sigma.
        sigmas: worst case: every error at this many standard deviations.
        together: try the linear model with these errors all off by the same amount.
        size: with ``together``: also what an error of this size does, file units.

    Raises:
        BadInput: anything wrong in the files or options. NoResult: home is singular.
    """
    machine = load(mechanism)
    refuse_singular_home(machine)    # about which no grid would be found
    mesh = _grid(machine, grid, poses, home_only)
    point, rho = read_point(tool, machine), metric_length(metric, machine)
    if not 0.0 < sigmas < 1e6:
        raise BadInput(f"{sigmas:g} is not a number of standard deviations", "--sigmas",
                       "Write one above 0, such as 3")
    looked = every_component(machine) if all_components else machine
    if free:
        looked = _narrowed(looked, tuple(free))
    wanted = (mesh.poses(machine) if mesh else None if poses is None
              else read_poses(poses, machine).poses)
    named = tuple(together)
    found = analyse(looked, SensitivityOptions(point, rho, sigmas, named,
                                               _size(looked, named, size)), wanted)
    source = source_of("sensitivity", [*machine.inputs, *files_of(poses)], None)
    record = SensitivityRecord.of(found, machine, mesh, source)
    return SensitivityResult(source, tuple(record.findings), machine, found, record, mesh,
                             poses is not None)


def _grid(machine: Mechanism, grid: str | None, poses: Any, home_only: bool
          ) -> Grid | None:
    if sum((grid is not None, poses is not None, home_only)) > 1:
        raise BadInput("only one of --poses, --grid and --home-only can be given", "",
                       "Leave the others out")
    return None if poses is not None or home_only else read_grid(grid, machine)


def _size(machine: Mechanism, together: tuple[str, ...], size: float | None) -> float | None:
    """Return the size of errors moved together in SI."""
    if size is None:
        return None
    if not together:
        raise BadInput("goes with --together", "--size", "Name the errors that are off by it")
    if not 0.0 < abs(size) < 1e12:
        raise BadInput(f"{size:g} is not the size of an error", "--size", "Write another number")
    named = [p for i in machine.free for p in (machine.parameters[i],)
             if any(p.matches(t) for t in together)]
    return size * machine.units.factor(named[0].quantity if named else "length")


def _narrowed(machine: Mechanism, patterns: tuple[str, ...]) -> Mechanism:
    for pattern in unmatched(machine.parameters, patterns):
        raise unknown("parameter", pattern, machine.names, "--free")
    return replace(machine, free=tuple(
        i for i, p in enumerate(machine.parameters) if any(p.matches(t) for t in patterns)))
