"""Plain data: what JSON can hold, and how each type is read, rejected and described."""

from __future__ import annotations

import dataclasses
import json
import math
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, TypeVar

import numpy as np

from ppmcal.linalg import Array
from ppmcal.notes import Note
from ppmcal.units import LARGEST

LARGEST_WHOLE = 2 ** 53
"""Floats represent every whole number up to here."""
T = TypeVar("T")
Json = dict[str, Any]


class WrongKind(TypeError):
    """A value whose type is not that of its annotation."""

    def __init__(self, wanted: str, value: object) -> None:
        """Store what was expected."""
        self.wanted, self.place = wanted if value is not None else "something, not null", ""

    def at(self, key: str | int) -> WrongKind:
        """Return it with ``key`` put in front of its place."""
        inner = f".{self.place}" if self.place and self.place[0] != "[" else self.place
        self.place = f"[{key}]{inner}" if isinstance(key, int) else f"{key}{inner}"
        return self

    def __str__(self) -> str:
        """Return the place and what was expected."""
        return f"{self.place}: should be {self.wanted}"


@dataclass(frozen=True)
class Reader:
    """How the values of an annotation are read and described.

    ``read`` takes plain data and whether bounds apply, as they do to data from files; it raises
    :class:`WrongKind`. ``schema`` takes the definitions and may add to them. ``blank`` is used
    where a key is missing and the class has no default. ``axes``: dimensions, if an array in SI.
    """

    read: Callable[[Any, bool], Any]
    schema: Callable[[Json], Json]
    blank: Any = None
    axes: int = 0


def number_up_to(largest: float) -> Reader:
    """Return the reader of a number of at most this magnitude."""
    bounds = {"maximum": largest, "minimum": -largest} if largest < math.inf else {}

    def read(value: Any, bounded: bool) -> float:
        if type(value) is not float and (isinstance(value, bool)
                                         or not isinstance(value, int | float)):
            raise WrongKind("a number", value)
        if bounded and not abs(value) <= largest:
            raise WrongKind(f"a number, {largest:g} at most", value)
        return float(value)

    return Reader(read, lambda _: {**bounds, "type": "number"}, math.nan)


def _whole(value: Any, bounded: bool) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise WrongKind("a whole number", value)
    if bounded and abs(value) > LARGEST_WHOLE:
        raise WrongKind(f"a whole number, {LARGEST_WHOLE} at most", value)
    return value


def _is(kind: type[T], wanted: str, name: str) -> Reader:
    def read(value: Any, bounded: bool) -> T:
        if not isinstance(value, kind):
            raise WrongKind(wanted, value)
        return value

    return Reader(read, lambda _: {"type": name}, kind())


def read_at(key: str | int, reader: Reader, value: Any, bounded: bool) -> Any:
    """Return what ``reader`` reads; an error includes ``key`` in its place."""
    try:
        return reader.read(value, bounded)
    except WrongKind as error:
        raise error.at(key) from None


def or_none(one: Reader, none: float | None = None) -> Reader:
    """Return the reader of a value or null, which reads as ``none``."""
    return Reader(lambda value, bounded: none if value is None else one.read(value, bounded),
                  lambda known: {"anyOf": [one.schema(known), {"type": "null"}]}, none)


def list_of(item: Reader) -> Reader:
    """Return the reader of a list of any length."""
    def read(value: Any, bounded: bool) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple):
            raise WrongKind("a list", value)
        return tuple(read_at(n, item, v, bounded) for n, v in enumerate(value))

    return Reader(read, lambda known: {"items": item.schema(known), "type": "array"}, ())


def several(items: list[Reader]) -> Reader:
    """Return the reader of a list of fixed length, one reader per item."""
    size = len(items)

    def read(value: Any, bounded: bool) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple):
            raise WrongKind("a list", value)
        found = tuple(read_at(n, one, v, bounded)
                      for n, (one, v) in enumerate(zip(items, value, strict=False)))
        if len(value) != size:
            wrong = WrongKind("something else", value)
            raise wrong.at(len(value)) if len(value) < size else wrong
        return found

    return Reader(read, lambda known: {
        "maxItems": size, "minItems": size, "prefixItems": [i.schema(known) for i in items],
        "type": "array"}, tuple(i.blank for i in items))


def mapping_to(item: Reader) -> Reader:
    """Return the reader of an object with arbitrary keys."""
    def read(value: Any, bounded: bool) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise WrongKind("an object", value)
        return {k: read_at(k, item, v, bounded) for k, v in value.items()}

    return Reader(read, lambda known: {
        "additionalProperties": item.schema(known) or True, "type": "object"},
        types.MappingProxyType({}))


def json_text(obj: object) -> str:
    """Return JSON text: nan and inf become null, NumPy values and dataclasses plain data."""
    return json.dumps(plain(obj), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(obj: object) -> Any:
    """Return ``obj`` as plain data that JSON can hold."""
    if type(obj) is float:    # as most are
        return obj if math.isfinite(obj) else None
    if type(obj) is list or type(obj) is tuple:
        return [plain(v) for v in obj]
    if isinstance(obj, str):
        return obj if isinstance(obj, Note) else str(obj)
    if obj is None or isinstance(obj, bool | int):
        return obj
    if isinstance(obj, np.bool_):
        return bool(obj)
    if isinstance(obj, np.integer):
        return int(obj)
    if isinstance(obj, float | np.floating):
        return float(obj) if math.isfinite(obj) else None
    if isinstance(obj, np.ndarray):
        return [plain(v) for v in obj.tolist()] if obj.ndim else plain(obj.item())
    if isinstance(obj, Mapping):
        return {str(k): plain(v) for k, v in obj.items()}
    if dataclasses.is_dataclass(obj) and not isinstance(obj, type):
        return {f.name: plain(getattr(obj, f.name)) for f in dataclasses.fields(obj)}
    if isinstance(obj, Sequence | set | frozenset):
        return [plain(v) for v in obj]
    return str(obj)


PLAIN: dict[Any, Reader] = {
    float: number_up_to(math.inf), int: Reader(_whole, lambda _: {"type": "integer"}, 0),
    str: _is(str, "text", "string"), bool: _is(bool, "true or false", "boolean"),
    Any: Reader(lambda value, bounded: value, lambda _: {})}

_NUMBERS = list_of(or_none(number_up_to(LARGEST)))
Line = Annotated[Array, replace(_NUMBERS, axes=1)]
"""An array (n,): a list in a file, null for nan."""
Rows = Annotated[Array, replace(list_of(_NUMBERS), axes=2)]
"""An array (n, m): a list of rows in a file."""
