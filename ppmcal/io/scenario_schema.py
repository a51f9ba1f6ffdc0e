"""The models of the scenario file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, model_validator

from ppmcal.io.schema import (
    CORRELATION,
    FRACTION,
    PAYLOAD,
    SEED,
    TENSION,
    Count,
    Label,
    Number,
    Positive,
    Registered,
    Sigma,
    Strict,
    UnitsFile,
    choice,
    each,
    numbers,
    refuse,
)
from ppmcal.io.sidecar import ONE_OR_SEVERAL, Sigmas, targets_given
from ppmcal.model.instruments import InstrumentKind, instruments

FORMAT = "ppmcal/scenario/1"
_CENTER = {"center": "center: {x: 0, y: 0, rz: 0}", "count": "count: 30",
           "half_range": "half_range: {x: 50, y: 50}", "radius": "radius: 80",
           "counts": "counts: {x: 5, y: 5}", "diameter": "diameter: 100", "pitch": "pitch: 20",
           "turns": "turns: 3"}


class _Around(Strict):
    """Poses about one."""

    examples: ClassVar[Mapping[str, str]] = _CENTER
    center: Any
    """Pose of the centre."""


class _InABox(_Around):
    """Poses about one, as far as half of a range away."""

    half_range: Any
    """Half of the range of each coordinate."""


class CircleFile(_Around):
    """``circle: {center, radius, count, swing}``."""

    radius: Positive
    """Radius in x, y."""
    count: Count
    """Poses."""
    swing: Any = None
    """Amplitude of the other coordinates along the circle."""


class GridFile(_InABox):
    """``grid: {center, half_range, counts}``."""

    counts: dict[Label, Count]
    """Levels of each coordinate."""


class RandomFile(_InABox):
    """``random: {center, half_range, count}``."""

    count: Count
    """Poses."""


class HelixFile(_Around):
    """``helix: {center, diameter, pitch, turns, count}``."""

    center: Any
    """Pose of the first turn's centre."""
    diameter: Positive
    """Diameter in x, y."""
    pitch: Number
    """Rise in z per turn."""
    turns: Positive
    """Turns."""
    count: Count
    """Poses."""


class PosesFile(Strict):
    """Exactly one of circle, grid, random, helix and file."""

    circle: CircleFile | None = None
    """Poses on a circle."""
    grid: GridFile | None = None
    """Poses of a grid."""
    random: RandomFile | None = None
    """Poses drawn evenly in a box."""
    helix: HelixFile | None = None
    """Poses on a helix."""
    file: Label | None = None
    """CSV of poses, relative to this file."""

    @model_validator(mode="after")
    def _one(self) -> PosesFile:
        given = [n for n in type(self).model_fields if getattr(self, n) is not None]
        if len(given) != 1:
            raise refuse(f"poses needs one of circle, grid, random, helix and file, this has "
                         f"{' and '.join(given) or 'none'}", "Keep exactly one of them")
        return self


_noise = each(numbers(
    lambda v: 0 <= v < 1e300, "a standard deviation",
    "Write a number of 0 or more, or one for each actuator: {leg1: 0.003}"))


class ScenarioSigmaFile(Sigmas[Sigma]):
    """Standard deviations to simulate; 0 is allowed."""

    value: Sigma | None = None
    """Of what an encoder at a joint reads (kind joint)."""
    actuator: Annotated[Any, BeforeValidator(_noise)] = 0.0
    """Of the joint values: one number, or one by actuator."""


class ScenarioInstrumentFile(Strict):
    """The instrument to simulate."""

    examples: ClassVar[Mapping[str, str]] = {"kind": "kind: pose",
                                             "sigma": "sigma: {position: 0.005, rotation: 0.001}"}
    kind: Annotated[InstrumentKind, Registered("instrument kind", instruments)]
    """What is measured."""
    sigma: ScenarioSigmaFile
    """Standard deviations of the noise."""
    point: Any = None
    """The fixed point that distances are measured from."""
    between: Annotated[str, choice("kind of distance", "point", "positions")] = "point"
    """Whether distances are from a point or between two platform positions."""
    at: Label | None = None
    """The joint that an encoder is at, such as `leg1.joint2` (kind joint)."""
    offset: Any = "known"
    """What an encoder at a joint reads more than is true, or `known`: nothing more."""
    station: Any = None
    """Where a tracker of `range` and `angle` stands, in the measured axes  [default: origin]."""


class NoiseFile(Strict):
    """How the noise is correlated and distributed."""

    ar: Annotated[float, BeforeValidator(CORRELATION)] = 0.0
    """Correlation of the noise from row to row, above -1 and below 1."""
    outliers: Annotated[float, BeforeValidator(FRACTION)] = 0.0
    """Part of the rows that are gross errors."""
    tails: Annotated[str, choice("kind of tails", "normal", "t4")] = "normal"
    """normal, or t4: Student's t of 4 degrees of freedom."""


class TemperatureFile(Strict):
    """``temperature: {mean: 20, swing: 4}`` in degrees Celsius; a number is a mean."""

    mean: Number = 20.0
    """Mean, degrees Celsius."""
    swing: Number = 0.0
    """Amplitude about the mean, degrees."""


def _listed(check: Callable[[object], Any]) -> BeforeValidator:
    """Return the check of a list of values, or of one."""
    return BeforeValidator(lambda value: [
        check(v) for v in (value if isinstance(value, list) else [value])])


class ConditionsFile(Strict):
    """Loads to go through, the temperature's course, and joint speeds at the trigger."""

    payload: Annotated[list[float], _listed(PAYLOAD)] = Field(default_factory=list)
    """Payloads to go through, kg."""
    tension: Annotated[list[float], _listed(TENSION)] = Field(default_factory=list)
    """Mean tensions to go through with which ropes are pulled tight without a load, N."""
    temperature: Annotated[TemperatureFile, BeforeValidator(
        lambda v: {"mean": v} if isinstance(v, int | float) else v)] | None = None
    """Course of the temperature, or its mean."""
    velocity: Annotated[Any, BeforeValidator(_noise)] = 0.0
    """Speed of the joints at the trigger: one number, or one by actuator."""


class ScenarioFile(Strict):
    """The top of a scenario file."""

    examples: ClassVar[Mapping[str, str]] = {
        "format": f"format: {FORMAT}",
        "units": "units: {length: mm, angle: deg}",
        "poses": "poses: {circle: {center: {x: 0, y: 0, rz: 0}, radius: 80, count: 30}}",
        "instrument": "instrument: {kind: pose, sigma: {position: 0.005, rotation: 0.001}}",
    }
    format: Annotated[str, choice("format", FORMAT)]
    """What this file is."""
    units: UnitsFile
    """Units of every number in this file."""
    poses: PosesFile
    """Where to measure."""
    instrument: ScenarioInstrumentFile
    """What measures."""
    name: Label | None = None
    """Name of the scenario."""
    errors: Any = None
    """Injected errors: by parameter name, or {random: {scale: 1}} (tolerances)."""
    effects: Any = None
    """What acts beyond geometry."""
    frame: Any = "known"
    """Pose of the base in the measuring frame, or `known`: the same."""
    target: Any = "known"
    """The measured point in platform axes, or `known`: the origin."""
    targets: Annotated[dict[str, Any] | None, BeforeValidator(targets_given)] = None
    """In place of `target`, several points of the platform: name -> a point, or `known`."""
    target_rotation: Any = "known"
    """Rotation vector of the measured body, or `known`: none."""
    noise: NoiseFile = NoiseFile()
    """Correlation, gross errors and tails of the noise."""
    repeats: Count = 1
    """Measurements at each pose."""
    approach: Annotated[str, choice("approach", "both", "sequence", "one")] = "one"
    """Directions from which poses are approached."""
    conditions: ConditionsFile = ConditionsFile()
    """Payloads, temperature and speed."""
    seed: Annotated[int, BeforeValidator(SEED)] = 0
    """Seed of everything drawn at random."""

    @model_validator(mode="after")
    def _either(self) -> ScenarioFile:
        if self.targets is not None and "target" in self.model_fields_set:
            raise refuse(*ONE_OR_SEVERAL)
        return self
