"""What is under way: stages in stages, and a time left only where there is a basis for it."""

from __future__ import annotations

import timeit

import pytest

from ppmcal.wording import progress
from ppmcal.wording.progress import (
    Watch,
    course,
    end,
    no_progress,
    note,
    reports_progress,
    stage,
    start_stage,
    watching,
)


class Clock:
    """A clock that goes on when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def run(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(progress, "perf_counter", found)
    return found


def test_nobody_watches() -> None:
    """Then it costs next to nothing: some microseconds for each pass over the rows."""
    def work() -> None:
        with stage("fitting", 3) as now:
            now.done()
            note("iteration 1")
        start_stage("next")
        end()

    assert timeit.timeit(work, number=2000) / 2000 < 1e-4


def test_steps_that_are_done_say_how_long_the_others_take(clock: Clock) -> None:
    with watching(Watch()) as watch, stage("simulating", 10, "machines") as work:
        assert watch.left() is None
        clock.run(0.2)
        work.done()
        assert watch.left() is None    # too short to tell
        clock.run(1.8)
        work.done(3)
        assert watch.left() == pytest.approx(3.0)
        clock.run(1.0)
        assert watch.left() == pytest.approx(2.0)
        assert watch.line() == "simulating: 4 of 10 machines"


def test_measured_shares_say_how_long_the_rest_takes(clock: Clock) -> None:
    with watching(Watch()) as watch, course({"reading": 1.0, "fitting": 4.0, "writing": 5.0}):
        start_stage("reading")
        clock.run(1.0)
        assert watch.left() is None
        start_stage("fitting")
        assert watch.left() == pytest.approx(9.0)
        clock.run(2.0)
        assert watch.left() == pytest.approx(7.0)
        clock.run(6.0)    # twice as long as its share: nobody knows
        assert watch.left() is None
        start_stage("writing")
        assert watch.left() == pytest.approx(9.0)


def test_a_stage_that_does_not_come_takes_its_share_with_it(clock: Clock) -> None:
    with watching(Watch()) as watch, course({"a": 1.0, "b": 8.0, "c": 1.0}):
        start_stage("a")
        clock.run(2.0)
        start_stage("c")
        assert watch.left() == pytest.approx(2.0)


def test_a_stage_that_comes_again_takes_as_long_as_before(clock: Clock) -> None:
    with watching(Watch()) as watch, course({"test": 1.0, "fit": 1.0, "write": 1.0}):
        start_stage("test")
        clock.run(3.0)
        start_stage("fit")
        clock.run(3.0)
        start_stage("test")
        assert watch.left() == pytest.approx(6.0)
        clock.run(1.0)
        assert watch.left() == pytest.approx(5.0)


def test_stages_within_stages_sharpen_the_estimate(clock: Clock) -> None:
    shares = {"fitting": {"near": 1.0, "all": 3.0}}
    with watching(Watch(shares=shares)) as watch, course({"fitting": 1.0, "writing": 1.0}):
        with stage("fitting"):
            with stage("near"):
                clock.run(2.0)
            with stage("all"):
                assert watch.left() == pytest.approx(6.0 + 8.0)
                note("iteration 1")
                assert watch.line() == "fitting: all: iteration 1"
        assert watch.line() == ""


def test_what_ends_in_an_error_leaves_nothing_open() -> None:
    with watching(Watch()) as watch, course({"a": 1.0}):
        start_stage("a")
        with pytest.raises(ValueError, match="no"), stage("b"):
            start_stage("c")
            raise ValueError("no")
        assert watch.line() == "a"
    assert watch.stages == ()


def test_the_python_face_hears_lines() -> None:
    @reports_progress
    def work(progress: object = no_progress) -> int:
        start_stage("reading")
        with stage("fitting"):
            note("iteration 1")
        return 3

    lines: list[str] = []
    assert work(progress=lines.append) == 3
    assert lines == ["reading", "reading: fitting", "reading: fitting: iteration 1"]
    assert work() == 3


def test_a_decorated_function_is_a_stage_each_time_it_is_called() -> None:
    lines: list[str] = []

    @stage("counting")
    def down(n: int) -> int:
        return n and down(n - 1)

    with watching(Watch(lines.append)) as watch:
        assert down(2) == 0
        assert watch.stages == ()
    assert lines == ["counting"] * 3
