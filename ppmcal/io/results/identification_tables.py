"""parameters.csv and residuals.csv, and what residuals.csv says by row: norms, times the noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppmcal.calibration.fit import GAP, Fit, MissingPoses, Problem, labels
from ppmcal.calibration.validation import Residuals
from ppmcal.io.csv import Table, csv_text
from ppmcal.io.results.record import Column, table_lines
from ppmcal.io.results.tables import (
    ENVIRONMENT,
    STAGES,
    WrittenTable,
    column_units,
    joint_columns,
    pose_columns,
)
from ppmcal.linalg import Array, Bools
from ppmcal.model.instruments import is_own_reading, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.store.output import LongText
from ppmcal.units import coordinate_quantity

PARAMETERS = ("name", "nominal", "value", "error", "sigma", "sigma_data", "tolerance", "unit",
              "status", "low", "high")
SESSIONS = ("sigma_sessions", "disagree")
PARAMETER_TABLE = WrittenTable(
    "parameters.csv", lambda name: name in (*PARAMETERS, *SESSIONS) and name not in (
        "name", "unit", "status"), frozenset({"disagree"}))
RESIDUAL_TABLE = WrittenTable(
    "residuals.csv", lambda name: name in ("row", "used", "x", "y") or name.startswith(STAGES),
    frozenset({"used"}))
"""With measured x and y in files of earlier versions."""
NEXT_TABLE = WrittenTable("next.csv", lambda name: name in (*POSE_COORDINATES, *ENVIRONMENT)
                          or name.startswith(("q_", "dir_", "vel_", "temperature")))


def quantity_of(coordinate: str) -> str:
    """Return the quantity of a measured coordinate, ``length`` or ``angle``."""
    return coordinate_quantity(coordinate) if is_measured(coordinate) else "length"


def is_measured(name: str) -> bool:
    """Whether residuals are of something called so."""
    return (name in (*POSE_COORDINATES, *number_names()) or name.startswith(GAP)
            or is_own_reading(name))


def _residual_names(problem: Problem) -> list[str]:
    """Return what residuals are of: coordinates first, gaps of limbs as they come."""
    measured = dict.fromkeys(c for d in problem.datasets for c in labels(d, problem.mechanism))
    known = [c for c in (*POSE_COORDINATES, *number_names()) if c in measured]
    return known + [c for c in measured if c not in known]


def parameters_csv(entries: Sequence[object]) -> str:
    """Return parameters.csv of entries of identification.json, in their units.

    ``low`` and ``high`` are the ends of the 95 % interval, empty where there is none.
    Where intervals count more than noise, columns say so: ``sigma_sessions``, and ``disagree``, 1
    where sessions disagree.
    """
    heads: tuple[str, ...] = PARAMETERS
    if any(getattr(e, "sigma_sessions", None) is not None for e in entries):
        heads += SESSIONS
    return csv_text(heads, [[int(v) if isinstance(v, bool) else v
                             for e in entries for v in [getattr(e, h)]] for h in heads])


def table_units(problem: Problem) -> dict[str, dict[str, str]]:
    """Return the units of residuals.csv and next.csv by column, empty for bare numbers.

    parameters.csv states its own, row by row.
    """
    mechanism = problem.mechanism
    residual = [f"{stage}{c}" for c in _residual_names(problem) for stage in STAGES]
    wanted = [*(f"q_{a}" for a in mechanism.actuators), *mechanism.coordinates, "temperature",
              *ENVIRONMENT, *(f"dir_{a}" for a in mechanism.actuators)]
    return {"residuals.csv": column_units(mechanism, ["row", *residual, "used"]),
            "next.csv": column_units(mechanism, wanted)}


def missing_csv(mechanism: Mechanism, missing: MissingPoses) -> str:
    """Return next.csv: joints and poses of the measurements that a weak campaign lacks."""
    table = joint_columns(mechanism, missing.q, "q_{}") | pose_columns(mechanism, missing.pose)
    return csv_text(list(table), list(table.values()))


def residuals_csv(fit: Fit, before: Residuals, after: Residuals,
                  geometry: Residuals | None = None) -> LongText:
    """Return residuals.csv: one line per input row, data set by data set.

    Rows that held nothing usable come last, with their reason; a used row that counts in part has
    its weight there. ``geometry``: of a fit of geometry alone, where the model has more.
    """
    sets = fit.problem.datasets
    dropped = [(d.name, row, reason) for d in sets for row, reason in d.dropped]
    sizes, lost = [len(d) for d in sets], len(dropped)
    reasons = np.full(sum(sizes) + lost, "", dtype=object)
    for begin, own, weight in zip(np.cumsum([0, *sizes]), fit.reasons, fit.problem.weights,
                                  strict=False):
        some = np.flatnonzero(weight < 0.995)    # else it would be written as one
        reasons[begin + some] = [f"weight {w:.2g}" for w in weight[some].tolist()]
        reasons[[begin + n for n in own]] = list(own.values())
    reasons[len(reasons) - lost:] = [reason for _, _, reason in dropped]
    stages = {"before": before.vector, "after": after.vector, "sigma": after.sigma,
              **({} if geometry is None else {"geometry": geometry.vector})}
    columns = [
        Column("row", np.concatenate([*(d.rows for d in sets),
                                      np.array([row for _, row, _ in dropped], dtype=np.int64)])),
        Column("dataset", np.repeat(
            np.array([*(d.name for d in sets), *(n for n, _, _ in dropped)], dtype=object),
            [*sizes, *(1 for _ in dropped)])),
        *_coordinate_columns(fit.problem, stages, lost),
        Column("used", np.concatenate([*fit.keep, np.zeros(lost, dtype=bool)]).astype(int)),
        Column("reason", reasons)]
    return table_lines(columns, fit.problem.mechanism.units)


def _coordinate_columns(problem: Problem, stages: Mapping[str, Sequence[Array]], dropped: int
                        ) -> Iterator[Column]:
    """Yield residuals and sigma of every measured coordinate; nan for rows without it.

    ``stages``: by name, m or rad of each data set (N, m).
    """
    for name in _residual_names(problem):
        for stage, source in stages.items():
            parts: list[Array] = []
            for d, values in zip(problem.datasets, source, strict=True):
                own = labels(d, problem.mechanism)
                parts.append(values[:, own.index(name)] if name in own else
                             np.full(len(d), np.nan))
            if dropped:
                parts.append(np.full(dropped, np.nan))
            yield Column(f"{stage}_{name}", parts[0] if len(parts) == 1 else
                         np.concatenate(parts), quantity_of(name))


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
    """All residuals of used rows over their noise, flat.

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


def gap_share(table: Table, freedoms: int) -> float:
    """Return the part of its noise that a gap of rows of joint values alone shows.

    Each row's pose of f coordinates is fitted to d closure equations. Of their noise, white, the
    residuals are what a projection onto d - f dimensions leaves, so that the sum of the squares of
    gaps over their sigma is d - f a row: their rms is sqrt((d - f) / d). How that is shared among
    the limbs of a row differs from pose to pose.

    Args:
        table: residuals.csv.
        freedoms: f, 0 where unknown: then 1.
    """
    equations = sum(c.startswith(GAP) for c in coordinates(table))
    return float(np.sqrt(1.0 - freedoms / equations)) if equations > freedoms else 1.0


def noise(table: Table, coordinate: str, freedoms: int = 0) -> Array:
    """Return the standard deviation of a residual that is noise alone (N,); see `gap_share`."""
    share = gap_share(table, freedoms) if coordinate.startswith(GAP) else 1.0
    return share * table.number(f"sigma_{coordinate}")


def white(table: Table, freedoms: int = 0) -> WhiteResiduals:
    """Return the white residuals of used rows; ``freedoms``: as :func:`gap_share`."""
    keep = used(table)
    out = []
    for c in coordinates(table):
        sigma = noise(table, c, freedoms)
        ratio = np.divide(table.number(f"after_{c}"), sigma, where=sigma > 1e-160,
                          out=np.full(table.size, np.nan))[keep]
        out.append(np.clip(ratio[np.isfinite(ratio)], -1e100, 1e100))
    values = np.concatenate(out) if out else np.zeros(0)
    return WhiteResiduals(values, float(np.sqrt(np.mean(values**2))) if values.size else None,
                          int(np.sum(np.abs(values) > FAR)))


def times_noise(table: Table, freedoms: int = 0) -> Array:
    """Return how far each row is from the model: rms of its residuals over their noise (N,)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratios = np.stack([table.number(f"after_{c}") / noise(table, c, freedoms)
                           for c in coordinates(table)] or [np.full(table.size, np.nan)])
        seen = np.isfinite(ratios)
        total = np.sum(np.where(seen, ratios, 0.0) ** 2, axis=0)
        out: Array = np.sqrt(total / np.sum(seen, axis=0))
    return out


def typical_sigma(table: Table, coordinate: str, freedoms: int = 0) -> float:
    """Return the median noise of a coordinate over used rows, 0 where none is known."""
    sigma = noise(table, coordinate, freedoms)[used(table)]
    sigma = sigma[np.isfinite(sigma)]
    return float(np.median(sigma)) if sigma.size else 0.0
