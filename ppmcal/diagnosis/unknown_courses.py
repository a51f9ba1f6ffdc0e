"""Slow drifts of zeros, base and target: by row number, and in recorded time.

As half waves over the campaign, smooth or a random walk; or as a start-up transient. Kennedy &
O'Hagan 2001; ISO 230-3, which lets a machine warm up.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ppmcal.diagnosis.kernels import FINER, LENGTHS, courses
from ppmcal.diagnosis.linear_system import System
from ppmcal.diagnosis.unknown_functions import EACH, Made
from ppmcal.linalg import Array
from ppmcal.model.effects import Shift
from ppmcal.model.effects.setting import PLACE

ALL_ZEROS = "all zeros"
WAVES = 24
"""Half waves of a drift in time; for a body, in all coordinates at once, half as many."""
RESTS = (*FINER, *LENGTHS[:3])
"""Time constants of transients, as fractions of a campaign."""
COURSE = "measure one pose repeatedly, from the beginning of a campaign to its end"


def courses_of(system: System, zeros_of_joints: Mapping[str, Array], least: float
               ) -> Iterator[Made]:
    """Yield slow drifts of each joint, of all joints equally and individually, of base and target.

    ``zeros_of_joints``: column of each joint's zero (N, m), per metre or radian; ``least``: rms, in
    sigmas, below which a column is only round-off.
    """
    if np.unique(_rows(system)).size < WAVES:
        return
    moving = [*_joints(system, zeros_of_joints), *_bodies(system, least)]
    for when, place in places_in(system).items():
        for name, subject, units in moving:
            for label, course, kernels in (
                    (f"a slow drift{when} of {name}",
                     *_waves(place, WAVES // (1 + (len(units) > 1)))),
                    (f"a start-up transient{when} of {name}", *_decays(place))):
                columns = np.concatenate([(u[..., None] * course[:, None, :]).reshape(
                    -1, course.shape[1]) for u in units], axis=1)
                yield Made(label, columns,
                           [np.asarray(np.kron(np.eye(len(units)), k)) for k in kernels],
                           name == ALL_ZEROS or len(units) > 1, subject=subject, remedy=COURSE)


def _waves(place: Array, count: int) -> tuple[Array, list[Array]]:
    """Return half waves of the rows' places in the campaign (N, K), and kernels (K, K)."""
    wave = np.pi * np.arange(1.0, count + 1.0)
    return np.cos(place[:, None] * wave), courses(wave)


def _decays(place: Array) -> tuple[Array, list[Array]]:
    """Return decays at the rows' places (N, K), and kernels (K, K): for all, and for each."""
    one = np.eye(len(RESTS))
    return np.exp(-place[:, None] / np.array(RESTS)), [one, *map(np.diag, one)]


def places_in(system: System) -> dict[str, Array]:
    """Return each row's place in the campaign (N,), 0 to 1: by row number, and in time."""
    rows = _rows(system)
    order = np.argsort(np.argsort(rows, kind="stable"), kind="stable")
    rank = order / max(order.size - 1.0, 1.0)
    out = {"": rank}
    time = np.concatenate([p.setting.time for p in system.firsts])
    if np.isfinite(time).all() and np.ptp(time) > 0.0:
        part = (time - time.min()) / np.ptp(time)
        if np.max(np.abs(part - rank)) > 0.5 / WAVES:
            out[" in time"] = part
    return out


def time_in(system: System) -> Array:
    """Return each row's place in the campaign (N,), 0 to 1: in time if recorded, or by number."""
    return list(places_in(system).values())[-1]


def _rows(system: System) -> Array:
    return np.concatenate([p.response.rows.row for p in system.firsts]).astype(float)


Moving = tuple[str, str, list[Array]]
"""Something that drifts: its description, what it acts on, and its columns (N, m)."""


def _joints(system: System, zeros: Mapping[str, Array]) -> Iterator[Moving]:
    """Yield the zeros of joints, per metre or radian."""
    yield from ((f"the zero of {name}", name, [unit]) for name, unit in zeros.items())
    if len(zeros) > 1:
        each = list(zeros.values())
        if len(set(system.problem.mechanism.actuator_quantity)) == 1:
            yield ALL_ZEROS, " ".join(zeros), [np.sum(each, axis=0)]
        yield "the zero of each joint individually", EACH, each


def _bodies(system: System, least: float) -> Iterator[Moving]:
    """Yield base and target, with coordinates scaled to one sigma, and each base coordinate."""
    free = system.problem.mechanism.motion.frame_coordinates
    for body in ("base", "target"):
        units = [system.column([_moved(body, c, len(p.response.pose)) for p in system.parts])
                 * system.observed for c in free]
        if body == "base":
            yield from ((f"the base's {c}", c, [u]) for c, u in zip(free, units, strict=True))
        rms = [float(np.sqrt(np.sum(u**2) / system.count)) for u in units]
        own = [np.asarray(u / r) for u, r in zip(units, rms, strict=True) if r > least]
        if own:
            yield f"the {body}", body, own


def _moved(body: str, coordinate: str, rows: int) -> Shift:
    """Return the shift of the base or the target along one coordinate, by 1."""
    along = np.tile(np.eye(6)[PLACE[coordinate]], (rows, 1))
    return Shift(frame=along) if body == "base" else Shift(target=along)
