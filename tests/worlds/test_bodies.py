"""Worlds of bodies in MuJoCo, of which ppmcal knows nothing, identified and diagnosed."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="worlds of bodies need mujoco: pip install 'ppmcal[test]'")

from bodies_study import answer_of, identified_apart, nominal_apart, wrong
from bodies_world.cases import CASES, SIGMA, campaign
from bodies_world.machines import MACHINES, PIVOT

import ppmcal
from ppmcal.io.results.diagnosis import DiagnosisRecord

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", MACHINES)
def test_a_rigid_world_is_where_ppmcal_says(name: str, tmp_path: Path) -> None:
    place, turn = nominal_apart(MACHINES[name], tmp_path)
    assert place < 1e-6
    assert turn < 1e-6


@pytest.mark.parametrize("name", MACHINES)
def test_errors_of_geometry_are_found(name: str, tmp_path: Path) -> None:
    """The true error falls to the noise, and no slot is beyond what its sigma says."""
    before, after, noise, worst = identified_apart(MACHINES[name], tmp_path)
    assert before > 20 * SIGMA[0]
    assert after < 2 * SIGMA[0]
    assert 0.85 < noise < 1.15
    assert worst < 4.0


def names_are_right(name: str, folder: Path) -> DiagnosisRecord:
    """Check what is named of a world, and how large it is; of the other worlds docs/rates tells."""
    case = CASES[name]
    campaign(name, 1, folder)
    found = ppmcal.diagnose(folder / "mechanism.yaml", [folder / "data.csv"]).record
    answer = answer_of(found)
    assert wrong(case, answer) == []
    for size, value, sigma, _ in answer.sizes:
        if size in case.sizes:
            assert abs(value - case.sizes[size]) < 4 * sigma
    assert answer.gap[1] < 0.5 * answer.gap[0]
    return found


@pytest.mark.long
def test_the_point_about_which_a_stand_turns_is_told(tmp_path: Path) -> None:
    """The ball joint's place, base axes; it is no figure of a stroke."""
    (effect,) = names_are_right("hexapod-stand", tmp_path).effects
    assert effect.mid_stroke is None
    for axis, pivot in zip("xyz", PIVOT, strict=True):
        told = effect.derived[f"center_{axis}"]
        assert abs(told.value - 1e3 * pivot) < 4 * told.sigma
        assert told.sigma < 40.0


@pytest.mark.long
def test_encoders_before_the_play_are_told(tmp_path: Path) -> None:
    """Rubbing joints stay behind what their motors' encoders read; directions are the moves'."""
    (effect,) = names_are_right("3-RRR-rubbing-both", tmp_path).effects
    width = effect.parameters["width"]
    assert (effect.kind, effect.side) == ("backlash", "lags")
    assert abs(width.value - CASES["3-RRR-rubbing-both"].sizes["backlash.width"]) < 4 * width.sigma
