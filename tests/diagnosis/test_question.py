"""A fit as a question to the evidence: the library's causes and rows that do not belong."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from hidden import Options, hide

from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.question import ROW_FAMILY, UNKNOWN_FAMILY, LibrarySource, question
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.term_candidates import all_settings
from ppmcal.diagnosis.unknown_causes import UnknownCauses
from ppmcal.inference.priors import (
    FAMILY,
    GROSS_ROW,
    MISREAD,
    NOISE_FREEDOM,
    OWN_NOISE_FREEDOM,
    UNKNOWN,
)
from ppmcal.inference.question import Question
from ppmcal.inference.sets import SetPosterior, posterior


def asked(machine: str, kinds: list[str], eta: float, poses: int = 60,
          spoiled: tuple[int, ...] = ()) -> Question:
    """Return the question of a campaign in which effects are hidden, and rows off by 20 sigma."""
    found = hide(machine, 7, kinds, eta, Options(poses=poses), "all")
    data = found.dataset
    for row in spoiled:
        data.position[row] += 20.0 * data.sigma_position[row]
    fit = identify(with_whole_rows(Problem(found.mechanism, (data,), found.mechanism.free)),
                   FitOptions())
    keep = [k | o for k, o in zip(fit.keep, fit.outliers, strict=True)]
    system = build(fit.problem, fit.state, keep)
    return question(system, library(system), UnknownCauses(system, all_settings(fit))).question


def names(found: SetPosterior) -> list[str]:
    return [found.best.question.blocks[i].family for i in found.best.chosen]


@pytest.mark.slow
def test_columns_are_those_of_the_library() -> None:
    found = asked("3-RPR", [], 1.0, poses=30)
    source = found.columns.parts[0]     # type: ignore[attr-defined]
    assert isinstance(source, LibrarySource)
    some = [5, 0, source.count - 1]
    values = np.random.default_rng(0).normal(size=(source.observed.size, 2))
    assert source.along(values)[some] == pytest.approx(source.some(some).T @ values)


@pytest.mark.slow
def test_a_kind_is_told_apart_by_its_joints_and_the_unknown_is_not() -> None:
    found = asked("3-RPR", [], 1.0, poses=30)
    where = defaultdict(set)
    for block in found.blocks:
        where[block.family].add(block.where)
    assert where["backlash"] == {"leg1", "leg2", "leg3", "leg1 leg2 leg3"}
    assert where[UNKNOWN_FAMILY] == where[ROW_FAMILY] == {""}


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is() -> None:
    found = posterior(asked("3-RPR", [], 1.0))
    assert not found.best.chosen and found.nothing((ROW_FAMILY,)) > 0.5


@pytest.mark.long
def test_a_hidden_effect_is_found() -> None:
    found = posterior(asked("3-RPR", ["curvature"], 2.0))
    assert names(found) == ["curvature"]
    assert found.families(0)["curvature"] > 0.9


@pytest.mark.slow
def test_rows_that_do_not_belong_are_told_from_causes() -> None:
    found = posterior(asked("3-RPR", ["curvature"], 2.0, spoiled=(10, 11, 40)))
    assert sorted(names(found)) == ["curvature", *[ROW_FAMILY] * 3]


@pytest.mark.long
def test_what_no_kind_does_is_unknown() -> None:
    found = posterior(asked("3-RRR-1", ["bump"], 2.0))
    assert UNKNOWN_FAMILY in names(found)


@pytest.mark.slow
def test_noise_that_files_want_estimated_is_hardly_known() -> None:
    """Estimated before anything is named, it holds what is missing."""
    found = hide("3-RPR", 7, [], 1.0, Options(poses=30), "all")
    fit = identify(with_whole_rows(Problem(found.mechanism, (
        found.dataset, replace(found.dataset, name="two")), found.mechanism.free)), FitOptions())
    for estimated, known in (((True, True), OWN_NOISE_FREEDOM), ((True, False), NOISE_FREEDOM)):
        datasets = tuple(replace(d, estimated=e) for d, e in zip(
            fit.problem.datasets, estimated, strict=True))
        system = build(replace(fit.problem, datasets=datasets), fit.state, fit.keep)
        own = question(system, library(system, ["gain"]), UnknownCauses(system, all_settings(fit)))
        assert own.question.known == float(known)
        view = own.question.views[0]
        assert {view.start.known, *(b.known for b in view.batches)} == {float(known)}


@pytest.mark.slow
def test_no_family_is_believed_more_than_its_prior() -> None:
    """Proper priors: all forms of a family together have what the table gives it, rows each."""
    found = asked("3-RRR-1", [], 1.0, poses=30)
    share: dict[str, float] = defaultdict(float)
    for block in found.blocks:
        assert np.isfinite(block.log_prior)
        if block.family == ROW_FAMILY:
            assert np.exp(block.log_prior) == pytest.approx(float(GROSS_ROW))
        else:
            share[block.family] += np.exp(block.log_prior)
    opposite = sum(np.exp(b.log_prior) for b in found.blocks if "opposite sign" in b.name)
    assert 0.0 < opposite < float(MISREAD)
    assert share.pop(UNKNOWN_FAMILY) - opposite == pytest.approx(float(UNKNOWN))
    assert len(share) > 10 and max(share.values()) == pytest.approx(float(FAMILY))
