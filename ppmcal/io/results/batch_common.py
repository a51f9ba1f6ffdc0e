"""What the machines of a batch have in common: the design's share, and the units'."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.sessions import FEWEST, CommonError, common_errors, share_interval
from ppmcal.io.results.batch import CampaignRecord
from ppmcal.linalg import Array

MOST = 0.5
"""An effect is the design's where more than this share of all machines have it."""


@dataclass(frozen=True)
class SharedEffect:
    """An effect that some of the machines have."""

    kind: str
    machines: tuple[str, ...]
    of: int
    low: float
    high: float
    sizes: tuple[tuple[str, str, Array], ...]

    @property
    def whose(self) -> str:
        """Return whether it is of the design, or of single units."""
        if self.of < FEWEST:
            return "too few machines to say"
        if self.low > MOST:
            return "the design's"
        return "perhaps the design's" if len(self.machines) > MOST * self.of else "the units'"


def _latest(records: Iterable[CampaignRecord], *commands: str) -> list[CampaignRecord]:
    out: dict[str, CampaignRecord] = {}
    for r in sorted(records, key=lambda r: r.date):
        if r.command in commands and not r.failed:
            out[r.machine] = r
    return list(out.values())


def shared_effects(records: Sequence[CampaignRecord]) -> list[SharedEffect]:
    """Return the effects of the latest diagnosis of each machine, most frequent first."""
    diagnosed = [r for r in _latest(records, "diagnose") if r.verdict != "misread"]
    kinds = dict.fromkeys(q.name for r in diagnosed for q in r.of_kind("effect"))
    out = []
    for kind in kinds:
        own = [(r.machine, q) for r in diagnosed for q in r.of_kind("effect") if q.name == kind]
        machines = tuple(dict.fromkeys(m for m, _ in own))
        sizes = [(name, unit, np.array([q.value for _, q in own if (q.parameter, q.unit) == (
            name, unit) and q.value is not None and q.sigma is not None])) for name, unit in
            dict.fromkeys((q.parameter, q.unit) for _, q in own if q.sigma is not None)]
        low, high = share_interval(len(machines), len(diagnosed))
        out.append(SharedEffect(kind, machines, len(diagnosed), low, high, tuple(sizes)))
    return sorted(out, key=lambda e: -len(e.machines))


def shared_parameters(records: Sequence[CampaignRecord]
                      ) -> list[tuple[str, str, float | None, CommonError]]:
    """Return name, unit, tolerance and mean error of each parameter, surest first.

    Of those that every machine has: what is there only where it was found is never 0 on average.
    """
    columns: dict[tuple[str, str], list[tuple[float, float | None]]] = {}
    fits = _latest(records, "identify", "diagnose")
    for r in fits:
        named = {q.name for q in r.of_kind("effect")}
        for q in r.of_kind("parameter"):
            if (q.value is not None and q.nominal is not None and q.status != "fixed"
                    and q.name.partition(".")[0] not in named):
                columns.setdefault((q.name, q.unit), []).append(
                    (q.value - q.nominal, q.tolerance))
    columns = {k: own for k, own in columns.items() if len(own) == len(fits)}
    found = common_errors([np.array([e for e, _ in own]) for own in columns.values()])
    out = [(name, unit, own[0][1], f) for ((name, unit), own), f in
           zip(columns.items(), found, strict=True) if f is not None]
    return sorted(out, key=lambda o: o[3].p_value)
