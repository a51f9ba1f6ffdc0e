"""Constants of effects that a search tries."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.diagnosis.grids import NEAR, _meeting


@pytest.mark.parametrize("sizes", [[1.0], [1.0, 2.0], [1.0, NEAR**2], [2.6e-5, 8.3e-3],
                                   [1e-6, 1.0, 1e4]])
def test_every_size_between_those_that_are_tried_is_near_one_of_them(sizes: list[float]) -> None:
    tried = np.array(_meeting(sizes))
    assert set(sizes) <= set(tried.tolist()) and np.all(np.diff(tried) > 0.0)
    between = np.geomspace(sizes[0], sizes[-1], 1001)
    apart = np.abs(np.log(between[:, None] / tried)).min(axis=1)
    assert apart.max() <= np.log(NEAR) * (1.0 + 1e-12)


def test_sizes_that_are_near_enough_are_all_that_is_tried() -> None:
    assert _meeting([3.0, 1.0, 16.0]) == [1.0, 3.0, 16.0]
