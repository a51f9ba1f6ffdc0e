"""Standard deviations that are implausible: next to nothing, or beyond the machine many times.

A double holds sixteen digits. Noise below :data:`SMALLEST` of the machine's size is lost in the
round-off of the joint values themselves, so that weights by it are weights by round-off; noise
beyond :data:`LARGEST` of it says nothing at all. Both come of a wrong unit or of a placeholder.
Here too: correlations, which must be those of some noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table
from ppmcal.io.pose_fields import CORRELATIONS
from ppmcal.linalg import Array, eigvalsh
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units

SMALLEST, LARGEST = 1e-13, 1e3
"""Parts of the machine's reach; of rotations, of a radian."""
LOOSEST = 1e9
"""The same of tolerances, some of which stand for "no idea"."""


def refuse_noise(data: Dataset, mechanism: Mechanism, side: str) -> None:
    """Refuse standard deviations of a data set that are implausible.

    Raises:
        BadInput: with the limits, in the file's units.
    """
    for name, sigma, quantity in (("position", data.sigma_position, "length"),
                                  ("rotation", data.sigma_rotation, "angle"),
                                  ("value", data.sigma_value,
                                   data.kind.quantity if data.kind.scalar else "length")):
        known = data.kind.number if name == "value" else name
        refuse_sigma(sigma, quantity, mechanism, data.units,
                     f"{side}: instrument.sigma.{known}, or columns of their own")
    bare = np.array(mechanism.actuator_has_ratio)
    for quantity in ("length", "angle"):
        mine = np.array([q == quantity for q in mechanism.actuator_quantity]) & ~bare
        refuse_sigma(data.sigma_actuator[mine & (data.sigma_actuator > 0.0)], quantity, mechanism,
                     data.units, f"{side}: instrument.sigma.actuator", nothing="0")


def refuse_tolerances(mechanism: Mechanism) -> None:
    """Refuse tolerances next to nothing, which would fix a parameter without saying so.

    Raises:
        BadInput: with the parameter and the limit.
    """
    for p in mechanism.parameters:
        if p.prior_sigma and p.quantity in ("length", "angle") and not p.per_unit:
            refuse_sigma(np.array([p.prior_sigma]), p.quantity, mechanism,
                         mechanism.units, f"{mechanism.source}: tolerance of {p.name}",
                         nothing="0, or `fixed: true`, for a parameter that must not change",
                         largest=LOOSEST, more="`.inf` for no prior")


def refuse_sigma(sigma: Array, quantity: str, mechanism: Mechanism, units: Units, place: str,
                 nothing: str = "", largest: float = LARGEST, more: str = "") -> None:
    """Refuse standard deviations (...), SI, outside the limits; nan is passed over.

    Args:
        sigma: as they are.
        quantity: ``length`` or ``angle``.
        mechanism: the machine, for its size.
        units: in which the message says it.
        place: where they stand.
        nothing: what to write for none.
        more: what to write for one without bound.
        largest: so many times the machine's size are too many.

    Raises:
        BadInput: with the limits, in the file's units.
    """
    if not sigma.size:
        return
    size = mechanism.reach if quantity == "length" else 1.0
    least, most = np.fmin.reduce(sigma, axis=None), np.fmax.reduce(sigma, axis=None)
    name, factor = units.name(quantity), units.factor(quantity)
    of = f"this machine of {size / factor:.3g} {name}" if quantity == "length" else "an angle"
    if least < SMALLEST * size:
        raise BadInput(f"a standard deviation of {least / factor:.3g} {name} is implausible: it "
                       f"is below the round-off of {of}", place,
                       "Write what the instrument's data sheet says, at least "
                       f"{SMALLEST * size / factor:.2g} {name}" + f", or {nothing}" * bool(nothing))
    if most > largest * size:
        raise BadInput(f"a standard deviation of {most / factor:.3g} {name} is implausible: it "
                       f"tells nothing about {of}", place, "Check its unit; at most "
                       f"{largest * size / factor:.3g} {name}" + f", or {more}" * bool(more))


def correlated_noise(table: Table, told: Sequence[str], sigma: Array) -> Array:
    """Return covariances (N, c, c) by standard deviations and the correlations in a table.

    Args:
        table: of N rows.
        told: its columns of correlations, such as ``rho_x_y``; empty cells are 0.
        sigma: of the first c of x ... rz (N, c), SI; nan where not measured.

    Raises:
        BadInput: rows with correlations that no noise has.
    """
    size = sigma.shape[1]
    out = np.tile(np.eye(size), (len(table), 1, 1))
    for name in told:
        i, j = CORRELATIONS[name]
        if j < size:
            out[:, i, j] = out[:, j, i] = np.nan_to_num(table.numbers[name])
    table.refuse_rows(eigvalsh(out)[:, 0] <= 0.0, told[0], "no noise has the row's correlations",
                      "Check the columns rho_...: each between -1 and 1, and of one noise",
                      listed=True)
    known = np.nan_to_num(sigma, nan=1.0)
    return np.asarray(known[:, :, None] * out * known[:, None, :])
