"""What residuals.csv says by row: which rows a fit used, norms, residuals over their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal.io.csv import Table
from ppmcal.io.results.identification_tables import quantity_of
from ppmcal.linalg import Array, Bools
from ppmcal.model.motions import POSE_COORDINATES

FAR = 5.0
"""White residuals beyond so many sigma are counted apart."""


@dataclass(frozen=True)
class ResidualNorm:
    """Coordinates that have one norm: position, rotation, or one distance.

    ``before`` and ``after`` (N,) are norms over the measured coordinates, nan where none is.
    """

    name: str
    quantity: str
    before: Array
    after: Array


@dataclass(frozen=True)
class WhiteResiduals:
    """All residuals of used rows over their sigma, flat.

    ``rms`` is 1 where all is noise, None without any; ``far``: how many are beyond :data:`FAR`.
    """

    values: Array
    rms: float | None
    far: int


def rms(values: Array) -> float:
    """Return the root mean square of what is finite."""
    return float(np.sqrt(np.nanmean(values**2)))


def coordinates(table: Table) -> list[str]:
    """Return the measured coordinates, in the file's order."""
    return [h.removeprefix("after_") for h in table.header if h.startswith("after_")]


def used(table: Table) -> Bools:
    """Return which rows the fit used (N,); all of them if the file does not say."""
    if "used" not in table.numbers:
        return np.ones(table.size, dtype=bool)
    return np.asarray(table.number("used") != 0.0, dtype=bool)


def row_numbers(table: Table) -> NDArray[np.int64]:
    """Return the number of every row in its file (N,), -1 where residuals.csv does not say."""
    found = np.nan_to_num(np.clip(table.number("row"), -1.0, 1e15), nan=-1.0)
    return found.astype(np.int64)


def row_key(index: int | str, dataset: str, row: int) -> str:
    """Return the name by which plots, tables and the drawing know a row.

    Args:
        index: of the identification on the page, from 0; of a diagnosis alone its folder.
        dataset: the row's data set.
        row: its number in the file.
    """
    return f"{index}:{dataset}:{row}"


def norms(table: Table) -> list[ResidualNorm]:
    """Return the norms of position and rotation, and further coordinates by themselves."""
    have = coordinates(table)
    parts: list[tuple[str, list[str]]] = [
        ("position", [c for c in have if c in POSE_COORDINATES[:3]]),
        ("rotation", [c for c in have if c in POSE_COORDINATES[3:]]),
        *((c, [c]) for c in have if c not in POSE_COORDINATES)]
    return [ResidualNorm(name, quantity_of(members[0]),
                         norm([table.number(f"before_{c}") for c in members]),
                         norm([table.number(f"after_{c}") for c in members]))
            for name, members in parts if members]


def norm(parts: Array | Sequence[Array]) -> Array:
    """Return the norm over the finite components (N,), nan where none is."""
    stack = np.array(parts)
    seen = np.isfinite(stack)
    total = np.sqrt(np.sum(np.where(seen, stack, 0.0) ** 2, axis=0))
    return np.where(seen.any(axis=0), total, np.nan)


def white(table: Table) -> WhiteResiduals:
    """Return the white residuals of used rows."""
    keep = used(table)
    out = []
    for c in coordinates(table):
        sigma = table.number(f"sigma_{c}")
        ratio = np.divide(table.number(f"after_{c}"), sigma, where=sigma > 1e-160,
                          out=np.full(table.size, np.nan))[keep]
        out.append(np.clip(ratio[np.isfinite(ratio)], -1e100, 1e100))
    values = np.concatenate(out) if out else np.zeros(0)
    return WhiteResiduals(values, float(np.sqrt(np.mean(values**2))) if values.size else None,
                          int(np.sum(np.abs(values) > FAR)))


def times_noise(table: Table) -> Array:
    """Return how far each row is from the model: rms of its residuals over their sigma (N,)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratios = np.stack([table.number(f"after_{c}") / table.number(f"sigma_{c}")
                           for c in coordinates(table)] or [np.full(table.size, np.nan)])
        seen = np.isfinite(ratios)
        total = np.sum(np.where(seen, ratios, 0.0) ** 2, axis=0)
        out: Array = np.sqrt(total / np.sum(seen, axis=0))
    return out


def typical_sigma(table: Table, coordinate: str) -> float:
    """Return the median sigma of a coordinate over used rows, 0 where none is known."""
    sigma = table.number(f"sigma_{coordinate}")[used(table)]
    sigma = sigma[np.isfinite(sigma)]
    return float(np.median(sigma)) if sigma.size else 0.0
