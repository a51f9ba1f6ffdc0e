"""A ``printer.cfg`` as a printer with what it measured, and what it was meant to be.

``SAVE_CONFIG`` writes what a calibration found into ``#*#`` lines at the end and comments the
earlier value out where it stands. The saved numbers are a result of the very touches that are to
be fitted; taken as nominal and prior they would be believed twice. What the printer was meant to
be is in the body, comments included.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ppmcal.controllers.delta.geometry import (
    ANGLES,
    KEYS,
    MM,
    TOWERS,
    DeltaGeometry,
    Triple,
    travel,
    triple,
)
from ppmcal.controllers.delta.printer import (
    FAR,
    WIDE_RODS,
    Mesh,
    Nominal,
    Printer,
    far_radius,
    far_rods,
    in_rows,
    mesh_of,
    nominal_of,
)
from ppmcal.controllers.klipper.config import (
    LARGEST,
    Config,
    moved,
    read_config,
    read_geometry,
    read_step,
    read_touches,
)
from ppmcal.controllers.klipper.lines import HEADER
from ppmcal.controllers.text import DECIMAL, NUMBER
from ppmcal.errors import BadInput, unknown
from ppmcal.linalg import Array
from ppmcal.notes import Note
from ppmcal.store.inputs import read_bytes

_GEOMETRY = tuple(name.split(".") for name in KEYS)
PROBES = ("probe", "bltouch", "smart_effector", "beacon", "cartographer", "scanner", "idm",
          "dockable_probe")
"""Sections that hold a probe's offsets, besides those that begin with probe_."""
FLAT_ROW = 0.05
"""Touches whose x differ by less, mm, do not tell a direction of travel."""
SKEW = 5.0
"""An angle that the printer is farther from than this, degrees, was never its own."""
_VALUE = r"([-+]?\d+(?:\.\d*)?)"
_TOUCH = re.compile(rf"probe at {_VALUE}\s*,\s*{_VALUE} is z={_VALUE}", re.ASCII)
_LINE = re.compile(r"(?P<out>[#;]*)\s*(?P<key>[A-Za-z_]+)\s*[:=]\s*"
                   rf"(?P<value>{NUMBER})\s*(?:[#;].*)?$", re.ASCII)
_COMMENT, _BODY, _SAVED = "a comment", "the file", "the saved calibration"


def read_printer(path: str | os.PathLike[str], rods: float | None = None,
                 meshes: Sequence[str] = (), radius: float | None = None) -> Printer:
    """Return the printer of a ``printer.cfg`` with what its calibration measured.

    ``meshes``: names of saved bed meshes, or logs with lines ``probe at x,y is z=...``.
    """
    config = read_config(path)
    if "kinematics" not in config.section("printer"):
        raise BadInput("is missing", config.at("printer", "kinematics"),
                       "Only linear delta printers are read: `kinematics: delta`")
    geometry, result = read_geometry(config), read_geometry(config.as_saved())
    nominal = read_nominal(config, result, rods, radius)
    steps = [read_step(config, f"stepper_{t}") for t in TOWERS]
    *touches, by_nozzle = read_touches(config, _probe(config, "z_offset"))
    heights, distances = (moved(rows, steps) for rows in touches)
    beds = tuple(_mesh(config, geometry, name) for name in meshes)
    findings = [Note(f"[include {name}] is not beside the file, and not followed: what stands "
                     "there is not known") for name in config.includes]
    findings += _overruled(config)
    own = config.as_saved().sections
    saved = any(key in own.get(section, {}) and own[section][key].saved
                for section, key in _GEOMETRY)
    if not heights and not beds:
        held = ", ".join(_mesh_names(config))
        findings.append(Note(
            "the file holds no measured heights: run DELTA_CALIBRATE and SAVE_CONFIG "
            "on the printer, then import again"
            + (f"; or import a mesh with --mesh: {held}" if held else "")))
    elif len(heights) < len(TOWERS) + 3 and not distances and not beds:
        findings.append(Note(
            f"{len(heights)} heights cannot tell 6 parameters apart: measure more"))
    findings += [*nominal.findings, *(f for bed in beds for f in bed.findings)]
    return Printer(str(path), geometry, nominal, saved, tuple(heights),
                   tuple(distances), beds, tuple(findings), result, config.files,
                   probe=(_probe(config, "x_offset"), _probe(config, "y_offset")),
                   by_hand=by_nozzle, probed=_section(config) is not None)


def _equal(one: str, two: str) -> bool:
    """Return whether two texts are one number."""
    if DECIMAL.fullmatch(one) and DECIMAL.fullmatch(two):
        return float(one) == float(two)
    return one == two


def _overruled(config: Config) -> list[Note]:
    """Return what to say of saved numbers that the firmware does not take."""
    if config.unread:
        return [Note(f"Klipper reads nothing of the #*# lines: {config.unread}. What they hold is "
                     "taken here as saved; the printer prints without it")]
    out = []
    for section, key in _GEOMETRY:
        saved = config.hidden.get(section, {}).get(key)
        now = config.sections.get(section, {}).get(key)
        if saved is not None and now is not None and not _equal(now.text, saved.text):
            out.append(f"[{section}] {key} {now.text} (line {now.line}) wins over the {saved.text} "
                       f"that the printer saved (line {saved.line})")
    return [Note(
        f"{out[0]}{f', and so do {len(out) - 1} more' if out[1:] else ''}: Klipper takes what "
        "stands above the #*# lines, so it does not print with its calibration. Comment them "
        "out there, or `ppmcal export klipper ... --write`")] if out else []


def _mesh_names(config: Config) -> list[str]:
    return [name.removeprefix("bed_mesh ") for name in config.sections
            if name.startswith("bed_mesh ")]


def _mesh(config: Config, geometry: DeltaGeometry, name: str) -> Mesh:
    """Return a saved mesh, or the touches of a log, as carriages of the printer."""
    log = Path(name).is_file()
    point, way, label = _logged(Path(name)) if log else (*_grid(config, name), name)
    offset = _probe(config, "z_offset")
    if not log:
        point = point - np.array([*_off(config, name), -offset])
    with np.errstate(invalid="ignore"):
        down = travel(geometry, MM * point) / MM
    return mesh_of(label, f"mesh {label}", offset, down, way)


def _grid(config: Config, name: str) -> tuple[Array, Array]:
    """Return the touches of a saved mesh (N, 3), mm, in their order, and the way along x (N,).

    Rows go up along y, the first from left to right, the next back. Points of a round mesh that
    are outside its radius were never touched: the file holds their neighbours there (bed_mesh.py
    of Klipper: ``generate_points``, ``probe_finalize``).
    """
    section = f"bed_mesh {name}"
    if section not in config.sections:
        raise unknown("mesh", name, _mesh_names(config), config.source)
    nx, ny = (int(config.number(section, key, positive=True)) for key in ("x_count", "y_count"))
    low, high = (np.array([config.number(section, f"{end}_{c}") for c in "xy"])
                 for end in ("min", "max"))
    entry = config.sections[section].get("points")
    values = [] if entry is None else [float(v) for v in DECIMAL.findall(entry.text)]
    if len(values) != nx * ny or nx < 2 or ny < 2:
        raise BadInput(f"{len(values)} heights stand here, and x_count times y_count is {nx * ny}",
                       config.at(section, "points"), "Take the block as the printer saved it")
    x, y = np.linspace(low[0], high[0], nx), np.linspace(low[1], high[1], ny)
    point = np.stack([*np.meshgrid(x, y), np.reshape(values, (ny, nx))], axis=-1)
    own = config.sections.get("bed_mesh", {})
    middle = np.zeros(2)
    reach = np.inf
    if "mesh_radius" in own:
        reach = np.floor(10.0 * config.number("bed_mesh", "mesh_radius", positive=True)) / 10.0
        if "mesh_origin" in own:
            middle = np.array(config.numbers("bed_mesh", "mesh_origin", 2))
    return in_rows(point, reach + 1e-3 >= np.hypot(*(point[..., :2] - middle).T).T)


def _off(config: Config, name: str) -> Array:
    """Return how far the points of a mesh are from the nozzle at its touches (2,), mm.

    Points are where the probe was; meshes that keep offsets of their own hold the nozzle's.
    """
    if "x_offset" in config.sections[f"bed_mesh {name}"]:
        return np.zeros(2)
    return np.array([_probe(config, "x_offset"), _probe(config, "y_offset")])


def _probe(config: Config, key: str) -> float:
    """Return an offset of the probe, mm, 0 without one."""
    section = _section(config)
    return 0.0 if section is None else config.number(section, key, 0.0)


def _section(config: Config) -> str | None:
    """Return the section of the probe, None without one."""
    return next((name for name in config.sections
                 if name in PROBES or name.startswith("probe_")), None)


def _logged(path: Path) -> tuple[Array, Array, str]:
    """Return nozzle positions (N, 3), mm, of the touches in a log, the ways (N,), and a name."""
    text = read_bytes(path).decode("utf-8", errors="replace")
    found = [tuple(map(float, m.groups())) for m in _TOUCH.finditer(text)]
    if len(found) < 3:
        raise BadInput(f"{len(found)} lines such as `probe at 0.000,0.000 is z=1.234` stand here",
                       str(path), "Give a log of the console or klippy.log with a bed's touches")
    point = np.array(found)
    if not np.all(np.abs(point) <= LARGEST):
        raise BadInput("a touch lies where no printer reaches", str(path),
                       f"Take out lines with numbers above {LARGEST:g}")
    moved = np.diff(point[:, 0], prepend=point[:1, 0])
    # repeats of a touch, and steps along y, go on as the move before
    last = np.maximum.accumulate(np.where(np.abs(moved) <= FLAT_ROW, 0, np.arange(len(point))))
    return point, np.where(moved[last] < 0.0, -1.0, 1.0), path.stem


def read_nominal(config: Config, active: DeltaGeometry, rods: float | None = None,
                 given: float | None = None) -> Nominal:
    """Return the nominal geometry of a printer whose last calibration gave ``active``.

    ``rods``, ``given``: their length, and delta_radius, as the user knows them, mm.

    Raises:
        BadInput: ``rods`` do not reach the middle.
    """
    body, told = _body(config)
    findings = list(told)
    if given is not None:
        radius, radius_from = given, "--radius"
        findings += far_radius(given, active.radius)
    else:
        radius, radius_from = _one(config, body, "printer", "delta_radius", active.radius)
        if abs(radius - active.radius) > FAR:
            findings.append(_placeholder("delta_radius", radius, active.radius, radius_from))
            radius, radius_from = active.radius, _SAVED
    findings += far_rods(rods, active.arms)
    arms, arms_from, known = _rods(config, body, active, rods, findings)
    ends, ends_from = _towers(config, body, "position_endstop", active.endstops)
    if max(abs(e - own) for e, own in zip(ends, active.endstops, strict=True)) > FAR:
        findings.append(_placeholder("position_endstop", ends[0], active.endstops[0], ends_from))
        ends, ends_from = active.endstops, _SAVED
    origin = {"delta_radius": radius_from, "rods": arms_from, "endstops": ends_from}
    return nominal_of(
        config.source, DeltaGeometry(radius, _angles(body, active), arms, ends), active, origin,
        rods, {key for key, place in origin.items() if place == _SAVED}, known, findings)


def _placeholder(key: str, value: float, now: float, origin: str) -> Note:
    place = "in a comment of the body" if origin == _COMMENT else "in the body of the file"
    return Note(f"{key} {value:g} mm {place} is {abs(value - now):.3g} mm from the {now:g} mm that "
                "the printer saved: it is taken for a placeholder, not for the nominal value")


_Body = dict[tuple[str, str], tuple[float, bool]]


def _body(config: Config) -> tuple[_Body, list[Note]]:
    """Return (section, key) -> (value, whether it is commented out), and what is ambiguous."""
    out: _Body = {}
    several: dict[str, list[float]] = {}
    section = ""
    for line in (one.text for one in config.body):
        header = HEADER.match(line)
        if header:
            section = header[1].strip()
            continue
        found = _LINE.match(line.strip())
        if found is None:
            continue
        place = section, found["key"].lower()
        value, quiet = float(found["value"]), bool(found["out"])
        if not abs(value) <= LARGEST:
            raise BadInput(f"{found['value'][:40]} is out of range",
                           f"{config.source}: [{section}] {place[1]}", "Correct the number")
        if quiet and place in out and not out[place][1]:
            continue
        if quiet and place in out and out[place][0] != value:
            several.setdefault(f"[{section}] {place[1]}", [out[place][0]]).append(value)
        out[place] = value, quiet
    keys = ("delta_radius", "arm_length", "position_endstop", "angle")
    return out, [Note(f"{name}: {', '.join(f'{v:g}' for v in values)} are commented out: the last "
                      "is taken as nominal") for name, values in several.items()
                 if name.endswith(keys)]


def _one(config: Config, body: _Body, section: str, key: str, active: float) -> tuple[float, str]:
    """Return a value and where it is from, the saved one only where nothing else stands."""
    if (section, key) in body:
        value, quiet = body[section, key]
        return value, _COMMENT if quiet else _BODY
    entry = config.sections.get(section, {}).get(key)
    return active, _SAVED if entry is not None and entry.saved else _BODY


def _towers(config: Config, body: _Body, key: str, active: Triple) -> tuple[Triple, str]:
    """Return a value of each tower, those of b and c a's where they have none of their own."""
    values: list[float] = []
    origins: list[str] = []
    for i, tower in enumerate(TOWERS):
        value, origin = _one(config, body, f"stepper_{tower}", key, active[i])
        alone = (f"stepper_{tower}", key) not in body
        if i and alone and origins[0] != _SAVED:
            value, origin = values[0], origins[0]
        values.append(value)
        origins.append(origin)
    worst = _SAVED if _SAVED in origins else _COMMENT if _COMMENT in origins else _BODY
    return triple(values), worst


def _rods(config: Config, body: _Body, active: DeltaGeometry, given: float | None,
          findings: list[Note]) -> tuple[Triple, str, bool]:
    """Return the rods, where they are from, and whether that is more than a saved result."""
    if given is not None:
        return (given, given, given), "--rods", True
    arms, origin = _towers(config, body, "arm_length", active.arms)
    if origin != _SAVED:
        return arms, origin, True
    mean = float(np.mean(active.arms))
    findings.append(Note(
        f"the rods' nominal length is not known: all that the file holds is what a calibration "
        f"saved ({', '.join(f'{a:g}' for a in active.arms)} mm). Their mean {mean:.3f} mm is taken "
        f"with a tolerance of {WIDE_RODS:g} mm; measure a rod from bearing to bearing, or look at "
        "its drawing, and give --rods LENGTH"))
    return (mean, mean, mean), _SAVED, False


def _angles(body: _Body, active: DeltaGeometry) -> Triple:
    """Return the towers' angles as drawn, those of the firmware where the file says nothing."""
    out = []
    for tower, usual, own in zip(TOWERS, ANGLES, active.angles, strict=True):
        value = body.get((f"stepper_{tower}", "angle"), (usual, True))[0]
        out.append(value if abs(value - own) <= SKEW else own)
    return triple(out)
