"""Campaigns of the independent generator that were once diagnosed wrongly, or in minutes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import ppmcal, rows
from wild.catalogue import write

from ppmcal import compensate, diagnose, identify
from ppmcal.calibration.interpretation.interpretation_error import InterpretationError
from ppmcal.commands.diagnose.run import DiagnosisResult


def diagnosed(folder: Path, case: str, machine: str, seed: int) -> DiagnosisResult:
    write(case, machine, 120, seed, folder)
    return diagnose(folder / "mechanism.yaml", [folder / "data.csv"])


def told(found: DiagnosisResult) -> set[tuple[str, float]]:
    """Kinds of the events that were named, with their rows."""
    return {(e["kind"], e["parameters"]["from_row"]["value"])
            for e in found.record.entries()["effects"]}


@pytest.mark.long
def test_typos_do_not_pull_the_fit_of_the_training_rows_away(tmp_path: Path) -> None:
    """Joints and positions typed wrong in six rows: only those are out, and nothing is there."""
    truth = write("gross-5", "delta-rotary", 120, 313442, tmp_path)
    found = diagnose(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    assert found.record.verdict == "none"
    assert found.record.ratio_after < 1.2
    (training,) = found.diagnosis.found.before.reasons
    wrong = set(truth["mistakes"][0]["indices"])
    assert len(training) <= len(wrong)


@pytest.mark.long
def test_events_with_their_rows(tmp_path: Path) -> None:
    """A zero that moves there and back, which makes rows look correlated."""
    found = told(diagnosed(tmp_path, "homed-there-and-back", "3-RPR", 220423))
    assert {k for k, _ in found} == {"zero_shift"}
    assert all(min(abs(row - at) for _, at in found) <= 2 for row in (40, 70))


@pytest.mark.long
@pytest.mark.parametrize(("case", "machine", "seed"), [
    ("base-sways", "hexapod", 186372), ("leg-settles", "delta-rotary", 504336)])
def test_what_wanders_in_time_is_no_row_of_events(tmp_path: Path, case: str, machine: str,
                                                  seed: int) -> None:
    """A stand that sways, a leg that settles: two or three steps make it up."""
    found = diagnosed(tmp_path, case, machine, seed).record
    assert found.verdict == "unnamed"
    assert found.unknown and all(u.looks_like.startswith(("a slow drift", "a start-up transient"))
                                 for u in found.unknown)


@pytest.mark.long
def test_what_would_shrink_with_heat_gives_way_to_what_grows(tmp_path: Path) -> None:
    """No expansion is below 0, of each joint neither: these legs look like a base that shrinks."""
    truth = write("leg-heat-late", "3-RPR", 120, 340698, tmp_path)["effects"][0]["parameters"]
    found = diagnose(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    assert found.verdict in ("named", "named-set")
    assert {e.kind for e in found.diagnosis.effects} == {"leg_thermal"}
    for named in found.record.entries()["effects"]:
        expansion = named["parameters"]["expansion"]
        assert abs(expansion["value"] - truth["expansion"]) < 4.0 * expansion["sigma"]
        assert expansion["sigma"] < 0.2 * truth["expansion"]


@pytest.mark.slow
def test_directions_that_are_inverted_in_a_part_of_the_rows(tmp_path: Path) -> None:
    with pytest.raises(InterpretationError) as refused:
        diagnosed(tmp_path, "approach-half-inverted", "3-RPR", 2)
    ((mistake,),) = (f.mistakes for f in refused.value.found)
    assert mistake.kind == "sign"
    assert mistake.columns[0].startswith("dir_")
    assert mistake.rows[0] <= 3
    assert abs(mistake.rows[-1] - 48) <= 3
    assert "the opposite sign to the other rows" in str(refused.value)


@pytest.mark.long
def test_what_follows_the_last_move_is_learned(tmp_path: Path) -> None:
    """Joints that stop short by a part of their move: in no library, and it comes back in order."""
    found = diagnosed(tmp_path, "shortfall", "delta-rotary", 266676)
    assert found.record.verdict == "unnamed"
    (term,) = found.record.entries()["learned"]
    assert term["input"] == "last move"
    assert term["gap"]["before"] > 1.4
    assert term["gap"]["after"] < 1.1
    # a share of the move, and so much of it as was hidden
    (part,) = term["equation"]["terms"]
    (factor,) = part["factors"]
    assert (factor["variable"], factor["form"], factor["degree"]) == ("move", "power", 1)
    (hidden,) = json.loads((tmp_path / "truth.json").read_text())["effects"]
    away = part["size"] / factor["scale"] + hidden["parameters"]["share"]
    assert abs(away) < 3.0 * part["sigma"] / factor["scale"]
    found.save(tmp_path / "d")
    ppmcal("check", "d/model.yaml", cwd=tmp_path, expect=0)
    targets = tmp_path / "wanted.csv"
    targets.write_text("".join(",".join(line.split(",")[4:7]) + "\n" for line in
                               (tmp_path / "data.csv").read_text().splitlines()))
    ppmcal("compensate", "d/model.yaml", targets, "--out", "c", cwd=tmp_path, expect=2)
    ppmcal("compensate", "d/model.yaml", targets, "--approach", "sequence", "--out", "c",
           cwd=tmp_path, expect=None)
    status = [r["status"] for r in rows(tmp_path / "c" / "commands.csv")]
    assert status.count("ok") > 0.8 * len(status)


@pytest.mark.long
def test_commands_through_a_stretch_that_the_model_misses_say_so(tmp_path: Path) -> None:
    """A worn place of a screw, 0.7 mm deep, that eight of 120 rows met: they were left out."""
    write("wear", "delta-linear", 120, 1003949, tmp_path, 2.0)
    found = identify(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    (stretch,) = found.identification.doubtful
    assert stretch.actuator == "leg2"
    found.save(tmp_path / "d")
    poses = [line.split(",") for line in (tmp_path / "data.csv").read_text().splitlines()]
    place = {c: poses[0].index(c) for c in ("x", "y", "z", "q_leg2")}
    joint = np.array([float(p[place["q_leg2"]]) for p in poses[1:]])
    wanted = {c: [float(p[place[c]]) for p in poses[1:]] for c in "xyz"}
    sent = compensate(tmp_path / "d" / "identified.yaml", wanted)
    sigma = sent.compensation.sigma_position
    inside = (joint > 1e3 * stretch.low) & (joint < 1e3 * stretch.high)
    assert sigma[inside].min() > 1e-4
    assert np.median(sigma[~inside]) < 1e-5
    assert any("leg2 between" in note for note in sent.notes)


@pytest.mark.long
@pytest.mark.parametrize(("case", "machine", "seed", "kind"), [
    ("stand-weight", "hexapod", 554533, "base_compliance"),
    ("motion-heat-platform", "3-RPR", 794398, "platform_thermal")])
def test_a_cause_in_a_body_is_named_alone(tmp_path: Path, case: str, machine: str, seed: int,
                                          kind: str) -> None:
    """Neither two plates that bend, nor an event, nor legs that heat."""
    found = diagnosed(tmp_path, case, machine, seed)
    assert found.record.verdict == "named"
    assert [e.kind for e in found.diagnosis.effects] == [kind]
