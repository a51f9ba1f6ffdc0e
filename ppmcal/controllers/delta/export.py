"""The export of a linear delta, in the numbers of any firmware that declares them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.controllers.delta.firmware import DeltaFirmware
from ppmcal.controllers.delta.fit import DISC, HEIGHTS, project
from ppmcal.controllers.delta.geometry import MM
from ppmcal.controllers.export import Exported, Number, head, misread, refuse_poses
from ppmcal.model.mechanism import Mechanism


def export_delta(firmware: DeltaFirmware[Any, Any], mechanism: Mechanism, old: Path | None,
                 poses: Path | None) -> Exported:
    """Return the machine in a firmware's numbers; see :class:`ppmcal.controllers.export.Exporter`.

    Raises:
        BadInput: no linear delta, or an option without use.
        NoResult: the lines would not be read as meant, or the firmware would not take them.
    """
    refuse_poses(firmware.name, poses)
    config = None if old is None else firmware.read(old)
    found = project(mechanism, firmware, None if config is None else firmware.numbers(config))
    notes = (*found.notes, *firmware.notes(found))
    text = firmware.text(found.new, head(mechanism.name, found.before, found.after,
                                         found.not_expressed, notes, firmware.how(found.new)))
    if firmware.numbers(firmware.parse(text, firmware.file)) != found.new:
        raise misread(firmware.file)
    firmware.check(found.new, mechanism.source)
    before = {(name, unit): value for name, unit, value in firmware.table(found.old)}
    return Exported(
        firmware.name, firmware.title, {firmware.file: text},
        f"{firmware.title}'s numbers hold "
        + ("all of the geometry" if found.exact else firmware.fitted),
        tuple(Number(name, before.get((name, unit)), value, unit)
              for name, unit, value in firmware.table(found.new)),
        f"{len(found.points)} points, {found.radius * 1e3:.0f} mm around the middle, z 0 to 100 "
        "mm; offset and rotation on the bed ignored",
        found.before, found.after, found.not_expressed, notes,
        tuple(firmware.advice(found, old, config)),
        {"grid": {"points": len(found.points), "radius": found.radius / MM,
                  "part_of_radius": DISC, "z": [z / MM for z in HEIGHTS]}},
        np.pad(found.points, ((0, 0), (0, 3))))
