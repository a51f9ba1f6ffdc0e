"""Words for lists: of more than three of a kind one sentence, with a count and where they are."""

from __future__ import annotations

import pytest

from ppmcal.wording import abbreviate_list, collapse_similar, sentence


@pytest.mark.parametrize("count, text", [
    (0, ""), (1, "a1"), (3, "a1, a2, a3"), (4, "a1, a2, a3, a4"),
    (5, "a1, a2, a3 and 2 more (all in x.csv)"), (9, "a1, a2, a3 and 6 more (all in x.csv)")])
def test_some_of_many_are_named(count: int, text: str) -> None:
    assert abbreviate_list([f"a{i}" for i in range(1, count + 1)], "x.csv") == text


def test_nine_sentences_of_a_kind_are_one() -> None:
    limbs = [f"limb 'leg{i}' does not close at home: the gap is {0.1 * i:.1f} mm" for i in
             range(1, 10)]
    (text,) = collapse_similar(limbs, "in the JSON")
    assert text == ("limb 'leg1' does not close at home: the gap is 0.1 mm; likewise 'leg2', "
                    "'leg3', 'leg4' and 5 more (in the JSON)")


@pytest.mark.parametrize("lines, told", [
    ([f"/a b/run{i}.csv: no column pose." for i in (1, 2)],
     "/a b/run1.csv, /a b/run2.csv: no column pose."),
    ([f"{d}: the noise is estimated" for d in ("morning", "evening")],
     "morning, evening: the noise is estimated"),
    ([f"row {i} refused: out of reach" for i in range(1, 10)],
     "rows 1, 2, 3 and 6 more (x) refused: out of reach"),
    ([f"row {i}: singular: q_leg{i} is at its end" for i in range(1, 5)],
     "row 1: singular: q_leg1 is at its end; likewise rows 2, 3, 4"),
    (["the fit had not converged"] * 2, "the fit had not converged")])
def test_a_fact_of_several_files_or_rows_is_told_once(lines: list[str], told: str) -> None:
    assert collapse_similar(lines, "x") == [told]


def test_sentences_of_other_kinds_stay_apart() -> None:
    lines = ["run1: 3 of 120 rows left out", "run2: 1 of 40 rows left out",
             "the fit had not converged", "run3: 2 of 9 rows left out"]
    assert sorted(collapse_similar(lines, "x")) == sorted(lines)
    assert collapse_similar([], "x") == []


def test_a_sentence_begins_large_and_ends_once() -> None:
    assert sentence(" what is left. ") == "What is left."
    assert sentence("") == ""
