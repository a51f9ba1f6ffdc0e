"""The border of the program: YAML, CSV and JSON in and out.

Files are in the units that they declare, everything handed on is SI. pydantic lives here and
nowhere else; every refusal is a :class:`ppmcal.errors.BadInput` that names the file, the place
in it and the mend. Names are loaded on first use, so that ``--help`` stays fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ppmcal.io.campaign import read_campaign
    from ppmcal.io.csv import Table
    from ppmcal.io.csv_writer import csv_text
    from ppmcal.io.dataset_reader import read_dataset
    from ppmcal.io.mechanism_reader import read_mechanism
    from ppmcal.io.mechanism_writer import write_mechanism
    from ppmcal.io.output import Output, json_text, provenance
    from ppmcal.io.plausibility import unit_findings
    from ppmcal.io.poses import JointTable, PoseTable, read_joints, read_poses, twists
    from ppmcal.io.scenario import Scenario, read_scenario
    from ppmcal.io.tables import read_table

_HOME = {
    "read_campaign": "campaign", "read_dataset": "dataset_reader",
    "read_mechanism": "mechanism_reader", "write_mechanism": "mechanism_writer",
    "Output": "output", "csv_text": "csv_writer", "json_text": "output", "provenance": "output",
    "unit_findings": "plausibility",
    "JointTable": "poses", "PoseTable": "poses", "read_joints": "poses", "read_poses": "poses",
    "twists": "poses",
    "Scenario": "scenario", "read_scenario": "scenario",
    "Table": "csv", "read_table": "tables",
}

__all__ = [
    "JointTable",
    "Output",
    "PoseTable",
    "Scenario",
    "Table",
    "csv_text",
    "json_text",
    "provenance",
    "read_campaign",
    "read_dataset",
    "read_joints",
    "read_mechanism",
    "read_poses",
    "read_scenario",
    "read_table",
    "twists",
    "unit_findings",
    "write_mechanism",
]


def __getattr__(name: str) -> Any:
    """Load the module that holds ``name`` on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
