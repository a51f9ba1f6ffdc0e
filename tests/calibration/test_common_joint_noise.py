"""Targets that were seen at one stand of the machine have the noise of its joints in common."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import MARKS, columns, long, machine, measured, several, wide
from scipy.stats import chi2

import ppmcal
from ppmcal.calibration.fit.fit_result import posterior
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.registration_freedoms import odds_of_opening
from ppmcal.calibration.sessions.session_posteriors import session_knowledge

FITS, JOINT = 24, 0.05
LEVEL = 0.001
"""A right program is outside by chance so often."""


def problem(folder: Path, paths: list[Path]) -> Problem:
    bench = ppmcal.load(machine(folder)).with_free(["*.offset"])
    return Problem(bench, ppmcal.read_data(bench, *paths), bench.free)


def with_joints_of_their_own(whole: Problem) -> Problem:
    """Return the problem as if each target had been seen at stands of its own."""
    return replace(whole, datasets=tuple(
        replace(d, stands=None, campaign="", body="") for d in whole.datasets))


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.long
def test_intervals_cover_what_is_true_where_the_noise_is_of_the_joints(
        tmp_path: Path, count: int) -> None:
    total = square = 0.0
    freedom = 0
    for seed in range(FITS):
        seen = measured(seed, rows=30, joint=JOINT, names=tuple(MARKS)[:count], slots=("offset",))
        fit = identify(problem(tmp_path, [wide(tmp_path, seen, joint=JOINT)]))
        off = 1e3 * fit.state.g[list(fit.problem.free)] - [seen.errors[f"leg{i}.offset"]
                                                           for i in (1, 2, 3)]
        total += float(off @ np.linalg.solve(1e6 * posterior(fit)[:3, :3], off))
        for rows in fit.problem.rows(fit.state, True, fit.keep):
            square += float(np.sum(rows.residual**2))
            freedom += rows.observed.sum()
        freedom -= len(fit.problem.columns) - 3     # offsets have a prior beside the data
    low, high = chi2.ppf([LEVEL / 2.0, 1.0 - LEVEL / 2.0], 3 * FITS)
    assert low < total < high
    low, high = chi2.ppf(LEVEL / 2.0, freedom - 3 * FITS), chi2.ppf(1.0 - LEVEL / 2.0, freedom)
    assert low < square < high


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_the_posterior_is_that_of_the_whole_covariance(tmp_path: Path, count: int) -> None:
    """Generalised least squares by the bench's own formulas, at the truth: it is nominal here.

    With joints of their own for each target the claim is another one: two targets make the frame,
    and with it a zero, look better known than it is, three make two of the zeros.
    """
    names = tuple(MARKS)[:count]
    seen = measured(3, rows=30, joint=JOINT, names=names, slots=())
    size = 6 + 2 * count
    information = np.diag([0.4**-2] * 3 + [0.0] * (size - 3))
    for pose in seen.poses:
        by_legs, by_frame, by_marks = columns(pose, names)
        rows = np.concatenate([by_legs, by_frame, by_marks], axis=1)
        noise = JOINT**2 * by_legs @ by_legs.T + 0.01**2 * np.eye(2 * count)
        information += rows.T @ np.linalg.solve(noise, rows)
    want = np.linalg.inv(information)[:3, :3]
    whole = problem(tmp_path, [wide(tmp_path, seen, joint=JOINT)])
    for found, right in ((whole, True), (with_joints_of_their_own(whole), False)):
        over = np.linalg.eigvals(np.linalg.solve(want, 1e6 * posterior(identify(found))[:3, :3]))
        assert np.allclose(over, 1.0, atol=0.01) == right
        assert right or over.min() < 0.9


@pytest.mark.slow
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


def test_rows_of_a_tracker_are_white_together(tmp_path: Path) -> None:
    """Its covariance of each position and the joints' noise, which two targets share."""
    names, station = ("T1", "T2"), np.array([4000.0, -3000.0])
    seen = measured(5, rows=8, joint=JOINT, names=names, slots=())
    path = wide(tmp_path, seen, joint=JOINT)
    text = path.with_suffix(".yaml").read_text()
    path.with_suffix(".yaml").write_text(text.replace(
        "position: 0.01", "range: 0.004, angle: 0.0006").replace(
        "kind: position", f"kind: position, station: {station.tolist()}"))
    whole = problem(tmp_path, [path])
    state = whole.start()
    given = list(whole.rows(state, True))
    for n, pose in enumerate(seen.poses):
        by_legs = columns(pose, names)[0]
        noise = JOINT**2 * by_legs @ by_legs.T
        for i, name in enumerate(names):
            way = seen.marks[name][n] - station
            far = np.linalg.norm(way)
            along = np.outer(way, way) / far**2
            noise[2 * i:2 * i + 2, 2 * i:2 * i + 2] += 0.004**2 * along + (
                np.radians(0.0006) * far) ** 2 * (np.eye(2) - along)
        root = np.linalg.inv(np.linalg.cholesky(noise))
        raw = 1e3 * np.concatenate([g.raw[n] for g in given])
        white = np.concatenate([g.residual[n] for g in given])
        assert white == pytest.approx(root @ raw, rel=1e-3, abs=1e-3 * np.abs(white).max())


@pytest.mark.slow
def test_what_a_campaign_knows_has_no_order_of_targets(tmp_path: Path) -> None:
    """Rows are white one target after the other: which is first says nothing of the machine."""
    seen = measured(5, rows=25, joint=JOINT, slots=("offset",))
    information, residuals = list[np.ndarray](), list[dict[str, np.ndarray]]()
    for names in (tuple(MARKS), tuple(reversed(MARKS))):
        found = problem(tmp_path, [wide(tmp_path, replace(
            seen, marks={n: seen.marks[n] for n in names}), joint=JOINT)])
        known = session_knowledge(identify(found))
        columns = [found.mechanism.names[p] for p in found.free] + list(known.names)
        own = [columns.index(n) for n in sorted(columns) if not n.startswith("scale")]
        information.append((known.matrix.T @ known.matrix)[np.ix_(own, own)])
        residuals.append({s.name: s.rest for s in known.sights})
    size = np.abs(information[0]).max()
    assert information[1] == pytest.approx(information[0], rel=1e-4, abs=1e-6 * size)
    for name, residual in residuals[0].items():
        assert residuals[1][name] == pytest.approx(residual, rel=1e-4,
                                                   abs=1e-4 * np.abs(residual).max())


@pytest.mark.slow
def test_what_may_be_open_has_no_order_of_targets(tmp_path: Path) -> None:
    """Columns of one target are in the rows of those that come after it, too."""
    seen = measured(5, rows=25, joint=JOINT, slots=("offset",))
    seen.marks["T2"][:, 0] += 0.05
    odds = list[dict[str, float]]()
    for names in (tuple(MARKS), tuple(reversed(MARKS))):
        path = wide(tmp_path, replace(seen, marks={n: seen.marks[n] for n in names}), joint=JOINT)
        side = path.with_suffix(".yaml")
        text = side.read_text()
        for name in names:
            text = text.replace(f"{name}: unknown", f"{name}: {list(MARKS[name])}")
        side.write_text(text)
        fit = identify(problem(tmp_path, [path]))
        found = odds_of_opening(fit.problem, fit.state, fit.keep, fit.prior,
                                [(i, "target") for i in range(3)])
        odds.append(dict(zip(names, found.tolist(), strict=True)))
    assert odds[1] == pytest.approx(odds[0], rel=1e-4)
    assert max(odds[0], key=odds[0].__getitem__) == "T2"


def test_a_row_that_is_left_out_is_not_given(tmp_path: Path) -> None:
    whole = problem(tmp_path, [wide(tmp_path, measured(5, rows=8, joint=JOINT), joint=JOINT)])
    state, keep = whole.start(), [np.ones(8, dtype=bool) for _ in range(3)]
    keep[0][3] = keep[1][3] = False
    third = list(whole.rows(state, True, keep))[2]
    alone = next(whole.rows_of(2, state, True))
    apart = np.abs(third.residual - alone.residual).max(axis=1)
    assert apart[3] == pytest.approx(0.0, abs=1e-9) and (np.delete(apart, 3) > 1e-6).all()
