"""Columns that are read wrongly, as probabilities tell them: in which file, in which rows."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hidden import Options, hide

from ppmcal.calibration.fit import FitOptions, Problem, identify
from ppmcal.calibration.interpretation import InterpretationError
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.misread_causes import refuse_misread
from ppmcal.diagnosis.question import Asked, question
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.term_candidates import all_settings
from ppmcal.diagnosis.unknown_causes import UnknownCauses
from ppmcal.model.mechanism import Mechanism


@pytest.fixture(scope="module")
def two_files() -> tuple[Asked, Mechanism]:
    """Return the question of two files: directions turned in some rows of one, or in all of one.

    In the first nothing was loaded.
    """
    found = hide("delta-linear", 7, [], 1.0, Options(poses=30), "all")
    numbers = np.arange(len(found.dataset))
    first, second = (replace(found.dataset.take(mine), name=name, source=f"{name}.csv")
                     for name, mine in (("one", numbers < 30), ("two", numbers >= 30)))
    first = replace(first, columns=first.columns | {"payload": 0.0 * first.q[:, 0]})
    problem = Problem(found.mechanism, (first, second), found.mechanism.free)
    fit = identify(with_whole_rows(problem), FitOptions())
    system = build(fit.problem, fit.state, fit.keep)
    return question(system, library(system, misread=True),
                    UnknownCauses(system, all_settings(fit))), found.mechanism


def told(asked: Asked, mechanism: Mechanism, *causes: Hypothesis | None) -> Any:
    """Return a round with a column that is read wrongly, or something unknown, in each place."""
    places = [SimpleNamespace(sure=True, only_misread=h is not None, hypothesis=h) for h in causes]
    return SimpleNamespace(places=places, asked=asked, fit=SimpleNamespace(
        problem=SimpleNamespace(mechanism=mechanism)))


def refused(asked: Asked, mechanism: Mechanism, h: Hypothesis) -> InterpretationError:
    with pytest.raises(InterpretationError) as error:
        refuse_misread(told(asked, mechanism, h))
    return error.value


@pytest.mark.slow
def test_no_file_is_refused_while_something_in_it_has_no_name(
        two_files: tuple[Asked, Mechanism]) -> None:
    """What looks like turned directions may be the rest of that."""
    asked, mechanism = two_files
    turned = next(h for h in asked.sources if isinstance(h, Hypothesis) and h.stretch)
    refuse_misread(told(asked, mechanism, turned, None))


@pytest.mark.slow
def test_directions_that_are_turned_are_told_with_their_file_and_their_rows(
        two_files: tuple[Asked, Mechanism]) -> None:
    asked, mechanism = two_files
    system = asked.system
    own = next(h for h in asked.sources if isinstance(h, Hypothesis) and h.stretch)
    begin = int(np.flatnonzero(system.dataset == 1)[0])
    some = refused(asked, mechanism, replace(own, stretch=(begin + 4, begin + 14)))
    (found,) = some.found
    rows = system.problem.datasets[1].rows[system.row[[begin + 4, begin + 13]]].tolist()
    assert found.source == "two.csv" and found.block is None
    assert found.mistakes[0].rows == tuple(range(rows[0], rows[1] + 1))
    assert "to the other rows" in some.what
    end = system.dataset.size
    (found,) = refused(asked, mechanism, replace(own, stretch=(begin, end))).found
    assert found.source == "two.csv" and not found.mistakes[0].rows
    assert found.block is not None and set(found.block) >= {"signs"}


@pytest.mark.slow
def test_a_column_in_another_unit_is_told_with_the_files_that_have_it(
        two_files: tuple[Asked, Mechanism]) -> None:
    asked, mechanism = two_files
    loaded, warm = (next(h for h in asked.sources if isinstance(h, Hypothesis)
                         and h.misread.startswith(column)) for column in ("payload", "temp"))
    assert [m.source for m in refused(asked, mechanism, loaded).found] == ["two.csv"]
    assert [m.source for m in refused(asked, mechanism, warm).found] == ["one.csv", "two.csv"]
