"""Mistakes that show without a fit: units of the environment, limits, struts, repeated rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import coordinates, shown
from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    Interpretation,
    InterpretationError,
    headers_of,
    with_line,
)
from ppmcal.calibration.interpretation.limits import MOST
from ppmcal.calibration.interpretation.readings import readable, with_verb
from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import ZERO_CELSIUS, Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import Note
from ppmcal.wording import abbreviate_list, pluralize

WORKSHOP = (-10.0, 45.0)
"""Temperatures, deg C, at which machines are measured."""
HEAVIEST = 2000.0
"""Payloads of more kg per metre of reach than this are implausible."""


def recorded_units(data: Dataset, mechanism: Mechanism) -> Iterator[tuple[FileFault, str]]:
    """Yield the columns of the environment that seem to be in another unit, and that unit."""
    for name, values in data.columns.items():
        known = values[np.isfinite(values)]
        if not known.size or name in data.read.get("units", {}):
            continue    # the sidecar's unit is trusted
        if name == "temperature" or name.startswith("temperature_"):
            unit = _temperature(known - ZERO_CELSIUS, name == "temperature")
            if unit:
                low, high = (f"{v - ZERO_CELSIUS:.4g}" for v in (known.min(), known.max()))
                other = "K" if unit == "K" else "deg F"
                yield FileFault("unit", (name,),
                                f"{name} is {low} to {high}: implausible in deg C, "
                                f"but not in {other}. For a heated part, write "
                                f"`units: {{{name}: C}}` into its sidecar"), unit
        elif name == "payload":
            most = float(np.median(known[known > 0.0])) if (known > 0.0).any() else 0.0
            if most > HEAVIEST * mechanism.reach:
                yield FileFault("unit", (name,), f"payload is about {most:.4g}: implausible for "
                                "this machine in kg, but not in g"), "g"


def _temperature(celsius: Array, room: bool) -> str:
    """Return the unit that values, read as deg C, are more likely in; empty if none.

    ``room``: whether they are room temperatures. A sensor on a bed or a drive may read 65 deg C.
    """
    middle = float(np.median(celsius))
    if WORKSHOP[0] <= middle <= WORKSHOP[1] + 5.0:
        return ""
    for unit, other in (("K", middle - ZERO_CELSIUS), ("F", (middle - 32.0) / 1.8)):
        if (room or unit == "K") and WORKSHOP[0] <= other <= WORKSHOP[1]:
            return unit
    return ""


def _in_other_units(data: Dataset, mechanism: Mechanism) -> Iterator[Interpretation]:
    for mistake, unit in recorded_units(data, mechanism):
        headers = headers_of(data, mistake.columns, unit)
        block = {} if headers else with_line(data, "units", dict.fromkeys(mistake.columns, unit))
        yield Interpretation(data.source, (mistake,), block, headers=headers)


def refuse_wrong_units(mechanism: Mechanism, datasets: Sequence[Dataset]) -> None:
    """Refuse columns of the environment that seem to be in another unit.

    Raises:
        InterpretationError: with the lines to write into the sidecars.
    """
    found = [m for d in datasets for m in _in_other_units(d, mechanism)]
    if found:
        raise InterpretationError.of(found, mechanism.units)


def plain_mistakes(data: Dataset, mechanism: Mechanism, others: Sequence[Interpretation] = ()
                   ) -> Iterator[Interpretation]:
    """Yield mistakes that show without a fit.

    ``others``: misreadings found by a search; joints outside their limits are not reported for
    columns that one of these concerns, since it explains them.
    """
    for mistake in stale(replace(data, unusable=None), mechanism)[1]:
        yield Interpretation(data.source, (mistake,))
    yield from _in_other_units(data, mechanism)
    told = {c for other in others if other.source == data.source for m in other.mistakes
            for c in m.columns}
    yield from (m for _, _, m in _outside(data, mechanism) if m.mistakes[0].columns[0] not in told)


def other_zeros(data: Dataset, mechanism: Mechanism) -> tuple[Interpretation, ...]:
    """Return the joints that most rows have outside their limits: counted from another zero.

    If home is outside too, the limits are wrong and no joint is blamed.
    """
    (low, high), home = mechanism.limits.T, home_state(mechanism).q
    return tuple(m for i, part, m in _outside(data, mechanism)
                 if part > MOST and low[i] <= home[i] <= high[i])


def _outside(data: Dataset, mechanism: Mechanism) -> Iterator[tuple[int, float, Interpretation]]:
    """Yield the joints outside their limits, in which part of the rows, and this in words."""
    low, high = mechanism.limits.T
    with np.errstate(invalid="ignore"):
        outside = (data.q < low) | (data.q > high)
    for i in np.flatnonzero(outside.any(axis=0)).tolist():
        name, rows = f"q_{mechanism.actuators[i]}", tuple(data.rows[outside[:, i]].tolist())
        yield i, float(outside[:, i].mean()), Interpretation(data.source, (FileFault(
            "outside-limits", (name,), f"{name} is outside its limits in "
            f"{pluralize(len(rows), 'row')}", rows),))


# --- struts of negative length: only the square enters, so a fit accepts either sign --------------

NEAR = 0.5
"""A joint with its median within this part of the opposite of its home value is negative."""


def _struts(data: Dataset, mechanism: Mechanism) -> list[int]:
    """Return the joints that are a limb's length, which enters squared only."""
    return [limb.actuator for limb in mechanism.limbs
            if data.commanded is None and limb.kind.actuator == "length"
            and not any(s.is_bar for s in limb.kind.slots)]


def rows_with_negative_struts(data: Dataset, mechanism: Mechanism) -> Bools:
    """Return the rows (N,) with a strut length of opposite sign to that at home: mistyped ones.

    The pose is the same for either sign, so that no residual shows it; effects of travel would.
    """
    struts = _struts(data, mechanism)
    return np.asarray((data.q[:, struts] * home_state(mechanism).q[struts] < 0.0).any(axis=1))


def with_positive_struts(data: Dataset, mechanism: Mechanism
                         ) -> tuple[Dataset, tuple[FileFault, ...]]:
    """Return the data with negative struts made positive, and this as a mistake."""
    home, turned = home_state(mechanism).q, []
    for i in _struts(data, mechanism):
        known = data.q[np.isfinite(data.q[:, i]), i]
        if known.size and abs(float(np.median(known)) + home[i]) < NEAR * abs(home[i]):
            turned.append(i)
    if not turned:
        return data, ()
    names = tuple(f"q_{mechanism.actuators[i]}" for i in turned)
    q, signs = data.q.copy(), data.read.get("signs", {})
    q[:, turned] *= -1.0
    right = replace(data, q=q, whole=None, place=None, read=with_line(
        data, "signs", {n: -signs.get(n, 1) for n in names}))
    return right, (FileFault("sign", names, f"{with_verb(names, 'has', 'have')} the other sign: "
                             "lengths of struts, which are not negative at home"),)


# --- rows that repeat the previous one: an instrument, or a log of joints, that was not updated ---
#
# With noise, a pose measured twice hardly ever gives the same digits, and a machine that has moved
# does not show the joint values of the previous row. While a machine rests, a measurement is
# stale if it repeats to the last digit and the file's other repeats do not.

FEWEST = 8
"""Fewest rows of a data set for its usual step to be known."""
MOVED = 0.1
"""A step of more than this part of the usual one is a move."""
BY_CHANCE = 0.05
"""Expected number of repeats by coarse digits alone above which no row is stale."""


def stale(data: Dataset, mechanism: Mechanism) -> tuple[Bools, tuple[FileFault, ...]]:
    """Return which rows repeat the previous one (N,), and this as mistakes.

    Heights and distances may well be the same twice: they are not judged.
    """
    out = np.zeros(len(data), dtype=bool)
    if not readable(data) or len(data) < FEWEST:
        return out, ()
    parts = list(coordinates(data, mechanism.motion))
    measured = shown(data)[:, parts]
    scale = np.where(np.array(parts) < 3, 1.0, mechanism.length_scale)
    pose_step, joint_step = (np.append(np.nan, np.linalg.norm(np.diff(v, axis=0), axis=1))
                             for v in (measured * scale, data.q))
    next_to = np.append(False, np.diff(data.rows) == 1)
    # by the file's labels: otherwise equal joint values alone would make rows one pose
    labels = data.groups if data.labels is None else data.labels
    same_group = np.append(False, np.diff(labels) == 0)
    moved = _moved(joint_step, joint_step)
    resting = _same_at_rest(measured, np.isfinite(joint_step) & ~moved & next_to)
    why = ", although the machine had moved"
    at_rest = f"{why} or its other repeats differ" if resting.any() else why
    found = []
    for rows, columns, what, reason in (
            ((pose_step == 0.0) & moved & next_to | resting,
             [POSE_COORDINATES[c] for c in parts], "the measurement repeats that", at_rest),
            ((joint_step == 0.0) & _moved(pose_step, pose_step[joint_step != 0.0]) & next_to
             & ~same_group, [f"q_{a}" for a in mechanism.actuators],
             "the joint values repeat those", why)):
        if rows.any() and rows.mean() < MOST:    # if more rows repeat, they are meant to
            out |= rows
            numbers = tuple(data.rows[rows].tolist())
            found.append(FileFault("stale", tuple(columns), f"in {pluralize(len(numbers), 'row')} "
                                   f"{what} of the previous row{reason}", numbers))
    return out, tuple(found)


def _same_at_rest(measured: Array, rest: Bools) -> Bools:
    """Return which measurements (N, m) repeat the previous one although noise should show (N,).

    ``rest``: rows before which the machine rested (N,). The other ones show how often a coordinate
    repeats by chance.
    """
    equal = np.concatenate([np.zeros((1, measured.shape[1]), bool), np.diff(measured, axis=0) == 0])
    same = rest & equal.all(axis=1)
    others = rest & ~same & np.isfinite(measured).all(axis=1)
    # estimated rate, never 0 (Laplace)
    chance = float(np.prod((equal[others].sum(axis=0) + 1.0) / (int(others.sum()) + 2.0)))
    if same.sum() >= MOST * rest.sum() or chance * rest.sum() > BY_CHANCE:
        return np.zeros_like(rest)
    return same


def _moved(step: Array, moves: Array) -> Bools:
    """Return which steps (N,) are moves of the machine.

    ``moves``: steps that show its usual travel (M,), without the scatter of repeats.
    """
    moving = moves[np.isfinite(moves) & (moves > 0.0)]
    usual = float(np.median(moving)) if moving.size else np.inf
    with np.errstate(invalid="ignore"):
        return np.asarray(step > MOVED * usual)


def without_stale(datasets: Sequence[Dataset], mechanism: Mechanism) -> tuple[Dataset, ...]:
    """Return the data sets with their stale rows marked unusable, with findings on them."""
    out = []
    for data in datasets:
        rows, found = stale(data, mechanism)
        told = [Note(f"{data.source}: {m.text}: row{'s' * (len(m.rows) > 1)} "
                     f"{abbreviate_list([str(n) for n in m.rows], data.source, 8)}; left out.",
                     topic="stale rows")
                for m in found]
        # data that passed here before already have the finding
        out.append(replace(data.without(rows, "stale: repeats the row before"), findings=tuple(
            dict.fromkeys((*data.findings, *told)))) if found else data)
    return tuple(out)
