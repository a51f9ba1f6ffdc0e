"""``closure`` of a mechanism file: how far surplus limbs may be from closing.

``closure: {sigma: 0.1}`` is of all limbs, ``closure: {sigma: {c1: 0.1, c2: 0.2}}`` of those that it
names: standard deviations in length units. Limbs that are not named close but for their drives.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import BeforeValidator

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.noise_limits import refuse_sigma
from ppmcal.io.schema import LARGEST, Strict, each, numbers
from ppmcal.io.yaml import to_file
from ppmcal.model.mechanism import Mechanism

KEY = "closure"

_sigma = each(numbers(lambda v: 0 <= v <= LARGEST, "a standard deviation",
                      "Write a number of 0 or more, or one for each limb: {c1: 0.1}"))


class ClosureFile(Strict):
    """What limbs may gap, of a machine with more of them than its platform has freedoms."""

    examples: ClassVar[Mapping[str, str]] = {"sigma": "sigma: {c1: 0.1, c2: 0.2}"}
    sigma: Annotated[Any, BeforeValidator(_sigma)]
    """Standard deviation of how far limbs are from closing beside their drives' noise, as a length:
    one number, or one by limb."""


def read_gaps(file: ClosureFile | None, mechanism: Mechanism) -> dict[str, float]:
    """Return what limbs may gap, m, by name; those with 0 are left out.

    Raises:
        BadInput: a limb that is not there, an implausible value, a machine without surplus limbs.
    """
    if file is None:
        return {}
    place, names = f"{mechanism.source}: {KEY}", [limb.name for limb in mechanism.limbs]
    if not mechanism.surplus:
        raise BadInput(
            f"the limbs put {mechanism.equations} conditions on {len(mechanism.dof)} coordinates: "
            "whatever they gap, there is a pose at which all close, so that a gap would be no "
            "other than noise of the drives", place, "Say that in the sidecar of the "
            "measurements, `instrument: {sigma: {actuator: 0.1}}`, and leave this key out")
    given = file.sigma if isinstance(file.sigma, dict) else dict.fromkeys(names, file.sigma)
    refuse_unknown("limb", given, names, f"{place}.sigma")
    out = {name: given[name] * mechanism.units.factor("length") for name in names
           if given.get(name)}
    refuse_sigma(np.array(list(out.values())), "length", mechanism, mechanism.units,
                 f"{place}.sigma", nothing="0")
    return out


def gaps_tree(mechanism: Mechanism) -> dict[str, Any]:
    """Return what limbs may gap as the file has it, empty where it says nothing."""
    length = mechanism.units.factor("length")
    own = {limb.name: to_file(mechanism.gaps[limb.name], length) for limb in mechanism.limbs
           if limb.name in mechanism.gaps}
    if not own:
        return {}
    alike = len(own) == len(mechanism.limbs) and len(set(own.values())) == 1
    return {"sigma": next(iter(own.values())) if alike else own}
