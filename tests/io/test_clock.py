"""Times in every usual writing; what could be read in two ways is refused."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.errors import BadInput
from ppmcal.io.clock import clock_of_numbers, clock_of_words, on_clock_of

NOON = 20516 * 86400.0 + 43200.0    # 2026-03-04 12:00:00


def at(i: int) -> str:
    return f"t.csv: row {i + 1}, column time"


@pytest.mark.parametrize(("text", "expected"), [
    ("12:00:00", 43200.0), ("12:00:00.25", 43200.25), ("12:00:00,250", 43200.25),
    ("12:00:00:250", 43200.25), ("12:00", 43200.0), ("12:00:00 AM", 0.0), ("12:00 pm", 43200.0),
    ("1:00:00 PM", 46800.0), ("2026-03-04T12:00:00", NOON), ("2026-03-04 12:00:00.5", NOON + 0.5),
    ("20260304T120000", NOON), ("2026-03-04T12:00:00Z", NOON),
    ("2026-03-04T13:00:00+01:00", NOON), ("2026-03-04T06:30:00-0530", NOON),
    ("04.03.2026 12:00:00", NOON), ("4-Mar-2026 12:00:00", NOON), ("March 4, 2026 12:00", NOON),
    ("03/14/2026 12:00:00", NOON + 864000.0), ("14/03/2026, 12:00:00 PM", NOON + 864000.0)])
def test_a_time_is_understood(text: str, expected: float) -> None:
    assert clock_of_words([text], at).seconds[0] == expected


def test_one_date_tells_the_order_of_all() -> None:
    clock = clock_of_words(["03/04/2026 12:00:00", "", "03/14/2026 12:00:00"], at)
    np.testing.assert_array_equal(clock.seconds, [NOON, np.nan, NOON + 864000.0])
    assert "month first" in clock.words
    told = clock_of_words(["03/04/2026 12:00:00"], at, "day-first")
    assert told.seconds[0] == NOON + 30 * 86400.0


@pytest.mark.parametrize(("cells", "says"), [
    (["03/04/2026 12:00"], ["row 1", "day 3 of month 4", "dates: day-first"]),
    (["13/01/2026 1:00", "01/13/2026 1:00"], ["another order"]),
    (["12:00:00", "noon"], ["row 2", "'noon' is not a time"]),
    (["12:00:00", "2026-03-04 12:00:00"], ["row 2", "only one has a date"]),
    (["2026-03-04 12:00:00", "2026-03-04 12:00:00Z"], ["only one has a zone"]),
    (["25:00:00"], ["not a time of day"]), (["13:00 PM"], ["am or pm"]),
    (["2026-02-30 12:00:00"], ["does not exist"]), (["", ""], ["no row has a time"])])
def test_what_is_no_time_is_refused(cells: list[str], says: list[str]) -> None:
    with pytest.raises(BadInput) as refused:
        clock_of_words(cells, at)
    for words in says:
        assert words in str(refused.value)


def test_zones() -> None:
    utc = clock_of_words(["2026-03-04T12:00:00Z"], at)
    for zone, text in (("+02:00", "14"), ("UTC", "12"), ("Europe/Berlin", "13")):
        local = clock_of_words([f"2026-03-04 {text}:00:00"], at, None, zone)
        assert local.zoned and local.seconds[0] == utc.seconds[0]
    with pytest.raises(BadInput, match="unknown zone"):
        clock_of_words(["2026-03-04 14:00:00"], at, None, "Mars/Base")
    for text in ("2026-03-29 02:30:00", "2026-10-25 02:30:00"):
        with pytest.raises(BadInput, match="forward or back"):
            clock_of_words([text], at, None, "Europe/Berlin")
    bare = clock_of_words(["2026-03-04 12:00:00"], at)
    with pytest.raises(BadInput, match=r"zone: \+02:00"):
        on_clock_of(utc, bare, "log.csv", "points.csv")


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e6, 1e9])
def test_numbers_since_1970_in_any_part_of_a_second(scale: float) -> None:
    clock = clock_of_numbers(np.array([NOON, NOON + 1.5]) * scale, "t")
    np.testing.assert_allclose(clock.seconds, [NOON, NOON + 1.5], rtol=0, atol=1e-6)
    assert clock.zoned and not clock.counter


def test_counters_and_their_units() -> None:
    assert clock_of_numbers(np.array([0.0, 5.0]), "t").counter
    np.testing.assert_array_equal(clock_of_numbers(np.array([500.0]), "t", 1e-3).seconds, [0.5])
    with pytest.raises(BadInput, match="some times are seconds since 1970"):
        clock_of_numbers(np.array([1.0, NOON]), "t")
    with pytest.raises(BadInput, match="clock-offset"):
        on_clock_of(clock_of_numbers(np.array([1.0]), "t"), clock_of_words(["1:00"], at), "a", "b")


def test_a_run_over_midnight_in_any_order() -> None:
    cells = ["23:59:00", "23:59:30", "00:00:10", "00:01:00"]
    expected = np.array([0.0, 30.0, 70.0, 120.0])
    for order in ([0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1]):
        found = clock_of_words([cells[i] for i in order], at).seconds
        np.testing.assert_array_equal(found - found[order.index(0)], expected[order])
    day = clock_of_words(["2026-03-03 23:59:00", "2026-03-04 00:01:00"], at)
    after = on_clock_of(day, clock_of_words(["00:01:00"], at), "a", "b")
    assert after[0] == day.seconds[1]
