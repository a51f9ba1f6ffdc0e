"""Distances with a tool, a fixed point or a unit stated wrongly: that is named, not geometry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import MARKS, machine, measured, turned
from helpers.campaigns_in_files import refusal

import ppmcal as package
from ppmcal.calibration.fit import Problem

POINTS = {"ball1": (150.0, 80.0), "ball2": (900.0, 150.0), "ball3": (480.0, 700.0)}


def campaign(folder: Path, target: tuple[float, float], points: dict[str, object]) -> Problem:
    """Return distances of mark T1 from three points; ``target``, ``points``: as stated."""
    seen = measured(5, slots=("offset",))
    machine(folder)
    at = seen.poses[:, :2] + (turned(seen.poses[:, 2]) @ np.array(MARKS["T1"]))
    noise = np.random.default_rng(1).normal(size=(3, len(at))) * 0.01
    for (name, point), scatter in zip(POINTS.items(), noise, strict=True):
        rows = np.column_stack([seen.q, np.linalg.norm(at - point, axis=1) + scatter])
        (folder / f"{name}.csv").write_text("q_leg1,q_leg2,q_leg3,distance\n" + "\n".join(
            ",".join(f"{v:.6f}" for v in row) for row in rows.tolist()) + "\n")
        (folder / f"{name}.yaml").write_text(
            f"format: ppmcal/dataset/1\nname: {name}\nunits: {{length: mm, angle: deg}}\n"
            "instrument: {kind: distance, sigma: {distance: 0.01}, "
            f"point: {points.get(name, list(point))}}}\nframe: known\ntarget: {list(target)}\n")
    bench = package.load(folder / "bench.yaml")
    data = tuple(package.read_data(bench, *(folder / f"{name}.csv" for name in POINTS)))
    return Problem(bench, data, bench.free)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [(40.0, 15.0), (60.0, -15.0)])
def test_a_target_stated_wrongly_in_all_files_is_named_once(
        tmp_path: Path, stated: tuple[float, float]) -> None:
    found = refusal(campaign(tmp_path, stated, {}))
    assert found is not None
    assert found.what.count("the measured point is not where the sidecar puts it") == 1
    assert "not at ({:g}, {:g}, 0) mm".format(*stated) in found.what
    assert found.hint == "Write into the sidecar: `target: unknown`"
    x, y = (float(v) for v in found.what.split("comes out at (")[1].split(",")[:2])
    assert np.hypot(x - MARKS["T1"][0], y - MARKS["T1"][1]) < 1.0


@pytest.mark.slow
def test_a_point_with_the_other_sign_is_named(tmp_path: Path) -> None:
    found = refusal(campaign(tmp_path, MARKS["T1"], {"ball2": [900, -150]}))
    assert found is not None and "ball2.csv" in found.where and "ball1" not in found.where
    assert "the fixed point is not where the sidecar puts it" in found.what
    assert found.hint == "Write into the sidecar: `instrument: {point: unknown}`"


@pytest.mark.slow
def test_exchanged_files_are_named(tmp_path: Path) -> None:
    found = refusal(campaign(tmp_path, MARKS["T1"], {"ball1": list(POINTS["ball2"]),
                                                     "ball2": list(POINTS["ball1"])}))
    assert found is not None and found.what.count("exchanged files?") == 2


def test_right_files_are_taken(tmp_path: Path) -> None:
    assert refusal(campaign(tmp_path, MARKS["T1"], {})) is None
    assert refusal(campaign(tmp_path, MARKS["T1"], dict.fromkeys(POINTS, "unknown"))) is None


@pytest.mark.parametrize(("unit", "word", "wrong"), [
    ("cm", "cm", ["ball2"]), ("in", "inches", list(POINTS))])
def test_distances_in_another_unit_are_named(tmp_path: Path, unit: str, word: str,
                                             wrong: list[str]) -> None:
    problem = campaign(tmp_path, MARKS["T1"], {})
    size = {"cm": 10.0, "in": 25.4}[unit]
    found = refusal(replace(problem, datasets=tuple(
        replace(d, value=d.value / size) if d.name in wrong else d for d in problem.datasets)))
    assert found is not None and f"distance is in {word}, not mm" in found.what
    assert [m.block for m in found.found] == [{"units": {"distance": unit}}] * len(wrong)
