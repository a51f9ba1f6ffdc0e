"""Do a bed's heights go with the way of the head? The regression that labels of beds come from.

    PYTHONPATH=benchmarks python -m labelled.beds --data DIR

Independent of the tool: heights as the firmware saved them, on a polynomial in x and y, with and
without the way of the head along x before the touch, times 1, x and y (a backlash of three towers
looks like that). There: p below 1e-6 with every degree; not there: above 0.05 with every degree; in
between nothing is said, and the bed has no label.
"""

from __future__ import annotations

import argparse
import csv
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import f as fisher

from ppmcal.linalg import Array

DEGREES = (3, 4, 6)
THERE, NOT_THERE = 1e-6, 0.05
LEFT = 6
"""A degree is tried where it leaves so many values."""


@dataclass(frozen=True)
class Way:
    """An F-test by degree: ``chances``; ``size``: between the two ways at the middle, and per x and
    per y at the edge, with the highest degree, in the unit of the heights; ``sigma`` of these (3,).
    """

    chances: tuple[float, ...]
    size: Array
    sigma: Array

    @property
    def label(self) -> str:
        """Return ``there``, ``nothing`` or ``undecided``."""
        if max(self.chances) < THERE:
            return "there"
        return "nothing" if min(self.chances) > NOT_THERE else "undecided"


def way(x: Array, y: Array, direction: Array, height: Array) -> Way | None:
    """Return whether heights (N,) at places (N,) go with directions (N,) of +1 and -1.

    None where a bed has too few touches for the lowest degree.
    """
    reach = max(float(np.abs(x).max()), float(np.abs(y).max()))
    x, y = x / reach, y / reach
    by = np.column_stack([direction, direction * x, direction * y])
    chances: list[float] = []
    size, sigma = np.zeros(3), np.zeros(3)
    for degree in DEGREES:
        shape = np.column_stack([x**i * y**j for i in range(degree + 1)
                                 for j in range(degree + 1 - i)])
        left = height.size - shape.shape[1] - 3
        if left < LEFT:
            break
        both = np.concatenate([shape, by], axis=1)
        found = np.linalg.lstsq(both, height, rcond=None)[0]
        without = height - shape @ np.linalg.lstsq(shape, height, rcond=None)[0]
        rest = height - both @ found
        noise = rest @ rest / left
        chances.append(float(fisher.sf((without @ without - rest @ rest) / 3 / noise, 3, left)))
        spread = np.sqrt(noise * np.diag(np.linalg.pinv(both.T @ both)))
        size, sigma = 2.0 * found[-3:], 2.0 * spread[-3:]
    return Way(tuple(chances), size, sigma) if chances else None


def read(path: Path) -> tuple[Array, Array, Array, Array]:
    """Return place, direction and height (N,) of a bed's touches, mm."""
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    x, y, direction, height = (np.array([float(r[c]) for r in rows]) for c in (
        "x_cmd_mm", "y_cmd_mm", "approach_dir_x", "mesh_z_mm"))
    return x, y, direction, height


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, default=os.environ.get("PPMCAL_DATA"))
    given = parser.parse_args()
    print("| bed | touches | p by degree | middle, x, y between the ways (mm) | label |")
    print("|---|---|---|---|---|")
    for path in sorted((Path(given.data) / "delta-meshes").glob("*.csv")):
        columns = read(path)
        found = way(*columns)
        if found is not None:
            sizes = ", ".join(f"{a:+.4f} +- {s:.4f}" for a, s in
                              zip(found.size, found.sigma, strict=True))
            chances = ", ".join(f"{p:.1e}" for p in found.chances)
            print(f"| {path.stem[:6]} | {columns[0].size} | {chances} | {sizes} | {found.label} |")


if __name__ == "__main__":
    main()
