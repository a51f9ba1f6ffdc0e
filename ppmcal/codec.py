"""The codec: dataclasses to and from JSON, and their JSON Schema, from their annotations alone.

A result is one frozen dataclass, defined where it is computed. Annotations
(:class:`ppmcal.units.Quantity`) give the quantities of its numbers: :func:`in_units` converts them
from SI to the units of a file, :func:`encoded` writes them, :func:`decoded` reads them back with
file, place and hint in errors, :func:`schema` describes them.

A file may be truncated, edited by hand or written by another version: missing and unknown keys are
accepted, and so is null, which counts as missing where a field does not allow it; a value of the
wrong type is rejected with file and place. An object for a few numbers needs no class of its own:
a field's key may be a path into it, ``limit.position``. A class that does not write its fields in
their order lists its keys in ``KEYS: ClassVar``; these may include cached properties, which keep
the file's values when read.
"""

from __future__ import annotations

import dataclasses
import math
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from inspect import cleandoc
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.linalg import Array
from ppmcal.plain import (
    PLAIN,
    Json,
    Reader,
    WrongKind,
    list_of,
    mapping_to,
    number_up_to,
    or_none,
    plain,
    read_at,
    several,
)
from ppmcal.units import AtMost, Key, Quantity, Units, Unsaid

AGAIN = "Run the command that writes it again"
T = TypeVar("T")


@dataclass(frozen=True)
class Field:
    """A field of a class: its name, key in a file, reader, default, and quantity.

    ``key``: with a dot, the key of an object and the key within it; ``whole``: the object is null
    where the field is None.
    """

    name: str
    key: str
    reader: Reader
    default: Callable[[], Any]
    quantity: Quantity | None
    whole: bool = False


def shape(kind: Any) -> tuple[Field, ...]:
    """Return the fields of a dataclass by their annotations."""
    return _shape(kind)


@cache
def _shape(kind: Any) -> tuple[Field, ...]:
    hints, out = get_type_hints(kind, include_extras=True), []
    fields = {f.name: f for f in dataclasses.fields(kind)}
    for name in getattr(kind, "KEYS", fields):
        f = fields.get(name) or dataclasses.field()
        hint = hints[name] if name in fields else get_type_hints(
            getattr(kind, name).func, include_extras=True)["return"]
        reader, marks = reader_of(hint), _marks(hint)
        default = f.default_factory if f.default_factory is not dataclasses.MISSING else (
            _always(reader.blank if f.default is dataclasses.MISSING or Unsaid() in marks
                    else f.default))
        key = next((m for m in marks if isinstance(m, Key)), Key(name))
        quantity = next((m for m in marks if isinstance(m, Quantity)), None)
        out.append(Field(name, key.name, reader, default, quantity, key.whole))
    return tuple(out)


@cache
def _objects(kind: Any) -> dict[str, str]:
    """Return the keys of nested objects, each with the key whose null makes it null, or ""."""
    inner = [f for f in shape(kind) if "." in f.key]
    return {f.key.partition(".")[0]: "" for f in inner} | {
        f.key.partition(".")[0]: f.key for f in inner if f.whole}


@cache
def _unwritten(kind: Any) -> dict[str, Any]:
    """Return the values, after reading, of fields that are not written: default or None."""
    written = {f.name for f in shape(kind)}
    return {f.name: None if f.default is dataclasses.MISSING else f.default
            for f in dataclasses.fields(kind) if f.name not in written}


def _flat(objects: Mapping[str, str], data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return data with the contents of ``objects`` under ``object.key``."""
    out: Json = {} if objects else data    # type: ignore[assignment]
    for key, value in data.items() if objects else ():
        if key not in objects or value is None:
            out[objects.get(key) or key] = value
        elif isinstance(value, Mapping):
            out |= {f"{key}.{k}": v for k, v in value.items()}
        else:
            raise WrongKind("an object", value).at(key)
    return out


def _nested(objects: Mapping[str, str], flat: Json) -> Json:
    """Return data with each ``object.key`` moved into its object."""
    out: Json = {}
    for key, value in flat.items():
        name, _, inner = key.partition(".")
        if not inner or name not in objects:
            out[key] = value
        elif flat.get(objects[name], ...) is None:
            out[name] = None
        else:
            out.setdefault(name, {})[inner] = value
    return out


def _always(value: T) -> Callable[[], T]:
    return lambda: value


def _marks(hint: Any) -> tuple[Any, ...]:
    return tuple(get_args(hint)[1:]) if get_origin(hint) is Annotated else ()


def reader_of(hint: Any) -> Reader:
    """Return the reader of an annotation.

    Raises:
        TypeError: JSON cannot hold it.
    """
    if get_origin(hint) is Annotated:
        bare, marks = get_args(hint)[0], _marks(hint)
        one = next((m for m in marks if isinstance(m, Reader)), None) or next(
            (number_up_to(m.largest) for m in marks if isinstance(m, AtMost)),
            None) or reader_of(bare)
        return or_none(one, math.nan if bare is float else None) if Unsaid() in marks else one
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        (one,) = (a for a in inner if a is not type(None))
        return or_none(reader_of(one))
    if origin is tuple:
        return list_of(reader_of(inner[0])) if inner[1:] == (...,) else several(
            [reader_of(a) for a in inner])
    if origin is not None and issubclass(origin, Mapping):
        return mapping_to(reader_of(inner[1]))
    if dataclasses.is_dataclass(hint):
        return reader_of_class(hint)
    if hint not in PLAIN:
        raise TypeError(f"no JSON holds {hint}")
    return PLAIN[hint]


def reader_of_class(kind: Any) -> Reader:
    """Return the reader of a dataclass; the object records the keys given and unknown ones."""
    def read(value: Any, bounded: bool) -> Any:
        if isinstance(value, kind):
            return value
        if not isinstance(value, Mapping):
            raise WrongKind("an object", value)
        value = _flat(_objects(kind), value)
        found, unknown = {}, {k: v for k, v in value.items() if v is not None}
        for f in shape(kind):
            one = unknown.pop(f.key, None)
            if one is not None:
                found[f.name] = read_at(f.key, f.reader, one, bounded)
            elif f.key in value and plain(f.default()) is None:
                found[f.name] = f.default()
        made = object.__new__(kind)
        made.__dict__.update(_unwritten(kind), **{
            f.name: found[f.name] if f.name in found else f.default() for f in shape(kind)},
            given=frozenset(found), more=unknown)
        return made

    def refer(known: Json) -> Json:
        if kind.__name__ not in known:
            known[kind.__name__] = {}
            known[kind.__name__] = _described(kind, known)
        return {"$ref": f"#/$defs/{kind.__name__}"}

    return Reader(read, refer, None)


def _described(kind: type, known: Json) -> Json:
    properties: Json = {}
    for f in shape(kind):
        own, default = f.reader.schema(known), f.default()
        if default != default and "anyOf" not in own:    # nan is null in the file
            own = {"anyOf": [own, {"type": "null"}]}
        if f.whole and "anyOf" in own:
            own = own["anyOf"][0]
        named = "$ref" in own or "$ref" in own.get("anyOf", [{}])[0]
        name, _, inner = f.key.rpartition(".")
        title = {} if named else {"title": inner.replace("_", " ").title()}
        own |= {"default": encoded(default, whole=True), **title}
        there = properties if not name else properties.setdefault(name, {
            "additionalProperties": True, "properties": {}, "type": "object",
            "title": name.replace("_", " ").title()})["properties"]
        there[inner] = dict(sorted(own.items()))
    for name in filter(_objects(kind).get, _objects(kind)):
        properties[name] = {"anyOf": [properties[name], {"type": "null"}], "default": None}
    return {"additionalProperties": True, "description": cleandoc(kind.__doc__ or ""),
            "properties": properties, "title": kind.__name__, "type": "object"}


def schema(kind: type) -> Json:
    """Return the JSON Schema of a class."""
    known: Json = {}
    own = _described(kind, known)
    return {"$defs": dict(sorted(known.items())), **own} if known else own


def decoded(kind: type[T], data: Any, path: Path, hint: str = AGAIN) -> T:
    """Return plain data from a file as an object of a class.

    Raises:
        BadInput: a value of the wrong type.
    """
    try:
        found: T = reader_of_class(kind).read(data, True)
    except WrongKind as error:
        raise BadInput(f"should be {error.wanted}", f"{path}: {error.place}", hint) from None
    return found


def unsaid(kind: type[T]) -> T:
    """Return an object of a class as if read from a file without any of its keys."""
    found: T = reader_of_class(kind).read({}, False)
    return found


def encoded(value: Any, whole: bool = False) -> Any:
    """Return data that JSON can hold; of an object that was read only the keys given, or all."""
    if type(value) is float or type(value) is str:    # most are
        return plain(value)
    if dataclasses.is_dataclass(value):
        given = None if whole else getattr(value, "given", None)
        kind: Any = type(value)
        return _nested(_objects(kind), {
            f.key: encoded(getattr(value, f.name), whole) for f in shape(kind)
            if given is None or f.name in given} | plain(getattr(value, "more", {})))
    if isinstance(value, Mapping):
        return {str(k): encoded(v, whole) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [encoded(v, whole) for v in value]
    return plain(value)


def in_units(value: T, units: Units) -> T:
    """Convert a result from SI to the units of a file; one already read from a file is unchanged.

    The result equals what will be read back. A field that names the quantity of others
    (:attr:`Quantity.of`) then names their unit.
    """
    if isinstance(value, tuple):
        return tuple(in_units(v, units) for v in value)  # type: ignore[return-value]
    if not dataclasses.is_dataclass(value) or hasattr(value, "given"):
        return value
    kind: Any = type(value)
    there = fields_in_units(kind, {n: getattr(value, n) for f in shape(kind) for n in (
        f.name, f.quantity.of if f.quantity else "") if n}, units)
    found: T = reader_of_class(kind).read(
        {f.key: encoded(there[f.name]) for f in shape(kind)}, False)
    return found


def fields_in_units(kind: Any, there: Mapping[str, Any], units: Units) -> Json:
    """Return the fields of a class that are ``there``, converted from SI to file units."""
    changed: Json = {}
    fields = {f.name: f for f in shape(kind)}
    for f in fields.values():
        if f.name not in there:
            continue
        own, quantity = there[f.name], f.quantity
        if quantity is None:
            changed.setdefault(f.name, in_units(own, units))
            continue
        name = there[quantity.of] if quantity.of else quantity.name
        if f.reader.axes and quantity.of:
            changed[f.name] = _along(own, quantity, units.factors(name), False)
            continue
        changed[f.name] = quantity.of_file(own, name, units)
        if quantity.of in fields:
            changed[quantity.of] = units.name(name)
    return changed


def in_si(value: T, units: Units) -> T:
    """Convert a result read in file units to SI: its arrays and all fields with a quantity.

    Raises:
        ValueError: array rows differ in length, or do not match their quantities.
    """
    if isinstance(value, tuple):
        return tuple(in_si(v, units) for v in value)  # type: ignore[return-value]
    if not dataclasses.is_dataclass(value):
        return value
    kind: Any = type(value)
    there: Json = {}
    for f in shape(kind):
        own, quantity = in_si(getattr(value, f.name), units), f.quantity
        factors = units.factors(getattr(value, quantity.of)) if quantity and quantity.of else []
        if f.reader.axes:
            own = np.array(own, dtype=float) if own or f.reader.axes == 1 else np.zeros(
                (0, len(factors)))
        if quantity is not None:
            own = _along(own, quantity, factors, True) if quantity.of else (
                own * units.factor(quantity.name))
        there[f.name] = own
    found: T = kind(**there)
    return found


def _along(values: Array, quantity: Quantity, factors: list[float], back: bool) -> Array:
    """Convert an array (..., n) to file units by the factors of its last axis, or ``back``."""
    factor = np.outer(factors, factors) if quantity.square else np.array(factors)
    if not values.size and not quantity.square:
        return values
    if values.shape[-factor.ndim:] != factor.shape:
        raise ValueError("another size")
    return np.asarray(values * factor if quantity.per != back else values / factor)
