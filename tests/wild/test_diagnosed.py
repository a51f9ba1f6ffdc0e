"""Campaigns of the independent generator that were once diagnosed wrongly, or in minutes."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.commands import ppmcal, rows
from wild.catalogue import write

from ppmcal.api.diagnose import DiagnosisResult, diagnose


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
    assert found.record.verdict == "named"
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
def test_a_second_event_of_a_named_kind_is_a_rival(tmp_path: Path) -> None:
    """The base moved twice; the second time is as well called new zeros of all legs."""
    found = diagnosed(tmp_path, "base-moved-twice", "delta-rotary", 885891).diagnosis
    for effect in found.effects:
        assert "base_shift" in (effect.kind, *(a.split(" ")[0] for a in effect.alternatives))


@pytest.mark.slow
def test_what_follows_the_last_move_is_learned(tmp_path: Path) -> None:
    """Joints that stop short by a part of their move: in no library, and it comes back in order."""
    found = diagnosed(tmp_path, "shortfall", "delta-rotary", 266676)
    assert found.record.verdict == "unnamed"
    (term,) = found.record.entries()["learned"]
    assert term["input"] == "last move"
    assert term["gap"]["before"] > 1.4
    assert term["gap"]["after"] < 1.1
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
