"""A sensitivity analysis in sentences, and what the user must look at."""

from __future__ import annotations

import numpy as np

from ppmcal.design.sensitivity import Sensitivity
from ppmcal.io.results.sensitivity_tables import (
    parameter_name,
    pose_quantity,
    rotates,
    size_quantity,
    size_unit,
)
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.region import Grid
from ppmcal.kinematics.tables import limit_reason
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording import number

LINEAR_WITHIN = 0.01
"""The linear model counts as right up to this relative difference."""
BAD, FAR = 0.1, 3.0
"""A finding: the linear model is wrong by this part before this many tolerances."""
ROUND_OFF = 1e-9


def sentences(found: Sensitivity, grid: Grid | None) -> list[str]:
    """Return the results in words, the most important first."""
    return [*_home(found), *_over_poses(found, grid), *_together(found), _linearity(found)]


def linear_limit(found: Sensitivity) -> float | None:
    """Return up to which size the linear model is right to 1 %, None where at all tried."""
    value = found.linear.holds_to(LINEAR_WITHIN)
    if not np.isfinite(value):
        return None
    return value / found.mechanism.units.factor(size_quantity(found))


def _home(found: Sensitivity) -> list[str]:
    """Return the errors at home, and the amplification index there."""
    units, home = found.mechanism.units, found.home
    turned = (f" and {units.words(found.home_index[1], 'angle/length')}" if rotates(found) else "")
    times = (f"{found.asked.sigmas:g} tolerances" if found.asked.sigmas != 1.0
             else "its tolerance")
    rho = units.words(found.asked.metric, "length")
    return [f"{found.mechanism.name}: {len(found.sources)} errors. At home the tool is off by "
            f"{_pair(found, home.position[0], home.rotation[0])} (root sum square, each error one "
            f"tolerance), at worst by "
            f"{_pair(found, home.worst_position[0], home.worst_rotation[0])} with "
            f"every error at {times}.",
            f"Error amplification at home: {number(found.home_index[0], 5)} "
            f"{units.name('length/length')}{turned} (all errors alike; angles count by {rho})."]


def _pair(found: Sensitivity, position: float, rotation: float) -> str:
    """Return an error of position and, where the platform rotates, of rotation."""
    units = found.mechanism.units
    text = units.words(position, "length")
    return f"{text} and {units.words(rotation, 'angle')}" if rotates(found) else text


def _over_poses(found: Sensitivity, grid: Grid | None) -> list[str]:
    """Return the range of the amplification index over the poses, and where it is least."""
    index, units = found.index[:, 0], found.mechanism.units
    good = np.isfinite(index)
    if good.sum() < 2:
        return ([f"Only 1 of {len(good)} poses can be used, see status in map.csv."]
                if 1 == good.sum() < len(good) else [])
    least = found.table.pose[int(np.nanargmin(index))]
    place = ", ".join(
        f"{name} = {number(_rounded(least[c] / units.factor(pose_quantity(c))))}"
        for name, c in zip(found.mechanism.coordinates, found.mechanism.dof, strict=True)
        if grid is None or c in grid.coordinates)
    return [f"Over {int(good.sum())} of {len(good)} poses it goes from "
            f"{number(np.nanmin(index))} to {number(np.nanmax(index))}; it is least at {place}."]


def _rounded(value: float) -> float:
    """Return 0 for what is only round-off."""
    return 0.0 if abs(value) < ROUND_OFF else value


def _together(found: Sensitivity) -> list[str]:
    """Return what errors of the size asked for do together."""
    one, units = found.at_size, found.mechanism.units
    if one is None:
        return []
    size = one.scale[0] / units.factor(size_quantity(found))
    head = f"{len(found.moved)} errors of {size:g} {size_unit(found)} together"
    if not np.isfinite(one.exact).all():
        return [f"{head} are too large: the machine has no pose at home's joint values then."]
    linear, exact = ([units.words(v, q, 7) for v, q in zip(both[0], ("length", "angle"),
                                                           strict=True)]
                     for both in (one.linear, one.exact))
    relative = one.apart[0, 0] / one.linear[0, 0] if one.linear[0, 0] > 0.0 else None
    turned = "" if not rotates(found) else (
        f" and turn it by {linear[1]} (linear), {exact[1]} (nonlinear)")
    return [f"{head} move the tool by {linear[0]} (linear), {exact[0]} (nonlinear), apart by "
            f"{number(relative, 3)} of it{turned}."]


def _linearity(found: Sensitivity) -> str:
    """Return up to which size of errors the linear model is right."""
    limit = linear_limit(found)
    what = ("All errors tried" if not found.asked.together else " and ".join(found.asked.together))
    if limit is None:
        return f"{what}: the linear model is right to {LINEAR_WITHIN:.0%} at every size tried."
    return (f"{what}: the linear model is right to {LINEAR_WITHIN:.0%} up to {number(limit, 3)} "
            f"{size_unit(found)}.")


def findings(found: Sensitivity, mechanism: Mechanism, grid: Grid | None) -> list[Note]:
    """Return what must be looked at: poses of a file that cannot be reached, wrong linear model."""
    out = list(mechanism.findings)
    lost = [parameter_name(found, s) for s, t in zip(found.sources, found.sigma, strict=True)
            if not t > 0.0]
    if lost:
        out.append(Note(
            f"{lost[0]}{f' and {len(lost) - 1} more' if len(lost) > 1 else ''} without a "
            "finite tolerance: root sum square, worst case and shares leave them out"))
    outside = limit_reason(mechanism, home_state(mechanism).q)
    if outside:
        out.append(Note(f"home is not within limits: {outside}"))
    if grid is None and len(found.table.status) > 1:
        out += [Note(f"row {n + 1}: {r}") for n, (s, r) in enumerate(
            zip(found.table.status, found.table.reason, strict=True)) if s != "ok"]
    limit = found.linear.holds_to(BAD)
    if not found.asked.together and limit < FAR:
        out.append(Note(
            f"the linear model is wrong by more than {BAD:.0%} from about {limit:.2g} times "
            "the tolerances on: trust Monte Carlo (ppmcal tolerances) instead"))
    return out
