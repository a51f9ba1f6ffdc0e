"""What an export promises: never less than what the model itself does not know."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.paths import ROOT
from helpers.report_files import html_of

from ppmcal.calibration.compensation.commands import compensate
from ppmcal.controllers import loaded
from ppmcal.controllers.export import pose_uncertainty
from ppmcal.io import read_mechanism
from ppmcal.io.results.export import ExportRecord
from ppmcal.io.results.knowledge import read_knowledge
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.report.exported import export_section
from ppmcal.report.records import Held

CONFIGS = ROOT / "configs"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A planar machine identified from a few rows, in an unknown frame."""
    folder = tmp_path_factory.mktemp("model")
    shutil.copy(CONFIGS / "3-RPR.yaml", folder / "m.yaml")
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": {"x": 500, "y": 288.675, "rz": 30}, "half_range": {
                    "x": 60, "y": 60, "rz": 8}, "count": 20}},
                "errors": {"random": {"scale": 1.0}}, "seed": 3,
                "instrument": {"kind": "pose", "sigma": {"position": 0.02, "rotation": 0.004}},
                "frame": {"x": 4, "y": -3, "rz": 1}, "target": [3, -2]}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=folder, expect=0)
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=folder)
    return folder / "i" / "identified.yaml"


def exported(model: Path, out: Path, form: str = "grid") -> tuple[dict[str, Any], str]:
    """Return export.json and what was said."""
    run = ppmcal("export", form, model, "--out", out)
    return json.loads((out / "export.json").read_text()), " ".join(run.out.split())


@pytest.mark.slow
def test_the_models_own_uncertainty_is_in_the_prediction(model: Path, tmp_path: Path) -> None:
    """That of `compensate` at the same poses in the frame of the only data set."""
    found, said = exported(model, tmp_path / "o")
    told = found["predicted"]
    mechanism = read_mechanism(model)
    knowledge = read_knowledge(model.with_name("identification.json"), mechanism)
    poses = loaded("grid").export(mechanism, None, None).poses
    (name, registration), = mechanism.registrations.items()
    wanted = measured_pose(registration, pose_motor(poses))
    wide = replace(knowledge, volume={})
    sigma = compensate(mechanism, wanted, registration, wide, name)
    for key, values, factor in (("position", sigma.sigma_position, 1e3),
                                ("rotation", sigma.sigma_rotation, 180.0 / np.pi)):
        parts = {k: v if key == "position" else v["rotation"] for k, v in told.items()}
        own = factor * np.sqrt(np.mean(values**2))
        assert parts["model"]["rms"] == pytest.approx(own, rel=1e-6)
        assert parts["after"]["rms"] == pytest.approx(
            np.hypot(own, parts["format"]["rms"]), rel=1e-6)
        assert parts["after"]["unit"] == ("mm" if key == "position" else "deg")
    assert told["model"]["frame"] == name
    assert told["format"]["rms"] == pytest.approx(found["gain"]["after"]["rms"])
    assert told["after"]["rms"] > 1e-3
    assert f"{told['model']['rms']:.2g} mm" in said
    assert f"in the frame of {name}" in said
    page = html_of(export_section(Held("o", ExportRecord.checked(found))))
    assert f"in the frame of {name}" in page
    assert str(model.with_name("identification.json")) in found["provenance"]["inputs"]


@pytest.mark.slow
def test_what_is_not_known_is_not_promised(model: Path, tmp_path: Path) -> None:
    """Without the identification beside it there is no figure, and no 0.0000 either."""
    alone = tmp_path / "identified.yaml"
    shutil.copy(model, alone)
    found, said = exported(alone, tmp_path / "o")
    assert found["predicted"]["after"]["rms"] is None
    assert found["predicted"]["model"]["rms"] is None
    assert "identification.json is not beside the model" in found["predicted"]["model"]["reason"]
    section = export_section(Held("o", ExportRecord.checked(found)))
    for text in (said, html_of(section)):
        assert "unknown, as identification.json is not beside the model" in text
        assert "Predicted error with the new" not in text


@pytest.mark.slow
def test_targets_of_one_body_are_in_one_frame(model: Path) -> None:
    """Of several marks that one instrument measured the first counts, and not the base axes."""
    mechanism = read_mechanism(model)
    poses = loaded("grid").export(mechanism, None, None).poses
    (name, registration), = mechanism.registrations.items()
    two = replace(mechanism, registrations={name: registration, "other": registration})
    own, both = (pose_uncertainty(m, poses) for m in (mechanism, two))
    assert (own.frame, both.frame) == (name, name)
    assert own.position == both.position is not None


@pytest.mark.slow
def test_the_promise_before_is_that_of_an_uncorrected_command(model: Path, tmp_path: Path) -> None:
    """Where the instrument was taken to stand by the nominal geometry, as `compensate` has it.

    In base axes, which only tolerances hold, the same numbers look several times as bad.
    """
    mechanism = read_mechanism(model)
    knowledge = read_knowledge(model.with_name("identification.json"), mechanism)
    made = loaded("grid").export(mechanism, None, None)
    (name, stands), = mechanism.registrations.items()
    wanted = measured_pose(knowledge.before[name], made.before.wanted)
    asked = compensate(mechanism, wanted, stands, replace(knowledge, volume={}), name)
    seen = made.before.seen(stands, knowledge.before[name])
    assert seen.rms == pytest.approx(np.sqrt(np.mean(asked.position_before**2)))
    assert seen.rotation_rms == pytest.approx(np.sqrt(np.mean(asked.rotation_before**2)))
    assert made.before.rms > 2.0 * seen.rms
    told = json.loads(model.with_name("identification.json").read_text())["residual"]["before"]
    assert 1e3 * seen.rms == pytest.approx(told["position"]["rms"], rel=0.5)
    # of tables, whose poses are in base axes, errors are there
    found, said = exported(model, tmp_path / "table")
    assert found["gain"]["before"]["rms"] == pytest.approx(1e3 * made.before.rms)
    assert "of the mark" not in said
    found, said = exported(model, tmp_path / "numbers", "mjcf")
    base = loaded("mjcf").export(mechanism, None, None).before
    own = found["gain"]["before"]["rms"]
    assert own == pytest.approx(1e3 * base.seen(stands, knowledge.before[name]).rms)
    assert f"of the mark that {name} measured" in said and own < 0.5e3 * base.rms
