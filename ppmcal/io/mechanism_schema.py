"""The models of the mechanism file, and the slots of a limb in it.

Declared here for the reader, the writer and the JSON Schema; which slots there are is the limb
kind's to say (:class:`ppmcal.model.limbs.chain.SlotSpec`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, TypeAdapter, ValidationError

from ppmcal.errors import BadInput, refuse_unknown, unknown
from ppmcal.io.schema import (
    DEVIATION,
    LARGEST,
    LIMIT,
    Flag,
    Label,
    Number,
    Path,
    Positive,
    Registered,
    Sigma,
    Strict,
    UnitsFile,
    Word,
    choice,
    each,
    numbers,
    refuse,
    show,
    translate,
    vector,
)
from ppmcal.model.limbs import LimbKind
from ppmcal.model.limbs.chain import SlotSpec
from ppmcal.model.motions import Motion, motions

FORMAT = "ppmcal/mechanism/1"


def _range(value: list[float]) -> list[float]:
    if value[0] >= value[1]:
        raise refuse(f"the lower limit {value[0]:g} is not below the upper {value[1]:g}",
                     "Write [lower, upper]")
    return value


def _ends(value: list[float]) -> list[float]:
    if value[0] > value[1]:
        raise refuse(f"the lowest value {value[0]:g} is above the highest {value[1]:g}",
                     "Write [lowest, highest]")
    return value


def _pattern(value: object) -> str:
    if not isinstance(value, str) or not value:
        raise refuse(f"{show(value)} is not a pattern",
                     'Write a pattern over parameter names in quotes, such as "*.offset"')
    return value


class TolerancesFile(Strict):
    """One standard deviation for each class of slots."""

    point: Sigma | None = None
    """Of joint coordinates: x, y, z, radius."""
    length: Sigma | None = None
    """Of rods and other lengths."""
    angle: Sigma | None = None
    """Of angles and directions."""
    offset: Sigma | None = None
    """Of the drives' zeros."""


class CostFile(Strict):
    """What a tolerance costs: weight / tolerance^exponent, the tolerance in file units."""

    weight: Positive = 1.0
    """Cost of a tolerance of 1 file unit."""
    exponent: Positive = 1.0
    """How fast the cost rises as the tolerance shrinks."""


def _cost(value: object) -> object:
    return value if isinstance(value, dict | CostFile) else {"weight": value}


class HomeFile(Strict):
    """The pose that selects the assembly mode, and maybe its joint values."""

    examples: ClassVar[Mapping[str, str]] = {"pose": "pose: {x: 0, y: 0, rz: 0}"}
    pose: Any
    """Pose of the platform in the assembly mode that is meant."""
    q: dict[Label, Number] | None = None
    """Joint values at that pose by actuator, to be checked against the limbs."""


class RegistrationFile(Strict):
    """Frame and target of one data set that was identified."""

    frame: Any = None
    """Pose of the base in the measuring frame."""
    target: Annotated[list[float], vector(3, 2)] | None = None
    """The measured point in platform axes."""
    target_rotation: Annotated[list[float], vector(3)] | None = None
    """Rotation vector of the measured body in platform axes."""
    scale: Positive = 1.0
    """Lengths that the instrument shows over true ones."""


class NoiseCheckFile(Strict):
    """What the residuals of the calibration were against the stated noise."""

    examples: ClassVar[Mapping[str, str]] = {"sigma_ratio": "sigma_ratio: 1.02"}
    sigma_ratio: Sigma
    """Residuals over the stated noise, root mean square."""
    chi2_p: Number | None = None
    """Chance of residuals as large, if the model and the stated noise are right."""


class MeasurementFile(Strict):
    """``measurement: {datasets: {name: ...}}``, written by identify."""

    datasets: dict[Label, RegistrationFile] = Field(default_factory=dict)
    """Registration of each data set by its name."""
    noise: NoiseCheckFile | None = None
    """Residuals against the stated noise: what misses its own data is not commanded."""
    ranges: dict[Label, Annotated[list[float], vector(2), AfterValidator(_ends)]] = Field(
        default_factory=dict)
    """Lowest and highest measured value by column: pose in the base frame, joints, conditions."""
    converged: Flag | None = None
    """Whether the fit was at its minimum, or ended at the noise; else it is not commanded."""


_sigma = each(numbers(lambda v: 0 <= v <= LARGEST, "a standard deviation",
                      "Write a number of 0 or more, or one for each limb: {c1: 0.1}"))


class ClosureFile(Strict):
    """What limbs may gap, of a machine with more of them than its platform has freedoms."""

    examples: ClassVar[Mapping[str, str]] = {"sigma": "sigma: {c1: 0.1, c2: 0.2}"}
    sigma: Annotated[Any, BeforeValidator(_sigma)]
    """Standard deviation of how far limbs are from closing beside their drives' noise, as a length:
    one number, or one by limb."""


class MechanismFile(Strict):
    """The top of a mechanism file; the limbs are checked against their kinds later."""

    examples: ClassVar[Mapping[str, str]] = {
        "format": f"format: {FORMAT}",
        "units": "units: {length: mm, angle: deg}",
        "motion": "motion: planar",
        "limbs": "limbs: [{name: leg1, kind: R(P)R, base: {point: [0, 0]}, ...}]",
        "home": "home: {pose: {x: 0, y: 0, rz: 0}}",
    }
    format: Annotated[str, choice("format", FORMAT)]
    """What this file is."""
    units: UnitsFile
    """Units of every number in this file."""
    motion: Annotated[Motion, Registered("motion", motions)]
    """planar-point: x, y; planar: x, y, rz; translational: x, y, z; schoenflies: x, y, z, rz;
    spatial: x, y, z, rx, ry, rz."""
    limbs: list[dict[Any, Any]]
    """The limbs from base to platform."""
    home: HomeFile
    """The pose that selects the assembly mode."""
    name: Label | None = None
    """The machine's name  [default: the file's]."""
    extends: Any = None
    """A mechanism file, relative to this one, that this one is laid over."""
    tolerances: TolerancesFile | None = None
    """Default standard deviations by class of slot: the prior."""
    limits: dict[Label, Annotated[list[float], vector(2, of=LIMIT),
                                  AfterValidator(_range)]] | None = None
    """Travel by actuator: [lower, upper], joint values."""
    gravity: Annotated[list[float], vector(3, 2)] | None = None
    """Direction of weight in base axes."""
    effects: Any = None
    """What acts beyond geometry."""
    stiffness: Any = None
    """Springs of all limbs; a limb may have its own."""
    cost: dict[str, Annotated[CostFile, BeforeValidator(_cost)]] | None = None
    """What a tolerance costs, by class of slot."""
    measurement: MeasurementFile | None = None
    """Registrations of data sets, written by identify."""
    free: list[Annotated[str, BeforeValidator(_pattern)]] | None = None
    """Patterns of the parameters that may change  [default: all with a tolerance]."""
    gauge: Annotated[str, choice("gauge", "base", "tolerances")] = "base"
    """What holds the base where joint values alone are measured: base: some of its points stay
    where they are; tolerances: the priors of all."""
    closure: ClosureFile | None = None
    """What limbs may gap, of a machine with more of them than its platform has freedoms."""
    optional: list[list[Annotated[str, BeforeValidator(_pattern)]]] | None = None
    """Lists of patterns, nested: freedoms that identify takes, or leaves, by what predicts
    left-out rows. Fixed ones need a tolerance. --free overrides them."""


def word(value: object, place: str) -> str:
    """Return a name that can stand in a column header and in a parameter path."""
    try:
        return str(TypeAdapter(Word).validate_python(value))
    except ValidationError as error:
        raise translate(error, place) from None


# ---- slots: which stand together under a path, and what may stand there


TURNS = ("rx", "ry", "rz")
"""Components of the small rotation that is a direction's error."""
POINTS = ("point", "center")
"""Last words of paths that are points."""
Form = Literal["direction", "first axis", "joint frame", "point", "number"]


class SlotFile(Strict):
    """One slot: ``120`` or ``{value: 120, tolerance: 0.2, fixed: true}``."""

    value: Number | None = None
    """Present value, in the file's unit of length or angle."""
    tolerance: Sigma | None = None
    """Standard deviation of the part from its nominal value; .inf: no prior."""
    fixed: Flag | None = None
    """Whether identification must leave it as it is."""
    nominal: Number | None = None
    """Value of the drawing, where `value` is an identified one."""
    sigma: Sigma | None = None
    """Standard deviation of `value` after identification."""
    share: Path | None = None
    """Name of a parameter that several slots have in common."""


def _three_sigmas(value: object) -> list[float]:
    values = value if isinstance(value, list) else [value] * 3
    if len(values) != 3:
        raise refuse(f"a number or a list of 3 is needed here, this has {len(values)}",
                     "Write one standard deviation, or [rx, ry, rz]")
    return [DEVIATION(one) for one in values]


class DirectionFile(Strict):
    """A unit vector: ``[0, 0, 1]`` or with its error, a small rotation in base axes.

    The machine's direction is Rot(``rotation``) ``value``; ``nominal`` is the nominal
    direction; ``sigma`` and ``tolerance`` belong to the rotation's rx, ry, rz.
    """

    value: Annotated[list[float], vector(3)] | None = None
    """The direction; it need not have length 1."""
    nominal: Annotated[list[float], vector(3)] | None = None
    """The direction of the drawing."""
    rotation: Annotated[list[float], vector(3)] | None = None
    """Small rotation in base axes that turns `value`: [rx, ry, rz]."""
    sigma: Annotated[list[float], BeforeValidator(_three_sigmas)] | None = None
    """Standard deviation of the rotation after identification."""
    tolerance: Annotated[list[float], BeforeValidator(_three_sigmas)] | None = None
    """Standard deviation of the rotation from the drawing."""
    fixed: Flag | None = None
    """Whether identification must leave it as it is."""
    share: Path | None = None
    """Name of a direction that several limbs have in common."""


@dataclass(frozen=True)
class SlotGroup:
    """Slots that stand together in a file.

    Attributes:
        path: ``base.point``; of a single slot its name.
        form: what stands there. ``first axis``: that of a universal joint, which a limb may lack.
        slots: in parameter order; of directions the small rotation that is their error.
    """

    path: str
    form: Form
    slots: tuple[SlotSpec, ...]

    @property
    def parts(self) -> dict[str, SlotSpec]:
        """The slots by the last word of their names: x, y, z, rx ..."""
        return {s.name.rpartition(".")[2]: s for s in self.slots}

    @property
    def polar(self) -> dict[str, SlotSpec]:
        """What a point may have in place of x and y: radius and angle."""
        return {"radius": SlotSpec(f"{self.path}.radius", "length", "point"),
                "angle": SlotSpec(f"{self.path}.angle", "angle", "angle")}


def groups(kind: LimbKind) -> list[SlotGroup]:
    """Return the slots of a kind in order, points, directions and joint frames together."""
    out: dict[tuple[str, Form], list[SlotSpec]] = {}
    for spec in (*kind.slots, *kind.joint_slots):
        head, _, tail = spec.name.rpartition(".")
        form: Form = (
            "direction" if head in kind.directions else "first axis" if head in kind.axes else
            "joint frame" if head.startswith("joint") and tail in ("x", "y", "z", *TURNS) else
            "point" if head.endswith(POINTS) else "number")
        out.setdefault((spec.name if form == "number" else head, form), []).append(spec)
    for path in kind.axes_without_errors:
        out[path, "direction"] = []
    return [SlotGroup(path, form, tuple(slots)) for (path, form), slots in out.items()]


def point_parts(raw: Any, axes: list[str], place: str) -> dict[str, Any]:
    """Return axis (or radius, angle) -> raw slot of a point, in parameter order."""
    example = "[" + ", ".join(["0"] * len(axes)) + "]"
    forms = (f"Write {example} with your numbers, {{{', '.join(f'{a}: ..' for a in axes)}}}, or "
             f"{{radius: .., angle: ..{', z: ..' if 'z' in axes else ''}}}")
    if raw is None:
        raise BadInput("the point is missing", place, forms)
    if isinstance(raw, list):
        if len(raw) != len(axes):
            raise BadInput(f"the point has {len(raw)} coordinates instead of {len(axes)}", place,
                           forms)
        return dict(zip(axes, raw, strict=True))
    if not isinstance(raw, dict):
        raise BadInput(f"{show(raw)} is not a point", place, forms)
    if "value" in raw or "share" in raw:
        return _spread_point(raw, axes, place)
    polar = "radius" in raw or "angle" in raw
    names = ["radius", "angle", *axes[2:]] if polar else axes
    for key in raw:
        if key not in names:
            raise unknown("key", key, names if polar else [*axes, "radius", "angle", "value"],
                          place)
    for name in names:
        if name not in raw:
            raise BadInput(f"the point lacks '{name}'", place, forms)
    return {name: raw[name] for name in names}


def _spread_point(raw: dict[Any, Any], axes: list[str], place: str) -> dict[str, Any]:
    """Return one slot per axis from ``{value: [x, y], tolerance: 0.2, share: NAME}``."""
    allowed = list(SlotFile.model_fields)
    out: dict[str, dict[str, Any]] = {axis: {} for axis in axes}
    refuse_unknown("key", raw, allowed, place)
    for key, value in raw.items():
        for i, axis in enumerate(axes):
            one = value
            if isinstance(value, list):
                if len(value) != len(axes):
                    raise BadInput(f"the list has {len(value)} numbers instead of {len(axes)}",
                                   f"{place}.{key}", "Give one for each coordinate")
                one = value[i]
            elif key in ("value", "nominal"):
                raise BadInput(f"{show(value)} is not a list of {len(axes)} numbers",
                               f"{place}.{key}", "Give one number for each coordinate")
            out[axis][key] = f"{one}.{axis}" if key == "share" else one
    return out


def absent_axes(kind: LimbKind, given: Mapping[str, Any], at: Callable[[str], str]
                ) -> dict[str, str]:
    """Return the slots of universal joints that a limb does not have -> what it would take.

    A first axis is there where the file gives it, and its offset with it, by path
    (``base.axis_offset``); ``at``: a path -> its place in the file, for messages.

    Raises:
        BadInput: an offset without its axis, or a universal joint at both ends.
    """
    out: dict[str, str] = {}
    used = ""
    for spec in reversed(kind.axis_offsets):
        body = spec.name.partition(".")[0]
        named = next((n for n in (spec.name, spec.needs) if given.get(n) is not None), None)
        if named and used:
            raise BadInput(f"both {named} and {used} are given, but a limb has one universal "
                           "joint, and a ball at its other end", at(named), "Leave out `axis` and "
                           f"`axis_offset` under `{body}`, or under `{used.partition('.')[0]}`")
        if spec.needs and named and given.get(spec.needs) is None:
            raise BadInput(f"{spec.name} is given, but not the first axis of that joint", at(""),
                           f"Add `axis: [1, 0, 0]` under `{body}`, in {body} axes")
        if named:
            used = named
        elif spec.needs or used:
            out |= {n: spec.needs or spec.name for n in (spec.name, spec.needs) if n}
    return out
