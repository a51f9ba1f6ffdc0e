"""What a machine was before: one definition, the same figure in every command, to the digit."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import columns, ppmcal
from helpers.paths import ROOT

import ppmcal as face
from ppmcal.calibration.validation.nominal_machine import DEFINITION, before

CONFIGS = ROOT / "configs"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A planar machine with errors and backlash in one leg, measured in an unknown frame."""
    folder = tmp_path_factory.mktemp("bench")
    shutil.copy(CONFIGS / "3-RPR.yaml", folder / "m.yaml")
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": {"x": 500, "y": 288.675, "rz": 30}, "half_range": {
                    "x": 60, "y": 60, "rz": 8}, "count": 30}},
                "errors": {"random": {"scale": 1.0}}, "seed": 3, "approach": "both",
                "effects": [{"kind": "backlash", "on": ["leg2"], "parameters": {"width": 0.06}}],
                "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
                "frame": {"x": 4, "y": -3, "rz": 1}, "target": [3, -2]}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=folder, expect=0)
    return folder


@pytest.mark.long
def test_it_is_the_same_in_every_command(bench: Path) -> None:
    """Of the nominal machine: neither the fit's start nor effects that it found are in it."""
    data = bench / "s" / "measurements.csv"
    plain = face.identify(bench / "m.yaml", data)
    found = face.diagnose(bench / "m.yaml", data, kinds=["backlash"])
    assert found.verdict == "named"
    again = face.identify(plain.mechanism, data)    # starts where the first one ended
    one, other, third = (r.record.entries() for r in (plain, found, again))
    stages = one["residual"]
    assert other["residual"]["before"] == stages["before"] == third["residual"]["before"]
    assert stages["before_is"] == other["residual"]["before_is"] == DEFINITION
    assert stages["before"]["position"]["rms"] > 3.0 * stages["after"]["position"]["rms"]
    assert other["residual"]["geometry"]["position"]["rms"] == pytest.approx(
        stages["after"]["position"]["rms"], rel=0.05)
    of_batch: list[dict[str, Any]] = []
    for result in (plain, found):
        of_batch.append({q.name: q.value for q in result.quantities()
                         if (q.what, q.parameter) == ("error", "before")})
    assert of_batch[0] == of_batch[1] == {k: v["rms"] for k, v in stages["before"].items()}


@pytest.mark.long
def test_console_and_files_say_it(bench: Path, tmp_path: Path) -> None:
    told = []
    for command, more in (("identify", []), ("diagnose", ["--kind", "backlash"])):
        run = ppmcal(command, bench / "m.yaml", bench / "s" / "measurements.csv", *more, "--out",
                     tmp_path / command)
        said = " ".join(run.out.split())
        assert f'"Before" is {DEFINITION}.' in said
        record = json.loads((tmp_path / command / "identification.json").read_text())
        told.append(f"{record['residual']['before']['position']['rms']:.4g}")
        assert told[-1] in said
    assert told[0] == told[1]
    assert "geometry_x" in columns(tmp_path / "diagnose" / "residuals.csv")
    assert "geometry_x" not in columns(tmp_path / "identify" / "residuals.csv")


@pytest.mark.long
def test_rows_that_are_not_in_use_do_not_place_the_instrument(bench: Path) -> None:
    """A gross error has a residual, and no say in where the frame stands."""
    found = face.identify(bench / "m.yaml", bench / "s" / "measurements.csv").identification
    problem = found.fit.problem
    keep = [np.ones(len(d), dtype=bool) for d in problem.datasets]
    keep[0][4] = False
    moved = problem.datasets[0].position.copy()
    moved[4] += 0.05
    wrong = type(problem)(problem.mechanism, (type(problem.datasets[0])(**{
        **vars(problem.datasets[0]), "position": moved}),), problem.free)
    clean = type(problem)(problem.mechanism, problem.datasets, problem.free)
    name = problem.datasets[0].name
    one, other = (before(p, keep) for p in (clean, wrong))
    np.testing.assert_allclose(one.registrations[name].frame, other.registrations[name].frame,
                               atol=1e-9)
    assert other.residuals.position[0][4] > one.residuals.position[0][4] + 0.05
