"""The study of how often intervals of exported numbers hold: which formats, and how it counts."""

from __future__ import annotations

import number_coverage
import numpy as np
import pytest
from number_coverage import CASES, Held, rate, table

import ppmcal
from ppmcal.controllers import loaded, own


@pytest.mark.long
def test_every_format_whose_numbers_have_intervals_is_studied() -> None:
    """Others have tables or bodies in place of numbers, or do not say what these follow."""
    studied = {form for case in CASES for form in case.formats}
    assert studied <= set(own())
    machine = ppmcal.load(ppmcal.shipped("3-RPR"))
    for form in set(own()) - studied:
        made = loaded(form).export(machine, None, None)
        assert made.again is None or not made.numbers, form


@pytest.mark.parametrize("case", range(len(CASES)))
def test_the_machines_are_read(case: int, tmp_path) -> None:
    tree, _ = number_coverage._trees(case)
    path = tmp_path / "m.yaml"
    path.write_text(tree)
    assert ppmcal.load(path).free


def test_numbers_that_go_together_count_as_fewer() -> None:
    """As often as campaigns differ by more than a toss for each number would make them."""
    rng = np.random.default_rng(1)
    apart = rng.binomial(10, 0.9, 400)
    together = 10 * rng.binomial(1, 0.9, 400)
    wide = [rate(held, np.full(400, 10)) for held in (apart, together)]
    width = [high - low for _, low, high in wide]
    assert width[1] / width[0] == pytest.approx(np.sqrt(10.0), rel=0.15)
    for share, low, high in wide:
        assert low < 0.9 < high and low < share < high


def test_a_table_has_a_line_for_each_format_that_was_exported() -> None:
    lines = table([Held(0, "klipper", 9, 10), Held(0, "klipper", 10, 10), Held(5, "maslow", 0, 0)])
    assert len(lines) == 3 and lines[2].startswith("| `klipper` | delta-linear | 2 | 20 | 95.0 (")
