"""Campaigns of the independent generator that were once diagnosed wrongly, or in minutes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import ppmcal, rows
from wild.catalogue import write

from ppmcal.api.compensate import compensate
from ppmcal.api.diagnose import DiagnosisResult, diagnose
from ppmcal.api.identify import identify
from ppmcal.calibration.interpretation.misread import Misread


def diagnosed(folder: Path, case: str, machine: str, seed: int) -> DiagnosisResult:
    write(case, machine, 120, seed, folder)
    return diagnose(folder / "mechanism.yaml", [folder / "data.csv"])


def told(found: DiagnosisResult) -> set[tuple[str, float]]:
    """Kinds of the events that were named, with their rows."""
    return {(e["kind"], e["parameters"]["from_row"]["value"])
            for e in found.record.entries()["effects"]}


@pytest.mark.slow
def test_typos_do_not_pull_the_fit_of_the_training_rows_away(tmp_path: Path) -> None:
    """Joints and positions typed wrong in six rows: only those are out, and nothing is there."""
    truth = write("gross-5", "delta-rotary", 120, 313442, tmp_path)
    found = diagnose(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    assert found.record.verdict == "none"
    assert found.record.fit.after < 1.2
    (training,) = found.diagnosis.found.before.reasons
    wrong = set(truth["mistakes"][0]["indices"])
    assert len(training) <= len(wrong)


@pytest.mark.slow
def test_a_reversal_beside_typos(tmp_path: Path) -> None:
    """One of them is a strut's sign: a row that no fit can predict."""
    found = diagnosed(tmp_path, "gross-5-backlash", "3-RPR", 250006)
    assert found.record.verdict in ("named", "named-set")
    assert [e.kind for e in found.diagnosis.effects] == ["backlash"]


@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine", "seed", "events"), [
    ("homed-there-and-back", "3-RPR", 220423, {("zero_shift", 40), ("zero_shift", 70)}),
    ("homed-there-and-back", "hexapod", 998384, {("zero_shift", 32), ("zero_shift", 62)}),
    ("slip-turn", "hexapod", 632855, {("zero_shift", 77)}),
    ("target-bumped", "3-RPR", 500482, {("target_shift", 51)}),
    ("homed-one", "delta-rotary", 1452, {("zero_shift", 46)})])
def test_events_with_their_rows(tmp_path: Path, case: str, machine: str, seed: int,
                                events: set[tuple[str, float]]) -> None:
    """Two that are undone (one makes rows look correlated), one of 5 mm, one of the target, one
    beside rows that were left out."""
    found = told(diagnosed(tmp_path, case, machine, seed))
    assert {k for k, _ in found} == {k for k, _ in events}
    assert all(min(abs(row - at) for _, at in found) <= 2 for _, row in events)


@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine", "seed"), [
    ("base-sways", "3-RPR", 374824), ("base-sways", "hexapod", 186372),
    ("base-walks", "3-RPR", 912132), ("leg-settles", "delta-rotary", 504336)])
def test_what_wanders_in_time_is_no_row_of_events(tmp_path: Path, case: str, machine: str,
                                                  seed: int) -> None:
    """A stand that sways or walks, a leg that settles: two or three steps make it up."""
    found = diagnosed(tmp_path, case, machine, seed).record
    assert found.verdict == "unnamed"
    assert found.unknown and all("slow course" in u.looks_like for u in found.unknown)


@pytest.mark.slow
def test_a_base_that_moved_twice_does_not_wander(tmp_path: Path) -> None:
    found = told(diagnosed(tmp_path, "base-moved-twice", "3-RPR", 374824))
    assert [k for k, _ in found] == ["base_shift", "base_shift"]
    assert all(abs(at - row) <= 2 for (_, at), row in
               zip(sorted(found, key=lambda f: f[1]), (43, 94), strict=True))


@pytest.mark.slow
def test_a_second_event_of_a_named_kind_is_a_rival(tmp_path: Path) -> None:
    """The base moved twice; the second time is as well called new zeros of all legs."""
    found = diagnosed(tmp_path, "base-moved-twice", "delta-rotary", 885891).diagnosis
    for effect in found.effects:
        assert "base_shift" in (effect.kind, *(a.split(" ")[0] for a in effect.alternatives))


@pytest.mark.slow
def test_the_cause_is_named_or_a_rival(tmp_path: Path) -> None:
    """A reversal, to which speed adds little."""
    found = diagnosed(tmp_path, "friction-one", "3-RPR", 548469).diagnosis
    assert found.verdict in ("named", "named-set")
    (effect,) = found.effects
    assert "friction" in (effect.kind, *(a.split(" ")[0] for a in effect.alternatives))


@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine", "seed", "kind"), [
    ("leg-heat-late", "3-RPR", 340698, "leg_thermal"),      # looks like a base that shrinks
    ("base-heat-late", "3-RRR", 680651, "base_thermal")])   # like a platform that shrinks
def test_what_would_shrink_with_heat_gives_way_to_what_grows(
        tmp_path: Path, case: str, machine: str, seed: int, kind: str) -> None:
    """No expansion is below 0, of each joint neither."""
    truth = write(case, machine, 120, seed, tmp_path)["effects"][0]["parameters"]
    found = diagnose(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    assert found.verdict in ("named", "named-set")
    assert {e.kind for e in found.diagnosis.effects} == {kind}
    for named in found.record.entries()["effects"]:
        expansion = named["parameters"]["expansion"]
        assert abs(expansion["value"] - truth["expansion"]) < 4.0 * expansion["sigma"]
        assert expansion["sigma"] < 0.2 * truth["expansion"]


@pytest.mark.slow
@pytest.mark.parametrize("machine", ["3-RPR", "crank-hexapod"])
def test_directions_that_are_inverted_in_a_part_of_the_rows(tmp_path: Path, machine: str) -> None:
    with pytest.raises(Misread) as refused:
        diagnosed(tmp_path, "approach-half-inverted", machine, 2)
    ((mistake,),) = (f.mistakes for f in refused.value.found)
    assert mistake.kind == "sign"
    assert mistake.columns[0].startswith("dir_")
    assert mistake.rows[0] <= 3
    assert abs(mistake.rows[-1] - 48) <= 3
    assert "another sign than in the other rows" in str(refused.value)


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize(("case", "machine", "seed", "kind"), [
    ("base-compliance", "hexapod", 417972, "base_compliance"),
    ("stand-weight", "hexapod", 554533, "base_compliance"),
    ("motion-heat-base", "hexapod", 146926, "base_thermal"),
    ("motion-heat-platform", "3-RPR", 794398, "platform_thermal")])
def test_a_cause_in_a_body_is_named_alone(tmp_path: Path, case: str, machine: str, seed: int,
                                          kind: str) -> None:
    """Neither two plates that bend, nor an event, nor legs that heat."""
    found = diagnosed(tmp_path, case, machine, seed)
    assert found.record.verdict == "named"
    assert [e.kind for e in found.diagnosis.effects] == [kind]


@pytest.mark.slow
def test_a_stand_that_may_be_legs_is_found(tmp_path: Path) -> None:
    """Of one kind there are hypotheses with fewer and with more parameters: each is its own."""
    found = diagnosed(tmp_path, "stand", "crank-hexapod", 800750)
    (effect,) = found.diagnosis.effects
    assert "base_compliance" in (effect.kind, *(a.split(" ")[0] for a in effect.alternatives))
    assert found.record.verdict in ("named", "named-set")
    assert found.record.next_measurements.reason
