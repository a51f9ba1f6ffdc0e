"""Are the numbers in the units that the files declare? Simple comparisons.

A wrong unit shows as a factor: 1000 (mm against m), 57.3 (deg against rad), 25.4 (in against
mm). Each finding is one sentence that names file and place, and says how to correct it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.history import ways
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note, of_column
from ppmcal.wording import row_list

LENGTH_FACTORS = {1000.0: "mm against m", 25.4: "in against mm", 1e6: "um against m"}
TURN = 2.0 * np.pi
TOO_FAR = 3.0
TOO_LITTLE = 1e-3
MOST_FAR = 1.0 / 3.0
"""If more than this part of rows is too far away, the unit is wrong, and they are not typos."""


def unit_findings(mechanism: Mechanism, datasets: Sequence[Dataset] = (),
                  sidecar: Callable[[Path], Path] = Path) -> list[Note]:
    """Return what looks like a wrong unit or a swapped column, as notes.

    Args:
        mechanism: the machine, SI.
        datasets: its measurements, SI.
        sidecar: names the file with the units of such a table, for messages.

    Raises:
        BadInput: the home pose cannot be reached.
    """
    # needs scipy; reading does not
    from ppmcal.calibration.interpretation import headers_of, in_headers, recorded_units

    outside = _home_outside(mechanism)
    out = [*_machine(mechanism), *outside.values()]
    for data in datasets:
        for mistake, unit in recorded_units(data, mechanism):
            other = in_headers(headers_of(data, mistake.columns, unit), data.source)
            lines = f"`read: {{units: {{{mistake.columns[0]}: {unit}}}}}`"
            out.append(Note(f"{data.source}: {mistake.text}. Write "
                            f"{other or f'into the sidecar: {lines}'}.", topic="units"))
        side = str(sidecar(Path(data.source)))
        out += _positions(mechanism, data, side)
        out += _rotations(data, side)
        for i, name in enumerate(mechanism.actuators):
            place = of_column(data.source, f"q_{name}")
            out += _joint(mechanism, data, i, place, side, i not in outside)
        out += _swapped(mechanism, data)
        out += _directions(mechanism, data)
    return out


def _directions(mechanism: Mechanism, data: Dataset) -> list[Note]:
    """Return recorded directions that contradict the row order vouched for by the sidecar."""
    if data.approach != "sequence":
        return []
    whole = data.entire
    told, out = ways(whole.q), []
    for a, name in enumerate(mechanism.actuators):
        recorded = whole.columns.get(f"dir_{name}", np.full(len(whole), np.nan))
        other = np.flatnonzero(np.isfinite(told[:, a]) & (np.sign(recorded) == -told[:, a]))
        if other.size:
            out.append(Note(f"{data.source}: dir_{name}: {row_list(whole.rows[other] - 1)}: the "
                            "joint came from the other side if the rows were visited in their "
                            "order. Directions are taken from the order; if the joint moved in "
                            "between, write `approach: columns`.", topic="approach"))
    return out


def _machine(mechanism: Mechanism) -> list[Note]:
    out = []
    unit = mechanism.units.length
    if mechanism.reach > 100.0 or mechanism.reach < 1e-3:
        out.append(Note(f"{mechanism.source}: units.length: the machine is {mechanism.reach:.3g} m "
                        f"across; is the file really in {unit}? Check `units: {{length: {unit}}}`.",
                        topic="units"))
    turn = float(np.max(np.abs(mechanism.home_pose[3:])))
    if turn > TURN and mechanism.units.angle == "rad":
        out.append(Note(f"{mechanism.source}: home.pose: the platform is turned by {turn:.4g} rad, "
                        "more than a whole turn; are the angles in degrees? Write `units: {angle: "
                        "deg}`.", topic="units"))
    return out


def _home_outside(mechanism: Mechanism) -> dict[int, Note]:
    """Return, by joint, a note if home itself is outside its limits."""
    out = {}
    for i, (name, q, bounds, (factor, unit)) in enumerate(zip(
            mechanism.actuators, home_state(mechanism).q.tolist(), mechanism.limits,
            mechanism.joint_units, strict=True)):
        if _beyond(np.array([q]), bounds)[0]:
            limbs = [f"'{limb.name}'" for limb in mechanism.limbs if limb.actuator == i]
            low, high = bounds
            given = "home.q" if np.isfinite(mechanism.home_q[i]) else "home.pose"
            out[i] = Note(f"{mechanism.source}: {given}: home is outside the limits of {name} "
                          f"(limb{'s' * (len(limbs) > 1)} {', '.join(limbs)}): {name} = "
                          f"{f'{q / factor:.6g} {unit}'.strip()} at home, limits "
                          f"{f'[{low / factor:.6g}, {high / factor:.6g}] {unit}'.strip()}; check "
                          "home, limits and their units.", topic="home")
    return out


def _beyond(q: Array, bounds: tuple[float, float]) -> NDArray[np.bool_]:
    """Which joint values (N,) are outside their limits, by more than round-off."""
    low, high = bounds
    slack = 1e-9 * (1.0 + abs(low) + abs(high)) if np.isfinite([low, high]).all() else 0.0
    return np.asarray((q < low - slack) | (q > high + slack))


def _factor(ratio: float, typical: float = 0.1) -> str:
    """Name the unit factor that brings a ratio of sizes closest to ``typical``, or nothing."""
    off = abs(np.log(ratio / typical))
    near = min(LENGTH_FACTORS, key=lambda f: abs(off - np.log(f)))
    if abs(off - np.log(near)) > np.log(15.0):
        return ""
    return f" (perhaps a factor {near:g}: {LENGTH_FACTORS[near]})"


def _span(values: Array) -> float:
    """Return the largest extent of the finite values along any axis, 0 without any."""
    values = values.reshape(len(values), -1)
    out = 0.0
    for column in values.T:
        finite = column[np.isfinite(column)]
        if finite.size > 1:
            out = max(out, float(finite.max() - finite.min()))
    return out


def _far(values: Array, limit: float) -> NDArray[np.bool_]:
    """Return the rows (N,) farther than this from the median row; none if there are many."""
    values = values.reshape(len(values), -1)
    values = values[:, np.isfinite(values).any(axis=0)]
    middle = np.nanmedian(values, axis=0) if values.size else 0.0
    far = np.nan_to_num(np.abs(values - middle)).max(axis=1, initial=0.0) > limit
    return far if far.sum() <= MOST_FAR * len(far) else np.zeros_like(far)


def _positions(mechanism: Mechanism, data: Dataset, side: str) -> list[Note]:
    """Compare the measured motion with the machine's reach."""
    reach, out = mechanism.reach, []
    values = data.value if data.kind.scalar else data.position
    if not data.kind.of_poses and (not data.kind.scalar or data.kind.quantity == "angle"):
        values = np.full(len(data), np.nan)
    far = _far(values, TOO_FAR * reach)
    if far.any():
        out.append(Note(f"{data.source}: {row_list(data.rows[far] - 1)}: measured more than "
                        f"{TOO_FAR:g} times the machine's reach of {reach:.4g} m away from the "
                        "other rows; correct or delete them.", topic="units"))
    span = _span(values[~far])
    commanded = 0.0 if data.commanded is None else _span(data.commanded[:, :3])
    if span > TOO_FAR * reach:
        out.append(Note(f"{data.source}: the measured motion spans {span:.4g} m, but the machine "
                        f"reaches {reach:.4g} m{_factor(span / reach)}; check units.length in "
                        f"{side} and in {mechanism.source}.", topic="units"))
    elif 0.0 < span < TOO_LITTLE * reach and len(data) > 2 and not data.kind.scalar:
        out.append(Note(f"{data.source}: the measured motion spans only {span:.4g} m, but the "
                        f"machine reaches {reach:.4g} m{_factor(span / reach)}; check units.length "
                        f"in {side} and in {mechanism.source}.", topic="units"))
    if commanded > TOO_FAR * reach:
        out.append(Note(f"{data.source}: columns cmd_x ...: the commanded motion spans "
                        f"{commanded:.4g} m, but the machine reaches {reach:.4g} "
                        f"m{_factor(commanded / reach)}; check units.length in {side}.",
                        topic="units"))
    return out


def _rotations(data: Dataset, side: str) -> list[Note]:
    """A rotation vector of more than a turn is probably in degrees, not radians."""
    size = np.abs(data.rotation[np.isfinite(data.rotation)])
    if size.size and float(np.median(size)) > TURN:
        return [Note(f"{data.source}: columns rx, ry, rz: rotations of "
                     f"{float(np.median(size)):.4g} rad are more than a whole turn (perhaps a "
                     f"factor 57.3: deg against rad); check units.angle in {side}.", topic="units")]
    return []


def _joint(mechanism: Mechanism, data: Dataset, index: int, place: str, side: str,
           limited: bool) -> list[Note]:
    """Compare one joint's values with its limits (if they hold at home), home and the reach."""
    q = data.q[:, index]
    finite = q[np.isfinite(q)]
    if not finite.size:
        return []
    outside = np.flatnonzero(_beyond(q, mechanism.limits[index]))
    if outside.size and limited:
        rows = row_list(data.rows[outside] - 1)
        if turns := _whole_turns(mechanism, q[outside], index):
            off = f"{abs(turns) * TURN / data.units.factor('angle'):.6g} {data.units.angle}"
            more, change = ("more", "subtract") if turns > 0 else ("less", "add")
            return [Note(f"{place}: {rows}: {off} {more} than within the limits of "
                         f"{mechanism.actuators[index]}: the same places, but counted in whole "
                         f"turns from elsewhere; {change} {off} in that column.", topic=place)]
        return [Note(f"{place}: {rows}: outside the limits of {mechanism.actuators[index]}; check "
                     f"the limits in {mechanism.source}, and the column's unit and order.",
                     topic=place)]
    if mechanism.actuator_has_ratio[index]:
        return []
    span = float(finite.max() - finite.min())
    if mechanism.actuator_quantity[index] == "angle":
        if float(np.median(np.abs(finite))) > 2.0 * TURN and span > 2.0 * TURN:
            return [Note(f"{place}: the joint turns through {span:.4g} rad (perhaps a factor 57.3: "
                         f"deg against rad); check units.angle in {side}.", topic=place)]
        return []
    if span > 10.0 * mechanism.reach:
        return [Note(f"{place}: the joint moves through {span:.4g} m, but the machine reaches "
                     f"{mechanism.reach:.4g} m{_factor(span / mechanism.reach)}; check "
                     f"units.length in {side}.", topic=place)]
    return _near_home(mechanism, finite, index, place)


def _whole_turns(mechanism: Mechanism, q: Array, index: int) -> int:
    """Return by how many turns values (n,) of a joint are outside its limits; 0: by no such."""
    if mechanism.actuator_quantity[index] != "angle" or mechanism.actuator_has_ratio[index]:
        return 0
    turns = round((float(np.median(q)) - float(np.mean(mechanism.limits[index]))) / TURN) if (
        np.isfinite(mechanism.limits[index]).all()) else 0
    return 0 if _beyond(q - turns * TURN, mechanism.limits[index]).any() else turns


def _near_home(mechanism: Mechanism, q: Array, index: int, place: str) -> list[Note]:
    """A joint all of whose values are much farther from its home value than the reach."""
    home = mechanism.home_q[index]
    if not np.isfinite(home):
        return []
    middle = float(np.median(q))
    if abs(middle - home) > TOO_FAR * mechanism.reach or (
            abs(home) > 0.02 * mechanism.reach and middle != 0.0
            and not 0.02 < abs(middle / home) < 50.0
            and float(np.min(np.abs(q - home))) > 0.5 * abs(home)):
        ratio = abs(middle / home) if home != 0.0 and middle != 0.0 else 1.0
        return [Note(f"{place}: values about {middle:.4g} m, but home.q is {home:.4g} "
                     f"m{_factor(ratio, 1.0)}; check the units, and the order of the columns.",
                     topic=place)]
    return []


def _swapped(mechanism: Mechanism, data: Dataset) -> list[Note]:
    """Two joints that are far from their own home values and close to each other's."""
    out = []
    middle = np.array([float(np.median(c[np.isfinite(c)])) if np.isfinite(c).any() else np.nan
                       for c in data.q.T])
    home, names = mechanism.home_q, mechanism.actuators
    width = np.array([_span(c[:, None]) for c in data.q.T])
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            own = abs(middle[i] - home[i]), abs(middle[j] - home[j])
            other = abs(middle[i] - home[j]), abs(middle[j] - home[i])
            apart = abs(home[i] - home[j])
            if (np.isfinite([*own, *other]).all() and min(own) > 0.75 * apart > 0.0
                    and max(other) < 0.25 * apart and apart > max(width[i], width[j])):
                out.append(Note(f"{data.source}: columns q_{names[i]} and q_{names[j]}: each is "
                                "near the other's home value; they look swapped. Check the header.",
                                topic="columns"))
    return out
