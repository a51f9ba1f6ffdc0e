"""Which universal joint of a limb the file speaks of: one, on the base's or the platform's side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.model.limbs import LimbKind


def absent_axes(kind: LimbKind, given: Mapping[str, Any], at: Callable[[str], str]
                ) -> dict[str, str]:
    """Return the slots of universal joints that a limb does not have -> what it would take.

    A first axis is there where the file gives it, and its offset with it.

    Args:
        kind: of the limb.
        given: what the file gives, by path (``base.axis_offset``).
        at: a path -> its place in the file, for messages.

    Raises:
        BadInput: an offset without its axis, or a universal joint at both ends.
    """
    out: dict[str, str] = {}
    used = ""
    for spec in reversed(kind.axis_offsets):
        body = spec.name.partition(".")[0]
        named = next((n for n in (spec.name, spec.needs) if given.get(n) is not None), None)
        if named and used:
            raise BadInput(f"both {named} and {used} are given, but a limb has one universal "
                           "joint, and a ball at its other end", at(named), "Leave out `axis` and "
                           f"`axis_offset` under `{body}`, or under `{used.partition('.')[0]}`")
        if spec.needs and named and given.get(spec.needs) is None:
            raise BadInput(f"{spec.name} is given, but not the first axis of that joint", at(""),
                           f"Add `axis: [1, 0, 0]` under `{body}`, in {body} axes")
        if named:
            used = named
        elif spec.needs or used:
            out |= {n: spec.needs or spec.name for n in (spec.name, spec.needs) if n}
    return out
