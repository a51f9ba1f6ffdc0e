"""What tests of several packages share: campaigns written to files and read back."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from ppmcal.calibration.fit import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.interpretation import InterpretationError, refuse_before_fit
from ppmcal.calibration.interpretation.read_rightly import refuse_after_fit
from ppmcal.io import read_campaign
from ppmcal.io.results.simulation import files
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.simulation.scenario import Scenario
from ppmcal.simulation.simulate import Campaign, simulate


@dataclass(frozen=True)
class Run:
    """A machine, what was simulated with it, and the data set that its files read as."""

    mechanism: Mechanism
    scenario: Scenario
    truth: Campaign
    data: Dataset

    @property
    def problem(self) -> Problem:
        return Problem(self.mechanism, (self.data,), self.mechanism.free)


def run(mechanism: Mechanism, scenario: Scenario, seed: int = 1, name: str = "a") -> Run:
    """Simulate a campaign, write its files and read them back."""
    campaign = simulate(mechanism, scenario, seed)
    with tempfile.TemporaryDirectory() as folder:
        for file, text in files(mechanism, scenario, campaign, name, {}).items():
            (Path(folder) / file).write_text(str(text), encoding="utf-8")
        data = read_campaign([Path(folder) / "measurements.csv"], mechanism)[0]
    return Run(mechanism, scenario, campaign, data)


def refusal(problem: Problem) -> InterpretationError | None:
    """Return why a campaign is refused, before a fit or after it; None if it is accepted."""
    try:
        refuse_before_fit(problem)
        refuse_after_fit(identify(problem))
    except InterpretationError as error:
        return error
    return None
