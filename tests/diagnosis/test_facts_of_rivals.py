"""Kinds that contain others: the plain one is named unless what the general one adds is a name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ppmcal.diagnosis.added_variable_test import build_test
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.rivals import as_one, simplified
from ppmcal.diagnosis.search import Search
from ppmcal.diagnosis.selection import own_log_p
from ppmcal.model.effects import effect_kinds

PLAIN, GENERAL = effect_kinds()["backlash"], effect_kinds()["friction"]
NAME = -9.0


def case(on: str, own: float, more: float, high: float = np.inf, shared: bool = True) -> Search:
    """Return a search: plain kinds on each of two joints, and a general one of two columns.

    ``own`` of the plain columns is in the data, and ``more`` of what only the general kind has.
    ``high``: how large the plain kind's coefficient may be.
    """
    rng = np.random.default_rng(1)
    n = 200
    columns = rng.normal(size=(n, 4))
    joints = ["ab".index(a) for a in on]
    if shared:
        columns[:, 2] = columns[:, joints].sum(axis=1)
    residual = rng.normal(size=n) + own * columns[:, joints].sum(axis=1) + more * columns[:, 3]
    test = build_test(np.linalg.qr(rng.normal(size=(n, 3)))[0], columns, residual, n)
    plain = [Hypothesis("backlash", (a,), True, ("width",), (-np.inf,), (high,), (c,), effect=PLAIN)
             for c, a in enumerate("ab")]
    columns_of_general = (2, 3) if shared else (*joints, 3)
    size = len(columns_of_general)
    general = Hypothesis("friction", tuple(on), shared, ("static",) * size, (-np.inf,) * size,
                         (np.inf,) * size, columns_of_general, effect=GENERAL)
    return Search(test, (*plain, general), -7.0, NAME, np.zeros(1))


@pytest.mark.parametrize("on", ["a", "ab"])
@pytest.mark.parametrize(("own", "more", "high", "plain"), [
    (2.0, 0.0, np.inf, True), (2.0, 0.35, np.inf, True), (2.0, 1.0, np.inf, False),
    (2.0, 0.0, 1.0, False), (0.0, 0.0, np.inf, False)])
def test_the_plain_kind_is_named_where_it_stands_and_the_rest_is_no_name(
        on: str, own: float, more: float, high: float, plain: bool) -> None:
    """Not where what is added reaches the threshold itself, nor where the plain is not possible."""
    search = case(on, own, more, high)
    made, found = simplified(search, (2,))
    kinds = [(made.hypotheses[i].kind, made.hypotheses[i].on, made.hypotheses[i].shared)
             for i in found]
    assert kinds == [("backlash" if plain else "friction", tuple(on), True)]
    if plain:
        # at p = 0.03 BIC alone would have it
        added = own_log_p(made, [*found, 2], 2)
        assert added > NAME
        assert (added < np.log(0.03)) == (more > 0.0)


def test_a_value_for_each_joint_is_replaced_joint_by_joint() -> None:
    found = simplified(case("ab", 2.0, 0.0, shared=False), (2,))[1]
    assert sorted(found) == [0, 1]
    assert simplified(case("ab", 2.0, 1.0, shared=False), (2,))[1] == (2,)


def test_what_is_no_part_of_the_general_kind_does_not_replace_it() -> None:
    """Its columns are others, or it is missing on a joint, or no kind contains it."""
    search = case("ab", 2.0, 0.0)
    rng = np.random.default_rng(2)
    other = build_test(np.linalg.qr(rng.normal(size=(200, 3)))[0], rng.normal(size=(200, 4)),
                       rng.normal(size=200), 200)
    for changed in (replace(search, test=other), replace(search, hypotheses=tuple(
            replace(h, on=("c",)) if n == 1 else h for n, h in enumerate(search.hypotheses))),
                    replace(search, hypotheses=tuple(
            replace(h, effect=effect_kinds()["gain"], kind="gain") if n == 2 else h
            for n, h in enumerate(search.hypotheses)))):
        assert simplified(changed, (2,))[1] == (2,)


def test_of_one_member_nothing_is_made_and_of_several_one_choice() -> None:
    search = case("ab", 2.0, 0.0)
    assert as_one(search, [1]) == (search, 1)
    made, at = as_one(search, [0, 1])
    assert at == len(search.hypotheses) == len(made.hypotheses) - 1
    assert (made.hypotheses[at].on, made.hypotheses[at].shared) == (("a", "b"), False)
