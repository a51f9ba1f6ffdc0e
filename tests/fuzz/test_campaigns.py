"""The short form of `make fuzz`'s poor campaigns: what failed once, and a dozen drawn ones."""

import json
import random
import warnings

import pytest

from fuzz.campaign import crashes
from fuzz.campaigns import SECONDS, case, run
from fuzz.judge import judged
from fuzz.mutations import fewer_rows

SEEDS = (0, 1, 2, 3, 4, 6, 7, 8, 9, 10)
"""Of cases that take a moment."""


def well(data):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        outcome = judged(run, data, 2 * SECONDS)
    assert not outcome.fault, f"{outcome.fault}\n{outcome.detail}"
    return outcome


@pytest.mark.long_cases("5edb1b7d2252")
@pytest.mark.slow
@pytest.mark.parametrize("path", [
    pytest.param(path, id=path.name) for name, path in crashes() if name == "campaign"])
def test_what_failed_once(path):
    well(path.read_bytes())


@pytest.mark.slow_cases("2", "3", "4", "6", "7", "8", "9", "10")
@pytest.mark.parametrize("seed", SEEDS)
def test_poor_campaigns_end_in_a_result_or_a_reason(seed):
    well(case(random.Random(seed)))


def test_a_case_is_drawn_by_its_seed_and_holds_everything():
    assert case(random.Random(5)) == case(random.Random(5)) != case(random.Random(6))
    assert set(json.loads(case(random.Random(5)))) == {"machine", "effects", "table", "sidecar",
                                                       "calls"}


def test_a_case_that_fails_gets_fewer_rows():
    data = json.dumps({"table": {"x": [1, 2, 3, 9], "y": [0, 0, 0, 0]}}).encode()
    least = fewer_rows(data, lambda d: 9 in json.loads(d)["table"].get("x", ()))
    assert json.loads(least)["table"] == {"x": [9]}
