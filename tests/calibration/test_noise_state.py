"""Whether the noise check failed, and which way; and the prior's part of chi-squared apart."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal as run

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.noise_estimate import (
    AGREES,
    ESTIMATED,
    LARGER,
    SMALLER,
    STATED,
    Noise,
    noise_check,
    noise_source,
    noise_state,
)
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.validation.summary import report
from ppmcal.codec import unsaid
from ppmcal.io.results.identification_wording import noise_verdict, short_intervals
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

SEEDS = 5


@pytest.fixture(scope="module")
def hexapod() -> Mechanism:
    return ppmcal.load(ppmcal.shipped("6-UPS"))


def campaign(machine: Mechanism, seed: int, scale: float) -> Dataset:
    """Twenty poses of a machine with errors of ``scale`` tolerances."""
    data: Dataset = ppmcal.simulate(machine, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": {"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0},
                             "half_range": {"x": 100, "y": 100, "z": 100, "rx": 8, "ry": 8,
                                            "rz": 8}, "count": 20}},
        "errors": {"random": {"scale": scale}},
        "frame": {"x": 5, "y": -3, "z": 2, "rx": 0, "ry": 0, "rz": 1},
        "instrument": {"kind": "pose", "sigma": {"position": 0.05, "rotation": 0.01}},
        "seed": seed}).data[0]
    return data


def found(machine: Mechanism, data: Dataset):
    fit = identify(Problem(machine, (data,), machine.free), FitOptions(robust=False))
    return fit, noise_check(fit)


@pytest.mark.parametrize(("ratio", "p", "state"), [
    (3.0, 1e-9, LARGER), (0.1, 1.0, SMALLER), (0.3, 0.89, AGREES), (1.0, 0.4, AGREES),
    (1.4, None, AGREES), (2.0, float("nan"), AGREES), (0.9, 0.9999, AGREES)])
def test_one_place_decides_whether_the_check_failed(ratio: float, p: float | None, state: str
                                                    ) -> None:
    assert noise_state(ratio, p) == state
    check = replace(unsaid(Noise), sigma_ratio=ratio, chi2_p=np.nan if p is None else p)
    assert check.state == state
    words, fine = noise_verdict(check)
    assert fine == (state == AGREES)
    assert ("exceed" in words, "below" in words) == (state == LARGER, state == SMALLER)


def test_noise_that_nobody_stated_is_not_called_stated(hexapod: Mechanism) -> None:
    data = campaign(hexapod, 1, 1.0)
    for source, own in ((STATED, data), (ESTIMATED, replace(data, estimated=True))):
        check = found(hexapod, own)[1]
        assert check.source == source
        for ratio, p in ((3.0, 1e-9), (0.1, 1.0), (1.0, 0.4)):
            words, _ = noise_verdict(replace(check, sigma_ratio=ratio, chi2_p=p))
            assert f"the {source} noise" in words
    assert noise_source([data, replace(data, estimated=True)]) == "stated or estimated"


@pytest.mark.slow
def test_noise_and_prior_are_checked_apart(hexapod: Mechanism) -> None:
    """Each part has its own degrees of freedom, whatever the other one is."""
    checks = [found(hexapod, campaign(hexapod, seed, 1.0))[1] for seed in range(SEEDS)]
    for chi2, degrees in ((sum(n.chi2 for n in checks), sum(n.degrees for n in checks)),
                          (sum(n.prior_chi2 for n in checks),
                           sum(n.prior_degrees for n in checks))):
        assert chi2 / degrees == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / degrees))
    tight = [found(hexapod, campaign(hexapod, seed, 3.0))[1] for seed in range(SEEDS)]
    assert all(n.tight and not n.failed for n in tight)
    # what no error of the machine explains stays what it was
    assert sum(n.chi2 for n in tight) == pytest.approx(sum(n.chi2 for n in checks), rel=0.02)


@pytest.mark.slow
def test_tolerances_that_are_too_tight_are_a_finding(hexapod: Mechanism) -> None:
    fit, _ = found(hexapod, campaign(hexapod, 1, 3.0))
    said = [f for f in report(fit, FitOptions(robust=False), 0.0, 1).findings if "tolerances" in f]
    assert any("too tight" in f for f in said)
    fit, _ = found(hexapod, campaign(hexapod, 1, 1.0))
    assert not any("too tight" in f for f in report(fit, FitOptions(robust=False), 0.0, 1).findings)


@pytest.mark.slow
def test_noise_that_is_too_small_is_not_blamed_on_the_tolerances(hexapod: Mechanism) -> None:
    data = campaign(hexapod, 1, 1.0).noisier(0.25)
    fit, check = found(hexapod, replace(data, estimated=False))
    assert check.failed
    result = report(fit, FitOptions(robust=False), 0.0, 1)
    assert not result.noise.tight and result.noise.failed


@pytest.mark.parametrize(("method", "said"), [("prior", False), ("gcv", True), ("damped", True)])
def test_intervals_that_hold_less_often_say_so(method: str, said: bool) -> None:
    assert any("held the truth" in t for t in short_intervals(method)) == said


@pytest.mark.slow
def test_tolerances_that_are_too_tight_are_said_wherever_a_person_looks(tmp_path: Path) -> None:
    """Console, JSON and page say so, and the exit code is that of a finding."""
    run("init", "3-RPR", "--out", tmp_path / "mine.yaml", expect=0)
    scenario = yaml.safe_load((tmp_path / "mine.scenario.yaml").read_text())
    scenario["errors"] = {"random": {"scale": 3.0}}
    (tmp_path / "mine.scenario.yaml").write_text(yaml.safe_dump(scenario))
    run("simulate", tmp_path / "mine.yaml", tmp_path / "mine.scenario.yaml", "--seed", 2,
        "--out", tmp_path / "s", expect=0)
    data = tmp_path / "s" / "measurements.csv"
    said = run("identify", tmp_path / "mine.yaml", data, "--keep-outliers", "--out", tmp_path / "i",
               expect=1)
    assert "the tolerances are too tight" in " ".join((said.out + said.err).split())
    record = json.loads((tmp_path / "i" / "identification.json").read_text())
    assert any("the tolerances are too tight" in f for f in record["findings"])
    assert record["noise"]["prior_p"] < 1e-3
    run("report", tmp_path / "i", "--out", tmp_path / "r", expect=0)
    page = (tmp_path / "r" / "report.html").read_text()
    assert "the errors are larger than the tolerances allow" in page
    assert "With doubts" in page and "the tolerances are too tight" in page
