"""Units in the headers of a table: ``q_leg1 [mm]``, ``x (mm)``, ``temperature [F]``.

A unit in a header says the same as one under ``read.units`` in the sidecar.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase

from ppmcal.errors import BadInput, unknown
from ppmcal.io.csv import Table
from ppmcal.io.read_block import UNITS, ReadFile
from ppmcal.io.reading import as_declared
from ppmcal.model.mechanism import Mechanism

_WITH_UNIT = re.compile(r"(?P<name>.*\S)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))")
_SPELT: Mapping[str, str] = {
    "°": "deg", "°C": "C", "°F": "F", "degC": "C", "degF": "F", "µm": "um", "μm": "um",
    "inch": "in", "rev": "turn", "Nm": "N m", "N.m": "N m", "N·m": "N m", "N*m": "N m"}
"""Other ways to write a unit."""
BARE = ("", "-", "1")
"""Written in the place of a unit where there is none."""
CLOCKS = ("time", "timestamp", "time stamp", "date", "datetime", "date time")
"""Columns in whose brackets the form of a clock may stand, or its zone."""
_CLOCK = re.compile(r"[hHmMsSyYdDfFT:./\- ]{5,}|UTC|GMT|Z|UTC[+-]\d{1,2}|local|ISO ?8601", re.ASCII)
RATES = ("vel_", "vx", "vy", "vz", "wx", "wy", "wz")
"""Columns that begin so are per second: `mm/s` is the same as `mm`."""


def bare_name(header: str) -> str:
    """Return a header without what stands in brackets at its end."""
    found = _WITH_UNIT.fullmatch(header.strip())
    return found["name"] if found else header.strip()


def zone_of(header: str) -> str | None:
    """Return the zone in the brackets of a header such as ``Time (UTC)``, None without one."""
    found = _WITH_UNIT.fullmatch(header.strip())
    inside = (found["square"] or found["round"] or "").strip() if found else ""
    if inside in ("UTC", "GMT", "Z"):
        return "UTC"
    away = re.fullmatch(r"UTC([+-])(\d{1,2})", inside)
    return f"{away[1]}{int(away[2]):02d}:00" if away else None


def in_own_units(table: Table, mechanism: Mechanism, known: Callable[[str], bool]) -> Table:
    """Return a table without a sidecar in the mechanism file's units, with bare names.

    Args:
        table: as it was read.
        mechanism: for its units and actuators.
        known: says of a name whether it is one of our columns; others stay as they are.

    Raises:
        BadInput: an unknown unit, one that the column cannot be in, or two columns of one name.
    """
    strange = [h for h in table.header if not known(bare_name(h))]
    read = ReadFile.model_construct(ignore=strange)
    mine = {bare_name(h) for h in table.header} - set(strange)
    table, units = without_units(table, read, mine)
    for name, unit in units.items():
        if unit == "counts":
            raise BadInput(f"{name} is in counts, and how many make a turn is not known",
                           f"{table.source}: header, column {name}", "Give it in turns or deg")
    if not units:
        return table
    return as_declared(table, ReadFile.model_construct(units=units), mechanism, mechanism.units,
                       table.source, units)


def without_units(table: Table, read: ReadFile, known: Collection[str]
                  ) -> tuple[Table, dict[str, str]]:
    """Return the table with bare names in its header, and the unit by name where there is one.

    A header that the sidecar names as it stands keeps its name; what it has in brackets counts
    where it is a unit.

    Args:
        table: as it was read.
        read: the sidecar's block.
        known: names of our own columns: what stands in brackets behind one must be a unit.

    Raises:
        BadInput: an unknown unit, or two columns of one name but for the unit.
    """
    named = {*read.columns.values(), *read.ignore}
    names, units = dict[str, str](), dict[str, str]()
    for header in table.header:
        name, unit = _split(header, f"{table.source}: header", known)
        names[header] = header if header in named else name
        if unit and header not in read.ignore:
            units[names[header]] = unit
    bare = tuple(names.values())
    for i, name in enumerate(bare):
        if name in bare[:i]:
            raise BadInput(f"two columns are called '{name}', but for the unit",
                           f"{table.source}: header", f"Write `ignore: ['{table.header[i]}']` "
                           "under `read` in the sidecar, or rename one of them")
    return replace(table, header=bare, numbers={names[h]: v for h, v in table.numbers.items()},
                   text={names[h]: v for h, v in table.text.items()}), units


def with_units(read: ReadFile, units: Mapping[str, str], side: str) -> ReadFile:
    """Return the sidecar's block with the headers' units, by our own names, in it.

    Raises:
        BadInput: header and sidecar name two units for one column.
    """
    more = dict(read.units)
    for name, unit in units.items():
        said = next((p for p in read.units if fnmatchcase(name, p)), None)
        if said is None:
            more[name] = unit
        elif read.units[said] != unit:
            raise BadInput(f"the sidecar says that {name} is in {read.units[said]}, the header "
                           f"that it is in {unit}", f"{side}: read.units.{said}",
                           "Correct the one that is wrong")
    return read.model_copy(update={"units": more}) if units else read


def _split(header: str, place: str, known: Collection[str]) -> tuple[str, str]:
    """Return name and unit of a header, the header and nothing where it has no unit."""
    found = _WITH_UNIT.fullmatch(header)
    if found is None:
        return header, ""
    name, unit = found["name"], (found["square"] or found["round"] or "").strip()
    unit = _SPELT.get(unit, unit)
    if name.startswith(RATES):
        unit = unit.removesuffix("/s")
    if unit in UNITS:
        return name, unit
    if name.lower() in CLOCKS and _CLOCK.fullmatch(unit):
        return name, ""
    ours = name in known or name.startswith("temperature_")
    if ours and unit not in BARE:
        error = unknown("unit", unit, UNITS)
        raise BadInput(error.what, f"{place}, column {header}", error.mend)
    return (name, "") if ours else (header, "")
