"""What all file models share: strict mappings, plain numbers, and errors in our own words."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeGuard, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError, core_schema

from ppmcal.errors import BadInput, refuse_unknown, unknown
from ppmcal.plain import LARGEST_WHOLE
from ppmcal.units import ANGLES, LENGTHS, Units

T = TypeVar("T", bound=BaseModel)


def refuse(what: str, hint: str = "") -> PydanticCustomError:
    """Return the error by which a validator refuses a value."""
    return PydanticCustomError("ppmcal", "{what}", {"what": what, "mend": hint})


def show(value: object) -> str:
    """Return a short text of a value for a message."""
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


LARGEST = 1e12
"""No number of a file may be larger: it would only overflow."""


def _finite(value: object) -> float:
    number = _number(value)
    if not math.isfinite(number):
        raise refuse(f"{show(value)} is not a finite number", "Write a number such as 12.5")
    if abs(number) > LARGEST:
        raise refuse(f"{show(value)} is out of range", "Write a number such as 12.5")
    return number


def is_number(value: object, most: float = LARGEST) -> TypeGuard[float]:
    """Whether a value of a file is a number from -most to most; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= most


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        hint = "Write a number such as 12.5"
        if isinstance(value, str) and "," in value:
            hint = "Write a decimal point instead of the comma"
        elif isinstance(value, dict | list):
            hint = "Write one number here, such as 12.5"
        raise refuse(f"{show(value)} is not a number", hint)
    return float(value)


def _label(value: object) -> str:
    if isinstance(value, int) and not isinstance(value, bool):
        value = str(value)
    if not isinstance(value, str) or not value.strip():
        raise refuse(f"{show(value)} is not a name", "Write a word such as leg1")
    return value.strip()


def _of_letters(marks: str, listed: str, why: str) -> BeforeValidator:
    """Return a validator of names that have letters, digits and some marks; ``why`` no others."""
    def check(value: object) -> str:
        name = _label(value)
        if not all(c.isalnum() or c in marks for c in name):
            raise refuse(f"the name {show(name)} has other characters than letters, digits, "
                         f"{listed}", f"Rename it: {why}")
        return name

    return BeforeValidator(check)


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise refuse(f"{show(value)} is neither true nor false", "Write true or false")
    return value


def numbers(accepts: Callable[[float], bool], what: str, hint: str, make: type[Any] = float,
            first: Callable[[object], object] = lambda value: value) -> Callable[[object], Any]:
    """Return a check of numbers, whole ones where ``make`` is int.

    Args:
        accepts: says of a number whether it is good.
        what: what one that it refuses is not.
        hint: what to write.
        make: what the number becomes.
        first: a check before this one.
    """
    kinds = int if make is int else int | float

    def check(value: object) -> Any:
        first(value)
        if isinstance(value, bool) or not isinstance(value, kinds) or not accepts(value):
            raise refuse(f"{show(value)} is not {what}", hint)
        return make(value)

    return check


def each(check: Callable[[object], Any]) -> Callable[[object], object]:
    """Return a check of one value, or of the values of a mapping, which stay as they are."""
    def checked(value: object) -> object:
        for one in value.values() if isinstance(value, dict) else [value]:
            check(one)
        return value

    return checked


SIGN = numbers(lambda v: v in (1, -1), "a sign", "Write 1 or -1")
SEED = numbers(lambda v: 0 <= v <= LARGEST_WHOLE, "a seed",
               f"Write a whole number from 0 to {LARGEST_WHOLE}", int)
FRACTION = numbers(lambda v: 0 <= v < 1, "a fraction", "Write a number from 0 to below 1")
CORRELATION = numbers(lambda v: -1 < v < 1, "a correlation", "Write a number between -1 and 1")
ROW_COUNT = numbers(lambda v: abs(v) <= 1_000_000, "a number of rows",
                    "Write a whole number such as 1", int)
PULSES = numbers(lambda v: 0 < v < 1e12, "a number of counts", "Write a positive number")
TENSION = numbers(lambda v: 0 < v < 1e12, "a tension", "Write N, above 0: [20, 80]")
PAYLOAD = numbers(lambda v: 0 <= v < 1e300, "a payload", "Write kg, 0 or more: [0, 20]")
_DEVIATION = (lambda v: v >= 0.0, "a standard deviation",
              "Write a number of 0 or more, or .inf for no prior")
DEVIATION = numbers(*_DEVIATION)
LIMIT = numbers(lambda v: not math.isnan(v), "a number", "Write a number, .inf or -.inf")
Number = Annotated[float, BeforeValidator(_finite)]
Sigma = Annotated[float, BeforeValidator(numbers(*_DEVIATION, first=_number))]
Positive = Annotated[float, BeforeValidator(numbers(
    lambda v: v > 0.0, "greater than 0", "Write a positive number", first=_finite))]
Count = Annotated[int, BeforeValidator(numbers(
    lambda v: 1 <= v <= 10_000_000, "a count", "Write a whole number from 1 to 10 million", int))]
Label = Annotated[str, BeforeValidator(_label)]
Word = Annotated[str, _of_letters(
    "_-", "_ and -", "names become column headers and parameter paths")]
Path = Annotated[str, _of_letters("_-.", "_, - and .", "shared names become parameter names")]
Flag = Annotated[bool, BeforeValidator(_flag)]


def vector(*sizes: int, of: Callable[[object], float] = _finite) -> BeforeValidator:
    """Return a validator for a list of numbers with one of the given lengths."""
    wanted = " or ".join(str(s) for s in sizes)

    def check(value: object) -> list[float]:
        if not isinstance(value, list | tuple) or len(value) not in sizes:
            found = f"has {len(value)}" if isinstance(value, list) else f"is {show(value)}"
            raise refuse(f"a list of {wanted} numbers is needed here, this {found}",
                         f"Write {show([0] * sizes[0])} with your numbers")
        return [of(v) for v in value]

    return BeforeValidator(check)


def _one_of(what: str, name: object, allowed: Collection[object]) -> None:
    """Refuse a name that is not allowed, with the nearest match."""
    try:
        refuse_unknown(what, [name], allowed)
    except BadInput as error:
        raise refuse(error.what, error.hint) from None


def _refuse_comma(key: object, data: Mapping[Any, Any], names: Collection[str]) -> None:
    """Refuse ``{angle: 0,02}``, which YAML takes for an angle of 0 and a key 02."""
    before = [*data][:[*data].index(key)]
    if str(key).isdigit() and data[key] is None and before and before[-1] in names and isinstance(
            data[before[-1]], int):
        raise refuse(f"the number of '{before[-1]}' seems to have a decimal comma",
                     "Write a point, such as 0.02 for 0,02: a comma ends an entry here")


@dataclass(frozen=True)
class Registered:
    """The name of a registered kind, which becomes that kind; an ``enum`` in the JSON Schema."""

    what: str
    kinds: Callable[[], Mapping[str, Any]]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler
                                     ) -> core_schema.CoreSchema:
        """Return the schema of a text that becomes the kind."""
        return core_schema.no_info_after_validator_function(
            self.find, core_schema.str_schema(),
            serialization=core_schema.to_string_ser_schema())

    def __get_pydantic_json_schema__(self, schema: core_schema.CoreSchema,
                                     handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the JSON Schema of a text with the names."""
        return {**handler(schema), "enum": list(self.kinds())}

    def find(self, name: str) -> Any:
        """Return the kind, or refuse the name."""
        kinds = self.kinds()
        for own, kind in kinds.items():
            if name in getattr(kind, "also_called", ()):
                raise refuse(f"unknown {self.what} '{name}'", f"Write '{own}' for it")
        _one_of(self.what, name, [*kinds])
        return kinds[name]


def choice(what: str, *allowed: str) -> Registered:
    """Return a validator for one word out of a few."""
    return Registered(what, lambda: {word: word for word in allowed})


def did_you_mean(name: object, allowed: Iterable[object]) -> str:
    """Return `` Did you mean 'x'?`` for the nearest of ``allowed``, empty if none is near."""
    near = unknown("", name, allowed).hint.rpartition(" Did you mean")
    return f" Did you mean{near[2]}" if near[1] else ""


class Strict(BaseModel):
    """A mapping of a file: unknown and missing keys are refused by name."""

    model_config = ConfigDict(extra="forbid", strict=False, frozen=True,
                              arbitrary_types_allowed=True, use_attribute_docstrings=True,
                              defer_build=True)
    examples: ClassVar[Mapping[str, str]] = {}

    @model_validator(mode="before")
    @classmethod
    def _keys(cls, data: Any) -> Any:
        if isinstance(data, cls):
            return data
        names = [*cls.model_fields]
        if not isinstance(data, dict):
            raise refuse(f"{show(data)} is not a mapping",
                         f"Write keys with values here: {', '.join(names)}")
        for key in data if cls.model_config.get("extra") != "allow" else ():
            _refuse_comma(key, data, names)
            _one_of("key", key, names)
        for name, field in cls.model_fields.items():
            if field.is_required() and name not in data:
                example = cls.examples.get(name, f"{name}: ...")
                raise refuse(f"the key '{name}' is missing", f"Add a line such as `{example}`")
        return data


def times(given: T, factor: float) -> T:
    """Return an entry with its value, nominal value, tolerance and sigma in another unit."""
    return given.model_copy(update={
        name: value * factor for name in ("value", "nominal", "tolerance", "sigma")
        if (value := getattr(given, name)) is not None})


class UnitsFile(Strict):
    """``units: {length: mm, angle: deg}``."""

    examples: ClassVar[Mapping[str, str]] = {"length": "length: mm", "angle": "angle: deg"}
    length: Annotated[str, choice("length unit", *LENGTHS)]
    """Unit of every length in the file."""
    angle: Annotated[str, choice("angle unit", *ANGLES)]
    """Unit of every angle in the file."""

    def units(self) -> Units:
        """Return the checked units."""
        return Units(self.length, self.angle)


def check(model: type[T], data: object, source: str,
          place: Callable[[Sequence[int | str]], str] | None = None, prefix: str = "") -> T:
    """Return plain data from YAML as ``model``.

    ``place`` turns a pydantic location into words  [default: joined with dots]; ``prefix`` is the
    place of ``data`` itself within the file.

    Raises:
        BadInput: the first problem, with the number of further ones.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise translate(error, source, place, prefix) from None


def dotted(location: Sequence[int | str]) -> str:
    """Return ``a.b[2]`` for ("a", "b", 2)."""
    out = ""
    for part in location:
        out += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if out else str(part)
    return out


def translate(error: ValidationError, source: str,
              place: Callable[[Sequence[int | str]], str] | None = None,
              prefix: str = "") -> BadInput:
    """Return a pydantic error in our own words: file, place, problem, hint."""
    problems = error.errors()
    first = problems[0]
    where = (place or dotted)(first["loc"])
    where = ".".join(p for p in (prefix, where) if p)
    context = first.get("ctx", {})
    if first["type"] == "ppmcal":
        what, hint = str(context["what"]), str(context["mend"])
    else:
        what = f"{show(first.get('input'))} cannot be used here ({first['msg']})"
        hint = "Change the value there"
    if len(problems) > 1:
        hint = f"{hint.rstrip('.')} (+{len(problems) - 1} more)"
    return BadInput(what, f"{source}: {where}" if where else source, hint)
