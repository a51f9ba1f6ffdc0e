"""The border of the program: YAML, CSV and JSON in and out.

Files are in the units that they declare, everything handed on is SI. pydantic lives here and
nowhere else; every refusal is a :class:`ppmcal.errors.BadInput` that names the file, the place
in it and the hint. Names are loaded on first use, so that ``--help`` stays fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.lazy import on_first_use

if TYPE_CHECKING:
    from ppmcal.io.campaign import read_campaign as read_campaign
    from ppmcal.io.csv import csv_text as csv_text
    from ppmcal.io.dataset_reader import read_dataset as read_dataset
    from ppmcal.io.mechanism_reader import read_mechanism as read_mechanism
    from ppmcal.io.mechanism_writer import write_mechanism as write_mechanism
    from ppmcal.io.poses import read_joints as read_joints
    from ppmcal.io.poses import read_poses as read_poses
    from ppmcal.io.poses import twists as twists
    from ppmcal.io.scenario import read_scenario as read_scenario
    from ppmcal.io.tables import read_table as read_table

if not TYPE_CHECKING:   # who checks types sees which names there are
    __getattr__ = on_first_use(__name__)
