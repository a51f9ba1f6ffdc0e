"""What tolerances make of the platform's motions, where some of them are infinite."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.learned import campaign, dip, fitted, likeliest, terms

from ppmcal.diagnosis.learned_terms import visible
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.observed_directions import ObservedMotion, observed_motion
from ppmcal.diagnosis.term_candidates import Visible
from ppmcal.io import read_mechanism
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

STATED = {"point": 0.3, "length": 0.3, "angle": 0.1, "offset": 0.4}


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[Dataset, ...]]:
    """Return a folder with a machine, and measurements of it with a worn place of one screw."""
    folder = tmp_path_factory.mktemp("day")
    _, data = campaign(folder, [dip()], 1, count=60)
    return folder, data


def machine(folder: Path, **tolerances: float) -> Mechanism:
    """Return the machine with other tolerances."""
    tree = yaml.safe_load((folder / "m.yaml").read_text())
    (folder / "n.yaml").write_text(yaml.safe_dump(tree | {"tolerances": STATED | tolerances}))
    return read_mechanism(folder / "n.yaml")


def rows_of(mechanism: Mechanism, data: tuple[Dataset, ...]):
    """Return a fit, its rows as terms see them, and the motion that these see."""
    fit = fitted(mechanism, data)
    seen: Visible = visible(fit, fit.keep, Whitening())
    observed: ObservedMotion = observed_motion(seen.system)
    return fit, seen, observed


@pytest.mark.slow
def test_an_infinite_tolerance_says_nothing_of_how_far_the_platform_moves(day) -> None:
    """The others do: sizes are as if what may be anywhere were known."""
    folder, data = day
    _, _, whole = rows_of(machine(folder), data)
    mechanism = machine(folder, point=float("inf"))
    fit, seen, observed = rows_of(mechanism, data)
    _, _, known = rows_of(machine(folder, point=1e-9), data)
    moved = [0, 1, 5]
    assert observed.place_sigma[moved] == pytest.approx(known.place_sigma[moved], rel=0.01)
    assert np.all(observed.place_sigma[moved] < whole.place_sigma[moved])
    # a drive's zero alone moves its own joint: by its tolerance of 0.4 mm
    assert observed.joint_sigma == pytest.approx(np.full(3, 0.4e-3), rel=1e-6)
    tried = terms(fit, seen)
    assert tried and all(0.0 < c.sigma < np.inf for c in tried)
    # and the worn place is found as with tolerances that are all finite
    found = likeliest(seen, tried)
    first = found.terms[0].candidate
    assert (first.curve.input, first.curve.acts, first.on) == ("travel", "joint", (
        False, True, False))


def test_where_all_tolerances_are_infinite_a_term_may_be_of_any_size(day) -> None:
    """No larger than the machine: what the rows observe is learned as with tolerances."""
    folder, data = day
    fit, seen, observed = rows_of(machine(folder, **dict.fromkeys(STATED, float("inf"))), data)
    reach = fit.problem.mechanism.reach
    assert observed.place_sigma[:3] == pytest.approx(np.full(3, reach))
    assert observed.joint_sigma == pytest.approx(np.full(3, reach))
    tried = terms(fit, seen)
    assert tried and all(0.0 < c.sigma < np.inf for c in tried)
    with np.errstate(divide="raise", invalid="raise"):
        found = likeliest(seen, tried)
    first = found.terms[0].candidate
    assert (first.curve.input, first.curve.acts, first.on) == ("travel", "joint", (
        False, True, False))
