"""What the user must look at, what to do next, and what hypotheses are called."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ppmcal.diagnosis.findings import advice, findings
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.lack_of_fit import LackOfFit
from ppmcal.io.results.diagnosis_wording import confounded


def remainder(ratio: float = 1.0, excess: float = 0.0) -> LackOfFit:
    return LackOfFit(ratio, excess, 1.0, "stated", "", 1.0)


def fit_with(reasons: dict[int, str], converged: bool = True, iterations: int = 60) -> Any:
    class Data(list[int]):
        name, findings = "run1", ()

    return SimpleNamespace(problem=SimpleNamespace(datasets=(Data(range(50)),)),
                           reasons=(reasons,), converged=converged, iterations=iterations)


def said(before: Any, after: Any, **left: float) -> list[str]:
    out: Any = SimpleNamespace(sentence="")
    return findings(before, after, remainder(**left), (), None, out)


def test_nothing_is_said_of_a_fit_that_is_as_it_should_be() -> None:
    assert said(fit_with({}), fit_with({})) == []


def test_rows_out_rows_back_and_a_fit_that_stopped_are_said() -> None:
    out, back = {3: "outlier", 4: "outlier"}, {3: "outlier"}
    assert [s for s in said(fit_with(out), fit_with(out)) if "in use" in s] == []
    assert "2 of 50 rows left out" in said(fit_with(out), fit_with(out))[0]
    words = said(fit_with(out), fit_with(back))
    assert "1 of 50 rows left out" in words[0]
    assert "1 row left out by the fit of geometry alone is explained by the effects" in words[1]
    assert "not converged after 60" in said(fit_with({}), fit_with({}, converged=False))[-1]
    once = said(fit_with({}), fit_with({}, converged=False, iterations=1))
    assert once[-1] == "the fit had not converged after 1 iteration"


def test_parameters_that_imitate_are_told_by_how_far_they_moved() -> None:
    """They are within their tolerances, or not: what is told is the way between two models."""
    record: Any = SimpleNamespace(absorbed_by_geometry=[SimpleNamespace(name="a.x")])
    assert confounded(record) == ("Without what is named, 1 parameter moved by more than its "
                                  "tolerance to imitate it, most a.x.")


@pytest.mark.parametrize(("left", "words"), [
    ({"excess": 3.5, "ratio": 1.4}, "1.40 times the stated noise"),
    ({"ratio": 0.01}, "only 0.01 times the stated noise")])
def test_residuals_above_or_far_below_the_noise_are_said(left: dict[str, float], words: str
                                                         ) -> None:
    assert words in " ".join(said(fit_with({}), fit_with({}), **left))


def test_what_geometry_imitates_is_said_once() -> None:
    machine = SimpleNamespace(with_values=lambda values: None)
    fit: Any = SimpleNamespace(problem=SimpleNamespace(datasets=(), mechanism=machine), reasons=(),
                               converged=True, state=SimpleNamespace(g=None))
    out: Any = SimpleNamespace(sentence="")
    effects: Any = [SimpleNamespace(kind=k, visibility=s, side=lambda machine: "",
                                          hypothesis=SimpleNamespace(called=k)) for k, s in
                    (("gain", 0.1), ("gain", 0.19), ("lag", 0.21), ("play", 0.01))]
    said, = findings(fit, fit, remainder(), effects, None, out)
    assert said.startswith("gain, play: geometry absorbs most of it")
    assert findings(fit, fit, remainder(), effects[2:3], None, out) == []
    doubt: Any = SimpleNamespace(confirmed=False)
    said, = findings(fit, fit, remainder(), effects[2:3], doubt, out)
    assert "do not confirm" in said


@pytest.mark.parametrize(("verdict", "words"), [
    ("none", "nothing more to measure: no missing"), ("weak", "repeat the campaign"),
    ("named", "nothing more to measure: the named"), ("partial", "measure the same poses again")])
def test_the_next_step_of_each_verdict(verdict: str, words: str) -> None:
    assert advice(verdict, 2, ()).reason.startswith(words)


@pytest.mark.parametrize(("columns", "missing"), [
    ((), "(load, temperature, time)"), (("tension_leg1", "time"), "(temperature)"),
    (("payload", "temperature"), "(time)"), (("fz", "temperature", "dir_leg1"), "(time)")])
def test_what_is_recorded_is_not_asked_for(columns: tuple[str, ...], missing: str) -> None:
    data: Any = SimpleNamespace(columns=dict.fromkeys(columns))
    assert advice("unnamed", 2, (data,)).reason.endswith(missing)


def test_what_held_out_poses_do_not_confirm_is_to_be_measured_again() -> None:
    gap: Any = SimpleNamespace(confirmed=False)
    assert "do not confirm" in advice("named", 2, (), gap).reason
    assert "do not confirm" not in advice("unnamed", 2, (), gap).reason


def hypothesis(**traits: Any) -> Hypothesis:
    parts: dict[str, Any] = {"kind": "play", "on": ("leg1",), "shared": True, "names": ("width",),
                             "low": (0.0,), "high": (1.0,), "columns": (3,)} | traits
    return Hypothesis(**parts)


@pytest.mark.parametrize(("one", "other", "apart"), [
    ({"tau": 2.0}, {"tau": 4.0}, 1.0 / 3.0), ({"tau": 2.0, "reach": 0.3}, {"tau": 2.0}, 1.0),
    ({"tau": -1.0}, {"tau": 3.0}, 1.0), ({"tau": 5.0}, {"tau": 5.0}, 0.0),
    ({"tau": 1.0, "low": 0.0}, {"tau": 3.0, "low": 9.0}, 0.5), ({}, {}, 0.0)])
def test_constants_differ_by_parts_of_both(one: dict[str, float], other: dict[str, float],
                                           apart: float) -> None:
    """Ends of a stroke are each joint's own, and no difference."""
    a, b = (hypothesis(constants=c, strokes=("low",)) for c in (one, other))
    assert a.apart(b) == pytest.approx(apart)
    assert b.apart(a) == pytest.approx(apart)


def test_a_label_says_what_and_where() -> None:
    assert hypothesis(on=("leg1", "leg2")).label == "play on leg1, leg2"
    assert hypothesis(slot="leg1.length").label == "geometry leg1.length"
    assert hypothesis(anonymous=True, follows="leg2").label == "an unknown shape along leg2"
