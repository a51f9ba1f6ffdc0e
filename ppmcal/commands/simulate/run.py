"""Measurements of a machine with injected errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.commands.inputs import load, read_data
from ppmcal.commands.result import Result
from ppmcal.commands.simulate.options import SimulateArguments
from ppmcal.commands.spec import Path_
from ppmcal.io import read_scenario
from ppmcal.io.results.simulation import files
from ppmcal.io.tables import is_path
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Scenario
from ppmcal.simulation.simulate import Campaign
from ppmcal.simulation.simulate import simulate as simulated
from ppmcal.store.output import Content
from ppmcal.store.provenance import source_of
from ppmcal.wording import pluralize


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
        named = replace(self, name=Path(folder).name)
        return super(SimulationResult, named).save(folder, force)

    @cached_property
    def data(self) -> tuple[Dataset, ...]:
        """The measurements as a user would get them: what is true is not in it."""
        import yaml

        sidecar = yaml.safe_load(str(self.files()["measurements.yaml"]))
        return read_data(self.mechanism, self.to_frame(), sidecar=sidecar)

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        found = self.campaign
        return {"format": "ppmcal/simulation/1", "rows": len(found.time),
                "poses": len(set(found.pose.tolist())), "left_out": list(found.left_out),
                "provenance": self.provenance}

    def headline(self) -> str:
        """Return rows, poses, instrument and seed."""
        rows, poses = len(self.campaign.time), len(set(self.campaign.pose.tolist()))
        return (f"{self.mechanism.name}: {pluralize(rows, 'row')} at {pluralize(poses, 'pose')}, "
                f"instrument {self.scenario.kind}, seed {self.provenance['seed']}; "
                f"{pluralize(int(self.campaign.outlier.sum()), 'outlier')} injected.")


def run(asked: SimulateArguments) -> SimulationResult:
    """Simulate measurements of a machine."""
    machine = load(asked.mechanism)
    plan = read_scenario(asked.scenario, machine)
    campaign = simulated(machine, plan, asked.seed)
    inputs = [*machine.inputs, *([asked.scenario] if is_path(asked.scenario) else [])]
    source = source_of("simulate", inputs, plan.seed if asked.seed is None else asked.seed)
    return SimulationResult(source, tuple(campaign.left_out), machine, plan, campaign)
