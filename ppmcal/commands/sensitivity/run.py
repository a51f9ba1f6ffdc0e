"""What each error of the geometry does to the tool."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from ppmcal.commands.inputs import files_of, load
from ppmcal.commands.result import Result
from ppmcal.commands.sensitivity.options import SensitivityArguments
from ppmcal.design.error_sources import all_components as every_component
from ppmcal.design.sensitivity import Sensitivity, SensitivityOptions, analyse
from ppmcal.errors import BadInput, unknown
from ppmcal.io import read_poses
from ppmcal.io.grid import metric_length, read_grid, read_point
from ppmcal.io.results.record import in_units
from ppmcal.io.results.sensitivity import SensitivityRecord
from ppmcal.io.results.sensitivity_tables import ranking, rotates
from ppmcal.kinematics.region import Grid
from ppmcal.kinematics.tables import refuse_singular_home
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.parameters import unmatched
from ppmcal.store.provenance import source_of
from ppmcal.wording import number
from ppmcal.wording.told import ShortTable

SHOWN = 10
"""Errors that the console shows."""


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

    def told(self) -> Iterator[str | ShortTable]:
        """Yield what was found in sentences, and the errors that count most."""
        yield from self.record.summary
        yield _ranking(self.sensitivity)


def run(asked: SensitivityArguments) -> SensitivityResult:
    """Tell what each geometric error of a machine does to the tool."""
    machine = load(asked.mechanism)
    refuse_singular_home(machine)    # about which no grid would be found
    mesh = _grid(machine, asked)
    point, rho = read_point(asked.tool, machine), metric_length(asked.metric, machine)
    if not 0.0 < asked.sigmas < 1e6:
        raise BadInput(f"{asked.sigmas:g} is not a number of standard deviations", "--sigmas",
                       "Write one above 0, such as 3")
    looked = every_component(machine) if asked.all_components else machine
    if asked.free:
        for pattern in unmatched(looked.parameters, asked.free):
            raise unknown("parameter", pattern, looked.names, "--free")
        looked = replace(looked, free=tuple(i for i, p in enumerate(looked.parameters)
                                            if any(p.matches(t) for t in asked.free)))
    wanted = (mesh.poses(machine) if mesh else None if asked.poses is None
              else read_poses(asked.poses, machine).poses)
    named = tuple(asked.together)
    found = analyse(looked, SensitivityOptions(point, rho, asked.sigmas, named,
                                               _size(looked, named, asked.size)), wanted)
    source = source_of("sensitivity", [*machine.inputs, *files_of(asked.poses)], None)
    record = SensitivityRecord.of(found, machine, mesh, source)
    return SensitivityResult(source, tuple(record.findings), machine, found, record, mesh,
                             asked.poses is not None)


def _grid(machine: Mechanism, asked: SensitivityArguments) -> Grid | None:
    if sum((asked.grid is not None, asked.poses is not None, asked.home_only)) > 1:
        raise BadInput("only one of --poses, --grid and --home-only can be given", "",
                       "Leave the others out")
    return None if asked.poses is not None or asked.home_only else read_grid(asked.grid, machine)


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


def _ranking(found: Sensitivity) -> ShortTable:
    """Return the errors that count most."""
    units, both = found.mechanism.units, rotates(found)
    table, mm, deg = in_units(ranking(found), units), units.length, units.angle
    rows = [[table["name"][i], f"{number(table['tolerance'][i])} {table['unit'][i]}",
             number(table["rss_position"][i]), f"{table['share_position'][i]:.1%}",
             *([number(table["rss_rotation"][i])] if both else [])]
            for i in range(min(SHOWN, len(table["name"])))]
    heads = ["error", "tolerance", f"tool rms, {mm}", "share", *([f"rms, {deg}"] if both else [])]
    return ShortTable(heads, rows, (1, 2, 3, 4))
