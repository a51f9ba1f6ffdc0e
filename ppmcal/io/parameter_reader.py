"""From slot entries of all limbs to parameters: sharing, default tolerances, what is free."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from ppmcal.errors import BadInput
from ppmcal.io.mechanism_schema import SlotFile
from ppmcal.io.schema import did_you_mean
from ppmcal.linalg import Array
from ppmcal.model.limbs import LimbKind
from ppmcal.model.limbs.chain import SlotSpec
from ppmcal.model.parameters import Parameter, SlotMap, unmatched
from ppmcal.notes import NOTE, Note
from ppmcal.units import Units


@dataclass(frozen=True)
class SlotEntry:
    """What the file says about one slot.

    Attributes:
        path: of the slot, with its limb.
        place: in the file, for messages.
        spec: what the slot measures.
        given: what the file says, SI.
        default: the value without one.
        standing: fixed at its default because the file does not mention it (``lateral``).
    """

    path: str
    place: str
    spec: SlotSpec
    given: SlotFile
    default: float | None = None
    standing: bool = False


@dataclass
class Draft:
    """One limb as read: entries in parameter order, and how slots follow from them.

    ``actuator``: the joint variable's name, None for a passive limb.
    ``direct``: slot names that take an entry's value; ``polar``: (slot x, slot y, path of
    the radius, path of the angle). ``numbers``: lengths and angles as printed in the file;
    ``absent``: (slot name, the direction that the file would have to give for it).
    """

    name: str
    kind: LimbKind
    actuator: str | None
    entries: list[SlotEntry] = field(default_factory=list)
    direct: list[str] = field(default_factory=list)
    polar: list[tuple[str, str, str, str]] = field(default_factory=list)
    constants: dict[str, Array] = field(default_factory=dict)
    shared_directions: dict[str, str] = field(default_factory=dict)
    branch: int | None = None
    numbers: list[tuple[str, float]] = field(default_factory=list)
    absent: list[tuple[str, str]] = field(default_factory=list)

    @property
    def has_ratio(self) -> bool:
        """Whether the file gives the limb a drive ratio."""
        return "ratio" in self.direct


def key(entry: SlotEntry) -> str:
    """Return the name of the parameter that an entry belongs to."""
    return entry.given.share or entry.path


def parameters(drafts: Sequence[Draft], classes: Mapping[str, float], units: Units
               ) -> tuple[tuple[Parameter, ...], set[str]]:
    """Return all parameters, in the order of their first slot, and those without a tolerance.

    ``classes``: tolerances that the file gives, in its ``units``. What has a class that is not
    among them is named in the second result, and has no tolerance as yet.
    """
    together: dict[str, list[SlotEntry]] = {}
    for draft in drafts:
        for entry in draft.entries:
            together.setdefault(key(entry), []).append(entry)
    paths = {e.path for d in drafts for e in d.entries}
    out, waiting = [], set()
    for name, entries in together.items():
        if entries[0].given.share and name in paths:
            raise BadInput(f"the shared name '{name}' is also the path of a slot",
                           entries[0].place, "Choose another name")
        parameter = _parameter(name, entries, classes, units)
        out.append(parameter)
        if parameter.tolerance is None and not parameter.per_unit and not all(
                e.standing for e in entries):
            waiting.add(name)
    return tuple(out), waiting


def _parameter(name: str, entries: Sequence[SlotEntry], classes: Mapping[str, float],
               units: Units) -> Parameter:
    first, share = entries[0], entries[0].given.share
    spec, ratio = first.spec, first.spec.tolerance_class == "ratio"
    for entry in entries[1:]:
        if (entry.spec.quantity, entry.spec.tolerance_class == "ratio") != (spec.quantity, ratio):
            raise BadInput(f"the shared name '{name}' ties a slot of another quantity "
                           f"({entry.spec.quantity}) to {first.path} ({spec.quantity})",
                           entry.place,
                           "Only lengths with lengths, angles with angles, ratios with ratios")
    value = _agreed(entries, "value", name)
    nominal = _agreed(entries, "nominal", name)
    if value is None:
        value = first.default if first.default is not None else nominal
    if value is None:
        places = ", ".join(e.path for e in entries)
        raise BadInput(f"the shared name '{name}' has no value" if share
                       else "the slot has no value", first.place,
                       f"Add `value:` at one of {places}" if share else "Add `value: ...`")
    own = _agreed(entries, "tolerance", name)
    standing = all(e.standing for e in entries)
    tolerance = own
    if own is None and not ratio and not standing and spec.tolerance_class in classes:
        tolerance = classes[spec.tolerance_class] * units.factor(spec.quantity)
    fixed = (bool(_agreed(entries, "fixed", name)) or standing or tolerance == 0.0
             or (ratio and own is None))
    return Parameter(name, spec.quantity, value, value if nominal is None else nominal,
                     tolerance, fixed, spec.tolerance_class,
                     tuple(e.path for e in entries) if share else (),
                     _agreed(entries, "sigma", name))


def _agreed(entries: Sequence[SlotEntry], field: str, name: str) -> float | None:
    """Return the one value that the entries give for a field, None where none does."""
    given = [(e, value) for e in entries if (value := getattr(e.given, field)) is not None]
    for entry, value in given[1:]:
        if not math.isclose(value, given[0][1], rel_tol=1e-12, abs_tol=1e-15):
            raise BadInput(f"the shared name '{name}' has two different entries for {field}: "
                           f"here and at {given[0][0].path}", entry.place,
                           "Give it once, or the same everywhere")
    return None if not given else given[0][1]


def slot_map(draft: Draft, index: Mapping[str, int]) -> SlotMap:
    """Return how the slots of one limb follow from the parameters."""
    by_path = {e.path: index[key(e)] for e in draft.entries}
    return SlotMap(
        tuple((slot, by_path[f"{draft.name}.{slot}"]) for slot in draft.direct),
        tuple((x, y, by_path[r], by_path[a]) for x, y, r, a in draft.polar))


def check_patterns(made: Sequence[Parameter], drafts: Sequence[Draft], patterns: Sequence[str],
                   source: str) -> list[Note]:
    """Refuse ``free`` patterns that name nothing; warn of those that name only fixed ones.

    Raises:
        BadInput: a pattern that names no parameter, with the nearest one.
    """
    missed = unmatched(made, patterns)
    names = [n for p in made for n in (p.name, *p.aliases)]
    if missed:
        for limb, slot, axis in ((d.name, *one) for d in drafts for one in d.absent):
            if fnmatchcase(f"{limb}.{slot}", missed[0]):
                raise BadInput(f"the pattern '{missed[0]}' names {slot}, but {limb} has no {axis}",
                               f"{source}: free",
                               f"Add `axis: [1, 0, 0]` under `{axis.partition('.')[0]}` of {limb}")
        raise BadInput(f"the pattern '{missed[0]}' names no parameter", f"{source}: free",
                       f"Parameters are called {', '.join(names[:8])}, ..."
                       f"{did_you_mean(missed[0], names)}")
    return [Note(f"{source}: free: the pattern '{pattern}' names only fixed parameters; give one a "
                 "tolerance to free it.", NOTE) for pattern in patterns
            if all(p.fixed for p in made if p.matches(pattern))]
