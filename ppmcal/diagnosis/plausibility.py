"""Effects of a size that no machine has: then it is the data that are read wrongly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ppmcal.calibration.interpretation import NOISE, Misreading, Mistake, with_line
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.result import Found
from ppmcal.diagnosis.search import Search, columns_of
from ppmcal.diagnosis.selection import STARTS, bic, possible
from ppmcal.diagnosis.stage import Stage
from ppmcal.model.dataset import PAYLOADS

COLUMNS = {"load": "payload (kg) or fx ... mz (N, N m)", "wrench": "payload (kg) or fx ... mz",
           "vel": "the vel_ columns", "dir": "the dir_ columns", "temperature":
           "temperature (deg C)", "time": "time (s)"}
"""What to look at, by what an effect depends on."""


def fitted_values(search: Search, hypothesis: int) -> list[float]:
    """Return the coefficients of one hypothesis alone, SI."""
    return [float(v) for v in search.test.fit(columns_of(search, [hypothesis]))[0]]


def implausible(search: Search, named: Sequence[Hypothesis]) -> int | None:
    """Return a hypothesis that explains more than what was chosen, of a size that no machine has.

    Something else is wrong then, a unit perhaps, and what was chosen in its place imitates it.

    Args:
        search: the first one.
        named: what was chosen at last, perhaps hypotheses that a later search made.
    """
    values, chosen = search.values(), nearest(search, named)
    now = bic(search, chosen)
    for i in np.argsort(values, kind="stable")[:STARTS]:
        hypothesis = search.hypotheses[i]
        if values[i] > search.name or hypothesis.anonymous or int(i) in chosen:
            continue
        if possible(search, [int(i)], usual=False, named=False) and not possible(
                search, [int(i)], named=False) and (bic(search, [int(i)]) < now):
            return int(i)
    return None


def nearest(search: Search, named: Sequence[Hypothesis]) -> list[int]:
    """Return the hypotheses of a search most like others, which may be of another search.

    A group of joints that it does not have is taken joint by joint.
    """
    def like(hypothesis: Hypothesis, on: tuple[str, ...]) -> list[int]:
        same = [(hypothesis.apart(f), i) for i, f in enumerate(search.hypotheses)
                if (f.family, f.on) == (hypothesis.family, on)
                and (f.shared == hypothesis.shared or len(on) == 1)]
        return [min(same)[1]] if same else []

    out: list[int] = []
    for hypothesis in named:
        out += like(hypothesis, hypothesis.on) or [
            i for a in hypothesis.on for i in like(hypothesis, (a,))
        ]
    return list(dict.fromkeys(out))


OTHER_UNITS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "payload": tuple((unit, size) for unit, size in PAYLOADS.items() if size != 1.0),
    "vel": (("per minute", 1.0 / 60.0),),
}
"""By column: other units, and the factor on what was recorded."""
MUCH_BETTER = 10.0
"""BIC by which an effect of a column read otherwise has to be better than what was chosen."""


def misread_column(found: Found, chosen: Sequence[Hypothesis]) -> Misreading | None:
    """Return how a column of the environment is to be read, None where nothing says so.

    An effect explains more than what was chosen, with a size that is none of a machine but would
    be one with the column in another unit.
    """
    search = found.first.search
    values, now = search.values(), bic(search, nearest(search, chosen))
    for i in np.argsort(values, kind="stable")[:STARTS]:
        hypothesis = search.hypotheses[i]
        if values[i] > search.name or possible(search, [int(i)]):
            return None
        kind = hypothesis.effect
        if hypothesis.anonymous or kind is None or hypothesis.leans or (
                bic(search, [int(i)]) > now - MUCH_BETTER):
            continue
        for column in dict.fromkeys("payload" if n in ("load", "wrench") else n
                                    for n in kind.needs):
            for unit, factor in OTHER_UNITS.get(column, ()):
                if _in_range(search, int(i), factor):
                    return _column_misreading(found, hypothesis, column, unit)
    return None


def _in_range(search: Search, index: int, factor: float) -> bool:
    """Whether an effect has a size of machines if its column is ``factor`` times as recorded."""
    hypothesis = search.hypotheses[index]
    sizes = np.array(fitted_values(search, index)) / factor
    usual = hypothesis.usual or ((-np.inf, np.inf),) * hypothesis.size
    low = np.maximum(hypothesis.low, [u[0] for u in usual])
    high = np.minimum(hypothesis.high, [u[1] for u in usual])
    return bool(np.all((sizes >= low) & (sizes <= high)))


def _column_misreading(found: Found, hypothesis: Hypothesis, column: str, unit: str) -> Misreading:
    problem, stage = found.before.problem, found.first
    data = problem.datasets[0]
    names = ("payload",) if column == "payload" else tuple(
        f"{column}_{a}" for a in hypothesis.on or problem.mechanism.actuators)
    text = (f"{names[0] if len(names) == 1 else column + '_ of ' + ', '.join(hypothesis.on)} "
            f"is in {unit}: {hypothesis.label} then has a size that machines have")
    block = None if unit == "per minute" else with_line(data, "units", dict.fromkeys(names, unit))
    return of_column(data.source, Mistake("unit", names, text), block, stage,
                     stage.search.test.left(list(hypothesis.columns)))


def of_column(source: str, mistake: Mistake, block: dict[str, object] | None, stage: Stage,
              left: float) -> Misreading:
    """Return the misreading of a column, of whose residuals ``left`` would be the square."""
    before = float(np.sqrt(np.mean(stage.residual**2)))
    after = float(np.sqrt(left / max(stage.search.test.freedom, 1)))
    return Misreading(source, (mistake,), block, NOISE, before, after, after)


def implausible_words(found: Found, index: int) -> str:
    """Return what a size outside the range of machines says about the data."""
    hypothesis = found.first.search.hypotheses[index]
    values = fitted_values(found.first.search, index)
    motion = found.before.problem.mechanism.motion
    kind = hypothesis.effect
    assert kind is not None
    specs = {s.name: s for s in kind.parameters(motion)}
    told = []
    for name, value, (low, high) in zip(hypothesis.names, values, hypothesis.usual, strict=True):
        if low <= value <= high:
            continue
        spec = specs[name.split(":")[-1]]
        if spec.reciprocal:
            value, low, high = 1.0 / value, 1.0 / high, 1.0 / low
        told.append(f"{name.replace(':', ' ')} {value:.3g}, beyond {low:.2g} to {high:.2g} "
                    f"(SI; {spec.why})")
    column = kind.doubt or ", ".join(COLUMNS.get(n, n) for n in kind.needs) or (
        "the joint columns and of the rotations")
    return (
        f"{hypothesis.label} would explain most, but with {'; '.join(told[:2])}: no machine has "
        f"that; check the unit of {column}. Nothing is named in its place"
    )
