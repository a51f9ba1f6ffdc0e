"""Effects with a size in each session, as causes of a question."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden import Options, hide

from ppmcal.calibration.fit import FitOptions, Problem, identify
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import System, build
from ppmcal.diagnosis.question import question
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.unknown_causes import UnknownCauses
from ppmcal.inference.priors import FAMILY, GOES_WITH

KINDS = ("backlash", "compliance", "zero_shift", "payload_offset")


@pytest.fixture(scope="module")
def two_days() -> System:
    """Return two files of a campaign in which nothing is hidden."""
    found = hide("3-RPR", 7, [], 1.0, Options(poses=30), "all")
    first = np.arange(len(found.dataset)) < 30
    data = tuple(replace(found.dataset.take(mine), name=name)
                 for mine, name in ((first, "one"), (~first, "two")))
    fit = identify(with_whole_rows(Problem(found.mechanism, data, found.mechanism.free)),
                   FitOptions())
    return build(fit.problem, fit.state, fit.keep)


def test_columns_of_the_sessions_add_up_to_those_of_the_effect(two_days: System) -> None:
    found = library(two_days, KINDS, apart=True)
    own = [h for h in found.hypotheses if h.sessions]
    assert {h.kind for h in own} == {"backlash", "compliance"}
    for h in own:
        plain = next(f for f in found.hypotheses if not (f.sessions or f.scanned) and f.shared
                     and (f.family, f.on) == (h.family, h.on))
        columns = found.some(h.columns)
        assert h.sessions == ("one", "two") and h.label.startswith(plain.label)
        assert np.sum(columns, axis=-1) == pytest.approx(np.sum(found.some(plain.columns), axis=-1))
        for s in (0, 1):
            assert not columns[two_days.dataset != s][..., s].any()


def test_one_in_ten_effects_is_not_the_same_in_all_sessions(two_days: System) -> None:
    fit_settings = [p.setting for p in two_days.firsts]
    asked = question(two_days, library(two_days, ["backlash"], apart=True),
                     UnknownCauses(two_days, fit_settings))
    prior = {(h.on, bool(h.sessions)): b.log_prior
             for b, h in zip(asked.question.blocks, asked.sources, strict=True)
             if isinstance(h, Hypothesis) and h.shared and h.family == "backlash"}
    for on in {on for on, _ in prior}:
        assert prior[on, True] - prior[on, False] == pytest.approx(
            np.log(float(GOES_WITH) / (1.0 - float(GOES_WITH))))
    every = [b.log_prior for b in asked.question.blocks if b.family == "backlash"]
    assert np.exp(every).sum() == pytest.approx(float(FAMILY))


def test_one_session_has_nothing_to_differ_from(two_days: System) -> None:
    alone = build(two_days.problem, two_days.state, [np.ones(30, dtype=bool),
                                                     np.zeros(30, dtype=bool)])
    assert not any(h.sessions for h in library(alone, KINDS, apart=True).hypotheses)
