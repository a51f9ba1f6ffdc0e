"""Options of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, field

from ppmcal.calibration.fit import FitOptions


@dataclass(frozen=True)
class DiagnosisOptions:
    """How to diagnose.

    ``holdout``: fraction of the poses held out; ``kinds``: to try, None for all; ``by_session``:
    compute the gap by leaving sessions out in turn; ``held``: names of parameters held by a choice
    of freedoms, which the intervals account for.
    """

    holdout: float = 0.27
    seed: int = 0
    kinds: tuple[str, ...] | None = None
    by_session: bool = False
    held: tuple[str, ...] = ()
    fit: FitOptions = field(default_factory=FitOptions)
