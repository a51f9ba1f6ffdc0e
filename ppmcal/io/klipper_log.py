"""Logs of Klipper: where GET_POSITION says the carriages are.

The lines ``stepper: stepper_a:297.5 stepper_b:...`` hold each carriage's place in mm. Lines
``probe at x,y is z=...`` hold no joint values: ``ppmcal import klipper --mesh`` reads them.
"""

from __future__ import annotations

import re

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table, cleaned
from ppmcal.io.ros_tables import Recording
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note

_ROW = re.compile(r"^(?:[^\w\n]*Recv: )?[^\w\n]*stepper:"
                  r"((?:[^\S\n]+\w+:[-+]?\d+(?:\.\d*)?)+)[^\S\n]*$", re.MULTILINE | re.ASCII)
_VALUE = re.compile(r"(?:stepper_)?(\w+):([-+]?\d+(?:\.\d*)?)", re.ASCII)
_PROBE = re.compile(r"probe at [-+.\d]+\s*,\s*[-+.\d]+ is z=", re.ASCII)


def klipper_log(data: bytes, source: str, mechanism: Mechanism) -> Recording | None:
    """Return the joint values of a log, None for any other file.

    The rows are called 1, 2, ... in the order of the log.

    Raises:
        BadInput: probed points only, drives that the machine does not have, or joint values of
            the machine that are not lengths.
    """
    if b"stepper:" not in data and b"probe at " not in data:
        return None
    text = cleaned(data, source).decode("utf-8")
    found, probed = _ROW.findall(text), len(_PROBE.findall(text))
    if not found:
        if not probed:
            return None
        raise BadInput(f"has {probed} lines `probe at x,y is z=...`, which hold no joint values",
                       source, "Read them with ppmcal import klipper printer.cfg --mesh THIS, or "
                       "have GET_POSITION say after each touch where the carriages are")
    rows = [dict(_VALUE.findall(line)) for line in found]
    for i, row in enumerate(rows):
        missing = [a for a in mechanism.actuators if a not in row]
        if missing:
            raise BadInput(f"line {i + 1} with `stepper:` has no stepper_{missing[0]}", source,
                           f"Its drives are {', '.join(row)}; those of the machine "
                           f"{', '.join(mechanism.actuators)}: name them alike")
    for a, quantity, bare in zip(mechanism.actuators, mechanism.actuator_quantity,
                                 mechanism.actuator_has_ratio, strict=True):
        if bare or quantity != "length":
            raise BadInput(f"Klipper says where the carriages are in mm, and q_{a} of this machine "
                           "is not a length", source, "Give a mechanism file without `ratio`, "
                           "whose joint value is the carriage's height in mm")
    header = ("pose", *(f"q_{a} [mm]" for a in mechanism.actuators))
    numbers = {f"q_{a} [mm]": np.array([float(r[a]) for r in rows]) for a in mechanism.actuators}
    table = Table(source, header, {"pose": np.arange(1.0, len(rows) + 1.0), **numbers}, {},
                  len(rows))
    origin = dict.fromkeys(header[1:], "`stepper:` lines of GET_POSITION")
    shown = {f"q_{a} [mm]": f"stepper_{a}" for a in mechanism.actuators}
    findings = (Note(f"{source}: {probed} lines `probe at` are not used: ppmcal import klipper "
                     "--mesh reads them."),) if probed else ()
    return Recording(table, "log of Klipper", (), findings,
                     {**origin, "pose": "count of the lines"}, {**shown, "pose": "(none)"})
