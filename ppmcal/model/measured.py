"""What a calibration saw, kept in the machine's own file: noise check, end of the fit, ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

MISSED = 5.0
"""Residuals more than so many times the stated noise: the model misses its own measurements."""
CHANCE = 1e-3
"""Chance of as large residuals below which it does."""


@dataclass(frozen=True)
class MeasurementBasis:
    """Residuals and ranges of the measurements behind a calibrated machine, and how its fit ended.

    Attributes:
        sigma_ratio: rms of the residuals over the stated noise, nan where unknown.
        chi2_p: chance of residuals as large, if model and stated noise are right.
        ranges: column -> (low, high), SI: coordinates of the platform's pose in the base frame,
            ``q_<actuator>``, and the recorded conditions.
        converged: whether the fit was at its minimum, or was ended on purpose at the noise; None
            where unknown.
    """

    sigma_ratio: float = float("nan")
    chi2_p: float = float("nan")
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    converged: bool | None = None

    @property
    def missed(self) -> bool:
        """Whether the model misses its own measurements by far more than their noise."""
        return self.sigma_ratio > MISSED and self.chi2_p < CHANCE
