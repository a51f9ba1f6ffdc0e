"""What ``ppmcal demo`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import PYTHON, Arguments, Command, Path_, needed


@dataclass(frozen=True)
class DemoArguments(Arguments):
    """Where to."""

    out: Path_ = needed("Folder of the results.", only=PYTHON)


COMMAND = Command(
    "demo", DemoArguments,
    about=("Run the main job once on the sample data: a table-top hexapod seen by a tracker.",
           "Check, identify, compensate, diagnose, inverse kinematics, simulation, sensitivity and "
           "a plan of measurements, one report."),
    examples=("ppmcal demo --out demo-results",), out="demo-results", script=True, recorded=False,
    shares={"check": 0.8, "identify": 0.8, "compensate": 0.2, "diagnose": 17.5, "kinematics": 0.05,
            "simulate": 0.1, "sensitivity": 1.6, "plan": 2.9, "report": 2.6})
