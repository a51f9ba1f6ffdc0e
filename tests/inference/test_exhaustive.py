"""The posterior over sets, against all sets one by one."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.special import logsumexp

from ppmcal.inference import sets
from ppmcal.inference.block_sets import BlockSet, state
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior

ROWS, WIDTH = 30, 2


def every(asked: Question, most: int | None = None) -> dict[frozenset[int], float]:
    """Return the log probability of every set, of ``most`` blocks at most."""
    count = len(asked.blocks)
    found = {frozenset(chosen): state(asked, chosen).log_p
             for size in range((count if most is None else most) + 1)
             for chosen in combinations(range(count), size)}
    total = float(logsumexp(list(found.values())))
    return {key: log_p - total for key, log_p in found.items()}


def asked_of(matrix: np.ndarray, effect: np.ndarray, seed: int, rho: float = 0.0,
             blocks: tuple[Block, ...] = (), alone: frozenset[str] = frozenset()) -> Question:
    """Return a question of columns (n, T) with an effect (n,) in the values."""
    rng = np.random.default_rng([seed, 1])
    noise = rng.normal(size=(ROWS, WIDTH))
    for i in range(1, ROWS):
        noise[i] = rho * noise[i - 1] + np.sqrt(1.0 - rho**2) * noise[i]
    geometry = 3.0 * rng.normal(size=(ROWS * WIDTH, 3))
    values = noise.ravel() + effect + geometry @ rng.normal(size=3)
    each = blocks or tuple(Block(f"k{i}", f"k{i}", (i,), np.log(0.05))
                           for i in range(matrix.shape[1]))
    return Question(MatrixColumns(matrix), values, geometry, each,
                    np.ones((ROWS, WIDTH), dtype=bool),
                    np.full(ROWS - 1, int(rho > 0.0)), alone)


def compared(asked: Question, within: float, most: int | None = None) -> None:
    """Hold what is said of sets, blocks, places and nothing against all sets one by one."""
    true, found = every(asked, most), posterior(asked)
    best = max(true, key=lambda key: true[key])
    assert frozenset(found.best.chosen) == best
    acting = np.zeros(len(asked.blocks))
    for key, log_p in true.items():
        acting[list(key)] += np.exp(log_p)
    assert found.probability == pytest.approx(acting, abs=within)
    empty = sum(np.exp(log_p) for key, log_p in true.items()
                if all(asked.blocks[i].family in asked.alone for i in key))
    assert found.nothing(asked.alone) == pytest.approx(empty, rel=0.2, abs=1e-12)
    for place, i in enumerate(found.best.chosen):
        if asked.blocks[i].family in asked.alone:
            continue
        family = asked.blocks[i].family
        own = sum(np.exp(log_p) for key, log_p in true.items() if i in key or any(
            asked.blocks[j].family == family for j in key - best))
        said = found.families(place)
        assert sum(said.values()) == pytest.approx(1.0)
        assert said[family] == pytest.approx(own, abs=within)


@pytest.mark.long_cases("1-sizes1", "1-sizes3", "2-sizes0", "2-sizes2", "2-sizes4")
@pytest.mark.slow
@pytest.mark.parametrize("sizes", [(), (0.4,), (0.6, 0.35), (2.0, 1.5, 0.35), (1.0, 1.0, 1.0, 0.3)])
@pytest.mark.parametrize("seed", [1, 2])
def test_causes_unlike_each_other_are_as_likely_as_all_sets_say(
        sizes: tuple[float, ...], seed: int) -> None:
    matrix = np.random.default_rng(seed).normal(size=(ROWS * WIDTH, 7))
    compared(asked_of(matrix, matrix[:, :len(sizes)] @ np.array(sizes), seed), 0.06)


@pytest.mark.parametrize("size", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_causes_that_look_alike_are_as_likely_as_all_sets_say(size: float, seed: int) -> None:
    matrix = np.random.default_rng(seed).normal(size=(ROWS * WIDTH, 6))
    matrix[:, 1] = matrix[:, 0] + 0.3 * matrix[:, 1]
    matrix[:, 3] = matrix[:, 2] + 0.5 * matrix[:, 3]
    compared(asked_of(matrix, size * (matrix[:, 0] - 0.7 * matrix[:, 2]), seed), 0.1)


@pytest.mark.parametrize("seed", [1, 3])
def test_a_sign_is_asked_in_every_set(seed: int) -> None:
    """Twins of which one may only be positive, where the effect is negative, and the other way."""
    matrix = np.random.default_rng(seed).normal(size=(ROWS * WIDTH, 4))
    matrix[:, 1] = matrix[:, 0] + 0.2 * matrix[:, 1]
    blocks = tuple(Block(f"k{i}", f"k{i}", (i,), np.log(0.05), low=low)
                   for i, low in enumerate((0.0, -np.inf, 0.0, -np.inf)))
    for sign in (1.0, -1.0):
        asked = asked_of(matrix, sign * matrix[:, 0], seed, blocks=blocks)
        compared(asked, 0.05)
        assert (posterior(asked).probability[0] > 0.05) == (sign > 0.0)    # its prior


@pytest.mark.parametrize("seed", [3, 4])
def test_what_was_scored_counts_as_what_was_looked_at(
        seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two causes, and two others that do the same: these are scored from one of them alone."""
    matrix = np.random.default_rng(seed).normal(size=(ROWS * WIDTH, 6))
    matrix[:, 2] = matrix[:, 0] + matrix[:, 1] + 0.03 * matrix[:, 2]
    matrix[:, 3] = matrix[:, 0] - matrix[:, 1] + 0.03 * matrix[:, 3]
    asked = asked_of(matrix, matrix[:, :2] @ [2.0, 1.0], seed)
    first, other = frozenset({0, 1}), frozenset({2, 3})
    search = sets.SetSearch

    class Short(search):
        """A search that has come to one pair, and to a half of the other."""

        def better(self, now: BlockSet) -> BlockSet | None:
            self._best(self.visit((2,)))
            return self.visit((0, 1)) if not now.chosen else None

        def far(self, now: BlockSet) -> BlockSet | None:
            return None

    monkeypatch.setattr(sets, "SetSearch", Short)
    found, true = posterior(asked), every(asked)
    assert frozenset(found.best.chosen) == first
    said = found.log_p[other] - found.log_p[first]
    assert said == pytest.approx(true[other] - true[first], abs=0.5) and abs(said) < 4.0
    # what is of no use beside the half that was scored is beside it, and no set by itself
    assert not [key for key in found.log_p if len(key) == 2 and key & {4, 5} and 2 in key]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_kind_on_another_joint_is_an_answer_of_its_own(seed: int) -> None:
    """Two points of a grid on each of two joints that look alike, and all are of one family."""
    matrix = np.random.default_rng(seed).normal(size=(ROWS * WIDTH, 5))
    matrix[:, 1] = matrix[:, 0] + 0.2 * matrix[:, 1]
    matrix[:, 2:4] = matrix[:, [0]] + 0.2 * matrix[:, 2:4]
    blocks = (*(Block(f"play on {on}", "play", (i,), np.log(0.01), where=on)
                for i, on in enumerate(("a", "a", "b", "b"))),
              Block("other", "other", (4,), np.log(0.01)))
    asked = asked_of(matrix, 0.8 * matrix[:, 0], seed, blocks=blocks)
    compared(asked, 0.1)
    true, found = every(asked), posterior(asked)
    said = {asked.blocks[min(m.chosen)].where: m.probability
            for m in found.members(0) if m.family}
    for on, (i, j) in {"a": (0, 1), "b": (2, 3)}.items():
        own = sum(np.exp(log_p) for key, log_p in true.items() if {i, j} & key)
        assert 0.02 < own < 0.98 and said[on] == pytest.approx(own, abs=0.1)
    assert found.families(0)["play"] > 0.95     # wherever it is


@pytest.mark.parametrize("places", [((2,), ()), ((1, 3), ()), ((1,), (3,))])
@pytest.mark.slow
def test_events_are_as_likely_as_all_sets_say(
        places: tuple[tuple[int, ...], ...]) -> None:
    """Events of one family on a, on b, and on both alike: the same set whatever came first."""
    rng = np.random.default_rng(1)
    lever = rng.normal(size=(2, ROWS * WIDTH))
    later = [np.repeat(np.arange(ROWS) >= onset, WIDTH) for onset in (6, 11, 16, 21)]
    matrix = np.column_stack([on * own for own in (*lever, lever.sum(axis=0)) for on in later])
    names = [name for name in ("a", "b", "all") for _ in later]
    blocks = tuple(Block(f"slip of {name} {i}", "slip", (i,), np.log(share * 0.02 / len(later)),
                         group=f"slip of {name}")
                   for i, name in enumerate(names) for share in (0.5 if name == "all" else 0.25,))
    effect = sum((matrix[:, 4 * n + i] * (-1.0) ** k for n, own in enumerate(places)
                  for k, i in enumerate(own)), np.zeros(ROWS * WIDTH))
    asked = asked_of(matrix, effect, 1, blocks=blocks)
    compared(asked, 0.1, most=3)
    # the prior of a set is that of adding its blocks in any order
    for chosen in ((1, 10), (10, 1), (1, 6), (2, 3)):
        one = asked.log_prior(chosen[:1]) + asked.more(chosen[:1])[chosen[1]]
        assert one == pytest.approx(asked.log_prior(chosen))


@pytest.mark.slow
def test_rows_that_do_not_belong_are_as_likely_as_all_sets_say() -> None:
    matrix = np.hstack([np.random.default_rng(5).normal(size=(ROWS * WIDTH, 3)),
                        np.eye(ROWS * WIDTH)[:, :10]])
    blocks = (*(Block(f"k{i}", f"k{i}", (i,), np.log(0.05)) for i in range(3)),
              *(Block(f"row {i}", "row", (3 + 2 * i, 4 + 2 * i), np.log(0.01)) for i in range(5)))
    effect = 0.7 * matrix[:, 0]
    effect[[0, 1, 4]] += 8.0
    compared(asked_of(matrix, effect, 5, blocks=blocks, alone=frozenset({"row"})), 0.05)


@pytest.mark.long_cases("0.0-12")
@pytest.mark.slow
@pytest.mark.parametrize(("rho", "most"), [(0.0, 12), (0.8, 3)])
def test_twelve_causes_are_as_likely_as_all_sets_say(rho: float, most: int) -> None:
    """4096 sets; two of the causes look alike, one is a slow course that noise may be."""
    rng = np.random.default_rng(7)
    matrix = rng.normal(size=(ROWS * WIDTH, 12))
    matrix[:, 1] = matrix[:, 0] + 0.4 * matrix[:, 1]
    matrix[:, 11] = np.repeat(np.cos(np.arange(ROWS) / 7.0), WIDTH)
    compared(asked_of(matrix, 0.8 * matrix[:, 0] + 0.5 * matrix[:, 5], 7, rho), 0.1,
             most)
