"""Values and columns of any length, of no rank, and of no number."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.errors import LinearAlgebraError
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.given import Conditioned
from ppmcal.inference.joint import joint
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior

ROWS = 40
PRIOR = float(np.log(0.02))


def drawn() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return columns (n, 5), values (n,) with two sigma of the first in them, geometry (n, 3)."""
    rng = np.random.default_rng(0)
    matrix, geometry = rng.normal(size=(ROWS, 5)), rng.normal(size=(ROWS, 3))
    return matrix, rng.normal(size=ROWS) + 2.0 * matrix[:, 0], geometry


def asked(matrix: np.ndarray, values: np.ndarray, geometry: np.ndarray,
          *blocks: Block) -> Question:
    each = blocks or tuple(Block(f"k{i}", f"k{i}", (i,), PRIOR) for i in range(matrix.shape[1]))
    return Question(MatrixColumns(matrix), values, geometry, each,
                    np.ones((values.size, 1), dtype=bool),
                    np.ones(max(values.size - 1, 0), dtype=np.int64))


@pytest.mark.parametrize("factor", [1e-140, 1e-12, 1e12, 1e140])
def test_a_unit_of_any_size_changes_nothing(factor: float) -> None:
    matrix, values, geometry = drawn()
    plain, other = posterior(asked(matrix, values, geometry)), posterior(
        asked(factor * matrix, values, geometry))
    assert plain.best.chosen == other.best.chosen == (0,)
    assert other.best.log_p == pytest.approx(plain.best.log_p, abs=1e-6)
    assert other.probability == pytest.approx(plain.probability, abs=1e-6)


@pytest.mark.parametrize("factor", [1e3, 1e6, 1e12, 1e100])
def test_geometry_as_wide_as_it_may_be_explains_no_more(factor: float) -> None:
    """What is known of geometry before costs every set the same, however little it is."""
    matrix, values, geometry = drawn()
    found = posterior(asked(matrix, values, factor * geometry))
    wide = posterior(asked(matrix, values, 1e3 * geometry))
    assert found.best.chosen == (0,)
    assert found.probability == pytest.approx(wide.probability, abs=1e-4)


@pytest.mark.parametrize("away", [0.0, 1e3, 1e6, 1e8])
def test_values_far_from_nominal_lose_no_digits(away: float) -> None:
    """y'My of a part that geometry has wholly, beside what it leaves."""
    matrix, values, geometry = drawn()
    basis, _ = np.linalg.qr(geometry)
    left = values - basis @ (basis.T @ values)
    root = 1e3 * max(away, 1.0)
    given = Conditioned.nothing(MatrixColumns(matrix), left + away * basis.sum(axis=1)).taking(
        root * basis)
    known = 3.0 * away**2 / (1.0 + root**2)
    assert given.rest == pytest.approx(left @ left + known, rel=1e-6)
    near = Conditioned.nothing(MatrixColumns(matrix), left).taking(root * basis)
    assert given.right == pytest.approx(near.right, abs=1e-5 * np.abs(near.right).max())


@pytest.mark.parametrize("factor", [1e-6, 1e6, 1e12, 1e100])
def test_a_stated_noise_of_any_size_has_an_answer(factor: float) -> None:
    matrix, values, geometry = drawn()
    found = posterior(asked(matrix, factor * values, geometry))
    assert np.isfinite(found.best.log_p) and 0.0 <= found.nothing() <= 1.0
    assert found.best.chosen == ((0,) if factor > 1.0 else ())


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_few_rows_say_little(rows: int) -> None:
    matrix, _, geometry = drawn()
    values = np.random.default_rng(1).normal(size=rows)
    found = posterior(asked(matrix[:rows], values, geometry[:rows]))
    assert not found.best.chosen
    assert found.nothing() == pytest.approx((1.0 / 1.02) ** 5, abs=0.1 if rows else 1e-9)


def test_nothing_to_ask_is_nothing() -> None:
    matrix, values, geometry = drawn()
    assert posterior(asked(matrix[:, :0], values, geometry)).nothing() == 1.0
    assert posterior(asked(matrix, np.zeros(ROWS), geometry)).nothing() > 0.9
    assert posterior(asked(matrix, values, geometry[:, :0])).best.chosen == (0,)


def test_what_no_value_sees_keeps_its_prior() -> None:
    """A column of nothing, and one that geometry has wholly."""
    matrix, values, geometry = drawn()
    matrix[:, 1], matrix[:, 2] = 0.0, geometry[:, 0]
    found = posterior(asked(matrix, values, 1e6 * geometry))
    assert found.best.chosen == (0,)
    assert found.probability[[1, 2]] == pytest.approx([0.02 / 1.02] * 2, abs=1e-4)


def test_columns_that_depend_on_each_other_are_those_that_span_them() -> None:
    """Twice a column is one of twice the variance, by the root that says so."""
    matrix, values, geometry = drawn()
    given = Conditioned.nothing(MatrixColumns(matrix), values).taking(geometry)
    length = 1.0 / np.sqrt(np.mean(matrix[:, 0] ** 2))
    twice = Block("", "", (0, 0), 0.0, roots=(np.diag([length, length]) / np.sqrt(2.0),))
    once = Block("", "", (0,), 0.0)
    assert joint(given, [twice]).log_evidence == pytest.approx(
        joint(given, [once]).log_evidence, abs=1e-9)
    whole = joint(given, [Block("", "", (0, 1, 0, 1, 2), 0.0)])
    assert np.isfinite(whole.log_evidence) and np.isfinite(np.concatenate(whole.sigmas)).all()


def test_blocks_that_stand_twice_share_what_one_had() -> None:
    matrix, values, geometry = drawn()
    found = posterior(asked(np.hstack([matrix, matrix]), values, geometry))
    one, = found.best.chosen
    assert one in (0, 5)
    assert found.probability[0] == pytest.approx(found.probability[5], rel=0.05)
    assert found.probability[[0, 5]].sum() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e160])
@pytest.mark.parametrize("what", ["column", "value", "geometry"])
def test_what_is_no_number_is_refused(bad: float, what: str) -> None:
    matrix, values, geometry = drawn()
    {"column": matrix[:, 0], "value": values, "geometry": geometry[:, 0]}[what][3] = bad
    with pytest.raises(LinearAlgebraError), np.errstate(all="ignore"):
        posterior(asked(matrix, values, geometry))
