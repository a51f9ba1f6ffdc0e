"""What a kind of instrument is: what it shows, and what that tells of where it stands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.model.motions import SPATIAL, Motion
from ppmcal.model.registry import Registry

Parts = tuple[int, ...]
FRAME, TARGET, ROTATION, HOMING = REGISTERED = ("frame", "target", "rotation", "homing")
"""What a registration may fit, simplest first."""


def whole_frame(motion: Motion, between: bool) -> Parts:
    """Return all components of a frame."""
    return motion.frame_parts


def whole_target(motion: Motion, relative: bool) -> Parts:
    """Return all components of a target point."""
    return tuple(range(motion.axes))


@dataclass(frozen=True, eq=False)
class InstrumentKind:
    """One kind of instrument: what it measures of frame o pose o target.

    Attributes:
        name: as in files.
        coordinates: motion -> which of x, y, z, rx, ry, rz it shows; what one number is
            stands in the place of one of them.
        number: of a kind that shows one number, what that is called, as a column and among the
            residuals; else empty. ``sigma``: the key of its noise among the sigmas.
        value: of such a kind: measured points (n, 3), m, and the point that they are measured from
            (3,) or (n, 3) -> the numbers (n,), SI.
        start: of such a kind: points as they are seen (n, 3), numbers (n,), motion -> the step of
            the frame's pose (6,) from which a fit starts; None: points are aligned.
        frame_parts, target_parts: (motion, whether the rows are of two platform positions, or, of
            a target, whether anything moves both it and the frame) -> the components of an
            unknown frame, an unknown target, that it can tell.
        opened: what of a registration its data can demand to be open, of :data:`REGISTERED`.
        sees_rotation: whether it shows rotations beside positions.
        touches: whether it shows where a flat was touched: readings have no scale of their own,
            and the flat may have a shape.
        along_line: whether it shows a distance from the frame's origin, which is
            ``instrument.point``, or between two platform positions (``to_q_`` columns).
    """

    name: str
    coordinates: Callable[[Motion], Parts]
    number: str = ""
    value: Callable[[Array, Array], Array] | None = None
    start: Callable[[Array, Array, Motion], Array] | None = None
    frame_parts: Callable[[Motion, bool], Parts] = whole_frame
    target_parts: Callable[[Motion, bool], Parts] = whole_target
    opened: tuple[str, ...] = REGISTERED
    sigma: str = "position"
    sees_rotation: bool = False
    touches: bool = False
    along_line: bool = False

    def __post_init__(self) -> None:
        """Refuse a number that nothing says the value of (ValueError)."""
        if bool(self.number) != (self.value is not None):
            raise ValueError(f"instrument '{self.name}' needs the number's name and its value")

    def __str__(self) -> str:
        """Return the name."""
        return self.name

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        """Pickle as the registered kind of that name."""
        return _registered, (self.name,)

    @property
    def scalar(self) -> bool:
        """Whether it shows one number."""
        return bool(self.number)

    @property
    def blind(self) -> bool:
        """Whether it shows nothing: joints alone tell of the machine."""
        return not self.coordinates(SPATIAL)

    @property
    def place(self) -> int:
        """Where that number stands among x, y, z, rx, ry, rz, whatever the motion."""
        return self.coordinates(SPATIAL)[0]

    def sigma_of(self, sigmas: object) -> float | None:
        """Return what the mapping ``sigmas`` of a file says under the kind's own key."""
        found: float | None = getattr(sigmas, self.sigma) if self.sigma else None
        return found

    def refuse(self, motion: Motion, surplus: int, source: str) -> None:
        """Refuse heights of a machine that has none, and joints alone where they tell nothing.

        Args:
            motion: of the machine.
            surplus: how many equations it has more than freedoms.
            source: the file that says what kind.

        Raises:
            BadInput: touches of a flat by a planar machine; no instrument and no surplus.
        """
        if self.blind and not surplus:
            raise BadInput("without an instrument nothing is known of this machine: it has as "
                           "many closure equations as freedoms, so any joint values agree",
                           f"{source}: instrument.kind", "Measure with an instrument, or give "
                           "the machine's further limbs or encoders")
        if self.touches and motion.planar:
            raise BadInput("a planar machine cannot touch a flat: it has no z",
                           f"{source}: instrument.kind", "Use pose, position or distance")


_REGISTRY: Registry[InstrumentKind] = Registry("instrument kind", "ppmcal.instruments")
register, instruments, find_instrument = _REGISTRY.register, _REGISTRY.kinds, _REGISTRY.find


def _registered(name: str) -> InstrumentKind:
    return find_instrument(name)


def number_names() -> tuple[str, ...]:
    """Return what the numbers of all kinds that show one are called: their columns."""
    return tuple(k.number for k in instruments().values() if k.scalar)
