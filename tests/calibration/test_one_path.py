"""`check` says of a file what `identify` and `diagnose` say, and blames the machine last."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

import ppmcal
from ppmcal import check, identify
from ppmcal.calibration.interpretation.interpretation_error import InterpretationError
from ppmcal.commands.inputs import load, shipped
from ppmcal.kinematics.pose_readings import written
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.mechanism import Mechanism

ERRORS = {
    "3-RPR": {"leg1.base.point.x": 0.4, "leg2.offset": -0.3},
    "6-UPS": {"leg1.offset": 0.3, "leg2.base.point.z": -0.3, "leg4.platform.point.radius": 0.2},
    "delta-linear": {"a.offset": 0.2}}


def measured(kind: str, **other: Any) -> tuple[Mechanism, Dataset]:
    text = yaml.safe_load(shipped(kind, True).read_text(encoding="utf-8"))
    machine = load(shipped(kind))
    scenario = {**copy.deepcopy(text), "errors": ERRORS[kind], **other}
    return machine, ppmcal.simulate(machine, scenario).data[0]


def hexapod(turn: float = 2.0, **other: Any) -> tuple[Mechanism, Dataset]:
    center = {"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0}
    half = {"x": 250, "y": 250, "z": 200, "rx": turn, "ry": turn, "rz": turn}
    return measured("6-UPS", poses={"random": {
        "center": center, "half_range": half, "count": 60}}, **other)


def in_the_base(data: Dataset) -> Dataset:
    return replace(data, frame=Unknown(False, np.zeros(6)))


def at_the_origin(data: Dataset) -> Dataset:
    return replace(data, target=Unknown(False, np.zeros(3)))


def as_euler(data: Dataset) -> Dataset:
    return replace(data, rotation=written(data.rotation, "euler-xyz"))


def a_row_late(data: Dataset) -> Dataset:
    late = np.arange(len(data) - 1)
    return replace(data.take(late + 1), position=data.position[late],
                   rotation=data.rotation[late], whole=None, place=None)


def said(machine: Mechanism, *data: Dataset) -> list[list[tuple[str, str]]]:
    """Return source and kind of each mistake, as check and as identify tell them."""
    with pytest.raises(InterpretationError) as refused:
        identify(machine, list(data))
    return [[(m.source, x.kind) for m in found for x in m.mistakes]
            for found in (check(machine, list(data)).misreadings, refused.value.found)]


@pytest.mark.parametrize(("kind", "change", "name", "mend"), [
    ("3-RPR", in_the_base, "frame", "frame: unknown"),
    ("delta-linear", in_the_base, "frame", "frame: unknown"),
    pytest.param("3-RPR", at_the_origin, "target", "target: unknown", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_what_the_sidecar_says_of_where_it_was_measured_is_doubted(
        kind: str, change: Callable[[Dataset], Dataset], name: str, mend: str) -> None:
    machine, data = measured(kind)
    data = change(data)
    with pytest.raises(InterpretationError) as refused:
        identify(machine, data)
    found = check(machine, data)
    for some in (found.misreadings, refused.value.found):
        assert [x.kind for m in some for x in m.mistakes] == [name]
    assert mend in " ".join(found.findings) and mend in refused.value.hint


@pytest.mark.long
@pytest.mark.parametrize(("change", "kind"), [(as_euler, "rotation"), (in_the_base, "frame")])
def test_a_mistake_that_tolerances_hide_is_no_other_machine(
        change: Callable[[Dataset], Dataset], kind: str) -> None:
    machine, data = hexapod()
    data = change(data)
    assert said(machine, data) == [[(data.source, kind)]] * 2


@pytest.mark.long
def test_a_row_late_on_a_dense_path_is_no_other_machine() -> None:
    center = {"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0}
    machine, data = measured("6-UPS", poses={"circle": {
        "center": center, "radius": 200, "count": 300, "swing": {"rx": 2, "ry": 2, "rz": 2}}})
    data = a_row_late(data)
    assert said(machine, data) == [[(data.source, "shifted")]] * 2


@pytest.mark.long
def test_who_mistakes_one_file_mistakes_the_next() -> None:
    machine, first = hexapod()
    second = replace(hexapod(seed=99)[1], name="second", source="second.csv")
    found = check(machine, [as_euler(first), as_euler(second)]).misreadings
    assert [(m.source, m.mistakes[0].kind) for m in found] == [
        (first.source, "rotation"), ("second.csv", "rotation")]


def test_what_is_read_rightly_is_not_doubted() -> None:
    assert not check(*measured("3-RPR")).misreadings
