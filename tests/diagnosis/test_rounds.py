"""Rounds of questions: what goes from one to the next, and when they end."""

from __future__ import annotations

from typing import Any

import numpy as np

import ppmcal
from ppmcal.diagnosis.explanation import _key, _seen
from ppmcal.diagnosis.extended_model import extended
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.question import Question
from ppmcal.model.effects import effect_kinds


def hypothesis(kind: str, on: tuple[str, ...], names: tuple[str, ...], **more: Any) -> Hypothesis:
    """Return a hypothesis of a kind of the library, of any size."""
    ends = (np.inf,) * len(names)
    return Hypothesis(kind, on, True, names, tuple(-e for e in ends), ends,
                      tuple(range(len(names))), effect=effect_kinds()[kind], **more)


def test_a_cause_is_the_same_whatever_the_stroke_that_was_measured() -> None:
    def periodic(period: float, low: float) -> Hypothesis:
        return Hypothesis("periodic", ("leg1",), True, ("size",), (0.0,), (1.0,), (0,),
                          constants={"period": period, "low": low}, strokes=("low",))

    assert _key(periodic(0.1, 0.2)) == _key(periodic(0.1, 0.2001))
    assert _key(periodic(0.1, 0.2)) != _key(periodic(0.2, 0.2))


def test_what_rows_do_not_see_of_an_effect_is_not_freed() -> None:
    """Touches of a flat see its height and its slope; a base goes nowhere along it."""
    step = hypothesis("base_shift", (), ("x", "y", "rz"), constants={"from_row": 10.0})
    machine, (added,) = extended(ppmcal.load(ppmcal.shipped("3-RPR")), [
        (step, np.array([0.0, 1e-4, 0.0]), np.array([0.0, 1e-5, 0.0]))])
    free = [n for n in added.parameters if machine.parameters[machine.names.index(n)].free]
    assert [n.rpartition(".")[2] for n in free] == ["y"]
    assert extended(machine, [(step, np.zeros(3), np.zeros(3))]) == (machine, ())


def test_a_column_that_geometry_makes_is_not_seen() -> None:
    """Its coefficient is what the prior says, wide, and no fit could tell it."""
    rng = np.random.default_rng(3)
    geometry, other = rng.normal(size=(80, 1)), rng.normal(size=(80, 1))
    columns = np.hstack([geometry, other, geometry + 1e-2 * other, np.zeros((80, 1))])
    asked = Question(MatrixColumns(columns), rng.normal(size=80), 1e8 * geometry,
                     (Block("all", "all", (0, 1, 2, 3), 0.0),), np.ones((40, 2), dtype=bool),
                     np.zeros(39, dtype=np.int64))
    assert _seen(asked, (0, 1, 2, 3)).tolist() == [False, True, True, False]
