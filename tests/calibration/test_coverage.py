"""A slice of the campaign study: does the fit know how well it knows?

Bounds come from the fits' own covariances. If they are right, a pooled squared error is a sum of
squares of normal variables with known mean and variance, close to a gamma law of these moments,
and the share of parameters inside their intervals has a known variance. Each of the checks below
fails a correct program with probability ALARM, all of them together with less than 0.1 %.
"""

from __future__ import annotations

import csv
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT
from scipy.special import bdtrc, gammainc, gammaincc, ndtr

STUDY = ROOT / "benchmarks" / "campaigns.py"
CAMPAIGNS = {"3-RPR": 12, "3-RPS": 6}
"""Fifty of each of eleven machines are in docs/campaigns.md."""
CHECKS = 2 * 3 + 3
ALARM = 0.9e-3 / CHECKS


@cache
def study() -> list[dict[str, float | str]]:
    """Run the study as a user would and read its CSV."""
    import tempfile

    rows: list[dict[str, float | str]] = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "campaigns.csv"
        for machine, count in CAMPAIGNS.items():
            # exit 1 only says that a ratio from so few campaigns is outside the study's bounds
            done = subprocess.run(
                [sys.executable, "-W", "error", str(STUDY), "--campaigns", str(count), "--machine",
                 machine, "--seed", "1", "--processes", "1", "--out", str(out)],
                capture_output=True, text=True, check=False, timeout=120)
            assert done.returncode in (0, 1), done.stderr
            assert done.stderr == ""
            with out.open(newline="") as stream:
                for row in csv.DictReader(stream):
                    rows.append({k: v if k in ("machine", "converged") else float(v)
                                 for k, v in row.items()})
    return rows


def column(name: str, machine: str | None = None) -> np.ndarray:
    return np.array([r[name] for r in study() if machine in (None, r["machine"])], dtype=float)


def tail(total: float, mean: float, variance: float) -> float:
    """Two-sided p-value of a sum of squares of these moments (gamma law)."""
    shape = mean**2 / variance
    x = total * mean / variance
    return 2.0 * float(min(gammainc(shape, x), gammaincc(shape, x)))


@pytest.mark.long
def test_every_campaign_converges() -> None:
    assert len(study()) == sum(CAMPAIGNS.values())
    assert {r["converged"] for r in study()} == {"True"}


@pytest.mark.long
@pytest.mark.parametrize("machine", CAMPAIGNS)
@pytest.mark.parametrize("kind", ["position", "rotation"])
def test_fresh_poses_err_as_much_as_promised(machine: str, kind: str) -> None:
    promised = column(f"{kind}_promised", machine)
    # whole campaigns: their machines and noise are drawn anew, so they are independent
    error = column(f"{kind}_error", machine) / promised
    variance = column(f"{kind}_spread", machine) / promised**2
    p = tail(float(error.sum()), float(error.size), float(variance.sum()))
    assert p > ALARM, f"rms {np.sqrt(error.mean()):.3f} of what was promised"


@pytest.mark.slow
@pytest.mark.parametrize("machine", CAMPAIGNS)
def test_95_percent_intervals_hold_95_percent(machine: str) -> None:
    inside, count = column("inside", machine), column("parameters", machine)
    away = (inside.sum() - 0.95 * count.sum()) / np.sqrt(column("inside_spread", machine).sum())
    coverage = inside.sum() / count.sum()
    assert 2.0 * ndtr(-abs(away)) > ALARM, f"{coverage:.3f} of the parameters are inside"


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.05, 0.001])
def test_noise_check_seldom_cries_wolf(level: float) -> None:
    p = column("noise_p")
    alarms = int(np.sum(p < level))
    assert bdtrc(max(alarms - 1, 0), p.size, level) > ALARM or alarms == 0
    # nor is it blind: p-values are spread over 0 to 1
    assert np.mean(p < 0.5) > 0.2


@pytest.mark.slow
def test_good_rows_are_seldom_taken_for_outliers() -> None:
    # a row goes when its p-value times the number of rows is below 0.05: 5 % of the campaigns
    dropped = int(np.sum(column("dropped") > 0))
    assert bdtrc(max(dropped - 1, 0), column("dropped").size, 0.05) > ALARM or dropped == 0
    assert column("dropped").max() <= 2


def test_a_decomposition_that_does_not_converge_is_done_another_way(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """LAPACK's divide and conquer fails on some sound matrices; a fit must not."""
    from ppmcal.linalg import svd

    matrix = np.random.default_rng(1).normal(size=(9, 5))
    wanted = svd(matrix)

    def fails(*args: object, **options: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", fails)
    u, s, vt = svd(matrix)
    np.testing.assert_allclose(s, wanted[1])
    np.testing.assert_allclose((u * s) @ vt, matrix, atol=1e-13)
