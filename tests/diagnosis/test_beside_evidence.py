"""What is told beside the causes themselves, and what becomes of what cannot be had."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from wild_diagnosis import write

from ppmcal.calibration.fit import LEFT_OUT, Fit, Problem
from ppmcal.diagnosis import naming, other_models
from ppmcal.diagnosis.diagnose import diagnose
from ppmcal.diagnosis.explanation import CausePlace, Round
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.options import DiagnosisOptions
from ppmcal.diagnosis.question import ROW_FAMILY, WrongRows
from ppmcal.errors import NoResult
from ppmcal.inference.blocks import Block
from ppmcal.inference.sets import Member
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.notes import topic_of

KINDS = DiagnosisOptions(kinds=("gain", "backlash"))


@pytest.fixture(scope="module")
def geared(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    """A drive that moves too far, by as much as is named."""
    folder: Path = tmp_path_factory.mktemp("gain")
    write("gain-one", "3-RPR", 60, 5, folder, 2.0)
    mechanism = read_mechanism(folder / "mechanism.yaml")
    return Problem(mechanism, read_campaign([folder / "data.csv"], mechanism), mechanism.free)


def none(*_: object, **__: object) -> Fit:
    raise NoResult("these rows fit nothing")


@pytest.mark.slow
def test_too_few_rows_to_hold_some_out_are_a_note(geared: Problem,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(naming, "training_part", none)
    found = diagnose(geared, KINDS)
    assert [e.kind for e in found.effects] == ["gain"] and found.gap is None
    assert any(topic_of(f) == LEFT_OUT and "these rows fit nothing" in f for f in found.findings)


@pytest.mark.long
def test_what_does_not_predict_loses_its_name_and_says_so(geared: Problem,
                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(naming, "predictions", lambda _: (SimpleNamespace(surely_worse=True),))
    found = diagnose(geared, KINDS)
    assert found.verdict == "unnamed" and not found.effects
    assert found.found.after is found.found.before and not found.found.added
    assert any("surely predicted worse" in f and "gain on" in f for f in found.findings)


def test_rows_that_do_not_belong_are_those_of_the_file_whatever_a_system_has_lost() -> None:
    """Each by its data set and its number there: the second row of a system is another's third."""
    blocks = tuple(Block(f"row {n}", ROW_FAMILY, (n,), 0.0) for n in range(3))
    asked: Any = SimpleNamespace(
        question=SimpleNamespace(blocks=blocks), sources=tuple(
            WrongRows((n,), f"row {n}") for n in range(3)),
        system=SimpleNamespace(dataset=np.array([0, 0, 1]), row=np.array([0, 2, 0])))
    answer: Any = SimpleNamespace(best=SimpleNamespace(chosen=(1, 2)))
    rest: Any = None
    assert Round(rest, (), (), None, rest, asked, answer, Whitening()).rows == {(0, 2), (1, 0)}


def test_a_set_that_stands_in_for_two_names_is_one_reading() -> None:
    """All legs alike in the place of either of two: one machine, which counts once."""
    def place(block: int, own: float) -> CausePlace:
        return CausePlace((Member("backlash", own, frozenset({0, 1}), frozenset({1})),
                           Member("backlash", 0.07, frozenset({2}), frozenset({2}))),
                          block, block, "", None)

    what: Any = SimpleNamespace(effects=((place(0, 0.92), ()), (place(1, 0.91), ())))
    (told, member, odds), = other_models.others(what)
    assert member.chosen == frozenset({2})
    assert told.block == 1 and odds == pytest.approx(0.91 / 0.07)
