"""The codec: findings as they are computed, SI, to JSON in file units, back, and their schema."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest

import ppmcal
from ppmcal.codec import decoded, encoded, in_si, in_units, schema, unsaid
from ppmcal.errors import BadInput
from ppmcal.io.results.record import Part, Whole
from ppmcal.io.results.units import JOINT, MachineUnits
from ppmcal.plain import Line, Rows, WrongKind, json_text
from ppmcal.units import (
    COLUMN,
    AtMost,
    ByCoordinate,
    Finite,
    Key,
    Length,
    OfUnit,
    OrNull,
    Quantity,
    Units,
)

MM = Units("mm", "deg")
Own = Annotated[float, Quantity(of="unit")]


@dataclass(frozen=True)
class Bend:
    """How far a rod bends."""

    name: str
    size: Own
    turn: Annotated[float, Quantity("angle")]
    unit: str
    ends: Annotated[tuple[float | None, ...], Quantity(of="unit", digits=3)] = ()
    share: Annotated[float, AtMost(1e30), Key("part of")] = 0.0


@dataclass(frozen=True)
class Bends:
    """All rods."""

    rods: tuple[Bend, ...]
    by_name: Mapping[str, Whole | None] = field(default_factory=dict)
    corner: tuple[float, float] | None = None
    sure: bool = False


ROD = Bend("a", 0.0123, math.pi / 4.0, "length", (0.00123456, math.nan), 0.5)
FILE = {"name": "a", "size": 0.0123 / 1e-3, "turn": math.pi / 4.0 / (math.pi / 180.0),
        "unit": "mm", "ends": [1.23, None], "part of": 0.5}


def read(data: Any, kind: type = Bends) -> Any:
    return decoded(kind, data, Path("bends.json"), "Bend it again")


def test_a_finding_is_written_in_file_units_and_reads_back() -> None:
    told = in_units(Bends((ROD,), {"a": 3}, (1.0, 2.0), True), MM)
    assert encoded(told) == {"rods": [FILE], "by_name": {"a": 3}, "corner": [1.0, 2.0],
                             "sure": True}
    again = read(json.loads(json_text(encoded(told))))
    assert again == told and encoded(again) == encoded(told)
    # what is in file units stays in them
    assert in_units(told, MM) == told and in_units(told.rods[0], Units("m", "rad")) == told.rods[0]


@dataclass(frozen=True, eq=False)
class Sag:
    """How far points of rods sag, by rod and point, and what that says of lengths."""

    names: tuple[str, ...]
    sag: Annotated[Rows, Quantity(of="axes")]
    turn: Annotated[float, Quantity("angle")]
    per: Annotated[Rows, Quantity(of="axes", per=True), Key("by.each")]
    spread: Annotated[Rows, Quantity(of="axes", square=True)]
    load: Line

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple("angle" if n == "turn" else "length" for n in self.names)


SAG = Sag(("x", "turn"), np.array([[0.1, 0.2], [math.nan, 0.4]]), 0.3, np.array([[5.0, 6.0]]),
          np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([7.0, math.nan]))
DEGREE = math.pi / 180.0


def test_arrays_are_in_the_units_of_their_columns_and_read_back() -> None:
    told = encoded(in_units(SAG, MM))
    assert told == {
        "names": ["x", "turn"], "sag": [[0.1 / 1e-3, 0.2 / DEGREE], [None, 0.4 / DEGREE]],
        "turn": 0.3 / DEGREE, "by": {"each": [[5.0 * 1e-3, 6.0 * DEGREE]]},
        "spread": [[1.0 / (1e-3 * 1e-3), 2.0 / (1e-3 * DEGREE)],
                   [3.0 / (1e-3 * DEGREE), 4.0 / (DEGREE * DEGREE)]], "load": [7.0, None]}
    again = in_si(read(json.loads(json_text(told)), Sag), MM)
    assert again.names == SAG.names and again.turn == pytest.approx(SAG.turn, rel=1e-15)
    for name in ("sag", "per", "spread", "load"):
        np.testing.assert_allclose(getattr(again, name), getattr(SAG, name), rtol=1e-15)
    none = in_si(read({"names": ["x"], "spread": [[1.0]]}, Sag), MM)
    assert none.sag.shape == (0, 1) and none.load.shape == (0,)


@pytest.mark.parametrize("key, value", [
    ("sag", [[1.0, 2.0], [3.0]]), ("sag", [[1.0]]), ("by", {"each": [[1.0, 2.0, 3.0]]}),
    ("spread", [[1.0, 2.0]]), ("spread", [])])
def test_arrays_of_another_size_are_no_arrays(key: str, value: Any) -> None:
    told = encoded(in_units(SAG, MM)) | {key: value}
    with pytest.raises(ValueError):
        in_si(read(told, Sag), MM)


@pytest.mark.parametrize("value, place", [
    (3.0, "sag: should be a list"), ([3.0], "sag[0]: should be a list"),
    ([[1.0, "a"]], "sag[0][1]: should be a number")])
def test_what_is_no_array_is_refused_with_its_place(value: Any, place: str) -> None:
    with pytest.raises(BadInput) as refusal:
        read({"sag": value}, Sag)
    assert place.split(": ")[0] in str(refusal.value) and place.split(": ")[1] in str(refusal.value)


@dataclass(frozen=True)
class Span:
    """From ``low`` to ``high``; of what it was found by nothing is written."""

    KEYS: ClassVar = ("width", "high", "low")

    low: Length[float]
    high: Length[float]
    by: str
    tries: int = field(default=0, compare=False)

    @cached_property
    def width(self) -> Length[OrNull[float]]:
        return self.high - self.low


def test_what_is_written_may_be_other_than_the_fields() -> None:
    told = in_units(Span(0.001, 0.004, "hand", 3), MM)
    assert list(encoded(told).items()) == [("width", 3.0), ("high", 4.0), ("low", 1.0)]
    assert list(schema(Span)["properties"]) == ["width", "high", "low"]
    again = read({"width": 5.0, "low": 1.0}, Span)
    assert again.width == 5.0 and again.low == 1.0
    assert again.by is None and again.tries == 0 and again == read(encoded(again), Span)


def test_nan_is_null_and_null_is_nan() -> None:
    lost = in_units(replace(ROD, size=math.nan), MM)
    assert encoded(lost)["size"] is None and math.isnan(read(encoded(lost), Bend).size)


def test_what_was_not_there_is_neutral_and_is_not_written_again() -> None:
    for data in ({"rods": [{"name": "a", "later": [1]}]}, {}):
        found = read(data)
        assert encoded(found) == data
    rod = read({"rods": [{"name": "a"}]}).rods[0]
    assert (rod.unit, rod.ends, rod.share) == ("", (), 0.0) and math.isnan(rod.size)
    assert read({"rods": None, "corner": None}) == Bends((), {}, None, False)


@pytest.mark.parametrize(("data", "what"), [
    ({"rods": {}}, "rods: should be a list"),
    ({"rods": [None]}, "rods[0]: should be something, not null"),
    ({"rods": [{}, {"size": "1"}]}, "rods[1].size: should be a number"),
    ({"rods": [{"part of": -1e31}]}, "rods[0].part of: should be a number, 1e+30 at most"),
    ({"rods": [{"ends": [1, True]}]}, "rods[0].ends[1]: should be a number"),
    ({"by_name": {"b": 1.0}}, "by_name.b: should be a whole number"),
    ({"by_name": {"b": 2**60}}, f"by_name.b: should be a whole number, {2**53} at most"),
    ({"corner": [1.0]}, "corner[1]: should be something else"),
    ({"corner": [1.0, 2.0, 3.0]}, "corner: should be something else"),
    ({"sure": 1}, "sure: should be true or false"), ({"rods": [{"name": 3}]}, "should be text"),
    ({"by_name": []}, "by_name: should be an object")])
def test_a_value_of_another_kind_is_refused_with_file_place_and_hint(data: Any, what: str) -> None:
    with pytest.raises(BadInput) as refusal:
        read(data)
    assert str(refusal.value).startswith("bends.json: ") and what in str(refusal.value)
    assert "Bend it again" in str(refusal.value)


def test_the_schema_says_what_is_read() -> None:
    found = schema(Bends)
    assert set(found["properties"]) == {"rods", "by_name", "corner", "sure"}
    rod = found["$defs"]["Bend"]
    assert rod["description"] == "How far a rod bends." and set(rod["properties"]) == set(FILE)
    assert rod["properties"]["part of"]["maximum"] == 1e30
    assert {"type": "null"} in rod["properties"]["size"]["anyOf"]


class Given(Part):
    """A part with what it was given."""

    size: float | None = None
    many: tuple[int, ...] = ()
    named: Mapping[str, float] = field(default_factory=dict)


def test_a_part_makes_plain_data_of_what_it_is_given() -> None:
    part = Given(size=np.float64("nan"), many=np.arange(2), named={"a": 1})
    assert (part.size, part.many, part.named) == (None, (0, 1), {"a": 1.0})
    assert Given(many=(1,)).entries() == {"many": [1]}
    assert Given(many=(1,)).changed(size=2.0).entries() == {"size": 2.0, "many": [1]}
    with pytest.raises(WrongKind, match=r"many\[0\]: should be a whole number"):
        Given(many=("one",))


@dataclass(frozen=True)
class Turned:
    """Where a table stands, SI."""

    stretch: float
    at: Mapping[str, float]
    ends: np.ndarray
    quantity: str = "length"


class Table(Part):
    """The same in a file."""

    stretch: OfUnit[float | None] = None
    at: ByCoordinate[Mapping[str, float | None]] = field(default_factory=dict)
    ends: Length[tuple[tuple[float | None, ...], ...]] = ()
    unit: str = ""
    note: str = ""


TURNED = Turned(0.002, {"x": 0.001, "rz": math.pi}, np.array([[0.001, np.nan]]))


def test_a_part_is_filled_from_a_finding_by_quantities() -> None:
    table = Table.filled(TURNED, MM, unit=TURNED.quantity)
    assert table.entries() == {"stretch": 2.0, "at": {"x": 1.0, "rz": 180.0},
                               "ends": [[1.0, None]], "unit": "mm"}
    # what is given stands in place of the finding's; without units it stays SI
    assert Table.filled(TURNED, stretch=0.5, note="half", unit="").entries() == {
        "stretch": 0.5, "at": dict(TURNED.at), "ends": [[0.001, None]], "unit": "", "note": "half"}


def test_a_quantity_need_not_be_among_the_fields() -> None:
    class Now(Part):
        now: OfUnit[float | None] = None

    assert Now.filled(None, MM, now=math.pi, unit="angle").entries() == {"now": 180.0}


def test_a_column_and_a_joint_are_quantities_of_the_machines_file() -> None:
    units = MachineUnits.of(ppmcal.load(ppmcal.shipped("delta-rotary")))
    degree = math.pi / 180.0
    for quantity, factor, name in (
            ("length", 1e-3, "mm"), ("N/length", 1.0 / 1e-3, "N/mm"), (JOINT + "a", degree, "deg"),
            (COLUMN + "base_radius", 1e-3, "mm"), (COLUMN + "a.base.axis.rx", degree, "deg"),
            (COLUMN + "homing.a of session", degree, "deg"), (COLUMN + "scale of day", 1e-6, "ppm"),
            (COLUMN + "frame.rz of day", degree, "deg"), (COLUMN + "frame.x of day", 1e-3, "mm")):
        assert (units.factor(quantity), units.name(quantity)) == (factor, name), quantity
    assert units.words(0.0123456, "length", 3) == "12.3 mm" == MM.words(0.0123456, "length", 3)
    assert MM.words(math.nan, "angle") == "- deg"


@dataclass(frozen=True)
class Check:
    """What a file may say or not."""

    ratio: Finite
    count: OrNull[int]
    by_name: Mapping[str, OrNull[Finite]] = field(default_factory=dict)
    chance: OrNull[Finite] = 1.0


def test_what_a_file_need_not_say_is_nan_or_none_whatever_the_default() -> None:
    for found in (unsaid(Check), read({}, Check), read({"count": None, "chance": None}, Check)):
        assert math.isnan(found.ratio) and found.count is None and math.isnan(found.chance)
    found = read({"by_name": {"a": None, "b": 2}}, Check)
    assert math.isnan(found.by_name["a"]) and found.by_name["b"] == 2.0
    assert encoded(found) == {"by_name": {"a": None, "b": 2.0}}
    assert schema(Check)["properties"]["chance"]["default"] is None
    with pytest.raises(BadInput, match=r"by_name.b: should be a number, 1e\+30 at most"):
        read({"by_name": {"b": 1e31}}, Check)


@dataclass(frozen=True)
class Odd:
    """What JSON cannot hold."""

    one: complex


def test_what_json_cannot_hold_has_no_codec() -> None:
    with pytest.raises(TypeError, match="no JSON holds"):
        schema(Odd)


@dataclass(frozen=True)
class Limits:
    """Two numbers in an object that is no class of its own."""

    name: str
    reach: Annotated[Length[float], Key("limit.reach")]
    turn: Annotated[Own, Key("limit.turn")] = 0.0
    unit: Annotated[str, Key("limit.unit")] = "angle"


def test_a_key_may_be_a_path_into_an_object() -> None:
    told = in_units(Limits("a", 0.002, math.pi), MM)
    held = encoded(told)
    assert held == {"name": "a", "limit": {"reach": 2.0, "turn": pytest.approx(180.0),
                                           "unit": "deg"}}
    # unknown keys within it are kept, and what was not there is not written
    held["limit"]["later"] = [1]
    again = read(held, Limits)
    assert again.reach == 2.0 and encoded(again) == held
    assert encoded(read({"limit": {"turn": 3.0}}, Limits)) == {"limit": {"turn": 3.0}}
    assert encoded(read({"limit": None}, Limits)) == {}
    found = schema(Limits)["properties"]["limit"]
    assert found["type"] == "object" and set(found["properties"]) == {"reach", "turn", "unit"}


@pytest.mark.parametrize(("data", "place"), [
    ({"limit": 3}, "limit: should be an object"),
    ({"limit": {"reach": "far"}}, "limit.reach: should be a number")])
def test_what_is_wrong_within_an_object_is_refused_with_its_place(data: Any, place: str) -> None:
    with pytest.raises(BadInput) as refusal:
        read(data, Limits)
    assert place.partition(": ")[2] in str(refusal.value)
    assert place.partition(": ")[0] in str(refusal.value)


@dataclass(frozen=True)
class Held:
    """A rod that is held, or is not; ``force`` follows from the rest."""

    name: str
    at: Annotated[Length[float | None], Key("clamp.at", whole=True)] = None
    screws: Annotated[int, Key("clamp.screws")] = 0
    force: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        """Work the force out."""
        self.__dict__["force"] = 2.0 * self.screws


@pytest.mark.parametrize(("rod", "clamp"), [
    (Held("a", 0.1, 3), {"at": 100.0, "screws": 3}), (Held("b"), None)])
def test_an_object_is_null_where_the_field_that_stands_for_it_is_none(
        rod: Held, clamp: object) -> None:
    """What follows from the rest is written too, and read as it is there."""
    told = {"name": rod.name, "clamp": clamp, "force": 2.0 * rod.screws}
    assert encoded(in_units(rod, MM)) == told
    again = read(told | {"force": 5.0}, Held)
    assert again.force == 5.0 and encoded(again) == told | {"force": 5.0}
    described = schema(Held)["properties"]["clamp"]
    assert described["anyOf"][1] == {"type": "null"} and described["default"] is None
    assert described["anyOf"][0]["properties"]["at"]["type"] == "number"
