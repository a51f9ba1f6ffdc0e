"""How far a machine is from where it should be, over many poses."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit import turn_between
from ppmcal.errors import NoResult
from ppmcal.io.results.export import CommandErrors
from ppmcal.io.results.parts import ErrorSize
from ppmcal.kinematics.registration import predict
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

MM = 1e-3


@dataclass(frozen=True)
class PlanarMotion:
    """A turn about z, rad, and a shift along x and y, m."""

    turn: float
    shift: tuple[float, float]


@dataclass(frozen=True)
class ErrorSummary:
    """Errors over ``count`` poses: of position, m, and of rotation, rad, if there is one.

    ``removed``: what was taken out of them, None for nothing. ``real``, ``wanted``: the motors
    (N, 8) that they are of, base frame, where rotations are known.
    """

    rms: float
    max: float
    rotation_rms: float | None = None
    rotation_max: float | None = None
    count: int = 0
    removed: PlanarMotion | None = None
    real: Array | None = field(default=None, repr=False, compare=False)
    wanted: Array | None = field(default=None, repr=False, compare=False)

    def seen(self, now: Registration, believed: Registration) -> ErrorSummary:
        """Return the errors of the mark that an instrument sees, in its frame.

        ``now``: where it stands and the mark is; ``believed``: where they were taken to be when
        the poses were asked for. The same where motors are not known.
        """
        if self.real is None or self.wanted is None:
            return self
        (at, turned), (asked, meant) = predict(now, self.real), predict(believed, self.wanted)
        return _summary(now.scale * at - believed.scale * asked, turn_between(turned, meant),
                        self.rotation_rms is not None)

    def entry(self) -> CommandErrors:
        """Return the entry of export.json, mm and degrees."""
        more: dict[str, Any] = {}
        if self.rotation_rms is not None and self.rotation_max is not None:
            more["rotation"] = ErrorSize(
                rms=float(np.degrees(self.rotation_rms)), max=float(np.degrees(self.rotation_max)),
                unit="deg")
        if self.removed is not None:
            more |= {"turn": float(np.degrees(self.removed.turn)),
                     "shift": tuple(v / MM for v in self.removed.shift)}
        return CommandErrors(rms=self.rms * 1e3, max=self.max * 1e3, unit="mm", **more)

    def words(self) -> str:
        """Return ``0.0123 mm rms, 0.0456 mm at most``, and the rotation."""
        return self.entry().words()


def rms_entry(position: float | None, rotation: float | None, **more: Any) -> CommandErrors:
    """Return root mean squares, m and rad, as an entry of export.json; rotation if there is one."""
    if rotation is not None:
        more["rotation"] = ErrorSize(rms=float(np.degrees(rotation)), unit="deg")
    return CommandErrors(rms=None if position is None else position * 1e3, unit="mm", **more)


def pose_errors(mechanism: Mechanism, real: Array, wanted: Array) -> ErrorSummary:
    """Return how far motors ``real`` are from ``wanted`` (N, 8), over the rows that are known.

    Raises:
        NoResult: no row is.
    """
    rows = np.flatnonzero(finite_rows(real) & finite_rows(wanted))
    if not rows.size:
        raise takes_none(mechanism)
    at, ideal = real[rows], wanted[rows]
    own = _summary(cga.translation(at) - cga.translation(ideal),
                   cga.rotation_vector(cga.compose(cga.reverse(ideal), at)),
                   bool(mechanism.motion.turns))
    return replace(own, real=at, wanted=ideal)


def _summary(shift: Array, turn: Array, turns: bool) -> ErrorSummary:
    """Return the sizes of shifts (N, 3) and, if the machine ``turns``, of turns (N, 3)."""
    away, angle = np.linalg.norm(shift, axis=1), np.linalg.norm(turn, axis=1)
    return ErrorSummary(rms(away), float(np.max(away)), rms(angle) if turns else None,
                        float(np.max(angle)) if turns else None, len(away))


def takes_none(mechanism: Mechanism) -> NoResult:
    """Return the error of poses of which a machine takes none."""
    return NoResult("the machine takes none of the poses", mechanism.source,
                    "Check `home` and `limits`, and the model with `ppmcal check`")


def next_to_none(mechanism: Mechanism) -> NoResult:
    """Return the error of a machine of which hardly a pose is within its limits."""
    return NoResult("the machine takes next to no pose around home within its limits",
                    mechanism.source, "Check `home` and `limits`")


def within_limits(mechanism: Mechanism, q: Array) -> Bools:
    """Return which joint values (N, k) are within the limits (N,)."""
    low, high = mechanism.limits.T
    with np.errstate(invalid="ignore"):
        return np.asarray(np.all((q >= low) & (q <= high), axis=1))


def rms(values: Array) -> float:
    """Return the root mean square of values (n,)."""
    return float(np.sqrt(np.mean(values**2)))
