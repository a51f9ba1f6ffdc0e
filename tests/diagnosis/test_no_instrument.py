"""What is asked, and said, of machines whose data have no instrument."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from helpers.redundant import alone, belts, written

import ppmcal
from ppmcal.calibration.fit import Problem, identify, too_few
from ppmcal.commands.inputs import prepared
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.linear_system import build
from ppmcal.model.effects import effect_kinds


def problem_of(folder: Path, count: int, **limb: Any) -> Problem:
    tree = belts()
    tree["limbs"] = [{**own, **limb} for own in tree["limbs"]]
    path = written(folder, tree | {"tolerances": {"point": 20, "offset": 5}})
    data = ppmcal.simulate(path, alone(tree, {"x": 900, "y": 600}, count, sigma=0.3)).data[0]
    mechanism, datasets = prepared(path, data)
    return Problem(mechanism, datasets, mechanism.free)


def test_no_effect_is_in_an_instrument_that_there_is_not(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, 30)
    fit = identify(problem)
    found = library(build(problem, fit.state, fit.keep))
    named = {h.kind for h in found.hypotheses} | {u.kind for u in found.untestable}
    assert "zero_shift" in named
    assert not named & {n for n, kind in effect_kinds().items() if kind.instrument}


def test_poses_that_are_too_few_say_what_more_of_them_are_for(tmp_path: Path) -> None:
    (told,) = too_few(identify(problem_of(tmp_path, 3, offset=0)))
    assert told.startswith("3 poses give 6 numbers for 9 unknowns")
    assert told.endswith("measure at least 2 more poses, to have as many numbers as unknowns")


def test_a_platform_that_does_not_turn_has_no_rotation_to_weigh(tmp_path: Path) -> None:
    text = " ".join(str(t) for t in ppmcal.check(written(tmp_path, belts())).told())
    assert "Smallest singular value at home" in text and "rotation" not in text
