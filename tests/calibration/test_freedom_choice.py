"""Freedoms are kept by how rows that were left out are predicted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.knowledge.freedom_choice import (
    choice_sentence,
    freedom_choice,
    with_chosen_freedoms,
)
from ppmcal.calibration.knowledge.intervals import spatial_blocks
from ppmcal.calibration.validation.residual_vectors import fresh_state, residuals
from ppmcal.errors import BadInput
from ppmcal.io import write_mechanism

LEANS, RODS = ("*.base.direction.*",), ("*.length",)


@pytest.fixture(scope="module")
def printer():
    """A linear delta whose rods are free, and whose towers may lean, by choice."""
    machine = ppmcal.load(ppmcal.shipped("delta-linear"))
    assert all(p.fixed and p.prior_sigma for p in machine.parameters if leans(p))
    return replace(machine, optional=(RODS, LEANS))


def leans(p):
    return any(p.matches(pattern) for pattern in LEANS)


def measured(machine, leaning, seed, count=40):
    """Positions of the nozzle of a machine off by its tolerances, its towers leaning or not."""
    rng = np.random.default_rng(seed)
    errors = {p.name: float(rng.normal()) * p.tolerance / machine.units.factor(p.quantity)
              for i, p in enumerate(machine.parameters)
              if i in machine.free or (leaning and leans(p))}
    data = ppmcal.simulate(machine, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": {"x": 0, "y": 0, "z": 1e3 * machine.home_pose[2]},
                             "half_range": {"x": 60, "y": 60, "z": 40}, "count": count}},
        "instrument": {"kind": "position", "sigma": {"position": 0.02}}, "frame": "known",
        "errors": errors, "seed": seed}).data
    return data


def chosen(machine, data):
    return with_chosen_freedoms(Problem(machine, data, machine.free), FitOptions(), [False])


@pytest.mark.slow
def test_leaning_towers_are_kept_where_they_lean_and_only_there(printer):
    for leaning in (False, True):
        problem, choice = chosen(printer, measured(printer, leaning, 3))
        freed = {problem.mechanism.names[i] for i in problem.free}
        assert any("direction" in n for n in freed) == leaning
        assert any(p.matches("*.length") for p in (
            problem.mechanism.parameters[i] for i in problem.free))
        assert choice.kept == (2 if leaning else 1) and choice.usual == 1
        assert ("better by more than a standard error" in choice_sentence(choice)) == leaning


@pytest.mark.long
def test_noise_does_not_flip_the_choice(printer):
    kept = [chosen(printer, measured(printer, False, 20 + n, 24))[1].kept for n in range(20)]
    assert sum(k > 1 for k in kept) <= 3


@pytest.mark.slow
def test_left_out_rows_are_predicted_as_by_fits_without_them(printer):
    """Linear algebra on the rows against a fit of the others, block by block, set by set."""
    data = measured(printer, False, 5)
    _, choice = chosen(printer, data)
    lean = [i for i, p in enumerate(printer.parameters) if leans(p)]
    rods = [i for i in printer.free if printer.parameters[i].matches(RODS[0])]
    six = [i for i in printer.free if i not in rods]
    small = replace(printer, free=tuple(six), optional=())
    (block,) = spatial_blocks(identify(Problem(small, data, small.free)))
    for entry, free in zip(choice.sets, (six, [*six, *rods], [*six, *rods, *lean]), strict=True):
        machine = replace(printer, free=tuple(free), optional=())
        total = 0.0
        for b in range(block.max() + 1):
            fit = identify(Problem(machine, (data[0].take(block != b),), machine.free),
                           FitOptions(robust=False))
            other = Problem(machine, (data[0].take(block == b),), machine.free)
            total += float(np.sum((residuals(other, fresh_state(other, fit.state)).vector[0]
                                   / 2e-5) ** 2))
        assert entry.missed == pytest.approx(np.sqrt(total / (3 * len(block))), rel=0.01)


def test_too_few_rows_leave_the_files_freedoms(printer):
    problem, choice = chosen(printer, (measured(printer, True, 6)[0].take(np.arange(3)),))
    assert choice is None and set(problem.free) == set(printer.free)


@pytest.mark.slow
def test_the_users_choice_and_other_methods_are_not_overruled(printer):
    data = measured(printer, True, 7)
    by_hand = ppmcal.identify(printer, data, free=["*.offset"], holdout=0.0)
    assert by_hand.freedoms is None and by_hand.record.blocks is None
    flat = with_chosen_freedoms(Problem(printer, data, printer.free), FitOptions(method="flat"),
                                [False])
    assert flat[1] is None and flat[0].free == printer.free


@pytest.mark.slow
def test_it_is_told_written_and_read_back(printer, tmp_path):
    found = ppmcal.identify(printer, measured(printer, True, 3), holdout=0.0)
    assert any("8 blocks of space" in n for n in found.notes)
    assert [s.kept for s in found.record.freedoms] == [True, True, True]
    found.save(tmp_path)
    again = ppmcal.load(tmp_path / "identified.yaml")
    assert {again.names[i] for i in again.free} == {
        found.mechanism.names[i] for i in found.mechanism.free}
    (tmp_path / "m.yaml").write_text(write_mechanism(printer, "x"), encoding="utf-8")
    assert ppmcal.load(tmp_path / "m.yaml").optional == (RODS, LEANS)
    text = (tmp_path / "m.yaml").read_text(encoding="utf-8").replace("*.length", "*.lenght")
    (tmp_path / "m.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match="lenght"):
        ppmcal.load(tmp_path / "m.yaml")


def test_one_set_alone_needs_no_choice(printer):
    fit = identify(Problem(replace(printer, optional=()), measured(printer, False, 8),
                           printer.free))
    choice = freedom_choice(fit, [printer.free], 0)
    assert choice.kept == 0 and choice.sets[0].behind == 0.0
