"""Verdicts, what is said beside them, and what residuals are held against."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.diagnosis import rivals, verdict, whitening
from ppmcal.diagnosis.adequacy import Remainder, inputs
from ppmcal.diagnosis.hypotheses import Hypothesis, united
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.verdict import decide, findings, next_step, not_predicted

Array = NDArray[np.float64]


def remainder(ratio: float, excess: float = 0.0, p: float = 1.0) -> Remainder:
    return Remainder(ratio, excess, 1.0, "stated", "", p, {})


class Block:
    """Records by how much effects close in all rows, and whether the rest is noise."""

    def __init__(self) -> None:
        self.asked: list[tuple[float, bool]] = []

    def fails(self, everywhere: float, adequate: bool) -> bool:
        self.asked.append((everywhere, adequate))
        return True


@pytest.mark.parametrize(("start", "left", "closed"), [
    (5.0, 1.0, 1.0), (5.0, 0.7, 1.0), (5.0, 5.0, 0.0), (5.0, 7.0, 0.0),
    (np.sqrt(17.0), np.sqrt(5.0), 0.5), (np.sqrt(101.0), np.sqrt(2.0), 0.9)])
def test_what_effects_close_is_of_the_excess_over_the_noise(start: float, left: float,
                                                            closed: float) -> None:
    """As lengths, not as squares: an excess of 4 that becomes 2 is halved."""
    block: Any = Block()
    assert not_predicted([block], remainder(left, 0.0), remainder(start)) == [block]
    assert block.asked == [(pytest.approx(closed), True)]
    not_predicted([block], remainder(left, 1e3), remainder(start))
    assert block.asked[1][1] is False


@pytest.mark.parametrize("start", [1.0, 0.9])
def test_where_nothing_exceeded_the_noise_nothing_is_to_be_predicted(start: float) -> None:
    block: Any = Block()
    assert not_predicted([block], remainder(0.5), remainder(start)) == []
    assert block.asked == []


def found(p: float = -100.0) -> Any:
    search = SimpleNamespace(name=np.log(1e-4), detect=np.log(1e-3))
    return SimpleNamespace(first=SimpleNamespace(search=search, log_p=np.array([p])), before=None)


def decided(left: Remainder, start: Remainder, effects: int = 1, few: bool = False,
            alternatives: bool = False, p: float = -100.0, suspicious: bool = False,
            imitated: bool = False) -> str:
    named: Any = [SimpleNamespace(alternatives=["x"] if alternatives else [])] * effects
    out: Any = SimpleNamespace(suspicious=suspicious)
    return decide(found(p), left, start, named, out, [], imitated)


def test_the_verdict_of_each_case(monkeypatch: pytest.MonkeyPatch) -> None:
    few: list[bool] = []
    monkeypatch.setattr(verdict, "few_poses", lambda fit: few)
    noise, much, far = remainder(1.0), remainder(3.0, 50.0, 1e-9), remainder(9.0, 99.0, 1e-9)
    assert decided(noise, far) == "named"
    assert decided(noise, far, alternatives=True) == "named-set"
    assert decided(noise, far, suspicious=True) == "partial"
    assert decided(noise, far, imitated=True) == "unnamed"
    assert decided(far, far, effects=0) == "unnamed"
    assert decided(noise, noise, effects=0, p=-1.0) == "none"
    assert decided(noise, noise, effects=0, p=-8.0) == "weak"
    assert decided(noise, noise, effects=0, p=-100.0) == "unnamed"
    assert decided(noise, noise, effects=0, p=-1.0, suspicious=True) == "unnamed"
    assert decided(noise, noise, imitated=True, p=-1.0) == "none"
    assert decided(much, far) == "partial"
    few[:] = [True]
    assert decided(much, far) == "unnamed"


@pytest.mark.parametrize(("left", "words"), [(np.sqrt(9.9), "partial"), (np.sqrt(11.2), "unnamed")])
def test_less_than_half_explained_is_no_name(monkeypatch: pytest.MonkeyPatch, left: float,
                                             words: str) -> None:
    """Of what exceeds the noise, in squares: of 21 units 20 do; 11 more than half, 9.8 less."""
    monkeypatch.setattr(verdict, "few_poses", lambda fit: [])
    start = remainder(np.sqrt(21.0), 50.0, 1e-9)
    assert decided(remainder(left, 50.0, 1e-9), start) == words


def test_what_geometry_imitates_is_said_once() -> None:
    machine = SimpleNamespace(with_values=lambda values: None)
    fit: Any = SimpleNamespace(problem=SimpleNamespace(datasets=(), mechanism=machine), reasons=(),
                               converged=True, state=SimpleNamespace(g=None))
    out: Any = SimpleNamespace(sentence="")
    effects: Any = [SimpleNamespace(kind=k, survival=s, side=lambda machine: "",
                                          hypothesis=SimpleNamespace(called=k)) for k, s in
                    (("gain", 0.1), ("gain", 0.19), ("lag", 0.21), ("play", 0.01))]
    said, = findings(fit, fit, remainder(1.0), effects, None, out, ())
    assert said.startswith("gain, play: geometry imitates most of it")
    assert findings(fit, fit, remainder(1.0), effects[2:3], None, out, ()) == []
    doubt: Any = SimpleNamespace(confirmed=False)
    said, = findings(fit, fit, remainder(1.0), effects[2:3], doubt, out, ())
    assert "do not confirm" in said


def hypothesis(**traits: Any) -> Hypothesis:
    parts: dict[str, Any] = {"kind": "play", "on": ("leg1",), "shared": True, "names": ("width",),
                             "low": (0.0,), "high": (1.0,), "columns": (3,)} | traits
    return Hypothesis(**parts)


def stage_of(*hypotheses: Any) -> Any:
    problem = SimpleNamespace(mechanism=SimpleNamespace(actuators=("leg1", "leg2")))
    return SimpleNamespace(hypotheses=hypotheses, system=SimpleNamespace(problem=problem))


@pytest.mark.parametrize(("effect", "words"), [(None, "record more"),
                                               (SimpleNamespace(remedy="warm it up"), "warm it")])
def test_of_what_is_not_named_the_nearest_suspect_says_what_to_do(
        monkeypatch: pytest.MonkeyPatch, effect: Any, words: str) -> None:
    rival = SimpleNamespace(hypothesis=SimpleNamespace(effect=effect))
    monkeypatch.setattr(verdict, "measured_against", lambda stage: iter([rival]))
    assert next_step(stage_of(), {}, "unnamed", 1).reason.startswith(words)
    assert next_step(stage_of(), {}, "named", 1).reason.startswith("nothing more to measure")


def test_a_frozen_slot_has_no_experiment_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor has what has no rivals; the likeliest rival is the one with the smallest odds."""
    monkeypatch.setattr(verdict, "propose", lambda *known: known)
    stage = stage_of(hypothesis(slot="leg1.length"), hypothesis(), hypothesis(kind="lag"))
    rival: Any = [SimpleNamespace(hypothesis=n, odds=o) for n, o in ((7, 9.0), (8, 2.0), (9, 5.0))]
    asked: Any = next_step(stage, {0: (rival, []), 1: ([], []), 2: (rival, [])}, "named-set", 5)
    assert asked == (stage, stage.hypotheses[2], 8, 2.0, 5)


# --- hypotheses -----------------------------------------------------------------------------------

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
    assert a.alike(b) == (apart == 0.0)


def test_hypotheses_of_joints_are_united_in_their_order() -> None:
    parts = [hypothesis(on=(f"leg{i}",), columns=(i,), low=(-i,), high=(2.0 * i,), shared=True,
                        usual=((0.0, i),), named=((i, 9.0),), constants={"low": -float(i)},
                        strokes=("low",)) for i in (1, 2)]
    assert united(parts[:1]) is parts[0]
    both = united(parts)
    assert (both.on, both.names, both.shared) == (("leg1", "leg2"), ("leg1:width", "leg2:width"),
                                                  False)
    assert (both.low, both.high, both.columns) == ((-1, -2), (2.0, 4.0), (1, 2))
    assert (both.usual, both.named) == (((0.0, 1), (0.0, 2)), ((1, 9.0), (2, 9.0)))
    assert both.constants == {"low": -1.0}      # the first's stands for all


def test_a_label_says_what_and_where() -> None:
    assert hypothesis(on=("leg1", "leg2")).label == "play on leg1, leg2"
    assert hypothesis(slot="leg1.length").label == "geometry leg1.length"
    assert hypothesis(anonymous=True, follows="leg2").label == "an unknown shape along leg2"


# --- what residuals are held against --------------------------------------------------------------

def system_of(motion: str = "spatial", n: int = 6, **rows: Any) -> Any:
    """Return n rows of a machine with two joints, at poses and joints that differ."""
    rng = np.random.default_rng(1)
    pose = np.tile([1.0, *[0.0] * 7], (n, 1))
    pose[:, 4:7] = -0.5 * rng.normal(size=(n, 3))
    none: dict[str, Any] = {"approach": np.zeros((n, 2)), "velocity": np.zeros((n, 2)),
                            "temperature": np.zeros(n), "wrench": np.zeros((n, 6)),
                            "time": np.full(n, np.nan)} | rows
    part = SimpleNamespace(at=slice(0, n), response=SimpleNamespace(
        rows=SimpleNamespace(**none), pose=pose),
        setting=SimpleNamespace(travel=np.stack([np.arange(n) ** 2.0, np.full(n, 3.0)], axis=-1)))
    dof = {"spatial": (0, 1, 2, 3, 4, 5), "translational": (0, 1, 2)}[motion]
    mechanism = SimpleNamespace(dof=dof, actuators=("leg1", "leg2"))
    return SimpleNamespace(firsts=(part,), problem=SimpleNamespace(mechanism=mechanism))


def test_residuals_are_held_against_what_varies() -> None:
    """What stands still, or is not known in some row, is left out; of columns the others stay."""
    found = inputs(system_of())
    assert set(found) == {"position", "leg1", "time", "previous move"}
    assert found["position"][0].shape == (6, 3)
    np.testing.assert_array_equal(found["leg1"][0][:, 0], np.arange(6) ** 2.0)
    np.testing.assert_array_equal(found["previous move"][0][:, 0], [0, 1, 3, 5, 7, 9])
    approach = np.array([[1.0, 1.0], [-1.0, 1.0]] * 3)
    more = inputs(system_of(approach=approach, temperature=np.arange(6.0),
                            velocity=np.where(np.arange(12) == 3, np.nan, 1.0).reshape(6, 2),
                            wrench=np.outer(np.arange(6), [0, 0, 1, 0, 0, 0])))
    assert set(more) - set(found) == {"direction", "temperature", "payload"}
    np.testing.assert_array_equal(more["direction"][0], approach[:, :1])
    np.testing.assert_array_equal(more["payload"][0][:, 0], np.arange(6))


@pytest.mark.parametrize(("time", "seen"), [
    ([0.0, 5.0, 6.0, 7.0, 8.0, 60.0], [0.0, 5.0, 6.0, 7.0, 8.0, 60.0]),
    ([0.0, 0.1, 0.2, 0.3, 0.4, 0.6], [0.0, 0.1, 0.2, 0.3, 0.4, 0.6]),
    ([3.0] * 6, list(range(6))), ([0.0, np.nan, 2.0, 3.0, 4.0, 5.0], list(range(6)))])
def test_time_is_the_order_of_rows_where_it_is_not_known(time: list[float], seen: list[float]
                                                         ) -> None:
    """Or where a clock stood still."""
    np.testing.assert_array_equal(inputs(system_of(time=np.array(time)))["time"][0][:, 0], seen)


def test_turns_are_there_where_a_machine_turns() -> None:
    system = system_of()
    turn = np.linspace(0.0, 0.3, 6)
    system.firsts[0].response.pose[:, 0] = np.cos(turn / 2.0)
    system.firsts[0].response.pose[:, 1] = np.sin(turn / 2.0)
    assert inputs(system)["rotation"][0].shape[1] >= 1
    still = system_of("translational")
    assert "rotation" not in inputs(still)
    assert inputs(still)["position"][0].shape == (6, 3)


def test_values_that_were_not_measured_are_no_residuals() -> None:
    """Whitened they are zero, whatever stood there; with all measured all stay."""
    seen = np.array([[True, False], [True, True]])
    values = np.ones((2, 2, 1))
    for observed, want in ((seen, [1.0, 0.0, 1.0, 1.0]), (np.ones_like(seen), [1.0] * 4)):
        system: Any = SimpleNamespace(observed=observed, dataset=np.zeros(2, dtype=int))
        made = Whitening(np.eye(2)[None], 0.0).apply(values, system)
        np.testing.assert_array_equal(made[:, 0], want)


def test_repeats_are_of_one_pose_and_one_environment() -> None:
    """Within a fiftieth of the largest speed or load, and a twentieth of a kelvin."""
    columns = {"vel_leg1": np.array([1.0, 1.0, 0.9, 1.0, 1.0, 1.0]),
               "temperature": 20.0 + np.array([0.0, 0.0, 0.0, 0.3, 0.0, 0.0]),
               "payload": np.array([5.0] * 4 + [5.5, 5.0])}
    data = SimpleNamespace(groups=np.zeros(6, dtype=int), columns=columns, sessions=None,
                           directions=lambda: None)
    system: Any = SimpleNamespace(dataset=np.zeros(6, dtype=int), row=np.arange(6),
                                  problem=SimpleNamespace(datasets=(data,)))
    label = whitening._environments(system)
    assert label is not None
    same = label[:, None] == label
    assert same[0].tolist() == [True, True, False, False, False, True]
    assert (same.sum(axis=1) == [3, 3, 1, 1, 1, 3]).all()
    data.groups = np.arange(6)
    assert whitening._environments(system) is None


@pytest.mark.parametrize(("rho", "asked"), [(0.0, 0), (-0.3, 0), (0.3, 1)])
def test_events_are_looked_for_where_rows_go_together(monkeypatch: pytest.MonkeyPatch, rho: float,
                                                      asked: int) -> None:
    """A pair of steps that is there makes rows alike, and is projected out beside the others."""
    columns: list[list[int]] = []

    def of_rest(system: Any, library: Any, chosen: Any) -> Any:
        columns.append(list(chosen))
        return SimpleNamespace(rho=rho)

    monkeypatch.setattr(whitening, "_projected", lambda *known: [4, 2])
    monkeypatch.setattr(whitening, "_of_rest", of_rest)
    monkeypatch.setattr(whitening, "best_pair", lambda *known: (2, 9))
    none: Any = None
    whitening.estimate(none, none)
    assert columns == [[4, 2], [4, 2, 9]][:1 + asked]


def test_of_choices_as_good_the_first_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """And no more than three are looked at."""
    values = {(0,): 5.0, (1,): 3.0, (2,): 3.0, (3,): 1.0}
    monkeypatch.setattr(rivals, "merged", lambda search, chosen: (search, chosen))
    monkeypatch.setattr(rivals, "simplified", lambda search, chosen: (search, chosen))
    monkeypatch.setattr(rivals, "bic", lambda search, chosen: values[tuple(chosen)])
    search: Any = None
    choices: Any = [SimpleNamespace(chosen=c) for c in values]
    assert rivals.settled(search, choices)[1] == (1,)
    assert rivals.settled(search, choices[::-1])[1] == (3,)
