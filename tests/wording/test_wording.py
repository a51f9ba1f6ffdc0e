"""Words for lists: of more than three of a kind one sentence, with a count and where they are."""

from __future__ import annotations

import pytest

from ppmcal.wording import gathered, sentence, some


@pytest.mark.parametrize("count, text", [
    (0, ""), (1, "a1"), (3, "a1, a2, a3"), (4, "a1, a2, a3, a4"),
    (5, "a1, a2, a3 and 2 more (all in x.csv)"), (9, "a1, a2, a3 and 6 more (all in x.csv)")])
def test_some_of_many_are_named(count: int, text: str) -> None:
    assert some([f"a{i}" for i in range(1, count + 1)], "x.csv") == text


def test_nine_sentences_of_a_kind_are_one() -> None:
    limbs = [f"limb 'leg{i}' does not close at home: the gap is {0.1 * i:.1f} mm" for i in
             range(1, 10)]
    (text,) = gathered(limbs, "in the JSON")
    assert text.startswith("9 alike: limb 'leg1'")
    assert "leg3" in text
    assert "leg4" not in text
    assert text.endswith("and 6 more (in the JSON)")


def test_sentences_of_other_kinds_stay_apart() -> None:
    lines = ["run1: 3 of 120 rows left out", "run2: 1 of 40 rows left out",
             "the fit had not converged", "run3: 2 of 9 rows left out"]
    assert sorted(gathered(lines, "x")) == sorted(lines)
    assert gathered([], "x") == []


def test_a_sentence_begins_large_and_ends_once() -> None:
    assert sentence(" what is left. ") == "What is left."
    assert sentence("") == ""
