"""compensate and export on the command line: refused as a whole, or row by row, with exit codes."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest
import yaml
from helpers.commands import number, ppmcal, rows
from helpers.paths import ROOT

SAMPLE = ROOT / "sample_data"
SCENARIO = """
format: ppmcal/scenario/1
units: {length: mm, angle: deg}
poses: {random: {center: {x: 500, y: 290, rz: 30}, half_range: {x: 60, y: 60, rz: 8}, count: 40}}
errors: {random: {scale: 1.0}}
effects: [EFFECT]
instrument: {kind: pose, sigma: {position: 0.005, rotation: 0.001}}
approach: both
seed: 5
"""
TARGETS = "x,y,rz\n480,280,28\n490,285,29\n505,290,30\n520,300,32\n"

pytestmark = pytest.mark.slow
LINES = [["compensate", "MODEL", "targets.csv", "--frame", "base"],
         ["export", "grid", "MODEL"], ["export", "joints", "MODEL"]]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A 3-RPR machine: calibrated well, and by data of which it misses a lot (backlash)."""
    folder = tmp_path_factory.mktemp("bench")
    shutil.copy(ROOT / "configs" / "3-RPR.yaml", folder / "m.yaml")
    (folder / "targets.csv").write_text(TARGETS)
    for name, effect in (("good", ""), ("bad", "{kind: backlash, parameters: {width: 0.3}}")):
        (folder / f"{name}.yaml").write_text(SCENARIO.replace("EFFECT", effect))
        ppmcal("simulate", "m.yaml", f"{name}.yaml", "--out", f"s_{name}", cwd=folder, expect=0)
        run = ppmcal("identify", "m.yaml", f"s_{name}/measurements.csv", "--out", name, cwd=folder)
        assert run.code in (0, 1), run.err
    return folder


def block(path: Path) -> dict[str, object]:
    found: dict[str, object] = yaml.safe_load(path.read_text())["measurement"]
    return found


def test_a_model_file_says_how_well_it_fits_and_what_was_measured(bench: Path) -> None:
    good, bad = (block(bench / n / "identified.yaml") for n in ("good", "bad"))
    noise = json.loads((bench / "bad/identification.json").read_text())["noise"]
    assert bad["noise"] == {"sigma_ratio": noise["sigma_ratio"], "chi2_p": noise["chi2_p"]}
    assert 0.5 < good["noise"]["sigma_ratio"] < 1.5     # type: ignore[index]
    assert noise["sigma_ratio"] > 5.0
    volume = json.loads((bench / "good/identification.json").read_text())["measured_volume"]
    ranges = good["ranges"]
    for name, ends in volume.items():
        assert ranges[name] == pytest.approx(ends)      # type: ignore[index]
    with (bench / "s_good/measurements.csv").open(newline="") as file:
        joint = [float(r["q_leg2"]) for r in csv.DictReader(file)]
    assert ranges["q_leg2"] == pytest.approx([min(joint), max(joint)])  # type: ignore[index]


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("copied", [False, True], ids=["folder", "yaml alone"])
def test_a_model_that_misses_its_data_is_refused_with_exit_3(bench: Path, tmp_path: Path,
                                                             line: list[str], copied: bool) -> None:
    model = bench / "bad"
    if copied:
        model = tmp_path / "machine.yaml"
        shutil.copy(bench / "bad" / "identified.yaml", model)
    args = [str(model) if a == "MODEL" else a for a in line]
    run = ppmcal(*args, "--out", str(tmp_path / "o"), cwd=bench, expect=3)
    said = " ".join(run.err.split())
    assert "does not fit its own calibration data" in said
    assert "times the noise" in said and "--regardless" in said and "--sigma estimated" in said
    assert not (tmp_path / "o").exists()
    # replacing files lifts nothing, and --force was both
    ppmcal(*args, "--out", str(tmp_path / "o"), "--overwrite", cwd=bench, expect=3)
    run = ppmcal(*args, "--out", str(tmp_path / "o"), "--force", cwd=bench, expect=2)
    assert "--overwrite replaces files" in " ".join(run.err.split())
    run = ppmcal(*args, "--out", str(tmp_path / "o"), "--regardless", cwd=bench, expect=1)
    assert "--regardless" in run.out
    assert (tmp_path / "o").exists()


def test_the_file_beside_says_it_of_older_models(bench: Path, tmp_path: Path) -> None:
    shutil.copytree(bench / "bad", tmp_path / "old")
    path = tmp_path / "old" / "identified.yaml"
    tree = yaml.safe_load(path.read_text())
    for name in ("noise", "ranges", "converged"):
        del tree["measurement"][name]
    path.write_text(yaml.safe_dump(tree))
    ppmcal("compensate", tmp_path / "old", "targets.csv", "--frame", "base", "--out",
           tmp_path / "o", cwd=bench, expect=3)
    path.rename(tmp_path / "alone.yaml")     # then nobody knows
    run = ppmcal("compensate", tmp_path / "alone.yaml", "targets.csv", "--frame", "base", "--out",
                 tmp_path / "o", cwd=bench, expect=0)
    assert "uncertainties are unknown" in " ".join(run.out.split())


@pytest.fixture(scope="module")
def unfinished(bench: Path) -> Path:
    """The model of a fit that was stopped after one step, though it fits its data well."""
    run = ppmcal("identify", "m.yaml", "s_good/measurements.csv", "--keep-outliers",
                 "--iterations", "1", "--out", "unfinished", cwd=bench, expect=1)
    assert "had not converged" in run.out
    assert block(bench / "unfinished/identified.yaml")["converged"] is False
    return bench / "unfinished"


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("known_by", ["folder", "yaml alone", "older folder"])
def test_a_model_whose_fit_had_not_converged_is_refused_with_exit_3(
        bench: Path, unfinished: Path, tmp_path: Path, line: list[str], known_by: str) -> None:
    model = tmp_path / "machine.yaml"
    if known_by == "yaml alone":
        shutil.copy(unfinished / "identified.yaml", model)
    else:
        model = tmp_path / "model"
        shutil.copytree(unfinished, model)
    if known_by == "older folder":      # whose model file does not say it
        path = model / "identified.yaml"
        path.write_text(path.read_text().replace("converged: false", ""))
    args = [str(model) if a == "MODEL" else a for a in line]
    run = ppmcal(*args, "--out", str(tmp_path / "o"), cwd=bench, expect=3)
    said = " ".join(run.err.split())
    assert "the fit of this model did not converge" in said and "--iterations" in said
    assert str(model) in run.err.replace("\n", "") and "--regardless" in said
    assert not (tmp_path / "o").exists()
    run = ppmcal(*args, "--out", str(tmp_path / "o"), "--regardless", cwd=bench, expect=1)
    assert "did not converge" in " ".join(run.out.split())


@pytest.mark.parametrize(("more", "code"), [([], 0), (["--iterations", "2"], 3)])
def test_a_damped_fit_is_taken_that_ended_at_the_noise(bench: Path, tmp_path: Path,
                                                       more: list[str], code: int) -> None:
    run = ppmcal("identify", "m.yaml", "s_good/measurements.csv", "--method", "damped", *more,
                 "--out", tmp_path / "i", cwd=bench, expect=1)
    assert "the fit was stopped" in run.out
    ppmcal("compensate", tmp_path / "i", "targets.csv", "--frame", "base", "--out",
           tmp_path / "o", cwd=bench, expect=code)


def test_noise_that_was_stated_too_small_is_mended_as_the_message_says(bench: Path, tmp_path: Path
                                                                      ) -> None:
    ppmcal("identify", "m.yaml", "s_bad/measurements.csv", "--sigma", "estimated", "--out",
           tmp_path / "i", cwd=bench)
    run = ppmcal("compensate", tmp_path / "i", "targets.csv", "--frame", "base", "--out",
                 tmp_path / "o", cwd=bench)
    assert run.code in (0, 1)
    for row in rows(tmp_path / "o" / "commands.csv"):
        if row["status"] == "ok":
            assert number(row, "sigma_position") < number(row, "error_position_before")


def test_a_row_that_is_off_the_path_is_refused_and_the_path_goes_on(bench: Path, tmp_path: Path
                                                                   ) -> None:
    """Limits that a straight way leaves, though both its ends are inside."""
    tree = yaml.safe_load((bench / "good" / "identified.yaml").read_text())
    targets = tmp_path / "t.csv"
    targets.write_text("x,y,rz\n510,236,30\n490,344,30\n510,236,30\n")
    ppmcal("compensate", bench / "good", targets, "--frame", "base", "--out", tmp_path / "a",
           cwd=bench, expect=0)
    joint = [number(r, "q_leg1") for r in rows(tmp_path / "a" / "commands.csv")]
    targets.write_text("x,y,rz\n500,290,30\n")
    ppmcal("compensate", bench / "good", targets, "--frame", "base", "--out", tmp_path / "a",
           cwd=bench, expect=0)
    low = number(rows(tmp_path / "a" / "commands.csv")[0], "q_leg1")
    assert low < min(joint)
    tree["limits"]["leg1"][0] = (low + min(joint)) / 2.0
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree))
    shutil.copy(bench / "good" / "identification.json", tmp_path)
    targets.write_text("x,y,rz\n510,236,30\n490,344,30\n510,236,30\n510,238,30\n")
    run = ppmcal("compensate", tmp_path / "m.yaml", targets, "--frame", "base", "--out",
                 tmp_path / "b", cwd=bench, expect=1)
    found = rows(tmp_path / "b" / "commands.csv")
    assert [r["status"] for r in found] == ["ok", "refused", "ok", "ok"]
    assert found[1]["q_leg1"] in ("", "nan") and found[1]["cmd_x"] in ("", "nan")
    assert "the straight way from row 1 leaves the limits: leg1" in found[1]["reason"]
    assert "row 2 refused" in run.out
    ppmcal("compensate", tmp_path / "m.yaml", targets, "--frame", "base", "--no-path", "--out",
           tmp_path / "c", cwd=bench, expect=0)


@pytest.mark.parametrize(("given", "words"), [
    (["temperature"], "NAME=VALUE"), (["temperature=warm"], "NAME=VALUE"),
    (["temperature=nan"], "NAME=VALUE"), (["payload=1", "--assume", "payload=2"], "already"),
    (["colour=3"], "colour"), (["payload=-1"], "negative"), (["dir_leg1=0.5"], "direction")])
def test_what_cannot_be_assumed_is_refused(bench: Path, given: list[str], words: str) -> None:
    run = ppmcal("compensate", "good", "targets.csv", "--frame", "base", "--assume", *given,
                 cwd=bench, expect=2)
    assert words in run.err
    assert "Traceback" not in run.err


def test_targets_beyond_all_reason_have_no_command(bench: Path) -> None:
    far = "1e10,285,29\n490,285,1e6\n"
    (bench / "far.csv").write_text("x,y,rz\n490,285,29\n" + far)
    run = ppmcal("compensate", "good", "far.csv", "--out", "far", cwd=bench)
    assert run.code == 1
    found = rows(bench / "far/commands.csv")
    assert [r["status"] for r in found] == ["ok", "refused", "refused"]
    assert all(r[f"q_leg{i}"] == "nan" for r in found[1:] for i in (1, 2, 3))
    assert "reach away" in found[1]["reason"] and "turns" in found[2]["reason"]


def test_uncertainties_of_another_calibration_are_not_taken_for_the_model_s(bench: Path) -> None:
    shutil.copytree(bench / "good", bench / "edited")
    model = bench / "edited/identified.yaml"
    tree = yaml.safe_load(model.read_text())
    tree["limbs"][0]["offset"]["value"] += 50.0
    model.write_text(yaml.safe_dump(tree, sort_keys=False))
    run = ppmcal("compensate", "edited", "targets.csv", "--out", "of_edited", cwd=bench)
    said = " ".join((run.out + run.err).split())
    assert "leg1.offset is" in said and "uncertainties are unknown" in said
    assert {r["sigma_position"] for r in rows(bench / "of_edited/commands.csv")} == {"nan"}
    run = ppmcal("kinematics", "inverse", "edited/identified.yaml", "targets.csv",
                 "--out", "joints", cwd=bench)
    assert "file's sigmas, as if" in " ".join(run.out.split())


@pytest.mark.long
def test_the_measurements_of_a_fit_are_no_test_of_it(bench: Path) -> None:
    data = "s_good/measurements.csv"
    run = ppmcal("identify", "m.yaml", data, "--holdout", data, "--out", "no", cwd=bench)
    assert run.code == 2 and "equal within its digits" in run.err
    run = ppmcal("validate", "good", data, "--out", "again", cwd=bench)
    assert run.code == 1
    assert f"{data}: the model was fitted to these" in " ".join((run.out + run.err).split())
    other = (bench / "good.yaml").read_text().replace("seed: 5", "seed: 6")
    (bench / "other.yaml").write_text(other)
    ppmcal("simulate", "m.yaml", "other.yaml", "--out", "s_other", cwd=bench, expect=0)
    run = ppmcal("validate", "good", "s_other/measurements.csv", "--out", "fresh", cwd=bench)
    assert "was fitted to" not in run.out + run.err
