"""The models of the scenario file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, model_validator

from ppmcal.io.schema import (
    Count,
    Label,
    Number,
    Positive,
    Spread,
    Strict,
    UnitsFile,
    choice,
    refuse,
    show,
)
from ppmcal.model.dataset import KINDS

FORMAT = "ppmcal/scenario/1"
_CENTER = {"center": "center: {x: 0, y: 0, rz: 0}", "count": "count: 30",
           "half_range": "half_range: {x: 50, y: 50}", "radius": "radius: 80",
           "counts": "counts: {x: 5, y: 5}", "diameter": "diameter: 100", "pitch": "pitch: 20",
           "turns": "turns: 3"}


class CircleFile(Strict):
    """``circle: {center, radius, count, swing}``."""

    examples: ClassVar[Mapping[str, str]] = _CENTER
    center: Any
    radius: Positive
    count: Count
    swing: Any = None


class GridFile(Strict):
    """``grid: {center, half_range, counts}``."""

    examples: ClassVar[Mapping[str, str]] = _CENTER
    center: Any
    half_range: Any
    counts: dict[Label, Count]


class RandomFile(Strict):
    """``random: {center, half_range, count}``."""

    examples: ClassVar[Mapping[str, str]] = _CENTER
    center: Any
    half_range: Any
    count: Count


class HelixFile(Strict):
    """``helix: {center, diameter, pitch, turns, count}``."""

    examples: ClassVar[Mapping[str, str]] = _CENTER
    center: Any
    diameter: Positive
    pitch: Number
    turns: Positive
    count: Count


class PosesFile(Strict):
    """Exactly one of circle, grid, random, helix and file."""

    circle: CircleFile | None = None
    grid: GridFile | None = None
    random: RandomFile | None = None
    helix: HelixFile | None = None
    file: Label | None = None

    @model_validator(mode="after")
    def _one(self) -> PosesFile:
        given = [n for n in type(self).model_fields if getattr(self, n) is not None]
        if len(given) != 1:
            raise refuse(f"poses needs one of circle, grid, random, helix and file, this has "
                         f"{' and '.join(given) or 'none'}", "Keep exactly one of them")
        return self


def _noise(value: object) -> object:
    values = value.values() if isinstance(value, dict) else [value]
    for one in values:
        if isinstance(one, bool) or not isinstance(one, int | float) or not 0 <= one < 1e300:
            raise refuse(f"{show(one)} is not a standard deviation",
                         "Write a number of 0 or more, or one for each actuator: {leg1: 0.003}")
    return value


class ScenarioSigmaFile(Strict):
    """Standard deviations to simulate; 0 is allowed."""

    position: Spread | None = None
    rotation: Spread | None = None
    height: Spread | None = None
    distance: Spread | None = None
    actuator: Annotated[Any, BeforeValidator(_noise)] = 0.0


class ScenarioInstrumentFile(Strict):
    """The instrument to simulate."""

    examples: ClassVar[Mapping[str, str]] = {"kind": "kind: pose",
                                             "sigma": "sigma: {position: 0.005, rotation: 0.001}"}
    kind: Annotated[str, choice("instrument kind", *KINDS)]
    sigma: ScenarioSigmaFile
    point: Any = None
    between: Annotated[str, choice("kind of distance", "point", "positions")] = "point"


def _fraction(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1:
        raise refuse(f"{show(value)} is not a fraction", "Write a number from 0 to below 1")
    return float(value)


def _correlation(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1 < value < 1:
        raise refuse(f"{show(value)} is not a correlation", "Write a number between -1 and 1")
    return float(value)


class NoiseFile(Strict):
    """How the noise is correlated and distributed."""

    ar: Annotated[float, BeforeValidator(_correlation)] = 0.0
    outliers: Annotated[float, BeforeValidator(_fraction)] = 0.0
    tails: Annotated[str, choice("kind of tails", "normal", "t4")] = "normal"


class TemperatureFile(Strict):
    """``temperature: {mean: 20, swing: 4}`` in degrees Celsius; a number is a mean."""

    mean: Number = 20.0
    swing: Number = 0.0


def _loads(value: object) -> object:
    values = value if isinstance(value, list) else [value]
    for one in values:
        if isinstance(one, bool) or not isinstance(one, int | float) or not 0 <= one < 1e300:
            raise refuse(f"{show(one)} is not a payload", "Write kg, 0 or more: [0, 20]")
    return values


class ConditionsFile(Strict):
    """Loads to go through, the temperature's course, and joint speeds at the trigger."""

    payload: Annotated[list[float], BeforeValidator(_loads)] = Field(default_factory=list)
    temperature: Annotated[TemperatureFile, BeforeValidator(
        lambda v: {"mean": v} if isinstance(v, int | float) else v)] | None = None
    velocity: Annotated[Any, BeforeValidator(_noise)] = 0.0


def _seed(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise refuse(f"{show(value)} is not a seed", "Write a whole number of 0 or more")
    return value


class ScenarioFile(Strict):
    """The top of a scenario file."""

    examples: ClassVar[Mapping[str, str]] = {
        "format": f"format: {FORMAT}",
        "units": "units: {length: mm, angle: deg}",
        "poses": "poses: {circle: {center: {x: 0, y: 0, rz: 0}, radius: 80, count: 30}}",
        "instrument": "instrument: {kind: pose, sigma: {position: 0.005, rotation: 0.001}}",
    }
    format: Annotated[str, choice("format", FORMAT)]
    units: UnitsFile
    poses: PosesFile
    instrument: ScenarioInstrumentFile
    name: Label | None = None
    errors: Any = None
    effects: Any = None
    frame: Any = "known"
    target: Any = "known"
    target_rotation: Any = "known"
    noise: NoiseFile = NoiseFile()
    repeats: Count = 1
    approach: Annotated[str, choice("approach", "both", "sequence", "one")] = "one"
    conditions: ConditionsFile = ConditionsFile()
    seed: Annotated[int, BeforeValidator(_seed)] = 0
