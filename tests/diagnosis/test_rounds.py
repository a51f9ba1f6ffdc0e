"""Rounds of questions: what goes from one to the next, and when they end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from wild_diagnosis import write

import ppmcal
from ppmcal.calibration.fit import Fit, FitOptions, Problem, identify
from ppmcal.diagnosis import cause_sizes, explanation
from ppmcal.diagnosis.cause_sizes import _seen
from ppmcal.diagnosis.explanation import Round, _key, explained
from ppmcal.diagnosis.extended_model import Sized, extended
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.naming import nearest as _nearest
from ppmcal.diagnosis.naming import told
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.told_places import unknown
from ppmcal.diagnosis.unknown_causes import UNKNOWN_FAMILY, UnknownCause
from ppmcal.errors import NoResult
from ppmcal.inference import moves
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.question import Question
from ppmcal.inference.sets import Member, SetPosterior
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.model.effects import effect_kinds
from ppmcal.model.mechanism import Mechanism


def hypothesis(kind: str, on: tuple[str, ...], names: tuple[str, ...], **more: Any) -> Hypothesis:
    """Return a hypothesis of a kind of the library, of any size."""
    ends = (np.inf,) * len(names)
    return Hypothesis(kind, on, True, names, tuple(-e for e in ends), ends,
                      tuple(range(len(names))), effect=effect_kinds()[kind], **more)


def test_a_cause_is_the_same_whatever_the_stroke_that_was_measured() -> None:
    def periodic(period: float, low: float) -> Hypothesis:
        return Hypothesis("periodic", ("leg1",), True, ("size",), (0.0,), (1.0,), (0,),
                          constants={"period": period, "low": low}, strokes=("low",))

    assert _key(periodic(0.1, 0.2)) == _key(periodic(0.1, 0.2001))
    assert _key(periodic(0.1, 0.2)) != _key(periodic(0.2, 0.2))


def test_kinds_with_other_parameters_are_other_causes() -> None:
    """A base that gives way to one part of a load, or to all: they have one label."""
    one, several = (hypothesis("base_compliance", (), names) for names in (
        ("z_fz",), ("z_fz", "rx_fz")))
    assert one.label == several.label and _key(one) != _key(several)
    assert _nearest(several, [one, several]) == 1


def test_what_rows_do_not_see_of_an_effect_is_not_freed() -> None:
    """Touches of a flat see its height and its slope; a base goes nowhere along it."""
    step = hypothesis("base_shift", (), ("x", "y", "rz"), constants={"from_row": 10.0})
    machine, (added,) = extended(ppmcal.load(ppmcal.shipped("3-RPR")), [
        Sized(step, np.array([0.0, 1e-4, 0.0]), np.array([0.0, 1e-5, 0.0]), np.ones(3))])
    free = [n for n in added.parameters if machine.parameters[machine.names.index(n)].free]
    assert [n.rpartition(".")[2] for n in free] == ["y"]
    assert extended(machine, [Sized(step, *np.zeros((3, 3)))]) == (machine, ())


def test_a_column_that_geometry_makes_is_not_seen() -> None:
    """Its coefficient is what the prior says, wide, and no fit could tell it."""
    rng = np.random.default_rng(3)
    geometry, other = rng.normal(size=(80, 1)), rng.normal(size=(80, 1))
    columns = np.hstack([geometry, other, geometry + 1e-2 * other, np.zeros((80, 1))])
    asked = Question(MatrixColumns(columns), rng.normal(size=80), 1e8 * geometry,
                     (Block("all", "all", (0, 1, 2, 3), 0.0),), np.ones((40, 2), dtype=bool),
                     np.zeros(39, dtype=np.int64))
    assert _seen(asked, (0, 1, 2, 3)).tolist() == [False, True, True, False]


def answered(*members: tuple[float, set[int]]) -> Round:
    """Return a round with a backlash (0) in its one place, and what else may be there.

    That is friction (1, 2), or a slow drift (3) alone or beside a lag (4).
    """
    families = ("backlash", "friction", "friction", UNKNOWN_FAMILY, "lag")
    sources = tuple(UnknownCause("a slow drift", 1, (), 1.0) if f == UNKNOWN_FAMILY
                    else Hypothesis(f, (f"leg{n}",), True, ("size",), (0.0,), (1.0,), (n,))
                    for n, f in enumerate(families))
    blocks = tuple(Block(f"{f} {n}", f, (n,), 0.0) for n, f in enumerate(families))
    likely = [Member(" and ".join(sorted({families[i] for i in own})), p, frozenset(own),
                     frozenset(own))
              for p, own in members]
    answer = SimpleNamespace(best=SimpleNamespace(chosen=(0,)),
                             likely=lambda place, mass: tuple(likely))
    asked: Any = SimpleNamespace(question=SimpleNamespace(blocks=blocks), sources=sources)
    none: Any = None
    return Round(none, (), (), None, none, asked, cast(SetPosterior, answer), Whitening())


def test_what_leads_in_a_place_is_told() -> None:
    """By all members in which it is: the likeliest single set may be of another family."""
    (own,) = answered((0.6, {0}), (0.4, {1})).places
    assert own.named and (own.leader, own.label) == (0, "backlash 0")
    found = answered((0.6, {2}), (0.4, {0}))
    (other,) = found.places
    assert other.named and (other.leader, other.block) == (2, 0)
    assert other.hypothesis is found.asked.sources[2] and found.told == {2}


def test_no_name_stands_where_unknown_leads_in_several_ways() -> None:
    (place,) = answered((0.45, {0}), (0.3, {3}), (0.25, {3, 4})).places
    assert not place.named and place.hypothesis is None and place.label == "unknown 3"
    (place,) = answered((0.45, {0}), (0.3, {3, 4}), (0.25, {3, 2})).places
    assert not place.named and place.sure
    (place,) = answered((0.55, {0}), (0.25, {3}), (0.2, {3, 4})).places
    assert place.named


@pytest.fixture(scope="module")
def slipped(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    """A screw that has slipped by a whole turn: hundreds of times the noise."""
    folder = tmp_path_factory.mktemp("slipped")
    write("slip-turn", "3-RPR", 40, 411689, folder, 1.0)
    mechanism = read_mechanism(folder / "mechanism.yaml")
    data = read_campaign([folder / "data.csv"], mechanism)
    return identify(with_whole_rows(Problem(mechanism, data, mechanism.free)), FitOptions())


@pytest.mark.long
def test_what_is_too_large_for_its_derivatives_is_fitted_before_another_cause_is_asked_for(
        slipped: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once each: a round that finds nothing new is the last, the same fit is asked the same.

    What else was found beside it at derivatives that do not hold is gone in the round after.
    """
    fits = list[str]()

    def counted(fit: Fit, machine: Mechanism, options: FitOptions) -> Fit:
        fits.append(machine.effects[-1].kind.name)
        return with_mechanism(fit, machine, options)

    monkeypatch.setattr(explanation, "with_mechanism", counted)
    rounds = explained(slipped, FitOptions())
    assert [r.cut for r in rounds] == [True, False, False]
    assert "zero_shift on leg3" in [p.label for p in rounds[0].places]
    assert [[p.label for p in r.places] for r in rounds[1:]] == [["zero_shift on leg3"]] * 2
    assert not any(r.given_up for r in rounds) and fits == ["zero_shift"] * 2


@pytest.mark.slow
def test_what_was_found_and_has_no_fit_is_told(slipped: Fit, monkeypatch: pytest.MonkeyPatch
                                               ) -> None:
    def none(*_: object) -> Fit:
        raise NoResult("no pose is reached")

    monkeypatch.setattr(explanation, "with_mechanism", none)
    monkeypatch.setattr(moves, "SETS", 20)
    (only,) = explained(slipped, FitOptions(), ["zero_shift"])
    assert not only.cut and only.answer.ended
    said = only.given_up[-1]
    assert "zero_shift on leg3" in said and "no pose is reached" in said and "--kind" in said


@pytest.mark.slow
def test_a_search_without_end_is_given_up_and_says_so(slipped: Fit,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cause_sizes, "LINEAR", np.inf)      # all is asked of derivatives
    monkeypatch.setattr(explanation, "ROUNDS", 1)
    monkeypatch.setattr(moves, "SETS", 20)
    (only,) = explained(slipped, FitOptions(), ["zero_shift"])
    assert only.answer.ended and only.given_up == (explanation.ENDED, explanation.UNSETTLED)
    # the fit with it was not asked: it is listed, with its probability, and has no name
    assert only.verdict == "unnamed" and not any(p.named for p in only.places)
    found = told(slipped, FitOptions(), ["zero_shift"])
    listed = [unknown(found, p) for p in found.last.unnamed]
    assert "zero_shift on leg3" in [u.looks_like for u in listed] and not found.effects
    assert all(u.probability > 0.5 for u in listed)


def test_rounds_that_do_not_agree_name_what_both_found() -> None:
    """Whatever the rows of their events."""
    backlash, unknown_one = answered((1.0, {0})), answered((0.9, {3}), (0.1, {0}))
    agreed = explanation._unsettled([unknown_one, backlash, backlash])
    assert agreed.given_up == () and agreed.verdict == "named"
    for rounds in ([backlash, unknown_one, backlash], [backlash]):
        last = explanation._unsettled(rounds)
        assert last.given_up == (explanation.UNSETTLED,) and last.verdict == "unnamed"
        assert [p.label for p in last.unnamed] == ["backlash 0"]


@pytest.mark.parametrize("family", [f"cause {n}" for n in range(12)])
def test_of_two_that_are_in_the_same_sets_that_of_the_best_set_leads(family: str) -> None:
    """Whatever the order in which Python keeps names, which is another in every process."""
    blocks = [Block(name, (n,), name, -1.0) for n, name in enumerate((family, UNKNOWN_FAMILY))]
    members = (Member(family, 1.0, frozenset({0, 1}), frozenset({0, 1})),)
    for best in (0, 1):
        what: Any = SimpleNamespace(answer=SimpleNamespace(best=SimpleNamespace(chosen=(best,))),
                                    asked=SimpleNamespace(question=SimpleNamespace(blocks=blocks)))
        assert blocks[Round._leading(what, members, best)[1]].family == blocks[best].family
