"""What an instrument sees of the platform, and what is learned of it, whatever tolerances say."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.learned import campaign, diagnosed, dip, fitted

from ppmcal.diagnosis.learned_terms import visible
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.observed_directions import observed_motion
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


@pytest.mark.slow
def test_whole_poses_show_the_plane_and_every_joint(day) -> None:
    """A machine in the plane has no height, of which no instrument tells anything."""
    folder, data = day
    fit = fitted(machine(folder), data)
    observed = observed_motion(visible(fit, fit.keep, Whitening()).system)
    assert [observed.place_seen(c) for c in range(6)] == [True, True, False, False, False, True]
    assert observed.joints == pytest.approx(np.ones(3))


@pytest.mark.long
def test_infinite_tolerances_learn_the_same(day) -> None:
    """They say nothing of how large geometry is: the worn place is learned all the same."""
    folder, data = day
    with np.errstate(divide="raise", invalid="raise"):
        found = diagnosed(machine(folder, **dict.fromkeys(STATED, float("inf"))), data).learned
    assert found is not None
    (term,), (curve,) = found.learned.terms, found.learned.curves
    assert (curve.input, curve.acts, term.on) == ("travel", "joint", (False, True, False))
    # 0.05 mm deep at 440 mm
    deep = np.median(curve.values) - curve.at(np.array([0.44]))[0]
    assert deep == pytest.approx(5e-5, rel=0.3)
