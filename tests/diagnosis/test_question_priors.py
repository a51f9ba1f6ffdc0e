"""What the causes of a question cost beforehand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.rounds import last_round
from hidden import Options, hide

from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.explanation import Round
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.question import Asked, question
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.term_candidates import all_settings
from ppmcal.diagnosis.unknown_causes import UnknownCauses
from ppmcal.inference.priors import FAMILY, FURTHER, GOES_WITH, MISREAD, PLAIN, SELDOM
from ppmcal.linalg import Array
from ppmcal.model.effects.learned import JOINT


def asked(machine: str, kinds: list[str], eta: float = 1.0, frozen: tuple[str, ...] = (),
          poses: int = 30) -> Asked:
    """Return the question of a campaign, slots frozen whose names end so."""
    found = hide(machine, 7, kinds, eta, Options(poses=poses), "all")
    mechanism = found.mechanism
    free = [i for i in mechanism.free if not mechanism.parameters[i].name.endswith(frozen)]
    fit = identify(with_whole_rows(Problem(mechanism, (found.dataset,), tuple(free))),
                   FitOptions())
    system = build(fit.problem, fit.state, fit.keep)
    return question(system, library(system, misread=True),
                    UnknownCauses(system, all_settings(fit)))


@pytest.mark.slow
def test_frozen_slots_of_one_sort_share_a_prior_and_a_second_of_a_sort_costs_less() -> None:
    found = asked("3-RRR-1", [], frozen=(".proximal", "leg2.distal"))
    at = {b.family: i for i, b in enumerate(found.question.blocks) if b.family.startswith("geom")}
    first, second, other = (at[f"geometry {n}"] for n in ("leg1.proximal", "leg3.proximal",
                                                          "leg2.distal"))
    prior = found.question.log_prior
    assert prior([first]) == pytest.approx(np.log(float(FAMILY) / 3))
    assert prior([other]) == pytest.approx(np.log(float(FAMILY)))
    assert prior([first, second]) - prior([second]) == pytest.approx(
        np.log(float(FURTHER)))  # two of three, in either order, are as many as one of three
    assert prior([first, other]) == pytest.approx(prior([first]) + prior([other]))


@pytest.mark.slow
def test_a_function_that_goes_with_more_is_a_tenth_as_usual_as_a_plain_one() -> None:
    """With the direction of approach, or with a second input; all together have the same prior."""
    system = asked("3-RRR-1", []).system
    some = [c for c in UnknownCauses(system, [p.setting for p in system.parts]).causes
            if c.curve is not None and c.curve.acts == JOINT and sum(c.on) == 1]
    plain = {c.share for c in some if not (c.curve.by or c.curve.signed)}
    more = {c.share for c in some if c.curve.by or c.curve.signed}
    (one,), (other,) = plain, more
    assert other == pytest.approx(float(GOES_WITH) * one)


def explanation(kind: str, on: str, change: Callable[[str, Array], Array | None]) -> Round:
    """Return what is found in a campaign with one effect, columns changed or (None) left out."""
    found = hide("delta-linear", 7, [kind], 1.0, Options(poses=90), on)
    columns = {name: change(name, values) for name, values in found.dataset.columns.items()}
    data = replace(found.dataset, columns={n: v for n, v in columns.items() if v is not None})
    return last_round(found.mechanism, data)


@pytest.mark.slow
def test_directions_that_are_turned_in_a_stretch_are_told_with_their_rows() -> None:
    """Velocities would say the same of the drive as directions that are right."""
    def turned(name: str, values: Array) -> Array | None:
        sign = np.where(np.arange(values.size) < 100, 1.0, -1.0)
        return None if name.startswith("vel_") else (
            values * sign if name.startswith("dir_") else values)

    found = explanation("backlash", "one", turned)
    place, = found.places
    assert place.misread == "dir_b turned" and "in rows 101 to 180" in place.label
    assert not place.named and found.verdict == "unnamed"


@pytest.mark.slow
def test_a_size_that_no_machine_has_is_a_column_in_another_unit() -> None:
    found = explanation("compliance", "all", lambda name, values: (
        1e3 if name == "payload" else 1.0) * values)
    place, = found.places
    assert place.hypothesis is not None and place.hypothesis.kind == "compliance"
    assert not place.named and place.misread


@pytest.mark.slow
def test_a_misread_column_costs_as_much_more_whatever_the_effect() -> None:
    """As the same effect of the column as it is, times the prior of a misreading."""
    found = asked("delta-linear", [], poses=20)
    blocks = {b.name: b for b in found.question.blocks}
    for name in ("leg_thermal on a, b, c", "leg_thermal on a"):
        first = next(b for b in found.question.blocks if b.name == name)
        misread = blocks[f"temperature in another unit: {name}"]
        assert misread.log_prior - first.log_prior == pytest.approx(np.log(float(MISREAD)))
    turned = [b for b in blocks.values() if b.family == "dir_a turned"]
    every = 2.0 * 20 * 2    # rows, up to which a stretch may reach
    assert turned and all(np.log(float(MISREAD) / every**2) < b.log_prior
                          - blocks["backlash on a"].log_prior < np.log(float(MISREAD) / every)
                          for b in turned)


@pytest.mark.slow
def test_an_effect_is_as_often_plain_as_with_what_it_may_have_beside() -> None:
    found = asked("delta-linear", [], poses=20)
    own = [(b, h) for b, h in zip(found.question.blocks, found.sources, strict=True)
           if isinstance(h, Hypothesis) and not h.misread
           and (h.kind, h.on, h.shared) == ("compliance", ("a", "b", "c"), True)]
    plain = [b.log_prior for b, h in own if not h.scanned]
    other = [b.log_prior for b, h in own if h.scanned]
    assert len(plain) == 1 and len(other) > 10
    assert np.exp(plain).sum() == pytest.approx(np.exp(other).sum() * float(PLAIN)
                                                / (1.0 - float(PLAIN)))


@pytest.mark.slow
def test_special_forms_and_plates_have_a_tenth_of_the_prior_of_their_like() -> None:
    """The families of one plain kind share its 1/50; so do the parts of a plate."""
    found = asked("delta-linear", [], poses=20)
    of: dict[str, float] = {}
    for block, h in zip(found.question.blocks, found.sources, strict=True):
        if isinstance(h, Hypothesis) and h.effect and not (h.misread or h.anonymous):
            of[block.family] = of.get(block.family, 0.0) + float(np.exp(block.log_prior))
    special = [f for f in of if f.startswith("backlash x ")]
    assert len(special) == 2 and of["backlash"] == pytest.approx(float(FAMILY))
    assert sum(of[f] for f in special) == pytest.approx(float(FAMILY) * float(GOES_WITH))
    plates = [f for f in of if f.startswith("plate_compliance")]
    assert len(plates) == 2
    assert sum(of[f] for f in plates) == pytest.approx(float(FAMILY) * float(SELDOM))


@pytest.mark.slow
def test_what_shrinks_where_it_should_grow_has_no_name() -> None:
    """No platform shrinks with heat; how often one that grows is named is in docs/rates."""
    found = hide("3-RPR", 7, ["platform_thermal"], 2.0, Options(poses=60), "all")
    middle = float(np.mean(found.dataset.columns["temperature"]))
    data = replace(found.dataset, columns={
        n: 2.0 * middle - v if n == "temperature" else v
        for n, v in found.dataset.columns.items()})
    told = last_round(found.mechanism, data)
    assert not any(p.named for p in told.places)
    assert any("of the opposite sign" in p.label for p in told.unnamed)


@pytest.mark.long
def test_a_leg_that_settles_over_breaks_has_no_name() -> None:
    """In rows it is a step, in time it is none."""
    found = hide("3-RPR", 7, [], 1.0, Options(poses=90), None)
    time = found.dataset.columns["time"].copy()
    span, count = np.ptp(time), time.size
    time[count // 8:] += span
    time[count // 2:] += 2.0 * span
    q = found.dataset.q.copy()
    q[:, 0] += 6e-5 * found.mechanism.reach * np.exp(-(time - time[0]) / (0.3 * span))
    data = replace(found.dataset, q=q, columns={**found.dataset.columns, "time": time})
    place, = last_round(found.mechanism, data).places
    assert not place.named
    assert place.label == "a start-up transient in time of the zero of leg1"
