"""Worlds of bodies in MuJoCo, of which ppmcal knows nothing, identified and diagnosed."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="worlds of bodies need mujoco: pip install 'ppmcal[test]'")

from bodies_study import ask, identified_apart, nominal_apart, wrong
from bodies_world.cases import CASES, SIGMA, campaign
from bodies_world.machines import MACHINES

pytestmark = pytest.mark.slow
SIGN = ("a load side that lags behind its encoder by friction has a backlash below 0: directions "
        "that are right are said to have the other sign, and the file is refused")
FLAT = "a flat base on a stand that tilts is said to bend, beside base_compliance"
KNOWN = {"3-RRR-rubbing-both": pytest.mark.xfail(strict=True, reason=SIGN),
         "hexapod-stand": pytest.mark.xfail(strict=True, reason=FLAT)}


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


@pytest.mark.parametrize("name", [pytest.param(n, marks=KNOWN.get(n, ())) for n in CASES])
def test_names_are_right(name: str, tmp_path: Path) -> None:
    """What is named, and how large it is; of worlds without a fault nothing is."""
    case = CASES[name]
    campaign(name, 1, tmp_path)
    answer = ask(tmp_path)
    assert wrong(case, answer) == []
    for size, value, sigma, _ in answer.sizes:
        if size in case.sizes:
            assert abs(value - case.sizes[size]) < 4 * sigma
    if case.must:
        assert answer.gap[1] < 0.5 * answer.gap[0]
