"""One mark of several whose columns are not what the file says: named, with lines that mend it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import Floats, listed, long, machine, measured, sidecar, wide
from helpers.campaigns_in_files import refusal

import ppmcal as package
from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation import InterpretationError
from ppmcal.calibration.interpretation.interpretation_error import block_text

pytestmark = pytest.mark.slow
Change = Callable[[Floats], Floats]


SPELT = "{axis} {name}"


def exchanged(at: Floats) -> Floats:
    return at[:, ::-1]


def in_cm(at: Floats) -> Floats:
    return at / 10.0


def turned_about(at: Floats) -> Floats:
    return -at


def mirrored(at: Floats) -> Floats:
    return at * [-1.0, 1.0]


def as_read(path: Path) -> InterpretationError | None:
    """Return the refusal of a campaign, before a fit or after it; None: it is taken."""
    machine = package.load(path.parent / "bench.yaml")
    return refusal(Problem(machine, tuple(package.read_data(machine, path)), machine.free))


@pytest.mark.long_cases("names2-change2-words2-block2")
@pytest.mark.parametrize(("names", "change", "words", "block"), [
    (("T1", "T2"), {"T2": exchanged}, ["target T2: x and y are exchanged"], {
        "columns": {"T2_x": "y T2", "T2_y": "x T2"}}),
    (("T1", "T2", "T3"), {"T1": in_cm}, ["target T1: x and y are in cm, not mm"], {
        "units": {"T1_x": "cm", "T1_y": "cm"}}),
    (("T1", "T2", "T3"), {"T2": turned_about}, ["target T2: x and y have the other sign"], {
        "signs": {"T2_x": -1, "T2_y": -1}}),
    (("T1", "T2"), {"T2": mirrored}, ["target T2: left-handed"], {"signs": {"T2_x": -1}}),
    (("T1", "T2", "T3"), {"T1": exchanged, "T2": in_cm},
     ["target T1: x and y are exchanged", "target T2: x and y are in cm"],
     {"columns": {"T1_x": "y T1", "T1_y": "x T1"}, "units": {"T2_x": "cm", "T2_y": "cm"}})])
def test_one_mark_is_named_with_lines_for_it_alone(
        tmp_path: Path, names: tuple[str, ...], change: Mapping[str, Change], words: list[str],
        block: Mapping[str, Mapping[str, object]]) -> None:
    machine(tmp_path)
    seen = measured(4, names=names)
    right = package.read_data(tmp_path / "bench.yaml", wide(tmp_path, seen, spelt=SPELT))
    wrong = replace(seen, marks={n: change[n](at) if n in change else at
                                 for n, at in seen.marks.items()})
    found = as_read(wide(tmp_path, wrong, spelt=SPELT))
    assert found is not None
    assert [w for w in words if w not in found.what] == []
    assert "or the mechanism file" not in found.what
    told = found.found[0].block
    assert told is not None
    assert {k: told[k] for k in block} == block
    # the lines make of the file what was measured
    file = wide(tmp_path, wrong, spelt=SPELT, more=f"read: {block_text(told)}")
    for one, other in zip(package.read_data(tmp_path / "bench.yaml", file), right, strict=True):
        assert one.position == pytest.approx(other.position, abs=1e-12, nan_ok=True)


@pytest.mark.long
def test_of_two_marks_that_are_turned_against_each_other_either_may_be_wrong(tmp_path: Path
                                                                             ) -> None:
    machine(tmp_path)
    seen = measured(4, names=("T1", "T2"))
    told = []
    for name in seen.marks:
        found = as_read(wide(tmp_path, replace(seen, marks={
            n: turned_about(at) if n == name else at for n, at in seen.marks.items()})))
        assert found is not None
        told.append(found.what)
    assert all("(or the other one in its place): x and y have the other sign" in t for t in told)


@pytest.mark.long
def test_all_marks_alike_are_no_mark_s_mistake(tmp_path: Path) -> None:
    machine(tmp_path)
    seen = measured(4)
    found = as_read(wide(tmp_path, replace(seen, marks={
        n: in_cm(at) for n, at in seen.marks.items()})))
    assert found is not None
    assert found.what.startswith("x and y are in cm, not mm")
    # the sidecar has no say where the header has the unit
    assert not found.found[0].block
    assert found.found[0].headers == {f"T{i}{c} [mm]": f"T{i}{c} [cm]" for i in (1, 2, 3)
                                      for c in "xy"}


@pytest.mark.long
def test_a_mark_in_a_long_file_needs_a_file_of_its_own(tmp_path: Path) -> None:
    machine(tmp_path)
    seen = measured(4)
    path = long(tmp_path, replace(seen, marks={
        n: exchanged(at) if n == "T3" else at for n, at in seen.marks.items()}))
    found = as_read(path)
    assert found is not None
    assert found.what.startswith("target T3: x and y are exchanged (`read: {columns: {x: y, y: x}}")
    assert "file of their own" in found.hint
    assert found.found[0].mistakes[0].rows == tuple(range(3, 121, 3))


@pytest.mark.parametrize("make", [wide, long])
def test_marks_that_are_read_rightly_are_left_alone(tmp_path: Path, make: Callable[..., Path]
                                                    ) -> None:
    machine(tmp_path)
    assert as_read(make(tmp_path, measured(4))) is None


def test_the_sidecar_s_other_lines_stay(tmp_path: Path) -> None:
    """The block that is told is written in the place of the old one."""
    machine(tmp_path)
    seen = measured(4, names=("T1", "T2"))
    path = wide(tmp_path, replace(seen, marks={"T1": seen.marks["T1"] / 1e3,
                                               "T2": exchanged(seen.marks["T2"])}),
                spelt="{name}_{axis}")
    path.with_suffix(".yaml").write_text(sidecar(
        "body", listed(["T1", "T2"]), more="read: {units: {T1_x: m, T1_y: m}}"))
    found = as_read(path)
    assert found is not None
    assert found.found[0].block == {"units": {"T1_x": "m", "T1_y": "m"},
                                    "columns": {"T2_x": "T2_y", "T2_y": "T2_x"}}
    assert np.all(seen.poses[:, :2] > 0.0)    # that signs of the marks mean something


def test_a_stated_mark_is_opened_among_the_targets(tmp_path: Path) -> None:
    machine(tmp_path)
    path = wide(tmp_path, measured(3))
    beside = path.with_suffix(".yaml")
    stated = "T1: [40, -15], T2: [-65, 30], T3: {}".format
    beside.write_text(beside.read_text().replace(listed(["T1", "T2", "T3"]), (
        f"targets: {{{stated('[60, 30]')}}}")))
    error = as_read(path)
    assert error is not None and "target T3: the measured point is not where" in error.what
    assert error.hint == "Write into the sidecar, among its `targets`: `T3: unknown`"
    beside.write_text(beside.read_text().replace(stated("[60, 30]"), stated("unknown")))
    assert as_read(path) is None


def test_rows_in_cm_are_told_with_the_columns_of_all_marks(tmp_path: Path) -> None:
    machine(tmp_path)
    seen = measured(3)
    for at in seen.marks.values():
        at[14:] /= 10.0
    error = as_read(wide(tmp_path, seen))
    assert error is not None and "rows 15 to 40: x and y are in cm, not mm" in error.what
    assert error.what.count("rows 15 to 40") == 1
    assert all(f"{name} [cm]" in error.what for name in ("T1x", "T1y", "T2x", "T3y"))
