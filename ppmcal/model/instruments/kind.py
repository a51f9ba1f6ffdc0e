"""Instrument kinds: what they measure, and which registration parameters are identifiable."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.model.motions import POSE_COORDINATES, SPATIAL, Motion
from ppmcal.model.registry import Registry
from ppmcal.units import coordinate_quantity

if TYPE_CHECKING:
    from ppmcal.model.mechanism import Mechanism

Parts = tuple[int, ...]
FRAME, TARGET, ROTATION, HOMING = REGISTERED = ("frame", "target", "rotation", "homing")
"""The parts that a registration may fit, simplest first."""


def whole_frame(motion: Motion, between: bool) -> Parts:
    """Return all components of a frame."""
    return motion.frame_parts


def whole_target(motion: Motion, relative: bool) -> Parts:
    """Return all components of a target point."""
    return tuple(range(motion.axes))


@dataclass(frozen=True, eq=False)
class InstrumentKind:
    """One kind of instrument: what it measures of frame o pose o target, or of a limb.

    Attributes:
        name: as in files.
        coordinates: motion -> which of x, y, z, rx, ry, rz it measures; a single number is
            represented by one of them.
        number: for a kind that measures one number, its name, as a column and among the residuals;
            otherwise empty. ``sigma``: the key of its noise among the sigmas.
        value: for such a kind: measured points (n, 3), m, and the point that they are measured from
            (3,) or (n, 3) -> the numbers (n,), SI.
        start: for such a kind: points as seen (n, 3), numbers (n,), motion -> the step of the
            frame's pose (6,) from which a fit starts; None: points are aligned.
        frame_parts, target_parts: (motion, whether rows are of two platform positions, or, for a
            target, whether anything moves both it and the frame) -> the identifiable components of
            an unknown frame, or target.
        opened: parts of a registration that its data may require to be free (:data:`REGISTERED`).
        sees_rotation: whether it measures rotations in addition to positions.
        touches: whether it measures where a flat was touched: readings have no scale of their own,
            and the flat may have a shape.
        along_line: whether it measures a distance from the frame's origin, which is
            ``instrument.point``, or between two platform positions (``to_q_`` columns).
        names: of its coordinates, if they are not pose coordinates.
        of_turn: for a kind that measures angles of a body's rotation: rotations (n, 3, 3) in the
            measuring frame, motion -> angles (n, k), rad, and their derivatives by a rotation in
            that frame (n, k, 3). Unless the machine is planar, that frame's z is up.
        aligned: for such a kind: angles, rotations of the platform to that frame, rotations of
            frame and body, which of these two are free -> these two, from which a fit starts.
        placed: for a kind at a joint of a limb: the name of the joint, the machine, the place in
            the file -> the coordinate that represents it. ``at``: that joint. ``joints``: the
            machine -> the names of all possible joints.
        assumed: values that the sidecar need not give. ``refused``: motion, direction of weight in
            base axes -> why it is useless on such a machine, and what to do; empty: it is not.
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
    names: tuple[str, ...] = ()
    of_turn: Callable[[Array, Motion], tuple[Array, Array]] | None = None
    aligned: Callable[[Array, Array, tuple[Array, Array], tuple[bool, bool]],
                      tuple[Array, Array]] | None = None
    placed: Callable[[str, Mechanism, str], int] | None = None
    joints: Callable[[Mechanism], Sequence[str]] = lambda mechanism: ()
    at: str = ""
    assumed: Mapping[str, str] = field(default_factory=dict)
    refused: Callable[[Motion, Array], tuple[str, str]] | None = None

    def __post_init__(self) -> None:
        """Reject a number without a function for its value (ValueError)."""
        if bool(self.number) != (self.value is not None or self.placed is not None):
            raise ValueError(f"instrument '{self.name}' needs the number's name and its value")

    def __str__(self) -> str:
        """Return the name."""
        return self.name

    def __reduce__(self) -> tuple[Any, tuple[str, str, int]]:
        """Pickle as the registered kind of that name, at its joint."""
        return _registered, (self.name, self.at, self.place if self.at else 0)

    @property
    def scalar(self) -> bool:
        """Whether it measures one number."""
        return bool(self.number)

    @property
    def also_called(self) -> tuple[str, ...]:
        """Other words in files for which its name is suggested."""
        return () if self.placed is None else ("encoder",)

    @property
    def blind(self) -> bool:
        """Whether it measures nothing: there are only the joint values."""
        return not self.coordinates(SPATIAL)

    @property
    def inside(self) -> bool:
        """Whether it is independent of base frame and target: it measures only joints."""
        return self.blind or self.placed is not None

    @property
    def of_poses(self) -> bool:
        """Whether it measures pose coordinates themselves, or a number derived from them."""
        return self.of_turn is None and self.placed is None

    @property
    def scales(self) -> bool:
        """Whether it measures lengths, which may have a scale error."""
        return self.of_poses and not self.touches

    @property
    def place(self) -> int:
        """Index of that number among x, y, z, rx, ry, rz, for any motion."""
        return self.coordinates(SPATIAL)[0]

    @property
    def quantity(self) -> str:
        """The quantity of that number, ``length`` or ``angle``."""
        return coordinate_quantity(POSE_COORDINATES[self.place])

    def columns(self, motion: Motion) -> tuple[str, ...]:
        """Return the column names of its measurements."""
        if self.scalar:
            return (self.number,)
        own = self.coordinates(motion)
        return self.names[:len(own)] or tuple(POSE_COORDINATES[c] for c in own)

    def labels(self, motion: Motion) -> tuple[str, ...]:
        """Return the names of its measurements among residuals: joints by their name."""
        prefix = TURN_OF if self.place > 2 else SLIDE_OF
        return (f"{prefix}{self.at}",) if self.at else self.columns(motion)

    def located(self, at: str | None, mechanism: Mechanism, source: str) -> InstrumentKind:
        """Return the kind at the joint named in a file; itself if it needs none.

        Raises:
            BadInput: an unknown joint, a missing one, or one that is not needed.
        """
        place = f"{source}: instrument.at"
        if self.placed is None:
            if at is not None:
                raise BadInput(f"the instrument '{self}' is not at a joint", place,
                               "Take it out, or write `kind: joint`")
            return self
        return _at_joint(self, at or "", self.placed(at or "", mechanism, place))

    def elsewhere(self, mechanism: Mechanism) -> Iterator[InstrumentKind]:
        """Yield the kind at each other possible joint of the machine."""
        for at in self.joints(mechanism):
            if at != self.at:
                yield self.located(at, mechanism, mechanism.source)

    def sigma_of(self, sigmas: object) -> float | None:
        """Return the entry of a file's mapping ``sigmas`` under the kind's own key."""
        found: float | None = getattr(sigmas, self.sigma) if self.sigma else None
        return found

    def sigma_stated(self, sigmas: Any) -> float | None:
        """Return the same, or the entry for positions if that applies."""
        return self.sigma_of(sigmas) or (sigmas.position if self.of_poses else None)

    def refuse(self, motion: Motion, surplus: int, source: str, gravity: Array | None = None
               ) -> None:
        """Reject heights of a planar machine, and joint values alone without redundancy.

        Args:
            motion: of the machine.
            surplus: number of closure equations in excess of the freedoms.
            source: the file that gives the kind.
            gravity: direction of weight in base axes (3,)  [default: the motion's usual one].

        Raises:
            BadInput: touches of a flat by a planar machine; no instrument and no surplus; reasons
                of the kind itself.
        """
        if self.refused is not None:
            why, hint = self.refused(motion, motion.gravity if gravity is None else gravity)
            if why:
                raise BadInput(why, f"{source}: instrument.kind", hint)
        if self.blind and not surplus:
            raise BadInput("without an instrument this machine cannot be calibrated: it has as "
                           "many closure equations as freedoms, so any joint values are consistent",
                           f"{source}: instrument.kind", "Measure with an instrument, or give "
                           "the machine's further limbs or encoders")
        if self.touches and motion.planar:
            raise BadInput("a planar machine cannot touch a flat: it has no z",
                           f"{source}: instrument.kind", "Use pose, position or distance")


_REGISTRY: Registry[InstrumentKind] = Registry("instrument kind", "ppmcal.instruments")
register, instruments, find_instrument = _REGISTRY.register, _REGISTRY.kinds, _REGISTRY.find


TURN_OF, SLIDE_OF = "turn_", "slide_"
"""Prefixes of a joint reading's name among residuals."""


def _registered(name: str, at: str = "", place: int = 0) -> InstrumentKind:
    kind = find_instrument(name)
    return _at_joint(kind, at, place) if at else kind


@lru_cache(maxsize=256)
def _at_joint(kind: InstrumentKind, at: str, coordinate: int) -> InstrumentKind:
    return replace(kind, at=at, coordinates=lambda motion: (coordinate,))


def number_names() -> tuple[str, ...]:
    """Return the column names of all kinds that measure one number of a point."""
    return tuple(k.number for k in instruments().values() if k.scalar and k.of_poses)


def is_own_reading(name: str) -> bool:
    """Whether a residual is of a tilt angle or of an encoder reading."""
    return name.startswith((TURN_OF, SLIDE_OF)) or any(
        name in k.names for k in instruments().values())
