"""What files were taken to mean, for those who look over the program's shoulder (``-v``)."""

from __future__ import annotations

import logging

from ppmcal.io.csv import Table
from ppmcal.io.sidecar import SidecarFile
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import pluralize

SHOWN = 24
log = logging.getLogger(__package__)


def remark_machine(machine: Mechanism) -> None:
    """Log what a mechanism file says."""
    if not log.isEnabledFor(logging.INFO):
        return
    kinds = ", ".join(dict.fromkeys(limb.kind.name for limb in machine.limbs))
    default = "" if machine.free_patterns is not None else " (those with a tolerance, by default)"
    effects = ", ".join(e.kind.name for e in machine.effects) or "none"
    log.info("%s: %s, %s %s, units %s and %s; %d of %d parameters free%s; effects: %s",
             machine.source, machine.motion, pluralize(len(machine.limbs), "limb"), kinds,
             machine.units.length, machine.units.angle, len(machine.free),
             len(machine.parameters), default, effects)


def remark_table(table: Table) -> None:
    """Log rows and columns of a table."""
    names = [*table.header[:SHOWN], *(["..."] if len(table.header) > SHOWN else [])]
    log.info("%s: %s, %s: %s", table.source, pluralize(len(table), "row"),
             pluralize(len(table.header), "column"), ", ".join(names))


def remark_data(data: Dataset, table: Table, file: SidecarFile, side: str) -> None:
    """Log what a table of measurements and its sidecar were taken to mean."""
    if not log.isEnabledFor(logging.INFO):
        return
    remark_table(table)
    sigma = ", ".join(f"{name} {value:g}" for name, value in
                      file.instrument.sigma.model_dump().items()
                      if isinstance(value, float | int) and not isinstance(value, bool) and value)
    log.info("%s: units %s and %s; instrument %s, sigma %s; frame %s, target %s; approach %s%s",
             side, file.units.length, file.units.angle, data.kind, sigma or "from columns",
             _state(data.frame), _state(data.target), data.approach,
             " (by default)" if file.approach is None else "")
    if data.headers or data.read:
        renamed = ", ".join(f"{own} from '{theirs}'" for own, theirs in data.headers.items())
        log.info("%s: read with %s", table.source, "; ".join(
            part for part in (renamed, str(data.read) if data.read else "") if part))


def _state(place: Unknown) -> str:
    if place.same_as is not None:
        return f"that of {place.same_as}"
    return "fitted" if place.fitted else "known"
