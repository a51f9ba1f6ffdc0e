"""Lines for the ``printer.cfg`` of a linear delta, and printers as such files have them.

What temperature does to z ``[z_thermal_adjust]`` does not hold on a delta: it adds
-temp_coeff (T - T at homing) to z, T smoothed over ``smooth_time``, but when it connects it looks
for a stepper called ``stepper_z`` (Klipper: ``z_thermal_adjust.py``), which neither kind of delta
has, and the firmware does not start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.delta.firmware import DeltaFirmware, DeltaFit
from ppmcal.controllers.delta.fit import export_delta
from ppmcal.controllers.delta.geometry import MM, TOWERS, DeltaGeometry, travel, unit_of
from ppmcal.controllers.delta.importer import printer_importer
from ppmcal.controllers.export import Exported, refuse_poses
from ppmcal.controllers.importing import Imported
from ppmcal.controllers.klipper.config import (
    Config,
    config_lines,
    parse_config,
    read_config,
    read_geometry,
)
from ppmcal.controllers.klipper.patch import patched
from ppmcal.controllers.klipper.reading import read_printer
from ppmcal.controllers.klipper.refit import with_own_fit
from ppmcal.controllers.klipper.rotary import is_rotary
from ppmcal.controllers.klipper.rotary_machine import export_rotary, imported, is_rotary_delta
from ppmcal.controllers.pose_grid import rest_columns
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note


def thermal_notes(mechanism: Mechanism, poses: Array | None) -> Iterator[Note]:
    """Yield how far each kelvin lifts the nozzle over poses (N, 6), where an effect says so."""
    own = tuple(e for e in mechanism.effects
                if "temperature" in e.kind.needs and not e.kind.instrument)
    if not own or poses is None:
        return
    rise = lifts(replace(mechanism, effects=own), poses) / MM
    if not rise.size:
        return
    names = ", ".join(dict.fromkeys(e.kind.name for e in own))
    yield Note(
        f"{names}: the nozzle rises by {rise.mean():.4g} mm in z per kelvin, from {rise.min():.4g} "
        f"to {rise.max():.4g} over the bed. temp_coeff: {rise.mean():.6f} in [z_thermal_adjust] "
        "would undo the mean, but that section asks for a stepper_z, and Klipper does not start "
        "with it on a delta: it is not written. SET_GCODE_OFFSET Z does the same by hand", NOTE)


def lifts(mechanism: Mechanism, poses: Array) -> Array:
    """Return how far one kelvin lifts the platform at poses (N, 6), at rest: (n,), m."""
    q = inverse_partial(Model(replace(mechanism, effects=())), poses).q
    q = q[finite_rows(q)]
    rest = rest_columns(mechanism, len(q))
    z = [cga.translation(reached_poses(Model(mechanism), q, environment(
        {**rest, "temperature": rest["temperature"] + by}, mechanism.actuators, mechanism.gravity,
        np.zeros_like(q))).pose)[:, 2] for by in (0.0, 1.0)]
    rise = z[1] - z[0]
    return np.asarray(rise[np.isfinite(rise)])


COPY = "printer.cfg"


def _advice(found: DeltaFit[DeltaGeometry], old: Path | None, config: Config | None
            ) -> Iterator[Note]:
    if old is not None:
        yield Note(
            f"Paste the lines of {KLIPPER.file} into {old}, above its #*# lines and below all "
            "other sections: there they win; or --write changes it.", NOTE)


def refuse_endstops(new: DeltaGeometry, source: str) -> None:
    """Refuse endstops that the firmware would not take: it counts them up from the bed, mm.

    Raises:
        NoResult: one of them is at the bed or below it.
    """
    for tower, end in zip(TOWERS, new.endstops, strict=True):
        if end <= 0.0:
            raise NoResult(f"position_endstop of stepper_{tower} would be {end:.6g} mm, which is "
                           "not above the bed: Klipper refuses it", source,
                           "Check `home`, `limits` and the height of the towers' points: the bed "
                           "is z = 0")


KLIPPER = DeltaFirmware(
    "klipper", "Klipper", "klipper.cfg", ("stepper_a", "stepper_b", "stepper_c"), "delta_radius",
    "position_endstop", "multiply its rotation_distance by that", read_config, parse_config,
    read_geometry, lambda geometry, _: geometry, travel,
    table=lambda geometry: ((name, unit_of(name), v) for name, v in geometry.named().items()),
    text=lambda geometry, comment: config_lines(geometry.named(), comment),
    how=lambda _: (
        "Paste above the #*# lines of printer.cfg, below all other sections: there they win",
        "over earlier values, over those of included files, and over the #*# lines."),
    advice=_advice, check=refuse_endstops, fitted="most of it, fitted")


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return the machine in Klipper's numbers; see :class:`ppmcal.controllers.export.Exporter`."""
    if is_rotary_delta(mechanism):
        refuse_poses(KLIPPER.name, poses)
        made = export_rotary(mechanism, old)
    else:
        made = export_delta(KLIPPER, mechanism, old, poses)
    return replace(made, notes=(*made.notes, *thermal_notes(mechanism, made.poses)))


def patch(exported: Exported, old: Path) -> Exported:
    """Return the export with a copy of the ``printer.cfg`` that holds the new numbers.

    Raises:
        BadInput, NoResult: there is no such copy.
    """
    if is_rotary(read_config(old)):
        raise BadInput("copies are written of linear deltas alone", "--write",
                       f"Leave it out, and paste the lines of {KLIPPER.file}")
    wanted = read_geometry(parse_config(exported.files[KLIPPER.file], KLIPPER.file))
    text, told = patched(old, wanted)
    advice = (Note(f"The {COPY} written has the new numbers in its #*# lines{told and '; '}{told}.",
                   NOTE),)
    return replace(exported, files={**exported.files, COPY: text}, advice=advice, copy=COPY)


_linear = printer_importer(lambda *asked: with_own_fit(read_printer(*asked)))


def import_config(path: Path, options: Mapping[str, Any]) -> Imported:
    """Return a printer's files; see :class:`ppmcal.controllers.importing.Importer`."""
    if not is_rotary(read_config(path)):
        return _linear(path, options)
    for name, none in (("rods", ()), ("mesh", ()), ("radius", None)):
        if options.get(name, none) != none:
            raise BadInput("a rotary delta is imported as its file has it", f"--{name}",
                           "Leave it out, and change machine.yaml")
    return imported(path)
