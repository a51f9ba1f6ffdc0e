"""Effects of a direction that one file of a campaign records and the others do not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from controllers.test_printer_import import MEANT, REAL, config, down, written
from helpers.commands import ppmcal

from ppmcal import import_config
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.unknown_directions import with_unknown_directions
from ppmcal.controllers.delta.importer import files
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.kinematics.effect_response import environment_of

WIDTH = 0.08
EFFECTS = ("effects: [{kind: backlash, on: [a, b, c], parameters: "
           "{width: {value: %g, tolerance: 1, free: true}}}]\n")


def campaign(folder: Path) -> Path:
    """Heights and distances without directions; a bed of 9 by 9 touches, to and fro, with them.

    Every carriage comes from the side of dir_x with half a backlash.
    """
    folder.mkdir()
    found = import_config("klipper", written(folder, config(MEANT, pairs=1.0, noise=0.01)))
    texts = files(found.imported.printer, "fixed")
    for name in ("machine.yaml", "heights.csv", "heights.yaml", "distances.csv", "distances.yaml"):
        (folder / name).write_text(texts[name])
    rng = np.random.default_rng(3)
    side = np.linspace(-80.0, 80.0, 9)
    x, y = (v.ravel() for v in np.meshgrid(side, side))
    way = np.where(rng.random(81) < 0.5, 1.0, -1.0)
    q = down(REAL, np.column_stack([x, y, rng.normal(0.0, 0.01, 81)]))
    rows = np.column_stack([np.zeros(81), q + 0.5 * WIDTH * way[:, None], way, way, way])
    np.savetxt(folder / "bed.csv", rows, delimiter=",", comments="", fmt="%.6f",
               header="height,q_a,q_b,q_c,dir_a,dir_b,dir_c")
    (folder / "bed.yaml").write_text(texts["heights.yaml"].replace("name: heights", "name: bed"))
    return folder


FILES = ("heights.csv", "distances.csv", "bed.csv")


@pytest.mark.slow
def test_a_backlash_is_tried_in_the_rows_that_know_their_direction(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "p")
    machine = read_mechanism(folder / "machine.yaml")
    data = read_campaign([folder / f for f in FILES], machine)
    fit = identify(with_whole_rows(Problem(machine, data, machine.free)), FitOptions())
    system = build(fit.problem, fit.state, fit.keep)
    found = library(system, ["backlash"])
    assert {h.on for h in found.hypotheses} == {("a",), ("b",), ("c",), ("a", "b", "c")}
    assert not found.untestable
    for at in found.hypotheses[0].columns:
        column = found.products.some([at])[..., 0]
        known = np.array([system.problem.datasets[d].name == "bed" for d in system.dataset])
        assert np.all(column[~known] == 0.0) and np.all(column[known, 0] != 0.0)


@pytest.mark.long
def test_a_backlash_is_named_though_two_of_three_files_know_no_direction(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "p")
    run = ppmcal("diagnose", "machine.yaml", *FILES, "--kind", "backlash", "--seed", "7", "--out",
                 "d", cwd=folder)
    assert run.code in (0, 1), run.err
    found = json.loads((folder / "d" / "diagnosis.json").read_text())
    assert [e["kind"] for e in found["effects"]] == ["backlash"]
    (told,) = [f for f in found["findings"] if "direction of approach" in f]
    total = sum(len((folder / f).read_text().splitlines()) - 1 for f in FILES)
    assert told == (f"effects of the direction of approach are tested on 81 of {total} rows: "
                    "dir_a, dir_b, dir_c are not recorded in heights and distances")
    assert "backlash" not in {u["kind"] for u in found["not_testable"]}
    # what was named is fitted to the same files by the command that comes next
    again = ppmcal("identify", "d/model.yaml", *FILES, "--out", "i", cwd=folder)
    assert again.code in (0, 1), again.err


@pytest.mark.slow
def test_a_side_that_is_not_known_is_noise_of_the_joint(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "p")
    text = (folder / "machine.yaml").read_text()
    (folder / "with.yaml").write_text(text + EFFECTS % WIDTH)
    machine = read_mechanism(folder / "with.yaml")
    data = read_campaign([folder / f for f in FILES], machine)
    data = with_unknown_directions(machine, data, [environment_of(machine, d) for d in data])
    noise = Problem(machine, data, machine.free).sigma_joints
    for d, sigma in zip(data, noise, strict=True):
        # the drives count downwards, and in mm
        assert sigma == pytest.approx(np.full(3, 0.0 if d.name == "bed" else 0.5 * WIDTH))


def test_a_file_alone_still_has_to_say_the_direction(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "p")
    text = (folder / "machine.yaml").read_text()
    (folder / "with.yaml").write_text(text + EFFECTS % WIDTH)
    run = ppmcal("identify", "with.yaml", "heights.csv", "--out", "i", cwd=folder, expect=2)
    assert "depend on dir_a" in " ".join(run.err.split())
