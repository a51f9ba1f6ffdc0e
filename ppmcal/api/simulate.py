"""Measurements of a machine with injected errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.api.inputs import Machine, Path_, load, read_data, recorded, source_of
from ppmcal.api.result import Result
from ppmcal.io import read_scenario
from ppmcal.io.csv_writer import Content
from ppmcal.io.frames import is_path
from ppmcal.io.results.simulation import files
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Scenario
from ppmcal.simulation.simulate import Campaign
from ppmcal.simulation.simulate import simulate as simulated
from ppmcal.wording import counted


@dataclass(frozen=True, eq=False, repr=False)
class SimulationResult(Result):
    """A simulated campaign.

    Attributes:
        mechanism, scenario: what was simulated.
        campaign: rows as the instrument shows them, SI, with what is true.
    """

    COMMAND: ClassVar[str] = "simulate"
    TABLE: ClassVar[str] = "measurements.csv"

    mechanism: Mechanism
    scenario: Scenario
    campaign: Campaign
    name: str = "simulated"

    def files(self) -> Mapping[str, Content]:
        """Return measurements.csv, measurements.yaml and truth.json."""
        return dict(files(self.mechanism, self.scenario, self.campaign, self.name,
                          self.provenance))

    def save(self, folder: Path_, force: bool = False) -> list[Path]:
        """Write the command's files; the data set is called like the folder."""
        named = SimulationResult(self.provenance, self.findings, self.mechanism, self.scenario,
                                 self.campaign, Path(folder).name)
        return super(SimulationResult, named).save(folder, force)

    @cached_property
    def data(self) -> tuple[Dataset, ...]:
        """The measurements as a user would get them: what is true is not in it."""
        import yaml

        sidecar = yaml.safe_load(str(self.files()["measurements.yaml"]))
        return read_data(self.mechanism, self.to_frame(), sidecar=sidecar)

    def headline(self) -> str:
        """Return rows, poses, instrument and seed."""
        rows, poses = len(self.campaign.time), len(set(self.campaign.pose.tolist()))
        return (f"{self.mechanism.name}: {counted(rows, 'row')} at {counted(poses, 'pose')}, "
                f"instrument {self.scenario.kind}, seed {self.provenance['seed']}; "
                f"{counted(int(self.campaign.outlier.sum()), 'outlier')} injected.")


@recorded
def simulate(mechanism: Machine, scenario: Path_ | Mapping[str, Any], *, seed: int | None = None
             ) -> SimulationResult:
    """Simulate measurements of a machine.

    Args:
        mechanism: the machine, or its file.
        scenario: path of a scenario file, or a mapping with its keys.
        seed: of the noise, in place of the scenario's.

    Raises:
        BadInput: anything wrong in the files. NoResult: no pose can be reached.
    """
    machine = load(mechanism)
    plan = read_scenario(scenario, machine)
    campaign = simulated(machine, plan, seed)
    inputs = [*machine.inputs, *([scenario] if is_path(scenario) else [])]
    source = source_of("simulate", inputs, plan.seed if seed is None else seed)
    return SimulationResult(source, tuple(campaign.left_out), machine, plan, campaign)
