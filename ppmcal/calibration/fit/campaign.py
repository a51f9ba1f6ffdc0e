"""Weak campaigns: data that cannot determine what is fitted: flat, short, or with few poses.

The spread of the poses is judged against what the machine can do: singular values of positions
and of rotations, each coordinate relative to what home can reach along it, so that poses spread
evenly over all of that have 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.observation import values_per_row
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.region import extent, named
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording import pluralize

FLAT = 0.04
"""Poses lie in a plane, on a line or at a point if the next singular value is below this."""
SHORT = 0.2
"""A stroke is short if no joint uses more than this part of its range."""
FEW = 1.5
"""Poses are few if there are fewer measured numbers per unknown than this."""
HALF = 0.5
"""A parameter is unknown if the poses leave open more than this part of its tolerance, beyond what
no pose of the instrument could determine: an unknown frame, say, is confounded with the base's."""
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz", "radius", "angle")
SPANS = {2: ("one point", "a line"), 3: ("one point", "a line", "a plane")}


@dataclass(frozen=True, eq=False)
class MissingPoses:
    """Measurements that would determine what a campaign leaves unknown, SI.

    ``q`` (R, k) joints, ``pose`` (R, 6) platform poses in the base frame; ``where``: coordinates
    in which they extend the campaign: name, lowest, highest.
    """

    q: Array
    pose: Array
    where: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class WeakCampaign:
    """A weak campaign.

    Attributes:
        shapes: its weaknesses, in words.
        unknown: parameters that it leaves open to more than :data:`HALF` of their tolerance.
        groups: the same in a few words.
        touches: whether the measurements are touches.
        missing: the measurements that would determine them.
    """

    shapes: tuple[str, ...]
    unknown: tuple[str, ...]
    groups: tuple[str, ...]
    touches: bool
    missing: MissingPoses


def weak_shapes(fit: Fit) -> tuple[str, ...]:
    """Return the weaknesses of a fit's poses in words; empty if there are none."""
    return (*_spanned(fit), *_stroke(fit), *few_poses(fit)) if fit.problem.free else ()


def geometry(fit: Fit) -> tuple[int, ...]:
    """Return the free parameters of a fit that do not belong to effects."""
    effects = {p for e in fit.problem.mechanism.effects for p in e.parameters.values()}
    return tuple(p for p in fit.problem.free if p not in effects)


def poses_in_use(fit: Fit) -> Array:
    """Return the platform poses (N, 6) of the rows in use, base frame; both ends of distances."""
    return pose_vector(np.concatenate([p[k & finite_rows(p)].reshape(-1, 8) for p, k in zip(
        fit.state.poses, fit.keep, strict=True)]))


def room(mechanism: Mechanism) -> tuple[tuple[int, ...], Array]:
    """Return the coordinates that a pose has, and how far home can go along each (c,), SI.

    At least a thousandth of the reach, or of a radian.
    """
    nominal = replace(mechanism.nominal(), effects=())
    chosen = named(nominal)
    low, high = extent(Model(nominal), chosen)
    least = [1e-3 * (mechanism.reach if c < 3 else 1.0) for c in chosen]
    return chosen, np.maximum(low + high, least)


def _spanned(fit: Fit) -> Iterable[str]:
    """Yield the point, line or plane that the poses lie in, and how the platform never turns."""
    chosen, size = room(fit.problem.mechanism)
    pose = poses_in_use(fit)[:, list(chosen)]
    away = (pose - pose.mean(axis=0)) / size * np.sqrt(12.0 / max(len(pose), 1))
    for turns in (False, True):
        own = [j for j, c in enumerate(chosen) if (c >= 3) == turns]
        if not own:
            continue
        rank = int((linalg.singular_values(away[:, own]) > FLAT).sum())
        if rank == len(own):
            continue
        if turns:
            yield ("the platform never turns" if not rank
                   else f"the platform turns about {'one axis' if rank == 1 else 'two axes'} only")
        elif len(own) in SPANS:
            yield f"these poses lie in {SPANS[len(own)][rank]}".replace("in a line", "on a line")
        else:
            yield "these poses lie at one height" if chosen[own[0]] == 2 else (
                "these poses lie in one place")


def _stroke(fit: Fit) -> Iterable[str]:
    """Yield that no joint uses much of the range between its limits."""
    limits = fit.problem.mechanism.limits
    q = np.concatenate([x for i in range(len(fit.problem.datasets)) if fit.keep[i].any()
                        for x, _ in fit.problem.ends(i, fit.state, np.flatnonzero(fit.keep[i]))])
    part = np.ptp(q, axis=0) / (limits[:, 1] - limits[:, 0])
    if np.isfinite(limits).all() and part.max() < SHORT:
        yield f"your poses use only {part.max():.0%} of the joints' travel"


def few_poses(fit: Fit) -> Iterable[str]:
    """Yield that there are few numbers for the unknowns, frames included."""
    columns, count, poses = _numbers(fit)
    if count < FEW * columns:
        yield (f"{pluralize(poses, 'pose')} give {pluralize(count, 'number')} for "
               f"{pluralize(columns, 'unknown')}")


def too_few(fit: Fit) -> Iterable[Note]:
    """Yield that there are fewer measured numbers than unknowns, so that no fit determines them."""
    columns, count, poses = _numbers(fit)
    if count < columns:
        yield Note(f"{pluralize(poses, 'pose')} give {pluralize(count, 'number')} for "
                   f"{pluralize(columns, 'unknown')}: the tolerances decide what these data "
                   "cannot, and fitting to within the noise proves nothing; measure "
                   f"{_more(fit, columns - count)}", topic="few rows")


def _more(fit: Fit, missing: int) -> str:
    """Return how many more poses to measure: a number for joint values alone, else just more."""
    surplus = fit.problem.mechanism.surplus
    if not surplus or not all(d.kind.blind for d in fit.problem.datasets):
        return "more poses"
    return (f"at least {pluralize(-(-missing // surplus), 'more pose')}, to have as many numbers "
            "as unknowns")


def _numbers(fit: Fit) -> tuple[int, int, int]:
    """Return the numbers of unknowns (frames included), of measured numbers, and of poses."""
    columns, count, poses = len(fit.problem.columns), 0, 0
    for data, keep in zip(fit.problem.datasets, fit.keep, strict=True):
        # repeats of a pose show noise, or effects, but nothing new about the geometry
        own = np.unique(data.groups[keep]).size
        poses += own
        count += own * values_per_row(data, fit.problem.mechanism)
    return columns, count, poses


def grouped(mechanism: Mechanism, some: Sequence[str], among: Sequence[str]) -> tuple[str, ...]:
    """Return parameter names abbreviated: ``z, rx, ry of every joint``.

    Args:
        mechanism: whose limbs the names begin with.
        some: the names to abbreviate.
        among: all candidates; ``every`` means every limb among these.
    """
    limbs = [limb.name for limb in mechanism.limbs]

    def parts(names: Sequence[str]) -> dict[tuple[str, str], list[str]]:
        out: dict[tuple[str, str], list[str]] = {}
        for name in names:
            limb, _, rest = name.partition(".")
            slot, _, component = rest.rpartition(".")
            if limb not in limbs:
                key, limb = (name, ""), ""
            else:
                key = (slot, component) if component in COMPONENTS else (rest, "")
            out.setdefault(key, []).append(limb)
        return out

    whole, by_slot = parts(among), dict[tuple[str, tuple[str, ...]], list[str]]()
    for (slot, component), limb_names in parts(some).items():
        all_of_them = limb_names == whole.get((slot, component)) and limb_names != [""]
        every = ("every",) if all_of_them else tuple(limb_names)
        by_slot.setdefault((slot, every), []).append(component)
    alike: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
    for (slot, own), components in by_slot.items():
        alike.setdefault((tuple(components), own), []).append(slot)
    return tuple(_told(c, own, slots) for (c, own), slots in alike.items())


def _told(components: Sequence[str], own: Sequence[str], slots: Sequence[str]) -> str:
    joints = len(slots) > 1 and all(s.startswith("joint") for s in slots)
    what = "joint" if joints else " and ".join(slots)
    head = f"{', '.join(components)} of " if components[0] else ""
    if own[0] == "every":
        return f"{head}every {what}"
    return f"{head}{what}" + (f" ({', '.join(own)})" if own[0] else "")
