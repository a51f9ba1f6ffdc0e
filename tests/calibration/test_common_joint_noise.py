"""Targets that were seen at one stand of the machine have the noise of its joints in common."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import MARKS, long, machine, measured, several, wide
from scipy.stats import chi2

import ppmcal
from ppmcal.calibration.fit.fit_result import posterior
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem

FITS, JOINT = 24, 0.05
LEVEL = 0.001
"""A right program is outside by chance so often."""


def problem(folder: Path, paths: list[Path]) -> Problem:
    bench = ppmcal.load(machine(folder)).with_free(["*.offset"])
    return Problem(bench, ppmcal.read_data(bench, *paths), bench.free)


@pytest.mark.parametrize("count", [2, 3])
def test_intervals_cover_what_is_true_where_the_noise_is_of_the_joints(
        tmp_path: Path, count: int) -> None:
    names = tuple(MARKS)[:count]
    total = independent = square = 0.0
    freedom = 0
    for seed in range(FITS):
        seen = measured(seed, rows=30, joint=JOINT, names=names, slots=("offset",))
        whole = problem(tmp_path, [wide(tmp_path, seen, joint=JOINT)])
        # as if each target had joints of its own
        apart = replace(whole, datasets=tuple(
            replace(d, stands=None, campaign="", body="") for d in whole.datasets))
        for found in (whole, apart):
            fit = identify(found)
            off = 1e3 * fit.state.g[list(found.free)] - [seen.errors[f"leg{i}.offset"]
                                                         for i in (1, 2, 3)]
            own = float(off @ np.linalg.solve(1e6 * posterior(fit)[:3, :3], off))
            if found is apart:
                independent += own
                continue
            total += own
            for rows in found.rows(fit.state, True, fit.keep):
                square += float(np.sum(rows.residual**2))
                freedom += rows.observed.sum()
            freedom -= len(found.columns) - 3     # offsets have a prior beside the data
    low, high = chi2.ppf([LEVEL / 2.0, 1.0 - LEVEL / 2.0], 3 * FITS)
    assert low < total < high
    assert independent > (high if count == 3 else total)
    low, high = chi2.ppf(LEVEL / 2.0, freedom - 3 * FITS), chi2.ppf(1.0 - LEVEL / 2.0, freedom)
    assert low < square < high


def test_in_every_form_of_the_file_the_noise_is_the_same(tmp_path: Path) -> None:
    seen = measured(5, rows=25, joint=JOINT, slots=("offset",))
    fits = [identify(problem(tmp_path, paths)) for paths in (
        [wide(tmp_path, seen, joint=JOINT)], [long(tmp_path, seen, joint=JOINT)],
        several(tmp_path, seen, joint=JOINT))]
    for fit in fits[1:]:
        assert fit.state.g == pytest.approx(fits[0].state.g, rel=1e-9, abs=1e-12)
        assert posterior(fit)[:3, :3] == pytest.approx(posterior(fits[0])[:3, :3], rel=1e-6)


def test_rows_are_white_together(tmp_path: Path) -> None:
    """White rows are what the inverse root of the covariance of all values of a stand makes."""
    whole = problem(tmp_path, [wide(tmp_path, measured(5, rows=8, joint=JOINT), joint=JOINT)])
    state = whole.start()
    alone = [next(whole.rows_of(i, state, True)) for i in range(3)]
    given = list(whole.rows(state, True))
    carried = [np.where(r.observed[..., None], r.response.by_joint, 0.0)  # type: ignore[union-attr]
               * whole.sigma_joints[0] for r in alone]
    for n in range(8):
        b = np.concatenate([c[n] for c in carried])
        cov = b @ b.T + 1e-10 * np.eye(6)
        root = np.linalg.inv(np.linalg.cholesky(cov))
        raw = np.concatenate([r.raw[n] for r in alone])
        jacobian = np.concatenate([r.raw_jacobian()[n] for r in alone])
        assert np.concatenate([g.residual[n] for g in given]) == pytest.approx(root @ raw, rel=1e-6)
        assert np.concatenate([g.jacobian[n] for g in given]) == pytest.approx(
            root @ jacobian, rel=1e-6, abs=1e-6 * np.abs(root @ jacobian).max())


def test_a_row_that_is_left_out_is_not_given(tmp_path: Path) -> None:
    whole = problem(tmp_path, [wide(tmp_path, measured(5, rows=8, joint=JOINT), joint=JOINT)])
    state, keep = whole.start(), [np.ones(8, dtype=bool) for _ in range(3)]
    keep[0][3] = keep[1][3] = False
    third = list(whole.rows(state, True, keep))[2]
    alone = next(whole.rows_of(2, state, True))
    apart = np.abs(third.residual - alone.residual).max(axis=1)
    assert apart[3] == pytest.approx(0.0, abs=1e-9) and (np.delete(apart, 3) > 1e-6).all()
