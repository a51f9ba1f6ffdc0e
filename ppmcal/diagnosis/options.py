"""What a diagnosis is asked for."""

from __future__ import annotations

from dataclasses import dataclass, field

from ppmcal.calibration.fit import FitOptions


@dataclass(frozen=True)
class DiagnosisOptions:
    """How to diagnose.

    ``holdout``: part of the poses kept back; ``kinds``: to try, or all; ``by_session``: the gap is
    that of sessions left out in turn; ``held``: names of parameters that a choice of freedoms
    holds, which the intervals count.
    """

    holdout: float = 0.27
    seed: int = 0
    kinds: tuple[str, ...] | None = None
    by_session: bool = False
    held: tuple[str, ...] = ()
    fit: FitOptions = field(default_factory=FitOptions)
