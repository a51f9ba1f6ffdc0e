"""Rows before a joint has crossed its play: where it stood is not known, and nothing happened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import write_csv
from helpers.machines import Array
from helpers.paths import ROOT

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.commands.inputs import prepared
from ppmcal.diagnosis.explanation import explained
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.tables import inverse_table, pose_vector

pytestmark = pytest.mark.slow
CONFIG = ROOT / "configs" / "3-RPR.yaml"
BENCH = read_mechanism(CONFIG)
UNKNOWN = "the state of the play is unknown"
WIDTH, SIGMA, ROWS = 0.08, (0.002, 0.0005), 80


def looped(u: Array, start: float) -> Array:
    """Return play's output, row by row, from ``start`` (-1 to 1) half widths off the joint."""
    half = 0.5e-3 * WIDTH
    now, out = u[0] + start * half, []
    for x in u:
        now = float(np.clip(now, x - half, x + half))
        out.append(now)
    return np.array(out)


def campaign(folder: Path, slow: int, start: float, seed: int, on: tuple[int, ...]) -> None:
    """Write rows of which the first ``slow`` are moves far below the play."""
    rng = np.random.default_rng(seed)
    half = np.array([60.0, 60.0, 8.0])
    away, poses = half * rng.uniform(-0.5, 0.5, 3), np.zeros((ROWS, 6))
    for k in range(ROWS):
        size = 10.0 ** (rng.uniform(-4.0, -3.6) if k < slow else rng.uniform(-3.5, 0.0))
        away = np.clip(away + half * size * rng.normal(size=3), -half, half)
        poses[k, [0, 1, 5]] = np.array([500.0, 288.675, 30.0]) + away
    poses[:, :2] *= 1e-3
    poses[:, 5] = np.radians(poses[:, 5])
    q = inverse_table(Model(BENCH), poses).q
    real = q + 2e-4 * rng.normal(size=3)
    for joint in on:
        real[:, joint] += looped(q[:, joint], start) - q[:, joint]
    seen = pose_vector(forward(Model(BENCH), real).pose)[:, [0, 1, 5]]
    seen = seen * [1e3, 1e3, 180.0 / np.pi] + rng.normal(size=(ROWS, 3)) * [
        SIGMA[0], SIGMA[0], SIGMA[1]]
    write_csv(folder / "d.csv", [
        {f"q_{a}": 1e3 * v for a, v in zip(BENCH.actuators, joints, strict=True)}
        | dict(zip(("x", "y", "rz"), values, strict=True))
        for joints, values in zip(q.tolist(), seen.tolist(), strict=True)])
    (folder / "d.yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
        "frame": "known", "target": "known", "approach": "sequence",
        "instrument": {"kind": "pose", "sigma": {"position": SIGMA[0], "rotation": SIGMA[1]}}}))


def left_out(found: Any, folder: Path) -> list[int]:
    """Return the rows that were left out for their start."""
    found.save(folder / "d")
    lines = (folder / "d" / "residuals.csv").read_text().splitlines()[1:]
    return [n for n, line in enumerate(lines, 1) if UNKNOWN in line]


@pytest.mark.long
@pytest.mark.parametrize(("slow", "start", "seed", "on"), [
    (6, -0.9, 1, (1,)), (14, 1.0, 2, (0, 1, 2))])
def test_the_start_of_play_is_no_event(slow: int, start: float, seed: int, on: tuple[int, ...],
                                       tmp_path: Path) -> None:
    """Play alone, with its width; the rows that are left out are told with the reason."""
    campaign(tmp_path, slow, start, seed, on)
    found = ppmcal.diagnose(CONFIG, [tmp_path / "d.csv"])
    record: Any = found.record
    assert record.verdict == "named"
    assert [e.kind for e in record.effects] == ["play"]
    width = record.effects[0].parameters["width"]
    assert abs(width.value - WIDTH) < 4.0 * width.sigma
    assert any("rows left out" in f for f in record.findings)
    gone = left_out(found, tmp_path)
    # of the first row no direction is known, so that it is out already
    assert gone == list(range(2, gone[-1] + 1))
    assert slow <= gone[-1] <= slow + 6


@pytest.mark.long
def test_rows_whose_start_is_known_are_kept(tmp_path: Path) -> None:
    """The first move is shorter than the play, the second one longer."""
    campaign(tmp_path, 0, 0.9, 1, (1,))
    found = ppmcal.diagnose(CONFIG, [tmp_path / "d.csv"])
    assert [e.kind for e in found.record.effects] == ["play"]
    assert left_out(found, tmp_path) == [2]


@pytest.mark.long
def test_where_a_play_stood_before_the_first_row_is_no_cause_of_its_own(tmp_path: Path) -> None:
    """The play says it by itself: nothing happened, and no row is left out."""
    campaign(tmp_path, 20, 1.0, 1, (1,))
    mechanism, data = prepared(CONFIG, [tmp_path / "d.csv"])
    fit = identify(with_whole_rows(Problem(mechanism, data, mechanism.free)), FitOptions())
    found = explained(fit, FitOptions())[-1]
    assert [p.label for p in found.places] == ["play on leg2"]
    assert found.verdict == "named" and not found.rows
