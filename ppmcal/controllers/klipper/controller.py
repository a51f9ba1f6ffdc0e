"""Lines for the ``printer.cfg`` of a linear delta, and printers as such files have them.

What temperature does to z ``[z_thermal_adjust]`` does not hold on a delta: it adds
-temp_coeff (T - T at homing) to z, T smoothed over ``smooth_time``, but when it connects it looks
for a stepper called ``stepper_z`` (Klipper: ``z_thermal_adjust.py``), which neither kind of delta
has, and the firmware does not start.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.delta.firmware import DeltaFirmware, DeltaFit
from ppmcal.controllers.delta.fit import export_delta
from ppmcal.controllers.delta.geometry import DIGITS, MM, TOWERS, DeltaGeometry, travel, unit_of
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
from ppmcal.controllers.klipper.lines import BLOCK, HEADER, SAVED, split
from ppmcal.controllers.klipper.reading import read_printer
from ppmcal.controllers.klipper.refit import with_own_fit
from ppmcal.controllers.klipper.rotary import export_rotary, imported, is_rotary, is_rotary_delta
from ppmcal.controllers.pose_grid import rest_columns
from ppmcal.controllers.text import exact_text
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.wording import pluralize


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


_KEY = re.compile(r"([A-Za-z0-9_]+)\s*[:=]")
_OWN = "# from here to the block: over numbers of included files"
Places = Mapping[tuple[str, str], str]


def patch(exported: Exported, old: Path) -> Exported:
    """Return the export with a copy of the ``printer.cfg``, as ``SAVE_CONFIG`` would leave it.

    The numbers go into the ``#*#`` block. Lines of the body that would win over it are commented
    out, so that they stay what the printer was meant to be; over a line of an included file, which
    belongs to others, only a later line of the body wins.

    Raises:
        BadInput: a rotary delta's, or Klipper does not read the file's ``#*#`` lines.
        NoResult: the copy would not be read as meant.
    """
    config = read_config(old)
    if is_rotary(config):
        raise BadInput("copies are written of linear deltas alone", "--write",
                       f"Leave it out, and paste the lines of {KLIPPER.file}")
    if config.unread:
        raise BadInput(f"Klipper reads nothing of the #*# lines: {config.unread}", str(old),
                       "Restore them as SAVE_CONFIG wrote them, or leave out --write and paste "
                       "klipper.cfg")
    wanted = read_geometry(parse_config(exported.files[KLIPPER.file], KLIPPER.file))
    body, block = _halves("\n".join(split(exact_text(old))))
    new = {(n.partition(".")[0], n.partition(".")[2]): f"{v:.{DIGITS}f}"
           for n, v in wanted.named().items()}
    body, quiet = _quiet(body, new)
    rest = parse_config("\n".join(body), str(old), old).sections
    over = {place: v for place, v in new.items() if place[1] in rest.get(place[0], {})}
    if over:
        body += ["", _OWN, *_sections(over, "")]
    copy = "\n".join([*body, "", *BLOCK, *_block(block, {k: v for k, v in new.items()
                                                         if k not in over})]) + "\n"
    _check(config, copy, old, wanted)
    told = _told(quiet, over)
    advice = (Note(f"The {COPY} written has the new numbers in its #*# lines{told and '; '}{told}.",
                   NOTE),)
    return replace(exported, files={**exported.files, COPY: copy}, advice=advice, copy=COPY)


def _halves(text: str) -> tuple[list[str], list[str]]:
    """Return the lines of the body and those below the block's header."""
    head = "\n" + "\n".join(BLOCK) + "\n"
    at = text.find(head)
    if at < 0:
        return text.rstrip("\n").split("\n"), []
    block = text[at + len(head):].strip()
    return text[:at].rstrip("\n").split("\n"), block.split("\n") if block else []


def _quiet(lines: list[str], new: Places) -> tuple[list[str], int]:
    """Return the body with the lines of these keys commented out, and how many keys."""
    out, section, inside, count = [], "", False, 0
    for line in lines:
        bare = re.sub("[#;].*", "", line).rstrip()
        header = HEADER.match(bare)
        if header:
            section, inside = header[1].strip(), False
        elif bare and not bare[0].isspace():
            key = _KEY.match(bare)
            inside = key is not None and (section, key[1].lower()) in new
            count += inside
        out.append(f"#{line}" if inside and bare and not header else line)
    return out, count


def _block(lines: list[str], new: Places) -> list[str]:
    """Return the block's lines with these numbers in their sections, or in new ones."""
    out: list[str] = []
    left = dict(new)
    section, inside = "", False
    for line in lines:
        bare = re.sub("[#;].*", "", line[4:]).rstrip()
        header = HEADER.match(bare)
        if header:
            _close(out, left, section)
            section, inside = header[1].strip(), False
        elif bare and not bare[0].isspace():
            key = _KEY.match(bare)
            place = (section, key[1].lower()) if key else ("", "")
            inside = place in new
            if place in left:
                out.append(f"{SAVED} {place[1]} = {left.pop(place)}")
        if not (inside and bare):
            out.append(line)
    _close(out, left, section)
    return out + _sections(left, f"{SAVED} ")


def _close(out: list[str], left: dict[tuple[str, str], str], section: str) -> None:
    """Put the numbers of a section that its lines did not hold to its end."""
    empty = 0
    while empty < len(out) and out[-1 - empty].strip() == SAVED:
        empty += 1
    own = [place for place in left if place[0] == section]
    out[len(out) - empty:len(out) - empty] = [
        f"{SAVED} {place[1]} = {left.pop(place)}" for place in own]


def _sections(places: Places, lead: str) -> list[str]:
    """Return whole sections, each line behind ``lead``."""
    out: list[str] = []
    for section in dict.fromkeys(place[0] for place in places):
        out += [lead.rstrip(), f"{lead}[{section}]"]
        out += [f"{lead}{key} = {v}" for (own, key), v in places.items() if own == section]
    return out


def _check(old: Config, copy: str, path: Path, wanted: DeltaGeometry) -> None:
    """Refuse a copy that does not read as the old file with the wanted geometry."""
    new = parse_config(copy, str(path), path)
    if new.unread or read_geometry(new) != wanted or _others(new) != _others(old):
        raise NoResult("the copy with the new numbers reads back as something else", str(path),
                       "Leave out --write, and paste klipper.cfg above the #*# lines")


def _others(config: Config) -> dict[tuple[str, str], str]:
    """Return section, key -> text of everything but the geometry."""
    own = {"delta_radius", "angle", "arm_length", "position_endstop"}
    return {(section, key): entry.text for section, keys in config.sections.items()
            for key, entry in keys.items()
            if key not in own or not (section == "printer" or section.startswith("stepper_"))}


def _told(quiet: int, over: Places) -> str:
    """Return what was done to the body, empty where nothing."""
    parts = [f"{pluralize(quiet, 'line')} above the #*# lines, which would win over them, "
             f"{'is' if quiet == 1 else 'are'} commented out"] if quiet else []
    parts += [f"{pluralize(len(over), 'number')} of included files stand{'s' * (len(over) == 1)} "
              "anew above the #*# lines, where it takes to win over them"] if over else []
    return "; ".join(parts)


_linear = printer_importer(lambda *asked: with_own_fit(read_printer(*asked)))


def import_config(path: Path, options: Mapping[str, Any]) -> Imported:
    """Return a printer's files; see :class:`ppmcal.controllers.importing.Importer`."""
    if not is_rotary(read_config(path)):
        return _linear(path, options)
    for name, none in (("rods", ()), ("mesh", ()), ("radius", None), ("effector", None)):
        if options.get(name, none) != none:
            raise BadInput("a rotary delta is imported as its file has it", f"--{name}",
                           "Leave it out, and change the machine.yaml that is written")
    return imported(path)
