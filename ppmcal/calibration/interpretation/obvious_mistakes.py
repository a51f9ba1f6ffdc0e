"""Mistakes that show without any fit: units of the environment, limits, signs of struts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.interpretation.limits import MOST
from ppmcal.calibration.interpretation.misread import Misread, Misreading, Mistake, with_line
from ppmcal.calibration.interpretation.stale_rows import stale
from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import ZERO_CELSIUS, Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import counted

WORKSHOP = (-10.0, 45.0)
"""Temperatures, deg C, in which machines are measured."""
HEAVIEST = 2000.0
"""A payload of more than so many kg per metre of reach is none."""


def recorded_units(data: Dataset, mechanism: Mechanism) -> Iterator[tuple[Mistake, str, str]]:
    """Yield columns of the environment that look like another unit: mistake, column, unit."""
    for name, values in data.columns.items():
        known = values[np.isfinite(values)]
        if not known.size or name in data.read.get("units", {}):
            continue    # a unit that the sidecar gives is believed
        if name == "temperature" or name.startswith("temperature_"):
            unit = _temperature(known - ZERO_CELSIUS, name == "temperature")
            if unit:
                low, high = (f"{v:.4g}" for v in np.ptp(known) * np.array([0.0, 1.0])
                             + known.min() - ZERO_CELSIUS)
                other = "K" if unit == "K" else "deg F"
                yield Mistake("unit", (name,), f"{name} is {low} to {high}: no workshop in deg C, "
                              f"but in {other}. Where a heated part is measured, "
                              f"`units: {{{name}: C}}` in its sidecar says so"), name, unit
        elif name == "payload":
            most = float(np.median(known[known > 0.0])) if (known > 0.0).any() else 0.0
            if most > HEAVIEST * mechanism.reach:
                yield Mistake("unit", (name,), f"payload is about {most:.4g}: more than this "
                              "machine can bear in kg, but not in g"), name, "g"


def _temperature(celsius: Array, room: bool) -> str:
    """Return the unit that the values, read as deg C, are likelier in; empty if none.

    ``room``: they are the room's. A sensor on a bed or a drive may well read 65 deg C.
    """
    middle = float(np.median(celsius))
    if WORKSHOP[0] <= middle <= WORKSHOP[1] + 5.0:
        return ""
    for unit, other in (("K", middle - ZERO_CELSIUS), ("F", (middle - 32.0) / 1.8)):
        if (room or unit == "K") and WORKSHOP[0] <= other <= WORKSHOP[1]:
            return unit
    return ""


def refuse_wrong_units(mechanism: Mechanism, datasets: Sequence[Dataset]) -> None:
    """Refuse columns of the environment that look like another unit.

    Raises:
        Misread: with the lines to write into the sidecars.
    """
    found = [Misreading(d.source, (mistake,), with_line(d, "units", {column: unit}))
             for d in datasets for mistake, column, unit in recorded_units(d, mechanism)]
    if found:
        raise Misread.of(found, mechanism.units)


def plain_mistakes(data: Dataset, mechanism: Mechanism, others: Sequence[Misreading] = ()
                   ) -> Iterator[Misreading]:
    """Yield mistakes that show without a fit.

    ``others``: misreadings that a search has found; joints outside their limits are not told of
    columns that one of them concerns, which is why they are outside.
    """
    for mistake in stale(replace(data, unusable=None), mechanism)[1]:
        yield Misreading(data.source, (mistake,))
    for mistake, column, unit in recorded_units(data, mechanism):
        yield Misreading(data.source, (mistake,), with_line(data, "units", {column: unit}))
    told = {c for other in others if other.source == data.source for m in other.mistakes
            for c in m.columns}
    for name, outside in _outside(data, mechanism):
        if name in told:
            continue
        rows = tuple(int(n) for n in data.rows[outside])
        yield Misreading(data.source, (Mistake(
            "outside-limits", (name,), f"{name} is outside its limits in "
            f"{counted(len(rows), 'row')}", rows),))


def other_zeros(data: Dataset, mechanism: Mechanism) -> tuple[Misreading, ...]:
    """Return joints that most rows have outside their limits: counted from another zero.

    Where home is outside too it is the limits that are wrong, and no joint is blamed.
    """
    low, high = mechanism.limits.T
    home = home_state(mechanism).q
    inside = {f"q_{a}" for a, within in zip(
        mechanism.actuators, (low <= home) & (home <= high), strict=True) if within}
    most = {name for name, outside in _outside(data, mechanism) if outside.mean() > MOST} & inside
    return tuple(m for m in plain_mistakes(data, mechanism)
                 if m.mistakes[0].kind == "outside-limits" and set(m.mistakes[0].columns) <= most)


def _outside(data: Dataset, mechanism: Mechanism) -> Iterator[tuple[str, Bools]]:
    """Yield joint columns that leave their limits, and in which rows (N,)."""
    for i, name in enumerate(mechanism.actuators):
        low, high = mechanism.limits[i]
        with np.errstate(invalid="ignore"):
            outside = (data.q[:, i] < low) | (data.q[:, i] > high)
        if outside.any():
            yield f"q_{name}", outside


# --- struts of negative length: only the square is seen, and a fit would take any sign ------------

NEAR = 0.5
"""A joint whose middle is within this part of the opposite of its home value is negative."""


def _struts(data: Dataset, mechanism: Mechanism) -> list[int]:
    """Return the joints that are a limb's length, of which only the square is seen."""
    return [limb.actuator for limb in mechanism.limbs
            if data.commanded is None and limb.kind.actuator == "length"
            and not any(s.is_bar for s in limb.kind.slots)]


def rows_with_negative_struts(data: Dataset, mechanism: Mechanism) -> Bools:
    """Return the rows (N,) with a strut's length of the other sign than at home: mistyped ones.

    The pose is as with the right sign, so that no residual shows it; what follows the travel would.
    """
    struts = _struts(data, mechanism)
    return np.asarray((data.q[:, struts] * home_state(mechanism).q[struts] < 0.0).any(axis=1))


def with_positive_struts(data: Dataset, mechanism: Mechanism
                         ) -> tuple[Dataset, tuple[Mistake, ...]]:
    """Return the data with columns of struts turned that are negative, and that as a mistake."""
    home, turned = home_state(mechanism).q, []
    for i in _struts(data, mechanism):
        known = data.q[np.isfinite(data.q[:, i]), i]
        if known.size and abs(float(np.median(known)) + home[i]) < NEAR * abs(home[i]):
            turned.append(i)
    if not turned:
        return data, ()
    names = tuple(f"q_{mechanism.actuators[i]}" for i in turned)
    q = data.q.copy()
    q[:, turned] *= -1.0
    signs = data.read.get("signs", {})
    right = replace(data, q=q, whole=None, place=None, read=with_line(
        data, "signs", {n: -signs.get(n, 1) for n in names}))
    has = "has" if len(names) == 1 else "have"
    return right, (Mistake("sign", names, f"{', '.join(names)} {has} the other sign: lengths of "
                           "struts, which are not negative at home"),)
