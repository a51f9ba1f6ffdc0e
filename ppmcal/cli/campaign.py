"""Reading a machine and its measurements for a command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ppmcal.model.dataset import Dataset
    from ppmcal.model.mechanism import Mechanism


def load(mech: Path, data: tuple[Path, ...], patterns: tuple[str, ...]
         ) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Read machine and data; ``patterns`` replace the file's choice of free parameters."""
    import numpy as np

    from ppmcal.errors import unknown
    from ppmcal.io import read_mechanism
    from ppmcal.kinematics.effect_response import with_strokes
    from ppmcal.model.parameters import unmatched

    mechanism = read_mechanism(mech)
    if patterns == ("none",):
        mechanism = mechanism.with_free([])
    elif patterns:
        for pattern in unmatched(mechanism.parameters, patterns):
            raise unknown("parameter", pattern, mechanism.names, "--free")
        mechanism = mechanism.with_free(patterns)
    datasets = readable(mechanism, data)
    if mechanism.effects and datasets:
        mechanism = with_strokes(mechanism, np.concatenate([d.q for d in datasets]))
        for d in datasets:
            _recorded(mechanism, d)
    return mechanism, datasets


def _recorded(mechanism: Mechanism, data: Dataset) -> None:
    """Refuse data without a column that the machine's effects depend on."""
    from ppmcal.errors import BadInput
    from ppmcal.kinematics.effect_response import conditions_of, missing_columns

    missing = missing_columns(mechanism, conditions_of(mechanism, data))
    if missing:
        raise BadInput(f"the effects of {mechanism.source} depend on {', '.join(missing)}, which "
                       "is not there", f"{data.source}: header",
                       f"Add the column {missing[0]}, or take the effect out")


def readable(mechanism: Mechanism, paths: Sequence[Path]) -> tuple[Dataset, ...]:
    """Read measurements, with joints."""
    from ppmcal.io import read_campaign
    from ppmcal.kinematics.tables import with_joints

    datasets = read_campaign(list(paths), mechanism)
    return tuple(with_joints(mechanism, d) for d in datasets)


@contextmanager
def unit_findings_told(mechanism: Mechanism, datasets: Sequence[Dataset]) -> Iterator[list[str]]:
    """Yield what `check` says of units and limits; a fit that fails inside says it too."""
    from ppmcal.errors import PpmcalError
    from ppmcal.io import unit_findings

    found = unit_findings(mechanism, datasets)
    try:
        yield found
    except PpmcalError as error:
        mend = " ".join([*found, error.mend]).strip()
        raise type(error)(error.what, error.where, mend) from None


def started(mechanism: Mechanism, start: Path) -> tuple[Mechanism, list[str]]:
    """Return the machine with the free values of an earlier calibration, and what was odd."""
    from ppmcal.io import read_mechanism

    other = read_mechanism(start)
    notes = same_machine(mechanism, other, start)
    found = dict(zip(other.names, other.values.tolist(), strict=True))
    g = mechanism.values.copy()
    for p in mechanism.free:
        g[p] = found.get(mechanism.names[p], g[p])
    return mechanism.with_values(g), notes


def same_machine(mechanism: Mechanism, other: Mechanism, source: Path) -> list[str]:
    """Return which fixed values differ between a machine and an earlier file of it.

    Raises:
        BadInput: the limbs are not the same.
    """
    from ppmcal.errors import BadInput

    kinds = [{limb.name: limb.kind.name for limb in m.limbs} for m in (mechanism, other)]
    if kinds[0] != kinds[1]:
        raise BadInput("is of another machine: its limbs are not those of "
                       f"{mechanism.source}", str(source),
                       "Give the identified.yaml of an earlier calibration of this machine")
    found = dict(zip(other.names, other.values.tolist(), strict=True))
    free = {mechanism.names[p] for p in mechanism.free}
    apart = [name for i, name in enumerate(mechanism.names)
             if name not in free and found.get(name, mechanism.values[i]) != mechanism.values[i]]
    if not apart:
        return []
    return [f"{len(apart)} fixed value{'s' if len(apart) > 1 else ''} are not as in {source}: "
            f"{', '.join(apart[:3])}{' ...' if len(apart) > 3 else ''}"]
