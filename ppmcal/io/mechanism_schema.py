"""The models of the mechanism file, as far as they do not depend on the limb kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BeforeValidator, Field, TypeAdapter, ValidationError

from ppmcal.io.schema import (
    LARGEST,
    LIMIT,
    Flag,
    Label,
    Number,
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
